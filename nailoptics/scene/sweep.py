"""A sweep file: a base scene and axes by dotted path, or a list of scenes, become the scenes of a batch."""

import copy
import itertools
import math
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..assets import data_dir
from ..errors import InputError
from . import Scene, load_scene
from .files import explain, frozen

MAX_SCENES = 1_000_000
_COMBINE = ("product", "zip", "latin_hypercube")
_TOP = ("schema_version", "base", "scenes", "combine", "samples", "seed", "axes")
_GIVEN = ("values", "linspace", "logspace", "range")


@dataclass(frozen=True)
class Axis:
    """What one axis sets: a place in the scene, and its values (for Latin hypercubes, one per scene)."""

    name: str
    path: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Sweep:
    """The scenes of a sweep, in order, and how they lie along its axes.

    dims : the dimensions of the results and their sizes; the last one varies fastest.
    """

    name: str
    axes: tuple[Axis, ...]
    dims: dict[str, int]
    scenes: tuple[Scene, ...]


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep file and build its scenes.

    Raises: InputError, one line that names the file, the field, the rule and the value.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give the path of a sweep file.") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: is not valid TOML: {' '.join(str(error).split())}.") from None
    try:
        return _build(data, path)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def _build(data: dict[str, Any], path: Path) -> Sweep:
    for key in data:
        if key not in _TOP:
            raise InputError(f"{key} is not a known field; known here: {', '.join(_TOP)}.")
    if data.get("schema_version") != 1:
        raise InputError(f"schema_version = {data.get('schema_version')}: must be 1; add it.")
    if ("base" in data) == ("scenes" in data):
        raise InputError("a sweep has either base (a scene file or table) or scenes (a list of files); give one.")
    combine = data.get("combine", "product")
    if combine not in _COMBINE:
        raise InputError(f"combine = {combine!r}: must be one of {', '.join(_COMBINE)}.")
    tables = data.get("axes", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError("axes: must be an array of tables, [[axes]].")
    if "base" in data and not tables:
        raise InputError("axes: a sweep over one base scene needs at least one [[axes]] table.")
    for key in ("samples", "seed"):
        if key in data and combine != "latin_hypercube":
            raise InputError(f'{key} belongs to combine = "latin_hypercube"; leave it out.')
    axes = _axes(tables, combine, data)
    files = data.get("scenes")
    bases = [_base(data["base"], path)] if files is None else [_base(f, path) for f in _list_of_files(files)]
    dims = {} if files is None else {"scene": len(bases)}
    if combine == "product":
        dims |= {axis.name: len(axis.values) for axis in axes}
        points = list(range(len(axis.values)) for axis in axes)
    elif axes:
        dims["sample"] = len(axes[0].values)
        points = [range(len(axes[0].values))]
    else:
        points = []
    if math.prod(dims.values()) > MAX_SCENES:
        raise InputError(f"axes make {math.prod(dims.values())} scenes; at most {MAX_SCENES}, use fewer values.")
    scenes = []
    for (raw, folder, name), *index in itertools.product(bases, *points):
        picks = index if combine == "product" else index * len(axes)
        scenes.append(_scene(raw, folder, name, [(a, a.values[i]) for a, i in zip(axes, picks, strict=True)]))
    if files is not None:
        axes = (Axis("scene", "", tuple(Path(f).stem for f in files)), *axes)
    return Sweep(path.stem, axes, dims, tuple(scenes))


def _list_of_files(files: Any) -> list[str]:
    if not isinstance(files, list) or not files or not all(isinstance(f, str) for f in files):
        raise InputError("scenes: must be an array of scene files, at least one.")
    return files


def _base(base: Any, path: Path) -> tuple[dict[str, Any], Path, str]:
    """A base scene as the user wrote it, with the folder of its parts and its name."""
    if isinstance(base, dict):
        return base, path.parent, "base"
    if not isinstance(base, str):
        raise InputError(f"base = {base!r}: must be the path of a scene file, or a table.")
    file = path.parent / base
    if not file.exists() and Path(base).parent == Path():
        shipped = data_dir("scenes") / (base if base.endswith(".toml") else f"{base}.toml")
        file = shipped if shipped.exists() else file
    load_scene(file)  # a fault of the base is told as its own, before any axis touches it
    return tomllib.loads(file.read_text(encoding="utf-8-sig")), file.parent, base


def _axes(tables: list[dict[str, Any]], combine: str, data: dict[str, Any]) -> tuple[Axis, ...]:
    lhs = combine == "latin_hypercube"
    samples = data.get("samples")
    if lhs and not (isinstance(samples, int) and not isinstance(samples, bool) and 1 <= samples <= MAX_SCENES):
        raise InputError(f"samples = {samples}: a Latin hypercube needs a whole number of 1 to {MAX_SCENES}.")
    columns: Any = [None] * len(tables)
    if lhs and tables:
        from scipy.stats import qmc

        seed = data.get("seed", 0)
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise InputError(f"seed = {seed!r}: must be a whole number of at least 0.")
        columns = qmc.LatinHypercube(d=len(tables), rng=np.random.default_rng(seed)).random(samples).T
    axes: list[Axis] = []
    for i, (table, column) in enumerate(zip(tables, columns, strict=True)):
        where = f"axes[{i}]"
        for key in table:
            if key not in ("path", "name", *_GIVEN):
                raise InputError(f"{where}.{key} is not a known field; known here: path, name, {', '.join(_GIVEN)}.")
        place = table.get("path")
        if not isinstance(place, str) or not place:
            raise InputError(f'{where}.path is missing; give a place in the scene such as "blood.so2".')
        _steps(place, where)
        name = table.get("name", re.sub(r"\W+", "_", place.rpartition(".")[2] or place).strip("_"))
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"{where}.name = {name!r}: must be a name of letters, digits and _.")
        if name in _TAKEN or any(a.name == name for a in axes):
            raise InputError(f'{where}: the name "{name}" is taken; give the axis another name = "...".')
        axes.append(Axis(name, place, _values(table, where, column)))
    if combine == "zip":
        for axis in axes[1:]:
            if len(axis.values) != len(axes[0].values):
                raise InputError(
                    f'axes "{axes[0].name}" and "{axis.name}" have {len(axes[0].values)} and {len(axis.values)} '
                    'values; combine = "zip" needs as many of each.'
                )
    return tuple(axes)


# Names that the results themselves use.
_TAKEN = {"led", "photodiode", "absorber", "zone", "time", "scene", "sample", "part", "state", "digest"}


def _values(table: dict[str, Any], where: str, column: np.ndarray | None) -> tuple[Any, ...]:
    given = [key for key in _GIVEN if key in table]
    if len(given) != 1:
        raise InputError(f"{where}: give exactly one of {', '.join(_GIVEN)}.")
    kind, raw = given[0], table[given[0]]
    if (kind == "range") != (column is not None and kind != "values"):
        rule = (
            'a Latin hypercube takes range = [low, high] or values; linspace and logspace are for "product" and "zip"'
        )
        raise InputError(f"{where}.{kind}: {rule}.")
    if kind == "values":
        if not isinstance(raw, list) or not raw:
            raise InputError(f"{where}.values: must be an array with at least one value.")
        if column is not None:
            return tuple(raw[int(x * len(raw))] for x in column)
        return tuple(raw)
    count = 2 if kind == "range" else 3
    numbers = isinstance(raw, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in raw)
    if not numbers or len(raw) != count or not all(math.isfinite(x) for x in raw):
        raise InputError(f"{where}.{kind} = {raw}: must be [low, high{', count' if count == 3 else ''}].")
    low, high = float(raw[0]), float(raw[1])
    if column is not None:
        return tuple((low + (high - low) * column).tolist())
    if raw[2] != int(raw[2]) or not 1 <= raw[2] <= MAX_SCENES:
        raise InputError(f"{where}.{kind}: count = {raw[2]}; must be a whole number of 1 to {MAX_SCENES}.")
    if kind == "logspace":
        if low <= 0 or high <= 0:
            raise InputError(f"{where}.logspace = {raw}: low and high must be above 0.")
        return tuple(np.geomspace(low, high, int(raw[2])).tolist())
    return tuple(np.linspace(low, high, int(raw[2])).tolist())


def _steps(place: str, where: str) -> list[str | int]:
    """A dotted path as keys and indices: leds[0].flux_mw is leds, 0, flux_mw."""
    steps: list[str | int] = []
    for part in place.split("."):
        match = re.fullmatch(r"([\w\-]+)((?:\[\d+\])*)", part)
        if not match:
            raise InputError(f'{where}.path = "{place}": "{part}" is no field; write it as in leds[0].flux_mw.')
        steps.append(match[1])
        steps += [int(n) for n in re.findall(r"\d+", match[2])]
    return steps


def _scene(raw: dict[str, Any], folder: Path, name: str, picks: list[tuple[Axis, Any]]) -> Scene:
    data = copy.deepcopy(raw)
    for axis, value in picks:
        _set(data, axis, value)
    try:
        # The values are set in what the user wrote, so that a digit or a part still fills what was not given.
        return Scene.model_validate(frozen(data), context={"folder": folder})
    except (ValidationError, InputError) as error:
        why = explain(error, Scene) if isinstance(error, ValidationError) else str(error)
        at = ", ".join(f"{axis.path} = {value}" for axis, value in picks)
        raise InputError(" ".join(f"{name} with {at}: {why}".splitlines())) from None


def _set(data: dict[str, Any], axis: Axis, value: Any) -> None:
    *way, last = _steps(axis.path, "axes")
    current: Any = data
    for depth, step in enumerate(way):
        if isinstance(current, dict) and isinstance(step, str):
            current = current.setdefault(step, {})
        else:
            current = current[_place(current, step, axis, depth)]
    if isinstance(current, dict) and isinstance(last, str):
        current[last] = value
    else:
        current[_place(current, last, axis, len(way))] = value


def _place(items: Any, step: str | int, axis: Axis, depth: int) -> int:
    """The index of an item of an array, by number or by its name."""
    if isinstance(items, list):
        names = [item.get("name", item.get("array")) if isinstance(item, dict) else None for item in items]
        if isinstance(step, int) and step < len(items):
            return step
        if step in names:
            return names.index(step)
        known = f"0 to {len(items) - 1}" + (f" or {', '.join(n for n in names if n)}" if any(names) else "")
        raise InputError(f'axis path "{axis.path}": there is no item {step} here; known: {known}.')
    raise InputError(f'axis path "{axis.path}" goes on at {step!r} where the base scene has a value; correct the path.')
