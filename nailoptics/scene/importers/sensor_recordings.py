"""Recordings of a worn sensor: a CSV with time, readings in volts and, where it was measured, the force."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..text_files import Rows, number_columns, read_rows
from ..touch import PRESSURES
from .recordings import RANGES, unloaded

Array = NDArray[np.float64]

SITES = {"proximal": 1.0, "distal": 0.0, "even": np.nan}
# A converter's counts are whole numbers far above any voltage of a photodiode's stage.
MOST_VOLTS = 50.0
# A converter that reads so much of its range is taken to be at its limit: its last codes cannot be distinguished.
SATURATED = 0.998
# Samples of a touch lie so far apart, usually: what is outside is no time in seconds. [s]
LEAST_STEP_S, MOST_STEP_S = 1e-5, 5.0
# Clocks count from some date; beyond this, steps of milliseconds are lost in their digits. [s]
MOST_TIME_S = 1e10


@dataclass(frozen=True)
class Recording:
    """Readings over time.

    name : what messages call it. names : (R,) str, of the readings.
    time_s : (T,) float, rising. [s]
    volts : (R, T) float; NaN in a gap. [V]
    force_n : (T,) float or None where no force was measured. [N]
    site : (T,) float or None where it is not stated. 1 proximal, 0 distal, NaN even.
    """

    name: str
    names: tuple[str, ...]
    time_s: Array
    volts: Array
    force_n: Array | None
    site: Array | None

    def of(self, names: Sequence[str]) -> "Recording":
        """The same with these readings, in this order; raises InputError unless it has just these, in volts."""
        check_known(self.names, names, self.name)
        order = [self.names.index(name) for name in names]
        check_volts(self.volts, self.names, self.name)
        return Recording(self.name, tuple(names), self.time_s, self.volts[order], self.force_n, self.site)


def read_sensor_recording(path: str | Path) -> Recording:
    """Read a recording: columns time_s, readings in volts, and, where known, force_n, site and both pressures.

    Raises: InputError that names the column, the line, the value and what to do.
    """
    path = Path(path)
    rows = read_rows(path, "a recording: a CSV with columns time_s, force_n and one for each reading in volts")
    name, header = str(path), [cell.strip() for cell in next(rows, (0, [""]))[1]]
    # Spreadsheets end lines with commas.
    while header and not header[-1]:
        header.pop()
    check_header(header, name)
    readings = reading_columns(header)
    titles = ["time_s", *(title for title in ("force_n", "site") if title in header), *readings]
    positions = {title: header.index(title) for title in titles}
    whole = _without_more_cells(rows, len(header), name)
    line, columns = number_columns(whole, positions, name, codes={"site": SITES})
    time_s = columns["time_s"]
    if len(time_s) < 2:
        raise InputError(f"{name}: has {len(time_s)} sample{'' if len(time_s) else 's'}; two or more are needed.")
    backwards = np.flatnonzero(np.diff(time_s) <= 0)
    if backwards.size:
        at = int(backwards[0]) + 1
        raise InputError(
            f"{name} line {line[at]}: time_s = {time_s[at]:.15g} does not come after {time_s[at - 1]:.15g}; "
            "sort the rows."
        )
    step_s = float(np.median(np.diff(time_s)))
    if not LEAST_STEP_S <= step_s <= MOST_STEP_S or np.abs(time_s).max() > MOST_TIME_S:
        raise InputError(
            f"{name}: time_s reaches {np.abs(time_s).max():g} in steps of {step_s:g}; give it in seconds, "
            f"{LEAST_STEP_S:g} to {MOST_STEP_S:g} from sample to sample."
        )
    volts = np.array([columns[title] for title in readings])
    force_n = columns.get("force_n")
    if force_n is not None:
        force_n = unloaded(force_n)
        most_n = RANGES["force_n"][1]
        wrong = np.flatnonzero((force_n < 0) | (force_n > most_n))
        if wrong.size:
            at = int(wrong[0])
            raise InputError(
                f"{name} line {line[at]}: force_n = {force_n[at]:g} must lie in 0 to {most_n:g} N; "
                "check its sign and unit."
            )
    return Recording(name, readings, time_s, volts, force_n, columns.get("site"))


def _without_more_cells(rows: Rows, count: int, name: str) -> Rows:
    """The same rows; raises InputError at one with more cells than there are columns."""
    for line, row in rows:
        if any(cell.strip() for cell in row[count:]):
            raise InputError(
                f"{name} line {line}: has {len(row)} cells for {count} columns; write numbers with a decimal point."
            )
        yield line, row


def reading_columns(header: Sequence[str]) -> tuple[str, ...]:
    """The columns that hold readings."""
    return tuple(title for title in header if title not in ("time_s", "force_n", "site", *PRESSURES))


def check_header(header: Sequence[str], name: str) -> None:
    """Raise InputError unless there is time, at least one reading, no column without a title, and no title twice."""
    if not any(header):
        raise InputError(f"{name}: is empty; give a CSV with time_s and the readings in volts.")
    if "\ufffd" in "".join(header):
        raise InputError(f"{name}: is no text; give a CSV with time_s and the readings in volts.")
    if len(header) == 1 and ";" in header[0]:
        raise InputError(f"{name}: has semicolons between columns; write commas, and numbers with a decimal point.")
    if "time_s" not in header:
        raise InputError(f"{name}: has no column time_s (it has {', '.join(header)[:80]}); add the times in seconds.")
    if "" in header:
        raise InputError(f"{name}: column {header.index('') + 1} has no title; name it or leave it out.")
    twice = next((title for title in header if header.count(title) > 1), None)
    if twice is not None:
        raise InputError(f"{name}: column {twice!r} is there twice; rename one.")
    if not reading_columns(header):
        raise InputError(f"{name}: has no reading; add a column of volts for each photodiode.")


def check_known(found: Sequence[str], names: Sequence[str], label: str) -> None:
    """Raise InputError unless the readings that were found are just those of a board."""
    missing, unknown = [n for n in names if n not in found], [n for n in found if n not in names]
    if missing:
        raise InputError(
            f"{label}: has no column {missing[0]!r}; this board's readings are {', '.join(names)}; "
            "take the recording's own board."
        )
    if unknown:
        raise InputError(
            f"{label}: column {unknown[0]!r} is no reading of this board ({', '.join(names)}); "
            "rename it or leave it out."
        )


def check_volts(volts: Array, names: Sequence[str], label: str) -> None:
    """Raise InputError for readings that are constant, empty, or counts of a converter."""
    for title, values in zip(names, volts, strict=True):
        seen = values[np.isfinite(values)]
        if not seen.size:
            raise InputError(f"{label}: column {title!r} is empty; leave it out or record it.")
        if np.abs(seen).max() > MOST_VOLTS:
            raise InputError(
                f"{label}: column {title!r} reaches {np.abs(seen).max():g} V, which looks like a converter's counts; "
                "convert it to volts."
            )
        if seen.size > 2 and np.ptp(seen) == 0:
            raise InputError(
                f"{label}: column {title!r} is constant at {seen[0]:g} V; check its wiring, "
                "or lower the LED's power if the converter ends there."
            )


def recording_csv(recording: Recording) -> str:
    """A recording as the text of its file."""
    named = {value: name for name, value in SITES.items() if np.isfinite(value)}
    out = StringIO()
    rows = csv.writer(out, lineterminator="\n")
    site, force = recording.site, recording.force_n
    known = [*(["force_n"] if force is not None else []), *(["site"] if site is not None else [])]
    rows.writerow(["time_s", *known, *recording.names])
    for k, time_s in enumerate(recording.time_s):
        cells = [repr(float(time_s))]
        cells += [f"{force[k]:.6g}"] if force is not None else []
        cells += [named.get(site[k], "even")] if site is not None else []
        rows.writerow([*cells, *("" if np.isnan(v) else f"{v:.7g}" for v in recording.volts[:, k])])
    return out.getvalue()
