"""Light to volts over a touch: what every photodiode reads, with its standard error and noise, of a worn sensor."""

import numpy as np
import xarray as xr

from ..checks import Array
from ..light import Transfer
from ..light.transfer.series import read_by_groups
from ..variables import Estimate, described
from . import electronics
from .drift_motion import drift_and_motion, motion_artefact, reading_gain
from .worn_light import WornLight


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
