"""KiCad boards, versions 5 to 9: parts, outline and origins read; parts moved; a layout as a new one."""

import cmath
import json
import math
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ...errors import InputError
from ...io import write_text
from ..base import Box, Point, Polygon, shifted
from ..rectangles import sides_of, turned
from ..text_files import read_text
from .outlines import FLAT_MM, Outline, around, middle
from .positions import PlacedPart

EDGE = "Edge.Cuts"
NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]+(e[-+]?[0-9]+)?", re.IGNORECASE)
TOKEN = re.compile(r'"(?P<quoted>(?:[^"\\]|\\.)*)"|(?P<mark>[()])|[^\s()"]+', re.DOTALL)
ESCAPE, CONTROL = re.compile(r"\\(.)", re.DOTALL), {"n": "\n", "r": "\r", "t": "\t"}
# A place in a file: what comes before it, x and y, and an angle.
AT = re.compile(r"(\(\s*at)(\s+[-+.\deE]+\s+[-+.\deE]+)((?:\s+[-+.\deE]+)?)(?=[\s)])")
# What a footprint may hold whose places are not relative to it, or whose angle KiCad's versions write differently.
NOT_MOVED = ("zone", "dimension", "image", "table", "fp_text_box")
CURVE_POINTS = 33
PAGE_CENTER_MM = (100.0, 100.0)
# A footprint that moves and turns by less stays as it is. [mm], [deg]
LEAST_MOVE_MM, LEAST_TURN_DEG = 2e-6, 2e-3
# Version of the format in which KiCad's modules became footprints.
FOOTPRINTS_SINCE = 20201115
# Part of a die's longer side that each of its two pads takes.
PAD_SHARE = 0.4


@dataclass(frozen=True)
class KicadBoard:
    """What of a board file places a sensor, in its own coordinates but with y up, seen from the top. [mm]

    footprints : Every part, with the name of its footprint.
    edges : Lines of the outline, in any order.
    auxiliary_mm, grid_mm : Origins of drill and position files, and of the grid; None where they are not set.
    thickness_mm : Of the insulation in its stackup, else of the whole board; 0 where the file says neither.
    """

    footprints: tuple[PlacedPart, ...]
    edges: tuple[Polygon, ...]
    auxiliary_mm: Point | None
    grid_mm: Point | None
    thickness_mm: float


class Item(list[Any]):
    """An item of a board file: its name, then texts and items; start is where in the file it stands."""

    start = 0


def read_board(path: Path) -> KicadBoard:
    """Read a board; raises InputError where it is none."""
    text = read_text(path, "a KiCad board (.kicad_pcb)")
    try:
        tree = _parsed(text)
        if tree[0] != "kicad_pcb":
            raise ValueError
        return _board(tree)
    except Exception as error:  # whatever a file that is none makes what reads its tree raise
        why = "" if type(error) is ValueError else f" ({type(error).__name__})"
        raise InputError(f"{path}: is no KiCad board that can be read{why}; save it with KiCad 5 or newer.") from None


def _parsed(text: str) -> Item:
    """The one item of a file, every word as it stands: a footprint 0603 and a value 1.50 are no numbers."""
    around = [Item()]
    for token in TOKEN.finditer(text):
        quoted, mark = token["quoted"], token["mark"]
        if mark == "(":
            item = Item()
            item.start = token.start()
            around[-1].append(item)
            around.append(item)
        elif mark:
            around.pop()
        else:
            around[-1].append(token[0] if quoted is None else ESCAPE.sub(lambda e: CONTROL.get(e[1], e[1]), quoted))
    ((tree,),) = around
    return tree


def _all(tree: Sequence[Any], *names: str) -> Iterator[Item]:
    return (item for item in tree if isinstance(item, Item) and item and item[0] in names)


def _numbers(tree: Sequence[Any], name: str) -> list[float]:
    """The numbers of an item such as (at 1 2 90); empty where there is none."""
    return [float(x) for x in next(_all(tree, name), Item())[1:] if isinstance(x, str) and NUMBER.fullmatch(x)]


def _point(tree: Sequence[Any], name: str) -> Point:
    x, y = _numbers(tree, name)[:2]
    return x, -y


def _board(tree: list[Any]) -> KicadBoard:
    footprints, edges = [], [line for item in tree if (line := _line(item, "gr_"))]
    rows = [row for row in next(_all(tree, "layers"), Item()) if isinstance(row, list) and "user" not in row[2:3]]
    # The bottom's copper is the last; up to version 5 items call it what its user did.
    back = {"B.Cu", *(str(row[1]) for row in rows[-1:])}
    for item in _all(tree, "module", "footprint"):
        x, y, angle = (*_numbers(item, "at"), 0.0)[:3]
        texts = {str(t[1]): str(t[2]) for t in _all(item, "fp_text", "property") if len(t) > 2}
        # Since version 8 properties, before it texts: a field of the user's own may have a name in other letters.
        ref, value = (texts.get(name, texts.get(name.lower(), "")) for name in ("Reference", "Value"))
        side = "bottom" if next(_all(item, "layer"), ["", "F.Cu"])[1] in back else "top"
        populated = "dnp" not in next(_all(item, "attr"), Item())
        boxes = _boxes(item, angle, "B" if side == "bottom" else "F")
        footprints.append(PlacedPart(ref, value, str(item[1]), (x, -y), angle, side, *boxes, populated))
        for line in filter(None, (_line(shape, "fp_") for shape in item)):
            moved = (turned(point, angle) for point in line)
            edges.append(tuple((a + x, b - y) for a, b in moved))
    setup = next(_all(tree, "setup"), Item())
    origins = {name: _numbers(setup, name) for name in ("aux_axis_origin", "grid_origin")}
    # KiCad writes an origin that nobody set as 0 0, the corner of the page, or not at all.
    auxiliary, grid = ((o[0], -o[1]) if len(o) == 2 and any(o) else None for o in origins.values())
    layers = _all(next(_all(setup, "stackup"), Item()), "layer")
    films = [layer for layer in layers if str(layer[1]).startswith("dielectric")] or [*_all(tree, "general")]
    thickness_mm = sum(sum(_numbers(film, "thickness")[:1]) for film in films)
    return KicadBoard(tuple(footprints), tuple(edges), auxiliary, grid, thickness_mm)


def _boxes(footprint: list[Any], angle_deg: float, side: str) -> tuple[Point, Box | None, Box | None, Box | None]:
    """Middle of a footprint's pads, its position where it has none, and the boxes around its body with the pads, its
    courtyard, and what it takes of the board's other side, before its rotation. [mm]

    side : F or B.
    """
    other = "F" if side == "B" else "B"
    pads, drilled = (_pads(footprint, angle_deg, *kinds) for kinds in ((), ("thru_hole", "np_thru_hole")))
    body, courtyard, beyond = (
        [point for shape in footprint for point in _line(shape, "fp_", layer)]
        for layer in (f"{side}.Fab", f"{side}.CrtYd", f"{other}.CrtYd")
    )
    boxes = around([*body, *pads]), around(courtyard), around([*beyond, *drilled])
    return middle(pads) if pads else (0.0, 0.0), *boxes


def _pads(footprint: list[Any], angle_deg: float, *kinds: str) -> list[Point]:
    """Corners of the boxes around a footprint's pads of some kinds, or all, before its rotation. [mm]"""
    corners: list[Point] = []
    for pad in (pad for pad in _all(footprint, "pad") if not kinds or pad[2] in kinds):
        x, y, pad_deg = (*_numbers(pad, "at"), 0.0)[:3]
        width, height = (*_numbers(pad, "size"), 0.0, 0.0)[:2]
        c, s = (abs(f(math.radians(pad_deg - angle_deg))) for f in (math.cos, math.sin))
        u, v = (width * c + height * s) / 2, (width * s + height * c) / 2
        corners += [(x - u, -y - v), (x + u, v - y)]
    return corners


def _line(item: Any, kind: str, layer: str = EDGE) -> Polygon:
    """The line that an item draws on a layer, the outline's if not given; none if it draws elsewhere."""
    if not (isinstance(item, list) and item and str(item[0]).startswith(kind)):
        return ()
    shape = str(item[0]).removeprefix(kind) if next(_all(item, "layer"), ["", ""])[1] == layer else ""
    if shape == "line":
        return _point(item, "start"), _point(item, "end")
    if shape == "rect":
        (a, b), (c, d) = _point(item, "start"), _point(item, "end")
        if radius := next(iter(_numbers(item, "radius")), 0.0):  # since KiCad 10
            return _rounded(min(a, c), min(b, d), max(a, c), max(b, d), radius)
        return (a, b), (c, b), (c, d), (a, d), (a, b)
    if shape == "circle":
        return _arc(_point(item, "center"), _point(item, "end"), math.tau)
    if shape == "arc":
        if angle := _numbers(item, "angle"):  # KiCad 5: start is the centre, and the angle follows the clock
            return _arc(_point(item, "start"), _point(item, "end"), -math.radians(angle[0]))
        return _arc_through(item)
    if shape in ("poly", "curve"):
        line: list[Point] = []
        for vertex in next(_all(item, "pts"))[1:]:
            if vertex[0] == "arc":
                line += _arc_through(vertex)
            else:
                line.append((float(vertex[1]), -float(vertex[2])))
        if shape == "poly":
            return (*line, line[0])
        a, b, c, d = np.array(line)
        t = np.linspace(0.0, 1.0, CURVE_POINTS)[:, None]
        points = (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t * t * (1 - t) * c + t**3 * d
        return tuple((x, y) for x, y in points.tolist())
    return ()


def _rounded(left: float, low: float, right: float, high: float, radius: float) -> Polygon:
    """A rectangle with rounded corners, against the clock from its lower right one."""
    line: list[Point] = []
    for quarter, x, y in ((-1, right - radius, low + radius), (0, right - radius, high - radius)):
        dx, dy = turned((radius, 0.0), 90.0 * quarter)
        line += _arc((x, y), (x + dx, y + dy), math.tau / 4)
    line += [(left + right - x, low + high - y) for x, y in line]
    return (*line, line[0])


def _arc(center: Point, start: Point, sweep_rad: float) -> Polygon:
    """An arc as short lines, its ends exact as far as arithmetic goes."""
    radius = math.dist(center, start)
    step = 2 * math.acos(max(0.0, 1 - FLAT_MM / radius)) if radius > FLAT_MM else math.tau / 4
    count = min(max(2, math.ceil(abs(sweep_rad) / step)), 1000)
    first = math.atan2(start[1] - center[1], start[0] - center[0])
    angles = (first + sweep_rad * i / count for i in range(1, count + 1))
    return (start, *((center[0] + radius * math.cos(a), center[1] + radius * math.sin(a)) for a in angles))


def _arc_through(item: Sequence[Any]) -> Polygon:
    """The arc through an item's three points; a straight line where they lie on one."""
    start, middle, end = (_point(item, name) for name in ("start", "mid", "end"))
    first = complex(*start)
    a, b = complex(*middle) - first, complex(*end) - first
    twice_mm2 = (a.conjugate() * b).imag
    if abs(twice_mm2) < 5e-10:
        return start, middle, end
    away = 1j * (abs(b) ** 2 * a - abs(a) ** 2 * b) / (2 * twice_mm2)  # from the start to the centre
    sweep = cmath.phase((away - b) / away) % math.tau
    center = first + away
    line = _arc((center.real, center.imag), start, sweep if twice_mm2 > 0 else sweep - math.tau)
    return (*line[:-1], end)


def moved_board(path: Path, places: Mapping[str, tuple[Point, float]], new: Sequence[tuple[PlacedPart, Point]]) -> str:
    """A board's text with some footprints elsewhere on their side, and new ones; all else stays byte for byte.

    places : position and angle of footprints by reference, as of `read_board`. [mm, deg]
    new : parts to add, with the size of each die. [mm]

    Raises: InputError where a footprint holds what does not move with it.
    """
    text = path.read_bytes().decode()
    tree, edits = _parsed(text), dict[tuple[int, int], str]()
    for item, part in zip(_all(tree, "module", "footprint"), _board(tree).footprints, strict=True):
        position_mm, angle_deg = places.get(part.ref, (part.position_mm, part.rotation_deg))
        turn_deg = round((angle_deg - part.rotation_deg + 180) % 360 - 180, 6)
        if abs(turn_deg) < LEAST_TURN_DEG and math.dist(position_mm, part.position_mm) < LEAST_MOVE_MM:
            continue
        for held in _all(item, *NOT_MOVED):
            raise InputError(f"{path}: {part.ref} has a {held[0]} in its footprint, which does not move with it.")
        edits |= _edit(text, item, turn_deg, position_mm)
        # Angles of pads and texts are those on the board.
        for one in _all(item, "pad", "fp_text", "property") if turn_deg else ():
            edits |= _edit(text, one, turn_deg)
    end = text.rindex(")")
    old = [*_numbers(tree, "version"), math.inf][0] < FOOTPRINTS_SINCE
    edits[end, end] = "".join(_footprint(part, size, part.position_mm, old=old) for part, size in new)
    for (start, stop), words in sorted(edits.items(), reverse=True):
        text = text[:start] + words + text[stop:]
    return text


def _edit(
    text: str, tree: Sequence[Any], turn_deg: float, position_mm: Point | None = None
) -> dict[tuple[int, int], str]:
    """The place that an item of a file has, turned, and elsewhere if that is given; none where it has none."""
    for at in _all(tree, "at"):
        if match := AT.match(text, at.start):
            head, place, angle = match.groups()
            if turn_deg:
                degrees = round((float(angle or 0) + turn_deg) % 360, 6)
                angle = f" {degrees:.10g}" if degrees else ""
            place = place if position_mm is None else f" {_place(position_mm)}"
            return {match.span(): f"{head}{place}{angle}"}
    return {}


def _place(point: Point) -> str:
    """A place as KiCad writes it, with y down. [mm]"""
    return " ".join(f"{x:.6f}".rstrip("0").rstrip(".") for x in (point[0] + 0.0, 0.0 - point[1]))


def write_board(
    path: Path, parts: Sequence[PlacedPart], sizes_mm: Sequence[Point], outline: Outline, *, thickness_mm: float
) -> None:
    """Write a layout as a board of KiCad 6, which newer ones open, from its origin; raises WriteError.

    sizes_mm : Size of each part's die at a rotation of 0, with two pads under it. [mm]
    thickness_mm : Of the board's film.
    """
    ox, oy = PAGE_CENTER_MM
    on_page = tuple(part.position_mm for part in parts), outline.corners_mm, *outline.holes_mm
    places, *lines = shifted(on_page, (ox, -oy))
    items = [_footprint(*of_part) for of_part in zip(parts, sizes_mm, places, strict=True)]
    items += [f"{_drawn('gr', line, EDGE, 0.05)}\n" for line in lines]
    board = {"thickness": f"{thickness_mm:.9g}", "origin": f"{ox:g} {oy:g}", "items": "".join(items)}
    write_text(path, _filled("board.kicad", board))


def _filled(template: str, fields: Mapping[str, str]) -> str:
    return Template(Path(__file__).with_name(template).read_text(encoding="utf-8")).substitute(fields)


def _drawn(kind: str, line: Sequence[Point], layer: str, width_mm: float) -> str:
    """A closed line on a layer, of a board (gr) or a part (fp)."""
    ends = [f"(start {_place(a)}) (end {_place(b)})" for a, b in sides_of(line)]
    return "\n".join(f'    ({kind}_line {both} (layer "{layer}") (width {width_mm:g}))' for both in ends)


def _footprint(part: PlacedPart, size_mm: Point, place_mm: Point, *, old: bool = False) -> str:
    """A part with two pads at a place in the file, in words of KiCad 6, or those of KiCad 4 and 5."""
    side, (u, v) = ("B" if part.side == "bottom" else "F"), (size_mm[0] / 2, size_mm[1] / 2)
    body = part.body_mm or (-u, -v, u, v)
    # Its two pads lie along its longer side.
    along, across = (1 - PAD_SHARE) * max(u, v), PAD_SHARE * 2 * max(u, v)
    fields = {name: json.dumps(getattr(part, name), ensure_ascii=False)[1:-1] for name in ("package", "ref", "value")}
    # An identifier that is the same whenever the same part is written.
    stamp = str(uuid.uuid5(uuid.NAMESPACE_URL, part.ref))
    fields |= {"kind": "module", "tstamp": stamp[:8]} if old else {"kind": "footprint", "tstamp": stamp}
    fields |= {"side": side, "place": _place(place_mm), "angle": f"{part.rotation_deg:.9g}"}
    fields["font"] = f"(effects (font (size 0.3 0.3) (thickness 0.05)){' (justify mirror)' if side == 'B' else ''})"
    for layer, (a, b, c, d) in (("Fab", body), ("CrtYd", part.courtyard_mm or body)):
        fields[layer] = _drawn("fp", ((a, b), (c, b), (c, d), (a, d)), f"{side}.{layer}", 0.02)
    fields["first"], fields["second"], fields["pad"] = (
        (f"0 {-along:.9g}", f"0 {along:.9g}", f"{2 * u:.9g} {across:.9g}")
        if v > u
        else (f"{-along:.9g} 0", f"{along:.9g} 0", f"{across:.9g} {2 * v:.9g}")
    )
    return _filled("footprint.kicad", fields)
