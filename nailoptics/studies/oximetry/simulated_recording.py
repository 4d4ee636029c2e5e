"""What an oximeter would record of a simulated finger: slots with their noise, over a touch and many beats."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ... import electronics
from ...light import Transfer
from ...scene import Oximeter, Scene
from ...scene.oximeter import DARK
from ...scene.slot_recordings import OximeterRecording
from ...statistics import seed_of
from ..blood_states import blood_over_touch
from .pulsation import read_states
from .slots import Stage

Array = NDArray[np.float64]

# Of the blood's course so many states are read; the logarithm of the light lies on a parabola through them.
STATES = 40
# Directions in which the zones' blood changes together.
DIRECTIONS = 2
_NOISE = 61


def light_of_touch(scene: Scene, transfer: Transfer, leds: tuple[int, int], *, seed: int) -> tuple[Array, Array]:
    """Times of the frames over a scene's touch [s], and the light that is detected then, (2, photodiodes, t) float."""
    frame_hz = (scene.oximeter or Oximeter()).frame_hz
    touch = scene.touch.model_copy(update={"sample_rate_hz": frame_hz})
    course = blood_over_touch(scene.model_copy(update={"touch": touch}))
    blood = course.blood_fraction.values.T
    return course.time.values, light_over(transfer, leds, scene.blood.so2, blood, seed=seed)


def record_light(
    stages: list[Stage], time_s: Array, light: Array, *, names: Sequence[str], seed: int
) -> OximeterRecording:
    """Record light over time; light : (2, photodiodes, t) float, detected fractions of the red and the infrared LED."""
    rng = np.random.default_rng(seed_of(seed, _NOISE))
    delay_s = stages[0].delays_s[stages[0].lights[1]]
    later = np.stack([np.interp(time_s + delay_s, time_s, one) for one in light[1]])
    volts, dark = [], []
    for j, stage in enumerate(stages):
        slots = _noisy(stage, np.stack([light[0, j], later[j]], -1), rng)
        place = [stage.slot_names.index(name) for name in stage.lights[:2]]
        volts.append(slots[:, place].T)
        dark.append(slots[:, stage.slot_names.index(DARK)] if stage.has_dark_slot else np.zeros(len(time_s)))
    return OximeterRecording("simulated", tuple(names), time_s, np.stack(volts, 1), np.stack(dark))


def _noisy(stage: Stage, fraction: Array, rng: np.random.Generator) -> Array:
    """Volts of every slot over time with noise, (t, slots) float; fraction : (t, 2) float."""
    slots, _ = stage.slot_volts(fraction)
    variance = np.sum(list(stage.slot_noise_v2(fraction.mean(0)).values()), axis=0)
    noisy = slots + np.sqrt(variance) * rng.standard_normal(slots.shape)
    return np.clip(noisy, 0.0, stage.scene.electronics.adc_range_v - electronics.lsb_v(stage.scene.electronics))


def light_over(transfer: Transfer, leds: tuple[int, int], so2: float, blood: Array, *, seed: int) -> Array:
    """Detected fractions over a course of the blood whose median is mixed and all else arterial, (2, photodiodes, t).

    blood : (t, zones) float.
    """
    resting = np.median(blood, axis=0)
    away = blood - resting
    directions = np.linalg.eigh(away.T @ away)[1][:, ::-1][:, :DIRECTIONS]
    places = away @ directions
    size = np.maximum(np.abs(places).max(0), 1e-12)
    order = np.argsort(places[:, 0], kind="stable")
    chosen = order[np.unique(np.linspace(0, len(order) - 1, STATES).astype(int))]
    found = []
    for led in leds:
        read = read_states(transfer, led, [(so2, resting, away[chosen])], seed=seed)[0]
        terms = np.linalg.lstsq(_terms(places[chosen] / size), np.log(read).T, rcond=None)[0]
        found.append(np.exp(_terms(places / size) @ terms).T)
    return np.stack(found)


def _terms(places: Array) -> Array:
    """Terms of a parabola over (n, d) places."""
    d = places.shape[1]
    square = [places[:, a] * places[:, b] for a in range(d) for b in range(a, d)]
    return np.column_stack([np.ones(len(places)), places, *square])
