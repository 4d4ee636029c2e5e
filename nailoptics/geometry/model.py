"""A geometry: interfaces that know both sides, faces that emit and read, and the parallel rays that cross it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .grid import Array, Grid, Indices

Integers = NDArray[np.int64]

RAYS_AT_ONCE = 20_000  # keep the work arrays small


@dataclass(frozen=True)
class Crossings:
    """Where rays along +z cross triangles, sorted by ray and then by z.

    ray : (n,) int. Index of the ray.
    z : (n,) float. Place of the crossing. [mm]
    triangle : (n,) int. Index of the triangle.
    forward : (n,) bool. Whether the ray goes along the triangle's normal.
    """

    ray: NDArray[np.int64]
    z: Array
    triangle: Indices
    forward: NDArray[np.bool_]


def cast(vertices: Array, triangles: Indices, rays: Array) -> Crossings:
    """Cross a mesh with all rays (r, 2) at x, y along +z.

    Which side of an edge a ray passes is decided once for the edge, whichever triangle asks, so that a ray never slips
    between two triangles that share one, nor meets both.
    """
    a, b, c = (vertices[triangles[:, i], :2] for i in range(3))
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    low, high = least.min(axis=0) - 1e-9, most.max(axis=0) + 1e-9
    bins = int(np.clip(np.sqrt(len(triangles)), 1, 512))
    per_mm = bins / (high - low)

    def bin_of(points: Array) -> Integers:
        # Rounding is monotone, so a ray within a triangle's bounds falls within its bins.
        return np.floor((points - low) * per_mm).astype(np.int64)

    at = bin_of(rays)
    over = np.nonzero(((at >= 0) & (at < bins)).all(axis=1))[0]
    crossings = []
    first, last = bin_of(least), bin_of(most)
    for start in range(0, max(len(over), 1), RAYS_AT_ONCE):
        some = over[start : start + RAYS_AT_ONCE]
        triangle, place = _pairs(first, last, at[some], bins)
        triangle, ray, area, forward = _inside(vertices, triangles, triangle, rays, some[place])
        # The area over edge i belongs to the corner opposite to it.
        x, y, z = area / area.sum(axis=0)
        height = vertices[:, 2][triangles[triangle]]
        crossings.append((ray, x * height[:, 2] + y * height[:, 0] + z * height[:, 1], triangle, forward))
    ray, z, triangle, forward = (np.concatenate([part[i] for part in crossings]) for i in range(4))
    order = np.lexsort((z, ray))
    return Crossings(ray[order], z[order], triangle[order], forward[order])


def _pairs(first: Integers, last: Integers, at: Integers, bins: int) -> tuple[Indices, Integers]:
    """All pairs of a triangle and of a ray in one of its bins; triangles rise. first, last : (n, 2) int. The bins along
    x and y that each triangle reaches into. at : (k, 2) int. The bin of each ray."""
    box = at[:, 0] * bins + at[:, 1]
    order = np.argsort(box, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(box, minlength=bins**2))])
    # In each column of bins that a triangle reaches into, its bins are one run.
    columns = last[:, 0] - first[:, 0] + 1
    triangle = np.repeat(np.arange(len(columns), dtype=np.int32), columns)
    rank = np.arange(len(triangle)) - np.repeat(np.cumsum(columns) - columns, columns)
    column = (first[triangle, 0] + rank) * bins
    begin, end = start[column + first[triangle, 1]], start[column + last[triangle, 1] + 1]
    some = np.nonzero(end > begin)[0]
    triangle, begin, count = triangle[some], begin[some], (end - begin)[some]
    place = np.repeat(begin - (np.cumsum(count) - count), count) + np.arange(count.sum())
    return np.repeat(triangle, count), order[place]


def _inside(
    vertices: Array, triangles: Indices, triangle: Indices, rays: Array, ray: Integers
) -> tuple[Indices, Integers, Array, NDArray[np.bool_]]:
    """Of pairs of triangles and rays those that cross, with twice the areas (3, k) over the edges, and whether forward.

    Edges go from the lower to the higher vertex, so that both triangles at one get the same number.
    """
    sides: NDArray[np.bool_] | None = None
    areas: list[Array] = []
    for i in range(3):
        begin, end = triangles[triangle, i], triangles[triangle, (i + 1) % 3]
        turned = begin > end
        start, along = vertices[np.minimum(begin, end), :2].T, vertices[np.maximum(begin, end), :2].T
        along -= start
        away = rays[ray].T - start
        signed = along[0] * away[1] - along[1] * away[0]
        # A ray on the edge itself counts as one moved by a little along x, and by much less along y.
        on_left = (along[1] < 0) | ((along[1] == 0) & (along[0] > 0))
        left = ((signed > 0) | ((signed == 0) & on_left)) != turned
        same = np.arange(len(ray)) if sides is None else np.nonzero(left == sides)[0]
        sides, triangle, ray = left[same], triangle[same], ray[same]
        areas = [area[same] for area in (*areas, np.where(turned, -signed, signed))]
    assert sides is not None
    return triangle, ray, np.stack(areas), sides


@dataclass(frozen=True)
class Face:
    """The face of an LED die or a photodiode element that looks at the nail.

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

    def region_at(self, points: Array) -> Indices:
        """Region at each point (k, 3) [mm], from the triangles below it, (k,) int; on an interface either side."""
        points = np.asarray(points, float).reshape(-1, 3)
        crossings, step = self._crossings(points[:, :2])
        below = crossings.z < points[crossings.ray, 2]
        return np.bincount(crossings.ray[below], step[below], len(points)).astype(np.int32)

    def columns(self, places_mm: Array, z_mm: Array) -> NDArray[np.int16]:
        """Region at places (r, 2) in x and y and at heights (k,), which rise, (r, k) int."""
        crossings, step = self._crossings(places_mm)
        steps = np.zeros((len(places_mm), len(z_mm) + 1), np.int16)
        np.add.at(steps, (crossings.ray, np.searchsorted(z_mm, crossings.z)), step)
        return np.cumsum(steps, axis=1, dtype=np.int16)[:, :-1]

    def section(self, y_mm: Array, z_mm: Array) -> NDArray[np.int16]:
        """Region on the lengthwise section at x = 0, (y, z) int, at places along the axes, which rise. [mm]"""
        return self.columns(np.column_stack([np.zeros_like(y_mm), y_mm]), z_mm)

    def _crossings(self, places_mm: Array) -> tuple[Crossings, Indices]:
        """Crossings of rays upwards, and by how much each changes the number of the region, from air on."""
        crossings = cast(self.vertices, self.triangles, places_mm)
        below, above = self.below[crossings.triangle], self.above[crossings.triangle]
        return crossings, np.where(crossings.forward, above - below, below - above)

    def interfaces(self) -> dict[tuple[int, int], Indices]:
        """Triangles (k, 3) of each interface by its regions (below, above), the lower index below, turned round where
        that is needed: each pair of regions comes once."""
        swap = self.below > self.above
        triangles = np.where(swap[:, None], self.triangles[:, ::-1], self.triangles)
        low, high = np.minimum(self.below, self.above), np.maximum(self.below, self.above)
        key = low.astype(np.int64) * len(self.regions) + high
        return {(int(k) // len(self.regions), int(k) % len(self.regions)): triangles[key == k] for k in np.unique(key)}
