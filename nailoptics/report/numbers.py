"""Numbers for people, rounded to their uncertainty, in a prefix of the unit that suits them; and for summaries."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..variables import unit_of

_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# What a terminal without Unicode lacks.
ASCII = str.maketrans({"±": "+-", "−": "-", "–": "-", "\u00a0": " ", "×": "x", "µ": "u", "∞": "inf"})
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS = "−"
TINY = 1e-290  # what is less has no power of ten to divide by
ROUNDING = 1e-9  # of a number: what sums of millions of double-precision numbers may leave


def prefix(magnitude: float, *, digits: int = 3) -> tuple[float, str]:
    """Scale and prefix in which a magnitude reads as 1 to 1000: 0.0123 V is 12.3 with (1e-3, "m").

    digits : Significant digits that will be shown: 0.9996 V to three of them is 1.00 V, not 1000 mV.
    """
    if not math.isfinite(magnitude) or abs(magnitude) < TINY:
        return 1.0, ""
    power = min(max(3 * (_power(magnitude, digits) // 3), -12), 9)
    return 10.0**power, _PREFIXES[power]


def _power(value: float, digits: int) -> int:
    """The power of ten of a number once it is rounded to so many digits: 0 of 0.9996 to three of them."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def fixed(value: float, decimals: int, *, sign: bool = False) -> str:
    """A number with so many decimals and a real minus sign; 0 is shown without a sign."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else ("∞" if value > 0 else MINUS + "∞")
    rounded = round(value, decimals)
    text = f"{abs(rounded):.{max(decimals, 0)}f}"
    return (MINUS if rounded < 0 else "+" if sign and rounded > 0 else "") + text


def significant(value: float, digits: int = 3, *, sign: bool = False) -> str:
    """A number with so many significant digits, in powers of ten where it is far from 1."""
    if not math.isfinite(value) or abs(value) < TINY:
        return fixed(value, 0)
    power = _power(value, digits)
    if -3 <= power < 5:
        return fixed(value, digits - 1 - power, sign=sign)
    return f"{fixed(value / 10.0**power, digits - 1, sign=sign)} × 10{str(power).translate(_SUPERSCRIPT)}"


def with_error(value: float, error: float, *, sign: bool = False, scale: float = 0.0, negligible: float = 1e-6) -> str:
    """Value ± standard error, both rounded to two digits of the error; powers of ten where needed.

    An error that is not known is shown as "± ?"; one below a negligible fraction of the value is left out.

    scale : Size of what the value is a difference or a part of, beside which rounding is 0.
    """
    if not math.isfinite(value):
        return "–"
    if abs(value) <= ROUNDING * scale and (error <= ROUNDING * scale or error == math.inf):
        return "0"
    if error <= max(TINY, negligible * abs(value)):
        return significant(value, 4, sign=sign)
    if not math.isfinite(error):
        return f"{significant(value, 3, sign=sign)} ± ?"
    power = math.floor(math.log10(max(abs(value), error)))
    scale, tail = (1.0, "") if -3 <= power < 5 else (10.0**power, f" × 10{str(power).translate(_SUPERSCRIPT)}")
    decimals = min(max(1 - math.floor(math.log10(error / scale)), 0), 9)
    text = f"{fixed(value / scale, decimals, sign=sign)} ± {fixed(error / scale, decimals)}"
    return f"({text}){tail}" if tail else text


def estimated(record: Any, name: str, scale: float = 1.0, **how: Any) -> str:
    """An estimate of a dataset or a record, times a scale, ± its standard error, as `with_error` writes them."""
    return with_error(*(scale * float(record[f"{name}{end}"]) for end in ("", "_stderr")), **how)


def cells(record: Any, columns: Mapping[str, tuple[str, float, int]], of: Any = estimated) -> dict[str, str]:
    """Cells of a row of a table, from a dataset or a record.

    columns : by their heads, name, scale and significant digits of each; with 0 digits, `of` it.
    """
    return {
        head: significant(scale * float(record[name]), digits) if digits else of(record, name, scale)
        for head, (name, scale, digits) in columns.items()
    }


def plain(data: Any, *names: str, **renamed: str) -> dict[str, Any]:
    """Variables of a dataset as plain numbers, texts and lists of them, by their names or, renamed, by a key."""
    return {key: data[name].values.tolist() for key, name in ({name: name for name in names} | renamed).items()}


def with_stderr(data: Any, name: str) -> dict[str, Any]:
    """An estimate of a dataset as a summary has it."""
    return plain(data, value=name, stderr=f"{name}_stderr")


def range_of(field: str, low: float, high: float) -> str:
    """The range of a field, with its unit: "0.4 to 0.6 mm"."""
    unit = unit_of(field)
    return f"{significant(low)} to {significant(high)}{'' if unit == '1' else f' {unit}'}"


def polynomial(coefficients: Iterable[float]) -> str:
    """A polynomial in R from its constant on, as it is written: "110.9 − 32.77 R + 0.9527 R²"."""
    text = ""
    for power, value in enumerate(map(float, coefficients)):
        letter = ("", " R")[power > 0] + (str(power).translate(_SUPERSCRIPT) if power > 1 else "")
        sign = f" {MINUS if value < 0 else '+'} " if power else ""
        text += f"{sign}{significant(abs(value) if power else value, 4)}{letter}"
    return text


def quantity(value: float, unit: str, *, digits: int = 3, sign: bool = False) -> str:
    """A number with unit and prefix, not to be parted at a line's end: 0.0123, "V" is "12.3 mV"."""
    if not math.isfinite(value):
        return fixed(value, 0)
    scale, letter = prefix(value, digits=digits)
    return f"{significant(value / scale, digits, sign=sign)}\u00a0{letter}{unit}"


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    units = (("h", 3600.0, 5400.0), ("min", 60.0, 90.0), ("s", 1.0, 1.0), ("ms", 1e-3, 1e-3), ("us", 1e-6, 0.0))
    name, size = next((unit, size) for unit, size, least in units if seconds >= least)
    return f"{seconds / size:.{0 if seconds >= 100 * size else 2}{'f' if seconds >= 100 * size else 'g'}} {name}"


def aligned(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Lines of a table of records for the terminal, in ASCII but for names; columns of numbers end at the right."""
    cells = [[str(cell).translate(ASCII) for cell in row] for row in (rows[0], *(row.values() for row in rows))]
    columns = list(zip(*cells, strict=True))
    widths = [max(map(len, column)) for column in columns]
    numeric = [2 * sum(cell[:1] in "-+(<0123456789" for cell in column[1:]) > len(column) for column in columns]
    lines = []
    for row in cells:
        padded = zip(row, widths, numeric, strict=True)
        lines.append("  ".join(cell.rjust(w) if right else cell.ljust(w) for cell, w, right in padded).rstrip())
    return lines
