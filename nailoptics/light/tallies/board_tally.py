"""What the walk keeps of each photon that arrives at the board's underside."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Geometry
from ..arithmetic import atan2

# The bare board sends back a few percent, so that a photon may arrive again; a fifth time one in a million does.
ARRIVALS = 4


class Recorder:
    """Place, weight and paths of every arrival at the underside, in slots of their photon."""

    def __init__(self, shape: Geometry, *, photons: int, tallies: int) -> None:
        self.nail_mm, self.board_mm = (dr.opaque(mi.Float, r) for r in (shape.nail_radius_mm, shape.board_radius_mm))
        self.columns = [dr.zeros(mi.Float, photons * ARRIVALS) for _ in range(3 + tallies)]

    def add(self, p: Any, weight: Any, path: list[Any], photon: Any, arrived: Any, active: Any) -> None:
        """Keep photons that arrive at p for the arrived-th time."""
        slot, inside = photon * ARRIVALS + arrived, active & (arrived < ARRIVALS)
        u = self.board_mm * atan2(p.x, p.z + self.nail_mm)
        for column, value in zip(self.columns, (u, p.y, weight, *path), strict=True):
            dr.scatter(column, value, slot, inside)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Photon (n,), place (n, 2) [mm], weight (n,) and paths (tallies, n) [mm], in the order of the photons."""
        dr.eval(self.columns)
        slot = np.flatnonzero(np.array(self.columns[2]))
        u, v, weight, *paths = (np.array(column)[slot] for column in self.columns)
        return slot // ARRIVALS, np.stack([u, v], -1).astype(float), weight.astype(float), np.stack(paths)
