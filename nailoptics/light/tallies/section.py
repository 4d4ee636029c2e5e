"""Where the light of an LED goes: its paths summed on a longitudinal section through the finger."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..sampling import Photon


class Section:
    """The light's path density on the longitudinal section, summed over the finger's width."""

    def __init__(self, y_mm: np.ndarray, z_mm: np.ndarray) -> None:
        self.y_mm, self.z_mm, self.spacing_mm = y_mm, z_mm, float(y_mm[1] - y_mm[0])
        self.values = dr.zeros(mi.Float64, len(y_mm) * len(z_mm))
        self.low = [dr.opaque(mi.Float, float(axis[0] - self.spacing_mm / 2)) for axis in (y_mm, z_mm)]
        self.count = [dr.opaque(mi.UInt32, len(axis)) for axis in (y_mm, z_mm)]

    def add(self, photon: Photon, p: Any, path: Any, weight: Any, active: Any) -> None:
        """Add a photon's path, of a middle p and a weight there. [mm]"""
        j = mi.Int32(dr.floor((p.y - self.low[0]) / self.spacing_mm))
        k = mi.Int32(dr.floor((p.z - self.low[1]) / self.spacing_mm))
        inside = active & (j >= 0) & (k >= 0) & (mi.UInt32(j) < self.count[0]) & (mi.UInt32(k) < self.count[1])
        cell = mi.UInt32(j) * self.count[1] + mi.UInt32(k)
        dr.scatter_reduce(dr.ReduceOp.Add, self.values, mi.Float64(path * weight), cell, inside)

    def density(self, photons: int) -> np.ndarray:
        """Path per area of the section and emitted photon, (y, z) float. [mm^-1]"""
        return np.array(self.values).reshape(len(self.y_mm), len(self.z_mm)) / (photons * self.spacing_mm**2)
