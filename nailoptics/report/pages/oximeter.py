"""Pages of an oximeter, forward from a scene and back from a recording, and their figures."""

import textwrap
from typing import Any

import numpy as np
import xarray as xr

from ...statistics import Z95
from ...studies.oximetry.ratio import MEASURED, TEXTBOOK
from ...studies.oximetry.recording import spo2_csv
from .. import maps, style
from ..files import Report, run_summary
from ..html import document, figure, section, small, table, texts
from ..numbers import ASCII, aligned, estimated, plain, polynomial, significant, with_error, with_stderr

TEXTS = texts("oximeter")


def oximeter_page(result: xr.Dataset) -> str:
    """The page of an oximeter."""
    best = result.sel(photodiode=result.attrs["best"])
    a, b = best.linear.values.tolist()
    red, infrared = (f"{significant(1e2 * index, 2)} %" for index in best.perfusion_index.values.tolist())
    overview, curves = figure(overview_figure(result), TEXTS["overview"]), table(_calibrations(result))
    disturbed = figure(_disturbances_figure(result), TEXTS["disturbance_curves"])
    return document(
        **TEXTS["page"],
        lead=TEXTS["lead"].format(result.sizes["photodiode"], result.attrs["rate_per_min"]),
        warnings=result.attrs["warnings"],
        cards=[
            (f"{significant(a, 4)} − {significant(-b, 3)} R", f"SpO2 in percent, {result.attrs['best']}"),
            (f"{significant(float(best.spo2_stderr), 2)} %", "standard error of SpO2 over 8 s, by the sensor's noise"),
            (f"{red} and {infrared}", "perfusion index, red and infrared"),
        ],
        body=[
            section("Calibration: from R to saturation", overview, curves, small(TEXTS["calibration"])),
            section("Uncertainty of SpO2", table(_errors(result)), small(TEXTS["errors"])),
            section("Sensitivity to disturbances", disturbed, small(TEXTS["disturbances"])),
        ],
        attributes=result.attrs,
    )


def _calibrations(result: xr.Dataset) -> list[dict[str, str]]:
    rows = []
    for name in result.photodiode.values:
        line = result.sel(photodiode=name)
        intercept, slope = map(with_error, line.linear.values, line.linear_stderr.values)
        row = {"Photodiode": name, "Intercept": intercept, "Slope": slope}
        row["Line's residual [%]"] = significant(float(line.linear_miss), 2)
        row["Quadratic"] = polynomial(line.quadratic.values)
        row["Its residual [%]"] = significant(float(line.quadratic_miss), 2)
        row[f"R({result.attrs['so2']:g})"] = estimated(line, "ratio_at_rest")
        rows.append(row | {"Path ratio": estimated(line, "path_ratio")})
    return rows


def _errors(result: xr.Dataset) -> list[dict[str, str]]:
    """Level of each LED's reading, and the standard errors of SpO2 by the causes of noise, and by the trace."""
    heads = [f"{led} [V]" for led in result.led.values] + [f"{cause} [%]" for cause in result.cause.values]
    heads, rows = ["Photodiode", *heads, "Noise, 8 s [%]", "Noise, one beat [%]", "Simulation error [%]"], []
    for name in result.photodiode.values:
        at = result.sel(photodiode=name)
        values = [*at.volts.values.mean(-1), *at.spo2_stderr_by_cause.values, at.spo2_stderr, at.spo2_stderr_beat]
        values.append(at.spo2_simulation_stderr)
        rows.append(dict(zip(heads, [name, *(significant(float(value), 2) for value in values)], strict=True)))
    return rows


def recording_page(result: xr.Dataset) -> str:
    """The page of a recording that was read."""
    summary = recording_summary(result)
    best = summary["readings"][summary["best"]]
    known = "unknown: no window without motion"
    if best["spo2"] is not None:
        spo2, low, high = (significant(best[f"spo2{end}"], 3) for end in ("", "_low", "_high"))
        known = f"{spo2} % (95 % interval {low} to {high} %), the middle of all still windows"
    lead = TEXTS["windows"].format(known, result.sizes["time"], result.attrs["window_s"], 100 * best["motion"])
    drawn = figure(_over_time_figure(result), TEXTS["over_time"].format(result.attrs["best"]))
    body = [section("Over time", drawn), section("Photodiodes", table(_recorded(summary)))]
    return document(**TEXTS["recording"], lead=lead, body=body, attributes=result.attrs)


def _recorded(summary: dict[str, Any]) -> list[dict[str, str]]:
    """What a recording says by each photodiode, on the page and in the terminal."""
    rows = []
    for name, r in summary["readings"].items():
        ends = "–" if r["spo2"] is None else f"{r['spo2_low']:.1f} to {r['spo2_high']:.1f}"
        row = {"Photodiode": name, "SpO2 [%]": _known(r["spo2"]), "95 % interval": ends, "R": _known(r["ratio"])}
        row |= {f"Perfusion, {led} [%]": _known(part, 100) for led, part in r["perfusion_index"].items()}
        row |= {"Pulse [1/min]": _known(r["rate_per_min"]), "Motion [%]": f"{100 * r['motion']:.0f}"}
        rows.append(row | {"Still windows": f"{r['still']} of {r['windows']}"})
    return rows


def _known(value: float | None, by: float = 1.0) -> str:
    return "–" if value is None else significant(by * value)


RED, INFRARED, COLUMNS = "#c0303b", "#6b4fa0", 3


@style.drawing()
def overview_figure(result: xr.Dataset) -> "style.Figure":
    """The best photodiode's pulse, saturation over R, and what a touch does to it, side by side."""
    figure, (beat, curve, force) = style.panels(11.4, 3.8, 1, 3, width_ratios=[1, 1.4, 1])
    best = result.sel(photodiode=result.attrs["best"])
    for name, colour in zip(result.led.values, (RED, INFRARED), strict=True):
        change, error = (1e3 * best[key].sel(led=name) for key in ("volts_pulse", "volts_pulse_stderr"))
        style.estimate(beat, result.beat_time, change, error, color=colour, label=style.plain(name))
    beat.set(title="A beat on the best photodiode", xlabel="time [s]", ylabel="change over a beat [mV]")
    beat.legend()
    colours = maps.colours_of(result)
    _calibration(curve, result, colours)
    _disturbance(force, result, "touch_force_n", colours)
    force.set(title="Effect of a touch", ylabel="bias of SpO2 [%]")
    return figure


def _calibration(panel: "style.Axes", result: xr.Dataset, colours: list[str]) -> None:
    """SpO2 over R of every photodiode with its interval, the textbook's line and that measured on fingers."""
    percent = 100 * result.so2.values
    for name, colour in zip(result.photodiode.values, colours, strict=True):
        line = result.sel(photodiode=name)
        low, high = line.ratio - Z95 * line.ratio_stderr, line.ratio + Z95 * line.ratio_stderr
        panel.fill_betweenx(percent, low, high, color=colour, alpha=0.18, linewidth=0)
        panel.plot(line.ratio, percent, color=colour, label=style.plain(name))
    ratio = np.linspace(0.2, float(result.ratio.max()), 2)
    for (a, b), label, dashes in ((TEXTBOOK, "textbook", (4, 3)), (MEASURED, "measured on fingers", (1, 2))):
        text = f"{label}: {a:g} − {-b:g} R"
        panel.plot(ratio, a + b * ratio, color=style.INK, linewidth=1.1, linestyle=(0, dashes), label=text)
    panel.set(ylim=(48, 102), xlabel="ratio of ratios R [1]", ylabel="arterial saturation [%]")
    panel.set_title("Saturation from the ratio of ratios")
    panel.legend(loc="upper right")


@style.drawing()
def _disturbances_figure(result: xr.Dataset) -> "style.Figure":
    """What is shown less what is true over everything that disturbs, a panel for each."""
    names, colours = result.attrs["disturbances"], maps.colours_of(result)
    figure, panels = style.tiles(len(names), COLUMNS, 7.2, 2.1)
    for k, (panel, name) in enumerate(zip(panels, names, strict=True)):
        _disturbance(panel, result, name, colours)
        panel.set_ylabel("" if k % COLUMNS else "bias of SpO2 [%]")
    style.legend_above(figure, panels[0], ncols=len(colours))
    return figure


def _disturbance(panel: "style.Axes", result: xr.Dataset, name: str, colours: list[str]) -> None:
    for j, colour in enumerate(colours):
        off, error = (result[key].values[j] for key in (f"off_by_{name}", f"off_by_{name}_stderr"))
        look: dict[str, Any] = {"color": colour, "marker": ".", "markersize": 4, "linewidth": 1.2}
        style.estimate(panel, result[name], off, error, label=style.plain(result.photodiode.values[j]), **look)
    units = result[name].attrs["units"]
    panel.axhline(0.0, color=style.MUTED, linewidth=0.7)
    # Below this a curve is flat for every purpose.
    low, high = panel.get_ylim()
    panel.set_ylim(min(low, -0.5), max(high, 0.5))
    words = result[name].attrs["long_name"]
    panel.set_xlabel(textwrap.fill(f"{words} [{units}]", 30), fontsize=8)


@style.drawing()
def _over_time_figure(result: xr.Dataset) -> "style.Figure":
    """SpO2 with its interval, pulse rate and motion over a recording, of the best photodiode."""
    best = result.sel(photodiode=result.attrs["best"])
    figure, (oxygen, rate, moved) = style.panels(7.2, 4.8, 3, sharex=True, gridspec_kw={"height_ratios": [3, 1.5, 1]})
    colour = style.ZONES[0]
    oxygen.fill_between(best.time, best.spo2_low, best.spo2_high, color=colour, alpha=0.2, linewidth=0, label="95 %")
    oxygen.plot(best.time, best.spo2, color=colour, marker=".", label="SpO2")
    oxygen.set_ylabel("SpO2 [%]")
    style.legend_above(figure, oxygen, ncols=2)
    rate.plot(best.time, best.rate_per_min, color=style.INK, marker=".")
    rate.set(ylabel="pulse [1/min]")
    moved.fill_between(best.time, 0.0, 100 * best.motion, color=style.MUTED, alpha=0.5, step="mid", linewidth=0)
    moved.set(ylim=(0, 100), ylabel="moved [%]", xlabel="middle of the window [s]")
    return figure


def oximeter_summary(result: xr.Dataset) -> dict[str, Any]:
    """Calibration and errors of an oximeter; so2 as a fraction, everything called SpO2 in percent."""
    readings = {}
    by_led = {"perfusion_index": "led", "perfusion_index_stderr": "led", "spo2_stderr_by_cause": "cause"}
    for name in result.photodiode.values:
        data = result.sel(photodiode=name)
        row = plain(data, "so2", "ratio", "ratio_stderr", "path_ratio", "path_ratio_stderr", "spo2_stderr")
        row |= plain(data, "spo2_stderr_beat", "spo2_simulation_stderr", "saturated")
        row["ratio_at_rest"] = {"so2": float(result.attrs["so2"])} | with_stderr(data, "ratio_at_rest")
        line = ("intercept", "slope", "intercept_stderr", "slope_stderr")
        row["fit"] = dict(zip(line, [*data.linear.values.tolist(), *data.linear_stderr.values.tolist()], strict=True))
        row["fit"] |= plain(data, "quadratic", miss="linear_miss")
        for key, dim in by_led.items():
            row[key] = dict(zip(data[dim].values.tolist(), data[key].values.tolist(), strict=True))
        row["disturbances"] = {
            key: plain(data, values=key, spo2_off=f"off_by_{key}", stderr=f"off_by_{key}_stderr")
            for key in result.attrs["disturbances"]
        }
        readings[str(name)] = row
    chosen = {name: result.attrs[name] for name in ("best", "warnings")}
    return {"readings": readings} | chosen | run_summary(result.attrs)


def recording_summary(result: xr.Dataset) -> dict[str, Any]:
    """Medians over the windows without motion of an oximeter's recording, SpO2 in percent."""
    readings = {}
    for name in result.photodiode.values:
        data = result.sel(photodiode=name)
        there = np.isfinite(data.spo2.values)
        row: dict[str, Any] = {"windows": int(data.sizes["time"]), "still": int(there.sum())}
        row["motion"] = float(data.motion.mean())
        for key in ("ratio", "ratio_stderr", "spo2", "spo2_stderr", "spo2_low", "spo2_high", "rate_per_min"):
            row[key] = _median(data[key].values)
        row["perfusion_index"] = {k: _median(data[f"perfusion_index_{k}"].values[there]) for k in ("red", "infrared")}
        readings[str(name)] = row
    best = result.attrs["best"]
    shown = {k: readings[best][k] for k in ("spo2", "spo2_low", "spo2_high", "rate_per_min")}
    return {"readings": readings, "best": best} | shown


def _median(values: np.ndarray) -> float | None:
    """The median of the values that are known, if any is."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def oximeter_lines(result: xr.Dataset, summary: dict[str, Any]) -> list[str]:
    """An oximeter's calibration and its error, photodiode by photodiode."""
    rows = zip(_calibrations(result), _errors(result), strict=True)
    shown = ["Photodiode", "Intercept", "Slope", f"R({result.attrs['so2']:g})", "Path ratio"]
    shown += ["Noise, 8 s [%]", "Simulation error [%]"]
    lines = aligned([{head: (line | error)[head] for head in shown} for line, error in rows])
    best = summary["readings"][summary["best"]]
    index = ", ".join(f"{led} {100 * value:.3f} %" for led, value in best["perfusion_index"].items())
    lines.append(f"best photodiode, by its noise: {summary['best']}; perfusion index {index}")
    for name, curve in best["disturbances"].items():
        worst, about = result.isel(abs(result[f"off_by_{name}"]).fillna(0.0).argmax(...)), result[name].attrs
        bias = estimated(worst, f"off_by_{name}", sign=True).translate(ASCII)
        ends = f"{curve['values'][0]:g} to {curve['values'][-1]:g} {about['units']}".removesuffix(" 1")
        lines.append(f"  {about['long_name']}, {ends}: bias at most {bias} % ({worst.photodiode.item()})")
    return lines


OXIMETER = Report(
    ("oximeter.nc", "oximeter.html", "oximeter.png"),
    oximeter_page,
    oximeter_summary,
    oximeter_lines,
    {"overview": overview_figure, "disturbances": _disturbances_figure},
)
OXYGEN = Report(
    ("oxygen.nc", "oxygen.csv", "oxygen.html"),
    recording_page,
    recording_summary,
    lambda result, summary: [*aligned(_recorded(summary)), f"best photodiode: {summary['best']}"],
    {"oxygen": _over_time_figure},
    lambda result: {"oxygen.csv": spo2_csv(result)},
)
