"""What blood makes of a reading, as a part of the reading at rest: smooth over pairs of places, by regression.

The mean, over the photons of a pair of places, of what absorption makes of each of them depends on how far both places
lie apart, on where along the nail their middle lies from the edge at which the zones of blood meet, and little on where
it lies across. So it is found by regression: with w a photon's weight at rest, r what a state makes of it and B
functions of its pair, t minimises

    sum of w (r - B t)^2 + curvature,

where curvature joins nodes that few photons tell of to those beside them.

The finger is alike along the nail: what a photon does at an edge of the zones it would have done at an edge elsewhere.
So light is traced with several edges, and each photon counts at the distance of its pair from each of them.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...light.board_map import Arrivals
from ...light.pair_kernel import PairBasis, node_products
from ...scene import Scene

Array = NDArray[np.float64]

# Degrees in the blood of both zones together, in the saturation, and in all.
BLOOD_DEGREE, SO2_DEGREE, DEGREE = 4, 2, 4


@dataclass(frozen=True)
class BloodPolynomial:
    """Polynomials in the blood of both zones and the saturation, over a box of states.

    blood_fraction, so2 : lowest and highest of the box.
    """

    blood_fraction: tuple[float, float]
    so2: tuple[float, float]

    @property
    def exponents(self) -> list[tuple[int, int, int]]:
        """Exponents of both zones' blood and of the saturation in each monomial, all scaled to -1 to 1."""
        blood, so2 = range(BLOOD_DEGREE + 1), range(SO2_DEGREE + 1)
        return [e for e in product(blood, blood, so2) if e[0] + e[1] <= BLOOD_DEGREE and sum(e) <= DEGREE]

    @property
    def states(self) -> Array:
        """Where a reading must be known, (n, 3): blood of both zones and saturation, denser towards the box's faces."""
        blood, so2 = (
            low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))
            for (low, high), count in ((self.blood_fraction, BLOOD_DEGREE + 1), (self.so2, SO2_DEGREE + 1))
        )
        return np.array(list(product(blood, blood, so2)))

    def monomials(self, states: Array) -> Array:
        """Each monomial at states (n, 3), (n, monomials) float."""
        bounds = np.array([self.blood_fraction, self.blood_fraction, self.so2])
        scaled = 2 * (states - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0]) - 1
        powers = np.array(self.exponents)
        return np.asarray(np.prod(scaled[:, None, :] ** powers[None], axis=-1))

    @property
    def coefficients(self) -> Array:
        """What makes the coefficients from values in all states, (monomials, states) float: least squares."""
        return np.asarray(np.linalg.pinv(self.monomials(self.states)), float)


# Nodes of how far a pair lies apart across and along the nail; the board's size is the last. [mm]
APART_MM = (0.0, 0.5, 0.9, 1.3, 1.7, 2.2, 2.8, 3.6, 5.0, 7.0)
# Nodes of its middle along the nail, from the zones' edge to either side. [mm]
FROM_EDGE_MM = (0.0, 0.7, 1.5, 2.5, 4.0, 6.0)
# Nodes of its middle across: so far to either side of the wall, or of the nail's middle. [mm]
BESIDE_WALL_MM, BESIDE_MIDDLE_MM = 1.5, 3.0
# Edges of the zones that light is traced with lie so far apart or more, and so far from the ends of the nail. [mm]
EDGES_APART_MM, FROM_END_MM = 2.0, 1.5
# How many photons the curvature between nodes, and their differences, weigh as much as.
CURVATURE_PHOTONS, DIFFERENCE_PHOTONS = 0.1, 0.005


@dataclass(frozen=True)
class RatioBasis:
    """Piecewise linear functions of a pair of places.

    apart_u_mm, apart_v_mm : nodes of the distances across and along the nail. [mm]
    from_edge_mm, middle_u_mm : nodes of the middle, along from the edge of the zones, and across. [mm]
    """

    apart_u_mm: Array
    apart_v_mm: Array
    from_edge_mm: Array
    middle_u_mm: Array

    @property
    def axes(self) -> tuple[Array, ...]:
        """The nodes, the last counting fastest."""
        return self.apart_u_mm, self.apart_v_mm, self.from_edge_mm, self.middle_u_mm

    @property
    def size(self) -> int:
        """How many functions there are."""
        return int(np.prod([len(axis) for axis in self.axes]))

    def matrix(self, x_mm: Array, y_mm: Array, edge_mm: float) -> Any:
        """The functions' values at pairs of places where the zones meet at v = edge_mm, sparse (n, size)."""
        from scipy.sparse import csr_matrix

        apart, middle = np.abs(x_mm - y_mm), 0.5 * (x_mm + y_mm)
        at, value = node_products(self.axes, (*apart.T, middle[:, 1] - edge_mm, middle[:, 0]))
        ends = at.shape[1] * np.arange(len(at) + 1)
        return csr_matrix((value.ravel(), at.ravel(), ends), shape=(len(at), self.size))

    @cached_property
    def curvature(self) -> Any:
        """The curvature between nodes, weighed in photons, sparse (size, size)."""
        from scipy.sparse import identity, kron

        total: Any = 0
        for k, axis in enumerate(self.axes):
            before, after = (int(np.prod([len(one) for one in part])) for part in (self.axes[:k], self.axes[k + 1 :]))
            total = total + kron(kron(identity(before), _roughness(axis)), identity(after))
        return total.tocsc()


def _roughness(axis: Array) -> Array:
    """The square of what values at an axis' nodes differ, from neighbours and from a straight line, (n, n)."""
    step = np.diff(np.eye(len(axis)), axis=0)
    width = np.diff(axis)
    bend = np.diff(step / width[:, None], axis=0) * width.mean()
    return np.asarray(DIFFERENCE_PHOTONS * step.T @ step + CURVATURE_PHOTONS * bend.T @ bend)


def ratio_basis(basis: PairBasis) -> RatioBasis:
    """The functions for the board of a kernel's."""
    first, second, along = basis.first_mm, basis.second_mm, basis.coarse_along_mm
    across = np.array([min(first[0], second[0]), max(first[-1], second[-1])])
    ends = (across, along[[0, -1]]) if basis.across == 0 else (along[[0, -1]], across)
    apart_u, apart_v = (np.array([d for d in APART_MM if d < high - low] + [high - low]) for low, high in ends)
    middle, beside = ends[0].mean(), BESIDE_MIDDLE_MM
    if not basis.one_side and basis.across == 0:
        facing = (first[-1], second[0]) if first[0] < second[0] else (second[-1], first[0])
        middle, beside = sum(facing) / 2, BESIDE_WALL_MM
    from_edge = np.array(FROM_EDGE_MM)
    return RatioBasis(
        apart_u, apart_v, np.concatenate([-from_edge[:0:-1], from_edge]), middle + beside * np.array([-1.0, 0.0, 1.0])
    )


def traced_edges_mm(scene: Scene, basis: PairBasis) -> tuple[float, ...]:
    """Where along the nail zones meet in what is traced: at the scene's edge and, beside a wall along the nail, all
    along it, since few photons pass a wall.

    Without a wall there are photons enough, and light near a board's ends differs; a wall across the nail lets nothing
    be alike along it.
    """
    assert scene.finger is not None
    edge, step = scene.zone_edges_mm[0], max(EDGES_APART_MM, scene.zone_width_mm)
    if basis.one_side or basis.across == 1:
        return (edge,)
    reach = scene.finger.nail_length_mm / 2 - FROM_END_MM
    steps = range(-int((reach + edge) // step), int((reach - edge) // step) + 1)
    return tuple(edge + step * k for k in sorted({0, *steps}))


def at_edge(arrivals: Arrivals, beds: tuple[int, ...], edge: int) -> Arrivals:
    """Arrivals whose paths are those in the two zones on either side of one edge.

    beds : columns of the traced zones, one after the other. edge : which of theirs.
    """
    path, first = arrivals.path_mm, beds[0]
    zones = path[:, first : first + len(beds)]
    both = zones[:, : edge + 1].sum(1), zones[:, edge + 1 :].sum(1)
    paths = np.column_stack([path[:, :first], *both, path[:, first + len(beds) :]])
    return Arrivals(arrivals.photons, arrivals.photon, arrivals.place_mm, arrivals.weight, paths)


class RatioSums:
    """Sums over photons from which the ratios are solved, in blocks of photons."""

    def __init__(self, basis: RatioBasis, *, blocks: int, columns: int) -> None:
        self.basis, self.weight = basis, 0.0
        self.products: list[Any] = [0.0] * blocks
        self.sums = np.zeros((blocks, basis.size, columns))

    def add(self, block: int, x_mm: Array, y_mm: Array, edge_mm: float, values: Array) -> None:
        """Add pairs of places where the zones meet at an edge.

        values : (n, 1 + columns) float. Weights at rest, and what each column makes of them.
        """
        from scipy.sparse import diags

        # So that a photon counts about 1, as in what curvature weighs.
        self.weight = self.weight or float(values[:, 0].mean())
        matrix, scaled = self.basis.matrix(x_mm, y_mm, edge_mm), values / self.weight
        self.products[block] = self.products[block] + matrix.T @ diags(scaled[:, 0]) @ matrix
        self.sums[block] += matrix.T @ scaled[:, 1:]

    def solve(self, by_block: list[int]) -> tuple[Array, Array]:
        """The ratios (size, columns), and some columns as single blocks of photons would have them, (blocks, size, n).

        by_block : which columns. A block moves the solution in proportion to what is left of its photons.
        """
        from scipy.sparse.linalg import splu

        factors = splu((sum(self.products) + self.basis.curvature).tocsc())
        found = np.asarray(factors.solve(self.sums.sum(0)))
        chosen = found[:, by_block]
        left = [sums[:, by_block] - product @ chosen for sums, product in zip(self.sums, self.products, strict=True)]
        moved = np.stack([factors.solve(one) for one in left])
        return found, chosen + len(left) * (moved - moved.mean(0))
