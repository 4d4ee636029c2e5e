"""Outlines of boards: lines in any order joined into a border and its holes, and room within them."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io import write_text
from .base import Point, Polygon
from .text_files import finite_number, read_rows

# Ends of lines that lie closer meet; layout programs chain a board's outline with the same tolerance.
SAME_PLACE_MM = 0.01
LEAST_AREA_MM2 = 1e-3
# Farther from its origin no board reaches, and a unit is wrong.
FARTHEST_MM = 1e6
# Widest pen whose stroke counts as one line where a program draws its two edges, as KiCad's DXF of contours.
PEN_MM = 0.3


@dataclass(frozen=True)
class Outline:
    """The border of a board and the holes in it, each from corner to corner. [mm]

    ignored : what of a drawing is neither, in words.
    """

    corners_mm: Polygon
    holes_mm: tuple[Polygon, ...] = ()
    ignored: tuple[str, ...] = ()


def read_outline(path: Path, *, unit_mm: float = 1.0) -> Outline:
    """The outline in a DXF drawing, or in a CSV with the columns x_mm, y_mm.

    unit_mm : one unit of a drawing that does not tell it. [mm]

    Raises: InputError for a file that cannot be read, or an outline that is not closed.
    """
    if path.suffix.lower() == ".dxf":
        from .dxf import dxf_lines

        lines, ignored = dxf_lines(path, unit_mm=unit_mm)
        return join(lines, str(path), ignored=ignored)
    rows = read_rows(path, "an outline")
    if not rows or [name.strip().lower() for name in rows[0][1][:2]] != ["x_mm", "y_mm"]:
        raise InputError(f"{path}: is no outline; give a DXF, or a CSV whose first line is x_mm,y_mm.")
    corners = []
    for number, row in rows[1:]:
        if len(row) < 2:
            raise InputError(f"{path} line {number}: {','.join(row)!r} is not two numbers.")
        x, y = (finite_number(text, name, f"{path} line {number}") for text, name in zip(row, "xy", strict=False))
        corners.append((x, y))
    if len(corners) > 1 and math.dist(corners[0], corners[-1]) < SAME_PLACE_MM:
        corners = corners[:-1]
    if len(corners) < 3 or abs(area_mm2(corners)) < LEAST_AREA_MM2:
        raise InputError(f"{path}: the outline has {len(corners)} corners and no area; give a closed line.")
    return Outline(tuple(corners))


def is_number(value: object) -> bool:
    """Whether a value of a scene's table is a length or an angle of any board."""
    return isinstance(value, int | float) and abs(value) <= FARTHEST_MM


def is_point(value: object) -> bool:
    """Whether a value of a scene's table is a place on any board."""
    return isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value))


def middle(outline: Outline) -> Point:
    """The middle of the box around an outline. [mm]"""
    xs, ys = zip(*outline.corners_mm, strict=True)
    return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2


def write_outline(path: Path, outline: Outline) -> None:
    """Write an outline with its holes as DXF, or its corners as CSV, by the name's suffix; raises WriteError."""
    if path.suffix.lower() == ".dxf":
        from .dxf import dxf_text

        write_text(path, dxf_text((outline.corners_mm, *outline.holes_mm)))
    else:
        write_text(path, "x_mm,y_mm\n" + "".join(f"{x:.6f},{y:.6f}\n" for x, y in outline.corners_mm))


def join(
    lines: Iterable[Sequence[Point]], name: str, *, ignored: Sequence[str] = (), around: Sequence[Point] = ()
) -> Outline:
    """The outline that a drawing's lines make, in any order and direction: the largest closed line and the holes in it.

    Where lines branch, the border is what can be walked round on the outside. Of a border drawn as the two edges of a
    pen's stroke the inner one is taken. Ends that lead nowhere, and closed lines outside or in a hole, are counted as
    ignored.

    lines : points of each. [mm]
    name : what the message begins with.
    ignored : what of the drawing was no line.
    around : points that the border must hold, where a drawing has several boards. [mm]

    Raises: InputError where nothing is closed, or an open line is larger than what is.
    """
    places, neighbours = _graph(lines, name)
    loose = _cut_loose_ends(neighbours)
    loops = sorted(_loops(places, neighbours), key=lambda loop: -abs(area_mm2(loop)))
    loops = [loop for loop in loops if abs(area_mm2(loop)) >= LEAST_AREA_MM2]
    _check_closed(places, loose, loops, name)
    border, elsewhere = next((loop for loop in loops if all(within(p, loop) for p in around)), loops[0]), 0
    holes: list[Polygon] = []
    unused = [*ignored]
    if (inner := next((loop for loop in loops if _is_stroke(border, loop)), None)) is not None:
        loops.remove(border)
        border = inner
        unused.append("the outer edge of the stroke that draws the border")
    for loop in loops:
        if loop is border:
            continue
        if within(loop[0], border) and not any(within(loop[0], hole) for hole in holes):
            holes.append(loop)
        else:
            elsewhere += 1
    if elsewhere:
        unused.append(f"{elsewhere} closed lines beside the largest one or in its holes")
    if loose:
        unused.append(f"{len(loose)} open lines")
    return Outline(border, tuple(holes), tuple(unused))


def _graph(lines: Iterable[Sequence[Point]], name: str) -> tuple[list[Point], list[set[int]]]:
    """The places where lines bend or end, one for all that lie together, and the neighbours of each."""
    places: list[Point] = []
    cells: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    neighbours: list[set[int]] = []

    def place(point: Point) -> int:
        x, y = point
        if not (abs(x) <= FARTHEST_MM and abs(y) <= FARTHEST_MM):
            raise InputError(f"{name}: the outline reaches ({x:g}, {y:g}) mm; check its units.")
        i, j = int(x // SAME_PLACE_MM), int(y // SAME_PLACE_MM)
        around = (k for a in (0, -1, 1) for b in (0, -1, 1) for k in cells.get((i + a, j + b), ()))
        nearest = min(around, key=lambda k: math.dist(places[k], point), default=None)
        if nearest is not None and math.dist(places[nearest], point) < SAME_PLACE_MM:
            return nearest
        cells[i, j].append(len(places))
        places.append((x, y))
        neighbours.append(set())
        return len(places) - 1

    for line in lines:
        # Ends decide where lines meet, and so are places before the points between them.
        ends = [place(line[0]), place(line[-1])] if line else []
        stops = [ends[0], *map(place, line[1:-1]), ends[1]] if line else []
        for a, b in zip(stops, stops[1:], strict=False):
            if a != b:
                neighbours[a].add(b)
                neighbours[b].add(a)
    return places, neighbours


def _cut_loose_ends(neighbours: list[set[int]]) -> list[list[int]]:
    """Take away what leads nowhere, end by end; returns the lines that were taken away."""
    lines = []
    for end in range(len(neighbours)):
        line = [end]
        while len(neighbours[line[-1]]) == 1:
            (following,) = neighbours[line[-1]]
            neighbours[line[-1]].clear()
            neighbours[following].discard(line[-1])
            line.append(following)
        if len(line) > 1:
            lines.append(line)
    return lines


def _loops(places: list[Point], neighbours: list[set[int]]) -> Iterator[Polygon]:
    """What hangs together, walked round on its outside against the clock from its lowest place."""
    seen = [False] * len(places)
    for first, beside in enumerate(neighbours):
        if seen[first] or not beside:
            continue
        seen[first], together = True, [first]
        for k in together:
            fresh = [one for one in neighbours[k] if not seen[one]]
            together += fresh
            for one in fresh:
                seen[one] = True
        yield tuple(places[k] for k in _walk_outside(places, neighbours, min(together, key=lambda k: places[k][::-1])))


def _walk_outside(places: list[Point], neighbours: list[set[int]], lowest: int) -> list[int]:
    def direction(a: int, b: int) -> float:
        return math.atan2(places[b][1] - places[a][1], places[b][0] - places[a][0])

    def following(at: int, back: float) -> int:
        """The next place against the clock from the direction back."""
        return min(neighbours[at], key=lambda b: (direction(at, b) - back - 1e-12) % math.tau)

    walked, at = [lowest], following(lowest, -math.pi / 2)
    second = at
    while True:
        walked.append(at)
        at = following(at, direction(at, walked[-2]))
        if walked[-1] == lowest and at == second:
            return walked[:-1]


def _check_closed(places: list[Point], loose: list[list[int]], loops: list[Polygon], name: str) -> None:
    """Raise InputError unless the largest closed line is larger than every open one."""
    if not loops and not loose:
        raise InputError(f"{name}: the outline has no area; give a closed line.")

    def size(points: Sequence[Point]) -> float:
        xs, ys = zip(*points, strict=True)
        return math.hypot(max(xs) - min(xs), max(ys) - min(ys))

    largest = max(loose, key=lambda line: size([places[k] for k in line]), default=[])
    if largest and (not loops or size([places[k] for k in largest]) > size(loops[0])):
        x, y = places[largest[0]]
        ends = [math.dist((x, y), places[line[0]]) for line in loose if line is not largest]
        ends += [math.dist((x, y), places[line[-1]]) for line in loose]
        raise InputError(
            f"{name}: the outline is open at ({x:g}, {y:g}) mm, from where it is {min(ends):.3g} mm to the next end of "
            "a line; close it."
        )


def _is_stroke(outer: Polygon, inner: Polygon) -> bool:
    """Whether two closed lines are the edges of one stroke around a board."""
    areas = [abs(area_mm2(line)) for line in (outer, inner)]
    length_mm = sum(math.dist(a, b) for line in (outer, inner) for a, b in zip(line, (*line[1:], line[0]), strict=True))
    thin = 0 < areas[0] - areas[1] < PEN_MM * length_mm / 2 and areas[1] > areas[0] / 2
    return thin and within(inner[0], outer)


def area_mm2(corners: Sequence[Point]) -> float:
    """Area of a polygon, negative where its corners follow the clock. [mm^2]"""
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)) / 2


def within(point: Point, corners: Sequence[Point]) -> bool:
    """Whether a point lies in a polygon, by the crossings of a ray along x."""
    x, y = point
    start = np.asarray(corners)
    (a, b), (c, d) = start.T, np.roll(start, -1, axis=0).T
    crossing = (b > y) != (d > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        return bool(np.count_nonzero(crossing & (x < a + (y - b) * (c - a) / (d - b))) % 2)


def has_room(center: Point, half_mm: Point, corners: Sequence[Point], holes: Sequence[Sequence[Point]]) -> bool:
    """Whether a rectangle lies within a border and outside of its holes; it may touch their lines.

    half_mm : Half its size along x and y. [mm]
    """
    inside = within(center, corners) and not any(within(center, hole) for hole in holes)
    return inside and not any(_cuts(center, half_mm, polygon) for polygon in (corners, *holes))


def _cuts(center: Point, half_mm: Point, corners: Sequence[Point]) -> bool:
    """Whether a polygon's line passes through a rectangle's inside."""
    start = np.asarray(corners) - center
    along = np.roll(start, -1, axis=0) - start
    # The part of each side, from 0 to 1, that lies between the rectangle's edges on both axes.
    least = np.asarray(half_mm) - 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (-least - start) / along, (least - start) / along
    low, high = np.minimum(low, high), np.maximum(low, high)
    still = along == 0
    between = np.abs(start) < least
    low = np.where(still, np.where(between, -np.inf, np.inf), low)
    high = np.where(still, np.where(between, np.inf, -np.inf), high)
    return bool(np.any(np.maximum(low.max(1), 0) < np.minimum(high.min(1), 1)))
