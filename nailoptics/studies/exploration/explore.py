"""Tables of a board's light from which a page reads any layout at once.

What a photodiode reads of an LED is a function of both their places, of their sizes and turns, of the wavelength, the
blood of two zones and its saturation: some ten numbers. It factors. The light between two places is a smooth kernel
(`light.pair_kernel`) of some 1200 coefficients for each wavelength; integrals over die and photodiode are sums over a
few Gauss points of each; and every coefficient is a polynomial of 31 terms in blood and saturation
(`blood_polynomial`). In half precision that is 0.1 MB for a wavelength, and as much again for the groups of photons
that tell the standard errors. The page so sums 2500 products for a pair of LED and photodiode: microseconds.

Places of LEDs by reciprocity or a grid of traces: both are one here, as photons start all over the board and count both
ways. A grid of LED places 1 mm apart, on the prototype's side of the wall some 60, each to 1 %, would take an hour at
the 61 s that one takes; one trace from each photodiode the other way tells every place of the LED, but only for
photodiodes that stay where they are. The kernel knows pairs of places on the prototype's board, 1.5 to 2.7 mm apart,
to 2 to 5 % by its photons, and farther ones less well, after 130 s for three wavelengths.

What it holds fixed: the outline, the wall, the cover, epoxy and finger; that LEDs are Lambertian and faces flush with
the board's underside. What it leaves out: that a photodiode swallows the few percent that the bare board would send
back, and what lies between the nodes of the kernel; `KERNEL_ERROR` stands for both in readings, `KERNEL_CHANGE_ERROR`
in their change and in the force that they resolve.
"""

import math
import time
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import underside
from ...light import ProgressCallback
from ...light.board_map import Arrivals, BloodPoint, BoardTracer, blood_point
from ...light.pair_kernel import PairBasis, PairProjection, RadialFunction, line_nodes, pair_basis
from ...options import BackendName, Requested, TraceOptions
from ...scene import Led, Scene, digest, to_toml
from ...statistics import seed_of
from ..ambient import SOURCES, photocurrents_a
from ..placement import boards
from ..placement.photon_maps import QUICK_DISTANCE_MM
from ..placement.progress import StageProgress
from .blood_polynomial import BloodPolynomial
from .touch_table import touch_table

Array = NDArray[np.float64]

# Photons of each of the scene's own wavelengths, on a board with a wall, through which little light comes, and without;
# of each further wavelength half as many.
WALL_PHOTONS, OPEN_PHOTONS = 3 << 21, 1 << 21
# Wavelengths that every page offers beside its scene's own, but for those nearer to one of these than this. [nm]
FURTHER_LEDS, SAME_NM = ("led_660", "led_940"), 8.0
# Groups of photons, whose spread tells standard errors.
BLOCKS = 12
# Batches that tell how light falls with the distance, before all are summed; each of so many photons at least.
FIRST_BATCHES, LEAST_BATCH = 4, 1 << 12
AMBIENT_BATCHES = 12
# Relative error of readings by the kernel's nodes and the bare board, rms: what is left on the prototype's board of 16
# readings of two layouts beside traces of their own, once the errors of both by their photons are taken off.
KERNEL_ERROR = 0.03
# Of their change under a touch, rms, in the same way: 16 readings of two kernels of 4.8 million photons each, beside
# traces of their own. A kernel of place alone knows little of where along the nail the two zones of blood meet.
KERNEL_CHANGE_ERROR = 0.25
# The blood at rest can be chosen from half to twice the scene's, the saturation down to here.
BLOOD_RANGE, LEAST_SO2 = (0.5, 2.0), 0.7
FLUENCE_PHOTONS, RING_MM, DEPTH_STEP_MM, FLUENCE_RADIUS_MM, BELOW_BED_MM = 1 << 16, 0.2, 0.1, 10.0, 2.0
# Streams of random numbers.
EVERYWHERE, FLUENCE = 11, 12


@dataclass
class ColourTable:
    """The kernel of one wavelength.

    led : what has this wavelength.
    coefficients : (size, monomials) float. Of the readings' kernel, over blood and saturation. [mm^-2]
    direct : (size,) float. Its part never in the bed, at rest. [mm^-2]
    blocks : (blocks, size, 3) float. By single groups of photons, at rest: readings, their change with either blood.
    fluence : (radius, depth) float. Around a source, per emitted power. [mm^-2]
    """

    led: Led
    coefficients: Array
    direct: Array
    blocks: Array
    fluence: Array
    photons: int


@dataclass
class Exploration:
    """Everything that the page knows.

    scene : the scene with outline, wall and origin spelled out; parts lie where they lay.
    ambient_nodes : (u, v) nodes of the photocurrent by light from outside; ambient_a_per_mm2 : (sources, a, b).
    """

    scene: Scene
    basis: PairBasis
    radial: RadialFunction
    polynomial: BloodPolynomial
    colours: list[ColourTable]
    touch: dict[str, Any]
    ambient_nodes: tuple[Array, Array]
    ambient_a_per_mm2: Array
    attributes: dict[str, Any] = field(default_factory=dict)


def explore(scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]) -> Exploration:
    """Trace what a page needs to show any layout on a finger scene's board.

    photons : of each of the scene's wavelengths; further ones get half as many.
    max_seconds : wall time after which tracing ends with what there is, a few batches of each wavelength. [s]

    Raises: InputError where the scene has no finger, several walls, LEDs that are not Lambertian, or other than two
    blood zones.
    """
    options, cpu = TraceOptions(**requested), time.process_time()
    if options.relative_error is not None:
        raise InputError("explore knows no relative_error, as every layout has its own; give photons or max_seconds.")
    _check(scene)
    base = explored_board(scene)
    layout, bare = base.layout, boards.bare(base)
    basis = pair_basis(layout.outline, layout.barriers[0] if layout.barriers else None)
    touch = touch_table(base)
    polynomial = _polynomial(base, touch)
    sources = colours(base)
    own = len({(led.wavelength_nm, led.fwhm_nm) for led in base.leds})
    usual = options.photons or scene.accuracy.photons or (OPEN_PHOTONS if basis.one_side else WALL_PHOTONS)
    limit = options.max_seconds or scene.accuracy.max_seconds or math.inf
    report = StageProgress(progress, limit)
    tables: list[ColourTable] = []
    first: _Sums | None = None
    for number, led in enumerate(sources):
        lit = bare.model_copy(update={"leds": tuple(_as(die, led) for die in bare.leds)})
        tracer = BoardTracer(lit, backend=options.backend, spacing_mm=QUICK_DISTANCE_MM)
        wanted = usual if number < own else usual // 2
        each = min(tracer.batch_photons, max(LEAST_BATCH, wanted // BLOCKS))
        batches = max(BLOCKS, round(wanted / each))
        sums = _Sums(tracer, each, number, basis, polynomial, options.seed, first.radial if first else None)
        for k in range(batches):
            if k >= BLOCKS and report.is_late((number + 1) / len(sources)):
                break
            sums.trace()
            report(f"{led.wavelength_nm:g} nm", (number + (k + 1) / batches) / len(sources))
        if first is None:
            first, projection = sums, PairProjection(basis, sums.known_radial)
        fluence = _fluence(base, led, seed=seed_of(options.seed, FLUENCE, number), backend=options.backend)
        tables.append(sums.table(led, projection, fluence))
    assert first is not None
    attributes: dict[str, Any] = {"seed": options.seed, "photons": sum(one.photons for one in tables)}
    attributes |= {"backend": tracer.backend.name, "scene": to_toml(scene), "digest": digest(scene)}
    attributes |= {"cpu_seconds": time.process_time() - cpu, "wall_seconds": report.seconds}
    nodes, currents = first.ambient()
    return Exploration(
        base, basis, first.known_radial, polynomial, tables, touch, nodes, currents, attributes=attributes
    )


def _check(scene: Scene) -> None:
    if scene.finger is None:
        raise InputError("explore needs a [finger] scene; a phantom has no board to drag parts on.")
    if len(scene.zone_edges_mm) > 1:
        raise InputError(
            f"blood: explore knows two blood zones, and the scene has {len(scene.zone_edges_mm) + 1}; leave zones out, "
            "or give one edge."
        )
    for i, led in enumerate(scene.leds):
        if led.pattern != "lambertian":
            raise InputError(
                f'leds[{i}].pattern = "{led.pattern}": explore knows Lambertian LEDs alone, whose light goes both '
                'ways; give pattern = "lambertian", or use simulate.'
            )
    if len(scene.layout.barriers) > 1:
        raise InputError(
            "board.barrier: explore knows one wall, and this board has walls on several sides of its photodiodes; put "
            "the LEDs on one side, or set barrier = false."
        )


def explored_board(scene: Scene) -> Scene:
    """The scene on the board that the page shows: `place`'s outline, wall and parts where the scene has them."""
    board, layout, (du, dv) = scene.board, scene.layout, scene.board.center_mm
    if layout.barriers:
        gap_mm = min(-layout.barriers[0].overlap_mm(led) for led in layout.leds)
        board = board.model_copy(update={"barrier_gap_mm": gap_mm})
    base = boards.base_board(scene.model_copy(update={"board": board}))
    cu, cv = base.board.center_mm

    def moved(part: Any) -> Any:
        u, v = part.position_mm
        return part.model_copy(update={"position_mm": (u + du - cu, v + dv - cv)})

    parts = {"leds": tuple(map(moved, base.leds)), "photodiodes": tuple(map(moved, base.photodiodes))}
    base = base.model_copy(update=parts)
    boards.check(base, "explore")
    return base


def colours(base: Scene) -> list[Led]:
    """An LED of each wavelength that the page knows: the scene's own first, then further ones."""
    found = list({(led.wavelength_nm, led.fwhm_nm): led for led in base.leds}.values())
    for part in FURTHER_LEDS:
        led = Led.model_validate({"name": part, "part": part})
        if all(abs(led.wavelength_nm - other.wavelength_nm) >= SAME_NM for other in found):
            found.append(led)
    return found


def _as(die: Led, led: Led) -> Led:
    """A die with the light of an LED."""
    return die.model_copy(update={name: getattr(led, name) for name in ("part", "wavelength_nm", "fwhm_nm")})


def _polynomial(base: Scene, touch: dict[str, Any]) -> BloodPolynomial:
    # What is venous depends on the blood at rest, so that there is none to choose.
    most = BLOOD_RANGE[1] if base.blood.venous_so2 is None else 1.0
    highest = min(1.0, most * base.blood.rest_blood_fraction * float(np.max(touch["blood"])))
    return BloodPolynomial((0.0, highest), (min(LEAST_SO2, base.blood.so2), 1.0))


class _Sums:
    """Arrivals of one wavelength summed over the kernel's functions, batch by batch."""

    def __init__(
        self,
        tracer: BoardTracer,
        photons: int,
        number: int,
        basis: PairBasis,
        polynomial: BloodPolynomial,
        seed: int,
        radial: RadialFunction | None,
    ) -> None:
        """photons : in a batch. number : of the wavelength. radial : g; found from the first batches if not given."""
        self.photons, self.tracer, self.number, self.seed = photons, tracer, number, seed
        self.basis, self.polynomial = basis, polynomial
        self.radial = radial
        self.rest = blood_point(tracer.scene, 0)
        self.points = [_state_point(tracer.scene, *map(float, state)) for state in polynomial.states]
        self.waiting: list[tuple[int, Array, Array, Array]] = []
        self.batches = 0
        self.mean = np.zeros((basis.size, len(polynomial.exponents) + 1))
        self.blocks = np.zeros((BLOCKS, basis.size, 3))
        self.block_batches = np.zeros(BLOCKS)
        self.left: list[tuple[Array, Arrivals]] = []

    @property
    def known_radial(self) -> RadialFunction:
        """g, once it is known."""
        assert self.radial is not None
        return self.radial

    def trace(self) -> None:
        """Trace one batch more."""
        seed = seed_of(self.seed, EVERYWHERE, self.number, self.batches)
        starts, arrived, left = self.tracer.everywhere(0, photons=self.photons, seed=seed)
        went, x, y = self.basis.between(starts[arrived.photon], arrived.place_mm)
        columns = (getattr(arrived, name)[went] for name in ("photon", "place_mm", "weight", "path_mm"))
        self.waiting.append((self.batches % BLOCKS, x, y, self._values(Arrivals(arrived.photons, *columns))))
        if self.number == 0 and self.batches < AMBIENT_BATCHES:
            self.left.append((starts[left.photon], left))
        self.batches += 1
        if self.radial is None and self.batches == FIRST_BATCHES:
            xs, ys, values = (np.concatenate([one[k] for one in self.waiting]) for k in (1, 2, 3))
            self.radial = RadialFunction.of_arrivals(self.basis, xs, ys, values[:, 0])
        if self.radial is not None:
            for block, x, y, values in self.waiting:
                sums = self.basis.sums(x, y, values)
                self.mean += sums[:, [*range(4, values.shape[1]), 1]]
                self.blocks[block] += sums[:, [0, 2, 3]]
                self.block_batches[block] += 1
            self.waiting = []

    def _values(self, arrivals: Arrivals) -> Array:
        """What each arrival adds: at rest to the reading, its direct part, both derivatives; then to each monomial."""
        rest = self.rest.values(arrivals)
        states = np.stack([point.values(arrivals)[:, 0] for point in self.points], -1)
        return np.column_stack([rest, states @ self.polynomial.coefficients.T])

    def table(self, led: Led, projection: PairProjection, fluence: Array) -> ColourTable:
        """The kernel from all that was summed."""
        per_batch = self.photons / underside(self.tracer.tracer.geometry).area_mm2
        mean = projection.solve(self.mean / (self.batches * per_batch))
        columns = self.blocks.transpose(1, 0, 2) / (self.block_batches * per_batch)[:, None]
        blocks = projection.solve(columns.reshape(self.basis.size, -1)).reshape(columns.shape)
        photons = self.batches * self.photons
        return ColourTable(led, mean[:, :-1], mean[:, -1], blocks.transpose(1, 0, 2), fluence, photons)

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


def fluence_edges(scene: Scene) -> tuple[Array, Array]:
    """Edges of the rings and of the depths on which the fluence is told. [mm]"""
    assert scene.finger is not None
    deepest = scene.finger.nail_thickness_mm + scene.finger.bed_thickness_mm + BELOW_BED_MM
    return np.arange(0.0, FLUENCE_RADIUS_MM + RING_MM / 2, RING_MM), np.arange(0.0, deepest, DEPTH_STEP_MM)


def _fluence(base: Scene, led: Led, *, seed: int, backend: BackendName) -> Array:
    """How the light of a die in the middle of a board without a wall spreads, (radius, depth) float. [mm^-2]"""
    board = base.board.model_copy(update={"barrier": False, "barrier_gap_mm": None})
    die = _as(base.leds[0], led).model_copy(update={"position_mm": (0.0, 0.0), "rotation_deg": 0.0})
    scene = boards.bare(base.model_copy(update={"board": board, "leds": (die,)}))
    tracer = BoardTracer(scene, backend=backend, spacing_mm=QUICK_DISTANCE_MM)
    return tracer.fluence(0, *fluence_edges(base), photons=FLUENCE_PHOTONS, seed=seed)
