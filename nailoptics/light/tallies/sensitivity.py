"""Where detected light was in the finger: its photons are walked once more, and their paths summed on voxels."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Geometry
from ...scene import Scene
from ..arithmetic import atan2
from ..sampling import Photon
from .cell_grid import CellGrid

ACROSS_MM, ALONG_MM = 0.3, 0.2
# Cells through the depth of the bed, and below it.
BED_CELLS, DEEPER_CELLS = 16, 8


@dataclass(frozen=True)
class VoxelGrid:
    """Cells under the nail, in its own coordinates: u across (as on the board), v along, depth below the plate's face.

    u_mm, v_mm, depth_mm : edges, evenly spaced; the bed's faces are among those of the depth. [mm]
    """

    u_mm: np.ndarray
    v_mm: np.ndarray
    depth_mm: np.ndarray
    nail_radius_mm: float
    board_radius_mm: float

    @staticmethod
    def under_nail(scene: Scene, geometry: Geometry) -> "VoxelGrid":
        """Cells from the plate through the bed into what lies below, over the whole nail."""
        finger = scene.finger
        assert finger is not None
        half_u = finger.nail_width_mm / 2 * geometry.board_radius_mm / geometry.nail_radius_mm
        half_v, step = finger.nail_length_mm / 2, finger.bed_thickness_mm / BED_CELLS
        above = int(finger.nail_thickness_mm / step)
        return VoxelGrid(
            np.linspace(-half_u, half_u, max(2, round(2 * half_u / ACROSS_MM) + 1)),
            np.linspace(-half_v, half_v, max(2, round(2 * half_v / ALONG_MM) + 1)),
            finger.nail_thickness_mm + step * np.arange(-above, BED_CELLS + DEEPER_CELLS + 1),
            geometry.nail_radius_mm,
            geometry.board_radius_mm,
        )

    @property
    def shape(self) -> tuple[int, int, int]:
        """How many cells in u, v and depth."""
        return len(self.u_mm) - 1, len(self.v_mm) - 1, len(self.depth_mm) - 1

    @cached_property
    def volume_mm3(self) -> np.ndarray:
        """Volume of the cells, which narrow with the depth, (1, 1, depth) float. [mm^3]"""
        radius = self.nail_radius_mm - (self.depth_mm[1:] + self.depth_mm[:-1]) / 2
        area = (self.u_mm[1] - self.u_mm[0]) * (self.v_mm[1] - self.v_mm[0])
        return (area * (self.depth_mm[1] - self.depth_mm[0]) * radius / self.board_radius_mm)[None, None]


class SensitivityTally:
    """Sums of paths on cells, each times what its photon counts for, in several groups of photons.

    weight, group : (photons,) What each photon of the walk counts for, and in which group.
    """

    def __init__(self, cells: VoxelGrid, weight: np.ndarray, group: np.ndarray, groups: int) -> None:
        self.cells, self.groups = cells, groups
        self.weight, self.group = mi.Float(weight.astype(np.float32)), mi.UInt32(group.astype(np.uint32))
        self.values = dr.zeros(mi.Float64, groups * int(np.prod(cells.shape)))
        self.per_group = dr.opaque(mi.UInt32, int(np.prod(cells.shape)))
        self.radii = [dr.opaque(mi.Float, r) for r in (cells.nail_radius_mm, cells.board_radius_mm)]
        edges = (cells.u_mm, cells.v_mm, cells.depth_mm)
        self.grid = CellGrid([e[0] for e in edges], [e[1] - e[0] for e in edges], cells.shape)

    def add(self, photon: Photon, p: Any, path: Any, weight: Any, active: Any) -> None:
        """Add a photon's path, of a middle p, times what it counts for in the end, whatever it weighs there. [mm]"""
        nail, board = self.radii
        height = p.z + nail
        place = (board * atan2(p.x, height), p.y, nail - dr.sqrt(p.x * p.x + height * height))
        cell, inside = self.grid.cell(place, active)
        group = dr.gather(mi.UInt32, self.group, photon.index, active)
        counts = dr.gather(mi.Float, self.weight, photon.index, active)
        dr.scatter_reduce(
            dr.ReduceOp.Add, self.values, mi.Float64(path * counts), group * self.per_group + cell, inside
        )

    def sums(self) -> np.ndarray:
        """Sums in each group and cell, (groups, u, v, depth) float. [mm]"""
        return np.array(self.values).reshape(self.groups, *self.cells.shape)
