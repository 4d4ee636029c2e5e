"""Export a scene: the one table of formats that other programs read."""

import os
from importlib import import_module
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from ..errors import InputError
from ..io import check_writable
from ..scene import Scene

FormatName = Literal["glb", "ply", "mmc", "mcx", "mitsuba"]


class Format(NamedTuple):
    """How a scene is written for other programs.

    what : in a few words. module, write : the function that writes a scene to a path and returns the files by what
    they are. folder : whether the path is a folder.
    """

    what: str
    module: str
    write: str
    folder: bool = True


FORMATS: dict[FormatName, Format] = {
    "glb": Format("a mesh with one named part per region, for viewers and CAD", "mesh_files", "write_mesh", False),
    "ply": Format("a mesh of the interfaces, with the regions beside each face", "mesh_files", "write_mesh", False),
    "mmc": Format("tetrahedra, media, source and detectors for MMC and pmmc", "mmc", "write_mmc"),
    "mcx": Format("labelled voxels, media, source and detectors for MCX and pmcx", "mcx", "write_mcx"),
    "mitsuba": Format("XML and meshes that plain Mitsuba renders", "mitsuba_files", "write_mitsuba"),
}
"""Formats by name, as `nailoptics export --format` knows them."""


def export(
    scene: Scene, path: str | Path, *, format: FormatName | None = None, voxel_mm: float | None = None
) -> dict[str, Path]:
    """Write a finger scene for another program.

    path : a file for glb and ply, else a folder, which is made.
    format : name of one of `FORMATS`; if not given, the ending of the path tells it.
    voxel_mm : side of the voxels of the format mcx; 0.1 if not given. [mm]

    Returns: what was written, by what it is.

    Raises: InputError for a phantom or an unknown format; WriteError where nothing can be written.
    """
    path = Path(path)
    ending = path.suffix.lower().removeprefix(".")
    known = ", ".join(get_args(FormatName))
    if format is None and ending not in FORMATS:
        files = " or ".join(f".{name}" for name, one in FORMATS.items() if not one.folder)
        raise InputError(f"{path}: its ending names no format; end a file in {files}, or give format, one of {known}.")
    name = ending if format is None else format
    if name not in FORMATS:
        raise InputError(f'format = "{name}" is none; choose from {known}.')
    if voxel_mm is not None and name != "mcx":
        raise InputError(f"voxel_mm = {voxel_mm:g} belongs to the format mcx, not to {name}; leave it out.")
    chosen = FORMATS[name]
    if not chosen.folder and ending != name:
        raise InputError(f"{path}: a file in the format {name} ends in .{name}; rename it.")
    if chosen.folder and os.path.exists(path) and not os.path.isdir(path):
        raise InputError(f"{path}: is a file where format {name} makes a folder; choose another name.")
    check_writable(path if chosen.folder else path.parent, *([] if chosen.folder else [path.name]))
    if scene.finger is None:
        raise InputError(
            "export: a phantom is laterally infinite and has no mesh; export a scene with [finger], or give its layers "
            "to the other program by hand."
        )
    write = getattr(import_module(f".{chosen.module}", __package__), chosen.write)
    paths: dict[str, Path] = write(scene, path, **({} if voxel_mm is None else {"voxel_mm": voxel_mm}))
    return paths
