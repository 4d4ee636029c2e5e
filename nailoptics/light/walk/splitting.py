"""Splitting (variance reduction) on the way to the photodiodes: a photon goes on as several of less weight."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import Face, Geometry
from .interfaces import DETECTED, FREE_EVENTS, IN_TISSUE, OVER_BED, FingerPhoton, Regions
from .sampling import FAR, absorption_depth, survival
from .tallies import CellGrid

# A photon over the bed that comes within reach of a photodiode, and flies so that it will miss it by no more than
# AIM_MM, is walked there as so many copies of equal shares of its weight; one flatter than LEAST_COS never is.
COPIES = 6
REACH_MM, AIM_MM, LEAST_COS = 0.8, 0.25, 0.1
# How far photodiodes are is known on cells of this size, seen from above.
CELL_MM = 0.1
# On its way in tissue each stride from the LED leaves half of the light or so, and each photon that has made one
# towards a photodiode goes on as two, up to a distance from there. With both, the figure of merit of the prototype's
# readings is 2.2 (nearest) to 7 times (farthest) that of plain walks, with the LED 5 mm away 34 to 48 times; of their
# changes with blood 2.6 to 8.6 and 35 to 53 times.
STRIDE_MM = 0.35
LEAST_DISTANCE_MM = 0.7
MOST_STRIDES = 7
STRIDE_CELL_MM = 0.25


class Reach:
    """Where photons of one LED are split: on the way to the photodiodes, and last within their reach.

    arrivals : For so many of each photon, in the mean, a batch has room.
    """

    def __init__(self, geometry: Geometry, led: Face) -> None:
        away, height, low = near_photodiodes(geometry)
        self.away, self.height = mi.Float(away.ravel()), mi.Float(np.where(away <= REACH_MM, height, FAR).ravel())
        self.grid = CellGrid(low, [CELL_MM] * 2, away.shape)
        strides, low = strides_made(geometry, led)
        self.strides = mi.UInt32(strides.ravel())
        self.way = CellGrid(low, [STRIDE_CELL_MM] * 3, strides.shape)
        self.arrivals = 2.0

    def made(self, p: Any, active: Any) -> Any:
        """Strides that light at p has made."""
        cell, inside = self.way.cell(p, active)
        return dr.gather(mi.UInt32, self.strides, cell, inside)

    def near(self, p: Any, w: Any, over_bed: Any) -> tuple[Any, Any]:
        """Whether a photon at p over the bed is within reach of a photodiode, and whether it flies towards one."""
        cell, inside = self.grid.cell((p.x, p.y), over_bed)
        height = dr.gather(mi.Float, self.height, cell, inside)
        within = inside & (height < FAR)
        up = within & (w.z > LEAST_COS)
        ahead = (height - p.z) / dr.select(up, w.z, 1)
        cell, inside = self.grid.cell((dr.fma(ahead, w.x, p.x), dr.fma(ahead, w.y, p.y)), up)
        return within, inside & (dr.gather(mi.Float, self.away, cell, inside) <= AIM_MM)


class Splitting:
    """All arrivals of photons and their copies at photodiodes; those for which there is no room are only counted."""

    def __init__(self, reach: Reach, photons: int, *, paths: int) -> None:
        self.reach, self.photons, room = reach, photons, math.ceil(reach.arrivals * photons)
        self.room: Any = dr.opaque(mi.UInt32, room)
        self.count = dr.zeros(mi.UInt32)
        self.photon, self.photodiode = (dr.zeros(mi.UInt32, room) for _ in range(2))
        self.weight, *self.path = (dr.zeros(mi.Float, room) for _ in range(1 + paths))

    def forks(self) -> list[Any]:
        """Room for how a photon stands where it is split: at each stride, and last within reach."""
        return [dr.alloc_local(mi.Float, MOST_STRIDES + 1) for _ in range(10 + len(self.path))]

    def split(self, photon: FingerPhoton, forks: list[Any], regions: Regions, active: Any) -> None:
        """Split a photon that comes nearer to a photodiode, and walk its copies one by one.

        Each starts where the photon was split, and ends there or goes away. All of them may be detected; it is the last
        that goes on, with the whole weight.
        """
        made = self.reach.made(photon.p, active)
        within, aims = self.reach.near(photon.p, photon.w, regions.is_a(OVER_BED, photon.region, active))
        # There each scattering may turn it towards one.
        photon.free_events = dr.select(within & (photon.near_copies == 0), mi.UInt32(1), FREE_EVENTS)
        splits = active & (photon.outcome == 0) & (photon.near_copies == 0)
        strides = splits & regions.is_a(IN_TISSUE, photon.region, active) & (made > photon.strides)
        _fork(photon, forks, strides, splits & aims & ~strides)
        _go_on(photon, forks, ~within, made < photon.strides, active)

    @dr.syntax
    def add(self, photon: FingerPhoton, accepted: Any) -> None:
        """Keep a photon, or a copy, that arrives at a photodiode, which makes so much of its light."""
        if photon.outcome >= DETECTED:
            weight = photon.weight * survival(photon.tau) * accepted
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
        columns = (self.photon, self.photodiode, self.weight)
        photon, photodiode, weight = (np.array(column)[: self.count[0]] for column in columns)
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
        return photon[chosen], photodiode[chosen], total, np.stack([np.array(column)[chosen] for column in self.path])


@dr.syntax
def _fork(photon: FingerPhoton, forks: list[Any], strides: Any, near: Any) -> None:
    """Split a photon that has made one more stride, or comes within reach of a photodiode."""
    if strides | near:
        photon.weight *= dr.select(near, 1 / COPIES, 0.5)
        state = [*photon.p, *photon.w, mi.Float(photon.region), photon.weight, photon.tau, photon.entered, *photon.path]
        for fork, value in zip(forks, state, strict=True):
            fork.write(value, dr.select(near, MOST_STRIDES, photon.strides))
        photon.pending |= dr.select(strides, mi.UInt32(1) << photon.strides, 0)
        photon.strides += dr.select(strides, mi.UInt32(1), 0)
        photon.near_copies = dr.select(near, mi.UInt32(COPIES), 0)


@dr.syntax
def _go_on(photon: FingerPhoton, forks: list[Any], far: Any, back: Any, active: Any) -> None:
    """Begin the next of the copies of a photon that ended, is far from the photodiodes or has gone back by a stride; or
    make the last one whole again."""
    ended, split_near = photon.outcome > 0, photon.near_copies > 0
    far &= split_near
    back &= ~split_near
    latest = dr.select(photon.strides > 0, photon.strides - 1, 0)
    from_near = active & (ended | far) & (photon.near_copies > 1)
    left = dr.select(back & ~ended, photon.pending >> latest, photon.pending)
    from_stride = active & ~from_near & (ended | back) & (left > 0)
    if active & ~ended & (far | back) & ~from_near & ~from_stride:
        photon.weight *= dr.select(far, mi.Float(COPIES), 2)
        photon.strides -= dr.select(back, mi.UInt32(1), 0)
        photon.near_copies = mi.UInt32(0)
    if from_near | from_stride:
        place = dr.select(from_near, MOST_STRIDES, 31 - dr.lzcnt(photon.pending | 1))
        state = [fork.read(place) for fork in forks]
        photon.p, photon.w = mi.Point3f(*state[:3]), mi.Vector3f(*state[3:6])
        photon.region, photon.weight, photon.tau, photon.entered = mi.UInt32(state[6]), *state[7:10]
        photon.path = state[10:]
        # What absorption leaves a photon knows nothing of how far it came.
        photon.absorption_optical_depth = photon.tau + absorption_depth(photon.rng.next_float32())
        photon.near_copies = dr.select(from_near, photon.near_copies - 1, 0)
        photon.strides = dr.select(from_near, photon.strides, place + 1)
        photon.pending ^= dr.select(from_near, 0, mi.UInt32(1) << place)
        photon.side, photon.outcome = mi.Float(0), mi.UInt32(0)
    photon.weight = dr.select(photon.outcome > 0, photon.weight * copies_of(photon), photon.weight)


def copies_of(photon: FingerPhoton) -> Any:
    """How many copies of its weight a photon was split into."""
    return mi.Float(mi.UInt32(1) << photon.strides) * dr.select(photon.near_copies > 0, mi.Float(COPIES), 1)


def near_photodiodes(geometry: Geometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far cells within reach are from the nearest photodiode, seen from above, (nx, ny) float, its height, (nx, ny)
    float, and the cells' lower corner, (2,) float. [mm]"""
    corners = [np.asarray(face.quads).reshape(-1, 3) for face in geometry.photodiodes]
    plans = [corner[:, :2] for corner in corners]
    low = np.min([plan.min(0) for plan in plans], axis=0) - REACH_MM
    high = np.max([plan.max(0) for plan in plans], axis=0) + REACH_MM
    cells = np.stack(np.meshgrid(*_middles(low, high, CELL_MM), indexing="ij"), -1)
    away, height = np.full(cells.shape[:2], np.inf), np.zeros(cells.shape[:2])
    for corner, plan in zip(corners, plans, strict=True):
        beyond = np.maximum(np.maximum(plan.min(0) - cells, cells - plan.max(0)), 0)
        distance = np.hypot(beyond[..., 0], beyond[..., 1])
        height = np.where(distance < away, corner[:, 2].mean(), height)
        away = np.minimum(away, distance)
    return away, height, low


def strides_made(geometry: Geometry, led: Face) -> tuple[np.ndarray, np.ndarray]:
    """How many strides light has made in each cell, (nx, ny, nz) uint32, from one LED towards a photodiode, and the
    cells' lower corner, (3,) float [mm]; no cells where there are none to make."""
    middles = np.array([face.center_mm for face in geometry.photodiodes])
    away = np.linalg.norm(middles - led.center_mm, axis=1)
    most = np.minimum(np.floor((away - LEAST_DISTANCE_MM) / STRIDE_MM), MOST_STRIDES)
    far = np.flatnonzero(most > 0)
    if not len(far):
        return np.zeros((1, 1, 1), np.uint32), np.zeros(3)
    centres, reach = middles[far], (away[far] - STRIDE_MM)[:, None]
    low, high = (centres - reach).min(0), (centres + reach).max(0)
    x, y, z = (axis.astype(np.float32) for axis in _middles(low, high, STRIDE_CELL_MM))
    made = np.zeros((len(x), len(y), len(z)), np.float32)
    for distance, limit, (u, v, w) in zip(away[far], most[far], centres, strict=True):
        left = np.sqrt(np.square(x - u)[:, None, None] + np.square(y - v)[:, None] + np.square(z - w))
        np.maximum(made, np.minimum((distance - left) / STRIDE_MM, limit), out=made)
    return made.astype(np.uint32), low


def _middles(low: np.ndarray, high: np.ndarray, cell_mm: float) -> list[np.ndarray]:
    """Middles of the cells of a size from corner to corner (d,), along each axis. [mm]"""
    return [a + cell_mm * (np.arange(np.ceil((b - a) / cell_mm)) + 0.5) for a, b in zip(low, high, strict=True)]
