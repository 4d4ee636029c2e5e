"""What a geometry is: interfaces that know both sides, and the faces that emit and read."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .cast import cast
from .grid import Array, Grid, Indices
from .locate import Locator
from .regions import AIR


@dataclass(frozen=True)
class Face:
    """The face of an LED die or a photodiode element that looks at the nail.

    name : as in the scene's layout.
    region : index of the part's own region; the epoxy lies on the face's other side.
    quads : (k, 4, 3) float. Planar rectangles, corners counter-clockwise seen from the nail side. [mm]
    normal : (k, 3) float. Unit normals of the quads, into the epoxy and towards the nail.
    area_mm2 : Area of all quads. [mm^2]
    density : (k,) float. How densely photons start on each quad of what shines, to any scale; alike if not given.
    """

    name: str
    region: int
    quads: Array
    normal: Array
    area_mm2: float
    density: Array | float = 1.0

    @property
    def areas_mm2(self) -> Array:
        """Areas of the quads, (k,) float. [mm^2]"""
        diagonals = self.quads[:, 2] - self.quads[:, 0], self.quads[:, 3] - self.quads[:, 1]
        return np.asarray(np.linalg.norm(np.cross(*diagonals), axis=1) / 2)

    @property
    def center_mm(self) -> Array:
        """Middle of the face, weighted by area, (3,) float. [mm]"""
        return np.average(self.quads.mean(axis=1), axis=0, weights=self.areas_mm2)


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

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.grid)

    @property
    def bounds_mm(self) -> Array:
        """Lowest and highest corner of the whole, (2, 3) float. [mm]"""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def region_at(self, points: Array) -> Indices:
        """Region at each point, by arithmetic on the grid's cells, not by the triangles.

        points : (k, 3) float. [mm]

        Returns: (k,) int; a point on an interface gets either side.
        """
        points, nodes = np.asarray(points, float).reshape(-1, 3), self.grid.nodes.reshape(-1, 3)
        beyond = (points < nodes.min(axis=0)) | (points > nodes.max(axis=0))
        # Around the grid there is air, and its cells are not made for it.
        return np.full(len(points), AIR, np.int32) if beyond.any(axis=1).all() else self._locator.region_at(points)

    def section(self, y_mm: Array, z_mm: Array) -> Indices:
        """Region on the lengthwise section at x = 0, (y, z) int, from the triangles above and below each point.

        y_mm, z_mm : places along the axes, rising. [mm]
        """
        found = cast(self.vertices, self.triangles, np.column_stack([np.zeros_like(y_mm), y_mm]))
        below, above = self.below[found.triangle], self.above[found.triangle]
        # What the region's number grows by at each crossing, from the air below the finger on.
        step = np.where(found.forward, above - below, below - above)
        steps = np.zeros((len(y_mm), len(z_mm) + 1), np.int32)
        np.add.at(steps, (found.ray, np.searchsorted(z_mm, found.z)), step)
        return np.cumsum(steps, axis=1, dtype=np.int32)[:, :-1]

    def volumes_mm3(self) -> dict[str, float]:
        """Volume of each region but air, from its faces by the divergence theorem. [mm^3]"""
        # About the middle, because the sum of large opposite terms would cost digits.
        a, b, c = (self.vertices[self.triangles[:, i]] - self.vertices.mean(axis=0) for i in range(3))
        six = np.einsum("ij,ij->i", a, np.cross(b, c))
        count = len(self.regions)
        signed = np.bincount(self.below, six, count) - np.bincount(self.above, six, count)
        return {name: float(v) / 6 for name, v in zip(self.regions[1:], signed[1:], strict=True)}

    def interfaces(self) -> dict[tuple[int, int], Indices]:
        """Triangles (k, 3) of each interface by its regions (below, above), the lower index below.

        Triangles are turned round where that is needed, so that each pair of regions comes once.
        """
        swap = self.below > self.above
        triangles = np.where(swap[:, None], self.triangles[:, ::-1], self.triangles)
        low, high = np.minimum(self.below, self.above), np.maximum(self.below, self.above)
        key = low.astype(np.int64) * len(self.regions) + high
        return {(int(k) // len(self.regions), int(k) % len(self.regions)): triangles[key == k] for k in np.unique(key)}
