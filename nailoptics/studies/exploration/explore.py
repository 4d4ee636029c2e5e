"""A table of a board's light from which a page reads any layout at once.

What a photodiode reads of an LED depends on both their places, sizes and turns, on the wavelength, the blood of two
zones and its saturation. The light between two places is a table of some 5000 coefficients for each wavelength
(`pair_table`), each a polynomial of 31 terms in blood and saturation; integrals over die and photodiode are sums over a
few Gauss points of each. Photon maps of a grid of LED places would need more light: on the prototype's board 200 000
photons of one place, 5 s of processor time, give its eight readings to 3-4 %, and a grid 1.5 mm apart has 30 places on
the LEDs' side of the wall alone.

Held fixed: the outline, the wall, the cover, epoxy and finger; LEDs are Lambertian and faces flush with the board's
underside. Left out: that a photodiode absorbs the few percent that the bare board would reflect, and what lies between
the nodes; `KERNEL_ERROR` stands for both in readings, `KERNEL_CHANGE_ERROR` in their change.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, TypeAlias, Unpack

import numpy as np
import xarray as xr

from ...display import Displayed
from ...errors import InputError, as_far_as_reached, unless_cut_off
from ...geometry import underside
from ...hemodynamics.touch import largest_force_n
from ...light import ProgressCallback, optics
from ...light.backend import choose_jit
from ...light.board_map import Arrivals, BloodPoint, BoardTracer, blood_point
from ...light.identity import light_scene
from ...light.tracing import Ending, StageProgress, run_until
from ...light.tracing.store import CODE, LightStore, cache_key, load_or_compute, program_digest
from ...light.transfer.records import transmissions
from ...options import Requested, TraceOptions
from ...scene import Led, Scene, SceneIn, as_scene, digest, to_toml
from ...sensor.ambient import INSIDE_NM, SOURCES, photocurrent_a_per_mm2
from ...sensor.information import PRIOR_PA, PhysiologicalNoise, operating_point
from ...statistics import Array, seed_of
from ...variables import stacked_rows, stopwatch
from ..placement import boards, candidates
from .drawn_people import DrawnPerson, ranked_people
from .pair_table import ZONES, BloodPolynomial, PairBasis, PairProjection, RadialFunction, pair_basis

# Photons of each of the scene's own wavelengths, on a board with a wall, through which little light comes, and without;
# of each further wavelength half as many.
WALL_PHOTONS, OPEN_PHOTONS = 5 << 20, 1 << 21
# Wavelengths that every page offers beside its scene's own, but for those nearer to one of these than this. [nm]
FURTHER_LEDS, SAME_NM = ("led_660", "led_940"), 8.0
# Groups of photons, whose scatter gives standard errors; photons of their first batches, of which each later one has
# twice as many; and of the pilot from which the fall with the distance is fitted.
BLOCKS, LEAST_BATCH, PILOT_PHOTONS = 12, 1 << 12, 1 << 18
# What a batch, and a wavelength's table in the end, take beside the batch's photons, in photons of the same time.
PER_BATCH, PER_TABLE = 6e3, 1e6
# Relative error of readings by the table's nodes and the bare board, rms, and of their change under a touch, in parts
# of what either zone's blood changes by itself, added up; the photons' errors are taken off. Readings: squares of 0.5
# and 1 mm beside three places of the LED of the prototype and of placement.toml, with its wall and without, 0 to 3 % in
# 850 of them. Changes: 27 photodiodes of the two scenes, through a healthy nail.
KERNEL_ERROR, KERNEL_CHANGE_ERROR = 0.03, 0.12
# The blood at rest can be chosen from half to twice the scene's, the saturation down to here.
BLOOD_RANGE, LEAST_SO2 = (0.5, 2.0), 0.7
# Nodes of the ambient light's table lie no farther apart than this. [mm]
AMBIENT_STEP_MM = 1.0
# Photons of the fluence around a source.
FLUENCE_PHOTONS = 1 << 16
# The scene as it is, then on people's fingers, each with the polynomial over its blood.
Fingers: TypeAlias = list[tuple[Scene, BloodPolynomial]]
# Streams of random numbers.
EVERYWHERE, FLUENCE, PILOT, RANKING = 11, 12, 13, 14
# The degree of polynomials over the blood of people, whose saturation is their own and whose blood at rest, too.
PERSON_DEGREE = 3


@dataclass
class WavelengthTable:
    """What is known of one wavelength.

    led : what has this wavelength.
    coefficients : (size, monomials) float. The kernel over g, over blood and saturation.
    direct : (size,) float. Its part never in the bed, at rest.
    blocks : (blocks, size, 3) float. At rest the kernel and its change with either blood, by single groups of photons.
    fluence : (radius_mm, depth_mm) float. Around a source amid the board without its wall, per power. [mm^-2]
    people : (people, size, monomials) float. The kernel of each of the people, over blood.
    """

    led: Led
    coefficients: Array
    direct: Array
    blocks: Array
    fluence: xr.DataArray
    photons: int
    people: Array


@dataclass(repr=False)
class Exploration(Displayed):
    """Everything that the page knows.

    scene : the scene with outline, wall and origin spelled out; parts lie where they lay.
    ambient_nodes : (u, v) nodes of the photocurrent by light from outside, where photodiodes can lie.
    ambient_a_per_mm2 : (sources, blocks, a, b), by single groups of photons.
    """

    scene: Scene
    basis: PairBasis
    radial: RadialFunction
    polynomial: BloodPolynomial
    wavelengths: list[WavelengthTable]
    touch: dict[str, Any]
    ambient_nodes: tuple[Array, Array]
    ambient_a_per_mm2: Array
    people: list[DrawnPerson]
    attributes: dict[str, Any] = field(default_factory=dict)


class WavelengthSums:
    """Arrivals of one wavelength summed over the functions of a pair of places."""

    def __init__(self, lit: Scene, tracer: BoardTracer, number: int, basis: PairBasis, fingers: Fingers) -> None:
        """lit : the bare board. number : of the wavelength."""
        self.lit, self.tracer, self.number, self.basis, self.seed = lit, tracer, number, basis, tracer.seed
        self.rest, self.fingers, self.points = blood_point(lit, 0), fingers, list[list[BloodPoint]]()
        for worn, polynomial in fingers:
            on = [{"finger": worn.finger, "blood": worn.blood.with_so2(so2)} for *_, so2 in polynomial.states]
            states = zip(on, polynomial.states[:, :2], strict=True)
            self.points.append([blood_point(lit.model_copy(update=one), 0, blood_fraction=b) for one, b in states])
        self.first = np.cumsum([0, *(len(polynomial.exponents) for _, polynomial in fingers)])
        self.sums = np.zeros((basis.size, self.first[-1] + 1))
        self.blocks, self.photons = np.zeros((BLOCKS, basis.size, 3)), np.zeros(BLOCKS)
        self.weight = self.arrivals = 0.0
        r = lit.layout.outline
        ends = [(r.u_min, r.u_max), (r.v_min, r.v_max)]
        if basis.wall_mm is not None:
            ends[basis.across] = basis.axes[1][0], basis.axes[1][-1]
        u, v = (np.linspace(a, b, math.ceil((b - a) / AMBIENT_STEP_MM) + 1) for a, b in ends)
        self.ambient_nodes = u, v
        self.ambient_a = np.zeros((len(SOURCES), BLOCKS, *map(len, self.ambient_nodes)))

    @property
    def area_mm2(self) -> float:
        """Area on which photons start. [mm^2]"""
        return underside(self.tracer.tracer.geometry).area_mm2

    def traced(self, photons: int, *seed: int) -> tuple[Arrivals, Array, Array, Arrivals]:
        """Photons that start anywhere: light between LEDs' places x and photodiodes' y; and light that leaves, with
        the place where it started."""
        starts, arrived, back, left = self.tracer.everywhere(photons=photons, seed=seed_of(self.seed, *seed))
        begin, end = starts[arrived.photon], arrived.place_mm
        passed, forth = self.basis.passed(begin, end)
        x, y = np.where(forth[:, None], begin, end)[passed], np.where(forth[:, None], end, begin)[passed]
        # Both ways are the same K: without a wall either end may be the photodiode, with one it is y.
        ways = np.where(forth, arrived.weight, back.weight), np.where(forth, back.weight, arrived.weight)
        weight = 0.5 * (ways[0] + ways[1] if self.basis.wall_mm is None else ways[0])
        left = replace(left, place_mm=starts[left.photon])
        return replace(arrived, weight=weight).select(passed), x, y, left

    def add(self, block: int, photons: int) -> None:
        """Trace one batch more for one group of photons."""
        arrivals, x, y, left = self.traced(photons, EVERYWHERE, self.number, block, int(self.photons[block]))
        functions, values = self.basis.matrix(x, y).T, self._values(arrivals)
        self.sums += functions @ values[:, :-3]
        self.blocks[block] += functions @ values[:, -3:]
        self.weight, self.arrivals = self.weight + arrivals.weight.sum(), self.arrivals + len(x)
        self.photons[block] += photons
        if self.number == 0:
            self._add_ambient(block, left)

    def _values(self, arrivals: Arrivals) -> Array:
        """What each arrival adds: to each monomial, to the direct part, to the reading at rest and its two changes."""
        rest, columns = self.rest.values(arrivals), list[Array]()
        for points, (_, polynomial) in zip(self.points, self.fingers, strict=True):
            mu_a = np.stack([point.mu_a for point in points]) - arrivals.mu_a
            states = transmissions(arrivals.path_mm, mu_a, points[0].share) * arrivals.weight[:, None]
            columns.append(states @ polynomial.coefficients.T)
        return np.column_stack([*columns, rest[:, [1, 0]], rest[:, 2:]])

    def table(self, projection: PairProjection) -> dict[str, Any]:
        """Fields of the `WavelengthTable` from all that was summed."""
        per_photon, first = self.area_mm2 / self.photons.sum(), self.first[:-1]
        weight = self.weight / self.arrivals * per_photon
        blocks = self.blocks * (self.area_mm2 / self.photons)[:, None, None]
        changes, direct = self.sums[:, :-1] * per_photon, self.sums[:, -1] * per_photon
        # The readings at rest, and beside them what blood changes, of which the first monomial is constant.
        rest = []
        for columns, (worn, polynomial) in zip(np.split(changes, first[1:], axis=1), self.fingers, strict=True):
            zone = worn.blood.rest_blood_fraction
            rest.append(columns @ polynomial.monomials(np.array([[zone, zone, worn.blood.so2]]))[0])
        at_rest = projection.solve(np.column_stack([*rest, direct, blocks[..., 0].T]), weight=weight)
        changes[:, first] -= np.transpose(rest)
        changes = projection.solve(np.column_stack([changes, *blocks[..., 1:]]), weight=weight, softer=ZONES)
        changes[:, first] += at_rest[:, : len(first)]
        own, *people, slopes = np.split(changes, self.first[1:], axis=1)
        slopes = slopes.reshape(len(changes), BLOCKS, 2)
        groups = np.concatenate([at_rest[:, len(first) + 1 :, None], slopes], -1).transpose(1, 0, 2)
        table = {"coefficients": own, "direct": at_rest[:, len(first)], "blocks": groups}
        return table | {"photons": int(self.photons.sum()), "people": np.array(people)}

    def _add_ambient(self, block: int, left: Arrivals) -> None:
        """Add light that leaves, as that from outside comes in, to the nodes around where it started."""
        scene = self.lit
        diode, n = scene.layout.photodiodes[0].photodiode, optics.index_around(scene, scene.leds[0].wavelength_nm)
        bare = np.stack([photocurrent_a_per_mm2(source, diode) for source in SOURCES])
        by_source = left.from_outside(bare, optics.absorption(scene, INSIDE_NM), area_mm2=self.area_mm2, n=n)
        # Each node's function is 1 there, and falls to 0 at the next.
        u, v = (
            np.stack([np.interp(x, axis, node, 0.0, 0.0) for node in np.eye(len(axis))])
            for axis, x in zip(self.ambient_nodes, left.place_mm.T, strict=True)
        )
        self.ambient_a[:, block] += left.photons * (by_source[:, None] * u) @ v.T

    def ambient_a_per_mm2(self) -> Array:
        """Photocurrent at the nodes by light from outside, per area, by groups of photons: least squares of what is
        linear between nodes, (sources, blocks, a, b) float. [A/mm^2]"""
        # Integrals of the products of any two nodes' functions.
        steps = (np.diff(axis) / 6 for axis in self.ambient_nodes)
        u, v = (2 * np.diag(np.append(d, 0) + np.append(0, d)) + np.diag(d, 1) + np.diag(d, -1) for d in steps)
        return np.linalg.inv(u) @ (self.ambient_a / self.photons[:, None, None]) @ np.linalg.inv(v)


def explore(scene: SceneIn, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]) -> Exploration:
    """Trace what a page needs to show any layout on a finger scene's board.

    photons : of each of the scene's wavelengths, 49152 at least; further ones get half as many.
    max_seconds : wall time in which the tables are to be there, of what photons there are by then, one batch of each
        group or more. [s]

    Raises: InputError where the scene has no finger, several walls, LEDs that are not Lambertian, or other than two
    blood zones; NotReachedError, whose result is the Exploration as far as it was made, if interrupted or out of time;
    KeyboardInterrupt if a wavelength has no photons by then.
    """
    scene = as_scene(scene)
    options, run_time = TraceOptions(**requested), stopwatch()
    if options.relative_error is not None:
        raise InputError("explore takes no relative_error, as every layout has its own; give photons or max_seconds.")
    _check(scene)
    report = StageProgress(progress, options.max_seconds or scene.accuracy.max_seconds or math.inf)
    base = explored_board(scene)
    basis = pair_basis(base.layout.outline, base.layout.barriers[0] if base.layout.barriers else None)
    sources, bare, stores = led_per_wavelength(base), boards.bare_board(base), LightStore.of_command(options)
    how: dict[str, Any] = {"stores": stores, "backend": options.backend, "seed": options.seed}
    lit = {(led.wavelength_nm, led.fwhm_nm): lit_by(bare, led) for led in sources}
    tracers = {light: BoardTracer(one, **how) for light, one in lit.items()}
    by_led = [tracers[led.wavelength_nm, led.fwhm_nm] for led in base.leds]
    people = ranked_people(base, by_led, seed_of(options.seed, RANKING))
    fingers = [(base, blood_polynomial(base, chosen=True))]
    fingers += [(person.scene, blood_polynomial(person.scene, chosen=False)) for person in people]
    sums = [WavelengthSums(one, tracers[light], k, basis, fingers) for k, (light, one) in enumerate(lit.items())]
    light, unmet = as_far_as_reached(_stored_light, base, sums, sources, options, report)
    attributes: dict[str, Any] = {"seed": options.seed, "photons": int(light["photons"].sum())}
    attributes |= {"backend": choose_jit(options.backend, "explore").name, "size_mm": scene.layout.outline.size_mm}
    attributes |= {"scene": to_toml(scene), "digest": digest(scene)} | run_time()
    radial, rings = RadialFunction(light["radial"]), {axis: light[axis] for axis in ("radius_mm", "depth_mm")}
    fluence = [xr.DataArray(values, rings) for values in light["fluence"]]
    kernels = light["coefficients"], light["direct"], light["blocks"], fluence
    tables = list(map(WavelengthTable, sources, *kernels, light["photons"].tolist(), light["people"]))
    ambient = sums[0].ambient_nodes, light["ambient_a_per_mm2"]
    own = fingers[0][1], tables, touch_table(base)
    exploration = Exploration(base, basis, radial, *own, *ambient, people, attributes)
    attributes |= {"cut_off": str(unmet)} if unmet else {}
    return unless_cut_off(exploration, unmet)


def blood_polynomial(scene: Scene, chosen: bool) -> BloodPolynomial:
    """Over all blood under the forces of the page; chosen : and all blood at rest and saturation that can be chosen."""
    blood = scene.blood
    # What is venous depends on the blood at rest, so that there is none to choose.
    most = BLOOD_RANGE[1] if chosen and blood.venous_so2 is None else 1.0
    over = 0.0, min(1.0, most * blood.rest_blood_fraction * float(np.max(touch_table(scene)["blood"])))
    if chosen:
        return BloodPolynomial(over, (min(LEAST_SO2, blood.so2), 1.0))
    return BloodPolynomial(over, (blood.so2, blood.so2), PERSON_DEGREE)


def _stored_light(
    base: Scene, sums: list[WavelengthSums], sources: list[Led], options: TraceOptions, report: StageProgress
) -> dict[str, Array]:
    """All that is traced of a board, as arrays of which the first axis of a wavelength's is the wavelength, from the
    store if it is there; raises NotReachedError with the same of fewer photons."""
    basis = sums[0].basis
    usual = options.photons or base.accuracy.photons or (OPEN_PHOTONS if basis.wall_mm is None else WALL_PHOTONS)
    scene_wavelengths = len({(led.wavelength_nm, led.fwhm_nm) for led in base.leds})
    photons = [max(BLOCKS * LEAST_BATCH, usual if k < scene_wavelengths else usual // 2) for k in range(len(sums))]

    def trace() -> tuple[dict[str, Any], dict[str, Array]]:
        fluence = [_fluence(base, led, k, options) for k, led in enumerate(sources)]
        there, x, y, _ = sums[0].traced(min(usual, PILOT_PHOTONS), PILOT)
        radial = RadialFunction.of_arrivals(basis, x, y, there.weight * (sums[0].area_mm2 / there.photons))
        projection = PairProjection(basis, radial)
        cut_off = _trace(sums, photons, report, projection)
        by_wavelength = stacked_rows([band.table(projection) for band in sums])
        report("tables", 1.0)
        rings = {str(axis): fluence[0][axis].values for axis in fluence[0].dims}
        light = {"radial": radial.log_coefficients, "fluence": np.stack(fluence), **by_wavelength, **rings}
        light["ambient_a_per_mm2"] = sums[0].ambient_a_per_mm2()
        unless_cut_off(light, cut_off)
        return {}, light

    entries = [store.entry(_tables_key(sums, options.seed)) for store in LightStore.of_command(options)]
    return load_or_compute(entries, "-".join(map(str, photons)), trace, lambda _, arrays: arrays)[0]


def _tables_key(sums: list[WavelengthSums], seed: int) -> dict[str, Any]:
    """Cache key of the tables: beside the light's paths what absorbs it, what reads it, and this program."""
    base, backend, fingers = sums[0].lit, sums[0].tracer.backend.name, sums[0].fingers
    read_by = {name: getattr(base, name) for name in ("blood", "finger", "photodiodes")}
    light = digest(light_scene(base).model_copy(update=read_by))
    leds = [[led.wavelength_nm, led.fwhm_nm] for led in (band.lit.leds[0] for band in sums)]
    key = cache_key("explore", light, leds[0][0], seed=seed, backend=backend) | {"leds": leds}
    key |= {"states": [[*polynomial.blood_fraction, *polynomial.so2] for _, polynomial in fingers]}
    key |= {"people": [[one.model_dump_json() for one in (worn.fingertip, worn.blood)] for worn, _ in fingers[1:]]}
    return key | {"program": program_digest((*CODE, "sensor/**/*.py", "studies/exploration/**/*.py"))}


def _trace(sums: list[WavelengthSums], photons: list[int], report: StageProgress, projection: PairProjection) -> str:
    """Trace rounds of a batch for every group of every wavelength, each round twice the last, until there are so many
    photons or the tables after the next would come late. Returns: why there are not so many, if so. Raises:
    KeyboardInterrupt where the first round is not complete."""

    def batches() -> Iterator[tuple[WavelengthSums, int, int]]:
        count, round_s, tables_s = LEAST_BATCH, 0.0, 0.0
        while count == LEAST_BATCH or report.seconds + 2 * round_s + tables_s < report.limit_s:
            begin_s = report.seconds
            left = [math.ceil(most / BLOCKS - band.photons[0]) for band, most in zip(sums, photons, strict=True)]
            sizes = [min(count, band.tracer.batch_photons, most) for band, most in zip(sums, left, strict=True)]
            if max(sizes) <= 0:
                return
            for band, size in zip(sums, sizes, strict=True):
                yield from ((band, block, size) for block in range(BLOCKS) if size > 0)
            count, round_s, begin_s = 2 * count, report.seconds - begin_s, report.seconds
            if not tables_s and math.isfinite(report.limit_s):
                sums[0].table(projection)
                tables_s = len(sums) * (report.seconds - begin_s)

    spent, begin_s = 0.0, report.seconds

    def sample(batch: tuple[WavelengthSums, int, int]) -> None:
        nonlocal spent
        band, block, size = batch
        band.add(block, size)
        spent += size + PER_BATCH
        left = sum(photons) - sum(band.photons.sum() for band in sums) + PER_TABLE * len(sums)
        left_s = left * (report.seconds - begin_s) / spent
        report(f"{band.lit.leds[0].wavelength_nm:g} nm", report.seconds / (report.seconds + left_s))

    ending = run_until(batches(), sample, is_late=lambda _: report.interrupted)
    if all(band.photons.sum() >= most for band, most in zip(sums, photons, strict=True)):
        return ""
    why = Ending.INTERRUPTED if report.interrupted or ending is Ending.INTERRUPTED else Ending.OUT_OF_TIME
    cut_off = f"{why.value} with {sum(band.photons.sum() for band in sums):.0f} of {sum(photons)} photons."
    if any((band.photons == 0).any() for band in sums):
        raise KeyboardInterrupt(f"{cut_off} No page was written.")
    return cut_off


def _check(scene: Scene) -> None:
    boards.check_two_zones(scene, "explore")
    for i, led in enumerate(scene.leds):
        if led.pattern != "lambertian":
            why = "explore supports Lambertian LEDs only, whose light goes both ways"
            raise InputError(f'leds[{i}].pattern = "{led.pattern}": {why}; give "lambertian", or use simulate.')
    if len(scene.layout.barriers) > 1:
        why = "explore supports one wall, and this board has walls on several sides of its photodiodes"
        raise InputError(f"board.barrier: {why}; put the LEDs on one side, or set barrier = false.")


def explored_board(scene: Scene) -> Scene:
    """The scene on the board that the page shows: `place`'s outline, wall and parts where the scene has them."""
    if (gap_mm := scene.layout.barrier_gap_mm) is not None:
        scene = scene.model_copy(update={"board": scene.board.model_copy(update={"barrier_gap_mm": gap_mm})})
    base = boards.base_board(scene)
    candidates.check(base, "explore")
    return base


def led_per_wavelength(base: Scene) -> list[Led]:
    """An LED of each wavelength of the page: the scene's own from the longest, which ambient light has, then others."""
    by_wavelength = sorted(base.leds, key=lambda led: -led.wavelength_nm)
    leds = list({(led.wavelength_nm, led.fwhm_nm): led for led in by_wavelength}.values())
    for part in FURTHER_LEDS:
        led = Led.model_validate({"name": part, "part": part})
        if all(abs(led.wavelength_nm - other.wavelength_nm) >= SAME_NM for other in leds):
            leds.append(led)
    return leds


def lit_by(bare: Scene, led: Led) -> Scene:
    """A bare board whose dies, which its wall goes by, have the light of an LED."""
    light = {name: getattr(led, name) for name in ("part", "wavelength_nm", "fwhm_nm")}
    return bare.model_copy(update={"leds": tuple(die.model_copy(update=light) for die in bare.leds)})


def _fluence(base: Scene, led: Led, number: int, options: TraceOptions) -> xr.DataArray:
    """Of an LED's wavelength around a die in the middle of the board without its wall."""
    board = base.board.model_copy(update={"barrier": False, "barrier_gap_mm": None})
    die = base.leds[0].model_copy(update={"position_mm": (0.0, 0.0), "rotation_deg": 0.0})
    bare = boards.bare_board(base.model_copy(update={"board": board, "leds": (die,)}))
    tracer = BoardTracer(lit_by(bare, led), backend=options.backend)
    return tracer.fluence(photons=FLUENCE_PHOTONS, seed=seed_of(options.seed, FLUENCE, number))


# Forces at which the blood is computed, denser where it changes more, up to this or a quarter beyond the scene's touch.
FORCES, LEAST_REACH_N = 33, 4.0


@lru_cache(8)
def touch_table(scene: Scene) -> dict[str, Any]:
    """Blood of both zones over that at rest, its and the force's change with both pressures, the body's noise.

    All blood goes with that at rest, so that each is per unit of it.
    """
    reach_n = max(LEAST_REACH_N, 1.25 * largest_force_n(scene))
    force_n = reach_n * np.linspace(0.0, 1.0, FORCES) ** 1.5
    since_rest_s = boards.rules(scene).since_rest_s
    points = [operating_point(scene, float(force), since_rest_s=since_rest_s) for force in force_n]
    rest = scene.blood.rest_blood_fraction
    bodies = [p.body or PhysiologicalNoise(np.zeros((2, 2)), np.zeros((0, 0)), 0.0) for p in points]
    return {
        "force_n": force_n,
        "blood": np.array([p.blood_fraction for p in points]) / rest,
        "blood_per_pa": np.array([p.blood_per_pa for p in points]) / rest,
        "waves": np.array([body.blood @ body.blood.T for body in bodies]) / rest**2,
        "force_per_pa": np.array([p.force_per_pa for p in points]),
        "prior_pa": PRIOR_PA,
        "has_body": points[0].body is not None,
        "led_drift": bodies[0].led_drift,
        "reading_drift": bodies[0].reading_gain,
        "lift": bodies[0].lift,
    }
