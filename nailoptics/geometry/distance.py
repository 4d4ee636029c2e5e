"""Where no interface can be: shells around the nail's axis, and a grid of safe distances to all else, for light that
wants to skip the search for a crossing."""

import math
from dataclasses import dataclass

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
# A triangle is part of a cylinder around the nail's axis where its distance to the axis varies by no more. [mm]
SHELL_MM = 0.005
# The shells with most of them are known, if they have so many square millimetres; all others are like any interface.
SHELLS, LEAST_SHELL_MM2 = 8, 2.0
# What single precision may add to heights, and how far light that has met a face may be off it. [mm]
ROUNDING_MM, OFF_FACE_MM = 1e-5, 1e-4


@dataclass(frozen=True)
class DistanceGrid:
    """Lower bounds on the distance to the nearest interface that is no part of a shell, cell by cell.

    distance_mm : (2, nx, ny, nz) float32. From the cell's centre to the nearest one that reaches below `outer_mm`, and
        that reaches above it; never more than the true distance, at most CAP_MM; 0 in the air. [mm]
    in_shell : (m,) bool. Which triangles are parts of shells.
    shells_mm : (s, 2) float. Between which heights over the nail plate's outer face each shell lies, a prism with many
        sides; all faces of plate, bed and board are cylinders around one axis. [mm]
    outer_mm : The least height of the shell that is the plate's outer face, on which walls of the board stand. [mm]
    origin_mm : (3,) float. Lowest corner of the first cell; its centre lies half a spacing further. [mm]
    spacing_mm : Edge of the cubic cells. [mm]

    From a point p in a cell of centre c, a distance is at least distance_mm - |p - c|.
    """

    distance_mm: NDArray[np.float32]
    in_shell: NDArray[np.bool_]
    shells_mm: Array
    outer_mm: float
    origin_mm: Array
    spacing_mm: float

    def centers(self, cells: NDArray[np.int64]) -> Array:
        """Centres (k, 3) of cells (k, 3). [mm]"""
        return self.origin_mm + self.spacing_mm * (np.asarray(cells) + 0.5)


def distance_grid(geometry: Geometry, *, spacing_mm: float = SPACING_MM) -> DistanceGrid:
    """Shells, and lower bounds on the distance to the nearest interface beside them.

    The bound is short by at most 2 % and 0.3 spacings, or 0.4 spacings where an interface is closer than half of one.

    Triangles are sampled on a lattice, and the nearest sample is looked up. If q is the place on an interface nearest
    to a point, then a sample of the same triangle (or edge, or vertex) lies within the lattice's covering radius r of
    q, at a right angle to the way to q; so distance^2 >= (distance to the nearest sample)^2 - r^2.
    """
    from scipy.ndimage import maximum_filter
    from scipy.spatial import cKDTree

    low, high = geometry.bounds_mm
    shape = np.maximum(np.ceil((high - low) / spacing_mm - 1e-9).astype(int), 1)
    filled = geometry.cells(low, spacing_mm, shape) != AIR
    corners = geometry.vertices[geometry.triangles]
    lowest, highest = _heights(corners + [0, 0, geometry.nail_radius_mm]) - geometry.nail_radius_mm
    in_shell, shells_mm = _shells(lowest, highest, _areas(corners))
    outer_mm = max((bottom for bottom, top in shells_mm if bottom < 0 < top), default=np.inf)
    radius = COVERED * spacing_mm
    reach = (1 + SLACK) * math.hypot(CAP_MM, radius)
    grid = DistanceGrid(np.zeros((2, *shape), np.float32), in_shell, shells_mm, outer_mm, low, spacing_mm)
    grid.distance_mm[:, filled] = CAP_MM
    for bound_mm, reaches in zip(grid.distance_mm, (lowest < outer_mm, highest > outer_mm), strict=True):
        points = _samples(geometry.vertices, geometry.triangles[~in_shell & reaches], radius)
        near = np.zeros(shape, bool)
        near[tuple(np.clip((points - low) // spacing_mm, 0, shape - 1).astype(int).T)] = True
        # Farther cells than the cap, and half a cell for the middle of each, keep it.
        near = maximum_filter(near, 2 * math.ceil(reach / spacing_mm + 0.5) + 1) & filled
        # A tree whose nodes are not shrunk to their points answers ten times faster here.
        samples = cKDTree(points, leafsize=32, balanced_tree=False, compact_nodes=False)
        centers = grid.centers(np.argwhere(near))
        nearest, _ = samples.query(centers, eps=SLACK, distance_upper_bound=reach, workers=-1)
        bound = np.sqrt(np.maximum((np.minimum(nearest, reach) / (1 + SLACK)) ** 2 - radius**2, 0))
        bound_mm[near] = np.minimum(bound, CAP_MM) * (1 - 1e-6)
    return grid


def _heights(corners: Array) -> Array:
    """The least and the largest distance of a place on each triangle (m, 3, 3) to the y axis, (2, m). [mm]"""
    flat = np.ascontiguousarray(corners.T[::2])
    along = np.roll(flat, -1, axis=1) - flat
    part = -(flat * along).sum(0) / np.maximum((along**2).sum(0), 1e-12)
    nearest = np.linalg.norm(flat + np.clip(part, 0, 1) * along, axis=0).min(0)
    return np.stack([nearest, np.linalg.norm(flat, axis=0).max(0)])


def _shells(lowest: Array, highest: Array, area_mm2: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which triangles are parts of shells, by the heights (m,) between which they lie, and between which heights each
    shell lies that has enough of them, none of them near another, (s, 2). [mm]"""
    shell, thin = np.rint((highest - highest.min()) / SHELL_MM).astype(int), highest - lowest < SHELL_MM
    area_of, between, in_shell = np.bincount(shell[thin], area_mm2[thin]), np.empty((0, 2)), np.zeros(len(thin), bool)
    for one in np.argsort(-area_of, kind="stable"):
        inside = thin & (shell == one)
        if len(between) == SHELLS or area_of[one] < LEAST_SHELL_MM2:
            break
        bottom, top = lowest[inside].min() - ROUNDING_MM, highest[inside].max() + ROUNDING_MM
        if ((bottom > between[:, 1] + 4 * OFF_FACE_MM) | (top < between[:, 0] - 4 * OFF_FACE_MM)).all():
            between, in_shell = np.vstack([between, [bottom, top]]), in_shell | inside
    return in_shell, between


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
