"""A photograph of the bare finger: its mesh in the traced colours, with the gloss of nail and skin, by stock Mitsuba.

It is a picture, not a measurement: gloss, lamp and camera are chosen to look like a finger on a desk, and there is no
hair and no texture.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import geometry as finger_geometry
from ..checks import Array
from ..errors import InputError
from ..scene import Scene, Viewing
from .backend import choose
from .reference.mitsuba_scene import rectangle
from .reference.readings import stock_mitsuba
from .walk.nail_reflectance import as_seen

# The camera looks there; the window is where the nail mirrors it into a camera before the tip and above. [mm]
TARGET_MM = (0.0, 1.0, -4.0)
FIELD_OF_VIEW_DEG = 22.0
WINDOW_MM, WINDOW_SIZE_MM = (48.0, -30.0, 62.0), 26.0
# How rough the surfaces are: a nail mirrors, skin shines.
ROUGHNESS = {"nail": 0.22, "skin": 0.5}
SKY, WINDOW = 0.95, 5.0
# Each pixel has so many paths of its own, and they are smoothed after, which has less noise than a filter on the film.
SAMPLES, SMOOTH_PX = 16, 0.7
DESK = 0.75


def photograph(
    scene: Scene, tile_mm: Array, on_nail: NDArray[np.bool_], colours: Array, *, backend: str = "auto"
) -> list[NDArray[np.uint8]]:
    """Pictures of a scene's finger without its board, one for each set of colours, each (height, width, 3).

    tile_mm : (t, 2) float. Middles of the tiles over one half of the finger, across and along. [mm]
    on_nail : (t,) bool. Which of them lie on the nail.
    colours : (pictures, t, 3) float in 0-1. Linear red, green and blue of each tile, as a diffuse albedo.
    """
    mesh = finger_geometry.build(as_seen(scene), board=False, resolution=2.0)
    if mesh.regions[int(mesh.region_at(np.array([scene.colour.camera_mm]))[0])] != "air":
        place = ", ".join(f"{value:g}" for value in scene.colour.camera_mm)
        raise InputError(f"colour.camera_mm = [{place}]: lies inside the finger; put it above, such as [-12, 38, 58].")
    outer = (mesh.below == 0) | (mesh.above == 0)
    inside = np.array(mesh.regions)[np.where(mesh.below == 0, mesh.above, mesh.below)]
    parts = {"nail": outer & (inside == "plate"), "skin": outer & (inside != "plate") & (inside != "cut")}
    pictures = []
    with stock_mitsuba(choose(backend, volpath=True)) as mi:
        for colour in colours:
            shapes = [_part(mi, mesh, parts[kind], kind, tile_mm, on_nail, colour) for kind in parts]
            pictures.append(_render(mi, shapes, scene.colour))
    return pictures


def _part(
    mi: Any, mesh: Any, chosen: Array, kind: str, tile_mm: Array, on_nail: NDArray[np.bool_], colours: Array
) -> Any:
    """Nail or skin as a smooth mesh that carries its colour."""
    from scipy.interpolate import RBFInterpolator

    triangles = mesh.triangles[chosen]
    # Normals point out of the finger.
    inward = mesh.below[chosen] == 0
    triangles[inward] = triangles[inward][:, ::-1]
    used, flat = np.unique(triangles, return_inverse=True)
    points = mesh.vertices[used]
    members = on_nail if kind == "nail" else ~on_nail
    places = tile_mm[members]
    # A smooth surface through the tiles, which have noise; beyond them the colour of the nearest.
    at = np.clip(np.stack([np.abs(points[:, 0]), points[:, 1]], -1), places.min(0), places.max(0))
    smooth = RBFInterpolator(places, colours[members], neighbors=min(24, len(places)), smoothing=2.0, kernel="linear")
    colour = np.clip(smooth(at), 0.0, 1.0)
    surface, base = mi.Properties(), {"type": "mesh_attribute", "name": "vertex_color"}
    bsdf = {"type": "principled", "base_color": base, "roughness": ROUGHNESS[kind], "specular": 0.5}
    surface["bsdf"] = mi.load_dict(bsdf)
    shape = mi.Mesh(kind, len(points), len(triangles), has_vertex_normals=True, props=surface)
    shape.add_attribute("vertex_color", 3, colour.astype(np.float32).ravel())
    params = mi.traverse(shape)
    params["vertex_positions"] = points.astype(np.float32).ravel()
    params["faces"] = flat.reshape(-1, 3).astype(np.uint32).ravel()
    params.update()
    return shape


def _render(mi: Any, shapes: list[Any], viewing: Viewing) -> NDArray[np.uint8]:
    from scipy.ndimage import gaussian_filter

    look, tall, (width, height) = mi.ScalarTransform4f().look_at, mi.ScalarTransform4f(), viewing.photograph_px
    window = look(origin=WINDOW_MM, target=TARGET_MM, up=(0, 0, 1)) @ tall.scale(WINDOW_SIZE_MM / 2)
    lowest = min(float(np.array(mi.traverse(shape)["vertex_positions"])[2::3].min()) for shape in shapes)
    desk = tall.translate((0, 0, lowest)) @ tall.scale(400)
    picture = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
        "window": rectangle(window, light={"type": "area", "radiance": {"type": "rgb", "value": WINDOW}}),
        "desk": rectangle(desk, bsdf={"type": "diffuse", "reflectance": {"type": "rgb", "value": DESK}}),
        "camera": {
            "type": "perspective",
            "fov": FIELD_OF_VIEW_DEG,
            "to_world": look(origin=viewing.camera_mm, target=TARGET_MM, up=(0, 0, 1)),
            "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter", "sample_count": SAMPLES},
        },
    } | {f"part{i}": shape for i, shape in enumerate(shapes)}
    scene = mi.load_dict(picture, optimize=False)
    image = gaussian_filter(np.array(mi.render(scene, spp=SAMPLES, seed=1)), (SMOOTH_PX, SMOOTH_PX, 0.0))
    return np.array(mi.Bitmap(image).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True))
