"""The board of a search or a given layout: on every finger, with its outline and wall spelled out, and bare; and what a
search may move on it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import TypeVar

import numpy as np

from ...errors import InputError
from ...scene import Finger, FingerCase, Led, Photodiode, Placement, Scene
from ...scene.base import Point, shifted
from ...scene.finger import ABSORBING, SCATTERING
from ...scene.importers.board_files import View
from ...scene.layout import SIDES, lay_elements, room_of
from ...scene.parts import DEEPEST_EPOXY_UM, ROOM, check_one_response
from ...scene.placement import MOST_SEARCHED
from ...scene.rectangles import Rectangle, has_room
from ..prior_uncertainty import at_value, draw_people

PartT = TypeVar("PartT", Led, Photodiode)
NAIL_MARGIN_MM = 0.1
# No board that bears an LED and a photodiode is narrower.
LEAST_BOARD_MM = 1.0
# A bare board carries one photodiode, because every scene has one; this one is too small to matter.
PROBE, PROBE_MM, PROBE_PLACES = "probe_photodiode", 0.05, 33
# Bodies and courtyards that overlap by less do not. [mm]
OVERLAP_MM = 1e-3
# Places are rounded to so many decimals of a millimetre, below which sums of floats differ. [1]
DECIMALS = 9
# LEDs that a search places together.
MOST_LEDS = 4
# One die in place of an array.
UNFITTED = {"feedback_ohm": None}
SINGLE = {"reference": None, "part": None, "wired": None, "elements": 1} | UNFITTED


def rules(scene: Scene) -> Placement:
    """The scene's [placement], or the usual rules for as many photodiodes as it has; where they give no outline, that
    of the board's own file, whose other parts are kept out, too; dies of a module, which do not move, are fixed."""
    board, count = scene.board, sum(len(p.wired_elements) for p in scene.photodiodes)
    placement = scene.placement or Placement(photodiodes=min(MOST_SEARCHED, count))
    taken = shifted(board.taken_mm or (), board.center_mm)
    of_modules = (p.name for p in (*scene.leds, *scene.photodiodes) if p.is_of_module)
    update: dict[str, object] = {"keep_out_mm": (*placement.keep_out_mm, *taken)}
    update["fixed"] = (*placement.fixed, *of_modules)
    if placement.outline_mm is None and board.outline_mm is not None:
        corners, *holes = shifted((board.outline_mm, *board.outline_holes_mm), board.center_mm)
        update |= {"outline_mm": corners, "outline_holes_mm": tuple(holes)}
    return placement.model_copy(update=update)


def check_two_zones(scene: Scene, command: str) -> None:
    """Raise InputError for a scene without a board, or whose blood is in more than two zones."""
    if scene.finger is None:
        raise InputError(f"{command} needs a [finger] scene; a phantom has no board and no force.")
    scene.require_blood(command)
    if scene.zone_count > 2:
        why = f"and the scene has {scene.zone_count}; leave zones out, or give one edge."
        raise InputError(f"blood: {command} supports two blood zones, {why}")


def fingers(scene: Scene) -> tuple[FingerCase, ...]:
    """The fingers that a layout must serve."""
    return rules(scene).fingers or (FingerCase(name=scene.fingertip.digit),)


@dataclass(frozen=True)
class PersonCase:
    """A person drawn from the priors: the first finger with values of its own, by field."""

    name: str
    first: FingerCase
    values: dict[str, float]

    @property
    def digit(self) -> str:
        """Whose light it is, as of other fingers their digit."""
        return self.name


def people(scene: Scene) -> list[PersonCase]:
    """The people for whom layouts are ranked."""
    first, count = fingers(scene)[0], rules(scene).people
    drawn = draw_people(worn_on(scene, first), count) if count else []
    return [PersonCase(f"person_{i}", first, values) for i, values in enumerate(drawn, 1)]


def worn_on(scene: Scene, case: FingerCase | PersonCase, *, light_only: bool = False) -> Scene:
    """The scene on one of the fingers; on a person's, what of a board with explicit edges lies on the nail.

    light_only : change what decides where light goes, sizes, and leave what only dims it.
    """
    if isinstance(case, PersonCase):
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
    return bare_board(cut, side=board.barrier_side) if scene.photodiodes[0].name == PROBE else cut


def _on_the_nail(corners: Sequence[Point], room: Point) -> tuple[Point, Point]:
    """Middle and size of what of an outline's box lies on the nail; raises InputError where that is hardly any. [mm]"""
    lows, highs = (tuple(edge(axis) for axis in zip(*corners, strict=True)) for edge in (min, max))
    ends = [(max(low, -most / 2), min(high, most / 2)) for low, high, most in zip(lows, highs, room, strict=True)]
    if min(high - low for low, high in ends) < LEAST_BOARD_MM:
        middle = [round((low + high) / 2, 2) + 0.0 for low, high in zip(lows, highs, strict=True)]
        size = f"{highs[0] - lows[0]:.3g} x {highs[1] - lows[1]:.3g} mm"
        why = f"of which the nail bears less than {LEAST_BOARD_MM:g} mm; state which point lies on the nail's centre"
        cure = '(outline_origin = "middle" or [x, y]), or the unit of a DXF that names none (outline_unit = "inch").'
        raise InputError(f"placement.outline: it is {size} around ({middle[0]:g}, {middle[1]:g}), {why} {cure}")
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
    """The layout with outline and wall spelled out, so that they stay when its photodiodes are taken away."""
    layout = scene.layout
    if len(layout.barriers) > 1:
        raise InputError(f'layout "{name}": has walls on several sides; place takes boards with one wall or none.')
    gap_mm = layout.barrier_gap_mm if layout.barriers else scene.board.barrier_gap_mm
    return _with_edges(scene, layout.outline.center_mm, layout.outline.size_mm, gap_mm)


def bare_board(scene: Scene, *, side: str | None = None) -> Scene:
    """A board of explicit outline and wall without its photodiodes, the same for all layouts that share its light.

    side : on which side of the photodiodes its LEDs lie; as in the scene's layout if not given. Needed with a wall.
    """
    if side is None and scene.board.barrier:
        side = scene.layout.barriers[0].name
    size, led = scene.board.size_mm, scene.leds[0].position_mm
    assert size is not None
    reach = (size[0] / 2 - 2 * PROBE_MM, size[1] / 2 - 2 * PROBE_MM)
    if side is None:
        # The corner that is farthest from the LED.
        place = (-reach[0] if led[0] > 0 else reach[0], -reach[1] if led[1] > 0 else reach[1])
    else:
        axis, way = SIDES[side]
        place = (led[0], way * reach[1]) if axis else (way * reach[0], led[1])
    if scene.board.outline_mm is not None:
        # The place nearest to that on which there is a board.
        lines = scene.board.outline_mm, scene.board.outline_holes_mm
        places = product(*(np.linspace(-most, most, PROBE_PLACES).tolist() for most in reach))
        near = sorted(places, key=lambda at: math.dist(at, place))
        place = next((at for at in near if has_room(at, (PROBE_MM, PROBE_MM), *lines)), place)
    board = scene.board.model_copy(update={"barrier_side": side})
    probe = SINGLE | dict.fromkeys(ROOM) | {"name": PROBE, "position_mm": place, "size_mm": (PROBE_MM, PROBE_MM)}
    return scene.model_copy(update={"photodiodes": (scene.photodiodes[0].model_copy(update=probe),), "board": board})


def courtyard_overlaps(scene: Scene) -> list[str]:
    """Parts of a board's file whose bodies or courtyards overlap, or reach over an edge or another part, in words."""
    board = scene.board
    both: tuple[Led | Photodiode, ...] = (*scene.leds, *scene.photodiodes)
    parts = [(p, room_of(p, board.on_nail(p.position_mm))) for p in both if p.body_mm or p.courtyard_mm]
    lines = [
        f"body or courtyard of {one.name} and {other.name} overlap by {room.overlap_mm(its):.2g} mm; move one of them"
        for (one, room), (other, its) in combinations(parts, 2)
        if room.overlap_mm(its) > OVERLAP_MM and one.footprint != other.footprint
    ]
    border, *holes = scene.layout.border_mm or (scene.layout.outline.corners_mm,)
    off = [*holes, *shifted(board.taken_mm or (), board.center_mm)]
    for part, room in parts if board.outline_mm or board.size_mm else ():
        half_mm = (room.u_max - room.u_min) / 2 - OVERLAP_MM, (room.v_max - room.v_min) / 2 - OVERLAP_MM
        if not has_room(room.center_mm, half_mm, border, off):
            lines.append(f"body or courtyard of {part.name} reaches over an edge or another part; move it")
    return lines


def misfits(scene: Scene) -> list[str]:
    """Parts that the epoxy between board and nail does not cover, and lenses that it undoes, in words."""
    room_um, lines = 1e3 * scene.board.height_mm, []
    for part in (*scene.leds, *scene.photodiodes):
        if (tall_um := part.package_height_um or 0.0) > room_um:
            text = f"{tall_um:g} um high, and {room_um:g} um are between board and nail: it cannot lie as drawn"
            deep_um = scene.board.clear_epoxy_um + tall_um - room_um
            cure = f"give board.clear_epoxy_um = {deep_um:g}" if deep_um <= DEEPEST_EPOXY_UM else "take a lower part"
            lines.append(f"package of {part.footprint} is {text}; {cure}")
        shape = "pattern" if isinstance(part, Led) else "angular_response"
        if part.lens and getattr(part, shape) not in ("lambertian", None):
            cure = 'set it to "lambertian"' if isinstance(part, Led) else "copy its part without it"
            lines.append(f"lens of {part.name} lies in epoxy of about its index: {shape} is that in air; {cure}")
    return [*dict.fromkeys(lines)]


def check_search(base: Scene, placement: Placement) -> None:
    """Raise InputError where a search cannot place what the scene has."""
    names = [*(led.name for led in base.leds), *(photodiode.name for photodiode in base.photodiodes)]
    for name in placement.fixed:
        if name not in names:
            why = f'"{name}" is no LED or photodiode of the scene; it has {", ".join(names)}.'
            raise InputError(f"placement.fixed: {why}")
    check_one_response(base.photodiodes)
    if not placement.search:
        return
    if len(base.leds) > MOST_LEDS:
        why = "set search = false and give candidates."
        raise InputError(f"placement.search places up to {MOST_LEDS} LEDs, the scene has {len(base.leds)}; {why}")
    (staying, loose), requested = fixed_and_loose(base, placement), placement.photodiodes
    fixed = len(lay_elements(base.board, staying)[0])
    if fixed > requested:
        raise InputError(f"placement.photodiodes = {requested}, but fixed has {fixed} of them; ask for more.")
    if placement.wire and requested - fixed > (most := sum(photodiode.elements for photodiode in loose)):
        why = f"fewer than the {requested - fixed} that photodiodes asks for; ask for fewer."
        raise InputError(f"placement.wire: the scene has {most} elements to choose from, {why}")


def fixed_and_loose(base: Scene, placement: Placement) -> tuple[tuple[Photodiode, ...], tuple[Photodiode, ...]]:
    """The scene's photodiodes that are fixed, and the others."""
    fixed = tuple(photodiode for photodiode in base.photodiodes if photodiode.name in placement.fixed)
    return fixed, tuple(photodiode for photodiode in base.photodiodes if photodiode not in fixed)


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
    """A part that lies along or across the nail, whichever is nearer."""
    return part.model_copy(update={"rotation_deg": 90.0 * round(part.rotation_deg / 90) % 360})


def single(photodiode: Photodiode) -> Photodiode:
    """A photodiode for another place: of an array one element, and of that or a module without its package."""
    of_several = photodiode.elements > 1 or photodiode.is_of_module
    return photodiode.model_copy(update=SINGLE | (dict.fromkeys(ROOM) if of_several else {"part": photodiode.part}))
