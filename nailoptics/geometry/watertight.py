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
    volume_error : Difference between the sum of the regions' volumes and the volume within the outermost faces, and
        of each region's volume by its faces and by its cells; the largest, relative to the whole.
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
    random = np.random.default_rng(seed)
    seen = disagreements = 0
    middle = geometry.bounds_mm.mean(axis=0)
    while seen < crossings:
        rotation = _random_rotation(random)
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
    volumes = np.array(list(geometry.volumes_mm3().values()))
    a, b, c = (geometry.vertices[geometry.triangles[:, i]] for i in range(3))
    six = np.einsum("ij,ij->i", a, np.cross(b, c))
    whole = (six[geometry.above == AIR].sum() - six[geometry.below == AIR].sum()) / 6
    corners, labels, _ = geometry.grid.tetrahedra()
    cells = np.bincount(labels, np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6, len(geometry.regions))[1:]
    return float(max(abs(volumes.sum() - whole), np.abs(volumes - cells).max()) / whole)


def _random_rotation(random: np.random.Generator) -> Array:
    """A rotation matrix, uniform over all rotations."""
    q, r = np.linalg.qr(random.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q
