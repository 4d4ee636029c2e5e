"""Drawings in DXF: their lines in millimetres, and closed lines written as a drawing."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ..base import Point, Polygon
from ..text_files import read_bytes

if TYPE_CHECKING:
    from ezdxf.document import Drawing

# How far an arc or a spline may lie from the lines that take its place.
FLAT_MM = 0.002
FLAT_PART = 1e-5  # of its size, where that is more: no curve becomes more than some hundred lines
# Things that a drawing shows, and points of their lines; a board's outline has some hundred.
MOST_ENTITIES, MOST_POINTS = 20_000, 200_000
# One drawing unit by $INSUNITS: inch, foot, mm, cm, m, microinch, mil, yard, angstrom, nm, um, dm. [mm]
UNITS_MM = {1: 25.4, 2: 304.8, 4: 1.0, 5: 10.0, 6: 1e3, 8: 25.4e-6, 9: 0.0254, 10: 914.4, 11: 1e-7, 12: 1e-6, 13: 1e-3}
UNITS_MM |= {14: 100.0}
# Layers to which layout programs write a board's outline.
OUTLINE_LAYERS = ("edge.cuts", "edge_cuts", "boardoutline", "board_outline", "outline", "dimension", "profile")
# What an entity needs to be a line; ezdxf puts zeros where a file leaves it out.
NEEDED = {
    "LINE": ("start", "end"),
    "ARC": ("center", "radius", "start_angle", "end_angle"),
    "CIRCLE": ("center", "radius"),
    "ELLIPSE": ("center", "major_axis"),
    "LWPOLYLINE": (),
    "POLYLINE": (),
    "SPLINE": (),
}


def dxf_lines(path: Path, *, unit_mm: float = 1.0) -> tuple[list[Polygon], list[str]]:
    """The lines of a drawing's model, curves as short straight ones, and what of it is no line, in words. [mm]

    Where a layer has a name that layout programs give to outlines, its lines alone.

    unit_mm : one drawing unit, where the drawing does not tell it. [mm]

    Raises: InputError for a file that is no drawing, or has no line.
    """
    drawing = _open(path)
    # $MEASUREMENT tells nothing: programs leave it at inches in drawings in millimetres.
    if unit := int(drawing.header.get("$INSUNITS", 0) or 0):
        if unit not in UNITS_MM:
            raise InputError(f"{path}: its unit ($INSUNITS = {unit}) is none of boards; export it in millimetres.")
        unit_mm = UNITS_MM[unit]
    layers: dict[str, list[Polygon]] = {}
    others: Counter[str] = Counter()
    points = 0
    try:
        for entity in _entities(drawing.modelspace(), path):
            kind = entity.dxftype()
            if not all(entity.dxf.hasattr(name) for name in NEEDED.get(kind, ())):
                raise InputError(f"{path}: a {kind} lacks one of {', '.join(NEEDED[kind])}; export the outline again.")
            if kind in NEEDED and (line := _flat(entity, unit_mm)):
                layers.setdefault(str(entity.dxf.layer).lower(), []).append(line)
                if (points := points + len(line)) > MOST_POINTS:
                    raise InputError(f"{path}: has more than {MOST_POINTS} points; export the outline alone.")
            else:
                others[kind] += 1
    except InputError:
        raise
    except Exception as error:  # ezdxf raises whatever a broken drawing makes its parts raise
        raise InputError(f"{path}: is no drawing that can be read ({type(error).__name__}); export it again.") from None
    ignored = [f"{count} {kind}" for kind, count in sorted(others.items())]
    for name in OUTLINE_LAYERS:
        if name in layers and len(layers) > 1:
            return layers[name], [*ignored, f"{sum(map(len, layers.values())) - len(layers[name])} on other layers"]
    lines = [line for layer in layers.values() for line in layer]
    if not lines:
        raise InputError(f"{path}: has no line, polyline, arc or spline; export the outline (Edge.Cuts) alone.")
    return lines, ignored


def _open(path: Path) -> "Drawing":
    try:
        import ezdxf
        from ezdxf import recover
    except ImportError:
        raise InputError(f"{path}: reading DXF needs ezdxf: pip install 'nailoptics[cad]'.") from None
    data = read_bytes(path, "an outline")
    try:
        if data.startswith(b"AutoCAD Binary DXF"):
            return ezdxf.readfile(path)
        return recover.read(BytesIO(data))[0]
    except Exception as error:  # as above
        raise InputError(f"{path}: is no DXF drawing ({type(error).__name__}); give an outline.") from None


def _entities(space: Iterable[Any], path: Path) -> Iterator[Any]:
    """Everything that a drawing shows, blocks taken apart."""
    stack, count = [iter(space)], 0
    while stack:
        entity = next(stack[-1], None)
        if entity is None:
            stack.pop()
            continue
        count += 1
        if count > MOST_ENTITIES or len(stack) > 64:
            raise InputError(f"{path}: draws more than {MOST_ENTITIES} things; export the outline (Edge.Cuts) alone.")
        if entity.dxftype() == "INSERT":
            stack.append(iter(entity.multi_insert() if entity.mcount > 1 else entity.virtual_entities()))
        elif not entity.dxf.invisible:
            yield entity


def _flat(entity: Any, unit_mm: float) -> Polygon:
    """An entity's points in millimetres; none if it is a mesh or has no length."""
    from ezdxf.path import bbox, make_path

    try:
        path = make_path(entity)
    except TypeError:  # a polyline that is a mesh
        return ()
    extent = bbox([path], fast=True)
    if not extent.has_data:
        return ()
    far = max(FLAT_MM / unit_mm, FLAT_PART * extent.size.magnitude)
    points = [(point.x * unit_mm, point.y * unit_mm) for point in path.flattening(far)]
    return tuple(points)


def dxf_text(lines: Sequence[Sequence[Point]]) -> str:
    """Closed lines as a drawing in millimetres, in the oldest form (R12), which every program reads. [mm]"""
    groups: list[tuple[int, object]] = [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    groups += [(9, "$INSUNITS"), (70, 4), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for corners in lines:
        groups += [(0, "POLYLINE"), (8, "OUTLINE"), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 1)]
        for x, y in corners:
            groups += [(0, "VERTEX"), (8, "OUTLINE"), (10, f"{x:.6f}"), (20, f"{y:.6f}"), (30, 0.0)]
        groups += [(0, "SEQEND"), (8, "OUTLINE")]
    groups += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code:>3}\n{value}\n" for code, value in groups)
