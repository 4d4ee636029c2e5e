"""A geometry: interfaces that know both sides, and faces that emit and read."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .cast import Integers, cast
from .grid import Array, Grid, Indices


@dataclass(frozen=True)
class Face:
    """The face of an LED die or a photodiode element that faces the nail.

    name : as in the scene's layout.
    region : index of the part's own region; the epoxy lies on the face's other side.
    quads : (k, 4, 3) float. Planar rectangles, corners counter-clockwise seen from the nail side. [mm]
    normal : (k, 3) float. Unit normals of the quads, into the epoxy and towards the nail.
    area_mm2 : Area of all quads. [mm^2]
    """

    name: str
    region: int
    quads: Array
    normal: Array
    area_mm2: float

    @property
    def areas_mm2(self) -> Array:
        """Areas of the quads, (k,) float. [mm^2]"""
        diagonals = self.quads[:, 2] - self.quads[:, 0], self.quads[:, 3] - self.quads[:, 1]
        return np.asarray(np.linalg.norm(np.cross(*diagonals), axis=1) / 2)

    @property
    def center_mm(self) -> Array:
        """Middle of the face, weighted by area, (3,) float. [mm]"""
        return np.average(self.quads.mean(axis=1), axis=0, weights=self.areas_mm2)

    @property
    def reach_mm(self) -> float:
        """From its middle to its farthest corner. [mm]"""
        return float(np.linalg.norm(self.quads - self.center_mm, axis=-1).max())


@dataclass(frozen=True)
class Geometry:
    """A finger with its board as interfaces between regions, each face once.

    Millimetres; the origin is the centre of the nail plate's outer face, x across, y to the tip, z out of the nail.

    vertices : (n, 3) float. [mm]
    triangles : (m, 3) int. Counter-clockwise seen from the side of `above`: normals point from `below` to `above`.
    below, above : (m,) int. Region on either side of each triangle.
    regions : Names of the regions; 0 is air. The first ones are `regions.REGIONS`, then "led:NAME" for each LED and
        "photodiode:NAME" for each element that is read.
    leds, photodiodes : Faces in the order of the scene's layout.
    nail_radius_mm : Radius of the nail plate's outer face. [mm]
    board_radius_mm : Radius of the board's underside, on which positions on the board are arc lengths. [mm]
    """

    vertices: Array
    triangles: Indices
    below: Indices
    above: Indices
    regions: tuple[str, ...]
    leds: tuple[Face, ...]
    photodiodes: tuple[Face, ...]
    nail_radius_mm: float
    board_radius_mm: float
    grid: Grid = field(repr=False)

    def on_board(self, p_mm: Array) -> Array:
        """Where points (n, 3) of the board's underside lie on the flat board, (n, 2) float: u, v. [mm]"""
        x, y, z = np.asarray(p_mm, float).T
        return np.stack([self.board_radius_mm * np.arctan2(x, z + self.nail_radius_mm), y], -1)

    @property
    def bounds_mm(self) -> Array:
        """Lowest and highest corner of the whole, (2, 3) float. [mm]"""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def normals(self, triangles: Indices) -> Array:
        """Unit normals of triangles (m, 3), (m, 3) float; of its own they point from `below` to `above`."""
        a, b, c = (self.vertices[triangles[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))

    def region_at(self, points: Array) -> Indices:
        """Region at each point (k, 3) [mm], from the triangles below it, (k,) int; on an interface either side."""
        points = np.asarray(points, float).reshape(-1, 3)
        ray, z, step = self._crossings(points[:, :2])
        below = z < points[ray, 2]
        return np.bincount(ray[below], step[below], len(points)).astype(np.int32)

    def columns(self, places_mm: Array, z_mm: Array) -> NDArray[np.int16]:
        """Region at places (r, 2) in x and y and at heights (k,), which rise, (r, k) int."""
        ray, z, step = self._crossings(places_mm)
        steps = np.zeros((len(places_mm), len(z_mm) + 1), np.int16)
        np.add.at(steps, (ray, np.searchsorted(z_mm, z)), step)
        return np.cumsum(steps, axis=1, dtype=np.int16)[:, :-1]

    def cells(self, low_mm: Array, side_mm: float, shape: Array) -> NDArray[np.int16]:
        """Region at the middles of cubic cells of a side from a lowest corner, of a shape, (nx, ny, nz) int. [mm]"""
        x, y, z = (low_mm[k] + side_mm * (np.arange(shape[k]) + 0.5) for k in range(3))
        places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        return self.columns(places, z).reshape(shape)

    def section(self, y_mm: Array, z_mm: Array) -> NDArray[np.int16]:
        """Region on the lengthwise section at x = 0, (y, z) int, at places along the axes, which rise. [mm]"""
        return self.columns(np.column_stack([np.zeros_like(y_mm), y_mm]), z_mm)

    def _crossings(self, places_mm: Array) -> tuple[Integers, Array, Indices]:
        """Ray and z of the crossings of rays upwards, and by how much each changes the region's number, from air on."""
        ray, z, triangle, forward = cast(self.vertices, self.triangles, places_mm)
        below, above = self.below[triangle], self.above[triangle]
        return ray, z, np.where(forward, above - below, below - above)

    def interfaces(self) -> dict[tuple[int, int], Indices]:
        """Triangles (k, 3) of each interface by its regions (below, above), the lower index below, turned round where
        that is needed: each pair of regions comes once."""
        swap = self.below > self.above
        triangles = np.where(swap[:, None], self.triangles[:, ::-1], self.triangles)
        low, high = np.minimum(self.below, self.above), np.maximum(self.below, self.above)
        key = low.astype(np.int64) * len(self.regions) + high
        return {(int(k) // len(self.regions), int(k) % len(self.regions)): triangles[key == k] for k in np.unique(key)}
