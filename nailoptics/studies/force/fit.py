"""The fit of a person to recordings of a known force: gains and offsets solved, factors of the vessels searched."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...hemodynamics.parameters import Parameters
from ...scene.importers.sensor_recordings import Recording
from .body_noise import arterial_response
from .person import LONGEST_STEP_S, NAMES, RIGID_PULP, SPREAD_LN, Person, Pulp, person, widths_over
from .reading_table import ReadingTable
from .state_space import LINEAR

Array = NDArray[np.float64]

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
# The body's pressure is looked for where it moves readings by this part of its largest effect, squared. Of a Gaussian
# the median of |x| is that part of its standard deviation.
LEAST_EFFECT, MEDIAN_OF_GAUSSIAN = 0.01, 0.6745
# The optics of nail and skin leave open how strongly a reading falls with the blood of a zone, by this part of what is
# traced; the trace's own error comes to it. (Absorption of the nail plate alone, a factor 2 either way, moves the
# near photodiodes' signal by -30 to +20 %.)
OPTICS_PART = 0.3
# Least spread of such a slope, which moves no reading: of ln volts by blood fraction.
LEAST_SLOPE = 1e-3
# Before any recording a gain is known to a factor of two, an offset to this part of the reading at rest.
GAIN_SPREAD, OFFSET_PART = 0.7, 0.1


@dataclass(frozen=True)
class Fitted:
    """Result of a fit, R readings, K recordings.

    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    covariance : (P + 4 R, P + 4 R) float. Of these, of gains, of offsets, and of steeper slopes by either zone's blood.
    gain, offset_v : (R,) float. Of every reading.
    table : that of the light, with the slopes by blood that the recordings ask for.
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

    base, rest_blood, area_cm2, share, distal_reach : the scene's person, whom the factors change.
    free : (P,) bool. Which factors are searched; the others stay 1.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        table: ReadingTable,
        base: Parameters,
        *,
        rest_blood: float,
        area_cm2: float,
        share: float,
        distal_reach: float = 0.0,
        pulp: Pulp = RIGID_PULP,
        free: NDArray[np.bool_],
    ) -> None:
        self.recordings, self.table, self.base = list(recordings), table, base
        self.usual = {"rest_blood": rest_blood, "area_cm2": area_cm2, "share": share, "distal_reach": distal_reach}
        self.pulp = pulp
        self.free = np.flatnonzero(free)
        self.slow = [_averaged(one) for one in self.recordings]
        self.volts = np.concatenate([one.volts for one in self.slow], axis=1)
        self.there = np.isfinite(self.volts)
        swing = np.nanmax(self.volts, axis=1) - np.nanmin(self.volts, axis=1)
        self.covariance = np.diag((FIRST_MISFIT * swing) ** 2 + table.noise_v**2)
        self.weight = np.ones(self.volts.shape[1])
        self.memory = 1.0

    def person(self, factors_ln: Array) -> Person:
        """The person of some factors (P, *S)."""
        return person(self.base, dict(zip(NAMES, np.exp(factors_ln), strict=True)), **self.usual, pulp=self.pulp)

    def model(self, factors_ln: Array, recordings: Sequence[Recording]) -> list[Array]:
        """Volts before gain and offset, and what a steeper slope by either zone's blood adds, (3, R, *S, T) each."""
        who = self.person(factors_ln)
        out = []
        for one in recordings:
            assert one.force_n is not None and one.site is not None
            pressure = who.pressures(one.force_n, one.site)
            sample_s = float(np.median(np.diff(one.time_s)))
            width = widths_over(who, one.time_s, pressure, longest_step_s=max(LONGEST_STEP_S, sample_s / STEPS_BETWEEN))
            rest = np.asarray(who.rest_blood)[..., None]
            blood = rest * width[:2] ** 2
            volts = self.table.volts(blood)
            out.append(np.stack([volts, *(volts * (zone - rest) for zone in blood)]))
        return out

    def solve(self, report: Callable[[float], None] = lambda done: None) -> Fitted:
        """Search the factors, from the best of several starts; report : takes the part that is done."""
        found, searches = [], len(STARTS) + ROUNDS
        for number, one in enumerate(STARTS):
            report(number / searches)
            found.append(self._search(self._start(one), FIRST_EVALUATIONS))
        free_ln = min(found, key=lambda one: one[1])[0]
        for number in range(ROUNDS):
            report((len(STARTS) + number) / searches)
            self._learn(self._linear_fit(self._columns(free_ln))[0][:, 0])
            free_ln, _ = self._search(free_ln, MOST_EVALUATIONS)
        self._learn(self._linear_fit(self._columns(free_ln))[0][:, 0])
        factors = np.zeros(len(NAMES))
        factors[self.free] = free_ln
        return self._finish(factors)

    def _start(self, named: dict[str, float]) -> Array:
        return np.log([named.get(NAMES[k], 1.0) for k in self.free])

    def _search(self, start_ln: Array, evaluations: int) -> tuple[Array, float]:
        """The free factors' logarithms that fit best from a start, and half their sum of squares."""
        most = (FARTHEST_SPREADS * SPREAD_LN)[self.free]
        found = least_squares(
            self._residual,
            start_ln,
            jac=self._jacobian,
            bounds=(-most, most),
            max_nfev=evaluations,
            xtol=1e-3,
            ftol=1e-4,
        )
        return np.asarray(found.x), float(found.cost)

    def _columns(self, free_ln: Array) -> Array:
        """What `model` gives, (3, R, 1 + P, T), at the factors and with each free one a step larger."""
        moved = np.zeros((len(NAMES), 1 + len(self.free)))
        moved[self.free] = free_ln[:, None]
        moved[self.free, np.arange(1, 1 + len(self.free))] += STEP_LN
        return np.concatenate(self.model(moved, self.slow), axis=-1)

    def _design(self, model: Array, recordings: Sequence[Recording]) -> Array:
        """Columns of the linear part, (R, S, T, 4 + K): volts, one, both slopes, time in each recording."""
        _, readings, columns, _ = model.shape
        basis = [np.ones(model.shape[-1])]
        ends = np.cumsum([0, *(len(one.time_s) for one in recordings)])
        for one, start, stop in zip(recordings, ends, ends[1:], strict=False):
            ramp = np.zeros(model.shape[-1])
            ramp[start:stop] = (one.time_s - one.time_s.mean()) / np.ptp(one.time_s)
            basis.append(ramp)
        fixed = np.broadcast_to(np.stack(basis, -1), (readings, columns, model.shape[-1], len(basis)))
        volts, *slopes = model[..., None]
        return np.concatenate([volts, fixed[..., :1], *slopes, fixed[..., 1:]], axis=-1)

    def _linear_fit(self, model: Array) -> tuple[Array, Array]:
        """Gains, offsets and drifts solved: residuals (R, S, T), 0 in gaps, and the priors', (R (4 + K), S)."""
        design = self._design(model, self.slow)
        count = design.shape[-1]
        weight = self.there * self.weight / np.diag(self.covariance)[:, None] / self.memory
        spread = self._spread(count)
        before = np.zeros(spread.shape)
        before[:, 0] = 1.0
        volts = np.where(self.there, self.volts, 0.0)
        normal = np.einsum("rstp,rt,rstq->rspq", design, weight, design, optimize=True)
        normal += (np.eye(count) / spread[:, None, :] ** 2)[:, None]
        right = np.einsum("rstp,rt,rt->rsp", design, weight, volts, optimize=True) + (before / spread**2)[:, None]
        found = np.linalg.solve(normal, right[..., None])[..., 0]
        self.gain_offset_drift = found[:, 0]
        fitted = np.einsum("rstp,rsp->rst", design, found)
        beside = (found - before[:, None]) / spread[:, None]
        residual = np.where(self.there[:, None], self.volts[:, None] - fitted, 0.0)
        return np.asarray(residual), np.moveaxis(beside, 1, -1).reshape(-1, found.shape[1])

    def _whiten(self, residual: Array) -> Array:
        """Residuals (R, S, T) over what is left of each reading, (R * T, S).

        Readings count each by itself: a person who differs from the model by more than by factors leaves alike
        residuals in all of them, and weights by their covariance would take for noise what the touch does.
        """
        white = residual / np.sqrt(np.diag(self.covariance))[:, None, None] * np.sqrt(self.weight / self.memory)
        return np.asarray(np.moveaxis(white, 1, -1).reshape(-1, residual.shape[1]))

    def residuals(self, free_ln: Array) -> tuple[Array, Array]:
        """Whitened residuals with the priors' below (M, N), and their derivatives (M, N, P), of N people side by side.

        free_ln : (P, N) float. Logarithms of the free factors.
        """
        count, people = free_ln.shape
        moved = np.zeros((len(NAMES), people, 1 + count))
        moved[self.free] = free_ln[..., None]
        for k, factor in enumerate(self.free):
            moved[factor, :, 1 + k] += STEP_LN
        columns = np.concatenate(self.model(moved.reshape(len(NAMES), -1), self.slow), axis=-1)
        residual, linear = self._linear_fit(columns)
        white = np.concatenate([self._whiten(residual), linear]).reshape(-1, people, 1 + count)
        spread = SPREAD_LN[self.free]
        priors = np.repeat(np.diag(1 / spread)[:, None], people, axis=1)
        own = np.concatenate([white[..., 0], free_ln / spread[:, None]])
        return own, np.concatenate([(white[..., 1:] - white[..., :1]) / STEP_LN, priors])

    def _evaluate(self, free_ln: Array) -> tuple[Array, Array]:
        """Residuals and derivatives of one person; kept, as both are asked for in turn."""
        key = free_ln.tobytes()
        if getattr(self, "_key", None) != (key, self.memory, self.covariance[0, 0]):
            own, slopes = self.residuals(free_ln[:, None])
            self._key, self._kept = (key, self.memory, self.covariance[0, 0]), (own[:, 0], slopes[:, 0])
        return self._kept

    def _residual(self, free_ln: Array) -> Array:
        return self._evaluate(free_ln)[0]

    def _jacobian(self, free_ln: Array) -> Array:
        return self._evaluate(free_ln)[1]

    def _learn(self, residual: Array) -> None:
        """Take the residuals' covariance, memory and weights from what was left over, (R, T)."""
        samples = residual.shape[1]
        weighted = residual * np.sqrt(self.weight)
        self.covariance = weighted @ weighted.T / samples + np.diag(self.table.noise_v**2)
        white = residual / np.sqrt(np.diag(self.covariance))[:, None]
        far = np.sqrt((white**2).mean(0))
        self.weight = np.minimum(1.0, HUBER / np.maximum(far, 1e-12))
        # Samples that hang together count as one: the integrated autocorrelation, up to where it first vanishes.
        power = np.abs(np.fft.rfft(white, 2 * samples)) ** 2
        lagged = np.fft.irfft(power).mean(0)[:samples]
        lagged = lagged / lagged[0]
        end = int(np.argmax(lagged < 0)) or samples
        self.memory = float(max(1.0, 1.0 + 2.0 * lagged[1:end].sum()))

    def _joint_covariance(self, model: Array, white: Array, response: Array) -> Array:
        """Covariance of all factors, gains, offsets and slopes together.

        What vessels do less, steeper slopes make up for: neither is known by itself as well as their product.

        model : (3, R, 1 + P, T) float. The model's columns. white : (R * T,) float. Whitened residuals.
        response : (R, T) float. Change of readings with the arterial pressure. [V/Pa]
        """
        readings, coefficients = len(self.gain_offset_drift), self.gain_offset_drift
        moved = coefficients[:, 0][:, None, None] * (model[0, :, 1:] - model[0, :, :1]) / STEP_LN
        design = self._design(model[:, :, :1], self.slow)[:, 0]
        linear = np.zeros((readings, readings, *design.shape[1:]))
        linear[range(readings), range(readings)] = design
        linear = np.moveaxis(linear, 2, -1).reshape(readings, -1, design.shape[1])
        slopes = self._whiten(np.where(self.there[:, None], np.concatenate([moved, linear], axis=1), 0.0))
        curvature = slopes.T @ slopes
        free, count = len(self.free), design.shape[-1]
        spread = np.concatenate([SPREAD_LN[self.free], self._spread(count).ravel()])
        # In units of the priors: their numbers differ by many orders, and the inverse's rounding with them.
        scale = np.outer(spread, spread)
        inverse = scale * np.linalg.inv(scale * curvature + np.eye(len(spread)))
        # The body's waves move all readings at once, and most where the vessels are about to shut, which is where
        # stiffness and area are identified: the sandwich of Huber and White, with what a wave does as the filling.
        each = slopes.reshape(readings, -1, slopes.shape[1])
        wave = self._wave(white.reshape(readings, -1), response)
        moved_by_wave = np.einsum("rtp,rt->tp", each, wave)
        # They hang together over time, too, and more where the model misses: blocks of time, each as it fell out.
        pull = np.einsum("rtp,rt->tp", each, white.reshape(readings, -1))
        blocks = np.add.reduceat(pull, np.arange(0, len(pull), max(1, len(pull) // BLOCKS)), axis=0)
        middle = moved_by_wave.T @ moved_by_wave + blocks.T @ blocks
        inverse = inverse @ (middle + np.diag(1 / spread**2)) @ inverse
        linear_ones = free + np.arange(LINEAR)[:, None] + count * np.arange(readings)
        kept = np.r_[:free, linear_ones.ravel()]
        out = np.diag(np.concatenate([SPREAD_LN**2, np.zeros(LINEAR * readings)]))
        place = np.r_[self.free, len(NAMES) : len(NAMES) + LINEAR * readings]
        out[np.ix_(place, place)] = inverse[np.ix_(kept, kept)]
        return np.asarray(0.5 * (out + out.T))

    def _wave(self, white: Array, response: Array) -> Array:
        """What a standard deviation of the arterial pressure does to each whitened sample, (R, T); memory is left out.

        white : (R, T) float. Whitened residuals, which tell how large that is. response : (R, T) float. [V/Pa]
        """
        per_pa: Array = response / np.sqrt(np.diag(self.covariance))[:, None] * np.sqrt(self.weight)
        effect = (per_pa**2).sum(0)
        seen = effect > LEAST_EFFECT * effect.max()
        if not seen.any():
            return per_pa
        pressure_pa = (per_pa * white).sum(0)[seen] / effect[seen] * np.sqrt(self.memory)
        return per_pa * float(np.median(np.abs(pressure_pa)) / MEDIAN_OF_GAUSSIAN)

    def _spread(self, count: int) -> Array:
        """What is known of gain, offset, slopes and drifts beforehand, (R, count)."""
        rest, gain = OFFSET_PART * np.nanmedian(self.volts, axis=1), np.full(len(self.volts), GAIN_SPREAD)
        volts, slopes = self.table.slopes(np.full(2, self.usual["rest_blood"]))
        steeper = np.hypot(self.table.slope_stderr, OPTICS_PART * slopes / volts[:, None])
        # The paper's optics know but one zone: what a reading does not depend on stays so.
        steeper = np.maximum(steeper, LEAST_SLOPE)
        return np.column_stack([gain, rest, steeper, *([rest] * (count - 4))])

    def _finish(self, factors: Array) -> Fitted:
        model = self._columns(factors[self.free])
        residual, _ = self._linear_fit(model)
        white = self._whiten(residual)[:, 0]
        coefficients, who = self.gain_offset_drift, self.person(factors)
        table = self.table.steeper(coefficients[:, 2:4] / coefficients[:, :1], float(who.rest_blood))
        response = [arterial_response(who, table, coefficients[:, 0], one) for one in self.slow]
        covariance = self._joint_covariance(model, white, np.concatenate(response, axis=1))
        white = white * np.sqrt(self.memory)
        predicted, left = [], []
        full = self.model(factors[:, None], self.recordings)
        for k, (one, model) in enumerate(zip(self.recordings, full, strict=True)):
            ramp = (one.time_s - one.time_s.mean()) / np.ptp(one.time_s)
            curve = coefficients[:, 1:2] + coefficients[:, 4 + k : 5 + k] * ramp
            curve = curve + np.einsum("rc,crt->rt", coefficients[:, [0, 2, 3]], model[:, :, 0])
            predicted.append(curve)
            left.append(one.volts - curve)
        return Fitted(
            factors_ln=factors,
            covariance=covariance,
            table=table,
            gain=coefficients[:, 0],
            offset_v=coefficients[:, 1],
            predicted_v=predicted,
            residual_v=left,
            chi2_per_dof=float((white**2).sum() / max(int(self.there.sum()) - len(self.free) - coefficients.size, 1)),
        )


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
        there = np.isfinite(blocks)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(there, blocks, 0.0).sum(-1) / there.sum(-1))

    site = None if recording.site is None else recording.site[: count * group : group]
    return Recording(
        recording.name, recording.names, mean(recording.time_s), mean(recording.volts), mean(recording.force_n), site
    )


# Factors are moved by so many of the spreads that the curvature at the best fit gives them.
OFFSETS = np.array([-3.0, -2.25, -1.5, -0.75, 0.0, 0.75, 1.5, 2.25, 3.0])
# Gauss-Newton steps in which all other factors follow.
PROFILE_ROUNDS = 2
# So many of a reading's values are held in memory at once, of all samples and of everybody who is tried. [about 0.1 GB]
MOST_VALUES = 800_000
# A profile is bent if, where a parabola leaves 95 %, the root of its deviance is off the parabola's by this part.
JUDGED_TO, BENT = 2.25, 0.25


@dataclass(frozen=True)
class Profile:
    """Profile likelihoods of P free factors at N places each.

    names : (P,) str. Of the factors.
    factors_ln : (P, N) float. Logarithms to which each factor was moved, rising.
    deviance : (P, N) float. Squares of the whitened residuals and priors beyond those of the best fit; NaN where the
        factor is at the limit of its search.
    offset : (P, N) float. How far it was moved, in spreads; a parabola's deviance is the square of it.
    """

    names: tuple[str, ...]
    factors_ln: Array
    deviance: Array
    offset: Array

    @property
    def bent(self) -> tuple[str, ...]:
        """Factors whose errors are not those of a parabola."""
        found = []
        for name, deviance, offset in zip(self.names, self.deviance, self.offset, strict=True):
            judged = (np.abs(offset) > 0.1) & (np.abs(offset) <= JUDGED_TO) & np.isfinite(deviance)
            root = np.sqrt(np.maximum(deviance[judged], 0.0))
            if (np.abs(root / np.abs(offset[judged]) - 1.0) > BENT).any():
                found.append(name)
        return tuple(found)


def profile_of(fit: Fit, free_ln: Array, report: Callable[[float], None] = lambda done: None) -> Profile:
    """The profiles about the best fit of some free factors' logarithms (P,); report : takes the part that is done."""
    own, slopes = fit.residuals(free_ln[:, None])
    least = float((own**2).sum())
    covariance = np.linalg.inv(slopes[:, 0].T @ slopes[:, 0])
    spread = np.sqrt(np.diag(covariance))
    most = (FARTHEST_SPREADS * SPREAD_LN)[fit.free][:, None]
    # A parabola's valley is where the others begin; (P, factor moved, place).
    valley = free_ln[:, None, None] + (covariance / spread)[..., None] * OFFSETS
    start = np.clip(valley, -most[..., None], most[..., None])
    moved = np.arange(len(free_ln))
    places = start[moved, moved]
    each = max(1, MOST_VALUES // (fit.volts.size * OFFSETS.size * (1 + moved.size)))
    parts = [moved[k : k + each] for k in range(0, moved.size, each)]
    found = []
    for number, part in enumerate(parts):
        report(number / len(parts))
        found.append(_least_along(fit, start[:, part], part, most))
    deviances = np.concatenate(found) - least
    deviances[places != valley[moved, moved]] = np.nan
    names = tuple(NAMES[factor] for factor in fit.free)
    return Profile(names, places, deviances, (places - free_ln[:, None]) / spread[:, None])


def _least_along(fit: Fit, start: Array, held: NDArray[np.intp], most: Array) -> Array:
    """The least sums of squares (H, N) with one factor of `held` (H,) at its starts (P, H, N), the others free."""
    (factors, holding, places), moved = start.shape, start.reshape(len(start), -1).copy()
    free = (np.arange(factors)[:, None] != np.repeat(held, places)).astype(float)
    own, slopes = fit.residuals(moved)
    least = (own**2).sum(0)
    for _ in range(PROFILE_ROUNDS):
        # A held factor has no slope, and its equation says that it stays.
        down = np.moveaxis(slopes * free.T, 1, 0)
        normal = np.swapaxes(down, 1, 2) @ down + np.eye(factors) * (1.0 - free.T)[:, None]
        step = np.linalg.solve(normal, np.swapaxes(down, 1, 2) @ own.T[..., None])[..., 0]
        moved = np.clip(moved - step.T, -most, most)
        own, slopes = fit.residuals(moved)
        least = np.minimum(least, (own**2).sum(0))
    return np.asarray(least.reshape(holding, places))
