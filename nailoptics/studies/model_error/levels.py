"""Levels of model of one scene, each measured against the full one: how far off it reads, and what it costs."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ... import tissue
from ...errors import InputError, NotReachedError, as_far_as_reached
from ...hemodynamics.for_scene import zones_of_photodiodes
from ...light import ProgressCallback, optics, read_rest
from ...light import backend as backends
from ...light.diffusion import DiffusionModel
from ...light.tracing import unlit
from ...light.transfer.series import read_replicates
from ...options import BackendName, TraceOptions
from ...scene import Scene
from ...statistics import farther_end, jackknife
from . import paired
from .changes import ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, lines_of, revised
from .paired import PairedReadings, PairedTracer

T = TypeVar("T")

DEFAULT_SECONDS = 120.0
REFERENCE, OWN = "full", "the scene itself"
# Stock Mitsuba gets this part of the time on each backend, if that is as many seconds at least.
STOCK_SHARE, STOCK_SECONDS = 0.08, 6.0
# Standard error for which the memory of the recorded photons is reported.
RECORDED_ERROR = 0.01
CHEAPER: dict[str, Changes] = {
    "matched indices": {"light": {"index_steps": False}},
    "similarity": {"light": {"similarity": True}},
    "similarity, matched": {"light": {"similarity": True, "index_steps": False}},
    "no epidermis, no Kapton": {"light": {"left_out": ["epidermis", "kapton"]}},
    "no bone either": {"light": {"left_out": ["bone", "epidermis", "kapton"]}},
}
FULL: Changes = {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}} | PART_WIDTH
STOCK: Changes = {"light": {"engine": "volpath"}}
DIFFUSION_CALL = "nailoptics.light.diffusion.DiffusionModel(scene).readings(blood)"
LITERATURE_CALL = "nailoptics.studies.model_error.levels.literature_changes(scene, name, blood)"
# Mean path of detected light over the distance from source to detector: adult forearm, 807 nm, distances of
# centimetres: 4.16 +- 0.78 (Duncan et al. 1995, Phys. Med. Biol. 40, 295). None was found for a finger or millimetres.
PATH_FACTOR = 4.16
# Relative change of a reading from the change of the optical depth along its path.
FORMULAS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Taylor (9)": np.negative,
    "Beer-Lambert (8)": lambda depth: np.expm1(-depth),
}


@dataclass(frozen=True)
class Bias:
    """How far a level is from the reference, as a part of it.

    value, stderr : mean over all photodiodes, weighed by the reference's errors.
    bound : what no photodiode's exceeds, with 95 % confidence each.
    """

    value: float
    stderr: float
    bound: float


@dataclass(frozen=True)
class Level:
    """One level of model, measured.

    reading : bias of the reading at rest; None where the level has none.
    signal : bias of the change by touch, as a part of the largest change of any photodiode; None where that is unknown.
    setup_seconds : processor time of the first answer before its photons; all of it where none are traced. [s]
    reading_noise, signal_noise : standard error of the worst reading, and of the worst change as a part of the largest,
        after one processor second of photons; 0 where none are traced. [s^0.5]
    memory_mb : of the photons recorded for a standard error of 1 %; None where none are.
    beforehand : what must be known beside the scene's media and shape; empty where nothing must.
    remark : what the numbers do not say; empty where they say all.
    changes : what of the scene selects it; nothing where the scene is so already.
    call : what gives it where no line of a scene does.
    """

    name: str
    backend: str
    reading: Bias | None
    signal: Bias | None
    setup_seconds: float
    reading_noise: float = 0.0
    signal_noise: float = 0.0
    memory_mb: float | None = None
    beforehand: str = ""
    remark: str = ""
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
        bounds = [math.inf if one is None else one.bound for one in (self.reading, self.signal)]
        return math.inf if any(math.isnan(one) for one in bounds) else max(bounds)

    def error(self, photon_seconds: float, coverage: float | None = None) -> float:
        """Error of the worst photodiode after so many seconds of photons.

        coverage : standard errors that are added to the bias; if not given, one standard error and the bias in squares.
        """
        if photon_seconds < 0 or not math.isfinite(self.bound):
            return math.inf
        errors = []
        for bias, noise in ((self.reading, self.reading_noise), (self.signal, self.signal_noise)):
            assert bias is not None
            stderr = noise / math.sqrt(photon_seconds) if photon_seconds else (math.inf if noise else 0.0)
            errors.append(math.hypot(bias.bound, stderr) if coverage is None else bias.bound + coverage * stderr)
        return max(errors)

    def photon_seconds(self, error: float, coverage: float | None = None) -> float:
        """Seconds of photons until that error is no more than this; inf where it never is. [s]"""
        if not self.bound <= error:
            return math.inf
        needed = 0.0
        for bias, noise in ((self.reading, self.reading_noise), (self.signal, self.signal_noise)):
            assert bias is not None
            left = error**2 - bias.bound**2 if coverage is None else ((error - bias.bound) / coverage) ** 2
            if noise:
                needed = max(needed, noise**2 / left if left > 0 else math.inf)
        return needed


@dataclass(frozen=True)
class ModelStudy:
    """What the levels of one scene are measured with.

    full : the scene with everything in it, against whose readings, `base`, every level is held.
    stock_seconds : for stock Mitsuba on each backend; 0 where that would be too few to detect anything.
    """

    scene: Scene
    full: Scene
    options: TraceOptions
    tracer: PairedTracer
    base: PairedReadings
    stock_seconds: float = 0.0

    @classmethod
    def of(cls, scene: Scene, options: TraceOptions, *, progress: ProgressCallback | None) -> "ModelStudy":
        """Trace a scene's full model, on one backend that compiles kernels.

        Raises: InputError where there is none; NotReachedError where a photodiode saw nothing to compare levels by.
        """
        chosen, full = backends.activate_jit(options.backend, "tradeoff"), revised(scene, FULL)
        # Each level's time is that of tracing it.
        walked = replace(options, backend=chosen.name, store=False)
        usual = None if options.photons or options.relative_error else DEFAULT_SECONDS
        stock_seconds = STOCK_SHARE * (options.max_seconds or usual or 0.0)
        stock_seconds = stock_seconds if stock_seconds >= STOCK_SECONDS else 0.0
        tracer = PairedTracer(3 + len(CHEAPER), walked, progress, usual_seconds=DEFAULT_SECONDS)
        tracer.reserved_s = 2 * stock_seconds
        base = tracer.trace(full)
        found = base.transfer
        for led, photodiode in np.argwhere(~(base.level > 0)):
            raise NotReachedError(unlit(found.leds[led], found.photodiodes[photodiode], found.traces[led].photons))
        return cls(scene, full, walked, tracer, base, stock_seconds)

    def levels(self) -> Iterator[Level]:
        """Every level, as soon as it is measured."""
        for measure in LEVELS:
            yield from measure(self)

    @cached_property
    def end_states(self) -> np.ndarray:
        """Blood at rest and at the touch's largest force, (2, zones) float."""
        return paired.end_states(self.full)

    @cached_property
    def largest_modulation(self) -> tuple[float, float]:
        """The largest change by touch of the reference's readings, as a part of them, and its relative error."""
        largest = int(np.argmax(np.abs(self.base.modulation)))
        value = float(np.abs(self.base.modulation.flat[largest]))
        return value, float(self.base.modulation_stderr.flat[largest]) / value

    def measured(self, name: str, changes: Changes, other: PairedReadings) -> Level:
        """A traced level against the reference."""
        found = paired.difference(self.base, other)
        reading = self.bias(found.ratio, found.ratio_stderr, skew=found.ratio_skew)
        signal = self.bias(np.asarray(found.swing), np.asarray(found.swing_stderr), skew=found.swing_skew)
        if other is self.base:
            reading = signal = Bias(0.0, 0.0, 0.0)
        worst, seconds = float(other.relative_stderr.max()), other.transfer.cpu_seconds
        worst_signal = float(other.modulation_stderr.max()) / self.largest_modulation[0]
        recorded = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in other.transfer.traces)
        return Level(
            name=name,
            backend=other.transfer.backend,
            changes=changes,
            reading=reading,
            signal=signal,
            setup_seconds=other.setup_seconds,
            reading_noise=worst * math.sqrt(seconds),
            signal_noise=worst_signal * math.sqrt(seconds),
            memory_mb=recorded * (worst / RECORDED_ERROR) ** 2 / 1e6,
        )

    def bias(self, values: np.ndarray, error: np.ndarray, *, shared: float = 0.0, skew: ArrayLike = 0.0) -> Bias:
        """The bias of a level from how far each of its readings is off, (led, photodiode) float, and the errors.

        shared : relative error of what all of them are parts of.
        skew : of each, its third moment over its variance.
        """
        bounds = farther_end(values, np.hypot(error, shared * values), skew)
        bound = float(np.max(np.where(np.isfinite(bounds), bounds, np.inf)))
        mean, stderr = paired.weighted_mean(values, error, self.base)
        if not np.isfinite(mean):
            return Bias(mean, stderr, bound)
        # The weights are estimates, too: of n photons a relative variance 1 / n is known to 1 / sqrt(n).
        relative = self.base.relative_stderr
        drift = float(np.linalg.norm((values - mean) / relative) / (relative**-2.0).sum())
        return Bias(mean, math.hypot(stderr, shared * mean, drift), bound)

    def signal_of(self, modulation: np.ndarray) -> Bias:
        """The bias of a signal that shares no photons with the reference, (led, photodiode) float."""
        unit, shared = self.largest_modulation
        noise = self.base.modulation_stderr / unit
        return self.bias((modulation - self.base.modulation) / unit, noise, shared=shared)


def timed(call: Callable[[], T]) -> tuple[T, float]:
    """What a call returns, and its processor time. [s]"""
    begin = time.process_time()
    return call(), time.process_time() - begin


def reference(study: ModelStudy) -> Iterator[Level]:
    """The full model itself."""
    yield study.measured(REFERENCE, {}, study.base)


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
    more = (blood_fraction - blood_fraction[0])[:, zones_of_photodiodes(scene)]
    return FORMULAS[name]((path_mm * mu_a[:, None])[..., None] * more.T)


def formulas(study: ModelStudy) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8), with constants from literature, and with those of the reference's mean paths.

    With traced constants the reading at rest is the trace's, at what that costs; it is the signal that they may miss.
    """
    full, base, ends = study.full, study.base, study.end_states
    depths, traced = [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.spectrum(led)
        mu_a = optics.absorption(full, wavelength, blood_fraction=ends)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.rest_so2))
        read = read_replicates(base.transfer, i, mu_a, blood, seed=study.options.seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depths.append(read.mean_path_mm @ ((ends[1] - ends[0]) * mean))
        traced.append(read.reading[..., 1] / read.reading[..., 0] - 1)
    unit, shared = study.largest_modulation
    for name, change in FORMULAS.items():
        found, seconds = timed(lambda name=name: literature_changes(full, name, ends)[..., -1])  # type: ignore[misc]
        yield Level(
            name=f"{name}, literature",
            backend="numpy",
            reading=None,
            signal=study.signal_of(found),
            setup_seconds=seconds,
            beforehand="one measured reading at rest",
            call=LITERATURE_CALL,
        )
        values = (change(np.stack(depths)) - np.stack(traced)) / unit
        signal = study.bias(values[:, 0], np.stack([jackknife(one) for one in values]), shared=shared)
        yield replace(study.measured(f"{name}, traced", {}, base), signal=signal)


def diffusion(study: ModelStudy) -> Iterator[Level]:
    """Layered diffusion, without a photon."""
    found, seconds = timed(lambda: DiffusionModel(study.full).readings(study.end_states))
    gain = found[..., 0] / study.base.level
    yield Level(
        name="layered diffusion",
        backend="numpy",
        reading=study.bias(gain - 1, gain * study.base.relative_stderr),
        signal=study.signal_of(found[..., 1] / found[..., 0] - 1),
        setup_seconds=seconds,
        call=DIFFUSION_CALL,
    )


def one_wavelength(study: ModelStudy) -> Iterator[Level]:
    """Every LED's line as one wavelength: the same trace, so the same cost, whatever the noise of its error."""
    if any(led.fwhm_nm for led in study.full.leds):
        narrow = paired.reweighted(study.base.transfer, revised(study.full, ONE_WAVELENGTH))
        level = study.measured("one wavelength", ONE_WAVELENGTH, narrow)
        yield replace(level, setup_seconds=study.base.setup_seconds)


def walked(study: ModelStudy) -> Iterator[Level]:
    """The same walk with parts of the model left out, and the full one on other backends."""
    own = changes_between(study.full, study.scene)
    for name, changes in (({OWN: own} if own else {}) | CHEAPER).items():
        yield study.measured(name, changes, study.tracer.trace(revised(study.full, changes)))
    for other in backends.findings():
        if other.usable and other.name not in (study.options.backend, "scalar"):
            backend: BackendName = other.name
            yield study.measured(f"{REFERENCE}, {backend}", {}, study.tracer.trace(study.full, backend=backend))


def stock(study: ModelStudy) -> Iterator[Level]:
    """Stock Mitsuba on every backend that can run it, measured where there is time for it."""
    jit = backends.choose(study.options.backend)
    for backend in (jit, backends.choose("scalar")):
        if "volpath" in backend.engines:
            study.tracer.reserved_s -= study.stock_seconds
            level = Level(
                name=f"stock Mitsuba, {backend.name}",
                backend=backend.name,
                reading=None,
                signal=None,
                setup_seconds=0.0,
                reading_noise=math.inf,
                signal_noise=math.inf,
                remark=f"not measured: takes max_seconds = {1.2 * STOCK_SECONDS / STOCK_SHARE:.0f} or more",
                changes=STOCK,
            )
            yield replace(level, **_stock(study, backend.name)) if study.stock_seconds else level


def _stock(study: ModelStudy, backend: BackendName) -> dict[str, Any]:
    """Reading and noise of stock Mitsuba, which traces one wavelength, against the reference at that wavelength."""
    narrow = paired.reweighted(study.base.transfer, revised(study.full, ONE_WAVELENGTH))
    study.tracer.check_time()
    scene = revised(study.full, STOCK)
    scene = scene.model_copy(update={"accuracy": type(scene.accuracy)()})
    how: dict[str, Any] = {"backend": backend, "seed": study.options.seed, "max_seconds": study.stock_seconds}
    try:
        found, _ = as_far_as_reached(read_rest, scene, **how)
    except InputError as error:
        return {"remark": f"not measured: {error}"}
    values = [[one["detected_fraction"], one["stderr"]] for one in found.readings]
    level, stderr = np.moveaxis(np.reshape(values, (*narrow.level.shape, 2)), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio, relative = level / narrow.level - 1, stderr / level
    if not np.isfinite(relative).all():
        return {"remark": f"not measured: {found.photons} paths in {found.cpu_seconds:.0f} s are too few"}
    worst = float(relative.max())
    return {
        "reading": study.bias(ratio, paired.error_of_ratio(ratio, relative, narrow.relative_stderr)),
        "reading_noise": worst * math.sqrt(found.cpu_seconds),
        "remark": f"one wavelength; {worst:.0%} on the worst reading after {found.cpu_seconds:.0f} s",
    }


# In the order in which they are measured.
LEVELS: tuple[Callable[[ModelStudy], Iterator[Level]], ...] = (
    reference,
    formulas,
    diffusion,
    one_wavelength,
    walked,
    stock,
)
