"""The table of one wavelength: light between places of the board, and what blood makes of it, summed batch by batch."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...geometry import underside
from ...light import optics
from ...light.board_map import Arrivals, BloodPoint, BoardTracer, blood_point
from ...light.pair_kernel import PairBasis, PairProjection, RadialFunction, line_nodes
from ...light.transfer.reweight import transmissions
from ...options import BackendName
from ...scene import Led, Scene
from ...sensor.ambient import SOURCES, photocurrents_a
from ...statistics import seed_of
from .blood_ratio import BloodPolynomial, RatioSums, at_edge, ratio_basis, traced_edges_mm

Array = NDArray[np.float64]

# Groups of photons, whose spread tells standard errors.
BLOCKS = 12
# Batches that tell how light falls with the distance, before all are summed.
FIRST_BATCHES = 4
AMBIENT_BATCHES = 12
# Cells of the distances that the walk asks for: a second more to make than the usual ones, 5 % less to walk. [mm]
DISTANCE_MM = 0.1
# How densely photons start at these distances from a wall. [mm] Of those from within 1 mm of the prototype's one in 20
# passes it, of those from 3 mm one in 200.
FROM_WALL_MM, DENSITY = (1.5, 3.0), (1.0, 0.35)
# Stream of random numbers.
EVERYWHERE = 11


@dataclass(frozen=True)
class NearWall:
    """Photons start more densely beside a wall along the nail, because few of those from afar pass it.

    middle_mm : Its place across the nail. [mm]
    """

    middle_mm: float

    def __call__(self, places_mm: Array) -> Array:
        """How densely photons start at places (n, 2), (n,) float. [mm]"""
        return np.interp(np.abs(places_mm[:, 0] - self.middle_mm), FROM_WALL_MM, DENSITY)


@dataclass
class ColourTable:
    """What is known of one wavelength.

    led : what has this wavelength.
    coefficients : (size,) float. Of the readings' kernel at rest. [mm^-2]
    direct : (size,) float. Its part never in the bed. [mm^-2]
    blocks : (blocks, size) float. The kernel by single groups of photons. [mm^-2]
    ratios : (ratio size, monomials) float. Parts of the reading at rest, over blood and saturation.
    ratio_blocks : (blocks, ratio size, 2) float. Their change with either blood at rest, by single groups of photons.
    fluence : (radius, depth) float. Around a source, per emitted power. [mm^-2]
    """

    led: Led
    coefficients: Array
    direct: Array
    blocks: Array
    ratios: Array
    ratio_blocks: Array
    fluence: Array
    photons: int


class ColourSums:
    """Arrivals of one wavelength summed over the functions of a pair of places, batch by batch."""

    def __init__(
        self,
        lit: Scene,
        number: int,
        basis: PairBasis,
        polynomial: BloodPolynomial,
        *,
        backend: BackendName,
        seed: int,
        radial: RadialFunction | None,
    ) -> None:
        """lit : the bare board. number : of the wavelength. radial : g; found from the first batches if not given."""
        self.number, self.seed, self.basis, self.polynomial, self.radial = number, seed, basis, polynomial, radial
        self.edges_mm = traced_edges_mm(lit, basis)
        walls = lit.layout.barriers if basis.across == 0 else ()
        self.density = NearWall(float(np.mean([walls[0].u_min, walls[0].u_max]))) if walls else None
        self.tracer = BoardTracer(_with_edges(lit, self.edges_mm), backend=backend, spacing_mm=DISTANCE_MM)
        self.beds = optics.bed_columns(self.tracer.scene)
        two = _with_edges(lit, lit.zone_edges_mm)
        self.rest = blood_point(two, 0)
        self.points = [_state_point(two, *map(float, state)) for state in polynomial.states]
        self.batches = self.photons = 0
        self.waiting: list[tuple[int, Array, Array, list[Array]]] = []
        self.mean = np.zeros((basis.size, 2))
        self.blocks = np.zeros((BLOCKS, basis.size))
        self.block_photons = np.zeros(BLOCKS)
        self.ratios = RatioSums(ratio_basis(basis), blocks=BLOCKS, columns=len(polynomial.exponents) + 2)
        self.left: list[tuple[Array, Arrivals]] = []

    @property
    def known_radial(self) -> RadialFunction:
        """g, once it is known."""
        assert self.radial is not None
        return self.radial

    def trace(self, photons: int) -> None:
        """Trace one batch more."""
        seed = seed_of(self.seed, EVERYWHERE, self.number, self.batches)
        starts, arrived, sent, left = self.tracer.everywhere(0, photons=photons, seed=seed, density=self.density)
        went, forth, x, y = self.basis.between(starts[arrived.photon], arrived.place_mm)
        block = self.batches % BLOCKS
        # With a wall one end is the photodiode's, without one either.
        weights: tuple[Array, ...] = (arrived.weight[went], sent.weight[went])
        if self.density is not None:
            # Light between two places is estimated from photons of either, in proportion to how many there are.
            here, there = (self.density(places) for places in (starts[arrived.photon[went]], arrived.place_mm[went]))
            weights = tuple(weight * (2 * here / (here + there)) for weight in weights)
        ways = weights if self.basis.one_side else (np.where(forth, *weights),)
        at_rest = self._add_ratios(block, x, y, arrived.select(went), ways)
        self.waiting.append((block, x, y, at_rest))
        if self.number == 0 and self.batches < AMBIENT_BATCHES:
            self.left.append((starts[left.photon], left))
        self.batches += 1
        self.photons += photons
        self.block_photons[block] += photons
        if self.radial is None and self.batches == FIRST_BATCHES:
            xs, ys = (np.concatenate([one[k] for one in self.waiting]) for k in (1, 2))
            readings = np.concatenate([one[3][0][:, 0] for one in self.waiting])
            self.radial = RadialFunction.of_arrivals(self.basis, xs, ys, readings)
        if self.radial is not None:
            for block, x, y, values in self.waiting:
                sums = self.basis.sums(x, y, *values)
                self.mean += sums
                self.blocks[block] += sums[:, 0]
            self.waiting = []

    def _add_ratios(self, block: int, x: Array, y: Array, arrivals: Arrivals, ways: tuple[Array, ...]) -> list[Array]:
        """Add what blood makes of arrivals, whose weights are (n,) for each way that they go.

        Returns: of each way the readings at rest and their part never in the bed, (n, 2).
        """
        rest = at_edge(arrivals, self.beds, 0)
        at_rest = [self.rest.values(replace(rest, weight=weight))[:, :2] for weight in ways]
        arrivals = replace(arrivals, weight=np.mean(ways, axis=0))
        for edge, edge_mm in enumerate(self.edges_mm):
            self.ratios.add(block, x, y, edge_mm, self._values(at_edge(arrivals, self.beds, edge)))
        return at_rest

    def _values(self, arrivals: Arrivals) -> Array:
        """What each arrival adds: to the reading at rest, to each monomial, and to the change with either blood."""
        rest = self.rest.values(arrivals)
        path, mu_a = arrivals.path_mm, self.points[0].traced
        states = transmissions(path, np.stack([point.mu_a for point in self.points]) - mu_a, self.points[0].share)
        states *= arrivals.weight[:, None]
        return np.column_stack([rest[:, 0], states @ self.polynomial.coefficients.T, rest[:, 2:]])

    def table(self, led: Led, projection: PairProjection, fluence: Array) -> ColourTable:
        """The tables from all that was summed."""
        area_mm2 = underside(self.tracer.tracer.geometry).area_mm2
        mean = projection.solve(self.mean * (area_mm2 / self.photons))
        blocks = projection.solve(self.blocks.T * (area_mm2 / self.block_photons))
        count = len(self.polynomial.exponents)
        ratios, ratio_blocks = self.ratios.solve([count, count + 1])
        return ColourTable(
            led, mean[:, 0], mean[:, 1], blocks.T, ratios[:, :count], ratio_blocks, fluence, self.photons
        )

    def ambient(self) -> tuple[tuple[Array, Array], Array]:
        """Nodes (u, v) where photodiodes may lie, and the photocurrent there by light from outside, per area.

        Returns: (a,), (b,) float [mm], and (sources, a, b) float [A/mm^2].
        """
        scene, basis = self.tracer.scene, self.basis
        axes = (basis.second_mm, basis.coarse_along_mm)[:: 1 if basis.across == 0 else -1]
        grid = tuple(len(axis) for axis in axes)
        area, emitted = underside(self.tracer.tracer.geometry).area_mm2, len(self.left)
        total = np.zeros((len(SOURCES), *grid))
        for starts, left in self.left:
            inside = np.all([(x >= axis[0]) & (x <= axis[-1]) for x, axis in zip(starts.T, axes, strict=True)], axis=0)
            (i, a), (j, b) = (line_nodes(axis, x[inside]) for axis, x in zip(axes, starts.T, strict=True))
            for k, source in enumerate(SOURCES):
                nm, diode = scene.leds[0].wavelength_nm, scene.layout.photodiodes[0].photodiode
                each = photocurrents_a(left, scene, source, traced_nm=nm, photodiode=diode, area_mm2=area)[inside]
                weight = each[:, None, None] * a[:, :, None] * b[:, None, :]
                np.add.at(total[k], (i[:, :, None], j[:, None, :]), weight / emitted)
        mass = [_hat_products(axis) for axis in axes]
        current = np.einsum("ai,bj,sij->sab", np.linalg.inv(mass[0]), np.linalg.inv(mass[1]), total)
        return (axes[0], axes[1]), np.maximum(current, 0.0)


def _with_edges(scene: Scene, edges_mm: tuple[float, ...]) -> Scene:
    """The scene with the blood's zones meeting at some edges."""
    zones = {"zones": None, "zone_edges_mm": edges_mm, "zone_width_mm": scene.zone_width_mm}
    return scene.model_copy(update={"blood": scene.blood.model_copy(update=zones)})


def _hat_products(axis: Array) -> Array:
    """Integrals of the products of the hats on an axis, (n, n) float. [mm]"""
    width = np.diff(axis)
    matrix = np.diag(np.concatenate([[0.0], width]) + np.concatenate([width, [0.0]])) / 3
    return matrix + (np.diag(width, 1) + np.diag(width, -1)) / 6


def _state_point(scene: Scene, one: float, two: float, so2: float) -> BloodPoint:
    """The absorption of a blood state; venous blood stays as far below arterial as in the scene."""
    venous = scene.blood.venous_so2
    below = None if venous is None else max(0.0, so2 - (scene.blood.so2 - venous))
    blood = scene.blood.model_copy(update={"so2": so2, "venous_so2": below})
    state = scene.model_copy(update={"blood": blood})
    return blood_point(state, 0, traced=scene, blood_fraction=[one, two])
