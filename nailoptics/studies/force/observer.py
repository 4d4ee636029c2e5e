"""An iterated extended Kalman filter on a person's network: from volts to the touch pressures that move the vessels.

Its state is what the network needs (three diameters), what drives it (both touch pressures, the body's arterial
pressure) and the slow drift of each reading. Pressures are random walks that stay at 0 or above; the arterial pressure
is a heartbeat and damped oscillators: breathing, vasomotion. What the calibration left open of the person and of
the gains is carried along, not estimated (Schmidt 1966): it widens the intervals, and no reading narrows it again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ...hemodynamics.stepping import step
from .heartbeat import Beat
from .network import LONGEST_STEP_S, closure_of, touch_on_walls
from .person import NAMES, PRIORS, Person
from .reading_table import ReadingTable

Array = NDArray[np.float64]

# Below this a pressure bends smoothly to 0, so that the filter always has a slope to follow. [N/cm^2]
SOFTNESS = 0.02
# Past closure nothing tells one touch from another: the filter stays at this part of it, from where it finds back.
PAST_CLOSURE = 1.2
# The lowest coordinate: further below 0 a pressure would have no slope left to come back by. [N/cm^2]
LOWEST = -0.03
# Steps by which the network's slopes are found: of widths over rest, of pressures in N/cm^2, of P_H in Pa.
LARGEST_STEP = np.array([0.05, 0.05, 0.05, 0.1, 0.1])
SMALLEST_STEP, ARTERIAL_STEP_PA = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02]), 200.0
# What the walls do beyond the model, per sample, of their widths at rest: keeps the filter from being sure of them.
WALL_NOISE = 1e-4
# At most so many linearisations of one sample; a coordinate moves no further than this in one of them.
ITERATIONS, FARTHEST = 5, 0.3
# A sample that less than one in a hundred is as far from its prediction as may be a sudden touch, by so much from the
# sample before it. [N/cm^2]
SUDDEN, JUMP = 0.99, 0.2
# A sample that less than one in a thousand is as far from its prediction as counts as an outlier.
OUTLIER = 0.999
# Gaps longer than this are no part of a recording any more: the filter starts anew after them. [s]
LONGEST_GAP_S = 5.0

WIDTHS, TOUCH, FIRST_BODY = slice(0, 3), slice(3, 5), 5
# Factors that change the network itself, whose effect on its walls is found by steps of this in their logarithm.
ON_WALLS = tuple(NAMES.index(name) for name in NAMES if PRIORS[name].fields or name == "distal_reach")
FACTOR_STEP_LN = 0.05
AREAS = [NAMES.index("contact_area"), NAMES.index("proximal_area")]


@dataclass(frozen=True)
class Oscillation:
    """A rhythm of the arterial pressure: a damped oscillator driven by noise.

    frequency_hz : where its power lies. coherence_s : how long it keeps its phase. rms_pa : its strength.
    """

    frequency_hz: float
    coherence_s: float
    rms_pa: float


@dataclass(frozen=True)
class Noise:
    """What moves readings beside the touch.

    reading_v : (R,) float. White noise of each reading, rms. [V]
    drift_per_min : float. Random walk of each reading in a minute, of its volts. [1]
    led_drift_per_min : float. That of all readings of an LED together.
    beat : the heart's; None where none was seen.
    rhythms : of the arterial pressure, beside the beat.
    touch_rate : float. Random walk of each touch pressure. [N/cm^2 / sqrt(s)]
    """

    reading_v: Array
    drift_per_min: float
    led_drift_per_min: float
    beat: Beat | None
    rhythms: tuple[Oscillation, ...]
    touch_rate: float


@dataclass(frozen=True)
class Calibrated:
    """A person's sensor as calibrated, and what the calibration left open.

    make : gives the person, or many, of logarithms of the factors (P, *S).
    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    gain, offset_v : (R,) float. Volts of a reading are offset + gain * the table's.
    covariance : (P + 2 R, P + 2 R) float. Of the factors' logarithms, the gains, and the offsets [V].
    """

    make: Callable[[Array], Person]
    table: ReadingTable
    factors_ln: Array
    gain: Array
    offset_v: Array
    covariance: Array


@dataclass
class PressureEstimate:
    """What one sample told.

    touch : (2,) float. Coordinates of both pressures; `pressure_of` makes pressures of them. [N/cm^2]
    covariance : (4, 4) float. Of these and of the logarithms of the contact's areas.
    arterial_pa : float. By how much P_H is off its mean. [Pa]
    surprise : float. Squared distance of the readings from their prediction, in its covariance.
    count : int. Readings that the sample has.
    outlier : bool. Whether it was too far off to be believed.
    """

    touch: Array
    covariance: Array
    arterial_pa: float
    surprise: float
    count: int
    outlier: bool


def pressure_of(coordinate: Array) -> Array:
    """Touch pressure of its coordinate: the same above 0, bent to 0 below. [N/cm^2]"""
    return SOFTNESS * np.logaddexp(0.0, coordinate / SOFTNESS)


class Observer:
    """Tells the touch from readings, one sample after the other; holds no more than its state."""

    def __init__(self, calibrated: Calibrated, noise: Noise) -> None:
        self.table, self.noise = calibrated.table, noise
        self.gain, self.offset_v = calibrated.gain, calibrated.offset_v
        readings, beat = len(self.gain), noise.beat.size if noise.beat else 0
        self.beat = slice(FIRST_BODY, FIRST_BODY + beat)
        self.body = slice(self.beat.stop, self.beat.stop + 2 * len(noise.rhythms))
        self.drift = slice(self.body.stop, self.body.stop + readings)
        # What is carried along: the factors of the person, and the gains.
        self.factors = slice(self.drift.stop, self.drift.stop + len(NAMES))
        self.gains = slice(self.factors.stop, self.factors.stop + readings)
        self.size, self.estimated = self.gains.stop, self.factors.start
        self.shown = [3, 4, *(self.factors.start + area for area in AREAS)]
        led = self.table.same_led()
        self._drift = noise.drift_per_min**2 * np.eye(readings) + noise.led_drift_per_min**2 * led @ led.T
        self.arterial = np.zeros(self.size)
        self.arterial[self.beat.start + 1 : self.beat.stop : 2] = 1.0
        self.arterial[self.body.start : self.body.stop : 2] = 1.0
        self._matrices: dict[float, tuple[Array, Array]] = {}
        self.person = calibrated.make(calibrated.factors_ln)
        closure = closure_of(self.person)
        self._highest = PAST_CLOSURE * np.array([closure.proximal, closure.distal])
        rest_blood = self.person.blood(np.ones(2))
        self._table_rest_v, by_blood = self.table.slopes(rest_blood)
        self._rest_by_blood = self.gain * (by_blood @ rest_blood)
        self.rest_volts = self.gain * self._table_rest_v
        self._open = self._open_covariance(calibrated.covariance)
        # One network for each of the steps by which `_predict` finds its slopes.
        columns = np.repeat(calibrated.factors_ln[:, None], 13 + 2 * len(ON_WALLS), axis=1)
        for k, factor in enumerate(ON_WALLS):
            columns[factor, 13 + 2 * k] += FACTOR_STEP_LN
            columns[factor, 14 + 2 * k] -= FACTOR_STEP_LN
        many = calibrated.make(columns)
        self._walls, self._rest, self._reach = many.walls, many.rest_m, many.distal_reach
        self._closed = np.stack(
            np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in many.walls.closed), many.rest_m[0])[:3]
        )
        self.restart()

    def _open_covariance(self, covariance: Array) -> Array:
        """The calibration's covariance of the drifts, factors and gains.

        Drifts begin as what is open of the readings at rest. These are well known, unlike gains and offsets, whose
        errors all but cancel there: an offset that is estimated beside a gain that is not would run away.
        """
        count, factors = len(self.gain), len(NAMES)
        level = np.zeros((count, len(covariance)))
        level[:, factors + count :] = np.eye(count)
        level[:, factors : factors + count] = np.diag(self._table_rest_v)
        level[:, NAMES.index("rest_blood")] = self._rest_by_blood
        take = np.vstack([level / self.rest_volts[:, None], np.eye(factors + count, len(covariance))])
        return take @ covariance @ take.T

    def restart(self) -> None:
        """Forget everything: an untouched finger, as far as is known."""
        self.state = np.zeros(self.size)
        self.state[WIDTHS] = 1.0
        self.covariance = np.zeros((self.size, self.size))
        diagonal = np.einsum("ii->i", self.covariance)
        diagonal[WIDTHS] = 1e-2**2
        diagonal[TOUCH] = 0.1**2
        if self.noise.beat:
            diagonal[self.beat] = self.noise.beat.start()
        diagonal[self.body] = np.repeat([one.rms_pa**2 for one in self.noise.rhythms], 2)
        self.covariance[self.drift.start :, self.drift.start :] = self._open
        self.covariance[self.drift, self.drift] += self._drift

    def see(self, volts: Array, since_s: float | None) -> PressureEstimate:
        """Take in one sample.

        volts : (R,) float; NaN where a reading has a gap. [V]
        since_s : time from the sample before it; None for the first. [s]
        """
        there = np.isfinite(volts)
        if since_s is not None and since_s <= LONGEST_GAP_S:
            before = self.state, self.covariance
            self._go_on(since_s)
            if there.any() and self._surprise(volts, there) > _limit(int(there.sum()), SUDDEN):
                self.state, self.covariance = before[0], before[1].copy()
                self.covariance[3, 3] += JUMP**2
                self.covariance[4, 4] += JUMP**2
                self._go_on(since_s)
        elif since_s is not None:
            self.restart()
        surprise = self._update(volts, there) if there.any() else 0.0
        return PressureEstimate(
            touch=self.state[TOUCH].copy(),
            covariance=self.covariance[np.ix_(self.shown, self.shown)],
            arterial_pa=float(self.arterial @ self.state),
            surprise=surprise,
            count=int(there.sum()),
            outlier=surprise > _limit(int(there.sum()), OUTLIER),
        )

    def _go_on(self, since_s: float) -> None:
        """Predict the next sample."""
        for _ in range(count := max(1, math.ceil(since_s / LONGEST_STEP_S - 1e-9))):
            self._predict(since_s / count)

    def _surprise(self, volts: Array, there: NDArray[np.bool_]) -> float:
        """Squared distance of the readings that are there from their prediction, in its covariance."""
        expected, slopes = self._expected(self.state)
        off, slopes = (volts - expected)[there], slopes[there]
        spread = slopes @ self.covariance @ slopes.T + np.diag(self.noise.reading_v[there] ** 2)
        return float(off @ np.linalg.solve(spread, off))

    def _linear_part(self, step_s: float) -> tuple[Array, Array]:
        """Transition and noise of all that is linear, over a step."""
        if step_s not in self._matrices:
            transition, noise = np.eye(self.size), np.zeros(self.size)
            noise[WIDTHS] = WALL_NOISE**2
            noise[TOUCH] = self.noise.touch_rate**2 * step_s
            for k, rhythm in enumerate(self.noise.rhythms):
                at = slice(self.body.start + 2 * k, self.body.start + 2 * k + 2)
                angle, kept = 2 * np.pi * rhythm.frequency_hz * step_s, np.exp(-step_s / rhythm.coherence_s)
                turned = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                transition[at, at] = kept * np.array(turned)
                noise[at] = (1 - kept**2) * rhythm.rms_pa**2
            whole = np.diag(noise)
            whole[self.drift, self.drift] = self._drift * step_s / 60.0
            if len(self._matrices) > 64:
                self._matrices.clear()
            self._matrices[step_s] = transition, whole
        transition, noise_matrix = self._matrices[step_s]
        return transition.copy(), noise_matrix

    def _predict(self, step_s: float) -> None:
        """Go on by one step."""
        state, (transition, noise) = self.state, self._linear_part(step_s)
        high = self.person.arterial_pa + self.arterial @ state
        reach = np.clip(np.sqrt(np.diag(self.covariance)[:5]), SMALLEST_STEP, LARGEST_STEP)
        count = self._rest.shape[1]
        around = np.repeat(state[:5, None], count, axis=1)
        around[range(5), range(1, 6)] += reach
        around[range(5), range(6, 11)] -= reach
        highs = np.full(count, high)
        highs[11:13] += ARTERIAL_STEP_PA * np.array([1.0, -1.0])
        widths = (
            step(
                self._walls,
                np.maximum(around[WIDTHS] * self._rest, self._closed),
                touch_on_walls(pressure_of(around[TOUCH]), self._reach),
                highs,
                self.person.venous_pa,
                step_s=step_s,
            )
            / self._rest
        )
        transition[WIDTHS, :5] = (widths[:, 1:6] - widths[:, 6:11]) / (2 * reach)
        transition[WIDTHS] += np.outer((widths[:, 11] - widths[:, 12]) / (2 * ARTERIAL_STEP_PA), self.arterial)
        by_factor = (widths[:, 13::2] - widths[:, 14::2]) / (2 * FACTOR_STEP_LN)
        for k, factor in enumerate(ON_WALLS):
            transition[WIDTHS, self.factors.start + factor] = by_factor[:, k]
        after = transition @ state
        after[WIDTHS] = widths[:, 0]
        if self.noise.beat:
            after[self.beat], transition[self.beat, self.beat], grown = self.noise.beat.go_on(state[self.beat], step_s)
            noise = noise.copy()
            noise[self.beat, self.beat] = grown
        self.state = after
        self.covariance = transition @ self.covariance @ transition.T + noise

    def _expected(self, state: Array) -> tuple[Array, Array]:
        """Volts of every reading and their slopes (R, size)."""
        width = np.maximum(state[:2], 1e-3)
        blood = self.person.blood(width)
        volts, by_blood = self.table.slopes(blood)
        slopes, each = np.zeros((len(volts), self.size)), np.arange(len(volts))
        slopes[:, :2] = self.gain[:, None] * by_blood * (2 * blood / width)
        slopes[each, self.drift.start + each] = self.rest_volts
        slopes[:, self.factors.start + NAMES.index("rest_blood")] = self.gain * (by_blood @ blood) - self._rest_by_blood
        slopes[each, self.gains.start + each] = volts - self._table_rest_v
        return self.offset_v + self.gain * volts + self.rest_volts * state[self.drift], slopes

    def _update(self, volts: Array, there: NDArray[np.bool_]) -> float:
        """Correct the state by the readings that are there; returns how far off they were."""
        before, covariance = self.state, self.covariance
        own, state, surprise = np.diag(self.noise.reading_v[there] ** 2), before, 0.0
        for iteration in range(ITERATIONS):
            expected, slopes = self._expected(state)
            off, slopes = (volts - expected)[there], slopes[there]
            spread = slopes @ covariance @ slopes.T
            if iteration == 0:
                surprise = float(off @ np.linalg.solve(spread + own, off))
                # A sample that cannot be so far off counts for less.
                own = own * max(1.0, surprise / _limit(len(off), OUTLIER))
            weight = np.linalg.solve(spread + own, slopes @ covariance).T
            # What is carried along is not corrected.
            weight[self.estimated :] = 0.0
            moved = before + weight @ (off - slopes @ (before - state)) - state
            moved[:5] = np.clip(moved[:5], -FARTHEST, FARTHEST)
            state = state + moved
            if np.abs(moved[:5]).max() < 1e-3:
                break
        self.state = state.copy()
        self.state[WIDTHS] = np.maximum(state[WIDTHS], 1e-3)
        self.state[TOUCH] = np.clip(state[TOUCH], LOWEST, self._highest)
        kept = np.eye(self.size) - weight @ slopes
        self.covariance = kept @ covariance @ kept.T + weight @ own @ weight.T
        return surprise


@lru_cache
def _limit(readings: int, part: float) -> float:
    """Squared distance that this part of samples of so many readings keep to."""
    return float(stats.chi2.ppf(part, max(readings, 1)))
