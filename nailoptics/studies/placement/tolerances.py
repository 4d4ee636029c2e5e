"""How much worse the best layout becomes by tolerances: of gluing, of each photodiode's place, of the LEDs' power."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...scene import Scene
from ...variables import described, jackknifed
from . import boards, candidates
from .candidates import CandidateLayout
from .objective import JUDGE_PHOTONS, Array, Objective, score_layout
from .photon_maps import PERSON_DISTANCE_MM, PhotonMapCache

STEP_MM, TURN_DEG = 0.5, 5.0
# A bin of an infrared LED's power is a factor of 1.6 wide, as data sheets sort them: this much about its middle.
POWER = 0.25
MOVED = {"left": (-STEP_MM, 0), "right": (STEP_MM, 0), "proximal": (0, -STEP_MM), "distal": (0, STEP_MM)}
TURNED = {"clockwise": -TURN_DEG, "counterclockwise": TURN_DEG}
POWERED = {"dimmer": 1 - POWER, "brighter": 1 + POWER}
KINDS = (*MOVED, *TURNED, *POWERED)


def tolerances(
    layout: CandidateLayout, cache: PhotonMapCache, objective: Objective, *, stop: Callable[[], bool]
) -> xr.Dataset:
    """How what layouts are ranked by changes on the fingers with each tolerance of a layout with resistors of its own.

    cache : has evaluated the layout. Another place of the board is traced, its wall and edges straight where it is
        turned; all else is read by the same light.
    stop : whether there is no time to trace more.

    Returns: Dataset over toleranced_part (board, photodiodes, LEDs) and deviation, NaN of what is no tolerance of a
        part, has no room, or was not traced.
    """
    scene, ranked = layout.scene, score_layout(layout, cache, objective).ranked
    fingers = cache.conditions[: len(objective.points)]
    elsewhere = replace(cache, conditions=fingers, distance_mm=PERSON_DISTANCE_MM, stop=stop)
    changes: dict[tuple[str, str], Array] = {}
    for (part, kind), varied in _varied(scene).items():
        try:
            candidates.check(varied, layout.name)
            moved, light = replace(layout, scene=varied), cache
            if part == "board":
                moved, light = candidates.candidate(layout.name, varied, ""), elsewhere
                light.extend(moved.board, JUDGE_PHOTONS)
            if light.of(moved.board).photons:
                changes[part, kind] = score_layout(moved, light, objective).ranked / ranked - 1
        except InputError:
            continue
    parts = ["board", *(part.name for part in (*scene.photodiodes, *scene.leds))]
    none = np.full_like(ranked, np.nan)
    table = np.array([[changes.get((part, kind), none) for kind in KINDS] for part in parts])
    data = described(__package__, tolerance_ranking=jackknifed(np.moveaxis(table, -1, 0)))
    return xr.Dataset(data, coords={"toleranced_part": parts, "deviation": list(KINDS)})


def _varied(scene: Scene) -> dict[tuple[str, str], Scene]:
    """The scene with each tolerance of each part; of the board's, without what then reaches over the nail."""

    def board_at(turn_deg: float, du: float = 0.0, dv: float = 0.0) -> Scene:
        cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        (u, v), update = scene.board.center_mm, dict[str, Any]()
        for name in ("leds", "photodiodes"):
            places = [part.position_mm for part in getattr(scene, name)]
            turned = [{"position_mm": (cos * x - sin * y, sin * x + cos * y)} for x, y in places]
            both = zip(getattr(scene, name), turned, strict=True)
            update[name] = tuple(
                part.model_copy(update=at | {"rotation_deg": (part.rotation_deg + turn_deg) % 360}) for part, at in both
            )
        # Edges lie straight: those of a turned board are its box.
        (width, length), sin = scene.layout.outline.size_mm, abs(sin)
        size_mm = (cos * width + sin * length, sin * width + cos * length)
        board = scene.board.model_copy(update={"center_mm": (u + du, v + dv), "size_mm": size_mm})
        return boards.cut_to(scene.model_copy(update=update | {"board": board}), boards.nail_mm(scene))

    varied = {("board", kind): board_at(0.0, *step) for kind, step in MOVED.items()}
    varied |= {("board", kind): board_at(turn_deg) for kind, turn_deg in TURNED.items()}
    for photodiode in scene.photodiodes:
        (u, v), others = photodiode.position_mm, scene.photodiodes
        for kind, (du, dv) in MOVED.items():
            moved = photodiode.model_copy(update={"position_mm": (u + du, v + dv)})
            parts = tuple(moved if one is photodiode else one for one in others)
            varied[photodiode.name, kind] = scene.model_copy(update={"photodiodes": parts})
    for led in scene.leds:
        for kind, factor in POWERED.items():
            powered = led.model_copy(update={"flux_mw": factor * led.flux_mw})
            leds = tuple(powered if one is led else one for one in scene.leds)
            varied[led.name, kind] = scene.model_copy(update={"leds": leds})
    return varied
