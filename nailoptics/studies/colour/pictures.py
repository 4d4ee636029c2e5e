"""Photographs of the finger at rest and pressed, in the colours that were traced."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...light.photograph import photograph
from ...scene import Scene
from .colorimetry import linear

# What is darker has missed the finger: no tissue is.
MISSED = 0.02


def photographs(scene: Scene, result: xr.Dataset, *, backend: str = "auto") -> list[NDArray[np.uint8]]:
    """The finger in the first and in the last state, (height, width, 3) each; one if there is only one state.

    result : what `colour` returned for the scene.
    """
    assert scene.finger is not None
    tiles, colours = result.tile_mm.values, linear(result.tile_srgb.values)
    hit = colours[:, 0].mean(-1) > MISSED
    # A tile across the nail's edge is neither.
    reach = np.abs(tiles) + 0.5 * result.attrs["tile_size_mm"]
    edge = scene.finger.nail_radius_mm * np.sin(0.5 * scene.finger.nail_width_mm / scene.finger.nail_radius_mm)
    on_nail = (reach[:, 0] <= edge) & (reach[:, 1] <= scene.finger.nail_length_mm / 2)
    inner = np.abs(tiles) - 0.5 * result.attrs["tile_size_mm"]
    off_nail = (inner[:, 0] >= edge) | (inner[:, 1] >= scene.finger.nail_length_mm / 2)
    kept = hit & (on_nail | off_nail)
    states = [0, -1] if result.sizes["state"] > 1 else [0]
    return photograph(scene, tiles[kept], on_nail[kept], colours[kept][:, states].swapaxes(0, 1), backend=backend)
