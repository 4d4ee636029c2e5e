"""Figures in space: the board on the nail from above, and the finger cut lengthwise with the light's paths."""

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ..scene import Scene
from ..scene.layout import Layout, Rectangle
from ..tissue.blood_zones import BloodZones
from . import style
from .readings import order_along_nail

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAIL, BOARD, BARRIER, SILICON, LED = "#f3ddd2", "#d9a441", "#2b2d31", "#8d949c", "#ffd84a"
TISSUE = {
    "air": "none",
    "plate": "#e9dcc0",
    "bed": "#eebfb2",
    "bone": "#f1ecdf",
    "pulp": "#f3d2c2",
    "epidermis": "#cf9f87",
    "epoxy": "#c9e3ea",
    "barrier": BARRIER,
    "kapton": BOARD,
    "cover": "#5d6168",
    "cut": "#d8d8d8",
    "silicon": SILICON,
}
DECADES = 3.0


def top_view(scene: Scene, result: xr.Dataset) -> "Figure":
    """The board on the nail, seen from above and rolled flat: what is where, and which blood lies below."""
    with style.drawing():
        figure = style.new_figure(6.4, 6.0)
        draw_top_view(figure.subplots(), scene, result)
    return figure


def draw_top_view(axes: "Axes", scene: Scene, result: xr.Dataset) -> None:
    """Draw the top view into axes."""
    from matplotlib.patches import Rectangle as Patch

    assert scene.finger is not None
    layout, finger = scene.layout, scene.finger
    half_u, half_v = finger.nail_width_mm / 2, finger.nail_length_mm / 2
    nail = Patch((-half_u, -half_v), 2 * half_u, 2 * half_v, fc=NAIL, ec=style.MUTED, lw=1.2)
    axes.add_patch(nail)
    _blood_zones(axes, scene, half_u, half_v)

    def fill(r: Rectangle, z: float, **look: Any) -> None:
        axes.add_patch(Patch((r.u_min, r.v_min), r.u_max - r.u_min, r.v_max - r.v_min, zorder=z, **look))

    fill(layout.outline, 2, fc=BOARD, ec=style.DARK_INK, lw=0.8, alpha=0.9)
    for wall in layout.barriers:
        fill(wall, 3, fc=BARRIER, lw=0)
    for element in layout.unwired:
        fill(element, 3, fc="#c9ccd0", ec="#70767d", lw=0.5)
    colours = dict(zip(order_along_nail(result, scene), style.place_colours(len(layout.photodiodes)), strict=False))
    for j, wired in enumerate(layout.photodiodes):
        fill(wired.area, 4, fc=colours.get(j, SILICON), ec=style.DARK_INK, lw=0.6)
    for led in layout.leds:
        fill(led, 4, fc=LED, ec=style.DARK_INK, lw=0.8)
    _label_parts(axes, scene, layout, half_v)
    axes.set_xlim(-half_u - 0.3, half_u + 0.3)
    axes.set_ylim(-half_v - 0.3, half_v + 0.3)
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_xlabel("across the nail [mm]")
    axes.set_ylabel("along the nail, towards the tip [mm]")


def _blood_zones(axes: "Axes", scene: Scene, half_u: float, half_v: float) -> None:
    """Tint the nail by the blood zones below it, as smoothly as they pass into each other."""
    from matplotlib.colors import to_rgb

    v = np.linspace(-half_v, half_v, 256)
    weights = BloodZones(scene.blood.zone_edges_mm, scene.blood.zone_width_mm).weights(v)
    tint = weights @ np.array([to_rgb(c) for c in style.place_colours(weights.shape[1])])
    image = np.concatenate([tint, np.full((len(v), 1), 0.30)], axis=1)[:, None]
    axes.imshow(image, extent=(-half_u, half_u, -half_v, half_v), origin="lower", aspect="auto", zorder=1)
    text: dict[str, Any] = {"color": style.DARK_INK, "fontsize": 8, "zorder": 5}
    for edge in scene.blood.zone_edges_mm:
        low, high = edge - scene.blood.zone_width_mm / 2, edge + scene.blood.zone_width_mm / 2
        for place in (low, high):
            axes.plot([-half_u, half_u], [place, place], color=style.DARK_INK, lw=0.6, ls=(0, (2, 3)), zorder=1.5)
    axes.text(-half_u + 0.15, half_v - 0.15, "distal blood", va="top", **text)
    axes.text(-half_u + 0.15, -half_v + 0.15, "proximal blood", va="bottom", **text)


def _label_parts(axes: "Axes", scene: Scene, layout: Layout, half_v: float) -> None:
    """Names beside the parts, none on another: photodiodes on the right, the rest on the side where it lies."""
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
    left = [(r, name) for r, name in others if r.center_mm[0] <= middle]
    right += [(r, name) for r, name in others if r.center_mm[0] > middle]
    gap = min(0.07 * half_v, 1.9 * half_v / len(right))
    size = max(8.0 * gap / (0.07 * half_v), 3.0)
    for group, side in ((left, -1), (right, 1)):
        edge = layout.outline.u_max if side > 0 else layout.outline.u_min
        for (r, name), place in zip(group, style.spread([r.center_mm[1] for r, _ in group], gap), strict=True):
            v, near = r.center_mm[1], r.u_max if side > 0 else r.u_min
            u = [near, edge, edge + side * 0.37]
            axes.plot(u, [v, v, place], color=style.DARK_INK, lw=0.6, zorder=6)
            look: dict[str, Any] = {"color": style.DARK_INK, "fontsize": size if side > 0 else 8.0}
            where: dict[str, Any] = {"ha": "left" if side > 0 else "right", "va": "center"}
            axes.text(edge + side * 0.45, place, style.plain(name), zorder=6, **look, **where)


def section(scene: Scene | None, result: xr.Dataset) -> "Figure":
    """The finger and its board cut lengthwise, one close view per LED with the density of its light's paths."""
    leds = result.sizes["led"] if "path_density" in result else 1
    with style.drawing():
        figure = style.new_figure(9.2, 3.1 + 3.55 * leds)
        panels = figure.subplots(leds + 1, 1, squeeze=False, gridspec_kw={"height_ratios": [2.9] + [3.5] * leds})[:, 0]
        whole = panels[0]
        _regions(whole, result)
        low_y, high_y, low_z, high_z = _close_view(scene, result)
        frame = [low_y, high_y, high_y, low_y, low_y], [low_z, low_z, high_z, high_z, low_z]
        whole.plot(*frame, color=style.MUTED, lw=1.2, ls=(0, (3, 2)))
        whole.set_title("Finger and board, cut lengthwise")
        _key(whole, result)
        for i, axes in enumerate(panels[1:]):
            draw_section(axes, scene, result, led=i)
    return figure


def draw_section(axes: "Axes", scene: Scene | None, result: xr.Dataset, *, led: int) -> None:
    """Draw the close view of the section under the board, with one LED's path density, into axes."""
    from matplotlib.colors import LogNorm
    from scipy.ndimage import gaussian_filter

    low_y, high_y, low_z, high_z = _close_view(scene, result)
    _regions(axes, result)
    if "path_density" in result:
        density = result.path_density.isel(led=led).transpose("section_y", "section_z")
        values = density.to_numpy()
        inside = values[values > 0]
        if inside.size:
            top = float(np.quantile(inside, 0.9995))
            # Single photons far from the board are noise; a pixel of smoothing joins them.
            smooth = gaussian_filter(values, 1.0)
            shown = np.ma.masked_less(smooth, top * 10**-DECADES)
            faded = np.clip(np.log10(np.maximum(smooth / top, 1e-9)) / DECADES + 1, 0, 1)
            image = axes.imshow(
                (shown / top).T,
                extent=_extent(result),
                origin="lower",
                norm=LogNorm(10**-DECADES, 1),
                cmap="magma",
                alpha=np.minimum(1.4 * faded, 1).T,
                zorder=3,
                interpolation="bilinear",
            )
            bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.01, 0.0, 0.02, 1.0)))
            bar.set_label("light paths [of largest]", fontsize=8)
            bar.outline.set_visible(False)
            _holding(axes, result, values)
        name = f"Paths of the light of LED {result.led.values[led]}, {float(result.wavelength_nm[led]):g} nm"
        axes.set_title(style.plain(name))
    _outlines(axes, result)
    _layer_names(axes, result, low_y, low_z)
    _parts_above(axes, scene, result, led, high_z)
    axes.set_xlim(low_y, high_y)
    axes.set_ylim(low_z, high_z)


def _extent(result: xr.Dataset) -> tuple[float, float, float, float]:
    """Edges of the section's pixels: coordinates are their centres."""
    edges: list[float] = []
    for name in ("section_y", "section_z"):
        places = result[name].to_numpy()
        half = (places[1] - places[0]) / 2 if len(places) > 1 else 0.5
        edges += [float(places[0] - half), float(places[-1] + half)]
    return edges[0], edges[1], edges[2], edges[3]


def _names(result: xr.Dataset) -> list[str]:
    return [str(n) for n in json.loads(result.section_region.attrs["regions"])]


def _colour(name: str) -> str:
    return LED if name.startswith("led:") else TISSUE.get(name, SILICON)


def _regions(axes: "Axes", result: xr.Dataset) -> None:
    """Fill each region with its colour."""
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_xlabel("along the nail, towards the tip [mm]")
    axes.set_ylabel("height [mm]")
    if "section_region" not in result:
        return
    from matplotlib.colors import to_rgba

    palette = np.array([to_rgba(_colour(name)) for name in _names(result)])
    region = result.section_region.transpose("section_y", "section_z").to_numpy()
    axes.imshow(palette[region].transpose(1, 0, 2), extent=_extent(result), origin="lower", zorder=1)


def _outlines(axes: "Axes", result: xr.Dataset) -> None:
    """Draw the borders of plate, bed and bone over the light."""
    if "section_region" not in result:
        return
    names = _names(result)
    region = result.section_region.transpose("section_y", "section_z").to_numpy()
    for name in ("plate", "bed", "bone"):
        here = (region == names.index(name)).astype(float) if name in names else np.zeros(region.shape)
        if here.any():
            y, z = result.section_y.to_numpy(), result.section_z.to_numpy()
            axes.contour(y, z, here.T, levels=[0.5], colors=["#ffffff"], linewidths=1.6, alpha=0.55, zorder=4)
            axes.contour(y, z, here.T, levels=[0.5], colors=[style.DARK_INK], linewidths=0.7, zorder=4)


def _layer_names(axes: "Axes", result: xr.Dataset, left: float, bottom: float) -> None:
    """Name the layers where they meet the left edge."""
    if "section_region" not in result:
        return
    names = _names(result)
    z = result.section_z.to_numpy()
    column = result.section_region.sel(section_y=left + 0.1, method="nearest").to_numpy()
    for name in ("plate", "bed", "bone"):
        heights = z[(column == names.index(name)) & (z > bottom)] if name in names else z[:0]
        if heights.size:
            axes.text(left + 0.12, heights.mean(), name, fontsize=8, color=style.DARK_INK, va="center", zorder=6)


def _holding(axes: "Axes", result: xr.Dataset, values: np.ndarray) -> None:
    """Outline the densest places that hold half and 90 % of the paths."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(values, 1.5)
    flat = np.sort(smooth.ravel())[::-1]
    held = np.cumsum(flat)
    y, z = result.section_y.to_numpy(), result.section_z.to_numpy()
    for part, dashes in ((0.5, "-"), (0.9, "--")):
        level = flat[np.searchsorted(held, part * held[-1])]
        if smooth.min() < level < smooth.max():
            look: dict[str, Any] = {"colors": ["#38d6c4"], "linewidths": 1.3, "linestyles": dashes}
            axes.contour(y, z, smooth.T, levels=[level], zorder=5, **look)


def _parts_above(axes: "Axes", scene: Scene | None, result: xr.Dataset, led: int, top: float) -> None:
    """Mark above the board where photodiodes and the LED lie along it; they need not lie in the section."""
    if scene is None or scene.finger is None:
        return
    layout = scene.layout
    if len(layout.photodiodes) != result.sizes["photodiode"] or len(layout.leds) != result.sizes["led"]:
        return
    order = order_along_nail(result, scene)
    for colour, j in zip(style.place_colours(len(order)), order, strict=True):
        area = layout.photodiodes[j].area
        axes.plot([area.v_min, area.v_max], [top - 0.2] * 2, color=colour, lw=5, solid_capstyle="butt", zorder=6)
    r = layout.leds[led]
    axes.plot([r.center_mm[1]], [top - 0.55], marker="v", color=LED, mec=style.DARK_INK, mew=0.7, ms=8, zorder=7)


def _close_view(scene: Scene | None, result: xr.Dataset) -> tuple[float, float, float, float]:
    """Box (y low, y high, z low, z high) around the board and what its light can reach. [mm]"""
    low_y, high_y, low_z, high_z = _extent(result)
    if scene is None or scene.finger is None:
        return low_y, high_y, low_z, high_z
    outline, board = scene.layout.outline, scene.board
    cover = (board.adhesive_um + board.clear_epoxy_um + board.kapton_um + board.cover_um) * 1e-3
    return max(low_y, outline.v_min - 1.5), min(high_y, outline.v_max + 1.5), max(low_z, -4.2), cover + 0.75


def _key(axes: "Axes", result: xr.Dataset) -> None:
    """A key of the regions' colours."""
    from matplotlib.patches import Patch

    if "section_region" not in result:
        return
    present = np.unique(result.section_region)
    names = [n for i, n in enumerate(_names(result)) if i in present and n in TISSUE and n != "air"]
    label = {"epoxy": "clear epoxy", "cut": "cut end", "pulp": "pulp", "cover": "opaque cover"}
    handles = [Patch(fc=TISSUE[n], ec=style.MUTED, lw=0.5, label=label.get(n, n)) for n in names]
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))
