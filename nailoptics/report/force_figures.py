"""Figures of a calibration and of a prediction: volts beside their fit, force beside what was measured."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from ..statistics import Z95
from . import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Points that a line is drawn with; more cannot be seen and make pages heavy.
POINTS = 1500
# How far above the largest known force an interval that is open above is drawn.
ROOM_ABOVE = 1.25
# Profiles side by side, and up to which deviance they are drawn: a parabola's at three standard errors, and room.
PROFILES_PER_ROW, MOST_DEVIANCE = 4, 10.0


def _thinned(count: int) -> slice:
    return slice(None, None, max(1, count // POINTS))


@style.drawing()
def fit(result: xr.Dataset) -> "Figure":
    """Every reading over the calibration, recorded and fitted, less its start."""
    readings = [str(name) for name in result.reading.values]
    recordings = np.unique(result.recording.values)
    figure, axes = style.panels(
        7.2, 0.9 * len(readings) + 0.6, len(readings), len(recordings), sharex="col", squeeze=False
    )
    for column, which in enumerate(recordings):
        part = result.isel(sample=np.flatnonzero(result.recording.values == which))
        part = part.isel(sample=_thinned(part.sizes["sample"]))
        for row, (name, colour) in enumerate(zip(readings, style.place_colours(len(readings)), strict=True)):
            panel, recorded = axes[row, column], part.volts.values[row]
            start = np.nanmedian(recorded[: max(3, len(recorded) // 50)])
            panel.plot(part.time_s, 1e3 * (recorded - start), color=colour, linewidth=3.0, alpha=0.55, label="recorded")
            fitted = 1e3 * (part.volts_fitted.values[row] - start)
            panel.plot(part.time_s, fitted, color=style.INK, linewidth=0.8, label="fitted")
            style.remark(panel, style.plain(name))
        axes[-1, column].set_xlabel("time [s]")
    axes[len(readings) // 2, 0].set_ylabel("change of the reading [mV]")
    return figure


@style.drawing()
def left_over(result: xr.Dataset) -> "Figure":
    """What the fit leaves of every reading, all in one panel for each recording."""
    recordings = np.unique(result.recording.values)
    figure, axes = style.panels(7.2, 2.4, 1, len(recordings), sharey=True, squeeze=False)
    colours = style.place_colours(result.sizes["reading"])
    for panel, which in zip(axes[0], recordings, strict=True):
        part = result.isel(sample=np.flatnonzero(result.recording.values == which))
        part = part.isel(sample=_thinned(part.sizes["sample"]))
        for k, colour in enumerate(colours):
            panel.plot(part.time_s, 1e3 * (part.volts - part.volts_fitted).values[k], color=colour, linewidth=0.7)
        panel.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("recorded less fitted [mV]")
    return figure


@style.drawing()
def profiles(result: xr.Dataset) -> "Figure":
    """Profile likelihoods of the factors in which the fit is not quadratic, a panel each."""
    names = list(result.attrs["bent_factors"])
    columns = min(len(names), PROFILES_PER_ROW)
    rows = -(-len(names) // columns)
    figure, axes = style.panels(7.2, 1.9 * rows + 0.3, rows, columns, squeeze=False)
    for panel, name in zip(axes.flat, names, strict=False):
        one = result.sel(factor=name)
        panel.plot(one.profile_factor, one.profile_quadratic, color=style.MUTED, linewidth=1.0)
        panel.plot(one.profile_factor, one.profile_deviance, ".-", color=style.ZONES[1])
        panel.axhline(Z95**2, color=style.INK, linewidth=0.7)
        panel.set_ylim(0.0, MOST_DEVIANCE)
        panel.set_title(style.plain(name.replace("_", " ")))
        panel.set_xlabel("factor on the scene's [1]")
    for panel in axes.flat[len(names) :]:
        panel.set_axis_off()
    axes[0, 0].set_ylabel("squared residuals [1]")
    return figure


@style.drawing()
def force(result: xr.Dataset) -> "Figure":
    """Force over time with its interval, beside the known force and the regressions' where they are known."""
    part = result.isel(time=_thinned(result.sizes["time"]))
    known = part.known_force_n.values
    top = np.nanmax([*np.where(np.isfinite(known), known, 0.0), *part.force_n.values]) * ROOM_ABOVE + 0.05
    figure, axes = style.panels(7.2, 3.4)
    high = np.minimum(part.force_high_n.values, top)
    axes.fill_between(part.time, part.force_low_n, high, color=style.ZONES[1], alpha=0.18, linewidth=0, label="95 %")
    if np.isinf(part.force_high_n.values).any():
        open_above = np.where(np.isinf(part.force_high_n.values), top, np.nan)
        axes.plot(part.time, open_above, color=style.ZONES[1], linewidth=2.5, label="open above")
    axes.plot(part.time, part.force_n, color=style.ZONES[1], label="told from the readings")
    if np.isfinite(known).any():
        axes.plot(part.time, known, color=style.INK, linewidth=1.1, label="measured")
        axes.plot(part.time, part.force_linear_n, color=style.MUTED, linewidth=0.7, label="linear regression")
    axes.set_ylim(-0.02 * top, 1.03 * top)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("force [N]")
    style.legend_above(figure, axes, ncols=5)
    return figure


@style.drawing()
def share(result: xr.Dataset) -> "Figure":
    """Where the touch is, the body's arterial pressure, and how well each sample fits."""
    part = result.isel(time=_thinned(result.sizes["time"]))
    figure, (place, body, fits) = style.panels(7.2, 4.6, 3, sharex=True)
    low, high = part.proximal_share_low, part.proximal_share_high
    place.fill_between(part.time, low, high, color=style.ZONES[0], alpha=0.18, linewidth=0)
    told = np.where(high - low < 0.9, part.proximal_share, np.nan)
    place.plot(part.time, told, color=style.ZONES[0])
    place.set_ylim(-0.05, 1.05)
    place.set_title("Proximal share of the force [1]; blank where it cannot be told")
    body.plot(part.time, part.arterial_change_pa, color=style.VEIN)
    # A body that is still is no noise to look into.
    body.set_ylim(min(body.get_ylim()[0], -10.0), max(body.get_ylim()[1], 10.0))
    body.set_title("Arterial pressure less its mean [Pa]")
    fits.plot(part.time, part.surprise, color=style.MUTED, linewidth=0.6)
    outlier = part.outlier.values.astype(bool)
    fits.plot(part.time[outlier], part.surprise[outlier], ".", color=style.ZONES[0], markersize=3)
    fits.set_yscale("log")
    fits.set_title("Squared distance of a sample from its prediction [1]; outliers are dots")
    fits.set_xlabel("time [s]")
    return figure
