"""Splitting on the way to the photodiodes: where light may be detected, a photon goes on as several of less weight."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ..geometry import Face, Geometry
from .tallies.cell_grid import CellGrid

# A photon that comes within reach of a photodiode, in plate or epoxy, is walked there as so many copies of equal shares
# of its weight. On the prototype the figure of merit of readings, and of their changes with blood, is 2 to 3 times that
# of plain walks (of the faintest reading 2.8 times).
COPIES = 8
REACH_MM = 0.4
# Reach is known on cells of this size, seen from above.
CELL_MM = 0.1
# Where a barrier keeps light in the tissue and all photodiodes are far from the LED, each stride on the way leaves some
# quarter of the photons, and each that has made it goes on as so many, up to a distance from the photodiodes. That is
# worth 2 times the figure of merit 2.5 mm away, 6 times at 4 mm, 14 to 22 times at 5 mm. Light that comes straight
# through the epoxy goes where its copies go, and photodiodes at unlike distances gain nothing.
STRIDE_COPIES = 4
STRIDE_MM = 1.0
LEAST_DISTANCE_MM = 1.25
MOST_STRIDES = 3
STRIDE_CELL_MM = 0.4


class Reach:
    """Where photons of one LED are split, level by level: on the way to the photodiodes, and last within their reach.

    copies : (levels) list of int. Into how many.
    """

    def __init__(self, geometry: Geometry, led: Face) -> None:
        near, low = near_photodiodes(geometry)
        self.near = mi.Bool(near.ravel())
        self.grid = CellGrid(low, [CELL_MM] * 2, near.shape)
        strides, low = strides_made(geometry, led)
        count = int(strides.max(initial=0))
        self.copies = [STRIDE_COPIES] * count + [COPIES]
        if count:
            self.strides = mi.UInt32(strides.ravel())
            self.way = CellGrid(low, [STRIDE_CELL_MM] * 3, strides.shape)

    def within(self, p: Any, over_bed: Any, active: Any) -> list[Any]:
        """Whether a photon at p is to be split at each level, (levels) list; at the last one only over the bed."""
        levels = []
        if len(self.copies) > 1:
            cell, inside = self.way.cell(p, active)
            made = dr.gather(mi.UInt32, self.strides, cell, inside)
            levels = [made > k for k in range(len(self.copies) - 1)]
        cell, inside = self.grid.cell((p.x, p.y), over_bed)
        return [*levels, dr.gather(mi.Bool, self.near, cell, inside)]


class Splitting:
    """What the copies of each photon scored in the photodiodes.

    If copies of a photon reach several photodiodes, it counts for one of these, chosen with a probability in proportion
    to the weight that arrived there, and with the weight of all: so every photon leaves one record, and records are
    independent.

    photodiode, score : (photons,) Which photodiode each counts for, and its weight there; 0 if none.
    """

    def __init__(self, reach: Reach, photons: int) -> None:
        self.reach = reach
        self.photodiode, self.score = dr.zeros(mi.UInt32, photons), dr.zeros(mi.Float, photons)


def near_photodiodes(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """The cells from which a photodiode is within reach, (nx, ny) bool, and their lower corner, (2,) float. [mm]"""
    plans = [np.asarray(face.quads).reshape(-1, 3)[:, :2] for face in geometry.photodiodes]
    low = np.min([plan.min(0) for plan in plans], axis=0) - REACH_MM
    high = np.max([plan.max(0) for plan in plans], axis=0) + REACH_MM
    middles = [a + CELL_MM * (np.arange(np.ceil((b - a) / CELL_MM)) + 0.5) for a, b in zip(low, high, strict=True)]
    cells = np.stack(np.meshgrid(*middles, indexing="ij"), -1)
    near = np.zeros(cells.shape[:2], bool)
    for plan in plans:
        beyond = np.maximum(np.maximum(plan.min(0) - cells, cells - plan.max(0)), 0)
        near |= np.hypot(beyond[..., 0], beyond[..., 1]) <= REACH_MM
    return near, low


def strides_made(geometry: Geometry, led: Face) -> tuple[np.ndarray, np.ndarray]:
    """How many strides light has made in each cell, (nx, ny, nz) uint32, from one LED to the photodiodes, and the
    cells' lower corner, (3,) float [mm]; no cells where there are none to make."""
    centres = np.array([_centre(face) for face in geometry.photodiodes])
    away = np.linalg.norm(centres - _centre(led), axis=1).min()
    reaches = away - STRIDE_MM * np.arange(1, 1 + MOST_STRIDES)
    reaches = reaches[reaches >= LEAST_DISTANCE_MM]
    walled = geometry.regions.index("barrier") in (*geometry.below, *geometry.above)
    if not walled or not len(reaches):
        return np.zeros((0, 0, 0), np.uint32), np.zeros(3)
    low, high = centres.min(0) - reaches[0], centres.max(0) + reaches[0]
    count = np.ceil((high - low) / STRIDE_CELL_MM).astype(int)
    middles = [a + STRIDE_CELL_MM * (np.arange(n) + 0.5) for a, n in zip(low, count, strict=True)]
    distance, _ = cKDTree(centres).query(np.stack(np.meshgrid(*middles, indexing="ij"), -1))
    return np.asarray((distance[..., None] < reaches).sum(-1), np.uint32), low


def _centre(face: Face) -> np.ndarray:
    return np.asarray(np.asarray(face.quads).reshape(-1, 3).mean(0))
