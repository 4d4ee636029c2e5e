"""How a worn sensor drifts and moves against the nail, and what that makes of its readings."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
import xarray as xr

from ..checks import Array
from ..errors import InputError, NotReachedError, as_far_as_reached
from ..light import DetectedLight, ProgressCallback, open_light
from ..light.tracing import accuracy
from ..light.transfer.series import ReadingSeries
from ..options import Requested, TraceOptions
from ..scene import Board, Scene
from ..statistics import seed_of
from ..variables import Estimate, Variables, described

# Random walks are drawn at so many knots in a second, whatever the rate of the samples, and are linear between them.
KNOTS_PER_S = 20.0
# So far the sensor is moved to see what that makes of its readings: far enough to stand out from the photons' noise,
# and little beside the 400 um of epoxy, or the 2 mm in which one blood zone passes into the next. [um]
LIFT_UM, SLIDE_UM = 40.0, 250.0
# Streams of the body's seed, beside those of its pressures.
_LED_DRIFT, _READING_DRIFT = 21, 22
_MOTIONS = {"lift": 23, "slide": 24}


@dataclass(frozen=True)
class MovedLight:
    """The light of a scene whose sensor was lifted or slid by some distance.

    motion : "lift" or "slide". distance_um : how far. [um]
    """

    motion: str
    distance_um: float
    light: DetectedLight


def worn_light(
    scene: Scene, *, states: Array, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> tuple[DetectedLight, tuple[MovedLight, ...], NotReachedError | None]:
    """The light under the scene's sensor in its place, and lifted and slid where its body moves it, and why some of
    it is less accurate than requested, if it is.

    states : (t, zones) float. The blood states that will be read. A limit in seconds holds for all traces together.
    """
    moves = moved_boards(scene)
    limit = accuracy(scene, TraceOptions(**requested)).max_seconds
    if moves and limit is not None:
        requested = requested | Requested(max_seconds=limit / (1 + len(moves)))
    given = {"states": states, "progress": progress, **requested}
    light, unmet = as_far_as_reached(open_light, scene, **given)
    moved = []
    for motion, distance_um, board in moves:
        there, also = as_far_as_reached(open_light, scene.model_copy(update={"board": board}), **given)
        moved.append(MovedLight(motion, distance_um, there))
        unmet = unmet or also
    return light, tuple(moved), unmet


def moved_boards(scene: Scene) -> list[tuple[str, float, Board]]:
    """The boards to be traced beside the scene's own: motion, distance [um] and board."""
    moves, board, moved = _rms_um(scene), scene.board, []
    if "lift" in moves:
        moved.append(("lift", LIFT_UM, board.model_copy(update={"adhesive_um": board.adhesive_um + LIFT_UM})))
    if "slide" in moves:
        moved.append(("slide", *_slid(scene)))
    return moved


def _slid(scene: Scene) -> tuple[float, Board]:
    """How far the board is slid along the nail [um], and the board; where the nail is no longer, it ends at its edge.

    Raises: InputError where the parts lie too near to both of the nail's ends.
    """
    (u, v), outline = scene.board.center_mm, scene.layout.outline
    corners = tuple((x - u, y - v) for x, y in outline.corners_mm)
    for cut in ({}, {"size_mm": None, "outline_mm": corners, "outline_holes_mm": ()}):
        for distance_um in (SLIDE_UM, -SLIDE_UM):
            update = cut | {"center_mm": (u, v + 1e-3 * distance_um)}
            slid = scene.model_copy(update={"board": scene.board.model_copy(update=update)})
            try:
                _ = slid.layout
            except InputError:
                continue
            return distance_um, slid.board
    raise InputError(
        f"body.motion.slide_um: the parts lie within {1e-3 * SLIDE_UM:g} mm of both ends of the nail, which leaves no "
        "room to slide the sensor; move them, or set slide_um = 0."
    )


def drift_and_motion(scene: Scene, time_s: Array) -> xr.Dataset:
    """What the body's seed makes of the sensor's drift and motion at times (t,); nothing of what the body leaves out.

    Drifts are factors on readings, 1 at the first time; motions lie about 0. [um]
    """
    body, since_s = scene.body, time_s - time_s[0]
    if body is None:
        return xr.Dataset()
    data: Variables = {}
    leds, photodiodes = len(scene.leds), len(scene.layout.photodiode_names)
    if drift := body.drift:
        walk = _random_walks(leds, since_s, seed_of(body.seed, _LED_DRIFT)) * drift.led_per_rt_min
        data |= described(__package__, led_drift=np.exp(walk))
        walk = _random_walks(leds * photodiodes, since_s, seed_of(body.seed, _READING_DRIFT)) * drift.reading_per_rt_min
        data |= described(__package__, reading_drift=np.exp(walk).reshape(leds, photodiodes, -1))
    for name, rms_um in _rms_um(scene).items():
        assert body.motion is not None
        course = _ornstein_uhlenbeck(since_s, body.motion.correlation_s, seed_of(body.seed, _MOTIONS[name]))
        data |= described(__package__, **{f"sensor_{name}_um": rms_um * course})
    return xr.Dataset(data)


def reading_gain(worn: xr.Dataset) -> Array:
    """Factor of LED and amplifier on readings by drift, (led, photodiode, t) or, without any, (1, 1, 1) float."""
    gain = worn.get("reading_drift", xr.DataArray([[[1.0]]])).values
    return np.asarray(gain * worn.get("led_drift", xr.DataArray([[1.0]])).values[:, None])


def motion_artefact(
    worn: xr.Dataset, in_place: ReadingSeries, moved: Sequence[MovedLight], blood: Array
) -> tuple[Array, Variables]:
    """What the sensor's motion makes of its readings: a factor on each, and how it comes about.

    worn : the scene's `drift_and_motion`. in_place : what is read with the sensor in its place, over blood (t, zones).
    moved : the light under the sensor elsewhere. Between both the logarithm of a reading goes with the distance.

    Returns: the factor, (led, photodiode, t) or, where nothing moves, (1, 1, 1) float.

    Raises: InputError where the sensor moves in a way that was not traced.
    """
    exponent, traced = np.zeros((1, 1, 1)), {shift.motion: shift for shift in moved}
    data: Variables = {}
    for name in _MOTIONS:
        if f"sensor_{name}_um" not in worn:
            continue
        if name not in traced:
            raise InputError(
                f"body.motion.{name}_um: light under a sensor that moves is traced by simulate alone; leave it out."
            )
        shift = traced[name]
        there = shift.light.readings_at(blood)
        with np.errstate(divide="ignore", invalid="ignore"):
            per_um = np.log(there.fraction / in_place.fraction) / shift.distance_um
            stderr = np.hypot(there.stderr / there.fraction, in_place.stderr / in_place.fraction) / shift.distance_um
        exponent = exponent + np.where(np.isfinite(per_um), per_um, 0.0) * worn[f"sensor_{name}_um"].values
        data |= described(__package__, **{f"{name}_per_um": Estimate(per_um[..., 0], stderr[..., 0])})
    return np.exp(exponent), data


def _rms_um(scene: Scene) -> dict[str, float]:
    """How far the body lifts and slides the sensor, where it does. [um]"""
    motion = scene.body and scene.body.motion
    every = {"lift": motion.lift_um, "slide": motion.slide_um} if motion else {}
    return {name: rms_um for name, rms_um in every.items() if rms_um > 0}


def _random_walks(count: int, since_s: Array, seed: int) -> Array:
    """Random walks from 0 whose standard deviation is 1 after a minute, (count, t); a longer course only adds to it."""
    knots = int(np.ceil(since_s[-1] * KNOTS_PER_S)) + 1
    steps = np.random.default_rng(seed).standard_normal((knots, count)) / np.sqrt(60.0 * KNOTS_PER_S)
    walk = np.concatenate([np.zeros((1, count)), np.cumsum(steps, axis=0)])
    at = np.arange(knots + 1) / KNOTS_PER_S
    return np.array([np.interp(since_s, at, column) for column in walk.T])


def _ornstein_uhlenbeck(since_s: Array, correlation_s: float, seed: int) -> Array:
    """An Ornstein-Uhlenbeck process of mean 0 and standard deviation 1, (t,) float."""
    from scipy.signal import lfilter

    knots = int(np.ceil(since_s[-1] * KNOTS_PER_S)) + 2
    drawn = np.random.default_rng(seed).standard_normal(knots)
    memory = np.exp(-1.0 / (KNOTS_PER_S * correlation_s))
    drawn[1:] *= np.sqrt(1.0 - memory**2)
    course = lfilter([1.0], [1.0, -memory], drawn)
    return np.interp(since_s, np.arange(knots) / KNOTS_PER_S, course)
