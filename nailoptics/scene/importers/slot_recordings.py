"""Recordings of an oximeter: a CSV whose rows are slots, or with a column for each LED and photodiode."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..oximeter import DARK
from ..text_files import Rows, number_columns, read_rows
from .sensor_recordings import check_volts

Array = NDArray[np.float64]

WHAT = "an oximeter's recording: a CSV with time_s and LED:PHOTODIODE columns, or time_s, slot and one per photodiode"


@dataclass(frozen=True)
class OximeterRecording:
    """Both LEDs' readings over time, at the times of the red ones.

    name : what messages call it. photodiodes : (P,) str.
    time_s : (T,) float, rising. [s]
    volts : (2, P, T) float. Of the red and the infrared LED as they were read, dark light included; NaN in a gap. [V]
    dark_v : (P, T) float. With no LED lit; 0 where that was not read. [V]
    """

    name: str
    photodiodes: tuple[str, ...]
    time_s: Array
    volts: Array
    dark_v: Array


def read_oximeter_recording(
    path: str | Path, *, leds: tuple[str, str], photodiodes: Sequence[str], delays_s: Mapping[str, float]
) -> OximeterRecording:
    """Read a recording.

    leds : names of the red and the infrared LED.
    photodiodes : names of the board's; the recording may hold fewer.
    delays_s : how much later than the red slot each light's slot is, for columns of one time; rows of slots have times
        of their own. [s]

    Raises: InputError that names the column, the line, the value and what to do.
    """
    rows, name = read_rows(Path(path), WHAT), str(path)
    header = [cell.strip() for cell in next(rows, (0, []))[1]]
    if not header:
        raise InputError(f"{name}: is empty; give {WHAT}.")
    if "time_s" not in header:
        raise InputError(f"{name}: has no column time_s (it has {', '.join(header)[:80]}); add the times in seconds.")
    twice = next((title for title in header if header.count(title) > 1), None)
    if twice is not None:
        raise InputError(f"{name}: column {twice!r} is there twice; rename one.")
    if "slot" in header:
        series, found = _of_slots(header, rows, name, leds=leds, photodiodes=photodiodes)
    else:
        series, found = _of_columns(header, rows, name, leds=leds, photodiodes=photodiodes, delays_s=delays_s)
    return _aligned(series, found, name, leds)


def recording_of(
    name: str, *, photodiodes: Sequence[str], time_s: Array, volts: Array, dark_v: Array | None = None
) -> OximeterRecording:
    """A recording from arrays, checked as a file is; shapes as in `OximeterRecording`."""
    time_s, volts = np.asarray(time_s, float), np.asarray(volts, float)
    dark_v = np.zeros_like(volts[0]) if dark_v is None else np.asarray(dark_v, float)
    for kind, one in (("red", volts[0]), ("infrared", volts[1])):
        check_volts(one, [f"{kind}:{photodiode}" for photodiode in photodiodes], name)
    return OximeterRecording(name, tuple(photodiodes), time_s, volts, dark_v)


Series = dict[str, tuple[Array, Array]]


def _of_columns(
    header: Sequence[str],
    rows: Rows,
    name: str,
    *,
    leds: tuple[str, str],
    photodiodes: Sequence[str],
    delays_s: Mapping[str, float],
) -> tuple[Series, tuple[str, ...]]:
    found = tuple(one for one in photodiodes if any(f"{light}:{one}" in header for light in leds))
    if not found:
        raise InputError(
            f"{name}: has no column such as '{leds[0]}:{photodiodes[0]}' (it has {', '.join(header)[:80]}); name the "
            "readings LED:PHOTODIODE as the scene does."
        )
    titles = {light: [f"{light}:{one}" for one in found] for light in (*leds, DARK)}
    missing = {light: [title for title in own if title not in header] for light, own in titles.items()}
    if len(missing[DARK]) == len(found):
        del titles[DARK]
    for light in titles:
        if missing[light]:
            raise InputError(
                f"{name}: has no column {missing[light][0]!r}; an oximeter needs both LEDs on each photodiode."
            )
    columns_read = ["time_s", *(title for own in titles.values() for title in own)]
    line, columns = number_columns(rows, {title: header.index(title) for title in columns_read}, name, codes={})
    time_s = _checked_times(columns["time_s"], line, name)
    series: Series = {
        light: (time_s + delays_s.get(light, 0.0), np.array([columns[title] for title in own]))
        for light, own in titles.items()
    }
    return series, found


def _of_slots(
    header: Sequence[str],
    rows: Rows,
    name: str,
    *,
    leds: tuple[str, str],
    photodiodes: Sequence[str],
) -> tuple[Series, tuple[str, ...]]:
    found = tuple(one for one in photodiodes if one in header)
    if not found:
        raise InputError(f"{name}: has no column of a photodiode; known here: {', '.join(photodiodes)}.")
    lights = (*leds, DARK)
    positions = {title: header.index(title) for title in ("time_s", "slot", *found)}
    codes = {"slot": {light: float(k) for k, light in enumerate(lights)}}
    line, columns = number_columns(rows, positions, name, codes=codes)
    series: Series = {}
    for k, light in enumerate(lights):
        lit = columns["slot"] == k
        if lit.any():
            time_s = _checked_times(columns["time_s"][lit], line[lit], name)
            series[light] = time_s, np.array([columns[one][lit] for one in found])
        elif light != DARK:
            raise InputError(f'{name}: has no slot "{light}"; an oximeter needs both LEDs.')
    return series, found


def _aligned(series: Series, found: tuple[str, ...], name: str, leds: tuple[str, str]) -> OximeterRecording:
    """Everything at the times of the red readings, which are a few milliseconds from the others."""
    time_s, red = series[leds[0]]

    def at_red(light: str) -> Array:
        own_s, volts = series[light]
        return np.array([np.interp(time_s, own_s, one) for one in volts])

    dark_v = at_red(DARK) if DARK in series else np.zeros_like(red)
    volts = np.stack([red, at_red(leds[1])])
    return recording_of(name, photodiodes=found, time_s=time_s, volts=volts, dark_v=dark_v)


def _checked_times(time_s: Array, line: NDArray[np.int64], name: str) -> Array:
    """The times, if there are two or more and they rise."""
    if len(time_s) < 2:
        raise InputError(f"{name}: has {len(time_s)} sample; a recording needs three beats or more.")
    backwards = np.flatnonzero(~(np.diff(time_s) > 0))
    if backwards.size:
        at = int(backwards[0]) + 1
        raise InputError(
            f"{name} line {line[at]}: time_s = {time_s[at]:.15g} does not come after {time_s[at - 1]:.15g}; "
            "sort the rows."
        )
    return time_s


def oximeter_csv(recording: OximeterRecording, leds: tuple[str, str]) -> str:
    """A recording as the text of its file, a column for each LED, and the dark slot, on each photodiode."""
    titles = ["time_s", *(f"{light}:{one}" for light in (*leds, DARK) for one in recording.photodiodes)]
    columns = np.concatenate([recording.time_s[None], *recording.volts, recording.dark_v])
    lines = [
        ",".join([repr(float(time_s)), *("" if np.isnan(x) else f"{x:.9g}" for x in volts)])
        for time_s, *volts in columns.T
    ]
    return "\n".join([",".join(titles), *lines]) + "\n"
