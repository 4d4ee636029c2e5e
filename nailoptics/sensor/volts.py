"""Light to volts over a touch, of a worn sensor: all light that it meets, in its place, where its body moves it and
from outside, its drift and motion, and what every photodiode reads, with its standard error and noise."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Unpack

import numpy as np
import xarray as xr

from ..checks import Array
from ..errors import InputError, NotReachedError, as_far_as_reached
from ..light import DetectedLight, ProgressCallback, ReweightWarning, Transfer, open_light, optics
from ..light.detect import rough_readings
from ..light.tracing import accuracy
from ..light.transfer.series import ReadingSeries, read_by_groups
from ..options import Requested, TraceOptions
from ..scene import Board, Scene
from ..statistics import Z95, quotient, seed_of
from ..variables import Estimate, Variables, described
from . import electronics
from .ambient import LAMP, ambient_bound_a, scene_ambient_a

# So far the sensor is moved to see what that makes of its readings: far enough to stand out from the photons' noise,
# and little beside the 400 um of epoxy, or the 2 mm in which one blood zone passes into the next. [um]
LIFT_UM, SLIDE_UM = 40.0, 250.0
# Random walks are drawn at so many knots in a second, whatever the rate of the samples, and are linear between them.
KNOTS_PER_S = 20.0
# Streams of the body's seed, beside those of its pressures.
_LED_DRIFT, _READING_DRIFT, _DONNING = 21, 22, 25
_MOTIONS = {"lift": 23, "slide": 24}


@dataclass(frozen=True)
class WornLight:
    """All light that a scene's sensor meets.

    scene : with a resistor at every photodiode.
    in_place : the light under the sensor in its place.
    ambient_a : (3, photodiodes) float. Photocurrents by the scene's [ambient], of `trace_ambient`; None without. [A]
    moved : the light under the sensor elsewhere, where the scene's body moves it, and how far that is [um], by "lift"
        and "slide".
    """

    scene: Scene
    in_place: DetectedLight
    ambient_a: Array | None
    moved: Mapping[str, tuple[float, DetectedLight]] = field(default_factory=dict)


def worn_light(
    scene: Scene, *, states: Array, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> tuple[WornLight, NotReachedError | None]:
    """Trace the light that a scene's sensor meets, and say why some of it is less accurate than requested, if it is.

    states : (t, zones) float. The blood states that will be read. A limit in seconds holds for all traces together.
    """
    moves, options = moved_boards(scene), TraceOptions(**requested)
    fitted, ambient_a = with_fitted_resistors(scene), scene_ambient_a(scene, options)
    limit = accuracy(scene, options).max_seconds
    if moves and limit is not None:
        requested = requested | Requested(max_seconds=limit / (1 + len(moves)))
    given = {"states": states, "progress": progress, **requested}
    light, unmet = as_far_as_reached(open_light, scene, **given)
    moved = {}
    for motion, distance_um, board in moves:
        there, also = as_far_as_reached(open_light, scene.model_copy(update={"board": board}), **given)
        moved[motion], unmet = (distance_um, there), unmet or also
    return WornLight(fitted, light, ambient_a, moved), unmet


def moved_boards(scene: Scene) -> list[tuple[str, float, Board]]:
    """The boards to be traced beside the scene's own: motion, distance [um] and board."""
    motion, board, moved = scene.body and scene.body.motion, scene.board, []
    if motion and motion.lift_um:
        moved.append(("lift", LIFT_UM, board.model_copy(update={"adhesive_um": board.adhesive_um + LIFT_UM})))
    if motion and motion.slide_um:
        moved.append(("slide", *_slid(scene)))
    return moved


def _slid(scene: Scene) -> tuple[float, Board]:
    """How far the board is slid along the nail [um], and the board, cut off at the nail's end; raises InputError where
    the parts lie too near to both of these."""
    (u, v), outline = scene.board.center_mm, scene.layout.outline
    corners = tuple((x - u, y - v) for x, y in outline.corners_mm)
    for cut in ({}, {"size_mm": None, "outline_mm": scene.board.outline_mm or corners}):
        for distance_um in (SLIDE_UM, -SLIDE_UM):
            update = cut | {"center_mm": (u, v + 1e-3 * distance_um)}
            slid = scene.model_copy(update={"board": scene.board.model_copy(update=update)})
            try:
                _ = slid.layout
            except InputError:
                continue
            return distance_um, slid.board
    why = "of both ends of the nail, which leaves no room to slide the sensor; move them, or set slide_um = 0."
    raise InputError(f"body.motion.slide_um: the parts lie within {1e-3 * SLIDE_UM:g} mm {why}")


def with_fitted_resistors(scene: Scene) -> Scene:
    """The scene with a resistor at every photodiode where it has "auto", the same for every command: fitted to the
    upper end of the 95 % interval of the brightest LED through a bed without blood, beside [ambient] or a lamp."""
    if electronics.has_resistors(scene):
        return scene
    ambient_a = ambient_bound_a(scene, usual=LAMP)
    with warnings.catch_warnings(action="ignore", category=ReweightWarning):  # few photons are allowed for below
        read = rough_readings(scene, np.zeros((1, scene.zone_count)))
    bound = (read.fraction + Z95 * np.nan_to_num(read.stderr))[..., 0]
    lit_a = [electronics.photocurrent_a(*both, scene.elements) for both in zip(bound, scene.leds, strict=True)]
    return electronics.with_resistors(scene, np.max(lit_a, axis=0) + ambient_a)


def read_volts(lit: WornLight, course: xr.Dataset) -> xr.Dataset:
    """Detected fractions and volts over the course, of `blood_over_touch`, with standard errors and noise, ambient
    light, and the sensor's drift and motion."""
    scene, light, blood = lit.scene, lit.in_place, course.blood_fraction.values.T
    readings = light.over(scene, course)
    worn = drift_and_motion(scene, course.time.values)
    motion, about_motion = motion_artefact(worn, readings, lit.moved, blood)
    # Only the light that arrives is moved light; what an LED or amplifier makes of it comes after.
    fraction, stderr, change_stderr = (
        np.multiply(motion, x, out=x) for x in (readings.fraction, readings.stderr, readings.change_stderr)
    )
    del readings
    gain = np.broadcast_to(reading_gain(worn), fraction.shape)
    # Drift and motion scale what is read: of its error they add their own part to the change's.
    scaled = np.broadcast_to(motion * gain / (motion * gain)[..., :1] - 1, fraction.shape)
    volts, volts_stderr, change, noise = (np.empty_like(fraction) for _ in range(4))
    diodes = scene.elements
    saturated = np.empty(fraction.shape, bool)
    ambient = {} if lit.ambient_a is None else electronics.ambient_in_readings(scene, *lit.ambient_a)
    ambient_a = np.zeros(fraction.shape[1]) if lit.ambient_a is None else lit.ambient_a[0]
    ohm, limit_v = electronics.stage_ohm(diodes, scene.electronics), electronics.limit_v(scene.electronics)
    crest_v = ohm * ambient_a * (scene.ambient.flicker if scene.ambient else 0.0)
    for i, j in np.ndindex(*fraction.shape[:2]):
        led, diode = scene.leds[i], diodes[j]
        read = electronics.read(gain[i, j] * fraction[i, j], led, diode, scene.electronics, ambient_a=ambient_a[j])
        per_fraction_v = electronics.volts_per_fraction(led, diode, scene.electronics) * gain[i, j]
        volts[i, j], noise[i, j] = read.volts, read.volts_noise_rms
        saturated[i, j], full = read.amplified_v + crest_v[j] >= limit_v, read.saturated
        change[i, j] = read.volts - read.volts[0]
        of_change = np.hypot(change_stderr[i, j], scaled[i, j] * stderr[i, j]) * per_fraction_v
        # At its limit a reading is known, and its change as well as the other of the two is.
        volts_stderr[i, j] = np.where(full, 0.0, stderr[i, j] * per_fraction_v)
        change_stderr[i, j] = np.where(
            full | full[0], np.where(full, volts_stderr[i, j, 0], volts_stderr[i, j]), of_change
        )
    data = ambient | about_motion
    data |= described(
        __package__,
        detected_fraction=Estimate(fraction, stderr),
        volts=Estimate(volts, volts_stderr),
        volts_change=Estimate(change, change_stderr),
        volts_noise_rms=noise,
        saturated=saturated,
        feedback_ohm=ohm,
        responsivity_a_per_w=[[optics.line_response(led, diode).sum() for diode in diodes] for led in scene.leds],
        mean_path_mm=Estimate(light.mean_path, light.mean_path_stderr),
        wavelength_nm=[led.wavelength_nm for led in scene.leds],
        zone_of_photodiode=list(scene.zones_of_photodiodes),
    )
    names = {"led": [led.name for led in scene.leds], "photodiode": list(scene.layout.photodiode_names)}
    return xr.Dataset(data, names | {"absorber": list(light.absorbers)}).merge(worn)


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
        number = np.cumsum(np.diff(scene.touch.is_off(time_s), prepend=False)) // 2
        drawn = np.random.default_rng(seed_of(body.seed, _DONNING)).normal(size=(number[-1], leds * photodiodes))
        walk += drift.donning * np.concatenate([np.zeros((1, leds * photodiodes)), drawn])[number].T
        data |= described(__package__, reading_drift=np.exp(walk).reshape(leds, photodiodes, -1))
    for name, stream in _MOTIONS.items():
        # An Ornstein-Uhlenbeck process.
        if (motion := body.motion) and (rms_um := getattr(motion, f"{name}_um")) > 0:
            from scipy.signal import lfilter

            knots = int(np.ceil(since_s[-1] * KNOTS_PER_S)) + 2
            drawn = np.random.default_rng(seed_of(body.seed, stream)).standard_normal(knots)
            memory = np.exp(-1.0 / (KNOTS_PER_S * motion.correlation_s))
            drawn[1:] *= np.sqrt(1.0 - memory**2)
            course = np.interp(since_s, np.arange(knots) / KNOTS_PER_S, lfilter([1.0], [1.0, -memory], drawn))
            data |= described(__package__, **{f"sensor_{name}_um": rms_um * course})
    return xr.Dataset(data)


def reading_gain(worn: xr.Dataset) -> Array:
    """Factor of LED and amplifier on readings by drift, (led, photodiode, t) or, without any, (1, 1, 1) float."""
    gain = worn.get("reading_drift", xr.DataArray([[[1.0]]])).values
    return np.asarray(gain * worn.get("led_drift", xr.DataArray([[1.0]])).values[:, None])


def motion_artefact(
    worn: xr.Dataset, in_place: ReadingSeries, moved: Mapping[str, tuple[float, DetectedLight]], blood: Array
) -> tuple[Array, Variables]:
    """What the sensor's motion makes of its readings: a factor on each, and how it comes about.

    worn : the scene's `drift_and_motion`. in_place : what is read with the sensor in its place, over blood (t, zones).
    moved : of `WornLight`. Between both places the logarithm of a reading goes with the distance.

    Returns: the factor, (led, photodiode, t) or, where nothing moves, (1, 1, 1) float.

    Raises: InputError where the sensor moves in a way that was not traced.
    """
    exponent, data = np.zeros((1, 1, 1)), Variables()
    for name in _MOTIONS:
        if f"sensor_{name}_um" not in worn:
            continue
        if name not in moved:
            why = "light under a sensor that moves is traced by simulate alone; leave it out."
            raise InputError(f"body.motion.{name}_um: {why}")
        distance_um, light = moved[name]
        there = light.readings_at(blood)
        with np.errstate(divide="ignore", invalid="ignore"):
            per_um = np.log(there.fraction / in_place.fraction) / distance_um
            stderr = np.hypot(there.stderr / there.fraction, in_place.stderr / in_place.fraction) / distance_um
        exponent = exponent + np.where(np.isfinite(per_um), per_um, 0.0) * worn[f"sensor_{name}_um"].values
        data |= described(__package__, **{f"{name}_per_um": Estimate(per_um[..., 0], stderr[..., 0])})
    return np.exp(exponent), data


def _random_walks(count: int, since_s: Array, seed: int) -> Array:
    """Random walks from 0 whose standard deviation is 1 after a minute, (count, t); a longer course only adds to it."""
    knots = int(np.ceil(since_s[-1] * KNOTS_PER_S)) + 1
    steps = np.random.default_rng(seed).standard_normal((knots, count)) / np.sqrt(60.0 * KNOTS_PER_S)
    walk = np.concatenate([np.zeros((1, count)), np.cumsum(steps, axis=0)])
    at = np.arange(knots + 1) / KNOTS_PER_S
    return np.array([np.interp(since_s, at, column) for column in walk.T])


def replicates_v(result: xr.Dataset, transfer: Transfer) -> Array:
    """Volts by all photons, and without each group of them, (led, photodiode, 1 + groups, time) float, of a result of
    `read_volts` with its course and the trace behind it. [V]"""
    so2 = result.so2.values.T if transfer.scene.blood.oxygen_balance else None
    read = read_by_groups(transfer, transfer.scene, result.blood_fraction.values.T, so2)
    read = np.moveaxis(read, 0, 2)
    # Volts are proportional to the light, but for what is dark.
    per_fraction = quotient(result.volts_stderr, result.detected_fraction_stderr)[:, :, None]
    moved = (quotient(read, read[:, :, :1]) - 1) * result.detected_fraction.values[:, :, None]
    return np.asarray(result.volts.values[:, :, None] + per_fraction * moved)
