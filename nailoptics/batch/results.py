"""The results of a batch as one dataset over the sweep's axes, and as a table."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from ..io import CorruptError, plain_cell, write_text
from .folder import Folder, ForeignError
from .study_runs import STUDIES
from .work import other_versions

log = logging.getLogger(__name__)

DONE, MISSING, FAILED, CORRUPT, FOREIGN = "done", "missing", "failed", "corrupt", "foreign"
# A variable of one scene: dimensions, values, attributes.
Stored = tuple[tuple[str, ...], np.ndarray, dict[str, Any]]
# What a result's header says of it, in the table: its name there, units, text.
_TOLD = (
    ("relative_error", "relative_error", "largest relative error"),
    ("photons", "photons_per_led", "photons per LED"),
    ("reached", "reached", "as accurate as requested"),
)


@dataclass(frozen=True)
class _Result:
    """One scene's result, taken apart: a dataset of its own for each would take most of the time."""

    data: dict[str, Stored]
    coords: dict[str, Stored]
    attrs: dict[str, Any]


def open_results(folder: str | Path, *, course: bool = False) -> xr.Dataset:
    """All results of a batch as one dataset, with the sweep's axes as its first dimensions and as coordinates.

    Scenes without a result of this batch are NaN (numbers), False, empty text or black (photographs); `state` says why:
    missing, failed, corrupt, or foreign, which is another seed's, backend's or version's.

    course : also what runs over time (volts, blood, force), for which the scenes must share their times.

    Raises: InputError where the folder holds no batch, or its scenes do not fit one dataset.
    """
    place = Folder(Path(folder))
    plan = place.read_plan()
    dims, shape = tuple(plan["dims"]), tuple(plan["dims"].values())
    names = {axis["name"] for axis in plan["axes"]}
    states: list[str] = []
    stack = _Stack(len(plan["scenes"]))
    for number, digest in enumerate(plan["scenes"]):
        one, state = None, DONE
        try:
            stored = place.read_result(digest, made=plan["made"])
            if stored:
                one = _result(*stored, names, course)
            else:
                state = FAILED if place.has_failed(digest) else MISSING
        except ForeignError:
            state = FOREIGN
        except CorruptError:
            state = FAILED if place.has_failed(digest) else CORRUPT
        states.append(state)
        if one is not None:
            stack.add(number, one)
    for state, why in ((CORRUPT, "damaged"), (FOREIGN, "another seed's, backend's or version's")):
        if count := states.count(state):
            log.warning("%s: %d results are %s and left out; run the batch again", place.root, count, why)
    if moved := other_versions(plan["made"]):
        log.warning("%s: was made with %s", place.root, moved)
    dataset = stack.dataset(dims, shape)
    text = "done, missing, failed, corrupt or foreign"
    dataset["state"] = (dims, np.array(states).reshape(shape), {"long_name": text})
    dataset["digest"] = (dims, np.array(plan["scenes"]).reshape(shape), {"long_name": "digest of the scene"})
    dataset = dataset.assign_coords(_coordinates(plan))
    dataset.attrs |= {"title": f"nailoptics: batch {plan['sweep']}", "Conventions": "CF-1.11"}
    dataset.attrs |= {name: plan["made"][name] for name in ("seed", "backend")} | {"study": plan["study"]}
    return dataset


def _result(header: dict[str, Any], arrays: dict[str, np.ndarray], axes: set[str], course: bool) -> _Result:
    """A scene's result without what runs over time, unless that is wanted.

    axes : names of the sweep's axes; a result that is called as one of them is renamed: leds.ir.wavelength_nm.
    """
    data: dict[str, Stored] = {}
    coords: dict[str, Stored] = {}
    for name, entry in header["variables"].items():
        dims = tuple(entry["dims"])
        if not course and "time" in dims:
            continue
        values = arrays[name] if name in arrays else np.array(entry["text"], dtype=str).reshape(entry["shape"])
        if entry["coord"]:
            coords[name] = dims, values, entry["attrs"]
        else:
            data[f"{name}_result" if name in axes else name] = dims, values, entry["attrs"]
    told = dict(header) | {"photons_per_led": float(header["photons_per_led"])}
    told["relative_error"] = np.nan if header["relative_error"] is None else header["relative_error"]
    for name, key, text in _TOLD:
        label = f"{name}_result" if name in axes else name
        data[label] = (), np.asarray(told[key]), {"units": "1", "long_name": text}
    return _Result(data, coords, header["attrs"])


class _Stack:
    """One array per variable of the first result over all scenes; what a scene lacks stays empty.

    Each result is copied as it comes: thousands of them, kept, would be searched for garbage again and again.
    """

    def __init__(self, scenes: int) -> None:
        self.scenes = scenes
        self.first: _Result | None = None
        self.full: dict[str, np.ndarray] = {}

    def add(self, number: int, one: _Result) -> None:
        """Put in the result of a scene, by its number; raises InputError where it does not fit the first."""
        if self.first is None:
            self.first = one
            self.full = {name: self._empty(values) for name, (_, values, _) in one.data.items()}
        _check_same_coordinates(self.first, one)
        for name, full in self.full.items():
            if name not in one.data:
                continue
            values = one.data[name][1]
            if values.shape != full.shape[1:]:
                raise InputError(
                    f'the scenes of this batch differ in the shape of their "{name}", so they are no one dataset; '
                    "sweep scenes with as many of each."
                )
            full[number] = values

    def _empty(self, values: np.ndarray) -> np.ndarray:
        # A type that can say that nothing is there.
        number = np.result_type(values.dtype, np.float32) if values.dtype.kind not in "bU" else None
        kinds: dict[str, tuple[Any, Any]] = {"b": (False, bool), "U": ("", object), "u": (0, values.dtype)}
        empty, holding = kinds.get(values.dtype.kind, (np.nan, number))
        return np.full((self.scenes, *values.shape), empty, holding)

    def dataset(self, dims: tuple[str, ...], shape: tuple[int, ...]) -> xr.Dataset:
        """All of them over the sweep's dimensions."""
        if self.first is None:
            return xr.Dataset()
        data = {}
        for name, (own, values, attrs) in self.first.data.items():
            whole = self.full[name]
            whole = whole.astype(str) if whole.dtype.kind == "O" else whole
            data[name] = ((*dims, *own), whole.reshape(*shape, *values.shape), attrs)
        kept = {k: v for k, v in self.first.attrs.items() if k in ("engine", "versions")}
        return xr.Dataset(data, coords=self.first.coords, attrs=kept)


def _check_same_coordinates(first: _Result, one: _Result) -> None:
    """Raise InputError where two scenes do not fit one dataset."""
    for name, (_, values, _) in first.coords.items():
        other = one.coords[name][1] if name in one.coords else None
        if other is None or other.shape != values.shape or not (other == values).all():
            raise InputError(
                f'the scenes of this batch differ in their "{name}", so they are no one dataset; '
                + ("leave course out." if name == "time" else "sweep scenes with the same names.")
            )


def _coordinates(plan: dict[str, Any]) -> dict[str, Any]:
    """The axes as coordinates; values that are tables or arrays become text."""
    coordinates: dict[str, Any] = {}
    for axis in plan["axes"]:
        values = axis["values"]
        if not all(isinstance(v, bool) for v in values) and all(isinstance(v, int | float) for v in values):
            values = np.array(values)
        elif not all(isinstance(v, str) for v in values):
            values = np.array([str(v) for v in values])
        dim = axis["name"] if axis["name"] in plan["dims"] else "sample"
        coordinates[axis["name"]] = (dim, values, {"long_name": axis["path"]} if axis["path"] else {})
    return coordinates


def write_table(results: xr.Dataset, path: str | Path) -> Path:
    """Write what `open_results` returns as CSV: a column per quantity, and a row per scene and what its study is over.

    That is each LED and photodiode; for colours, each force and place.
    """
    for dim in ("absorber", "band"):
        for name in [str(n) for n, v in results.data_vars.items() if dim in v.dims] if dim in results.coords else ():
            apart = {f"{name}_{item}": results[name].sel({dim: item}, drop=True) for item in results[dim].values}
            results = results.drop_vars(name).assign(apart)
    study = STUDIES.get(results.attrs.get("study", ""))
    rows = {*results.state.dims, *(study.rows if study else ("led", "photodiode"))}
    table = results[[n for n, v in results.data_vars.items() if set(v.dims) <= rows]].to_dataframe().reset_index()
    texts = [name for name in table if table[name].dtype.kind not in "biuf"]
    table[texts] = table[texts].map(plain_cell)
    write_text(Path(path), table.rename(columns=plain_cell).to_csv(index=False))
    return Path(path)
