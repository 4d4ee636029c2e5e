"""Layouts as scenes: boards with an explicit outline and wall, with photodiodes or bare, on every finger."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, TypeVar

import numpy as np

from ...errors import InputError
from ...scene import Board, Candidate, Finger, FingerCase, Led, Photodiode, Placement, Scene
from ...scene.base import Point
from ...scene.finger import ABSORBING, SCATTERING
from ...scene.layout import lay_elements
from ...scene.parts import check_one_response
from ...scene.rectangles import Rectangle

Places = Sequence[tuple[float, float]]
PartT = TypeVar("PartT", Led, Photodiode)

# LEDs that a search places together.
MOST_LEDS = 4

NAIL_MARGIN_MM = 0.1
# No board that bears an LED and a photodiode is narrower.
LEAST_BOARD_MM = 1.0
# A bare board carries one photodiode, because every scene has one; this one is too small to matter.
SPECK_MM = 0.05
FAR_SIDE = {"left": (1, 0), "right": (-1, 0), "below": (0, 1), "above": (0, -1)}
# One die in place of an array.
SINGLE = {"reference": None, "part": None, "wired": None, "elements": 1, "pitch_mm": None}


@dataclass(frozen=True)
class CandidateLayout:
    """A layout to judge: the whole scene, the bare board whose light it reads, and where it came from."""

    name: str
    scene: Scene
    board: Scene
    origin: str


def candidate(name: str, scene: Scene, origin: str) -> CandidateLayout:
    """A layout with its bare board; origin is "given" or "searched"."""
    return CandidateLayout(name, scene, bare(explicit(scene, name)), origin)


def rules(scene: Scene) -> Placement:
    """The scene's [placement], or the usual rules; where they give no outline, that of the board's own file."""
    placement, (du, dv) = scene.placement or Placement(), scene.board.center_mm
    if placement.outline_mm is not None or scene.board.outline_mm is None:
        return placement
    corners, *holes = (
        tuple((x + du, y + dv) for x, y in line) for line in (scene.board.outline_mm, *scene.board.outline_holes_mm)
    )
    return placement.model_copy(update={"outline_mm": corners, "outline_holes_mm": tuple(holes)})


def fingers(scene: Scene) -> tuple[FingerCase, ...]:
    """The fingers that a layout must serve."""
    assert scene.finger is not None
    return rules(scene).fingers or (FingerCase(name=scene.finger.digit),)


def on_finger(scene: Scene, case: FingerCase, *, light_only: bool = False) -> Scene:
    """The scene on one of the fingers.

    light_only : change what decides where light goes, sizes, and leave what only dims it.
    """
    assert scene.finger is not None
    kept = {name: getattr(scene.finger, name) for name in (*ABSORBING, *SCATTERING)}
    finger = scene.finger if case.digit is None else Finger(digit=case.digit, **kept)
    if light_only:
        return scene.model_copy(update={"finger": finger})
    blood = {"rest_blood_fraction": case.rest_blood_fraction, "so2": case.so2}
    blood = {name: value for name, value in blood.items() if value is not None}
    absorbing = {"melanin_fraction": case.melanin_fraction, "dermis": case.dermis}
    absorbing = {name: value for name, value in absorbing.items() if value is not None}
    finger = finger.model_copy(update=absorbing)
    return scene.model_copy(update={"finger": finger, "blood": scene.blood.model_copy(update=blood)})


def base_board(scene: Scene) -> Scene:
    """The scene with its outline and the wall's gap spelled out and nothing of [placement] left.

    The outline is that of [placement], else of [board], else the smallest of the fingers' nails.
    """
    placement, board = rules(scene), scene.board
    own = scene.placement.outline_mm if scene.placement else None
    if own is not None:
        center, size = _on_the_nail(own, _smallest_nail_mm(scene))
    elif board.size_mm is None and board.outline_mm is not None:
        # What of the board's own file lies on the nail.
        center, size = scene.layout.outline.center_mm, scene.layout.outline.size_mm
    elif board.size_mm is not None:
        center, size = board.center_mm, board.size_mm
    else:
        center, size = (0.0, 0.0), _smallest_nail_mm(scene)
    update = _around(board, center, size)
    if board.barrier and board.barrier_gap_mm is None:
        update["barrier_gap_mm"] = placement.bond_wire_mm
    return scene.model_copy(update={"board": board.model_copy(update=update), "placement": None})


def _smallest_nail_mm(scene: Scene) -> Point:
    """Size of what every finger's nail has room for. [mm]"""
    nails = [on_finger(scene, case).finger for case in fingers(scene)]
    widths, lengths = zip(*((n.nail_width_mm, n.nail_length_mm) for n in nails if n), strict=True)
    return min(widths) - 2 * NAIL_MARGIN_MM, min(lengths) - 2 * NAIL_MARGIN_MM


def _on_the_nail(corners: Sequence[Point], nail_mm: Point) -> tuple[Point, Point]:
    """Middle and size of what of an outline's box lies on the nail; raises InputError where that is hardly any. [mm]"""
    lows, highs = (tuple(edge(axis) for axis in zip(*corners, strict=True)) for edge in (min, max))
    ends = [(max(low, -most / 2), min(high, most / 2)) for low, high, most in zip(lows, highs, nail_mm, strict=True)]
    if min(high - low for low, high in ends) < LEAST_BOARD_MM:
        middle = [round((low + high) / 2, 2) + 0.0 for low, high in zip(lows, highs, strict=True)]
        size = f"{highs[0] - lows[0]:.3g} x {highs[1] - lows[1]:.3g} mm"
        raise InputError(
            f"placement.outline: it is {size} around ({middle[0]:g}, {middle[1]:g}), "
            f"of which the nail bears less than {LEAST_BOARD_MM:g} mm; tell which point lies on the nail's centre "
            '(outline_origin = "middle" or [x, y]), or the unit of a drawing that names none (outline_unit = "inch").'
        )
    (a, b), (c, d) = ends
    return ((a + b) / 2, (c + d) / 2), (b - a, d - c)


def _around(board: Board, center_mm: Point, size_mm: Point) -> dict[str, object]:
    """What puts a board's origin in the middle of its edges, its file's outline staying where it is."""
    update: dict[str, object] = {"center_mm": center_mm, "size_mm": size_mm}
    if board.outline_mm is None:
        return update
    du, dv = board.center_mm[0] - center_mm[0], board.center_mm[1] - center_mm[1]
    corners, *holes = (tuple((x + du, y + dv) for x, y in line) for line in (board.outline_mm, *board.outline_holes_mm))
    return update | {"outline_mm": corners, "outline_holes_mm": tuple(holes)}


def candidate_scene(base: Scene, one: Candidate) -> Scene:
    """A candidate's layout on the board: its own parts where it says what they are, else like the scene's.

    Raises: InputError where the layout is impossible, or its LEDs are not the scene's by name.
    """
    wanted = [led.name for led in base.leds]
    if not one.leds:
        leds_deg, photodiodes_deg = (
            getattr(one, f"{kind}_deg") or [90.0 * turned for turned in getattr(one, f"{kind}_turned")]
            for kind in ("leds", "photodiodes")
        )
        order = _named_as(base, one) if one.led_refs else list(range(len(one.leds_mm)))
        return with_parts(
            base,
            [one.leds_mm[i] for i in order],
            one.photodiodes_mm,
            name=one.name,
            leds_deg=[leds_deg[i] for i in order] if leds_deg else (),
            photodiodes_deg=photodiodes_deg,
            led_refs=[one.led_refs[i][0] for i in order] if one.led_refs else (),
            photodiode_refs=one.photodiode_refs,
        )
    by_name = {led.name: led for led in one.leds}
    if set(by_name) != set(wanted):
        raise InputError(
            f'layout "{one.name}" places the LEDs {", ".join(by_name)}, but the scene has {", ".join(wanted)}; give '
            'each its name in parts, as D1 = { led = "led_660", name = "red" }.'
        )
    (du, dv), leds = base.board.center_mm, [by_name[name] for name in wanted]

    def moved(part: Led | Photodiode) -> Led | Photodiode:
        return part.model_copy(update={"position_mm": (part.position_mm[0] - du, part.position_mm[1] - dv)})

    scene = base.model_copy(update={"leds": tuple(map(moved, leds)), "photodiodes": tuple(map(moved, one.photodiodes))})
    check(scene, one.name)
    return scene


def _named_as(base: Scene, one: Candidate) -> list[int]:
    """Which of a file's LEDs is each of the scene's: by reference or value, the LED's name or part."""
    if len(base.leds) == len(one.led_refs) == 1:
        return [0]
    found = []
    for led in base.leds:
        names = {led.name.lower(), (led.part or led.name).lower()}
        same = [i for i, ref in enumerate(one.led_refs) if names & {word.lower() for word in ref}]
        exact = [i for i in same if led.name.lower() in {word.lower() for word in one.led_refs[i]}] or same
        if len(exact) != 1:
            refs = ", ".join(f"{ref} ({value})" for ref, value in one.led_refs)
            raise InputError(
                f'layout "{one.name}": which of its LEDs {refs} is "{led.name}"? Name it so, or say it in parts, as '
                f'D1 = {{ led = "PART", name = "{led.name}" }}.'
            )
        found.append(exact[0])
    if len(found) < len(one.led_refs):
        raise InputError(f'layout "{one.name}" places {len(one.led_refs)} LEDs, but the scene has {len(base.leds)}.')
    return found


def with_parts(
    base: Scene,
    leds_mm: Places,
    photodiodes_mm: Places,
    *,
    name: str,
    leds_deg: Sequence[float] = (),
    photodiodes_deg: Sequence[float] = (),
    led_refs: Sequence[str] = (),
    photodiode_refs: Sequence[str] = (),
) -> Scene:
    """The board with its LEDs and photodiodes at places on the nail; photodiodes are all like the scene's first.

    leds_deg, photodiodes_deg : how far each of them is turned from how the scene's lies; not at all if not given. [deg]
    led_refs, photodiode_refs : references of a file, where they are known; the photodiodes are named so, else PD1 and
        so on.

    Raises: InputError where the layout is impossible.
    """
    if len(leds_mm) != len(base.leds):
        raise InputError(f'layout "{name}" places {len(leds_mm)} LEDs, but the scene has {len(base.leds)}.')
    du, dv = base.board.center_mm

    def placed(parts: Sequence[Led | Photodiode], places: Places, turned_deg: Sequence[float]) -> tuple[Any, ...]:
        out = []
        for i, (part, (u, v)) in enumerate(zip(parts, places, strict=True)):
            angle = (part.rotation_deg + (turned_deg[i] if turned_deg else 0.0)) % 360
            out.append(part.model_copy(update={"position_mm": (u - du, v - dv), "rotation_deg": angle}))
        return tuple(out)

    single = base.photodiodes[0].model_copy(update=SINGLE)
    names = photodiode_refs or [f"PD{i + 1}" for i in range(len(photodiodes_mm))]
    named = [single.model_copy(update={"name": one, "reference": one if photodiode_refs else None}) for one in names]
    refs: Sequence[str | None] = led_refs or [led.reference for led in base.leds]
    lit = [led.model_copy(update={"reference": ref}) for led, ref in zip(base.leds, refs, strict=True)]
    leds, photodiodes = placed(lit, leds_mm, leds_deg), placed(named, photodiodes_mm, photodiodes_deg)
    scene = base.model_copy(update={"leds": leds, "photodiodes": photodiodes})
    check(scene, name)
    return scene


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
    loose, asked = loose_photodiodes(base, placement), placement.photodiodes
    kept = tuple(one for one in base.photodiodes if one.name in placement.fixed)
    fixed = len(lay_elements(base.board, kept)[0])
    if fixed > asked:
        raise InputError(f"placement.photodiodes = {asked}, but fixed has {fixed} of them; ask for more.")
    if placement.wire and asked - fixed > (most := sum(photodiode.elements for photodiode in loose)):
        raise InputError(
            f"placement.wire: the scene has {most} elements to choose from, and photodiodes asks for {asked - fixed}; "
            "ask for fewer."
        )


def loose_photodiodes(base: Scene, placement: Placement) -> list[Photodiode]:
    """The scene's photodiodes that are not fixed."""
    return [photodiode for photodiode in base.photodiodes if photodiode.name not in placement.fixed]


def searchable(base: Scene, placement: Placement) -> Scene:
    """The board whose parts, those aside that stay where they are, lie along or across the nail."""
    stay = {*placement.fixed, *((one.name for one in base.photodiodes) if placement.wire else ())}
    leds = tuple(one if one.name in stay else straightened(one) for one in base.leds)
    photodiodes = tuple(one if one.name in stay else straightened(one) for one in base.photodiodes)
    return base.model_copy(update={"leds": leds, "photodiodes": photodiodes})


def straightened(part: PartT) -> PartT:
    """A part that lies along or across the nail, whichever is nearer."""
    across = round(part.rotation_deg / 90) % 2
    return part.model_copy(update={"rotation_deg": 0.0, "size_mm": part.size_mm[:: -1 if across else 1]})


def way_of(side: str) -> int:
    """Which way photodiodes lie from LEDs on a side of them: 1 towards higher, -1 towards lower u or v."""
    return sum(FAR_SIDE[side])


def searched(
    base: Scene,
    placement: Placement,
    leds_mm: Places,
    photodiodes: Sequence[Rectangle],
    *,
    side: str | None,
    name: str,
) -> Scene:
    """The board with its LEDs at places on the nail, and what a search found beside the photodiodes that are fixed.

    photodiodes : areas of new ones, or where elements are wired, those by name.
    side : of the photodiodes on which the LEDs lie behind their wall; None without a wall.
    """
    du, dv = base.board.center_mm
    leds = tuple(
        led.model_copy(update={"position_mm": (u - du, v - dv)}) for led, (u, v) in zip(base.leds, leds_mm, strict=True)
    )
    kept = [one for one in base.photodiodes if one.name in placement.fixed]
    if placement.wire:
        wanted = {area.name for area in photodiodes}
        for one in loose_photodiodes(base, placement):
            wired = tuple(i for i, element in enumerate(one.element_names()) if element in wanted)
            if wired:
                kept.append(one.model_copy(update={"wired": wired if len(wired) < one.elements else None}))
    else:
        like = straightened(base.photodiodes[0]).model_copy(update=SINGLE)
        areas = sorted(photodiodes, key=lambda area: area.center_mm[::-1])
        for area, (name, ref) in zip(areas, _named(base, placement, areas), strict=True):
            place = (area.center_mm[0] - du, area.center_mm[1] - dv)
            kept.append(like.model_copy(update={"name": name, "reference": ref, "position_mm": place}))
    board = base.board.model_copy(update={"barrier_side": side})
    scene = base.model_copy(update={"leds": leds, "photodiodes": tuple(kept), "board": board})
    check(scene, name)
    return scene


def _named(base: Scene, placement: Placement, areas: Sequence[Rectangle]) -> list[tuple[str, str | None]]:
    """Names and references of new photodiodes: each is the nearest of a board's file that is like them, else new."""
    from scipy.optimize import linear_sum_assignment

    loose, like, (du, dv) = loose_photodiodes(base, placement), base.photodiodes[0], base.board.center_mm
    same = (1, like.part, like.size_mm)
    alike = [one for one in loose if one.reference and (one.elements, one.part, one.size_mm) == same]
    kept = [one for one in base.photodiodes if one not in loose]
    taken = {word for one in (*kept, *alike) for word in (one.name, one.reference)}
    apart = np.array(
        [[math.dist(area.center_mm, np.add(one.position_mm, (du, dv))) for one in alike] for area in areas]
    )
    nearest = dict(zip(*linear_sum_assignment(apart.reshape(len(areas), len(alike))), strict=True))
    new = (name for name in (f"PD{i}" for i in count(1)) if name not in taken)
    return [
        (alike[nearest[i]].name, alike[nearest[i]].reference) if i in nearest else (next(new), None)
        for i in range(len(areas))
    ]


def check(scene: Scene, name: str) -> None:
    """Raise InputError unless the scene's board can be laid out, and read from a map."""
    try:
        _ = scene.layout
    except InputError as error:
        raise InputError(f'layout "{name}": {error}') from None
    check_one_response(scene.photodiodes)


def explicit(scene: Scene, name: str) -> Scene:
    """The same layout with outline and wall spelled out, so that they stay when its photodiodes are taken away."""
    layout = scene.layout
    (u, v), (du, dv) = layout.outline.center_mm, scene.board.center_mm
    update = _around(scene.board, (u, v), layout.outline.size_mm)
    if len(layout.barriers) > 1:
        raise InputError(f'layout "{name}": has walls on several sides; place takes boards with one wall or none.')
    for wall in layout.barriers:
        update["barrier_gap_mm"] = min(-wall.overlap_mm(led) for led in layout.leds)

    def moved(part: Led | Photodiode) -> Led | Photodiode:
        x, y = part.position_mm
        return part.model_copy(update={"position_mm": (x + (du - u), y + (dv - v))})

    board = scene.board.model_copy(update=update)
    parts = {"leds": tuple(map(moved, scene.leds)), "photodiodes": tuple(map(moved, scene.photodiodes))}
    return scene.model_copy(update={"board": board, "placement": None} | parts)


def bare(scene: Scene, *, side: str | None = None) -> Scene:
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
        across, along = FAR_SIDE[side]
        place = (across * reach[0] if across else led[0], along * reach[1] if along else led[1])
    board = scene.board.model_copy(update={"barrier_side": side})
    speck = SINGLE | {"name": "speck", "position_mm": place, "size_mm": (SPECK_MM, SPECK_MM)}
    photodiodes = (scene.photodiodes[0].model_copy(update=speck),)
    return scene.model_copy(update={"photodiodes": photodiodes, "board": board})
