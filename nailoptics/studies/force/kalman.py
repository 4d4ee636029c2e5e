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
from scipy import stats

from .person import LONGEST_GAP_S, LONGEST_STEP_S, Array
from .state_space import (
    LEAST_WIDTH,
    PULP,
    TOUCH,
    WALL_STATES,
    WIDTHS,
    StateSpace,
)
from .subject import READING_CORRELATION_S, Subject

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
# The filter restarts, at rest, after gaps, and where a width over rest has a larger standard error than this: a soft
# vein past closure is known to no more than 2, and must not be taken for diverged.
DIVERGED = 5.0


class PressureEstimate(NamedTuple):
    """Estimate of one sample, or of T samples: (T, ...) each.

    touch_n_per_cm2 : (2,) float. Coordinates of both pressures, of which `touch_pressure` makes pressures. [N/cm^2]
    covariance : (2, 2) float. Of these, for an exact calibration.
    arterial_pa : float. Deviation of P_H from its mean. [Pa]
    nis : float. Normalized innovation squared. count : int. Valid readings.
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
    mahalanobis2 = np.einsum("...i,...ij,...j->...", touch, np.linalg.inv(covariance), touch)
    density = np.exp(-0.5 * mahalanobis2) / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
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
        self.informed = False
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
        self.informed |= bool(valid.any())
        variance = self.subject.measurement_noise(self._blood_v, self._moved_v, since_s)
        nis = self._update(volts, valid, variance)
        self._update_zero(min(since_s or 0.0, LONGEST_GAP_S))
        blood_v = self.model.measurement(self.state)[0] - self.subject.rest_v * self.state[self.model.drift]
        self._moved_v, self._blood_v = self._moved_v + blood_v - self._blood_v, blood_v
        return PressureEstimate(
            touch_n_per_cm2=self.model.sensed_touch(self.state, self.relaxed_n_per_cm2),
            covariance=self.covariance[TOUCH, TOUCH].copy(),
            arterial_pa=self.model.arterial_pa(self.state),
            nis=nis,
            count=int(valid.sum()),
            outlier=nis > _chi2_quantile(int(valid.sum()), OUTLIER_GATE),
            informed=self.informed,
        )

    def predict(self, since_s: float) -> None:
        """Predict the next sample, or restart."""
        if since_s > LONGEST_GAP_S:
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
        if not (np.isfinite(variance).all() and (variance[:, WIDTHS] < DIVERGED**2).all()):
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

    def _update(self, volts: Array, valid: NDArray[np.bool_], variance: Array) -> float:
        """Iterated update of all modes by the valid readings, merged; returns the normalized innovation squared."""
        predicted = state = self.state
        farthest = TOUCH_GATE * np.sqrt(np.einsum("mii->mi", self.mode_covariance)[:, TOUCH].max(0))
        measurement_noise, nis, probability = np.diag(variance[valid]), 0.0, self.mode_probability
        for iteration in range(ITERATIONS):
            expected, jacobian = self.model.measurement(state)
            innovation, jacobian = (volts - expected)[valid], jacobian[valid]
            innovation_by_state = jacobian @ self.mode_covariance
            innovation_covariance = innovation_by_state @ jacobian.T
            if iteration == 0:
                mode_nis, log_likelihood = _likelihood(innovation, innovation_covariance + measurement_noise)
                probability = probability * np.exp(log_likelihood - log_likelihood.max())
                probability /= probability.sum()
                nis = float(probability @ mode_nis)
                # Outliers count for less.
                measurement_noise = measurement_noise * max(1.0, nis / _chi2_quantile(len(innovation), OUTLIER_GATE))
            innovation_covariance = innovation_covariance + measurement_noise
            gain = np.moveaxis(np.linalg.solve(innovation_covariance, innovation_by_state), 1, 2)
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
        covariance = identity_less_gain @ self.mode_covariance @ np.moveaxis(identity_less_gain, 1, 2)
        covariance = covariance + gain @ measurement_noise @ np.moveaxis(gain, 1, 2)
        from_mean = corrections - probability @ corrections
        self.mode_probability = probability
        self.covariance = np.einsum("m,mij->ij", probability, covariance) + (probability * from_mean.T) @ from_mean
        self.state = self.model.bound_touch(state, self.covariance)
        self.state[WIDTHS] = np.maximum(self.state[WIDTHS], LEAST_WIDTH)
        self.state[PULP] = min(max(self.state[PULP], 0.0), self.model.touch_bounds_n_per_cm2[1][1])
        return nis

    def _update_zero(self, since_s: float) -> None:
        """Update by the knowledge that the touch is 0, weighted by the probability that the finger rests."""
        touch, covariance = self.state[TOUCH], self.covariance[TOUCH, TOUCH]
        odds = rest_odds(touch, covariance)
        information = odds / (1.0 + odds) * since_s / ZERO_STDERR_N_PER_CM2_RT_S**2
        gain = self.covariance[:, TOUCH] * information @ np.linalg.inv(np.eye(2) + covariance * information)
        self.state = self.state - gain @ touch
        self.covariance = self.covariance - gain @ self.covariance[TOUCH]


def estimate_pressures(subject: Subject, time_s: Array, volts: Array) -> PressureEstimate:
    """Estimates of samples (T,) from volts (R, T)."""
    kalman, since_s = KalmanFilter(subject), [None, *np.diff(time_s)]
    return stacked(kalman.update_sample(*sample) for sample in zip(volts.T, since_s, strict=True))


def _likelihood(innovation: Array, innovation_covariance: Array) -> tuple[Array, Array]:
    """Normalized innovations squared (M,) and log-likelihoods of an innovation (r,) of covariances (M, r, r)."""
    root = np.linalg.cholesky(innovation_covariance)
    columns = np.broadcast_to(innovation[:, None], (len(root), len(innovation), 1))
    nis = (np.linalg.solve(root, columns) ** 2).sum((1, 2))
    return nis, -0.5 * nis - np.log(np.einsum("mii->mi", root)).sum(1)


@lru_cache
def _chi2_quantile(readings: int, part: float) -> float:
    return float(stats.chi2.ppf(part, max(readings, 1)))
