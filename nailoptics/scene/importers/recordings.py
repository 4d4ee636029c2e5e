"""Recordings that a scene names: columns of a CSV over time, checked sample by sample."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ..base import LEAST_AREA_MM2
from ..text_files import number_columns, read_rows

PRESSURES = ("proximal_pressure_pa", "distal_pressure_pa")
# What a column may hold, and its unit. A touch presses with less than 100 N/cm^2; an artery holds less than 60 kPa.
RANGES: dict[str, tuple[float, float, str]] = {
    "force_n": (0.0, 100.0, "N"),
    "shear_n": (-100.0, 100.0, "N"),
    **dict.fromkeys(PRESSURES, (0.0, 1e6, "Pa")),
    "contact_area_mm2": (LEAST_AREA_MM2, 1e3, "mm^2"),
    "proximal_share": (0.0, 1.0, "(a part)"),
    "arterial_pressure_pa": (-1e4, 6e4, "Pa"),
}
# A load cell that nothing presses reads a little on either side of zero: so far below it counts as none. [N]
UNLOADED_N = 0.05

Columns = dict[str, tuple[float, ...]]


def read_columns(path: Path, name: str, known: Sequence[str], *, either: Sequence[Sequence[str]]) -> Columns:
    """Columns of a recording by name, time_s among them; others than the known ones are left out.

    name : the field that names the file, for messages.
    known : columns that are read where they are there.
    either : sets of columns of which one must be whole.

    Raises: InputError, one line that names the file, the line and the value.
    """
    shown = f"{name} {str(path)!r}"
    rows = read_rows(path, f"a CSV with columns time_s,{','.join(either[0])}", shown=shown)
    header = [cell.strip() for cell in next(rows, (0, []))[1]]
    if "time_s" not in header or not any(set(names) <= set(header) for names in either):
        needed = ", or ".join(" and ".join(["time_s", *names]) for names in either)
        raise InputError(f"{shown} needs a header with {needed}; write one, or give another file.")
    titles = ["time_s", *(title for title in known if title in header)]
    line, columns = number_columns(rows, {title: header.index(title) for title in titles}, shown, gaps=False)
    if "force_n" in columns:
        columns["force_n"] = unloaded(columns["force_n"])
    check_columns(columns, shown, line)
    return {title: tuple(column.tolist()) for title, column in columns.items()}


def unloaded(force_n: ArrayLike) -> NDArray[np.float64]:
    """Measured forces (T,), of which none is left where a load cell reads just below zero. [N]"""
    force_n = np.asarray(force_n, dtype=float)
    return np.where((force_n < 0.0) & (force_n >= -UNLOADED_N), 0.0, force_n)


def check_columns(columns: Mapping[str, ArrayLike], name: str, line: NDArray[np.int64] | None = None) -> None:
    """Raise InputError unless there are two samples or more of each column, times rise, and values are possible.

    line : (T,) int. Of each sample in its file, for messages; its number if not given.
    """
    arrays = {title: np.asarray(column, float) for title, column in columns.items()}
    time_s, counts = arrays["time_s"], " and ".join(map(str, sorted({len(array) for array in arrays.values()})))

    def at(sample: int) -> str:
        return f"{name}: sample {sample + 1}:" if line is None else f"{name} line {line[sample]}:"

    if len(time_s) < 2 or len(counts.split()) > 1:
        what = "sample" if counts == "1" else "samples"
        raise InputError(f"{name}: has {counts} {what}; two or more are needed, as many of each column.")
    for k in np.flatnonzero(~(np.diff(time_s) > 0))[:1] + 1:
        raise InputError(f"{at(k)} time_s = {time_s[k]:.15g} does not come after {time_s[k - 1]:.15g}; sort the rows.")
    for title, (low, high, unit) in RANGES.items():
        values = arrays.get(title, np.empty(0))
        for k in np.flatnonzero((values < low) | (values > high))[:1]:
            raise InputError(
                f"{at(k)} {title} = {values[k]:g} must lie in {low:g} to {high:g} {unit}; check its sign and unit."
            )
