"""Weighted least squares of a person on recordings of a known force, with sandwich covariance.

Gains, offsets, slopes by blood and drifts enter linearly and are solved; factors of the vessels are searched.
References: Golub, Pereyra 2003, Inverse Probl. 19:R1 (variable projection); White 1982, Econometrica 50:1 (sandwich).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from ...scene.importers.sensor_recordings import Recording
from ...statistics import MEDIAN_OF_GAUSSIAN
from .body_noise import arterial_response
from .person import NAMES, SPREAD_LN, Array, NominalFinger
from .reading_table import ReadingTable
from .subject import LINEAR

# Recordings are averaged to this rate, for the first search to the second, which leaves little of the heartbeat. [Hz]
RATE_HZ, SLOW_RATE_HZ = 20.0, 1.0
# Least number of samples after averaging.
LEAST_SAMPLES = 60
# Bounds of the search, in standard deviations of the priors. A distal pressure that falls off within the zone acts as
# one over up to three times the contact's area. The table of light ends at two standard deviations of blood at rest.
FARTHEST_SPREADS = np.where(np.array(NAMES) == "rest_blood", 2.0, 3.0)
# Starts of the search, other factors at 1: closure lies at half and at twice the force of the scene's guess.
STARTS: tuple[dict[str, float], ...] = ({}, {"contact_area": 0.5}, {"contact_area": 2.0})
# Step of the derivatives by the logarithm of a factor.
STEP_LN = 0.02
# Rounds of iterative reweighting, and evaluations of the residuals in each search.
ROUNDS, FIRST_EVALUATIONS, MOST_EVALUATIONS = 2, 6, 10
# First guess of the residuals' standard deviation, as a fraction of a reading's swing.
FIRST_MISFIT = 0.05
# Huber's threshold for 95 % efficiency, in standard deviations.
HUBER = 1.345
# All recordings of a calibration together have so many touches at the least.
LEAST_TOUCHES_OF_ALL = 8
# Blocks of time of the sandwich covariance's scores.
BLOCKS = 24
# The arterial pressure is estimated where its effect on readings, squared, is at least this fraction of its median.
LEAST_EFFECT = 0.01
# Prior standard deviation of d ln volts / d blood, over the traced slope: absorption of the nail plate alone,
# a factor 2 either way, moves the near photodiodes' signal by -30 to +20 %. And the least one, which moves no reading.
OPTICS_PART, LEAST_SLOPE = 0.3, 1e-3
# Prior standard deviations of gains, and of their change from one putting-on of the sensor to the next, over the usual
# gain of all readings; of an offset and a drift as fractions of the reading at rest.
GAIN_SPREAD, DONNING_SPREAD, OFFSET_PART = 0.7, 0.2, 0.1


@dataclass(frozen=True)
class Fitted:
    """Result of a fit, R readings, K recordings.

    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    covariance : (P + 4 R, P + 4 R) float. Of these, of gains, of offsets, and of steeper slopes by either zone's blood.
    gain, offset_v : (R,) float. Of every reading, the gain as a mean over recordings. donning : standard deviation of
        the next gain from it, over readings, as the sensor is put on anew for each recording. [1]
    table : readings over blood, with the fitted slopes.
    predicted_v, residual_v : per recording (R, T) float, at its own samples. [V]
    chi2_per_dof : of the whitened residuals.
    """

    factors_ln: Array
    covariance: Array
    table: ReadingTable
    gain: Array
    offset_v: Array
    donning: float
    predicted_v: list[Array]
    residual_v: list[Array]
    chi2_per_dof: float


class Fit:
    """Fit of the factors of a finger to recordings.

    finger : whose constants the factors multiply. free : (P,) bool. Which factors are searched; the others stay 1.
    rate_hz : that recordings are averaged to. [Hz]
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        table: ReadingTable,
        finger: NominalFinger,
        *,
        free: NDArray[np.bool_],
        rate_hz: float = RATE_HZ,
    ) -> None:
        self.recordings, self.table, self.finger = list(recordings), table, finger
        self.free = np.flatnonzero(free)
        self.most_ln = (FARTHEST_SPREADS * SPREAD_LN)[self.free]
        self.averaged = [averaged(recording, rate_hz) for recording in self.recordings]
        self.volts = np.concatenate([recording.volts for recording in self.averaged], axis=1)
        self.valid = np.isfinite(self.volts)
        swing = np.nanmax(self.volts, axis=1) - np.nanmin(self.volts, axis=1)
        # Residual variance of each reading, weights of samples, and their integrated autocorrelation time in samples.
        self.variance = (FIRST_MISFIT * swing) ** 2 + table.noise_v**2
        self.weight, self.memory = np.ones(self.volts.shape[1]), 1.0
        # Prior standard deviations of gain, offset, slopes and drifts, and of the gain's change in each of several.
        volts, slopes = table.slopes(np.full(2, finger.rest_blood_fraction))
        slope = np.maximum(np.hypot(table.slope_stderr, OPTICS_PART * slopes / volts[:, None]), LEAST_SLOPE)
        median_v, count = np.nanmedian(self.volts, axis=1), len(self.averaged)
        usual, part_v = float(np.exp(np.log(np.abs(median_v) / volts).mean())), OFFSET_PART * median_v
        spreads = [np.full(len(part_v), GAIN_SPREAD * usual), part_v, usual * slope, *[part_v] * count]
        # The sensor may be put on anew for each recording, whose gain is identifiable if it has touches of both sides.
        self.changed = count if count > 1 and all({0, 1} <= {*np.asarray(one.site)} for one in recordings) else 0
        changes = [np.full(len(part_v), DONNING_SPREAD * usual)] * self.changed
        self.prior_spread = np.column_stack([*spreads, *changes])
        # The usual gain; all else 0.
        self.prior = usual * np.eye(self.prior_spread.shape[1])[0]
        # A search ends, is weighted anew and goes on at the same factors, of which the columns know no weights.
        self._columns = lru_cache(2)(self._moved_columns)

    def solve(self, report: Callable[[float], None] = lambda done: None) -> Fitted:
        """Search the factors, from the best of several starts; report : takes the part that is done, often."""
        starts = [np.log([start.get(NAMES[k], 1.0) for k in self.free]) for start in STARTS]
        searches, results = len(starts) + ROUNDS, []
        # Which start is best slow touches tell.
        free = np.isin(np.arange(len(NAMES)), self.free)
        slow = Fit(self.recordings, self.table, self.finger, free=free, rate_hz=SLOW_RATE_HZ)
        for number, start in enumerate(starts):
            results.append(slow._search(start, FIRST_EVALUATIONS, partial(report, number / searches)))
        free_ln = min(results, key=lambda result: result[1])[0]
        for number in range(len(starts), searches):
            self._reweight(free_ln)
            free_ln, _ = self._search(free_ln, MOST_EVALUATIONS, partial(report, number / searches))
        self._reweight(free_ln)
        return self._finish(free_ln)

    def residuals(self, free_ln: Array) -> tuple[Array, Array]:
        """Whitened residuals and deviations from priors (M,), and their Jacobian (M, P).

        free_ln : (P,) float. Logarithms of the free factors.
        """
        solved, residual = self._linear_fit(self._columns(tuple(free_ln)))
        off_prior = (solved - self.prior) / self.prior_spread[:, None]
        linear = np.moveaxis(off_prior, 1, -1).reshape(-1, solved.shape[1])
        white, spread = np.concatenate([self._whiten(residual), linear]), SPREAD_LN[self.free]
        by_factor = (white[:, 1:] - white[:, :1]) / STEP_LN
        return np.concatenate([white[:, 0], free_ln / spread]), np.concatenate([by_factor, np.diag(1 / spread)])

    def model(self, factors_ln: Array, recordings: Sequence[Recording]) -> list[Array]:
        """Per recording (3, R, *S, T): volts before gain and offset, and their derivatives by either zone's slope."""
        who, out = self.finger.person(factors_ln), []
        for recording in recordings:
            assert recording.force_n is not None and recording.site is not None
            pressure_n_per_cm2 = who.pressures_n_per_cm2(recording.force_n, recording.site)
            rest = np.asarray(who.rest_blood)[..., None]
            blood = rest * who.diameters_over(recording.time_s, pressure_n_per_cm2)[:2] ** 2
            volts = self.table.volts(blood)
            out.append(np.stack([volts, *((volts.T - self.table.dark_v).T * (zone - rest) for zone in blood)]))
        return out

    def _search(self, start_ln: Array, evaluations: int, report: Callable[[], object]) -> tuple[Array, float]:
        """Logarithms of the free factors (P,) at the least squares from a start, and half their sum; reports often."""

        # One pass gives residuals and Jacobian, which scipy requests one after the other.
        @lru_cache(1)
        def both(free_ln: tuple[float, ...]) -> tuple[Array, Array]:
            report()
            return self.residuals(np.array(free_ln))

        value, jacobian = (lambda free_ln, k=k: both(tuple(free_ln))[k] for k in (0, 1))
        how = {"bounds": (-self.most_ln, self.most_ln), "max_nfev": evaluations, "xtol": 1e-3, "ftol": 1e-4}
        result = least_squares(value, start_ln, jac=jacobian, **how)
        return np.asarray(result.x), float(result.cost)

    def _moved_columns(self, free_ln: tuple[float, ...]) -> Array:
        """`model`, (3, R, 1 + P, T), at the factors (P,) and with each free one a step larger."""
        moved = np.zeros((len(NAMES), 1 + len(free_ln)))
        moved[self.free] = np.array(free_ln)[:, None] + STEP_LN * np.eye(len(free_ln), 1 + len(free_ln), 1)
        return np.concatenate(self.model(moved, self.averaged), axis=-1)

    def _design(self, model: Array) -> Array:
        """Columns of the linear part, (R, S, T, 4 + K): volts, one, both slopes, time in each recording. And volts in
        each where gains differ, (R, S, T, 4 + 2 K)."""
        ramps = [_ramp(recording)[:, None] for recording in self.averaged]
        within = block_diag(*map(np.ones_like, ramps))[:, : self.changed]
        fixed = np.column_stack([np.ones(len(within)), block_diag(*ramps)])
        fixed = np.broadcast_to(fixed, (*model.shape[1:], fixed.shape[1]))
        volts, *slopes = model[..., None]
        return np.concatenate([volts, fixed[..., :1], *slopes, fixed[..., 1:], volts * within], axis=-1)

    def _linear_fit(self, model: Array) -> tuple[Array, Array]:
        """Least squares of `_design`, (R, S, P), and residuals (R, S, T), 0 in gaps."""
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
        """Residuals (R, S, T) over their standard deviations, (R * T, S). Correlations between readings are left out:
        model error is common to all readings, and weights by their covariance would take the touch for noise."""
        white = residual / np.sqrt(self.variance)[:, None, None] * np.sqrt(self.weight / self.memory)
        return np.asarray(np.moveaxis(white, 1, -1).reshape(-1, residual.shape[1]))

    def _reweight(self, free_ln: Array) -> None:
        """Update variance, weights and autocorrelation time from the residuals at some factors."""
        residual = self._linear_fit(self._columns(tuple(free_ln)))[1][:, 0]
        samples = residual.shape[1]
        self.variance = (self.weight * residual**2).sum(1) / self.valid.sum(1) + self.table.noise_v**2
        white = residual / np.sqrt(self.variance)[:, None]
        rms = np.sqrt((white**2).sum(0) / np.maximum(self.valid.sum(0), 1))
        self.weight = np.minimum(1.0, HUBER / np.maximum(rms, 1e-12))
        # Integrated autocorrelation time, up to the first zero crossing.
        lagged = np.fft.irfft(np.abs(np.fft.rfft(white, 2 * samples)) ** 2).mean(0)[:samples]
        end = int(np.argmax(lagged < 0)) or samples
        self.memory = float(max(1.0, 1.0 + 2.0 * lagged[1:end].sum() / lagged[0]))

    def _finish(self, free_ln: Array) -> Fitted:
        """The fit at the best factors, with its covariance, at the recordings' own samples."""
        factors = np.zeros(len(NAMES))
        factors[self.free] = free_ln
        model = self._columns(tuple(free_ln))
        all_solved, residual = self._linear_fit(model)
        solved, white, who = all_solved[:, 0], self._whiten(residual)[:, 0], self.finger.person(factors)
        table = self.table.steeper(solved[:, 2:4] / solved[:, :1], float(who.rest_blood))
        response = [arterial_response(who, table, solved[:, 0], recording) for recording in self.averaged]
        count = len(self.recordings)
        drifts, changes = solved[:, LINEAR : LINEAR + count].T, np.zeros((count, len(solved)))
        changes[:] = solved[:, LINEAR + count :].T if self.changed else 0.0
        scales = solved[:, [0, 2, 3]] + changes[..., None] * np.eye(3)[0]
        own = zip(self.recordings, self.model(factors, self.recordings), drifts, scales, strict=True)
        predicted = [
            solved[:, 1:2] + drift[:, None] * _ramp(recording) + np.einsum("rc,crt->rt", scale, parts)
            for recording, parts, drift, scale in own
        ]
        # Of the next gain from the mean, which has the error of a mean.
        spread2 = ((changes / solved[:, 0]) ** 2).sum(0).mean() / max(count - 1, 1) * (1.0 + 1.0 / count)
        dof = max(int(self.valid.sum()) - len(self.free) - solved.size, 1)
        return Fitted(
            factors_ln=factors,
            covariance=self._joint_covariance(model, solved, white, np.concatenate(response, axis=1)),
            table=table,
            gain=solved[:, 0],
            offset_v=solved[:, 1],
            donning=float(np.sqrt(spread2)),
            predicted_v=predicted,
            residual_v=[recording.volts - curve for recording, curve in zip(self.recordings, predicted, strict=True)],
            chi2_per_dof=float(self.memory * (white**2).sum() / dof),
        )

    def _joint_covariance(self, model: Array, solved: Array, white: Array, response: Array) -> Array:
        """Sandwich covariance of all factors' logarithms, gains, offsets and slopes, (P + 4 R, P + 4 R).

        model : (3, R, 1 + P, T) float, of `_columns`. solved : (R, C) float. white : (R * T,) float.
        response : (R, T) float, of readings to the arterial pressure. [V/Pa]
        """
        readings, count, free = *solved.shape, len(self.free)
        by_factor = solved[:, :1, None] * (model[0, :, 1:] - model[0, :, :1]) / STEP_LN
        design = np.moveaxis(self._design(model[:, :, :1])[:, 0], -1, 1)
        by_linear = np.einsum("rs,rpt->rspt", np.eye(readings), design).reshape(readings, -1, design.shape[-1])
        jacobian = self._whiten(np.where(self.valid[:, None], np.concatenate([by_factor, by_linear], axis=1), 0.0))
        spread = np.concatenate([SPREAD_LN[self.free], self.prior_spread.ravel()])
        # Inverted in units of the priors, as the parameters differ by orders of magnitude.
        scale = np.outer(spread, spread)
        bread = scale * np.linalg.inv(scale * (jacobian.T @ jacobian) + np.eye(len(spread)))
        # Waves of the arterial pressure move all readings at once, most near closure, where stiffness and area are
        # identified; residuals are correlated over time: scores of the wave and of blocks of time.
        by_sample = jacobian.reshape(readings, -1, len(spread))
        white = white.reshape(readings, -1)
        wave = np.einsum("rtp,rt->tp", by_sample, self._wave(white, response))
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
        """Effect of one standard deviation of the arterial pressure on each whitened sample, (R, T).

        white : (R, T) float. Whitened residuals, from which that is estimated. response : (R, T) float. [V/Pa]
        """
        per_pa: Array = response / np.sqrt(self.variance)[:, None] * np.sqrt(self.weight)
        effect = (per_pa**2).sum(0)
        visible = effect > LEAST_EFFECT * np.median(effect)
        if not visible.any():
            return per_pa
        pressure_pa = (per_pa * white).sum(0)[visible] / effect[visible] * np.sqrt(self.memory)
        return per_pa * float(np.median(np.abs(pressure_pa)) / MEDIAN_OF_GAUSSIAN)


def _ramp(recording: Recording) -> Array:
    """Time over a recording, of mean 0 and from end to end 1, (T,) float."""
    return np.asarray((recording.time_s - recording.time_s.mean()) / np.ptp(recording.time_s))


def averaged(recording: Recording, rate_hz: float) -> Recording:
    """The recording with groups of samples averaged to a rate, where it is faster."""
    time_s, force_n = recording.time_s, np.asarray(recording.force_n)
    samples = 1.0 / (rate_hz * float(np.median(np.diff(time_s))))
    group = max(1, min(len(time_s) // LEAST_SAMPLES, round(samples)))
    count = len(time_s) // group
    if group == 1:
        return recording

    def mean(values: Array) -> Array:
        blocks = values[..., : count * group].reshape(*values.shape[:-1], count, group)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.nansum(blocks, -1) / np.isfinite(blocks).sum(-1))

    site = None if recording.site is None else recording.site[: count * group : group]
    return replace(recording, time_s=mean(time_s), volts=mean(recording.volts), force_n=mean(force_n), site=site)


def joined(recordings: Sequence[Recording]) -> Recording:
    """All samples of recordings with force and site, one after the other; times begin anew with each."""
    names = ("time_s", "volts", "force_n", "site")
    parts = ([np.asarray(getattr(recording, name)) for recording in recordings] for name in names)
    time_s, volts, force_n, site = (np.concatenate(part, axis=-1) for part in parts)
    return Recording("all", recordings[0].names, time_s, volts, force_n, site)
