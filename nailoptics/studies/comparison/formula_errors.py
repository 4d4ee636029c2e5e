"""How far Taylor (9) and Beer-Lambert (8) are from traced light over one sweep: in all, in parts, and up to where."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...paper.reduced_optics import FittedCurve, fit_curve
from ...statistics import Z95, jackknife

Over = Literal["force", "blood", "saturation"]
MODELS, WAYS = ("taylor", "beer_lambert"), ("fitted", "predicted", "predicted_both")
PARTS = ("truncation", "one_path", "both_zones", "blood_scattering")
TOLERANCES = (0.01, 0.05)


@dataclass(frozen=True)
class StateSweep:
    """States over which the models are evaluated; the first is where the predicted ones start from.

    setting : (t,) float. Force [N], blood fraction or saturation.
    blood : (t, zones) float. so2 : (t,) float.
    """

    over: Over
    setting: np.ndarray
    blood: np.ndarray
    so2: np.ndarray


@dataclass(frozen=True)
class TracedSweep:
    """One photodiode's traced light over a sweep, (r, t) float each; replicates (r) are those of `read_led`.

    own : index of the zone above which it lies.
    mu_a : (t, zones) float. Absorption of the blood in each zone, averaged over the LED's line. [mm^-1]
    path_mm : (r, zones) float. Mean path in each zone where the sweep starts.
    traced : readings.
    alone : readings if only the blood of its own zone changes.
    scattered, surer : readings if the blood scatters too, and if the slope of that is larger by its error.
    """

    own: int
    mu_a: np.ndarray
    path_mm: np.ndarray
    traced: np.ndarray
    alone: np.ndarray
    scattered: np.ndarray
    surer: np.ndarray

    @property
    def own_mu_a(self) -> np.ndarray:
        """Absorption of the blood in its own zone, (t,) float. [mm^-1]"""
        return np.asarray(self.mu_a[:, self.own])

    @property
    def swing(self) -> np.ndarray:
        """Largest less least reading, (r, 1) float."""
        return np.asarray(np.ptp(self.traced, axis=1)[:, None])


def formula_errors(pair: TracedSweep, sweep: StateSweep) -> dict[str, np.ndarray]:
    """All that is known of the formulas' errors, by name of the variable, with standard errors as NAME_stderr."""
    fit, x = _curve(pair.own_mu_a, pair.traced[0], curved=True), pair.own_mu_a
    readings = _readings(pair, fit.replicates(x, pair.traced))
    part, part_stderr = _parts(pair, readings)
    fitted = [fitted_range_errors(pair.own_mu_a, pair.traced, curved=name == "beer_lambert") for name in MODELS]
    predicted = [[range_errors(model, pair.traced) for model in way] for way in readings[1:]]
    replicates = {
        "reading": pair.traced,
        "swing": pair.swing[:, 0],
        "relative_swing": pair.swing[:, 0] / pair.traced[:, 0],
        "error": np.moveaxis((readings - pair.traced) / pair.swing, 2, 0),
        "range_error": np.moveaxis(np.stack([fitted, *predicted]), 2, 0),
        "alpha_d2": pair.path_mm[:, pair.own, None] * pair.own_mu_a,
        "bed_alpha_d2": pair.path_mm @ pair.mu_a.T,
        "path_mm": pair.path_mm[:, pair.own],
        "path_fitted_mm": fit.curvature_of_replicates(x, pair.traced),
    }
    out = {name: values[0] for name, values in replicates.items()}
    out |= {f"{name}_stderr": jackknife(values) for name, values in replicates.items()}
    out |= {"model_reading": readings[:, :, 0], "part_error": part, "part_error_stderr": part_stderr}
    return out | _limits(out, sweep, pair.own)


def _readings(pair: TracedSweep, fitted_curve: np.ndarray) -> np.ndarray:
    """Readings by Taylor (9) and Beer-Lambert (8), (way, model, r, t) float: fitted, with the mean path in the own
    zone, and with those in both zones.
    """
    own_depth = pair.path_mm[:, pair.own, None] * (pair.own_mu_a - pair.own_mu_a[0])
    both = pair.path_mm @ (pair.mu_a - pair.mu_a[0]).T
    predicted = [[pair.traced[:, :1] * factor for factor in (1 - depth, np.exp(-depth))] for depth in (own_depth, both)]
    return np.stack([[_line(pair, pair.traced), fitted_curve], *predicted])


def _curve(x: np.ndarray, y: np.ndarray, *, curved: bool) -> FittedCurve:
    """The curve of Beer-Lambert (8), or the line of Taylor (9), that fits readings over the absorption of the blood."""
    return fit_curve(x, y, curved=curved, scale=float(np.ptp(x)))


def _line(pair: TracedSweep, rows: np.ndarray) -> np.ndarray:
    """Straight lines through rows over the absorption of the blood in its own zone, (r, t) float."""
    return _curve(pair.own_mu_a, rows[0], curved=False).replicates(pair.own_mu_a, rows)


def _parts(pair: TracedSweep, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The error of Taylor (9), step by step from formula to trace, and standard errors, (way, part, t) float each."""
    (line, curve), (line_of_both, curve_of_both) = readings[1:]
    chain = [curve, pair.alone, pair.traced, pair.scattered]
    missed = [_line(pair, level) - level for level in chain]
    fitted = [missed[0], *(b - a for a, b in zip(missed, missed[1:], strict=False))]
    predicted = [line - curve, curve - pair.alone, pair.alone - pair.traced, pair.traced - pair.scattered]
    none = np.zeros_like(pair.traced)
    knowing_both = [line_of_both - curve_of_both, curve_of_both - pair.traced, none, predicted[3]]
    part = np.stack([fitted, predicted, knowing_both]) / pair.swing
    stderr = jackknife(np.moveaxis(part, 2, 0))
    # The slope comes from traces of its own, so its error is independent.
    moved = (pair.scattered - pair.surer)[:1]
    by_slope = np.concatenate([_line(pair, -moved) + moved, moved, moved]) / pair.swing[0]
    stderr[:, 3] = np.hypot(stderr[:, 3], by_slope)
    return part[:, :, 0], stderr


def _limits(errors: dict[str, np.ndarray], sweep: StateSweep, own_zone: int) -> dict[str, np.ndarray]:
    """How far each model holds, in the sweep's setting, in blood and in alpha D^2, with 95 % intervals."""
    shape = (len(WAYS), len(MODELS), len(TOLERANCES))
    # Crossings are counted in points, then converted to each measure.
    points = np.arange(len(sweep.setting), dtype=float)
    error, stderr = errors["range_error"], errors["range_error_stderr"]
    limits = [limit(points, error[w, m], stderr[w, m], TOLERANCES[k]) for w, m, k in np.ndindex(shape)]
    at, low, high, ends = (np.reshape(column, shape) for column in zip(*limits, strict=True))
    out, exact = {"limit_ends": ends}, np.zeros(len(points))
    curves = {
        "limit": (sweep.setting, exact),
        "limit_blood_fraction": (sweep.blood[:, own_zone], exact),
        "limit_alpha_d2": (errors["alpha_d2"], errors["alpha_d2_stderr"]),
        "limit_bed_alpha_d2": (errors["bed_alpha_d2"], errors["bed_alpha_d2_stderr"]),
    }
    for name, (curve, error) in curves.items():
        out[name] = np.interp(at, points, curve)
        both = np.stack([np.interp(end, points, curve) for end in (low, high)])
        spread = Z95 * np.interp(at, points, error)
        out[f"{name}_low"], out[f"{name}_high"] = both.min(0) - spread, both.max(0) + spread
    return out


def range_errors(model: np.ndarray, traced: np.ndarray) -> np.ndarray:
    """Largest distance of a model from the trace over each range that starts at the first point, (r, t) float.

    In parts of the trace's swing over the same range; at the first point it is that at the second.
    """
    worst = np.maximum.accumulate(np.abs(model - traced), 1)
    swing = np.maximum.accumulate(traced, 1) - np.minimum.accumulate(traced, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.where(swing > 0, worst / swing, 0.0)
    error[:, 0] = error[:, min(1, error.shape[1] - 1)]
    return error


def fitted_range_errors(x: np.ndarray, traced: np.ndarray, *, curved: bool) -> np.ndarray:
    """The same for a model that is fitted anew to each range, (r, t) float; 0 while it has as many constants."""
    error = np.zeros_like(traced)
    for end in range(4 if curved else 3, len(x) + 1):
        some, y = x[:end], traced[:, :end]
        swing = np.ptp(y, axis=1)
        missed = np.abs(_curve(some, y[0], curved=curved).replicates(some, y) - y).max(1)
        with np.errstate(invalid="ignore", divide="ignore"):
            error[:, end - 1] = np.where(swing > 0, missed / swing, 0.0)
    return error


def crossing(setting: np.ndarray, error: np.ndarray, tolerance: float) -> tuple[float, bool]:
    """Setting at which an error first exceeds a tolerance, and True; the last setting and False if it never does."""
    over = np.flatnonzero(~(error <= tolerance))
    if not len(over):
        return float(setting[-1]), False
    i = int(over[0])
    if i == 0 or not np.isfinite(error[i]):
        return float(setting[max(i - 1, 0)]), True
    part = (tolerance - error[i - 1]) / (error[i] - error[i - 1])
    return float(setting[i - 1] + part * (setting[i] - setting[i - 1])), True


def limit(
    setting: np.ndarray, error: np.ndarray, stderr: np.ndarray, tolerance: float
) -> tuple[float, float, float, bool]:
    """Setting up to which an error stays within a tolerance.

    Returns: value, lower and upper end of its 95 % interval, and whether the error exceeds the tolerance at all.
    """
    value, ends = crossing(setting, error, tolerance)
    first, _ = crossing(setting, error + Z95 * stderr, tolerance)
    last, _ = crossing(setting, error - Z95 * stderr, tolerance)
    return value, first, last, ends
