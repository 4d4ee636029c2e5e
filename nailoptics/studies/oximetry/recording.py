"""Recordings of an oximeter: simulated from a scene's result, slot by slot with noise, and read by its curve."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...hemodynamics.for_scene import blood_over_touch
from ...light import Transfer
from ...light.transfer.interpolation import ChebyshevBox
from ...scene import Oximeter, Scene
from ...scene.importers.sensor_recordings import OximeterRecording, read_oximeter_recording
from ...scene.oximeter import DARK
from ...sensor import electronics
from ...sensor.front_end import SampledFrontEnd, front_ends_of
from ...statistics import seed_of
from ..pulsatile_blood import oximeter_leds
from .ratio import read_states
from .spo2_over_time import CalibrationCurve, pulses_over_time, spo2_over_time

Array = NDArray[np.float64]

# Nodes along the first principal components of the zones' blood, between which light is interpolated.
NODES = (8, 4)
_NOISE = 61


def light_of_touch(scene: Scene, transfer: Transfer, leds: tuple[int, int], *, seed: int) -> tuple[Array, Array]:
    """Times of the frames over a scene's touch [s], and the light that is detected then, (2, photodiodes, t) float."""
    frame_hz = (scene.oximeter or Oximeter()).frame_hz
    touch = scene.touch.model_copy(update={"sample_rate_hz": frame_hz})
    touched = blood_over_touch(scene.model_copy(update={"touch": touch}))
    blood = touched.blood_fraction.values.T
    return touched.time.values, light_over(transfer, leds, scene.blood.so2, blood, seed=seed)


def record_light(
    front_ends: list[SampledFrontEnd], time_s: Array, light: Array, *, names: Sequence[str], seed: int
) -> OximeterRecording:
    """Record light over time; light : (2, photodiodes, t) float, detected fractions of the red and the infrared LED."""
    rng = np.random.default_rng(seed_of(seed, _NOISE))
    delay_s = front_ends[0].delays_s[front_ends[0].lights[1]]
    later = np.stack([np.interp(time_s + delay_s, time_s, one) for one in light[1]])
    volts, dark = [], []
    for j, front_end in enumerate(front_ends):
        slots = _noisy(front_end, np.stack([light[0, j], later[j]], -1), rng)
        place = [front_end.slot_names.index(name) for name in front_end.lights[:2]]
        volts.append(slots[:, place].T)
        dark.append(slots[:, front_end.slot_names.index(DARK)] if front_end.has_dark_slot else np.zeros(len(time_s)))
    return OximeterRecording("simulated", tuple(names), time_s, np.stack(volts, 1), np.stack(dark))


def _noisy(front_end: SampledFrontEnd, fraction: Array, rng: np.random.Generator) -> Array:
    """Volts of every slot over time with noise, (t, slots) float; fraction : (t, 2) float."""
    slots, _ = front_end.slot_volts(fraction)
    variance = np.sum(list(front_end.slot_noise_v2(fraction.mean(0)).values()), axis=0)
    noisy = slots + np.sqrt(variance) * rng.standard_normal(slots.shape)
    return np.clip(noisy, 0.0, electronics.limit_v(front_end.scene.electronics))


def light_over(transfer: Transfer, leds: tuple[int, int], so2: float, blood: Array, *, seed: int) -> Array:
    """Detected fractions over a course of the blood whose median is mixed and all else arterial, (2, photodiodes, t).

    blood : (t, zones) float.
    """
    resting = np.median(blood, axis=0)
    away = blood - resting
    components = np.linalg.eigh(away.T @ away)[1][:, ::-1][:, : len(NODES)]
    places = away @ components
    box = ChebyshevBox(places.min(0), places.max(0) + 1e-12, NODES[: places.shape[1]])
    weights = box.weights(places).T
    pulses = box.nodes @ components.T
    return np.stack([read_states(transfer, led, [(so2, resting, pulses)], seed=seed)[0] @ weights for led in leds])


def read_for(scene: Scene, path: str | Path) -> OximeterRecording:
    """Read a recording of a scene's oximeter; raises InputError, also where it holds no pulse."""
    leds = oximeter_leds(scene)
    first = front_ends_of(scene, leds)[0]
    names, delays_s = scene.layout.photodiode_names, first.delays_s
    recording = read_oximeter_recording(path, leds=first.lights[:2], photodiodes=names, delays_s=delays_s)
    # Checked here, before any light is traced.
    pulses_over_time(recording, scene)
    return recording


def read_oxygen(scene: Scene, result: xr.Dataset, recording: OximeterRecording | str | Path) -> xr.Dataset:
    """Oxygen over time from a recording, or its file, by the curve of a scene.

    result : what `oximeter` returned for the scene.

    Returns and raises: as `spo2_over_time`.
    """
    given = recording if isinstance(recording, OximeterRecording) else read_for(scene, recording)
    return spo2_over_time(given, CalibrationCurve.of(result), scene)


def simulated(scene: Scene, result: xr.Dataset, *, seed: int) -> OximeterRecording:
    """What the oximeter would record of its scene's touch, in the ambient light that the scene names.

    result : what `oximeter` returned for the scene.
    """
    front_ends = front_ends_of(scene, oximeter_leds(scene), np.asarray(result.ambient_a))
    names = [str(name) for name in result.photodiode.values]
    return record_light(front_ends, result.time.values, result.detected_fraction.values, names=names, seed=seed)
