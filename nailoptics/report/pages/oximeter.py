"""Pages of an oximeter, forward from a scene and back from a recording, and their figures."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...scene import parse_scene
from ...statistics import Z95
from ...studies.oximetry.ratio import MEASURED, TEXTBOOK
from ...studies.oximetry.recording import spo2_rows
from .. import maps, style
from ..files import Report
from ..html import document, escaped, figure, section, small, table
from ..numbers import polynomial, significant, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PULSE = (
    "Each LED's reading over a beat, less its mean and less the dark slot, with the trace's 95 % interval. More blood, "
    "less light: the reading falls as the pulse arrives."
)
CURVE = (
    "R of every photodiode against the arteries' saturation, from one trace of each LED, with its 95 % interval, "
    "between the line of textbooks and one that was measured on fingers."
)
DISTURB = (
    "Bias of SpO2, displayed less true saturation, of an oximeter calibrated with the scene as it is, as one thing "
    "changes, with the 95 % interval of the trace."
)


def oximeter_page(result: xr.Dataset) -> str:
    """The page of an oximeter."""
    best = result.sel(photodiode=result.attrs["best"])
    a, b = best.linear.values
    cards = [
        (f"{significant(float(a), 4)} − {significant(-float(b), 3)} R", f"SpO2 in percent, {result.attrs['best']}"),
        (significant(float(best.ratio_at_rest), 3), f"R at a saturation of {100 * result.attrs['so2']:g} %"),
        (f"{significant(float(best.spo2_stderr), 2)} %", "standard error of SpO2 over 8 s"),
        (
            f"{significant(1e2 * float(best.perfusion_index[0]), 2)} % and "
            f"{significant(1e2 * float(best.perfusion_index[1]), 2)} %",
            "perfusion index, red and infrared",
        ),
    ]
    return document(
        kicker="pulse oximeter",
        title="Oxygen from volts",
        lead=f"{result.sizes['photodiode']} photodiodes, a heart that beats {result.attrs['rate_per_min']:g} times a "
        "minute, and every saturation from one trace of each LED.",
        warnings=result.attrs["warnings"],
        cards=cards,
        body=[
            section("The pulse in volts", figure(_pulse_figure(result), "pulse", PULSE), *_board(result)),
            section(
                "Calibration: from R to saturation",
                figure(_calibration_figure(result), "calibration", CURVE),
                _calibrations(result),
            ),
            section("Uncertainty of SpO2", _errors(result), small(_ERRORS)),
            section(
                "Sensitivity to disturbances",
                figure(_disturbances_figure(result), "disturbances", DISTURB),
                _melanin(result),
                small(
                    "The resting blood is as venous as the scene says, what pulsates is arterial. Where lines of LEDs "
                    "move, light scatters as at the traced wavelength. Sunlight is full at 100 klx, on all of the "
                    "finger; nails of other thickness have traces of their own."
                ),
            ),
        ],
        attributes=result.attrs,
    )


_ERRORS = (
    "Electronics: shot and thermal noise and that of the sample-and-hold. Ambient light: the shot noise that it adds. "
    "Trace: photon noise of the simulation, which more photons reduce."
)


def _board(result: xr.Dataset) -> list[str]:
    try:
        scene = parse_scene(str(result.attrs["scene"]))
    except (InputError, KeyError):
        return []
    text = "The board from above, rolled flat."
    return [figure(maps.top_view(scene), "top", text, narrow=True)]


def _calibrations(result: xr.Dataset) -> str:
    rows = []
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        pairs = zip(one.linear.values, one.linear_stderr.values, strict=True)
        rows.append(
            [
                escaped(name),
                *(with_error(float(value), float(error)) for value, error in pairs),
                significant(float(one.linear_miss), 2),
                polynomial(one.quadratic.values, "R"),
                significant(float(one.quadratic_miss), 2),
                with_error(float(one.ratio_at_rest), float(one.ratio_at_rest_stderr)),
                with_error(float(one.path_ratio), float(one.path_ratio_stderr)),
            ]
        )
    at = f"R({result.attrs['so2']:g})"
    head = ["Photodiode", "Intercept", "Slope", "Residual [%]", "Quadratic", "Residual [%]", at, "Path ratio"]
    return table(head, rows) + small(
        "Lines are fitted from 70 to 100 %. The path ratio is the red light's mean path in the pulsatile blood over "
        "the infrared's: R is in proportion to it."
    )


def _errors(result: xr.Dataset) -> str:
    head = [
        "Photodiode",
        *(f"{escaped(cause)} [%]" for cause in result.cause.values),
        "All, 8 s [%]",
        "All, one beat [%]",
    ]
    rows = []
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        each = [significant(float(x), 2) for x in one.spo2_stderr_by_cause.values]
        total = [significant(float(one[key]), 2) for key in ("spo2_stderr", "spo2_stderr_beat")]
        rows.append([escaped(name), *each, *total])
    return table(head, rows)


def _melanin(result: xr.Dataset) -> str:
    worst = float(result.melanin_bound.max())
    met = float(result.epidermis_part_bound.max())
    return (
        f"<p>Does light through the nail meet epidermis at all? At most {significant(100 * met, 2)} % of what a "
        f"photodiode detects (95 % confidence), so that melanin changes SpO2 by at most {significant(worst, 2)} %.</p>"
    )


def recording_page(result: xr.Dataset) -> str:
    """The page of a recording that was read."""
    summary = recording_summary(result)
    best = summary["readings"][summary["best"]]
    cards = [("unknown", "SpO2: no window without motion")]
    if best["spo2"] is not None:
        cards = [
            (f"{significant(best['spo2'], 3)} %", "SpO2, the middle of all still windows"),
            (f"{significant(best['spo2_low'], 3)} to {significant(best['spo2_high'], 3)} %", "its 95 % interval"),
        ]
    if best["rate_per_min"] is not None:
        cards.append((significant(best["rate_per_min"], 3), "beats a minute"))
    rows = [
        [
            escaped(name),
            *(significant(one[key], 3) if one[key] is not None else "–" for key in ("spo2", "spo2_stderr", "ratio")),
            *(
                significant(100 * one["perfusion_index"][k], 2) if one["perfusion_index"][k] is not None else "–"
                for k in ("red", "infrared")
            ),
            f"{one['still']} of {one['windows']}",
        ]
        for name, one in summary["readings"].items()
    ]
    head = ["Photodiode", "SpO2 [%]", "±", "R", "Perfusion, red [%]", "infrared [%]", "Still windows"]
    moved = f"motion in {100 * best['motion']:.0f} % of the time"
    return document(
        kicker="pulse oximeter",
        title="Oxygen from a recording",
        lead=f"{result.sizes['time']} windows of {result.attrs['window_s']:g} s; {moved}.",
        cards=cards,
        body=[
            section(
                "Over time",
                figure(
                    _over_time_figure(result),
                    "time",
                    f"Photodiode {result.attrs['best']}. Windows with motion for more than half of the time "
                    "are left out.",
                ),
            ),
            section("Photodiodes", table(head, rows)),
        ],
        attributes=result.attrs,
    )


RED, INFRARED = "#c0303b", "#6b4fa0"
COLUMNS = 3


@style.drawing()
def _pulse_figure(result: xr.Dataset) -> "Figure":
    """Both LEDs' readings over a beat, less their means, a panel for each photodiode."""
    names = [str(name) for name in result.photodiode.values]
    figure, axes = style.panels(7.2, 2.3, 1, len(names), sharex=True, squeeze=False)
    for j, (panel, name) in enumerate(zip(axes[0], names, strict=True)):
        _draw_pulse(panel, result, j)
        panel.set_title(style.plain(name))
        level = result.volts.values[:, j].mean(-1)
        style.remark(panel, f"on {level[0]:.2f} V and {level[1]:.2f} V")
    axes[0, 0].set_ylabel("change over a beat [mV]")
    style.legend_above(figure, axes[0, 0], ncols=2)
    return figure


def _draw_pulse(panel: "Axes", result: xr.Dataset, photodiode: int) -> None:
    """Both LEDs' readings of one photodiode over a beat, into axes that are there."""
    for k, colour in enumerate((RED, INFRARED)):
        change, error = (1e3 * result[key].values[k, photodiode] for key in ("volts_pulse", "volts_pulse_stderr"))
        low, high = change - Z95 * error, change + Z95 * error
        panel.fill_between(result.beat_time, low, high, color=colour, alpha=0.2, linewidth=0)
        panel.plot(result.beat_time, change, color=colour, label=style.plain(result.led.values[k]))
    panel.set_xlabel("time [s]")


@style.drawing()
def _calibration_figure(result: xr.Dataset) -> "Figure":
    """SpO2 over R of every photodiode with its interval, the textbook's line and that measured on fingers."""
    figure, axes = style.panels(7.2, 4.2)
    _draw_calibration(axes, result)
    return figure


def _draw_calibration(axes: "Axes", result: xr.Dataset) -> None:
    """The same into axes that are there."""
    percent = 100 * result.so2.values
    for name, colour in zip(result.photodiode.values, style.place_colours(result.sizes["photodiode"]), strict=True):
        one = result.sel(photodiode=name)
        low, high = one.ratio - Z95 * one.ratio_stderr, one.ratio + Z95 * one.ratio_stderr
        axes.fill_betweenx(percent, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(one.ratio, percent, color=colour, label=style.plain(name))
    ratio = np.linspace(0.2, float(result.ratio.max()), 2)
    for (a, b), label, dashes in ((TEXTBOOK, "textbook", (4, 3)), (MEASURED, "measured on fingers", (1, 2))):
        text = f"{label}: {a:g} − {-b:g} R"
        axes.plot(ratio, a + b * ratio, color=style.INK, linewidth=1.1, linestyle=(0, dashes), label=text)
    axes.set_ylim(48, 102)
    axes.set_xlabel("ratio of ratios R [1]")
    axes.set_ylabel("arterial saturation [%]")
    axes.legend(loc="upper right")


@style.drawing()
def overview_figure(result: xr.Dataset) -> "Figure":
    """The best photodiode's pulse, saturation over R, and what a touch does to it, side by side for a README."""
    figure, (beat, curve, force) = style.panels(12.0, 4.0, 1, 3, width_ratios=[1, 1.4, 1])
    best = [str(name) for name in result.photodiode.values].index(result.attrs["best"])
    _draw_pulse(beat, result, best)
    beat.set_title("A beat on the best photodiode")
    beat.set_ylabel("change over a beat [mV]")
    beat.legend()
    _draw_calibration(curve, result)
    curve.set_title("Saturation from the ratio of ratios")
    _disturbance(force, result, "touch_force_n", style.place_colours(result.sizes["photodiode"]))
    force.set_title("Effect of a touch")
    force.set_ylabel("bias of SpO2 [%]")
    return figure


@style.drawing()
def _disturbances_figure(result: xr.Dataset) -> "Figure":
    """What is shown less what is true over everything that disturbs, a panel for each."""
    names = [str(name) for name in result.attrs["disturbances"]]
    rows = -(-len(names) // COLUMNS)
    figure, axes = style.panels(7.2, 2.1 * rows, rows, COLUMNS, squeeze=False)
    colours = style.place_colours(result.sizes["photodiode"])
    for panel, name in zip(axes.flat, names, strict=False):
        _disturbance(panel, result, name, colours)
    for panel in axes.flat[len(names) :]:
        panel.set_axis_off()
    for row in axes:
        row[0].set_ylabel("bias of SpO2 [%]")
    style.legend_above(figure, axes[0, 0], ncols=len(colours))
    return figure


def _disturbance(panel: "Axes", result: xr.Dataset, name: str, colours: list[str]) -> None:
    for j, colour in enumerate(colours):
        off, error = (result[key].values[j] for key in (f"off_by_{name}", f"off_by_{name}_stderr"))
        label = style.plain(result.photodiode.values[j])
        panel.fill_between(result[name], off - Z95 * error, off + Z95 * error, color=colour, alpha=0.2, linewidth=0)
        panel.plot(result[name], off, color=colour, marker=".", markersize=4, linewidth=1.2, label=label)
    units = result[name].attrs["units"]
    panel.axhline(0.0, color=style.MUTED, linewidth=0.7)
    # Below this a curve is flat for every purpose.
    low, high = panel.get_ylim()
    panel.set_ylim(min(low, -0.5), max(high, 0.5))
    words = result[name].attrs["long_name"]
    panel.set_xlabel(style.in_lines(f"{words} [{units}]"), fontsize=8)


@style.drawing()
def _over_time_figure(result: xr.Dataset) -> "Figure":
    """SpO2 with its interval, pulse rate and motion over a recording, of the best photodiode."""
    one = result.sel(photodiode=result.attrs["best"])
    figure, (oxygen, rate, moved) = style.panels(7.2, 4.8, 3, sharex=True, gridspec_kw={"height_ratios": [3, 1.5, 1]})
    colour = style.ZONES[0]
    oxygen.fill_between(one.time, one.spo2_low, one.spo2_high, color=colour, alpha=0.2, linewidth=0, label="95 %")
    oxygen.plot(one.time, one.spo2, color=colour, marker=".", label="SpO2")
    oxygen.set_ylabel("SpO2 [%]")
    style.legend_above(figure, oxygen, ncols=2)
    rate.plot(one.time, one.rate_per_min, color=style.INK, marker=".")
    rate.set_ylabel("pulse [1/min]")
    moved.fill_between(one.time, 0.0, 100 * one.motion, color=style.MUTED, alpha=0.5, step="mid", linewidth=0)
    moved.set_ylim(0, 100)
    moved.set_ylabel("moved [%]")
    moved.set_xlabel("middle of the window [s]")
    return figure


def oximeter_summary(result: xr.Dataset) -> dict[str, Any]:
    """Calibration and errors of an oximeter; so2 in parts of 1, everything called SpO2 in percent."""
    scene_so2, leds = float(result.attrs["so2"]), [str(name) for name in result.led.values]
    readings = {}
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        terms, errors = one.linear.values.tolist(), one.linear_stderr.values.tolist()
        readings[str(name)] = {
            "so2": one.so2.values.tolist(),
            "ratio": one.ratio.values.tolist(),
            "ratio_stderr": one.ratio_stderr.values.tolist(),
            "ratio_at_rest": {
                "so2": scene_so2,
                "value": float(one.ratio_at_rest),
                "stderr": float(one.ratio_at_rest_stderr),
            },
            "fit": {"intercept": terms[0], "slope": terms[1], "intercept_stderr": errors[0], "slope_stderr": errors[1]}
            | {"miss": float(one.linear_miss), "quadratic": one.quadratic.values.tolist()},
            "perfusion_index": dict(zip(leds, one.perfusion_index.values.tolist(), strict=True)),
            "perfusion_index_stderr": dict(zip(leds, one.perfusion_index_stderr.values.tolist(), strict=True)),
            "path_ratio": float(one.path_ratio),
            "path_ratio_stderr": float(one.path_ratio_stderr),
            "spo2_stderr": float(one.spo2_stderr),
            "spo2_stderr_beat": float(one.spo2_stderr_beat),
            "spo2_stderr_by_cause": dict(
                zip(map(str, one.cause.values), one.spo2_stderr_by_cause.values.tolist(), strict=True)
            ),
            "saturated": bool(one.saturated),
            "melanin_bound": float(one.melanin_bound),
            "disturbances": {
                key: {
                    "values": one[key].values.tolist(),
                    "spo2_off": one[f"off_by_{key}"].values.tolist(),
                    "stderr": one[f"off_by_{key}_stderr"].values.tolist(),
                }
                for key in result.attrs["disturbances"]
            },
        }
    kept = ("best", "warnings", "photons", "engine", "backend", "cpu_seconds", "wall_seconds", "digest")
    return {"readings": readings} | {name: result.attrs[name] for name in kept}


def recording_summary(result: xr.Dataset) -> dict[str, Any]:
    """Medians over the windows without motion of an oximeter's recording, SpO2 in percent."""
    readings = {}
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        there = np.isfinite(one.spo2.values)
        row = {"windows": int(one.sizes["time"]), "still": int(there.sum()), "motion": float(one.motion.mean())}
        for key in ("ratio", "ratio_stderr", "spo2", "spo2_stderr", "spo2_low", "spo2_high", "rate_per_min"):
            values = one[key].values[np.isfinite(one[key].values)]
            row[key] = float(np.median(values)) if len(values) else None  # type: ignore[assignment]
        index = {k: one[f"perfusion_index_{k}"].values[there] for k in ("red", "infrared")}
        readings[str(name)] = row | {
            "perfusion_index": {k: float(np.nanmedian(v)) if len(v) else None for k, v in index.items()}
        }
    best = result.attrs["best"]
    return {
        "readings": readings,
        "best": best,
        **{k: readings[best][k] for k in ("spo2", "spo2_low", "spo2_high", "rate_per_min")},
    }


def oximeter_lines(summary: dict[str, Any]) -> list[str]:
    """An oximeter's calibration and its error, photodiode by photodiode."""
    lines = [
        f"{'photodiode':<14} {'SpO2 in percent':<20} {'R at rest':>9} {'+-':>7} {'path ratio':>10} {'error, 8 s':>10}"
    ]
    for name, one in summary["readings"].items():
        fit, rest = one["fit"], one["ratio_at_rest"]
        line = f"{fit['intercept']:.1f} - {-fit['slope']:.1f} R"
        lines.append(
            f"{name:<14} {line:<20} {rest['value']:9.4f} {rest['stderr']:7.4f} {one['path_ratio']:10.3f} "
            f"{one['spo2_stderr']:8.2f} %"
        )
    best = summary["readings"][summary["best"]]
    index = ", ".join(f"{led} {100 * value:.3f} %" for led, value in best["perfusion_index"].items())
    lines.append(f"best photodiode: {summary['best']}; perfusion index {index}")
    for name, one in best["disturbances"].items():
        worst = max(one["spo2_off"], key=abs)
        lines.append(f"  {name} from {one['values'][0]:g} to {one['values'][-1]:g}: bias at most {worst:+.2f} %")
    return lines


def oxygen_lines(summary: dict[str, Any]) -> list[str]:
    """SpO2, pulse rate and motion of an oximeter's recording, photodiode by photodiode."""
    lines = []
    for name, one in summary["readings"].items():
        spo2 = "SpO2 unknown"
        if one["spo2"] is not None:
            spo2 = f"SpO2 {one['spo2']:.1f} % ({one['spo2_low']:.1f} to {one['spo2_high']:.1f})"
        rate = "rate unknown" if one["rate_per_min"] is None else f"{one['rate_per_min']:.1f} beats a minute"
        motion = f"motion in {100 * one['motion']:.0f} % of the time"
        lines.append(f"{name:<14} {spo2}, {rate}, {motion}{', best' if name == summary['best'] else ''}")
    return lines


def _oxygen_files(result: xr.Dataset) -> tuple[Any, ...]:
    table = "".join(f"{row}\n" for row in spo2_rows(result))
    return result, table, lambda _: recording_page(result)


OXIMETER = Report(
    ("oximeter.nc", "oximeter.html", "oximeter.png"),
    lambda result: (result, lambda _: oximeter_page(result), lambda _: overview_figure(result)),
    oximeter_summary,
    lambda result, summary: oximeter_lines(summary),
)
OXYGEN = Report(
    ("oxygen.nc", "oxygen.csv", "oxygen.html"),
    _oxygen_files,
    recording_summary,
    lambda result, summary: oxygen_lines(summary),
)
