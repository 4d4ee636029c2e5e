"""Export a scene: glb and ply are meshes for viewers and CAD; mmc, mcx and mitsuba trace the same light elsewhere;
kicad_pcb is its board, spice its circuit."""

import os
from importlib import import_module
from pathlib import Path
from typing import Any, Unpack

from ..errors import InputError
from ..io import check_writable
from ..options import FormatName, Requested
from ..scene import SceneIn, as_scene

# The function that writes a scene to a path and returns the files by what they are, and the endings that a file's name
# may have; formats without any make a folder.
WRITERS: dict[FormatName, tuple[str, str, tuple[str, ...]]] = {
    "glb": ("mesh_files", "write_mesh", (".glb",)),
    "ply": ("mesh_files", "write_mesh", (".ply",)),
    "kicad_pcb": ("kicad_board", "write_kicad_pcb", (".kicad_pcb",)),
    "spice": ("spice", "write_spice", (".cir", ".sp")),
    "mmc": ("monte_carlo", "write_mmc", ()),
    "mcx": ("monte_carlo", "write_mcx", ()),
    "mitsuba": ("mesh_files", "write_mitsuba", ()),
}


def export(
    scene: SceneIn,
    path: str | Path,
    *,
    format: FormatName | None = None,
    voxel_mm: float | None = None,
    folder: str | Path | None = None,
    **requested: Unpack[Requested],
) -> dict[str, Path]:
    """Write a finger scene for another program.

    path : a file for glb, ply, kicad_pcb and spice (.cir or .sp), else a folder, which is made.
    format : if not given, the ending of the path decides.
    voxel_mm : side of the voxels of the format mcx; 0.1 if not given. [mm]
    folder : where the board lies from which the scene's layout came, for kicad_pcb; the current one if not given.

    requested : fields of `TraceOptions` for the format spice, which traces the light of the scene.

    Returns: what was written, by what it is.

    Raises: InputError for a phantom or an unknown format; WriteError where nothing can be written.
    """
    scene = as_scene(scene)
    if not isinstance(path, str | Path):
        raise InputError(f"path = {path!r}: is not a path; give a file or folder to write.")
    path = Path(path)
    ending, known = path.suffix.lower(), ", ".join(WRITERS)
    name = format or next((one for one, (*_, endings) in WRITERS.items() if ending in endings), None)
    if name is None:
        those = ", ".join(one for *_, endings in WRITERS.values() for one in endings)
        raise InputError(f"{path}: its ending names no format; end it in {those}, or give format, one of {known}.")
    if name not in WRITERS:
        raise InputError(f'format = "{name}" is unknown; choose from {known}.')
    if voxel_mm is not None and name != "mcx":
        raise InputError(f"voxel_mm = {voxel_mm:g} belongs to the format mcx, not to {name}; leave it out.")
    if requested and name != "spice":
        raise InputError(f"{next(iter(requested))} belongs to the format spice, not to {name}; leave it out.")
    module, function, endings = WRITERS[name]
    if endings and ending not in endings:
        raise InputError(f"{path}: a file in the format {name} ends in {' or '.join(endings)}; rename it.")
    if not endings and os.path.exists(path) and not os.path.isdir(path):
        raise InputError(f"{path}: is a file where format {name} makes a folder; choose another name.")
    check_writable(path.parent if endings else path, *([path.name] if endings else []))
    if scene.finger is None:
        why = "a phantom is laterally infinite and has no mesh, board or touch; export a scene with [finger]"
        raise InputError(f"export: {why}, or give its layers to the other program by hand.")
    write = getattr(import_module(f".{module}", __package__), function)
    more: dict[str, Any] = {**requested} if voxel_mm is None else {"voxel_mm": voxel_mm}
    if name == "kicad_pcb":
        more["folder"] = Path(folder or ".")
    return write(scene, path, **more)
