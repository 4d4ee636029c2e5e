"""Parallel rays through a geometry: every crossing of every ray, exact at edges."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .boxes import Boxes

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

PAIRS = 2_000_000


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
    caster = _Caster(vertices, triangles, rays)
    found = [caster.cross(part) for part in caster.parts()]
    ray, z, triangle, forward = (np.concatenate([f[i] for f in found]) for i in range(4))
    order = np.lexsort((z, ray))
    return Crossings(ray[order], z[order], triangle[order], forward[order])


class _Caster:
    """Triangles by the boxes of an even plane grid that they may reach into."""

    def __init__(self, vertices: Array, triangles: Indices, rays: Array) -> None:
        self.vertices, self.triangles, self.rays = vertices, triangles, rays
        flat = vertices[triangles][:, :, :2]
        self.low = flat.min(axis=(0, 1)) - 1e-9
        high = flat.max(axis=(0, 1)) + 1e-9
        self.bins = int(np.clip(np.sqrt(len(triangles)), 1, 512))
        self.per_mm = self.bins / (high - self.low)
        self.boxes = Boxes.sort(self._bin(flat.min(axis=1)), self._bin(flat.max(axis=1)), bins=self.bins)

    def _bin(self, points: Array) -> NDArray[np.int64]:
        # Rounding is monotone, so a ray within a triangle's bounds falls within its bins.
        return np.floor((points - self.low) * self.per_mm).astype(np.int64)

    def parts(self) -> list[NDArray[np.int64]]:
        """Indices of rays over the mesh, in parts that keep the work arrays small."""
        bins = self._bin(self.rays)
        over = np.nonzero(((bins >= 0) & (bins < self.bins)).all(axis=1))[0]
        work = np.cumsum(self.boxes.count(self.boxes.at(bins[over])))
        cuts = np.searchsorted(work, np.arange(PAIRS, work[-1] if len(work) else 0, PAIRS))
        return np.split(over, cuts)

    def cross(self, rays: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Indices, NDArray[np.bool_]]:
        """Ray, z, triangle and direction of each crossing of the given rays."""
        box = self.boxes.at(self._bin(self.rays[rays]))
        triangle, ray = self.boxes.items(box), np.repeat(rays, self.boxes.count(box))
        corner = self.triangles[triangle]
        x, y = self.rays[ray].T
        area, left = np.empty((3, len(ray))), np.empty((3, len(ray)), bool)
        for i in range(3):
            a, b = corner[:, i], corner[:, (i + 1) % 3]
            turned = a > b
            low, high = np.where(turned, b, a), np.where(turned, a, b)
            (ax, ay), (bx, by) = self.vertices[low, :2].T, self.vertices[high, :2].T
            # Always from the lower to the higher vertex: both triangles at an edge get the same number.
            signed = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            # On the edge itself, the ray counts as moved by a little along x, and by much less along y.
            tie = (by < ay) | ((by == ay) & (bx > ax))
            left[i] = ((signed > 0) | ((signed == 0) & tie)) != turned
            area[i] = np.where(turned, -signed, signed)
        forward, back = np.all(left, axis=0), ~np.any(left, axis=0)
        hit = np.nonzero(forward | back)[0]
        weights = area[:, hit] / area[:, hit].sum(axis=0)
        z = self.vertices[:, 2][corner[hit]]
        # The area over edge i belongs to the corner opposite to it.
        place = weights[0] * z[:, 2] + weights[1] * z[:, 0] + weights[2] * z[:, 1]
        return ray[hit], place, triangle[hit], forward[hit]
