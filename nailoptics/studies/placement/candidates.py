"""Layouts to rank: given ones and those of a search, as scenes on the board."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene import Candidate, Led, Photodiode, Placement, Scene
from ...scene.base import Point
from ...scene.parts import check_one_response
from ...scene.rectangles import Rectangle
from . import boards
from .boards import DECIMALS, PartT, fixed_and_loose, straightened

# Of simple layouts, and the fraction of it by which a place may be off.
GRID_MM, ON_GRID = 0.25, 1e-3


@dataclass(frozen=True)
class CandidateLayout:
    """A layout to evaluate: the whole scene, the bare board whose light it reads, and where it came from."""

    name: str
    scene: Scene
    board: Scene
    origin: str

    @property
    def complexity(self) -> tuple[int, ...]:
        """Least for the simplest of tied layouts: parts, rows of photodiodes, whether these have no mirror image in the
        LEDs' middle, photodiodes off a grid of 0.25 mm, how far the LEDs lie from the board's edge."""
        layout = self.scene.layout
        leds, photodiodes = (np.array([r.center_mm for r in areas]) for areas in (layout.leds, layout.photodiode_areas))
        middle, places = leds.mean(0), {tuple(place) for place in np.round(photodiodes, 3)}
        images = [np.round(np.where(axis, 2 * middle - photodiodes, photodiodes), 3) for axis in ([0, 1], [1, 0])]
        rows = min(len({place[axis] for place in places}) for axis in (0, 1))
        asymmetric = all({tuple(place) for place in image} != places for image in images)
        off_grid = np.abs(photodiodes / GRID_MM - np.rint(photodiodes / GRID_MM)).max(1) > ON_GRID
        aside = np.abs(middle - layout.outline.center_mm).max() / GRID_MM
        return len(leds) + len(photodiodes), rows, int(asymmetric), int(off_grid.sum()), -round(aside)


def candidate(name: str, scene: Scene, origin: str) -> CandidateLayout:
    """A layout with its bare board; origin is "given" or "searched"."""
    return CandidateLayout(name, scene, boards.bare_board(boards.with_explicit_walls(scene, name)), origin)


def candidate_scene(base: Scene, plan: Candidate) -> Scene:
    """A candidate's layout on the board: its own parts where it says what they are, else like the scene's.

    Raises: InputError where the layout is impossible, or its LEDs are not the scene's by name.
    """
    leds, photodiodes = _parts_of(base, plan) if plan.leds else _placed_parts(base, plan)
    scene = base.model_copy(update={"leds": tuple(leds), "photodiodes": tuple(photodiodes)})
    check(scene, plan.name)
    return scene


def _parts_of(base: Scene, plan: Candidate) -> tuple[list[Led], list[Photodiode]]:
    """The parts of a candidate that says what they are, its LEDs in the scene's order."""
    names, by_name = [led.name for led in base.leds], {led.name: led for led in plan.leds}
    if set(by_name) != set(names):
        why = f'{", ".join(names)}; give each its name in parts, as D1 = {{ led = "led_660", name = "red" }}.'
        raise InputError(f'layout "{plan.name}" places the LEDs {", ".join(by_name)}, but the scene has {why}')
    leds = [_at(base, by_name[name], by_name[name].position_mm) for name in names]
    return leds, [_at(base, part, part.position_mm) for part in plan.photodiodes]


def _placed_parts(base: Scene, plan: Candidate) -> tuple[list[Led], list[Photodiode]]:
    """The scene's LEDs at a candidate's places, and photodiodes like the scene's first, turned from how those lie.

    Where references of a file are known, photodiodes are named so, else PD1 and so on.
    """
    if not plan.led_refs and len(plan.leds_mm) != len(base.leds):
        raise InputError(f'layout "{plan.name}" places {len(plan.leds_mm)} LEDs, but the scene has {len(base.leds)}.')
    leds_deg, photodiodes_deg = (
        getattr(plan, f"{kind}_deg") or [0.0] * len(getattr(plan, f"{kind}_mm")) for kind in ("leds", "photodiodes")
    )
    leds, photodiodes, like = [], [], boards.single(base.photodiodes[0])
    for led, i in zip(base.leds, _named_as(base, plan) if plan.led_refs else range(len(base.leds)), strict=True):
        reference, angle = (plan.led_refs[i][0] if plan.led_refs else led.reference, led.rotation_deg + leds_deg[i])
        leds.append(_at(base, led, plan.leds_mm[i], rotation_deg=angle % 360, reference=reference))
    refs = plan.photodiode_refs or [ref for _, ref in _named(base, Placement(), plan.photodiodes_mm)]
    for i, (place, turned, ref) in enumerate(zip(plan.photodiodes_mm, photodiodes_deg, refs, strict=True)):
        name, angle = ref if plan.photodiode_refs else f"PD{i + 1}", (like.rotation_deg + turned) % 360
        photodiodes.append(_at(base, like, place, name=name, reference=ref, rotation_deg=angle))
    return leds, photodiodes


def _at(base: Scene, part: PartT, place_mm: Point, **changes: Any) -> PartT:
    """A part at a place on the nail. [mm]"""
    at_mm = tuple(round(at - middle, DECIMALS) for at, middle in zip(place_mm, base.board.center_mm, strict=True))
    return part.model_copy(update={"position_mm": at_mm} | changes)


def _named_as(base: Scene, plan: Candidate) -> list[int]:
    """Which of a file's LEDs is each of the scene's: by reference or value, the LED's name or part."""
    if len(base.leds) == len(plan.led_refs) == 1:
        return [0]
    numbers = []
    for led in base.leds:
        names = {led.name.lower(), (led.part or led.name).lower()}
        same = [i for i, ref in enumerate(plan.led_refs) if names & {word.lower() for word in ref}]
        exact = [i for i in same if led.name.lower() in {word.lower() for word in plan.led_refs[i]}] or same
        if len(exact) != 1:
            refs = ", ".join(f"{ref} ({value})" for ref, value in plan.led_refs)
            why = f'or say it in parts, as D1 = {{ led = "PART", name = "{led.name}" }}.'
            raise InputError(f'layout "{plan.name}": which of its LEDs {refs} is "{led.name}"? Name it so, {why}')
        numbers.append(exact[0])
    if len(numbers) < len(plan.led_refs):
        raise InputError(f'layout "{plan.name}" places {len(plan.led_refs)} LEDs, but the scene has {len(base.leds)}.')
    return numbers


def searched(
    base: Scene,
    placement: Placement,
    leds_mm: Sequence[Point],
    photodiodes: Sequence[Rectangle],
    *,
    wall: tuple[str, float] | None,
    name: str,
) -> Scene:
    """The board with its LEDs at places on the nail, and the search's photodiodes beside those that are fixed.

    photodiodes : areas of new ones, or where elements are wired, those by name.
    wall : side of the photodiodes on which the LEDs lie behind their wall, and its gap to the nearest; None without.
    """
    leds = [_at(base, led, place) for led, place in zip(base.leds, leds_mm, strict=True)]
    fixed, loose = fixed_and_loose(base, placement)
    parts = [*fixed]
    if placement.wire:
        names = {area.name for area in photodiodes}
        for part in loose:
            if wired := tuple(i for i, element in enumerate(part.element_names()) if element in names):
                parts.append(part.model_copy(update={"wired": wired if len(wired) < part.elements else None}))
    else:
        like = boards.single(straightened(base.photodiodes[0]))
        areas = sorted(photodiodes, key=lambda area: area.center_mm[::-1])
        for area, (new, ref) in zip(areas, _named(base, placement, [a.center_mm for a in areas]), strict=True):
            parts.append(_at(base, like, area.center_mm, name=new, reference=ref))
    side, gap_mm = wall or (None, base.board.barrier_gap_mm)
    board = base.board.model_copy(update={"barrier_side": side, "barrier_gap_mm": gap_mm})
    scene = base.model_copy(update={"board": board, "leds": tuple(leds), "photodiodes": tuple(parts)})
    check(scene, name)
    return scene


def _named(base: Scene, placement: Placement, places: Sequence[Point]) -> list[tuple[str, str | None]]:
    """Names and references of photodiodes at places on the nail: of the nearest alike in a board's file, else new."""
    from scipy.optimize import linear_sum_assignment

    (_, loose), like = fixed_and_loose(base, placement), base.photodiodes[0]
    same = (1, like.part, like.size_mm, like.body_mm, like.courtyard_mm)
    alike = [p for p in loose if p.reference and (p.elements, p.part, p.size_mm, p.body_mm, p.courtyard_mm) == same]
    # What a file has stays on its board, whether its light is searched or not.
    kept = [p for p in base.photodiodes if p.reference or p not in loose]
    taken = {word for p in kept for word in (p.name, p.reference)}
    distance_mm = np.array([[math.dist(place, base.board.on_nail(p.position_mm)) for p in alike] for place in places])
    nearest = dict(zip(*linear_sum_assignment(distance_mm.reshape(len(places), len(alike))), strict=True))
    new = (name for name in (f"PD{i}" for i in count(1)) if name not in taken)
    return [
        (alike[nearest[i]].name, alike[nearest[i]].reference) if i in nearest else (next(new), None)
        for i in range(len(places))
    ]


def check(scene: Scene, name: str) -> None:
    """Raise InputError unless the scene's board can be laid out, and read from a map."""
    try:
        _ = scene.layout
    except InputError as error:
        raise InputError(f'layout "{name}": {error}') from None
    check_one_response(scene.photodiodes)
