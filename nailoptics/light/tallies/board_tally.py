"""What the walk keeps of each photon that arrives at the board's underside."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Geometry
from ..arithmetic import atan2
from ..sampling import remaining
from ..surroundings import FingerPhoton

# The bare board sends back a few percent, so that a photon may arrive again; a fifth time one in a million does.
ARRIVALS = 4


class BoardTally:
    """Place, weight and paths of every arrival at the underside, in slots of their photon.

    angles : whether the angles at which they meet it are kept, too.
    """

    def __init__(self, geometry: Geometry, *, photons: int, paths: int, angles: bool = False) -> None:
        self.nail_mm, self.board_mm = (
            dr.opaque(mi.Float, r) for r in (geometry.nail_radius_mm, geometry.board_radius_mm)
        )
        self.columns = [dr.zeros(mi.Float, photons * ARRIVALS) for _ in range(3 + paths)]
        self.cosines = dr.zeros(mi.Float, photons * ARRIVALS) if angles else None

    def add(self, photon: FingerPhoton, cos: Any, active: Any) -> None:
        """Keep a photon that arrives once more, at an angle of this cosine."""
        slot, inside = photon.index * ARRIVALS + photon.arrivals, active & (photon.arrivals < ARRIVALS)
        u = self.board_mm * atan2(photon.p.x, photon.p.z + self.nail_mm)
        values = (u, photon.p.y, photon.weight * remaining(photon.tau), *photon.path)
        for column, value in zip(self.columns, values, strict=True):
            dr.scatter(column, value, slot, inside)
        if self.cosines is not None:
            dr.scatter(self.cosines, cos, slot, inside)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Photon (n,), place (n, 2) [mm], weight (n,), paths (t, n) [mm] and cosine (n,), in the order of the photons;
        all cosines are 1 where angles are not kept."""
        dr.eval(self.columns)
        slot = np.flatnonzero(np.array(self.columns[2]))
        u, v, weight, *paths = (np.array(column)[slot] for column in self.columns)
        cos = np.ones(len(slot)) if self.cosines is None else np.array(self.cosines)[slot].astype(float)
        return slot // ARRIVALS, np.stack([u, v], -1).astype(float), weight.astype(float), np.stack(paths), cos
