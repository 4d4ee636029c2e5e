"""How far (9) and (8) are from one photodiode's traced light over one sweep: in all, in parts, and up to where."""

from dataclasses import dataclass

import numpy as np

from ...statistics import Z95, jackknife
from . import fits
from .state_sweep import StateSweep

MODELS, WAYS = ("taylor", "beer_lambert"), ("fitted", "predicted", "predicted_both")
PARTS = ("truncation", "one_path", "both_zones", "blood_scattering")
TOLERANCES = (0.01, 0.05)


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


def formula_errors(one: TracedSweep, sweep: StateSweep) -> dict[str, np.ndarray]:
    """All that is known of the formulas' errors, by name of the variable, with standard errors as NAME_stderr."""
    fitted_curve, fitted_path_mm = fits.exponential(one.own_mu_a, one.traced)
    readings = _readings(one, fitted_curve)
    part, part_stderr = _parts(one, readings)
    replicates = {
        "reading": one.traced,
        "swing": one.swing,
        "relative_swing": one.swing / one.traced[:, :1],
        "error": np.moveaxis((readings - one.traced) / one.swing, 2, 0),
        "range_error": np.moveaxis(_range_errors(one, readings), 2, 0),
        "alpha_d2": one.path_mm[:, one.own, None] * one.own_mu_a,
        "bed_alpha_d2": one.path_mm @ one.mu_a.T,
        "path_mm": one.path_mm,
        "path_fitted_mm": fitted_path_mm,
    }
    out = {name: values[0] for name, values in replicates.items()}
    out |= {f"{name}_stderr": jackknife(values) for name, values in replicates.items()}
    out |= {"model_reading": readings[:, :, 0], "part_error": part, "part_error_stderr": part_stderr}
    picked = {"swing": 0, "relative_swing": 0, "path_mm": one.own}
    for end in ("", "_stderr"):
        out |= {f"{name}{end}": out[f"{name}{end}"][k] for name, k in picked.items()}
    return out | _limits(out, sweep, one.own)


def _readings(one: TracedSweep, fitted_curve: np.ndarray) -> np.ndarray:
    """Readings by (9) and (8): fitted, with the own zone's mean path, with both zones', (way, model, r, t) float."""
    own = one.path_mm[:, one.own, None] * (one.own_mu_a - one.own_mu_a[0])
    both = one.path_mm @ (one.mu_a - one.mu_a[0]).T
    predicted = [[one.traced[:, :1] * factor for factor in (1 - depth, np.exp(-depth))] for depth in (own, both)]
    return np.stack([[fits.line(one.own_mu_a, one.traced), fitted_curve], *predicted])


def _parts(one: TracedSweep, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The error of (9), step by step from the formula to the trace, and standard errors, (way, part, t) float each."""
    (line, curve), (line_of_both, curve_of_both) = readings[1:]
    chain = [curve, one.alone, one.traced, one.scattered]
    missed = [fits.line(one.own_mu_a, level) - level for level in chain]
    fitted = [missed[0], *(b - a for a, b in zip(missed, missed[1:], strict=False))]
    predicted = [line - curve, curve - one.alone, one.alone - one.traced, one.traced - one.scattered]
    none = np.zeros_like(one.traced)
    knowing_both = [line_of_both - curve_of_both, curve_of_both - one.traced, none, predicted[3]]
    part = np.stack([fitted, predicted, knowing_both]) / one.swing
    stderr = jackknife(np.moveaxis(part, 2, 0))
    # The slope comes from traces of its own, so its error is independent.
    moved = (one.scattered - one.surer)[:1]
    by_slope = np.concatenate([fits.line(one.own_mu_a, -moved) + moved, moved, moved]) / one.swing[0]
    stderr[:, 3] = np.hypot(stderr[:, 3], by_slope)
    return part[:, :, 0], stderr


def _range_errors(one: TracedSweep, readings: np.ndarray) -> np.ndarray:
    """Largest error over the range from the start to each point, of the swing there, (way, model, r, t) float."""
    fitted = [fits.fitted_range_errors(one.own_mu_a, one.traced, name) for name in MODELS]
    return np.stack([fitted, *([fits.range_errors(model, one.traced) for model in way] for way in readings[1:])])


def _limits(found: dict[str, np.ndarray], sweep: StateSweep, own: int) -> dict[str, np.ndarray]:
    """How far each model holds, in the sweep's setting, in blood and in alpha D^2, with 95 % intervals."""
    shape = (len(WAYS), len(MODELS), len(TOLERANCES))
    # Crossings are counted in points, then turned into whatever is wanted.
    points = np.arange(len(sweep.setting), dtype=float)
    error, stderr = found["range_error"], found["range_error_stderr"]
    limits = [fits.limit(points, error[w, m], stderr[w, m], TOLERANCES[k]) for w, m, k in np.ndindex(shape)]
    limit, low, high, ends = (np.reshape(column, shape) for column in zip(*limits, strict=True))
    out, exact = {"limit_ends": ends}, np.zeros(len(points))
    curves = {
        "limit": (sweep.setting, exact),
        "limit_blood_fraction": (sweep.blood[:, own], exact),
        "limit_alpha_d2": (found["alpha_d2"], found["alpha_d2_stderr"]),
        "limit_bed_alpha_d2": (found["bed_alpha_d2"], found["bed_alpha_d2_stderr"]),
    }
    for name, (curve, error) in curves.items():
        out[name] = np.interp(limit, points, curve)
        both = np.stack([np.interp(end, points, curve) for end in (low, high)])
        spread = Z95 * np.interp(limit, points, error)
        out[f"{name}_low"], out[f"{name}_high"] = both.min(0) - spread, both.max(0) + spread
    return out
