"""Text files that people wrote, read whole, as rows of a CSV or as tables of TOML, with errors in the user's words."""

import csv
import math
import tomllib
from pathlib import Path
from typing import Any

from ..errors import InputError


def read_text(path: Path, wanted: str, *, shown: str | None = None, any_encoding: bool = False) -> str:
    """The text of a file, with or without a byte order mark, which some editors and spreadsheets write.

    wanted : what to give instead, for the message, such as "a position file".
    shown : how the message names the file; its path if not given.
    any_encoding : whether it may be UTF-16 or Windows' own text, too, as other programs write it.

    Raises: InputError.
    """
    try:
        return decoded(path.read_bytes()) if any_encoding else path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{shown or path}: cannot be read: {error.strerror}; give {wanted}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{shown or path}: is not a text file; give {wanted}.") from None


def decoded(data: bytes) -> str:
    """The text that bytes are, in UTF-16 if they begin so, else in UTF-8, else in Windows' own; UnicodeDecodeError."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def read_rows(path: Path, wanted: str, *, shown: str | None = None) -> list[tuple[int, list[str]]]:
    """Rows of a CSV with their line numbers, without empty lines and comments; raises InputError as `read_text`."""
    reader = csv.reader(read_text(path, wanted, shown=shown).splitlines())
    try:
        numbered = [(reader.line_num, row) for row in reader]
    except csv.Error:
        raise InputError(f"{shown or path}: is not a text file; give {wanted}.") from None
    return [(n, row) for n, row in numbered if any(cell.strip() for cell in row) and row[0].lstrip()[:1] != "#"]


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """TOML's tables, with tuples for its arrays, which is what frozen models hold; raises InputError."""
    try:
        return {key: frozen(value) for key, value in tomllib.loads(text).items()}
    except tomllib.TOMLDecodeError as error:
        raise InputError(one_line(f"{name}: is not valid TOML: {error}.")) from None
    except RecursionError:
        raise InputError(f"{name}: is not valid TOML: its tables or arrays are nested too deep.") from None


def frozen(data: Any) -> Any:
    """The same tables with tuples for lists."""
    if isinstance(data, dict):
        return {key: frozen(value) for key, value in data.items()}
    return tuple(frozen(item) for item in data) if isinstance(data, list) else data


def finite_number(text: str, name: str, where: str) -> float:
    """The number that a text is; raises InputError."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} = {text!r} is not a number.")
    return value


def one_line(text: str) -> str:
    """A message without line breaks."""
    return " ".join(text.splitlines())
