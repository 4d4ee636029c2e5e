"""Uncertainty due to unknown parameters of the finger, in words and tables: standard deviations over the priors."""

from typing import Any

import numpy as np
import xarray as xr

from .html import details, section, small, table, texts
from .numbers import cells, estimated, plain, range_of

# A scene is off a prior's mean by more than so many of its standard deviations.
OFF_CENTRE = 0.5
KINDS, TEXTS = ("reading", "change", "resolution"), texts("uncertainty")
# Standard deviations of no effect that is worth a row, and of none at all.
NO_EFFECT, ROUNDING = 1e-4, 1e-6


def spread_summary(result: xr.Dataset) -> dict[str, Any]:
    """The priors with the largest standard deviation due to each, and conclusions; empty without any."""
    if not result.sizes.get("prior"):
        return {}
    rows = _rows(result)
    return {"unknowns": rows, "conclusions": _conclusions(result, rows)}


def _kinds(result: xr.Dataset) -> list[str]:
    """The quantities whose standard deviation over the priors a result has."""
    return [kind for kind in KINDS if f"prior_{kind}_spread" in result]


def _rows(result: xr.Dataset) -> list[dict[str, Any]]:
    """The priors, the most influential first, by the best layout or the photodiode that each affects most."""
    rows: list[dict[str, Any]] = []
    # Without the rest of the result, which would be cut as often.
    priors = result[[name for name in result.data_vars if str(name).startswith("prior_")]]
    priors = priors.isel(layout=0) if "layout" in priors.dims else priors
    for name, p in ((name, priors.sel(prior=name)) for name in priors.prior.values):
        row = {"name": str(name)} | plain(p, field="prior_field", how="prior_how", source="prior_source")
        row |= {"low": float(p.prior_range[0]), "high": float(p.prior_range[1]), "offset": float(p.prior_offset)}
        for kind in _kinds(result):
            spread = p[[f"prior_{kind}_spread", f"prior_{kind}_spread_stderr"]]
            at = np.nan_to_num(spread[f"prior_{kind}_spread"].values, nan=-1.0).argmax()
            row |= {str(key).removeprefix("prior_"): float(values.values.flat[at]) for key, values in spread.items()}
        rows.append(row)
    return sorted(rows, key=lambda row: -max(np.nan_to_num(row[f"{kind}_spread"], nan=-1.0) for kind in _kinds(result)))


def _conclusions(result: xr.Dataset, rows: list[dict[str, Any]]) -> list[str]:
    """What a designer may conclude over the priors of the finger, whose rows are given."""
    traced = [row for row in rows if row["how"] != "not traced"]
    lines = (_of_layouts if "best_stays_best_at" in result else _of_readings)(result, traced)
    if left := [row["name"] for row in rows if row["how"] == "not traced"]:
        lines.append(TEXTS["cut_off" if result.attrs.get("cut_off") else "not_included"].format(", ".join(left)))
    return lines


def _of_readings(result: xr.Dataset, traced: list[dict[str, Any]]) -> list[str]:
    """What the priors make of a simulated touch."""
    # A converter at its limit has no change, whatever its light does.
    usable = ~result.saturated.any("time")
    if not traced or not usable.any():
        return []
    words = list[str]()
    for kind in ("reading", "change"):
        most = max(traced, key=lambda row: row[f"{kind}_spread"])["name"]
        words += [_range(result[f"{kind}_spread"].where(usable), result[f"{kind}_spread_stderr"]), most]
    lines = [TEXTS["vary"].format(*words)]
    off, shift = [row["name"] for row in traced if abs(row["offset"]) > OFF_CENTRE], result.reading_shift.where(usable)
    if off and np.isfinite(shift).any():
        ends = " to ".join(f"{round(100 * x):+d} %" for x in (np.nanmin(shift), np.nanmax(shift)))
        lines.append(TEXTS["shifted"].format(", ".join(off), ends))
    signs, count = int(result.keeps_sign.where(usable, False).sum()), int(usable.sum())
    unsure = "" if signs == count else TEXTS["unsure"]
    return [*lines, TEXTS["sign"].format(signs, count, unsure), TEXTS["nef"], TEXTS["not_among"]]


def _of_layouts(result: xr.Dataset, traced: list[dict[str, Any]]) -> list[str]:
    """How robust a ranking of layouts is over the priors."""
    nodes, stays, beaten = (int(result[name]) for name in ("nodes", "best_stays_best_at", "best_surely_beaten_at"))
    compared = int(np.isfinite(result.resolution_spread.values).sum())
    lines = []
    if compared > 1 and nodes:
        lines.append(TEXTS["robust"].format(compared, result.layout.values[0], stays, nodes, beaten or "none"))
    if traced:
        most = max(traced, key=lambda row: row["resolution_spread"])["name"]
        n = result.resolution_at_node_n.isel(layout=0).values
        ends = " to ".join(f"{1e3 * x:.3g}" for x in (np.nanmin(n), np.nanmax(n)))
        spread = estimated(result.isel(layout=0), "resolution_spread", 100)
        lines.append(TEXTS["resolution"].format(spread, ends, most))
    return lines


def _range(spread: xr.DataArray, stderr: xr.DataArray) -> str:
    """The range of a standard deviation over the photodiodes, without its lower end where photons hide that."""
    known = np.isfinite(spread.values)
    values, errors = spread.values[known], stderr.values[known]
    if not values.size:
        return "an unknown amount"
    least, most = (f"{100 * x:.0f}" for x in (values.min(), values.max()))
    if values.min() < errors[values.argmin()]:
        return f"up to {most} %"
    return f"{least} %" if least == most else f"{least}-{most} %"


def spread_section(result: xr.Dataset) -> str:
    """The section of a page on uncertainty over the priors; empty without any."""
    if not result.sizes.get("prior"):
        return ""
    rows = _rows(result)
    columns = {f"{kind.capitalize()}, largest std [%]": (f"{kind}_spread", 100.0, 0) for kind in _kinds(result)}
    lines, unresolved, kinds = list[dict[str, str]](), list[str](), [f"{kind}_spread" for kind in _kinds(result)]
    for row in (row for row in rows if row["how"] != "not traced"):
        row |= {key: 0.0 for k in kinds if row[k] <= ROUNDING for key in (k, f"{k}_stderr")}
        if any(row[k] > NO_EFFECT and not row[k] < row[f"{k}_stderr"] < np.inf for k in kinds):
            named = {"Parameter": row["name"], "95 % range": range_of(row["field"], row["low"], row["high"])}
            lines.append(named | cells(row, columns))
        elif any(row[k] > NO_EFFECT for k in kinds):
            unresolved.append(row["name"])
    note = TEXTS["note"] + (" " + TEXTS["unresolved"].format(", ".join(unresolved)) if unresolved else "")
    sources = table([{"Parameter": row["name"], "Source of its range": row["source"]} for row in rows], kind="words")
    tables = table(lines), small(note), details("Sources of the ranges", sources)
    return section("Uncertainty over the priors", *_conclusions(result, rows), *tables)
