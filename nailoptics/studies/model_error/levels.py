"""Levels of model of one scene, each measured against the full one: how far off it reads, and what it costs."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ... import tissue
from ...errors import InputError, NotReachedError
from ...light import ProgressCallback, optics
from ...light import backend as backends
from ...light.diffusion import DiffusionModel
from ...light.tracing import unlit
from ...light.transfer.series import read_replicates, readings_over_states
from ...options import BackendName, TraceOptions
from ...scene import Scene
from ...statistics import FEW_TERMS, farther_end, jackknife
from . import literature, paired
from .answers import MORE, Bias, Cost, Level, in_words
from .literature import FORMULAS
from .paired import PairedReadings, PairedTracer
from .stock import StockPass
from .stored_map import StoredMap
from .variants import ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, revised

DEFAULT_SECONDS = 120.0
REFERENCE, OWN = "full", "the scene itself"
BATCHES = (1 << 14, 1 << 16, 1 << 18)
# Stock Mitsuba gets this part of the time on each backend, if that is as many seconds at least.
STOCK_SHARE, STOCK_SECONDS = 0.08, 6.0
# Of fewer effective paths on all photodiodes its noise is not known, and it counts as not measured.
STOCK_PATHS = 30
# What is said to be needed is so many times that, for what else a command does.
ROOM = 1.2
# Standard error for which the memory of the kept photons is told.
KEPT_ERROR = 0.01
# The plate of the finger whose stored trace is read for the scene's.
THICKER = 1.1
# What is done in less is repeated until it has taken so long, to be timed. [s]
TIMED_SECONDS = 0.02
PARTS = ("bone", "epidermis", "kapton")
CHEAPER: dict[str, Changes] = {
    "matched indices": {"light": {"index_steps": False}},
    "similarity": {"light": {"similarity": True}},
    "similarity, matched": {"light": {"similarity": True, "index_steps": False}},
    "no epidermis, no Kapton": {"light": {"left_out": ["epidermis", "kapton"]}},
    "no bone either": {"light": {"left_out": list(PARTS)}},
}
FULL: Changes = {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}} | PART_WIDTH
MAP, THICKER_PLATE = "stored map, other layout", "stored trace, thicker plate"
DIFFUSION_CALL = "nailoptics.light.diffusion.DiffusionModel(scene).readings(blood)"
LITERATURE_CALL = "nailoptics.studies.model_error.literature.changes(scene, name, blood)"
MAP_CALL = "nailoptics.studies.model_error.stored_map.StoredMap.of(scene, ...).read(layout)"
STOCK: Changes = {"light": {"engine": "volpath"}}


@dataclass(frozen=True)
class Bench:
    """What the levels of one scene are measured with.

    full : the scene with everything in it, against whose readings, `base`, every level is held.
    changes : what of it makes each level that is traced with the same random numbers.
    others : backends that the full model is traced on, too; stock : those that can run stock Mitsuba, each for
        stock_seconds; 0 where that would be too few to see anything.
    """

    full: Scene
    changes: dict[str, Changes]
    others: Sequence[BackendName]
    stock: Sequence[BackendName]
    stock_seconds: float
    options: TraceOptions
    tracer: PairedTracer
    base: PairedReadings

    @classmethod
    def of(cls, scene: Scene, options: TraceOptions, *, progress: ProgressCallback | None) -> "Bench":
        """Trace a scene's full model, on one backend that compiles kernels.

        Raises: InputError where there is none; NotReachedError where a photodiode saw nothing to compare levels by.
        """
        chosen = backends.activate_jit(options.backend, "tradeoff")
        full = revised(scene, FULL)
        own = changes_between(full, scene)
        changes = ({OWN: own} if own else {}) | CHEAPER
        others = [f.name for f in backends.findings() if f.usable and f.name not in (chosen.name, "scalar")]
        stock = [one.name for one in (chosen, backends.choose("scalar")) if "volpath" in one.engines]
        # Each level's time is that of tracing it.
        walked, scenes = replace(options, backend=chosen.name, store=False), 3 + len(changes) + len(others)
        usual = None if options.photons or options.relative_error else DEFAULT_SECONDS
        stock_seconds = STOCK_SHARE * (options.max_seconds or usual or 0.0)
        if stock_seconds < STOCK_SECONDS:
            stock_seconds = 0.0
        tracer = PairedTracer(scenes, walked, progress, usual_seconds=DEFAULT_SECONDS, shapes=2)
        tracer.reserved_s = len(stock) * stock_seconds
        base = tracer.trace(full)
        found = base.transfer
        for led, photodiode in np.argwhere(~(base.level > 0)):
            raise NotReachedError(unlit(found.leds[led], found.photodiodes[photodiode], found.traces[led].photons))
        return cls(full, changes, others, stock, stock_seconds, options, tracer, base)

    def levels(self) -> Iterator[Level]:
        """Every level, as soon as it is measured."""
        for measure in LEVELS:
            yield from measure(self)

    def batches(self) -> dict[int, float]:
        """Processor seconds per million photons in batches of several sizes: what many small batches cost."""
        one_led = self.full.model_copy(update={"leds": self.full.leds[:1]})
        out = {}
        for photons in BATCHES:
            self.tracer.check_time()
            options = replace(self.tracer.options, photons=photons, relative_error=None, max_seconds=None)
            found = PairedTracer(1, options, None).trace(one_led)
            out[photons] = found.transfer.cpu_seconds / photons * 1e6
        return out

    @cached_property
    def reference(self) -> Level:
        """The full model, measured against itself."""
        return self.measured(REFERENCE, {}, self.base)

    @cached_property
    def states(self) -> np.ndarray:
        """Blood from rest to the touch's largest force, (1000, zones) float."""
        first, last = paired.end_states(self.full)
        return np.asarray(first + np.linspace(0, 1, MORE)[:, None] * (last - first))

    @cached_property
    def largest_modulation(self) -> float:
        """The largest change by touch of the reference's readings, as a part of them."""
        return float(np.abs(self.base.modulation).max())

    @cached_property
    def error_of_largest(self) -> float:
        """Relative standard error of that, which all signals share that are told as parts of it."""
        largest = int(np.argmax(np.abs(self.base.modulation)))
        return float(self.base.modulation_stderr.flat[largest]) / self.largest_modulation

    def measured(self, name: str, changes: Changes, other: PairedReadings) -> Level:
        """A traced level against the reference."""
        found = paired.difference(self.base, other)
        reading = self.bias(found.ratio, found.ratio_stderr, skew=found.ratio_skew)
        signal = self.bias(np.asarray(found.swing), np.asarray(found.swing_stderr), skew=found.swing_skew)
        if other is self.base:
            reading = signal = Bias(0.0, 0.0, 0.0)
        worst, spent = float(other.relative_stderr.max()), other.transfer.cpu_seconds
        worst_signal = float(other.modulation_stderr.max()) / self.largest_modulation
        kept = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in other.transfer.traces)
        reweighting = cpu_seconds(
            lambda: readings_over_states(other.transfer, self.states, weight_by_responsivity=True)
        )
        first = Cost(other.setup_seconds, 1.0)
        return Level(
            name=name,
            backend=other.transfer.backend,
            changes=changes,
            reading=reading,
            signal=signal,
            first=first,
            states=Cost(0.0, reweighting / spent),
            layouts=Cost(MORE * first.fixed, MORE * first.per_second),
            reading_noise=worst * math.sqrt(spent),
            signal_noise=worst_signal * math.sqrt(spent),
            memory_mb=kept * (worst / KEPT_ERROR) ** 2 / 1e6,
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

    def reading_of(self, level: np.ndarray, relative_stderr: ArrayLike = 0.0) -> Bias:
        """The bias of readings at rest that share no photons with the reference, and their relative errors."""
        gain = level / self.base.level
        return self.bias(gain - 1, gain * np.hypot(relative_stderr, self.base.relative_stderr))

    def signal_of(self, modulation: np.ndarray, error: ArrayLike = 0.0) -> Bias:
        """The bias of a signal that shares no photons with the reference, (led, photodiode) float, and its errors."""
        unit = self.largest_modulation
        noise = np.hypot(error, self.base.modulation_stderr) / unit
        return self.bias((modulation - self.base.modulation) / unit, noise, shared=self.error_of_largest)


def cpu_seconds(call: Callable[[], object]) -> float:
    """Processor time of a call, repeated where it is short. [s]"""
    begin, times = time.process_time(), 0
    while (spent := time.process_time() - begin) < TIMED_SECONDS:
        call()
        times += 1
    return spent / times


def reference(bench: Bench) -> Iterator[Level]:
    """The full model itself."""
    yield bench.reference


def one_wavelength(bench: Bench) -> Iterator[Level]:
    """Every LED's line as one wavelength: the same trace, so the same cost, whatever the noise of its error."""
    if any(led.fwhm_nm for led in bench.full.leds):
        narrow = paired.reweighted(bench.base.transfer, revised(bench.full, ONE_WAVELENGTH))
        level, full = bench.measured("one wavelength", ONE_WAVELENGTH, narrow), bench.reference
        yield replace(level, first=full.first, layouts=full.layouts, memory_mb=full.memory_mb)


def walked(bench: Bench) -> Iterator[Level]:
    """The same walk with parts of the model left out, and the full one on other backends."""
    for name, changes in bench.changes.items():
        yield bench.measured(name, changes, bench.tracer.trace(revised(bench.full, changes)))
    for backend in bench.others:
        yield bench.measured(f"{REFERENCE}, {backend}", {}, bench.tracer.trace(bench.full, backend=backend))


def stored(bench: Bench) -> Iterator[Level]:
    """What another finger's trace or a photon map of the board answers, once it is there."""
    plate_mm = bench.full.finger.nail_thickness_mm * THICKER if bench.full.finger else 0.0
    thicker = bench.tracer.trace(revised(bench.full, {"finger": {"nail_thickness_mm": plate_mm}}))
    level, rest = bench.measured(THICKER_PLATE, {}, thicker), bench.states[:1]
    read = cpu_seconds(lambda: readings_over_states(thicker.transfer, rest, weight_by_responsivity=True))
    yield replace(
        level,
        first=Cost(read),
        states=Cost(level.states.at(thicker.transfer.cpu_seconds)),
        reading_noise=0.0,
        signal_noise=0.0,
        beforehand=f"a trace of that finger ({level.first.at(thicker.transfer.cpu_seconds):.0f} s)",
        stored=True,
    )
    try:
        yield _mapped(bench)
    except InputError:
        # A board with walls on several sides has no bare board.
        return


def _mapped(bench: Bench) -> Level:
    """A photon map of the board without photodiodes, read where the scene has them."""
    full, base, photons = bench.full, bench.base, bench.base.transfer.traces[0].photons
    backend, check = bench.tracer.options.backend, bench.tracer.check_time
    found = StoredMap.of(full, photons=photons, seed=bench.options.seed, backend=backend, check=check)
    read = found.read(full)
    level, more = read[:, 0, :, 0], bench.states - bench.states[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.stack([jackknife(one) for one in read[..., 0]]) / level
        changes = read[..., 1:] @ more[-1] / read[..., 0]
        noise = np.stack([jackknife(one) for one in changes])
    few = ~(relative**2 < 1 / FEW_TERMS)
    each = cpu_seconds(lambda: found.read(full))
    return Level(
        name=MAP,
        backend=base.transfer.backend,
        reading=bench.reading_of(level, np.where(few, np.inf, relative)),
        signal=bench.signal_of(changes[:, 0], np.where(few, np.inf, noise)),
        first=Cost(each),
        states=Cost(cpu_seconds(lambda: read[:, 0, :, 1:] @ more.T)),
        layouts=Cost(MORE * each),
        beforehand=f"a map of that finger, board and LED ({found.cpu_seconds:.0f} s)",
        stored=True,
        call=MAP_CALL,
    )


def diffusion(bench: Bench) -> Iterator[Level]:
    """Layered diffusion, without a photon."""
    model = DiffusionModel(bench.full)
    found = model.readings(bench.states[[0, -1]])
    first = cpu_seconds(lambda: DiffusionModel(bench.full).readings(bench.states[[0, -1]]))
    yield Level(
        name="layered diffusion",
        backend="numpy",
        reading=bench.reading_of(found[..., 0]),
        signal=bench.signal_of(found[..., 1] / found[..., 0] - 1),
        first=Cost(first),
        states=Cost(cpu_seconds(lambda: model.readings(bench.states))),
        layouts=Cost(MORE * first),
        call=DIFFUSION_CALL,
    )


def formulas(bench: Bench) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8), with constants from literature, and with those of the reference's mean paths.

    From literature there is no reading at rest. With traced constants it is the trace's, at what that costs; it is the
    signal that they may miss.
    """
    full, base, ends = bench.full, bench.base, bench.states[[0, -1]]
    for name in FORMULAS:
        first, more = (cpu_seconds(partial(literature.changes, full, name, blood)) for blood in (ends, bench.states))
        yield Level(
            name=f"{name}, literature",
            backend="numpy",
            reading=None,
            signal=bench.signal_of(literature.changes(full, name, ends)[..., -1]),
            first=Cost(first),
            states=Cost(more),
            layouts=Cost(MORE * first),
            beforehand="one measured reading at rest",
            call=LITERATURE_CALL,
        )
    depths, traced = [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.spectrum(led)
        mu_a = optics.absorption(full, wavelength, blood_fraction=ends)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.rest_so2))
        read = read_replicates(base.transfer, i, mu_a, blood, seed=bench.options.seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depths.append(read.mean_path_mm @ ((ends[1] - ends[0]) * mean))
        traced.append(read.reading[..., 1] / read.reading[..., 0] - 1)
    along = np.multiply.outer(np.stack(depths)[:, 0], np.linspace(0, 1, MORE))
    for name, change in FORMULAS.items():
        values = (change(np.stack(depths)) - np.stack(traced)) / bench.largest_modulation
        error = np.stack([jackknife(one) for one in values])
        signal = bench.bias(values[:, 0], error, shared=bench.error_of_largest)
        spent = cpu_seconds(partial(change, along))
        yield replace(bench.reference, name=f"{name}, traced", signal=signal, states=Cost(spent))


def stock(bench: Bench) -> Iterator[Level]:
    """Stock Mitsuba on every backend that can run it, measured where there is time for it."""
    for backend in bench.stock:
        bench.tracer.reserved_s -= bench.stock_seconds
        level = Level(
            name=f"stock Mitsuba, {backend}",
            backend=backend,
            reading=None,
            signal=None,
            first=Cost(0.0, 1.0),
            states=Cost(0.0, MORE),
            layouts=Cost(0.0, MORE),
            reading_noise=math.inf,
            signal_noise=math.inf,
            remark=f"not measured: takes --max-seconds {ROOM * STOCK_SECONDS / STOCK_SHARE:.0f} or more",
            changes=STOCK,
        )
        yield replace(level, **_stock(bench, backend)) if bench.stock_seconds else level


def _stock(bench: Bench, backend: BackendName) -> dict[str, Any]:
    """Reading and noise of stock Mitsuba, which traces one wavelength, against the reference at that wavelength."""
    narrow = paired.reweighted(bench.base.transfer, revised(bench.full, ONE_WAVELENGTH))
    seconds, check = bench.stock_seconds, bench.tracer.check_time
    scene, seed = revised(bench.full, STOCK), bench.options.seed
    try:
        found = StockPass.of(scene, backend=backend, seconds=seconds, seed=seed, check=check)
    except InputError as error:
        return {"remark": f"not measured: {error}"}
    if found.effective_paths < STOCK_PATHS:
        longer = ROOM * seconds / STOCK_SHARE * STOCK_PATHS / max(found.effective_paths, 1.0)
        why = f"not measured: {found.effective_paths:.0f} effective paths in {found.path_seconds:.0f} s, "
        return {"remark": why + f"{STOCK_PATHS} are needed; takes about --max-seconds {longer:.0f}"}
    relative = found.relative_stderr(narrow.level)
    ratio, worst = found.level / narrow.level - 1, float(relative.max())
    noise = worst * math.sqrt(found.path_seconds)
    reading = bench.bias(ratio, paired.error_of_ratio(ratio, relative, narrow.relative_stderr))
    until = in_words(found.setup_seconds + (noise / KEPT_ERROR) ** 2)
    remark = f"{KEPT_ERROR:.0%} on every reading would take {until}: as the root of the time, from {worst:.0%} after "
    first = Cost(found.setup_seconds, 1.0)
    fields: dict[str, Any] = {"reading": reading, "reading_noise": noise, "first": first}
    return fields | {"remark": f"{remark}{in_words(found.path_seconds)}, one wavelength"}


# In the order in which they are measured.
LEVELS: tuple[Callable[[Bench], Iterator[Level]], ...] = (
    reference,
    formulas,
    diffusion,
    one_wavelength,
    walked,
    stored,
    stock,
)
