"""Force over time with its 95 % interval from a calibrated person's readings: a recording, or lines one by one."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import InputError
from ...hemodynamics.parameters import PA_PER_N_PER_CM2
from ...scene.importers import sensor_recordings
from ...scene.importers.sensor_recordings import STDIN, Recording, check_known
from ...sensor.electronics import recorded_at_limit
from ...variables import Estimate, Variables, described
from ...version import code_attributes
from .ensemble import MISSING_S
from .interval import ForceEstimate, ForceEstimator
from .kalman import KalmanFilter, PressureEstimate, estimate_pressures, stacked
from .person import SIDES, Array
from .scores import TOUCH_N, TOUCH_SCORES, is_still, rms, touches_by_kind
from .subject import Subject, load_subject, parse_subject

# A recording does not fit its subject if more of its samples than this are outliers, and than so many times those of
# the calibration, or if all others are on average further off their predictions than this, in variances.
MOST_OUTLIERS, OVER_CALIBRATION, MOST_CHI2 = 0.03, 2.0, 1.5
# A switch that acts further than this from where the known force would have it is not late, but wrong. [s]
LATEST_S = 1.0
# Live samples by whose times the rate is checked, at least and at most.
RATE_SAMPLES = 10, 50
# The pattern that explains most of a misfit is named where that is this fraction.
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

    Raises: InputError for readings of another board, below 12.5 Hz, or thresholds out of order.
    """
    if not 0 < release_n < press_n < np.inf:
        raise InputError(f"release = {release_n:g} N must lie above 0 and below press = {press_n:g} N.")
    subject = _subject(subject)
    recording = readings if isinstance(readings, Recording) else sensor_recordings.read_sensor_recording(readings)
    recording, warnings = _without_saturated(subject, recording.with_readings(subject.light.names))
    estimates = estimate_pressures(subject, recording.time_s, recording.volts)
    since_s, estimator = np.diff(recording.time_s, prepend=recording.time_s[0]), ForceEstimator(subject)
    force, filter_n, over_rest = estimator.estimate(estimates, recording.volts, since_s)
    force, filter_n = force.where(estimates.informed), np.where(estimates.informed, filter_n, np.nan)
    known_n = np.where(estimates.informed, np.nan if recording.force_n is None else recording.force_n, np.nan)
    result = _dataset(subject, recording, estimates, (force, filter_n, over_rest), known_n).assign(
        _event_variables(recording.time_s, force.force_n, known_n, press_n=press_n, release_n=release_n)
    )
    missing = (np.isnan(over_rest) & estimates.informed).sum(1)
    if absent := [f"{name} ({count})" for name, count in zip(recording.names, missing, strict=True) if count]:
        long = f"samples for longer than {MISSING_S:g} s or since before it was read at rest"
        warnings.append(f"{', '.join(absent)} missing in so many {long}: force there is the filter's alone.")
    by_side = {f"open_above_{side}_n": force_n for side, force_n in estimator.open_above_n.items()}
    warnings[:0] = filter(None, [subject.quality.fault, *map("calibration: {}".format, subject.quality.lacking)])
    if (is_open := result.attrs["touch_open_above"]) > 0.5:
        no_bound = f"{is_open:.0%} of the touches' intervals have no upper bound"
        warnings.append(f"{no_bound}: that they cover the force says little.")
    return result.assign_attrs(by_side, open_above_n=min(by_side.values()), warnings=warnings)


def live(subject: Subject, lines: Iterable[str]) -> Iterator[str]:
    """The lines of predict.csv for lines of a recording that come one by one: each is answered before the next is read.

    Raises: InputError for a header that lacks a reading, or a line that is none.
    """

    def titles(header: list[str]) -> tuple[str, ...]:
        sensor_recordings.check_header(header, STDIN)
        check_known(sensor_recordings.reading_columns(header), subject.light.names, STDIN)
        return "time_s", *subject.light.names

    samples = sensor_recordings.samples_by_line(lines, titles)
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

    Raises: InputError for volts of other readings, times out of order, or too few samples in a second.
    """
    subject, recent_s = _subject(subject), np.zeros(0)
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
        if recent_s.size and not time_s > recent_s[-1]:
            raise InputError(f"{where} does not come after {recent_s[-1]:.15g}; times must rise.")
        recent_s = np.append(recent_s, time_s)[-RATE_SAMPLES[1] :]
        if len(recent_s) >= RATE_SAMPLES[0]:
            sensor_recordings.check_rate(recent_s, where)
        if np.nanmax(np.abs(volts), initial=0.0) > sensor_recordings.MOST_VOLTS:
            raise InputError(f"{where} {sensor_recordings.NOT_VOLTS}.")
        # A converter at its limit holds no information.
        volts = np.where(recorded_at_limit(volts, subject.light.range_v), np.nan, volts)
        since_s = float(np.diff(recent_s)[-1]) if len(recent_s) > 1 else None
        estimate = kalman.update_sample(volts, since_s)
        force = estimator.estimate(stacked([estimate]), volts[:, None], np.array([since_s or 0.0]))[0]
        columns = (float(column[0]) for column in force.where(estimate.informed)[: len(FORCE_COLUMNS)])
        yield LiveForce._make((time_s, *columns, bool(estimate.outlier)))


def _subject(given: Subject | xr.Dataset | str | Path) -> Subject:
    if isinstance(given, xr.Dataset):
        return parse_subject(given.attrs["subject"])
    return given if isinstance(given, Subject) else load_subject(given)


def events(time_s: Array, force_n: Array, *, press_n: float, release_n: float) -> Iterator[tuple[float, str]]:
    """Times at which a switch with hysteresis closes and opens."""
    closed = False
    for time, force in zip(time_s.tolist(), force_n, strict=True):
        if force < release_n if closed else force > press_n:
            closed = not closed
            yield time, "press" if closed else "release"


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
    where = force.proximal_share if recording.site is None else recording.site
    bounds_n, still = (force.force_low_n, force.force_high_n), is_still(recording.time_s, known_n)
    touches = touches_by_kind(known_n, force.force_n, bounds_n, where, still)
    pressures_pa = (PA_PER_N_PER_CM2 * column for column in (force.pressure_n_per_cm2, force.pressure_stderr_n_per_cm2))
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
        "incomplete": int(np.isnan(recording.volts).any(0).sum()),
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
    """When the switch acts on the estimated force, and how long after it would on the known one, below 0 before, NaN
    where that does not act within LATEST_S."""
    known = ((time_s[at], series[at]) for series in (force_n, known_n) for at in [np.isfinite(series)])
    switched, true = ([*events(at_s, at_n, **thresholds_n)] for at_s, at_n in known)
    at_s, kinds = np.array([at for at, _ in switched], float), np.array([kind for _, kind in switched], dtype=str)
    near_s = ((at - t for t, kind in true if kind == key and abs(at - t) <= LATEST_S) for at, key in switched)
    late_s = [min(latencies_s, key=abs, default=np.nan) for latencies_s in near_s]
    return described(__package__, event_time_s=at_s, event_kind=kinds, event_latency_s=np.array(late_s, float))


def _misfit(subject: Subject, recording: Recording, estimates: PressureEstimate, force_n: Array) -> str:
    """The likely cause where readings do not fit the subject; empty where they do."""
    # Outliers count where force has hardly changed for a while: vessels follow a sudden touch unlike the model's.
    outlier, still = estimates.outlier, is_still(recording.time_s, force_n)
    outliers = float(outlier[still].mean()) if still.any() else 1.0
    chi2 = estimates.nis[~outlier].sum() / max(estimates.count[~outlier].sum(), 1)
    if outliers <= max(MOST_OUTLIERS, OVER_CALIBRATION * subject.quality.outliers) and chi2 <= MOST_CHI2:
        return ""
    off = np.nanmedian(recording.volts, axis=1) - (subject.readings.offset_v + subject.rest_v)
    patterns = {"ambient light": np.ones_like(off), "a lifted sensor or other gain": subject.rest_v}
    along, name = max(((off @ shape) ** 2 / (shape @ shape), name) for name, shape in patterns.items())
    return f"{name}, or another person" if along > EXPLAINED * (off @ off) else "another person or place, or motion"


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
