"""Recordings that a scene names: columns of a CSV over time, checked sample by sample."""

from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ..text_files import read_rows

# What a column may hold, and its unit. A touch presses with less than 100 N/cm^2; an artery holds less than 60 kPa.
RANGES: dict[str, tuple[float, float, str]] = {
    "force_n": (0.0, 100.0, "N"),
    "shear_n": (-100.0, 100.0, "N"),
    "proximal_pressure_pa": (0.0, 1e6, "Pa"),
    "distal_pressure_pa": (0.0, 1e6, "Pa"),
    "arterial_pressure_pa": (-1e4, 6e4, "Pa"),
}
# A load cell that nothing presses reads a little on either side of zero: so far below it counts as none. [N]
UNLOADED_N = 0.05
_WORDS = {1: "one number", 2: "two numbers", 3: "three numbers", 4: "four numbers", 5: "five numbers"}

Columns = dict[str, tuple[float, ...]]


def read_columns(path: Path, name: str, known: Sequence[str], *, either: Sequence[Sequence[str]]) -> Columns:
    """Columns of a recording by name, time_s among them; others than the known ones are left out.

    name : the field that names the file, for messages.
    known : columns that are read where they are there.
    either : sets of columns of which one must be whole.

    Raises: InputError, one line that names the file, the line and the value.
    """
    shown = f"{name} {str(path)!r}"
    needed = " and ".join(["time_s", *either[0]])
    lines = read_rows(path, f"a CSV with columns {needed.replace(' and ', ',')}", shown=shown)
    header = [cell.strip() for cell in next(lines, (0, []))[1]]
    if "time_s" not in header or not any(set(names) <= set(header) for names in either):
        others = "".join(f", or time_s and {' and '.join(names)}" for names in either[1:])
        raise InputError(f"{shown} needs a header with {needed}{others}; write one, or give another file.")
    found = ["time_s", *(name for name in known if name in header)]
    places, rows = [header.index(name) for name in found], array("d")
    for number, row in lines:
        try:
            rows.extend([float(row[place]) for place in places])
        except (ValueError, IndexError):
            raise InputError(f"{shown} line {number}: {','.join(row)!r} is not {_WORDS[len(found)]}.") from None
    columns = {name: tuple(rows[i :: len(found)]) for i, name in enumerate(found)}
    if "force_n" in columns:
        columns["force_n"] = tuple(unloaded(columns["force_n"]).tolist())
    check_columns(columns, shown)
    return columns


def unloaded(force_n: ArrayLike) -> NDArray[np.float64]:
    """Measured forces (T,), of which none is left where a load cell reads just below zero. [N]"""
    force_n = np.asarray(force_n, dtype=float)
    return np.where((force_n < 0.0) & (force_n >= -UNLOADED_N), 0.0, force_n)


def check_columns(columns: Mapping[str, Sequence[float]], name: str) -> None:
    """Raise InputError unless times rise, every column has a value for each, and all are finite and possible."""
    time_s = columns["time_s"]
    lengths = {len(column) for column in columns.values()}
    if len(time_s) < 2 or len(lengths) > 1:
        counts = ", ".join(f"{len(column)} of {column_name}" for column_name, column in columns.items())
        raise InputError(f"{name} needs at least two samples, as many of each column, has {counts}.")
    if not all(np.all(np.isfinite(column)) for column in columns.values()):
        raise InputError(f"{name} holds a value that is not finite; remove the sample.")
    falling = np.flatnonzero(np.diff(time_s) <= 0)
    if falling.size:
        at = int(falling[0]) + 1
        raise InputError(
            f"{name}: time_s must rise, but sample {at + 1} ({time_s[at]:.15g}) follows {time_s[at - 1]:.15g}; "
            "sort or remove it."
        )
    for column_name, (low, high, unit) in RANGES.items():
        column = columns.get(column_name, (low,))
        if min(column) < low or max(column) > high:
            wrong = min(column) if min(column) < low else max(column)
            raise InputError(
                f"{name}: {column_name} must lie in {low:g} to {high:g} {unit}, found {wrong:g}; check sign and unit."
            )
