"""The page of a trace: what each photodiode detects of each LED, in one state of the blood or in several."""

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ...light import Transfer, rest_of
from ...statistics import Z95
from .. import style
from ..files import Report, run_summary
from ..html import document, figure, section, table
from ..maps import led_name
from ..numbers import aligned, cells
from ..readings import rest_lines

NAMES = ["detected_fraction", "detected_fraction_stderr", "effective_photons"]


def page(result: Transfer | xr.Dataset) -> str:
    """The page of a transfer at rest, or of readings."""
    readings = _readings(result)
    caption = "Detected fraction of the emitted power, with its 95 % interval; states from left to right."
    body = section("Readings", figure(draw(result), caption), table(_rows(result)))
    lead = f"{readings.attrs['photons']} photons; {readings.sizes['state']} states of the blood."
    return document(kicker="trace", title="Detected light", lead=lead, body=[body], attributes=readings.attrs)


@style.drawing()
def draw(result: Transfer | xr.Dataset) -> "style.Figure":
    """Detected fraction of each photodiode, by LED and state."""
    readings = _readings(result)
    states, leds, count = (readings.sizes[name] for name in ("state", "led", "photodiode"))
    drawing, panels = style.panels(7.2, 2.6 * leds + 0.4, leds, squeeze=False, sharex=True)
    for i, axes in enumerate(panels[:, 0]):
        for k, colour in enumerate(style.place_colours(states)):
            one, at = readings.isel(led=i, state=k), np.arange(count) + 0.5 * (k + 0.5) / states - 0.25
            error = Z95 * one.detected_fraction_stderr
            axes.errorbar(at, one.detected_fraction, error, fmt="o", markersize=4, color=colour)
        axes.set(title=led_name(readings, i), ylabel="detected fraction [1]", yscale="log")
    panels[-1, 0].set_xticks(range(count), [*map(style.plain, readings.photodiode.values)], rotation=30, ha="right")
    return drawing


def _readings(result: Transfer | xr.Dataset) -> xr.Dataset:
    """Readings over state, led and photodiode."""
    readings = result.at() if isinstance(result, Transfer) else result
    one = {} if "state" in readings.dims else {name: readings[name].expand_dims("state") for name in NAMES}
    return readings.assign(one)


def _records(result: Transfer | xr.Dataset) -> list[dict[str, Any]]:
    return _readings(result)[NAMES].to_dataframe().reset_index().to_dict("records")


def _rows(result: Transfer | xr.Dataset) -> list[dict[str, str]]:
    names = {"State": "state", "LED": "led", "Photodiode": "photodiode"}
    shown = {"Detected [1e-6]": ("detected_fraction", 1e6, 0)}
    return [{head: str(r[name]) for head, name in names.items()} | cells(r, shown) for r in _records(result)]


TRACE = Report(
    ("trace.nc", "trace.html"),
    page,
    lambda readings: {"readings": _records(readings)} | run_summary(readings.attrs),
    lambda readings, _: aligned(_rows(readings)),
    {"readings": draw},
)
TRANSFER = replace(
    TRACE,
    summary=lambda transfer: rest_of(transfer).as_dict(),
    lines=lambda transfer, _: rest_lines(rest_of(transfer)),
    others=lambda transfer: {"trace.nc": transfer.at()},
)
