"""A scene's oximeter and recordings: simulated from what it found, and read by it."""

from pathlib import Path

import numpy as np
import xarray as xr

from ...scene import Scene
from ...scene.slot_recordings import OximeterRecording, read_oximeter_recording
from .beating_blood import oximeter_leds
from .simulated_recording import record_light
from .slots import stages_of
from .spo2_over_time import KnownCurve, pulses_over_time, spo2_over_time


def read_for(scene: Scene, path: str | Path) -> OximeterRecording:
    """Read a recording of a scene's oximeter; raises InputError, also where it holds no pulse."""
    leds = oximeter_leds(scene)
    first = stages_of(scene, leds)[0]
    names, delays_s = scene.layout.photodiode_names, first.delays_s
    found = read_oximeter_recording(path, leds=first.lights[:2], photodiodes=names, delays_s=delays_s)
    # Here, so that nobody waits for light first.
    pulses_over_time(found, scene)
    return found


def read_oxygen(scene: Scene, result: xr.Dataset, recording: OximeterRecording | str | Path) -> xr.Dataset:
    """Oxygen over time from a recording, or its file, by the curve of a scene.

    result : what `oximeter` returned for the scene.

    Returns and raises: as `spo2_over_time`.
    """
    given = recording if isinstance(recording, OximeterRecording) else read_for(scene, recording)
    return spo2_over_time(given, KnownCurve.of(result), scene)


def simulated(scene: Scene, result: xr.Dataset, *, seed: int) -> OximeterRecording:
    """What the oximeter would record of its scene's touch, in the light from outside that the scene names.

    result : what `oximeter` returned for the scene.
    """
    stages = stages_of(scene, oximeter_leds(scene), np.asarray(result.ambient_a))
    names = [str(name) for name in result.photodiode.values]
    return record_light(stages, result.time.values, result.detected_fraction.values, names=names, seed=seed)
