"""Boards as KiCad has them: position files (Ref,Val,Package,PosX,PosY,Rot,Side) and outlines as DXF or CSV."""

import csv
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..io import write_text

COLUMNS = ("Ref", "Val", "Package", "PosX", "PosY", "Rot", "Side")
ARC_STEP_DEG = 5.0  # an arc becomes a polygon of such steps


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
    rows = list(_rows(path, "a position file"))
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
        x, y, turn = (_number(row[at[name]], name, where) for name in ("PosX", "PosY", "Rot"))
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


def read_outline(path: Path) -> tuple[tuple[float, float], ...]:
    """Corners of a board outline, in order round it, from a DXF (lines, polylines, arcs) or a CSV x_mm,y_mm. [mm]

    Raises: InputError for a file that cannot be read, or an outline that is not one closed line.
    """
    if path.suffix.lower() == ".dxf":
        return _dxf_outline(path)
    rows = list(_rows(path, "an outline"))
    if not rows or [name.strip().lower() for name in rows[0][1][:2]] != ["x_mm", "y_mm"]:
        raise InputError(f"{path}: is no outline; give a DXF, or a CSV whose first line is x_mm,y_mm.")
    corners = []
    for number, row in rows[1:]:
        if len(row) < 2:
            raise InputError(f"{path} line {number}: {','.join(row)!r} is not two numbers.")
        corners.append(
            tuple(_number(text, name, f"{path} line {number}") for text, name in zip(row, "xy", strict=False))
        )
    return _closed([(x, y) for x, y in corners], path)


def write_outline(path: Path, corners_mm: Sequence[tuple[float, float]]) -> None:
    """Write an outline as a closed polyline (.dxf) or as corners (.csv)."""
    if path.suffix.lower() == ".dxf":
        groups = [(0, "SECTION"), (2, "HEADER"), (9, "$INSUNITS"), (70, "4"), (0, "ENDSEC"), (0, "SECTION")]
        groups += [(2, "ENTITIES"), (0, "LWPOLYLINE"), (8, "Edge.Cuts"), (90, str(len(corners_mm))), (70, "1")]
        for x, y in corners_mm:
            groups += [(10, f"{x:.6f}"), (20, f"{y:.6f}")]
        groups += [(0, "ENDSEC"), (0, "EOF")]
        write_text(path, "".join(f"{code}\n{value}\n" for code, value in groups))
    else:
        write_text(path, "x_mm,y_mm\n" + "".join(f"{x:.6f},{y:.6f}\n" for x, y in corners_mm))


def _dxf_outline(path: Path) -> tuple[tuple[float, float], ...]:
    lines = _text(path, "an outline").splitlines()
    groups = [(lines[i].strip(), lines[i + 1].strip()) for i in range(0, len(lines) - 1, 2)]
    scale = 25.4 if ("70", "1") in [groups[i + 1] for i, g in enumerate(groups[:-1]) if g[1] == "$INSUNITS"] else 1.0
    chains: list[list[tuple[float, float]]] = []
    for kind, fields in _entities(groups):
        values: dict[str, list[float]] = {}
        for code, text in fields:
            if code in ("10", "20", "11", "21", "40", "42", "50", "51", "70"):
                values.setdefault(code, []).append(_number(text, f"group {code}", str(path)))
        points = list(zip(values.get("10", []), values.get("20", []), strict=False))
        if kind == "LINE" and points:
            chains.append([points[0], (values["11"][0], values["21"][0])])
        elif kind == "LWPOLYLINE" and points:
            if any(values.get("42", [])):
                raise InputError(f"{path}: a polyline has bulges; export arcs as ARC or as short lines.")
            closed = int(values.get("70", [0])[0]) & 1
            chains.append(points + points[:1] if closed else points)
        elif kind in ("ARC", "CIRCLE") and points:
            first = values["50"][0] if kind == "ARC" else 0.0
            last = values["51"][0] if kind == "ARC" else 360.0
            span = (last - first) % 360 or 360.0
            steps = math.ceil(span / ARC_STEP_DEG)
            (x, y), r = points[0], values["40"][0]
            angles = [math.radians(first + span * i / steps) for i in range(steps + 1)]
            chains.append([(x + r * math.cos(a), y + r * math.sin(a)) for a in angles])
    if not chains:
        raise InputError(f"{path}: has no LINE, LWPOLYLINE, ARC or CIRCLE; export the outline (Edge.Cuts) alone.")
    return _closed([(scale * x, scale * y) for x, y in _joined(chains, path)], path)


def _entities(groups: list[tuple[str, str]]) -> Iterable[tuple[str, list[tuple[str, str]]]]:
    """Kind and groups of each entity."""
    starts = [i for i, (code, _) in enumerate(groups) if code == "0"]
    inside = False
    for i, end in zip(starts, [*starts[1:], len(groups)], strict=True):
        if groups[i][1] == "SECTION":
            inside = ("2", "ENTITIES") in groups[i + 1 : end]
        elif groups[i][1] == "ENDSEC":
            inside = False
        elif inside:
            yield groups[i][1], groups[i + 1 : end]


def _joined(chains: list[list[tuple[float, float]]], path: Path) -> list[tuple[float, float]]:
    """Lines and arcs in any order and direction as one line round the board."""
    chain, rest = list(chains[0]), chains[1:]
    while rest:
        for i, other in enumerate(rest):
            if math.dist(chain[-1], other[0]) < 1e-3 or math.dist(chain[-1], other[-1]) < 1e-3:
                other = other if math.dist(chain[-1], other[0]) < 1e-3 else other[::-1]
                chain += other[1:]
                del rest[i]
                break
        else:
            x, y = chain[-1]
            raise InputError(f"{path}: the outline is not one closed line: nothing goes on from ({x:g}, {y:g}) mm.")
    if math.dist(chain[0], chain[-1]) > 1e-3:
        raise InputError(f"{path}: the outline is open between its first and last point; close it.")
    return chain


def _closed(corners: list[tuple[float, float]], path: Path) -> tuple[tuple[float, float], ...]:
    if len(corners) > 1 and math.dist(corners[0], corners[-1]) < 1e-3:
        corners = corners[:-1]
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)) / 2
    if len(corners) < 3 or abs(area) < 1e-3:
        raise InputError(f"{path}: the outline has {len(corners)} corners and no area; give a closed line.")
    return tuple(corners)


def _rows(path: Path, what: str) -> Iterable[tuple[int, list[str]]]:
    """Numbered rows of a CSV, without empty lines and comments."""
    for number, row in enumerate(csv.reader(_text(path, what).splitlines()), start=1):
        if row and any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#"):
            yield number, row


def _text(path: Path, what: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give {what}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file; give {what}.") from None


def _number(text: str, name: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} = {text!r} is not a number.")
    return value
