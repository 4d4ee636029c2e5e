"""Geometry for other programs: GLB with one named part per region, PLY with the regions of every face."""

from pathlib import Path

import numpy as np

from ..assets import read_toml
from ..geometry import Geometry, build
from ..io import make_folder, write_bytes
from ..scene import Scene

# glTF counts in metres with y up; the finger lies in it with the nail up and the tip towards the viewer.
TO_GLTF = np.array([[-1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, 1e-3, 0, 0], [0, 0, 0, 1]])


def write_mesh(scene: Scene, path: Path) -> dict[str, Path]:
    """Write a scene's geometry to a file; returns the path by what it is. The ending of its name chooses the format.

    .glb : one closed mesh per region, named as the region, in metres with the nail up, as glTF asks.
    .ply : one mesh of all interfaces, each face once, in millimetres; integer face properties `below` and `above` give
        the regions on both sides (normals point from below to above), and comments in the header name the regions.

    Raises: WriteError where the file cannot be written.
    """
    make_folder(path.parent)
    write = {".glb": _glb, ".ply": _ply}[path.suffix.lower()]
    write_bytes(path, write(build(scene)))
    return {"mesh": path}


def _glb(geometry: Geometry) -> bytes:
    import trimesh

    scene = trimesh.Scene()
    colours = read_toml("mesh_colours.toml")
    dies = {face.region: colours["led"] for face in geometry.leds}
    dies |= {face.region: colours["photodiode"] for face in geometry.photodiodes}
    for index, name in enumerate(geometry.regions):
        # The closed surface of the region: faces below which it lies have their normals out of it already.
        out, inward = geometry.triangles[geometry.below == index], geometry.triangles[geometry.above == index]
        triangles = np.concatenate([out, inward[:, ::-1]])
        if name == "air" or not len(triangles):
            continue
        used, flat = np.unique(triangles, return_inverse=True)
        colour = (*(dies.get(index) or colours[name]), 255)
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
