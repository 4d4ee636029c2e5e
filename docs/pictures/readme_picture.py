"""Draw the picture of a result: board, section with light, and readings.

python docs/pictures/readme_picture.py result.nc docs/pictures/prototype.png
"""

import sys
from pathlib import Path

import xarray as xr
from matplotlib.figure import Figure

from nailoptics.report import maps, style
from nailoptics.report.pages.simulate_figures import draw_change
from nailoptics.scene import parse_scene


def readme_picture(result: xr.Dataset, path: Path) -> None:
    """Write one wide picture of a result of `simulate`, in the format of the suffix (.png, .svg)."""
    scene = parse_scene(str(result.attrs["scene"]))
    with style.drawing():
        # A transparent background is unreadable on a dark page.
        figure = Figure(figsize=(12.0, 6.0), layout="constrained", facecolor="white")
        places = [["board", "section"], ["board", "change"]]
        axes = figure.subplot_mosaic(places, width_ratios=[5.2, 6.6], height_ratios=[1.0, 1.05])
        maps.draw_top_view(axes["board"], scene)
        maps.draw_section(axes["section"], scene, result, led=0)
        draw_change(axes["change"], result, scene, led=0)
        axes["board"].set_title("The board on the nail")
        axes["section"].set_title("Light in the finger, lengthwise section")
        axes["change"].set_title("Photodiode readings during the press")
        style.write_figure(figure, path, dpi=110)


if __name__ == "__main__":
    readme_picture(xr.load_dataset(sys.argv[1], engine="h5netcdf"), Path(sys.argv[2]))
