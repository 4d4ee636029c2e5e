"""Recordings as CSV files: of a touch or a pressure that a scene names, of a worn sensor in volts, of an oximeter."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...checks import Array
from ...errors import InputError
from ...io import write_text
from ..base import ARTERIAL_PA, LEAST_AREA_MM2, MOST_FORCE_N, VENOUS_PA
from ..electronics import DARK
from ..text_files import Rows, number_columns, parse_toml, read_rows, read_text

PRESSURES = ("proximal_pressure_pa", "distal_pressure_pa")
# Clocks count from some date; beyond this, steps of milliseconds are lost in their digits. [s]
MOST_TIME_S = 1e10
# What a column may hold, and its unit. A touch presses with less than 100 N/cm^2.
RANGES: dict[str, tuple[float, float, str]] = {
    "time_s": (-MOST_TIME_S, MOST_TIME_S, "s"),
    "force_n": (0.0, MOST_FORCE_N, "N"),
    "shear_n": (-100.0, 100.0, "N"),
    **dict.fromkeys(PRESSURES, (0.0, 1e6, "Pa")),
    "contact_area_mm2": (LEAST_AREA_MM2, 1e3, "mm^2"),
    "proximal_share": (0.0, 1.0, "(a part)"),
    "arterial_pressure_pa": (*ARTERIAL_PA, "Pa"),
    "venous_pressure_pa": (*VENOUS_PA, "Pa"),
    "hand_height_m": (-1.0, 1.0, "m"),
    **{f"{light} light": (0.0, np.inf, "counts") for light in ("red", "infrared", "ambient")},
}
IN_NEWTONS = "give it in newtons: divide millinewtons by 1000, grams-force by 102"
# A load cell that nothing presses reads a little on either side of zero: so far below it counts as none. [N]
UNLOADED_N = 0.05
SITES = {"proximal": 1.0, "distal": 0.0, "even": np.nan}
# What messages call lines that come one by one.
STDIN = "stdin"
# Millivolts and a converter's counts lie far above any voltage of a photodiode's stage.
MOST_VOLTS = 50.0
NOT_VOLTS = "looks like millivolts or a converter's counts; convert it to volts"
# Samples lie so far apart, usually: less is not a time in seconds, and from 0.1 on the force's filter diverges. [s]
LEAST_STEP_S, MOST_STEP_S = 1e-5, 0.08


def with_recording(
    data: dict[str, Any], folder: Path | None, name: str, known: Sequence[str], *, either: Sequence[Sequence[str]]
) -> dict[str, Any]:
    """A table with the columns of the file that it names, if it does, time_s among them; raises InputError.

    name : the table's, for messages.
    known : columns that are read where they are there. either : sets of columns of which one must be whole.
    """
    if not isinstance(data.get("file"), str) or "recorded_time_s" in data:
        return data
    path = Path(folder or Path()) / data["file"]
    shown = f"{name}.file {str(path)!r}"
    rows = read_rows(path, f"a CSV with columns time_s,{','.join(either[0])}", shown=shown)
    header = [cell.strip() for cell in next(rows, (0, []))[1]]
    if "time_s" not in header or not any(set(names) <= set(header) for names in either):
        needed = ", or ".join(" and ".join(["time_s", *names]) for names in either)
        raise InputError(f"{shown} needs a header with {needed}; write one, or give another file.")
    titles = ["time_s", *(title for title in known if title in header)]
    columns = _numbers(rows, header, titles, shown, gaps=False)
    return data | {f"recorded_{title}": tuple(column.tolist()) for title, column in columns.items()}


def _numbers(rows: Rows, header: Sequence[str], titles: Sequence[str], name: str, **how: Any) -> dict[str, Array]:
    """Columns (T,) by title as numbers that are possible, as `number_columns` reads them."""
    line, columns = number_columns(rows, {title: header.index(title) for title in titles}, name, **how)
    if "force_n" in columns:
        force_n = columns["force_n"]
        columns["force_n"] = np.where((force_n < 0.0) & (force_n >= -UNLOADED_N), 0.0, force_n)
    check_columns(columns, name, line)
    return columns


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
        # What is too large says more of a wrong unit than noise about 0 does.
        for k in [*np.flatnonzero(values > high)[:1], *np.flatnonzero(values < low)[:1]][:1]:
            hint = IN_NEWTONS if title == "force_n" and values[k] > high else "check its sign and unit"
            raise InputError(f"{at(k)} {title} = {values[k]:g} must lie in {low:g} to {high:g} {unit}; {hint}.")


@dataclass(frozen=True, repr=False)
class Recording:
    """Readings over time.

    name : what messages call it.
    names : (R,) str, of the readings.
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

    def __repr__(self) -> str:
        samples = f"{len(self.time_s)} samples in {np.ptp(self.time_s):.4g} s"
        return f"<Recording {self.name}: {len(self.names)} readings, {samples}>"

    def with_readings(self, names: Sequence[str]) -> "Recording":
        """The recording with its readings in this order; raises InputError for others, other units and slow ones."""
        check_known(self.names, names, self.name)
        order = [self.names.index(name) for name in names]
        check_volts(self.volts, self.names, self.name)
        check_rate(self.time_s, self.name)
        return replace(self, names=tuple(names), volts=self.volts[order])

    def select(self, samples: slice | NDArray[Any]) -> "Recording":
        """The recording of some of the samples."""
        force_n, site = (None if one is None else one[samples] for one in (self.force_n, self.site))
        return replace(self, time_s=self.time_s[samples], volts=self.volts[:, samples], force_n=force_n, site=site)

    def save(self, path: str | Path) -> None:
        """Write the recording as a CSV, which `calibrate` and `predict` read; raises WriteError."""
        write_text(Path(path), recording_csv(self))


def read_sensor_recording(path: str | Path) -> Recording:
    """Read a recording: columns time_s, readings in volts, and, where known, force_n, site and both pressures.

    Raises: InputError that names the column, the line, the value and what to do.
    """
    name, header, rows = _table(
        path, "a recording: a CSV with columns time_s, force_n and one for each reading in volts"
    )
    check_header(header, name)
    readings = reading_columns(header)
    titles = ["time_s", *(title for title in ("force_n", "site") if title in header), *readings]
    columns = _numbers(rows, header, titles, name, codes={"site": SITES})
    volts = np.array([columns[title] for title in readings])
    return Recording(name, readings, columns["time_s"], volts, columns.get("force_n"), columns.get("site"))


def _table(
    path: str | Path, expected: str, *, starts: Callable[[list[str]], bool] | None = None
) -> tuple[str, list[str], Rows]:
    """Name of a file for messages, its header, and its rows; raises InputError at one with more cells than columns.

    starts : whether a row is a header that may lie below lines of settings; else it is the first.
    """
    name, rows = str(path), read_rows(path, expected)
    if name.endswith(".toml"):
        parse_toml(read_text(path, expected), name, "recording")
    first = list(islice(rows, PREAMBLE_LINES)) or [(0, [""])]
    place = next((k for k, (_, row) in enumerate(first) if starts is not None and starts(row)), 0)
    rows, header = chain(first[place + 1 :], rows), [cell.strip() for cell in first[place][1]]
    # Spreadsheets end lines with commas.
    while header and not header[-1]:
        header.pop()

    def checked() -> Rows:
        for line, row in rows:
            if any(cell.strip() for cell in row[len(header) :]):
                why = "write numbers with a decimal point."
                raise InputError(f"{name} line {line}: has {len(row)} cells for {len(header)} columns; {why}")
            yield line, row

    return name, header, checked()


def reading_columns(header: Sequence[str]) -> tuple[str, ...]:
    """The columns that hold readings."""
    return tuple(title for title in header if title not in ("time_s", "force_n", "site", *PRESSURES))


def check_header(header: Sequence[str], name: str) -> None:
    """Raise InputError unless there is time, at least one reading, no column without a title, and no title twice."""
    twice = next((title for title in header if header.count(title) > 1), None)
    for wrong, why in (
        (not any(header), "is empty; give a CSV with time_s and the readings in volts"),
        ("\ufffd" in "".join(header), "is not text; give a CSV with time_s and the readings in volts"),
        (";" in "".join(header[:1]), "has semicolons between columns; write commas, and numbers with a decimal point"),
        ("time_s" not in header, f"has no column time_s (it has {', '.join(header)[:80]}); add the times in seconds"),
        ("" in header, f"column {[*header, ''].index('') + 1} has no title; name it or leave it out"),
        (twice is not None, f"column {twice!r} is there twice; rename one"),
        (not reading_columns(header), "has no reading; add a column of volts for each photodiode"),
    ):
        if wrong:
            raise InputError(f"{name}: {why}.")


def check_known(titles: Sequence[str], names: Sequence[str], label: str) -> None:
    """Raise InputError unless the readings of a recording are just those of a board."""
    missing, unknown = [n for n in names if n not in titles], [n for n in titles if n not in names]
    if missing:
        why = f"this board's readings are {', '.join(names)}; give a recording of their volts, or take its own board."
        raise InputError(f"{label}: has no column {missing[0]!r}; {why}")
    if unknown:
        why = "rename it or leave it out."
        raise InputError(f"{label}: column {unknown[0]!r} is not a reading of this board ({', '.join(names)}); {why}")


def check_rate(time_s: ArrayLike, label: str) -> None:
    """Raise InputError for times [s] that usually lie too far apart to follow a touch."""
    step_s = float(np.median(np.diff(time_s)))
    if not LEAST_STEP_S <= step_s <= MOST_STEP_S + 1e-6:
        why = f"record at {1 / MOST_STEP_S:g} to {1 / LEAST_STEP_S:g} Hz, with times in seconds."
        raise InputError(f"{label}: time_s rises in steps of {step_s:g} ({1 / step_s:.3g} Hz); {why}")


def check_volts(volts: Array, names: Sequence[str], label: str) -> None:
    """Raise InputError for readings that are constant, empty, of the wrong sign, or counts of a converter."""
    for title, values in zip(names, volts, strict=True):
        known = values[np.isfinite(values)]
        if not known.size:
            raise InputError(f"{label}: column {title!r} is empty; record it.")
        if np.abs(known).max() > MOST_VOLTS:
            raise InputError(f"{label}: column {title!r} reaches {np.abs(known).max():g} V, which {NOT_VOLTS}.")
        if known.size > 2 and np.ptp(known) == 0:
            why = "check its wiring, or lower the LED's power if the converter ends there."
            raise InputError(f"{label}: column {title!r} is constant at {known[0]:g} V; {why}")
        if np.median(known) < 0.0:
            raise InputError(f"{label}: column {title!r} is mostly below 0 V; change its sign.")


def samples_by_line(lines: Iterable[str], titles: Callable[[list[str]], Sequence[str]]) -> Iterator[dict[str, float]]:
    """Samples of a recording's lines that come one by one, by title: each is given before the next line is read.

    Empty lines, comments (#) and a last line that ends in its midst, as of a sensor that was unplugged, are left out.

    titles : what is read, of the header, which is read at once. Raises: InputError for a line that is not a sample.
    """
    rows = (
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip("\ufeff").lstrip().startswith("#")
    )
    _, first = next(rows, (1, ""))
    header = [cell.strip() for cell in _cells(first.removeprefix("\ufeff"))]
    columns = {title: header.index(title) for title in titles(header)}

    def samples() -> Iterator[dict[str, float]]:
        for number, line in rows:
            cells = _cells(line)
            if len(cells) <= max(columns.values()) and not line.endswith("\n"):
                return
            _, sample = number_columns(iter([(number, cells)]), columns, STDIN)
            yield {title: float(column[0]) for title, column in sample.items()}

    return samples()


def _cells(line: str) -> list[str]:
    return next(csv.reader([line.replace("\r", "")]), [])


def recording_csv(recording: Recording) -> str:
    """A recording as the text of its file."""
    named = {value: name for name, value in SITES.items() if np.isfinite(value)}
    columns: dict[str, list[str]] = {"time_s": [repr(time_s) for time_s in recording.time_s.tolist()]}
    if recording.force_n is not None:
        columns["force_n"] = _written(recording.force_n, 6)
    if recording.site is not None:
        columns["site"] = [named.get(site, "even") for site in recording.site]
    return _csv(columns | {name: _written(v, 7) for name, v in zip(recording.names, recording.volts, strict=True)})


def _written(values: Array, digits: int) -> list[str]:
    return ["" if np.isnan(x) else f"{x:.{digits}g}" for x in values]


def _csv(columns: Mapping[str, Sequence[str]]) -> str:
    out = StringIO()
    csv.writer(out, lineterminator="\n").writerows([[*columns], *zip(*columns.values(), strict=True)])
    return out.getvalue()


@dataclass(frozen=True)
class OximeterRecording:
    """Both LEDs' readings over time, at the times of the red ones.

    name : what messages call it. photodiodes : (P,) str.
    time_s : (T,) float, rising. [s]
    volts : (2, P, T) float. Of the red and the infrared LED as they were read, dark light included; NaN in a gap. [V]
    dark_v : (P, T) float. With no LED lit; 0 where that was not read. [V]
    counts : whether volts are counts of an unknown converter instead.
    """

    name: str
    photodiodes: tuple[str, ...]
    time_s: Array
    volts: Array
    dark_v: Array
    counts: bool = False


OXIMETER_CSV = "a CSV with time_s and LED:PHOTODIODE columns"
# Columns of oximeter modules' recordings, in lower case; LEDC1 to 3 are those of the MAX86161's evaluation kit.
MODULE_COLUMNS = {"red": ("red", "ledc2"), "infrared": ("infrared", "ir", "ledc1"), "ambient": ("ambient", "ledc3")}
# Such files may have so many lines of settings before their header.
PREAMBLE_LINES = 40


def read_oximeter_recording(
    path: str | Path,
    *,
    leds: tuple[str, str],
    photodiodes: Sequence[str],
    delays_s: Mapping[str, float],
    frame_hz: float,
) -> OximeterRecording:
    """Read a recording that has a column for each LED and photodiode, or that of a module.

    leds : names of the red and the infrared LED.
    photodiodes : names of the board's; the recording may hold fewer, a module's holds the first.
    frame_hz : samples in a second of a module's recording without times. [Hz]
    delays_s : how much later than the red slot each light's slot is. [s]

    Raises: InputError that names the column, the line, the value and what to do.
    """
    name, header, rows = _table(path, f"an oximeter's recording: {OXIMETER_CSV}", starts=_is_module)
    if _is_module(header):
        return _read_module(name, header, rows, photodiodes[0], frame_hz)
    check_header(header, name)
    there = tuple(name for name in photodiodes if any(f"{led}:{name}" in header for led in leds))
    if not there:
        example = f"{leds[0]}:{photodiodes[0]}"
        raise InputError(f"{name}: has no column such as {example!r} of this scene; give {OXIMETER_CSV}.")
    titles = {light: [f"{light}:{photodiode}" for photodiode in there] for light in (*leds, DARK)}
    if not any(title in header for title in titles[DARK]):
        del titles[DARK]
    numbers = ["time_s", *(title for of_light in titles.values() for title in of_light)]
    for missing in (title for title in numbers if title not in header):
        raise InputError(f"{name}: has no column {missing!r}; an oximeter needs both LEDs on each photodiode.")
    columns = _numbers(rows, header, numbers, name)
    # Everything at the times of the red readings, which are a few milliseconds from the others.
    start_s, red = columns["time_s"], np.array([columns[title] for title in titles[leds[0]]])
    time_s = start_s + delays_s.get(leds[0], 0.0)
    infrared, *dark = (
        np.array([np.interp(time_s, start_s + delays_s.get(light, 0.0), columns[title]) for title in of_light])
        for light, of_light in titles.items()
        if light != leds[0]
    )
    for kind, volts in (("red", red), ("infrared", infrared)):
        check_volts(volts, [f"{kind}:{photodiode}" for photodiode in there], name)
    dark_v = dark[0] if dark else np.zeros_like(red)
    return OximeterRecording(name, there, time_s, np.stack([red, infrared]), dark_v)


def _is_module(header: Sequence[str]) -> bool:
    """Whether a row is the header of a module's recording."""
    titles = {title.strip().lower() for title in header}
    words = not any(title[:1] in "0123456789-+." for title in titles if title)
    return words and any(titles & {*MODULE_COLUMNS[light]} for light in ("red", "infrared"))


def _read_module(name: str, header: Sequence[str], rows: Rows, photodiode: str, frame_hz: float) -> OximeterRecording:
    """A module's recording: counts of red, infrared and perhaps ambient light over time_s, timestamp [ms] or frames."""
    titles = [title.lower() for title in header]
    clock = next((title for title in ("time_s", "timestamp") if title in titles), None)
    known = [(light, title) for light, names in MODULE_COLUMNS.items() for title in reversed(names)]
    columns = {light: titles.index(title) for light, title in known if title in titles}
    for light in {"red", "infrared"} - columns.keys():
        needed = f"name one {' or '.join(MODULE_COLUMNS[light])} (an oximeter needs both)"
        raise InputError(f"{name}: has no column of {light} light; {needed}.")
    clocks = {"time_s": titles.index(clock)} if clock else {}
    # The evaluation kit ends with the time at which it stopped.
    samples = takewhile(lambda row: row[1][0].strip().lower() != "stop time", rows)
    line, read = number_columns(samples, clocks | columns, name)
    time_s = read["time_s"] if clock else np.arange(len(line)) / frame_hz
    time_s = 1e-3 * (time_s - time_s[:1]) if clock == "timestamp" else time_s
    check_columns({"time_s": time_s} | {f"{light} light": read[light] for light in columns}, name, line)
    volts = np.array([[read["red"]], [read["infrared"]]])
    dark = read["ambient"][None] if "ambient" in read else np.zeros((1, len(line)))
    return OximeterRecording(name, (photodiode,), time_s, volts, dark, counts=True)


def oximeter_csv(recording: OximeterRecording, leds: tuple[str, str]) -> str:
    """A recording as the text of its file, a column for each LED, and the dark slot, on each photodiode."""
    titles = [f"{light}:{photodiode}" for light in (*leds, DARK) for photodiode in recording.photodiodes]
    volts = (_written(column, 9) for column in (*recording.volts[0], *recording.volts[1], *recording.dark_v))
    times = {"time_s": [repr(time_s) for time_s in recording.time_s.tolist()]}
    return _csv(times | dict(zip(titles, volts, strict=True)))
