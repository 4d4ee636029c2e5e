"""Light to volts over a touch, of a worn sensor: its drift and motion, and what every photodiode reads, with its
standard error and noise."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..checks import Array
from ..errors import InputError
from ..light import Transfer
from ..light.transfer.series import ReadingSeries, read_by_groups
from ..scene import Scene
from ..statistics import seed_of
from ..variables import Estimate, Variables, described
from . import electronics
from .worn_light import MovedLight, WornLight

# Random walks are drawn at so many knots in a second, whatever the rate of the samples, and are linear between them.
KNOTS_PER_S = 20.0
# Streams of the body's seed, beside those of its pressures.
_LED_DRIFT, _READING_DRIFT = 21, 22
_MOTIONS = {"lift": 23, "slide": 24}


def read_volts(lit: WornLight, course: xr.Dataset) -> xr.Dataset:
    """Detected fractions and volts over the course, with standard errors and noise, ambient light, and the sensor's
    drift and motion.

    course : of `blood_over_touch`.
    """
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
    diodes = [element.photodiode for element in scene.layout.photodiodes]
    saturated, responsivity_a_per_w = np.empty(fraction.shape, bool), np.empty(fraction.shape[:2])
    ambient = {} if lit.ambient_a is None else electronics.ambient_in_readings(scene, *lit.ambient_a)
    ambient_a = np.zeros(fraction.shape[1]) if lit.ambient_a is None else lit.ambient_a[0]
    for i, j in np.ndindex(*fraction.shape[:2]):
        led, diode = scene.leds[i], diodes[j]
        read = electronics.read(gain[i, j] * fraction[i, j], led, diode, scene.electronics, ambient_a=ambient_a[j])
        per_fraction_v = electronics.volts_per_fraction(led, diode, scene.electronics) * gain[i, j]
        volts[i, j], noise[i, j], saturated[i, j] = read.volts, read.volts_noise_rms, read.saturated
        change[i, j] = read.volts - read.volts[0]
        volts_stderr[i, j] = stderr[i, j] * per_fraction_v
        change_stderr[i, j] = np.hypot(change_stderr[i, j], scaled[i, j] * stderr[i, j]) * per_fraction_v
        responsivity_a_per_w[i, j] = electronics.responsivity_a_per_w(diode, led.wavelength_nm)
    data = ambient | about_motion
    data |= described(
        __package__,
        detected_fraction=Estimate(fraction, stderr),
        volts=Estimate(volts, volts_stderr),
        volts_change=Estimate(change, change_stderr),
        volts_noise_rms=noise,
        saturated=saturated,
        feedback_ohm=electronics.stage_ohm(diodes, scene.electronics),
        responsivity_a_per_w=responsivity_a_per_w,
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
        data |= described(__package__, reading_drift=np.exp(walk).reshape(leds, photodiodes, -1))
    for name, stream in _MOTIONS.items():
        if (motion := body.motion) and (rms_um := getattr(motion, f"{name}_um")) > 0:
            course = _ornstein_uhlenbeck(since_s, motion.correlation_s, seed_of(body.seed, stream))
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


def replicates_v(result: xr.Dataset, transfer: Transfer) -> Array:
    """Volts by all photons, and without each group of them, (led, photodiode, 1 + groups, time) float. [V]

    result : of `read_volts` and its course. transfer : the trace behind it.
    """
    read = read_by_groups(transfer, transfer.scene, result.blood_fraction.values.T)
    read = np.moveaxis(read, 0, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Volts are proportional to the light, but for what is dark.
        per_fraction = (result.volts_stderr / result.detected_fraction_stderr).values[:, :, None]
        moved = (read / read[:, :, :1] - 1) * result.detected_fraction.values[:, :, None]
    return np.asarray(result.volts.values[:, :, None] + per_fraction * moved)
