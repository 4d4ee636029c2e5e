"""Levels of model of one scene, each measured against the full one: how far off it reads, and what it costs."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ... import tissue
from ...errors import NotReachedError, as_far_as_reached
from ...light import ProgressCallback, optics, read_rest
from ...light import backend as backends
from ...light.course import course, read_replicates
from ...light.tracing import INTERRUPTED, unseen
from ...options import BackendName, Requested, TraceOptions
from ...scene import Scene
from ...statistics import Z95, jackknife
from . import paired
from .paired import PairedReadings, PairedTracer
from .variants import ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, lines_of, revised

DEFAULT_SECONDS = 120.0
TARGETS = (0.01, 0.003, 0.001)
REFERENCE, OWN = "full", "the scene itself"
BATCHES = (1 << 14, 1 << 16, 1 << 18)
# Stock Mitsuba gets this part of the time on each backend, towards this error.
VOLPATH_SHARE, VOLPATH_ERROR = 0.15, 0.01
# Blood states that a level is read at, to see what one more costs.
STATES = 1000
PARTS = ("bone", "epidermis", "kapton")
CHEAPER: dict[str, Changes] = {
    "matched indices": {"light": {"index_steps": False}},
    "similarity": {"light": {"similarity": True}},
    "similarity, matched": {"light": {"similarity": True, "index_steps": False}},
    "no epidermis, no Kapton": {"light": {"left_out": ["epidermis", "kapton"]}},
    "no bone either": {"light": {"left_out": list(PARTS)}},
}
FULL: Changes = {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}} | PART_WIDTH
STOCK: Changes = {"light": {"engine": "volpath"}}


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

    reading : bias of the reading at rest.
    signal : bias of the change by touch, as a part of the largest change; None where that is not traced.
    cpu_seconds : to a relative standard error of 1 %, 0.3 % and 0.1 % of the worst reading.
    reweight_seconds : for a thousand more blood states from what gives 1 %; None where each is traced anew.
    memory_mb : of the photons kept for 1 %; None where none are.
    setup_seconds : before the first photon.
    changes : what of the scene selects it; nothing where the scene is so already.
    proven : whether its bounds, on what it does not take from the reference, lie within the tolerance.
    """

    name: str
    backend: str
    changes: Changes
    reading: Bias
    signal: Bias | None
    cpu_seconds: tuple[float, ...]
    reweight_seconds: float | None
    memory_mb: float | None
    setup_seconds: float
    proven: bool

    @property
    def lines(self) -> list[str]:
        """The scene lines that select it."""
        return lines_of(self.changes)


@dataclass(frozen=True)
class Bench:
    """What the levels of one scene are measured with.

    full : the scene with everything in it, against whose readings, `base`, every level is held.
    changes : what of it makes each level that is traced with the same random numbers.
    others : backends that the full model is traced on, too; stock : those that can run stock Mitsuba.
    """

    full: Scene
    changes: dict[str, Changes]
    others: Sequence[BackendName]
    stock: Sequence[BackendName]
    options: TraceOptions
    tracer: PairedTracer
    base: PairedReadings
    tolerance: float

    @classmethod
    def of(cls, scene: Scene, options: TraceOptions, *, tolerance: float, progress: ProgressCallback | None) -> "Bench":
        """Trace a scene's full model, on one backend that compiles kernels.

        Raises: InputError where there is none; NotReachedError where a photodiode saw nothing to compare levels by.
        """
        chosen = backends.activate_jit(options.backend, "tradeoff")
        full = revised(scene, FULL)
        own = changes_between(full, scene)
        changes = ({OWN: own} if own else {}) | CHEAPER
        others = [f.name for f in backends.findings() if f.usable and f.name not in (chosen.name, "scalar")]
        stock = [one.name for one in (chosen, backends.choose("scalar")) if "volpath" in one.engines]
        walked, scenes = replace(options, backend=chosen.name), 1 + len(changes) + len(others)
        if options.max_seconds is not None:
            walked = replace(walked, max_seconds=options.max_seconds * (1 - len(stock) * VOLPATH_SHARE))
        tracer = PairedTracer(scenes, walked, progress, usual_seconds=DEFAULT_SECONDS)
        base = tracer.trace(full)
        found = base.transfer
        for led, photodiode in np.argwhere(~(base.level > 0)):
            raise NotReachedError(unseen(found.leds[led], found.photodiodes[photodiode], found.traces[led].photons))
        return cls(full, changes, others, stock, options, tracer, base, tolerance)

    def levels(self) -> Iterator[Level]:
        """Every level, as soon as it is measured."""
        for measure in LEVELS:
            yield from measure(self)

    def batches(self) -> dict[int, float]:
        """Processor seconds per million photons in batches of several sizes: what many small batches cost."""
        one_led = self.full.model_copy(update={"leds": self.full.leds[:1]})
        out = {}
        for photons in BATCHES:
            options = replace(self.tracer.options, photons=photons)
            found = replace(self.tracer, options=options, progress=None).trace(one_led)
            out[photons] = found.transfer.cpu_seconds / photons * 1e6
        return out

    @cached_property
    def reference(self) -> Level:
        """The full model, measured against itself."""
        return self.measured(REFERENCE, {}, self.base)

    def measured(self, name: str, changes: Changes, other: PairedReadings) -> Level:
        """A traced level against the reference."""
        found = paired.difference(self.base, other)
        reading = _bias(found.ratio, found.ratio_stderr, self.base)
        signal = _bias(np.asarray(found.swing), np.asarray(found.swing_stderr), self.base)
        if other is self.base:
            reading, signal = replace(reading, bound=0.0), replace(signal, bound=0.0)
        worst = float(other.relative_stderr.max())
        kept = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in other.transfer.traces)
        more = (worst / TARGETS[0]) ** 2
        first, last = paired.end_states(other.transfer.scene)
        begin = time.perf_counter()
        course(other.transfer, first + np.linspace(0, 1, STATES)[:, None] * (last - first), electrons=True)
        return Level(
            name=name,
            backend=other.transfer.backend,
            changes=changes,
            reading=reading,
            signal=signal,
            cpu_seconds=_cost(other.transfer.cpu_seconds, worst),
            reweight_seconds=more * (time.perf_counter() - begin),
            memory_mb=kept * more / 1e6,
            setup_seconds=other.setup_seconds,
            proven=reading.bound <= self.tolerance,
        )


def reference(bench: Bench) -> Iterator[Level]:
    """The full model itself."""
    yield bench.reference


def one_wavelength(bench: Bench) -> Iterator[Level]:
    """Every LED's line as one wavelength: the same trace, so the same cost, whatever the noise of its error."""
    if any(led.fwhm_nm for led in bench.full.leds):
        narrow = paired.reweighted(bench.base.transfer, revised(bench.full, ONE_WAVELENGTH))
        level, full = bench.measured("one wavelength", ONE_WAVELENGTH, narrow), bench.reference
        yield replace(level, cpu_seconds=full.cpu_seconds, memory_mb=full.memory_mb)


def walked(bench: Bench) -> Iterator[Level]:
    """The same walk with parts of the model left out, and the full one on other backends."""
    for name, changes in bench.changes.items():
        yield bench.measured(name, changes, bench.tracer.trace(revised(bench.full, changes)))
    for backend in bench.others:
        yield bench.measured(f"{REFERENCE}, {backend}", {}, bench.tracer.trace(bench.full, backend=backend))


def _bias(values: np.ndarray, error: np.ndarray, base: PairedReadings) -> Bias:
    bounds = np.abs(values) + Z95 * error
    bound = float(np.max(np.where(np.isfinite(bounds), bounds, np.inf)))
    return Bias(*paired.weighted_mean(values, error, base), bound)


def _cost(cpu_seconds: float, error: float) -> tuple[float, ...]:
    return tuple(cpu_seconds * (error / target) ** 2 for target in TARGETS)


def formulas(bench: Bench) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8) with the constants that the reference's mean paths give them.

    At rest a formula is the reading that gave it its constants, at what that costs; it is the signal that it may miss.
    """
    full, base = bench.full, bench.base
    states, along = paired.end_states(full), np.linspace(0, 1, STATES)
    depths, traced = [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.spectrum(led)
        mu_a = optics.absorption(full, wavelength, blood_fraction=states)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.rest_so2))
        read = read_replicates(base.transfer, i, mu_a, blood, seed=bench.options.seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depths.append(read.mean_path_mm @ ((states[1] - states[0]) * mean))
        traced.append(read.reading[..., 1] / read.reading[..., 0] - 1)
    for name, change in (("Taylor (9)", np.negative), ("Beer-Lambert (8)", lambda depth: np.expm1(-depth))):
        values = (change(np.stack(depths)) - np.stack(traced)) / float(np.abs(base.modulation).max())
        signal = _bias(values[:, 0], np.stack([jackknife(one) for one in values]), base)
        begin = time.perf_counter()
        change(np.outer(depths[-1], along))
        spent = len(full.leds) * (time.perf_counter() - begin)
        proven = signal.bound <= bench.tolerance
        yield replace(bench.reference, name=name, signal=signal, reweight_seconds=spent, proven=proven)


def stock(bench: Bench) -> Iterator[Level]:
    """Stock Mitsuba on every backend that can run it."""
    seconds = VOLPATH_SHARE * (bench.options.max_seconds or DEFAULT_SECONDS)
    for backend in bench.stock:
        limits = Requested(relative_error=VOLPATH_ERROR, max_seconds=seconds, seed=bench.options.seed, backend=backend)
        yield _stock(bench, limits)


def _stock(bench: Bench, limits: Requested) -> Level:
    """Stock Mitsuba, which traces one wavelength, against the reference at that wavelength."""
    narrow = paired.reweighted(bench.base.transfer, revised(bench.full, ONE_WAVELENGTH))
    scene = revised(bench.full, STOCK)
    begin, cpu = time.perf_counter(), time.process_time()
    rest, unmet = as_far_as_reached(read_rest, scene, progress=bench.tracer.progress, **limits)
    if unmet and str(unmet).startswith(INTERRUPTED):
        raise unmet
    rows = [(row["detected_fraction"], row["stderr"]) for row in rest.readings]
    value, stderr = np.array(rows).T.reshape(2, *narrow.level.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(value > 0, stderr / value, np.inf)
        ratio = value / narrow.level - 1
        reading = _bias(ratio, paired.error_of_ratio(ratio, relative, narrow.relative_stderr), narrow)
    return Level(
        name=f"stock Mitsuba, {limits['backend']}",
        backend=limits["backend"],
        changes=STOCK,
        reading=reading,
        signal=None,
        cpu_seconds=_cost(time.process_time() - cpu, float(relative.max())),
        reweight_seconds=None,
        memory_mb=None,
        setup_seconds=max(time.perf_counter() - begin - rest.wall_seconds, 0.0),
        proven=reading.bound <= bench.tolerance,
    )


# In the order in which they are measured.
LEVELS: tuple[Callable[[Bench], Iterator[Level]], ...] = (reference, formulas, one_wavelength, walked, stock)
