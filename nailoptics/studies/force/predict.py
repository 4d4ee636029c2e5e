"""Force over time with its 95 % interval from a calibrated person's readings: of a recording, or of lines one by one.

The interval is of the filter, the calibration's uncertainty and the ensemble; it has no upper bound where the vessels
are closed.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr
from scipy.stats import norm, qmc

from ...errors import InputError
from ...scene.importers.sensor_recordings import (
    MOST_VOLTS,
    STDIN,
    Recording,
    check_header,
    check_known,
    read_sensor_recording,
    reading_columns,
    samples_by_line,
)
from ...sensor.electronics import recorded_at_limit
from ...statistics import covariance_root
from ...variables import Estimate, Variables, described
from ...version import code_attributes
from .body_noise import REST_FORCE_N
from .ensemble import Features
from .kalman import KalmanFilter, PressureEstimate, estimate_pressures, rest_odds, stacked, touch_pressure
from .person import N_PER_CM2, NAMES, SIDES, Array, Person
from .scores import TOUCH_N, TOUCH_SCORES, is_still, rms, touches_by_kind
from .subject import Subject, load_subject, parse_subject

# Held touches of either side at which the error is computed, in parts of closure.
PARTS = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
# Steps of derivatives: of the factors' logarithms, and of pressures in N/cm^2.
STEP_LN, STEP_N_PER_CM2 = 0.05, 0.02
# Prior of a pressure, where readings hardly depend on it. [N/cm^2]
PRESSURE_PRIOR_N_PER_CM2 = 0.5
AREAS = [NAMES.index("contact_area"), NAMES.index("proximal_area")]
# Points that stand for the Gaussian of both pressures: quantiles to some 2 % of a spread.
POINTS = 256
QUANTILES = (0.025, 0.975)
# Below this force, where pressures bend to 0, there may be no touch at all, and it has no place. [N]
LEAST_FORCE_N = 0.03
# Factor on the standard errors of filter and calibration, both of which count some of the model's error: chosen on the
# virtual people, of whose touches the 95 % intervals otherwise cover 97 to 100 %.
INTERVAL_SCALE = 0.82
# An interval of the share as wide as this holds no information.
UNKNOWN_SHARE = 0.9
# Shares of a touch of both sides, and the least error of a share. [1]
BOTH_SHARES, LEAST_SHARE_ERROR = (0.2, 0.8), 0.05


class ForceEstimate(NamedTuple):
    """Force of T samples, with 95 % bounds.

    force_n, force_low_n, force_high_n : (T,) float; the last is infinite where the vessels are closed. [N]
    proximal_share, with its bounds : (T,) float. Part of it; 0 to 1 where it is not known.
    probability_proximal, _distal, _both : (T,) float. That the touch is of that side, or of both; a third where there
        may be none, NaN where the calibration does not say how well it tells sides apart.
    pressure_n_per_cm2, pressure_stderr_n_per_cm2 : (2, T) float. Proximal and distal. [N/cm^2]
    """

    force_n: Array
    force_low_n: Array
    force_high_n: Array
    proximal_share: Array
    proximal_share_low: Array
    proximal_share_high: Array
    probability_proximal: Array
    probability_distal: Array
    probability_both: Array
    pressure_n_per_cm2: Array
    pressure_stderr_n_per_cm2: Array

    def where(self, known: Array) -> "ForceEstimate":
        """The same, NaN where not known (T,)."""
        return ForceEstimate(*(np.where(known, column, np.nan) for column in self))


SITE_PROBABILITIES = ForceEstimate._fields[6:9]


class ForceInterval:
    """Forces with 95 % intervals of the filter's estimates, for one sample or many."""

    def __init__(self, subject: Subject) -> None:
        self.subject, self.person = subject, subject.person
        closure_n_per_cm2 = self.person.closure_n_per_cm2()
        self._closed_n_per_cm2 = closure_n_per_cm2[:, None]
        root, rest_v = covariance_root(subject.covariance), subject.rest_v
        # Of readings at rest: white noise and a minute's drift. [1/V^2]
        noise_v2 = np.outer(rest_v, rest_v) * subject.drift_covariance + np.diag(subject.readings.noise_v**2)
        self._information = np.linalg.inv(noise_v2)
        self._roots = [
            make_interp_spline(bends, [self._jacobian(side, bend) @ root for bend in bends], k=1)
            for side, bends in enumerate(closure_n_per_cm2[:, None] * PARTS)
        ]
        self._points = norm.ppf(qmc.Sobol(2, scramble=True, seed=0).random(POINTS)).T
        covariance = self._calibration_covariance(np.diag(closure_n_per_cm2))[0]
        part = np.sqrt(np.einsum("tii->ti", covariance).diagonal()) / closure_n_per_cm2
        # Force of a touch on either side from which its interval may have no upper bound, and its lower bound. [N]
        self.saturated_above_n = self.person.side_areas_cm2 * closure_n_per_cm2
        self._least_closing_n = self.saturated_above_n * np.exp(-2 * part)

    def of(self, estimates: PressureEstimate) -> ForceEstimate:
        """The forces of some samples."""
        touch, by_filter = estimates.touch_n_per_cm2, estimates.covariance * INTERVAL_SCALE**2
        pressure_n_per_cm2 = touch_pressure(touch.T)
        by_calibration, pressure_by_calibration = self._calibration_covariance(pressure_n_per_cm2)
        covariance = by_filter + by_calibration
        cloud = np.einsum("tij,jp->itp", covariance_root(covariance), self._points)
        pressures_n_per_cm2 = touch_pressure(touch.T[:, :, None] + cloud)
        force, share = self.person.force(pressures_n_per_cm2)
        low, high = np.quantile(force, QUANTILES, axis=1)
        share_low, share_high = np.quantile(share, QUANTILES, axis=1)
        middle, middle_share = self.person.force(pressure_n_per_cm2)
        highest_n_per_cm2 = np.quantile(pressures_n_per_cm2, QUANTILES[1], axis=2)
        is_closed = highest_n_per_cm2 >= self._closed_n_per_cm2
        saturated = is_closed.any(0)
        # Past closure a harder touch reads the same: neither bound lies above it.
        low = np.minimum(low, np.where(is_closed, self._least_closing_n[:, None], np.inf).min(0))
        # Where rest is no less likely than the quantile, the bound is 0.
        resting = rest_odds(touch, covariance)
        low = np.where((low < LEAST_FORCE_N) | (resting > QUANTILES[0]), 0.0, low)
        nowhere = (middle < LEAST_FORCE_N) | (share_high - share_low > UNKNOWN_SHARE)
        spread, error = np.where(nowhere, np.inf, share.std(1)), self.subject.quality.share_error
        probabilities = _site_probabilities(middle_share, spread, np.array(error or (np.nan, np.nan)))
        pressure_variance = np.einsum("tii->it", by_filter + pressure_by_calibration)
        return ForceEstimate(
            force_n=middle,
            force_low_n=np.minimum(low, middle),
            force_high_n=np.where(saturated, np.inf, np.maximum(high, middle)),
            proximal_share=middle_share,
            proximal_share_low=np.where(nowhere, 0.0, share_low),
            proximal_share_high=np.where(nowhere, 1.0, share_high),
            **dict(zip(SITE_PROBABILITIES, probabilities, strict=True)),
            pressure_n_per_cm2=pressure_n_per_cm2,
            pressure_stderr_n_per_cm2=np.sqrt(np.maximum(pressure_variance, 0.0)),
        )

    def _calibration_covariance(self, pressure_n_per_cm2: Array) -> tuple[Array, Array]:
        """Covariances (T, 2, 2) of forces over the contact's areas, and of the pressures themselves. An error of an
        area is one of the pressure, too, the other way: forces were known."""
        total = np.maximum(pressure_n_per_cm2.sum(0), 1e-9)
        proximal, distal = (root(np.minimum(total, root.t[-1])) for root in self._roots)
        share = (pressure_n_per_cm2[0] / total)[:, None, None]
        root = share * proximal + (1.0 - share) * distal
        known = root @ np.moveaxis(root, 1, 2) * INTERVAL_SCALE**2
        jacobian = np.zeros((total.size, 2, 4))
        jacobian[:, [0, 1], [0, 1]] = 1.0
        jacobian[:, [0, 1], 2], jacobian[:, 0, 3] = pressure_n_per_cm2.T, pressure_n_per_cm2[0]
        return jacobian @ known @ np.moveaxis(jacobian, 1, 2), known[:, :2, :2]

    def _jacobian(self, side: int, pressure_n_per_cm2: float) -> Array:
        """Derivatives of the estimate of a held touch by all parameters of the calibration, (4, P + 4 R) float. Of both
        pressures and of the logarithms of the contact's areas. A person who is not quite the calibrated one gives other
        readings; the pressures that explain them best, beside drift and noise, are off by so much."""
        subject, count = self.subject, len(NAMES)
        held = np.where(np.arange(2) == side, pressure_n_per_cm2, 0.0)[:, None]
        steps = STEP_LN * np.hstack([np.eye(count), -np.eye(count)])
        moved, _ = self._risen_v(subject.scene.person(subject.factors_ln[:, None] + steps), held)
        by_factor = (moved[:, :count] - moved[:, count:]) / (2 * STEP_LN)
        around = np.maximum(held + STEP_N_PER_CM2 * np.hstack([np.eye(2), -np.eye(2), np.zeros((2, 1))]), 0)
        near, steeper = self._risen_v(subject.person, around)
        slopes = (near[:, :2] - near[:, 2:4]) / np.diag(around[:, :2] - around[:, 2:4])
        by_gain = np.diag(near[:, 4] / subject.readings.gain)
        by_slope = [np.diag(zone[:, 4]) for zone in steeper]
        by_parameter = np.column_stack([by_factor, by_gain, np.zeros_like(by_gain), *by_slope])
        weighted = slopes.T @ self._information
        precision = weighted @ slopes + np.eye(2) / PRESSURE_PRIOR_N_PER_CM2**2
        by_touch = -np.linalg.solve(precision, weighted @ by_parameter)
        return np.vstack([by_touch, np.eye(by_parameter.shape[1])[AREAS]])

    def _risen_v(self, who: Person, pressure_n_per_cm2: Array) -> tuple[Array, Array]:
        """Volts of every reading over those at rest, (R, S), of one or many people under held pressures (2, S). And
        what steeper slopes by the blood of either zone add to them, (2, R, S)."""
        width, light = who.steady_widths(pressure_n_per_cm2), self.subject.light
        blood, rest = who.blood(width), who.blood(np.ones_like(width))
        volts = light.volts(blood)
        risen = self.subject.readings.gain[:, None] * (volts - light.volts(rest))
        return risen, volts * (blood - rest)[:, None]


def _site_probabilities(share: Array, spread: Array, error: Array) -> Array:
    """Probabilities (3, T) that a touch is of the proximal side, of the distal one, or of both; a third where unknown.

    All force of a touch of one side is there; that of both has any of BOTH_SHARES. None is more likely before.

    share, spread : (T,) float. Estimated proximal share, and its standard deviation by the filter.
    error : (2,) float. Of the share of the calibration's proximal and distal touches, rms.
    """
    known = np.isfinite(spread)
    of_side = np.maximum(np.where(known, spread, 1.0), np.maximum(error, LEAST_SHARE_ERROR)[:, None])
    of_both, (low, high) = np.sqrt((of_side**2).mean(0)), BOTH_SHARES
    one = np.exp(-0.5 * ((share - [[1.0], [0.0]]) / of_side) ** 2) / (np.sqrt(2.0 * np.pi) * of_side)
    both = (ndtr((high - share) / of_both) - ndtr((low - share) / of_both)) / (high - low)
    density = np.stack([*one, both])
    return np.asarray(np.where(known, density / density.sum(0), 1.0 / 3.0))


class ForceEstimator:
    """A subject's force from the filter's estimates and the readings of samples that come one after another.

    It is the ensemble's where there is one, else the filter's. Readings over rest, and all memory, begin with the first
    sample, which is taken for one of an untouched finger.
    """

    def __init__(self, subject: Subject) -> None:
        self._ensemble, self._interval = subject.ensemble, ForceInterval(subject)
        # Force of a touch on either side from which its interval has no upper bound. [N]
        open_from_n = self._ensemble.open_from_n if self._ensemble else self._interval.saturated_above_n
        self.open_above_n = dict(zip(SIDES, open_from_n.tolist(), strict=True))
        self._features = Features(self._ensemble.components if self._ensemble else np.empty((0, 0)))
        self._areas_cm2 = subject.person.side_areas_cm2[:, None]

    def of(self, estimates: PressureEstimate, volts: Array, since_s: Array) -> tuple[ForceEstimate, Array, Array]:
        """Force of the next samples (T,), that of the filter alone [N], and ln volts less those at rest, (R, T).

        volts : (R, T) float. since_s : (T,) float. Time from sample to sample. [s]
        """
        by_filter = self._interval.of(estimates)
        with np.errstate(invalid="ignore", divide="ignore"):
            over_rest = self._features.over_rest(np.log(volts), by_filter.force_n < REST_FORCE_N, since_s)
        force = by_filter
        if self._ensemble is not None:
            features = self._features.with_memory(over_rest, by_filter.pressure_n_per_cm2 * self._areas_cm2, since_s)
            force_n = self._ensemble.force_n(features, by_filter.force_n)
            low_n, high_n = self._ensemble.interval_n(features, force_n, by_filter.proximal_share)
            force = by_filter._replace(force_n=force_n, force_low_n=low_n, force_high_n=high_n)
        # Where there may be no touch, none of the sides is any more likely.
        may_rest = force.force_low_n <= 0.0
        likely = {name: np.where(may_rest, 1.0 / 3.0, getattr(force, name)) for name in SITE_PROBABILITIES}
        return force._replace(**likely), by_filter.force_n, over_rest


# A recording does not fit its subject if more of its samples than this are outliers, or if all others are on average
# further off their predictions than this, in variances.
MOST_OUTLIERS, MOST_CHI2 = 0.03, 1.5
# Patterns of a misfit are named where they explain this part of it.
EXPLAINED = 0.8


def predict(
    subject: Subject | xr.Dataset | str | Path,
    readings: Recording | str | Path,
    *,
    press_n: float = 0.5,
    release_n: float = 0.3,
) -> xr.Dataset:
    """Force over time from readings.

    subject : what `calibrate` returned, or its file.
    readings : a recording, or its file; its force, where known, is what the result is judged by.
    press_n, release_n : the virtual switch closes above the first force and opens below the second. [N]

    Returns: Dataset over time: force_n with force_low_n and force_high_n (95 %; infinite where the vessels are closed),
    proximal share and pressures with theirs, NaN before the first reading and the first after a gap of 5 s; arterial
    pressure, normalized innovation squared (NIS), outlier, the regressions' forces; its attributes hold what
    `prediction_summary` prints.

    Raises: InputError for readings of another board, or thresholds out of order.
    """
    if not 0 < release_n < press_n < np.inf:
        raise InputError(f"release = {release_n:g} N must lie above 0 and below press = {press_n:g} N.")
    subject = _subject(subject)
    recording = readings if isinstance(readings, Recording) else read_sensor_recording(readings)
    recording, warnings = _without_saturated(subject, recording.of(subject.light.names))
    estimates = estimate_pressures(subject, recording.time_s, recording.volts)
    since_s, estimator = np.diff(recording.time_s, prepend=recording.time_s[0]), ForceEstimator(subject)
    force, filter_n, over_rest = estimator.of(estimates, recording.volts, since_s)
    force, filter_n = force.where(estimates.informed), np.where(estimates.informed, filter_n, np.nan)
    known_n = np.where(estimates.informed, np.nan if recording.force_n is None else recording.force_n, np.nan)
    result = _dataset(subject, recording, estimates, (force, filter_n, over_rest), known_n).assign(
        _event_variables(recording.time_s, force.force_n, known_n, press_n=press_n, release_n=release_n)
    )
    above_n = estimator.open_above_n
    by_side = {f"open_above_{side}_n": force_n for side, force_n in above_n.items()}
    if subject.quality.is_wrong:
        off = f"{1e3 * subject.quality.rms_n:.0f} mN off on its own touches (rms)"
        warnings.insert(0, f"the calibration itself was {off}: calibrate again.")
    if (is_open := result.attrs["touch_open_above"]) > 0.5:
        no_bound = f"{is_open:.0%} of the touches' intervals have no upper bound"
        warnings.append(f"{no_bound}: that they cover the force says little.")
    return result.assign_attrs(by_side, open_above_n=min(above_n.values()), warnings=warnings)


def live(subject: Subject, lines: Iterable[str]) -> Iterator[str]:
    """The lines of predict.csv for lines of a recording that come one by one: each is answered before the next is read.

    Raises: InputError for a header that lacks a reading, or a line that is none.
    """

    def titles(header: list[str]) -> tuple[str, ...]:
        check_header(header, STDIN)
        check_known(reading_columns(header), subject.light.names, STDIN)
        return "time_s", *subject.light.names

    samples = samples_by_line(lines, titles)
    yield ",".join(CSV_COLUMNS)
    for force in predict_live(subject, ((sample.pop("time_s"), sample) for sample in samples)):
        yield _csv_row(*force)


class LiveForce(NamedTuple):
    """Force at one time, with its 95 % interval; force_high_n is infinite where the vessels may be closed. [s, N]"""

    time_s: float
    force_n: float
    force_low_n: float
    force_high_n: float
    proximal_share: float
    proximal_share_low: float
    proximal_share_high: float
    probability_proximal: float
    probability_distal: float
    probability_both: float
    outlier: bool


def predict_live(
    subject: Subject | xr.Dataset | str | Path, samples: Iterable[tuple[float, Mapping[str, float]]]
) -> Iterator[LiveForce]:
    """Force of samples that come one by one: each is answered before the next is taken.

    subject : as for `predict`.
    samples : time [s] and volts of each reading by its name; NaN is a gap. Times rise; the finger is untouched at
        first, and again after a gap of 5 s. Forces are NaN before the first reading, and the first after such a gap.

    Raises: InputError for volts of other readings, or times out of order.
    """
    subject, last_s = _subject(subject), None
    kalman, estimator, names = KalmanFilter(subject), ForceEstimator(subject), subject.light.names
    for sample in samples:
        try:
            time_s, by_name = sample
            where = f"sample at time_s = {time_s:.15g}"
            check_known([*by_name], names, where)
            volts = np.array([np.nan if by_name[name] is None else by_name[name] + 0.0 for name in names], float)
        except (TypeError, ValueError):
            example = (0.0, dict.fromkeys(names, 0.5))
            raise InputError(f"sample {sample!r:.100}: give a time in s and numbers in V, as {example}.") from None
        if last_s is not None and not time_s > last_s:
            raise InputError(f"{where} does not come after {last_s:.15g}; times must rise.")
        if np.nanmax(np.abs(volts), initial=0.0) > MOST_VOLTS:
            raise InputError(f"{where} looks like a converter's counts; convert it to volts.")
        # A converter at its limit holds no information.
        volts = np.where(recorded_at_limit(volts, subject.light.range_v), np.nan, volts)
        since_s: float | None = None if last_s is None else time_s - last_s
        estimate = kalman.update_sample(volts, since_s)
        last_s, force = time_s, estimator.of(stacked([estimate]), volts[:, None], np.array([since_s or 0.0]))[0]
        columns = (float(column[0]) for column in force.where(estimate.informed)[: len(FORCE_COLUMNS)])
        yield LiveForce._make((time_s, *columns, bool(estimate.outlier)))


def _subject(given: Subject | xr.Dataset | str | Path) -> Subject:
    if isinstance(given, xr.Dataset):
        return parse_subject(given.attrs["subject"])
    return given if isinstance(given, Subject) else load_subject(given)


def events(time_s: Array, force_n: Array, *, press_n: float, release_n: float) -> list[tuple[float, str]]:
    """Times at which a switch with hysteresis closes and opens."""
    switched, closed = [], False
    for time, force in zip(time_s.tolist(), force_n, strict=True):
        if force < release_n if closed else force > press_n:
            closed = not closed
            switched.append((time, "press" if closed else "release"))
    return switched


# What is estimated of each sample, in the order of predict.csv and of `ForceEstimate`.
FORCE_COLUMNS = ForceEstimate._fields[:9]
CSV_COLUMNS = ("time_s", *FORCE_COLUMNS[:3], "open_above", *FORCE_COLUMNS[3:], "outlier")


def csv_rows(result: xr.Dataset) -> Iterator[str]:
    """The lines of predict.csv; an upper bound that is open is left empty."""
    yield ",".join(CSV_COLUMNS)
    for row in zip(*(result[name].values for name in ("time", *FORCE_COLUMNS, "outlier")), strict=True):
        yield _csv_row(*row)


def _csv_row(time_s: float, *columns: float) -> str:
    """One line of predict.csv; columns : those of `FORCE_COLUMNS`, and whether the sample is an outlier."""
    force_n, low_n, high_n, *of_place, outlier = columns
    bound = ",1" if np.isinf(high_n) else f"{high_n:.4f},0"
    place = ",".join(f"{value:.3f}" for value in of_place)
    return f"{float(time_s)!r},{force_n:.4f},{low_n:.4f},{bound},{place},{int(outlier)}"


def _dataset(
    subject: Subject,
    recording: Recording,
    estimates: PressureEstimate,
    estimated: tuple[ForceEstimate, Array, Array],
    known_n: Array,
) -> xr.Dataset:
    force, filter_n, over_rest = estimated
    compared_n = {name: baseline.force_n(over_rest) for name, baseline in subject.comparisons.items()}
    compared_n["filter"] = filter_n
    where = force.proximal_share if recording.site is None else np.nan_to_num(recording.site, nan=0.5)
    bounds_n, still = (force.force_low_n, force.force_high_n), is_still(recording.time_s, np.nan_to_num(known_n))
    touches = touches_by_kind(known_n, force.force_n, bounds_n, where > 0.5, still)
    pressures_pa = (N_PER_CM2 * column for column in (force.pressure_n_per_cm2, force.pressure_stderr_n_per_cm2))
    of_sides = zip(SIDES, *pressures_pa, strict=True)
    data = described(
        __package__,
        **dict(zip(FORCE_COLUMNS, force, strict=False)),
        **{f"force_{name}_n": series for name, series in compared_n.items()},
        arterial_change_pa=estimates.arterial_pa,
        normalized_innovation_squared=estimates.nis,
        outlier=estimates.outlier,
        known_force_n=known_n,
        **{f"{side}_pressure_pa": Estimate(*of_side) for side, *of_side in of_sides},
        **{f"touch_{name}": [kind[name] for kind in touches.values()] for name in TOUCH_SCORES},
    )
    misfit = _misfit(subject, recording, estimates, force.force_n)
    inside = (known_n >= force.force_low_n) & (known_n <= force.force_high_n)
    touching = (force.force_n if recording.force_n is None else known_n) >= TOUCH_N
    half_width_n = 0.5 * (force.force_high_n - force.force_low_n)
    attributes = {
        "rms_n": rms(force.force_n - known_n),
        "coverage_95": _of_some(np.mean, inside[np.isfinite(known_n)]),
        "half_width_n": _of_some(np.median, half_width_n[touching]),
        "touch_open_above": _of_some(np.mean, np.isinf(force.force_high_n)[touching]),
        "chi2_per_dof": float(estimates.nis.sum() / max(estimates.count.sum(), 1)),
        "outliers": float(estimates.outlier.mean()),
        "consistent": int(not misfit),
        "misfit": misfit,
        "scene_digest": subject.scene_digest,
        "title": "force from volts",
    } | code_attributes()
    touched = known_n >= TOUCH_N
    attributes |= {f"touch_rms_{name}_n": rms((series - known_n)[touched]) for name, series in compared_n.items()}
    coordinates = described(__package__, time=recording.time_s, kind=list(touches))
    return xr.Dataset(data, coordinates, attributes)


def _event_variables(time_s: Array, force_n: Array, known_n: Array, **thresholds_n: float) -> Variables:
    """When the switch acts on the estimated force, and how long after it would on the known one."""
    switched, true = (events(time_s, series, **thresholds_n) for series in (force_n, np.nan_to_num(known_n)))
    at_s, kinds = np.array([at for at, _ in switched], float), np.array([kind for _, kind in switched], dtype=str)
    true_s = [max((t for t, kind in true if kind == key and t <= at), default=np.nan) for at, key in switched]
    return described(__package__, event_time_s=at_s, event_kind=kinds, event_latency_s=at_s - np.array(true_s))


def _misfit(subject: Subject, recording: Recording, estimates: PressureEstimate, force_n: Array) -> str:
    """The likely cause where readings do not fit the subject; empty where they do."""
    # Outliers count where force has hardly changed for a while: no person's vessels follow a sudden touch quite as the
    # model's do.
    outlier, still = estimates.outlier, is_still(recording.time_s, force_n)
    outliers = float(outlier[still].mean()) if still.any() else 1.0
    chi2 = estimates.nis[~outlier].sum() / max(estimates.count[~outlier].sum(), 1)
    if outliers <= MOST_OUTLIERS and chi2 <= MOST_CHI2:
        return ""
    off = np.nanmedian(recording.volts, axis=1) - (subject.readings.offset_v + subject.rest_v)
    patterns = {
        "ambient light, or another person": np.ones_like(off),
        "a lifted sensor or other gain, or another person": subject.rest_v,
    }
    for name, shape in patterns.items():
        along = (off @ shape) ** 2 / ((shape @ shape) * max(float(off @ off), 1e-30))
        if along > EXPLAINED:
            return name
    return "another person or place, or motion"


def _without_saturated(subject: Subject, recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with gaps where a converter was at its limit, and warnings of them."""
    saturated, warnings = recorded_at_limit(recording.volts, subject.light.range_v), []
    for name, volts, full in zip(recording.names, recording.volts, saturated, strict=True):
        valid = int(np.isfinite(volts).sum())
        if full.sum() == valid:
            raise InputError(f"{recording.name}: column {name!r} is saturated throughout; lower the LED's power.")
        if full.any():
            warnings.append(f"{name} is saturated in {int(full.sum())} of {valid} samples, which count as gaps.")
    return replace(recording, volts=np.where(saturated, np.nan, recording.volts)), warnings


def _of_some(statistic: Callable[[Any], Any], values: NDArray[Any]) -> float:
    return float(statistic(values)) if values.size else float("nan")
