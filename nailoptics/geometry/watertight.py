"""Proof that a geometry is watertight: rays through the whole, media met against media by arithmetic, and volumes."""

from dataclasses import dataclass

import numpy as np

from .cast import Array, Crossings, cast
from .model import Geometry
from .regions import AIR

ALLOWED_PER_CROSSING = 1e-6
ALLOWED_VOLUME = 1e-6
SHORT_MM = 1e-7  # crossings that lie closer have no order
RAYS = 20_000  # at once, to bound the memory


@dataclass(frozen=True)
class WatertightReport:
    """How far a geometry is watertight.

    crossings : Crossings of rays and interfaces that were checked.
    disagreements : Stretches between crossings whose medium by the interfaces is not the one by arithmetic, and
        crossings whose interface does not border on the medium that the ray was in.
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
    """Fire random rays through the whole and compare the media they meet with point-in-region answers.

    crossings : How many crossings to check, at least.
    """
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(seed)
    seen = disagreements = 0
    middle = geometry.bounds_mm.mean(axis=0)
    while seen < crossings:
        rotation = Rotation.random(None, random).as_matrix()
        vertices = (geometry.vertices - middle) @ rotation.T
        low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
        # The average ray crosses about seven interfaces.
        rays = int(min(RAYS, max(100, (crossings - seen) / 6)))
        start = low + random.random((rays, 2)) * (high - low)
        found = cast(vertices, geometry.triangles, start)
        disagreements += _disagreements(geometry, found, start, rotation, middle)
        seen += len(found.ray)
    return WatertightReport(seen, disagreements, _volume_error(geometry))


def _disagreements(geometry: Geometry, found: Crossings, start: Array, rotation: Array, middle: Array) -> int:
    below, above = geometry.below[found.triangle], geometry.above[found.triangle]
    before, after = np.where(found.forward, below, above), np.where(found.forward, above, below)
    first = np.r_[True, found.ray[1:] != found.ray[:-1]]
    last = np.r_[first[1:], True]
    medium = np.where(first, AIR, np.roll(after, 1))
    length = np.where(last, np.inf, np.roll(found.z, -1) - found.z)
    # Two crossings at the same place to the last digits have no order that could be wrong.
    wrong = int(((medium != before) & (np.roll(length, 1) > SHORT_MM)).sum()) + int((after[last] != AIR).sum())
    between = np.nonzero(~last & (length > SHORT_MM))[0]
    place = np.column_stack([start[found.ray[between]], found.z[between] + length[between] / 2])
    return wrong + int((geometry.region_at(place @ rotation + middle) != after[between]).sum())


def _volume_error(geometry: Geometry) -> float:
    corners, labels, _ = geometry.grid.tetrahedra()
    cells = np.bincount(labels, np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6, len(geometry.regions))[1:]
    return float(np.abs(list(geometry.volumes_mm3().values()) - cells).max() / cells.sum())
