"""Scenes to and from TOML, their digest, their JSON Schema, and errors in the user's words."""

import hashlib
import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..assets import data_dir
from ..checks import as_input_error, nearest
from ..errors import InputError
from .base import Table
from .scene import Scene
from .text_files import is_there, parse_toml, read_text, short

# What studies take: a scene, its file, or the name of a shipped one.
SceneIn = Scene | str | Path


def load_scene(path: str | Path) -> Scene:
    """Read a scene file, or the shipped scene of that name, such as prototype.

    Parts and recordings are looked for beside it, and their contents become part of the scene.

    Raises: InputError, one line that names the file, the field, the rule and the value.
    """
    if not isinstance(path, str | Path):
        raise InputError(f'scene = {short(repr(path))}: give a Scene, or the path or name of one, such as "prototype".')
    given, path = str(path), Path(path)
    if not is_there(path):
        path = shipped_scene(given) or path
        if not is_there(path) and path.parent == Path() and not path.suffix:
            known = sorted(path.stem for path in data_dir("scenes").glob("*.toml"))
            own = {path.stem: path.name for path in Path().glob("*.toml")}
            meant = f'did you mean "{own.get(near, near)}"? ' if (near := nearest(given, [*known, *own])) else ""
            why = f"there is no such file and no shipped scene of that name; {meant}shipped: {', '.join(known)}."
            raise InputError(f"{given}: {why}")
    return parse_scene(read_text(path, "the path of a scene file (TOML)"), folder=path.parent, name=str(path))


def as_scene(scene: SceneIn) -> Scene:
    """The scene, or that of a file or of a shipped scene's name; raises InputError for anything else."""
    return scene if isinstance(scene, Scene) else load_scene(scene)


def shipped_scene(name: str) -> Path | None:
    """The file of the shipped scene of a name, as prototype, prototype.toml or scenes/prototype.toml; None without."""
    path = Path(name)
    shipped = data_dir("scenes") / (path.name if path.suffix else f"{path.name}.toml")
    return shipped if path.parent in (Path(), Path("scenes")) and is_there(shipped) else None


def parse_scene(text: str, *, folder: str | Path | None = None, name: str = "scene") -> Scene:
    """Read a scene from TOML text; folder is where its parts and recordings lie."""
    return scene_of(parse_toml(text, name, "scene"), folder=folder, name=name)


def scene_of(tables: dict[str, Any], *, folder: str | Path | None = None, name: str = "") -> Scene:
    """A scene from its tables, in which arrays are tuples; raises InputError where they make none.

    name : what the message begins with.
    """
    try:
        return Scene.model_validate(tables, context={"folder": folder})
    except (ValidationError, InputError) as error:
        raise as_input_error(error, Scene, name) from None


def digest(scene: Scene) -> str:
    """SHA-256 of the whole scene as JSON with sorted keys, (64) hexadecimal characters."""
    plain = scene.model_dump(mode="json", exclude_none=True)
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def to_toml(scene: SceneIn) -> str:
    """The scene as TOML, complete: parts and recordings are written out."""
    import tomli_w

    return tomli_w.dumps(as_scene(scene).model_dump(mode="python", exclude_none=True))


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scene file, for editors."""
    schema = schema_of(Scene, "nailoptics scene")
    # Parts fill what is required of an LED or a photodiode, so an editor must not require it.
    schema["$defs"]["Led"]["required"] = ["name"]
    schema["$defs"]["Photodiode"]["required"] = ["position_mm"]
    return schema


def schema_of(model: type[Table], title: str) -> dict[str, Any]:
    """JSON Schema of a file whose tables make a model."""
    schema = model.model_json_schema(mode="validation") | {"title": title}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema
