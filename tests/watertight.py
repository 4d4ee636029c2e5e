"""A check that a geometry is watertight, by random rays through it and by volumes."""

from dataclasses import dataclass

import numpy as np

from nailoptics.geometry import Geometry
from nailoptics.geometry.cast import cast
from nailoptics.geometry.regions import AIR

ALLOWED_PER_CROSSING = 1e-6
ALLOWED_VOLUME = 1e-6
SHORT_MM = 1e-7  # crossings that lie closer have no order
RAYS = 20_000  # at once, to bound the memory


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
        ray, z, triangle, forward = cast(vertices, geometry.triangles, low + random.random((rays, 2)) * (high - low))
        below, above = geometry.below[triangle], geometry.above[triangle]
        before, after = np.where(forward, below, above), np.where(forward, above, below)
        first = np.r_[True, ray[1:] != ray[:-1]]
        # Two crossings at the same place to the last digits have no order that could be wrong.
        ordered = first | np.r_[True, np.diff(z) > SHORT_MM]
        medium = np.where(first, AIR, np.roll(after, 1))
        disagreements += int(((medium != before) & ordered).sum()) + int((after[np.r_[first[1:], True]] != AIR).sum())
        checked += len(ray)
    return WatertightReport(checked, disagreements, _volume_error(geometry))


def _volume_error(geometry: Geometry) -> float:
    numbers, labels = geometry.grid.tetrahedra()
    corners = geometry.grid.nodes.reshape(-1, 3)[numbers]
    cells = np.bincount(labels, np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6, len(geometry.regions))[1:]
    return float(np.abs(list(volumes_mm3(geometry).values()) - cells).max() / cells.sum())


def volumes_mm3(geometry: Geometry) -> dict[str, float]:
    """Volume of each region but air, from its faces by the divergence theorem. [mm^3]"""
    # About the middle, because the sum of large opposite terms would cost digits.
    a, b, c = (geometry.vertices[geometry.triangles[:, i]] - geometry.vertices.mean(axis=0) for i in range(3))
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    count = len(geometry.regions)
    signed = np.bincount(geometry.below, six, count) - np.bincount(geometry.above, six, count)
    return {name: float(v) / 6 for name, v in zip(geometry.regions[1:], signed[1:], strict=True)}
