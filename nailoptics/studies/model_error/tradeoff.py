"""Error against processor time of every level of model of a scene, from a formula to the full photon walk."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import xarray as xr

from ... import tissue
from ...assets import read_toml
from ...display import Displayed
from ...errors import InputError, NotReachedError, unless_cut_off
from ...hemodynamics.for_scene import blood_over_touch
from ...hemodynamics.touch import largest_force_n
from ...light import ProgressCallback, backend as backends, optics
from ...light.tracing import unlit
from ...light.transfer.series import read_by_groups, read_replicates
from ...options import Requested, TraceOptions
from ...scene import Scene, SceneIn, as_scene
from ...variables import Estimate, described
from . import paired
from .explain import DEFAULT_TOLERANCE, ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, lines_of, revised
from .paired import Estimates, PairedReadings, PairedTracer

# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1
REFERENCE, OWN = "full", "the scene itself"
CHEAPER: dict[str, Changes] = read_toml("cheaper_models.toml")
FULL: Changes = {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}} | PART_WIDTH
FEWER_SAMPLES = 10
# Relative change of a reading from the change of the optical depth along its path.
FORMULAS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Taylor (9)": np.negative,
    "Beer-Lambert (8)": lambda depth: np.expm1(-depth),
}


@dataclass(frozen=True)
class Bias:
    """How far a level is from the reference, as a fraction of it.

    value, stderr : mean over all photodiodes, weighted by the reference's errors.
    bound : what no photodiode's exceeds, with 95 % confidence each.
    """

    value: float
    stderr: float
    bound: float


@dataclass(frozen=True)
class Level:
    """One level of model, measured.

    reading : bias of the reading at rest.
    signal : bias of the change by touch, as a fraction of the largest change of any photodiode.
    setup_seconds : processor time of the first answer before its photons. [s]
    reading_noise, signal_noise : standard error of the worst reading, and of the worst change as a fraction of the
        largest, after one processor second of photons. [s^0.5]
    changes : what of the scene selects it.
    call : what gives it beside that, where no line of a scene does.
    """

    name: str
    reading: Bias
    signal: Bias
    setup_seconds: float
    reading_noise: float
    signal_noise: float
    changes: Changes
    call: str = ""

    @property
    def lines(self) -> list[str]:
        """The scene lines that select it."""
        return lines_of(self.changes)

    @property
    def bound(self) -> float:
        """What the bias of no photodiode's reading or signal exceeds; inf where that is not known."""
        return max(self.reading.bound, self.signal.bound)

    def photon_seconds(self, error: float) -> float:
        """Seconds of photons until the error of the worst photodiode is no more than this; inf where it never is. [s]
        One standard error and the bound on the bias add in squares."""
        needed = 0.0
        for bias, noise in ((self.reading, self.reading_noise), (self.signal, self.signal_noise)):
            left = error**2 - bias.bound**2
            needed = max(needed, noise**2 / left if left > 0 else math.inf)
        return needed

    def seconds(self, error: float) -> float:
        """Processor time of the first answer within an error; inf where it has none. [s]"""
        return self.setup_seconds + self.photon_seconds(error)

    def relative_error(self, error: float) -> float:
        """Standard error of the worst reading in the answer within an error; 0 where it has none."""
        seconds = self.photon_seconds(error)
        return self.reading_noise / math.sqrt(seconds) if math.isfinite(seconds) else 0.0


@dataclass(frozen=True, repr=False)
class Tradeoff(Displayed):
    """All levels of model, and the fastest within a tolerance, as a scene.

    An error is that of the worst photodiode: of its reading at rest, relative, or of its change by touch, as a fraction
    of the largest change of any photodiode, whichever is larger; the bound on the level's bias and one standard error,
    in squares.

    levels : the cheapest for the tolerance first, then those that never reach it.
    chosen : the fastest within the tolerance; the full model where too few photons came to evaluate any.
    scene : the chosen level's, with the relative error that it needs.
    """

    levels: tuple[Level, ...]
    tolerance: float
    chosen: Level
    scene: Scene
    wall_seconds: float
    attributes: dict[str, Any]

    @property
    def lines(self) -> list[str]:
        """The scene lines that select the chosen level and its accuracy."""
        error = self.chosen.relative_error(self.tolerance)
        return self.chosen.lines + ([f"[accuracy] relative_error = {error:.2g}"] if error else [])

    def dataset(self) -> xr.Dataset:
        """Everything of the levels over level, as a Dataset."""
        columns: dict[str, Any] = {"first_fixed": [level.setup_seconds for level in self.levels]}
        for which in ("reading", "signal"):
            biases = [getattr(level, which) for level in self.levels]
            value, stderr, bound = np.array([(b.value, b.stderr, b.bound) for b in biases]).T
            columns |= {f"{which}_bias": Estimate(value, stderr), f"{which}_bound": bound}
            columns[f"{which}_noise"] = [getattr(level, f"{which}_noise") for level in self.levels]
        names = {"level": [level.name for level in self.levels]}
        return xr.Dataset(described("nailoptics.studies", **columns), names, self.attributes)


def fastest(levels: Iterable[Level], error: float) -> Level | None:
    """The level whose answer of no more than an error costs least; None where none gives one. The scene itself, or else
    the full model, stays where none is cheaper beyond the noise of costs."""
    able = [level for level in levels if math.isfinite(level.seconds(error))]
    least = min((level.seconds(error) for level in able), default=math.inf)
    usual = {level.name: level for level in able if (1 - COST_NOISE) * level.seconds(error) <= least}
    cheapest = next((level for level in able if level.seconds(error) == least), None)
    return usual.get(OWN) or usual.get(REFERENCE) or cheapest


def tradeoff(
    scene: SceneIn,
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
    scene = as_scene(scene)
    paired.check_study(scene, tolerance, "tradeoff", "has one level, itself")
    scene.require_blood("tradeoff")
    if largest_force_n(scene) <= 0:
        raise InputError("touch: the force never leaves 0, so there is nothing to compare levels by; give a force.")
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
    reference = measured(scene, REFERENCE, base, base)
    levels = [reference, *formulas(scene, base), *courses(scene, base)]
    if any(led.fwhm_nm for led in full.leds):
        # The same photons, so the same cost, whatever the noise of its error.
        levels.append(measured(scene, "one wavelength", base, paired.reweighted(base, revised(full, ONE_WAVELENGTH))))
    try:
        for name, variant in traced.items():
            levels.append(measured(scene, name, base, tracer.trace(variant)))
        levels.append(other_zones(scene, base, tracer))
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error).rstrip('.') or 'interrupted'}; {len(levels)} levels were measured before."

    chosen = fastest(levels, tolerance) or reference
    selected = revised(scene, chosen.changes)
    if relative := chosen.relative_error(tolerance):
        selected = selected.model_copy(update={"accuracy": type(scene.accuracy)(relative_error=relative)})
    about = light.attributes() | ({"cut_off": unmet} if unmet else {})
    # The full model first among those that cost the same.
    levels.sort(key=lambda level: (level.seconds(tolerance), level.setup_seconds, level.name != REFERENCE))
    result = Tradeoff(tuple(levels), tolerance, chosen, selected, time.perf_counter() - start, about)
    return unless_cut_off(result, unmet)


def measured(scene: Scene, name: str, base: PairedReadings, other: PairedReadings) -> Level:
    """A traced level of a scene against the reference, which has no bias against itself."""
    reading = signal = Bias(0.0, 0.0, 0.0)
    if other is not base:
        off = paired.difference(base, other)
        assert off.signal is not None
        reading, signal = bias_of(base, off.reading), bias_of(base, off.signal)
    root_s = math.sqrt(other.transfer.cpu_seconds)
    return Level(
        name=name,
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
    bound = float(np.nan_to_num(bounds, nan=np.inf, posinf=np.inf).max())
    mean, stderr = paired.weighted_mean(off, base)
    if not np.isfinite(mean):
        return Bias(mean, stderr, bound)
    # The weights are estimates, too: of n photons a relative variance 1 / n is known to 1 / sqrt(n).
    relative = base.relative_stderr
    drift = float(np.linalg.norm((off.value - mean) / relative) / (relative**-2.0).sum())
    return Bias(mean, math.hypot(stderr, shared * mean, drift), bound)


def formulas(scene: Scene, base: PairedReadings) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8), with constants from the mean paths of the reference.

    The reading at rest is the trace's, at what that costs; it is the signal that they may miss.
    """
    full = base.transfer.scene
    ends, depths, traced = paired.end_states(full), [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.detected_spectrum(led, full.elements)
        mu_a = optics.absorption(full, wavelength, blood_fraction=ends)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.rest_so2))
        reading, path_mm = read_replicates(base.transfer, i, mu_a, blood)
        mean = share @ blood / share.sum(1)
        depths.append(path_mm @ (ends[1] - ends[0]) * mean)
        traced.append(reading[..., 1] / reading[..., 0] - 1)
    unit, stderr = base.largest_modulation
    for name, change in FORMULAS.items():
        off = (change(np.stack(depths, 1)) - np.stack(traced, 1)) / unit
        signal = bias_of(base, Estimates.of_replicates(off), shared=stderr / unit)
        yield replace(measured(scene, f"{name}, traced", base, base), signal=signal)


def courses(scene: Scene, base: PairedReadings) -> Iterator[Level]:
    """Blood of a looser tolerance and of fewer samples: signals where blood between samples is off most."""
    full, (unit, stderr) = base.transfer.scene, base.largest_modulation
    blood_over_touch(full)  # the first one of a process imports and compiles
    usual, usual_s = _timed_course(full)
    blood = usual.blood_fraction.values
    ways: dict[str, tuple[dict[str, Any], Changes]] = {"vessels to 1e-3": ({"rtol": 1e-3}, {})}
    if usual.sizes["time"] > 2 * FEWER_SAMPLES:
        fewer = {"touch": {"sample_rate_hz": full.touch.sample_rate_hz / FEWER_SAMPLES}}
        ways[f"1 of {FEWER_SAMPLES} samples"] = {}, fewer
    for name, (way, changes) in ways.items():
        course, seconds = _timed_course(revised(full, changes), **way)
        other = np.stack([np.interp(usual.time, course.time, zone) for zone in course.blood_fraction.values])
        farthest = int(np.abs(other - blood).max(0).argmax())
        states = np.stack([blood[:, 0], blood[:, farthest], other[:, farthest]])
        rest, right, wrong = np.moveaxis(read_by_groups(base.transfer, full, states), -1, 0)
        off = (wrong - right) / rest / unit
        level = measured(scene, name, base, base)
        yield replace(
            level,
            signal=bias_of(base, Estimates.of_replicates(off), shared=stderr / unit),
            setup_seconds=level.setup_seconds + seconds - usual_s,
            changes=level.changes | changes,
            call="" if changes else f"nailoptics.hemodynamics.for_scene.blood_over_touch(scene, **{way})",
        )


def _timed_course(scene: Scene, **way: Any) -> tuple[xr.Dataset, float]:
    """Blood over a touch, and its processor time. [s]"""
    begin = time.process_time()
    return blood_over_touch(scene, **way), time.process_time() - begin


def other_zones(scene: Scene, base: PairedReadings, tracer: PairedTracer) -> Level:
    """The scene with eight blood zones, or with two if it has more: other blood under a touch, none at rest."""
    two = scene.zone_count == 2
    changes: Changes = {"blood": {"zones": 8 if two else None, "zone_edges_mm": (0.0,)}}
    other = tracer.trace(revised(base.transfer.scene, changes))
    level = measured(scene, "eight zones" if two else "two zones", base, other)
    return replace(level, reading=Bias(0.0, 0.0, 0.0), changes=level.changes | changes)
