"""Figures of a placement: the ranking, the board, and maps of light, noise and resolution."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...scene import Scene
from ...scene.layout import Rectangle
from .. import maps, style
from ..scene_description import CAUSES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 20
# A cause of less than this of a layout's variance is not drawn.
LEAST_PART = 5e-3
SMOOTH_CELLS = 2.0
# A resolution whose relative error is larger is left blank: with few photons it is biased low.
KNOWN = 0.25
# Dynamic range of the maps of light.
DIMMEST = 3e4


@style.drawing()
def ranking_figure(result: xr.Dataset) -> "Figure":
    """Layouts with their intervals, best on top."""
    count = min(result.sizes["layout"], SHOWN)
    figure, axes = style.panels(7.2, 0.9 + 0.32 * count)
    for i in range(count):
        best, low, high = (1e3 * float(result[f"force_resolution_{end}n"][i]) for end in ("", "low_", "high_"))
        colour = style.ZONES[0] if str(result.layout.values[i]) == "paper" else style.ZONES[1]
        axes.plot([low, high], [i, i], color=colour, lw=2.2, solid_capstyle="butt")
        axes.plot([best], [i], "o", mfc=colour if bool(result.tied[i]) else "none", mec=colour, ms=6)
        fingers_mn = 1e3 * result.finger_resolution_n.values[i]
        axes.plot(fingers_mn, [i] * len(fingers_mn), "|", color=style.MUTED, ms=9, mew=1.0, zorder=1)
    if "electronics_resolution_n" in result:
        still = 1e3 * result.electronics_resolution_n.values[:count]
        axes.plot(still, range(count), "D", mfc="none", mec=style.MUTED, ms=4.5, label="electronics alone")
        style.legend_above(figure, axes, ncols=1)
    axes.set_yticks(range(count), [style.plain(name).replace("_", " ") for name in result.layout.values[:count]])
    axes.set(ylim=(count - 0.5, -0.5), xlabel="force resolution [mN]")
    finest = float(result.get("electronics_resolution_n", result.force_resolution_n).min())
    if float(result.force_resolution_high_n[:count].max()) > 8 * finest:
        axes.set_xscale("log")
        style.plain_log(axes.xaxis)
    else:
        axes.set_xlim(left=0)
    return figure


@style.drawing()
def budget_figure(rows: list[dict[str, Any]]) -> "Figure":
    """What a layout can change of the variance of its force by cause, one bar for each layout, as of `budgets`."""
    causes = list(rows[0])[3:]
    variance = {cause: np.array([1e6 * row.get(cause, 0.0) ** 2 for row in rows]) for cause in causes}
    shown = [cause for cause, v2 in variance.items() if (v2 > LEAST_PART * sum(variance.values())).any()]
    figure, axes = style.panels(7.2, 1.3 + 0.36 * len(rows))
    left, colours = np.zeros(len(rows)), style.place_colours(len(shown))
    for cause, colour in zip(shown, colours, strict=True):
        axes.barh(
            range(len(rows)), variance[cause], left=left, height=0.6, color=colour, label=CAUSES.get(cause, cause)
        )
        left += variance[cause]
    for i, (end, row) in enumerate(zip(left, rows, strict=True)):
        rms_mn = 1e3 * np.sqrt(row["total"] ** 2 - row["floor"] ** 2)
        axes.annotate(f"{rms_mn:.3g} mN", (end, i), (4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(range(len(rows)), [style.plain(row["layout"]).replace("_", " ") for row in rows])
    axes.set(xlim=(0, 1.2 * left.max()), ylim=(len(rows) - 0.5, -0.5), xlabel="variance of the force [mN²]")
    style.legend_above(figure, axes, ncols=4)
    return figure


@style.drawing()
def map_figure(scene: Scene, result: xr.Dataset) -> "Figure":
    """Light and its direct part, and noise and resolution of one photodiode, over the board."""
    from matplotlib.colors import LogNorm, Normalize

    light, direct = (_smooth(result[name].isel(led=0).to_numpy()) for name in ("irradiance", "direct"))
    noise = 1e6 * result.place_noise_v.isel(led=0).to_numpy()
    resolution = 1e3 * _known(result, "place_resolution_n")
    finest = float(np.nanmin(resolution)) if np.isfinite(resolution).any() else 1.0
    # Boards are narrow, and a title on one line would be cut off at the picture's edge.
    panels = [
        ("Light\n[1/mm²]", "u", light, "viridis", _bright(light)),
        ("Shunted light\n[1/mm²]", "u", direct, "viridis", _bright(direct)),
        ("Noise of a photodiode\n[µV]", "place_u", noise, "viridis", Normalize(noise.min(), noise.max())),
        ("Its own resolution\n[mN]", "place_u", resolution, "viridis_r", LogNorm(finest, 100 * finest)),
    ]
    figure, grid = style.panels(9.2, 4.9, 1, 4) if slender(result) else style.panels(9.2, 8.4, 2, 2)
    _draw_maps(grid.flat, scene, result, panels)
    for axes in grid.flat:
        axes.axis(maps.extent(result.u.to_numpy(), result.v.to_numpy()))
    return figure


@style.drawing()
def sensitivity_figure(scene: Scene, result: xr.Dataset) -> "Figure":
    """Fall of the light with the blood of either zone, relative to the light there."""
    from matplotlib.colors import Normalize

    light = _smooth(result.irradiance.isel(led=0).to_numpy())
    # Where few photons came, the ratio is noise and is left blank.
    light[_smooth(result.irradiance_stderr.isel(led=0).to_numpy()) > 0.7 * light] = np.nan
    sensitivity = [_smooth(-result.sensitivity.isel(led=0, blood_zone=k).to_numpy()) for k in range(2)]
    with np.errstate(invalid="ignore", divide="ignore"):
        fall = [np.where(light > 0, z / light, np.nan) for z in sensitivity]
    norm = Normalize(0.0, float(np.nanquantile(np.stack(fall), 0.99)))
    titles = ("Proximal blood [%/%]", "Distal blood [%/%]")
    figure, grid = style.panels(5.6 if slender(result) else 9.2, 4.7, 1, 2)
    _draw_maps(grid, scene, result, [(title, "u", z, "magma", norm) for title, z in zip(titles, fall, strict=True)])
    return figure


def slender(result: xr.Dataset) -> bool:
    """Whether the board is so long and narrow that four maps have room beside one another."""
    return bool(np.ptp(result.v.to_numpy()) > 2 * np.ptp(result.u.to_numpy()))


def _known(result: xr.Dataset, name: str) -> np.ndarray:
    """Values of the first LED where photons enough stand behind them, nan elsewhere."""
    value, error = (result[f"{name}{end}"].isel(led=0).to_numpy() for end in ("", "_stderr"))
    with np.errstate(invalid="ignore"):
        return np.where((error > 0) & (error < KNOWN * value), value, np.nan)


def _bright(light: np.ndarray) -> Any:
    """The colour scale of light: down to a fixed part of the brightest."""
    from matplotlib.colors import LogNorm

    top = float(light.max()) or 1.0
    return LogNorm(top / DIMMEST, top)


def _draw_maps(grid: Iterable["Axes"], scene: Scene, result: xr.Dataset, panels: Iterable[tuple[Any, ...]]) -> None:
    """Draw maps with contours, the bar of their colours and the board's parts; blank where nothing is known.

    panels : title, name of the coordinate across (that along has v in its place), values, colour map and its scale.
    """
    for axes, (title, u, values, colours, norm) in zip(grid, panels, strict=True):
        across, along = result[u].to_numpy(), result[u.replace("u", "v")].to_numpy()
        shown = np.clip(values, norm.vmin, norm.vmax).T
        image = axes.imshow(shown, extent=maps.extent(across, along), origin="lower", cmap=colours, norm=norm)
        if min(shown.shape) > 1:
            levels = norm.inverse(np.linspace(0, 1, 9))[1:-1]
            axes.contour(across, along, shown, levels=levels, colors=["#ffffff"], linewidths=0.5, alpha=0.7)
        axes.figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02)
        axes.set_title(title)
        _parts(axes, scene, result)


@style.drawing()
def sites_figure(result: xr.Dataset) -> "Figure":
    """Candidate positions of one LED by force resolution; of several arrangements with it, that of the best."""
    from matplotlib.colors import LogNorm

    figure, axes = style.panels(5.6, 4.8)
    tried, led = result.led_site_mm, str(result.led.values[0])
    # Where a given layout is the best, its LEDs may be others than those that were searched.
    number = list(tried.searched_led.values).index(led) if led in tried.searched_led.values else 0
    place, resolution_mn = tried.isel(searched_led=number).to_numpy(), 1e3 * result.led_site_resolution_n.to_numpy()
    norm = LogNorm(resolution_mn.min(), max(resolution_mn.max(), 1.001 * resolution_mn.min()))
    marks = {"left": (">", 0.12, 0), "right": ("<", -0.12, 0), "below": ("^", 0, 0.12), "above": ("v", 0, -0.12)}
    look: dict[str, Any] = {"cmap": "viridis_r", "s": 46, "edgecolors": style.MUTED, "linewidths": 0.4}
    for side in dict.fromkeys(result.led_site_side.values):
        at, (mark, du, dv) = result.led_site_side.values == side, marks.get(str(side), ("o", 0, 0))
        # The finest is drawn last, over the others.
        at = np.flatnonzero(at)[np.argsort(-resolution_mn[at])]
        image = axes.scatter(place[at, 0] + du, place[at, 1] + dv, c=resolution_mn[at], norm=norm, marker=mark, **look)
    figure.colorbar(image, ax=axes, label="force resolution [mN]", format="{x:g}").ax.yaxis.set_minor_formatter("{x:g}")
    axes.axis(maps.extent(result.u.to_numpy(), result.v.to_numpy()))
    axes.set(aspect="equal", xlabel=maps.ACROSS, ylabel=maps.ALONG)
    return figure


def _lit(scene: Scene, result: xr.Dataset) -> Rectangle:
    """The LED that a result of one LED is about."""
    return next(die for die in scene.layout.leds if die.name == str(result.led.values[0]))


def _parts(axes: "Axes", scene: Scene, result: xr.Dataset) -> None:
    """Outline the layout's parts over a map; the LED that is lit is filled."""
    lit = _lit(scene, result)
    for r in scene.layout.barriers:
        maps.draw_rectangle(axes, r, zorder=3, fc=maps.BARRIER, lw=0)
    boxes = [(e.area, "none") for e in scene.layout.photodiodes] + [
        (led, maps.LED if led == lit else "none") for led in scene.layout.leds
    ]
    for r, fill in boxes:
        for colour, width in (("#ffffff", 1.8), (style.DARK_INK, 0.8)):
            maps.draw_rectangle(axes, r, zorder=3, fc=fill, ec=colour, lw=width)
    axes.grid(False)
    axes.set(xlabel="across [mm]", ylabel="along, to the tip [mm]")


def _smooth(values: np.ndarray) -> np.ndarray:
    """A map without the grain of single photons; what is not finite counts as nothing known."""
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(values)
    weight = gaussian_filter(known.astype(float), SMOOTH_CELLS)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight > 0.05, gaussian_filter(np.where(known, values, 0.0), SMOOTH_CELLS) / weight, np.nan)
