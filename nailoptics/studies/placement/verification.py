"""The best layout at close range: a fresh trace of its own board, and ambient light."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from ...errors import InputError
from ...light import ProgressCallback, backend as backends
from ...light.board_map import blood_point
from ...light.reference.readings import check_readable, read_leds
from ...options import TraceOptions
from ...scene import Scene
from ...sensor.ambient import PHOTONS, sources_of, trace_ambient
from ...sensor.information import OperatingPoint, force_resolution_n, scene_responses, total_information
from ...statistics import Z95, leave_one_out, seed_of
from ...variables import Estimate, Variables, described, jackknifed
from . import boards
from .candidates import CandidateLayout
from .objective import resolution_stderr_n
from .photon_maps import FingerCondition, PhotonMapCache, Stopped

LEAST_BATCHES = 8
# The fresh trace has this fraction of a full batch's photons in each of its batches at least.
LEAST_PART = 1 / 8
# A batch takes up to so long on two cores. [s]
SHORT_S = 10.0
# So much light comes through a board without a cover that few photons suffice, with an error that goes with the others.
OPEN_PHOTONS = 1 << 13
# Paths of stock Mitsuba for the photodiodes that share them. Their number is fixed: its batches are skewed, and to stop
# where they look settled favours low readings.
MITSUBA_PATHS = 1 << 20
COVERS = ("covered", "uncovered")
# Stream of random numbers.
FORWARD = 2


def _ambient(scene: Scene, values: np.ndarray, point: OperatingPoint, cache: PhotonMapCache) -> Variables:
    """Light from outside on each photodiode, with the cover and without, and what it leaves of the force resolution."""
    sources, traced = sources_of(scene), []
    options = TraceOptions(backend=cache.backend, store=bool(cache.stores))
    for cover_um, photons in ((scene.board.cover_um, PHOTONS), (0.0, OPEN_PHOTONS)):
        on = scene.model_copy(update={"board": scene.board.model_copy(update={"cover_um": cover_um})})
        cache.check_time()
        traced.append(trace_ambient(on, sources, options, seed=cache.seed, photons=photons))
    current, error, _ = np.stack(traced, 1)
    high = current + Z95 * error
    read = scene_responses(scene, values, point, ambient_a=high)
    return described(
        __package__,
        ambient_volts=np.max([r.amplified_v for r in read], axis=0),
        ambient_a=Estimate(current, error),
        ambient_high_a=high,
        ambient_noise_v=np.max([r.noise_v for r in read], axis=0),
        ambient_resolution_n=force_resolution_n(total_information(read), point),
    )


def verify_layout(layout: CandidateLayout, cache: PhotonMapCache, *, max_seconds: float) -> xr.Dataset:
    """Everything about a layout on the first finger that the map of its bare board does not contain; empty where the
    cache is to stop before.

    cache : has evaluated the layout; the fresh trace has as many photons, unless time runs out, and some in any case.
    max_seconds : the fresh trace takes half of it at most, the rest is left to light from outside. [s]
    """
    begin, condition, photons = time.perf_counter(), cache.conditions[0], cache.traced_board(layout.board).photons
    scene, point = boards.worn_on(layout.scene, condition.case), condition.point
    tracer = cache.tracer(scene)
    blood = tuple(blood_point(scene, led, blood_fraction=point.blood_fraction) for led in range(len(scene.leds)))
    means: list[np.ndarray] = []

    batches = max(LEAST_BATCHES, photons // tracer.batch_photons)
    # Where time is short, the batches that must be are small ones.
    least = round(LEAST_PART * min(photons, tracer.batch_photons))
    per_batch = least if max_seconds <= LEAST_BATCHES * SHORT_S else max(least, photons // batches)
    try:
        while len(means) < LEAST_BATCHES or (len(means) < batches and time.perf_counter() < begin + max_seconds / 2):
            detections = []
            for i, at in enumerate(blood):
                cache.check_time()
                seed = seed_of(cache.seed, FORWARD, i, len(means))
                detections.append(tracer.detected(i, at, photons=per_batch, seed=seed))
            means.append(np.stack(detections))
        values = leave_one_out(np.stack(means))
        data = described(__package__, checked_fraction=jackknifed(values[..., 0]))
        data |= _ambient(scene, values[0], point, cache)
    except Stopped:
        return xr.Dataset()
    read = scene_responses(scene, np.moveaxis(values, 1, 0), point, replicates=True)
    resolution = force_resolution_n(total_information(read), point)
    error = resolution_stderr_n(resolution)
    attributes = {"checked_resolution_n": float(resolution[0]), "checked_resolution_n_stderr": float(error)}
    unlit = {"volts": np.max([r.amplified_v[0] for r in read]), "noise_v": np.max([r.noise_v[0] for r in read])}
    attributes |= {f"checked_most_{name}": float(most) for name, most in unlit.items()}
    coordinates = {"led": [led.name for led in scene.leds], "best_photodiode": list(scene.layout.photodiode_names)}
    coordinates |= {"cover": list(COVERS), "ambient": [source.kind for source in sources_of(scene)]}
    return xr.Dataset(data, coords=coordinates, attrs=attributes)


def check_mitsuba(scenes: Sequence[Scene], backend: str) -> None:
    """Raise InputError where stock Mitsuba cannot read boards, or not in reasonable time."""
    if not backends.choose(backend, volpath=True).jit:
        raise InputError("verify_with_mitsuba: no backend here compiles volpath (see nailoptics doctor); leave it out.")
    for scene in scenes:
        check_readable(scene)


def verify_by_mitsuba(
    best: Scene,
    condition: FingerCondition,
    verified: xr.Dataset,
    options: TraceOptions,
    progress: ProgressCallback | None,
) -> xr.Dataset:
    """The readings of a layout on one finger by stock Mitsuba, over those of the fresh trace; empty if interrupted.

    verified : what `verify_layout` says of the layout.
    options : seed, backend, and whether batches are stored and taken from the store.
    """
    options = replace(options, photons=MITSUBA_PATHS, relative_error=None, max_seconds=None)
    scene = boards.worn_on(best, condition.case)
    try:
        traced = read_leds(scene, options, progress, condition.point.blood_fraction[None])
    except KeyboardInterrupt:
        return xr.Dataset()
    if traced[-1].interrupted:
        return xr.Dataset()
    # Values and standard errors.
    stock = np.stack([[reading.fraction[:, 0], reading.fraction_stderr[:, 0]] for reading in traced], 1)
    fresh = np.stack([verified.checked_fraction, verified.checked_fraction_stderr])
    # A path ends on one photodiode, so that their errors are independent.
    stock_sum, fresh_sum = (np.stack([of[0].sum(-1), np.linalg.norm(of[1], axis=-1)]) for of in (stock, fresh))
    return xr.Dataset(_over_fresh("mitsuba", stock, fresh) | _over_fresh("mitsuba_led", stock_sum, fresh_sum))


def _over_fresh(name: str, stock: np.ndarray, fresh: np.ndarray) -> Variables:
    """Light by stock Mitsuba over that of the fresh trace; both have values, then standard errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = stock[0] / fresh[0]
        error = ratio * np.hypot(stock[1] / stock[0], fresh[1] / fresh[0])
        z = (ratio - 1) / error
    return described(__package__, **{f"{name}_ratio": Estimate(ratio, error), f"{name}_z": z})
