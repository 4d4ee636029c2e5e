"""Pages of a calibration and of a prediction."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..io import write_text
from ..scene import parse_scene
from . import force_figures
from .html import document, escaped, figure, section, small, table
from .numbers import significant, with_error

FORCE = (
    "Force told from the readings, with its 95 % interval. Where the vessels are shut a harder touch reads the same: "
    "the interval is open above, which the bar at the top shows."
)
PROFILES = (
    "Squared residuals beyond those of the best fit while one factor is held and all others follow (coloured), and "
    "what they were, were the fit quadratic (grey); between the crossings with the line lie 95 %."
)
SHARE = (
    "Top: how much of the force presses proximally, with its 95 % interval; where that spans everything, the place "
    "cannot be told. Middle: the heartbeat and slower waves that the filter follows beside the touch. Bottom: how far "
    "each sample lies from its prediction; about as much as there are readings is usual."
)


def write_calibration_page(result: xr.Dataset, summary: dict[str, Any], path: Path) -> None:
    """Write the page of a calibration, whole or not at all; raises WriteError.

    summary : what `calibration_summary` says of the result.
    """
    cards = [
        (f"{significant(1e3 * summary['rms_n'], 2)} mN", "error of the force told from these recordings, rms"),
        (significant(summary["chi2_per_dof"], 2), "squared residuals over what their own scatter explains"),
        (f"× {significant(summary['widening'], 2)}", "width of intervals over the usual, as these recordings need it"),
    ]
    caption = (
        "Each reading less its start: recorded (wide, coloured) and fitted (thin, dark), a column for each recording."
    )
    rest = (
        "What the fit leaves of each reading, coloured from proximal (warm) to distal (cool). Noise and heartbeat are "
        "meant to stay; what follows the touch is what the model misses, and intervals are as much wider."
    )
    text = document(
        kicker="calibration",
        title="A person's sensor, calibrated",
        lead=f"{len(result.attrs['recordings'])} recordings of a known force, "
        f"{result.sizes['reading']} readings, {result.sizes['sample']} samples.",
        warnings=summary["warnings"],
        cards=cards,
        body=[
            section(
                "Recorded and fitted",
                figure(force_figures.fit(result), "fit", caption),
                figure(force_figures.left_over(result), "left", rest),
            ),
            section(
                "The person",
                _factors_table(summary),
                *_profiles(result),
                small(
                    "Known by the recording is a factor whose spread fell to less than 0.7 of what it was before; any "
                    "other keeps its prior, and its error is carried into intervals."
                ),
            ),
            section(
                "The readings",
                _readings_table(result, summary),
                small("Gain and offset are over what the scene's own light and electronics would read."),
            ),
        ],
        attributes=result.attrs,
    )
    write_text(path, text)


def _profiles(result: xr.Dataset) -> list[str]:
    """Where the fit is not quadratic in a factor: the factor's profile likelihood."""
    bent = [name.replace("_", " ") for name in result.attrs["bent_factors"]]
    if not bent:
        return [small("In every factor the fit is quadratic to a quarter of a standard error: its error is symmetric.")]
    return [
        small(
            f"The fit is not quadratic in {escaped(', '.join(bent))}: there the curve, not the error, tells the range."
        ),
        figure(force_figures.profiles(result), "profiles", PROFILES),
    ]


def _factors_table(summary: dict[str, Any]) -> str:
    """What the recordings say of the person, beside what was known before."""
    factors = [
        [
            escaped(name.replace("_", " ")),
            with_error(one["value"], one["stderr"]),
            escaped(one["prior"].removeprefix("lognormal about 1, ")),
            "recording" if one["informed"] else "prior",
            escaped(one["what"]),
        ]
        for name, one in summary["parameters"].items()
    ]
    return table(["Factor on the scene's", "Value", "Before, about 1", "Known by", "What it is"], factors)


def _readings_table(result: xr.Dataset, summary: dict[str, Any]) -> str:
    """Gain, offset, noise and headroom of each reading."""
    limit_v = parse_scene(str(result.attrs["scene"]), name="the scene").electronics.adc_range_v
    most = f"Largest, of {limit_v:g} V [V]"
    rows = [
        [
            escaped(name),
            with_error(one["gain"], one["gain_stderr"]),
            with_error(1e3 * one["offset_v"], 1e3 * one["offset_stderr_v"]),
            significant(1e3 * one["residual_rms_v"], 2),
            significant(1e6 * one["noise_v"], 2),
            significant(float(np.nanmax(result.volts.sel(reading=name))), 3),
        ]
        for name, one in summary["readings"].items()
    ]
    return table(["Reading", "Gain", "Offset [mV]", "Left over, rms [mV]", "Noise, rms [µV]", most], rows)


def write_prediction_page(result: xr.Dataset, summary: dict[str, Any], path: Path) -> None:
    """Write the page of a prediction, whole or not at all; raises WriteError.

    summary : what `prediction_summary` says of the result.
    """
    warnings = list(summary["warnings"])
    if not summary["consistent"]:
        warnings.append(
            f"These readings do not fit the subject: {summary['misfit']}. The force may be wrong; calibrate again."
        )
    is_open = float(np.isinf(result.force_high_n.values).mean())
    cards = [(f"{significant(summary['open_above_n'], 2)} N", "force from which a touch may be any harder")]
    if np.isfinite(summary["rms_n"]):
        cards = [
            (f"{significant(1e3 * summary['rms_n'], 2)} mN", "error of the force, rms"),
            (f"{100 * summary['coverage_95']:.0f} %", "of samples inside their 95 % interval"),
            (f"{significant(1e3 * summary['baseline_rms_n']['linear'], 2)} mN", "linear regression's error, rms"),
            *cards,
        ]
    rows = [
        [escaped(one["kind"]), significant(one["time_s"], 4), significant(1e3 * one["latency_s"], 2)]
        for one in summary["events"]
    ]
    body = [
        section("Force", figure(force_figures.force(result), "force", FORCE), _methods(summary)),
        section("Place, body and fit", figure(force_figures.share(result), "share", SHARE)),
        section("The virtual switch", table(["Event", "At [s]", "After the known force [ms]"], rows)) if rows else "",
    ]
    text = document(
        kicker="prediction",
        title="Force from volts",
        lead=f"{result.sizes['time']} samples; the interval is open above in {100 * is_open:.0f} % of them.",
        warnings=warnings,
        cards=cards,
        body=body,
        attributes=result.attrs | {"digest": result.attrs["scene_digest"]},
    )
    write_text(path, text)


def _methods(summary: dict[str, Any]) -> str:
    """Errors of the force by the filter and by regressions on the same calibration; empty where no force is known."""
    if not np.isfinite(summary["rms_n"]):
        return ""
    named = {"linear": "linear regression", "components": "principal component regression"}
    errors = {"filter on the vessels": summary["rms_n"]}
    errors |= {named[name]: error for name, error in summary["baseline_rms_n"].items()}
    rows = [[name, significant(1e3 * error, 2)] for name, error in errors.items()]
    return table(["Force by", "Error, rms [mN]"], rows)
