"""A layout as a board of KiCad: the user's own with its parts moved, or a new one."""

import logging
import math
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import write_text
from ..scene import Led, Photodiode, Scene
from ..scene.base import Point
from ..scene.importers.board_files import View, read_board_file
from ..scene.importers.kicad import moved_board, read_board, write_board
from ..scene.importers.outlines import Outline
from ..scene.importers.positions import PlacedPart
from ..scene.parts import ROOM
from ..scene.rectangles import turned
from ..studies.placement.result import kicad_parts, outline

log = logging.getLogger(__name__)

# By so much the dies of one footprint may move differently. [mm]
ALIKE_MM = 1e-3


def write_kicad_pcb(scene: Scene, path: Path, *, folder: Path | None = None) -> dict[str, Path]:
    """Write a scene's layout as a board of KiCad, its own one, in a folder, if it came from one; returns the path.

    Raises: WriteError; InputError where the own board cannot be read, or a footprint not be moved.
    """
    if is_own(scene):
        write_text(path, own_board(scene, folder or Path())[1])
    else:
        write_new_board(scene, path, outline(scene, scene))
    return {"board": path}


def is_own(scene: Scene) -> bool:
    """Whether a scene's layout came from a board of KiCad."""
    return bool(scene.board.kicad and scene.board.parts and any(led.reference for led in scene.leds))


def write_new_board(scene: Scene, path: Path, edges: Outline) -> None:
    """Write a layout as a new board; raises WriteError."""
    sizes = [*(led.size_mm for led in scene.leds), *(e.photodiode.size_mm for e in scene.layout.photodiodes)]
    write_board(path, kicad_parts(scene), sizes, edges, thickness_mm=1e-3 * scene.board.kapton_um)


def own_board(scene: Scene, folder: Path) -> tuple[Scene, str]:
    """A scene with references of parts that are new on its own board, and that board's text, parts where it has them.

    Raises: InputError where the board cannot be read, or a footprint not be moved.
    """
    path, view = folder / str(scene.board.kicad), View.of_kicad(scene.board)
    try:
        leds, photodiodes, _ = read_board_file(scene.board.model_dump(exclude_none=True), folder)
    except ValueError as error:
        raise InputError(f"{path}: {error}.") from None
    footprints = {part.ref: part for part in read_board(path).footprints}
    scene, new = _with_references(scene, {*footprints})
    both: tuple[Led | Photodiode, ...] = (*scene.leds, *scene.photodiodes)
    parts = {part.reference: part for part in both}
    places: dict[str, tuple[Point, float]] = {}
    for table in (*leds, *photodiodes):
        # Dies of a module are called by its reference and their own name.
        ref = next(ref for ref in (table["reference"], table["reference"].rpartition(".")[0]) if ref in footprints)
        if (part := parts.get(table["reference"])) is None:
            log.warning("%s: %s has no place in this layout, and stays where it is.", path, table["reference"])
            continue
        before, after = (view.place_in_file(place) for place in (table["position_mm"], part.position_mm))
        turn_deg = view.angle_in_file(part.rotation_deg) - view.angle_in_file(table["rotation_deg"])
        (x, y), angle_deg = footprints[ref].position_mm, footprints[ref].rotation_deg + turn_deg
        u, v = turned((x - before[0], y - before[1]), turn_deg)
        place = (after[0] + u, after[1] + v)
        if math.dist(places.setdefault(ref, (place, angle_deg))[0], place) > ALIKE_MM:
            raise InputError(f"{path}: {ref} is one footprint, whose dies cannot move by themselves: keep them fixed.")
    added = []
    for part in (parts[ref] for ref in new):
        size_mm = part.size_mm[0], part.length_mm
        package = f"{'LED' if isinstance(part, Led) else 'PD'}_{size_mm[0]:g}x{size_mm[1]:g}mm"
        at = view.place_in_file(part.position_mm), view.angle_in_file(part.rotation_deg), str(scene.board.faces_nail)
        own: dict[str, Any] = {room: view.box(box) for room in ROOM if (box := getattr(part, room))}
        added.append((PlacedPart(str(part.reference), part.name, package, *at, **own), size_mm))
    return scene, moved_board(path, places, added)


def _with_references(scene: Scene, taken: set[str]) -> tuple[Scene, list[str]]:
    """The scene whose every part has a reference, a new one if it had none; and the new ones."""
    parts, new, update = dict(scene.board.parts or {}), list[str](), dict[str, Any]()
    for kind, start in (("led", "D"), ("photodiode", "PD")):
        mine = list[Any](getattr(scene, f"{kind}s"))
        for i, part in enumerate(mine):
            if not part.reference:
                names = (part.name, *(f"{start}{k}" for k in range(1, len(taken) + 2)))
                ref = next(name for name in names if name not in taken and name.isalnum())
                mine[i], taken = part.model_copy(update={"reference": ref}), taken | {ref}
                parts[ref] = {kind: True, "size_mm": part.size_mm}
                new.append(ref)
        update[f"{kind}s"] = tuple(mine)
    update |= {"board": scene.board.model_copy(update={"parts": parts})}
    return scene.model_copy(update=update), new
