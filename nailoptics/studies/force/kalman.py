"""Interacting-multiple-model (IMM) extended Kalman filter of the touch.

Modes are touches that move slowly and touches that step; they differ in the process noise of the touch pressures alone,
and share one state, to which all are merged after each sample. In symbols of the textbook: x `state`, P `covariance`,
F `transition`, H `jacobian`, nu `innovation`, S `innovation_covariance`, R `Subject.measurement_noise`, K `gain`,
mu `mode_probability`, Pi `mode_transition`.

References: Bar-Shalom, Li, Kirubarajan 2001, Estimation with Applications to Tracking and Navigation: sec. 5.2.3
(Kalman filter, Joseph form), 5.4.2 (normalized innovation squared), 10.3 (extended), 10.5.2 (iterated), 11.6 (multiple
models; merged once per sample as the first-order generalized pseudo-Bayesian estimator, with the mode transitions of
the IMM, Blom and Bar-Shalom 1988).
"""

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, gammaincinv

from ...hemodynamics.rosenbrock import step
from ...hemodynamics.waves import RATE_SPREAD
from .person import ARTERIAL_STEP_PA, LONGEST_GAP_S, LONGEST_STEP_S, NAMES, Array, PulsatileGain, touch_on_walls
from .subject import NOISE_S, READING_CORRELATION_S, Subject

# Below this a pressure bends smoothly to 0, so that its derivative never vanishes. [N/cm^2]
SOFTNESS_N_PER_CM2 = 0.002
# Past closure touches cannot be distinguished: the estimate is bounded at so many times it, from where it can return.
PAST_CLOSURE = 1.2
# The lowest coordinate: further below 0 a pressure would have no slope left to come back by. [N/cm^2]
LOWEST_N_PER_CM2 = -0.01
# Limits of the numerical Jacobian's steps, else the state's standard deviations: diameters over rest, pressures in
# N/cm^2.
LARGEST_STEP = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1])
SMALLEST_STEP = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02])
# Process noise of the walls, of their diameters at rest. [1 / sqrt(s)]
WALL_NOISE_RT_S = 5e-4
# Process noise: relative error of the walls' velocity, and its correlation time. Chosen on the virtual people:
# without it a touch that is released past closure is estimated for seconds. [1, s]
SPEED_ERROR, SPEED_CORRELATION_S = 0.2, 0.3
# Process noise of the distal pulp. [N/cm^2 / sqrt(s)]
PULP_NOISE_N_PER_CM2_RT_S = 0.05
# Standard deviations of a state of which nothing is known but that the finger rests: diameters [1], pressures [N/cm^2].
INITIAL_DIAMETER, INITIAL_PRESSURE_N_PER_CM2 = 1e-2, 0.1
# Least diameter over rest that the measurement takes.
LEAST_DIAMETER = 1e-3
# A time constant of this or less is none. [s]
SHORTEST_S = 1e-9

DIAMETERS, TOUCH, PULP, FIRST_WAVE = slice(0, 3), slice(3, 5), 5, 6
# The states that the network's step depends on, each with a step up and down in the Jacobian; P_H has two more.
WALL_STATES = FIRST_WAVE


def touch_pressure(coordinate_n_per_cm2: Array) -> Array:
    """Touch pressure of its coordinate: the same above 0, bent to 0 below. [N/cm^2]"""
    return SOFTNESS_N_PER_CM2 * np.logaddexp(0.0, coordinate_n_per_cm2 / SOFTNESS_N_PER_CM2)


class StateSpace:
    """Process and measurement of one person's sensor; holds no estimate.

    person : the calibrated one. size : number of states. beat, harmonics, waves, drift : slices of the state.
    touch_bounds_n_per_cm2 : the least and the largest coordinates of both pressures, (2,) float each. [N/cm^2]
    """

    def __init__(self, subject: Subject) -> None:
        self.subject, self.person, noise = subject, subject.person, subject.noise
        beat = noise.beat.size if noise.beat else 0
        self.beat = slice(FIRST_WAVE, FIRST_WAVE + beat)
        self.harmonics = slice(self.beat.start + 1, self.beat.stop, 2)
        self.waves = slice(self.beat.stop, self.beat.stop + 2 * len(noise.waves))
        self.drift = slice(self.waves.stop, self.waves.stop + len(subject.rest_v))
        self.size = self.drift.stop
        # Weights of the state that give the pressure of the beat and that of the slow waves.
        self.beat_weights, self.wave_weights = np.zeros(self.size), np.zeros(self.size)
        self.beat_weights[self.harmonics] = 1.0
        self.wave_weights[self.waves.start : self.waves.stop : 2] = 1.0
        highest_n_per_cm2 = PAST_CLOSURE * self.person.closure_n_per_cm2()
        self.touch_bounds_n_per_cm2 = np.full(2, LOWEST_N_PER_CM2), highest_n_per_cm2
        self._pulsatile_gain = PulsatileGain(self.person, highest_n_per_cm2)
        # One network for each of the steps of the Jacobian.
        self._many = subject.scene.person(np.repeat(subject.factors_ln[:, None], 3 + 2 * WALL_STATES, axis=1))
        self._closed_m = self._many.walls.with_axes(2).closed
        self._drift_jacobian = np.pad(np.diag(subject.rest_v), [(0, 0), (self.drift.start, 0)])
        self._linear_process_of = lru_cache(8)(self._linear_process)

    def initial(self) -> tuple[Array, Array]:
        """State and covariance of an untouched finger, as far as is known."""
        subject, state, covariance = self.subject, np.zeros(self.size), np.zeros((self.size, self.size))
        state[DIAMETERS] = 1.0
        variance = np.einsum("ii->i", covariance)
        variance[DIAMETERS] = INITIAL_DIAMETER**2
        variance[TOUCH] = variance[PULP] = INITIAL_PRESSURE_N_PER_CM2**2
        if subject.noise.beat:
            # Of a beat whose phase is not known yet.
            variance[self.beat] = [RATE_SPREAD**2, *np.repeat(np.square(subject.noise.beat.rms_pa), 2)]
        variance[self.waves] = np.repeat([wave.rms_pa**2 for wave in subject.noise.waves], 2)
        # Uncertainty of the calibration at rest.
        count, factors, blood = len(subject.rest_v), len(NAMES), self.person.blood(np.ones(2))
        volts, by_blood = subject.light.slopes(blood)
        jacobian = np.zeros((count, len(subject.covariance)))
        jacobian[:, NAMES.index("rest_blood")] = subject.readings.gain * (by_blood @ blood)
        jacobian[:, factors : factors + count] = np.diag(volts)
        jacobian[:, factors + count : factors + 2 * count] = np.eye(count)
        jacobian /= subject.rest_v[:, None]
        put_on = subject.noise.donning**2 * np.eye(count)
        covariance[self.drift, self.drift] = (
            jacobian @ subject.covariance @ jacobian.T + subject.drift_covariance + put_on
        )
        return state, covariance

    def resolve_harmonics(self, since_s: float) -> None:
        """Leave out the heart's harmonics that samples so far apart do not show."""
        if beat := self.subject.noise.beat:
            self.beat_weights[self.harmonics] = beat.resolved_harmonics(since_s)

    def process(
        self, state: Array, stderr: Array, relaxed_n_per_cm2: Array, step_s: float
    ) -> tuple[Array, Array, Array]:
        """State (n,) after a step [s], its Jacobian F and the process noise Q, (n, n) each, that of the touch left out.

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
        before_m = np.maximum(around[DIAMETERS] * many.rest_m, self._closed_m)
        outside_pa = touch_on_walls(touch, many.distal_reach)
        diameters = step(many.walls, before_m, outside_pa, highs, person.venous_pa, step_s=step_s) / many.rest_m
        moved = np.vstack([diameters, touch[1]])
        driven, (up, down) = [0, 1, 2, PULP], np.split(moved[:, 1:first], 2, axis=1)
        transition[driven, :WALL_STATES] = (up - down) / (2 * step_by)
        by_arterial = (diameters[:, first] - diameters[:, first + 1]) / (2 * ARTERIAL_STEP_PA)
        transition[DIAMETERS] += np.outer(by_arterial, self.wave_weights)
        after = transition @ state
        after[driven] = moved[:, 0]
        speed_error = SPEED_ERROR * (diameters[:, 0] - state[DIAMETERS])
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
        subject, calibrated, diameter = self.subject, self.subject.readings, np.maximum(state[:2], LEAST_DIAMETER)
        pulsatile, by_touch = self._pulsatile_gain.at(touch_pressure(state[TOUCH]))
        beat_pa, blood = self.beat_weights @ state, self.person.blood(diameter)
        volts, by_blood = subject.light.slopes(blood * (1.0 + pulsatile * beat_pa))
        by_blood = calibrated.gain[:, None] * by_blood
        jacobian = self._drift_jacobian.copy()
        jacobian[:, :2] = by_blood * (1.0 + pulsatile * beat_pa) * (2 * blood / diameter)
        jacobian[:, TOUCH] = by_blood @ (blood[:, None] * by_touch) * beat_pa * expit(state[TOUCH] / SOFTNESS_N_PER_CM2)
        jacobian += np.outer(by_blood @ (blood * pulsatile), self.beat_weights)
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

    def _linear_process(self, step_s: float) -> tuple[Array, Array]:
        """Transition and noise of all that is linear, over a step."""
        transition, variance = np.eye(self.size), np.zeros(self.size)
        variance[DIAMETERS] = WALL_NOISE_RT_S**2 * step_s
        variance[PULP] = PULP_NOISE_N_PER_CM2_RT_S**2 * step_s
        for k, wave in enumerate(self.subject.noise.waves):
            at = slice(self.waves.start + 2 * k, self.waves.start + 2 * k + 2)
            transition[at, at], variance[at] = wave.propagate(step_s)
        noise = np.diag(variance)
        noise[self.drift, self.drift] = self.subject.drift_covariance * step_s / 60.0
        return transition, noise


# Process noise of the touch: random walk in a second. Chosen on the virtual people: three times as much takes more of
# the body's waves for touches. [N/cm^2 / sqrt(s)]
TOUCH_RATE_N_PER_CM2_RT_S = 0.1
# Modes: random walks of the touch of these times the usual rate, and their mean durations. [1, s]
MODE_RATE, MODE_DURATION_S = np.array([1.0, 10.0]), np.array([2.0, 0.3])
# Most iterations of the update, largest step of a coordinate in one, and the step below which they end.
ITERATIONS, LARGEST_UPDATE, CONVERGED = 5, 0.3, 1e-3
# Most standard deviations of its prediction by which a sample moves the touch: it bends to 0 at rest, from where the
# linearised filter takes a step of force within a sample for two to four times as much. [1]
TOUCH_GATE = 4.0
# A finger rests as often as it touches, with pressures of this range on either side: prior of rest. [N/cm^2]
TOUCH_RANGE_N_PER_CM2 = 0.5
# Standard error of the zero after a second of rest. [N/cm^2 sqrt(s)]
ZERO_STDERR_N_PER_CM2_RT_S = 0.025
# A sample whose normalized innovation squared lies above this quantile of chi-squared is an outlier.
OUTLIER_GATE = 0.999
# The filter restarts, at rest, after gaps, and where a diameter over rest has a larger standard error than this: a soft
# vein past closure is known to no more than 2, and must not be taken for diverged.
DIVERGED = 5.0


class PressureEstimate(NamedTuple):
    """Estimate of one sample, or of T samples: (T, ...) each.

    touch_n_per_cm2 : (2,) float. Coordinates of both pressures, of which `touch_pressure` makes pressures. [N/cm^2]
    covariance : (2, 2) float. Of these, for an exact calibration.
    arterial_pa : float. Deviation of P_H from its mean. [Pa]
    nis : float. Normalized innovation squared, as of samples NOISE_S apart. count : int. Valid readings.
    outlier : bool. Whether the NIS exceeds the gate.
    informed : bool. Whether a reading came since the filter began or restarted, without which all this is its prior.
    """

    touch_n_per_cm2: Array
    covariance: Array
    arterial_pa: Any
    nis: Any
    count: Any
    outlier: Any
    informed: Any


def stacked(estimates: Iterable[PressureEstimate]) -> PressureEstimate:
    """Estimates of single samples as one."""
    return PressureEstimate(*map(np.array, zip(*estimates, strict=True)))


def mode_transition(since_s: float) -> Array:
    """Mode transition probabilities Pi (M, M) over a time."""
    stay = np.exp(-since_s / MODE_DURATION_S)
    leave = (1.0 - stay) / (len(MODE_RATE) - 1)
    return np.asarray(np.diag(stay - leave) + leave[:, None])


def rest_odds(touch: Array, covariance: Array) -> Array:
    """Odds (...) of rest over touch, for estimates (..., 2) with covariances (..., 2, 2)."""
    x, y = touch[..., 0], touch[..., 1]
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    determinant = xx * yy - xy**2
    mahalanobis2 = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / determinant
    density = np.exp(-0.5 * mahalanobis2) / (2 * np.pi * np.sqrt(determinant))
    return np.asarray(TOUCH_RANGE_N_PER_CM2**2 * density)


class KalmanFilter:
    """Estimates the touch from readings, sample by sample.

    state, covariance : merged over modes. mode_probability : (M,) float.
    mode_covariance : (M, size, size) float. Predicted, of each mode.
    relaxed_n_per_cm2 : (2,) float. Pressures that the viscoelastic pulp has relaxed to. [N/cm^2]
    informed : bool. Whether a reading came since the last restart.
    """

    def __init__(self, subject: Subject) -> None:
        self.subject, self.model = subject, StateSpace(subject)
        self.restart()

    def restart(self) -> None:
        """Return to the prior of an untouched finger."""
        self.state, self.covariance = self.model.initial()
        self.informed, self._unread_s = False, 0.0
        self.relaxed_n_per_cm2 = np.zeros(2)
        # Readings less drift, and their recent change. [V]
        self._blood_v, self._moved_v = self.model.measurement(self.state)[0], np.zeros(len(self.subject.rest_v))
        self.mode_probability = np.full(len(MODE_RATE), 1.0 / len(MODE_RATE))
        self.mode_covariance = np.repeat(self.covariance[None], len(MODE_RATE), axis=0)

    def update_sample(self, volts: Array, since_s: float | None) -> PressureEstimate:
        """Predict and update by one sample.

        volts : (R,) float; NaN where a reading has a gap. [V]
        since_s : time from the sample before it; None for the first. [s]
        """
        if since_s is not None:
            self.predict(since_s)
        valid = np.isfinite(volts)
        if valid.any():
            self.informed, self._unread_s = True, 0.0
        variance, usual = (self.subject.measurement_noise(self._blood_v, self._moved_v, s) for s in (since_s, NOISE_S))
        gate = 2.0 * float(gammaincinv(max(valid.sum(), 1) / 2, OUTLIER_GATE))  # quantile of chi-squared
        nis = self._update(volts, valid, variance, usual, gate)
        # Pseudo-measurement of zero touch, weighted by the probability that the finger rests, which readings show.
        touch, covariance = self.state[TOUCH], self.covariance[TOUCH, TOUCH]
        odds, elapsed_s = rest_odds(touch, covariance), min(since_s or 0.0, LONGEST_GAP_S) if valid.any() else 0.0
        information = odds / (1.0 + odds) * elapsed_s / ZERO_STDERR_N_PER_CM2_RT_S**2
        gain = self.covariance[:, TOUCH] * information @ np.linalg.inv(np.eye(2) + covariance * information)
        self.state = self.state - gain @ touch
        self.covariance = self.covariance - gain @ self.covariance[TOUCH]
        blood_v = self.model.measurement(self.state)[0] - self.subject.rest_v * self.state[self.model.drift]
        self._moved_v, self._blood_v = self._moved_v + blood_v - self._blood_v, blood_v
        # The touch less the pulp's relaxation up to that; from twice it on all, linear between.
        touch, lost = self.state[TOUCH], np.maximum(self.model.person.creep * self.relaxed_n_per_cm2, 1e-9)
        return PressureEstimate(
            touch_n_per_cm2=np.asarray(touch - lost * np.clip(2.0 - touch / lost, 0.0, 1.0)),
            covariance=self.covariance[TOUCH, TOUCH].copy(),
            arterial_pa=float((self.model.beat_weights + self.model.wave_weights) @ self.state),
            nis=nis,
            count=int(valid.sum()),
            outlier=nis > gate,
            informed=self.informed,
        )

    def predict(self, since_s: float) -> None:
        """Predict the next sample, or restart."""
        self._unread_s += since_s
        if self._unread_s > LONGEST_GAP_S or not self.informed:
            self.restart()
            return
        self.model.resolve_harmonics(since_s)
        self.mode_probability = self.mode_probability @ mode_transition(since_s)
        self._moved_v = self._moved_v * np.exp(-since_s / READING_CORRELATION_S)
        self.mode_covariance = np.repeat(self.covariance[None], len(MODE_RATE), axis=0)
        steps = max(1, math.ceil(since_s / LONGEST_STEP_S - 1e-9))
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(steps):
                self._predict_step(since_s / steps)
        # Readings of another person can make a filter diverge.
        variance = np.einsum("mii->mi", self.mode_covariance)
        if not (np.isfinite(variance).all() and (variance[:, DIAMETERS] < DIVERGED**2).all()):
            self.restart()

    def _predict_step(self, step_s: float) -> None:
        """Predict state and covariance of each mode by one step of the network."""
        variance = np.einsum("m,mii->i", self.mode_probability, self.mode_covariance)[:WALL_STATES]
        after, transition, noise = self.model.process(self.state, np.sqrt(variance), self.relaxed_n_per_cm2, step_s)
        self.relaxed_n_per_cm2 = self.model.relax(self.state, self.relaxed_n_per_cm2, step_s)
        before, touch = self.mode_covariance.copy(), range(TOUCH.start, TOUCH.stop)
        # Process noise of the touch, which differs by mode, before the step; `process` has that of all else.
        before[:, touch, touch] += (step_s * (TOUCH_RATE_N_PER_CM2_RT_S * MODE_RATE) ** 2)[:, None]
        self.mode_covariance = transition @ before @ transition.T + noise
        self.state = after

    def _update(self, volts: Array, valid: NDArray[np.bool_], variance: Array, usual: Array, gate: float) -> float:
        """Iterated update of all modes by the valid readings, merged; returns the normalized innovation squared, by
        the usual variance: that of correlated samples grows with their rate."""
        predicted = state = self.state
        farthest = TOUCH_GATE * np.sqrt(np.einsum("mii->mi", self.mode_covariance)[:, TOUCH].max(0))
        measurement_noise, nis, probability = np.diag(variance[valid]), 0.0, self.mode_probability
        for iteration in range(ITERATIONS):
            expected, jacobian = self.model.measurement(state)
            innovation, jacobian = (volts - expected)[valid], jacobian[valid]
            innovation_by_state = jacobian @ self.mode_covariance
            innovation_covariance = innovation_by_state @ jacobian.T
            if iteration == 0:
                root = np.linalg.cholesky(innovation_covariance + measurement_noise)
                columns = np.broadcast_to(innovation[:, None], (len(root), len(innovation), 1))
                mode_nis = (np.linalg.solve(root, columns) ** 2).sum((1, 2))
                log_likelihood = -0.5 * mode_nis - np.log(np.einsum("mii->mi", root)).sum(1)
                probability = probability * np.exp(log_likelihood - log_likelihood.max())
                probability /= probability.sum()
                apart = np.linalg.solve(innovation_covariance + np.diag(usual[valid]), columns)[..., 0]
                nis = float(probability @ apart @ innovation)
                # Outliers count for less.
                measurement_noise = measurement_noise * max(1.0, float(probability @ mode_nis) / gate)
            innovation_covariance = innovation_covariance + measurement_noise
            gain = np.linalg.solve(innovation_covariance, innovation_by_state).swapaxes(1, 2)
            corrections = gain @ (innovation - jacobian @ (predicted - state))
            updated = predicted + probability @ corrections
            nearest = np.maximum(updated[TOUCH], predicted[TOUCH] - farthest)
            updated[TOUCH] = np.minimum(nearest, predicted[TOUCH] + farthest)
            moved = updated - state
            moved[:WALL_STATES] = np.minimum(np.maximum(moved[:WALL_STATES], -LARGEST_UPDATE), LARGEST_UPDATE)
            state = state + moved
            if np.abs(moved[:WALL_STATES]).max() < CONVERGED:
                break
        # Joseph form, which stays positive for any gain; merged with the spread of the modes' means.
        identity_less_gain = np.eye(self.model.size) - gain @ jacobian
        covariance = identity_less_gain @ self.mode_covariance @ identity_less_gain.swapaxes(1, 2)
        covariance = covariance + gain @ measurement_noise @ gain.swapaxes(1, 2)
        from_mean = corrections - probability @ corrections
        self.mode_probability = probability
        self.covariance = np.einsum("m,mij->ij", probability, covariance) + (probability * from_mean.T) @ from_mean
        self.state = self.model.bound_touch(state, self.covariance)
        self.state[DIAMETERS] = np.maximum(self.state[DIAMETERS], LEAST_DIAMETER)
        self.state[PULP] = min(max(self.state[PULP], 0.0), self.model.touch_bounds_n_per_cm2[1][1])
        return nis


def estimate_pressures(subject: Subject, time_s: Array, volts: Array) -> PressureEstimate:
    """Estimates of samples (T,) from volts (R, T)."""
    kalman, since_s = KalmanFilter(subject), [None, *np.diff(time_s)]
    return stacked(kalman.update_sample(*sample) for sample in zip(volts.T, since_s, strict=True))
