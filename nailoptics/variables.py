"""Variables of a Dataset under the CF conventions: dimensions, values, units, a name in words, and a standard error."""

import re
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .assets import read_toml
from .statistics import jackknife

if TYPE_CHECKING:
    import xarray as xr

Variable = tuple[tuple[str, ...], np.ndarray, dict[str, str]]
Variables = dict[str, Variable]
# Of more samples than this, what is worked out for each is kept in single precision, 6e-8 of it, which is far below
# the error of a trace and the step of a converter.
MANY_SAMPLES = 200_000
# By the ends of names.
UNITS = read_toml("units.toml")


def precision(samples: int) -> type[np.floating[Any]]:
    """The type in which numbers of each of so many samples are kept; their times are double always."""
    return np.float32 if samples > MANY_SAMPLES else np.float64


def stopwatch() -> Callable[[], dict[str, Any]]:
    """What tells the processor and wall time since now, as attributes of a result. [s]"""
    cpu, begin = time.process_time(), time.perf_counter()
    return lambda: {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}


def unit_of(field: str) -> str:
    """The unit that a field's name ends with: "N/m" of blood.tuning.vein_stiffness_n_per_m; "1" where it has none."""
    head, *below = re.sub(r"\[\d+\]", "", field).rpartition(".")[2].split("_per_")
    words = head.split("_")
    ends = ("_".join(words[-count:]) for count in (2, 1) if count < len(words))
    above = next((UNITS[end] for end in ends if end in UNITS), "1")
    return "/".join([above, *(UNITS.get(word, word) for word in below)])


def variable(
    name: str, dims: str | tuple[str, ...], values: Any, long_name: str, *, units: str = "1", stderr: Any = None
) -> Variables:
    """A variable by its name, with its standard error beside it as NAME_stderr if it has one.

    Joined by |, several make the first argument of `xarray.Dataset`.
    """
    dims, values = (dims,) if isinstance(dims, str) else dims, np.asarray(values)
    # Texts have no units, not even 1.
    attributes = {"long_name": long_name} if values.dtype.kind in "OSU" else {"units": units, "long_name": long_name}
    if stderr is None:
        return {name: (dims, values, attributes)}
    return {
        name: (dims, values, attributes | {"ancillary_variables": f"{name}_stderr"}),
        f"{name}_stderr": (dims, np.asarray(stderr), {"units": units, "long_name": f"standard error: {long_name}"}),
    }


class Estimate(NamedTuple):
    """Values with their standard errors, of one shape."""

    values: Any
    stderr: Any


def jackknifed(replicates: np.ndarray) -> Estimate:
    """An estimate made from all groups of photons and without each, (1 + groups, ...) float."""
    return Estimate(replicates[0], jackknife(replicates))


def stacked_rows(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The rows' arrays or numbers by name, all rows together, (rows, ...)."""
    return {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def described(package: str, /, **values: Any) -> Variables:
    """Variables as variables.toml of a package describes them by name: dims, long_name and, unless it is 1, units.

    values : arrays, or an `Estimate` where a variable has a standard error.
    """
    data: Variables = {}
    for name, value in values.items():
        of = value if isinstance(value, Estimate) else Estimate(value, None)
        about = _descriptions(package)[name]
        data |= variable(name, values=of.values, stderr=of.stderr, **about | {"dims": tuple(about["dims"])})
    return data


@cache
def _descriptions(package: str) -> dict[str, dict[str, Any]]:
    return tomllib.loads(resources.files(package).joinpath("variables.toml").read_text(encoding="utf-8"))


def to_record(dataset: "xr.Dataset") -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A dataset as a header for JSON and arrays of numbers."""
    variables, arrays = {}, {}
    for name, variable in dataset.variables.items():
        entry: dict[str, Any] = {"dims": variable.dims, "attrs": variable.attrs, "coord": name in dataset.coords}
        if variable.dtype.kind in "biuf":
            arrays[str(name)] = variable.values
        else:
            entry["text"] = [str(item) for item in variable.values.ravel()]
            entry["shape"] = variable.shape
        variables[str(name)] = entry
    attributes = {k: v for k, v in dataset.attrs.items() if k not in ("scene", "cpu_seconds", "wall_seconds", "reused")}
    return {"variables": variables, "attrs": attributes}, arrays


def from_record(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> "xr.Dataset":
    """The dataset that `to_record` took apart."""
    import xarray as xr

    data: dict[str, Any] = {}
    coords: dict[str, Any] = {}
    for name, entry in header["variables"].items():
        values = arrays[name] if name in arrays else np.array(entry["text"], dtype=str).reshape(entry["shape"])
        (coords if entry["coord"] else data)[name] = (tuple(entry["dims"]), values, entry["attrs"])
    return xr.Dataset(data, coords=coords, attrs=dict(header["attrs"]))
