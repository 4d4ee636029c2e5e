"""Readings by stock volpath: LED by LED within an accuracy, and what lies between the blood states that were traced."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ...geometry import Geometry
from ...options import TraceOptions
from ...scene import Scene
from ...statistics import seed_of
from .. import optics
from ..backend import choose
from ..tracing import Ending, ProgressCallback, TraceProgress, Trigger, out_of_time, run_until, share_of_time
from ..transfer.series import ReadingSeries
from .integrate import phantom_fractions
from .mitsuba_scene import LEAVING, BedAbsorption, Window
from .states import StateReadings, finger_states

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


def phantom_readings(scene: Scene, progress: ProgressCallback | None, led: int, options: TraceOptions) -> StateReadings:
    """Read one LED over a phantom, and where its light went.

    Paths are traced in rounds, each as long as all before it; the first always runs, and none begins after max_seconds.
    """
    name, target, max_seconds = scene.leds[led].name, options.relative_error, options.max_seconds or math.inf
    begin, rounds, sizes = time.perf_counter(), list[np.ndarray](), list[int]()
    # Without a tolerance or a number the time alone ends it.
    trigger = Trigger(target=target or 0.0, first=FIRST_ROUND, growth=1.0)

    def pooled() -> list[tuple[float, float]]:
        """Row by row: photodiodes, light reflected, transmitted, both of these."""
        return [_pooled(list(row), sizes) for row in zip(*rounds, strict=True)]

    def worst() -> float:
        return max((stderr / value if value > 0 else math.inf for value, stderr in pooled()[:-3]), default=0.0)

    def paths() -> int:
        return ROUND_BATCHES * sum(sizes)

    def needed() -> Iterator[int]:
        while more := max(options.photons - paths(), 0) if options.photons else trigger.needed(paths(), worst()):
            yield more

    def sample(more: int) -> None:
        size = min(math.ceil(more / ROUND_BATCHES), MAX_BATCH_PATHS)
        rounds.append(_phantom_round(scene, led, len(rounds), size, options))
        sizes.append(size)

    def report() -> None:
        if progress:
            error, seconds = worst(), time.perf_counter() - begin
            share = paths() / options.photons if options.photons else trigger.share_done(error)
            share = min(1.0, max(share, seconds / max_seconds))
            progress(TraceProgress(name, paths(), error, target, share, seconds))

    late = lambda more: bool(rounds) and time.perf_counter() - begin >= max_seconds  # noqa: E731
    ending = run_until(needed(), sample, is_late=late, report=report)
    *values, reflected, transmitted, out = pooled()
    met = ending is Ending.MET or not (options.photons or target)
    fraction, fraction_stderr = np.array(values).reshape(-1, 2, 1).swapaxes(0, 1)
    return StateReadings(
        fraction=fraction,
        fraction_stderr=fraction_stderr,
        ratio=np.ones_like(fraction),
        ratio_stderr=np.zeros_like(fraction),
        batches=len(rounds) * ROUND_BATCHES,
        paths=paths(),
        unmet_reason=None if met else out_of_time(name, f"relative error {worst():.3g}"),
        interrupted=ending is Ending.INTERRUPTED,
        energy={
            "reflected": reflected,
            "transmitted": transmitted,
            "absorbed": (1 - out[0], out[1]),
            "lost": (0.0, 0.0),
        },
    )


def _phantom_round(scene: Scene, led: int, number: int, size: int, options: TraceOptions) -> np.ndarray:
    """One round of batches: photodiodes, light reflected, transmitted, and both of these, (p + 3, batches) float."""
    windows = [*([Window(p.position_mm, p.size_mm)] for p in scene.photodiodes), LEAVING]
    made: dict[str, Any] = {"led": led, "batches": ROUND_BATCHES, "paths_per_batch": size}
    made["backend"] = choose(options.backend, volpath=True)
    *apertures, leaving = (
        phantom_fractions(scene, some, seed=seed_of(options.seed, led, number, k), **made)
        for k, some in enumerate(windows)
    )
    return np.stack([*(batches[:, 0] for batches in apertures), *leaving.T, leaving.sum(1)])


def _pooled(rounds: list[np.ndarray], sizes: list[int]) -> tuple[float, float]:
    """Mean and standard error of rounds of batches, each round weighed by the paths in a batch of it."""
    weight = np.array(sizes) / sum(sizes)
    mean = [float(np.mean(batches)) for batches in rounds]
    stderr = [float(np.std(batches, ddof=1) / math.sqrt(len(batches))) for batches in rounds]
    return float(weight @ mean), float(np.linalg.norm(weight * stderr))


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
    # Where nothing was seen the errors are infinite, and what comes of them is not a number.
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
