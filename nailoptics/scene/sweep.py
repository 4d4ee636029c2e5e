"""A sweep file: a base scene and axes by dotted path, or a list of scenes, become the scenes of a batch."""

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, field_validator

from ..checks import as_input_error
from ..errors import InputError
from .base import Table
from .files import load_scene, scene_of, schema_of, shipped_scene
from .scene import Scene, steps_of, with_value
from .text_files import frozen, is_there, parse_toml, read_text, short

MAX_SCENES = 1_000_000
# Names that the results themselves use: of every study, and of some.
_TAKEN = {"led", "photodiode", "absorber", "zone", "time", "scene", "sample", "part", "state", "digest"}
_TAKEN_BY = {
    "colour": {"force", "place", "band", "channel", "wavelength", "row", "column", "prior", "site", "node", "end"},
    "oximeter": {"cause"},
}
_GIVEN = ("values", "linspace", "logspace", "range")

StudyName = Literal["simulate", "trace", "oximeter", "colour"]
Count = Annotated[int, Field(ge=1, le=MAX_SCENES)]
Spaced = tuple[float, float, Count]


class AxisTable(Table):
    """One axis of a sweep: a field of the scene and its values."""

    path: str
    """Path of the field, such as blood.so2, leds[0].flux_mw or leds.ir.position_mm."""
    name: str | None = None
    """Name of the axis in the results; the last part of the path if not given."""
    values: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    """The values themselves."""
    linspace: Spaced | None = None
    """[low, high, count]: evenly spaced values."""
    logspace: Spaced | None = None
    """[low, high, count]: logarithmically spaced values."""
    range: tuple[float, float] | None = None
    """[low, high] of a Latin hypercube."""

    @field_validator("path")
    @classmethod
    def _path_has_steps(cls, path: str) -> str:
        steps_of(path)
        return path

    def _check(self) -> None:
        if len([key for key in _GIVEN if getattr(self, key) is not None]) != 1:
            raise ValueError(f"give exactly one of {', '.join(_GIVEN)}")
        if self.logspace is not None and min(self.logspace[:2]) <= 0:
            raise ValueError(f"logspace = {list(self.logspace)}: low and high must be above 0")
        if not self.axis_name.isidentifier():
            raise ValueError(f'name = "{self.axis_name}": must be a name of letters, digits and _')

    @property
    def axis_name(self) -> str:
        """Name of the axis in the results."""
        last = self.path.rpartition(".")[2]
        return re.sub(r"\W+", "_", last).strip("_") if self.name is None else self.name

    def values_at(self, quantiles: np.ndarray | None = None) -> tuple[Any, ...]:
        """The values of the axis; at quantiles (samples,) in 0 to 1 of a Latin hypercube."""
        with np.errstate(all="ignore"):  # what overflows is not a value of any field, which says so
            if self.linspace is not None:
                return tuple(np.linspace(*self.linspace).tolist())
            if self.logspace is not None:
                return tuple(np.geomspace(*self.logspace).tolist())
        values = self.values or ()
        if quantiles is None:
            return values
        if self.range is not None:
            low, high = self.range
            return tuple((low + (high - low) * quantiles).tolist())
        return tuple(values[int(x * len(values))] for x in quantiles)


class SweepFile(Table):
    """A sweep."""

    schema_version: Literal[1]
    """Version of this format."""
    study: StudyName = "simulate"
    """The study of every scene: touch to volts, light only, a pulse oximeter, or colours and photographs."""
    base: str | dict[str, Any] | None = None
    """The base scene, modified by every axis: a scene file, a shipped scene's name, or a table."""
    scenes: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """Scene files, instead of one base."""
    combine: Literal["product", "zip", "latin_hypercube"] = "product"
    """product: every combination of values; zip: all axes together; latin_hypercube: random samples of all ranges."""
    samples: Count | None = None
    """Number of scenes of a Latin hypercube."""
    seed: Annotated[int, Field(ge=0)] | None = None
    """Seed of a Latin hypercube; 0 if not given."""
    axes: tuple[AxisTable, ...] = ()
    """The fields that vary; the last axis of a product varies fastest."""

    def _check(self) -> None:
        if (self.base is None) == (self.scenes is None):
            raise ValueError("a sweep has either base (a scene file or table) or scenes (a list of files); give one")
        if self.base is not None and not self.axes:
            raise ValueError("axes: a sweep over one base scene needs at least one [[axes]] table")
        taken = _TAKEN | _TAKEN_BY.get(self.study, set())
        for i, axis in enumerate(self.axes):
            if axis.axis_name in taken:
                raise ValueError(f'axes[{i}]: the name "{axis.axis_name}" is taken; give the axis another name = "..."')
            taken.add(axis.axis_name)
        sampled = self.combine == "latin_hypercube"
        if sampled and self.samples is None:
            raise ValueError("samples is missing: a Latin hypercube needs their number")
        for key in ("samples", "seed"):
            if not sampled and getattr(self, key) is not None:
                raise ValueError(f'{key} belongs to combine = "latin_hypercube"; leave it out')
        for i, axis in enumerate(self.axes):
            texts = {re.sub(r"\.0\b", "", str(value)) for value in axis.values or ()}  # 1 and 1.0 are one value
            if self.combine == "product" and len(texts) < len(axis.values or ()):
                raise ValueError(f"axes[{i}]: {axis.path} has a value twice; leave one out")
            if axis.values is None and (axis.range is not None) != sampled:
                why = 'linspace and logspace are for "product" and "zip"'
                raise ValueError(f"axes[{i}]: a Latin hypercube takes range = [low, high] or values; {why}")
        counts = {axis.axis_name: len(axis.values_at()) for axis in self.axes if self.combine == "zip"}
        if len({*counts.values()}) > 1:
            each = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ValueError(f'axes differ in their numbers of values, {each}; combine = "zip" needs as many of each')


@dataclass(frozen=True)
class Axis:
    """What one axis sets: a place in the scene, and its values (for Latin hypercubes, one per scene)."""

    name: str
    path: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Sweep:
    """The scenes of a sweep, in order, and how they lie along its axes.

    dims : The dimensions of the results and their sizes; the last one varies fastest.
    """

    name: str
    axes: tuple[Axis, ...]
    dims: dict[str, int]
    scenes: tuple[Scene, ...]
    study: StudyName = "simulate"


def load_sweep(path: str | Path) -> Sweep:
    """Read a sweep file and build its scenes; raises InputError."""
    path = Path(path)
    tables = parse_toml(read_text(path, "the path of a sweep file (TOML)"), str(path), "sweep")
    try:
        return _build(SweepFile.model_validate(tables), path)
    except (ValidationError, InputError) as error:
        raise as_input_error(error, SweepFile, "" if str(error).startswith(str(path)) else str(path)) from None


def sweep_over(
    scene: Scene | str | Path, over: Mapping[str, Any], *, study: StudyName = "simulate", combine: str = "product"
) -> Sweep:
    """The sweep of a scene, of a scene file or of a shipped scene over the values of its fields.

    An axis is called as the last part of its path; as all of it where another axis or the results have that name.

    Raises: InputError.
    """
    if not over or not isinstance(over, Mapping):
        raise InputError(f'over = {short(repr(over))}: give fields and values, such as {{"blood.so2": [0.9, 0.97]}}.')
    reserved, last = _TAKEN | _TAKEN_BY.get(study, set()), {path: str(path).rpartition(".")[2] for path in over}
    axes = []
    for path, given in over.items():
        values = frozen(list(given) if isinstance(given, range) else given)
        if not (isinstance(values, tuple) and values):
            raise InputError(f'over: "{path}" = {given!r} is not a list of values; give one, such as [0.9, 0.97].')
        shared = last[path] in reserved or list(last.values()).count(last[path]) > 1
        name = re.sub(r"\W+", "_", str(path)).strip("_") if shared else None
        axes.append({"path": str(path), "values": values, "name": name})
    base = dict(scene) if isinstance(scene, Scene) else str(scene)
    file = {"schema_version": 1, "study": study, "base": base, "combine": combine, "axes": tuple(axes)}
    try:
        return _build(SweepFile.model_validate(file), Path("sweep"))
    except (ValidationError, InputError) as error:
        raise as_input_error(error, SweepFile) from None


def sweep_json_schema() -> dict[str, Any]:
    """JSON Schema of a sweep file, for editors."""
    return schema_of(SweepFile, "nailoptics sweep")


def _build(file: SweepFile, path: Path) -> Sweep:
    points = zip if file.combine != "product" else itertools.product
    quantiles: list[np.ndarray | None] = [None] * len(file.axes)
    if file.combine == "latin_hypercube" and file.axes:
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(d=len(file.axes), rng=np.random.default_rng(file.seed or 0))
        quantiles = list(sampler.random(file.samples).T)
    pairs = zip(file.axes, quantiles, strict=True)
    axes = tuple(Axis(axis.axis_name, axis.path, axis.values_at(column)) for axis, column in pairs)
    dims = {axis.name: len(axis.values) for axis in axes}
    if file.combine != "product" and axes:
        dims = {"sample": len(axes[0].values)}
    if file.scenes is not None:
        dims = {"scene": len(file.scenes)} | dims
    if math.prod(dims.values()) > MAX_SCENES:
        raise InputError(f"axes make {math.prod(dims.values())} scenes; at most {MAX_SCENES}, use fewer values.")
    given = list(points(*(axis.values for axis in axes))) if axes else [()]
    bases = [_base(base, path, axes) for base in file.scenes or [file.base]]
    of_finger = {"blood", "touch", "body", "board", "colour", "priors", "placement"}
    for axis in axes if all(tables.get("phantom") for _, tables, _ in bases) else ():
        if steps_of(axis.path)[0] in of_finger:
            raise InputError(f'path "{axis.path}" changes nothing of a [phantom]; give a field of it, or a [finger].')
    scenes = tuple(_scene(*base, axes, values) for base in bases for values in given)
    if file.scenes is not None:
        axes = (Axis("scene", "", tuple(Path(name).stem for name in file.scenes)), *axes)
    return Sweep(path.stem, axes, dims, scenes, file.study)


def _base(base: Any, path: Path, axes: Sequence[Axis]) -> tuple[str, dict[str, Any], Path]:
    """Name of a base scene, its tables as the user wrote them, and the folder of its parts; where an axis is of a part
    that a board's file has, what the scene is with that file read."""
    if isinstance(base, dict):
        return "base", base, path.parent
    file = path.parent / base
    if not is_there(file):
        file = shipped_scene(base) or file
    read = load_scene(file)  # a fault of the base is reported as its own, before any axis touches it
    if read.board.unmapped is not None and {"leds", "photodiodes"} & {steps_of(axis.path)[0] for axis in axes}:
        return base, dict(read), file.parent
    return base, parse_toml(read_text(file, "the path of a scene file (TOML)"), str(file)), file.parent


def _scene(name: str, tables: dict[str, Any], folder: Path, axes: tuple[Axis, ...], values: tuple[Any, ...]) -> Scene:
    """The base with values at their places; a digit or a part still fills what was not given."""
    at = []
    for axis, value in zip(axes, values, strict=True):
        tables = with_value(tables, steps_of(axis.path), value, axis.path)
        at.append(f"{axis.path} = {short(str(value))}")
    return scene_of(tables, folder=folder, name=f"{name} with {', '.join(at)}" if at else name)
