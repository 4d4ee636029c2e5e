"""Drawings in DXF: their lines in millimetres."""

from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import InputError
from ..base import Polygon
from ..text_files import read_bytes

if TYPE_CHECKING:
    from ezdxf.document import Drawing

# How far an arc or a spline may lie from the lines that take its place.
FLAT_MM = 0.002
FLAT_PART = 1e-5  # of its size, where that is more: no curve becomes more than some hundred lines
# Things that a drawing shows, and points of their lines; a board's outline has some hundred.
MOST_ENTITIES, MOST_POINTS = 20_000, 200_000
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


def dxf_lines(path: Path, *, unit_mm: float = 1.0) -> list[Polygon]:
    """The lines of a drawing's model, curves as short straight ones; text and the like are left out. [mm]

    Where a layer has a name that layout programs give to outlines, its lines alone.

    unit_mm : one drawing unit, where the drawing does not state it. [mm]

    Raises: InputError for a file that is no drawing, or has no line.
    """
    layers: dict[str, list[Polygon]] = {}
    points = 0
    try:
        drawing = _open(path)
        unit_mm = _unit_mm(drawing, path) or unit_mm
        for entity in _entities(drawing.modelspace(), path):
            kind = entity.dxftype()
            if not all(entity.dxf.hasattr(name) for name in NEEDED.get(kind, ())):
                raise InputError(f"{path}: a {kind} lacks one of {', '.join(NEEDED[kind])}; export the outline again.")
            if kind in NEEDED and (line := _flat(entity, unit_mm)):
                layers.setdefault(str(entity.dxf.layer).lower(), []).append(line)
                if (points := points + len(line)) > MOST_POINTS:
                    raise InputError(f"{path}: has more than {MOST_POINTS} points; export the outline alone.")
    except InputError:
        raise
    except Exception as error:  # ezdxf raises whatever a broken drawing makes its parts raise
        raise InputError(
            f"{path}: is no DXF drawing that can be read ({type(error).__name__}); export it again."
        ) from None
    outlines = [layers[name] for name in OUTLINE_LAYERS if name in layers]
    lines = outlines[0] if outlines else [line for layer in layers.values() for line in layer]
    if not lines:
        raise InputError(f"{path}: has no line, polyline, arc or spline; export the outline (Edge.Cuts) alone.")
    return lines


def _open(path: Path) -> "Drawing":
    try:
        import ezdxf
        from ezdxf import recover
    except ImportError:
        raise InputError(f"{path}: reading DXF needs ezdxf: pip install 'nailoptics[cad]'.") from None
    data = read_bytes(path, "an outline")
    return ezdxf.readfile(path) if data.startswith(b"AutoCAD Binary DXF") else recover.read(BytesIO(data))[0]


def _unit_mm(drawing: "Drawing", path: Path) -> float | None:
    """One unit of a drawing that states it. [mm]"""
    from ezdxf.enums import InsertUnits
    from ezdxf.units import conversion_factor

    # $MEASUREMENT says nothing: programs leave it at inches in drawings in millimetres.
    unit = int(drawing.header.get("$INSUNITS", 0) or 0)
    try:
        return conversion_factor(InsertUnits(unit), InsertUnits.Millimeters) if unit else None
    except (ValueError, TypeError):
        raise InputError(f"{path}: its unit ($INSUNITS = {unit}) is not known; export it in millimetres.") from None


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
    return tuple((point.x * unit_mm, point.y * unit_mm) for point in path.flattening(far))
