"""Where Taylor (9) and Beer-Lambert (8) hold against traced light, what each leaves out, and the verdict on one."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Unpack, get_args

import numpy as np
import xarray as xr

from .. import tissue
from ..errors import InputError, as_far_as_reached, unless_cut_off
from ..hemodynamics.blood import saturation
from ..hemodynamics.for_scene import steady_blood
from ..hemodynamics.touch import largest_force_n
from ..hemodynamics.zones import capillary_zones
from ..light import ProgressCallback, Transfer, optics, trace
from ..light.transfer.series import read_replicates
from ..options import Over, Requested, TraceOptions
from ..paper.reduced_optics import FittedCurve, fit_curve
from ..scene import Scene, SceneIn, as_scene
from ..statistics import Z95, jackknife, quotient, seed_of
from ..variables import Estimate, described, stacked_rows

OVER: tuple[Over, ...] = get_args(Over)
MODELS, WAYS = ("taylor", "beer_lambert"), ("fitted", "predicted", "predicted_both")
PARTS = ("truncation", "one_path", "both_zones", "blood_scattering")
TOLERANCES = (0.01, 0.05)
POINTS = 41
LARGEST_BLOOD_FRACTION, LEAST_SO2 = 0.1, 0.5
# The bed's scattering is traced at these factors, with this share of the photons, for the slope of ln reading.
SCATTERING_FACTORS, SCATTERING_SHARE = (0.7, 1.4), 0.25
# A verdict is given with this probability.
SURE = 0.95


@dataclass(frozen=True)
class StateSweep:
    """States over which the models are evaluated; the first is where the predicted ones start from.

    setting : (t,) float. Force [N], blood fraction or saturation.
    blood, so2 : (t, zones) float. Of each zone.
    """

    over: Over
    setting: np.ndarray
    blood: np.ndarray
    so2: np.ndarray


@dataclass(frozen=True)
class TracedSweep:
    """One photodiode's traced light over a sweep, (r, t) float each; replicates (r) are those of `read_replicates`.

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


def compare(
    scene: SceneIn,
    *,
    over: Sequence[Over] = ("force", "blood"),
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Compare the paper's reduced optics with traced light, for every LED and photodiode of a finger scene.

    over : what is swept: the steady force from 0 to the touch's largest, both zones' blood fraction from 0 to 10 %,
        the saturation from 1 to 0.5.

    Returns: Dataset over sweep, led, photodiode and point; errors as fractions of the traced swing over the sweep.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the accuracy went.
    """
    scene = as_scene(scene)
    options = TraceOptions(**requested)
    if scene.finger is None:
        raise InputError("compare needs a [finger] scene; a [phantom] has no blood.")
    sweeps = [state_sweep(scene, each) for each in dict.fromkeys(over)]
    if not sweeps:
        raise InputError(f"over is empty; choose from {', '.join(OVER)}.")
    deadline, limited = time.perf_counter() + (options.max_seconds or math.inf), options
    if options.max_seconds is not None:
        # A quarter of the photons twice, for the scattering, is half as much again.
        limited = replace(options, max_seconds=options.max_seconds / (1 + 2 * SCATTERING_SHARE))
    transfer, why = as_far_as_reached(trace, scene, progress=progress, **limited.fields)
    unmet = str(why) if why else None
    slopes = np.full((2, len(scene.leds), len(transfer.photodiodes)), np.nan)
    if time.perf_counter() < deadline:
        slopes = _scattering_slopes(transfer, limited, progress)
    elif not unmet:
        unmet = "max_seconds ended the comparison before the bed's scattering was traced; its part is not known."
    return unless_cut_off(compare_transfer(transfer, sweeps, slopes), unmet)


def state_sweep(scene: Scene, over: Over) -> StateSweep:
    """The steady force from 0 to the touch's largest, the blood fraction of all zones, or the saturation."""
    along, every = np.linspace(0, 1, POINTS), np.ones((POINTS, scene.zone_count))
    if over == "blood":
        setting = along * LARGEST_BLOOD_FRACTION
        blood = setting[:, None] * every
        return StateSweep(over, setting, blood, saturation(scene.blood, blood))
    if over == "saturation":
        setting = 1 - along * (1 - LEAST_SO2)
        return StateSweep(over, setting, scene.blood.rest_blood_fraction * every, setting[:, None] * every)
    if over != "force":
        raise InputError(f'over = "{over}" is unknown; choose from {", ".join(OVER)}.')
    largest = largest_force_n(scene)
    if largest <= 0:
        raise InputError("touch: the force never leaves 0, so there is no range to compare over; give a force.")
    blood = steady_blood(scene, along * largest)
    return StateSweep(over, along * largest, blood, saturation(scene.blood, blood))


def _scattering_slopes(transfer: Transfer, options: TraceOptions, progress: ProgressCallback | None) -> np.ndarray:
    """Slope of ln reading by ln of the bed's scattering at rest and its error, (2, led, photodiode) float."""
    photons = max(1, round(SCATTERING_SHARE * max(t.photons for t in transfer.traces)))
    limit = None if options.max_seconds is None else SCATTERING_SHARE * options.max_seconds
    fewer = replace(options, photons=photons, relative_error=None, max_seconds=limit)
    finger, log, square = transfer.scene.fingertip, [], []
    for k, factor in enumerate(SCATTERING_FACTORS):
        changed = finger.model_copy(update={"bed_scattering": factor * finger.bed_scattering})
        scene = transfer.scene.model_copy(update={"finger": changed})
        # Streams of their own, which no neighbouring seed shares; a trace takes seeds below 2^63.
        sampling = replace(fewer, seed=seed_of(options.seed, k) >> 1).fields
        rest = as_far_as_reached(trace, scene, progress=progress, **sampling)[0].at()
        value, error = rest.detected_fraction.values, rest.detected_fraction_stderr.values
        log.append(np.log(np.where(value > 0, value, np.nan)))
        square.append(quotient(error, value) ** 2)
    span = np.log(SCATTERING_FACTORS[1] / SCATTERING_FACTORS[0])
    return np.stack([(log[1] - log[0]) / span, np.sqrt(square[0] + square[1]) / span])


def compare_transfer(transfer: Transfer, sweeps: list[StateSweep], slopes: np.ndarray) -> xr.Dataset:
    """Compare one trace with the formulas over every sweep.

    slopes : (2, led, photodiode) float. Slope of ln reading by ln of the bed's scattering, and its error.
    """
    scene = transfer.scene
    zone = np.array(scene.zones_of_photodiodes)
    errors = [[_led_errors(transfer, i, s, zone, slopes[:, i]) for s in sweeps] for i in range(len(scene.leds))]
    gathered = stacked_rows([stacked_rows(by_sweep) for by_sweep in errors])
    of_sweeps = ["N" if s.over == "force" else "1" for s in sweeps]
    names = (name for name in gathered if not name.endswith("_stderr"))
    data = described(
        __package__,
        **{name: Estimate(gathered[name], gathered.get(f"{name}_stderr")) for name in names},
        setting=[s.setting for s in sweeps],
        setting_units=of_sweeps,
        blood_fraction=[s.blood.T for s in sweeps],
        zone_of_photodiode=zone,
        wavelength_nm=[led.wavelength_nm for led in scene.leds],
    )
    # CF: a variable has one unit; where it has another in each sweep, it says where to look.
    comment = "each sweep in the unit that setting_units has for it"
    elsewhere = {"ancillary_variables": "setting_units", "comment": comment}
    for name in ("setting", "limit", "limit_low", "limit_high"):
        del data[name][2]["units"]
        data[name][2].update({"units": of_sweeps[0]} if len(set(of_sweeps)) == 1 else elsewhere)
    coords: dict[str, Any] = {"led": transfer.leds, "photodiode": transfer.photodiodes}
    coords |= {"zone": capillary_zones(scene).names, "sweep": [s.over for s in sweeps], "model": MODELS, "way": WAYS}
    coords |= {"part": PARTS, "within": TOLERANCES}
    coords = {name: list(labels) for name, labels in coords.items()}
    about = {"title": "nailoptics: reduced optics against traced light", "reused": int(transfer.reused)}
    about |= {name: getattr(transfer, name) for name in ("cpu_seconds", "wall_seconds")}
    return xr.Dataset(data, coords, transfer.attributes() | about)


def _led_errors(
    transfer: Transfer, led: int, sweep: StateSweep, zone: np.ndarray, slopes: np.ndarray
) -> dict[str, np.ndarray]:
    """Results of one LED over one sweep, photodiode by photodiode."""
    scene = transfer.scene
    wavelength, share = optics.detected_spectrum(scene.leds[led], scene.elements)
    wavelength_nm, share = scene.leds[led].wavelength_nm, share / share.sum(1, keepdims=True)
    blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, float(sweep.so2[0, 0])))
    reading, path_mm = read_replicates(transfer, led, _absorption(transfer, wavelength, sweep), blood)
    # One absorption for the whole line: that a line has many is an error of one path for all light.
    over_line = np.asarray(tissue.blood_mu_a_per_mm(wavelength, sweep.so2[..., None])) @ share.T
    contrast = tissue.blood_scattering_contrast(wavelength_nm, bed_scattering=scene.fingertip.bed_scattering)
    denser = contrast * (sweep.blood - sweep.blood[0])
    rows = []
    # Where a photodiode saw nothing, or nothing changes, there is no answer: NaN.
    with np.errstate(invalid="ignore", divide="ignore"):
        for j, bed in enumerate(zone):
            path = path_mm[:, j]
            traced, *alone = np.split(reading[:, j], 1 + len(optics.bed_columns(scene)), axis=1)
            # The slope is known for the whole bed; each zone gets the part of it that the light's path has there.
            denser_here = (denser @ path.T / path.sum(1)).T
            slope, error = slopes[:, j]
            scattered, surer = (traced * np.exp(value * denser_here) for value in (slope, slope + error))
            pair = TracedSweep(int(bed), sweep.blood * over_line[..., j], path, traced, alone[bed], scattered, surer)
            rows.append(formula_errors(pair, sweep))
    return stacked_rows(rows)


def _absorption(transfer: Transfer, wavelength: np.ndarray, sweep: StateSweep) -> np.ndarray:
    """Absorption over the line in all states, then in those where only one zone's blood changes, zone by zone."""
    so2 = sweep.so2[:, 0] if sweep.over == "saturation" else None  # or the scene's own, zone by zone
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=sweep.blood, so2=so2)
    columns = np.arange(mu_a.shape[-1])
    alone = [np.where(columns == column, mu_a, mu_a[:1]) for column in optics.bed_columns(transfer.scene)]
    return np.concatenate([mu_a, *alone])


def formula_errors(pair: TracedSweep, sweep: StateSweep) -> dict[str, np.ndarray]:
    """All that is known of the formulas' errors, by name of the variable, with standard errors as NAME_stderr."""
    fit, x = _curve(pair.own_mu_a, pair.traced[0], curved=True), pair.own_mu_a
    # By Taylor (9) and Beer-Lambert (8), (way, model, r, t): fitted, with the mean path in the own zone, and with both.
    own_depth = pair.path_mm[:, pair.own, None] * (pair.own_mu_a - pair.own_mu_a[0])
    both = pair.path_mm @ (pair.mu_a - pair.mu_a[0]).T
    lines = [[pair.traced[:, :1] * factor for factor in (1 - depth, np.exp(-depth))] for depth in (own_depth, both)]
    readings = np.stack([[_line(pair, pair.traced), fit.replicates(x, pair.traced)], *lines])
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
    """Largest distance of a model from the trace over each range that starts at the first point, (r, t) float. In parts
    of the trace's swing over the same range; at the first point it is that at the second."""
    worst = np.maximum.accumulate(np.abs(model - traced), 1)
    swing = np.maximum.accumulate(traced, 1) - np.minimum.accumulate(traced, 1)
    error = np.where(swing > 0, quotient(worst, swing), 0.0)
    error[:, 0] = error[:, min(1, error.shape[1] - 1)]
    return error


def fitted_range_errors(x: np.ndarray, traced: np.ndarray, *, curved: bool) -> np.ndarray:
    """`range_errors` of a model fitted anew to each range, (r, t) float; 0 while it has as many constants as points."""
    error = np.zeros_like(traced)
    for end in range(4 if curved else 3, len(x) + 1):
        some, y = x[:end], traced[:, :end]
        swing = np.ptp(y, axis=1)
        missed = np.abs(_curve(some, y[0], curved=curved).replicates(some, y) - y).max(1)
        error[:, end - 1] = np.where(swing > 0, quotient(missed, swing), 0.0)
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
    """Setting up to which an error stays within a tolerance, lower and upper end of its 95 % interval, and whether the
    error exceeds the tolerance at all."""
    value, ends = crossing(setting, error, tolerance)
    first, last = (crossing(setting, error + side * Z95 * stderr, tolerance)[0] for side in (1, -1))
    return value, first, last, ends


@dataclass(frozen=True)
class Verdict:
    """Whether a fitted model stays within a tolerance for every LED and photodiode over a whole sweep.

    sure : probability with which it does so, or does not, by the traces' noise; readings : how many were compared.
    surely_within, undecided : how many of these stay within it, each with 95 % probability, and of how many it is open.
    worst_error : of the reading that is furthest off, as a fraction of its swing.
    worst_low, worst_high : what the largest error of all readings lies between, 95 % sure.
    """

    outcome: Literal["met", "missed", "undecided"]
    model: str
    tolerance: float
    worst_error: float
    worst_low: float
    worst_high: float
    led: str
    photodiode: str
    sweep: str
    sure: float
    readings: int
    surely_within: int
    undecided: int


def verdict(result: xr.Dataset, tolerance: float, *, model: str = "taylor") -> Verdict:
    """Judge a fitted model over the force, or over the first sweep where the force was not swept.

    Met if even the error that is nearest to the tolerance lies below it, with a probability of 95 %; missed if one lies
    above it, with that probability after Bonferroni's correction: of many readings some lie above it by chance.
    """
    from scipy.special import ndtr, ndtri

    sweep = "force" if "force" in result.sweep.values else str(result.sweep.values[0])
    end = result.sel(sweep=sweep, way="fitted", model=model).isel(point=-1)
    error, stderr = end.range_error.values, end.range_error_stderr.values
    # Of a photodiode that saw nothing nothing is known.
    below = np.where(np.isfinite(error), ndtr(quotient(tolerance - error, stderr)), 0.5)
    met, missed = float(below.min()), max(0.0, 1 - float(error.size * below.min()))
    i, j = np.unravel_index(int(np.where(np.isfinite(error), error, -np.inf).argmax()), error.shape)
    # Of many readings one lies above the largest error by chance, so that the lower end has Bonferroni's correction.
    low, high = error - float(ndtri(1 - (1 - SURE) / 2 / error.size)) * stderr, error + Z95 * stderr
    known = np.isfinite(low)
    return Verdict(
        outcome="missed" if missed >= SURE else "met" if met >= SURE else "undecided",
        model=model,
        tolerance=tolerance,
        worst_error=float(error[i, j]),
        worst_low=float(np.max(low, where=known, initial=0.0)),
        worst_high=float(np.max(high)) if known.all() else math.inf,
        led=str(result.led.values[i]),
        photodiode=str(result.photodiode.values[j]),
        sweep=sweep,
        sure=max(met, missed),
        readings=error.size,
        surely_within=int(np.sum(below >= SURE)),
        undecided=int(np.sum(np.abs(below - 0.5) < SURE - 0.5)),
    )
