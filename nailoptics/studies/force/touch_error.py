"""The error of the force that the Kalman filter estimates over touches, of a sensor that is known exactly.

The filter is linearised along a protocol of slow and quick touches. A Riccati recursion makes its gains, by which two
errors are propagated: the covariance by what the body and the electronics add to readings, and the lag behind a touch
that moves otherwise than the random walk that the filter takes it for. The vessels' part is the same for all layouts.

Reference: Gelb 1974, Applied Optimal Estimation, sec. 7.2 (error covariance of a filter whose model is not the truth).
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError

from ...checks import as_input_error
from ...errors import InputError
from ...hemodynamics.waves import HEARTBEAT, CardiacOscillator, oscillators, pressure_lines, slow_waves, waves_of
from ...scene import Body, Scene
from ...sensor.information import sensor_changes
from . import kalman
from .body_noise import HARMONICS, cardiac_oscillator, pressure_to_blood_gain
from .kalman import TOUCH, StateSpace
from .person import NAMES, Array, Person, nominal_finger
from .reading_table import LINEAR_POWERS, POWERS, ReadingTable
from .scores import TOUCH_N
from .subject import LINEAR, READING_CORRELATION_S, Noise, Quality, Readings, Subject

# Samples in a second, as in recordings of touches; the longest step of the vessels' network is longer. [Hz]
RATE_HZ = 25.0
# Time of each part of a touch, and the fraction of the force at its end: a slow touch and a quick one of either side,
# after a rest in which the filter takes hold of the body's waves. [s, 1]
FIRST_REST_S = 6.0
TOUCHES = ((3.0, 1.0), (2.0, 1.0), (1.0, 0.0), (3.0, 0.0), (0.16, 1.0), (2.0, 1.0), (0.1, 0.0), (3.0, 0.0))
# A touch that moves by more than so many standard deviations of the slow mode's random walk is taken for quick.
QUICK = 3.0
# Motion of the sensor within the time from rest to rest is drift to the filter. [s]
REST_TO_REST_S = 10.0
# Change of the logarithm of a reading with the blood, beside which drift is nothing. [1]
EXACT_SLOPE = 1e6


class _Step(NamedTuple):
    """The filter's model from one sample to the next, without the readings' drift: n states. Walls, touch and pulp come
    first and depend on all; the others are the body's waves, each as it was when the touches began.

    transition : (6, n) float. Of the first states. noise : (2, n, n) float. Of the process, to the filter and in truth.
    by_state : (2, n) float. Change of the blood of both zones with the state.
    blood : (2, 2) float. Its distance from rest and recent change one sample before: what the model's error follows.
    moved : (2,) float. By how much both touches move, of which the filter knows nothing.
    """

    transition: Array
    noise: Array
    by_state: Array
    blood: Array
    moved: Array


class TouchError:
    """The filter's rms error over a slow and a quick touch of either side, for any layout on a scene's finger.

    noise : what the scene's body does, as the filter knows it.
    """

    def __init__(self, scene: Scene, force_n: float) -> None:
        """force_n : of all touches. Raises: InputError for a finger or a body that no calibration could have."""
        try:
            self.person = nominal_finger(scene).person()
            self.noise = scene_noise(scene.body, self.person)
        except ValidationError as error:
            fault = as_input_error(error, BaseModel).args[0]
            raise InputError(f"the filter of predict cannot follow this: {fault}") from None
        parts, height = np.array(TOUCHES).T
        corner_s = np.cumsum([0.0, FIRST_REST_S, *parts, *parts])
        time_s = np.arange(0.0, corner_s[-2], 1.0 / RATE_HZ)  # nothing counts after the last touch
        self._force_n = force_n * np.interp(time_s, corner_s, [0.0, 0.0, *height, *height])
        self._proximal = time_s < corner_s[1 + len(TOUCHES)]
        model = StateSpace(_blood_meter(scene, self.noise))
        self._initial = model.initial()[1][: model.drift.start, : model.drift.start]
        self._steps = list(self._linearised(model))

    def _linearised(self, model: StateSpace) -> Iterator[_Step]:
        """The model along the touches, from the first sample on."""
        since_s, kept = 1.0 / RATE_HZ, np.exp(-1.0 / (RATE_HZ * READING_CORRELATION_S))
        model.resolve_harmonics(since_s)
        touch = self.person.pressures_n_per_cm2(self._force_n, self._proximal.astype(float))
        state, relaxed, size = model.initial()[0], np.zeros(2), model.drift.start
        if self.noise.beat:
            state[model.harmonics] = np.sqrt(2.0) * np.array(self.noise.beat.rms_pa)
        # Waves turn and fade by themselves: back at the beginning only what is added to them on the way changes them.
        waves, onward, before = slice(kalman.FIRST_WAVE, size), np.eye(size), np.zeros((2, 2))
        for moved in np.diff(touch, axis=1, prepend=0.0).T:
            after, transition, noise = model.process(state, np.zeros(kalman.WALL_STATES), relaxed, since_s)
            relaxed, after[TOUCH] = model.relax(state, relaxed, since_s), state[TOUCH] + moved
            state = after
            quick = np.abs(moved).max() > QUICK * kalman.TOUCH_RATE_N_PER_CM2_RT_S * np.sqrt(since_s)
            rate = kalman.TOUCH_RATE_N_PER_CM2_RT_S * kalman.MODE_RATE[int(quick)]
            # The meter's readings are exp(blood over that at rest).
            volts, jacobian = model.measurement(state)
            blood, rest = self.person.rest_blood * (np.log(volts) - 1.0), self.person.rest_blood
            noise = noise[:size, :size] + since_s * rate**2 * transition[:size, TOUCH] @ transition[:size, TOUCH].T
            transition = transition[:size, :size] @ onward
            onward[waves, waves] = transition[waves, waves]
            back = np.linalg.inv(onward)
            noise = np.stack([back @ noise @ back.T, np.zeros((size, size))])
            # What the filter takes for noise of touch, walls and pulp is none of the body's.
            noise[1, waves, waves] = noise[0, waves, waves]
            yield _Step(
                transition=transition[: kalman.FIRST_WAVE],
                noise=noise,
                by_state=rest * jacobian[:, :size] @ onward / volts[:, None],
                blood=before,
                moved=moved,
            )
            before = np.stack([blood, kept * (before[1] + blood - before[0])])

    def rms_n(self, slopes: Array, noise: Array, led: Array) -> Array:
        """The error over the touches, (...) float. [N]

        slopes : (..., R, 2) float. Change of the logarithm of R readings with the blood of either zone.
        noise : (..., R) float. Their white noise, rms, over themselves.
        led : (R, L) float. Which LED each reading is of, 1 or 0.
        """
        *shape, count = noise.shape
        slopes, noise = slopes.reshape(-1, count, 2), noise.reshape(-1, count)
        touched = self._force_n >= min(TOUCH_N, 0.5 * self._force_n.max())
        areas2 = self.person.side_areas_cm2**2 * np.eye(2)[np.where(self._proximal, 0, 1)] * touched[:, None]
        errors2 = (error2 @ area2 for error2, area2 in zip(self._errors2(slopes, noise, led), areas2, strict=True))
        return np.asarray(np.sqrt(sum(errors2) / touched.sum()).reshape(shape))

    @cached_property
    def floor_n(self) -> float:
        """The error where readings show the blood of both zones exactly, model included: what no layout changes. [N]"""
        exact = copy(self)
        exact.noise = replace(self.noise, dynamic_error=0.0, static_error=0.0)
        return float(exact.rms_n(EXACT_SLOPE * np.eye(2), np.full(2, 1.0 / EXACT_SLOPE), np.ones((2, 1))))

    def _errors2(self, slopes: Array, noise: Array, led: Array) -> Iterator[Array]:
        """Mean squared errors of both touch pressures, (batch, 2) float, sample by sample. [(N/cm^2)^2]"""
        batch, count = noise.shape
        size, since_s, drift = len(self._initial), 1.0 / RATE_HZ, self.noise.drift_covariance(led)
        # The filter's covariance and the actual one, all of their rows, and what a sample adds to them.
        everything, added = (np.zeros((2, n, size + count, size + count)) for n in (batch, 1))
        rows, driven = everything.reshape(-1, size + count)[:, :size], slice(kalman.FIRST_WAVE)
        everything[..., :size, :size], everything[..., size:, size:] = self._initial, drift
        added[..., size:, size:] = drift * since_s / 60.0
        # Of readings, and of the touch, which reads 0 at rest; variances of their noise, the filter's and the actual.
        jacobian, noise2 = np.zeros((batch, count + 2, size + count)), np.zeros((2, batch, count + 2))
        jacobian[:, :count, size:], jacobian[:, count:, TOUCH] = np.eye(count), np.eye(2)
        noise2[0, :, count:], noise2[1, :, :count] = kalman.ZERO_STDERR_N_PER_CM2_RT_S**2 / since_s, noise**2
        lag, touch2 = np.zeros((batch, size + count)), _diagonal(everything[1])[:, TOUCH]
        from_rest, recent = np.einsum("tkz,brz->ktbr", [step.blood for step in self._steps], slopes)
        model_error2 = self.noise.model_error2(from_rest, recent, since_s)
        for step, force_n, error2 in zip(self._steps, self._force_n, model_error2, strict=True):
            # F P F^T of a symmetric P, kept so: what rounding leaves of it grows.
            moved = (rows @ step.transition.T).reshape(2, batch, size + count, -1)
            everything[:, :, driven], everything[..., driven] = np.swapaxes(moved, 2, 3), moved
            both = step.transition @ moved[:, :, :size]
            everything[:, :, driven, driven] = 0.5 * (both + both.swapaxes(2, 3))
            added[:, 0, :size, :size] = step.noise
            everything += added
            lag[:, driven] = lag[:, :size] @ step.transition.T
            lag[:, TOUCH] += step.moved
            jacobian[:, :count, :size], noise2[0, :, :count] = slopes @ step.by_state, noise**2 + error2
            read = slice(count if force_n else count + 2)
            _update(everything, lag, jacobian[:, read], noise2[..., read])
            yield lag[:, TOUCH] ** 2 + touch2


def _diagonal(matrices: Array) -> Array:
    """The diagonals (..., n) of matrices (..., n, n), which change with them."""
    return np.einsum("...ii->...i", matrices)


def _update(covariances: Array, lag: Array, jacobian: Array, noise2: Array) -> None:
    """Update the filter's covariances and the actual ones, (2, batch, n, n), and its lag (batch, n), by m readings with
    a Jacobian (batch, m, n), whose noise has a variance (2, batch, m) to the filter and in truth, as `kalman` does."""
    by_state = jacobian @ covariances
    innovation_covariance = by_state @ np.swapaxes(jacobian, 1, 2)
    _diagonal(innovation_covariance)[...] += noise2
    gain_t = np.linalg.inv(innovation_covariance[0]) @ by_state[0]  # K^T, of both
    # Joseph's form, (1 - K H) P (1 - K H)^T + K R K^T: P less K (H P - S K^T / 2) and its transpose.
    change = gain_t.swapaxes(1, 2) @ (by_state - 0.5 * innovation_covariance @ gain_t)
    covariances -= change
    covariances -= np.swapaxes(change, 2, 3)
    lag -= ((jacobian @ lag[..., None]).swapaxes(1, 2) @ gain_t)[:, 0]


def scene_noise(body: Body | None, person: Person) -> Noise:
    """What a scene's body does to readings, as a calibration would estimate it; motion counts as drift."""
    drift, lift, slide = sensor_changes(body)
    # Displacements at either end of a touch are independent of each other.
    per_min = np.sqrt(2.0 * 60.0 / REST_TO_REST_S)
    own = [(wave, wave.lines(**fields)) for wave, fields in waves_of(body or Body())]
    waves, beats = oscillators(own), next((lines for wave, lines in own if wave is HEARTBEAT), None)
    if body and body.moves and not own:  # a recorded pressure, of which bands are all that is known
        frequency_hz, variance_pa2 = pressure_lines(body)
        beating, waves = frequency_hz >= HEARTBEAT.band_hz[0], slow_waves(frequency_hz, variance_pa2)
        beats = frequency_hz[beating], variance_pa2[beating]
    return Noise(
        drift_per_min=float(np.hypot(drift.reading_per_rt_min, per_min * slide)),
        led_drift_per_min=float(np.hypot(drift.led_per_rt_min, per_min * lift)),
        waves=tuple(waves),
        beat=_heart(person, *beats) if beats and beats[1].any() else None,
    )


def _heart(person: Person, frequency_hz: Array, variance_pa2: Array) -> CardiacOscillator:
    """The heart of the largest line, by what the vessels pass on of its harmonics; lines (n,) each. [Hz, Pa^2]"""
    rate_hz = float(frequency_hz[np.argmax(variance_pa2)])
    rms_pa = [np.sqrt(variance_pa2[np.rint(frequency_hz / rate_hz) == k].sum()) for k in range(1, 1 + HARMONICS)]
    heights = [pressure_to_blood_gain(person, k * rate_hz) * rms for k, rms in enumerate(rms_pa, start=1)]
    return cardiac_oscillator(rate_hz, heights)


def _blood_meter(scene: Scene, noise: Noise) -> Subject:
    """A subject of two readings whose logarithms are the blood of either zone over that at rest."""
    finger, count = nominal_finger(scene), 2
    most_blood = min(1.0, 10.0 * finger.rest_blood_fraction)
    coefficients = np.zeros((count, len(POWERS)))
    coefficients[range(count), LINEAR_POWERS] = most_blood / finger.rest_blood_fraction
    zeros, ones = np.zeros(count), np.ones(count)
    light = ReadingTable(dict(zip("ab", coefficients, strict=True)), zeros, most_blood, np.zeros((2, 2)), ones, 1.0)
    return Subject(
        scene_digest="",
        quality=Quality(1.0, rms_n=0.0),
        factors=np.ones(len(NAMES)),
        readings=Readings(ones, zeros, zeros, ones),
        noise=noise,
        scene=finger,
        light=light,
        covariance=np.zeros((len(NAMES) + LINEAR * count,) * 2),
    )
