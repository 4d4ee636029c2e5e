"""Where the shipped facts lie: spectra, parts and scenes, from a wheel as from a source checkout."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

WAVELENGTH_RANGE_NM = (400.0, 1000.0)
"""The wavelengths that every shipped spectrum covers. [nm]"""

_PACKAGE = Path(__file__).resolve().parent


def data_dir(name: Literal["assets", "scenes"]) -> Path:
    """Return the folder of the shipped assets or scenes.

    A wheel carries them inside the package (`_assets`, `_scenes`); a source checkout or an editable install has
    them beside it.
    """
    for folder in (_PACKAGE / f"_{name}", _PACKAGE.parent / name):
        if folder.is_dir():
            return folder
    why = f"neither {_PACKAGE / f'_{name}'} nor {_PACKAGE.parent / name} exists; install nailoptics again"
    raise InputError(f"the folder of the shipped {name} is missing: {why}")


def asset_path(relative: str) -> Path:
    """Return the path of one shipped asset, such as "spectra/water.csv"."""
    path = data_dir("assets") / relative
    if not path.is_file():
        raise InputError(f'asset "{relative}" does not exist in {data_dir("assets")}; check its name')
    return path


@cache
def read_table(relative: str) -> dict[str, NDArray[np.float64]]:
    """Read a shipped CSV table into one read-only float array per column.

    Lines that begin with # are its citation; the first other line names the columns, with their units.
    """
    lines = [line for line in asset_path(relative).read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    columns = np.loadtxt(lines[1:], delimiter=",", ndmin=2).T
    columns.setflags(write=False)
    return dict(zip(lines[0].split(","), columns, strict=True))


@cache
def read_toml(relative: str) -> dict[str, Any]:
    """The tables of a shipped TOML file, which are not to be changed."""
    return tomllib.loads(asset_path(relative).read_text(encoding="utf-8"))
