"""Draw a page's figures as the pictures of its tutorial, from the results of the tutorial's commands.

python docs/pictures/tutorial_pictures.py compare compare.nc docs/pictures/taylor.png
python docs/pictures/tutorial_pictures.py place place.nc docs/pictures/place.png
"""

import sys
from pathlib import Path

import xarray as xr

from nailoptics.report import style
from nailoptics.report.pages import compare, placement_figures


def draw(study: str, result: xr.Dataset, path: Path) -> None:
    """Write the figure that says most."""
    if study == "compare":
        figure = compare._changes_figure(result, led=0, sweep="force")
    else:
        figure = placement_figures.ranking_figure(result)
    figure.set_facecolor("white")
    style.write_figure(figure, path, dpi=110)


if __name__ == "__main__":
    name, file, picture = sys.argv[1:]
    draw(name, xr.load_dataset(file, engine="h5netcdf"), Path(picture))
