"""Photographs of the finger at rest and pressed, in the colours that were traced."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...light.photograph import photograph
from ...scene import Scene
from .colorimetry import linear

# What is darker has missed the finger: no tissue is.
MISSED = 0.02


def photographs(
    scene: Scene,
    result: xr.Dataset,
    *,
    states: Sequence[int] = (0, -1),
    backend: str = "auto",
) -> list[NDArray[np.uint8]]:
    """The finger in some states, (height, width, 3) each; in the first and the last if not given, once if they are one.

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
    chosen = list(dict.fromkeys(state % result.sizes["state"] for state in states))
    shown = colours[kept][:, chosen].swapaxes(0, 1)
    return photograph(scene, tiles[kept], on_nail[kept], shown, size=scene.colour.photograph_px, backend=backend)
