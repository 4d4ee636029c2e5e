"""A geometry: interfaces that know both sides, faces that emit and read, and the proof that it is watertight."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .cast import Crossings, cast
from .grid import Array, Grid, Indices
from .regions import AIR

ALLOWED_PER_CROSSING = 1e-6
ALLOWED_VOLUME = 1e-6
SHORT_MM = 1e-7  # crossings that lie closer have no order
RAYS = 20_000  # at once, to bound the memory


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
        """Region at each point, from the triangles below it.

        points : (k, 3) float. [mm]

        Returns: (k,) int; a point on an interface gets either side.
        """
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


@dataclass(frozen=True)
class WatertightReport:
    """How far a geometry is watertight.

    crossings : Crossings of rays and interfaces that were checked.
    disagreements : Crossings whose interface does not border on the medium that the ray was in, and rays that do not
        end in air.
    volume_error : The largest difference of a region's volume by its faces and by its cells, relative to the whole.
    """

    crossings: int
    disagreements: int
    volume_error: float

    @property
    def passed(self) -> bool:
        """At most 1 disagreement per 1e6 crossings, and volumes that add up within 1e-6."""
        few = self.disagreements <= max(1.0, ALLOWED_PER_CROSSING * self.crossings)
        return few and self.volume_error < ALLOWED_VOLUME


def check_watertight(geometry: Geometry, *, crossings: int = 1_000_000, seed: int = 0) -> WatertightReport:
    """Fire random rays through the whole and follow the media that they meet.

    crossings : How many crossings to check, at least.
    """
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(seed)
    checked = disagreements = 0
    while checked < crossings:
        vertices = (geometry.vertices - geometry.bounds_mm.mean(axis=0)) @ Rotation.random(None, random).as_matrix().T
        low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
        # The average ray crosses about seven interfaces.
        rays = int(min(RAYS, max(100, (crossings - checked) / 6)))
        met = cast(vertices, geometry.triangles, low + random.random((rays, 2)) * (high - low))
        below, above = geometry.below[met.triangle], geometry.above[met.triangle]
        before, after = np.where(met.forward, below, above), np.where(met.forward, above, below)
        first = np.r_[True, met.ray[1:] != met.ray[:-1]]
        # Two crossings at the same place to the last digits have no order that could be wrong.
        ordered = first | np.r_[True, np.diff(met.z) > SHORT_MM]
        medium = np.where(first, AIR, np.roll(after, 1))
        disagreements += int(((medium != before) & ordered).sum()) + int((after[np.r_[first[1:], True]] != AIR).sum())
        checked += len(met.ray)
    return WatertightReport(checked, disagreements, _volume_error(geometry))


def _volume_error(geometry: Geometry) -> float:
    corners, labels = geometry.grid.tetrahedra()
    cells = np.bincount(labels, np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6, len(geometry.regions))[1:]
    return float(np.abs(list(geometry.volumes_mm3().values()) - cells).max() / cells.sum())
