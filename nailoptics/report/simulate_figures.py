"""Figures over time: the touch, the vessels, and every photodiode's volts beside the reduced optics."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ..scene import Scene
from . import style
from .numbers import prefix, quantity, with_error
from .readings import change_v, hold_end, order_along_nail

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More samples than this add bytes to a page and nothing to a picture.
SAMPLES = 500
# Small multiples stay readable up to so many photodiodes; of more, evenly spaced ones are shown.
PANELS = 16
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "beer_lambert": ("(8) Beer–Lambert", {"color": style.INK, "lw": 1.1, "ls": (0, (5, 2.5))}),
    "taylor": ("(9) Taylor", {"color": style.INK, "lw": 1.3, "ls": (0, (1, 1.6))}),
}


def touch(result: xr.Dataset) -> "Figure":
    """The touch: force, and the pressures that it makes on the veins and on the distal capillaries."""
    with style.drawing():
        figure = style.new_figure(9.2, 2.7)
        left, right = figure.subplots(1, 2, sharex=True)
        seen = _thin(result)
        _line(left, seen, seen.force_n, color=style.INK)
        left.set_title("Force on the fingertip")
        left.set_ylabel("force [N]")
        names = (("proximal", "on the veins (proximal)", "-"), ("distal", "on the capillaries (distal)", (0, (4, 2.5))))
        for zone, (name, label, dashes) in enumerate(names):
            pressure = seen[f"{name}_pressure_pa"] / 1e3
            _line(right, seen, pressure, color=style.ZONES[zone], linestyle=dashes, label=label, lw=2.2 - 0.4 * zone)
        right.set_title("Pressure that it makes")
        right.set_ylabel("pressure [kPa]")
        for axes in (left, right):
            axes.set_ylim(0, None)
            _time_axis(axes, result)
        _legend_below(right)
    return figure


def vessels(result: xr.Dataset) -> "Figure":
    """What the touch does to the blood: capillary and vein diameters, and the bed's blood fraction."""
    with style.drawing():
        figure = style.new_figure(9.2, 2.9)
        capillary, vein, blood = figure.subplots(1, 3, sharex=True)
        seen = _thin(result)
        for i, zone in enumerate(result.zone.values):
            look = {"color": style.place_colours(result.sizes["zone"])[i], "label": style.plain(zone)}
            _line(capillary, seen, seen.capillary_diameter_m.isel(zone=i) * 1e6, **look)
            _line(blood, seen, seen.blood_fraction.isel(zone=i) * 100, **look)
        _line(vein, seen, seen.vein_diameter_m * 1e6, color=style.VEIN)
        for axes, title, label in (
            (capillary, "Capillaries", "diameter [µm]"),
            (vein, "Vein of the pulp", "diameter [µm]"),
            (blood, "Blood in the nail bed", "blood fraction [%]"),
        ):
            axes.set_title(title)
            axes.set_ylabel(label)
            _time_axis(axes, result)
            _not_too_close(axes)
        _legend_below(capillary)
        _legend_below(blood)
    return figure


def overview(result: xr.Dataset, scene: Scene | None) -> "Figure":
    """Change of every photodiode from rest, one panel per LED, over the force."""
    leds = result.sizes["led"]
    with style.drawing():
        per_led = 3.6 if leds > 1 else 4.2
        figure = style.new_figure(9.2, 0.9 + per_led * leds)
        panels = figure.subplots(
            leds + 1, 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [0.8] + [per_led] * leds}
        )[:, 0]
        for axes in panels[2:]:
            axes.sharey(panels[1])
        seen = _thin(result)
        _line(panels[0], seen, seen.force_n, color=style.INK)
        panels[0].fill_between(seen.time, 0, seen.force_n, color=style.MUTED, alpha=0.15, lw=0)
        panels[0].set_ylabel("force [N]")
        panels[0].set_ylim(0, None)
        for i, axes in enumerate(panels[1:]):
            draw_change(axes, result, scene, led=i)
            if i < leds - 1:
                axes.set_xlabel("")
    return figure


def draw_change(axes: "Axes", result: xr.Dataset, scene: Scene | None, *, led: int) -> None:
    """Draw the change of every photodiode from rest under one LED into axes, with its value at the hold's end."""
    order = order_along_nail(result, scene)
    change, _, _ = change_v(result)
    hold = hold_end(result)
    scale, letter = prefix(float(np.abs(change).max()))
    seen = _thin(result)
    axes.axhline(0, color=style.MUTED, lw=0.8)
    for colour, j in zip(style.place_colours(len(order)), order, strict=True):
        label = f"{result.photodiode.values[j]}  {quantity(change[led, j, hold], 'V', sign=True)}"
        _line(axes, seen, change[led, j, seen.attrs["samples"]] / scale, color=colour, label=style.plain(label))
    axes.set_ylabel(f"change from rest [{letter}V]")
    axes.axvline(float(result.time[hold]), color=style.MUTED, lw=0.8, ls=(0, (2, 2)))
    axes.set_title(style.plain(_led_title(result, led)))
    _not_too_close(axes)
    _time_axis(axes, result)
    handles, labels = axes.get_legend_handles_labels()
    # From the tip down, as on the nail.
    axes.legend(
        handles[::-1],
        labels[::-1],
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        title=f"at {float(result.time[hold]):.3g} s",
        ncols=1 + (len(order) - 1) // 16,
    )


def volts(result: xr.Dataset, scene: Scene | None, *, led: int) -> "Figure":
    """One LED's readings, one panel per photodiode: traced volts with both errors, (8), (9) and what they miss.

    Proximal photodiodes are on the left, distal ones on the right. The inner band is the trace's standard error of
    the change from rest, the outer one the electronics' noise of one sample; the trace's error of the level, which
    all samples share, is a number in the title.
    """
    order = order_along_nail(result, scene)
    if len(order) > PANELS:
        order = [order[k] for k in np.linspace(0, len(order) - 1, PANELS).round().astype(int)]
    colours = style.place_colours(len(order))
    rows = -(-len(order) // 2)
    columns = 1 if len(order) == 1 else 2
    with style.drawing():
        figure = style.new_figure(9.2, 0.45 + 2.15 * rows)
        grid = figure.subplots(
            2 * rows, columns, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [2.2, 1] * rows}
        )
        residual_v = np.stack([result[f"volts_{name}"] - result.volts for name in ("beer_lambert", "taylor")])[:, led]
        outer = float(np.abs(residual_v[:, order]).max())
        residual_scale, letter = prefix(max(outer, float(result.volts_noise_rms[led].max())))
        for k, j in enumerate(order):
            column, row = divmod(k, rows)
            main, below = grid[2 * row, column], grid[2 * row + 1, column]
            _reading(main, result, led, j, colours[k])
            _residual(below, result, led, j, residual_scale)
            below.set_ylabel(f"missed\n[{letter}V]", fontsize=8)
        limit = 1.15 * max(abs(y) for axes in grid[1::2].ravel() for y in axes.dataLim.intervaly if np.isfinite(y))
        for axes in grid[1::2].ravel():
            axes.set_ylim(-(limit or 1.0), limit or 1.0)
        for axes in grid.ravel()[2 * len(order) :]:
            axes.set_visible(False)
        for axes in grid[-1]:
            _time_axis(axes, result)
        style.legend_above(figure, grid[0, 0], ncols=5, handlelength=2.2, columnspacing=1.4)
    return figure


def _reading(axes: "Axes", result: xr.Dataset, led: int, photodiode: int, colour: str) -> None:
    """Traced volts of one photodiode with bands, and both reduced models."""
    seen = _thin(result)
    index = seen.attrs["samples"]
    one = seen.isel(led=led, photodiode=photodiode)
    _, stderr, bound = change_v(result)
    scale, letter = prefix(float(np.abs(one.volts).max()))
    time, middle = one.time.to_numpy(), one.volts.to_numpy() / scale
    if len(time) > 1:
        name = "error of the trace" + (", at most" if bound else "")
        bands = ((one.volts_noise_rms.to_numpy(), 0.2, "noise (rms)"), (stderr[led, photodiode, index], 0.45, name))
        for error_v, alpha, label in bands:
            low, high = middle - error_v / scale, middle + error_v / scale
            axes.fill_between(time, low, high, color=colour, alpha=alpha, lw=0, label=label)
    _line(axes, one, middle, color=colour, label="traced light")
    for name, (label, look) in MODELS.items():
        _line(axes, one, one[f"volts_{name}"] / scale, label=label, **look)
    axes.set_ylabel(f"volts [{letter}V]", fontsize=8)
    rest = result.isel(led=led, photodiode=photodiode, time=0)
    level = with_error(float(rest.volts) / scale, float(rest.volts_stderr) / scale)
    axes.set_title(style.plain(result.photodiode.values[photodiode]), color=style.INK)
    style.remark(axes, f"at rest {level} {letter}V")
    _not_too_close(axes)


def _residual(axes: "Axes", result: xr.Dataset, led: int, photodiode: int, scale: float) -> None:
    """What each reduced model misses of one photodiode's traced volts, against the noise."""
    one = _thin(result).isel(led=led, photodiode=photodiode)
    noise = one.volts_noise_rms.to_numpy() / scale
    if len(noise) > 1:
        axes.fill_between(one.time, -noise, noise, color=style.MUTED, alpha=0.16, lw=0)
    axes.axhline(0, color=style.MUTED, lw=0.7)
    for name, (_, look) in MODELS.items():
        _line(axes, one, (one[f"volts_{name}"] - one.volts) / scale, **look)


def _led_title(result: xr.Dataset, led: int) -> str:
    return f"LED {result.led.values[led]}, {float(result.wavelength_nm[led]):g} nm"


def _thin(result: xr.Dataset) -> xr.Dataset:
    """At most SAMPLES times, the first and the last among them; attribute `samples` says which."""
    count = result.sizes["time"]
    index = np.unique(np.linspace(0, count - 1, min(count, SAMPLES)).round().astype(int))
    return result.isel(time=index).assign_attrs(samples=index)


def _line(axes: "Axes", over: xr.Dataset, values: object, **look: Any) -> None:
    """A line over time; a dot where there is one time only."""
    if over.sizes["time"] == 1:
        look = {**look, "marker": "o", "linestyle": "none"}
        look.pop("ls", None)
    axes.plot(over.time.to_numpy(), np.asarray(values), **look)


def _time_axis(axes: "Axes", result: xr.Dataset) -> None:
    axes.set_xlabel("time [s]")
    if result.sizes["time"] > 1:
        axes.set_xlim(float(result.time[0]), float(result.time[-1]))


def _not_too_close(axes: "Axes") -> None:
    """Keep rounding noise of a constant from filling the axes: show at least 1 per mille of the value."""
    low, high = axes.get_ylim()
    middle, least = (low + high) / 2, 1e-3 * max(abs(low), abs(high))
    if high - low < least:
        axes.set_ylim(middle - least, middle + least)
    axes.ticklabel_format(axis="y", useOffset=False)


def _legend_below(axes: "Axes") -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=2, handlelength=1.8, columnspacing=1.2)
