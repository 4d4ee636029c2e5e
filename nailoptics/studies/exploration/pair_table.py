"""The light between any two places of a board as one table of coefficients, estimated from photons that start anywhere.

A photon that starts at x on the board's underside and arrives at y samples K(x, y), the irradiance at y by a Lambertian
source of unit power at x; by reciprocity K(x, y) = K(y, x), so that each photon counts both ways. K = g C: g is a
smooth function of the distance |x - y| alone, which falls by five decades, and C is piecewise linear in four
coordinates: where x and y lie across the nail (or across a wall), their distance along it and their middle along it.
Galerkin's projection, with a penalty on the curvature of C between nodes (a smoothing spline), gives its coefficients:

    (M + R) c = b,   M = integral of g B B^T over all pairs of places,   b = sum over arrivals of weight B,

in units of photons. Everything is linear in the photons: other blood states are further columns of b, which share the
photons' noise, and groups of photons give the standard errors.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.rectangles import Rectangle
from ...statistics import Array

# Nodes beside a wall and beside a rim, and how far apart those between may lie. [mm]
BESIDE_WALL_MM, BESIDE_RIM_MM, BETWEEN_MM = (0.0, 0.15, 0.35, 0.6, 1.0, 1.5), (0.0, 0.8), 2.0
# Nodes of the distance along; the board's length is the last. [mm]
DISTANCE_MM = (0.0, 0.3, 0.7, 1.2, 1.8, 2.5, 3.5, 5.0, 7.0)
# Nodes of the middle along lie no farther apart than this. [mm]
MIDDLE_STEP_MM = 2.5
# The strength of the penalty: expected change of C from node to node, and its deviation from a straight line, rms, on
# each of so many lines of nodes; of changes by blood both are so much larger over the middle along, where one zone of
# blood follows another.
DIFFERENCE, BEND, LINES, ZONES = 5.0, 1.0, 500, 8.0
# Pairs of places at which M is summed, low in discrepancy, and the shortest distance that g distinguishes. [mm]
PAIRS, NEAREST_MM = 1 << 19, 0.2
# Degrees in the saturation and in all.
SO2_DEGREE, DEGREE = 2, 4


@dataclass(frozen=True)
class BloodPolynomial:
    """Polynomials in the blood of both zones and the saturation, over a box of states.

    blood_fraction, so2 : lowest and highest of the box; of one saturation alone both are the same.
    degree : in all.
    """

    blood_fraction: tuple[float, float]
    so2: tuple[float, float]
    degree: int = DEGREE

    @property
    def exponents(self) -> list[tuple[int, ...]]:
        """Exponents of both zones' blood and of the saturation in each monomial, all scaled to -1 to 1."""
        return [e for e in product(*(range(len(nodes)) for nodes in self._nodes)) if sum(e) <= self.degree]

    @property
    def _nodes(self) -> list[Array]:
        """Chebyshev's nodes of each variable."""
        degrees = self.degree, self.degree, SO2_DEGREE if self.so2[0] < self.so2[1] else 0
        ends = zip((self.blood_fraction, self.blood_fraction, self.so2), degrees, strict=True)
        return [a + (b - a) * (0.5 - 0.5 * np.cos(np.pi * np.arange(n + 1) / (n or 1))) for (a, b), n in ends]

    @property
    def states(self) -> Array:
        """Where a reading must be known, (n, 3): blood of both zones and saturation."""
        return np.array(list(product(*self._nodes)))

    def monomials(self, states: Array) -> Array:
        """Each monomial at states (n, 3), (n, monomials) float."""
        low, high = np.array([self.blood_fraction, self.blood_fraction, self.so2]).T
        scaled = 2 * (states - low) / np.where(high > low, high - low, 1.0) - 1
        return np.asarray(np.prod(scaled[:, None, :] ** np.array(self.exponents)[None], axis=-1))

    @property
    def coefficients(self) -> Array:
        """What makes the coefficients from values in all states, (monomials, states) float: least squares."""
        return np.asarray(np.linalg.pinv(self.monomials(self.states)), float)


@dataclass(frozen=True)
class PairBasis:
    """The piecewise linear functions of a pair of places x and y.

    Of each direction, across the wall or the nail and along it, they know the distance and the middle of the pair; but
    across a wall where x, on the LEDs' side, and y lie.

    across : 0 where u is the axis across, 1 where v is.
    axes : nodes of both coordinates across, then of both along; the last counts fastest. [mm]
    wall_mm : the middle of the wall across, if there is one. leds_below : whether LEDs lie on its lower side.
    """

    across: int
    axes: tuple[Array, Array, Array, Array]
    wall_mm: float | None
    leds_below: bool = False

    @property
    def size(self) -> int:
        """How many functions there are."""
        return math.prod(map(len, self.axes))

    def coordinates(self, x_mm: Array, y_mm: Array) -> tuple[Array, ...]:
        """The four coordinates of pairs of places, (n, 2) each. [mm]"""
        a, b = self.across, 1 - self.across
        distance, middle = np.abs(x_mm - y_mm).T, 0.5 * (x_mm + y_mm).T
        across = (x_mm[:, a], y_mm[:, a]) if self.wall_mm is not None else (distance[a], middle[a])
        return *across, distance[b], middle[b]

    def matrix(self, x_mm: Array, y_mm: Array) -> Any:
        """The functions' values at pairs of places (n, 2) each, sparse (n, size); outside the nodes as at the edge."""
        from scipy.sparse import csr_matrix

        count = len(x_mm)
        at, weight = np.zeros((count, 1), np.int64), np.ones((count, 1))
        for axis, x in zip(self.axes, self.coordinates(x_mm, y_mm), strict=True):
            low = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
            part = np.clip((x - axis[low]) / (axis[low + 1] - axis[low]), 0.0, 1.0)
            at = (at[:, :, None] * len(axis) + np.stack([low, low + 1], -1)[:, None]).reshape(count, 2 * at.shape[1])
            weight = (weight[:, :, None] * np.stack([1 - part, part], -1)[:, None]).reshape(at.shape)
        return csr_matrix((weight.ravel(), at.ravel(), 16 * np.arange(count + 1)), shape=(count, self.size))

    def sample(self) -> tuple[Array, Array, Array]:
        """Pairs of places, as many between any nodes, (n, 2) each, and the area squared that each stands for. [mm]"""
        from scipy.stats import qmc

        columns, volume = [], np.full(PAIRS, 1 / PAIRS)
        for axis, t in zip(self.axes, np.asarray(qmc.Sobol(4, seed=0).random(PAIRS)).T, strict=True):
            cell = np.minimum((t * (len(axis) - 1)).astype(int), len(axis) - 2)
            width = np.diff(axis)[cell]
            columns.append(axis[cell] + (t * (len(axis) - 1) - cell) * width)
            volume = volume * width * (len(axis) - 1)
        x, y = np.zeros((2, PAIRS, 2))
        for k, axis_number in enumerate((self.across, 1 - self.across)):
            first, second = columns[2 * k : 2 * k + 2]
            if k == 1 or self.wall_mm is None:
                # Distance and middle; pairs of either order are alike, and none reaches over the board's edge.
                low, high = self.axes[2 * k + 1][[0, -1]]
                inside = (first / 2 <= second - low) & (first / 2 <= high - second)
                volume, first, second = volume * 2 * inside, second - first / 2, second + first / 2
            x[:, axis_number], y[:, axis_number] = first, second
        return x[volume > 0], y[volume > 0], volume[volume > 0]

    def passed(self, starts_mm: Array, arrivals_mm: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which photons went from one side of the wall to the other, and which of all started on the LEDs' side."""
        if self.wall_mm is None:
            return np.ones(len(starts_mm), bool), np.ones(len(starts_mm), bool)
        starts_first, arrives_first = (
            (places[:, self.across] < self.wall_mm) == self.leds_below for places in (starts_mm, arrivals_mm)
        )
        return starts_first != arrives_first, starts_first


def pair_basis(outline: Rectangle, wall: Rectangle | None) -> PairBasis:
    """The functions for a board, with a wall or without.

    wall : named after the side of the photodiodes on which the LEDs lie, as in a layout.
    """
    across = 0 if wall is None or wall.name in ("left", "right") else 1
    ends = [(outline.u_min, outline.u_max), (outline.v_min, outline.v_max)]
    low, high = ends[across]
    along = _pair_nodes(*ends[1 - across])
    if wall is None:
        return PairBasis(across, (*_pair_nodes(low, high), *along), None)
    faces = (wall.u_min, wall.u_max) if across == 0 else (wall.v_min, wall.v_max)
    below = _nodes(low, faces[0], BESIDE_RIM_MM, BESIDE_WALL_MM)
    above = _nodes(faces[1], high, BESIDE_WALL_MM, BESIDE_RIM_MM)
    leds_below = wall.name in ("left", "below")
    sides = (below, above) if leds_below else (above, below)
    return PairBasis(across, (*sides, *along), sum(faces) / 2, leds_below)


def _pair_nodes(low: float, high: float) -> tuple[Array, Array]:
    """Nodes of a distance and of a middle between two ends. [mm]"""
    distance = np.array([d for d in DISTANCE_MM if d < high - low] + [high - low])
    return distance, np.linspace(low, high, math.ceil((high - low) / MIDDLE_STEP_MM) + 1)


def _nodes(low: float, high: float, first: tuple[float, ...], last: tuple[float, ...]) -> Array:
    """Nodes from one end to the other, dense beside the ends; evenly where there is no room for that."""
    inside = high - low - first[-1] - last[-1]
    if inside < 0.5:
        return np.linspace(low, high, max(2, round((high - low) / 0.5) + 1))
    between = np.linspace(low + first[-1], high - last[-1], math.ceil(inside / BETWEEN_MM) + 1)
    return np.concatenate([low + np.array(first[:-1]), between, high - np.array(last[-2::-1])])


@dataclass(frozen=True)
class RadialFunction:
    """g, a positive function of the distance: exp of a polynomial in its logarithm.

    log_coefficients : (k,) float, the highest power first.
    """

    log_coefficients: Array

    def __call__(self, x_mm: Array, y_mm: Array) -> Array:
        """Its values at pairs of places, (n, 2) each. [mm]"""
        distance = np.maximum(np.hypot(*(x_mm - y_mm).T), NEAREST_MM)
        return np.exp(np.polyval(self.log_coefficients, np.log(distance)))

    @staticmethod
    def of_arrivals(basis: PairBasis, x_mm: Array, y_mm: Array, weight: Array) -> "RadialFunction":
        """How K falls with the distance, by arrivals of such weights per photon and area of its start. [mm^2]"""
        x, y, volume = basis.sample()
        by_chance, distance = (np.maximum(np.hypot(*(a - b).T), NEAREST_MM) for a, b in ((x, y), (x_mm, y_mm)))
        edges = np.geomspace(NEAREST_MM, by_chance.max() * 1.0001, 25)
        both = ((distance, weight), (by_chance, volume))
        light, pairs = (np.histogram(x, edges, weights=weights)[0] for x, weights in both)
        count = np.histogram(distance, edges)[0] * (pairs > 0)
        known, middle = count > 0, np.log(edges[1:] * edges[:-1]) / 2
        fit = np.polyfit(middle[known], np.log(light[known] / pairs[known]), 4, w=np.sqrt(count[known]))
        return RadialFunction(fit)


class PairProjection:
    """Solves for the coefficients of any sums."""

    def __init__(self, basis: PairBasis, radial: RadialFunction) -> None:
        from scipy.sparse import diags

        x, y, volume = basis.sample()
        self.basis, self.moments = basis, 0
        for part in np.array_split(np.arange(len(x)), 16):
            values = basis.matrix(x[part], y[part])
            self.moments = self.moments + values.T @ diags(volume[part] * radial(x[part], y[part])) @ values

    def solve(self, sums: Array, *, weight: float, softer: float = 1.0) -> Array:
        """The coefficients (size, q) of K / g from sums of weights (size, q), per photon and area of its start [mm^2].

        weight : likewise, of a typical arrival; it sets how much the penalty counts.
        softer : so many times is the expected curvature of C larger over the middle along.
        """
        from scipy.sparse import identity, kron
        from scipy.sparse.linalg import splu

        axes = self.basis.axes
        penalty: Any = 0
        for k, axis in enumerate(axes):
            before, after = (math.prod(map(len, part)) for part in (axes[:k], axes[k + 1 :]))
            step, width = np.diff(np.eye(len(axis)), axis=0), np.diff(axis)
            bend = np.diff(step / width[:, None], axis=0) * width.mean()
            # The expected curvature between nodes as a precision.
            precision = LINES / (before * after) / (softer**2 if k == len(axes) - 1 else 1.0)
            axis_penalty = precision * (step.T @ step / DIFFERENCE**2 + bend.T @ bend / BEND**2)
            penalty = penalty + kron(kron(identity(before), axis_penalty), identity(after))
        return np.asarray(splu((self.moments + weight * penalty.tocsc()).tocsc()).solve(sums))
