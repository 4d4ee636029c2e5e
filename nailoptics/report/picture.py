"""One wide picture of a result, for a README: board, section with light, and what the photodiodes read."""

from pathlib import Path

import xarray as xr

from ..scene import parse_scene
from . import maps, simulate_figures, style


def readme_picture(result: xr.Dataset, path: Path) -> None:
    """Write one wide picture of a result; the suffix of path says which kind (.png, .svg).

    Raises: InputError where the result's scene cannot be read, WriteError where the file cannot be written.
    """
    scene = parse_scene(str(result.attrs.get("scene", "")), name="the result's scene")
    with style.drawing():
        figure = style.new_figure(12.0, 6.0)
        # The page's paper would be transparent, which dark surroundings make unreadable.
        figure.set_facecolor("white")
        grid = figure.add_gridspec(2, 2, width_ratios=[5.2, 6.6], height_ratios=[1.0, 1.05])
        board, change = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[1, 1])
        maps.draw_top_view(board, scene)
        board.set_title("The board on the nail")
        if "section_region" in result:
            cut = figure.add_subplot(grid[0, 1])
            maps.draw_section(cut, scene, result, led=0)
            cut.set_title("Its light in the finger, cut lengthwise")
        simulate_figures.draw_change(change, result, scene, led=0)
        change.set_title("What the photodiodes read while the finger presses")
        style.write_figure(figure, path, dpi=110, facecolor="white")
