"""Pages of a calibration and of a prediction, and their figures: volts beside their fit, force over time."""

import math
from typing import Any

import numpy as np
import xarray as xr

from ...scene import parse_scene
from ...statistics import Z95
from ...studies.force.predict import csv_rows
from ...studies.force.scores import BASELINES, TOUCH_N, TOUCH_SCORES
from ...studies.force.subject import Subject, parse_subject, subject_toml
from .. import maps, style
from ..files import Report
from ..html import Html, details, document, figure, section, small, table, texts
from ..numbers import cells, estimated, plain, significant, with_error

TEXTS = texts("force")


def calibration_page(result: xr.Dataset) -> str:
    """The page of a calibration."""
    summary, count = calibration_summary(result), len(result.attrs["recordings"])
    cards = [
        (f"{significant(1e3 * summary['rms_n'], 2)} mN", f"rms error of the force, {_judged_on(summary)}"),
        (f"± {significant(1e3 * summary['half_width_n'], 2)} mN", TEXTS["half_width"].format(summary["coverage_95"])),
        (significant(summary["chi2_per_dof"], 2), "chi-squared per degree of freedom"),
    ]
    return document(
        **TEXTS["calibration"],
        lead=f"{count} recording{'s' if count > 1 else ''} of a known force, "
        f"{result.sizes['reading']} readings, {result.sizes['sample']} samples.",
        warnings=summary["warnings"],
        cards=cards,
        body=[
            _touches_section(summary["quality"]),
            section("Recorded and fitted", figure(_fit_figure(result), TEXTS["fit"])),
            _person_section(summary),
            section("The readings", table(_readings(result, summary)), small(TEXTS["gains"])),
        ],
        attributes=result.attrs,
    )


def _person_section(summary: dict[str, Any]) -> Html:
    drawn = figure(_factor_figure(summary["parameters"]), "The factors, with their 95 % intervals.", narrow=True)
    return section("The person", drawn, table(_factors(summary)), small(TEXTS["known"]))


def _subject_page(subject: Subject) -> str:
    """The page of a subject without the recordings that it was calibrated with."""
    summary = _subject_summary(subject)
    body = [_touches_section(summary["quality"]), _person_section(summary)]
    lead = f"{len(subject.light.names)} readings."
    return document(kicker="subject", title="A person's sensor", lead=lead, body=body, attributes={})


def _judged_on(summary: dict[str, Any]) -> str:
    """The touches that a calibration's errors are of, in words."""
    return f"{TEXTS['held_out' if summary['is_held_out'] else 'fitted']} of {TOUCH_N:g} N or more"


def _touches_section(touches: dict[str, dict[str, float]], heading: str = "How well the touches are estimated") -> Html:
    """How well the touches of each kind are estimated."""
    known = {kind: scores for kind, scores in touches.items() if math.isfinite(scores["rms_n"])}
    rows = [{"Touches": kind} | cells(scores, TEXTS["scores"]) for kind, scores in known.items()]
    return section(heading, table(rows), small(TEXTS["kinds"].format(TOUCH_N)))


def _factors(summary: dict[str, Any]) -> list[dict[str, str]]:
    """What the recordings say of the person, beside what was known before."""
    return [
        {
            "Factor on the scene's": name.replace("_", " "),
            "Value": with_error(factor["value"], factor["stderr"]),
            "Before, about 1": factor["prior"].removeprefix("lognormal about 1, "),
            "Known by": "recording" if factor["informed"] else "prior",
            "What it is": factor["what"],
        }
        for name, factor in summary["parameters"].items()
    ]


def _readings(result: xr.Dataset, summary: dict[str, Any]) -> list[dict[str, str]]:
    """Gain, offset, noise and headroom of each reading."""
    limit_v = parse_scene(str(result.attrs["scene"]), name="the scene").electronics.adc_range_v
    return [
        {
            "Reading": name,
            "Gain": estimated(reading, "gain"),
            "Offset [mV]": with_error(1e3 * reading["offset_v"], 1e3 * reading["offset_stderr_v"]),
            "Residual, rms [mV]": significant(1e3 * reading["residual_rms_v"], 2),
            "Noise, rms [µV]": significant(1e6 * reading["noise_v"], 2),
            f"Largest, of {limit_v:g} V [V]": significant(float(np.nanmax(result.volts.sel(reading=name))), 3),
        }
        for name, reading in summary["readings"].items()
    ]


def prediction_page(result: xr.Dataset) -> str:
    """The page of a prediction."""
    summary = prediction_summary(result)
    warnings = list(summary["warnings"])
    if not summary["consistent"]:
        warnings.append(TEXTS["misfit"].format(summary["misfit"]))
    cards = [(f"{significant(summary['open_above_n'], 2)} N", "force above which intervals have no upper bound")]
    methods: list[dict[str, str]] = []
    if np.isfinite(summary["rms_n"]):
        errors = {"this estimate": summary["touch_rms_n"]}
        for name, error_n in summary["baseline_rms_n"].items():
            errors[result[f"force_{name}_n"].attrs["long_name"].removeprefix("force by ")] = error_n
        of_touches = "Error over touches, rms [mN]"
        methods = [{"Force by": name, of_touches: significant(1e3 * error, 2)} for name, error in errors.items()]
        inside = f"{100 * summary['coverage_95']:.0f} %", "of samples inside their 95 % interval"
        cards = [(f"{significant(1e3 * summary['rms_n'], 2)} mN", "error of the force, rms"), inside, *cards]
    events = table([{"Event": event["kind"]} | cells(event, TEXTS["events"]) for event in summary["events"]])
    switch = details(f"{len(summary['events'])} events", events) if summary["events"] else ""
    return document(
        **TEXTS["prediction"],
        lead=TEXTS["lead"].format(result.sizes["time"], 100 * np.isinf(result.force_high_n.values).mean()),
        warnings=warnings,
        cards=cards,
        body=[
            section("Force", figure(force_figure(result), TEXTS["force"]), table(methods) if methods else ""),
            _touches_section(summary["touches"], "Touches") if methods else "",
            section("Place, body and fit", figure(_share_figure(result), TEXTS["share"])),
            section("The virtual switch", switch) if switch else "",
        ],
        attributes=result.attrs | {"digest": result.attrs["scene_digest"]},
    )


# Of an event of the virtual switch.
EVENT = ("time_s", "kind", "latency_s")
# Points that a line is drawn with; more cannot be seen and make pages heavy.
POINTS = 1500
# How far above the largest known force an interval that is open above is drawn.
ROOM_ABOVE = 1.25


def _thinned(result: xr.Dataset, over: str) -> xr.Dataset:
    return result.isel({over: slice(None, None, max(1, result.sizes[over] // POINTS))})


@style.drawing()
def _fit_figure(result: xr.Dataset) -> "style.Figure":
    """All readings over the calibration, recorded and fitted, less their starts; below, their residuals."""
    colours = maps.colours_of(result)  # of each LED's readings
    parts = [_thinned(part, "sample") for _, part in result.groupby(result.recording)]
    how: dict[str, Any] = {"sharex": "col", "sharey": "row", "squeeze": False, "height_ratios": [3.0, 2.0]}
    figure, axes = style.panels(7.2, 4.6, 2, len(parts), **how)
    for part, (readings, residuals) in zip(parts, axes.T, strict=True):
        time_s, recorded_mv, fitted_mv = part.time_s, 1e3 * part.volts.values, 1e3 * part.volts_fitted.values
        for k in range(part.sizes["reading"]):
            colour = colours[k % len(colours)]
            start_mv = np.nanmedian(recorded_mv[k, : max(3, len(time_s) // 50)])
            name = style.plain(part.reading.values[k])
            readings.plot(time_s, recorded_mv[k] - start_mv, color=colour, linewidth=2.4, alpha=0.55, label=name)
            readings.plot(time_s, fitted_mv[k] - start_mv, color=style.INK, linewidth=0.6)
            residuals.plot(time_s, recorded_mv[k] - fitted_mv[k], color=colour, linewidth=0.7)
        residuals.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("change of the reading [mV]")
    axes[1, 0].set_ylabel("residual [mV]")
    style.legend_above(figure, axes[0, 0], ncols=4)
    return figure


@style.drawing()
def _factor_figure(factors: dict[str, dict[str, Any]]) -> "style.Figure":
    """What the recordings say of the person: factors on the scene's constants, with their 95 % intervals."""
    drawing, axes = style.panels(6.4, 0.6 + 0.28 * len(factors))
    for row, factor in enumerate(factors.values()):
        ends = factor["value"] * np.exp(np.array([-Z95, Z95]) * factor["stderr"] / factor["value"])
        colour = style.ZONES[0] if factor["informed"] else style.MUTED
        axes.plot(ends, [row, row], color=colour)
        axes.plot(factor["value"], row, "o", color=colour)
    axes.axvline(1.0, color=style.MUTED, linewidth=0.8)
    axes.set(xscale="log", xlabel="factor on the scene's [1]; grey: known by the prior alone")
    style.plain_log(axes.xaxis)
    style.named_rows(axes, [name.replace("_", " ")[:28] for name in factors])
    return drawing


@style.drawing()
def force_figure(result: xr.Dataset) -> "style.Figure":
    """Force over time with its interval, beside the known force and the regressions' where they are known."""
    part = _thinned(result, "time")
    known, unbounded = part.known_force_n.values, np.isinf(part.force_high_n.values)
    top = np.nanmax([*np.where(np.isfinite(known), known, 0.0), *part.force_n.values]) * ROOM_ABOVE + 0.05
    figure, axes = style.panels(7.2, 3.4)
    high = np.minimum(part.force_high_n.values, top)
    axes.fill_between(part.time, part.force_low_n, high, color=style.ZONES[1], alpha=0.18, linewidth=0, label="95 %")
    if unbounded.any():
        open_above = np.where(unbounded, top, np.nan)
        axes.plot(part.time, open_above, color=style.ZONES[1], linewidth=2.5, label="no upper bound")
    axes.plot(part.time, part.force_n, color=style.ZONES[1], label="estimated")
    if np.isfinite(known).any():
        axes.plot(part.time, known, color=style.INK, linewidth=1.1, label="measured")
        if "force_cubic_n" in part:
            axes.plot(part.time, part.force_cubic_n, color=style.MUTED, linewidth=0.7, label="cubic regression")
    axes.set(ylim=(-0.02 * top, 1.03 * top), xlabel="time [s]", ylabel="force [N]")
    style.legend_above(figure, axes, ncols=5)
    return figure


@style.drawing()
def _share_figure(result: xr.Dataset) -> "style.Figure":
    """Where the touch is, and on which side, the body's arterial pressure, and how well each sample fits."""
    part = _thinned(result, "time")
    figure, (place, side, body, fits) = style.panels(7.2, 5.8, 4, sharex=True)
    low, high = part.proximal_share_low, part.proximal_share_high
    place.fill_between(part.time, low, high, color=style.ZONES[0], alpha=0.18, linewidth=0)
    place.plot(part.time, np.where(high - low < 0.9, part.proximal_share, np.nan), color=style.ZONES[0])
    place.set(ylim=(-0.05, 1.05), title="Proximal share of the force [1]; blank where not identifiable")
    for name, colour in zip(("proximal", "distal", "both"), (*style.ZONES, style.MUTED), strict=True):
        side.plot(part.time, part[f"probability_{name}"], color=colour, label=name)
    side.set(ylim=(-0.05, 1.05), title="Probability of the touched side [1]: proximal, distal, both (grey)")
    body.plot(part.time, part.arterial_change_pa, color=style.VEIN)
    # A body that is still is no noise to look into.
    body.set_ylim(min(body.get_ylim()[0], -10.0), max(body.get_ylim()[1], 10.0))
    body.set_title("Arterial pressure less its mean [Pa]")
    nis, outlier = part.normalized_innovation_squared, part.outlier.values.astype(bool)
    fits.plot(part.time, nis, color=style.MUTED, linewidth=0.6)
    fits.plot(part.time[outlier], nis[outlier], ".", color=style.ZONES[0], markersize=3)
    fits.set(yscale="log", title="Normalized innovation squared [1]; outliers are dots", xlabel="time [s]")
    return figure


def calibration_summary(result: xr.Dataset) -> dict[str, Any]:
    """Readings, factors, fit and warnings of a calibration."""
    return _subject_summary(parse_subject(result.attrs["subject"])) | {"warnings": list(result.attrs["warnings"])}


def _subject_summary(subject: Subject) -> dict[str, Any]:
    weights = subject.ensemble.weights if subject.ensemble else {"filter": np.ones(2)}
    return {
        "readings": subject.reading_table(),
        "parameters": subject.factor_table(),
        "chi2_per_dof": subject.quality.chi2_per_dof,
        "rms_n": subject.quality.rms_n,
        **{name: subject.quality.touches["all"][name] for name in ("half_width_n", "coverage_95")},
        "is_held_out": subject.ensemble is not None,
        "quality": subject.quality.touches,
        "weights": {name: both.tolist() for name, both in weights.items()},
    }


def prediction_summary(result: xr.Dataset) -> dict[str, Any]:
    """Errors, coverage, consistency and events of a prediction."""
    names = ["rms_n", "coverage_95", "chi2_per_dof", "open_above_n", "outliers", "misfit"]
    names += ["half_width_n", "touch_open_above", "incomplete"]
    scores = {name: f"touch_{name}" for name in TOUCH_SCORES}
    touches = {kind: plain(result.sel(kind=kind), **scores) for kind in result.kind.values.tolist()}
    events = (result[f"event_{name}"].values.tolist() for name in EVENT)
    return {name: result.attrs[name] for name in names} | {
        "touch_rms_n": touches["all"]["rms_n"],
        "touch_coverage_95": touches["all"]["coverage_95"],
        "touches": touches,
        "open_above_by_side_n": {side: float(result.attrs[f"open_above_{side}_n"]) for side in ("proximal", "distal")},
        "consistent": bool(result.attrs["consistent"]),
        "warnings": list(result.attrs["warnings"]),
        "baseline_rms_n": {
            name: result.attrs[f"touch_rms_{name}_n"] for name in ("filter", *BASELINES) if f"force_{name}_n" in result
        },
        "events": [dict(zip(EVENT, event, strict=True)) for event in zip(*events, strict=True)],
    }


def _touches_line(which: str, scores: dict[str, float]) -> str:
    """How well touches are estimated: error, coverage and the interval's half width, all of the same samples."""
    half_n = scores["half_width_n"]
    width = f"half width {1e3 * half_n:.0f} mN (median)" if math.isfinite(half_n) else "mostly without upper bound"
    inside = f"{scores['coverage_95']:.0%} inside their 95 % interval, {width}"
    return f"{which}: rms error {1e3 * scores['rms_n']:.0f} mN, {inside}"


def _prediction_lines(result: xr.Dataset, summary: dict[str, Any]) -> list[str]:
    share, above = 100 * np.isinf(result.force_high_n.values).mean(), f"{summary['open_above_n']:.2f} N"
    unbounded = f"; {share:.2g} % of them, above {above}, without upper bound (vessels may be closed)" if share else ""
    lacking = f", {summary['incomplete']} of them lack a reading" if summary["incomplete"] else ""
    lines = [f"{result.sizes['time']} samples{lacking}{unbounded}"]
    if math.isfinite(summary["rms_n"]):
        lines.append(f"rms {1e3 * summary['rms_n']:.0f} mN, {summary['coverage_95']:.0%} inside their 95 % interval")
    if math.isfinite(summary["touch_rms_n"]):
        lines.append(_touches_line(f"touches of {TOUCH_N:g} N or more", summary["touches"]["all"]))
    if not summary["consistent"]:
        lines.append(f"the readings are inconsistent with this subject: {summary['misfit']}.")
    return lines


CALIBRATION = Report(
    ("subject.toml", "subject.html"),
    calibration_page,
    calibration_summary,
    lambda _, summary: [_touches_line(_judged_on(summary), summary["quality"]["all"])],
    {"fit": _fit_figure},
    lambda result: {"subject.toml": result.attrs["subject"]},
)
SUBJECT = Report(
    ("subject.toml", "subject.html"),
    _subject_page,
    _subject_summary,
    lambda subject, summary: [repr(subject)],
    {"factors": lambda subject: _factor_figure(subject.factor_table())},
    lambda subject: {"subject.toml": subject_toml(subject)},
)
PREDICTION = Report(
    ("predict.nc", "predict.csv", "predict.html", "predict.png"),
    prediction_page,
    prediction_summary,
    _prediction_lines,
    {"force": force_figure, "share": _share_figure},
    lambda result: {"predict.csv": "".join(f"{row}\n" for row in csv_rows(result))},
)
