"""Light to volts over a touch: what every photodiode reads, with its standard error and noise, of a worn sensor."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..light import DetectedLight
from ..scene import Scene
from ..variables import Estimate, Variables, described
from . import electronics
from .drift_motion import MovedLight, drift_and_motion, motion_artefact, reading_gain


def read_volts(
    scene: Scene, light: DetectedLight, course: xr.Dataset, moved: Sequence[MovedLight], ambient: Variables
) -> xr.Dataset:
    """Detected fractions and volts over the course, with standard errors and noise, and the sensor's drift and motion.

    course : of `blood_over_touch`. moved : the light under the sensor elsewhere, where the scene's body moves it.
    ambient : the light from outside, of `ambient_in_readings`.
    """
    blood = course.blood_fraction.values.T
    readings = light.over(scene, course)
    worn = drift_and_motion(scene, course.time.values)
    motion, about_motion = motion_artefact(worn, readings, moved, blood)
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
    ohm = electronics.stage_ohm(diodes, scene.electronics)
    saturated, responsivity_a_per_w = np.empty(fraction.shape, bool), np.empty(fraction.shape[:2])
    ambient_a = ambient["ambient_a"][1] if ambient else np.zeros(fraction.shape[1])
    for i, j in np.ndindex(*fraction.shape[:2]):
        led, diode = scene.leds[i], diodes[j]
        read = electronics.read(gain[i, j] * fraction[i, j], led, diode, scene.electronics, ambient_a=ambient_a[j])
        per_fraction_v = electronics.volts_per_fraction(led, diode, scene.electronics) * gain[i, j]
        volts[i, j], noise[i, j], saturated[i, j] = read.volts, read.volts_noise_rms, read.saturated
        change[i, j] = read.volts - read.volts[0]
        volts_stderr[i, j] = stderr[i, j] * per_fraction_v
        change_stderr[i, j] = np.hypot(change_stderr[i, j], scaled[i, j] * stderr[i, j]) * per_fraction_v
        responsivity_a_per_w[i, j] = electronics.responsivity_a_per_w(diode, led.wavelength_nm)
    data = about_motion | described(
        __package__,
        detected_fraction=Estimate(fraction, stderr),
        volts=Estimate(volts, volts_stderr),
        volts_change=Estimate(change, change_stderr),
        volts_noise_rms=noise,
        saturated=saturated,
        feedback_ohm=ohm,
        responsivity_a_per_w=responsivity_a_per_w,
        mean_path_mm=Estimate(light.mean_path, light.mean_path_stderr),
        wavelength_nm=[led.wavelength_nm for led in scene.leds],
        zone_of_photodiode=list(scene.zones_of_photodiodes),
    )
    names = {"led": [led.name for led in scene.leds], "photodiode": list(scene.layout.photodiode_names)}
    return xr.Dataset(data, names | {"absorber": list(light.absorbers)}).merge(worn)
