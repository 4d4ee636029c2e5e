"""Where the light of an LED goes: its paths summed on a longitudinal section through the finger."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..sampling import Photon
from .cell_grid import CellGrid


class Section:
    """The light's path density on the longitudinal section, summed over the finger's width."""

    def __init__(self, y_mm: np.ndarray, z_mm: np.ndarray) -> None:
        self.y_mm, self.z_mm, self.spacing_mm = y_mm, z_mm, float(y_mm[1] - y_mm[0])
        self.values = dr.zeros(mi.Float64, len(y_mm) * len(z_mm))
        low = [float(axis[0] - self.spacing_mm / 2) for axis in (y_mm, z_mm)]
        self.grid = CellGrid(low, [self.spacing_mm] * 2, [len(y_mm), len(z_mm)])

    def add(self, photon: Photon, p: Any, path: Any, weight: Any, active: Any) -> None:
        """Add a photon's path, of a middle p and a weight there. [mm]"""
        cell, inside = self.grid.cell((p.y, p.z), active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.values, mi.Float64(path * weight), cell, inside)

    def density(self, photons: int) -> np.ndarray:
        """Path per area of the section and emitted photon, (y, z) float. [mm^-1]"""
        return np.array(self.values).reshape(len(self.y_mm), len(self.z_mm)) / (photons * self.spacing_mm**2)
