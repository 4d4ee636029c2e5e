"""Geometry for other programs: GLB with one named part per region, PLY with the regions of every face."""

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry import Geometry, build
from ..io import make_folder, write_bytes
from ..scene import Scene

COLOURS = {
    "plate": (244, 221, 205),
    "bed": (222, 120, 115),
    "bone": (236, 228, 200),
    "pulp": (226, 160, 140),
    "epidermis": (224, 178, 150),
    "epoxy": (190, 220, 235),
    "barrier": (30, 30, 30),
    "kapton": (205, 140, 40),
    "cover": (50, 50, 55),
    "cut": (150, 60, 60),
    "silicon": (90, 95, 110),
    "led": (240, 40, 40),
    "photodiode": (70, 90, 160),
}
# glTF counts in metres with y up; the finger lies in it with the nail up and the tip towards the viewer.
TO_GLTF = np.array([[-1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, 1e-3, 0, 0], [0, 0, 0, 1]])


def write_mesh(scene: Scene, path: Path) -> dict[str, Path]:
    """Write a scene's geometry as `export_mesh` does; returns the path by what it is."""
    make_folder(path.parent)
    return {"mesh": export_mesh(build(scene), path)}


def export_mesh(geometry: Geometry, path: str | Path) -> Path:
    """Write a geometry to a file; the ending of its name chooses the format.

    .glb : one closed mesh per region, named as the region, in metres with the nail up, as glTF asks.
    .ply : one mesh of all interfaces, each face once, in millimetres; integer face properties `below` and `above` give
        the regions on both sides (normals point from below to above), and comments in the header name the regions.

    Raises: InputError where the ending is another; WriteError where the file cannot be written.
    """
    path = Path(path)
    writers = {".glb": _glb, ".ply": _ply}
    if path.suffix.lower() not in writers:
        raise InputError(f'{path}: geometry is written as .glb or .ply, not as "{path.suffix}"; choose one of them.')
    write_bytes(path, writers[path.suffix.lower()](geometry))
    return path


def _glb(geometry: Geometry) -> bytes:
    import trimesh

    scene = trimesh.Scene()
    dies = {face.region: COLOURS["led"] for face in geometry.leds}
    dies |= {face.region: COLOURS["photodiode"] for face in geometry.photodiodes}
    for index, name in enumerate(geometry.regions):
        # The closed surface of the region: faces below which it lies have their normals out of it already.
        out, inward = geometry.triangles[geometry.below == index], geometry.triangles[geometry.above == index]
        triangles = np.concatenate([out, inward[:, ::-1]])
        if name == "air" or not len(triangles):
            continue
        used, flat = np.unique(triangles, return_inverse=True)
        colour = (*(dies.get(index) or COLOURS[name]), 255)
        material = trimesh.visual.material.PBRMaterial(
            name=name, baseColorFactor=colour, metallicFactor=0.0, roughnessFactor=0.7
        )
        visual = trimesh.visual.TextureVisuals(material=material)
        mesh = trimesh.Trimesh(geometry.vertices[used], flat.reshape(-1, 3), process=False, visual=visual)
        scene.add_geometry(mesh, node_name=name, geom_name=name, transform=TO_GLTF)
    return bytes(scene.export(file_type="glb"))


def _ply(geometry: Geometry) -> bytes:
    import trimesh

    mesh = trimesh.Trimesh(geometry.vertices, geometry.triangles, process=False)
    mesh.face_attributes["below"] = geometry.below.astype(np.int32)
    mesh.face_attributes["above"] = geometry.above.astype(np.int32)
    data = bytes(trimesh.exchange.ply.export_ply(mesh, include_attributes=True))
    comments = "".join(f"comment region {i} {name}\n" for i, name in enumerate(geometry.regions))
    first, second, rest = data.split(b"\n", 2)
    return b"\n".join([first, second, comments.encode() + rest])
