"""Where the light of each LED ends: what each region absorbs, and what leaves the finger."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from . import style
from .html import figure
from .numbers import with_error
from .readings import led_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What of an LED's light no region absorbs.
LEAVES = {"reflected": "leaves to the air", "transmitted": "leaves up the finger"}
NAMES = {
    "barrier": "barrier, opaque epoxy",
    "cover": "cover and rim, opaque epoxy",
    "photodiodes": "photodiodes that are read",
    "silicon": "photodiodes not wired",
    "leds": "LEDs, their own die too",
}
# Less of the light than this is not worth a bar, at any LED.
LEAST = 1e-4


def light_ends(result: xr.Dataset) -> str:
    """The figure with its caption; empty where the engine keeps no such sums."""
    if "absorbed_fraction" not in result:
        return ""
    text = (
        "Where the light of each LED ends, in percent of what it emits, with its standard error: what absorbs it, and "
        "what leaves the finger. Regions that take less than 0.01 % of it are left out."
    )
    return figure(draw(result), "ends", text)


@style.drawing()
def draw(result: xr.Dataset) -> "Figure":
    """One bar for each end of the light and LED, the ends that take most on top."""
    from matplotlib import colormaps

    value, stderr = (_ends(result, suffix) for suffix in ("", "_stderr"))
    most = value.max("led")
    ends = most.end[most >= LEAST].values[np.argsort(-most[most >= LEAST].values, kind="stable")]
    leds = result.sizes["led"]
    room = style.Room(left=0.25 + style.longest_in(ends), top=0.1)
    drawing, axes = style.panels(9.2, 0.8 + len(ends) * (0.14 + 0.16 * leds), room_in=room)
    rows, high = np.arange(len(ends)), 0.8 / leds
    # Not the colours of places along the nail, which warm and cool ones stand for.
    for i, colour in enumerate(colormaps["cividis"](np.linspace(0.45, 0.85, leds))):
        share, error = (100 * one.isel(led=i).sel(end=ends).values for one in (value, stderr))
        at = rows + (i - (leds - 1) / 2) * high
        look: dict[str, Any] = {"color": colour, "label": style.plain(led_name(result, i))}
        bars = axes.barh(at, share, 0.9 * high, xerr=error, ecolor=style.INK, **look)
        words = [f"{with_error(*pair)} %" for pair in zip(share, error, strict=True)]
        axes.bar_label(bars, words, padding=4, fontsize=8, color=style.INK)
    axes.set_yticks(rows, [style.plain(str(name)) for name in ends])
    axes.set(ylim=(len(ends) - 0.4, -0.6), xlim=(0, 118 * float(most.max())), xlabel="% of the LED's light")
    axes.grid(False, axis="y")
    if leds > 1:
        axes.legend(loc="lower right")
    return drawing


def _ends(result: xr.Dataset, suffix: str) -> xr.DataArray:
    """Fractions of each LED's light by their end in words, (led, end), or their standard errors."""
    left = result[f"energy_fraction{suffix}"].sel(part=list(LEAVES)).rename(part="end")
    taken = result[f"absorbed_fraction{suffix}"].rename(region="end")
    names = [*LEAVES.values(), *(NAMES.get(str(name), str(name)) for name in taken.end.values)]
    return xr.concat([left, taken], "end").assign_coords(end=names).transpose("led", "end")
