"""Error against processor time for every level of model, side by side on the user's scene."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Unpack

import numpy as np

from ... import tissue
from ...errors import NotReachedError
from ...light import ProgressCallback, RestReadings, optics, read_rest
from ...light import backend as backends
from ...light.course import course, read_replicates
from ...light.tracing import INTERRUPTED, unseen
from ...options import BackendName, Requested, TraceOptions
from ...scene import Scene
from ...statistics import Z95, jackknife
from . import paired
from .paired import PairedReadings, PairedTracer
from .variants import ONE_WAVELENGTH, PART_WIDTH, Changes, changes_between, lines_of, revised

DEFAULT_SECONDS, DEFAULT_TOLERANCE = 120.0, 0.02
TARGETS = (0.01, 0.003, 0.001)
REFERENCE, OWN = "full", "the scene itself"
BATCHES = (1 << 14, 1 << 16, 1 << 18)
# Stock Mitsuba gets this part of the time on each backend, towards this error.
VOLPATH_SHARE, VOLPATH_ERROR = 0.15, 0.01
# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1
# Blood states that a level is read at, to see what one more costs.
STATES = 1000
PARTS = ("bone", "epidermis", "kapton")
CHEAPER: tuple[tuple[str, Changes], ...] = (
    ("matched indices", {"light": {"index_steps": False}}),
    ("similarity", {"light": {"similarity": True}}),
    ("similarity, matched", {"light": {"similarity": True, "index_steps": False}}),
    ("no epidermis, no Kapton", {"light": {"left_out": ["epidermis", "kapton"]}}),
    ("no bone either", {"light": {"left_out": list(PARTS)}}),
)
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
class Tradeoff:
    """All levels, the cheapest first; the one to take, as a scene; what a batch of so many photons costs per million.

    seconds_to_prove : about how long would tell whether a cheaper level meets the tolerance; None where none could.
    """

    levels: tuple[Level, ...]
    tolerance: float
    chosen: str
    scene: Scene
    seconds_to_prove: float | None
    batches: dict[int, float]
    wall_seconds: float
    attributes: dict[str, Any]

    @property
    def choice(self) -> Level:
        """The cheapest level that provably meets the tolerance."""
        return next(level for level in self.levels if level.name == self.chosen)

    @property
    def front(self) -> list[Level]:
        """The Pareto front: levels than which none is both cheaper and nearer to the reference, cheapest first."""
        out: list[Level] = []
        for one in sorted(self.levels, key=lambda level: (level.cpu_seconds[0], abs(level.reading.value))):
            if np.isfinite(one.reading.value) and (not out or abs(one.reading.value) < abs(out[-1].reading.value)):
                out.append(one)
        return out

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        kept = {name: getattr(self, name) for name in ("tolerance", "chosen", "seconds_to_prove", "wall_seconds")}
        batches = {str(photons): seconds for photons, seconds in self.batches.items()}
        made = {name: self.attributes[name] for name in ("digest", "photons")}
        rows = [asdict(level) | {"lines": level.lines, "front": level in self.front} for level in self.levels]
        return kept | {"lines": self.choice.lines, "batches": batches} | made | {"levels": rows}

    def __str__(self) -> str:
        lines = [
            f"{'level':<24} {'reading off by':>18} {'at most':>8} {'signal off by':>17} {'at most':>8} "
            f"{'CPU s to 1 %':>12} {'0.3 %':>8} {'0.1 %':>8} {'MB':>6}  front"
        ]
        for one in self.levels:
            signal = bound = ""
            if one.signal is not None:
                signal = f"{100 * one.signal.value:+7.2f} +- {100 * one.signal.stderr:4.2f} %"
                bound = f"{one.signal.bound:.1%}"
            memory = "" if one.memory_mb is None else f"{one.memory_mb:.0f}"
            off = f"{100 * one.reading.value:+8.2f} +- {100 * one.reading.stderr:4.2f} %"
            off = off if np.isfinite(one.reading.value) else "not known"
            first, second, third = one.cpu_seconds
            lines.append(
                f"{one.name:<24} {off:>18} {one.reading.bound:>8.1%} {signal:>17} {bound:>8} "
                f"{first:>12.3g} {second:>8.3g} {third:>8.3g} {memory:>6}  {'*' if one in self.front else ''}"
            )
        choice = self.choice
        lines.append(f"Cheapest that provably meets {self.tolerance:.2%} on every photodiode: {choice.name}.")
        if choice.lines:
            lines += ["Scene lines that select it:", *(f"  {line}" for line in choice.lines)]
        else:
            lines.append("The scene is that already: no line needs to change.")
        if self.seconds_to_prove is not None:
            lines.append(f"A cheaper one could be proven with about --max-seconds {self.seconds_to_prove:.0f}.")
        return "\n".join(lines)


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

    tolerance : relative error of a reading at rest that a level may have.
    photons : of each LED in each trace; or
    relative_error : of the full model's trace, all others having as many photons; or
    max_seconds : for all levels together, about; 120 if nothing else is asked for.

    Raises: InputError; NotReachedError, whose result is the Tradeoff as far as it was made, if interrupted.
    """
    paired.check_study(scene, tolerance, "tradeoff", "has one level, itself")
    options = TraceOptions(**requested)
    chosen = backends.activate_jit(options.backend, "tradeoff")
    if options.unbounded:
        options = replace(options, max_seconds=DEFAULT_SECONDS)
    start = time.perf_counter()
    full = revised(scene, FULL)
    own = changes_between(full, scene)
    cheaper = (*(((OWN, own),) if own else ()), *CHEAPER)
    others = [f.name for f in backends.findings() if f.usable and f.name not in (chosen.name, "scalar")]
    stock = [one.name for one in (chosen, backends.choose("scalar")) if "volpath" in one.engines]
    volpath_seconds = VOLPATH_SHARE * (options.max_seconds or DEFAULT_SECONDS)
    left = None if options.max_seconds is None else options.max_seconds - len(stock) * volpath_seconds
    shared = replace(options, backend=chosen.name, max_seconds=left)
    tracer = PairedTracer(1 + len(cheaper) + len(others), shared, progress)
    base = _reference(full, tracer)
    measured: list[Level] = []
    batches, unmet = {}, None
    try:
        for level in _levels(full, base, tracer, cheaper, others, tolerance, options.seed):
            measured.append(level)
        for name in stock:
            limits = Requested(relative_error=VOLPATH_ERROR, max_seconds=volpath_seconds)
            limits |= Requested(seed=options.seed, backend=name)
            measured.append(_stock(full, base, tolerance, limits, progress))
        batches = _batches(full, tracer)
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error) or INTERRUPTED} ({len(measured)} levels were measured before)"
    # The full model first among those that cost the same.
    measured.sort(key=lambda level: (level.cpu_seconds[0], level.name != REFERENCE))
    choice, spent = _cheapest(measured), time.perf_counter() - start
    result = Tradeoff(
        levels=tuple(replace(one, changes=changes_between(scene, revised(full, one.changes))) for one in measured),
        tolerance=tolerance,
        chosen=choice.name,
        scene=revised(full, choice.changes),
        seconds_to_prove=_to_prove(measured, choice, tolerance, spent),
        batches=batches,
        wall_seconds=spent,
        attributes=base.transfer.attributes(),
    )
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _reference(full: Scene, tracer: PairedTracer) -> PairedReadings:
    """The full model; raises NotReachedError where a photodiode saw nothing to compare levels by."""
    base = tracer.trace(full)
    found = base.transfer
    for led, photodiode in np.argwhere(~(base.level > 0)):
        raise NotReachedError(unseen(found.leds[led], found.photodiodes[photodiode], found.traces[led].photons))
    return base


def _levels(
    full: Scene,
    base: PairedReadings,
    tracer: PairedTracer,
    cheaper: Sequence[tuple[str, Changes]],
    others: Sequence[BackendName],
    tolerance: float,
    seed: int,
) -> Iterator[Level]:
    """Every level that the photon walk gives, as soon as it is measured."""
    reference = _measured(REFERENCE, {}, base, base, tolerance)
    yield reference
    yield from _formulas(full, base, reference, seed, tolerance)
    if any(led.fwhm_nm for led in full.leds):
        narrow = paired.reweighted(base.transfer, revised(full, ONE_WAVELENGTH))
        level = _measured("one wavelength", ONE_WAVELENGTH, base, narrow, tolerance)
        # The same trace, so the same cost, whatever the noise of its error.
        yield replace(level, cpu_seconds=reference.cpu_seconds, memory_mb=reference.memory_mb)
    for name, changes in cheaper:
        yield _measured(name, changes, base, tracer.trace(revised(full, changes)), tolerance)
    for name in others:
        yield _measured(f"{REFERENCE}, {name}", {}, base, tracer.trace(full, backend=name), tolerance)


def _measured(name: str, changes: Changes, base: PairedReadings, other: PairedReadings, tolerance: float) -> Level:
    """A traced level against the reference."""
    found = paired.difference(base, other)
    reading = _bias(found.ratio, found.ratio_stderr, base)
    signal = _bias(np.asarray(found.swing), np.asarray(found.swing_stderr), base)
    if other is base:
        reading, signal = replace(reading, bound=0.0), replace(signal, bound=0.0)
    worst = float(other.relative_stderr.max())
    kept = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in other.transfer.traces)
    more = (worst / TARGETS[0]) ** 2
    first, last = paired.end_states(other.transfer.scene)
    begin = time.perf_counter()
    course(other.transfer, first + np.linspace(0, 1, STATES)[:, None] * (last - first), electrons=True)
    reweight_seconds = more * (time.perf_counter() - begin)
    return Level(
        name=name,
        backend=other.transfer.backend,
        changes=changes,
        reading=reading,
        signal=signal,
        cpu_seconds=_cost(other.transfer.cpu_seconds, worst),
        reweight_seconds=reweight_seconds,
        memory_mb=kept * more / 1e6,
        setup_seconds=other.setup_seconds,
        proven=reading.bound <= tolerance,
    )


def _bias(values: np.ndarray, error: np.ndarray, base: PairedReadings) -> Bias:
    bounds = np.abs(values) + Z95 * error
    bound = float(np.max(np.where(np.isfinite(bounds), bounds, np.inf)))
    return Bias(*paired.weighted_mean(values, error, base), bound)


def _cost(cpu_seconds: float, error: float) -> tuple[float, ...]:
    return tuple(cpu_seconds * (error / target) ** 2 for target in TARGETS)


def _formulas(full: Scene, base: PairedReadings, reference: Level, seed: int, tolerance: float) -> Iterator[Level]:
    """Taylor (9) and Beer-Lambert (8) with the constants that the reference's mean paths give them.

    At rest a formula is the reading that gave it its constants, at what that costs; it is the signal that it may miss.
    """
    states, along = paired.end_states(full), np.linspace(0, 1, STATES)
    depths, traced = [], []
    for i, led in enumerate(full.leds):
        wavelength, share = optics.spectrum(led)
        mu_a = optics.absorption(full, wavelength, blood_fraction=states)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.so2))
        read = read_replicates(base.transfer, i, mu_a, blood, seed=seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depths.append(read.mean_path_mm @ ((states[1] - states[0]) * mean))
        traced.append(read.reading[..., 1] / read.reading[..., 0] - 1)
    for name, change in (("Taylor (9)", np.negative), ("Beer-Lambert (8)", lambda depth: np.expm1(-depth))):
        values = (change(np.stack(depths)) - np.stack(traced)) / float(np.abs(base.modulation).max())
        signal = _bias(values[:, 0], np.stack([jackknife(one) for one in values]), base)
        begin = time.perf_counter()
        change(np.outer(depths[-1], along))
        spent = len(full.leds) * (time.perf_counter() - begin)
        yield replace(reference, name=name, signal=signal, reweight_seconds=spent, proven=signal.bound <= tolerance)


def _stock(
    full: Scene, base: PairedReadings, tolerance: float, limits: Requested, progress: ProgressCallback | None
) -> Level:
    """Stock Mitsuba, which traces one wavelength, against the reference at that wavelength."""
    narrow = paired.reweighted(base.transfer, revised(full, ONE_WAVELENGTH))
    scene = revised(full, STOCK)
    begin, cpu = time.perf_counter(), time.process_time()
    try:
        rest = read_rest(scene, progress=progress, **limits)
    except NotReachedError as error:
        if not isinstance(error.result, RestReadings) or str(error).startswith(INTERRUPTED):
            raise
        rest = error.result
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
        proven=reading.bound <= tolerance,
    )


def _cheapest(measured: list[Level]) -> Level:
    """The cheapest proven level; the scene itself, else the full model, where that costs as little within noise."""
    proven = {level.name: level for level in measured if level.proven}
    usual, first = proven.get(OWN, proven[REFERENCE]), next(iter(proven.values()))
    return first if first.cpu_seconds[0] < (1 - COST_NOISE) * usual.cpu_seconds[0] else usual


def _to_prove(levels: list[Level], choice: Level, tolerance: float, spent: float) -> float | None:
    """Seconds after which a cheaper level would be proven to meet the tolerance, if it does; None where none could."""
    cheaper = [one.reading for one in levels if not one.proven and one.cpu_seconds[0] < choice.cpu_seconds[0]]
    needed = [
        spent * ((bias.bound - abs(bias.value)) / (tolerance - abs(bias.value))) ** 2
        for bias in cheaper
        if abs(bias.value) + bias.stderr < tolerance < bias.bound < np.inf
    ]
    return min(needed, default=None)


def _batches(full: Scene, tracer: PairedTracer) -> dict[int, float]:
    """Processor seconds per million photons in batches of several sizes: what many small batches cost."""
    one_led = full.model_copy(update={"leds": full.leds[:1]})
    out = {}
    for photons in BATCHES:
        found = replace(tracer, options=replace(tracer.options, photons=photons), progress=None).trace(one_led)
        out[photons] = found.transfer.cpu_seconds / photons * 1e6
    return out
