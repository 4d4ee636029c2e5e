"""What a virtual person's worn sensor would record: simulated volts with noise, drift and the converter's steps."""

import numpy as np
import xarray as xr

from ... import electronics
from ...scene import Scene
from ...scene.sensor_recordings import SITES, Recording
from ...statistics import seed_of
from .reading_table import reading_names

# Which stream of random numbers the noise takes, beside those of the light and the body.
_NOISE, _DRIFT = 11, 12


def record(scene: Scene, result: xr.Dataset, *, seed: int, drift_per_min: float = 0.0) -> Recording:
    """A recording of a simulated touch.

    result : what `simulate` returned for the scene.
    drift_per_min : random walk of every reading in a minute, as a part of it: temperature and ageing of the LED.
    """
    names = reading_names(scene)
    volts = result.volts.values.reshape(len(names), -1)
    noise = result.volts_noise_rms.values.reshape(volts.shape)
    time_s = result.time.values
    walk = np.random.default_rng(seed_of(seed, _DRIFT)).normal(size=volts.shape)
    steps = np.sqrt(np.diff(time_s, prepend=time_s[0]) / 60.0)
    volts = volts * (1.0 + drift_per_min * np.cumsum(walk * steps, axis=1))
    # The converter's own steps are applied below, not drawn.
    lsb = electronics.lsb_v(scene.electronics)
    analog = np.sqrt(np.maximum(noise**2 - lsb**2 / 12, 0.0))
    volts = volts + analog * np.random.default_rng(seed_of(seed, _NOISE)).normal(size=volts.shape)
    volts = np.clip(np.round(volts / lsb) * lsb, 0.0, scene.electronics.adc_range_v)
    site = SITES[scene.touch.site] if scene.touch.site else {1.0: 1.0, 0.0: 0.0}.get(scene.touch.proximal_share, np.nan)
    return Recording("simulated", names, time_s, volts, result.force_n.values, np.full(time_s.shape, site))
