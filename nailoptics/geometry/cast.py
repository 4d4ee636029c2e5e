"""Parallel rays through a geometry: every crossing of every ray, exact at edges."""

import numpy as np
from numpy.typing import NDArray

from ..checks import Array

Integers = NDArray[np.int64]
Indices = NDArray[np.int32]

RAYS_AT_ONCE = 20_000  # keep the work arrays small


def cast(vertices: Array, triangles: Indices, rays: Array) -> tuple[Integers, Array, Indices, NDArray[np.bool_]]:
    """Cross a mesh with all rays (r, 2) at x, y along +z.

    Which side of an edge a ray passes is decided once for the edge, whichever triangle asks, so that a ray never slips
    between two triangles that share one, nor meets both.

    Returns: of each crossing, sorted by ray and then by z, the index of the ray, z [mm], the index of the triangle and
    whether the ray goes along its normal, (n,) each.
    """
    a, b, c = (vertices[triangles[:, i], :2] for i in range(3))
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    low, high = least.min(axis=0) - 1e-9, most.max(axis=0) + 1e-9
    bins = int(np.clip(2 * np.sqrt(len(triangles)), 1, 1024))
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
    return ray[order], z[order], triangle[order], forward[order]


def _pairs(first: Integers, last: Integers, at: Integers, bins: int) -> tuple[Indices, Integers]:
    """All pairs of a triangle and of a ray in one of its bins; triangles rise. first, last : (n, 2) int. The bins along
    x and y that each triangle reaches into. at : (k, 2) int. The bin of each ray."""
    box = at[:, 0] * bins + at[:, 1]
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
    return np.repeat(triangle, count), np.argsort(box, kind="stable")[place]


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
