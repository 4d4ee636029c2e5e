"""Where Taylor (9) and Beer-Lambert (8) hold against traced light, and what each of them leaves out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Unpack

import numpy as np
import xarray as xr

from ... import tissue
from ...errors import InputError, NotReachedError
from ...light import Progress, Transfer, optics, trace
from ...options import Requested, TraceOptions
from ...scene import Scene
from ..blood_states import largest_force_n, steady_blood, zones_of_photodiodes
from ..model_error.variants import validated
from ..replicates import LedReadings, read_led, stderr
from . import fits

Over = Literal["force", "blood", "saturation"]
OVER: tuple[Over, ...] = ("force", "blood", "saturation")
MODELS, WAYS = ("taylor", "beer_lambert"), ("fitted", "predicted", "predicted_both")
PARTS = ("truncation", "one_path", "both_zones", "blood_scattering")
TOLERANCES = (0.01, 0.05)
POINTS = 41
LARGEST_BLOOD_FRACTION, LEAST_SO2 = 0.1, 0.5
# The bed's scattering is traced at these factors, with this share of the photons, for the slope of ln reading.
SCATTERING_FACTORS, SCATTERING_SHARE = (0.7, 1.4), 0.25
# mu_s' of whole blood at a haematocrit of 45 %, computed by N. Bosschaart et al., Lasers Med. Sci. 29, 453 (2014):
# 1.34 per mm at 800 nm, 1.26 to 1.47 between 450 and 1000 nm.
BLOOD_REDUCED_SCATTERING_PER_MM = 1.34


@dataclass(frozen=True)
class Sweep:
    """States over which the models are judged; the first is where the predicted ones start from.

    setting : (t,) float. Force [N], blood fraction or saturation.
    blood : (t, zones) float. so2 : (t,) float.
    """

    over: Over
    setting: np.ndarray
    blood: np.ndarray
    so2: np.ndarray


def compare(
    scene: Scene,
    *,
    over: Sequence[Over] = ("force", "blood"),
    wavelengths_nm: Sequence[float] = (),
    progress: Callable[[Progress], None] | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Compare the paper's reduced optics with traced light, for every LED and photodiode of a finger scene.

    Parameters
    ----------
    over : what is swept: the steady force from 0 to the touch's largest, both zones' blood fraction from 0 to 10 %,
        the saturation from 1 to 0.5.
    wavelengths_nm : each LED is traced at these wavelengths too, as LED@wavelength. [nm]

    Returns: Dataset over sweep, led, photodiode and point; errors in percent of the traced swing over the sweep.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the accuracy went.
    """
    options = TraceOptions(**requested)
    if scene.finger is None:
        raise InputError("compare needs a [finger] scene; a [phantom] has no blood.")
    sweeps = [_sweep(scene, one) for one in dict.fromkeys(over)]
    if not sweeps:
        raise InputError(f"over is empty; choose from {', '.join(OVER)}.")
    scenes = [scene, *(_at_wavelength(scene, value) for value in dict.fromkeys(wavelengths_nm))]
    # A quarter of the photons twice, for the scattering, is half as much again.
    share = None if options.max_seconds is None else options.max_seconds / len(scenes) / (1 + 2 * SCATTERING_SHARE)
    options = replace(options, max_seconds=share)
    results, unmet = [], None
    for one in scenes:
        transfer, why = _traced(one, options, progress)
        slopes = _scattering_slopes(transfer, options, progress)
        results.append(_judge(transfer, sweeps, slopes, options.seed))
        unmet = unmet or why
    result = xr.concat(results, "led", data_vars="minimal", coords="minimal", compat="override", join="override")
    result.attrs = results[0].attrs
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _traced(
    scene: Scene, options: TraceOptions, progress: Callable[[Progress], None] | None
) -> tuple[Transfer, str | None]:
    try:
        return trace(scene, progress=progress, **options.fields), None
    except NotReachedError as error:
        if not isinstance(error.result, Transfer):
            raise
        return error.result, str(error)


def _at_wavelength(scene: Scene, wavelength_nm: float) -> Scene:
    """The same scene with every LED at another wavelength, named after it."""
    leds = [
        led.model_dump() | {"wavelength_nm": wavelength_nm, "name": f"{led.name[:30]}.{wavelength_nm:g}nm"}
        for led in scene.leds
    ]
    return validated(scene.model_dump() | {"leds": tuple(leds)})


def _sweep(scene: Scene, over: Over) -> Sweep:
    rest, so2, zones = scene.blood.rest_blood_fraction, scene.blood.so2, optics.zones(scene).count
    level, along = np.full((POINTS, zones), rest), np.linspace(0, 1, POINTS)
    if over == "blood":
        blood = along * LARGEST_BLOOD_FRACTION
        return Sweep(over, blood, np.repeat(blood[:, None], zones, 1), np.full(POINTS, so2))
    if over == "saturation":
        saturation = 1 - along * (1 - LEAST_SO2)
        return Sweep(over, saturation, level, saturation)
    if over != "force":
        raise InputError(f'over = "{over}" is not known; choose from {", ".join(OVER)}.')
    largest = largest_force_n(scene)
    if largest <= 0:
        raise InputError("touch: the force never leaves 0, so there is no range to compare over; give a force.")
    force = along * largest
    return Sweep(over, force, steady_blood(scene, force), np.full(POINTS, so2))


def _scattering_slopes(
    transfer: Transfer, options: TraceOptions, progress: Callable[[Progress], None] | None
) -> np.ndarray:
    """Slope of ln reading by ln of the bed's scattering at rest and its error, (2, led, photodiode); NaN if unseen."""
    photons = max(1, round(SCATTERING_SHARE * max(t.photons for t in transfer.traces)))
    log, square = [], []
    for k, factor in enumerate(SCATTERING_FACTORS):
        light = transfer.scene.light
        changed = light.model_copy(update={"bed_scattering": factor * light.bed_scattering})
        scene = transfer.scene.model_copy(update={"light": changed})
        limit = None if options.max_seconds is None else SCATTERING_SHARE * options.max_seconds
        fewer = replace(options, photons=photons, relative_error=None, max_seconds=limit, seed=options.seed + 1 + k)
        other, _ = _traced(scene, fewer, progress)
        rest = other.at()
        value, error = rest.detected_fraction.values, rest.detected_fraction_stderr.values
        with np.errstate(invalid="ignore", divide="ignore"):
            log.append(np.where(value > 0, np.log(value), np.nan))
            square.append((error / value) ** 2)
    span = np.log(SCATTERING_FACTORS[1] / SCATTERING_FACTORS[0])
    return np.stack([(log[1] - log[0]) / span, np.sqrt(square[0] + square[1]) / span])


def _judge(transfer: Transfer, sweeps: list[Sweep], slopes: np.ndarray, seed: int) -> xr.Dataset:
    """All results of one trace."""
    scene = transfer.scene
    zone = zones_of_photodiodes(scene)
    gathered: dict[str, list[Any]] = {}
    for i in range(len(scene.leds)):
        per_led = [_judge_sweep(transfer, i, sweep, zone, slopes[:, i], seed) for sweep in sweeps]
        for name in per_led[0]:
            gathered.setdefault(name, []).append(np.stack([one[name] for one in per_led]))
    data: dict[str, Any] = {}
    for name, values in gathered.items():
        dims, attributes = _VARIABLES[name.removesuffix("_stderr").removesuffix("_low").removesuffix("_high")]
        suffix = name.removeprefix(name.removesuffix("_stderr").removesuffix("_low").removesuffix("_high"))
        words = {"": "", "_stderr": "standard error of the ", "_low": "lower end of the 95 % interval of the "}
        text = words.get(suffix, "upper end of the 95 % interval of the ") + attributes[1]
        more = {"ancillary_variables": f"{name}_stderr"} if f"{name}_stderr" in gathered else {}
        data[name] = (("led", "sweep", *dims), np.stack(values), {"units": attributes[0], "long_name": text} | more)
    data["setting"] = (
        ("sweep", "point"),
        [s.setting for s in sweeps],
        {"units": "1", "long_name": "what is swept: force in N, blood fraction, or saturation"},
    )
    data["blood_fraction"] = (
        ("sweep", "zone", "point"),
        [s.blood.T for s in sweeps],
        {"units": "1", "long_name": "blood fraction of the nail bed"},
    )
    data["zone_of_photodiode"] = ("photodiode", zone, {"long_name": "blood zone above which it lies, 0 proximal"})
    data["scattering_slope"] = (
        ("led", "photodiode"),
        slopes[0],
        {
            "units": "1",
            "long_name": "slope of ln reading by ln of the bed's scattering",
            "ancillary_variables": "scattering_slope_stderr",
        },
    )
    data["scattering_slope_stderr"] = (("led", "photodiode"), slopes[1], {"units": "1", "long_name": "its error"})
    data["wavelength_nm"] = (
        "led",
        [led.wavelength_nm for led in scene.leds],
        {"units": "nm", "long_name": "peak wavelength"},
    )
    coords = {
        "led": list(transfer.leds),
        "photodiode": list(transfer.photodiodes),
        "sweep": [s.over for s in sweeps],
        "zone": ["proximal", "distal"],
        "model": list(MODELS),
        "way": list(WAYS),
        "part": list(PARTS),
        "within": list(TOLERANCES),
    }
    seconds = {"cpu_seconds": transfer.cpu_seconds, "wall_seconds": transfer.wall_seconds}
    return xr.Dataset(data, coords=coords, attrs=transfer.attributes() | seconds)


_PAIR, _CURVE, _LIMIT = ("photodiode",), ("photodiode", "point"), ("photodiode", "way", "model", "within")
_MODEL = ("photodiode", "way", "model", "point")
_VARIABLES: dict[str, tuple[tuple[str, ...], tuple[str, str]]] = {
    "reading": (_CURVE, ("1", "traced reading, as a fraction of the emitted power")),
    "model_reading": (_MODEL, ("1", "reading by the model, as a fraction of the emitted power")),
    "error": (_MODEL, ("percent", "model less trace, of the traced swing over the sweep")),
    "range_error": (_MODEL, ("percent", "largest error of the model over the range up to here, of the swing there")),
    "part_error": (("photodiode", "way", "part", "point"), ("percent", "part of the error of (9), of the swing")),
    "swing": (_PAIR, ("1", "traced reading's largest less its least, as a fraction of the emitted power")),
    "alpha_d2": (_CURVE, ("1", "alpha D^2 of the photodiode's own zone")),
    "bed_alpha_d2": (_CURVE, ("1", "alpha D^2 of all the blood in the bed, zone by zone")),
    "path_mm": (_PAIR, ("mm", "mean path in the photodiode's own zone where the sweep starts")),
    "path_fitted_mm": (_PAIR, ("mm", "mean path there that the (8) fitted over the sweep has in its place")),
    "limit": (_LIMIT, ("1", "setting up to which the model holds")),
    "limit_ends": (_LIMIT, ("1", "whether it fails within the sweep at all")),
    "limit_blood_fraction": (_LIMIT, ("1", "blood fraction of the photodiode's own zone there")),
    "limit_alpha_d2": (_LIMIT, ("1", "alpha D^2 of the photodiode's own zone there")),
    "limit_bed_alpha_d2": (_LIMIT, ("1", "alpha D^2 of all the blood in the bed there")),
}


def _judge_sweep(
    transfer: Transfer, led: int, sweep: Sweep, zone: np.ndarray, slopes: np.ndarray, seed: int
) -> dict[str, np.ndarray]:
    """Results of one LED over one sweep, photodiode by photodiode."""
    scene = transfer.scene
    wavelength, share = optics.spectrum(scene.leds[led])
    share = share * wavelength / np.sum(share * wavelength)
    mu_a = optics.absorption(scene, wavelength, blood_fraction=sweep.blood, so2=sweep.so2)
    states = [mu_a]
    for column in optics.bed_columns(transfer.scene):
        # Only this zone's blood changes.
        alone = np.repeat(mu_a[:1], POINTS, 0)
        alone[..., column] = mu_a[..., column]
        states.append(alone)
    blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, float(sweep.so2[0])))
    read = read_led(transfer, led, np.concatenate(states), blood, seed=seed)
    # One absorption for the whole line: that a line has many is an error of one path for all light.
    over_line = np.asarray(tissue.blood_mu_a_per_mm(wavelength, sweep.so2[:, None])) @ share
    x = sweep.blood * over_line[:, None]
    bed = tissue.optical_properties("bed", scene.leds[led].wavelength_nm)
    denser = (
        BLOOD_REDUCED_SCATTERING_PER_MM / (float(bed.mu_s_per_mm) * (1 - float(bed.g))) * (sweep.blood - sweep.blood[0])
    )
    # Where a photodiode saw nothing, or nothing changes, there is no answer: NaN.
    with np.errstate(invalid="ignore", divide="ignore"):
        rows = [_judge_photodiode(read, j, int(zone[j]), x, denser, slopes[:, j], sweep) for j in range(len(zone))]
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def _judge_photodiode(
    read: LedReadings,
    j: int,
    own: int,
    x: np.ndarray,
    denser: np.ndarray,
    slope: np.ndarray,
    sweep: Sweep,
) -> dict[str, np.ndarray]:
    """Results of one photodiode: the chain from (9) to the trace, each step with its error.

    x : (t, zones) float. Absorption of the blood in each zone, averaged over the LED's line. [mm^-1]
    denser : (t, zones) float. What the blood added since the first state scatters, relative to the bed.
    slope : (2,) float. Slope of ln reading by ln of the bed's scattering, and its error.
    """
    own_x, path = x[:, own], read.fall[:, j]
    traced, alone = read.reading[:, j, :POINTS], read.reading[:, j, (1 + own) * POINTS : (2 + own) * POINTS]
    depth = path[:, own, None] * (own_x - own_x[0])
    single, tangent = traced[:, :1] * np.exp(-depth), traced[:, :1] * (1 - depth)
    all_depth = path @ (x - x[0]).T
    single_all, tangent_all = traced[:, :1] * np.exp(-all_depth), traced[:, :1] * (1 - all_depth)
    # The slope is known for the whole bed; each zone gets the part of it that the light's path has there.
    denser_here = (denser @ path.T / path.sum(1)).T
    scattered, surer = (traced * np.exp(value * denser_here) for value in (slope[0], slope[0] + slope[1]))
    swing = np.ptp(traced, axis=1)[:, None]
    curves, a = fits.exponential(own_x, traced)
    model = np.stack([[fits.line(own_x, traced), curves], [tangent, single], [tangent_all, single_all]])
    error = (model - traced) / swing

    chain = [single, alone, traced, scattered]
    missed = [fits.line(own_x, level) - level for level in chain]
    fitted = [missed[0], *(b - a for a, b in zip(missed, missed[1:], strict=False))]
    predicted = [tangent - single, single - alone, alone - traced, traced - scattered]
    knowing_both = [tangent_all - single_all, single_all - traced, np.zeros_like(traced), predicted[3]]
    part = np.stack([fitted, predicted, knowing_both]) / swing
    part_stderr = stderr(np.moveaxis(part, 2, 0))
    # The slope comes from traces of its own, so its error is independent.
    moved = (scattered - surer)[:1]
    by_slope = np.concatenate([fits.line(own_x, -moved) + moved, moved, moved]) / swing[0]
    part_stderr[:, 3] = np.hypot(part_stderr[:, 3], by_slope)

    ranges = np.stack(
        [
            [fits.fitted_range_errors(own_x, traced, name) for name in MODELS],
            [fits.range_errors(one, traced) for one in (tangent, single)],
            [fits.range_errors(one, traced) for one in (tangent_all, single_all)],
        ]
    )
    alpha_d2, bed_alpha_d2 = path[:, own, None] * own_x, path @ x.T
    out = {
        "reading": traced[0],
        "reading_stderr": stderr(traced),
        "swing": swing[0, 0],
        "swing_stderr": stderr(swing)[0],
        "model_reading": model[:, :, 0],
        "error": 100 * error[:, :, 0],
        "error_stderr": 100 * stderr(np.moveaxis(error, 2, 0)),
        "range_error": 100 * ranges[:, :, 0],
        "range_error_stderr": 100 * stderr(np.moveaxis(ranges, 2, 0)),
        "part_error": 100 * part[:, :, 0],
        "part_error_stderr": 100 * part_stderr,
        "alpha_d2": alpha_d2[0],
        "alpha_d2_stderr": stderr(alpha_d2),
        "bed_alpha_d2": bed_alpha_d2[0],
        "bed_alpha_d2_stderr": stderr(bed_alpha_d2),
        "path_mm": path[0, own],
        "path_mm_stderr": stderr(path)[own],
        "path_fitted_mm": a[0],
        "path_fitted_mm_stderr": stderr(a),
    }
    return out | _limits(out, sweep, own)


def _limits(found: dict[str, np.ndarray], sweep: Sweep, own: int) -> dict[str, np.ndarray]:
    """How far each model holds, in the sweep's setting, in blood and in alpha D^2, with 95 % intervals."""
    shape = (len(WAYS), len(MODELS), len(TOLERANCES))
    limit, low, high = (np.zeros(shape) for _ in range(3))
    ends = np.zeros(shape, bool)
    # Crossings are counted in points, then turned into whatever is wanted.
    points = np.arange(POINTS, dtype=float)
    for w, m, k in np.ndindex(shape):
        limit[w, m, k], low[w, m, k], high[w, m, k], ends[w, m, k] = fits.limit(
            points, found["range_error"][w, m], found["range_error_stderr"][w, m], 100 * TOLERANCES[k]
        )
    out: dict[str, np.ndarray] = {"limit_ends": ends}
    curves = {
        "limit": (sweep.setting, np.zeros(POINTS)),
        "limit_blood_fraction": (sweep.blood[:, own], np.zeros(POINTS)),
        "limit_alpha_d2": (found["alpha_d2"], found["alpha_d2_stderr"]),
        "limit_bed_alpha_d2": (found["bed_alpha_d2"], found["bed_alpha_d2_stderr"]),
    }
    for name, (curve, error) in curves.items():
        out[name] = np.interp(limit, points, curve)
        both = np.stack([np.interp(end, points, curve) for end in (low, high)])
        spread = fits.Z95 * np.interp(limit, points, error)
        out[f"{name}_low"], out[f"{name}_high"] = both.min(0) - spread, both.max(0) + spread
    return out
