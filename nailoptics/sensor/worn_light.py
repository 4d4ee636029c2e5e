"""All light that a worn sensor meets, traced: in its place, where its body moves it, from outside, and what its
resistors fit to."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np

from ..checks import Array
from ..errors import InputError, NotReachedError, as_far_as_reached
from ..light import DetectedLight, ProgressCallback, open_light
from ..light.detect import rough_readings
from ..light.tracing import accuracy
from ..options import Requested, TraceOptions
from ..scene import Board, Scene
from ..statistics import Z95
from . import electronics
from .ambient import LAMP, ambient_bound_a, scene_ambient_a

# So far the sensor is moved to see what that makes of its readings: far enough to stand out from the photons' noise,
# and little beside the 400 um of epoxy, or the 2 mm in which one blood zone passes into the next. [um]
LIFT_UM, SLIDE_UM = 40.0, 250.0


@dataclass(frozen=True)
class MovedLight:
    """The light of a scene whose sensor was lifted or slid by some distance.

    motion : "lift" or "slide". distance_um : how far. [um]
    """

    motion: str
    distance_um: float
    light: DetectedLight


@dataclass(frozen=True)
class WornLight:
    """All light that a scene's sensor meets.

    scene : with a resistor at every photodiode.
    in_place : the light under the sensor in its place. moved : elsewhere, where the scene's body moves it.
    ambient_a : (3, photodiodes) float. Photocurrents by the scene's [ambient], of `trace_ambient`; None without. [A]
    """

    scene: Scene
    in_place: DetectedLight
    ambient_a: Array | None
    moved: Sequence[MovedLight] = ()


def worn_light(
    scene: Scene, *, states: Array, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> tuple[WornLight, NotReachedError | None]:
    """Trace the light that a scene's sensor meets, and say why some of it is less accurate than requested, if it is.

    states : (t, zones) float. The blood states that will be read. A limit in seconds holds for all traces together.
    """
    moves, options = moved_boards(scene), TraceOptions(**requested)
    fitted, ambient_a = with_fitted_resistors(scene), scene_ambient_a(scene, options)
    limit = accuracy(scene, options).max_seconds
    if moves and limit is not None:
        requested = requested | Requested(max_seconds=limit / (1 + len(moves)))
    given = {"states": states, "progress": progress, **requested}
    light, unmet = as_far_as_reached(open_light, scene, **given)
    moved = []
    for motion, distance_um, board in moves:
        there, also = as_far_as_reached(open_light, scene.model_copy(update={"board": board}), **given)
        moved.append(MovedLight(motion, distance_um, there))
        unmet = unmet or also
    return WornLight(fitted, light, ambient_a, moved), unmet


def moved_boards(scene: Scene) -> list[tuple[str, float, Board]]:
    """The boards to be traced beside the scene's own: motion, distance [um] and board."""
    motion, board, moved = scene.body and scene.body.motion, scene.board, []
    if motion and motion.lift_um:
        moved.append(("lift", LIFT_UM, board.model_copy(update={"adhesive_um": board.adhesive_um + LIFT_UM})))
    if motion and motion.slide_um:
        moved.append(("slide", *_slid(scene)))
    return moved


def _slid(scene: Scene) -> tuple[float, Board]:
    """How far the board is slid along the nail [um], and the board; where the nail is no longer, it ends at its edge.

    Raises: InputError where the parts lie too near to both of the nail's ends.
    """
    (u, v), outline = scene.board.center_mm, scene.layout.outline
    corners = tuple((x - u, y - v) for x, y in outline.corners_mm)
    for cut in ({}, {"size_mm": None, "outline_mm": corners, "outline_holes_mm": ()}):
        for distance_um in (SLIDE_UM, -SLIDE_UM):
            update = cut | {"center_mm": (u, v + 1e-3 * distance_um)}
            slid = scene.model_copy(update={"board": scene.board.model_copy(update=update)})
            try:
                _ = slid.layout
            except InputError:
                continue
            return distance_um, slid.board
    raise InputError(
        f"body.motion.slide_um: the parts lie within {1e-3 * SLIDE_UM:g} mm of both ends of the nail, which leaves no "
        "room to slide the sensor; move them, or set slide_um = 0."
    )


def with_fitted_resistors(scene: Scene) -> Scene:
    """The scene with a resistor at every photodiode where it has "auto", the same for every command: fitted to the
    upper end of the 95 % interval of the brightest LED through a bed without blood, beside [ambient] or a lamp."""
    if electronics.has_resistors(scene):
        return scene
    ambient_a = ambient_bound_a(scene, usual=LAMP)
    read = rough_readings(scene, np.zeros((1, len(scene.zone_edges_mm) + 1)))
    bound = (read.fraction + Z95 * np.nan_to_num(read.stderr))[..., 0]
    photodiodes = [element.photodiode for element in scene.layout.photodiodes]
    lit_a = [
        electronics.photocurrent_a(of_led, led, photodiodes) for of_led, led in zip(bound, scene.leds, strict=True)
    ]
    return electronics.with_resistors(scene, np.max(lit_a, axis=0) + ambient_a)
