"""Scenes to and from TOML, their digest, their JSON Schema, and errors in the user's words."""

import difflib
import hashlib
import json
import re
import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from ..errors import InputError
from .models import Scene


def load_scene(path: str | Path) -> Scene:
    """Read a scene file.

    Parts and recordings are looked for beside it, and their contents become part of the scene.

    Raises: InputError, one line that names the file, the field, the rule and the value.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors write a byte order mark
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give the path of a scene file.") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file; give the path of a scene file (TOML).") from None
    return parse_scene(text, folder=path.parent, name=str(path))


def parse_scene(text: str, *, folder: str | Path | None = None, name: str = "scene") -> Scene:
    """Read a scene from TOML text; folder is where its parts and recordings lie."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(_one_line(f"{name}: is not valid TOML: {error}.")) from None
    except RecursionError:
        raise InputError(f"{name}: is not a scene: its tables or arrays are nested too deep.") from None
    try:
        return Scene.model_validate(frozen(data), context={"folder": folder})
    except ValidationError as error:
        raise InputError(_one_line(f"{name}: {explain(error, Scene)}")) from None
    except InputError as error:
        raise InputError(_one_line(f"{name}: {error}")) from None


def _one_line(text: str) -> str:
    return " ".join(text.splitlines())


def frozen(data: Any) -> Any:
    """TOML's arrays as tuples, which is what frozen models hold."""
    if isinstance(data, dict):
        return {key: frozen(value) for key, value in data.items()}
    return tuple(frozen(item) for item in data) if isinstance(data, list) else data


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """The first fault of a validation in one line: field, rule, value, what to do."""
    faults = error.errors(include_url=False)
    # An array with a faulty item is also called too short; once is enough.
    faults = [f for f in faults if f["type"] != "too_short" or not f["input"]]
    fault = faults[0]
    where = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in fault["loc"]).lstrip(".")
    value = fault.get("input")
    if fault["type"] == "extra_forbidden":
        known = _fields_at(model, fault["loc"][:-1])
        close = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1)
        line = f"{where} is not a known field; " + (
            f'did you mean "{close[0]}"?' if close else f"known here: {', '.join(known)}."
        )
    elif fault["type"] == "missing":
        line = f"{where} is missing; add it."
    elif fault["type"] == "value_error":
        line = (f"{where}: " if where else "") + str(fault["ctx"]["error"]) + "."
    else:
        shown = json.dumps(value, default=str) if not isinstance(value, dict) else "a table"
        line = f"{where} = {shown[:60]}: must {_rule(fault['msg'])}."
    return line + (f" (and {len(faults) - 1} more)" if len(faults) > 1 else "")


def _rule(message: str) -> str:
    """Pydantic's rule in TOML's words: "Tuple should have at least 1 item ..." is "have at least 1 item ..."."""
    rule = re.sub(r"^(Input|Value|Tuple|String) should ", "", message)
    rule = re.sub(r"a valid dictionary or instance of \w+", "a table", rule)
    return rule.replace("a valid tuple", "an array").replace(" after validation", "")


def _fields_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Names of the fields of the table at a location in a scene."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        annotation = current.model_fields[part].annotation if part in current.model_fields else None
        found = [m for m in _models_in(annotation)]
        if not found:
            return []
        current = found[0]
    return list(current.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for argument in getattr(annotation, "__args__", ()) for m in _models_in(argument)]


def canonical_json(scene: Scene) -> str:
    """The scene as JSON with sorted keys: the text behind the digest."""
    return json.dumps(scene.model_dump(mode="json", exclude_none=True), sort_keys=True, separators=(",", ":"))


def digest(scene: Scene) -> str:
    """SHA-256 of the whole scene, (64) hexadecimal characters."""
    return hashlib.sha256(canonical_json(scene).encode()).hexdigest()


def to_toml(scene: Scene) -> str:
    """The scene as TOML, complete: parts and recordings are written out."""
    import tomli_w

    return tomli_w.dumps(scene.model_dump(mode="python", exclude_none=True))


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scene file, for editors."""
    schema = Scene.model_json_schema(mode="validation")
    # Parts fill what is required of an LED or a photodiode, so an editor must not ask for it.
    schema["$defs"]["Led"]["required"] = ["name"]
    schema["$defs"]["Photodiode"]["required"] = ["position_mm"]
    schema["title"] = "nailoptics scene"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | schema
