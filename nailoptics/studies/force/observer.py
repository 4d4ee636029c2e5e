"""An iterated extended Kalman filter on a person's network: from volts to the touch pressures that move the vessels.

Its state is what the network needs (three diameters), what drives it (both touch pressures, what is left of the distal
one in the pulp, the body's arterial pressure) and the slow drift of each reading. Touch pressures are random walks that
stay at 0 or above and move or step: each sample is read in both ways, and these are weighed by how well they foretold
it (Blom and Bar-Shalom 1988, with one Gaussian between samples). The arterial pressure is a heartbeat and damped
oscillators: breathing, vasomotion. The beat reaches the blood at once, all else through the vessels.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import expit

from ...hemodynamics.stepping import step
from ...hemodynamics.waves import CardiacOscillator, DampedOscillator
from .heartbeat import PulsedBlood
from .network import LONGEST_STEP_S, closure_of, touch_on_walls
from .person import NAMES, Person
from .reading_table import ReadingTable

Array = NDArray[np.float64]

# Below this a pressure bends smoothly to 0, so that the filter always has a slope to follow. [N/cm^2]
SOFTNESS = 0.002
# Past closure nothing tells one touch from another: the filter stays at this part of it, from where it finds back.
PAST_CLOSURE = 1.2
# The lowest coordinate: further below 0 a pressure would have no slope left to come back by. [N/cm^2]
LOWEST = -0.01
# Steps by which the network's slopes are found: of widths over rest, of pressures in N/cm^2, of P_H in Pa.
LARGEST_STEP = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1])
SMALLEST_STEP, ARTERIAL_STEP_PA = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 0.02]), 200.0
# What the walls do beyond the model, per sample, of their widths at rest: keeps the filter from being sure of them.
WALL_NOISE = 1e-4
# Nobody's walls move quite as fast as the model's: by so much of every movement, alike for so long. Chosen on the
# virtual people: without it a touch that is let go past closure is told for seconds. [1, s]
SPEED_ERROR, SPEED_LASTS_S = 0.2, 0.3
# How long what readings are off by the blood's movement stays alike. [s]
READING_LASTS_S = 0.4
# What the distal pulp does beyond the model. [N/cm^2 / sqrt(s)]
PULP_NOISE = 0.05
# What is calibrated of each reading: gain, offset and a steeper slope by the blood of either zone.
LINEAR = 4
# At most so many linearisations of one sample; a coordinate moves no further than this in one of them.
ITERATIONS, FARTHEST = 5, 0.3
# Touches move or step: random walks of these times the usual rate, each for so long on average. [s]
RATES, LASTING_S = np.array([1.0, 10.0]), np.array([2.0, 0.3])
# A finger rests as often as it touches, with pressures of this range on either side: what is not told from rest is
# most likely rest, and a second of it tells where zero is to this. [N/cm^2, N/cm^2 sqrt(s)]
TOUCHES_REACH, ZERO = 0.5, 0.025
# A sample that less than one in a thousand is as far from its prediction as counts as an outlier.
OUTLIER = 0.999
# Gaps longer than this are no part of a recording any more: the filter starts anew after them. [s]
LONGEST_GAP_S = 5.0
# Widths over rest that are known no better than this are those of a filter that ran away: it starts anew, too. A soft
# vein past closure is known to no more than 2, and must not be taken for one: to start anew is to take it for rest.
RUN_AWAY = 5.0

WIDTHS, TOUCH, LEFT, FIRST_BODY = slice(0, 3), slice(3, 5), 5, 6
# These act on the walls, each with the columns of a step up and a step down; two more are of the arterial pressure.
ACTING = FIRST_BODY


@dataclass(frozen=True)
class Noise:
    """What moves readings beside the touch.

    reading_v : (R,) float. White noise of each reading, rms. [V]
    drift_per_min : float. Random walk of each reading in a minute, of its volts. [1]
    led_drift_per_min : float. That of all readings of an LED together.
    beat : the heart's; None where none was seen.
    rhythms : of the arterial pressure, beside the beat.
    touch_rate : float. Random walk of each touch pressure. [N/cm^2 / sqrt(s)]
    moved_error, held_error : float. Errors of readings beyond the model, of how far they have just moved with the blood
        and of how far they are from rest. [1]
    """

    reading_v: Array
    drift_per_min: float
    led_drift_per_min: float
    beat: CardiacOscillator | None
    rhythms: tuple[DampedOscillator, ...]
    touch_rate: float
    moved_error: float
    held_error: float


@dataclass(frozen=True)
class Calibrated:
    """A person's sensor as calibrated, and what the calibration left open.

    make : gives the person, or many, of logarithms of the factors (P, *S).
    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    gain, offset_v : (R,) float. Volts of a reading are offset + gain * the table's.
    covariance : (P + 4 R, P + 4 R) float. Of the factors' logarithms, gains, offsets [V], and steeper slopes by blood.
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
    covariance : (2, 2) float. Of these, were the person known exactly.
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


def going_on(since_s: float) -> Array:
    """Probabilities (M, M) with which a touch that moves in one way moves in each a while later."""
    stay = np.exp(-since_s / LASTING_S)
    leave = (1.0 - stay) / (len(RATES) - 1)
    return np.asarray(np.diag(stay - leave) + leave[:, None])


def within(state: Array, covariance: Array, touches: tuple[Array, Array], drift: slice) -> Array:
    """The likeliest state whose touch lies in a range and whose drift is the given one's.

    Were the drift to follow, every touch let go would push it the same way, and rest would end up far from 0.
    """
    bounded = np.clip(state[TOUCH], *touches)
    off = np.flatnonzero(bounded != state[TOUCH])
    if not off.size:
        return state.copy()
    place = off + TOUCH.start
    moved = state + covariance[:, place] @ np.linalg.solve(
        covariance[np.ix_(place, place)], (bounded - state[TOUCH])[off]
    )
    moved[drift] = state[drift]
    return np.asarray(moved)


class Observer:
    """Tells the touch from readings, one sample after the other; holds no more than its state."""

    def __init__(self, calibrated: Calibrated, noise: Noise) -> None:
        self.table, self.noise = calibrated.table, noise
        self.gain, self.offset_v = calibrated.gain, calibrated.offset_v
        readings, beat = len(self.gain), noise.beat.size if noise.beat else 0
        self.beat = slice(FIRST_BODY, FIRST_BODY + beat)
        self.body = slice(self.beat.stop, self.beat.stop + 2 * len(noise.rhythms))
        self.drift = slice(self.body.stop, self.body.stop + readings)
        self.size = self.drift.stop
        led = self.table.same_led()
        self._drift = noise.drift_per_min**2 * np.eye(readings) + noise.led_drift_per_min**2 * led @ led.T
        # What adds up to the pressure of the beat and, slower, of all other rhythms.
        self.beating, self.slow = np.zeros(self.size), np.zeros(self.size)
        self.beating[self.beat.start + 1 : self.beat.stop : 2] = 1.0
        self.slow[self.body.start : self.body.stop : 2] = 1.0
        self._matrices: dict[float, tuple[Array, Array]] = {}
        self.person = calibrated.make(calibrated.factors_ln)
        closure = closure_of(self.person)
        highest = PAST_CLOSURE * np.array([closure.proximal, closure.distal])
        # The least and the largest coordinates that pressures take.
        self.touches = np.full(2, LOWEST), highest
        rest_v, _ = self.table.slopes(self.person.blood(np.ones(2)))
        self._pulsed = PulsedBlood(self.person, highest)
        self.rest_volts = self.gain * rest_v
        self._level = self._open_at_rest(calibrated.covariance)
        # One network for each of the steps by which `_predict` finds its slopes.
        many = calibrated.make(np.repeat(calibrated.factors_ln[:, None], 3 + 2 * ACTING, axis=1))
        self._walls, self._rest, self._reach = many.walls, many.rest_m, many.distal_reach
        self._closed = np.stack(
            np.broadcast_arrays(*(np.asarray(one, dtype=float) for one in many.walls.closed), many.rest_m[0])[:3]
        )
        self.restart()

    def _open_at_rest(self, covariance: Array) -> Array:
        """Covariance of the readings at rest, over themselves, that the calibration's covariance leaves open."""
        count, factors = len(self.gain), len(NAMES)
        blood = self.person.blood(np.ones(2))
        volts, by_blood = self.table.slopes(blood)
        by = np.zeros((count, len(covariance)))
        by[:, factors + count : factors + 2 * count] = np.eye(count)
        by[:, factors : factors + count] = np.diag(volts)
        by[:, NAMES.index("rest_blood")] = self.gain * (by_blood @ blood)
        by /= self.rest_volts[:, None]
        return by @ covariance @ by.T

    def restart(self) -> None:
        """Forget everything: an untouched finger, as far as is known."""
        self.state = np.zeros(self.size)
        self.state[WIDTHS] = 1.0
        self.covariance = np.zeros((self.size, self.size))
        diagonal = np.einsum("ii->i", self.covariance)
        diagonal[WIDTHS] = 1e-2**2
        diagonal[TOUCH] = 0.1**2
        diagonal[LEFT] = 0.1**2
        if self.noise.beat:
            diagonal[self.beat] = self.noise.beat.initial_variance()
        diagonal[self.body] = np.repeat([one.rms_pa**2 for one in self.noise.rhythms], 2)
        self.covariance[self.drift, self.drift] = self._level + self._drift
        self.followed = np.zeros(2)
        # What the blood makes of readings, and how far that has just moved. [V]
        self.blood_v, self.moved_v = self._expected(self.state)[0], np.zeros(len(self.gain))
        self.ways = np.full(len(RATES), 1.0 / len(RATES))
        self.each = np.repeat(self.covariance[None], len(RATES), axis=0)

    def see(self, volts: Array, since_s: float | None) -> PressureEstimate:
        """Take in one sample.

        volts : (R,) float; NaN where a reading has a gap. [V]
        since_s : time from the sample before it; None for the first. [s]
        """
        if since_s is not None:
            self.foresee(since_s)
        return self.take_in(volts, since_s)

    def foresee(self, since_s: float) -> Array | None:
        """Predict the next sample; returns the slopes of its state by that before, or None where it began anew."""
        if since_s > LONGEST_GAP_S:
            self.restart()
            return None
        if self.noise.beat:
            self.beating[self.beat.start + 1 : self.beat.stop : 2] = self.noise.beat.resolved_harmonics(since_s)
        self.ways = self.ways @ going_on(since_s)
        self.moved_v = self.moved_v * np.exp(-since_s / READING_LASTS_S)
        self.each, slopes = np.repeat(self.covariance[None], len(RATES), axis=0), np.eye(self.size)
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(count := max(1, math.ceil(since_s / LONGEST_STEP_S - 1e-9))):
                slopes = self._predict(since_s / count) @ slopes
        # Another person's readings can drive a filter out of all bounds: it then knows nothing.
        variance = np.einsum("mii->mi", self.each)
        if not (np.isfinite(variance).all() and (variance[:, WIDTHS] < RUN_AWAY**2).all()):
            self.restart()
            return None
        return slopes

    def take_in(self, volts: Array, since_s: float | None) -> PressureEstimate:
        """Correct what was predicted by a sample (R,), so long after the one before it."""
        there = np.isfinite(volts)
        # Alike for so long, an error is told from the touch no better by many samples than by one.
        alike = max(1.0, READING_LASTS_S / since_s) if since_s else 1.0
        held_v = self.blood_v - self.offset_v - self.rest_volts
        beyond_v2 = (self.noise.moved_error * self.moved_v) ** 2 + (self.noise.held_error * held_v) ** 2
        own_v2 = self.noise.reading_v**2 + alike * beyond_v2
        surprise = self._update(volts, there, own_v2)
        self._find_zero(min(since_s or 0.0, LONGEST_GAP_S))
        blood_v = self._expected(self.state)[0] - self.rest_volts * self.state[self.drift]
        self.moved_v, self.blood_v = self.moved_v + blood_v - self.blood_v, blood_v
        return PressureEstimate(
            touch=self.told(self.state),
            covariance=self.covariance[TOUCH, TOUCH].copy(),
            arterial_pa=float((self.beating + self.slow) @ self.state),
            surprise=surprise,
            count=int(there.sum()),
            outlier=surprise > _limit(int(there.sum()), OUTLIER),
        )

    def _linear_part(self, step_s: float) -> tuple[Array, Array]:
        """Transition and noise of all that is linear, over a step."""
        if step_s not in self._matrices:
            transition, noise = np.eye(self.size), np.zeros(self.size)
            noise[WIDTHS] = WALL_NOISE**2
            noise[LEFT] = PULP_NOISE**2 * step_s
            for k, rhythm in enumerate(self.noise.rhythms):
                at = slice(self.body.start + 2 * k, self.body.start + 2 * k + 2)
                transition[at, at], noise[at] = rhythm.propagate(step_s)
            whole = np.diag(noise)
            whole[self.drift, self.drift] = self._drift * step_s / 60.0
            if len(self._matrices) > 64:
                self._matrices.clear()
            self._matrices[step_s] = transition, whole
        transition, noise_matrix = self._matrices[step_s]
        return transition.copy(), noise_matrix

    def _predict(self, step_s: float) -> Array:
        """Go on by one step; returns its slopes."""
        state, (transition, noise) = self.state, self._linear_part(step_s)
        pulp, high = self.person.pulp, self.person.arterial_pa + self.slow @ state
        spread = np.sqrt(np.einsum("m,mii->i", self.ways, self.each)[:ACTING])
        reach = np.clip(spread, SMALLEST_STEP, LARGEST_STEP)
        count, first = self._rest.shape[1], 1 + 2 * ACTING
        around = np.repeat(state[:ACTING, None], count, axis=1)
        around[range(ACTING), range(1, 1 + ACTING)] += reach
        around[range(ACTING), range(1 + ACTING, first)] -= reach
        highs = np.full(count, high)
        highs[first : first + 2] += ARTERIAL_STEP_PA * np.array([1.0, -1.0])
        touch = pulp.spread(pressure_of(around[TOUCH]), self.followed)
        touch[1] = pulp.recover(around[LEFT], touch[1], step_s)
        widths = (
            step(
                self._walls,
                np.maximum(around[WIDTHS] * self._rest, self._closed),
                touch_on_walls(touch, self._reach),
                highs,
                self.person.venous_pa,
                step_s=step_s,
            )
            / self._rest
        )
        moved = np.vstack([widths, touch[1]])
        driven = [0, 1, 2, LEFT]
        transition[driven, :ACTING] = (moved[:, 1 : 1 + ACTING] - moved[:, 1 + ACTING : first]) / (2 * reach)
        transition[WIDTHS] += np.outer((widths[:, first] - widths[:, first + 1]) / (2 * ARTERIAL_STEP_PA), self.slow)
        after = transition @ state
        after[driven] = moved[:, 0]
        noise = noise.copy()
        speed_error = SPEED_ERROR * (widths[:, 0] - state[WIDTHS])
        noise[range(3), range(3)] += speed_error**2 * SPEED_LASTS_S / step_s
        if self.noise.beat:
            after[self.beat], transition[self.beat, self.beat], grown = self.noise.beat.propagate(
                state[self.beat], step_s
            )
            noise[self.beat, self.beat] = grown
        self.state, self.followed = after, pulp.follow(self.followed, pressure_of(state[TOUCH]), step_s)
        each = self.each.copy()
        each[:, [3, 4], [3, 4]] += (step_s * (self.noise.touch_rate * RATES) ** 2)[:, None]
        self.each = transition @ each @ transition.T + noise
        return transition

    def _expected(self, state: Array) -> tuple[Array, Array]:
        """Volts of every reading and their slopes (R, size)."""
        width = np.maximum(state[:2], 1e-3)
        pulsed, by_touch = self._pulsed.part(pressure_of(state[TOUCH]))
        beat_pa, blood = self.beating @ state, self.person.blood(width)
        volts, by_blood = self.table.slopes(blood * (1.0 + pulsed * beat_pa))
        by_blood = self.gain[:, None] * by_blood
        slopes, each = np.zeros((len(volts), self.size)), np.arange(len(volts))
        slopes[:, :2] = by_blood * (1.0 + pulsed * beat_pa) * (2 * blood / width)
        slopes[:, TOUCH] = by_blood @ (blood[:, None] * by_touch) * beat_pa * expit(state[TOUCH] / SOFTNESS)
        slopes += np.outer(by_blood @ (blood * pulsed), self.beating)
        slopes[each, self.drift.start + each] = self.rest_volts
        return self.offset_v + self.gain * volts + self.rest_volts * state[self.drift], slopes

    def _update(self, volts: Array, there: NDArray[np.bool_], own_v2: Array) -> float:
        """Correct the state by the readings that are there, of some variance; returns how far off they were."""
        before, state, each = self.state, self.state, self.each
        own, surprise = np.diag(own_v2[there]), 0.0
        ways = self.ways
        for iteration in range(ITERATIONS):
            expected, slopes = self._expected(state)
            off, slopes = (volts - expected)[there], slopes[there]
            seen = slopes @ each
            spread = seen @ slopes.T
            if iteration == 0:
                far, likely = _fit_of(off, spread + own)
                ways = _weighed(ways, likely)
                surprise = float(ways @ far)
                # A sample that cannot be so far off counts for less.
                own = own * max(1.0, surprise / _limit(len(off), OUTLIER))
            spread = spread + own
            weight = np.moveaxis(np.linalg.solve(spread, seen), 1, 2)
            moves = weight @ (off - slopes @ (before - state))
            moved = before + ways @ moves - state
            moved[:ACTING] = np.clip(moved[:ACTING], -FARTHEST, FARTHEST)
            state = state + moved
            if np.abs(moved[:ACTING]).max() < 1e-3:
                break
        left = np.eye(self.size) - weight @ slopes
        kept = left @ each @ np.moveaxis(left, 1, 2) + weight @ own @ np.moveaxis(weight, 1, 2)
        apart = moves - ways @ moves
        self.ways, self.state = ways, state.copy()
        self.covariance = np.einsum("m,mij->ij", ways, kept) + (ways * apart.T) @ apart
        self.state = within(self.state, self.covariance, self.touches, self.drift)
        self.state[WIDTHS] = np.maximum(self.state[WIDTHS], 1e-3)
        self.state[LEFT] = np.clip(self.state[LEFT], 0.0, self.touches[1][1])
        return surprise

    def told(self, state: Array) -> Array:
        """Coordinates of the touch, where vessels feel it; of less than what the pulp has yet to give back: none."""
        lost = np.maximum(self.person.pulp.creep * self.followed, 1e-9)
        return np.asarray(state[TOUCH] - lost * np.clip(2.0 - state[TOUCH] / lost, 0.0, 1.0))

    def _find_zero(self, since_s: float) -> None:
        """Learn from rest where zero is, as scales do, by as much as this is likely to be rest."""
        touch, known = self.state[TOUCH], self.covariance[TOUCH, TOUCH]
        far = touch @ np.linalg.solve(known, touch)
        density = np.exp(-0.5 * far) / (2 * np.pi * np.sqrt(np.linalg.det(known)))
        odds = TOUCHES_REACH**2 * density
        information = odds / (1.0 + odds) * since_s / ZERO**2
        across = self.covariance[:, TOUCH] * information
        weight = across @ np.linalg.inv(np.eye(2) + known * information)
        self.state = self.state - weight @ touch
        self.covariance = self.covariance - weight @ self.covariance[TOUCH]


def _fit_of(off: Array, spread: Array) -> tuple[Array, Array]:
    """Squared distances (M,) of a sample off by (r,) in covariances (M, r, r), and its log-likelihoods."""
    root = np.linalg.cholesky(spread)
    far = (np.linalg.solve(root, np.broadcast_to(off[:, None], (len(root), len(off), 1))) ** 2).sum((1, 2))
    return far, -0.5 * far - np.log(np.einsum("mii->mi", root)).sum(1)


def _weighed(ways: Array, likely: Array) -> Array:
    """Probabilities (M,) after a sample of some likelihoods, given as logarithms."""
    after = ways * np.exp(likely - likely.max())
    return np.asarray(after / after.sum())


@lru_cache
def _limit(readings: int, part: float) -> float:
    """Squared distance that this part of samples of so many readings keep to."""
    return float(stats.chi2.ppf(part, max(readings, 1)))
