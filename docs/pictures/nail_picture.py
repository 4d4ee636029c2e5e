"""Draw the README's first picture: the finger at rest and pressed, the nail under force, and the readings.

    python docs/pictures/nail_picture.py COLOUR_FOLDER result.nc docs/pictures/nail_colour.png

COLOUR_FOLDER is what `nailoptics colour nail_colour` wrote, result.nc what `nailoptics simulate prototype` wrote.
"""

import sys
from pathlib import Path

import xarray as xr
from matplotlib.figure import Figure
from PIL import Image

from nailoptics.report import style
from nailoptics.report.pages import colour as colour_page
from nailoptics.report.pages.simulate import draw_change
from nailoptics.scene import parse_scene


def nail_picture(folder: Path, readings: xr.Dataset, path: Path) -> None:
    """Write one wide picture, a PNG."""
    colours = xr.load_dataset(folder / "colour.nc")
    finger = parse_scene(str(colours.attrs["scene"])).finger
    assert finger is not None
    with style.drawing():
        figure = Figure(figsize=(12.0, 4.9), layout="constrained", facecolor="white")
        left, right = figure.subfigures(1, 2, width_ratios=[6.6, 5.4])
        above, below = left.subfigures(2, 1, height_ratios=[2.75, 2.15])
        for panel, name in zip(above.subplots(1, 2), ("rest", "pressed"), strict=True):
            panel.imshow(Image.open(folder / f"{name}.png"))
            panel.set_axis_off()
            force = float(colours.force_n[0 if name == "rest" else -1])
            panel.set_title("At rest" if name == "rest" else f"Pressed by {force:g} N", loc="center")
        panels = below.subplots(1, colours.sizes["state"])
        colour_page.draw_strip(panels, colours)
        below.supxlabel(f"Traced; {colour_page.seen_by(colours)}", fontsize=7, color=style.MUTED)
        axes = right.subplots()
        draw_change(axes, readings, parse_scene(str(readings.attrs["scene"])), led=0)
        axes.set_title("Photodiode readings during the press")
        style.write_figure(figure, path, dpi=110)


if __name__ == "__main__":
    nail_picture(Path(sys.argv[1]), xr.load_dataset(sys.argv[2]), Path(sys.argv[3]))
