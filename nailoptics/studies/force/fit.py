"""The fit of a person to recordings of a known force: gains and offsets solved, factors of the vessels searched."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...scene.importers.sensor_recordings import Recording
from .body_noise import arterial_response
from .person import LONGEST_STEP_S, NAMES, SPREAD_LN, Array, NominalFinger
from .reading_table import ReadingTable
from .subject import LINEAR

# The fit needs no more samples than the touch has detail: recordings are averaged to these rates, the first where the
# force changes by more than FAST_N_PER_S. The mean over a second leaves little of the heart's beat. [Hz]
FAST_RATE_HZ, SLOW_RATE_HZ, FAST_N_PER_S = 50.0, 1.0, 1.0
# However short a recording is, so many samples of it are left.
LEAST_SAMPLES = 60
# Samples further apart than a step of the network are walked in so many.
STEPS_BETWEEN = 4
# Nobody lies further from the scene's guess than this, in spreads of the priors. A distal pressure that falls off
# within the zone acts as one over a larger area, up to three times the contact's. The table of light ends at two
# spreads of the blood at rest.
FARTHEST_SPREADS = np.where(np.array(NAMES) == "rest_blood", 2.0, 3.0)
# Where the search begins, but for ones: closure lies at half and at twice the force of the scene's guess.
STARTS: tuple[dict[str, float], ...] = ({}, {"contact_area": 0.5}, {"contact_area": 2.0})
# Step of the derivatives by the logarithm of a factor.
STEP_LN = 0.02
# Rounds in which the residuals' covariance, their memory and the samples' weights are taken from the round before.
ROUNDS, FIRST_EVALUATIONS, MOST_EVALUATIONS = 2, 6, 10
# At first residuals are held to this part of a reading's swing.
FIRST_MISFIT = 0.05
# Samples this many standard deviations off begin to count less (Huber's weight for 95 % efficiency).
HUBER = 1.345
# Standard errors are made of what was left over in so many blocks of time.
BLOCKS = 24
# The body's pressure is estimated where it moves readings by this part of its largest effect, squared. Of a Gaussian
# the median of |x| is that part of its standard deviation.
LEAST_EFFECT, MEDIAN_OF_GAUSSIAN = 0.01, 0.6745
# The optics of nail and skin leave open how strongly a reading falls with the blood of a zone, by this part of what is
# traced; the trace's own error comes to it. (Absorption of the nail plate alone, a factor 2 either way, moves the
# near photodiodes' signal by -30 to +20 %.)
OPTICS_PART = 0.3
# Least spread of such a slope, which moves no reading: of ln volts by blood fraction.
LEAST_SLOPE = 1e-3
# Factors are moved by so many of the standard errors that the curvature at the best fit gives them, for profiles of the
# likelihood; in so many Gauss-Newton steps all other factors follow.
OFFSETS = np.array([-3.0, -2.25, -1.5, -0.75, 0.0, 0.75, 1.5, 2.25, 3.0])
PROFILE_ROUNDS = 2
# So many of a reading's values are held in memory at once, of all samples and people side by side. [about 0.1 GB]
MOST_VALUES = 800_000
# A profile is bent if, where a parabola leaves 95 %, the root of its deviance is off the parabola's by this part.
JUDGED_TO, BENT = 2.25, 0.25
# Before any recording a gain is known to a factor of two, an offset to this part of the reading at rest.
GAIN_SPREAD, OFFSET_PART = 0.7, 0.1


@dataclass(frozen=True)
class Fitted:
    """Result of a fit, R readings, K recordings.

    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    covariance : (P + 4 R, P + 4 R) float. Of these, of gains, of offsets, and of steeper slopes by either zone's blood.
    gain, offset_v : (R,) float. Of every reading.
    table : that of the light, with the slopes by blood that the recordings show.
    residual_v : per recording (R, T) float at the recording's own samples; predicted_v likewise.
    chi2_per_dof : of the whitened residuals of the last round.
    """

    factors_ln: Array
    covariance: Array
    table: ReadingTable
    gain: Array
    offset_v: Array
    predicted_v: list[Array]
    residual_v: list[Array]
    chi2_per_dof: float


class Fit:
    """Recordings of a known force beside what a person's sensor would read.

    finger : the scene's, whose constants the factors multiply.
    free : (P,) bool. Which factors are searched; the others stay 1.
    """

    def __init__(
        self, recordings: Sequence[Recording], table: ReadingTable, finger: NominalFinger, *, free: NDArray[np.bool_]
    ) -> None:
        self.recordings, self.table, self.finger = list(recordings), table, finger
        self.free = np.flatnonzero(free)
        self.most_ln = (FARTHEST_SPREADS * SPREAD_LN)[self.free]
        self.averaged = [_averaged(one) for one in self.recordings]
        self.volts = np.concatenate([one.volts for one in self.averaged], axis=1)
        self.valid = np.isfinite(self.volts)
        swing = np.nanmax(self.volts, axis=1) - np.nanmin(self.volts, axis=1)
        # Of each reading's residuals; weights of samples; correlated samples that count as one.
        self.variance = (FIRST_MISFIT * swing) ** 2 + table.noise_v**2
        self.weight, self.memory = np.ones(self.volts.shape[1]), 1.0
        self.prior, self.prior_spread = self._linear_prior()

    def solve(self, report: Callable[[float], None] = lambda done: None) -> Fitted:
        """Search the factors, from the best of several starts; report : takes the part that is done."""
        searched, searches = [], len(STARTS) + ROUNDS
        for number, start in enumerate(STARTS):
            report(number / searches)
            start_ln = np.log([start.get(NAMES[k], 1.0) for k in self.free])
            searched.append(self._search(start_ln, FIRST_EVALUATIONS))
        free_ln = min(searched, key=lambda one: one[1])[0]
        for number in range(ROUNDS):
            report((len(STARTS) + number) / searches)
            self._reweight(free_ln)
            free_ln, _ = self._search(free_ln, MOST_EVALUATIONS)
        self._reweight(free_ln)
        return self._finish(free_ln)

    def residuals(self, free_ln: Array) -> tuple[Array, Array]:
        """Whitened residuals with the priors' below (M, N), and their derivatives (M, N, P), of N people side by side.

        free_ln : (P, N) float. Logarithms of the free factors.
        """
        count, people = free_ln.shape
        columns = self._columns(free_ln)
        solved, residual = self._linear_fit(columns)
        off_prior = (solved - self.prior[:, None]) / self.prior_spread[:, None]
        linear = np.moveaxis(off_prior, 1, -1).reshape(-1, columns.shape[2])
        white = np.concatenate([self._whiten(residual), linear]).reshape(-1, people, 1 + count)
        spread = SPREAD_LN[self.free]
        priors = np.repeat(np.diag(1 / spread)[:, None], people, axis=1)
        value = np.concatenate([white[..., 0], free_ln / spread[:, None]])
        return value, np.concatenate([(white[..., 1:] - white[..., :1]) / STEP_LN, priors])

    def model(self, factors_ln: Array, recordings: Sequence[Recording]) -> list[Array]:
        """Volts before gain and offset, and what a steeper slope by either zone's blood adds, (3, R, *S, T) each."""
        who, out = self.finger.person(factors_ln), []
        for one in recordings:
            assert one.force_n is not None and one.site is not None
            pressure = who.pressures(one.force_n, one.site)
            longest_s = max(LONGEST_STEP_S, float(np.median(np.diff(one.time_s))) / STEPS_BETWEEN)
            rest = np.asarray(who.rest_blood)[..., None]
            blood = rest * who.widths_over(one.time_s, pressure, longest_step_s=longest_s)[:2] ** 2
            volts = self.table.volts(blood)
            out.append(np.stack([volts, *(volts * (zone - rest) for zone in blood)]))
        return out

    def _search(self, start_ln: Array, evaluations: int) -> tuple[Array, float]:
        """The free factors' logarithms that fit best from a start, and half their sum of squares."""
        # Residuals and derivatives come together, and are requested one after the other.
        both = lru_cache(1)(lambda free_ln: [part[:, 0] for part in self.residuals(np.array(free_ln)[:, None])])
        result = least_squares(
            lambda free_ln: both(tuple(free_ln))[0],
            start_ln,
            jac=lambda free_ln: both(tuple(free_ln))[1],
            bounds=(-self.most_ln, self.most_ln),
            max_nfev=evaluations,
            xtol=1e-3,
            ftol=1e-4,
        )
        return np.asarray(result.x), float(result.cost)

    def _columns(self, free_ln: Array) -> Array:
        """What `model` gives, (3, R, N (1 + P), T), at the factors (P, N) and with each free one a step larger."""
        count, people = free_ln.shape
        moved = np.zeros((len(NAMES), people, 1 + count))
        moved[self.free] = free_ln[..., None]
        moved[self.free, :, np.arange(1, 1 + count)] += STEP_LN
        return np.concatenate(self.model(moved.reshape(len(NAMES), -1), self.averaged), axis=-1)

    def _design(self, model: Array) -> Array:
        """Columns of the linear part, (R, S, T, 4 + K): volts, one, both slopes, time in each recording."""
        _, readings, columns, samples = model.shape
        basis, end = [np.ones(samples)], 0
        for one in self.averaged:
            start, end = end, end + len(one.time_s)
            basis.append(np.zeros(samples))
            basis[-1][start:end] = _ramp(one)
        fixed = np.broadcast_to(np.stack(basis, -1), (readings, columns, samples, len(basis)))
        volts, *slopes = model[..., None]
        return np.concatenate([volts, fixed[..., :1], *slopes, fixed[..., 1:]], axis=-1)

    def _linear_prior(self) -> tuple[Array, Array]:
        """Gain, offset, slopes and drifts before any recording and their standard deviations, (R, 4 + K)."""
        rest_v, gain = OFFSET_PART * np.nanmedian(self.volts, axis=1), np.full(len(self.volts), GAIN_SPREAD)
        volts, slopes = self.table.slopes(np.full(2, self.finger.rest_blood_fraction))
        steeper = np.hypot(self.table.slope_stderr, OPTICS_PART * slopes / volts[:, None])
        # The paper's optics know but one zone: what a reading does not depend on stays so.
        steeper = np.maximum(steeper, LEAST_SLOPE)
        spread = np.column_stack([gain, rest_v, steeper, *([rest_v] * len(self.averaged))])
        return np.eye(spread.shape[1])[np.zeros(len(spread), int)], spread

    def _linear_fit(self, model: Array) -> tuple[Array, Array]:
        """Gains, offsets, slopes and drifts solved, (R, S, 4 + K), and residuals (R, S, T), 0 in gaps."""
        design, spread = self._design(model), self.prior_spread
        weight = self.valid * self.weight / self.variance[:, None] / self.memory
        volts = np.where(self.valid, self.volts, 0.0)
        normal = np.einsum("rstp,rt,rstq->rspq", design, weight, design, optimize=True)
        normal += (np.eye(design.shape[-1]) / spread[:, None, :] ** 2)[:, None]
        right = np.einsum("rstp,rt,rt->rsp", design, weight, volts, optimize=True) + (self.prior / spread**2)[:, None]
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        fitted = np.einsum("rstp,rsp->rst", design, solved)
        return solved, np.where(self.valid[:, None], self.volts[:, None] - fitted, 0.0)

    def _whiten(self, residual: Array) -> Array:
        """Residuals (R, S, T) over their standard deviations, (R * T, S).

        Each reading is whitened by itself: a person who differs from the model by more than by factors leaves alike
        residuals in all of them, and weights by their covariance would take for noise what the touch does.
        """
        white = residual / np.sqrt(self.variance)[:, None, None] * np.sqrt(self.weight / self.memory)
        return np.asarray(np.moveaxis(white, 1, -1).reshape(-1, residual.shape[1]))

    def _reweight(self, free_ln: Array) -> None:
        """Take the residuals' variance, memory and weights from the residuals of some factors."""
        residual = self._linear_fit(self._columns(free_ln[:, None]))[1][:, 0]
        samples = residual.shape[1]
        self.variance = (self.weight * residual**2).sum(1) / samples + self.table.noise_v**2
        white = residual / np.sqrt(self.variance)[:, None]
        rms = np.sqrt((white**2).mean(0))
        self.weight = np.minimum(1.0, HUBER / np.maximum(rms, 1e-12))
        # Correlated samples count as one: the integrated autocorrelation, up to where it first vanishes.
        power = np.abs(np.fft.rfft(white, 2 * samples)) ** 2
        lagged = np.fft.irfft(power).mean(0)[:samples]
        lagged = lagged / lagged[0]
        end = int(np.argmax(lagged < 0)) or samples
        self.memory = float(max(1.0, 1.0 + 2.0 * lagged[1:end].sum()))

    def _finish(self, free_ln: Array) -> Fitted:
        """The fit at the best factors, with its covariance, at the recordings' own samples."""
        factors = np.zeros(len(NAMES))
        factors[self.free] = free_ln
        model = self._columns(free_ln[:, None])
        all_solved, residual = self._linear_fit(model)
        solved, white, who = all_solved[:, 0], self._whiten(residual)[:, 0], self.finger.person(factors)
        table = self.table.steeper(solved[:, 2:4] / solved[:, :1], float(who.rest_blood))
        response = [arterial_response(who, table, solved[:, 0], one) for one in self.averaged]
        covariance = self._joint_covariance(model, solved, white, np.concatenate(response, axis=1))
        predicted = []
        for k, (one, parts) in enumerate(zip(self.recordings, self.model(factors, self.recordings), strict=True)):
            linear = solved[:, 1:2] + solved[:, 4 + k : 5 + k] * _ramp(one)
            predicted.append(linear + np.einsum("rc,crt->rt", solved[:, [0, 2, 3]], parts))
        dof = max(int(self.valid.sum()) - len(self.free) - solved.size, 1)
        return Fitted(
            factors_ln=factors,
            covariance=covariance,
            table=table,
            gain=solved[:, 0],
            offset_v=solved[:, 1],
            predicted_v=predicted,
            residual_v=[one.volts - curve for one, curve in zip(self.recordings, predicted, strict=True)],
            chi2_per_dof=float(self.memory * (white**2).sum() / dof),
        )

    def _joint_covariance(self, model: Array, solved: Array, white: Array, response: Array) -> Array:
        """Covariance of all factors, gains, offsets and slopes together: the sandwich of Huber and White.

        What vessels do less, steeper slopes make up for: neither is known by itself as well as their product.

        model : (3, R, 1 + P, T) float. The model's columns. solved : (R, 4 + K) float. white : (R * T,) float.
        response : (R, T) float. Change of readings with the arterial pressure. [V/Pa]
        """
        readings, count, free = *solved.shape, len(self.free)
        by_factor = solved[:, :1, None] * (model[0, :, 1:] - model[0, :, :1]) / STEP_LN
        design = np.moveaxis(self._design(model[:, :, :1])[:, 0], -1, 1)
        by_linear = np.einsum("rs,rpt->rspt", np.eye(readings), design).reshape(readings, -1, design.shape[-1])
        jacobian = self._whiten(np.where(self.valid[:, None], np.concatenate([by_factor, by_linear], axis=1), 0.0))
        spread = np.concatenate([SPREAD_LN[self.free], self.prior_spread.ravel()])
        # In units of the priors: their numbers differ by many orders, and the inverse's rounding with them.
        scale = np.outer(spread, spread)
        bread = scale * np.linalg.inv(scale * (jacobian.T @ jacobian) + np.eye(len(spread)))
        # The body's waves move all readings at once, and most where the vessels are about to shut, which is where
        # stiffness and area are identified: what a wave does is a part of the filling.
        by_sample = jacobian.reshape(readings, -1, len(spread))
        white = white.reshape(readings, -1)
        wave = np.einsum("rtp,rt->tp", by_sample, self._wave(white, response))
        # Residuals are correlated over time, too, and more where the model misses: blocks of time, as they came out.
        score = np.einsum("rtp,rt->tp", by_sample, white)
        blocks = np.add.reduceat(score, np.arange(0, len(score), max(1, len(score) // BLOCKS)), axis=0)
        sandwich = bread @ (wave.T @ wave + blocks.T @ blocks + np.diag(1 / spread**2)) @ bread
        linear = free + np.arange(LINEAR)[:, None] + count * np.arange(readings)
        of_all = np.r_[:free, linear.ravel()]
        out = np.diag(np.concatenate([SPREAD_LN**2, np.zeros(LINEAR * readings)]))
        place = np.r_[self.free, len(NAMES) : len(out)]
        out[np.ix_(place, place)] = sandwich[np.ix_(of_all, of_all)]
        return np.asarray(0.5 * (out + out.T))

    def _wave(self, white: Array, response: Array) -> Array:
        """What a standard deviation of the arterial pressure does to each whitened sample, (R, T); memory is left out.

        white : (R, T) float. Whitened residuals, from which that is estimated. response : (R, T) float. [V/Pa]
        """
        per_pa: Array = response / np.sqrt(self.variance)[:, None] * np.sqrt(self.weight)
        effect = (per_pa**2).sum(0)
        visible = effect > LEAST_EFFECT * effect.max()
        if not visible.any():
            return per_pa
        pressure_pa = (per_pa * white).sum(0)[visible] / effect[visible] * np.sqrt(self.memory)
        return per_pa * float(np.median(np.abs(pressure_pa)) / MEDIAN_OF_GAUSSIAN)


def _ramp(recording: Recording) -> Array:
    """Time over a recording, of mean 0 and from end to end 1, (T,) float."""
    return np.asarray((recording.time_s - recording.time_s.mean()) / np.ptp(recording.time_s))


def _averaged(recording: Recording) -> Recording:
    """The recording with groups of samples averaged to the rate of the fit, where it is faster."""
    assert recording.force_n is not None
    rise = np.nanmax(np.abs(np.diff(recording.force_n) / np.diff(recording.time_s)), initial=0.0)
    rate = FAST_RATE_HZ if rise > FAST_N_PER_S else SLOW_RATE_HZ
    longest = len(recording.time_s) // LEAST_SAMPLES
    group = max(1, min(longest, round(1.0 / (rate * float(np.median(np.diff(recording.time_s)))))))
    count = len(recording.time_s) // group
    if group == 1:
        return recording

    def mean(values: Array) -> Array:
        blocks = values[..., : count * group].reshape(*values.shape[:-1], count, group)
        valid = np.isfinite(blocks)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(valid, blocks, 0.0).sum(-1) / valid.sum(-1))

    site = None if recording.site is None else recording.site[: count * group : group]
    time_s, volts, force_n = (mean(one) for one in (recording.time_s, recording.volts, recording.force_n))
    return replace(recording, time_s=time_s, volts=volts, force_n=force_n, site=site)


@dataclass(frozen=True)
class Profile:
    """Profile likelihoods of P free factors at N places each.

    names : (P,) str. Of the factors.
    factors_ln : (P, N) float. Logarithms to which each factor was moved, rising.
    deviance : (P, N) float. Squares of the whitened residuals and priors beyond those of the best fit; NaN where the
        factor is at the limit of its search.
    offset : (P, N) float. How far it was moved, in standard errors; a parabola's deviance is the square of it.
    """

    names: tuple[str, ...]
    factors_ln: Array
    deviance: Array
    offset: Array

    @property
    def bent(self) -> tuple[str, ...]:
        """Factors whose errors are not those of a parabola."""
        judged = (np.abs(self.offset) > 0.1) & (np.abs(self.offset) <= JUDGED_TO)
        root = np.sqrt(np.maximum(self.deviance, 0.0)) / np.where(judged, np.abs(self.offset), 1.0)
        # NaN compares false.
        return tuple(np.array(self.names)[(judged & (np.abs(root - 1.0) > BENT)).any(1)].tolist())


def profile_of(fit: Fit, free_ln: Array, report: Callable[[float], None] = lambda done: None) -> Profile:
    """The profiles about the best fit of some free factors' logarithms (P,); report : takes the part that is done."""
    value, slopes = fit.residuals(free_ln[:, None])
    covariance = np.linalg.inv(slopes[:, 0].T @ slopes[:, 0])
    spread, most, count = np.sqrt(np.diag(covariance)), fit.most_ln[:, None], len(free_ln)
    # A parabola's valley is where the others begin; (P, factor moved, place).
    valley = free_ln[:, None, None] + (covariance / spread)[..., None] * OFFSETS
    start, moved = np.clip(valley, -most[..., None], most[..., None]), np.arange(count)
    places = start[moved, moved]
    together = max(1, MOST_VALUES // (fit.volts.size * OFFSETS.size * (1 + count)))
    least = []
    for first in range(0, count, together):
        report(first / count)
        some = moved[first : first + together]
        least.append(_least_along(fit, start[:, some], some, most))
    deviance = np.concatenate(least) - float((value**2).sum())
    deviance[places != valley[moved, moved]] = np.nan
    names = tuple(NAMES[factor] for factor in fit.free)
    return Profile(names, places, deviance, (places - free_ln[:, None]) / spread[:, None])


def _least_along(fit: Fit, start: Array, held: NDArray[np.intp], most: Array) -> Array:
    """The least sums of squares (H, N) with one factor of `held` (H,) at its starts (P, H, N), the others free."""
    (factors, holding, places), moved = start.shape, start.reshape(len(start), -1)
    free = (np.arange(factors)[:, None] != np.repeat(held, places)).astype(float)
    value, slopes = fit.residuals(moved)
    least = (value**2).sum(0)
    for _ in range(PROFILE_ROUNDS):
        # A held factor has no slope, and its equation says that it stays.
        down = np.moveaxis(slopes * free.T, 1, 0)
        normal = np.swapaxes(down, 1, 2) @ down + np.eye(factors) * (1.0 - free.T)[:, None]
        step = np.linalg.solve(normal, np.swapaxes(down, 1, 2) @ value.T[..., None])[..., 0]
        moved = np.clip(moved - step.T, -most, most)
        value, slopes = fit.residuals(moved)
        least = np.minimum(least, (value**2).sum(0))
    return np.asarray(least.reshape(holding, places))
