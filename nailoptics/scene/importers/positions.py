"""Position files for pick and place: KiCad's CSV and .pos, and those of assemblers, as they come."""

import csv
import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...assets import read_toml
from ...errors import InputError
from ...io import of_plain_cell, plain_cell, write_text
from ..base import Box
from ..parts import BottomRotation, FileUnit
from ..text_files import read_text, short
from .outlines import FARTHEST_MM

log = logging.getLogger(__name__)

COLUMNS = ("Ref", "Val", "Package", "PosX", "PosY", "Rot", "Side")
# Fields of a scene's table that say how its position file is read, as `read_positions` calls them.
READING = {"negate_x_on_bottom", "positions_unit", "rotation_on_bottom"}
LENGTHS = ("PosX", "PosY")
NEEDED = ("Ref", "PosX", "PosY", "Rot")
# How programs call the columns, the best name first, and the sides; units of length. [mm]
KNOWN_AS, SIDES, UNITS_MM = (read_toml("position_files.toml")[name] for name in ("columns", "sides", "units_mm"))
LENGTH = re.compile(r"([-+]?[0-9.,]+(?:e[-+]?[0-9]+)?)\s*([a-z\"]*)", re.IGNORECASE)
# How files of Excel begin, read as text.
SPREADSHEETS = ("PK\x03\x04", "ÐÏ\x11à")


@dataclass(frozen=True)
class PlacedPart:
    """A part on a board, in the file's own coordinates: x to the right, y up, seen from the top. [mm]

    rotation_deg : Against the clock, seen from the top, on either side. [deg]
    pads_middle_mm : Middle of its pads, from its position, before its rotation. [mm]
    body_mm, courtyard_mm, beyond_mm : Boxes around its body and pads, its courtyard, and what it takes of the board's
        other side, likewise; None where its file does not draw them. [mm]
    populated : Whether it is fitted; False of parts marked DNP.
    """

    ref: str
    value: str
    package: str
    position_mm: tuple[float, float]
    rotation_deg: float
    side: str
    pads_middle_mm: tuple[float, float] = (0.0, 0.0)
    body_mm: Box | None = None
    courtyard_mm: Box | None = None
    beyond_mm: Box | None = None
    populated: bool = True

    @property
    def kind(self) -> str:
        """led or photodiode by its reference, such as D1, LED2 or PD1; empty of any other."""
        match = re.fullmatch(r"(D|LED|(PD))[0-9_.-]*", self.ref.upper())
        return "" if match is None else "photodiode" if match[2] else "led"


def read_positions(
    path: Path,
    *,
    negate_x_on_bottom: bool = False,
    positions_unit: FileUnit | None = None,
    rotation_on_bottom: BottomRotation | None = None,
) -> tuple[PlacedPart, ...]:
    """Read a position file, both sides, in the order of the file.

    Columns may be parted by commas, semicolons, tabs or, in a .pos, blanks; lengths are in the unit that stands in the
    cell, in the column's name, or beside the columns, else in the one given. Without a column of the side all lie on
    the top, and a warning says so.

    negate_x_on_bottom : the file has KiCad's "negative X coordinates for footprints on bottom layer": undo that.
    rotation_on_bottom : an assembler's angle on the bottom is 180 degrees less KiCad's.

    Raises: InputError with file, line and what is wrong.
    """
    text = read_text(path, "a position file (CSV or .pos)", any_encoding=True)
    (at, unit_mm), rows = _table(text, path, UNITS_MM[positions_unit or "mm"])
    if "Side" not in at:
        log.warning("%s: no column states the side (Side or Layer); all its parts are read as on the top.", path.name)
    parts: list[PlacedPart] = []
    for number, row in rows:
        where = f"{path} line {number}"
        if len(row) <= max(at.values()):
            raise InputError(f"{where}: has {len(row)} columns, its header more; complete it.")
        cells = {name: row[k].strip() for name, k in at.items()}
        x, y = (_length_mm(cells[name], name, where, unit_mm[name]) for name in ("PosX", "PosY"))
        turn = _length_mm(re.sub(r"\s*(°|deg|degrees)$", "", cells["Rot"], flags=re.IGNORECASE), "Rot", where, 1.0)
        side = SIDES.get(re.sub(r"[^a-z]", "", cells.get("Side", "top").lower()))
        if side is None:
            raise InputError(f'{where}: Side = "{cells["Side"]}"; must be top or bottom.')
        if side == "bottom" and negate_x_on_bottom:
            x = -x
        if side == "bottom" and rotation_on_bottom == "assembler":
            turn = (180.0 - turn) % 360.0
        ref, value, package = (of_plain_cell(cells.get(name, "")) for name in ("Ref", "Val", "Package"))
        parts.append(PlacedPart(ref, value, package, (x, y), turn, side))
    if not parts:
        raise InputError(f"{path}: contains no parts; export the positions of both sides.")
    return tuple(parts)


def warn_of_bottom(
    table: Mapping[str, Any],
    parts: Sequence[PlacedPart],
    used: Sequence[PlacedPart],
    oblique: Sequence[PlacedPart] = (),
    text: str = "",
) -> None:
    """Say in a line each how X and angles of the bottom side are read, where the scene does not say it and it matters.

    table : of the scene, that names the file. parts, used : all of the file as they stand, and those that count.
    oblique : those that do not look the same at 180 degrees less their angle. text : of the file.
    """
    top, bottom = ([part.position_mm[0] for part in parts if part.side == side] for side in ("top", "bottom"))

    def share_room(bottom: Sequence[float]) -> bool:
        # On one board the sides overlap; of one side alone some X is positive, as on KiCad's page.
        return min(top) < max(bottom) and min(bottom) < max(top) if top else max(bottom) > 0

    if "negate_x_on_bottom" not in table and any(part.side == "bottom" for part in used):
        as_it_stands, negated = share_room(bottom), share_room([-x for x in bottom])
        if negated or not as_it_stands:
            why = "may be negated" if as_it_stands or not negated else "looks negated, as KiCad may write it"
            how = "add negate_x_on_bottom = true if it is, or the layout is mirrored; false if it is not."
            log.warning("%s: X on the bottom %s, and is read as it stands: %s", table["positions"], why, how)
    refs = [part.ref for part in oblique if part.side == "bottom"]
    if refs and not table.get("rotation_on_bottom"):
        by_assembler = re.search(r"designator\W.*mid\s*x", text, re.IGNORECASE)
        why = "its header is that of an assembler" if by_assembler else "assemblers write it otherwise"
        read = f"the rotation of {', '.join(refs)} on the bottom is read as KiCad writes it, but {why}"
        how = 'set rotation_on_bottom to "assembler" (180 degrees less the angle) or "kicad".'
        log.warning("%s: %s: %s", table["positions"], read, how)


def _table(
    text: str, path: Path, usual_mm: float
) -> tuple[tuple[dict[str, int], dict[str, float]], list[tuple[int, list[str]]]]:
    """The columns, each with its unit, and the numbered rows below them."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        usual_mm = _stated_unit(line) or usual_mm
        for separator in (",", ";", "\t", " "):
            header = _cells(line.lstrip("# ") if separator == " " else line, separator)
            at = _columns(header)
            if all(name in at for name in NEEDED):
                numbered = list(enumerate(lines, 1))[number + 1 :]
                # PCB and pcb-rnd state the unit below the names of the columns.
                below = (_stated_unit(line) for _, line in numbered if line.startswith("#"))
                usual_mm = next(filter(None, below), usual_mm)
                units = {name: _unit_of(header[k], path) or usual_mm for name, k in at.items() if name in LENGTHS}
                rows = [(k, row) for k, line in numbered if (row := _cells(line, separator)) and any(row)]
                return (at, units), [(k, row) for k, row in rows if not row[0].lstrip().startswith("#")]
    if text.startswith(SPREADSHEETS):
        raise InputError(f"{path}: is a spreadsheet, not a position file; save it as CSV.")
    first = next((_columns(cells) for line in lines if len(cells := _cells(line, ",")) > 1), {})
    missing = ", ".join(name for name in NEEDED if name not in first)
    usual = f"{','.join(COLUMNS)}, or as an assembler has it (Designator, Mid X, Mid Y, Layer, Rotation)"
    raise InputError(f"{path}: is not a position file: {missing} missing; its first line must be {usual}.")


def _cells(line: str, separator: str) -> list[str]:
    try:
        if separator == " ":
            # Altium puts quotes around cells that hold blanks; in KiCad's .pos none does.
            return [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"(?=\s|$)|(\S+)', line)]
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def _columns(header: Sequence[str]) -> dict[str, int]:
    """Where each column stands."""
    plain = [re.sub(r"\(.*\)|\[.*\]", "", cell.lower()) for cell in header]
    plain = [re.sub(r"(mm|mils?|inch|inches|deg|degrees)$", "", re.sub(r"[^a-z]", "", cell)) for cell in plain]
    columns = {
        name: next((plain.index(title) for title in known if title in plain), None) for name, known in KNOWN_AS.items()
    }
    return {name: k for name, k in columns.items() if k is not None}


def _stated_unit(line: str) -> float | None:
    """The unit that a line beside the table states, as in "Units used: mil" or "# X,Y in mm". [mm]"""
    match = re.search(r"(?:\bunits?(?:\s+used)?\s*[:=]|^#\s*x,\s*y in)\s*\"?(\w+)", line, re.IGNORECASE)
    return UNITS_MM.get(match[1].lower()) if match else None


def _unit_of(title: str, path: Path) -> float | None:
    """The unit in the name of a column of lengths, as in "Center-X(mm)". [mm]"""
    match = re.search(r"[(\[]\s*([^)\]]+?)\s*[)\]]$|[ _-](mm|mils?|in|inch|inches)$", title.strip().lower())
    if match is None:
        return None
    if (value := UNITS_MM.get(match[1] or match[2])) is None:
        raise InputError(f'{path}: the unit of its column "{short(title)}" is not known; use mm, mil or inch.')
    return value


def _length_mm(text: str, name: str, where: str, unit_mm: float) -> float:
    """A length in millimetres, its unit in the cell or else the column's; raises InputError."""
    match = LENGTH.fullmatch(text.strip().replace("−", "-"))
    unit = match[2].lower() if match else ""
    try:
        if match is None or (unit and unit not in UNITS_MM):
            raise ValueError
        value = float(match[1].replace(",", ".")) * (UNITS_MM[unit] if unit else unit_mm)
    except ValueError:
        raise InputError(f"{where}: {name} = {text!r} is not a number.") from None
    if not abs(value) <= FARTHEST_MM:
        raise InputError(f"{where}: {name} = {text!r} is too far away; check its unit.")
    return value


def write_positions(path: Path, parts: Iterable[PlacedPart]) -> None:
    """Write a position file in KiCad's form, formulas of spreadsheets behind an apostrophe; raises WriteError."""
    lines = [",".join(COLUMNS)]
    for part in parts:
        numbers = ",".join(f"{value + 0.0:.6f}" for value in (*part.position_mm, part.rotation_deg))
        texts = (
            plain_cell(" ".join(text.splitlines())).replace('"', '""') for text in (part.ref, part.value, part.package)
        )
        lines.append(",".join([*(f'"{text}"' for text in texts), numbers, part.side]))
    write_text(path, "\n".join(lines) + "\n")
