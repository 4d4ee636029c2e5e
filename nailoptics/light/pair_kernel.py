"""The light between any two places of a board: a smooth kernel, fitted to photons that start all over it.

A photon that starts at x on the board's underside and arrives at y tells K(x, y), the irradiance at y by a Lambertian
source of unit power at x. By reciprocity K(x, y) = K(y, x), so that each photon counts for both ways.

Hardly any two photons share both places, but K is smooth. It is g C: g is a function of the distance |x - y| alone,
which falls by five decades, and C is a sum of two piecewise linear functions. One knows x and y across the nail (or
across a wall, beside which its nodes are dense) and how far they lie apart along it: that is all where the finger is
alike along the nail. The other, on few nodes of all four coordinates, is what differs with the place: the rim, the tip.
Galerkin's projection gives their coefficients c: with B the functions' values at a pair of places,

    c = M^-1 b,   M = integral of g B B^T over all pairs,   b = sum over arrivals of weight B, per photon and area.

Everything is linear in the photons. So derivatives and other blood states are further columns of b, and groups of
photons tell the standard errors.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.rectangles import Rectangle

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Nodes beside a wall and beside a rim, and how far apart those between may lie. [mm]
BESIDE_WALL_MM, BESIDE_RIM_MM, BETWEEN_MM = (0.0, 0.25, 0.6, 1.1), (0.0, 0.8), 2.0
# Distances along the nail between which C is linear; the board's length is the last. [mm]
APART_MM = (0.0, 0.2, 0.45, 0.75, 1.1, 1.5, 1.95, 2.5, 3.2, 4.0, 5.0, 6.5, 9.0)
# The coarse nodes along the nail: so far from either end, and in the middle. [mm]
COARSE_END_MM = (0.0, 0.7, 2.4)
# The radial function has so many knots, evenly in the logarithm of the distance, from this one on. [mm]
KNOTS, NEAREST_MM = 32, 0.2
# Pairs of places at which the integral M is taken, low in discrepancy.
PAIRS = 1 << 19
# Part of its diagonal that is added to M: both functions hold the constant, which is either's as well.
RIDGE = 1e-4


def line_nodes(axis: Array, x: Array) -> tuple[Indices, Array]:
    """The two nodes around each x and their weights there, (n, 2) each; what lies outside counts as on the edge."""
    at = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    part = np.clip((x - axis[at]) / (axis[at + 1] - axis[at]), 0.0, 1.0)
    return np.stack([at, at + 1], -1), np.stack([1 - part, part], -1)


def node_products(axes: tuple[Array, ...], values: tuple[Array, ...]) -> tuple[Indices, Array]:
    """The nodes around points of several coordinates, the last counting fastest, and their weights, (n, 2^d) each."""
    count = len(values[0])
    at, weight = np.zeros((count, 1), np.int64), np.ones((count, 1))
    for axis, x in zip(axes, values, strict=True):
        index, part = line_nodes(axis, x)
        at = (at[:, :, None] * len(axis) + index[:, None, :]).reshape(count, -1)
        weight = (weight[:, :, None] * part[:, None, :]).reshape(count, -1)
    return at, weight


@dataclass(frozen=True)
class PairBasis:
    """The functions of a pair of places whose sum is C.

    across : 0 where u is the axis across the nail or wall, 1 where v is.
    first_mm, second_mm : nodes across, of the LEDs' place and of the photodiodes'. [mm]
    apart_mm : nodes of the distance along.
    coarse_first_mm, coarse_second_mm, coarse_along_mm : nodes of the other function. [mm]
    """

    across: int
    first_mm: Array
    second_mm: Array
    apart_mm: Array
    coarse_first_mm: Array
    coarse_second_mm: Array
    coarse_along_mm: Array

    @property
    def one_side(self) -> bool:
        """Whether LEDs and photodiodes lie on the same part of the board, which has no wall."""
        return self.first_mm is self.second_mm

    @cached_property
    def axes(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """The nodes of either function: across, across and apart; across, along, across, along."""
        along = self.coarse_along_mm
        fine = self.first_mm, self.second_mm, self.apart_mm
        return fine, (self.coarse_first_mm, along, self.coarse_second_mm, along)

    @property
    def size(self) -> int:
        """How many functions there are."""
        return sum(int(np.prod([len(axis) for axis in axes])) for axes in self.axes)

    def at(self, x_mm: Array, y_mm: Array) -> tuple[Indices, Array]:
        """The 24 functions that are not 0 at pairs of places, (n, 2) each, and their values, (n, 24) each. [mm]"""
        a, b = self.across, 1 - self.across
        fine, coarse = self.axes
        one = node_products(fine, (x_mm[:, a], y_mm[:, a], np.abs(x_mm[:, b] - y_mm[:, b])))
        other = node_products(coarse, (x_mm[:, a], x_mm[:, b], y_mm[:, a], y_mm[:, b]))
        first = int(np.prod([len(axis) for axis in fine]))
        return np.concatenate([one[0], other[0] + first], 1), np.concatenate([one[1], other[1]], 1)

    def matrix(self, x_mm: Array, y_mm: Array) -> Any:
        """The functions' values at pairs of places, sparse (n, size)."""
        from scipy.sparse import csr_matrix

        at, value = self.at(x_mm, y_mm)
        ends = at.shape[1] * np.arange(len(at) + 1)
        return csr_matrix((value.ravel(), at.ravel(), ends), shape=(len(at), self.size))

    def places(self, unit: Array) -> tuple[Array, Array, Array]:
        """Pairs of places for points of the unit cube (n, 4), denser where the nodes are, and the area squared that
        each stands for, (n,). [mm], [mm^4]"""
        ends = self.coarse_along_mm[[0, -1]]
        columns, volume = [], np.full(len(unit), 1 / len(unit))
        for axis, t in zip((self.first_mm, ends, self.second_mm, ends), unit.T, strict=True):
            cell = np.minimum((t * (len(axis) - 1)).astype(int), len(axis) - 2)
            width = np.diff(axis)[cell]
            columns.append(axis[cell] + (t * (len(axis) - 1) - cell) * width)
            volume = volume * width * (len(axis) - 1)
        pair = np.stack(columns, -1)
        order = [0, 1] if self.across == 0 else [1, 0]
        return pair[:, :2][:, order], pair[:, 2:][:, order], volume

    def between(
        self, starts_mm: Array, arrivals_mm: Array
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Array, Array]:
        """Which photons went from one side to the other; and of these, which started on the first, and where each was
        on the first and on the second. [mm]"""
        if self.one_side:
            every = np.ones(len(starts_mm), bool)
            return every, every, starts_mm, arrivals_mm
        axis = self.across
        rises = self.second_mm[0] > self.first_mm[0]
        facing = (self.first_mm[-1], self.second_mm[0]) if rises else (self.first_mm[0], self.second_mm[-1])
        middle = sum(facing) / 2
        starts_first = (starts_mm[:, axis] < middle) == rises
        went = starts_first != ((arrivals_mm[:, axis] < middle) == rises)
        x = np.where(starts_first[:, None], starts_mm, arrivals_mm)
        y = np.where(starts_first[:, None], arrivals_mm, starts_mm)
        return went, starts_first[went], x[went], y[went]

    def sums(self, x_mm: Array, y_mm: Array, values: Array, back: Array | None = None) -> Array:
        """Sums of the arrivals' values (n, q) times the functions there, (size, q); each counts for both ways.

        back : their values where they count for the way back, which only differ, and count, without a wall.
        """
        forth = self.matrix(x_mm, y_mm).T @ values
        if not self.one_side:
            return np.asarray(0.5 * forth)
        return np.asarray(0.5 * (forth + self.matrix(y_mm, x_mm).T @ (values if back is None else back)))


def pair_basis(outline: Rectangle, wall: Rectangle | None) -> PairBasis:
    """The functions for a board, with a wall or without.

    wall : named after the side of the photodiodes on which the LEDs lie, as in a layout.
    """
    across = 0 if wall is None or wall.name in ("left", "right") else 1
    ends = [(outline.u_min, outline.u_max), (outline.v_min, outline.v_max)]
    (low, high), (start, end) = ends[across], ends[1 - across]
    apart = np.array([d for d in APART_MM if d < end - start] + [end - start])
    half = (end - start) / 2
    from_end = np.array([d for d in COARSE_END_MM if d < half])
    along = np.unique(np.concatenate([start + from_end, [start + half], end - from_end]))
    if wall is None:
        whole, coarse = _nodes(low, high, BESIDE_RIM_MM, BESIDE_RIM_MM), np.linspace(low, high, 3)
        return PairBasis(across, whole, whole, apart, coarse, coarse, along)
    faces = (wall.u_min, wall.u_max) if across == 0 else (wall.v_min, wall.v_max)
    below, above = (
        _nodes(low, faces[0], BESIDE_RIM_MM, BESIDE_WALL_MM),
        _nodes(faces[1], high, BESIDE_WALL_MM, BESIDE_RIM_MM),
    )
    first, second = (below, above) if wall.name in ("left", "below") else (above, below)
    coarse_first, coarse_second = (np.linspace(axis[0], axis[-1], 3) for axis in (first, second))
    return PairBasis(across, first, second, apart, coarse_first, coarse_second, along)


def _nodes(low: float, high: float, first: tuple[float, ...], last: tuple[float, ...]) -> Array:
    """Nodes from one end to the other, dense beside the ends; evenly where there is no room for that."""
    inside = high - low - first[-1] - last[-1]
    if inside < 0.5:
        return np.linspace(low, high, max(2, round((high - low) / 0.5) + 1))
    between = np.linspace(low + first[-1], high - last[-1], int(np.ceil(inside / BETWEEN_MM)) + 1)
    return np.concatenate([low + np.array(first[:-1]), between, high - np.array(last[-2::-1])])


@dataclass(frozen=True)
class RadialFunction:
    """A positive function of the distance: its logarithm is linear in that of the distance, between knots.

    log_mm, log_value : (k,) float. Logarithms of distances in mm and of values.
    """

    log_mm: Array
    log_value: Array

    def __call__(self, x_mm: Array, y_mm: Array) -> Array:
        """Its values at pairs of places, (n, 2) each. [mm]"""
        distance = np.hypot(*(x_mm - y_mm).T)
        return np.exp(np.interp(np.log(np.maximum(distance, NEAREST_MM / 2)), self.log_mm, self.log_value))

    @staticmethod
    def of_arrivals(basis: PairBasis, x_mm: Array, y_mm: Array, weight: Array) -> "RadialFunction":
        """How arrivals fall with the distance, per pair of places; its size does not matter, C makes it up."""
        x, y, volume = basis.places(_even_points())
        by_chance, seen = np.hypot(*(x - y).T), np.hypot(*(x_mm - y_mm).T)
        edges = np.geomspace(NEAREST_MM, by_chance.max() * 1.0001, KNOTS + 1)
        edges[0] = 0.0
        light = np.histogram(seen, edges, weights=weight)[0]
        there = np.histogram(by_chance, edges, weights=volume)[0]
        known = (light > 0) & (there > 0)
        middle = np.sqrt(edges[1:] * np.maximum(edges[:-1], NEAREST_MM))
        return RadialFunction(np.log(middle[known]), np.log(light[known] / there[known]))


def _even_points() -> Array:
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(4, seed=0).random(PAIRS))


class PairProjection:
    """M of a basis with its factors: solves for the coefficients of any sums."""

    def __init__(self, basis: PairBasis, radial: RadialFunction) -> None:
        from scipy.sparse import diags, identity
        from scipy.sparse.linalg import splu

        total: Any = 0
        for part in np.array_split(_even_points(), 16):
            x, y, volume = basis.places(part)
            volume, values = volume * (len(part) / PAIRS), basis.matrix(x, y)
            total = total + values.T @ diags(volume * radial(x, y)) @ values
        self.scale = 1 / np.sqrt(np.maximum(total.diagonal(), np.finfo(float).tiny))
        scaled = diags(self.scale) @ total @ diags(self.scale) + RIDGE * identity(basis.size)
        self.factors = splu(scaled.tocsc())

    def solve(self, sums: Array) -> Array:
        """The coefficients (size, q) of kernels g C whose arrivals add up to sums (size, q) per photon and area."""
        return np.asarray(self.scale[:, None] * self.factors.solve(self.scale[:, None] * sums))
