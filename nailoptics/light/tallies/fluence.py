"""How light spreads below a place of the board: its paths by depth and by distance from there."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Geometry
from ..arithmetic import atan2
from ..sampling import Photon
from .cell_grid import CellGrid


class FluenceTally:
    """Sums of paths on rings around a place, by depth below the nail plate's outer face; above it is negative.

    place_mm : (u, v) on the flat board. [mm]
    radius_mm, depth_mm : edges, evenly spaced. [mm]
    """

    def __init__(
        self, geometry: Geometry, place_mm: tuple[float, float], radius_mm: np.ndarray, depth_mm: np.ndarray
    ) -> None:
        self.radius_mm, self.depth_mm = radius_mm, depth_mm
        self.nail, self.board, self.u, self.v = (
            dr.opaque(mi.Float, float(x)) for x in (geometry.nail_radius_mm, geometry.board_radius_mm, *place_mm)
        )
        edges = (radius_mm, depth_mm)
        self.shape = tuple(len(edge) - 1 for edge in edges)
        self.grid = CellGrid([e[0] for e in edges], [e[1] - e[0] for e in edges], self.shape)
        self.values = dr.zeros(mi.Float64, int(np.prod(self.shape)))

    def add(self, photon: Photon, p: Any, path: Any, weight: Any, active: Any) -> None:
        """Add a photon's path, of a middle p and a weight there. [mm]"""
        height = p.z + self.nail
        across, along = self.board * atan2(p.x, height) - self.u, p.y - self.v
        place = dr.sqrt(across * across + along * along), self.nail - dr.sqrt(p.x * p.x + height * height)
        cell, inside = self.grid.cell(place, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.values, mi.Float64(path * weight), cell, inside)

    def density(self, photons: int) -> np.ndarray:
        """Fluence rate per emitted power, (radius, depth) float. [mm^-2]"""
        ring = np.pi * np.diff(self.radius_mm**2)[:, None] * np.diff(self.depth_mm)[None]
        return np.array(self.values).reshape(self.shape) / (photons * ring)
