"""How far the nearest interface is: a grid of safe distances for light that wants to skip the search for a crossing."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cast import Array
from .model import Geometry
from .regions import AIR

# Edge of the cells. Those of 0.1 mm take 1 s more of processor time to make, and a walk among them takes 6 % less,
# which pays after two million photons.
SPACING_MM = 0.15
# Larger distances are capped: light seldom goes further before it scatters. [mm]
CAP_MM = 0.35
COVERED = 0.4  # covering radius of the samples, in spacings
SLACK = 0.02  # relative; lets the search for the nearest sample stop early
CHUNK = 500_000
# In the nail plate light scatters every 0.03 mm, so that cells help little. Those near its faces also have a plane,
# which gives distances up to this one: a ray of three is left, and a walk takes two thirds of the time. [mm]
PLANE_REACH_MM = 0.06
# Coarser cells have none: few of them are thin enough to help, and planes take as long to make as all the rest.
PLANES_BELOW_MM = 0.3
# Interfaces near such a cell are taken in parts whose edges are no longer.
PLANE_PART_MM = 0.12
# So many cells at once: what is between stays small.
PLANES_AT_ONCE = 1024
# Planes are whole numbers of these: of a normal, to 1, and of lengths.
NORMAL_STEPS = 127
PLANE_STEP_MM = 0.003


@dataclass(frozen=True)
class DistanceGrid:
    """Lower bounds on the distance to the nearest interface, cell by cell.

    distance_mm : (nx, ny, nz) float32. From the cell's centre; never more than the true distance, at most CAP_MM; 0 in
        the air. [mm]
    slack_steps : (nx, ny, nz) uint8. How far interfaces near the cell are from its plane at most, in PLANE_STEP_MM;
        0 in cells without a plane.
    offset_steps : (nx, ny, nz) int8. Height of the cell's centre over its plane, likewise.
    normal_steps : (nx, ny, nz, 2) int8. Components along x and y of the plane's upward normal, in 1 / NORMAL_STEPS.
    origin_mm : (3,) float. Lowest corner of the first cell; its centre lies half a spacing further. [mm]
    spacing_mm : Edge of the cubic cells. [mm]

    From a point p in a cell of centre c, the distance is at least distance_mm - |p - c|. In a cell with a plane it is
    also at least p's distance to the plane less the slack, or PLANE_REACH_MM if that is less.
    """

    distance_mm: NDArray[np.float32]
    slack_steps: NDArray[np.uint8]
    offset_steps: NDArray[np.int8]
    normal_steps: NDArray[np.int8]
    origin_mm: Array
    spacing_mm: float

    def centers(self, cells: NDArray[np.int64]) -> Array:
        """Centres (k, 3) of cells (k, 3). [mm]"""
        return self.origin_mm + self.spacing_mm * (np.asarray(cells) + 0.5)


def distance_grid(
    geometry: Geometry, *, spacing_mm: float = SPACING_MM, bounds_mm: Array | None = None
) -> DistanceGrid:
    """Lower bounds on the distance to the nearest interface.

    bounds_mm : (2, 3) float. Lowest and highest corner; the whole geometry if not given. [mm]

    The bound is short by at most 2 % and 0.3 spacings, or 0.4 spacings where an interface is closer than half of one.

    Triangles are sampled on a lattice, and the nearest sample is looked up. If q is the place on an interface nearest
    to a point, then a sample of the same triangle (or edge, or vertex) lies within the lattice's covering radius r of
    q, at a right angle to the way to q; so distance^2 >= (distance to the nearest sample)^2 - r^2.
    """
    low, high = geometry.bounds_mm if bounds_mm is None else np.asarray(bounds_mm, float)
    shape = np.maximum(np.ceil((high - low) / spacing_mm - 1e-9).astype(int), 1)
    result = np.zeros(shape, np.float32)
    slack, offset, normal = np.zeros(shape, np.uint8), np.zeros(shape, np.int8), np.zeros((*shape, 2), np.int8)
    grid = DistanceGrid(result, slack, offset, normal, low, spacing_mm)
    x, y, z = (low[k] + spacing_mm * (np.arange(shape[k]) + 0.5) for k in range(3))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    cells = np.argwhere(geometry.columns(places, z).reshape(shape) != AIR)
    corners = geometry.vertices[geometry.triangles]
    plate = [region for region, name in enumerate(geometry.regions) if name == "plate"]
    of_plate = np.isin(geometry.below, plate) | np.isin(geometry.above, plate)
    # What lies farther from the cells than the cap is nearest to none of them.
    reach = 2 * CAP_MM + spacing_mm
    close = ((corners.max(axis=1) > low - reach) & (corners.min(axis=1) < high + reach)).all(axis=1)
    corners, of_plate = corners[close], of_plate[close]
    radius = COVERED * spacing_mm
    samples = _tree(_samples(corners, radius))
    for start in range(0, len(cells), CHUNK):
        chunk = cells[start : start + CHUNK]
        result[tuple(chunk.T)] = _bound(samples, grid.centers(chunk), radius) * (1 - 1e-6)
    if of_plate.any() and spacing_mm < PLANES_BELOW_MM:
        _add_planes(grid, cells, corners, of_plate)
    return grid


def _add_planes(grid: DistanceGrid, cells: NDArray[np.int64], corners: Array, of_plate: NDArray[np.bool_]) -> None:
    """Find planes for those of the cells (k, 3) that lie near the nail plate's faces, some of all triangles (m, 3, 3).

    A cell's plane is parallel to the face nearest to its centre, halfway between the lowest and the highest place on
    any interface within reach of the cell. Each such place lies in a part of a triangle whose corners are within the
    length of its longest edge, one of them no lower and one no higher.
    """
    reach = PLANE_REACH_MM + math.sqrt(0.75) * grid.spacing_mm
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.ceil(longest / PLANE_PART_MM).astype(int)
    faces, face = _lattice(corners[of_plate], pieces[of_plate])
    upward = np.cross(*np.diff(corners[of_plate], axis=1).transpose(1, 0, 2))
    upward *= np.copysign(1 / np.linalg.norm(upward, axis=1), upward[:, 2])[:, None]
    cells = cells[grid.distance_mm[tuple(cells.T)] < reach]
    away, nearest = _tree(faces).query(grid.centers(cells), distance_upper_bound=reach, workers=-1)
    cells, nearest = cells[np.isfinite(away)], nearest[np.isfinite(away)]
    centers = grid.centers(cells)
    # Rounded towards 0, so that their length is less than 1.
    plan = np.trunc(upward[face[nearest], :2] * NORMAL_STEPS).astype(np.int8)
    x, y = plan.T / NORMAL_STEPS
    normals = np.column_stack([x, y, np.sqrt(1 - x**2 - y**2)])
    within = reach + PLANE_PART_MM
    away, _ = _tree(centers).query(corners.mean(axis=1), distance_upper_bound=within + longest.max(), workers=-1)
    close = away <= within + longest
    parts = _tree(_distinct(_lattice(corners[close], pieces[close])[0]))
    lowest, highest = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
    for start in range(0, len(cells), PLANES_AT_ONCE):
        chunk = slice(start, start + PLANES_AT_ONCE)
        pairs = _tree(centers[chunk]).sparse_distance_matrix(parts, within, output_type="ndarray")
        cell = pairs["i"] + start
        height = np.einsum("ij,ij->i", parts.data[pairs["j"]] - centers[cell], normals[cell]) / PLANE_STEP_MM
        np.minimum.at(lowest, cell, height)
        np.maximum.at(highest, cell, height)
    offset = np.rint(-(lowest + highest) / 2)
    # A little more, for points that were taken for one and what rounding adds where it is read.
    slack = np.ceil(np.maximum(highest + offset, -lowest - offset) + 0.1)
    # Only where a plane gives more than the centre's distance, from 27 places of the cell.
    places = grid.spacing_mm / 3 * (np.indices((3, 3, 3)).reshape(3, -1) - 1)
    plane = np.abs(normals @ places + PLANE_STEP_MM * offset[:, None]) - PLANE_STEP_MM * slack[:, None]
    center = grid.distance_mm[tuple(cells.T)][:, None] - np.linalg.norm(places, axis=0)
    better = plane.clip(0).sum(axis=1) > center.clip(0).sum(axis=1)
    used = better & (np.abs(offset) < 128) & (slack < 256)
    at = tuple(cells[used].T)
    grid.slack_steps[at], grid.offset_steps[at], grid.normal_steps[at] = slack[used], offset[used], plan[used]


def _tree(points: Array) -> Any:
    """A tree of points (k, 3). One whose nodes are not shrunk to their points answers ten times faster here."""
    from scipy.spatial import cKDTree

    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def _distinct(points: Array) -> Array:
    """Points (k, 3), of those that agree to 0.1 um one; all within 200 mm."""
    x, y, z = np.rint((points - points.min(axis=0)) * 1e4).astype(np.int64).T
    return points[np.unique(x << 42 | y << 21 | z, return_index=True)[1]]


def _bound(samples: Any, points: Array, radius: float) -> Array:
    """Lower bounds (k,), at most the cap, at points (k, 3) from samples that cover the interfaces within a radius."""
    reach = (1 + SLACK) * float(np.hypot(CAP_MM, radius))
    nearest, _ = samples.query(points, eps=SLACK, distance_upper_bound=reach, workers=-1)
    bound = np.sqrt(np.maximum((np.minimum(nearest, reach) / (1 + SLACK)) ** 2 - radius**2, 0))
    return np.asarray(np.minimum(bound, CAP_MM))


def _samples(corners: Array, radius: float) -> Array:
    """Points (k, 3) on triangles (m, 3, 3), so that no place on them is farther than a radius from one."""
    a, b, c = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1).T
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    # The place farthest from all three corners: the middle of the circle around them, or a place on the longest edge.
    obtuse = c**2 >= a**2 + b**2
    covering = np.where(obtuse, b**2 * c / (b**2 + c**2 - a**2), a * b * c / (4 * area))
    covering = np.where(obtuse, np.maximum(covering, a**2 * c / (a**2 + c**2 - b**2)), covering)
    return _lattice(corners, np.ceil(covering / radius).astype(int))[0]


def _lattice(corners: Array, pieces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Corners (k, 3) of the equal parts of triangles (m, 3, 3) whose edges are cut in so many pieces, (m,), and the
    triangle of each, (k,)."""
    points, triangles = [], []
    for n in np.unique(pieces):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
        inside = i + j <= n
        weights = np.stack([i[inside], j[inside], n - i[inside] - j[inside]], axis=1) / n
        points.append((weights @ corners[pieces == n]).reshape(-1, 3))
        triangles.append(np.repeat(np.flatnonzero(pieces == n), len(weights)))
    return np.concatenate(points), np.concatenate(triangles)
