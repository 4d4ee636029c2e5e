"""Tables of measurements on people: nails, skin, pulse and slow waves, read and checked, and what is computed of them.

The shipped ones are in assets/real, each with its source; tables of one's own with the same names and columns replace
them.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ...assets import asset_path, read_toml
from ...checks import Array
from ...errors import InputError

SPECTRUM_NM = np.arange(400.0, 701.0, 10.0)
_SPECTRUM = [f"{nm:.0f}_nm" for nm in SPECTRUM_NM]
NAIL_RGB, SKIN_RGB = ([f"{part}_{channel}" for channel in "rgb"] for part in ("nail", "skin"))
# Columns of each table: None for text, else the numbers above the first and up to the second of which all must be.
COLUMNS = {
    table: {name: tuple(ends) if ends else None for name, ends in columns.items()}
    for table, columns in read_toml("real/columns.toml").items()
}
# Places of skin, and the percentiles that a table has of each; those of ring fingers are pooled over groups.
PERCENTILES = {"ring finger": (5, 25, 50, 75, 95), "back of hand": (5, 50, 95)}
# Recordings in which motion spoils the pulse correlate less than this.
LEAST_CORRELATION = 0.9
# Of the finger's recordings, those at a saturation near the scene's. [percent]
NORMAL_SPO2 = 94.0
HAEMOGLOBIN_STEP_G_PER_L = 10.0


def read_people(name: str, folder: Path | None = None) -> pd.DataFrame:
    """A table of `COLUMNS`: from a folder where it has one, else the shipped one.

    Its attrs are the source, and whether it is the shipped one.

    Raises: InputError for missing or unknown columns, values outside of their ranges, or too few rows.
    """
    shipped, columns = asset_path(f"real/{name}.csv"), COLUMNS[name]
    path = folder / shipped.name if folder is not None and (folder / shipped.name).is_file() else shipped
    try:
        table = pd.read_csv(path, comment="#")
    except (ValueError, OSError) as error:
        why = " ".join(str(error).split())
        raise InputError(f"{path}: cannot be read as a table ({why}); give a CSV with named columns.") from None
    if missing := [column for column in columns if column not in table]:
        raise InputError(f"{path}: lacks the column {missing[0]}; it needs {', '.join(columns)}.")
    if unknown := [column for column in table if column.endswith("_nm") and column not in columns]:
        raise InputError(f"{path}: has an unknown column {unknown[0]}; its columns are {', '.join(columns)}.")
    for column, ends in columns.items():
        text = table[column]
        values = text if ends is None else pd.to_numeric(text, errors="coerce").to_numpy(float)
        wrong = text.isna() if ends is None else ~((values > ends[0]) & (values <= ends[1]) & np.isfinite(values))
        if (rows := np.flatnonzero(wrong)).size:
            kind = "a name" if ends is None else f"a finite number above {ends[0]:g}"
            kind += f" and at most {ends[1]:g}" if ends and np.isfinite(ends[1]) else ""
            got = f"got {text.iloc[rows[0]]} in row {rows[0] + 1}"
            raise InputError(f"{path}: {column} must be {kind}, {got}; correct it.")
        table[column] = values
    if lacking := _lacking(name, table):
        raise InputError(f"{path}: needs {lacking}; add rows or leave the table out.")
    head = (line[1:].strip() for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#"))
    source = " ".join(head).partition("Source: ")[2] if path == shipped else str(path)
    table.attrs = {"source": source, "shipped": path == shipped}
    return table


def _lacking(name: str, table: pd.DataFrame) -> str:
    """What rows a table lacks for its comparison, in words; empty if none."""
    if name == "nail_photos":
        days = table.groupby("day")["hb_g_per_l"]
        enough = len(table) > len(days) + 1 and (days.max() > days.min()).any()
        return "" if enough else "two people more than days, of different haemoglobin within a day"
    if name == "red_infrared_pulse":
        still = table[table["correlation"] > LEAST_CORRELATION]
        if still["ratio_of_ratios"].nunique() < 3:
            return f"three recordings of different ratio with a correlation above {LEAST_CORRELATION:g}"
        high = (still["spo2_percent"] >= NORMAL_SPO2).any()
        return "" if high else f"one of these recordings at a saturation of {NORMAL_SPO2:g} % or more"
    if name == "skin_spectra":
        unknown = set(table["place"]) - set(PERCENTILES)
        if unknown or not len(table):
            return f"rows of place {' or '.join(PERCENTILES)}" + "".join(f" and none of {one}" for one in unknown)
        for (place, group), rows in table.groupby(["place", "group"]):
            for percent in PERCENTILES[place]:
                if (rows["percentile"] == percent).sum() != 1:
                    return f"one row of percentile {percent} for {place}, group {group}"
        return ""
    return "" if len(table) > 1 else "two rows"


def percentile(spectra: pd.DataFrame, percent: int) -> Array:
    """Reflectance at `SPECTRUM_NM` of a place and group, (q,) float. [percent]"""
    return np.asarray(spectra[spectra.percentile == percent][_SPECTRUM].to_numpy(float)[0])


def pooled(spectra: pd.DataFrame, percentiles: Sequence[int]) -> Array:
    """Percentiles of ring fingers of all groups together, from those of each, (n, q) float. [percent]"""
    if spectra.group.nunique() == 1:
        return np.stack([percentile(spectra, percent) for percent in percentiles])
    known, samples = PERCENTILES["ring finger"], []
    for _, group in spectra.groupby("group"):
        rows = np.stack([percentile(group, percent) for percent in known])
        at = 100 * (np.arange(count := people_count(group)) + 0.5) / count
        samples.append(np.stack([np.interp(at, known, column) for column in rows.T], -1))
    return np.asarray(np.percentile(np.concatenate(samples), percentiles, axis=0))


def people_count(spectra: pd.DataFrame) -> int:
    """How many people a table of spectra has."""
    return int(np.ceil(spectra[spectra.percentile == 50].people.sum()))


def slope_within_days(photos: pd.DataFrame, values: Array) -> tuple[float, float]:
    """Of people's values, (p,) float, per 10 g/l of haemoglobin within a day of photographs, and its standard error."""
    day = photos["day"].to_numpy()
    x, y = (v - np.array([v[day == d].mean() for d in day]) for v in (photos["hb_g_per_l"].to_numpy(), values))
    slope = float(x @ y / (x @ x))
    freedom = len(x) - len(set(day)) - 1
    stderr = float(np.sqrt(((y - slope * x) ** 2).sum() / freedom / (x @ x)))
    return HAEMOGLOBIN_STEP_G_PER_L * slope, HAEMOGLOBIN_STEP_G_PER_L * stderr
