"""Tables of a board's light from which a page reads any layout at once.

What a photodiode reads of an LED is a function of both their places, of their sizes and turns, of the wavelength, the
blood of two zones and its saturation: some ten numbers. It factors. The light between two places is a smooth kernel
(`light.pair_kernel`) of some 1200 coefficients for each wavelength; integrals over die and photodiode are sums over a
few Gauss points of each; and what blood makes of a reading at rest is smooth over pairs of places (`blood_ratio`, some
4000 nodes), a polynomial of 31 terms in blood and saturation at each (`BloodPolynomial`). In half precision, with the
groups of photons that tell the standard errors, that is 0.6 MB for a wavelength.

Places of LEDs by reciprocity or a grid of traces: both are one here, as photons start all over the board and count both
ways. A grid of LED places 1 mm apart, on the prototype's side of the wall some 60, each to 1 %, would take an hour at
the 61 s that one takes; one trace from each photodiode the other way tells every place of the LED, but only for
photodiodes that stay where they are. The kernel knows pairs of places on the prototype's board, 1.5 to 2.7 mm apart,
to 2 to 5 % by its photons, and farther ones less well, after two and a half minutes of processor time for three
wavelengths.

What it holds fixed: the outline, the wall, the cover, epoxy and finger; that LEDs are Lambertian and faces flush with
the board's underside. What it leaves out: that a photodiode swallows the few percent that the bare board would send
back, and what lies between the nodes; `kernel_error` stands for both in readings, `KERNEL_CHANGE_ERROR` in their
change, `kernel_resolution_error` in the force that they resolve.
"""

import math
import time
from dataclasses import dataclass, field
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError, NotReachedError
from ...hemodynamics.for_scene import largest_force_n, touch_areas_mm2, touch_pressures_pa
from ...light import ProgressCallback
from ...light.board_map import BoardTracer
from ...light.pair_kernel import PairBasis, PairProjection, RadialFunction, pair_basis
from ...light.tracing import Ending, StageProgress, run_until, seconds_per_sample
from ...options import BackendName, Requested, TraceOptions
from ...scene import Led, Scene, digest, to_toml
from ...sensor.information import PRIOR_PA, operating_point
from ...sensor.physiological_noise import LIFT_PER_UM
from ...statistics import seed_of
from ..placement import boards, candidates
from ..placement.photon_maps import QUICK_DISTANCE_MM
from .blood_ratio import BloodPolynomial, RatioBasis, ratio_basis
from .colour_table import BLOCKS, ColourSums, ColourTable

Array = NDArray[np.float64]

# Photons of each of the scene's own wavelengths, on a board with a wall, through which little light comes, and without;
# of each further wavelength half as many.
WALL_PHOTONS, OPEN_PHOTONS = 5 << 20, 1 << 21
# Wavelengths that every page offers beside its scene's own, but for those nearer to one of these than this. [nm]
FURTHER_LEDS, SAME_NM = ("led_660", "led_940"), 8.0
# Batches have so many photons at least.
LEAST_BATCH = 1 << 12
# Under a limit of time, batches are such that each group has its first within this part of what is left for their
# wavelength, by the pace of so many photons.
FIRST_ROUND, PACE_PHOTONS = 0.5, 1 << 15
# Relative error of readings by the kernel's nodes and the bare board, rms. With a wall: what is left on the prototype's
# board of 16 readings of two layouts beside traces of their own, errors of both by their photons taken off. Without a
# wall: of 188 photodiodes of 1 x 1 mm, 1.2 to 4.5 mm from four places of an LED on the bare board of
# scenes/placement.toml, 2 million photons of the table; their mean is off by -0.1(2) %. Nodes across that are 1.1 mm
# apart, in place of 1.9, or four times the pairs of places for M make it no smaller.
KERNEL_ERROR, OPEN_KERNEL_ERROR = 0.03, 0.045
# Of their change under a touch, rms, in parts of what either zone's blood changes by itself, added up: 46 photodiodes
# of 1 x 1 mm under four places of the prototype's LED, three forces, beside a million photons of each place; 5.2
# million photons of the table. Errors by the photons of both are taken off.
KERNEL_CHANGE_ERROR = 0.026
# The blood at rest can be chosen from half to twice the scene's, the saturation down to here.
BLOOD_RANGE, LEAST_SO2 = (0.5, 2.0), 0.7
FLUENCE_PHOTONS, RING_MM, DEPTH_STEP_MM, FLUENCE_RADIUS_MM, BELOW_BED_MM = 1 << 16, 0.2, 0.1, 10.0, 2.0
# Stream of random numbers.
FLUENCE = 12


@dataclass
class Exploration:
    """Everything that the page knows.

    scene : the scene with outline, wall and origin spelled out; parts lie where they lay.
    ambient_nodes : (u, v) nodes of the photocurrent by light from outside; ambient_a_per_mm2 : (sources, a, b).
    """

    scene: Scene
    basis: PairBasis
    ratio: RatioBasis
    radial: RadialFunction
    polynomial: BloodPolynomial
    colours: list[ColourTable]
    touch: dict[str, Any]
    ambient_nodes: tuple[Array, Array]
    ambient_a_per_mm2: Array
    attributes: dict[str, Any] = field(default_factory=dict)

    @property
    def kernel_error(self) -> float:
        """Relative error of readings beyond that by photons, rms."""
        return OPEN_KERNEL_ERROR if self.basis.one_side else KERNEL_ERROR

    @property
    def kernel_resolution_error(self) -> float:
        """Of the force resolved, which goes as the slopes of the readings: as much as all that moves a slope."""
        return math.hypot(self.kernel_error, KERNEL_CHANGE_ERROR)


def explore(scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]) -> Exploration:
    """Trace what a page needs to show any layout on a finger scene's board.

    photons : of each of the scene's wavelengths; further ones get half as many.
    max_seconds : wall time after which tracing ends with what there is, twelve batches of each wavelength or more. [s]

    Raises: InputError where the scene has no finger, several walls, LEDs that are not Lambertian, or other than two
    blood zones; NotReachedError, whose result is the Exploration as far as it was made, if interrupted;
    KeyboardInterrupt if the scene's own wavelengths are not known by then.
    """
    options, cpu = TraceOptions(**requested), time.process_time()
    if options.relative_error is not None:
        raise InputError("explore knows no relative_error, as every layout has its own; give photons or max_seconds.")
    _check(scene)
    report = StageProgress(progress, options.max_seconds or scene.accuracy.max_seconds or math.inf)
    base = explored_board(scene)
    basis = pair_basis(base.layout.outline, base.layout.barriers[0] if base.layout.barriers else None)
    touch = touch_table(base)
    polynomial = _polynomial(base, touch)
    first, tables, cut_off = _traced(base, basis, polynomial, options, report)
    attributes: dict[str, Any] = {"seed": options.seed, "photons": sum(one.photons for one in tables)}
    attributes |= {"backend": first.tracer.backend.name, "scene": to_toml(scene), "digest": digest(scene)}
    attributes |= {"cpu_seconds": time.process_time() - cpu, "wall_seconds": report.seconds}
    nodes, currents = first.ambient()
    found = Exploration(
        base,
        basis,
        ratio_basis(basis),
        first.known_radial,
        polynomial,
        tables,
        touch,
        nodes,
        currents,
        attributes=attributes,
    )
    if cut_off:
        attributes["cut_off"] = cut_off
        raise NotReachedError(cut_off, result=found)
    return found


def _traced(
    base: Scene, basis: PairBasis, polynomial: BloodPolynomial, options: TraceOptions, report: StageProgress
) -> tuple[ColourSums, list[ColourTable], str]:
    """The sums of the first wavelength, the tables of all, and what the user's interrupt left out of them, if it did.

    Raises: KeyboardInterrupt where the scene's own wavelengths are not known by then.
    """
    bare, sources = boards.bare_board(base), colours(base)
    own = len({(led.wavelength_nm, led.fwhm_nm) for led in base.leds})
    usual = options.photons or base.accuracy.photons or (OPEN_PHOTONS if basis.one_side else WALL_PHOTONS)
    how: dict[str, Any] = {"backend": options.backend, "seed": options.seed}
    tables: list[ColourTable] = []
    first: ColourSums | None = None
    pace_s, cut_off = 0.0, ""
    for number, led in enumerate(sources):
        lit = bare.model_copy(update={"leds": tuple(_as(die, led) for die in bare.leds)})
        sums = ColourSums(lit, number, basis, polynomial, **how, radial=first.radial if first else None)
        end, most = (number + 1) / len(sources), usual if number < own else usual // 2
        each = min(sums.tracer.batch_photons, max(LEAST_BATCH, most // BLOCKS))
        if not math.isinf(report.limit_s):
            pilot = ColourSums(lit, number, basis, polynomial, **how, radial=None)
            pace_s = pace_s or seconds_per_sample(pilot.trace, LEAST_BATCH, lambda first_s: PACE_PHOTONS)
            each = min(each, _fitting(end * report.limit_s - report.seconds, pace_s))
        batches = max(BLOCKS, round(most / each))
        _trace(sums, each, batches, led, report, begin=number / len(sources), end=end)
        others = sources[number + 1 :]
        is_known = sums.batches >= BLOCKS
        if report.interrupted and (sums.batches < batches or others):
            cut_off = f"interrupted: {led.wavelength_nm:g} nm has {sums.batches} of {batches} batches"
            cut_off += "".join(f", {other.wavelength_nm:g} nm none" for other in others) + "."
            if number + is_known < own:
                raise KeyboardInterrupt(f"{cut_off} No page was written.")
        if not is_known:
            break
        if first is None:
            first, projection = sums, PairProjection(basis, sums.known_radial)
        fluence = _fluence(base, led, seed=seed_of(options.seed, FLUENCE, number), backend=options.backend)
        tables.append(sums.table(led, projection, fluence))
        if cut_off:
            break
    assert first is not None
    return first, tables, cut_off


def _fitting(left_s: float, pace_s: float) -> int:
    """Photons of a batch such that each group has its first well within a time, by their pace. [s]"""
    return max(LEAST_BATCH, int(FIRST_ROUND * left_s / (BLOCKS * pace_s)))


def _trace(
    sums: ColourSums, each: int, batches: int, led: Led, report: StageProgress, *, begin: float, end: float
) -> None:
    """Add batches of so many photons to the sums of one colour, which has the time between two parts of all of it.

    An interrupt of the user ends it, whatever it has.
    """

    def is_late(k: int) -> bool:
        return report.interrupted or (k >= BLOCKS and report.is_late(end))

    def sample(k: int) -> None:
        sums.trace(each)
        report(f"{led.wavelength_nm:g} nm", begin + (end - begin) * (k + 1) / batches)

    if run_until(range(batches), sample, is_late=is_late) is Ending.INTERRUPTED:
        report.interrupted = True


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
    candidates.check(base, "explore")
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


def fluence_edges(scene: Scene) -> tuple[Array, Array]:
    """Edges of the rings and of the depths of the fluence's table. [mm]"""
    assert scene.finger is not None
    deepest = scene.finger.nail_thickness_mm + scene.finger.bed_thickness_mm + BELOW_BED_MM
    return np.arange(0.0, FLUENCE_RADIUS_MM + RING_MM / 2, RING_MM), np.arange(0.0, deepest, DEPTH_STEP_MM)


def _fluence(base: Scene, led: Led, *, seed: int, backend: BackendName) -> Array:
    """How the light of a die in the middle of a board without a wall spreads, (radius, depth) float. [mm^-2]"""
    board = base.board.model_copy(update={"barrier": False, "barrier_gap_mm": None})
    die = _as(base.leds[0], led).model_copy(update={"position_mm": (0.0, 0.0), "rotation_deg": 0.0})
    scene = boards.bare_board(base.model_copy(update={"board": board, "leds": (die,)}))
    tracer = BoardTracer(scene, backend=backend, spacing_mm=QUICK_DISTANCE_MM)
    return tracer.fluence(0, *fluence_edges(base), photons=FLUENCE_PHOTONS, seed=seed)


# Forces at which the blood is computed, denser where it changes more, up to this or a quarter beyond the scene's touch.
FORCES, LEAST_REACH_N = 33, 4.0


def touch_table(scene: Scene) -> dict[str, Any]:
    """Blood of both zones in parts of that at rest, its change with both pressures, and the body's noise, by force.

    All blood goes with that at rest, so that each is per unit of it.
    """
    reach_n = max(LEAST_REACH_N, 1.25 * largest_force_n(scene))
    force_n = reach_n * np.linspace(0.0, 1.0, FORCES) ** 1.5
    since_rest_s = boards.rules(scene).since_rest_s
    points = [operating_point(scene, float(force), since_rest_s=since_rest_s) for force in force_n]
    rest = scene.blood.rest_blood_fraction
    waves = [np.zeros((2, 2)) if p.body is None else p.body.blood @ p.body.blood.T for p in points]
    body, minutes = scene.body, since_rest_s / 60
    drift, motion = (body.drift, body.motion) if body else (None, None)
    return {
        "force_n": force_n,
        "blood": np.array([p.blood_fraction for p in points]) / rest,
        "blood_per_pa": np.array([p.blood_per_pa for p in points]) / rest,
        "waves": np.array(waves) / rest**2,
        "force_per_pa": np.array(touch_areas_mm2(scene)) * 1e-6,
        "pressure_per_n": np.array(touch_pressures_pa(scene, 1.0)),
        "prior_pa": PRIOR_PA,
        "has_body": points[0].body is not None,
        "led_drift": drift.led_per_rt_min * np.sqrt(minutes) if drift else 0.0,
        "reading_drift": drift.reading_per_rt_min * np.sqrt(minutes) if drift else 0.0,
        "lift": LIFT_PER_UM * motion.lift_um if motion else 0.0,
    }
