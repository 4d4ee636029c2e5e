"""Figures of a placement: the ranking, what limits it, its front, and maps of light, sensitivity and resolution."""

from typing import Any

import numpy as np
import xarray as xr

from ...scene import Scene
from .. import maps, style
from ..numbers import quantity
from ..scene_description import CAUSES

SHOWN = 20
# A cause of less than this of a layout's variance is not drawn.
LEAST_PART = 5e-3
SMOOTH_CELLS = 2.0
# Relative errors beyond which a resolution, which few photons bias low, and a ratio to the light are left blank.
KNOWN, KNOWN_LIGHT = 0.25, 0.7
# Dynamic range of the maps of light, and of resolution.
DIMMEST, COARSEST = 3e4, 100.0
# Maps side by side, their width together, the room of labels, and the bar of colours beside each of them. [inch]
COLUMNS, WIDTH_IN = 3, 9.6
ROOM_IN = style.Room(left=0.55, right=0.6, across=0.8, down=0.8)
BAR: dict[str, Any] = {"fraction": 0.07, "pad": 0.03, "shrink": 0.85, "aspect": 30}


@style.drawing()
def ranking_figure(result: xr.Dataset) -> "style.Figure":
    """Layouts with their intervals, best on top."""
    shown = result.isel(layout=slice(SHOWN))
    names, rows, tied = shown.layout.values, np.arange(shown.sizes["layout"]), shown.tied.values
    force = "force_error" if "force_error_n" in shown else "force_resolution"
    best, low, high = (1e3 * shown[f"{force}_{end}n"].values for end in ("", "low_", "high_"))
    colours = np.where(names == "paper", *style.ZONES)
    figure, axes = style.panels(4.6, 0.9 + 0.32 * len(rows))
    on_finger = shown.finger_force_error_n if "force_error_n" in shown else shown.finger_resolution_n
    axes.plot(1e3 * on_finger.values, rows, "|", color=style.MUTED, ms=9, mew=1.0, zorder=1)
    axes.hlines(rows, low, high, colors=colours, lw=2.2)
    axes.scatter(best, rows, 36, np.where(tied, colours, "none"), edgecolors=colours, zorder=3)
    finest, left = best.min(), 0.0
    if force == "force_error" and "people_off" not in shown:
        left = 1e3 * float(shown.force_error_floor_n.max())
        axes.axvline(left, color=style.MUTED, ls=":", label="the same for all layouts")
        style.legend_above(figure, axes, ncols=1)
    elif "electronics_resolution_n" in shown:
        alone = 1e3 * shown.electronics_resolution_n.values
        axes.plot(alone, rows, "D", mfc="none", mec=style.MUTED, ms=4.5, label="electronics alone")
        style.legend_above(figure, axes, ncols=1)
        finest = alone.min()
    style.named_rows(axes, names)
    axes.set_xlabel("error of the force over touches [mN]" if force == "force_error" else "force resolution [mN]")
    if high.max() > 8 * finest:
        axes.set_xscale("log")
        style.plain_log(axes.xaxis)
    else:
        axes.set_xlim(left=0.95 * left)
    return figure


@style.drawing()
def budget_figure(budgets: list[dict[str, Any]]) -> "style.Figure":
    """What a layout can change of the variance of its force by cause, one bar for each layout, as of `budgets`."""
    causes = list(budgets[0])[3:]
    variance = np.array([[1e6 * budget[cause] ** 2 for budget in budgets] for cause in causes])
    ends = variance.cumsum(0)
    shown = np.flatnonzero((variance > LEAST_PART * ends[-1]).any(1))
    figure, axes = style.panels(4.6, 1.3 + 0.36 * len(budgets))
    for k, colour in zip(shown, style.place_colours(len(shown)), strict=True):
        look: dict[str, Any] = {"height": 0.6, "color": colour, "label": CAUSES.get(causes[k], causes[k])}
        bars = axes.barh(range(len(budgets)), variance[k], left=ends[k] - variance[k], **look)
    axes.bar_label(bars, [quantity(1e-3 * rms_mn, "N") for rms_mn in np.sqrt(ends[-1])], padding=4, fontsize=8)
    style.named_rows(axes, [budget["layout"] for budget in budgets])
    axes.set(xlim=(0, 1.35 * ends.max()), xlabel="variance of the force [mN²]")
    style.legend_above(figure, axes, ncols=3)
    return figure


@style.drawing()
def front_figure(result: xr.Dataset, words: str, factor: float, unit: str) -> "style.Figure":
    """What layouts are ranked by over the number of photodiodes, a line for each power of the LEDs; filled on the
    Pareto front. words, factor, unit : what it is, and in which it is shown."""
    figure, axes = style.panels(4.6, 3.4)
    counts, powers = result.front_photodiodes.values, result.led_power_mw.values
    for j, colour in enumerate(style.place_colours(len(powers))):
        at = result.isel(led_power_mw=j)
        value, error = factor * at.front_error.values, factor * at.front_error_stderr.values
        # Beside each other, as powers that resolve alike would hide each other.
        at_counts = counts + 0.025 * max(np.ptp(counts), 1) * (j - (len(powers) - 1) / 2)
        look: dict[str, Any] = {"color": colour, "lw": 1.2, "capsize": 2, "ls": ("-", "--")[j % 2]}
        axes.errorbar(at_counts, value, error, label=quantity(1e-3 * powers[j], "W"), **look)
        axes.scatter(at_counts, value, 34, np.where(at.on_front, colour, "#ffffff"), edgecolors=colour, zorder=3)
    axes.set(xlabel="photodiodes", ylabel=f"{words}{unit and f' [{unit.strip()}]'}", xticks=counts)
    axes.set_yscale("log")
    style.plain_log(axes.yaxis)
    style.legend_above(figure, axes, ncols=4)
    return figure


@style.drawing()
def map_figure(scene: Scene, result: xr.Dataset, *, led: int) -> "style.Figure":
    """One LED's light over the board, what of it is shunted and how blood dims it; the resolution of one photodiode,
    and of the layouts with the LED at each site that was tried."""
    from matplotlib.colors import LogNorm, Normalize

    of_led = result.isel(led=led)
    light, shunted, error = (_smooth(of_led[name]) for name in ("irradiance", "direct", "irradiance_stderr"))
    own, own_error = of_led.place_resolution_n, of_led.place_resolution_n_stderr
    own_mn = 1e3 * own.where((own_error > 0) & (own_error < KNOWN * own))
    divisor = light.where((light > 0) & (error <= KNOWN_LIGHT * light))
    falls = [_smooth(-fall) / divisor for fall in of_led.sensitivity.transpose("blood_zone", ...)]
    finest, steepest = float(own_mn.min().fillna(1.0)), max(float(fall.quantile(0.99).fillna(0.0)) for fall in falls)
    brightest = [float(values.max()) or 1.0 for values in (light, shunted)]
    of_light = [LogNorm(top / DIMMEST, top) for top in brightest]
    of_blood = Normalize(0.0, steepest or 1.0)
    shown = [
        ("Light [1/mm²]", light, "viridis", of_light[0]),
        ("Shunted light [1/mm²]", shunted, "viridis", of_light[1]),
        ("Proximal blood [%/%]", falls[0], "magma", of_blood),
        ("Distal blood [%/%]", falls[1], "magma", of_blood),
        ("One photodiode [mN]", own_mn, "viridis_r", LogNorm(finest, COARSEST * finest)),
    ]
    tried = bool(result.sizes["led_site"])
    board = maps.extent(result.u.values, result.v.values)
    across_in = (WIDTH_IN - ROOM_IN.left - ROOM_IN.right - (COLUMNS - 1) * ROOM_IN.across) / COLUMNS
    height_in = (1 - BAR["fraction"] - BAR["pad"]) * across_in * (board[3] - board[2]) / (board[1] - board[0])
    figure, panels = style.tiles(len(shown) + tried, COLUMNS, WIDTH_IN, height_in + ROOM_IN.down, room_in=ROOM_IN)
    for axes, values in zip(panels, shown, strict=False):
        _draw_map(axes, *values)
        _parts(axes, scene, led)
    if tried:
        _draw_sites(panels[-1], result, str(of_led.led.item()))
    for axes in panels:
        axes.axis(board)
        axes.set(aspect="equal", xlabel="across [mm]", ylabel="along, to the tip [mm]" if axes in panels[::3] else "")
        axes.grid(False)
    return figure


def _draw_map(axes: "style.Axes", title: str, values: xr.DataArray, colours: str, norm: Any) -> None:
    """A map with contours and the bar of its colours; blank where nothing is known."""
    across, along = (values[name].values for name in values.dims)
    shown = np.clip(values.values, norm.vmin, norm.vmax).T
    image = axes.imshow(shown, extent=maps.extent(across, along), origin="lower", cmap=colours, norm=norm)
    if min(shown.shape) > 1:
        levels = norm.inverse(np.linspace(0, 1, 9))[1:-1]
        axes.contour(across, along, shown, levels=levels, colors=["#ffffff"], linewidths=0.5, alpha=0.7)
    axes.figure.colorbar(image, ax=axes, **BAR)
    axes.set_title(title)


def _draw_sites(axes: "style.Axes", result: xr.Dataset, led: str) -> None:
    """Sites of one LED by force resolution; of several arrangements with it, that of the best."""
    from matplotlib.colors import LogNorm

    tried = result.led_site_mm
    # Where a given layout is the best, its LEDs may be others than those that were searched.
    number = list(tried.searched_led.values).index(led) if led in tried.searched_led.values else 0
    place, resolution_mn = tried.isel(searched_led=number).to_numpy(), 1e3 * result.led_site_resolution_n.to_numpy()
    norm = LogNorm(resolution_mn.min(), max(resolution_mn.max(), 1.001 * resolution_mn.min()))
    marks = {"left": (">", 0.2, 0), "right": ("<", -0.2, 0), "below": ("^", 0, 0.2), "above": ("v", 0, -0.2)}
    for side in dict.fromkeys(result.led_site_side.values):
        mark, *aside = marks.get(str(side), ("o", 0, 0))
        at = np.flatnonzero(result.led_site_side.values == side)
        # The finest is drawn last, over the others.
        at = at[np.argsort(-resolution_mn[at])]
        look: dict[str, Any] = {"cmap": "viridis_r", "norm": norm, "edgecolors": style.MUTED, "linewidths": 0.4}
        u_mm, v_mm = (place[at] + aside).T
        image = axes.scatter(u_mm, v_mm, s=24, c=resolution_mn[at], marker=mark, **look)
    axes.figure.colorbar(image, ax=axes, **BAR, format="{x:g}").ax.yaxis.set_minor_formatter("{x:g}")
    axes.set_title("LEDs tried [mN]")


def _parts(axes: "style.Axes", scene: Scene, lit: int) -> None:
    """Outline the layout's parts over a map; the LED that is lit is filled."""
    for line in scene.layout.border_mm:
        maps.draw_area(axes, line, zorder=3, fc="none", ec=style.MUTED, lw=0.8)
    for r in scene.layout.barriers:
        maps.draw_area(axes, r, zorder=3, fc=maps.BARRIER, lw=0)
    for r in (*scene.layout.leds, *scene.layout.photodiode_areas):
        fill = maps.LED if r == scene.layout.leds[lit] else "none"
        for colour, width in (("#ffffff", 1.8), (style.DARK_INK, 0.8)):
            maps.draw_area(axes, r, zorder=3, fc=fill, ec=colour, lw=width)


def _smooth(values: xr.DataArray) -> xr.DataArray:
    """A map without the grain of single photons; what is not finite counts as nothing known."""
    known = np.isfinite(values.to_numpy())
    weight = maps.smoothed(known.astype(float), SMOOTH_CELLS)
    smooth = maps.smoothed(np.where(known, values, 0.0), SMOOTH_CELLS)
    return values.copy(data=smooth / np.where(weight > 0.05, weight, np.nan))
