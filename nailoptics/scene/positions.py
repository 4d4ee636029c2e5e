"""Position files, as KiCad exports them for pick and place: Ref,Val,Package,PosX,PosY,Rot,Side."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..io import write_text
from .text_files import finite_number, read_rows

COLUMNS = ("Ref", "Val", "Package", "PosX", "PosY", "Rot", "Side")


@dataclass(frozen=True)
class PlacedPart:
    """One line of a position file, in the file's own coordinates: x to the right, y up, seen from the top. [mm]"""

    ref: str
    value: str
    package: str
    position_mm: tuple[float, float]
    rotation_deg: float
    side: str

    @property
    def is_led(self) -> bool:
        """Whether it is an LED, by its reference: D1, LED2 and the like, but not photodiodes PD1."""
        return re.fullmatch(r"(D|LED)[0-9_.-]*", self.ref.upper()) is not None

    @property
    def is_turned(self) -> bool:
        """Whether it lies across: turned by 90 or 270 degrees, not by 0 or 180."""
        return round(self.rotation_deg / 90) % 2 == 1


def read_positions(path: Path, *, negate_x_on_bottom: bool = False) -> tuple[PlacedPart, ...]:
    """Read a KiCad position file, both sides, in the order of the file.

    negate_x_on_bottom : the file was exported with "use negative X coordinates for footprints on bottom layer"; turn
        the sign of X back on that side.

    Raises: InputError with file, line and what is wrong.
    """
    rows = read_rows(path, "a position file")
    header = [name.strip().lower() for name in rows[0][1]] if rows else []
    missing = [name for name in COLUMNS if name.lower() not in header]
    if missing:
        raise InputError(
            f"{path}: is no position file: {', '.join(missing)} missing; its first line must be {','.join(COLUMNS)}."
        )
    at = {name: header.index(name.lower()) for name in COLUMNS}
    parts: list[PlacedPart] = []
    for number, row in rows[1:]:
        where = f"{path} line {number}"
        if len(row) < len(header):
            raise InputError(f"{where}: has {len(row)} columns, its header {len(header)}; complete it.")
        x, y, turn = (finite_number(row[at[name]], name, where) for name in ("PosX", "PosY", "Rot"))
        side = row[at["Side"]].strip().lower()
        if side not in ("top", "bottom"):
            raise InputError(f'{where}: Side = "{row[at["Side"]]}"; must be top or bottom.')
        if side == "bottom" and negate_x_on_bottom:
            x = -x
        if abs(turn / 90 - round(turn / 90)) > 1e-3:
            raise InputError(
                f"{where}: Rot = {turn:g}; parts on the nail lie along or across it: give a multiple of 90."
            )
        ref = row[at["Ref"]].strip()
        if any(part.ref == ref for part in parts):
            raise InputError(f'{where}: Ref "{ref}" is there twice; give each part its own.')
        parts.append(PlacedPart(ref, row[at["Val"]].strip(), row[at["Package"]].strip(), (x, y), turn, side))
    if not parts:
        raise InputError(f"{path}: names no part; export the positions of both sides.")
    return tuple(parts)


def write_positions(path: Path, parts: Iterable[PlacedPart], *, negate_x_on_bottom: bool = False) -> None:
    """Write a position file in KiCad's form; raises InputError where the place cannot be written."""
    lines = [",".join(COLUMNS)]
    for part in parts:
        x, y = part.position_mm
        x = -x if part.side == "bottom" and negate_x_on_bottom else x
        numbers = ",".join(f"{value + 0.0:.6f}" for value in (x, y, part.rotation_deg))
        lines.append(f'"{part.ref}","{part.value}","{part.package}",{numbers},{part.side}')
    write_text(path, "\n".join(lines) + "\n")
