"""What a virtual person's worn sensor would record: simulated volts with noise and the converter's steps."""

from typing import Literal

import numpy as np
import xarray as xr

from ...hemodynamics.for_scene import blood_over_touch
from ...light import DetectedLight
from ...scene import Scene, Touch
from ...scene.importers.sensor_recordings import SITES, Recording
from ...sensor import electronics
from ...statistics import seed_of
from ..simulate import simulate_from
from .reading_table import reading_names

# Which stream of random numbers the noise takes, beside those of the light and the body.
_NOISE = 11
# Allowed error of a step of the vessels' equations, of a diameter. It adds up to 1e-5, below the converter's steps.
_RTOL = 1e-3


def record_touch(
    scene: Scene, light: DetectedLight, touch: Touch, *, seed: int, model: Literal["massless", "inertial"] = "massless"
) -> Recording:
    """A recording of one more touch by a person whose light is traced: pulse, drift and noise are those of the seed.

    light : what `open_light` returned for the scene, whatever its touch.
    model : the equations of the vessels, as for `hemodynamics.respond`.
    """
    body = scene.body.model_copy(update={"seed": seed}) if scene.body else None
    touched = scene.model_copy(update={"touch": touch, "body": body})
    course = blood_over_touch(touched, model=model, rtol=_RTOL)
    return record(touched, simulate_from(touched, light, course=course, seed=seed), seed=seed)


def record(scene: Scene, result: xr.Dataset, *, seed: int) -> Recording:
    """A recording of a simulated touch.

    result : what `simulate` returned for the scene.
    """
    names = reading_names(scene)
    volts = result.volts.values.reshape(len(names), -1)
    noise = result.volts_noise_rms.values.reshape(volts.shape)
    time_s = result.time.values
    # The converter's own steps are applied below, not drawn.
    lsb = electronics.lsb_v(scene.electronics)
    analog = np.sqrt(np.maximum(noise**2 - lsb**2 / 12, 0.0))
    volts = volts + analog * np.random.default_rng(seed_of(seed, _NOISE)).normal(size=volts.shape)
    volts = np.clip(np.round(volts / lsb) * lsb, 0.0, scene.electronics.adc_range_v)
    site = SITES[scene.touch.site] if scene.touch.site else {1.0: 1.0, 0.0: 0.0}.get(scene.touch.proximal_share, np.nan)
    return Recording("simulated", names, time_s, volts, result.force_n.values, np.full(time_s.shape, site))
