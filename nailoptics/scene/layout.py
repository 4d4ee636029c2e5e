"""Where everything lies on the flat board: dies, photodiode elements, barrier walls, outline."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from .base import Point, Polygon, shifted
from .finger import Finger
from .parts import Board, Led, Photodiode
from .rectangles import Rectangle, area_mm2, has_room, turned

Border = tuple[Polygon, ...]  # a drawn line, then its holes
ROUNDING_MM = 1e-6  # what parts may overlap without a complaint
BOARD_MARGIN_MM = 0.5  # from the outermost parts to the edge of a board whose size is not given
NAIL_MARGIN_MM = 0.05  # the least from the board's edge to the nail's
WALL_ROOM_MM = 0.02  # the least left beside a wall between LEDs and photodiodes
LEAST_EPOXY_UM = 20.0  # what is left between a part and the adhesive
LAYOUTS_KEPT = 256
# Sides of the photodiodes on which LEDs may lie: the axis across their wall, and which way the photodiodes lie.
SIDES = {"left": (0, 1), "right": (0, -1), "below": (1, 1), "above": (1, -1)}


@dataclass(frozen=True)
class Element:
    """One photodiode element that is read, and the scene's photodiode that it belongs to."""

    area: Rectangle
    photodiode: Photodiode

    @property
    def name(self) -> str:
        """Name of the photodiode; of an array, with the number of the element."""
        return self.area.name


@dataclass(frozen=True)
class Layout:
    """The board as rectangles from the centre of the nail plate; border_mm : a drawn border in its outline, holes."""

    outline: Rectangle
    leds: tuple[Rectangle, ...]
    photodiodes: tuple[Element, ...]
    unwired: tuple[Rectangle, ...]
    unwired_height_um: float
    barriers: tuple[Rectangle, ...]
    border_mm: Border = ()

    @property
    def photodiode_names(self) -> tuple[str, ...]:
        """Names of the elements that are read."""
        return tuple(element.name for element in self.photodiodes)

    @property
    def photodiode_areas(self) -> tuple[Rectangle, ...]:
        """Areas of the elements that are read."""
        return tuple(element.area for element in self.photodiodes)

    @property
    def barrier_gap_mm(self) -> float | None:
        """From the first wall to the LED nearest to it; None without a wall. [mm]"""
        return min(-self.barriers[0].overlap_mm(led) for led in self.leds) if self.barriers else None


@lru_cache(LAYOUTS_KEPT)
def lay_out(finger: Finger, board: Board, leds: tuple[Led, ...], photodiodes: tuple[Photodiode, ...]) -> Layout:
    """The layout of the board on a finger's nail; raises ValueError where it is impossible."""
    dies = tuple(
        Rectangle.around(led.name, board.on_nail(led.position_mm), led.size_mm, led.rotation_deg) for led in leds
    )
    wired, unwired = lay_elements(board, photodiodes)
    for what, one in [*(("leds", led) for led in leds), *(("photodiodes", diode) for diode in photodiodes)]:
        if one.height_um > board.clear_epoxy_um - LEAST_EPOXY_UM:
            tall = f'{what} "{one.name}": height_um = {one.height_um:g} leaves less than {LEAST_EPOXY_UM:g} um'
            raise ValueError(f"{tall} of the clear epoxy, {board.clear_epoxy_um:g} um deep; make clear_epoxy_um more")
    parts = [(f'leds "{r.name}"', r) for r in dies] + [(f'photodiode "{e.name}"', e.area) for e in wired]
    parts += [(f'photodiode element "{r.name}"', r) for r in unwired]
    unplaced = [f'leds "{led.name}"' for led in leds if "position_mm" not in led.model_fields_set]
    for (name, r), (other_name, other) in _side_by_side(parts):
        if (depth_mm := r.overlap_mm(other)) > ROUNDING_MM:
            cure = "move one of them" if name not in unplaced else "it was not given and is (0, 0), give it"
            raise ValueError(f"{name}: position_mm lies {depth_mm:.3g} mm inside {other_name}; {cure}")
    outline = _outline(board, border := _border(board), parts, finger)
    u, v = (outline.u_min, outline.u_max), (outline.v_min, outline.v_max)
    for axis, (low, high), size in (("wide", u, finger.nail_width_mm), ("long", v, finger.nail_length_mm)):
        if low < -size / 2 + NAIL_MARGIN_MM or high > size / 2 - NAIL_MARGIN_MM:
            what, cure = f"board: {low:.2f} to {high:.2f} mm", "; make the board smaller or move its center_mm"
            if board.size_mm is None:
                name, r = max(parts, key=lambda part: np.abs(part[1].corners_mm).max(0)[int(axis == "long")])
                what, cure = "{} at ({:.4g}, {:.4g}) mm, with board beside it,".format(name, *r.center_mm), "; move it"
            raise ValueError(f"{what} does not fit on the nail, which is {size:g} mm {axis}{cure}")
    barriers = _barriers(board, dies, [e.area for e in wired] + unwired, outline) if board.barrier else ()
    # What is not wired stands in the way like what is; the highest stands for all.
    height_um = max((p.height_um for p in photodiodes if p.wired is not None), default=0.0)
    return Layout(outline, dies, tuple(wired), tuple(unwired), height_um, barriers, border)


def room_of(part: Led | Photodiode, center_mm: Point, spare_mm: float = 0.0) -> Rectangle:
    """What a part takes of a board where it has its centre: its courtyard, and its body, or its dies where none is
    known, with so much beside it. [mm]"""
    u, v = part.size_mm[0], part.length_mm
    boxes = [(-u / 2, -v / 2, u / 2, v / 2), *([part.body_mm] if part.body_mm else [])]
    corners = np.concatenate([np.reshape(boxes, (-1, 2)) + sign * spare_mm for sign in (-1, 1)])
    corners = np.concatenate([corners, np.reshape(part.courtyard_mm or (), (-1, 2))])
    low, high = corners.min(0), corners.max(0)
    aside = turned(tuple(((low + high) / 2).tolist()), part.rotation_deg)
    place = center_mm[0] + aside[0], center_mm[1] + aside[1]
    return Rectangle.around(part.name, place, tuple((high - low).tolist()), part.rotation_deg)


def _side_by_side(parts: list[tuple[str, Rectangle]]) -> Iterator[tuple[tuple[str, Rectangle], tuple[str, Rectangle]]]:
    """Pairs of parts whose boxes along the axes overlap: of a thousand parts few of half a million."""
    low, high = (np.array([[getattr(r, f"{axis}_{end}") for axis in "uv"] for _, r in parts]) for end in ("min", "max"))
    u, v = (np.minimum.outer(b, b) > np.maximum.outer(a, a) for a, b in zip(low.T, high.T, strict=True))
    for i, j in np.argwhere(np.triu(u & v, 1)):
        yield parts[i], parts[j]


def _border(board: Board) -> Border:
    """The drawn border and its holes, in nail coordinates; none of a board without a drawing, or a rectangle. [mm]"""
    lines = (board.outline_mm, *board.outline_holes_mm) if board.outline_mm else ()
    if len(lines) == 1 and np.prod(np.ptp(lines[0], axis=0)) - abs(area_mm2(lines[0])) < ROUNDING_MM:
        return ()
    return shifted(lines, board.center_mm)


def _outline(board: Board, border: Border, parts: list[tuple[str, Rectangle]], finger: Finger) -> Rectangle:
    """The board's edges: its size, its file's outline as far as the nail goes, or enough for its parts."""
    if board.size_mm is not None:
        outline = Rectangle.around("board", board.center_mm, board.size_mm)
    else:
        if board.outline_mm is not None:
            # What reaches beyond the nail, such as the tail to a connector, ends at its edge.
            half = np.array([finger.nail_width_mm, finger.nail_length_mm]) / 2 - NAIL_MARGIN_MM
            corners = np.clip(np.add(board.outline_mm, board.center_mm), -half, half)
        else:
            boxes = np.array([(r.u_min, r.v_min, r.u_max, r.v_max) for _, r in parts]).reshape(-1, 2)
            corners = np.concatenate([boxes - BOARD_MARGIN_MM, boxes + BOARD_MARGIN_MM])
        (u_min, v_min), (u_max, v_max) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        outline = Rectangle("board", u_min, u_max, v_min, v_max)
    for name, r in parts:
        across = min(r.u_min - outline.u_min, outline.u_max - r.u_max)
        off = min(across, r.v_min - outline.v_min, outline.v_max - r.v_max) < ROUNDING_MM
        # Along the part's own edges.
        edges = [[turned(corner, -r.rotation_deg) for corner in line] for line in border]
        half_mm = (r.size_mm[0] / 2, r.size_mm[1] / 2)
        if off or (border and not has_room(turned(r.center_mm, -r.rotation_deg), half_mm, edges[0], edges[1:])):
            cure = "move it or enlarge board.size_mm"
            if board.outline_mm is not None:
                cure = "move it, or give board.origin, the point of the file on the nail's centre"
            u, v = (round(x, 2) + 0.0 for x in r.center_mm)
            where = f"{name} at ({u:g}, {v:g}) mm"
            raise ValueError(f"{where} reaches over the edge of the board, of a hole in it or of the nail; {cure}")
    return outline


def lay_elements(board: Board, photodiodes: tuple[Photodiode, ...]) -> tuple[list[Element], list[Rectangle]]:
    """Photodiode elements that are read, and those that are there but not wired."""
    wired: list[Element] = []
    unwired: list[Rectangle] = []
    for photodiode in photodiodes:
        u, v = board.on_nail(photodiode.position_mm)
        resistors = iter(photodiode.feedback_ohm) if isinstance(photodiode.feedback_ohm, tuple) else None
        pitch = photodiode.pitch_mm or photodiode.size_mm[1]
        for i, name in enumerate(photodiode.element_names()):
            along, up = turned((0.0, (i - (photodiode.elements - 1) / 2) * pitch), photodiode.rotation_deg)
            area = Rectangle.around(name, (u + along, v + up), photodiode.size_mm, photodiode.rotation_deg)
            if i in photodiode.wired_elements:
                one = photodiode.model_copy(update={"feedback_ohm": next(resistors)}) if resistors else photodiode
                wired.append(Element(area, one))
            else:
                unwired.append(area)
    return wired, unwired


def span_mm(area: Rectangle, side: str) -> tuple[float, float]:
    """The edges of a part along the way from LEDs on a side to their photodiodes: the near one, then the far one."""
    axis, way = SIDES[side]
    low, high = (area.v_min, area.v_max) if axis else (area.u_min, area.u_max)
    return (low, high) if way > 0 else (-high, -low)


def _barriers(
    board: Board, leds: tuple[Rectangle, ...], photodiodes: list[Rectangle], outline: Rectangle
) -> tuple[Rectangle, ...]:
    """Straight walls over the whole board, each at the requested gap from the LEDs on one side, or midway."""
    width, beside = board.barrier_um * 1e-3, board.barrier_gap_mm
    nearest = {side: min(span_mm(r, side)[0] for r in photodiodes) for side in SIDES}
    faced: dict[str, list[float]] = {side: [] for side in SIDES}
    for led in leds:
        gaps = {side: nearest[side] - span_mm(led, side)[1] for side in SIDES}
        side: str = board.barrier_side or max(gaps, key=lambda key: gaps[key])
        if gaps[side] < width + (beside or 0.0) + WALL_ROOM_MM:
            needed = f"a wall of {width:g} mm{f' at a gap of {beside:g} mm' if beside else ''}"
            why = f"no room for {needed}; move it, make barrier_um smaller, or set barrier = false"
            gap = f"{max(gaps[side], 0):.3g} mm beside the photodiodes"
            raise ValueError(f'board.barrier: LED "{led.name}" lies {gap}, which leaves {why}')
        faced[side].append(span_mm(led, side)[1])
    walls = []
    for side, edges in faced.items():
        if edges:
            (axis, way), edge = SIDES[side], max(edges)
            middle = way * ((edge + nearest[side]) / 2 if beside is None else edge + (beside + width / 2))
            ends = [(outline.u_min, outline.u_max), (outline.v_min, outline.v_max)]
            ends[axis] = (middle - width / 2, middle + width / 2)
            walls.append(Rectangle(side, *ends[0], *ends[1]))
    for wall, led in product(walls, leds):
        if wall.overlap_mm(led) > ROUNDING_MM:
            raise ValueError(f'board.barrier: the wall would cut LED "{led.name}"; move it or set barrier = false')
    return tuple(walls)
