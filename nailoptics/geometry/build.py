"""From a scene to its geometry."""

import logging
from collections.abc import Collection

import numpy as np

from ..errors import InputError
from ..scene import Light, Photodiode, Scene
from ..scene.finger import ABSORBING, SCATTERING
from .board import BentBoard
from .grid import Grid
from .model import Face, Geometry
from .nodes import BELOW, Nodes
from .regions import AIR, AROUND, EPOXY, KAPTON, REGIONS, SILICON
from .surfaces import FingerSurfaces

log = logging.getLogger(__name__)

FOLDS_RAD = (0.28, 0.6, 1.2)  # over which the skin beside the nail leaves its cylinder; the steepest that fits is built
# What of a scene a geometry is built from, and what of its parts is not.
BUILT_FROM = ("finger", "board", "leds", "photodiodes")
LAMBERTIAN = {"pattern": "lambertian", "pattern_deg": None, "pattern_relative": None}
LED_LIGHT = {"part": None, "wavelength_nm": 800.0, "fwhm_nm": 0.0, "flux_mw": 1.0} | LAMBERTIAN
READ_OUT = ("quantum_efficiency", "dark_current_na", "shunt_mohm")


def build(scene: Scene, *, resolution: float = 1.0, board: bool = True) -> Geometry:
    """Build the finger of a scene and the board on its nail, without the parts that the scene's light leaves out.

    board : Without it the nail is bare, and the geometry has no LEDs and no photodiodes.
    resolution : Divides the size of the cells; the nail's facets lie within 2 um / resolution^2 of its cylinder, but
        an LED die is always flat.

    Raises: InputError where the scene has no finger, its sizes make no finger, or resolution lies outside 0.1 to 10.
    """
    if not 0.1 <= resolution <= 10:
        raise InputError(f"resolution = {resolution:g}: must be between 0.1 and 10.")
    for fold_rad in FOLDS_RAD:
        surfaces = FingerSurfaces(scene.fingertip, fold_rad)
        bent = BentBoard(scene, surfaces)
        nodes = Nodes(surfaces, bent, resolution)
        grid = Grid(nodes.positions(), nodes.labels())
        if 6 * grid.least_volume_mm3 > -1e-9:
            break
    else:
        cure = "width_mm, thickness_mm, nail_width_mm, nail_radius_mm and the layers' thicknesses closer to anatomy"
        raise InputError(f"finger: these sizes do not make a finger: its layers cross one another; bring {cure}.")
    faces = [_face(grid, r.name, region) for region, r, _ in bent.parts if region != SILICON] if board else []
    if not board:
        grid.labels[:, :, BELOW:] = AIR
    for part in scene.light.left_out:
        grid.labels[grid.labels == REGIONS.index(part)] = REGIONS.index(AROUND[part])
    geometry = Geometry(
        *grid.interfaces(),
        regions=bent.regions,
        leds=tuple(faces[: len(scene.leds)]),
        photodiodes=tuple(faces[len(scene.leds) :]),
        nail_radius_mm=scene.fingertip.nail_radius_mm,
        board_radius_mm=bent.radius_mm,
        grid=grid,
    )
    log.info("geometry: %d triangles between %d regions", len(geometry.triangles), len(geometry.regions))
    return geometry


def underside(geometry: Geometry) -> Face:
    """The bare underside of the board as one face: where epoxy lies below the film, and no part and no wall."""
    return _face(geometry.grid, "underside", KAPTON, over=EPOXY)


def shaping(scene: Scene, *, with_faces: Collection[str] = ()) -> Scene:
    """A scene with everything at its default that its geometry is not built from; equal for all of one geometry, which
    has parts with_faces even where the scene leaves them out."""
    others = {name: field for name, field in Scene.model_fields.items() if name not in BUILT_FROM}
    usual: dict[str, object] = {name: f.default for name, f in others.items() if not f.is_required()}
    if scene.finger is not None:
        usual["finger"] = scene.finger.with_usual((*ABSORBING, *SCATTERING))
    usual["light"] = Light(left_out=tuple(part for part in AROUND if part in {*scene.light.left_out} - {*with_faces}))
    usual["board"] = scene.board.model_copy(update={"opaque_reflectance": 0.0})
    usual["leds"] = tuple(led.model_copy(update=LED_LIGHT) for led in scene.leds)
    read_out = {name: Photodiode.model_fields[name].default for name in READ_OUT}
    usual["photodiodes"] = tuple(photodiode.model_copy(update=read_out) for photodiode in scene.photodiodes)
    return scene.model_copy(update=usual)


def _face(grid: Grid, name: str, region: int, *, over: int | None = None) -> Face:
    """The lower face of a part, in the board's film or below it; over : where this region lies below it alone."""
    layer = int(np.nonzero((grid.labels == region).any(axis=(0, 1)))[0][0])
    nodes, cells = grid.nodes[:, :, layer], grid.labels[:, :, layer] == region
    if over is not None:
        cells &= grid.labels[:, :, layer - 1] == over
    # A column is straight along the nail, so that cells in a row of it are one rectangle. Corners run along the nail
    # first, then across, because the nail side sees the board from below.
    ends = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (column, first), (_, last) = np.nonzero(ends > 0), np.nonzero(ends < 0)
    corners = ((column, first), (column, last), (column + 1, last), (column + 1, first))
    quads = np.stack([nodes[corner] for corner in corners], axis=1)
    cross = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    area = np.linalg.norm(cross, axis=1)
    return Face(name, region, quads, cross / area[:, None], float(area.sum()))
