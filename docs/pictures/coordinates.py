"""Draw coordinates.svg from the prototype's geometry: the flat board, bent onto the nail, and sections.

python docs/pictures/coordinates.py docs/pictures/coordinates.svg
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nailoptics.assets import data_dir
from nailoptics.geometry import build
from nailoptics.geometry.model import Geometry
from nailoptics.report import maps, style
from nailoptics.scene import Scene, load_scene

LED, PHOTODIODE, ARROW = maps.LED, "#4a6fa5", "#b3261e"


def region_colour(name: str) -> str:
    """The colour of a region, with one for all LEDs and one for all photodiodes."""
    return LED if name.startswith("led:") else PHOTODIODE if name.startswith("photodiode:") else maps.TISSUE[name]


def draw_regions(
    axes: Axes, horizontal: np.ndarray, vertical: np.ndarray, geometry: Geometry, regions: np.ndarray
) -> None:
    """Fill each region of a section, (vertical, horizontal) int."""
    for index in np.unique(regions[regions > 0]):
        inside = (regions == index).astype(float)
        axes.contourf(horizontal, vertical, inside, levels=[0.5, 1.5], colors=[region_colour(geometry.regions[index])])
    axes.set(aspect="equal")
    axes.grid(False)


def arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], name: str, *, at: tuple[float, float]
) -> None:
    """An axis from its origin, with its name at the arrow's head."""
    look = {"arrowstyle": "-|>", "color": ARROW, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=look, zorder=9)
    axes.text(end[0] + at[0], end[1] + at[1], name, color=ARROW, fontsize=9, ha="center", va="center", zorder=9)


def draw_flat(axes: Axes, scene: Scene) -> None:
    """The flat board seen from above, and the nail through it."""
    assert scene.finger is not None
    layout, finger = scene.layout, scene.finger
    half_u, half_v = finger.nail_width_mm / 2, finger.nail_length_mm / 2
    corners = [(-half_u, -half_v), (half_u, -half_v), (half_u, half_v), (-half_u, half_v)]
    axes.fill(*zip(*corners, strict=True), fc=maps.NAIL, ec=style.MUTED, lw=1)
    maps.draw_rectangle(axes, layout.outline, fc=maps.BOARD, ec=style.DARK_INK, lw=0.8, alpha=0.85)
    for wall in layout.barriers:
        maps.draw_rectangle(axes, wall, fc=maps.BARRIER, lw=0)
    for area in layout.photodiode_areas:
        maps.draw_rectangle(axes, area, fc=PHOTODIODE, ec=style.DARK_INK, lw=0.4)
    for die in layout.leds:
        maps.draw_rectangle(axes, die, fc=LED, ec=style.DARK_INK, lw=0.6)
    arrow(axes, (0, 0), (4.6, 0), "u", at=(0.4, 0))
    arrow(axes, (0, 0), (0, 5.4), "v", at=(0.4, 0))
    axes.plot(0, 0, "o", color=ARROW, ms=4, zorder=9)
    for text, at in (("fingertip, free edge", half_v + 0.6), ("cuticle, towards the hand", -half_v - 0.6)):
        axes.text(0, at, text, ha="center", va="center", fontsize=8)
    die = layout.leds[0].center_mm
    axes.annotate(
        f"LED at [{die[0]:g}, {die[1]:g}]", die, (-5.4, 2.6), fontsize=8, arrowprops={"arrowstyle": "-", "lw": 0.6}
    )
    element = layout.photodiodes[-1].area.center_mm
    axes.annotate("photodiode\nelement", element, (2.6, 3.1), fontsize=8, arrowprops={"arrowstyle": "-", "lw": 0.6})
    axes.set(xlim=(-6.6, 6.6), ylim=(-7.4, 7.4), aspect="equal", xlabel="u, across the nail [mm]")
    axes.set(ylabel="v, along the nail [mm]", title="The flat board, seen from above")
    axes.grid(False)


def draw_across(axes: Axes, geometry: Geometry) -> None:
    """The cross section at v = 0, seen from the hand towards the tip: u is an arc length on the underside."""
    x, z = np.linspace(-9.4, 9.4, 470), np.linspace(-4.6, 1.9, 260)
    points = np.stack(np.broadcast_arrays(x[None, :], 0.013, z[:, None]), axis=-1)
    draw_regions(axes, x, z, geometry, geometry.region_at(points.reshape(-1, 3)).reshape(len(z), len(x)))
    radius, low = geometry.board_radius_mm, geometry.nail_radius_mm
    angle = np.linspace(0, 4.6 / radius, 60)
    arc = radius * np.sin(angle), radius * np.cos(angle) - low
    axes.plot(*arc, color=ARROW, lw=1.6)
    arrow(axes, (arc[0][-2], arc[1][-2]), (arc[0][-1], arc[1][-1]), "u", at=(0.5, -0.1))
    arrow(axes, (0, 0), (0, 1.75), "z", at=(0.4, 0))
    axes.set(xlabel="x [mm]", ylabel="z [mm]", title="Bent onto the nail: cross section at v = 0, seen from the hand")
    axes.set(xlim=(x[0], x[-1]), ylim=(z[0], z[-1]))


def draw_along(axes: Axes, geometry: Geometry) -> None:
    """The lengthwise section at u = 0, the tip on the right."""
    y, z = np.linspace(-9.5, 10.5, 420), np.linspace(-13.6, 1.9, 320)
    draw_regions(axes, y, z, geometry, geometry.section(y, z).T)
    arrow(axes, (0, 0), (6.4, 0), "v = y", at=(0.3, 0.75))
    arrow(axes, (0, 0), (0, 1.75), "z", at=(0.5, 0))
    for text, at in (("bone", (-4.5, -4.6)), ("pulp", (2.5, -8.5)), ("bed", (-3.2, -1.4)), ("board", (-6.6, 1.2))):
        axes.text(*at, text, fontsize=8, ha="center", va="center")
    axes.set(xlabel="y [mm]", ylabel="z [mm]", title="Lengthwise section at u = 0")
    axes.set(xlim=(y[0], y[-1]), ylim=(z[0], z[-1]))


def draw(path: Path) -> None:
    """Write the drawing."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    geometry = build(scene)
    # The same bytes from every run.
    with style.drawing(), matplotlib.rc_context({"svg.hashsalt": "coordinates", "svg.fonttype": "none"}):
        figure = Figure(figsize=(11.0, 6.2), layout="constrained", facecolor="white")
        axes = figure.subplot_mosaic(
            [["flat", "across"], ["flat", "along"]], width_ratios=[1, 1.35], height_ratios=[0.8, 1.4]
        )
        draw_flat(axes["flat"], scene)
        draw_across(axes["across"], geometry)
        draw_along(axes["along"], geometry)
        figure.savefig(path, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
