"""A finger for plain Mitsuba: one scene of XML per LED, its interfaces as PLY meshes, and how to render them."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ..geometry import build
from ..io import make_folder
from ..light import optics
from ..light.reference.mitsuba_scene import finger_scene
from ..scene import Scene
from . import compatibility

# What an object of a scene is called in XML, by its type.
TAGS = {"volpath": "integrator", "homogeneous": "medium", "hg": "phase", "ply": "shape", "area": "emitter"}
TAGS |= dict.fromkeys(("diffuse", "dielectric", "null"), "bsdf")
TAGS |= {"irradiancemeter": "sensor", "hdrfilm": "film", "box": "rfilter"}
# Photodiodes read in one rendering, one in each colour.
COLOURS = 3
MESHES = "meshes"


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
    own = [
        ("emission of the LEDs", "Lambertian, from the whole die", "the same, backwards"),
        ("sides of dies and photodiodes in the film", "those of photodiodes detect, too", "black"),
        ("paths in the tissue", "recorded for every photon", "none: render again for other absorption"),
    ]
    return compatibility.write_folder(
        "mitsuba",
        folder,
        exported,
        files,
        rows=compatibility.rows(scene, geometry, own=own, reflecting=True),
        about="one LED's scene, for variants `scalar_rgb`, `llvm_ad_rgb`, `cuda_ad_rgb`",
        photodiodes=compatibility.numbered(names, start=1),
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
