"""Splitting on the way to the photodiodes: where light may be detected, a photon goes on as several of less weight."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Face, Geometry
from .tallies import CellGrid

# A photon that comes within reach of a photodiode, in plate or epoxy, is walked there as so many copies of equal shares
# of its weight. On the prototype the figure of merit of readings, and of their changes with blood, is 2 to 3 times that
# of plain walks (of the faintest reading 2.8 times).
COPIES = 8
REACH_MM = 0.4
# Reach is known on cells of this size, seen from above.
CELL_MM = 0.1
# Where a barrier keeps light in the tissue, each stride from the LED leaves a quarter of it or so, and each photon that
# has made one towards a photodiode goes on as so many, up to a distance from there. For the faintest of the prototype's
# readings that is worth 2 times the figure of merit, with the LED 5 mm away 14 times. Light that comes straight through
# the epoxy goes where its copies go.
STRIDE_COPIES = 4
STRIDE_MM = 1.0
LEAST_DISTANCE_MM = 1.25
MOST_STRIDES = 3
STRIDE_CELL_MM = 0.4


class Reach:
    """Where photons of one LED are split, level by level: on the way to the photodiodes, and last within their reach.

    copies : (levels) list of int. Into how many.
    importance : (photodiodes,) float32. How much light counts there, so that the faintest readings have their part.
    """

    def __init__(self, geometry: Geometry, led: Face) -> None:
        near, low = near_photodiodes(geometry)
        self.near = mi.Bool(near.ravel())
        self.grid = CellGrid(low, [CELL_MM] * 2, near.shape)
        strides, low = strides_made(geometry, led)
        count = int(strides.max(initial=0))
        self.copies = [STRIDE_COPIES] * count + [COPIES]
        away = distances(geometry, led)
        self.importance = np.ones(len(away), np.float32)
        if count:
            self.importance = (STRIDE_COPIES ** ((away - away.min()) / STRIDE_MM)).astype(np.float32)
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
    to the weight that arrived there times its importance, and with what makes up for the others: so every photon leaves
    one record, and records are independent.

    photodiode, score : (photons,) Which photodiode each counts for, and the sum of all its weights, each times the
        importance of where it arrived; 0 if none.
    """

    def __init__(self, reach: Reach, photons: int) -> None:
        self.reach, self.importance = reach, mi.Float(reach.importance)
        self.photodiode, self.score = dr.zeros(mi.UInt32, photons), dr.zeros(mi.Float, photons)

    def records(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which photons were detected, (n,) int, by which photodiode, (n,) int, and with what weight, (n,) float."""
        photodiode, score = np.array(self.photodiode), np.array(self.score)
        detected = np.flatnonzero(score)
        photodiode = photodiode[detected]
        return detected, photodiode, score[detected].astype(float) / self.reach.importance[photodiode]


def near_photodiodes(geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """The cells from which a photodiode is within reach, (nx, ny) bool, and their lower corner, (2,) float. [mm]"""
    plans = [np.asarray(face.quads).reshape(-1, 3)[:, :2] for face in geometry.photodiodes]
    low = np.min([plan.min(0) for plan in plans], axis=0) - REACH_MM
    high = np.max([plan.max(0) for plan in plans], axis=0) + REACH_MM
    cells = _middles(low, high, CELL_MM)
    near = np.zeros(cells.shape[:2], bool)
    for plan in plans:
        beyond = np.maximum(np.maximum(plan.min(0) - cells, cells - plan.max(0)), 0)
        near |= np.hypot(beyond[..., 0], beyond[..., 1]) <= REACH_MM
    return near, low


def strides_made(geometry: Geometry, led: Face) -> tuple[np.ndarray, np.ndarray]:
    """How many strides light has made in each cell, (nx, ny, nz) uint32, from one LED towards a photodiode, and the
    cells' lower corner, (3,) float [mm]; no cells where there are none to make."""
    away = distances(geometry, led)
    most = np.minimum(np.floor((away - LEAST_DISTANCE_MM) / STRIDE_MM), MOST_STRIDES)
    far = np.flatnonzero(most > 0)
    walled = geometry.regions.index("barrier") in (*geometry.below, *geometry.above)
    if not walled or not len(far):
        return np.zeros((0, 0, 0), np.uint32), np.zeros(3)
    centres = np.array([_centre(geometry.photodiodes[i]) for i in far])
    reach = (away[far] - STRIDE_MM)[:, None]
    low, high = (centres - reach).min(0), (centres + reach).max(0)
    cells = _middles(low, high, STRIDE_CELL_MM).astype(np.float32)
    made = np.zeros(cells.shape[:-1])
    for i, centre in zip(far, centres.astype(np.float32), strict=True):
        nearer = away[i] - np.sqrt(np.square(cells - centre).sum(-1))
        made = np.maximum(made, np.minimum(np.floor(nearer / STRIDE_MM), most[i]))
    return made.astype(np.uint32), low


def distances(geometry: Geometry, led: Face) -> np.ndarray:
    """From an LED to the middle of each photodiode, (photodiodes,) float. [mm]"""
    return np.array([np.linalg.norm(_centre(face) - _centre(led)) for face in geometry.photodiodes])


def _middles(low: np.ndarray, high: np.ndarray, cell_mm: float) -> np.ndarray:
    """Middles of the cells of a size from corner to corner (d,), one axis for each coordinate, (..., d) float. [mm]"""
    axes = (a + cell_mm * (np.arange(np.ceil((b - a) / cell_mm)) + 0.5) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def _centre(face: Face) -> np.ndarray:
    return np.asarray(np.asarray(face.quads).reshape(-1, 3).mean(0))
