"""The independent engine: readings by Mitsuba's stock volpath, LED by LED within an accuracy, and what lies between the
blood states that were traced.

It shares nothing with the photon walk but the scene: absorption acts along the way through real participating media.
"""

import hashlib
import math
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError, NotReachedError
from ...geometry import Geometry, build
from ...options import BackendName, TraceOptions
from ...scene import Scene
from ...statistics import seed_of
from .. import optics
from ..backend import NAMES, Backend, activate, choose
from ..optics import Media
from ..tracing import Ending, ProgressCallback, StoppingCriterion, TraceProgress, run_until, unlit
from ..tracing.stopping import out_of_time, share_of_time
from ..tracing.store import CacheEntry, LightStore, led_cache_key, load_or_compute
from ..transfer.records import ENERGY
from ..transfer.series import ReadingSeries
from . import mitsuba_scene
from .mitsuba_scene import LEAVING, BedAbsorption, Window

# The rgb variants carry three plain floats, at the cost of one; the spectral ones four.
RGB: dict[BackendName, str] = {name: f"{name}_ad_rgb" for name in NAMES} | {"scalar": "scalar_rgb"}
SPECTRAL: dict[BackendName, str] = {name: f"{name}_ad_spectral" for name in NAMES} | {"scalar": "scalar_rgb"}
PIXELS = mitsuba_scene.FILM * mitsuba_scene.FILM
# Mitsuba's seeds have 32 bits.
SEEDS = 1 << 32
# Batches of each round, whose spread gives the standard error. They are skewed: few of them look settled too soon, and
# stopping whenever they do favours low ones. So none stops before so many, and few rounds decide what is still needed.
ROUND_BATCHES, ROUND_GROWTH = 32, 3.0
# Every group of readings gets so many batches, whatever the time.
LEAST_BATCHES = 8
# Paths of the first round, and most paths of one batch, which runs uninterrupted.
FIRST_ROUND, MAX_BATCH_PATHS = 1 << 14, 1 << 15
# A photodiode that so many paths saw nothing of is taken for unlit.
UNLIT_PATHS = 1 << 23
# A zone whose blood changes by less than this fraction gets a state of its own, so that its mean path is known: by a
# fifth more, or less where half is blood; without blood, by a thousandth.
LEAST_CHANGE, OWN_CHANGE, OWN_BLOOD = 0.02, 0.2, 1e-3
# The bed's absorption is given on so many places per width of the step between two blood zones, and a little beyond
# the finger. [1, mm]
PLACES_PER_STEP, BEYOND_MM = 40, 0.2
# What an LED still gets when no time is left. [s]
LEAST_SECONDS = 1e-9


@contextmanager
def stock_mitsuba(backend: Backend, variants: Mapping[BackendName, str] = RGB) -> Iterator[Any]:
    """Mitsuba in one of the variants that this engine needs; the one that was set before returns afterwards."""
    if "volpath" not in backend.engines:
        raise InputError(f"volpath cannot run on {backend.library}: its kernels abort there; take the scalar backend.")
    # Dr.Jit loads its library at import, so only `activate`, which knows the right one, may import it.
    loaded = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded else None
    mi = activate(backend, variants)
    try:
        yield mi
    finally:
        if before and mi.variant() != before:
            mi.set_variant(before)


def _render(mi: Any, scene: Any, *, paths: int, seed: int) -> NDArray[np.float64]:
    """Mean of each channel over some paths, (channels,) float."""
    spp = max(1, math.ceil(paths / PIXELS))
    image = np.array(mi.render(scene, spp=spp, seed=seed % SEEDS), dtype=np.float64)
    mean = image.reshape(-1, image.shape[-1]).mean(axis=0)
    if not np.isfinite(mean).all():
        raise FloatingPointError(f"volpath gave {mean}")
    return np.asarray(mean)


class Paths:
    """Traces one LED's light to up to four readings at once, three by the scalar backend.

    made : the scene of a Mitsuba, which may write meshes to a folder; channel k of its film is reading k.
    scale : (channels,) float. Fraction of the LED's power per channel.
    """

    def __init__(self, made: Callable[[Any, Path], dict[str, Any]], scale: Sequence[float], backend: Backend) -> None:
        self._backend, self._scale = backend, np.array(scale)
        with stock_mitsuba(self._backend, SPECTRAL) as mi, tempfile.TemporaryDirectory(prefix="nailoptics-") as meshes:
            scene = made(mi, Path(meshes))
            self._scene = mi.load_dict(mitsuba_scene.spectral(scene) if self._backend.jit else scene, optimize=False)

    def batch(self, *, paths: int, seed: int) -> NDArray[np.float64]:
        """Fractions of the LED's power from one batch, (channels,) float; kernels cannot be interrupted."""
        with stock_mitsuba(self._backend, SPECTRAL) as mi:
            return np.asarray(_render(mi, self._scene, paths=paths, seed=seed)[: len(self._scale)] * self._scale)


def phantom_paths(scene: Scene, windows: Sequence[Window], *, led: int = 0, backend: Backend) -> Paths:
    """An LED's light that leaves a phantom through as many windows as there are channels."""
    assert scene.phantom is not None
    phantom, source = scene.phantom, scene.leds[led]
    # What is reciprocal is radiance over n squared. A beam reads the radiance that leaves along it; a die reads
    # irradiance, pi times as much.
    below = (phantom.n_below / phantom.n_above) ** 2
    read = 1.0 if source.pattern == "pencil" else math.pi
    scale = [(1.0 if window.top else below) / read for window in windows]
    return Paths(lambda mi, _: mitsuba_scene.phantom_scene(mi, phantom, source, windows), scale, backend)


def finger_paths(
    geometry: Geometry, media: Media, *, bed: BedAbsorption, led: int, photodiodes: tuple[int, ...], backend: Backend
) -> Paths:
    """An LED's light on one photodiode of a finger in up to three blood states, or on as many as there are channels.

    media, bed : as of `line_optics`; the bed's own mu_a in `media` is not used.
    led, photodiodes : indices into geometry.leds, whose light is taken to be Lambertian, and geometry.photodiodes;
        several only with one state.
    """
    channels, die = max(len(bed.mu_a_per_mm), len(photodiodes)), geometry.leds[led]
    colour = np.eye(mitsuba_scene.channel_count(SPECTRAL[backend.name]))
    colours = {geometry.photodiodes[p].region: colour[i].tolist() for i, p in enumerate(photodiodes)}
    if len(photodiodes) == 1:
        colours = dict.fromkeys(colours, [1.0] * len(colour))

    def made(mi: Any, folder: Path) -> dict[str, Any]:
        return mitsuba_scene.finger_scene(mi, geometry, media, bed, sensor=die.region, emitters=colours, folder=folder)

    # Irradiance E under radiance 1 gives a throughput E A; a Lambertian die of radiance 1 emits pi A.
    return Paths(made, [1 / math.pi] * channels, backend)


@dataclass(frozen=True)
class StateReadings:
    """Readings of every photodiode in a few blood states.

    fraction, fraction_stderr : (photodiodes, states) float. Detected fraction of the LED's power; the error is infinite
        where nothing was detected.
    ratio, ratio_stderr : (photodiodes, states) float. Reading over that of the first state; far less noisy than either.
    paths : How many every reading rests on, at least.
    unmet_reason : Why some fraction does not have the relative error that was required; None if all have.
    interrupted : Whether that is because the user ended it.
    energy : Where the light went, with standard errors; None where that is not known.
    """

    fraction: NDArray[np.float64]
    fraction_stderr: NDArray[np.float64]
    ratio: NDArray[np.float64]
    ratio_stderr: NDArray[np.float64]
    paths: int
    unmet_reason: str | None
    interrupted: bool
    energy: dict[str, tuple[float, float]] | None = None


def unmet(traced: Sequence[StateReadings]) -> NotReachedError | None:
    """Why readings fall short of what is required, if they do."""
    short = (NotReachedError(r.unmet_reason, interrupted=r.interrupted) for r in traced if r.unmet_reason)
    return next(short, None)


@dataclass(eq=False)
class _Group:
    """Readings that share their paths.

    photodiodes : names of those that it reads, or of the one that it reads in several states; none where it reads
        parts of the LED's power.
    sizes, rows : paths of each batch, and what it read, (channels,) float.
    seconds : that its batches took, stored ones when they were traced. [s]
    size, planned : paths of the next batch, and of all that are planned.
    """

    traced: Paths
    photodiodes: Sequence[str]
    entries: Sequence[CacheEntry] = ()
    sizes: list[int] = field(default_factory=list)
    rows: list[NDArray[np.float64]] = field(default_factory=list)
    seconds: float = 0.0
    size: int = 0
    planned: int = 0

    @property
    def paths(self) -> int:
        """How many there are."""
        return sum(self.sizes)

    def plan(self, more: int) -> None:
        """Plan a round of more paths; the film may hold a few more, so that all its pixels have the same number."""
        self.planned += max(more, ROUND_BATCHES)
        self.size = min(math.ceil(more / ROUND_BATCHES), MAX_BATCH_PATHS)

    def batch(self, seed: int) -> None:
        """Trace one batch, or take it from a store."""

        def trace() -> tuple[dict[str, Any], dict[str, np.ndarray]]:
            begin = time.perf_counter()
            row = self.traced.batch(paths=self.size, seed=seed)
            return {}, {"row": row, "seconds": np.array(time.perf_counter() - begin)}

        batch, _ = load_or_compute(self.entries, f"{seed}-{self.size}", trace, lambda _, arrays: arrays)
        self.rows.append(batch["row"])
        self.seconds += float(batch["seconds"])
        self.sizes.append(self.size)

    @property
    def error(self) -> float:
        """The largest relative standard error of a photodiode in its first state; an absolute one of parts."""
        if len(self.sizes) < 2:
            return math.inf
        mean, stderr = pooled(self.sizes, np.array(self.rows))
        of = mean[: len(self.photodiodes)] if self.photodiodes else np.ones_like(mean)
        return float(np.max(np.divide(stderr[: len(of)], of, out=np.full_like(of, math.inf), where=of > 0)))


def pooled(sizes: Sequence[int], rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean of batches (b, k) of so many paths (b,), and its standard error, (k,) float each."""
    weight = np.array(sizes) / sum(sizes)
    mean = weight @ rows
    return mean, np.sqrt(weight**2 @ (rows - mean) ** 2 * (len(rows) / (len(rows) - 1)))


def ratio_to_first(sizes: Sequence[int], rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ratio of each column's mean to the first column's, and its standard error, as `pooled`; columns share their
    noise. Ones with infinite errors where nothing was detected."""
    mean, _ = pooled(sizes, rows)
    if not mean[0] > 0:
        return np.ones_like(mean), np.full_like(mean, math.inf)
    ratio = mean / mean[0]
    return ratio, pooled(sizes, rows - rows[:, :1] * ratio)[1] / mean[0]


def _sample(
    groups: Sequence[_Group], led: str, options: TraceOptions, seed: int, progress: ProgressCallback | None
) -> tuple[str | None, bool]:
    """Trace groups of readings of an LED in rounds until each has the paths or the error that are required.

    No batch begins after max_seconds, but for the first few of each group.

    Returns: why what is required was not reached, if it was not, and whether the user interrupted.
    """
    begin, photons, max_seconds = time.perf_counter(), options.photons, options.max_seconds or math.inf
    # Without a tolerance or a number the time alone ends it.
    target = options.relative_error or 0.0
    criterion = StoppingCriterion(target=target, first=FIRST_ROUND, margin=1.05, growth=ROUND_GROWTH)
    dark = []
    for group in groups:
        group.plan(photons or criterion.first)

    def seconds() -> float:
        return time.perf_counter() - begin

    def worst() -> float:
        return max(group.error for group in groups)

    def needed() -> Iterator[_Group]:
        while unfinished := [group for group in groups if group.paths < group.planned]:
            yield min(unfinished, key=lambda group: group.paths / group.planned)

    def sample(group: _Group) -> None:
        group.batch(seed_of(seed, groups.index(group), len(group.sizes)))
        if group.paths < group.planned or photons:
            return
        unread = [name for name, lit in zip(group.photodiodes, np.any(group.rows, axis=0), strict=False) if not lit]
        if unread and group.paths >= UNLIT_PATHS:
            dark.append(unlit(led, unread[0], group.paths))
        elif more := criterion.needed(group.paths, group.error):
            group.plan(more)

    def is_late(_: _Group) -> bool:
        return seconds() >= max_seconds and min(len(group.sizes) for group in groups) >= LEAST_BATCHES

    def report() -> None:
        if progress:
            paths, error = min(group.paths for group in groups), worst()
            share = max(paths / photons if photons else criterion.share_done(error), seconds() / max_seconds)
            # What comes from a store counts as long as it took: so the pace holds for what is left.
            spent = max(seconds(), sum(group.seconds for group in groups))
            progress(TraceProgress(led, paths, error, target or None, min(1.0, share), spent))

    ending, so_far = run_until(needed(), sample, is_late=is_late, report=report), f"relative error {worst():.3g}"
    if ending is Ending.INTERRUPTED:
        if min(len(group.sizes) for group in groups) < 2:
            raise KeyboardInterrupt
        return f'interrupted: LED "{led}" has {so_far}.', True
    if ending is Ending.OUT_OF_TIME and (photons or target):
        return out_of_time(led, f"{so_far}, {target:g} requested" if target else so_far), False
    return (dark[0] if dark else None), False


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
    """Readings of all photodiodes in up to three blood states, until each has the error or paths, or time is up.

    Raises: InputError for an LED with a measured pattern, or a photodiode with an angular response.
    """
    check_readable(scene)
    backend = choose(options.backend, volpath=True)
    paths = partial(finger_paths, geometry, media, bed=bed, led=led, backend=backend)
    names, states = [face.name for face in geometry.photodiodes], len(bed.mu_a_per_mm)
    together = 1 if states > 1 else mitsuba_scene.channel_count(SPECTRAL[backend.name])
    parts = [tuple(range(k, min(k + together, len(names)))) for k in range(0, len(names), together)]
    columns = (np.ascontiguousarray(a).tobytes() for a in (*vars(media).values(), bed.v_mm, bed.mu_a_per_mm))
    key = led_cache_key(scene, led, seed=options.seed, backend=backend.name, what="volpath")
    key |= {"optics": hashlib.sha256(b"".join(columns)).hexdigest()}
    entries = [store.entry(key) for store in LightStore.of_command(options)]
    # One change of Mitsuba's variant for all batches.
    with stock_mitsuba(backend, SPECTRAL):
        groups = [_Group(paths(photodiodes=part), [names[i] for i in part], entries) for part in parts]
        reason, interrupted = _sample(groups, scene.leds[led].name, options, seed_of(options.seed, led), progress)
    return _readings(groups, reason, interrupted, states=states)


def check_readable(scene: Scene) -> None:
    """Raise InputError for an LED with a measured pattern, or a photodiode with an angular response."""
    for led in scene.leds:
        mitsuba_scene.check_pattern(led)
    for photodiode in scene.photodiodes:
        if photodiode.angular_response is not None:
            why = "leave it out, or use trace or simulate on a backend that compiles kernels."
            raise InputError(f'photodiode "{photodiode.name}": angular_response is not known to volpath; {why}')


def phantom_readings(
    scene: Scene, *, led: int, options: TraceOptions, progress: ProgressCallback | None = None
) -> StateReadings:
    """Read one LED over a phantom, and where its light went."""
    backend = choose(options.backend, volpath=True)
    paths = partial(phantom_paths, scene, led=led, backend=backend)
    with stock_mitsuba(backend, SPECTRAL):
        groups = [_Group(paths([Window(p.position_mm, p.size_mm)]), [p.name]) for p in scene.photodiodes]
        leaving = _Group(paths(LEAVING), [])
        ended = _sample([*groups, leaving], scene.leds[led].name, options, seed_of(options.seed, led), progress)
    rows = np.array(leaving.rows)
    mean, stderr = pooled(leaving.sizes, np.column_stack([rows, 1 - rows.sum(1), np.zeros(len(rows))]))
    energy = dict(zip(ENERGY, zip(mean.tolist(), stderr.tolist(), strict=True), strict=True))
    return replace(_readings(groups, *ended), energy=energy, paths=leaving.paths)


def _readings(groups: Sequence[_Group], reason: str | None, interrupted: bool, *, states: int = 1) -> StateReadings:
    """What groups read of their photodiodes, or of one in several states."""
    means = [np.reshape(pooled(group.sizes, np.array(group.rows)), (2, -1, states)) for group in groups]
    fraction, stderr = np.concatenate([np.zeros((2, 0, states)), *means], axis=1)
    ratios = [ratio_to_first(group.sizes, np.array(group.rows)) for group in groups] if states > 1 else []
    ratio, ratio_stderr = np.swapaxes(ratios, 0, 1) if ratios else (np.ones_like(fraction), np.zeros_like(fraction))
    paths = min((group.paths for group in groups), default=0)
    error = np.where(fraction > 0, stderr, math.inf)
    return StateReadings(fraction, error, ratio, ratio_stderr, paths, reason, interrupted)


def read_leds(
    scene: Scene, options: TraceOptions, progress: ProgressCallback | None, blood: np.ndarray | None
) -> list[StateReadings]:
    """The readings of every LED, each in its share of the time.

    blood : (states, zones) float in 0-1. Up to three states of a finger's blood.
    """
    begin, traced = time.perf_counter(), list[StateReadings]()
    finger = None if blood is None else build(scene)
    for i in range(len(scene.leds)):
        share = share_of_time(options.max_seconds, begin, len(scene.leds) - i)
        how: dict[str, Any] = {"led": i, "options": replace(options, max_seconds=max(share, LEAST_SECONDS))}
        if finger is None or blood is None:
            traced.append(phantom_readings(scene, progress=progress, **how))
        else:
            media, bed = line_optics(scene, finger, blood, i, along_line=choose(options.backend, volpath=True).jit)
            traced.append(finger_states(scene, finger, media, bed, progress=progress, **how))
        if traced[-1].interrupted and i + 1 < len(scene.leds):
            raise KeyboardInterrupt  # nothing is known of the other LEDs
    return traced


def line_optics(
    scene: Scene, finger: Geometry, blood: np.ndarray, led: int, *, along_line: bool
) -> tuple[Media, BedAbsorption]:
    """Optics of the regions, and absorption of the bed along the nail in each blood state, (states, zones) float.

    along_line : absorption and scattering at each wavelength of the LED's line, not at its peak alone.
    """
    source, zones = scene.leds[led], optics.zones(scene)
    media, is_line = optics.finger_media(scene, finger.regions, source.wavelength_nm), along_line and source.fwhm_nm > 0
    wavelength_nm = mitsuba_scene.line_wavelengths_nm(source) if is_line else np.array([source.wavelength_nm])
    if is_line:
        each = [optics.finger_media(scene, finger.regions, nm) for nm in wavelength_nm.tolist()]
        mu_a, mu_s = (np.stack([getattr(one, name) for one in each], axis=-1) for name in ("mu_a", "mu_s"))
        media = replace(media, mu_a=mu_a, mu_s=mu_s)
    low, high = np.asarray(finger.bounds_mm)[:, 1]
    places = 1 + round((high - low) / (zones.width_mm / PLACES_PER_STEP))
    v = np.linspace(low - BEYOND_MM, high + BEYOND_MM, places)
    of_zones = optics.absorption(scene, wavelength_nm, blood_fraction=blood)[..., list(optics.bed_columns(scene))]
    mu_a = np.swapaxes(of_zones @ zones.weights(v).T, -1, -2)
    return media, BedAbsorption(v, mu_a if is_line else mu_a[..., 0])


def corner_states(states: np.ndarray) -> np.ndarray:
    """The first state, and for each zone a state in which that zone alone is as far from it as it ever gets.

    states : (t, zones) float. Blood fractions. [1] Returns: (1 + zones, zones) float. [1]
    """
    rest = states[0]
    far = states[np.abs(states - rest).argmax(0), np.arange(len(rest))]
    own = np.where(rest < 0.5, (1 + OWN_CHANGE) * rest + OWN_BLOOD, (1 - OWN_CHANGE) * rest)
    far = np.where(np.abs(far - rest) <= LEAST_CHANGE * rest, own, far)
    return np.stack([rest, *(np.where(np.arange(len(rest)) == k, far, rest) for k in range(len(rest)))])


def between(traced: Sequence[StateReadings], corners: np.ndarray, blood: ArrayLike) -> ReadingSeries:
    """Readings between the corner states, which were traced for each LED: ln S is linear in the blood of each zone.

    corners : as `corner_states` makes them. blood : (t, zones) float. Blood fractions to read at. [1]

    The errors of the zones' ratios share noise of unknown sign, so they are added, which is an upper bound.
    """
    columns = ("fraction", "fraction_stderr", "ratio", "ratio_stderr")
    rest, stderr, ratio, ratio_stderr = (np.stack([getattr(one, name) for one in traced]) for name in columns)
    x = (np.asarray(blood, float) - corners[0]) / (np.diagonal(corners[1:]) - corners[0])
    # Where nothing was detected the errors are infinite, and what comes of them is not a number.
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction, level = rest[..., :1] * np.exp(np.log(ratio[..., 1:]) @ x.T), stderr[..., :1] / rest[..., :1]
        each = ratio_stderr[..., 1:] / ratio[..., 1:]
        spread, moved = (each @ np.abs(d).T for d in (x, x - x[0]))
        change = fraction - fraction[..., :1]
        stderr, change_stderr = fraction * np.hypot(level, spread), np.hypot(np.abs(change) * level, fraction * moved)
        return ReadingSeries(fraction, stderr, change, change_stderr)
