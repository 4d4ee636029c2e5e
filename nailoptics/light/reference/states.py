"""The main job on stock volpath: every photodiode in a few blood states, within a tolerance or a time."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...geometry import Geometry
from ...options import TraceOptions
from ...scene import Scene
from ...scene.parts import check_flat
from ...statistics import seed_of
from ..backend import choose
from ..optics import Media
from ..tracing import Ending, ProgressCallback, TraceProgress, Trigger, out_of_time, run_until, unlit
from .integrate import BedAbsorption, FingerPaths
from .mitsuba_scene import check_pattern

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


@dataclass(frozen=True)
class StateReadings:
    """Readings of every photodiode in a few blood states.

    fraction, fraction_stderr : (photodiodes, states) float. Detected fraction of the LED's power; the error is infinite
        where nothing was seen.
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
    media: Media,
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
    backend = choose(options.backend, volpath=True)
    tracer = partial(FingerPaths, geometry, media, led=led, backend=backend)
    batches = _Batches(tracer, bed, geometry, led, options, progress)
    ratio, ratio_stderr = batches.settle_ratios()
    reason = batches.settle_levels()
    mean = np.array([np.mean(values) for values in batches.level])
    relative = np.array([relative_stderr(values) for values in batches.level])
    fraction = mean[:, None] * ratio
    error = np.full_like(fraction, math.inf)
    seen = mean > 0
    error[seen] = fraction[seen] * np.hypot(relative[seen, None], ratio_stderr[seen] / ratio[seen])
    paths = batches.done * batches.paths
    readings = StateReadings(fraction, error, ratio, ratio_stderr, batches.done, paths, reason)
    return replace(readings, interrupted=batches.interrupted)


class _Batches:
    """The batches of one LED as they come, all of one size, so that all weigh the same.

    level : Of each photodiode, its readings in the first state, batch by batch.
    done, paths : How many batches there are, and the paths of each.
    """

    def __init__(
        self,
        tracer: Callable[..., FingerPaths],
        bed: BedAbsorption,
        geometry: Geometry,
        led: int,
        options: TraceOptions,
        progress: ProgressCallback | None,
    ) -> None:
        self.tracer, self.bed, self.progress = tracer, bed, progress
        self.led, self.photodiodes = geometry.leds[led].name, [face.name for face in geometry.photodiodes]
        self.target, self.max_seconds = options.relative_error or 0.0, options.max_seconds or math.inf
        self.seed = seed_of(options.seed, led)
        self.start, self.done, self.paths = time.perf_counter(), 0, 0
        self.level: list[list[float]] = [[] for _ in self.photodiodes]
        self.trigger = Trigger(target=self.target, first=LEAST_BATCHES, margin=1.05, growth=ROUND_FACTOR - 1)
        self.interrupted = False

    def settle_ratios(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Each state's reading over that of the first state, and its standard error, (photodiodes, states) float."""
        found = []
        for i in range(len(self.level)):
            traced, rows = self.tracer(bed=self.bed, photodiodes=(i,)), []
            share = RATIO_SHARE * self.max_seconds / (RATIO_BATCHES * len(self.level))
            self.paths = self.paths or traced.paths_for(min(BATCH_SECONDS, share))
            for _ in range(RATIO_BATCHES):
                rows.append(self._trace(traced, (i,)))
                self._report()
            found.append(ratio_to_first(np.stack(rows)))
        ratio, stderr = np.reshape(found, (len(found), 2, -1)).swapaxes(0, 1)
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

    Returns two (k,) floats; ones with infinite errors where nothing was seen.
    """
    mean = batches.mean(axis=0)
    if not mean[0] > 0:
        return np.ones_like(mean), np.full_like(mean, math.inf)
    ratio = mean / mean[0]
    return ratio, (batches - batches[:, :1] * ratio).std(axis=0, ddof=1) / mean[0] / math.sqrt(len(batches))


def relative_stderr(values: list[float]) -> float:
    """Relative standard error of a mean; infinite while nothing was seen."""
    mean = float(np.mean(values)) if values else 0.0
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) / mean if mean > 0 and len(values) > 1 else math.inf
