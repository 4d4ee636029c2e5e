"""The photographs of a sweep of colours on one sheet: a row for each scene, a column for each force."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from . import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# More scenes would be too small to see, or too large a picture.
MOST_SCENES = 48
# Of one photograph, and of the words beside a row. [inch]
WIDTH, WORDS = 1.5, 1.9


@style.drawing()
def contact_sheet(results: xr.Dataset) -> "Figure":
    """Photographs of up to 48 scenes in the order of the sweep; what is not done is left empty.

    results : what `batch.open_results` returns for a sweep of colours.
    """
    dims = results.state.dims
    rows = list(np.ndindex(*results.state.shape))[:MOST_SCENES]
    forces, high, wide = (results.sizes[name] for name in ("force", "row", "column"))
    tall = WIDTH * high / wide
    size = (WORDS + WIDTH * forces, 0.35 + tall * len(rows))
    figure, panels = style.panels(*size, len(rows), forces, squeeze=False)
    axes = [
        name for name in results.coords if set(results[name].dims) & set(dims) and np.unique(results[name]).size > 1
    ]
    for index, row in zip(rows, panels, strict=True):
        one = results.isel(dict(zip(dims, index, strict=True)))
        for k, panel in enumerate(row):
            panel.set_axis_off()
            if one.state.item() == "done":
                panel.imshow(one.photograph.values[k])
                panel.set_title(f"{float(one.force_n[k]):g} N", loc="center", fontsize=7, pad=2)
        words = [f"{name} = {_short(one[name].item())}" for name in axes]
        if one.state.item() != "done":
            words.append(str(one.state.item()))
        row[0].text(-0.05, 0.5, style.plain("\n".join(words)), transform=row[0].transAxes, ha="right", va="center")
    return figure


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)[:28]
