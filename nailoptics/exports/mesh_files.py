"""Meshes for other programs: GLB with a named part per region, PLY with the regions of every face, and plain Mitsuba:
one scene of XML per LED, its interfaces as PLY meshes, and how to render them."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..assets import read_toml
from ..geometry import Geometry, build
from ..io import make_folder, write_bytes
from ..light import optics
from ..light.reference.mitsuba_scene import finger_scene
from ..scene import Scene
from . import compatibility

# glTF counts in metres with y up; the finger lies in it with the nail up and the tip towards the viewer.
TO_GLTF = np.array([[-1e-3, 0, 0, 0], [0, 0, 1e-3, 0], [0, 1e-3, 0, 0], [0, 0, 0, 1]])
# What an object of a scene is called in XML, by its type.
TAGS = {"volpath": "integrator", "homogeneous": "medium", "hg": "phase", "ply": "shape", "area": "emitter"}
TAGS |= dict.fromkeys(("diffuse", "dielectric", "null"), "bsdf")
TAGS |= {"irradiancemeter": "sensor", "hdrfilm": "film", "box": "rfilter"}
# Photodiodes read in one rendering, one in each colour.
COLOURS = 3
MESHES = "meshes"


def write_mesh(scene: Scene, path: Path) -> dict[str, Path]:
    """Write a scene's geometry to a file; returns the path by what it is. The ending of its name chooses the format.

    .glb : one closed mesh per region, named as the region, in metres with the nail up, as glTF asks.
    .ply : one mesh of all interfaces, each face once, in millimetres; integer face properties `below` and `above` give
        the regions on both sides (normals point from below to above), and comments in the header name the regions.

    Raises: WriteError where the file cannot be written.
    """
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


def write_mitsuba(scene: Scene, folder: Path) -> dict[str, Path]:
    """Write a scene for each LED, the meshes and a README to a folder; returns their paths by what they are."""
    exported = compatibility.as_seen(scene, reflecting=True)
    geometry = build(exported)
    names, files = [face.name for face in geometry.photodiodes], []
    # Which photodiode emits which colour is a parameter of the file.
    colours: dict[int, Any] = {f.region: f"$photodiode_{k + 1}" for k, f in enumerate(geometry.photodiodes)}
    for i, led in enumerate(exported.leds):
        meshes, sensor = folder / MESHES / compatibility.led_file(exported, i, ""), geometry.leds[i].region
        make_folder(meshes)
        media = optics.finger_media(exported, geometry.regions, led.wavelength_nm)
        made = finger_scene(None, geometry, media, None, sensor=sensor, emitters=colours, folder=meshes)
        files.append(_document(made, names, folder))
    return compatibility.write_folder(
        "mitsuba",
        folder,
        scene,
        files,
        reflecting=True,
        about="one LED's scene, for variants `scalar_rgb`, `llvm_ad_rgb`, `cuda_ad_rgb`",
        photodiodes=", ".join(f"{k} {name}" for k, name in enumerate(names, start=1)),
    )


def _document(made: dict[str, Any], photodiodes: list[str], folder: Path) -> bytes:
    """A scene that Mitsuba's `load_dict` takes as a file for its `load_file`."""
    root = ElementTree.Element("scene", version="3.0.0")
    for k, name in enumerate(photodiodes):
        colour = ",".join("1" if k == c else "0" for c in range(COLOURS))
        root.append(ElementTree.Comment(f" photodiode_{k + 1} is {name.replace('--', '- -')} "))
        ElementTree.SubElement(root, "default", name=f"photodiode_{k + 1}", value=colour)
    for name, value in made.items():
        if name != "type":
            _add(root, name, value, folder, top=True)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)


def _add(parent: ElementTree.Element, name: str, value: Any, folder: Path, *, top: bool = False) -> None:
    """Add a field of a scene, or one of its objects with all that it holds, to an element."""
    if not isinstance(value, dict):
        kind = {bool: "boolean", int: "integer", float: "float", str: "string"}[type(value)]
        if name == "filename":
            value = Path(value).relative_to(folder).as_posix()
        text = str(value).lower() if isinstance(value, bool) else repr(value) if kind == "float" else str(value)
        ElementTree.SubElement(parent, kind, name=name, value=text)
    elif value["type"] == "ref":
        ElementTree.SubElement(parent, "ref", name=name, id=value["id"])
    elif value["type"] == "rgb":
        colour = value["value"]
        text = colour if isinstance(colour, str) else repr(float(colour))
        ElementTree.SubElement(parent, "rgb", name=name, value=text)
    else:
        own = {"id": name} if top else {"name": name}
        child = ElementTree.SubElement(parent, TAGS[value["type"]], {"type": value["type"], **own})
        for key, part in value.items():
            if key != "type":
                _add(child, key, part, folder)
