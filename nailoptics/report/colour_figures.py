"""Figures of a nail's colour: the strip of the paper's Fig. 2, Lab along the nail and over force, a press over time."""

from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from . import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The animation of a press: frames a second, and its size. [px]
FRAMES_PER_S = 8
FRAME_PX = (300, 420)


def _nail(result: xr.Dataset) -> slice:
    """The places on the nail: all but the first and the last, which are skin."""
    return slice(1, result.sizes["place"] - 1)


def _nail_shape(panel: Any, colours: np.ndarray, v_mm: np.ndarray, *, width_mm: float, skin: np.ndarray) -> None:
    """A nail in its colours along its length, the tip upwards, on skin."""
    from matplotlib.patches import Ellipse, FancyBboxPatch

    low, high = v_mm[0], v_mm[-1]
    margin, half = 0.16 * width_mm, width_mm / 2
    at = np.linspace(low, high, 200)
    fine = np.stack([np.interp(at, v_mm, colours[:, k]) for k in range(3)], -1)
    finger = FancyBboxPatch(
        (-half - margin, low - 1.5 * margin),
        width_mm + 2 * margin,
        high - low + 3.2 * margin,
        boxstyle=f"round,pad=0,rounding_size={0.45 * width_mm}",
        facecolor=skin,
        edgecolor="none",
    )
    panel.add_patch(finger)
    image = panel.imshow(fine[:, None], origin="lower", extent=(-half, half, low, high), aspect="equal", zorder=2)
    middle, tall = (low + high) / 2, 1.12 * (high - low)
    image.set_clip_path(Ellipse((0, middle), 1.13 * width_mm, tall, transform=panel.transData))
    panel.set_xlim(-half - 1.6 * margin, half + 1.6 * margin)
    panel.set_ylim(low - 2.2 * margin, high + 2.4 * margin)
    panel.set_axis_off()


@style.drawing()
def strip(result: xr.Dataset, *, width_mm: float) -> "Figure":
    """The nail under each force, in its colours."""
    forces, nail = result.force_n.values, _nail(result)
    figure, axes = style.panels(1.45 * len(forces), 1.9, 1, len(forces), squeeze=False)
    for s, panel in enumerate(axes[0]):
        colours = result.srgb.values[nail, s]
        skin = result.srgb.values[[0, -1], s].mean(0)
        _nail_shape(panel, colours, result.v_mm.values[nail], width_mm=width_mm, skin=skin)
        panel.set_title(f"{forces[s]:g} N", loc="center")
    return figure


@style.drawing()
def along(result: xr.Dataset) -> "Figure":
    """L*, a* and b* along the nail, for each force, with 95 % intervals."""
    from matplotlib import colormaps

    from ..statistics import Z95

    figure, axes = style.panels(7.2, 5.6, 3, sharex=True)
    forces = result.force_n.values
    for s, force in enumerate(forces):
        colour = colormaps["viridis"](0.9 * s / max(len(forces) - 1, 1))
        for k, panel in enumerate(axes):
            value, error = result.lab.values[:, s, k], Z95 * result.lab_stderr.values[:, s, k]
            panel.plot(result.v_mm, value, color=colour, label=f"{force:g} N")
            panel.fill_between(result.v_mm, value - error, value + error, color=colour, alpha=0.15, linewidth=0)
    for k, (panel, words) in enumerate(zip(axes, ("lightness L*", "redness a*", "yellowness b*"), strict=True)):
        panel.plot(result.v_mm, result.lab_without_blood.values[:, k], ":", color=style.MUTED, label="no blood")
        panel.set_title(words)
    axes[-1].set_xlabel("place along the nail, towards the tip [mm]; the outermost two are skin")
    style.legend_above(figure, axes[0], ncols=len(forces) + 1)
    return figure


@style.drawing()
def over_force(result: xr.Dataset) -> "Figure":
    """Difference to rest and the white band, over force."""
    from ..statistics import Z95

    figure, (change, band) = style.panels(7.2, 2.8, 1, 2)
    nail = range(*_nail(result).indices(result.sizes["place"]))
    for p, colour in zip(nail, style.place_colours(len(nail)), strict=True):
        error = Z95 * result.delta_e_2000_stderr[p]
        change.errorbar(result.force_n, result.delta_e_2000[p], error, color=colour, linewidth=1.0)
    change.set_title("Difference to rest, CIEDE2000; warm: proximal")
    error = Z95 * result.white_band_mm_stderr
    band.errorbar(result.force_n, result.white_band_mm, error, color=style.INK, marker="o", markersize=3)
    band.set_title("White band [mm]")
    for panel in (change, band):
        panel.set_xlabel("force [N]")
    return figure


@style.drawing()
def press(result: xr.Dataset) -> "Figure":
    """Redness over time while a touch presses and lets go."""
    figure, (force, red) = style.panels(7.2, 3.6, 2, sharex=True, height_ratios=[1, 2.4])
    force.plot(result.time, result.press_force_n, color=style.INK)
    force.set_title("Force [N]")
    nail = range(*_nail(result).indices(result.sizes["place"]))
    for p, colour in zip(nail, style.place_colours(len(nail)), strict=True):
        red.plot(result.time, result.press_lab[p, :, 1] - result.press_lab[p, 0, 1], color=colour, linewidth=1.2)
    red.set_title("Redness a* less that at rest")
    style.remark(red, "warm: proximal; cool: distal")
    red.set_xlabel("time [s]")
    return figure


def animation(result: xr.Dataset, *, width_mm: float) -> bytes:
    """The press as an animated GIF."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    nail, frames = _nail(result), []
    with style.drawing():
        for t in range(result.sizes["time"]):
            figure, panel = style.panels(FRAME_PX[0] / 100, FRAME_PX[1] / 100)
            figure.set_facecolor("white")
            skin = result.press_srgb.values[[0, -1], t].mean(0)
            colours = result.press_srgb.values[nail, t]
            _nail_shape(panel, colours, result.v_mm.values[nail], width_mm=width_mm, skin=skin)
            panel.set_title(f"{float(result.time[t]):.1f} s    {float(result.press_force_n[t]):.1f} N", loc="center")
            canvas = FigureCanvasAgg(figure)
            figure.set_dpi(100)
            canvas.draw()
            frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    data = BytesIO()
    each = round(1000 / FRAMES_PER_S)
    frames[0].save(data, format="GIF", save_all=True, append_images=frames[1:], duration=each, loop=0)
    return data.getvalue()
