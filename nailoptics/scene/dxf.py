"""Outlines of boards: DXF with lines, polylines and arcs, or a CSV of corners."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import InputError
from ..io import write_text
from .text_files import finite_number, read_rows, read_text

ARC_STEP_DEG = 5.0  # an arc becomes a polygon of such steps
SAME_PLACE_MM = 1e-3  # ends of lines that lie closer meet


def read_outline(path: Path) -> tuple[tuple[float, float], ...]:
    """Corners of a board outline, in order round it, from a DXF (lines, polylines, arcs) or a CSV x_mm,y_mm. [mm]

    Raises: InputError for a file that cannot be read, or an outline that is not one closed line.
    """
    if path.suffix.lower() == ".dxf":
        return _dxf_outline(path)
    rows = read_rows(path, "an outline")
    if not rows or [name.strip().lower() for name in rows[0][1][:2]] != ["x_mm", "y_mm"]:
        raise InputError(f"{path}: is no outline; give a DXF, or a CSV whose first line is x_mm,y_mm.")
    corners = []
    for number, row in rows[1:]:
        if len(row) < 2:
            raise InputError(f"{path} line {number}: {','.join(row)!r} is not two numbers.")
        corners.append(
            tuple(finite_number(text, name, f"{path} line {number}") for text, name in zip(row, "xy", strict=False))
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
    lines = read_text(path, "an outline").splitlines()
    groups = [(lines[i].strip(), lines[i + 1].strip()) for i in range(0, len(lines) - 1, 2)]
    scale = 25.4 if ("70", "1") in [groups[i + 1] for i, g in enumerate(groups[:-1]) if g[1] == "$INSUNITS"] else 1.0
    chains: list[list[tuple[float, float]]] = []
    for kind, fields in _entities(groups):
        values: dict[str, list[float]] = {}
        for code, text in fields:
            if code in ("10", "20", "11", "21", "40", "42", "50", "51", "70"):
                values.setdefault(code, []).append(finite_number(text, f"group {code}", str(path)))
        points = list(zip(values.get("10", []), values.get("20", []), strict=False))
        if kind == "LINE" and points:
            chains.append([points[0], (values["11"][0], values["21"][0])])
        elif kind == "LWPOLYLINE" and points:
            if any(values.get("42", [])):
                raise InputError(f"{path}: a polyline has bulges; export arcs as ARC or as short lines.")
            closed = int(values.get("70", [0])[0]) & 1
            chains.append(points + points[:1] if closed else points)
        elif kind in ("ARC", "CIRCLE") and points:
            first, last = (values["50"][0], values["51"][0]) if kind == "ARC" else (0.0, 360.0)
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
        ways = ((i, way) for i, other in enumerate(rest) for way in (other, other[::-1]))
        following = next(((i, way) for i, way in ways if math.dist(chain[-1], way[0]) < SAME_PLACE_MM), None)
        if following is None:
            x, y = chain[-1]
            raise InputError(f"{path}: the outline is not one closed line: nothing goes on from ({x:g}, {y:g}) mm.")
        chain += following[1][1:]
        del rest[following[0]]
    if math.dist(chain[0], chain[-1]) > SAME_PLACE_MM:
        raise InputError(f"{path}: the outline is open between its first and last point; close it.")
    return chain


def _closed(corners: list[tuple[float, float]], path: Path) -> tuple[tuple[float, float], ...]:
    if len(corners) > 1 and math.dist(corners[0], corners[-1]) < SAME_PLACE_MM:
        corners = corners[:-1]
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)) / 2
    if len(corners) < 3 or abs(area) < SAME_PLACE_MM:
        raise InputError(f"{path}: the outline has {len(corners)} corners and no area; give a closed line.")
    return tuple(corners)
