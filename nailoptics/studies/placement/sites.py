"""Where a search may put LEDs and photodiodes: rows of LEDs along a wall, and the places that the rules leave."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.sparse import csr_array

from ...scene import Led, Photodiode, Placement, Scene
from ...scene.base import Point
from ...scene.layout import SIDES, WALL_ROOM_MM, lay_elements, room_of, span_mm
from ...scene.rectangles import Rectangle, has_room
from . import boards

# A wall that leaves less than this fraction of the board to the photodiodes is not tried.
LEAST_ROOM = 0.4
ROUNDING_MM = 1e-9
# Places of an LED whose light is traced on one board, and how far its dies lie apart there. [mm]
TOGETHER, APART_MM = 8, 0.05
# Parts of the room that regular photodiodes take.
PARTS = (1.0, 2 / 3, 1 / 3)


@dataclass(frozen=True)
class LedRow:
    """LEDs that share a wall: the side of the photodiodes on which they lie, None on a board without walls, and where
    the edge of the nearest of them lies that faces the wall. [mm]"""

    side: str | None = None
    face_mm: float = 0.0


@dataclass(frozen=True)
class PhotodiodePlaces:
    """Where a photodiode may lie, and after these where those lie that stay.

    areas : (free + s,) places, of one photodiode each. photodiodes : what each of them is.
    spacing_mm : the least of two of the free ones, across or along. [mm]
    """

    areas: tuple[Rectangle, ...]
    photodiodes: tuple[Photodiode, ...]
    free: int
    spacing_mm: Point

    @cached_property
    def centers_mm(self) -> np.ndarray:
        """Centres of the free places, (free, 2) float. [mm]"""
        return np.array([area.center_mm for area in self.areas[: self.free]]).reshape(-1, 2)

    @cached_property
    def exclude(self) -> np.ndarray:
        """Which of the free places exclude each other, and each itself, (free, free) bool."""
        (u, v), (across_mm, along_mm) = self.centers_mm.T, np.array(self.spacing_mm) - 1e-9
        near = (np.abs(u - u[:, None]) < across_mm) & (np.abs(v - v[:, None]) < along_mm)
        return near | np.eye(self.free, dtype=bool)

    @cached_property
    def windows(self) -> csr_array:
        """Which of the free places (columns) exclude one (rows) that is no further across or along: each other, too."""
        u, v = self.centers_mm.T
        return csr_array((self.exclude & (u > u[:, None] - 1e-9) & (v > v[:, None] - 1e-9)).astype(float))

    def in_rows(
        self, count: int, axis: int, middle_mm: float, step_mm: float, allowed: np.ndarray | None
    ) -> list[list[int]]:
        """Free places in equal rows that are symmetric about a middle along the other axis and take all of the room, or
        two thirds or one third of it: each choice of as many."""
        (across, along), spacing = self.centers_mm[:, [axis, 1 - axis]].T, np.array(self.spacing_mm)[[axis, 1 - axis]]
        # Steps from the first place on, and half steps to either side of the middle.
        ahead, aside = (across - across.min()) / step_mm, 2 * (along - middle_mm) / step_mm
        usable = (np.abs(aside - np.rint(aside)) < 1e-6) & (True if allowed is None else allowed)
        ahead, aside = np.rint(ahead).astype(int), np.rint(aside).astype(int)
        most, half = ahead.max(), np.abs(aside).max()
        table = np.full((most + 1, 2 * half + 1), -1)
        table[ahead[usable], half + aside[usable]] = np.flatnonzero(usable)
        patterns = []
        for columns in (n for n in range(1, count + 1) if count % n == 0):
            rows = count // columns
            for part, of_aside, start, less in product(PARTS, PARTS, (0.5, 0.0, 1.0), (0, 1)):
                # Of rows that are an even number only every other distance has them on places.
                steps = int(part * most / max(columns - 1, 1)), int(of_aside * half / max(rows - 1, 1)) - less
                close = step_mm * np.array(steps) < spacing - 1e-9
                if (columns > 1 and close[0]) or (rows > 1 and close[1]):
                    continue
                first = int(start * (most - steps[0] * (columns - 1)))
                lines = first + steps[0] * np.arange(columns), half + steps[1] * (2 * np.arange(rows) - rows + 1)
                cells = table[np.ix_(*lines)].ravel().tolist()
                if min(cells) >= 0:
                    patterns.append(cells)
        return patterns

    def is_straight(self, places: list[int]) -> bool:
        """Whether free places lie in one straight row."""
        return bool((np.ptp(self.centers_mm[places], axis=0) < ROUNDING_MM).any())


@dataclass(frozen=True)
class Sites:
    """The places that a scene's board and the rules of its search leave."""

    base: Scene
    rules: Placement

    @cached_property
    def outline(self) -> Rectangle:
        """The board's edges."""
        size = self.base.board.size_mm
        assert size is not None
        return Rectangle.around("board", self.base.board.center_mm, size)

    @cached_property
    def is_fixed(self) -> tuple[bool, ...]:
        """Of each LED whether it stays where it is."""
        return tuple(led.name in self.rules.fixed for led in self.base.leds)

    @cached_property
    def _fixed(self) -> list[Rectangle]:
        """Elements that are read of photodiodes that stay."""
        fixed, _ = boards.fixed_and_loose(self.base, self.rules)
        return [element.area for element in lay_elements(self.base.board, fixed)[0]]

    @cached_property
    def elements(self) -> tuple[Rectangle, ...]:
        """Of which the search wires some: all elements of the scene's photodiodes that are not fixed."""
        loose = boards.fixed_and_loose(self.base, self.rules)[1] if self.rules.wire else ()
        wired = tuple(photodiode.model_copy(update={"wired": None}) for photodiode in loose)
        return tuple(element.area for element in lay_elements(self.base.board, wired)[0])

    def obstacles(self, spare_mm: float = 0.0) -> list[Rectangle]:
        """The room of every photodiode that stays, as of `room_of`."""
        staying = (p for p in self.base.photodiodes if self.rules.wire or p.name in self.rules.fixed)
        return [room_of(p, self.base.board.on_nail(p.position_mm), spare_mm) for p in staying]

    def die(self, led: int, place_mm: Point) -> Rectangle:
        """An LED's die at a place."""
        one = self.base.leds[led]
        return Rectangle.around(one.name, place_mm, one.size_mm, one.rotation_deg)

    def room(self, led: int, place_mm: Point) -> Rectangle:
        """What an LED takes at a place, with half of the clearance to another."""
        return room_of(self.base.leds[led], place_mm, self.rules.clearance_mm / 2)

    def _room_beside(self, led: int, place_mm: Point) -> Rectangle:
        """`room` with what photodiodes leave to a bare die for its bond wire, less half of their clearance."""
        one, half_mm = self.base.leds[led], self.rules.clearance_mm / 2
        return room_of(one, place_mm, half_mm if one.body_mm or one.courtyard_mm else self.rules.bond_wire_mm - half_mm)

    def place_of(self, led: int) -> Point:
        """Where the scene has an LED."""
        return self.base.board.on_nail(self.base.leds[led].position_mm)

    def may_lie(self, led: int, place_mm: Point) -> bool:
        """Whether an LED may lie at a place of the board, photodiodes that are still to be placed aside."""
        beside, others = self._room_beside(led, place_mm), self.obstacles(self.rules.clearance_mm / 2)
        inside = self._is_inside(self.base.leds[led], place_mm)
        return inside and all(-beside.overlap_mm(other) >= -ROUNDING_MM for other in others)

    def _is_inside(self, part: Led | Photodiode, place_mm: Point) -> bool:
        """Whether a straight part at a place leaves its distance to edge and holes, and lies off what is kept out."""
        rules, o, r = self.rules, self.outline, room_of(part, place_mm, self.rules.edge_mm)
        if min(r.u_min - o.u_min, o.u_max - r.u_max, r.v_min - o.v_min, o.v_max - r.v_max) < -ROUNDING_MM:
            return False
        # Other parts of the board's file keep their clearance, too.
        own = room_of(part, place_mm, rules.clearance_mm if self.base.board.taken_mm else 0.0)
        half_mm, own_half_mm = ((one.size_mm[0] / 2, one.size_mm[1] / 2) for one in (r, own))
        if not has_room(own.center_mm, own_half_mm, own.corners_mm, rules.keep_out_mm):
            return False
        drawn = rules.outline_mm
        return drawn is None or has_room(r.center_mm, half_mm, drawn, rules.outline_holes_mm)

    def go_together(self, places_mm: Sequence[Point]) -> bool:
        """Whether LEDs at these places, in the scene's order, leave their clearance to each other."""
        rooms = [self.room(i, place) for i, place in enumerate(places_mm)]
        pairs = ((i, j) for j in range(len(rooms)) for i in range(j) if not (self.is_fixed[i] and self.is_fixed[j]))
        return all(-rooms[i].overlap_mm(rooms[j]) >= -ROUNDING_MM for i, j in pairs)

    def grid(self, step_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Places of LEDs across and along the board. [mm]"""
        free = [self.die(i, (0.0, 0.0)).size_mm for i, fixed in enumerate(self.is_fixed) if not fixed]
        return self._axes(step_mm, np.array(free).max(0))

    def _axes(self, step_mm: float, size_mm: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """Places of parts of a size across and along the board, symmetric about its middle. [mm]"""
        room_mm = np.array(self.outline.size_mm) - size_mm - 2 * self.rules.edge_mm
        halves = np.floor(room_mm / 2 / step_mm + 1e-9).astype(int)
        u, v = (x + step_mm * np.arange(-n, n + 1) for x, n in zip(self.outline.center_mm, halves, strict=True))
        return u, v

    def rows(self, step_mm: float) -> dict[LedRow, list[list[Point]]]:
        """Rows on a grid and through the first LED as drawn, as the grid may miss sides of a small board, with all
        LEDs' places. Walls along the nail, where blood zones follow each other, promise most and come first."""
        count = len(self.base.leds)
        us, vs = np.empty((2, 0))
        if False in self.is_fixed:
            us, vs = map(np.union1d, self.grid(step_mm), np.round(self.place_of(self.is_fixed.index(False)), 4))
        special = self.rules.outline_mm is not None or self.rules.keep_out_mm or self.rules.fixed or self.rules.wire
        # A layout and its mirror image are one; of several LEDs only all together have a mirror image.
        is_symmetric = not special and abs(self.outline.u_min + self.outline.u_max) < 1e-6
        half_us = us[us <= 1e-6] if is_symmetric else us
        if not self.base.board.barrier:
            places = [(float(u), float(v)) for u in (half_us if count == 1 else us) for v in vs]
            return self._with_room({LedRow(): [places] * count})
        rows: dict[LedRow, list[list[Point]]] = {}
        for side, (axis, _) in SIDES.items():
            middles, along = (vs, half_us) if axis else (half_us, vs)
            if count > 1:
                along = self._room_for_all(us if axis else vs, 1 - axis, step_mm)
            for row in self._rows_at(side, middles):
                rows[row] = [[self.in_row(i, row, float(x)) for x in along] for i in range(count)]
        return self._with_room(rows)

    def _room_for_all(self, along: np.ndarray, axis: int, step_mm: float) -> np.ndarray:
        """Places along a row, on a grid so fine that as many LEDs as there are have room in it side by side."""
        free = [self.room(i, (0.0, 0.0)).size_mm[axis] for i, fixed in enumerate(self.is_fixed) if not fixed]
        while len(along) < len(free) and step_mm / 2 >= max(free):
            step_mm /= 2
            along = self.grid(step_mm)[axis]
        return along

    def _rows_at(self, side: str, middles: np.ndarray) -> list[LedRow]:
        """Rows of a side with the first free LED's middle at each place, and one at the edge of what is fixed."""
        fixed, way = self._fixed_face(side), SIDES[side][1]
        faces = [] if fixed is None else [way * fixed]
        if len(middles):
            first = self.die(self.is_fixed.index(False), (0.0, 0.0))
            faces += [float(x) + way * span_mm(first, side)[1] for x in middles]
        return [LedRow(side, face) for face in dict.fromkeys(faces)]

    def _fixed_face(self, side: str) -> float | None:
        """Of the LEDs that stay, the edge that is nearest to photodiodes, as `span_mm`; None if none does."""
        dies = [self.die(i, self.place_of(i)) for i, fixed in enumerate(self.is_fixed) if fixed]
        return max((span_mm(die, side)[1] for die in dies), default=None)

    def _with_room(self, rows: dict[LedRow, list[list[Point]]]) -> dict[LedRow, list[list[Point]]]:
        """The rows whose wall leaves room, with the places where each LED may lie; a fixed one lies where it is."""
        left: dict[LedRow, list[list[Point]]] = {}
        for row, places in rows.items():
            by_led = [
                [self.place_of(i)] if self.is_fixed[i] else [p for p in place if self.may_lie(i, p)]
                for i, place in enumerate(places)
            ]
            if all(by_led) and self.leaves_room(row):
                left[row] = by_led
        return left

    def in_row(self, led: int, row: LedRow, along_mm: float) -> Point:
        """An LED's place in a row with a wall: its edge at the row's face."""
        assert row.side is not None
        axis, way = SIDES[row.side]
        across = row.face_mm - way * span_mm(self.die(led, (0.0, 0.0)), row.side)[1]
        return (along_mm, across) if axis else (across, along_mm)

    def leaves_room(self, row: LedRow) -> bool:
        """Whether a row's wall leaves enough of the board, and lies between all LEDs and photodiodes that stay."""
        if row.side is None:
            return True
        axis, way = SIDES[row.side]
        face, fixed = way * row.face_mm, self._fixed_face(row.side)
        if fixed is not None and face < fixed - ROUNDING_MM:
            return False
        room = span_mm(self.outline, row.side)[1] - face
        if room <= LEAST_ROOM * self.outline.size_mm[axis] and not self.obstacles():
            return False
        behind = face + self.gap_mm(row.side) + self.base.board.barrier_um * 1e-3 + WALL_ROOM_MM
        return all(span_mm(obstacle, row.side)[0] - behind >= -ROUNDING_MM for obstacle in self.obstacles())

    def gap_mm(self, side: str) -> float:
        """From the LEDs' face to their wall: the board's gap, or what their bodies with the clearance need."""
        gap, at = self.base.board.barrier_gap_mm, (0.0, 0.0)
        gaps = [self.rules.bond_wire_mm if gap is None else gap]
        for i, led in enumerate(self.base.leds):
            if led.body_mm or led.courtyard_mm:
                room = room_of(led, at, self.rules.clearance_mm)
                gaps.append(span_mm(room, side)[1] - span_mm(self.die(i, at), side)[1])
        return max(gaps)

    def apart(self, led: int, places_mm: Iterable[Point]) -> list[list[Point]]:
        """Places of an LED in groups that one board has room for; each by itself for one that stands out of it."""
        groups: list[list[Point]] = []
        most = 1 if self.base.leds[led].height_um else TOGETHER
        for place in places_mm:
            die = self.die(led, place)
            beside = (g for g in groups if all(-die.overlap_mm(self.die(led, other)) > APART_MM for other in g))
            if (group := next((g for g in beside if len(g) < most), None)) is None:
                groups.append(group := [])
            group.append(place)
        return groups

    def board_at(self, led: int, places_mm: Sequence[Point], row: LedRow) -> Scene:
        """The bare board with one of its LEDs at each of some places of a row, and the wall of that."""
        (du, dv), board = self.base.board.center_mm, self.base.board
        if row.side is not None:
            edge = span_mm(self.die(led, places_mm[0]), row.side)[1]
            gap = self.gap_mm(row.side) + SIDES[row.side][1] * row.face_mm - edge
            board = board.model_copy(update={"barrier_gap_mm": gap})
        # LEDs that shine alike share their light, whatever their names.
        moved = [{"position_mm": (u - du, v - dv), "name": f"led{k}"} for k, (u, v) in enumerate(places_mm)]
        leds = tuple(self.base.leds[led].model_copy(update=update) for update in moved)
        return boards.bare_board(self.base.model_copy(update={"leds": leds, "board": board}), side=row.side)

    def photodiode_places(self, walls: Sequence[Rectangle], leds_mm: Mapping[int, Point]) -> PhotodiodePlaces:
        """The places that walls and, where there are none, LEDs at places leave to photodiodes."""
        areas = list(self.elements if self.rules.wire else self._grid_areas)
        of_one = room_of(self._like, (0.0, 0.0), self.rules.clearance_mm / 2)
        spacing = (0.0, 0.0) if self.rules.wire else of_one.size_mm
        free = np.ones(len(areas), bool)
        for wall in [] if self.rules.wire else walls:
            axis, way = SIDES[wall.name]
            near = self._bounds_mm(areas)[:, axis if way > 0 else axis + 2] * way
            behind = span_mm(wall, wall.name)[1] + max(self.rules.clearance_mm, WALL_ROOM_MM)
            free &= near >= behind - ROUNDING_MM
        free &= bool(walls) | self.are_beside(areas, leds_mm)
        areas = [areas[k] for k in np.flatnonzero(free)]
        by_name = {name: photodiode for photodiode in self.base.photodiodes for name in photodiode.element_names()}
        by_name |= {e.name: e.photodiode for e in lay_elements(self.base.board, self.base.photodiodes)[0]}
        kinds = [by_name.get(area.name, self.base.photodiodes[0]) for area in (*areas, *self._fixed)]
        return PhotodiodePlaces((*areas, *self._fixed), tuple(kinds), len(areas), spacing)

    def are_beside(self, areas: Sequence[Rectangle], leds_mm: Mapping[int, Point]) -> np.ndarray:
        """Which photodiodes (m,) leave LEDs at these places, by number, their room, without walls, (m,) bool."""
        return self._are_clear(areas, (self._room_beside(i, place) for i, place in leds_mm.items()))

    def _are_clear(self, areas: Sequence[Rectangle], others: Iterable[Rectangle]) -> np.ndarray:
        """Which photodiodes (m,) lie off all of some others, by their bounds, (m,) bool."""
        u_min, v_min, u_max, v_max = self._bounds_mm(areas, self.rules.clearance_mm / 2).T
        clear = np.ones(len(areas), bool)
        for r in others:
            across = np.maximum(u_min - r.u_max, r.u_min - u_max)
            clear &= np.maximum(across, np.maximum(v_min - r.v_max, r.v_min - v_max)) >= -ROUNDING_MM
        return clear

    def _bounds_mm(self, areas: Sequence[Rectangle], spare_mm: float = 0.0) -> np.ndarray:
        """What photodiodes take at these areas, (m, 4) float: u_min, v_min, u_max, v_max. [mm]"""
        if self.rules.wire or not areas:
            bounds = np.array([(a.u_min, a.v_min, a.u_max, a.v_max) for a in areas]).reshape(-1, 4)
            return bounds + spare_mm * np.array([-1, -1, 1, 1])
        r = room_of(self._like, (0.0, 0.0), spare_mm)
        return np.tile([a.center_mm for a in areas], 2) + (r.u_min, r.v_min, r.u_max, r.v_max)

    @cached_property
    def _grid_areas(self) -> tuple[Rectangle, ...]:
        """Every place of a photodiode on the board, beside those that stay."""
        size_mm = Rectangle.around("", (0.0, 0.0), self._like.size_mm, self._like.rotation_deg).size_mm
        places = product(*(axis.tolist() for axis in self._axes(self.rules.photodiode_step_mm, size_mm)))
        areas = [Rectangle.around("", place, size_mm) for place in places]
        clear = self._are_clear(areas, self.obstacles(self.rules.clearance_mm / 2))
        return tuple(areas[k] for k in np.flatnonzero(clear) if self._is_inside(self._like, areas[k].center_mm))

    @cached_property
    def _like(self) -> Photodiode:
        """What is placed, straight: the scene's first photodiode, of an array one element."""
        return boards.single(boards.straightened(self.base.photodiodes[0]))
