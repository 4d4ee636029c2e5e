"""What a search may move: the parts that are not fixed, which lie straight, and what it cannot place."""

from typing import TypeVar

from ...errors import InputError
from ...scene import Led, Photodiode, Placement, Scene
from ...scene.layout import lay_elements
from ...scene.parts import check_one_response
from .boards import FAR_SIDE

PartT = TypeVar("PartT", Led, Photodiode)
# LEDs that a search places together.
MOST_LEDS = 4


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
    kept = tuple(one for one in base.photodiodes if one.name in placement.fixed)
    fixed = len(lay_elements(base.board, kept)[0])
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
