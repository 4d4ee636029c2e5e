"""Figures of a simulated touch: force, vessels, volts beside the reduced optics, and where the light ends."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...hemodynamics.for_scene import hold_end
from ...scene import Scene
from .. import style
from ..maps import coloured_along_nail, led_name
from ..numbers import prefix, significant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# More samples than this add bytes to a page and nothing to a picture.
SAMPLES = 500
# Small multiples stay readable up to so many photodiodes; of more, evenly spaced ones are shown.
PANELS = 16
DASHED = (0, (4, 2.5))
# What moves over time: title, label and scale of a panel, and the variables in it.
COURSES: tuple[tuple[str, str, float, tuple[str, ...]], ...] = (
    ("Force on the fingertip", "force [N]", 1.0, ("force_n", "shear_n")),
    ("Pressure that it makes", "pressure [kPa]", 1e-3, ("proximal_pressure_pa", "distal_pressure_pa")),
    ("Arterial pressure", "pressure [kPa]", 1e-3, ("arterial_pressure_pa",)),
    ("Capillaries", "diameter [µm]", 1e6, ("capillary_diameter_m",)),
    ("Vein of the pulp", "diameter [µm]", 1e6, ("vein_diameter_m",)),
    ("Blood in the nail bed", "blood fraction [%]", 100, ("blood_fraction",)),
    ("Its oxygen", "saturation [%]", 100, ("so2",)),
)
LINES = {
    "force_n": ("normal", style.INK),
    "shear_n": ("shear, towards the tip", style.VEIN),
    "proximal_pressure_pa": ("on the veins", style.ZONES[0]),
    "distal_pressure_pa": ("on the capillaries", style.ZONES[1]),
    "arterial_pressure_pa": ("", style.ZONES[0]),
}
# Without blood, at rest and beyond: a nail's colours.
BLOOD = ("#fbf6f2", "#e6a5a0", "#8e1022")
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "beer_lambert": ("Beer–Lambert (8)", {"color": style.INK, "ls": (0, (5, 2.5))}),
    "taylor": ("Taylor (9)", {"color": style.INK, "ls": (0, (1, 1.6))}),
}


@style.drawing()
def courses(result: xr.Dataset) -> "Figure":
    """The touch, and what it does to the vessels and to the blood of the nail bed and its oxygen, a panel for each."""
    thin, colours = _thin(result), style.place_colours(result.sizes["zone"])
    shown = [course for course in COURSES if course[3][0] in result]
    room = style.Room(left=0.65, across=0.7, down=0.7)
    figure, panels = style.tiles(len(shown), 3, 9.2, 2.5, room_in=room, sharex=True)
    for axes, (title, label, scale, names) in zip(panels, shown, strict=True):
        lines: list[tuple[str, str, xr.DataArray]] = []
        for name in names:
            if name in result and "zone" in result[name].dims:
                zones = zip(result.zone.values, colours, thin[name].transpose("zone", "time"), strict=True)
                lines += [(str(zone), colour, values) for zone, colour, values in zones]
            elif name in result:
                lines.append((*LINES.get(name, ("", style.VEIN)), thin[name]))
        for k, (text, colour, values) in enumerate(lines):
            # Curves that lie on one another are all visible.
            look = {"color": colour, "linestyle": ("-", DASHED)[k % 2], "label": style.plain(text)}
            _line(axes, scale * values, **look)
        _over_time(axes, result, title, label)
        _not_too_close(axes)
        axes.tick_params(labelbottom=True)
        if len(lines) > 1:
            axes.legend(loc="best", fontsize=7, handlelength=1.8)
    return figure


@style.drawing()
def bed(result: xr.Dataset, scene: Scene) -> "Figure":
    """Blood of the nail bed along the nail over time, as a part of that at rest, and where the white band ends."""
    from matplotlib.colors import LinearSegmentedColormap

    half_mm, thin = scene.fingertip.nail_length_mm / 2, _thin(result)
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
    """Change of every photodiode from rest, one panel per LED."""
    leds = result.sizes["led"]
    figure, panels = style.panels(9.2, 0.4 + 3.4 * leds, leds, sharex=True, sharey=True, squeeze=False)
    for i, axes in enumerate(panels[:, 0]):
        draw_change(axes, result, scene, led=i)
        axes.label_outer()
    return figure


def draw_change(axes: "Axes", result: xr.Dataset, scene: Scene | None, *, led: int) -> None:
    """Draw the change of every photodiode from rest under one LED into axes, with its value at the hold's end."""
    photodiodes = coloured_along_nail(scene, result.sizes["photodiode"])
    change, hold = result.volts_change, hold_end(result)
    hold_s = float(result.time[hold])
    scale, letter = prefix(_largest(course for of_led in change for course in of_led))
    thin = _thin(result)
    axes.axhline(0, color=style.MUTED, lw=0.8)
    for colour, j in photodiodes:
        moved = f"{significant(float(change[led, j, hold]) / scale, 3, sign=True)} {letter}V"
        moved = "saturated" if result.saturated[led, j].any() else moved
        moved = moved if result.detected_fraction[led, j].any() else "no light"
        label = f"{result.photodiode.values[j]}  {moved}"
        _line(axes, thin.volts_change[led, j] / scale, color=colour, label=style.plain(label))
    axes.axvline(hold_s, color=style.MUTED, lw=0.8, ls=(0, (2, 2)))
    _over_time(axes, result, style.plain(led_name(result, led)), f"change from rest [{letter}V]")
    _not_too_close(axes)
    # From the tip down, as on the nail.
    look: dict[str, Any] = {"reverse": True, "loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    axes.legend(title=f"at {hold_s:.3g} s", ncols=1 + (len(photodiodes) - 1) // 16, **look)


def volts(result: xr.Dataset, scene: Scene | None, *, led: int) -> "Figure":
    """One LED's readings, one panel per photodiode, the more proximal ones first: change from rest of traced light and
    of both reduced models, with the trace's error of the change."""
    order = coloured_along_nail(scene, result.sizes["photodiode"])
    if len(order) > PANELS:
        order = [order[k] for k in np.linspace(0, len(order) - 1, PANELS).round().astype(int)]
    colours, places = zip(*order, strict=True)
    thin = _thin(result).isel(led=led, photodiode=list(places)).transpose("photodiode", "time", ...)
    rest = result.volts.isel(led=led, photodiode=list(places), time=0).where(thin.detected_fraction.any("time"))
    scale, letter = prefix(_largest(thin.volts_change))
    models = {label: ((thin[f"volts_{name}"] - rest).values / scale, look) for name, (label, look) in MODELS.items()}
    traced, stderr = (thin[name].values / scale for name in ("volts_change", "volts_change_stderr"))
    named = dict(zip(thin.photodiode.values, colours, strict=True))
    labels = {"xlabel": "time [s]", "ylabel": f"change [{letter}V]"}
    return style.beside_models(thin.time.values, traced, stderr, models, named=named, **labels)


def _thin(result: xr.Dataset) -> xr.Dataset:
    """At most so many times, the first and the last among them; no change of what detected no light."""
    count = result.sizes["time"]
    thin = result.isel(time=np.unique(np.linspace(0, count - 1, min(count, SAMPLES)).round().astype(int)))
    return thin.assign(volts_change=thin.volts_change.where(thin.detected_fraction.any("time")))


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
