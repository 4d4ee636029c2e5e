"""The main job on stock volpath: every photodiode in a few blood states, within a tolerance or a time."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import Geometry
from ...scene import Scene
from ...statistics import seed_of
from ..backend import Backend
from ..optics import Media
from ..tracing import INTERRUPTED, unseen
from .integrate import BedAbsorption, FingerPaths

log = logging.getLogger(__name__)

# Batches per photodiode that settle how its states differ; their noise is shared, so few do.
RATIO_BATCHES = 16
RATIO_SHARE = 0.4
BATCH_SECONDS = 1.5
# Batches are skewed: few of them look settled too soon, and stopping whenever they do favours low ones. So none stops
# before so many, and what is still needed is decided in few rounds.
LEAST_BATCHES = 30
ROUND_FACTOR = 4.0
# A photodiode that so many batches saw nothing of is taken for dark.
DARK_BATCHES = 400


@dataclass(frozen=True)
class StateReadings:
    """Readings of every photodiode in a few blood states.

    fraction, fraction_stderr : (photodiodes, states) float. Detected fraction of the LED's power; the error is infinite
        where nothing was seen.
    ratio, ratio_stderr : (photodiodes, states) float. Reading over that of the first state; far less noisy than either.
    batches : Batches in all, each of `paths` paths.
    fell_short : Why some fraction does not have the relative error that was asked for; None if all have.
    """

    fraction: NDArray[np.float64]
    fraction_stderr: NDArray[np.float64]
    ratio: NDArray[np.float64]
    ratio_stderr: NDArray[np.float64]
    batches: int
    paths: int
    fell_short: str | None
    seconds: float


def finger_states(
    scene: Scene,
    geometry: Geometry,
    media: Media,
    *,
    bed: BedAbsorption,
    led: int,
    relative_error: float,
    max_seconds: float,
    seed: int,
    backend: Backend | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> StateReadings:
    """Readings of all photodiodes in up to three blood states, until each has the relative error or time is up.

    Colours first tell the states apart, photodiode by photodiode, which settles the ratios; then the photodiodes, three
    in one trace, which settles the level. The first part always runs, whatever the time; an interrupt (from `progress`)
    in the second ends it with what is there.

    relative_error : Relative standard error that every reading must reach.
    max_seconds : Wall time after which no new batch begins. [s]
    progress : Called after each batch with the worst relative error so far and the seconds spent.

    Raises: InputError for an LED with a measured pattern.
    """
    start = time.perf_counter()
    count, states = len(geometry.photodiodes), len(bed.mu_a_per_mm)

    def tracer(absorption: BedAbsorption, photodiodes: tuple[int, ...]) -> FingerPaths:
        return FingerPaths(
            geometry,
            media,
            bed=absorption,
            led=led,
            photodiodes=photodiodes,
            pattern=scene.leds[led],
            backend=backend,
        )

    def batch(traced: FingerPaths) -> NDArray[np.float64]:
        return traced.batch(paths=paths, seed=seed_of(seed, done))

    def told() -> None:
        worst = max(relative_stderr(values) for values in level)
        log.debug("volpath: %d batches, worst relative error %.3g", done, worst)
        if progress:
            progress(worst, time.perf_counter() - start)

    level: list[list[float]] = [[] for _ in range(count)]
    ratio, ratio_stderr = np.ones((count, states)), np.zeros((count, states))
    paths = done = 0
    for i in range(count):
        traced = tracer(bed, (i,))
        # Batches of one size, so that all of them weigh the same.
        paths = paths or traced.paths_for(min(BATCH_SECONDS, RATIO_SHARE * max_seconds / (RATIO_BATCHES * count)))
        rows = []
        for _ in range(RATIO_BATCHES):
            rows.append(batch(traced))
            level[i].append(float(rows[-1][0]))
            done += 1
            told()
        ratio[i], ratio_stderr[i] = ratio_to_first(np.stack(rows))
    rest = BedAbsorption(bed.v_mm, bed.mu_a_per_mm[:1])
    # Photodiodes that are equally hard share a trace.
    order = sorted(range(count), key=lambda i: relative_stderr(level[i]))
    groups = [tuple(order[k : k + 3]) for k in range(0, count, 3)]
    tracers: dict[tuple[int, ...], FingerPaths] = {}
    planned, name, fell_short = dict.fromkeys(groups, LEAST_BATCHES), scene.leds[led].name, None
    try:
        while unfinished := [group for group in groups if len(level[group[0]]) < planned[group]]:
            if time.perf_counter() - start >= max_seconds:
                fell_short = (
                    f'max_seconds ended the trace of LED "{name}" before the relative error of {relative_error:g} was '
                    "reached; allow more time or ask for less."
                )
                break
            group = max(unfinished, key=lambda group: planned[group] / len(level[group[0]]))
            if group not in tracers:
                tracers[group] = tracer(rest, group)
            for i, value in zip(group, batch(tracers[group]), strict=True):
                level[i].append(float(value))
            done += 1
            told()
            if len(level[group[0]]) == planned[group]:
                dark = [i for i in group if not any(level[i])]
                if dark and planned[group] >= DARK_BATCHES:
                    photodiode = geometry.photodiodes[dark[0]].name
                    fell_short = unseen(name, photodiode, planned[group] * paths)
                else:
                    planned[group] = max(batches_for(relative_error, level[i]) for i in group)
    except KeyboardInterrupt:
        fell_short = f'{INTERRUPTED}: LED "{name}" has {done} batches.'
    mean = np.array([np.mean(values) for values in level])
    relative = np.array([relative_stderr(values) for values in level])
    fraction = mean[:, None] * ratio
    error = np.full_like(fraction, math.inf)
    seen = mean > 0
    error[seen] = fraction[seen] * np.hypot(relative[seen, None], ratio_stderr[seen] / ratio[seen])
    return StateReadings(
        fraction=fraction,
        fraction_stderr=error,
        ratio=ratio,
        ratio_stderr=ratio_stderr,
        batches=done,
        paths=paths,
        fell_short=fell_short,
        seconds=time.perf_counter() - start,
    )


def batches_for(relative_error: float, values: list[float]) -> int:
    """Batches in all that should reach a relative error, judged by those that are there; at most so many times more."""
    factor = (relative_stderr(values) / relative_error) ** 2
    return len(values) if factor <= 1 else math.ceil(len(values) * min(1.05 * factor, ROUND_FACTOR))


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
