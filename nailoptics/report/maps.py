"""Figures in space: the board on the nail from above, and the finger cut lengthwise with the light's paths."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from ..light import optics
from ..scene import Scene, parse_scene
from ..scene.base import Point
from ..scene.rectangles import Rectangle
from . import style
from .html import texts

TEXTS = texts("maps")
NAIL, LED, TISSUE = TEXTS["nail"], TEXTS["led"], TEXTS["regions"]
BOARD, BARRIER = TISSUE["kapton"], TISSUE["barrier"]
DECADES = 3
# Names of parts stand so far beside the board; mean width of their letters, and from line to line; names that take
# more than this fraction of the drawing's width are written smaller. [mm], [inch], [1]
LABEL_MM, LETTER_IN, LINE_IN, MOST_NAMES_PART = 0.45, 0.065, 0.125, 0.65
MOST_NAMED = 64  # photodiodes; names of more could not be read
# Beside the section stand its key and the scale of the paths.
BESIDE = style.Room(left=0.55, right=1.25, down=0.7)
LAYERS = ("plate", "bed", "bone")
ACROSS, ALONG = "across the nail [mm]", "along the nail, towards the tip [mm]"


def led_name(result: xr.Dataset, led: int) -> str:
    """An LED with its wavelength."""
    return f"LED {result.led.values[led]}, {float(result.wavelength_nm[led]):g} nm"


def order_along_nail(scene: Scene) -> list[int]:
    """Indices of the photodiodes from the most proximal to the most distal."""
    areas = scene.layout.photodiode_areas
    return sorted(range(len(areas)), key=lambda j: areas[j].center_mm[1])


def coloured_along_nail(scene: Scene) -> list[tuple[str, int]]:
    """Colour and index of each photodiode, from the most proximal to the most distal."""
    order, distal = order_along_nail(scene), sum(area.center_mm[1] > 0 for area in scene.layout.photodiode_areas)
    return list(zip(style.place_colours(len(order), distal), order, strict=True))


def colours_of(result: xr.Dataset) -> list[str]:
    """Colour of each photodiode's place along the nail, in the order of a result."""
    scene = parse_scene(str(result.attrs["scene"]), name="the result's scene")
    return [colour for colour, _ in sorted(coloured_along_nail(scene), key=lambda one: one[1])]


def extent(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float, float]:
    """Outer edges of an image's pixels, from their middles: low x, high x, low y, high y."""
    dx, dy = ((places[1] - places[0]) / 2 if len(places) > 1 else 0.5 for places in (x, y))
    return float(x[0] - dx), float(x[-1] + dx), float(y[0] - dy), float(y[-1] + dy)


def draw_area(axes: "style.Axes", area: Rectangle | Sequence[Point], **look: Any) -> None:
    """Draw a rectangle of the board, or what lies within corners, with the tip upwards."""
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(area.corners_mm if isinstance(area, Rectangle) else area, closed=True, **look))


@style.drawing()
def top_view(scene: Scene) -> "style.Figure":
    """The board on the nail, seen from above and rolled flat: what is where, and which blood lies below."""
    figure, axes = style.panels(4.5, 3.9, room_in=style.Room(left=0.55, top=0.1))
    draw_top_view(axes, scene)
    return figure


def draw_top_view(axes: "style.Axes", scene: Scene) -> None:
    """Draw the top view into axes."""
    layout, finger = scene.layout, scene.fingertip
    half_u, half_v = finger.nail_width_mm / 2, finger.nail_length_mm / 2
    draw_area(axes, Rectangle("nail", -half_u, half_u, -half_v, half_v), fc=NAIL, ec=style.MUTED, lw=1.2)
    _blood_zones(axes, scene, half_u, half_v)
    border, *holes = layout.border_mm or (layout.outline.corners_mm,)
    for area, fill in ((border, BOARD), *((hole, NAIL) for hole in holes)):
        draw_area(axes, area, zorder=2, fc=fill, ec=style.DARK_INK, lw=0.8, alpha=0.9)
    for wall in layout.barriers:
        draw_area(axes, wall, zorder=3, fc=BARRIER, lw=0)
    for element in layout.unwired:
        draw_area(axes, element, zorder=3, fc="#c9ccd0", ec="#70767d", lw=0.5)
    for colour, j in coloured_along_nail(scene):
        draw_area(axes, layout.photodiode_areas[j], zorder=4, fc=colour, ec=style.DARK_INK, lw=0.6)
    for led in layout.leds:
        draw_area(axes, led, zorder=4, fc=LED, ec=style.DARK_INK, lw=0.8)
    groups = _names_beside(scene)
    letters = [max((len(name) for _, name in group), default=0) for group in groups]
    # Boards may be as wide as the nail, and their labels need room beside them.
    box, dpi = axes.get_window_extent(), axes.figure.dpi
    ends = np.array([layout.outline.u_min - LABEL_MM, layout.outline.u_max + LABEL_MM])
    letter_in = min(LETTER_IN, MOST_NAMES_PART * box.width / dpi / (sum(letters) + 4))
    filled = letter_in * (sum(letters) + 4) * dpi / box.width
    mm_per_in = dpi * max(np.ptp(ends) / (1 - filled) / box.width, (2 * half_v + 0.6) / box.height)
    low, high = ends + np.multiply((-1, 1), letter_in * mm_per_in * np.add(letters, 2))
    low, high = min(-half_u - 0.3, low), max(half_u + 0.3, high)
    axes.set(xlim=(low, high), ylim=(-half_v - 0.3, half_v + 0.3), aspect="equal", xlabel=ACROSS, ylabel=ALONG)
    axes.grid(False)
    gap = min(LINE_IN * mm_per_in, 1.9 * half_v / max(map(len, groups)))
    size = 8.0 * min(letter_in / LETTER_IN, gap / (LINE_IN * mm_per_in))
    _label_parts(axes, layout.outline, groups, gap, max(size, 3.0))


def _blood_zones(axes: "style.Axes", scene: Scene, half_u: float, half_v: float) -> None:
    """Tint the nail by the blood zones below it, as smoothly as they pass into each other."""
    from matplotlib.colors import to_rgb

    v = np.linspace(-half_v, half_v, 256)
    weights = optics.zones(scene).weights(v)
    tint = weights @ np.array([to_rgb(c) for c in style.place_colours(weights.shape[1])])
    image = np.concatenate([tint, np.full((len(v), 1), 0.30)], axis=1)[:, None]
    axes.imshow(image, extent=(-half_u, half_u, -half_v, half_v), origin="lower", aspect="auto", zorder=1)
    for edge in scene.zone_edges_mm:
        for side in (-1, 1):
            place = edge + side * scene.zone_width_mm / 2
            axes.plot([-half_u, half_u], [place, place], color=style.DARK_INK, lw=0.6, ls=(0, (2, 3)), zorder=1.5)
    for name, side, va in (("distal blood", 1, "top"), ("proximal blood", -1, "bottom")):
        axes.text(-half_u + 0.15, side * (half_v - 0.15), name, va=va, color=style.DARK_INK, fontsize=8, zorder=5)


def _names_beside(scene: Scene) -> list[list[tuple[Rectangle, str]]]:
    """Parts with the names that stand left and right of the board: photodiodes on the right, if they are not too many,
    the rest on the side where it lies, but where the line to a name would cross another part."""
    layout = scene.layout
    right = [(e.area, e.name) for e in layout.photodiodes]
    middle = sum(r.center_mm[0] for r, _ in right) / len(right)
    others = [(r, f"LED {r.name}, {led.wavelength_nm:g} nm") for r, led in zip(layout.leds, scene.leds, strict=True)]
    if layout.barriers:
        wall = layout.barriers[0]
        at = wall.v_min + 0.93 * (wall.v_max - wall.v_min)
        others.append((Rectangle("", wall.u_min, wall.u_max, at, at), "opaque barrier"))
    if layout.unwired:
        lowest = min(layout.unwired, key=lambda r: r.v_min)
        others.append((Rectangle("", lowest.u_min + 0.1, lowest.u_max, lowest.v_min, lowest.v_max), "not wired"))
    named = [(1, *one) for one in right if len(right) <= MOST_NAMED]
    sides = named + [(1 if r.center_mm[0] > middle else -1, r, name) for r, name in others]
    parts = [*layout.leds, *layout.photodiode_areas]
    groups: dict[int, list[tuple[Rectangle, str]]] = {-1: [], 1: []}
    for side, r, name in sides:
        u, v = r.center_mm
        right_of = [other.center_mm[0] > u for other in parts if other != r and other.v_min < v < other.v_max]
        is_hidden = (side == 1) in right_of and (side != 1) not in right_of
        groups[-side if is_hidden else side].append((r, name))
    return [*groups.values()]


def _label_parts(
    axes: "style.Axes",
    outline: Rectangle,
    groups: Sequence[Sequence[tuple[Rectangle, str]]],
    gap: float,
    fontsize: float,
) -> None:
    """Write names left and right of the board, none on another. gap : between their lines. [mm]"""
    from matplotlib.patheffects import withStroke

    for group, side, bound, ha in zip(groups, (-1, 1), ("u_min", "u_max"), ("right", "left"), strict=True):
        edge = getattr(outline, bound)
        look: dict[str, Any] = {"color": style.DARK_INK, "fontsize": fontsize, "ha": ha, "va": "center", "zorder": 6}
        look["path_effects"] = [withStroke(linewidth=2, foreground=NAIL)]  # where it crosses the nail's edge
        for (r, name), place in zip(group, style.spread([r.center_mm[1] for r, _ in group], gap), strict=True):
            v, u = r.center_mm[1], [getattr(r, bound), edge, edge + side * 0.37]
            axes.plot(u, [v, v, place], color=style.DARK_INK, lw=0.6, zorder=3.5)  # behind the parts
            axes.text(edge + side * LABEL_MM, place, style.plain(name), **look)


def _cut(result: xr.Dataset) -> xr.DataArray:
    """The finger cut lengthwise: at each y and z, the middles of pixels, the number of the region among its `names`."""
    region = result.section_region.transpose("section_y", "section_z")
    places = {"y": region.section_y.to_numpy(), "z": region.section_z.to_numpy()}
    return xr.DataArray(region.to_numpy(), places, ("y", "z"), attrs={"names": json.loads(region.attrs["regions"])})


@style.drawing()
def section(scene: Scene, result: xr.Dataset) -> "style.Figure":
    """The finger and its board cut lengthwise, one close view per LED with the density of its light's paths."""
    from matplotlib.patches import Patch

    if "section_region" not in result:
        raise InputError('figure = "section" needs the paths of light: simulate(scene, picture=True).')
    leds = result.sizes["led"] if "path_density" in result else 1
    heights = [2.9] + [3.5] * leds
    figure, (whole, *views) = style.panels(9.2, 3.1 + 3.55 * leds, leds + 1, room_in=BESIDE, height_ratios=heights)
    cut = _cut(result)
    _regions(whole, cut)
    low_y, high_y, low_z, high_z = _close_view(scene, cut)
    frame = [low_y, high_y, high_y, low_y, low_y], [low_z, low_z, high_z, high_z, low_z]
    whole.plot(*frame, color=style.MUTED, lw=1.2, ls=(0, (3, 2)))
    whole.set_title("Finger and board, cut lengthwise")
    there, names = {cut.names[region] for region in np.unique(cut)} - {"air"}, TEXTS["names"]
    shown = {name: colour for name, colour in TISSUE.items() if name in there}
    key = [Patch(fc=fc, ec=style.MUTED, lw=0.5, label=names.get(name, name)) for name, fc in shown.items()]
    whole.legend(handles=key, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for i, axes in enumerate(views):
        draw_section(axes, scene, result, led=i)
    return figure


def draw_section(axes: "style.Axes", scene: Scene, result: xr.Dataset, *, led: int) -> None:
    """Draw the close view of the section under the board, with one LED's path density, into axes."""
    cut = _cut(result)
    low_y, high_y, low_z, high_z = _close_view(scene, cut)
    _regions(axes, cut)
    if "path_density" in result:
        _paths(axes, cut, result.path_density.isel(led=led).transpose("section_y", "section_z").to_numpy())
        axes.set_title(style.plain(f"Paths of the light of {led_name(result, led)}"))
    _layers(axes, cut, low_y, low_z)
    # Above the board, where photodiodes and the LED lie along it; they need not lie in the section.
    for colour, j in coloured_along_nail(scene):
        area = scene.layout.photodiode_areas[j]
        axes.plot([area.v_min, area.v_max], [high_z - 0.2] * 2, color=colour, lw=5, solid_capstyle="butt", zorder=6)
    v = scene.layout.leds[led].center_mm[1]
    axes.plot([v], [high_z - 0.55], marker="v", color=LED, mec=style.DARK_INK, mew=0.7, ms=8, zorder=7)
    axes.set(xlim=(low_y, high_y), ylim=(low_z, high_z))


def _paths(axes: "style.Axes", cut: xr.DataArray, density: np.ndarray) -> None:
    """Where light passes, over three decades, and the densest places that hold half and 90 % of it."""
    from matplotlib.colors import LogNorm

    if not (inside := density[density > 0]).size:
        return
    # Single photons far from the board are noise; some smoothing joins them.
    smooth = smoothed(density, 1.5)
    relative = smooth / float(np.quantile(inside, 0.9995))
    faded = np.clip(np.log10(np.maximum(relative, 1e-9)) / DECADES + 1, 0, 1)
    image = axes.imshow(
        np.ma.masked_less(relative, 10.0**-DECADES).T,
        extent=extent(cut.y.values, cut.z.values),
        origin="lower",
        norm=LogNorm(10.0**-DECADES, 1),
        cmap="magma",
        alpha=np.minimum(1.4 * faded, 1).T,
        zorder=3,
        interpolation="bilinear",
    )
    # Powers of ten as text: as formulas they would take a quarter of the figure's time.
    decades: dict[str, Any] = {"ticks": [10.0**-power for power in range(DECADES + 1)], "format": "%g"}
    bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.01, 0.0, 0.02, 1.0)), **decades)
    bar.minorticks_off()
    bar.set_label("light paths [of largest]", fontsize=8)
    bar.outline.set_visible(False)
    densest = np.sort(smooth.ravel())[::-1]
    for part, dashes in ((0.5, "-"), (0.9, "--")):
        level = densest[np.searchsorted(np.cumsum(densest), part * densest.sum())]
        if densest[-1] < level < densest[0]:
            look: dict[str, Any] = {"colors": ["#38d6c4"], "linewidths": 1.3, "linestyles": dashes}
            axes.contour(cut.y, cut.z, smooth.T, levels=[level], zorder=5, **look)


def smoothed(density: np.ndarray, cells: float) -> np.ndarray:
    """A map (m, n) averaged with Gaussian weights of a standard deviation in cells; importing scipy takes longer."""
    for _ in density.shape:
        weight = np.exp(-0.5 * (np.subtract.outer(*2 * [np.arange(len(density))]) / cells) ** 2)
        density = ((weight @ density) / weight.sum(1, keepdims=True)).T
    return density


def _regions(axes: "style.Axes", cut: xr.DataArray) -> None:
    """Fill each region with its colour."""
    from matplotlib.colors import to_rgba

    axes.set(aspect="equal", xlabel=ALONG, ylabel="height [mm]")
    axes.grid(False)
    colours = [to_rgba(LED if name.startswith("led:") else TISSUE.get(name, TISSUE["silicon"])) for name in cut.names]
    image = np.array(colours)[cut.values].transpose(1, 0, 2)
    axes.imshow(image, extent=extent(cut.y.values, cut.z.values), origin="lower", zorder=1)


def _layers(axes: "style.Axes", cut: xr.DataArray, left: float, bottom: float) -> None:
    """Draw the borders of plate, bed and bone over the light, and name these where they meet the left edge."""
    column = int(np.argmin(abs(cut.y.values - (left + 0.1))))
    for name in LAYERS:
        here = cut.values == (cut.names.index(name) if name in cut.names else -1)
        if here.any():
            border: dict[str, Any] = {"levels": [0.5], "zorder": 4}
            halo = axes.contour(cut.y, cut.z, here.T, colors=["#ffffff"], linewidths=1.6, alpha=0.55, **border)
            axes.contour(halo, colors=[style.DARK_INK], linewidths=0.7, **border)
        heights = cut.z.values[here[column] & (cut.z.values > bottom)]
        if heights.size:
            axes.text(left + 0.12, heights.mean(), name, fontsize=8, color=style.DARK_INK, va="center", zorder=6)


def _close_view(scene: Scene, cut: xr.DataArray) -> tuple[float, float, float, float]:
    """Box (y low, y high, z low, z high) around the board and what its light can reach. [mm]"""
    low_y, high_y, low_z, high_z = extent(cut.y.values, cut.z.values)
    outline, board = scene.layout.outline, scene.board
    cover = board.height_mm + (board.kapton_um + board.cover_um) * 1e-3
    return max(low_y, outline.v_min - 1.5), min(high_y, outline.v_max + 1.5), max(low_z, -4.2), cover + 0.75
