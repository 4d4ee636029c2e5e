"""Figures of a simulated touch: force, vessels, volts beside the reduced optics, and where the light ends."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...scene import Scene
from ...studies.simulate import hold_end
from .. import style
from ..maps import coloured_along_nail, led_name, order_along_nail
from ..numbers import prefix, significant, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More samples than this add bytes to a page and nothing to a picture.
SAMPLES = 500
# Small multiples stay readable up to so many photodiodes; of more, evenly spaced ones are shown.
PANELS = 16
WITH_LEGENDS_BELOW = style.Room(left=0.65, bottom=0.8, across=0.75)
DASHED = (0, (4, 2.5))
# Name, scale, title and label of what the vessels do.
VESSELS = (
    ("capillary_diameter_m", 1e6, "Capillaries", "diameter [µm]"),
    ("vein_diameter_m", 1e6, "Vein of the pulp", "diameter [µm]"),
    ("blood_fraction", 100, "Blood in the nail bed", "blood fraction [%]"),
    ("so2", 100, "Its oxygen", "saturation [%]"),
)
# Without blood, at rest and beyond: a nail's colours.
BLOOD = ("#fbf6f2", "#e6a5a0", "#8e1022")
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "beer_lambert": ("Beer–Lambert (8)", {"color": style.INK, "lw": 1.1, "linestyle": (0, (5, 2.5))}),
    "taylor": ("Taylor (9)", {"color": style.INK, "lw": 1.3, "linestyle": (0, (1, 1.6))}),
}


@style.drawing()
def touch(result: xr.Dataset) -> "Figure":
    """The touch: force, and the pressures on the veins and on the distal capillaries; arterial pressure if it moves."""
    beats, thin = "arterial_pressure_pa" in result, _thin(result)
    figure, panels = style.panels(9.2, 2.7, 1, 2 + beats, room_in=WITH_LEGENDS_BELOW, sharex=True)
    left, right = panels[:2]
    _line(left, thin.force_n, color=style.INK, label="normal")
    if "shear_n" in thin:
        _line(left, thin.shear_n, color=style.VEIN, linestyle=DASHED, label="shear, towards the tip")
        _legend_below(left)
    names = (("proximal", "on the veins (proximal)", "-"), ("distal", "on the capillaries (distal)", DASHED))
    for zone, (name, label, dashes) in enumerate(names):
        pressure = thin[f"{name}_pressure_pa"] / 1e3
        _line(right, pressure, color=style.ZONES[zone], linestyle=dashes, label=label, lw=2.2 - 0.4 * zone)
    _over_time(left, result, "Force on the fingertip", "force [N]")
    _over_time(right, result, "Pressure that it makes", "pressure [kPa]")
    left.set_ylim(min(0.0, float(result.get("shear_n", result.force_n).min())), None)
    right.set_ylim(0, None)
    if beats:
        _line(panels[2], thin.arterial_pressure_pa / 1e3, color=style.ZONES[0], lw=1.1)
        _over_time(panels[2], result, "Arterial pressure", "pressure [kPa]")
    _legend_below(right, ncols=1 if beats else 2)
    return figure


@style.drawing()
def vessels(result: xr.Dataset) -> "Figure":
    """What the touch does to the blood: capillary and vein diameters, the bed's blood fraction, and its oxygen."""
    fields = [field for field in VESSELS if field[0] in result]
    # A legend of many zones takes more room.
    room = WITH_LEGENDS_BELOW if result.sizes["zone"] <= 2 else None
    figure, panels = style.panels(9.2, 2.9, 1, len(fields), room_in=room, sharex=True)
    thin, colours = _thin(result), style.place_colours(result.sizes["zone"])
    for axes, (name, scale, title, label) in zip(panels, fields, strict=True):
        values = scale * thin[name]
        if "zone" not in values.dims:
            _line(axes, values, color=style.VEIN)
        else:
            for i, (zone, colour) in enumerate(zip(result.zone.values, colours, strict=True)):
                # Curves that lie on one another are all visible.
                look = {"color": colour, "label": style.plain(zone), "linestyle": ("-", DASHED)[i % 2]}
                _line(axes, values.isel(zone=i), **look)
        _over_time(axes, result, title, label)
        _not_too_close(axes)
        if name in ("capillary_diameter_m", "blood_fraction"):
            _legend_below(axes)
    return figure


@style.drawing()
def bed(result: xr.Dataset, scene: Scene) -> "Figure":
    """Blood of the nail bed along the nail over time, as a part of that at rest, and where the white band ends."""
    from matplotlib.colors import LinearSegmentedColormap

    assert scene.finger is not None
    half_mm, thin = scene.finger.nail_length_mm / 2, _thin(result)
    part = thin.blood_fraction.to_numpy() / scene.blood.rest_blood_fraction
    figure, axes = style.panels(9.2, 2.8)
    colours = LinearSegmentedColormap.from_list("blood", BLOOD)
    edges_mm, most = [-half_mm, *scene.zone_edges_mm, half_mm], max(2.0, float(part.max()))
    time_s = thin.time.to_numpy()
    borders = np.concatenate([time_s[:1], (time_s[1:] + time_s[:-1]) / 2, time_s[-1:]])
    image = axes.pcolormesh(borders, edges_mm, part, cmap=colours, vmin=0, vmax=most, rasterized=True)
    _line(axes, half_mm - thin.white_band_mm, color=style.DARK_INK, lw=1.2, linestyle=DASHED)
    _over_time(axes, result, "Blood along the nail", "towards the tip [mm]")
    axes.set_ylim(-half_mm, half_mm)
    axes.grid(False)
    figure.colorbar(image, ax=axes, label="blood, of that at rest [1]")
    return figure


@style.drawing()
def overview(result: xr.Dataset, scene: Scene | None) -> "Figure":
    """Change of every photodiode from rest, one panel per LED, over the force."""
    leds = result.sizes["led"]
    per_led = 3.6 if leds > 1 else 4.2
    columns = _legend_columns(result.sizes["photodiode"])
    legend_in = columns * (0.5 + style.longest_in(f"{name}  -1.23 mV" for name in result.photodiode.values))
    room = style.Room(left=0.7, right=min(0.1 + legend_in, 4.5), top=0.1, down=0.4)
    how: dict[str, Any] = {"sharex": True, "height_ratios": [0.8] + [per_led] * leds}
    figure, (top, *panels) = style.panels(9.2, 0.9 + per_led * leds, leds + 1, room_in=room, **how)
    thin = _thin(result)
    _line(top, thin.force_n, color=style.INK)
    top.fill_between(thin.time, 0, thin.force_n, color=style.MUTED, alpha=0.15, lw=0)
    top.set(ylabel="force [N]", ylim=(0, None))
    for axes in panels[1:]:
        axes.sharey(panels[0])
    for i, axes in enumerate(panels):
        draw_change(axes, result, scene, led=i)
        if i < leds - 1:
            axes.set_xlabel("")
    return figure


def draw_change(axes: "Axes", result: xr.Dataset, scene: Scene | None, *, led: int) -> None:
    """Draw the change of every photodiode from rest under one LED into axes, with its value at the hold's end."""
    photodiodes = coloured_along_nail(scene, result.sizes["photodiode"])
    change, hold = result.volts_change, hold_end(result)
    hold_s = float(result.time[hold])
    scale, letter = prefix(_largest(one for of_led in change for one in of_led))
    thin = _thin(result)
    axes.axhline(0, color=style.MUTED, lw=0.8)
    for colour, j in photodiodes:
        moved = f"{significant(float(change[led, j, hold]) / scale, 3, sign=True)} {letter}V"
        moved = "saturated" if result.saturated[led, j].any() else moved
        label = f"{result.photodiode.values[j]}  {moved}"
        _line(axes, thin.volts_change[led, j] / scale, color=colour, label=style.plain(label))
    axes.axvline(hold_s, color=style.MUTED, lw=0.8, ls=(0, (2, 2)))
    _over_time(axes, result, style.plain(led_name(result, led)), f"change from rest [{letter}V]")
    _not_too_close(axes)
    # From the tip down, as on the nail.
    look: dict[str, Any] = {"reverse": True, "loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    axes.legend(title=f"at {hold_s:.3g} s", ncols=_legend_columns(len(photodiodes)), **look)


def _legend_columns(photodiodes: int) -> int:
    return 1 + (photodiodes - 1) // 16


@style.drawing()
def volts(result: xr.Dataset, scene: Scene | None, *, led: int) -> "Figure":
    """One LED's readings, one panel per photodiode: traced volts with errors, both reduced models and residuals.

    Proximal photodiodes are on the left, distal ones on the right. The band is the trace's standard error of the change
    from rest; its error of the level, which all samples share, is a number in the title.
    """
    order = order_along_nail(scene, result.sizes["photodiode"])
    if len(order) > PANELS:
        order = [order[k] for k in np.linspace(0, len(order) - 1, PANELS).round().astype(int)]
    rows, columns = -(-len(order) // 2), min(len(order), 2)
    ratios = [2.2, 1] * rows
    height_in, how = 0.8 + 2.2 * rows, {"sharex": True, "squeeze": False, "height_ratios": ratios}
    room = style.Room(left=0.85, top=0.55, across=0.85, down=0.25)
    figure, grid = style.panels(9.2, height_in, 2 * rows, columns, room_in=room, **how)
    each = [(result[f"volts_{name}"][led, j], result.volts[led, j]) for name in MODELS for j in order]
    missed_v = [float(np.abs(model - traced).max()) for model, traced in each]
    missed_scale, missed_letter = prefix(max(*missed_v, _largest(result.volts_noise_rms[led])))
    thin, rest = _thin(result, SAMPLES // columns).isel(led=led), result.isel(led=led, time=0)
    for k, (j, colour) in enumerate(zip(order, style.place_colours(len(order)), strict=True)):
        column, row = divmod(k, rows)
        main, below = grid[2 * row : 2 * row + 2, column]
        one = thin.isel(photodiode=j)
        scale, letter = prefix(float(np.abs(one.volts).max()))
        low, high = ((one.volts + k * one.volts_change_stderr) / scale for k in (-1, 1))
        main.fill_between(one.time, low, high, color=colour, alpha=0.45, lw=0, label="error of the trace")
        noise = one.volts_noise_rms / missed_scale
        below.axhline(0, color=style.MUTED, lw=0.7)
        below.fill_between(one.time, -noise, noise, color=style.MUTED, alpha=0.16, lw=0)
        _line(main, one.volts / scale, color=colour, label="traced light")
        for name, (label, look) in MODELS.items():
            _line(main, one[f"volts_{name}"] / scale, label=label, **look)
            _line(below, (one[f"volts_{name}"] - one.volts) / missed_scale, **look)
        main.set_ylabel(f"volts [{letter}V]", fontsize=8)
        below.set_ylabel(f"residual\n[{missed_letter}V]", fontsize=8)
        level = with_error(float(rest.volts[j]) / scale, float(rest.volts_stderr[j]) / scale)
        main.set_title(style.plain(one.photodiode.values), color=style.INK)
        style.remark(main, "saturated" if one.saturated.any() else f"at rest {level} {letter}V")
        _not_too_close(main)
    residuals = grid[1::2].ravel()
    limit = 1.15 * max(abs(y) for axes in residuals for y in axes.dataLim.intervaly if np.isfinite(y)) or 1.0
    for axes in residuals:
        axes.set_ylim(-limit, limit)
    for axes in grid.ravel()[2 * len(order) :]:
        axes.set_visible(False)
    grid[0, 0].locator_params("x", nbins=6)
    for axes in grid[-1]:
        _over_time(axes, result)
    style.legend_above(figure, grid[0, 0], ncols=4, handlelength=2.2, columnspacing=1.4)
    return figure


def _thin(result: xr.Dataset, samples: int = SAMPLES) -> xr.Dataset:
    """At most so many times, the first and the last among them."""
    count = result.sizes["time"]
    return result.isel(time=np.unique(np.linspace(0, count - 1, min(count, samples)).round().astype(int)))


def _largest(rows: Iterable[xr.DataArray]) -> float:
    """The largest distance from 0 in rows that are read one after the other."""
    return float(np.fmax.reduce([abs(row).max() for row in rows]))


def _line(axes: "Axes", values: xr.DataArray, **look: Any) -> None:
    """A line over time; a dot where there is one time only."""
    if values.size == 1:
        look |= {"marker": "o", "linestyle": "none"}
    axes.plot(values.time.to_numpy(), values.to_numpy(), **look)


def _over_time(axes: "Axes", result: xr.Dataset, title: str = "", ylabel: str = "") -> None:
    axes.set(xlabel="time [s]", title=title or axes.get_title("left"), ylabel=ylabel or axes.get_ylabel())
    if result.sizes["time"] > 1:
        axes.set_xlim(float(result.time[0]), float(result.time[-1]))


def _not_too_close(axes: "Axes") -> None:
    """Keep rounding noise of a constant from filling the axes: show at least 1 per mille of the value."""
    low, high = axes.get_ylim()
    middle, least = (low + high) / 2, 1e-3 * max(abs(low), abs(high))
    if high - low < least:
        axes.set_ylim(middle - least, middle + least)
    axes.ticklabel_format(axis="y", useOffset=False)


def _legend_below(axes: "Axes", *, ncols: int = 2) -> None:
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=ncols, handlelength=1.8, columnspacing=1.2)


# What of an LED's light no region absorbs.
LEAVES = {"reflected": "leaves to the air", "transmitted": "leaves up the finger"}
NAMES = {
    "barrier": "barrier, opaque epoxy",
    "cover": "cover and rim, opaque epoxy",
    "photodiodes": "photodiodes that are read",
    "silicon": "photodiodes not wired",
    "leds": "LEDs, their own die too",
}
# Less of the light than this is not worth a bar, at any LED.
LEAST = 1e-4


@style.drawing()
def light_ends(result: xr.Dataset) -> "Figure":
    """One bar for each end of the light and LED, the ends that take most on top."""
    from matplotlib import colormaps

    value, stderr = (_ends(result, suffix) for suffix in ("", "_stderr"))
    most = value.max("led")
    ends = most.end[most >= LEAST].values[np.argsort(-most[most >= LEAST].values, kind="stable")]
    leds = result.sizes["led"]
    room = style.Room(left=0.25 + style.longest_in(ends), top=0.1)
    drawing, axes = style.panels(9.2, 0.8 + len(ends) * (0.14 + 0.16 * leds), room_in=room)
    rows, high = np.arange(len(ends)), 0.8 / leds
    # Not the colours of places along the nail, which warm and cool ones stand for.
    for i, colour in enumerate(colormaps["cividis"](np.linspace(0.45, 0.85, leds))):
        share, error = (100 * one.isel(led=i).sel(end=ends).values for one in (value, stderr))
        at = rows + (i - (leds - 1) / 2) * high
        look: dict[str, Any] = {"color": colour, "label": style.plain(led_name(result, i))}
        bars = axes.barh(at, share, 0.9 * high, xerr=error, ecolor=style.INK, **look)
        words = [f"{with_error(*pair)} %" for pair in zip(share, error, strict=True)]
        axes.bar_label(bars, words, padding=4, fontsize=8, color=style.INK)
    axes.set_yticks(rows, [style.plain(str(name)) for name in ends])
    axes.set(ylim=(len(ends) - 0.4, -0.6), xlim=(0, 118 * float(most.max())), xlabel="% of the LED's light")
    axes.grid(False, axis="y")
    if leds > 1:
        axes.legend(loc="lower right")
    return drawing


def _ends(result: xr.Dataset, suffix: str) -> xr.DataArray:
    """Fractions of each LED's light by their end in words, (led, end), or their standard errors."""
    left = result[f"energy_fraction{suffix}"].sel(part=list(LEAVES)).rename(part="end")
    taken = result[f"absorbed_fraction{suffix}"].rename(region="end")
    names = [*LEAVES.values(), *(NAMES.get(str(name), str(name)) for name in taken.end.values)]
    return xr.concat([left, taken], "end").assign_coords(end=names).transpose("led", "end")
