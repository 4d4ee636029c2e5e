"""State-space model of a calibrated sensor under a touch: what the Kalman filter predicts and compares with readings.

State x: diameters of the three walls over those at rest; both touch pressures, as coordinates that `touch_pressure`
bends to 0; what is left of the distal pressure in the pulp; heartbeat and slow waves of the arterial pressure; the
relative drift of each reading. Process: the network of vessels, one step at a time. Measurement: volts of all readings.
"""

from functools import lru_cache

import numpy as np
from scipy.special import expit

from ...hemodynamics.rosenbrock import step
from .person import NAMES, Array, PulsatileGain, touch_on_walls
from .subject import Subject

# Below this a pressure bends smoothly to 0, so that its derivative never vanishes. [N/cm^2]
SOFTNESS_N_PER_CM2 = 0.002
# Past closure touches cannot be distinguished: the estimate is bounded at this part of it, from where it can return.
PAST_CLOSURE = 1.2
# The lowest coordinate: further below 0 a pressure would have no slope left to come back by. [N/cm^2]
LOWEST_N_PER_CM2 = -0.01
# Limits of the numerical Jacobian's steps, else the state's standard deviations: diameters over rest, pressures in
# N/cm^2; and the step of P_H in Pa.
LARGEST_STEP = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1])
SMALLEST_STEP, ARTERIAL_STEP_PA = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02]), 200.0
# Process noise of the walls, of their diameters at rest per step. [1]
WALL_NOISE = 1e-4
# Process noise: error of the walls' velocity as a part of it, and its correlation time. Chosen on the virtual people:
# without it a touch that is released past closure is estimated for seconds. [1, s]
SPEED_ERROR, SPEED_CORRELATION_S = 0.2, 0.3
# Process noise of the distal pulp. [N/cm^2 / sqrt(s)]
PULP_NOISE_N_PER_CM2_RT_S = 0.05
# Standard deviations of a state of which nothing is known but that the finger rests: diameters [1], pressures [N/cm^2].
INITIAL_WIDTH, INITIAL_PRESSURE_N_PER_CM2 = 1e-2, 0.1
# Least diameter over rest that the measurement takes.
LEAST_WIDTH = 1e-3
# A time constant of this or less is none. [s]
SHORTEST_S = 1e-9

WIDTHS, TOUCH, PULP, FIRST_WAVE = slice(0, 3), slice(3, 5), 5, 6
# The states that the network's step depends on, each with a step up and down in the Jacobian; P_H has two more.
WALL_STATES = FIRST_WAVE


def touch_pressure(coordinate_n_per_cm2: Array) -> Array:
    """Touch pressure of its coordinate: the same above 0, bent to 0 below. [N/cm^2]"""
    return SOFTNESS_N_PER_CM2 * np.logaddexp(0.0, coordinate_n_per_cm2 / SOFTNESS_N_PER_CM2)


class StateSpace:
    """Process and measurement of one person's sensor; holds no estimate.

    person : the calibrated one. size : number of states. beat, waves, drift : slices of the state.
    touch_bounds_n_per_cm2 : the least and the largest coordinates of both pressures, (2,) float each. [N/cm^2]
    """

    def __init__(self, subject: Subject) -> None:
        self.subject, self.person, noise = subject, subject.person, subject.noise
        beat = noise.beat.size if noise.beat else 0
        self.beat = slice(FIRST_WAVE, FIRST_WAVE + beat)
        self.waves = slice(self.beat.stop, self.beat.stop + 2 * len(noise.waves))
        self.drift = slice(self.waves.stop, self.waves.stop + len(subject.rest_v))
        self.size = self.drift.stop
        # Weights of the state that give the pressure of the beat and that of the slow waves.
        self.beat_weights, self.wave_weights = np.zeros(self.size), np.zeros(self.size)
        self.beat_weights[self.beat.start + 1 : self.beat.stop : 2] = 1.0
        self.wave_weights[self.waves.start : self.waves.stop : 2] = 1.0
        highest_n_per_cm2 = PAST_CLOSURE * self.person.closure_n_per_cm2()
        self.touch_bounds_n_per_cm2 = np.full(2, LOWEST_N_PER_CM2), highest_n_per_cm2
        self._pulsatile_gain = PulsatileGain(self.person, highest_n_per_cm2)
        # One network for each of the steps of the Jacobian.
        self._many = subject.scene.person(np.repeat(subject.factors_ln[:, None], 3 + 2 * WALL_STATES, axis=1))
        self._closed_m = self._many.walls.with_axes(2).closed
        self._linear_process_of = lru_cache(2)(self._linear_process)

    def initial(self) -> tuple[Array, Array]:
        """State and covariance of an untouched finger, as far as is known."""
        subject, state, covariance = self.subject, np.zeros(self.size), np.zeros((self.size, self.size))
        state[WIDTHS] = 1.0
        variance = np.einsum("ii->i", covariance)
        variance[WIDTHS] = INITIAL_WIDTH**2
        variance[TOUCH] = variance[PULP] = INITIAL_PRESSURE_N_PER_CM2**2
        if subject.noise.beat:
            variance[self.beat] = subject.noise.beat.initial_variance()
        variance[self.waves] = np.repeat([wave.rms_pa**2 for wave in subject.noise.waves], 2)
        # Uncertainty of the calibration at rest.
        count, factors, blood = len(subject.rest_v), len(NAMES), self.person.blood(np.ones(2))
        volts, by_blood = subject.light.slopes(blood)
        jacobian = np.zeros((count, len(subject.covariance)))
        jacobian[:, NAMES.index("rest_blood")] = subject.readings.gain * (by_blood @ blood)
        jacobian[:, factors : factors + count] = np.diag(volts)
        jacobian[:, factors + count : factors + 2 * count] = np.eye(count)
        jacobian /= subject.rest_v[:, None]
        covariance[self.drift, self.drift] = jacobian @ subject.covariance @ jacobian.T + subject.drift_covariance
        return state, covariance

    def resolve_harmonics(self, since_s: float) -> None:
        """Leave out the heart's harmonics that samples so far apart do not show."""
        if beat := self.subject.noise.beat:
            self.beat_weights[self.beat.start + 1 : self.beat.stop : 2] = beat.resolved_harmonics(since_s)

    def arterial_pa(self, state: Array) -> float:
        """By how much P_H is off its mean. [Pa]"""
        return float((self.beat_weights + self.wave_weights) @ state)

    def process(
        self, state: Array, stderr: Array, relaxed_n_per_cm2: Array, step_s: float
    ) -> tuple[Array, Array, Array]:
        """State after a step, its Jacobian F and the process noise Q, that of the touch left out.

        stderr : (6,) float. Standard deviations of the states that act on the walls.
        relaxed_n_per_cm2 : (2,) float. Pressures that the viscoelastic pulp has relaxed to. [N/cm^2]
        """
        transition, noise = (part.copy() for part in self._linear_process_of(step_s))
        many, person = self._many, self.person
        high = person.arterial_pa + self.wave_weights @ state
        step_by = np.minimum(np.maximum(stderr, SMALLEST_STEP), LARGEST_STEP)
        count, first = many.rest_m.shape[1], 1 + 2 * WALL_STATES
        around = np.repeat(state[:WALL_STATES, None], count, axis=1)
        around[range(WALL_STATES), range(1, 1 + WALL_STATES)] += step_by
        around[range(WALL_STATES), range(1 + WALL_STATES, first)] -= step_by
        highs = np.full(count, high)
        highs[first : first + 2] += ARTERIAL_STEP_PA * np.array([1.0, -1.0])
        touch = np.maximum(touch_pressure(around[TOUCH]) - (person.creep * relaxed_n_per_cm2)[:, None], 0.0)
        # The distal pulp follows a rising touch at once, a falling one slowly.
        remaining = np.exp(-step_s / np.maximum(person.recovery_s, SHORTEST_S))
        touch[1] = np.maximum(touch[1], touch[1] + (around[PULP] - touch[1]) * remaining)
        before_m = np.maximum(around[WIDTHS] * many.rest_m, self._closed_m)
        outside_pa = touch_on_walls(touch, many.distal_reach)
        widths = step(many.walls, before_m, outside_pa, highs, person.venous_pa, step_s=step_s) / many.rest_m
        moved = np.vstack([widths, touch[1]])
        driven = [0, 1, 2, PULP]
        transition[driven, :WALL_STATES] = (moved[:, 1 : 1 + WALL_STATES] - moved[:, 1 + WALL_STATES : first]) / (
            2 * step_by
        )
        by_arterial = (widths[:, first] - widths[:, first + 1]) / (2 * ARTERIAL_STEP_PA)
        transition[WIDTHS] += np.outer(by_arterial, self.wave_weights)
        after = transition @ state
        after[driven] = moved[:, 0]
        speed_error = SPEED_ERROR * (widths[:, 0] - state[WIDTHS])
        noise[range(3), range(3)] += speed_error**2 * SPEED_CORRELATION_S / step_s
        if beat := self.subject.noise.beat:
            at = self.beat, self.beat
            after[self.beat], transition[at], noise[at] = beat.propagate(state[self.beat], step_s)
        return after, transition, noise

    def relax(self, state: Array, relaxed_n_per_cm2: Array, step_s: float) -> Array:
        """What the viscoelastic pulp has relaxed to after a step, (2,) float. [N/cm^2]"""
        pressure_n_per_cm2 = touch_pressure(state[TOUCH])
        remaining = np.exp(-step_s / self.person.creep_s)
        return np.asarray(pressure_n_per_cm2 + (relaxed_n_per_cm2 - pressure_n_per_cm2) * remaining)

    def measurement(self, state: Array) -> tuple[Array, Array]:
        """Volts of every reading (R,) and their Jacobian H (R, size)."""
        subject, calibrated, width = self.subject, self.subject.readings, np.maximum(state[:2], LEAST_WIDTH)
        pulsatile, by_touch = self._pulsatile_gain.at(touch_pressure(state[TOUCH]))
        beat_pa, blood = self.beat_weights @ state, self.person.blood(width)
        volts, by_blood = subject.light.slopes(blood * (1.0 + pulsatile * beat_pa))
        by_blood = calibrated.gain[:, None] * by_blood
        jacobian, readings = np.zeros((len(volts), self.size)), np.arange(len(volts))
        jacobian[:, :2] = by_blood * (1.0 + pulsatile * beat_pa) * (2 * blood / width)
        jacobian[:, TOUCH] = by_blood @ (blood[:, None] * by_touch) * beat_pa * expit(state[TOUCH] / SOFTNESS_N_PER_CM2)
        jacobian += np.outer(by_blood @ (blood * pulsatile), self.beat_weights)
        jacobian[readings, self.drift.start + readings] = subject.rest_v
        return calibrated.offset_v + calibrated.gain * volts + subject.rest_v * state[self.drift], jacobian

    def bound_touch(self, state: Array, covariance: Array) -> Array:
        """The likeliest state with its touch within bounds; the drift stays, as each release would bias it alike."""
        lowest_n_per_cm2, highest_n_per_cm2 = self.touch_bounds_n_per_cm2
        bounded = np.minimum(np.maximum(state[TOUCH], lowest_n_per_cm2), highest_n_per_cm2)
        outside = np.flatnonzero(bounded != state[TOUCH])
        if not outside.size:
            return state.copy()
        at = outside + TOUCH.start
        back = np.linalg.solve(covariance[np.ix_(at, at)], (bounded - state[TOUCH])[outside])
        moved = state + covariance[:, at] @ back
        moved[self.drift] = state[self.drift]
        return np.asarray(moved)

    def sensed_touch(self, state: Array, relaxed_n_per_cm2: Array) -> Array:
        """Coordinates of the touch less the relaxation of the pulp, 0 where that is larger."""
        lost = np.maximum(self.person.creep * relaxed_n_per_cm2, 1e-9)
        return np.asarray(state[TOUCH] - lost * np.clip(2.0 - state[TOUCH] / lost, 0.0, 1.0))

    def _linear_process(self, step_s: float) -> tuple[Array, Array]:
        """Transition and noise of all that is linear, over a step."""
        transition, variance = np.eye(self.size), np.zeros(self.size)
        variance[WIDTHS] = WALL_NOISE**2
        variance[PULP] = PULP_NOISE_N_PER_CM2_RT_S**2 * step_s
        for k, wave in enumerate(self.subject.noise.waves):
            at = slice(self.waves.start + 2 * k, self.waves.start + 2 * k + 2)
            transition[at, at], variance[at] = wave.propagate(step_s)
        noise = np.diag(variance)
        noise[self.drift, self.drift] = self.subject.drift_covariance * step_s / 60.0
        return transition, noise
