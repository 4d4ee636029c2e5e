"""Readings by stock volpath: LED by LED within an accuracy, and what lies between the blood states that were traced."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Geometry
from ...options import TraceOptions
from ...scene import Scene
from ...scene.parts import check_flat
from ...statistics import seed_of
from .. import optics
from ..backend import choose
from ..tracing import Ending, ProgressCallback, TraceProgress, Trigger, out_of_time, run_until, share_of_time, unlit
from ..transfer.series import ReadingSeries
from .mitsuba_scene import LEAVING, BedAbsorption, FingerPaths, Window, check_pattern, phantom_fractions

# Batches per photodiode that settle how its states differ; their noise is shared, so few do.
RATIO_BATCHES = 16
RATIO_SHARE = 0.4
BATCH_SECONDS = 1.5
# Batches are skewed: few of them look settled too soon, and stopping whenever they do favours low ones. So none stops
# before so many, and what is still needed is decided in few rounds.
LEAST_BATCHES = 30
ROUND_FACTOR = 4.0
# A photodiode that so many batches saw nothing of is taken for unlit.
UNLIT_BATCHES = 400
# Batches of each round over a phantom, whose spread gives the standard error.
ROUND_BATCHES = 32
# Paths of the first round, and most paths of one batch, which runs uninterrupted.
FIRST_ROUND, MAX_BATCH_PATHS = 1 << 16, 1 << 18
# A zone whose blood changes by less than this part of it gets a state of its own, so that its mean path is known: by a
# fifth more, or less where half is blood; without blood, by a thousandth.
LEAST_CHANGE, OWN_CHANGE, OWN_BLOOD = 0.02, 0.2, 1e-3
# The bed's absorption is given on so many places per width of the step between two blood zones, and a little beyond
# the finger. [1, mm]
PLACES_PER_STEP, BEYOND_MM = 40, 0.2
# What an LED still gets when no time is left. [s]
LEAST_SECONDS = 1e-9


@dataclass(frozen=True)
class StateReadings:
    """Readings of every photodiode in a few blood states.

    fraction, fraction_stderr : (photodiodes, states) float. Detected fraction of the LED's power; the error is infinite
        where nothing was detected.
    ratio, ratio_stderr : (photodiodes, states) float. Reading over that of the first state; far less noisy than either.
    batches, paths : How many in all.
    unmet_reason : Why some fraction does not have the relative error that was required; None if all have.
    interrupted : Whether that is because the user ended it.
    energy : Where the light went, with standard errors; None where that is not known.
    """

    fraction: NDArray[np.float64]
    fraction_stderr: NDArray[np.float64]
    ratio: NDArray[np.float64]
    ratio_stderr: NDArray[np.float64]
    batches: int
    paths: int
    unmet_reason: str | None
    energy: dict[str, tuple[float, float]] | None = None
    interrupted: bool = False


def finger_states(
    scene: Scene,
    geometry: Geometry,
    media: optics.Media,
    bed: BedAbsorption,
    *,
    led: int,
    options: TraceOptions,
    progress: ProgressCallback | None = None,
) -> StateReadings:
    """Readings of all photodiodes in up to three blood states, until each has the relative error or time is up.

    Colour channels first separate the states, photodiode by photodiode, which settles the ratios; then the
    photodiodes, three in one trace, which settles the level. The first part always runs, whatever the time; an
    interrupt (from `progress`) in the second ends it with what is there.

    options : with a relative error, which every reading must reach; no new batch begins after max_seconds.

    Raises: InputError for an LED with a measured pattern, or a photodiode with an angular response.
    """
    check_pattern(scene.leds[led])
    check_flat(scene.photodiodes, "volpath")
    tracer = partial(FingerPaths, geometry, media, led=led, backend=choose(options.backend, volpath=True))
    names = [face.name for face in geometry.photodiodes]
    batches = _Batches(tracer, bed, geometry.leds[led].name, names, options, progress, seed_of(options.seed, led))
    ratio, ratio_stderr = batches.settle_ratios()
    reason = batches.settle_levels()
    mean = np.array([np.mean(values) for values in batches.level])
    relative = np.array([relative_stderr(values) for values in batches.level])
    fraction = mean[:, None] * ratio
    error = np.full_like(fraction, math.inf)
    lit = mean > 0
    error[lit] = fraction[lit] * np.hypot(relative[lit, None], ratio_stderr[lit] / ratio[lit])
    paths, interrupted = batches.done * batches.paths, batches.interrupted
    return StateReadings(fraction, error, ratio, ratio_stderr, batches.done, paths, reason, interrupted=interrupted)


@dataclass
class _Batches:
    """The batches of one LED as they come, all of one size, so that all weigh the same.

    done, paths : How many batches there are, and the paths of each.
    level : Of each photodiode, its readings in the first state, batch by batch.
    start : of the performance counter. [s]
    """

    tracer: Callable[..., FingerPaths]
    bed: BedAbsorption
    led: str
    photodiodes: list[str]
    options: TraceOptions
    progress: ProgressCallback | None
    seed: int
    interrupted: bool = False
    done: int = 0
    paths: int = 0
    start: float = field(default_factory=time.perf_counter)

    def __post_init__(self) -> None:
        self.target, self.max_seconds = self.options.relative_error or 0.0, self.options.max_seconds or math.inf
        self.level: list[list[float]] = [[] for _ in self.photodiodes]
        self.trigger = Trigger(target=self.target, first=LEAST_BATCHES, margin=1.05, growth=ROUND_FACTOR - 1)

    def settle_ratios(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Each state's reading over that of the first state, and its standard error, (photodiodes, states) float."""
        ratios = []
        for i in range(len(self.level)):
            traced, rows = self.tracer(bed=self.bed, photodiodes=(i,)), []
            share = RATIO_SHARE * self.max_seconds / (RATIO_BATCHES * len(self.level))
            self.paths = self.paths or traced.paths_for(min(BATCH_SECONDS, share))
            for _ in range(RATIO_BATCHES):
                rows.append(self._trace(traced, (i,)))
                self._report()
            ratios.append(ratio_to_first(np.stack(rows)))
        ratio, stderr = np.reshape(ratios, (len(ratios), 2, -1)).swapaxes(0, 1)
        return ratio, stderr

    def settle_levels(self) -> str | None:
        """Trace the first state until every photodiode has the relative error; says why not, if they do not."""
        rest = BedAbsorption(self.bed.v_mm, self.bed.mu_a_per_mm[:1])
        # Photodiodes that are equally hard share a trace.
        order = sorted(range(len(self.level)), key=lambda i: relative_stderr(self.level[i]))
        groups = [tuple(order[k : k + 3]) for k in range(0, len(order), 3)]
        tracers: dict[tuple[int, ...], FingerPaths] = {}
        planned, reasons = dict.fromkeys(groups, LEAST_BATCHES), []

        def needed() -> Iterator[tuple[int, ...]]:
            while unfinished := [group for group in groups if len(self.level[group[0]]) < planned[group]]:
                yield max(unfinished, key=lambda group: planned[group] / len(self.level[group[0]]))

        def sample(group: tuple[int, ...]) -> None:
            if group not in tracers:
                tracers[group] = self.tracer(bed=rest, photodiodes=group)
            self._trace(tracers[group], group)
            count = len(self.level[group[0]])
            if count < planned[group]:
                return
            dark = [i for i in group if not any(self.level[i])]
            if dark and count >= UNLIT_BATCHES:
                reasons.append(unlit(self.led, self.photodiodes[dark[0]], count * self.paths))
            else:
                planned[group] += max(self.trigger.needed(count, relative_stderr(self.level[i])) for i in group)

        ending = run_until(
            needed(), sample, is_late=lambda group: self.seconds >= self.max_seconds, report=self._report
        )
        if ending is Ending.OUT_OF_TIME:
            return out_of_time(self.led, f"relative error {self.worst:.3g}, {self.target:g} requested")
        if ending is Ending.INTERRUPTED:
            self.interrupted = True
            return f'interrupted: LED "{self.led}" has {self.done} batches.'
        return reasons[0] if reasons else None

    @property
    def seconds(self) -> float:
        """Time since the first batch began. [s]"""
        return time.perf_counter() - self.start

    def _trace(self, traced: FingerPaths, photodiodes: tuple[int, ...]) -> NDArray[np.float64]:
        """Add one batch to the levels; its first readings are those of the photodiodes in the first state."""
        values = traced.batch(paths=self.paths, seed=seed_of(self.seed, self.done))
        for i, value in zip(photodiodes, values, strict=False):
            self.level[i].append(float(value))
        self.done += 1
        return values

    def _report(self) -> None:
        if self.progress:
            worst = self.worst
            share = min(1.0, max(self.trigger.share_done(worst), self.seconds / self.max_seconds))
            self.progress(TraceProgress(self.led, 0, worst, self.target, share, self.seconds))

    @property
    def worst(self) -> float:
        """The largest relative standard error so far."""
        return max(relative_stderr(values) for values in self.level)


def ratio_to_first(batches: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ratio of each column's mean to the first column's, and its standard error; columns share their noise.

    batches : (b, k) float.

    Returns two (k,) floats; ones with infinite errors where nothing was detected.
    """
    mean = batches.mean(axis=0)
    if not mean[0] > 0:
        return np.ones_like(mean), np.full_like(mean, math.inf)
    ratio = mean / mean[0]
    return ratio, (batches - batches[:, :1] * ratio).std(axis=0, ddof=1) / mean[0] / math.sqrt(len(batches))


def relative_stderr(values: list[float]) -> float:
    """Relative standard error of a mean; infinite while nothing was detected."""
    mean = float(np.mean(values)) if values else 0.0
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) / mean if mean > 0 and len(values) > 1 else math.inf


def read_leds(scene: Scene, options: TraceOptions, read: Callable[..., StateReadings]) -> list[StateReadings]:
    """The readings of every LED, each in its share of the time.

    read : reads one LED, given its number and the options for it alone.
    """
    begin, traced = time.perf_counter(), []
    for led in range(len(scene.leds)):
        share = share_of_time(options.max_seconds, begin, len(scene.leds) - led)
        traced.append(read(led, replace(options, max_seconds=max(share, LEAST_SECONDS))))
        if traced[-1].interrupted and led + 1 < len(scene.leds):
            raise KeyboardInterrupt  # nothing is known of the other LEDs
    return traced


def finger_readings(
    scene: Scene,
    finger: Geometry,
    blood: np.ndarray,
    progress: ProgressCallback | None,
    led: int,
    options: TraceOptions,
) -> StateReadings:
    """Read one LED of a finger in up to three blood states, (states, zones) float."""
    media = optics.finger_media(scene, finger.regions, scene.leds[led].wavelength_nm)
    bed = bed_absorption(scene, finger, blood, led)
    return finger_states(scene, finger, media, bed, led=led, options=options, progress=progress)


def bed_absorption(scene: Scene, finger: Geometry, blood: np.ndarray, led: int) -> BedAbsorption:
    """Absorption of the bed along the nail at an LED's wavelength, in each blood state, (states, zones) float."""
    zones = optics.zones(scene)
    mu_a = optics.absorption(scene, scene.leds[led].wavelength_nm, blood_fraction=blood)[:, 0]
    low, high = np.asarray(finger.bounds_mm)[:, 1]
    places = 1 + round((high - low) / (zones.width_mm / PLACES_PER_STEP))
    v = np.linspace(low - BEYOND_MM, high + BEYOND_MM, places)
    return BedAbsorption(v, mu_a[:, list(optics.bed_columns(scene))] @ zones.weights(v).T)


def _pooled(rounds: list[np.ndarray], sizes: list[int]) -> np.ndarray:
    """Mean and standard error of photodiodes, light reflected, transmitted, both of these, (p + 3, 2) float.

    rounds : (p + 3, batches) float each. sizes : paths of a batch of each round.
    """
    weight = np.array(sizes) / sum(sizes)
    mean = np.mean(rounds, -1)
    stderr = np.std(rounds, -1, ddof=1) / math.sqrt(ROUND_BATCHES)
    return np.array([[weight @ m, np.linalg.norm(weight * e)] for m, e in zip(mean.T, stderr.T, strict=True)])


def phantom_readings(scene: Scene, progress: ProgressCallback | None, led: int, options: TraceOptions) -> StateReadings:
    """Read one LED over a phantom, and where its light went.

    Paths are traced in rounds, each as long as all before it; the first always runs, and none begins after max_seconds.
    """
    name, target, max_seconds = scene.leds[led].name, options.relative_error, options.max_seconds or math.inf
    begin, rounds, sizes = time.perf_counter(), list[np.ndarray](), list[int]()
    # Without a tolerance or a number the time alone ends it.
    trigger = Trigger(target=target or 0.0, first=FIRST_ROUND, growth=1.0)
    windows = [*([Window(p.position_mm, p.size_mm)] for p in scene.photodiodes), LEAVING]
    made: dict[str, Any] = {"led": led, "batches": ROUND_BATCHES, "backend": choose(options.backend, volpath=True)}

    def worst() -> float:
        if not rounds:
            return math.inf
        estimates = _pooled(rounds, sizes)[:-3].tolist()
        return max((stderr / value if value > 0 else math.inf for value, stderr in estimates), default=0.0)

    def paths() -> int:
        return ROUND_BATCHES * sum(sizes)

    def seconds() -> float:
        return time.perf_counter() - begin

    def needed() -> Iterator[int]:
        while more := max(options.photons - paths(), 0) if options.photons else trigger.needed(paths(), worst()):
            yield more

    def sample(more: int) -> None:
        size = min(math.ceil(more / ROUND_BATCHES), MAX_BATCH_PATHS)
        *apertures, leaving = (
            phantom_fractions(
                scene, some, seed=seed_of(options.seed, led, len(rounds), k), paths_per_batch=size, **made
            )
            for k, some in enumerate(windows)
        )
        rounds.append(np.stack([*(batches[:, 0] for batches in apertures), *leaving.T, leaving.sum(1)]))
        sizes.append(size)

    def report() -> None:
        if progress:
            error = worst()
            share = paths() / options.photons if options.photons else trigger.share_done(error)
            share = min(1.0, max(share, seconds() / max_seconds))
            progress(TraceProgress(name, paths(), error, target, share, seconds()))

    ending = run_until(needed(), sample, is_late=lambda _: bool(rounds) and seconds() >= max_seconds, report=report)
    *values, reflected, transmitted, out = _pooled(rounds, sizes).tolist()
    met = ending is Ending.MET or not (options.photons or target)
    fraction, fraction_stderr = np.array(values).reshape(-1, 2, 1).swapaxes(0, 1)
    energy = {"reflected": reflected, "transmitted": transmitted, "absorbed": [1 - out[0], out[1]], "lost": [0.0, 0.0]}
    return StateReadings(
        fraction=fraction,
        fraction_stderr=fraction_stderr,
        ratio=np.ones_like(fraction),
        ratio_stderr=np.zeros_like(fraction),
        batches=len(rounds) * ROUND_BATCHES,
        paths=paths(),
        unmet_reason=None if met else out_of_time(name, f"relative error {worst():.3g}"),
        interrupted=ending is Ending.INTERRUPTED,
        energy={part: (value, stderr) for part, (value, stderr) in energy.items()},
    )


def corner_states(states: np.ndarray) -> np.ndarray:
    """The first state, and for each zone a state in which that zone alone is as far from it as it ever gets."""
    rest = states[0]
    far = states[np.abs(states - rest).argmax(0), np.arange(len(rest))]
    own = np.where(rest < 0.5, (1 + OWN_CHANGE) * rest + OWN_BLOOD, (1 - OWN_CHANGE) * rest)
    far = np.where(np.abs(far - rest) <= LEAST_CHANGE * rest, own, far)
    return np.stack([rest, *(np.where(np.arange(len(rest)) == k, far, rest) for k in range(len(rest)))])


def secant_paths(
    scene: Scene, corners: np.ndarray, ratio: np.ndarray, ratio_stderr: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean path in each blood zone, -d ln S / d mu_a between its two states; NaN for the other absorbers. [mm]"""
    out = np.full((2, *ratio.shape[:2], len(optics.absorbers(scene))), np.nan)
    for i, led in enumerate(scene.leds):
        mu_a = optics.absorption(scene, led.wavelength_nm, blood_fraction=corners)[:, 0]
        for k, column in enumerate(optics.bed_columns(scene)):
            span = mu_a[k + 1, column] - mu_a[0, column]
            out[0, i, :, column] = -np.log(ratio[i, :, k + 1]) / span
            out[1, i, :, column] = ratio_stderr[i, :, k + 1] / ratio[i, :, k + 1] / abs(span)
    return out[0], out[1]


def between(
    rest: np.ndarray,
    relative: np.ndarray,
    ratio: np.ndarray,
    ratio_stderr: np.ndarray,
    corners: np.ndarray,
    blood: np.ndarray,
) -> ReadingSeries:
    """Readings between the corner states: ln S is linear in the blood of each zone.

    The errors of the zones' ratios share noise of unknown sign, so they are added, which is an upper bound.
    """
    x = (blood - corners[0]) / (np.diagonal(corners[1:]) - corners[0])
    # Where nothing was detected the errors are infinite, and what comes of them is not a number.
    with np.errstate(invalid="ignore", divide="ignore"):
        of_rest = np.exp(np.log(ratio[..., 1:]) @ x.T)
        each = ratio_stderr[..., 1:] / ratio[..., 1:]
        spread, moved = (each @ np.abs(d).T for d in (x, x - x[0]))
        fraction, level = rest[..., None] * of_rest, relative[..., None]
        change = fraction - fraction[..., :1]
        return ReadingSeries(
            fraction=fraction,
            stderr=fraction * np.hypot(level, spread),
            change=change,
            change_stderr=np.hypot(np.abs(change) * level, fraction * moved),
        )
