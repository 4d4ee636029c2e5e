"""The readings of a touch and of a trace in numbers: as rows, as a summary, and as lines for the terminal."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ..scene import Scene
from ..studies.simulate import hold_end
from .maps import order_along_nail
from .numbers import aligned
from .uncertainty_section import spread_summary

if TYPE_CHECKING:
    from ..light import RestReadings


@dataclass(frozen=True)
class Reading:
    """One photodiode under one LED: at rest, its change at the end of the hold, and its largest change."""

    led: str
    photodiode: str
    led_index: int
    photodiode_index: int
    zone: str
    distance_mm: float
    force_change_n: float
    saturated: bool
    peak_s: float
    rest_v: float
    rest_stderr_v: float
    noise_rms_v: float
    change_v: float
    change_stderr_v: float
    peak_v: float
    peak_stderr_v: float
    rest_spread: float = math.nan
    """Relative standard deviations over the priors of the finger."""
    change_spread: float = math.nan

    @property
    def change_percent(self) -> float:
        """Change at the end of the hold, in percent of the reading at rest."""
        return 100 * self.change_v / self.rest_v if self.rest_v else math.nan

    @property
    def sigmas(self) -> float:
        """Change in standard errors of the trace: the z score of its sign."""
        return _ratio(abs(self.change_v), self.change_stderr_v)

    @property
    def signal_to_noise(self) -> float:
        """Change over the electronics' noise of one sample."""
        return _ratio(abs(self.change_v), self.noise_rms_v)

    @property
    def resolution_n(self) -> float:
        """Force that one sample resolves: noise over the mean slope from rest to hold; NaN without a touch. [N]"""
        force_n = abs(self.force_change_n)
        return _ratio(self.noise_rms_v * force_n, abs(self.change_v)) if force_n else math.nan


def _ratio(value: float, by: float) -> float:
    if by > 0:
        return value / by
    return math.inf if value > 0 else math.nan


def photodiode_readings(result: xr.Dataset, scene: Scene | None) -> list[Reading]:
    """Every LED and photodiode, LED by LED, photodiodes from proximal to distal."""
    rest, held = result.isel(time=0), result.isel(time=hold_end(result))
    # Pair by pair, as of a million samples each copy of all readings is large.
    swings = [[int(np.nanargmax(np.abs(one))) for one in of_led] for of_led in result.volts_change]
    largest = xr.DataArray(swings, dims=("led", "photodiode"))
    peak = result[["volts_change", "volts_change_stderr"]].isel(time=largest)
    columns = {
        "peak_s": result.time[largest],
        "rest_v": rest.volts,
        "rest_stderr_v": rest.volts_stderr,
        "noise_rms_v": held.volts_noise_rms,
        "change_v": held.volts_change,
        "change_stderr_v": held.volts_change_stderr,
        "peak_v": peak.volts_change,
        "peak_stderr_v": peak.volts_change_stderr,
    }
    if "reading_spread" in result:
        columns |= {"rest_spread": result.reading_spread, "change_spread": result.change_spread}
    return [
        Reading(
            led=str(result.led.values[i]),
            photodiode=str(result.photodiode.values[j]),
            led_index=i,
            photodiode_index=j,
            zone=str(result.zone.values[int(result.zone_of_photodiode[j])]),
            distance_mm=math.nan
            if scene is None
            else math.dist(scene.layout.leds[i].center_mm, scene.layout.photodiode_areas[j].center_mm),
            force_change_n=float(held.force_n - rest.force_n),
            saturated=bool(result.saturated[i, j].any()),
            **{name: float(values[i, j]) for name, values in columns.items()},
        )
        for i, j in product(range(result.sizes["led"]), order_along_nail(scene, result.sizes["photodiode"]))
    ]


def simulation_summary(result: xr.Dataset) -> dict[str, Any]:
    """Volts at the start, their change to the end of the hold, the largest change, and their noise."""
    rows, hold_s = [], float(result.time[hold_end(result)])
    for r in photodiode_readings(result, None):
        row: dict[str, Any] = {
            "led": r.led,
            "photodiode": r.photodiode,
            "volts_start": r.rest_v,
            "volts_start_stderr": r.rest_stderr_v,
            "volts_change": r.change_v,
            "volts_change_stderr": r.change_stderr_v,
            "volts_change_peak": r.peak_v,
            "volts_change_peak_stderr": r.peak_stderr_v,
            "time_of_peak_s": r.peak_s,
            "volts_noise_rms": r.noise_rms_v,
            "time_of_change_s": hold_s,
            "saturated": r.saturated,
        }
        for name in ("beer_lambert_residual_rms_v", "taylor_residual_rms_v"):
            row[name] = float(result[name][r.led_index, r.photodiode_index])
        if not math.isnan(r.rest_spread):
            row["volts_start_spread"] = abs(r.rest_v) * r.rest_spread
            row["volts_change_spread"] = abs(r.change_v) * r.change_spread
        rows.append(row)
    absorbed = {}
    if "absorbed_fraction" in result:
        part = result[["absorbed_fraction", "absorbed_fraction_stderr"]]
        part = part.rename(absorbed_fraction="value", absorbed_fraction_stderr="stderr").transpose("led", "region")
        absorbed = {
            str(led): {
                str(region): {k: float(part[k][i, n]) for k in part} for n, region in enumerate(part.region.values)
            }
            for i, led in enumerate(part.led.values)
        }
    names = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest", "accuracy_reached")
    # volpath stores no light.
    more = {"reused": bool(result.attrs.get("reused", 0))} | {name: result.attrs[name] for name in names}
    return {"readings": rows, "absorbed": absorbed} | spread_summary(result) | more


def simulation_lines(summary: dict[str, Any]) -> list[str]:
    """The readings of a `simulation_summary` as a table."""
    readings = summary["readings"]
    spread = ["spread"] if any("volts_start_spread" in row for row in readings) else []
    head = ["LED", "photodiode", "start V", "+-", *spread, "change mV", "+-", *spread, "peak mV", "noise mV"]
    rows = []
    for row in readings:
        cells = [row["led"], row["photodiode"], f"{row['volts_start']:.4f}"]
        if row["saturated"]:
            rows.append([*cells, "saturated: the converter is at its limit, these volts do not measure the light"])
            continue
        over = [row.get(f"volts_{name}_spread", math.nan) for name in ("start", "change") if spread]
        cells += [f"{volts:.4f}" for volts in (row["volts_start_stderr"], *over[:1])]
        millivolts = [row["volts_change"], row["volts_change_stderr"], *over[1:], row["volts_change_peak"]]
        rows.append([*cells, *(f"{1e3 * volts:.3f}" for volts in millivolts), f"{1e3 * row['volts_noise_rms']:.4f}"])
    lines = aligned([head, *rows], left=(0, 1))
    hold_s = readings[0]["time_of_change_s"]
    lines.append(
        f"start: the first sample; change: from there to the end of the hold, at {hold_s:.3g} s; peak: the largest one"
    )
    if spread:
        lines.append("+-: standard error of the trace; spread: one standard deviation over the priors of the finger")
    return [*lines, *absorbed_lines(summary.get("absorbed", {})), *summary.get("conclusions", [])]


def rest_lines(rest: "RestReadings") -> list[str]:
    """The readings of a trace, and where its light went."""
    rows = []
    for row in rest.readings:
        error = _plus_minus(row["stderr"], ".1e")
        if "upper_limit_95" in row:
            error = f"below {row['upper_limit_95']:.1e} (95 %)"
        rows.append([row["led"], row["photodiode"], f"{row['detected_fraction']:.4e} {error}"])
    lines = aligned(rows, left=(0, 1, 2))
    for part, share in (rest.energy or {}).items():
        lines.append(f"{part:>11} {share['value']:.5f} {_plus_minus(share['stderr'], '.5f')}")
    lines += absorbed_lines(rest.transfer.absorbed()) if rest.transfer else []
    return lines + ([rest.note] if rest.note else [])


def absorbed_lines(absorbed: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[str]:
    """Where each LED's absorbed light ended, the largest part first, with the largest standard error."""
    lines = []
    for led, regions in absorbed.items():
        parts = sorted(((part["value"], name) for name, part in regions.items() if part["value"] > 0), reverse=True)
        if parts:
            error = 100 * max(part["stderr"] for part in regions.values())
            shown = ", ".join(f"{name} {100 * value:.2f} %" for value, name in parts)
            lines.append(f"{led} absorbed in {shown} ({_plus_minus(error, '.2f')} % or less)")
    return lines


def _plus_minus(stderr: float, form: str) -> str:
    return "+- unknown" if math.isnan(stderr) else f"+- {stderr:{form}}"
