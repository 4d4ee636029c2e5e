"""How much worse the best layout becomes by tolerances: of gluing, of each part's place, of the LEDs' power."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...scene import Scene
from ...scene.rectangles import turned
from ...statistics import Array
from ...variables import described, jackknifed
from . import boards, candidates
from .boards import PartT
from .candidates import CandidateLayout
from .objective import Objective, score_layout
from .photon_maps import PERSON_DISTANCE_MM, PhotonMapCache

STEP_MM, TURN_DEG = 0.5, 5.0
# A bin of an infrared LED's power is a factor of 1.6 wide, as data sheets sort them: this much about its middle.
POWER = 0.25
# Groups of photons for the error of a change, and photons of each LED where light goes otherwise.
GROUPS, PHOTONS = 4, 1 << 17
MOVED = {"left": (-STEP_MM, 0), "right": (STEP_MM, 0), "proximal": (0, -STEP_MM), "distal": (0, STEP_MM)}
TURNED = {"clockwise": -TURN_DEG, "counterclockwise": TURN_DEG}
POWERED = {"dimmer": 1 - POWER, "brighter": 1 + POWER}
KINDS = (*MOVED, *TURNED, *POWERED)


def tolerances(layout: CandidateLayout, cache: PhotonMapCache, objective: Objective) -> xr.Dataset:
    """How what layouts are ranked by changes on the fingers with each tolerance of a layout with resistors of its own.

    cache : has evaluated the layout. Another place of the board, its wall and edges straight where it is turned, or of
        an LED is traced; all else is read by the same light.

    Returns: Dataset over toleranced_part (board, photodiodes, LEDs) and deviation, NaN of what is no tolerance of a
        part, has no room, or was not traced.
    """
    objective = replace(objective, filter_groups=GROUPS)
    scene, ranked = layout.scene, score_layout(layout, cache, objective).ranked
    fingers = cache.conditions[: len(objective.points)]
    photons = min(PHOTONS, cache.most_photons or PHOTONS)
    elsewhere = replace(cache, conditions=fingers, distance_mm=PERSON_DISTANCE_MM, batch_photons=photons)
    room = boards.room_mm(*(boards.worn_on(scene, condition.case) for condition in fingers))
    leds, changes = {led.name for led in scene.leds}, dict[tuple[str, str], Array]()
    for part, kind, vary in _varied(scene):
        try:
            if part == "board" or (kind in MOVED and part in leds):
                moved, light = candidates.candidate(layout.name, boards.cut_to(vary(), room), ""), elsewhere
                light.extend(moved.board, photons)
            else:
                moved, light = replace(layout, scene=vary()), cache
                candidates.check(moved.scene, layout.name)
            if light.of(moved.board).photons:
                changes[part, kind] = score_layout(moved, light, objective).ranked / ranked - 1
        except InputError:
            continue
    parts = ["board", *(part.name for part in (*scene.photodiodes, *scene.leds))]
    none = np.full_like(ranked, np.nan)
    table = np.array([[changes.get((part, kind), none) for kind in KINDS] for part in parts])
    data = described(__package__, tolerance_ranking=jackknifed(np.moveaxis(table, -1, 0)))
    return xr.Dataset(data, coords={"toleranced_part": parts, "deviation": list(KINDS)})


def _varied(scene: Scene) -> Iterator[tuple[str, str, Callable[[], Scene]]]:
    """Each part, a deviation of it, and what makes the scene with that, which may be impossible."""
    for kind, (du, dv) in MOVED.items():
        yield "board", kind, partial(_glued, scene, du_mm=du, dv_mm=dv)
        for i, (u, v) in enumerate(photodiode.position_mm for photodiode in scene.photodiodes):
            moved: dict[str, Any] = {f"photodiodes[{i}].position_mm": (u + du, v + dv)}
            yield scene.photodiodes[i].name, kind, partial(scene.with_, **moved)
        for i, (led, die) in enumerate(zip(scene.leds, scene.layout.leds, strict=True)):
            moved = {f"leds[{i}].position_mm": tuple(np.add(led.position_mm, (du, dv)).tolist())}
            # The wall stays where it is.
            there = replace(die, u_min=die.u_min + du, u_max=die.u_max + du, v_min=die.v_min + dv, v_max=die.v_max + dv)
            dies = [*scene.layout.leds[:i], there, *scene.layout.leds[i + 1 :]]
            if walls := scene.layout.barriers:
                moved["board.barrier_gap_mm"] = min(-walls[0].overlap_mm(one) for one in dies)
            yield led.name, kind, partial(scene.with_, **moved)
    for kind, angle_deg in TURNED.items():
        yield "board", kind, partial(_glued, scene, angle_deg=angle_deg)
    for led, (kind, factor) in product(scene.leds, POWERED.items()):
        yield led.name, kind, partial(scene.with_led, led.name, flux_mw=factor * led.flux_mw)


def _glued(scene: Scene, *, du_mm: float = 0.0, dv_mm: float = 0.0, angle_deg: float = 0.0) -> Scene:
    """The board glued aside, or turned about its middle."""
    turn, (u, v) = partial(turned, angle_deg=angle_deg), scene.board.center_mm
    # Edges lie straight: those of a turned board are its box; a drawn border turns with it.
    corners = product(*zip((0.0, 0.0), scene.layout.outline.size_mm, strict=True))
    size_mm = tuple(np.ptp([*map(turn, corners)], axis=0).tolist())
    border, *holes = (tuple(map(turn, line)) for line in (scene.board.outline_mm or (), *scene.board.outline_holes_mm))
    update: dict[str, Any] = {"center_mm": (u + du_mm, v + dv_mm), "size_mm": size_mm}
    update |= {"outline_mm": border or None, "outline_holes_mm": tuple(holes)}

    def glued(part: PartT) -> PartT:
        at_deg = (part.rotation_deg + angle_deg) % 360
        return part.model_copy(update={"position_mm": turn(part.position_mm), "rotation_deg": at_deg})

    parts = {kind: tuple(map(glued, getattr(scene, kind))) for kind in ("leds", "photodiodes")}
    return scene.model_copy(update={"board": scene.board.model_copy(update=update)} | parts)
