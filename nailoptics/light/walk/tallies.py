"""Tallies of a walk: what it keeps of photons on their way, and where they arrive on the board."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Geometry
from ...scene import Scene
from .interfaces import FingerPhoton
from .sampling import atan2, survival


class CellGrid:
    """Cells of equal size along each axis, from a lowest corner on."""

    def __init__(self, low_mm: Iterable[float], cell_mm: Iterable[float], count: Iterable[int]) -> None:
        self.low = [dr.opaque(mi.Float, float(low)) for low in low_mm]
        self.per_mm = [dr.opaque(mi.Float, float(1 / size)) for size in cell_mm]
        self.count = [dr.opaque(mi.UInt32, int(n)) for n in count]

    def cell(self, place: Sequence[Any], active: Any) -> tuple[Any, Any]:
        """Index of the cell at a place, the last axis counting fastest, and whether there is one."""
        index, inside = mi.UInt32(0), mi.Bool(active)
        for value, low, per_mm, count in zip(place, self.low, self.per_mm, self.count, strict=True):
            cell = mi.Int32(dr.floor((value - low) * per_mm))
            inside &= (cell >= 0) & (mi.UInt32(cell) < count)
            index = index * count + mi.UInt32(cell)
        return index, inside


# The bare board sends back a few percent, so that a photon may arrive again; a fifth time one in a million does.
ARRIVALS = 4


class BoardTally:
    """Place, angle, weight and paths of every arrival at the underside, in slots of their photon."""

    def __init__(self, geometry: Geometry, *, photons: int, paths: int) -> None:
        self.nail_mm, self.board_mm = (
            dr.opaque(mi.Float, r) for r in (geometry.nail_radius_mm, geometry.board_radius_mm)
        )
        self.columns = [dr.zeros(mi.Float, photons * ARRIVALS) for _ in range(4 + paths)]

    def add(self, photon: FingerPhoton, cos: Any, active: Any) -> None:
        """Keep a photon that arrives once more, at an angle of this cosine."""
        slot, inside = photon.index * ARRIVALS + photon.arrivals, active & (photon.arrivals < ARRIVALS)
        u = self.board_mm * atan2(photon.p.x, photon.p.z + self.nail_mm)
        values = (u, photon.p.y, photon.weight * survival(photon.tau), cos, *photon.path)
        for column, value in zip(self.columns, values, strict=True):
            dr.scatter(column, value, slot, inside)

    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Photon (n,), place (n, 2) [mm], weight (n,), paths (t, n) [mm] and cosine (n,), in the photons' order."""
        dr.eval(self.columns)
        slot = np.flatnonzero(np.array(self.columns[2]))
        u, v, weight, cos, *paths = (np.array(column)[slot] for column in self.columns)
        place = np.stack([u, v], -1).astype(float)
        return slot // ARRIVALS, place, weight.astype(float), np.stack(paths), cos.astype(float)


class PathTally:
    """Sums of paths on a grid of cells, each times the photon's weight there: per volume they are the fluence.

    place : coordinates of a point on the grid.
    """

    def __init__(self, edges_mm: Sequence[np.ndarray], place: Callable[[Any], Sequence[Any]]) -> None:
        self.shape, self.place = tuple(len(e) - 1 for e in edges_mm), place
        self.values = dr.zeros(mi.Float64, int(np.prod(self.shape)))
        self.grid = CellGrid([e[0] for e in edges_mm], [e[1] - e[0] for e in edges_mm], self.shape)

    def add(self, photon: FingerPhoton, p: Any, path: Any, weight: Any, active: Any) -> None:
        """Add the path of a photon, whose region other tallies read, of a middle p and a weight there. [mm]"""
        cell, inside = self.grid.cell(self.place(p), active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.values, mi.Float64(path * weight), cell, inside)

    def sums(self) -> np.ndarray:
        """Sums in each cell, (...) float. [mm]"""
        return np.array(self.values).reshape(self.shape)


class Section(PathTally):
    """The light's path density on the longitudinal section, summed over the finger's width."""

    def __init__(self, y_mm: np.ndarray, z_mm: np.ndarray) -> None:
        self.spacing_mm = float(y_mm[1] - y_mm[0])
        edges = [np.append(axis, axis[-1] + self.spacing_mm) - self.spacing_mm / 2 for axis in (y_mm, z_mm)]
        super().__init__(edges, lambda p: (p.y, p.z))

    def density(self, photons: int) -> np.ndarray:
        """Path per area of the section and emitted photon, (y, z) float. [mm^-1]"""
        return np.asarray(self.sums() / (photons * self.spacing_mm**2))


ACROSS_MM, ALONG_MM = 0.3, 0.2
# Cells through the depth of the bed, and below it.
BED_CELLS, DEEPER_CELLS = 16, 8


class FluenceTally(PathTally):
    """Sums of paths on cells from the plate through the bed into what lies below, over the whole nail, in its own
    coordinates: u across (as on the board), v along, depth below the plate's face.

    edges_mm : u, v and depth, evenly spaced; the bed's faces are among those of the depth. [mm]
    volume_mm3 : of the cells, which narrow with the depth, (depth,) float. [mm^3]
    """

    def __init__(self, scene: Scene, geometry: Geometry) -> None:
        finger, nail_mm, board_mm = scene.fingertip, geometry.nail_radius_mm, geometry.board_radius_mm
        half_u = finger.nail_width_mm / 2 * board_mm / nail_mm
        half_v, step = finger.nail_length_mm / 2, finger.bed_thickness_mm / BED_CELLS
        above = int(finger.nail_thickness_mm / step)
        u = np.linspace(-half_u, half_u, max(2, round(2 * half_u / ACROSS_MM) + 1))
        v = np.linspace(-half_v, half_v, max(2, round(2 * half_v / ALONG_MM) + 1))
        depth = finger.nail_thickness_mm + step * np.arange(-above, BED_CELLS + DEEPER_CELLS + 1)
        self.edges_mm, radius_mm = (u, v, depth), nail_mm - (depth[1:] + depth[:-1]) / 2
        self.volume_mm3 = (u[1] - u[0]) * (v[1] - v[0]) * (depth[1] - depth[0]) * radius_mm / board_mm
        nail, board = (dr.opaque(mi.Float, r) for r in (nail_mm, board_mm))

        def place(p: Any) -> tuple[Any, Any, Any]:
            height = p.z + nail
            return board * atan2(p.x, height), p.y, nail - dr.sqrt(p.x * p.x + height * height)

        super().__init__(self.edges_mm, place)
