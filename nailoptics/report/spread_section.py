"""What is unknown of the finger, in words and tables: how far answers spread, and which conclusions hold over it."""

import math
from typing import Any

import numpy as np
import xarray as xr

from .html import escaped, section, small, table
from .numbers import significant, with_error
from .tables import number


def spread_summary(result: xr.Dataset) -> dict[str, Any]:
    """The priors with the largest spread that each makes, and what holds over all of them; empty without a spread."""
    if "prior" not in result.dims:
        return {}
    return {"unknowns": _rows(result), "conclusions": conclusions(result)}


def _rows(result: xr.Dataset) -> list[dict[str, Any]]:
    """The priors of a simulated touch, the one that moves changes most first."""
    rows = []
    for i, name in enumerate(result.prior.values):
        one = result.isel(prior=i)
        texts = ("field", "how", "source")
        row: dict[str, Any] = {"name": str(name)} | {text: str(one[f"prior_{text}"].item()) for text in texts}
        row |= {"low": float(one.prior_range[0]), "high": float(one.prior_range[1])}
        for kind in ("reading", "change", "signal"):
            values = one[f"prior_{kind}_spread"].values
            worst = np.unravel_index(int(np.nan_to_num(values, nan=-1.0).argmax()), values.shape)
            row[f"{kind}_spread"] = float(values[worst])
            row[f"{kind}_spread_stderr"] = float(one[f"prior_{kind}_spread_stderr"].values[worst])
        rows.append(row)
    return sorted(rows, key=lambda row: -np.nan_to_num(max(row["reading_spread"], row["change_spread"]), nan=-1.0))


def conclusions(result: xr.Dataset) -> list[str]:
    """What a designer may conclude of a simulated touch, whatever the finger."""
    rows, lines = _rows(result), []
    traced = [row for row in rows if row["how"] != "not traced"]
    signs, moved = result.keeps_sign.values, result.signal.values != 0
    if moved.any():
        kept, all_ = int((signs & moved).sum()), int(moved.sum())
        lost = [
            f"{photodiode} under {led}"
            for i, led in enumerate(result.led.values)
            for j, photodiode in enumerate(result.photodiode.values)
            if moved[i, j] and not signs[i, j]
        ]
        text = f"The sign of the change holds over all that is unknown of the finger at {kept} of {all_} readings"
        lines.append(text + (f", not at {', '.join(lost)}." if lost else "."))
    if traced:
        words = (
            "Over it readings spread by {} and their changes by {} (one standard deviation), most by the {} and the {}."
        )
        names = [max(traced, key=lambda row: row[f"{kind}_spread"])["name"] for kind in ("reading", "change")]
        lines.append(words.format(_range(result.reading_spread), _range(result.change_spread), *names))
        lines.append("The force that a sample resolves (noise / slope) spreads as the changes do.")
    if left := [row["name"] for row in rows if row["how"] == "not traced"]:
        lines.append(
            f"Not in it, because they need traces of their own ([priors] own_traces = true): {', '.join(left)}."
        )
    return lines


def _range(spread: xr.DataArray) -> str:
    """A spread from the photodiode where it is least to that where it is most."""
    known = spread.values[np.isfinite(spread.values)]
    if not known.size:
        return "an unknown part"
    least, most = (f"{100 * x:.0f}" for x in (known.min(), known.max()))
    return f"{least} %" if least == most else f"{least}-{most} %"


def spread_section(result: xr.Dataset) -> str:
    """The section of a page on what is unknown; empty without a spread."""
    if "prior" not in result.dims:
        return ""
    head = ["Unknown", "95 % within", "Reading spreads<br>at most [%]", "Change spreads<br>at most [%]", "How"]
    lines = [
        [
            escaped(row["name"]),
            f"{significant(row['low'])} to {significant(row['high'])}",
            *(_percent(row[f"{kind}_spread"], row[f"{kind}_spread_stderr"]) for kind in ("reading", "change")),
            row["how"],
        ]
        for row in _rows(result)
    ]
    said = "".join(f"<p>{escaped(line)}</p>" for line in conclusions(result))
    sources = "; ".join(f"{row['name']}: {row['source']}" for row in _rows(result))
    return section(
        "What is unknown of the finger",
        said,
        table(head, lines),
        small(
            "Each spread is one standard deviation over the prior's range, at the photodiode that it moves most; all "
            "together add in quadrature. Ranges of absorption and scattering are factors. " + escaped(sources) + "."
        ),
    )


def _percent(value: float, error: float) -> str:
    return number(value, with_error(100 * value, 100 * error)) if math.isfinite(value) else "not traced"
