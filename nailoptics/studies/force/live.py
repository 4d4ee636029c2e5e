"""Force from readings that come line by line: each line is answered before the next is read."""

import csv
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...scene.importers.sensor_recordings import MOST_VOLTS, SATURATED, check_header, check_known, reading_columns
from .kalman import KalmanFilter, PressureEstimate
from .predict import CSV_COLUMNS, csv_row
from .subject import Subject
from .uncertainty import ForceEstimate

Array = NDArray[np.float64]

NAME = "stdin"


def live(subject: Subject, lines: Iterable[str]) -> Iterator[str]:
    """The lines of predict.csv for lines of a recording that come one by one: each is answered before the next is read.

    Empty lines and comments (#) are skipped; a last line that ends in its midst, as of a sensor that was unplugged, is
    left out.

    Raises: InputError for a header that lacks a reading, or a line that is none.
    """
    given = _counted(lines)
    number, first = next(given, (1, ""))
    header = [cell.strip() for cell in _cells(first.removeprefix("\ufeff"), number)]
    check_header(header, NAME)
    names = subject.table.names
    check_known(reading_columns(header), names, NAME)
    places = [header.index(name) for name in ("time_s", *names)]
    yield ",".join(CSV_COLUMNS)
    for time_s, force, estimate in _estimates(subject, _samples(given, places)):
        share = (force.share[0], force.share_low[0], force.share_high[0])
        yield csv_row(time_s, force.force_n[0], force.low_n[0], force.high_n[0], *share, estimate.outlier)


def _counted(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Lines that say something, with their numbers from 1."""
    for number, line in enumerate(lines, start=1):
        if line.strip() and not line.lstrip("\ufeff").lstrip().startswith("#"):
            yield number, line


def _samples(given: Iterable[tuple[int, str]], places: list[int]) -> Iterator[tuple[float, Array]]:
    for number, line in given:
        cells = _cells(line, number)
        if len(cells) <= max(places) and not line.endswith("\n"):
            return
        yield _sample(cells, places, f"{NAME} line {number}: {line.strip()[:60]!r}")


def _cells(line: str, number: int) -> list[str]:
    try:
        return next(csv.reader([line.rstrip("\r\n")]), [])
    except csv.Error:
        raise InputError(f"{NAME} line {number}: is no line of a CSV.") from None


def _sample(cells: list[str], places: list[int], shown: str) -> tuple[float, Array]:
    """Time and volts of a line; empty cells are gaps."""
    try:
        values = np.array([float(cells[place].strip() or "nan") for place in places])
    except (ValueError, IndexError):
        raise InputError(f"{shown} holds no number where one belongs.") from None
    named = [cells[place].strip().lower() for place in places]
    if not np.isfinite(values[0]) or np.isinf(values).any() or "nan" in named:
        raise InputError(f"{shown} needs a time and finite volts; an empty cell is a gap.")
    if np.nanmax(np.abs(values[1:]), initial=0.0) > MOST_VOLTS:
        raise InputError(f"{shown} looks like a converter's counts; convert it to volts.")
    return float(values[0]), values[1:]


def _estimates(
    subject: Subject, samples: Iterable[tuple[float, Array]]
) -> Iterator[tuple[float, ForceEstimate, PressureEstimate]]:
    kalman, last = KalmanFilter(subject.sensor, subject.noise), None
    interval = subject.force_interval()
    for time_s, volts in samples:
        if last is not None and time_s <= last:
            raise InputError(f"{NAME}: time_s = {time_s:.15g} does not come after {last:.15g}; times must rise.")
        # A converter at its limit holds no information.
        valid_v = np.where(volts >= SATURATED * subject.table.range_v, np.nan, volts)
        estimate = kalman.update_sample(valid_v, None if last is None else time_s - last)
        last = time_s
        yield time_s, interval.of([estimate]), estimate
