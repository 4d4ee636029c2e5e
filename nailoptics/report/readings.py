"""The readings of a touch and of a trace in numbers: as a table, as a summary, and as lines for the terminal."""

import math
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ..hemodynamics.for_scene import hold_end
from ..light import RestReadings
from ..scene import Scene
from .files import run_summary
from .html import texts
from .maps import order_along_nail
from .numbers import ASCII, aligned, estimated, prefix, quantity, significant, with_error, with_stderr
from .scene_description import CAUSES
from .uncertainty_section import spread_summary

# Residuals of the reduced optics, and spreads over the priors where they were computed.
RESIDUALS = ("beer_lambert_residual_rms_v", "taylor_residual_rms_v")
SPREADS = ("reading_spread", "change_spread")
TEXTS = texts("readings")
# What of the page's table has no room in a terminal.
PAGE_ALONE = ("Blood zone", "Of rest [%]", "z score [σ]", "SNR [1]")


def photodiode_readings(result: xr.Dataset, scene: Scene | None = None) -> pd.DataFrame:
    """Every LED and photodiode, LED by LED: at rest, change, noise; with the scene from proximal to distal.

    Columns are those of the summary and `reading`, its name; `zone`, `distance_mm`, `change_percent`; `z_score`, the
    change in standard errors of the trace; `signal_to_noise`, the change over the electronics' noise of one sample; and
    `noise_equivalent_force_n`: noise of one sample over the mean slope to the end of the hold, else NaN.
    """
    rest, held = result.isel(time=0, drop=True), result.isel(time=hold_end(result), drop=True)
    pair = ("led", "photodiode")
    # Pair by pair, as of a million samples each copy of all readings is large.
    swings = [[int(np.nanargmax(np.abs(course))) for course in of_led] for of_led in result.volts_change.values]
    peak = result[["volts_change", "volts_change_stderr"]].isel(time=xr.DataArray(swings, dims=pair)).drop_vars("time")
    columns = {
        "volts_start": rest.volts,
        "volts_start_stderr": rest.volts_stderr,
        "volts_change": held.volts_change,
        "volts_change_stderr": held.volts_change_stderr,
        "volts_change_peak": peak.volts_change,
        "volts_change_peak_stderr": peak.volts_change_stderr,
        "time_of_peak_s": (pair, result.time.values[swings]),
        "volts_noise_rms": held.volts_noise_rms,
        "time_of_change_s": float(result.time[hold_end(result)]),
        "saturated": result.saturated.any("time"),
        "zone": ("photodiode", result.zone.values[result.zone_of_photodiode]),
        **{name: result[name] for name in (*RESIDUALS, *SPREADS) if name in result},
    }
    data = xr.Dataset(columns)
    if scene is not None:
        leds, areas = scene.layout.leds, scene.layout.photodiode_areas
        data["distance_mm"] = pair, [[math.dist(led.center_mm, a.center_mm) for a in areas] for led in leds]
        data = data.isel(photodiode=order_along_nail(scene))
    table = data.to_dataframe(dim_order=pair).reset_index()
    change, force_n = table.volts_change.abs(), float(abs(held.force_n - rest.force_n))
    table["reading"] = table.photodiode + (" under " + table.led if result.sizes["led"] > 1 else "")
    table["change_percent"] = 100 * table.volts_change / table.volts_start
    table["z_score"] = change / table.volts_change_stderr
    table["signal_to_noise"] = change / table.volts_noise_rms
    table["noise_equivalent_force_n"] = table.volts_noise_rms * force_n / change if force_n else math.nan
    return table


def simulation_summary(result: xr.Dataset) -> dict[str, Any]:
    """Volts at the start, their change to the end of the hold, the largest change, and their noise."""
    table = photodiode_readings(result)
    for name, column, of in (("start", "reading_spread", "volts_start"), ("change", "change_spread", "volts_change")):
        if column in table:
            table[f"volts_{name}_spread"] = table[of].abs() * table[column]
    names = ["led", "photodiode", "saturated", *RESIDUALS, *(n for n in table if n.startswith(("volts", "time")))]
    absorbed: dict[str, Any] = {}
    if "absorbed_fraction" in result:
        part = result[["absorbed_fraction", "absorbed_fraction_stderr"]]
        for led, region in product(part.led.values, part.region.values):
            end = with_stderr(part.sel(led=led, region=region), "absorbed_fraction")
            absorbed.setdefault(str(led), {})[str(region)] = end
    summary: dict[str, Any] = {"readings": table[names].to_dict("records"), "absorbed": absorbed}
    if "ambient_a" in result:
        ambient = result[[name for name in result if str(name).startswith("ambient_")]]
        summary["ambient"] = ambient.to_dataframe().reset_index().to_dict("records")
    if "false_force_n" in result:
        summary["false_force_n"] = result.false_force_n.to_series().to_dict()
    return summary | spread_summary(result) | run_summary(result.attrs)


def reading_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    """The readings in words, of `photodiode_readings`, for the page and the terminal; those at the limit have one."""
    names = ("volts_start", "volts_change_peak", "volts_noise_rms")
    scales = (prefix(float(table[name].abs().max())) for name in names)
    (volts, letter), (change, change_letter), (noise, noise_letter) = scales
    rows = []
    for r in table.itertuples():
        distance = {"Distance to LED [mm]": significant(r.distance_mm)} if "distance_mm" in table else {}
        row = {"Photodiode": r.photodiode, "Blood zone": r.zone} | distance
        row[f"At rest [{letter}V]"] = with_error(r.volts_start / volts, r.volts_start_stderr / volts)
        error = r.volts_change_stderr / change
        row[f"Change [{change_letter}V]"] = with_error(r.volts_change / change, error, sign=True)
        row["Of rest [%]"] = significant(r.change_percent, 3, sign=True)
        row["z score [σ]"] = significant(r.z_score, 2)
        row[f"Peak change [{change_letter}V]"] = significant(r.volts_change_peak / change, 3, sign=True)
        if "reading_spread" in table:
            row["Prior std at rest [%]"] = significant(100 * r.reading_spread, 2)
            row["Prior std of change [%]"] = significant(100 * r.change_spread, 2)
        row[f"Noise, rms [{noise_letter}V]"] = significant(r.volts_noise_rms / noise)
        row["SNR [1]"] = significant(r.signal_to_noise)
        row["NEF [mN]"] = significant(1e3 * r.noise_equivalent_force_n)
        if r.saturated:
            row = dict.fromkeys(row, "–") | {"Photodiode": f"{r.photodiode} saturated", "Blood zone": r.zone} | distance
            row[f"At rest [{letter}V]"] = significant(r.volts_start / volts)
        rows.append(row)
    return rows


def disturbance_lines(result: xr.Dataset) -> list[str]:
    """Ambient light on the photodiode that has most of it, and the false forces by the body, in words."""
    lines = []
    if "ambient_a" in result:
        most = result.isel(photodiode=int(result.ambient_a.argmax()))
        rest = (quantity(float(most[f"ambient_{name}_v"]), "V") for name in ("left", "noise", "flicker"))
        lines.append(TEXTS["ambient"].format(estimated(most, "ambient_volts"), most.photodiode.item(), *rest))
    if "false_force_n" in result:
        forces = zip(result.disturbance.values, result.false_force_n.values, strict=True)
        shown = ", ".join(f"{CAUSES.get(name, name)} {quantity(float(force_n), 'N')}" for name, force_n in forces)
        lines.append(TEXTS["false_force"].format(shown))
    return lines


def simulation_lines(result: xr.Dataset, summary: dict[str, Any]) -> list[str]:
    """The readings of a touch as a table, where the light ends, and conclusions over the priors."""
    table = photodiode_readings(result)
    rows = [
        {"LED": led} | {head: cell for head, cell in row.items() if head not in PAGE_ALONE}
        for led, row in zip(table.led, reading_rows(table), strict=True)
    ]
    hold = f"change: from the first sample to the last under the largest force, at {table.time_of_change_s[0]:.3g} s"
    few = any("?" in cell for row in rows for cell in row.values())
    error = f"standard error of the trace{' (?: too few photons for one)' if few else ''}"
    lines = [*aligned(rows), f"{hold}; +-: {error}; NEF: noise-equivalent force, noise over slope"]
    if table.saturated.any():
        lines.append("saturated: the converter is at its limit, these volts do not measure the light")
    lines += [*absorbed_lines(summary["absorbed"]), *(line.translate(ASCII) for line in disturbance_lines(result))]
    return [*lines, *summary.get("conclusions", [])]


def rest_lines(rest: RestReadings) -> list[str]:
    """The readings of a trace, and where its light went."""
    lines = ["LED, photodiode, detected fraction of the emitted power [1]"]
    names = [f"{row['led']}  {row['photodiode']}" for row in rest.readings]
    for name, row in zip(names, rest.readings, strict=True):
        limit = row.get("upper_limit_95")
        error = _plus_minus(row["stderr"], ".1e") if limit is None else f"below {limit:.1e} (95 %)"
        lines.append(f"{name:<{max(map(len, names))}}  {row['detected_fraction']:.4e} {error}")
    for part, share in (rest.energy or {}).items():
        lines.append(f"{part:>11} {share['value']:.5f} {_plus_minus(share['stderr'], '.5f')}")
    lines += absorbed_lines(rest.transfer.absorbed()) if rest.transfer else []
    return lines + ([rest.transfer.shared_error] if rest.transfer and rest.transfer.shared_error else [])


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
