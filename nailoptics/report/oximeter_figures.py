"""Figures of an oximeter: its pulse in volts, R against saturation, what disturbs it, and oxygen over time."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..statistics import Z95
from ..studies.oximetry.ratio import MEASURED, TEXTBOOK
from . import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RED, INFRARED = "#c0303b", "#6b4fa0"
COLUMNS = 3


@style.drawing()
def pulse(result: xr.Dataset) -> "Figure":
    """Both LEDs' readings over a beat, less their means, a panel for each photodiode."""
    names = [str(name) for name in result.photodiode.values]
    figure, axes = style.panels(7.2, 2.3, 1, len(names), sharex=True, squeeze=False)
    for j, (panel, name) in enumerate(zip(axes[0], names, strict=True)):
        draw_pulse(panel, result, j)
        panel.set_title(style.plain(name))
        level = result.volts.values[:, j].mean(-1)
        style.remark(panel, f"on {level[0]:.2f} V and {level[1]:.2f} V")
    axes[0, 0].set_ylabel("change over a beat [mV]")
    style.legend_above(figure, axes[0, 0], ncols=2)
    return figure


def draw_pulse(panel: "Axes", result: xr.Dataset, photodiode: int) -> None:
    """Both LEDs' readings of one photodiode over a beat, into axes that are there."""
    for k, colour in enumerate((RED, INFRARED)):
        change, error = (1e3 * result[key].values[k, photodiode] for key in ("volts_pulse", "volts_pulse_stderr"))
        low, high = change - Z95 * error, change + Z95 * error
        panel.fill_between(result.beat_time, low, high, color=colour, alpha=0.2, linewidth=0)
        panel.plot(result.beat_time, change, color=colour, label=style.plain(result.led.values[k]))
    panel.set_xlabel("time [s]")


@style.drawing()
def calibration(result: xr.Dataset) -> "Figure":
    """SpO2 over R of every photodiode with its interval, the textbook's line and that measured on fingers."""
    figure, axes = style.panels(7.2, 4.2)
    draw_calibration(axes, result)
    return figure


def draw_calibration(axes: "Axes", result: xr.Dataset) -> None:
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
def overview(result: xr.Dataset) -> "Figure":
    """The best photodiode's pulse, saturation over R, and what a touch does to it, side by side for a README."""
    figure, (beat, curve, force) = style.panels(12.0, 4.0, 1, 3, width_ratios=[1, 1.4, 1])
    best = [str(name) for name in result.photodiode.values].index(result.attrs["best"])
    draw_pulse(beat, result, best)
    beat.set_title("A beat on the best photodiode")
    beat.set_ylabel("change over a beat [mV]")
    beat.legend()
    draw_calibration(curve, result)
    curve.set_title("Saturation from the ratio of ratios")
    _disturbance(force, result, "touch_force_n", style.place_colours(result.sizes["photodiode"]))
    force.set_title("What a touch does to it")
    force.set_ylabel("bias of SpO2 [%]")
    return figure


@style.drawing()
def disturbances(result: xr.Dataset) -> "Figure":
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
    panel.set_xlabel(style.in_lines(words + ("" if units == "1" else f" [{units}]")), fontsize=8)


@style.drawing()
def over_time(result: xr.Dataset) -> "Figure":
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
