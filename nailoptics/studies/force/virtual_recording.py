"""What a virtual person's worn sensor would record: simulated volts with noise and the converter's steps."""

import numpy as np
import xarray as xr

from ... import electronics
from ...scene import Scene
from ...scene.sensor_recordings import SITES, Recording
from ...statistics import seed_of
from .reading_table import reading_names

# Which stream of random numbers the noise takes, beside those of the light and the body.
_NOISE = 11


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
