"""Error against processor time for every level of model, side by side on the user's scene."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import tissue
from ..errors import InputError, NotReachedError
from ..light import Progress, Rest, media, read_rest
from ..light import backend as backends
from ..scene import Scene
from . import variants
from .fits import Z95
from .replicates import read_led, stderr
from .variants import Look, revised

DEFAULT_SECONDS, DEFAULT_TOLERANCE = 120.0, 0.02
TARGETS = (0.01, 0.003, 0.001)
REFERENCE = "reference"
# Shares of the time: everything is measured against the reference, and volpath needs a start.
REFERENCE_SHARE, VOLPATH_SHARE = 3, 2
BATCHES = (1 << 14, 1 << 16, 1 << 18)
VOLPATH_ERROR = 0.01


@dataclass(frozen=True)
class Level:
    """One level of model, measured.

    bias, bias_stderr : relative error of the reading at rest, over all photodiodes weighed by the reference's errors.
    bias_bound : what no photodiode's error exceeds, with 95 % confidence each.
    signal_bias, signal_bias_stderr : relative error of the change by touch, likewise; None where it is not traced.
    cpu_seconds : to a relative standard error of 1 %, 0.3 % and 0.1 % of the worst reading.
    memory_mb : of the photons kept for 1 %; None where none are.
    setup_seconds : before the first photon.
    lines : scene lines that select it; empty for the scene as it is.
    proven : whether the bound, or for the reference nothing, lies within the tolerance.
    """

    name: str
    backend: str
    lines: str
    bias: float
    bias_stderr: float
    bias_bound: float
    signal_bias: float | None
    signal_bias_stderr: float | None
    cpu_seconds: tuple[float, ...]
    memory_mb: float | None
    setup_seconds: float
    proven: bool


@dataclass(frozen=True)
class Tradeoff:
    """All levels, the cheapest first; the one to take; what a batch of so many photons costs per million."""

    levels: tuple[Level, ...]
    tolerance: float
    chosen: str
    seconds_to_prove: float
    batches: dict[int, float]
    wall_seconds: float
    attributes: dict[str, Any]

    @property
    def choice(self) -> Level:
        """The cheapest level that provably meets the tolerance."""
        return next(level for level in self.levels if level.name == self.chosen)

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        kept = {name: value for name, value in vars(self).items() if name not in ("levels", "attributes", "batches")}
        batches = {str(photons): seconds for photons, seconds in self.batches.items()}
        made = {name: self.attributes[name] for name in ("digest", "photons")}
        rows = [vars(level) for level in self.levels]
        return kept | {"lines": self.choice.lines, "batches": batches} | made | {"levels": rows}

    def __str__(self) -> str:
        lines = [
            f"{'level':<26} {'reading off by':>18} {'at most':>8} {'signal off by':>17} "
            f"{'CPU s to 1 %':>12} {'0.3 %':>8} {'0.1 %':>8} {'MB':>6}"
        ]
        for one in self.levels:
            signal = ""
            if one.signal_bias is not None and one.signal_bias_stderr is not None:
                signal = f"{100 * one.signal_bias:+7.2f} +- {100 * one.signal_bias_stderr:4.2f} %"
            memory = "" if one.memory_mb is None else f"{one.memory_mb:.0f}"
            lines.append(
                f"{one.name:<26} {100 * one.bias:+8.2f} +- {100 * one.bias_stderr:4.2f} % {one.bias_bound:>8.1%} "
                f"{signal:>17} "
                f"{one.cpu_seconds[0]:>12.3g} {one.cpu_seconds[1]:>8.3g} {one.cpu_seconds[2]:>8.3g} {memory:>6}"
            )
        choice = self.choice
        lines.append(f"Cheapest that provably meets {self.tolerance:.2%} on every photodiode: {choice.name}.")
        lines.append(f"Scene lines: {choice.lines}" if choice.lines else "No scene line needs to change.")
        if np.isfinite(self.seconds_to_prove):
            lines.append(f"A cheaper one could be told with about --max-seconds {self.seconds_to_prove:.0f}.")
        return "\n".join(lines)


def tradeoff(
    scene: Scene,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    seed: int = 0,
    backend: str = "auto",
    photons: int | None = None,
    relative_error: float | None = None,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Tradeoff:
    """Measure bias and cost of every level of model on a finger scene, against its full model.

    Parameters
    ----------
    tolerance : relative error of a reading at rest that a level may have.
    max_seconds : for all levels together; 120 if neither photons nor an error is asked for.

    Raises: InputError.
    """
    if scene.finger is None:
        raise InputError("tradeoff needs a [finger] scene; a [phantom] has one level, itself.")
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance = {tolerance:g} must lie between 0 and 1.")
    chosen = backends.choose(backend)
    if not chosen.jit:
        raise InputError(f"tradeoff needs a JIT backend to compare levels, and {chosen.name} is none: {chosen.advice}")
    if photons is None and relative_error is None and max_seconds is None:
        max_seconds = DEFAULT_SECONDS
    start = time.perf_counter()
    full = revised(scene, {"light": {"engine": "auto", "index_steps": True, "similarity": False, "left_out": ()}})
    full = full.model_copy(update={"accuracy": type(scene.accuracy)()})
    levels = _levels(full)
    others = [f.name for f in backends.findings() if f.usable and f.name != chosen.name and f.name == "cuda"]
    stock = [chosen.name, *(["scalar"] if chosen.name != "scalar" else [])]
    shares = REFERENCE_SHARE + len(levels) + len(others) + VOLPATH_SHARE * len(stock)

    def seen(one: Scene, number: int, parts: int = 1, on: str = chosen.name) -> tuple[Look, float]:
        nonlocal shares
        begin = time.perf_counter()
        found, _ = variants.look(
            one,
            seed=seed + number,
            backend=on,
            photons=photons,
            relative_error=relative_error,
            max_seconds=None if max_seconds is None else max(1.0, (max_seconds - (begin - start)) * parts / shares),
            progress=progress,
        )
        shares -= parts
        return found, max(time.perf_counter() - begin - found.transfer.wall_seconds, 0.0)

    base, setup = seen(full, 0, REFERENCE_SHARE)
    measured = [_measured(REFERENCE, "", base, base, setup, tolerance)]
    measured += _formulas(full, base, setup, seed, tolerance)
    narrow = variants.reread(base.transfer, variants.without_lines(full))
    measured.append(_measured("one wavelength", "leds.fwhm_nm = 0", base, narrow, setup, tolerance))
    for number, (name, lines, one) in enumerate(levels, start=1):
        found, before = seen(one, number)
        measured.append(_measured(name, lines, base, found, before, tolerance))
    for name in others:
        found, before = seen(full, 50, on=name)
        measured.append(_measured(f"{REFERENCE} on {name}", "", base, found, before, tolerance))
    for name in stock:
        limit = (max_seconds or DEFAULT_SECONDS) - (time.perf_counter() - start)
        limit = max(1.0, limit * VOLPATH_SHARE / max(shares, VOLPATH_SHARE))
        shares -= VOLPATH_SHARE
        measured.append(_stock(full, narrow, seed, name, limit, tolerance, progress))
    measured.sort(key=lambda level: level.cpu_seconds[0])
    choice = next(level for level in measured if level.proven)
    return Tradeoff(
        levels=tuple(measured),
        tolerance=tolerance,
        chosen=choice.name,
        seconds_to_prove=_to_prove(measured, choice, tolerance, time.perf_counter() - start),
        batches=_batches(full, chosen.name, seed),
        wall_seconds=time.perf_counter() - start,
        attributes=base.transfer.attributes(),
    )


def _levels(full: Scene) -> list[tuple[str, str, Scene]]:
    """Cheaper scenes, with the lines that select them."""
    parts = ("bone", "epidermis", "kapton")
    light: Sequence[tuple[str, dict[str, Any]]] = (
        ("matched indices", {"index_steps": False}),
        ("similarity", {"similarity": True}),
        ("similarity, matched", {"similarity": True, "index_steps": False}),
        ("bare layers", {"left_out": parts}),
    )
    out = []
    for name, changes in light:
        shown = ("true" if v is True else "false" if v is False else str(list(v)) for v in changes.values())
        lines = "; ".join(f"light.{key} = {value}" for key, value in zip(changes, shown, strict=True))
        out.append((name, lines, revised(full, {"light": changes})))
    return out


def _measured(name: str, lines: str, base: Look, other: Look, setup: float, tolerance: float) -> Level:
    """A traced level against the reference; of the same photons only their spread about the change is an error."""
    ratio, error = variants.difference(base, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        swing = other.modulation / base.modulation - 1
        noise = np.hypot(base.modulation_stderr / base.modulation, other.modulation_stderr / other.modulation)
    if other.transfer.traces is base.transfer.traces:
        noise = swing * base.relative_stderr
    bias, bias_stderr, bound = _pooled(ratio, error, base)
    signal, signal_stderr, _ = _pooled(swing, np.abs(noise), base)
    worst = float(other.relative_stderr.max())
    kept = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in other.transfer.traces)
    return Level(
        name=name,
        backend=other.transfer.backend,
        lines=lines,
        bias=bias,
        bias_stderr=bias_stderr,
        bias_bound=bound,
        signal_bias=signal,
        signal_bias_stderr=signal_stderr,
        cpu_seconds=_cost(other.transfer.cpu_seconds, worst),
        memory_mb=kept * (worst / TARGETS[0]) ** 2 / 1e6,
        setup_seconds=setup,
        proven=name == REFERENCE or bound <= tolerance,
    )


def _pooled(ratio: np.ndarray, error: np.ndarray, base: Look) -> tuple[float, float, float]:
    """Mean over the readings, its error, and what no one exceeds."""
    bounds = np.abs(ratio) + Z95 * error
    return *variants.pooled(ratio, error, base), float(np.max(np.where(np.isfinite(bounds), bounds, np.inf)))


def _cost(cpu_seconds: float, error: float) -> tuple[float, ...]:
    return tuple(cpu_seconds * (error / target) ** 2 for target in TARGETS)


def _formulas(full: Scene, base: Look, setup: float, seed: int, tolerance: float) -> list[Level]:
    """Taylor (9) and Beer-Lambert (8) with the constants that the reference's mean paths give them."""
    errors: dict[str, list[np.ndarray]] = {"taylor": [], "beer_lambert": []}
    states = variants.end_states(full)
    for i, led in enumerate(full.leds):
        wavelength, share = media.spectrum(led)
        mu_a = media.absorption(full, wavelength, blood_fraction=states)
        blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, full.blood.so2))
        read = read_led(base.transfer, i, mu_a, blood, seed=seed)
        mean = float(np.average(blood, weights=share * wavelength))
        depth = read.fall @ ((states[1] - states[0]) * mean)
        traced = read.reading[..., 1] / read.reading[..., 0] - 1
        errors["taylor"].append(-depth / traced - 1)
        errors["beer_lambert"].append(np.expm1(-depth) / traced - 1)
    reference = _measured(REFERENCE, "", base, base, setup, tolerance)
    out = []
    for name, words in (("taylor", "Taylor (9)"), ("beer_lambert", "Beer-Lambert (8)")):
        values = np.stack(errors[name])
        signal, error, _ = _pooled(values[:, 0], np.stack([stderr(one) for one in values]), base)
        # At rest the formula is the reading that gave it its constants; it is the signal that it gets wrong.
        shown = vars(reference) | {"name": words, "signal_bias": signal, "signal_bias_stderr": error}
        out.append(Level(**shown | {"proven": abs(signal) + Z95 * error <= tolerance}))
    return out


def _stock(
    full: Scene,
    narrow: Look,
    seed: int,
    backend: str,
    max_seconds: float,
    tolerance: float,
    progress: Callable[[Progress], None] | None,
) -> Level:
    """Stock Mitsuba, which traces one wavelength, against the reference at that wavelength."""
    scene = revised(full, {"light": {"engine": "volpath"}})
    begin, cpu = time.perf_counter(), time.process_time()
    asked: dict[str, Any] = {"relative_error": VOLPATH_ERROR, "max_seconds": max_seconds}
    try:
        rest = read_rest(scene, seed=seed, backend=backend, progress=progress, **asked)
    except NotReachedError as error:
        if not isinstance(error.result, Rest):
            raise
        rest = error.result
    shape = narrow.level.shape
    value = np.array([row["detected_fraction"] for row in rest.readings]).reshape(shape)
    relative = np.array([row["stderr"] for row in rest.readings]).reshape(shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(value > 0, relative / value, np.inf)
        ratio = value / narrow.level - 1
        error_of = variants.error_of_ratio(ratio, relative, narrow.relative_stderr)
    bias, bias_stderr, bound = _pooled(ratio, error_of, narrow)
    return Level(
        name=f"stock Mitsuba, {backend}",
        backend=backend,
        lines='light.engine = "volpath"',
        bias=bias,
        bias_stderr=bias_stderr,
        bias_bound=bound,
        signal_bias=None,
        signal_bias_stderr=None,
        cpu_seconds=_cost(time.process_time() - cpu, float(relative.max())),
        memory_mb=None,
        setup_seconds=max(time.perf_counter() - begin - rest.wall_seconds, 0.0),
        proven=bound <= tolerance,
    )


def _to_prove(levels: list[Level], choice: Level, tolerance: float, spent: float) -> float:
    """Seconds after which a cheaper level would be told to meet the tolerance, if it does; NaN where none could."""
    needed = [
        spent * ((one.bias_bound - abs(one.bias)) / (tolerance - abs(one.bias))) ** 2
        for one in levels
        if one.cpu_seconds[0] < choice.cpu_seconds[0] and abs(one.bias) + one.bias_stderr < tolerance and not one.proven
        and one.bias_bound > tolerance
    ]  # fmt: skip
    return min(needed, default=float("nan"))


def _batches(full: Scene, backend: str, seed: int) -> dict[int, float]:
    """Processor seconds per million photons in batches of several sizes: what many small batches cost."""
    one_led = full.model_copy(update={"leds": full.leds[:1]})
    out = {}
    for photons in BATCHES:
        look, _ = variants.look(one_led, seed=seed + 90, backend=backend, photons=photons)
        out[photons] = look.transfer.cpu_seconds / photons * 1e6
    return out
