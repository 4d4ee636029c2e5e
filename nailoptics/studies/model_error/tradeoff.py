"""Error against processor time of every level of model of a scene, from a formula to the full photon walk."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeVar, Unpack

import numpy as np
import xarray as xr

from ... import tissue
from ...display import Displayed
from ...errors import NotReachedError
from ...hemodynamics.for_scene import blood_over_touch
from ...light import ProgressCallback, optics
from ...light import backend as backends
from ...light.tracing import unlit
from ...light.transfer.series import read_replicates
from ...options import Requested, TraceOptions
from ...scene import Scene
from ...statistics import jackknife
from ...variables import Variables, variable
from ..prior_uncertainty import read_by_groups
from .changes import ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, lines_of, revised
from .paired import (
    Estimates,
    PairedReadings,
    PairedTracer,
    check_study,
    difference,
    end_states,
    reweighted,
    weighted_mean,
)

T = TypeVar("T")

DEFAULT_TOLERANCE = 0.02
# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1
REFERENCE, OWN = "full", "the scene itself"
CHEAPER: dict[str, Changes] = {
    "matched indices": {"light": {"index_steps": False}},
    "similarity": {"light": {"similarity": True}},
    "similarity, matched": {"light": {"similarity": True, "index_steps": False}},
    "no epidermis, no Kapton": {"light": {"left_out": ["epidermis", "kapton"]}},
    "no bone either": {"light": {"left_out": ["bone", "epidermis", "kapton"]}},
}
FULL: Changes = {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}} | PART_WIDTH
# Other ways to follow the blood over the touch, by arguments of `blood_over_touch`.
COURSES: dict[str, dict[str, Any]] = {"walls with mass": {"model": "inertial"}, "vessels to 1e-3": {"rtol": 1e-3}}
FEWER_SAMPLES = 10
LITERATURE_CALL = "nailoptics.studies.model_error.tradeoff.literature_changes(scene, name, blood)"
# Mean path of detected light over the distance from source to detector: adult forearm, 807 nm, distances of
# centimetres: 4.16 +- 0.78 (Duncan et al. 1995, Phys. Med. Biol. 40, 295). None is published for a finger or
# millimetres.
PATH_FACTOR = 4.16
# Relative change of a reading from the change of the optical depth along its path.
FORMULAS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Taylor (9)": np.negative,
    "Beer-Lambert (8)": lambda depth: np.expm1(-depth),
}


@dataclass(frozen=True)
class Bias:
    """How far a level is from the reference, as a part of it.

    value, stderr : mean over all photodiodes, weighted by the reference's errors.
    bound : what no photodiode's exceeds, with 95 % confidence each.
    """

    value: float
    stderr: float
    bound: float


@dataclass(frozen=True)
class Level:
    """One level of model, measured.

    reading : bias of the reading at rest; None where the level has none.
    signal : bias of the change by touch, as a part of the largest change of any photodiode.
    setup_seconds : processor time of the first answer before its photons; all of it where none are traced. [s]
    reading_noise, signal_noise : standard error of the worst reading, and of the worst change as a part of the largest,
        after one processor second of photons; 0 where none are traced. [s^0.5]
    beforehand : what must be known beside the scene's media and shape; empty where nothing must.
    changes : what of the scene selects it; None where no line of a scene does, but the call alone.
    """

    name: str
    backend: str
    reading: Bias | None
    signal: Bias
    setup_seconds: float
    reading_noise: float = 0.0
    signal_noise: float = 0.0
    beforehand: str = ""
    changes: Changes | None = None
    call: str = ""

    @property
    def lines(self) -> list[str]:
        """The scene lines that select it."""
        return lines_of(self.changes or {})

    @property
    def traces(self) -> bool:
        """Whether its answers are made of photons."""
        return self.reading_noise > 0

    @property
    def bound(self) -> float:
        """What the bias of no photodiode's reading or signal exceeds; inf where that is not known."""
        return max(self.reading.bound, self.signal.bound) if self.reading else math.inf

    def photon_seconds(self, error: float) -> float:
        """Seconds of photons until the error of the worst photodiode is no more than this; inf where it never is. [s]

        One standard error and the bound on the bias add in squares.
        """
        if self.reading is None or self.bound > error:
            return math.inf
        needed = 0.0
        for bound, noise in ((self.reading.bound, self.reading_noise), (self.signal.bound, self.signal_noise)):
            left = error**2 - bound**2
            if noise:
                needed = max(needed, noise**2 / left if left > 0 else math.inf)
        return needed

    def within(self, error: float) -> "Answer | None":
        """The level with the fewest photons that keep it within an error; None where none do."""
        seconds = self.photon_seconds(error)
        return Answer(self, seconds, error if self.traces else self.bound) if math.isfinite(seconds) else None


@dataclass(frozen=True)
class Answer:
    """A level with so many seconds of photons, and its error on the worst photodiode."""

    level: Level
    photon_seconds: float
    error: float

    @property
    def seconds(self) -> float:
        """Processor time of the first answer. [s]"""
        return self.level.setup_seconds + self.photon_seconds

    @property
    def relative_error(self) -> float:
        """Standard error of its worst reading; 0 where no photons are traced."""
        noise = self.level.reading_noise
        return noise / float(np.sqrt(self.photon_seconds)) if noise and self.photon_seconds else 0.0


@dataclass(frozen=True)
class Tradeoff(Displayed):
    """All levels of model, and the fastest within a tolerance, as a scene.

    An error is that of the worst photodiode: of its reading at rest, relative, or of its change by touch, as a part of
    the largest change of any photodiode, whichever is larger; the bound on the level's bias and one standard error, in
    squares.

    levels : the cheapest for the tolerance first, then those that never reach it.
    chosen : the fastest within the tolerance; the full model where too few photons came to evaluate any.
    """

    levels: tuple[Level, ...]
    tolerance: float
    chosen: Answer
    scene: Scene
    wall_seconds: float
    attributes: dict[str, Any]

    def fastest(self, error: float) -> Answer | None:
        """The cheapest answer within an error."""
        return fastest(self.levels, error)

    @property
    def lines(self) -> list[str]:
        """The scene lines that select the chosen level and its accuracy."""
        error = self.chosen.relative_error
        return self.chosen.level.lines + ([f"[accuracy] relative_error = {error:.2g}"] if error else [])

    def dataset(self) -> xr.Dataset:
        """Everything of the levels over level, as a Dataset."""
        data: Variables = {}
        nothing = Bias(math.nan, math.nan, math.nan)
        for which, text in (("reading", "reading at rest"), ("signal", "change by touch, of the largest change")):
            biases = [getattr(level, which) or nothing for level in self.levels]
            value, stderr, bound = np.array([(b.value, b.stderr, b.bound) for b in biases]).T
            data |= variable(f"{which}_bias", "level", value, f"bias of the {text}", stderr=stderr)
            data |= variable(f"{which}_bound", "level", bound, f"what no photodiode's bias exceeds, of the {text}")
            noise = [getattr(level, f"{which}_noise") for level in self.levels]
            text = f"standard error after one second of photons, of the {text}"
            data |= variable(f"{which}_noise", "level", noise, text)
        seconds = [level.setup_seconds for level in self.levels]
        data |= variable("first_fixed", "level", seconds, "processor time of an answer without photons", units="s")
        return xr.Dataset(data, {"level": [level.name for level in self.levels]}, self.attributes)


def fastest(levels: Iterable[Level], error: float) -> Answer | None:
    """The answer of no more than an error that costs least; None where no level gives one.

    The scene itself, or else the full model, stays where none is cheaper beyond the noise of costs.
    """
    answers = [answer for level in levels if (answer := level.within(error))]
    least = min(answers, key=lambda answer: answer.seconds, default=None)
    for name in (OWN, REFERENCE):
        for answer in answers:
            if least and answer.level.name == name and (1 - COST_NOISE) * answer.seconds <= least.seconds:
                return answer
    return least


def tradeoff(
    scene: Scene,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Tradeoff:
    """Measure bias and cost of every level of model on a finger scene, against its full model.

    All levels that the photon walk gives are traced with the same random numbers, so that photons which never meet
    what a level leaves out are no part of its error.

    tolerance : error of an answer, as `Tradeoff` has it.
    photons : of each LED in each trace; or
    relative_error : of the full model's trace, all others having as many photons; or
    max_seconds : for all levels together, about; 90 if nothing else is requested.

    Raises: InputError, also where no backend compiles kernels; NotReachedError where a photodiode saw nothing to
        compare levels by, or, if interrupted, with the Tradeoff as far as it was made as result.
    """
    check_study(scene, tolerance, "tradeoff", "has one level, itself")
    scene.require_blood("tradeoff")
    options, start = TraceOptions(**requested), time.perf_counter()
    # Each level's time is that of tracing it.
    options = replace(options, backend=backends.activate_jit(options.backend, "tradeoff").name, store=False)
    full = revised(scene, FULL)
    traced = {OWN: scene} if changes_between(full, scene) else {}
    traced |= {name: revised(full, changes) for name, changes in CHEAPER.items()}
    tracer = PairedTracer(2 + len(traced), options, progress)
    base = tracer.trace(full)
    light, unmet = base.transfer, None
    for led, photodiode in np.argwhere(~(base.level > 0)):
        raise NotReachedError(unlit(light.leds[led], light.photodiodes[photodiode], light.traces[led].photons))
    levels = [measured(scene, REFERENCE, base, base), *formulas(scene, base, options.seed)]
    levels += courses(scene, base, options.seed)
    if any(led.fwhm_nm for led in full.leds):
        # The same photons, so the same cost, whatever the noise of its error.
        levels.append(measured(scene, "one wavelength", base, reweighted(base, revised(full, ONE_WAVELENGTH))))
    try:
        for name, variant in traced.items():
            levels.append(measured(scene, name, base, tracer.trace(variant)))
        levels.append(other_zones(scene, base, tracer))
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error).rstrip('.') or 'interrupted'}; {len(levels)} levels were measured before."
    about = light.attributes() | ({"cut_off": unmet} if unmet else {})
    unjudged, seconds = Answer(levels[0], light.cpu_seconds, math.inf), time.perf_counter() - start
    result = _chosen(Tradeoff(tuple(levels), tolerance, unjudged, scene, seconds, about))
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _chosen(result: Tradeoff) -> Tradeoff:
    """The result with its levels in order, and the fastest within the tolerance as a scene."""

    def place(level: Level) -> tuple[float, float, bool]:
        # The full model first among those that cost the same.
        seconds = level.setup_seconds + level.photon_seconds(result.tolerance)
        return seconds, level.setup_seconds, level.name != REFERENCE

    answer = result.fastest(result.tolerance) or result.chosen
    scene = revised(result.scene, answer.level.changes or {})
    if answer.relative_error:
        accuracy = type(scene.accuracy)(relative_error=min(answer.relative_error, 1.0))
        scene = scene.model_copy(update={"accuracy": accuracy})
    return replace(result, levels=tuple(sorted(result.levels, key=place)), chosen=answer, scene=scene)


def measured(scene: Scene, name: str, base: PairedReadings, other: PairedReadings) -> Level:
    """A traced level of a scene against the reference, which has no bias against itself."""
    reading = signal = Bias(0.0, 0.0, 0.0)
    if other is not base:
        paired = difference(base, other)
        assert paired.signal is not None
        reading, signal = bias_of(base, paired.reading), bias_of(base, paired.signal)
    root_s = math.sqrt(other.transfer.cpu_seconds)
    return Level(
        name=name,
        backend=other.transfer.backend,
        reading=reading,
        signal=signal,
        setup_seconds=other.setup_seconds,
        reading_noise=float(other.relative_stderr.max()) * root_s,
        signal_noise=float(other.modulation_stderr.max()) / base.largest_modulation[0] * root_s,
        changes=changes_between(scene, other.transfer.scene),
    )


def bias_of(base: PairedReadings, off: Estimates, *, shared: float = 0.0) -> Bias:
    """The bias of a level from how far each of its readings is off.

    shared : relative error of what all of them are parts of.
    """
    bounds = off._replace(stderr=np.hypot(off.stderr, shared * off.value)).bound
    bound = float(np.max(np.where(np.isfinite(bounds), bounds, np.inf)))
    mean, stderr = weighted_mean(off, base)
    if not np.isfinite(mean):
        return Bias(mean, stderr, bound)
    # The weights are estimates, too: of n photons a relative variance 1 / n is known to 1 / sqrt(n).
    relative = base.relative_stderr
    drift = float(np.linalg.norm((off.value - mean) / relative) / (relative**-2.0).sum())
    return Bias(mean, math.hypot(stderr, shared * mean, drift), bound)


def signal_bias(base: PairedReadings, modulation: np.ndarray) -> Bias:
    """The bias of a signal that shares no photons with the reference, (led, photodiode) float."""
    unit, stderr = base.largest_modulation
    off = Estimates((modulation - base.modulation) / unit, base.modulation_stderr / unit)
    return bias_of(base, off, shared=stderr / unit)


def timed(call: Callable[..., T], *arguments: Any, **options: Any) -> tuple[T, float]:
    """What a call returns, and its processor time. [s]"""
    begin = time.process_time()
    return call(*arguments, **options), time.process_time() - begin


def literature_changes(scene: Scene, name: str, blood_fraction: np.ndarray) -> np.ndarray:
    """Relative change of every reading from the first blood state on, (led, photodiode, states) float.

    By a formula with constants from literature alone: each photodiode sees the blood of the zone above which it lies,
    along a path of 4.16 times its distance from the LED, at the LED's peak wavelength. The reading at rest, V0 + V1 of
    the paper, is in no literature.

    name : of `FORMULAS`.
    blood_fraction : (states, zones) float in 0-1.
    """
    layout = scene.layout
    path_mm = PATH_FACTOR * np.array(
        [[math.dist(led.center_mm, area.center_mm) for area in layout.photodiode_areas] for led in layout.leds]
    )
    mu_a = np.array([tissue.blood_mu_a_per_mm(led.wavelength_nm, scene.blood.rest_so2) for led in scene.leds])
    more = (blood_fraction - blood_fraction[0])[:, list(scene.zones_of_photodiodes)]
    return FORMULAS[name]((path_mm * mu_a[:, None])[..., None] * more.T)


def formulas(scene: Scene, base: PairedReadings, seed: int) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8), with constants from literature, and with those of the reference's mean paths.

    With traced constants the reading at rest is the trace's, at what that costs; it is the signal that they may miss.

    seed : of the groups of photons, from which errors come.
    """
    full = base.transfer.scene
    ends, depths, traced = end_states(full), [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.spectrum(led)
        mu_a = optics.absorption(full, wavelength, blood_fraction=ends)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.rest_so2))
        read = read_replicates(base.transfer, i, mu_a, blood, seed=seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depths.append(read.mean_path_mm @ ((ends[1] - ends[0]) * mean))
        traced.append(read.reading[..., 1] / read.reading[..., 0] - 1)
    unit, stderr = base.largest_modulation
    for name, change in FORMULAS.items():
        changes, seconds = timed(literature_changes, full, name, ends)
        signal, known = signal_bias(base, changes[..., -1]), "one measured reading at rest"
        yield Level(f"{name}, literature", "numpy", None, signal, seconds, beforehand=known, call=LITERATURE_CALL)
        values = (change(np.stack(depths)) - np.stack(traced)) / unit
        errors = np.stack([jackknife(value) for value in values])
        signal = bias_of(base, Estimates(values[:, 0], errors), shared=stderr / unit)
        yield replace(measured(scene, f"{name}, traced", base, base), signal=signal)


def courses(scene: Scene, base: PairedReadings, seed: int) -> Iterator[Level]:
    """Other ways to follow the blood, and fewer samples: signals where blood, linear between samples, is off most.

    seed : of the groups of photons, from which errors come.
    """
    full, (unit, stderr) = base.transfer.scene, base.largest_modulation
    usual, usual_s = timed(blood_over_touch, full)
    blood = usual.blood_fraction.values
    fewer: Changes = {"touch": {"sample_rate_hz": full.touch.sample_rate_hz / FEWER_SAMPLES}}
    ways: dict[str, tuple[dict[str, Any], Changes]] = {name: (how, {}) for name, how in COURSES.items()}
    if usual.sizes["time"] > 2 * FEWER_SAMPLES:
        ways[f"1 of {FEWER_SAMPLES} samples"] = {}, fewer
    for name, (how, changes) in ways.items():
        course, seconds = timed(blood_over_touch, revised(full, changes), **how)
        other = np.stack([np.interp(usual.time, course.time, zone) for zone in course.blood_fraction.values])
        farthest = int(np.abs(other - blood).max(0).argmax())
        states = np.stack([blood[:, 0], blood[:, farthest], other[:, farthest]])
        rest, right, wrong = np.moveaxis(read_by_groups(base.transfer, full, states, seed), -1, 0)
        off = (wrong - right) / rest / unit
        signal = bias_of(base, Estimates(off[0], jackknife(off)), shared=stderr / unit)
        yield replace(
            measured(scene, name, base, base),
            signal=signal,
            setup_seconds=base.setup_seconds + seconds - usual_s,
            changes=changes_between(scene, full) | changes,
            call=f"nailoptics.hemodynamics.for_scene.blood_over_touch(scene, **{how})" if how else "",
        )


def other_zones(scene: Scene, base: PairedReadings, tracer: PairedTracer) -> Level:
    """The scene with eight blood zones, or with two if it has more: other blood under a touch, none at rest."""
    two = len(scene.zone_edges_mm) == 1
    changes: Changes = {"blood": {"zones": 8 if two else None, "zone_edges_mm": (0.0,)}}
    other = tracer.trace(revised(base.transfer.scene, changes))
    level = measured(scene, "eight zones" if two else "two zones", base, other)
    signal, changes = signal_bias(base, other.modulation), (level.changes or {}) | changes
    return replace(level, reading=Bias(0.0, 0.0, 0.0), signal=signal, changes=changes)
