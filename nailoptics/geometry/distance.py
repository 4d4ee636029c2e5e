"""How far the nearest interface is: a grid of safe distances for light that wants to skip the search for a crossing."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cast import Array, Indices
from .model import Geometry
from .regions import AIR

# Edge of the cells: those of 0.2 mm take twice as long to make, and a walk among them is no more than 1 % faster; among
# those of 0.5 mm it is a fifth slower.
SPACING_MM = 0.3
# Larger distances are capped: light seldom goes further before it scatters. [mm]
CAP_MM = 0.35
COVERED = 0.4  # covering radius of the samples, in spacings
SLACK = 0.02  # relative; lets the search for the nearest sample stop early
CHUNK = 500_000
# A triangle is part of a cylinder around the nail's axis where its distance to the axis varies by no more. [mm]
SHELL_MM = 0.005
# The shells with most of them are known, if they have so many square millimetres; all others are like any interface.
SHELLS, LEAST_SHELL_MM2 = 8, 2.0
# What single precision may add to heights. [mm]
ROUNDING_MM = 1e-5


@dataclass(frozen=True)
class DistanceGrid:
    """Lower bounds on the distance to the nearest interface, cell by cell.

    distance_mm : (nx, ny, nz) float32. From the cell's centre; never more than the true distance, at most CAP_MM; 0 in
        the air. [mm]
    off_shell_mm : (nx, ny, nz) float32. Likewise, to the nearest interface that is no part of a shell. [mm]
    shells_mm : (s, 2) float. Between which heights over the nail plate's outer face each shell lies; all faces of
        plate, bed and board are cylinders around one axis. [mm]
    origin_mm : (3,) float. Lowest corner of the first cell; its centre lies half a spacing further. [mm]
    spacing_mm : Edge of the cubic cells. [mm]

    From a point p in a cell of centre c, the distance is at least distance_mm - |p - c|.
    """

    distance_mm: NDArray[np.float32]
    off_shell_mm: NDArray[np.float32]
    shells_mm: Array
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
    from scipy.spatial import cKDTree

    low, high = geometry.bounds_mm if bounds_mm is None else np.asarray(bounds_mm, float)
    shape = np.maximum(np.ceil((high - low) / spacing_mm - 1e-9).astype(int), 1)
    cells = np.argwhere(geometry.cells(low, spacing_mm, shape) != AIR)
    corners = geometry.vertices[geometry.triangles]
    in_shell, shells_mm = _shells(corners + [0, 0, geometry.nail_radius_mm])
    # What lies farther from the cells than the cap is nearest to none of them.
    reach = 2 * CAP_MM + spacing_mm
    close = ((corners.max(axis=1) > low - reach) & (corners.min(axis=1) < high + reach)).all(axis=1)
    radius = COVERED * spacing_mm
    distance, off_shell = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    grid = DistanceGrid(distance, off_shell, shells_mm - geometry.nail_radius_mm, low, spacing_mm)
    distance[tuple(cells.T)] = off_shell[tuple(cells.T)] = CAP_MM
    for bound_mm, chosen in ((distance, close), (off_shell, close & ~in_shell)):
        # A tree whose nodes are not shrunk to their points answers ten times faster here.
        points = _samples(geometry.vertices, geometry.triangles[chosen], radius) if chosen.any() else ()
        samples = cKDTree(points, leafsize=32, balanced_tree=False, compact_nodes=False) if len(points) else None
        for start in range(0, len(cells) if samples else 0, CHUNK):
            chunk = cells[start : start + CHUNK]
            bound_mm[tuple(chunk.T)] = _bound(samples, grid.centers(chunk), radius) * (1 - 1e-6)
        # Where no interface is near, no other one is.
        cells = cells[bound_mm[tuple(cells.T)] < CAP_MM * (1 - 1e-5)]
    return grid


def _shells(corners: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which of some triangles (m, 3, 3) are parts of cylinders around the y axis, (m,), and of each cylinder that has
    enough of them the least and the largest distance of a place on it to the axis, (s, 2). [mm]"""
    flat, after = corners[..., ::2], np.roll(corners[..., ::2], -1, axis=1)
    along = after - flat
    part = -(flat * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    nearest = np.linalg.norm(flat + np.clip(part, 0, 1)[..., None] * along, axis=-1).min(1)
    farthest = np.linalg.norm(flat, axis=-1).max(1)
    shell, thin = np.rint(farthest / SHELL_MM).astype(int), farthest - nearest < SHELL_MM
    area_of = np.bincount(shell[thin], _areas(corners[thin]))
    known = [one for one in np.argsort(-area_of, kind="stable")[:SHELLS] if area_of[one] >= LEAST_SHELL_MM2]
    inside = [thin & (shell == one) for one in known]
    between = [[nearest[one].min() - ROUNDING_MM, farthest[one].max() + ROUNDING_MM] for one in inside]
    return thin & np.isin(shell, known), np.array(between).reshape(-1, 2)


def _bound(samples: Any, points: Array, radius: float) -> Array:
    """Lower bounds (k,), at most the cap, at points (k, 3) from samples that cover the interfaces within a radius."""
    reach = (1 + SLACK) * float(np.hypot(CAP_MM, radius))
    nearest, _ = samples.query(points, eps=SLACK, distance_upper_bound=reach, workers=-1)
    bound = np.sqrt(np.maximum((np.minimum(nearest, reach) / (1 + SLACK)) ** 2 - radius**2, 0))
    return np.asarray(np.minimum(bound, CAP_MM))


def _samples(vertices: Array, triangles: Indices, radius: float) -> Array:
    """Points (k, 3) on triangles (m, 3), so that no place on them is farther than a radius from one; vertices once."""
    corners, used = vertices[triangles], np.zeros(len(vertices), bool)
    used[triangles] = True
    a, b, c = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1).T
    # The place farthest from all three corners: the middle of the circle around them, or a place on the longest edge.
    obtuse = c**2 >= a**2 + b**2
    covering = np.where(obtuse, b**2 * c / (b**2 + c**2 - a**2), a * b * c / (4 * _areas(corners)))
    covering = np.where(obtuse, np.maximum(covering, a**2 * c / (a**2 + c**2 - b**2)), covering)
    return np.concatenate([vertices[used], _lattice(corners, np.ceil(covering / radius).astype(int))])


def _lattice(corners: Array, pieces: NDArray[np.int64]) -> Array:
    """Corners (k, 3) of the equal parts of triangles (m, 3, 3) whose edges are cut in so many pieces, (m,), but for
    the corners of the triangles."""
    points = [np.empty((0, 3))]
    for n in np.unique(pieces):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
        parts = np.stack([i, j, n - i - j], axis=-1)
        weights = parts[(parts >= 0).all(-1) & (parts < n).all(-1)] / n
        points.append((weights @ corners[pieces == n]).reshape(-1, 3))
    return np.concatenate(points)


def _areas(corners: Array) -> Array:
    """Areas (m,) of triangles (m, 3, 3). [mm^2]"""
    return np.asarray(np.linalg.norm(np.cross(*np.diff(corners, axis=1).transpose(1, 0, 2)), axis=1) / 2)
