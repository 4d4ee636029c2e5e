"""The page of a trace: what each photodiode detects of each LED, in one state or in several."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...light import Transfer
from ...statistics import Z95
from .. import style
from ..files import Report, run_summary
from ..html import document, figure, section, table
from ..maps import led_name
from ..numbers import aligned, estimated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What is shown of each reading.
NAMES = ["detected_fraction", "detected_fraction_stderr", "effective_photons"]


def page(result: Transfer | xr.Dataset) -> str:
    """The page of a transfer at rest, or of readings."""
    readings = _readings(result)
    caption = "Detected fraction of the emitted power, with its 95 % interval; states from left to right."
    body = section("Detected light", figure(draw(result), caption), table(_rows(readings)))
    lead = f"{readings.attrs['photons']} photons; {readings.sizes['state']} states of the blood."
    return document(kicker="trace", title="Detected light", lead=lead, body=[body], attributes=readings.attrs)


@style.drawing()
def draw(result: Transfer | xr.Dataset) -> "Figure":
    """Detected fraction of each photodiode, by LED and state."""
    readings = _readings(result)
    at, (leds, count) = np.arange(readings.sizes["photodiode"]), (readings.sizes[name] for name in ("led", "state"))
    drawing, panels = style.panels(7.2, 2.6 * leds + 0.4, leds, squeeze=False, sharex=True)
    for i, axes in enumerate(panels[:, 0]):
        for k, colour in enumerate(style.place_colours(count)):
            one = readings.isel(led=i, state=k)
            half = Z95 * one.detected_fraction_stderr
            axes.errorbar(
                at + 0.5 * (k + 0.5) / count - 0.25, one.detected_fraction, half, fmt="o", markersize=4, color=colour
            )
        axes.set(title=led_name(readings, i), ylabel="detected fraction [1]", yscale="log")
    panels[-1, 0].set_xticks(at, [style.plain(name) for name in readings.photodiode.values], rotation=30, ha="right")
    return drawing


def _readings(result: Transfer | xr.Dataset) -> xr.Dataset:
    readings = result.at() if isinstance(result, Transfer) else result
    if "state" in readings.dims:
        return readings
    return readings.assign({name: readings[name].expand_dims("state") for name in NAMES})


def _rows(readings: xr.Dataset) -> list[dict[str, str]]:
    rows = []
    for k, i, j in np.ndindex(*(readings.sizes[dim] for dim in ("state", "led", "photodiode"))):
        one = readings.isel(state=k, led=i, photodiode=j)
        row: dict[str, str] = {"State": str(k)} if readings.sizes["state"] > 1 else {}
        row |= {"LED": str(one.led.item()), "Photodiode": str(one.photodiode.item())}
        rows.append(row | {"Detected [1e-6]": estimated(one, "detected_fraction", 1e6)})
    return rows


def _summary(result: Transfer | xr.Dataset) -> dict[str, Any]:
    readings = _readings(result)
    return {"readings": readings[NAMES].to_dataframe().reset_index().to_dict("records")} | run_summary(readings.attrs)


TRACE = Report(
    ("trace.nc", "trace.html"),
    page,
    _summary,
    lambda result, _: aligned(_rows(_readings(result))),
    {"readings": draw},
    lambda result: {"trace.nc": result.at() if isinstance(result, Transfer) else result},
)
