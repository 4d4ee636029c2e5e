"""Text files that people wrote, read whole, as rows of a CSV or as tables of TOML, with errors in the user's words."""

import csv
import math
import re
import stat
import tomllib
from array import array
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..assets import read_toml
from ..errors import InputError

# A recording of a million samples has a tenth of it. [bytes]
MOST_BYTES = 500e6
# What tells a recording from TOML.
RECORDING = re.compile(r"(?:[ \t]*(?:#[^\n]*)?\n)*[^#=\n]*\btime_s\b[^=\n]*,")
# Of a whole number; Python writes none that is much longer.
MOST_BITS = 8192
# Rows of a table, each with its line number.
Rows = Iterator[tuple[int, list[str]]]


def read_text(path: str | Path, expected: str, *, shown: str | None = None, any_encoding: bool = False) -> str:
    """The text of a file, with or without a byte order mark, which editors write; raises InputError.

    expected : what to give instead, for the message, such as "a position file".
    shown : how the message names the file; its path if not given.
    any_encoding : whether it may be UTF-16 or Windows' own text, too, as other programs write it.
    """
    with _reading(path, expected, shown or str(path)):
        data = Path(path).read_bytes()
        if not any_encoding:
            text = data.decode("utf-8-sig")
        elif data[:2] in (b"\xff\xfe", b"\xfe\xff"):
            text = data.decode("utf-16")
        else:
            try:
                text = data.decode("utf-8-sig")
            except UnicodeDecodeError:
                text = data.decode("cp1252")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_bytes(path: Path, expected: str) -> bytes:
    """All that is in an ordinary file of bounded size; arguments as for `read_text`. Raises: InputError."""
    with _reading(path, expected, str(path)):
        return path.read_bytes()


@contextmanager
def _reading(path: str | Path, expected: str, name: str) -> Iterator[None]:
    """InputError where the path is not an ordinary file of bounded size, cannot be read, or holds no text."""
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
            # A pipe would be waited for without end.
            raise InputError(f"{name}: is not an ordinary file; give {expected}.")
        if status.st_size > MOST_BYTES:
            raise InputError(f"{name}: has {status.st_size / 1e6:.0f} MB, more than {MOST_BYTES / 1e6:g}; shorten it.")
        yield
    except OSError as error:
        raise InputError(f"{short(name)}: cannot be read: {error.strerror}; give {expected}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{name}: is not a text file; give {expected}.") from None
    except (TypeError, ValueError):  # no path at all, or with a character that none may have
        raise InputError(f"{short(repr(name))}: is not a path; give {expected}.") from None


def is_there(path: Path) -> bool:
    """Whether there is such a file; not where the path cannot be one, because a name is too long or holds no text."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_rows(path: str | Path, expected: str, *, shown: str | None = None) -> Rows:
    """Rows of a CSV with their line numbers, one at a time, without empty lines and comments; raises InputError."""
    name = shown or str(path)
    with _reading(path, expected, name), Path(path).open(encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        try:
            for row in reader:
                if any(cell.strip() for cell in row) and row[0].lstrip()[:1] != "#":
                    yield reader.line_num, row
        except csv.Error as error:
            raise InputError(f"{name} line {reader.line_num}: is not a line of a table ({error}).") from None


def number_columns(
    rows: Rows,
    columns: Mapping[str, int],
    name: str,
    *,
    codes: Mapping[str, Mapping[str, float]] | None = None,
    gaps: bool = True,
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Line numbers (T,) of rows, and their columns (T,) as numbers, NaN where a cell is empty; time_s has none empty.

    columns : the position of each column in a row. codes : the numbers of words, for columns that hold words.
    gaps : whether cells may be empty. Raises: InputError for a cell that is neither.
    """
    lines, numbers, words = array("q"), array("d"), codes or {}
    for line, row in rows:
        lines.append(line)
        for title, position in columns.items():
            text = row[position].strip() if position < len(row) else ""
            if title in words:
                if text not in words[title]:
                    known = ", ".join(words[title])
                    raise InputError(f"{name} line {line}: {title} = {text[:40]!r} is unknown; choose from {known}.")
                numbers.append(words[title][text])
            elif not text and gaps and title != "time_s":
                numbers.append(math.nan)
            else:
                hint = "an empty cell is a gap" if gaps and title != "time_s" else "every row needs one"
                try:
                    value = float(text)
                except ValueError:
                    value = math.nan
                if not math.isfinite(value):
                    raise InputError(f"{name} line {line}: {title} = {text[:40]!r} is not a finite number; {hint}.")
                numbers.append(value)
    table = np.array(numbers).reshape(-1, len(columns)).T.copy()
    return np.array(lines), dict(zip(columns, table, strict=True))


def parse_toml(text: str, name: str, wanted: str = "") -> dict[str, Any]:
    """TOML's tables, with tuples for its arrays, which is what frozen models hold; raises InputError, also for another
    kind of file than is wanted, of assets/file_kinds.toml."""
    if not isinstance(text, str):
        raise InputError(f"{name}: {short(repr(text))} is not text; give TOML, as a file has it.")
    try:
        read = {"time_s": ()} if wanted and RECORDING.match(text) else tomllib.loads(text)
        tables = {key: frozen(value) for key, value in read.items()}
    except ValueError as error:
        digits = "a number has thousands of digits; shorten it"
        why = digits if "int_max_str_digits" in str(error) else str(error)
        raise InputError(short(f"{name}: is not valid TOML: {why}", 300) + ".") from None
    except RecursionError:
        raise InputError(f"{name}: is not valid TOML: its tables or arrays are nested too deep.") from None
    for kind, about in read_toml("file_kinds.toml").items() if wanted else ():
        if tables.keys() & about["keys"]:
            if kind != wanted:
                raise InputError(f"{name}: is {about['is']}; give a {wanted} here.")
            break
    return tables


def frozen(data: Any) -> Any:
    """Tables of a file with tuples for lists and arrays, as frozen models hold; raises ValueError."""
    if isinstance(data, dict):
        return {key: frozen(value) for key, value in data.items()}
    if isinstance(data, np.ndarray | np.generic):
        data = data.tolist()
    if isinstance(data, int) and data.bit_length() > MOST_BITS:
        raise ValueError("it holds a number of thousands of digits")
    return tuple(frozen(item) for item in data) if isinstance(data, list | tuple) else data


def short(text: str, most: int = 120) -> str:
    """A text, or its beginning where it is too long for a message."""
    return text if len(text) <= most else text[: most - 3] + "..."
