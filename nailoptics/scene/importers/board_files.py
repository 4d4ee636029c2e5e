"""A designer's board file as LEDs and photodiodes on the nail: what its references are, its origin, and its side."""

import logging
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from ...assets import data_dir
from ...errors import InputError
from ..base import Box, Point
from ..catalogue import ModulePart, load_part
from ..parts import FILM_UM, USUAL_FILM_UM
from ..rectangles import area_mm2, turned
from ..text_files import number_columns, read_rows, read_text
from .kicad import KicadBoard, read_board
from .outlines import LEAST_AREA_MM2, SAME_PLACE_MM, Outline, around, dxf_lines, is_number, is_point, join, middle
from .positions import READING, PlacedPart, read_positions, warn_of_bottom

log = logging.getLogger(__name__)

Tables = tuple[dict[str, Any], ...]
KINDS = ("led", "photodiode", "module")
NOT_IN_SCENE = {"offset_mm", "rotation_deg"}
SHOWN = 12  # references that a message names
# Within this of its wavelength a shipped die is proposed for an LED.
NEAR_NM = 15.0
# A footprint's position is its body's middle, or the first pin of one with wires: farther from its pads' middle than
# this, the pads count. [mm]
ANCHOR_MM = 0.5
# No nail reaches farther from the origin: beyond this, a file's coordinates are those of a page. [mm]
NAIL_REACH_MM = 20.0


@dataclass(frozen=True)
class View:
    """How a file's coordinates become the nail's: origin, which side faces the nail, and a turn. [mm, deg]"""

    origin_mm: Point = (0.0, 0.0)
    mirrored: bool = False
    turn_deg: float = 0.0

    @classmethod
    def of_kicad(cls, board: Any) -> "View":
        """That of a scene's board, which has been read from KiCad."""
        x, y = board.origin
        return cls((x, 0.0 - y), board.faces_nail == "top", board.turn_deg)

    @property
    def fields(self) -> dict[str, object]:
        """Fields of a KiCad board's table that say this, its origin as KiCad shows it."""
        return {"origin": (self.origin_mm[0], 0.0 - self.origin_mm[1]), "faces_nail": ("bottom", "top")[self.mirrored]}

    def place(self, point: Point) -> Point:
        """A point seen from the board's top, as it lies on the nail. [mm]"""
        x, y = point[0] - self.origin_mm[0], point[1] - self.origin_mm[1]
        u, v = turned((-x if self.mirrored else x, y), self.turn_deg)
        return round(u, 9), round(v, 9)

    def box(self, box: Box) -> Box:
        """A box in a part's own frame, seen from the board's top, in its frame on the nail; and back. [mm]"""
        return (-box[2], box[1], -box[0], box[3]) if self.mirrored else box

    def angle(self, rotation_deg: float) -> float:
        """An angle seen from the board's top, as it is on the nail. [deg]"""
        return round(((-rotation_deg if self.mirrored else rotation_deg) + self.turn_deg) % 360, 9)

    def place_in_file(self, point: Point) -> Point:
        """The point seen from the board's top that lies at one of the nail. [mm]"""
        u, v = turned(point, -self.turn_deg)
        return round(self.origin_mm[0] + (-u if self.mirrored else u), 9), round(self.origin_mm[1] + v, 9)

    def angle_in_file(self, rotation_deg: float) -> float:
        """The angle seen from the board's top that is one on the nail. [deg]"""
        return round((rotation_deg - self.turn_deg) * (-1 if self.mirrored else 1) % 360, 9)


def read_board_file(table: Mapping[str, Any], folder: str | Path | None) -> tuple[Tables, Tables, dict[str, Any]]:
    """What of the file that a `[board]` or a candidate names lies on the nail: tables of LEDs and of photodiodes, and
    the fields of a `[board]` that it gives; raises ValueError, InputError.

    table : with kicad or positions, and parts, origin, faces_nail, turn_deg, negate_x_on_bottom, positions_unit.
    """
    if table.get("kicad") is not None and table.get("positions") is not None:
        raise ValueError("kicad and positions both place the parts; give one of them")
    name, uses = _name(table), table.get("parts") or {}
    path = Path(folder or Path()) / name
    board = read_board(path) if table.get("kicad") is not None else None
    placed = board.footprints if board else read_positions(path, **{one: table[one] for one in READING & table.keys()})
    if not uses:
        raise ValueError(f"{name}: nothing says what its parts are; choose from this and add it: {proposal(placed)}")
    mapped = _mapped(placed, uses, name)
    if board is None:
        oblique = [part for part in mapped if _looks_turned(part, uses[part.ref], folder)]
        warn_of_bottom(table, placed, mapped, oblique, read_text(path, "a position file", any_encoding=True))
    # A file may hold several boards: the outline around the parts.
    whole = join(board.edges, name, around=[part.position_mm for part in mapped]) if board and board.edges else None
    side = str(table.get("faces_nail") or mapped[0].side)
    for part in (part for part in mapped if part.side != side):
        why = "parts on the other side see nothing: take it out of the parts"
        raise ValueError(f"parts.{part.ref} lies on the {part.side}, but the {side} of the board faces the nail; {why}")
    view = view_of(table, mapped, side, board=board, outline=whole)
    tables: dict[str, list[dict[str, Any]]] = {"led": [], "photodiode": []}
    for part in mapped:
        for kind, fields in _tables(part, dict(uses[part.ref]), view, folder):
            tables[kind].append(fields)
    own: dict[str, Any] = {"unmapped": tuple(part.ref for part in placed if part.ref not in uses)}
    # A layout goes back into a board of KiCad.
    own |= {"parts": None} if board is None else view.fields
    own["taken_mm"] = tuple(_taken([part for part in placed if part.ref not in uses], mapped, side, view)) or None
    # Where a size is given, it takes the place of the file's outline.
    if whole is not None and not {"outline_mm", "size_mm"} & table.keys():
        border, *holes = (tuple(map(view.place, line)) for line in (whole.corners_mm, *whole.holes_mm))
        own |= {"outline_mm": border, "outline_holes_mm": tuple(holes)}
    film_um = 0.0 if board is None else round(1e3 * board.thickness_mm, 6)
    if film_um and "kapton_um" not in table:
        own["kapton_um"] = film_um if FILM_UM[0] <= film_um <= FILM_UM[1] else USUAL_FILM_UM
        if own["kapton_um"] != film_um:
            text = f"one that bends onto a nail {FILM_UM[0]} to {FILM_UM[1]}: a film of {USUAL_FILM_UM:g} um is taken"
            log.warning("%s: the board is %g um thick, %s; or give board.kapton_um.", name, film_um, text)
    return tuple(tables["led"]), tuple(tables["photodiode"]), own


def _taken(
    others: Sequence[PlacedPart], mapped: Sequence[PlacedPart], side: str, view: View
) -> Iterator[tuple[Point, ...]]:
    """Corners of the room that a board's other parts take on the side of the nail, as far as a nail may reach; a part
    in whose room mapped ones were drawn leaves it to them."""
    for part in others:
        boxes = [part.beyond_mm] if part.side != side else [part.body_mm, part.courtyard_mm]
        if (room := around([point for box in boxes if box for point in (box[:2], box[2:])])) is None:
            continue
        (x, y), (a, b, c, d) = part.position_mm, room
        inside = (turned((m.position_mm[0] - x, m.position_mm[1] - y), -part.rotation_deg) for m in mapped)
        if any(a < u < c and b < v < d for u, v in inside):
            continue
        corners = (turned(corner, part.rotation_deg) for corner in ((a, b), (c, b), (c, d), (a, d)))
        places = tuple(view.place((x + u, y + v)) for u, v in corners)
        if min(max(map(abs, place)) for place in places) < NAIL_REACH_MM:
            yield places


def _name(table: Mapping[str, Any]) -> str:
    return str(table.get("kicad") or table.get("positions"))


def view_of(
    table: Mapping[str, Any],
    parts: Sequence[PlacedPart],
    faces_nail: str | None,
    *,
    board: KicadBoard | None = None,
    outline: Outline | None = None,
) -> View:
    """How the coordinates of a file become the nail's, by what a table says of it; raises ValueError.

    parts : those of the file that are used. faces_nail : side of the board.
    """
    origin = _origin(table.get("origin"), board, outline, parts, _name(table))
    return View(origin, faces_nail == "top", float(table.get("turn_deg", 0.0)))


def read_outline(path: Path, *, unit_mm: float = 1.0) -> Outline:
    """The outline of a KiCad board, from its auxiliary origin if that is set, in a DXF drawing, or in a CSV with the
    columns x_mm, y_mm.

    unit_mm : one unit of a drawing that does not state it. [mm]

    Raises: InputError for a file that cannot be read, or an outline that is not closed.
    """
    if path.suffix.lower() == ".kicad_pcb":
        board = read_board(path)
        x, y = board.auxiliary_mm or (0.0, 0.0)
        return join([[(a - x, b - y) for a, b in line] for line in board.edges], str(path))
    if path.suffix.lower() == ".dxf":
        return join(dxf_lines(path, unit_mm=unit_mm), str(path))
    rows = read_rows(path, "an outline")
    if [name.strip().lower() for name in next(rows, (0, []))[1][:2]] != ["x_mm", "y_mm"]:
        raise InputError(f"{path}: is not an outline; give a KiCad board, DXF, or CSV whose first line is x_mm,y_mm.")
    _, columns = number_columns(rows, {"x_mm": 0, "y_mm": 1}, str(path), gaps=False)
    corners = [*zip(*(column.tolist() for column in columns.values()), strict=True)]
    if len(corners) > 1 and math.dist(corners[0], corners[-1]) < SAME_PLACE_MM:
        corners = corners[:-1]
    if len(corners) < 3 or abs(area_mm2(corners)) < LEAST_AREA_MM2:
        raise InputError(f"{path}: the outline has {len(corners)} corners and no area; give a closed line.")
    return Outline(tuple(corners))


def _mapped(placed: Sequence[PlacedPart], uses: Mapping[str, Any], name: str) -> list[PlacedPart]:
    refs = [part.ref for part in placed]
    for ref, use in uses.items():
        if not isinstance(use, Mapping) or len(set(use) & set(KINDS)) != 1:
            raise ValueError(f'parts.{ref} must say what it is: one of led, photodiode, module = "PART"')
        if not is_point(use.get("offset_mm", (0.0, 0.0))):
            raise ValueError(f"parts.{ref}.offset_mm must be [x, y]")
        if not is_number(use.get("rotation_deg", 0.0)):
            raise ValueError(f"parts.{ref}.rotation_deg must be a number")
        if "position_mm" in use:
            raise ValueError(f"parts.{ref}.position_mm is the file's; give offset_mm, from there, in the part's frame")
        if (count := refs.count(ref)) != 1:
            known = ", ".join(sorted(set(filter(None, refs)))[:SHOWN])
            there = f"{count} times" if count else f"not; it has {known}"
            raise ValueError(f"parts.{ref} names a part that {name} has {there}")
    mapped = [part for part in placed if part.ref in uses]
    if absent := [part.ref for part in mapped if not part.populated]:
        log.warning("%s: %s is marked DNP (do not populate) and left out.", name, ", ".join(absent))
    if len(absent) == len(mapped):
        raise ValueError(f"{name}: all parts that are mapped are marked DNP (do not populate)")
    return [part for part in mapped if part.populated]


def _origin(
    origin: Any, board: KicadBoard | None, outline: Outline | None, mapped: Sequence[PlacedPart], name: str
) -> Point:
    """The point that lies on the nail's centre, in the file's coordinates; where the file has none from which a nail
    reaches its mapped parts, their middle. [mm]"""
    if not isinstance(origin, str | None):
        x, y = origin
        # KiCad shows y downwards.
        return (float(x), float(y)) if board is None else (float(x), -float(y))
    if board is None and origin is not None:
        raise ValueError(f'origin = "{origin}" needs a KiCad board; give [x, y] as in {name}, or leave it out')
    named: dict[str, Point | None] = {"positions": (0.0, 0.0)}
    if board is not None:
        named = {"auxiliary": board.auxiliary_mm, "outline": middle(outline.corners_mm) if outline else None}
    if origin is None:
        points, first = [part.position_mm for part in mapped], next(filter(None, named.values()), None)
        if first and all(abs(a - b) <= NAIL_REACH_MM for at in points for a, b in zip(at, first, strict=True)):
            return first
        text = "has no origin near its mapped parts, whose middle lies on the nail's centre: give origin"
        log.warning("%s: %s.", name, text)
        return middle(points)
    if board is not None and (point := (named | {"grid": board.grid_mm}).get(origin)) is not None:
        return point
    why = 'set it in KiCad, or give origin = "auxiliary", "grid", "outline" or [x, y]'
    raise ValueError(f"{name} has no such origin; {why}")


def _looks_turned(part: PlacedPart, use: Mapping[str, Any], folder: str | Path | None) -> bool:
    """Whether a part is another one at 180 degrees less its angle: oblique, a module, aside, or of several elements."""
    return bool(part.rotation_deg % 90 or {"module", "offset_mm", "wired"} & use.keys() or _elements(use, folder) != 1)


def _elements(use: Mapping[str, Any], folder: str | Path | None) -> int:
    """How many elements a photodiode has, of its own or of the part that it names."""
    name = use.get("photodiode", use.get("part"))
    of_part = load_part(name, beside=folder) if isinstance(name, str) else None
    return int(use.get("elements", getattr(of_part, "elements", 1)))


def _tables(
    part: PlacedPart, use: dict[str, Any], view: View, folder: str | Path | None
) -> list[tuple[str, dict[str, Any]]]:
    """A part, or what a module of several holds, as tables of LEDs and photodiodes."""
    kind = next(kind for kind in KINDS if kind in use)
    given = {name: value for name, value in use.items() if name not in (*KINDS, *NOT_IN_SCENE)}
    offset, more_deg = tuple(use.get("offset_mm", (0.0, 0.0))), float(use.get("rotation_deg", 0.0))
    pads = (0.0, 0.0) if "offset_mm" in use else _pads_middle(part)

    def table(name: str, ref: str, at: Point, fields: dict[str, Any]) -> dict[str, Any]:
        # A footprint on the bottom is that of the library turned over around its x axis; the file's pads are, too.
        aside = pads[0] + at[0], pads[1] + (-at[1] if part.side == "bottom" else at[1])
        x, y = turned(aside, part.rotation_deg)
        place = view.place((part.position_mm[0] + x, part.position_mm[1] + y))
        # Turned over, a part turns the other way, and the row of its elements points down.
        flipped_deg = (180.0 if _elements(fields, folder) > 1 else 0.0) - more_deg
        own_deg = flipped_deg if part.side == "bottom" else more_deg
        angle = view.angle(part.rotation_deg + own_deg)
        drawn: dict[str, Any] = {"name": name, "reference": ref, "position_mm": place, "rotation_deg": angle}
        for room, box in (("body_mm", part.body_mm), ("courtyard_mm", part.courtyard_mm)):
            points = product(box[::2], box[1::2]) if box else ()
            if own := around([turned((a - aside[0], b - aside[1]), -own_deg) for a, b in points]):
                drawn[room] = tuple(round(edge, 9) for edge in view.box(own))
        return drawn | fields

    if kind == "module":
        module = load_part(str(use[kind]), beside=folder, expect=ModulePart)
        assert isinstance(module, ModulePart)
        both = [("led", led) for led in module.leds] + [("photodiode", photodiode) for photodiode in module.photodiodes]
        name = str(given.get("name", part.ref))
        return [
            (k, table(f"{name}.{die.name}", f"{part.ref}.{die.name}", die.position_mm, die.scene_fields()))
            for k, die in both
        ]
    if isinstance(use[kind], str):
        given["part"] = use[kind]
    elif use[kind] is not True:
        raise ValueError(f"parts.{part.ref}.{kind} must be the name of a part, or true for one without")
    return [(kind, table(str(given.pop("name", part.ref)), part.ref, offset, given))]


def _pads_middle(part: PlacedPart) -> Point:
    """Where a part's body is, from its position: the middle of its pads where these lie aside. [mm]"""
    if (aside_mm := math.hypot(*part.pads_middle_mm)) <= ANCHOR_MM:
        return 0.0, 0.0
    why = f"and is taken; parts.{part.ref}.offset_mm = [0, 0] takes the position"
    log.warning("%s: the middle of its pads lies %.2f mm from its footprint's position, %s.", part.ref, aside_mm, why)
    return part.pads_middle_mm


def proposal(placed: Sequence[PlacedPart]) -> str:
    """A map of the parts that look like LEDs and photodiodes, by library and reference, as a line of a scene file."""
    shipped = sorted((path.stem for path in (data_dir("assets") / "parts").glob("*.toml")), key=len, reverse=True)
    fitted = [part for part in placed if part.ref and part.populated]
    lines = [f"{part.ref} = {{ {use} }}" for part in fitted if (use := _looks_like(part, shipped))]
    if not lines:
        refs = ", ".join(part.ref for part in placed if part.ref)
        return f'parts = {{ REF = {{ led = "PART" }} }}, with REF one of {refs}'
    return f"parts = {{ {', '.join(lines)} }}"


def _looks_like(part: PlacedPart, shipped: Sequence[str]) -> str:
    text = f"{part.package} {part.value}".lower()
    plain = re.sub(r"[^a-z0-9]", "", text)
    for name in shipped:
        if name.replace("_", "") in plain and not name.startswith(("led_", "pd_")):
            kind = load_part(name).kind
            return f'{"photodiode" if kind == "photodiode_array" else kind} = "{name}"'
    ref = part.ref.upper()
    if re.match(r"PD\d|PH\d", ref) or re.search("photodiode|vemd|temd|bpw|sfh2", plain):
        return 'photodiode = "?"' if not re.match(r"LED?\d", ref) else ""
    nm = re.search(r"(\d{3,4})\s*nm", text)
    # A letter with a footprint of a library of LEDs is one, too.
    of_leds = re.fullmatch("[A-Z]", ref) and re.match("leds?[_:]", text)
    if of_leds or re.match(r"(LED|LD)\d", ref) or (re.match(r"D\d", ref) and (nm or "led" in text)):
        if nm:
            dies = {name: int(name[4:]) for name in shipped if re.fullmatch(r"led_\d+", name)}
            near = next((name for name, peak_nm in dies.items() if abs(peak_nm - int(nm[1])) < NEAR_NM), None)
            return f'led = "{near}"' if near else f"led = true, wavelength_nm = {nm[1]}.0"
        return 'led = "?"'
    return ""
