"""Outlines of boards: read from drawings, and lines joined into a border and its holes."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...io import write_text
from ..base import Box, Point, Polygon
from ..rectangles import area_mm2
from ..text_files import read_bytes

if TYPE_CHECKING:
    import shapely
    from ezdxf.document import Drawing

# Ends of lines that lie closer meet; layout programs chain a board's outline with the same tolerance.
SAME_PLACE_MM = 0.01
NEAREST = 4
# Pairs of lines that meet, beyond each one's neighbours; they are counted for so many of the lines.
MOST_MEETINGS, COUNTED = 100_000, 200
GRID_MM = 1e-6  # to which crossings of lines are rounded, as KiCad's own coordinates are
LEAST_AREA_MM2 = 1e-3
# Farther from its origin no board reaches, and a unit is wrong.
FARTHEST_MM = 1e6
# How far an arc or a spline may lie from the lines that take its place.
FLAT_MM = 0.002
FLAT_PART = 1e-5  # of its size, where that is more: no curve becomes more than some hundred lines
# Things that a drawing shows, and points of their lines; a board's outline has some hundred.
MOST_ENTITIES, MOST_POINTS = 20_000, 200_000
# Layers to which layout programs write a board's outline.
OUTLINE_LAYERS = ("edge.cuts", "edge_cuts", "boardoutline", "board_outline", "outline", "dimension", "profile")
# What an entity needs to be a line; ezdxf puts zeros where a file leaves it out.
NEEDED: dict[str, tuple[str, ...]] = {"LINE": ("start", "end"), "CIRCLE": ("center", "radius")}
NEEDED |= {"ARC": ("center", "radius", "start_angle", "end_angle"), "ELLIPSE": ("center", "major_axis")}
NEEDED |= {"LWPOLYLINE": (), "POLYLINE": (), "SPLINE": ()}


@dataclass(frozen=True)
class Outline:
    """The border of a board and the holes in it, each from corner to corner. [mm]"""

    corners_mm: Polygon
    holes_mm: tuple[Polygon, ...] = ()


def is_number(value: object) -> bool:
    """Whether a value of a scene's table is a length or an angle of any board."""
    return isinstance(value, int | float) and abs(value) <= FARTHEST_MM


def is_point(value: object) -> bool:
    """Whether a value of a scene's table is a place on any board."""
    return isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value))


def middle(points: Sequence[Point]) -> Point:
    """The middle of the box around points. [mm]"""
    xs, ys = zip(*points, strict=True)
    return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2


def around(points: Sequence[Point]) -> Box | None:
    """The box around points; None where that has no area. [mm]"""
    xs, ys = zip(*points, strict=True) if points else ((0.0,), (0.0,))
    return (min(xs), min(ys), max(xs), max(ys)) if min(xs) < max(xs) and min(ys) < max(ys) else None


def dxf_lines(path: Path, *, unit_mm: float) -> list[Polygon]:
    """The lines of a drawing's model, or of its layer for outlines, curves as short straight ones; raises InputError.

    unit_mm : one drawing unit, where the drawing does not state it. [mm]
    """
    layers: dict[str, list[Polygon]] = {}
    points = 0
    try:
        import ezdxf
        from ezdxf import recover
    except ImportError:
        raise InputError(f"{path}: reading DXF needs ezdxf: pip install 'nailoptics[cad]'.") from None
    data = read_bytes(path, "an outline")
    try:
        drawing = ezdxf.readfile(path) if data.startswith(b"AutoCAD Binary DXF") else recover.read(BytesIO(data))[0]
        unit_mm = _unit_mm(drawing, path) or unit_mm
        for count, entity in enumerate(_entities(drawing.modelspace())):
            if count >= MOST_ENTITIES:
                why = f"draws more than {MOST_ENTITIES} things; export the outline (Edge.Cuts) alone."
                raise InputError(f"{path}: {why}")
            kind = entity.dxftype()
            if kind not in NEEDED or entity.dxf.invisible:
                continue
            if not all(map(entity.dxf.hasattr, NEEDED[kind])):
                raise InputError(f"{path}: a {kind} lacks one of {', '.join(NEEDED[kind])}; export the outline again.")
            if line := _flat(entity, unit_mm):
                layers.setdefault(str(entity.dxf.layer).lower(), []).append(line)
                if (points := points + len(line)) > MOST_POINTS:
                    raise InputError(f"{path}: has more than {MOST_POINTS} points; export the outline alone.")
    except InputError:
        raise
    except Exception as error:  # ezdxf raises whatever a broken drawing makes its parts raise
        why = f"is no DXF drawing that can be read ({type(error).__name__}); export it again."
        raise InputError(f"{path}: {why}") from None
    named = next((name for name in OUTLINE_LAYERS if name in layers), None)
    lines = layers[named] if named else [line for layer in layers.values() for line in layer]
    if not lines:
        raise InputError(f"{path}: has no line, polyline, arc or spline; export the outline (Edge.Cuts) alone.")
    return lines


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


def _entities(space: Iterable[Any]) -> Iterator[Any]:
    """Everything in a drawing, blocks and, after each, what is in it."""
    for entity in space:
        yield entity
        if entity.dxftype() == "INSERT":
            yield from _entities(entity.multi_insert() if entity.mcount > 1 else entity.virtual_entities())


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


def write_outline(path: Path, outline: Outline) -> None:
    """Write an outline with its holes as a drawing in DXF R12, which every program reads; raises WriteError."""
    groups: list[tuple[int, object]] = [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    groups += [(9, "$INSUNITS"), (70, 4), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for corners in (outline.corners_mm, *outline.holes_mm):
        groups += [(0, "POLYLINE"), (8, "OUTLINE"), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 1)]
        for x, y in corners:
            groups += [(0, "VERTEX"), (8, "OUTLINE"), (10, f"{x:.6f}"), (20, f"{y:.6f}"), (30, 0.0)]
        groups += [(0, "SEQEND"), (8, "OUTLINE")]
    groups += [(0, "ENDSEC"), (0, "EOF")]
    write_text(path, "".join(f"{code:>3}\n{value}\n" for code, value in groups))


def join(lines: Iterable[Sequence[Point]], name: str, *, around: Sequence[Point] = ()) -> Outline:
    """The outline that a drawing's lines make, in any order and direction: the largest closed line and the holes in it.

    Where lines branch, the border goes round all the areas that they enclose together; of boards that share an edge,
    round those on which parts lie. Lines that enclose nothing, and closed lines outside or in a hole, are left out.

    lines, around : points of each line, and of the parts, where a drawing has several boards. [mm]

    Raises: InputError where nothing is closed, an open line is larger than what is, or shapely is missing.
    """
    try:
        import shapely
    except ImportError:
        raise InputError(f"{name}: reading an outline needs shapely: pip install 'nailoptics[cad]'.") from None
    areas, loose = _areas(lines, name)
    _check_closed(areas, loose, name)
    border = _border(areas, around)
    inside = [area for area, held in zip(areas, shapely.covers(border, areas), strict=True) if held]
    holes = [shapely.Polygon(ring) for area in _outermost(inside) for ring in area.interiors]
    return Outline(_corners(border), tuple(map(_corners, holes)))


def _areas(lines: Iterable[Sequence[Point]], name: str) -> tuple[list["shapely.Polygon"], list["shapely.LineString"]]:
    """The areas that lines enclose, each without those in it, the largest first, and the lines that enclose none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree
    from shapely import LineString, STRtree, get_parts, line_merge, polygonize_full, unary_union

    points = [np.asarray(line, float).reshape(-1, 2) for line in lines if len(line) > 1]
    for x, y in (point for line in points for point in line[~(np.abs(line) <= FARTHEST_MM).all(1)]):
        raise InputError(f"{name}: the outline reaches ({x:g}, {y:g}) mm; check its units.")
    if points:
        # Ends that nearly meet are one place; that each is joined to its nearest few bounds the work.
        ends, of_line = np.unique(np.concatenate([line[[0, -1]] for line in points]), axis=0, return_inverse=True)
        _, near = KDTree(ends).query(ends, k=NEAREST, distance_upper_bound=SAME_PLACE_MM)
        rows, columns = np.nonzero(near < len(ends))
        graph = coo_array((np.ones(len(rows)), (rows, near[rows, columns])), shape=(len(ends),) * 2)
        _, place = connected_components(graph, directed=False)
        _, first = np.unique(place, return_index=True)
        for line, both in zip(points, first[place][of_line.reshape(-1, 2)], strict=True):
            line[[0, -1]] = ends[both]
    drawn = [LineString(line) for line in points if np.ptp(line, axis=0).any()]
    some = drawn[:: max(1, len(drawn) // COUNTED)]
    meetings = len(STRtree(drawn).query(some, predicate="intersects")[0]) if some else 0
    if meetings * len(drawn) > (MOST_MEETINGS + 5 * len(drawn)) * len(some):
        raise InputError(f"{name}: its {len(drawn)} lines cross one another too often; give the outline alone.")
    enclosed, cuts, dangles, _ = polygonize_full(get_parts(unary_union(drawn, grid_size=GRID_MM)))
    areas = [area for area in get_parts(enclosed) if _corners_area(area) >= LEAST_AREA_MM2]
    loose = line_merge(unary_union([cuts, dangles]))
    return sorted(areas, key=_corners_area, reverse=True), [line for line in get_parts(loose) if line.length]


def _outermost(areas: Iterable["shapely.Polygon"]) -> list["shapely.Polygon"]:
    """Those of some areas that lie in no hole of another."""
    from shapely import Polygon, STRtree

    areas = [*areas]
    holes = STRtree([Polygon(ring) for area in areas for ring in area.interiors])
    inner = {*holes.query(areas, predicate="covered_by")[0].tolist()}
    return [area for i, area in enumerate(areas) if i not in inner]


def _border(areas: list["shapely.Polygon"], around: Sequence[Point]) -> "shapely.Polygon":
    """The outside of the areas in which points lie, or of all that hang together, of those that do the largest."""
    from shapely import MultiPoint, Polygon, get_parts, unary_union

    points = MultiPoint(around)
    solid = [Polygon(area.exterior) for area in _outermost(areas)]
    populated = unary_union([area for area in solid if area.intersects(points)])
    if populated.geom_type == "Polygon" and not populated.is_empty and populated.covers(points):
        return Polygon(populated.exterior)
    together = sorted(get_parts(unary_union(solid)), key=_corners_area, reverse=True)
    return Polygon(next((area for area in together if area.covers(points)), together[0]).exterior)


def _corners_area(polygon: "shapely.Polygon") -> float:
    """Area of a polygon with what is in its holes. [mm^2]"""
    return abs(area_mm2(polygon.exterior.coords[:-1]))


def _corners(polygon: "shapely.Polygon") -> Polygon:
    """The corners of a polygon against the clock from its lowest one. [mm]"""
    corners = [(float(x), float(y)) for x, y in polygon.exterior.coords[:-1]]
    corners = corners if area_mm2(corners) > 0 else corners[::-1]
    lowest = min(range(len(corners)), key=lambda k: corners[k][::-1])
    return (*corners[lowest:], *corners[:lowest])


def _check_closed(areas: list["shapely.Polygon"], loose: list["shapely.LineString"], name: str) -> None:
    """Raise InputError unless the largest area is larger than every open line."""
    if not areas and not loose:
        raise InputError(f"{name}: the outline has no area; give a closed line.")

    def size(shape: "shapely.Polygon | shapely.LineString") -> float:
        low_x, low_y, high_x, high_y = shape.bounds
        return math.hypot(high_x - low_x, high_y - low_y)

    largest = max(loose, key=size, default=None)
    if largest is not None and (not areas or size(largest) > size(areas[0])):
        (x, y), *others = [
            line.coords[k] for line in (largest, *(line for line in loose if line is not largest)) for k in (0, -1)
        ]
        next_mm = min(math.dist((x, y), other) for other in others)
        why = f"from where it is {next_mm:.3g} mm to the next end of a line; close it."
        raise InputError(f"{name}: the outline is open at ({x:g}, {y:g}) mm, {why}")
