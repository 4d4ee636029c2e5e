"""Tell force over time from a calibrated person's readings, with intervals, events, and what does not fit."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...commit import code_attributes
from ...errors import InputError
from ...scene.importers.sensor_recordings import SATURATED, Recording, read_sensor_recording
from ...variables import variable
from .kalman import KalmanFilter, PressureEstimate, smoothed_estimates
from .state_space import StateSpace
from .subject import Subject, read_subject
from .uncertainty import ForceEstimate

Array = NDArray[np.float64]

# A recording does not fit its subject if more of its samples than this are outliers, or if all others are on average
# further off their predictions than this, in variances.
MOST_OUTLIERS, MOST_CHI2 = 0.03, 1.5
# Outliers count where force has hardly changed for a while: no person's vessels follow a sudden touch quite as the
# model's do. [N, s]
STILL_N, SETTLING_S = 0.1, 0.5
# Samples of this force or more are of a touch: at rest an interval from 0 covers by itself. [N]
TOUCH_N = 0.15
# The regressions that a force is compared with, in words.
REGRESSIONS = {"linear": "linear in the readings", "components": "on their principal components"}
# Patterns of a misfit are named where they explain this part of it.
EXPLAINED = 0.8


def predict(
    subject: Subject | str | Path,
    readings: Recording | str | Path,
    *,
    press_n: float = 0.5,
    release_n: float = 0.3,
    smooth: bool = False,
) -> xr.Dataset:
    """Force over time from readings.

    subject : what `calibrate` found, or its file.
    readings : a recording, or its file; its force, where known, is what the result is judged by.
    press_n, release_n : the virtual switch closes above the first force and opens below the second. [N]
    smooth : use the samples after each as well, not only those before it.

    Returns: Dataset over time: force_n with force_low_n and force_high_n (95 %; infinite where the vessels are closed),
    proximal share and pressures with theirs, arterial pressure, normalized innovation squared (`surprise`) and outlier
    of each sample, the regressions' forces; its attributes hold what `prediction_summary` prints.

    Raises: InputError for readings of another board, or thresholds out of order.
    """
    if not 0 < release_n < press_n < np.inf:
        raise InputError(f"release = {release_n:g} N must lie above 0 and below press = {press_n:g} N.")
    subject = subject if isinstance(subject, Subject) else read_subject(subject)
    recording = readings if isinstance(readings, Recording) else read_sensor_recording(readings)
    recording, warnings = _without_saturated(subject, recording.of(subject.table.names))
    kalman = KalmanFilter(subject.sensor, subject.noise)
    samples = zip(recording.volts.T, [None, *np.diff(recording.time_s)], strict=True)
    if smooth:
        estimates = smoothed_estimates(kalman, samples)
    else:
        estimates = [kalman.update_sample(volts, since_s) for volts, since_s in samples]
    interval = subject.force_interval()
    forces, above_n = interval.of(estimates), interval.saturated_above_n
    result = _dataset(subject, recording, kalman, estimates, forces, press_n=press_n, release_n=release_n)
    by_side = {f"open_above_{side}_n": force_n for side, force_n in above_n.items()}
    if subject.is_wrong:
        warnings.append(
            f"the calibration itself was {1e3 * subject.rms_n:.0f} mN off on its own touches (rms): calibrate again."
        )
    if result.attrs["touch_open_above"] > 0.5:
        warnings.append(
            f"{result.attrs['touch_open_above']:.0%} of the touches' intervals have no upper bound: that they cover "
            "the force says little."
        )
    return result.assign_attrs(by_side, open_above_n=min(above_n.values()), warnings=warnings)


def events(time_s: Array, force_n: Array, *, press_n: float, release_n: float) -> list[tuple[float, str]]:
    """Times at which a switch with hysteresis closes and opens."""
    found, closed = [], False
    for time, force in zip(time_s, force_n, strict=True):
        if not closed and force > press_n:
            closed = True
            found.append((float(time), "press"))
        elif closed and force < release_n:
            closed = False
            found.append((float(time), "release"))
    return found


CSV_COLUMNS = (
    "time_s",
    "force_n",
    "force_low_n",
    "force_high_n",
    "open_above",
    "proximal_share",
    "proximal_share_low",
    "proximal_share_high",
    "outlier",
)


def csv_rows(result: xr.Dataset) -> Iterator[str]:
    """The lines of predict.csv; an upper bound that is open is left empty."""
    yield ",".join(CSV_COLUMNS)
    columns = [result.time.values, *(result[name].values for name in ("force_n", "force_low_n", "force_high_n"))]
    columns += [result[name].values for name in CSV_COLUMNS[5:]]
    for row in zip(*columns, strict=True):
        yield csv_row(*row)


def csv_row(
    time_s: float, force_n: float, low_n: float, high_n: float, share: float, low: float, high: float, outlier: bool
) -> str:
    """One line of predict.csv."""
    bound, is_open = ("", 1) if np.isinf(high_n) else (f"{high_n:.4f}", 0)
    return (
        f"{float(time_s)!r},{force_n:.4f},{low_n:.4f},{bound},{is_open},{share:.3f},{low:.3f},{high:.3f},{int(outlier)}"
    )


def _dataset(
    subject: Subject,
    recording: Recording,
    kalman: KalmanFilter,
    estimates: list[PressureEstimate],
    estimate: ForceEstimate,
    *,
    press_n: float,
    release_n: float,
) -> xr.Dataset:
    time_s, over = recording.time_s, "time"
    data = variable("force_n", over, estimate.force_n, "force, estimated from the readings", units="N")
    data |= variable("force_low_n", over, estimate.low_n, "lower bound of the force, 95 %", units="N")
    bound = "upper bound of the force, 95 %; infinite where the vessels are closed"
    data |= variable("force_high_n", over, estimate.high_n, bound, units="N")
    data |= variable("proximal_share", over, estimate.share, "proximal share of the force")
    data |= variable("proximal_share_low", over, estimate.share_low, "lower bound of the proximal share, 95 %")
    data |= variable("proximal_share_high", over, estimate.share_high, "upper bound of the proximal share, 95 %")
    for k, side in enumerate(("proximal", "distal")):
        values, error = 1e4 * estimate.pressure[k], 1e4 * estimate.pressure_stderr[k]
        data |= variable(f"{side}_pressure_pa", over, values, f"{side} touch pressure", units="Pa", stderr=error)
    arterial = np.array([one.arterial_pa for one in estimates])
    data |= variable("arterial_change_pa", over, arterial, "arterial pressure less its mean", units="Pa")
    nis = np.array([one.nis for one in estimates])
    data |= variable("surprise", over, nis, "normalized innovation squared of the readings (NIS)")
    outlier = np.array([one.outlier for one in estimates])
    data |= variable("outlier", over, outlier, "NIS too large to be chance")
    forces = {name: one.force_n(recording.volts) for name, one in subject.baselines.items()}
    for name, force in forces.items():
        data |= variable(f"force_{name}_n", over, force, f"force by regression, {REGRESSIONS[name]}", units="N")
    known = np.full(time_s.shape, np.nan) if recording.force_n is None else recording.force_n
    data |= variable("known_force_n", over, known, "known force", units="N")
    found = events(time_s, estimate.force_n, press_n=press_n, release_n=release_n)
    true = events(time_s, np.nan_to_num(known), press_n=press_n, release_n=release_n)
    data |= _event_variables(found, true if recording.force_n is not None else None)
    consistent, misfit = _consistency(subject, recording, kalman, estimates, estimate.force_n)
    inside = (known >= estimate.low_n) & (known <= estimate.high_n)
    judged = np.isfinite(known)
    touching = (estimate.force_n if recording.force_n is None else known) >= TOUCH_N
    half_width = 0.5 * (estimate.high_n - estimate.low_n)[touching]
    attributes = {
        "rms_n": _rms(estimate.force_n - known),
        "coverage_95": _mean(inside[judged]),
        "touch_rms_n": _rms((estimate.force_n - known)[touching]),
        "touch_coverage_95": _mean(inside[touching & judged]),
        "half_width_n": float(np.median(half_width)) if half_width.size else float("nan"),
        "touch_open_above": _mean(np.isinf(half_width)),
        "chi2_per_dof": float(nis.sum() / max(sum(one.count for one in estimates), 1)),
        "outliers": float(outlier.mean()),
        "consistent": int(consistent),
        "misfit": misfit,
        "scene_digest": subject.scene_digest,
        "title": "force from volts",
    } | code_attributes()
    attributes |= {f"rms_{name}_n": _rms(force - known) for name, force in forces.items()}
    return xr.Dataset(data, variable("time", over, time_s, "time", units="s"), attributes)


def _event_variables(found: list[tuple[float, str]], true: list[tuple[float, str]] | None) -> dict[str, Any]:
    latency = []
    for time, kind in found:
        before = [t for t, other in true or [] if other == kind and t <= time]
        latency.append(time - before[-1] if before else np.nan)
    data = variable("event_time_s", "event", np.array([t for t, _ in found], float), "when the switch acts", units="s")
    data |= variable("event_kind", "event", np.array([kind for _, kind in found], dtype=str), "press or release")
    return data | variable(
        "event_latency_s", "event", np.array(latency, float), "time from the known force to the switch", units="s"
    )


def _consistency(
    subject: Subject, recording: Recording, kalman: KalmanFilter, estimates: list[PressureEstimate], force_n: Array
) -> tuple[bool, str]:
    """Whether the readings fit the subject; else in one word what it looks like."""
    outlier = np.array([one.outlier for one in estimates])
    before_n = np.interp(recording.time_s - SETTLING_S, recording.time_s, force_n)
    still = np.abs(force_n - before_n) < STILL_N
    outliers = float(outlier[still].mean()) if still.any() else 1.0
    usual = [one for one in estimates if not one.outlier]
    chi2 = sum(one.nis for one in usual) / max(sum(one.count for one in usual), 1)
    if outliers <= MOST_OUTLIERS and chi2 <= MOST_CHI2:
        return True, ""
    return False, _pattern(recording, kalman.model)


def _pattern(recording: Recording, model: StateSpace) -> str:
    """The likely cause of a misfit: more light on all alike, less of all in proportion, or neither."""
    off = np.nanmedian(recording.volts, axis=1) - (model.offset_v + model.rest_v)
    patterns = {
        "ambient light, or another person": np.ones_like(off),
        "a lifted sensor or other gain, or another person": model.rest_v,
    }
    for name, shape in patterns.items():
        along = (off @ shape) ** 2 / ((shape @ shape) * max(float(off @ off), 1e-30))
        if along > EXPLAINED:
            return name
    return "another person or place, or motion"


def _without_saturated(subject: Subject, recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with gaps where a converter was at its limit, and warnings of them."""
    saturated = recording.volts >= SATURATED * subject.table.range_v
    found = []
    for name, volts, full in zip(recording.names, recording.volts, saturated, strict=True):
        seen = int(np.isfinite(volts).sum())
        if full.sum() == seen:
            raise InputError(f"{recording.name}: column {name!r} is saturated throughout; lower the LED's power.")
        if full.any():
            found.append(f"{name} is saturated in {int(full.sum())} of {seen} samples, which count as gaps.")
    return replace(recording, volts=np.where(saturated, np.nan, recording.volts)), found


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else float("nan")


def _rms(off: Array) -> float:
    there = np.isfinite(off)
    return float(np.sqrt(np.mean(off[there] ** 2))) if there.any() else float("nan")
