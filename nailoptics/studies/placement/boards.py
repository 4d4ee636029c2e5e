"""The board of a search or a given layout: on every finger, with its outline and wall spelled out, and bare; what a
search may move on it; and layouts to rank, given ones and those of a search, as scenes on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, count, product
from typing import Any, TypeVar

import numpy as np

from ...errors import InputError
from ...scene import Candidate, Finger, FingerCase, Led, Photodiode, Placement, Scene
from ...scene.base import Point, shifted
from ...scene.finger import ABSORBING, SCATTERING
from ...scene.importers.board_files import View
from ...scene.importers.outlines import has_room
from ...scene.layout import SIDES, lay_elements, room_of
from ...scene.parts import ROOM, check_one_response
from ...scene.rectangles import Rectangle
from ..prior_uncertainty import at_value, draw_people

PartT = TypeVar("PartT", Led, Photodiode)

NAIL_MARGIN_MM = 0.1
# No board that bears an LED and a photodiode is narrower.
LEAST_BOARD_MM = 1.0
# A bare board carries one photodiode, because every scene has one; this one is too small to matter.
SPECK, SPECK_MM, SPECK_PLACES = "speck", 0.05, 33
# Bodies and courtyards that overlap by less do not. [mm]
OVERLAP_MM = 1e-3
# Places are rounded to so many decimals of a millimetre, below which sums of floats differ. [1]
DECIMALS = 9
# LEDs that a search places together.
MOST_LEDS = 4
# One die in place of an array.
UNFITTED = {"feedback_ohm": None}
SINGLE = {"reference": None, "part": None, "wired": None, "elements": 1, "pitch_mm": None} | UNFITTED
# Of simple layouts, and the part of it by which a place may be off.
GRID_MM, ON_GRID = 0.25, 1e-3


def rules(scene: Scene) -> Placement:
    """The scene's [placement], or the usual rules; where they give no outline, that of the board's own file, whose
    other parts are kept out, too."""
    placement, board = scene.placement or Placement(), scene.board
    taken = shifted(board.taken_mm or (), board.center_mm)
    update: dict[str, object] = {"keep_out_mm": (*placement.keep_out_mm, *taken)}
    if placement.outline_mm is None and board.outline_mm is not None:
        corners, *holes = shifted((board.outline_mm, *board.outline_holes_mm), board.center_mm)
        update |= {"outline_mm": corners, "outline_holes_mm": tuple(holes)}
    return placement.model_copy(update=update)


def check_two_zones(scene: Scene, command: str) -> None:
    """Raise InputError for a scene without a board, or whose blood is in more than two zones."""
    if scene.finger is None:
        raise InputError(f"{command} needs a [finger] scene; a phantom has no board and no force.")
    scene.require_blood(command)
    if (zones := len(scene.zone_edges_mm) + 1) > 2:
        raise InputError(
            f"blood: {command} knows two blood zones, and the scene has {zones}; leave zones out, or give one edge."
        )


def fingers(scene: Scene) -> tuple[FingerCase, ...]:
    """The fingers that a layout must serve."""
    return rules(scene).fingers or (FingerCase(name=scene.fingertip.digit),)


@dataclass(frozen=True)
class Person:
    """A person drawn from the priors: the first finger with values of its own, by field."""

    name: str
    first: FingerCase
    values: dict[str, float]

    @property
    def digit(self) -> str:
        """Whose light it is, as of other fingers their digit."""
        return self.name


def people(scene: Scene) -> list[Person]:
    """The people for whom layouts are ranked."""
    first, count = fingers(scene)[0], rules(scene).people
    drawn = draw_people(worn_on(scene, first), count) if count else []
    return [Person(f"person_{i}", first, values) for i, values in enumerate(drawn, 1)]


def worn_on(scene: Scene, case: FingerCase | Person, *, light_only: bool = False) -> Scene:
    """The scene on one of the fingers; on a person's, what of a board with explicit edges lies on the nail.

    light_only : change what decides where light goes, sizes, and leave what only dims it.
    """
    if isinstance(case, Person):
        scene = worn_on(scene, case.first)
        for field, value in case.values.items():
            scene = at_value(scene, field, value)
        return cut_to(scene, room_mm(scene))
    optics = {name: getattr(scene.fingertip, name) for name in (*ABSORBING, *SCATTERING)}
    finger = scene.fingertip if case.digit is None else Finger(digit=case.digit, **optics)
    if light_only:
        return scene.model_copy(update={"finger": finger})

    def given(*names: str) -> dict[str, object]:
        return {name: value for name in names if (value := getattr(case, name)) is not None}

    finger = finger.model_copy(update=given("melanin_fraction", "dermis"))
    blood = scene.blood.model_copy(update=given("rest_blood_fraction", "so2"))
    return scene.model_copy(update={"finger": finger, "blood": blood})


def base_board(scene: Scene) -> Scene:
    """The scene with its outline and the wall's gap spelled out and nothing of [placement] left.

    The outline is that of [placement], else of [board], else the smallest of the fingers' nails.
    """
    board, gap_mm = scene.board, scene.board.barrier_gap_mm
    room = room_mm(*(worn_on(scene, case) for case in fingers(scene)))
    if (drawn := rules(scene).outline_mm) is not None:
        center, size = _on_the_nail(drawn, room)
        (du, dv), lines = board.center_mm, (drawn, *rules(scene).outline_holes_mm)
        border, *holes = shifted(lines, (-du, -dv))
        update = {"outline_mm": border, "outline_holes_mm": tuple(holes)}
        scene = scene.model_copy(update={"board": board.model_copy(update=update)})
    elif board.size_mm is not None:
        center, size = board.center_mm, board.size_mm
    else:
        center, size = (0.0, 0.0), room
    return _with_edges(scene, center, size, rules(scene).bond_wire_mm if board.barrier and gap_mm is None else gap_mm)


def room_mm(*scenes: Scene) -> Point:
    """Width and length of a board for which the nails of all these scenes have room. [mm]"""
    widths, lengths = zip(
        *((f.nail_width_mm, f.nail_length_mm) for scene in scenes if (f := scene.finger)), strict=True
    )
    return min(widths) - 2 * NAIL_MARGIN_MM, min(lengths) - 2 * NAIL_MARGIN_MM


def fits(scene: Scene) -> bool:
    """Whether all parts of a board lie on the nail of its scene."""
    try:
        return bool(scene.layout)
    except InputError:
        return False


def cut_to(scene: Scene, size_mm: Point) -> Scene:
    """A board of explicit edges without what of it lies outside this size of the nail; parts stay where they are."""
    board = scene.board
    assert board.size_mm is not None
    corners = Rectangle.around("board", board.center_mm, board.size_mm).corners_mm
    cut = _with_edges(scene, *_on_the_nail(corners, size_mm), board.barrier_gap_mm)
    return bare_board(cut, side=board.barrier_side) if scene.photodiodes[0].name == SPECK else cut


def _on_the_nail(corners: Sequence[Point], room: Point) -> tuple[Point, Point]:
    """Middle and size of what of an outline's box lies on the nail; raises InputError where that is hardly any. [mm]"""
    lows, highs = (tuple(edge(axis) for axis in zip(*corners, strict=True)) for edge in (min, max))
    ends = [(max(low, -most / 2), min(high, most / 2)) for low, high, most in zip(lows, highs, room, strict=True)]
    if min(high - low for low, high in ends) < LEAST_BOARD_MM:
        middle = [round((low + high) / 2, 2) + 0.0 for low, high in zip(lows, highs, strict=True)]
        size = f"{highs[0] - lows[0]:.3g} x {highs[1] - lows[1]:.3g} mm"
        raise InputError(
            f"placement.outline: it is {size} around ({middle[0]:g}, {middle[1]:g}), "
            f"of which the nail bears less than {LEAST_BOARD_MM:g} mm; state which point lies on the nail's centre "
            '(outline_origin = "middle" or [x, y]), or the unit of a DXF that names none (outline_unit = "inch").'
        )
    (a, b), (c, d) = ends
    return ((a + b) / 2, (c + d) / 2), (b - a, d - c)


def _with_edges(scene: Scene, center_mm: Point, size_mm: Point, gap_mm: float | None) -> Scene:
    """The scene with its board's edges and the wall's gap spelled out; parts and the outline of the board's file stay
    where they are on the nail."""
    board, (du, dv) = scene.board, scene.board.center_mm
    u, v, across, along = (round(x, DECIMALS) for x in (*center_mm, *size_mm))

    def moved(places: Sequence[Point]) -> tuple[Point, ...]:
        return tuple((round(x + du - u, DECIMALS), round(y + dv - v, DECIMALS)) for x, y in places)

    update: dict[str, object] = {"center_mm": (u, v), "size_mm": (across, along), "barrier_gap_mm": gap_mm}
    if isinstance(board.origin, tuple) and board.kicad:
        view = View.of_kicad(board)
        update |= replace(view, origin_mm=view.place_in_file((u - du, v - dv))).fields
    if board.outline_mm is not None:
        update |= {"outline_mm": moved(board.outline_mm), "outline_holes_mm": tuple(map(moved, board.outline_holes_mm))}
    if board.taken_mm is not None:
        update["taken_mm"] = tuple(map(moved, board.taken_mm))
    parts = {
        kind: tuple(p.model_copy(update={"position_mm": moved([p.position_mm])[0]}) for p in getattr(scene, kind))
        for kind in ("leds", "photodiodes")
    }
    return scene.model_copy(update={"board": board.model_copy(update=update), "placement": None} | parts)


def with_explicit_walls(scene: Scene, name: str) -> Scene:
    """The same layout with outline and wall spelled out, so that they stay when its photodiodes are taken away."""
    layout = scene.layout
    if len(layout.barriers) > 1:
        raise InputError(f'layout "{name}": has walls on several sides; place takes boards with one wall or none.')
    gaps_mm = [min(-wall.overlap_mm(led) for led in layout.leds) for wall in layout.barriers]
    gap_mm = gaps_mm[0] if gaps_mm else scene.board.barrier_gap_mm
    return _with_edges(scene, layout.outline.center_mm, layout.outline.size_mm, gap_mm)


def bare_board(scene: Scene, *, side: str | None = None) -> Scene:
    """A board of explicit outline and wall without its photodiodes, the same for all layouts that share its light.

    side : on which side of the photodiodes its LEDs lie; as in the scene's layout if not given. Needed with a wall.
    """
    if side is None and scene.board.barrier:
        side = scene.layout.barriers[0].name
    size, led = scene.board.size_mm, scene.leds[0].position_mm
    assert size is not None
    reach = (size[0] / 2 - 2 * SPECK_MM, size[1] / 2 - 2 * SPECK_MM)
    if side is None:
        # The corner that is farthest from the LED.
        place = (-reach[0] if led[0] > 0 else reach[0], -reach[1] if led[1] > 0 else reach[1])
    else:
        axis, way = SIDES[side]
        place = (led[0], way * reach[1]) if axis else (way * reach[0], led[1])
    if scene.board.outline_mm is not None:
        # The place nearest to that on which there is a board.
        lines = scene.board.outline_mm, scene.board.outline_holes_mm
        places = product(*(np.linspace(-most, most, SPECK_PLACES).tolist() for most in reach))
        near = sorted(places, key=lambda at: math.dist(at, place))
        place = next((at for at in near if has_room(at, (SPECK_MM, SPECK_MM), *lines)), place)
    board = scene.board.model_copy(update={"barrier_side": side})
    speck = SINGLE | dict.fromkeys(ROOM) | {"name": SPECK, "position_mm": place, "size_mm": (SPECK_MM, SPECK_MM)}
    photodiodes = (scene.photodiodes[0].model_copy(update=speck),)
    return scene.model_copy(update={"photodiodes": photodiodes, "board": board})


def crowded(scene: Scene) -> list[str]:
    """Parts of a board's file whose bodies or courtyards overlap, or reach over an edge or another part, in words."""
    board, (du, dv) = scene.board, scene.board.center_mm
    both: tuple[Led | Photodiode, ...] = (*scene.leds, *scene.photodiodes)
    parts = [
        (p, room_of(p, (p.position_mm[0] + du, p.position_mm[1] + dv))) for p in both if p.body_mm or p.courtyard_mm
    ]
    lines = [
        f"body or courtyard of {one.name} and {other.name} overlap by {room.overlap_mm(its):.2g} mm; move one of them"
        for (one, room), (other, its) in combinations(parts, 2)
        if room.overlap_mm(its) > OVERLAP_MM
        and (one.reference or one.name).split(".")[0] != (other.reference or other.name).split(".")[0]
    ]
    border, *holes = scene.layout.border_mm or (scene.layout.outline.corners_mm,)
    off = [*holes, *shifted(board.taken_mm or (), board.center_mm)]
    for part, room in parts if board.outline_mm or board.size_mm else ():
        half_mm = (room.u_max - room.u_min) / 2 - OVERLAP_MM, (room.v_max - room.v_min) / 2 - OVERLAP_MM
        if not has_room(room.center_mm, half_mm, border, off):
            lines.append(f"body or courtyard of {part.name} reaches over an edge or another part; move it")
    return lines


def check_search(base: Scene, placement: Placement) -> None:
    """Raise InputError where a search cannot place what the scene has."""
    names = [*(led.name for led in base.leds), *(photodiode.name for photodiode in base.photodiodes)]
    for name in placement.fixed:
        if name not in names:
            raise InputError(
                f'placement.fixed: "{name}" is no LED or photodiode of the scene; it has {", ".join(names)}.'
            )
    check_one_response(base.photodiodes)
    if not placement.search:
        return
    if len(base.leds) > MOST_LEDS:
        raise InputError(
            f"placement.search places up to {MOST_LEDS} LEDs, the scene has {len(base.leds)}; set search = false and "
            "give candidates."
        )
    loose, requested = loose_photodiodes(base, placement), placement.photodiodes
    staying = tuple(photodiode for photodiode in base.photodiodes if photodiode.name in placement.fixed)
    fixed = len(lay_elements(base.board, staying)[0])
    if fixed > requested:
        raise InputError(f"placement.photodiodes = {requested}, but fixed has {fixed} of them; ask for more.")
    if placement.wire and requested - fixed > (most := sum(photodiode.elements for photodiode in loose)):
        raise InputError(
            f"placement.wire: the scene has {most} elements to choose from, fewer than the {requested - fixed} that "
            "photodiodes asks for; ask for fewer."
        )


def loose_photodiodes(base: Scene, placement: Placement) -> list[Photodiode]:
    """The scene's photodiodes that are not fixed."""
    return [photodiode for photodiode in base.photodiodes if photodiode.name not in placement.fixed]


def searchable_board(base: Scene, placement: Placement) -> Scene:
    """The board whose parts, those aside that stay where they are, lie along or across the nail; photodiodes that do
    not stay, or are wired anew, have the resistor of [electronics]."""
    stay = {*placement.fixed, *((photodiode.name for photodiode in base.photodiodes) if placement.wire else ())}
    leds = tuple(led if led.name in stay else straightened(led) for led in base.leds)
    photodiodes = tuple(
        p if p.name in placement.fixed else (p if p.name in stay else straightened(p)).model_copy(update=UNFITTED)
        for p in base.photodiodes
    )
    return base.model_copy(update={"leds": leds, "photodiodes": photodiodes})


def straightened(part: PartT) -> PartT:
    """A part that lies along or across the nail, whichever is nearer; of a module without its package."""
    of_module = dict.fromkeys(ROOM if "." in (part.reference or "") else ())
    return part.model_copy(update={"rotation_deg": 90.0 * round(part.rotation_deg / 90) % 360} | of_module)


def single(photodiode: Photodiode) -> Photodiode:
    """A photodiode for another place: of an array one element, without its package."""
    return photodiode.model_copy(update=SINGLE | dict.fromkeys(ROOM if photodiode.elements > 1 else ()))


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
    return CandidateLayout(name, scene, bare_board(with_explicit_walls(scene, name)), origin)


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
        raise InputError(
            f'layout "{plan.name}" places the LEDs {", ".join(by_name)}, but the scene has {", ".join(names)}; give '
            'each its name in parts, as D1 = { led = "led_660", name = "red" }.'
        )
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
    leds, photodiodes, like = [], [], single(base.photodiodes[0])
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
    du, dv = base.board.center_mm
    at_mm = round(place_mm[0] - du, DECIMALS), round(place_mm[1] - dv, DECIMALS)
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
            raise InputError(
                f'layout "{plan.name}": which of its LEDs {refs} is "{led.name}"? Name it so, or say it in parts, as '
                f'D1 = {{ led = "PART", name = "{led.name}" }}.'
            )
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
    parts = [photodiode for photodiode in base.photodiodes if photodiode.name in placement.fixed]
    if placement.wire:
        names = {area.name for area in photodiodes}
        for part in loose_photodiodes(base, placement):
            if wired := tuple(i for i, element in enumerate(part.element_names()) if element in names):
                parts.append(part.model_copy(update={"wired": wired if len(wired) < part.elements else None}))
    else:
        like = single(straightened(base.photodiodes[0]))
        areas = sorted(photodiodes, key=lambda area: area.center_mm[::-1])
        for area, (new, ref) in zip(areas, _named(base, placement, [a.center_mm for a in areas]), strict=True):
            parts.append(_at(base, like, area.center_mm, name=new, reference=ref))
    side, gap_mm = wall or (None, base.board.barrier_gap_mm)
    board = base.board.model_copy(update={"barrier_side": side, "barrier_gap_mm": gap_mm})
    scene = base.model_copy(update={"board": board, "leds": tuple(leds), "photodiodes": tuple(parts)})
    check(scene, name)
    return scene


def _named(base: Scene, placement: Placement, places: Sequence[Point]) -> list[tuple[str, str | None]]:
    """Names and references of photodiodes at places on the nail: of the nearest of a board's file that is like them,
    else new."""
    from scipy.optimize import linear_sum_assignment

    loose, like, (du, dv) = loose_photodiodes(base, placement), base.photodiodes[0], base.board.center_mm
    same = (1, like.part, like.size_mm, like.body_mm, like.courtyard_mm)
    alike = [p for p in loose if p.reference and (p.elements, p.part, p.size_mm, p.body_mm, p.courtyard_mm) == same]
    fixed = [p for p in base.photodiodes if p not in loose]
    taken = {word for p in (*fixed, *alike) for word in (p.name, p.reference)}
    distance_mm = np.array([[math.dist(place, np.add(p.position_mm, (du, dv))) for p in alike] for place in places])
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
