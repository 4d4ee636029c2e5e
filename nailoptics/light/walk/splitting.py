"""Splitting on the way to the photodiodes: where light may be detected, a photon goes on as several of less weight."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Face, Geometry
from .interfaces import DETECTED, FingerPhoton
from .sampling import remaining
from .tallies import CellGrid

# A photon that comes within reach of a photodiode, in plate or epoxy, is walked there as so many copies of equal shares
# of its weight. With the strides below the figure of merit of the prototype's readings is 1.6 (nearest) to 6 times
# (farthest) that of plain walks, of their changes with blood 2.3 to 6.5 times.
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
    arrivals : For so many of each photon, in the mean, a batch has room.
    """

    def __init__(self, geometry: Geometry, led: Face) -> None:
        near, low = near_photodiodes(geometry)
        self.near = mi.Bool(near.ravel())
        self.grid = CellGrid(low, [CELL_MM] * 2, near.shape)
        strides, low = strides_made(geometry, led)
        count = int(strides.max(initial=0))
        self.copies = [STRIDE_COPIES] * count + [COPIES]
        self.arrivals = 1.0
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
    """All arrivals of photons and their copies at photodiodes; those for which there is no room are only counted."""

    def __init__(self, reach: Reach, photons: int, *, paths: int) -> None:
        self.reach, self.photons, room = reach, photons, math.ceil(reach.arrivals * photons)
        self.room: Any = dr.opaque(mi.UInt32, room)
        self.count = dr.zeros(mi.UInt32)
        self.photon, self.photodiode = (dr.zeros(mi.UInt32, room) for _ in range(2))
        self.weight, *self.path = (dr.zeros(mi.Float, room) for _ in range(1 + paths))

    @dr.syntax
    def add(self, photon: FingerPhoton, accepted: Any) -> None:
        """Keep a photon, or a copy, that arrives at a photodiode, which makes so much of its light."""
        if photon.outcome >= DETECTED:
            weight = photon.weight * remaining(photon.tau) * accepted
            slot = dr.scatter_inc(self.count, mi.UInt32(0), weight > 0)
            inside = (weight > 0) & (slot < self.room)
            values = photon.index, photon.outcome - DETECTED, weight, *photon.path
            for target, value in zip((self.photon, self.photodiode, self.weight, *self.path), values, strict=True):
                dr.scatter(target, value, slot, inside)

    def fits(self) -> bool:
        """Whether there was room for all; if not, the next walk towards these photodiodes has more."""
        if self.count[0] > self.room[0]:
            self.reach.arrivals = 1.25 * self.count[0] / self.photons
        return bool(self.count[0] <= self.room[0])

    def records(self, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """One record for every photodiode that copies of a photon reached, with the sum of their weights there and the
        path of one of them, drawn with a probability in proportion to its weight.

        Returns: photon (n,) and photodiode (n,) int, weight (n,) float and path (t, n) [mm], in the photons' order.
        """
        photon, photodiode, weight, *path = (
            np.array(column)[: self.count[0]] for column in (self.photon, self.photodiode, self.weight, *self.path)
        )
        pair = photon.astype(np.int64) << 32 | photodiode
        # Copies of a photon come one after the other: a stable order is the same each time.
        order = np.argsort(pair, kind="stable")
        pair, weight = pair[order], weight[order].astype(float)
        first, up_to = np.flatnonzero(np.diff(pair, prepend=-1)), np.cumsum(weight)
        total = np.add.reduceat(weight, first)
        # By the photon's own number, whatever others leave, so that scenes that share it share its record.
        part = np.random.default_rng(seed).random(self.photons)[pair[first] >> 32]
        lot = up_to[first] - weight[first] + part * total
        # Rounding must not draw a neighbour's.
        drawn = np.clip(np.searchsorted(up_to, lot), first, np.append(first[1:], len(pair)) - 1)
        chosen = order[drawn]
        return photon[chosen], photodiode[chosen], total, np.stack(path)[:, chosen]


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
    away = np.array([np.linalg.norm(_centre(face) - _centre(led)) for face in geometry.photodiodes])
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


def _middles(low: np.ndarray, high: np.ndarray, cell_mm: float) -> np.ndarray:
    """Middles of the cells of a size from corner to corner (d,), one axis for each coordinate, (..., d) float. [mm]"""
    axes = (a + cell_mm * (np.arange(np.ceil((b - a) / cell_mm)) + 0.5) for a, b in zip(low, high, strict=True))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1)


def _centre(face: Face) -> np.ndarray:
    return np.asarray(np.asarray(face.quads).reshape(-1, 3).mean(0))
