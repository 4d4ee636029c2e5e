"""The results of a batch as one dataset over the sweep's axes, as a table, and how far it is."""

import logging
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from ..io import CorruptError, plain_cell, write_text
from .folder import Folder, ForeignError, Plan
from .studies import STUDIES

log = logging.getLogger(__name__)

# What a result's header says of it, in the table: its name there and there, and in words.
_ABOUT = (
    ("relative_error", "relative_error", "largest relative error"),
    ("photons", "photons_per_led", "photons per LED"),
    ("reached", "reached", "as accurate as requested"),
)
# The pace is that of the results of the last minutes. [s]
_WINDOW_S = 600.0
# Dimensions, values, attributes.
_Variable = tuple[tuple[str, ...], np.ndarray, dict[str, Any]]


def open_results(folder: str | Path, *, course: bool = False) -> xr.Dataset:
    """All results of a batch as one dataset, with the sweep's axes as its first dimensions and as coordinates.

    Scenes without a result of this batch are NaN (numbers), False, empty text or black (photographs); `state` says why:
    missing, failed, corrupt, or foreign, which is another seed's, backend's or version's.

    course : also what runs over time (volts, blood, force), for which the scenes must share their times.

    Raises: InputError where the folder holds no batch, or its scenes do not fit one dataset.
    """
    place = Folder(Path(folder))
    plan = place.read_plan()
    dims, shape = tuple(plan.dims), tuple(plan.dims.values())
    states: list[str] = []
    data: dict[str, _Variable] = {}
    coords: dict[str, _Variable] = {}
    attributes: dict[str, Any] = {}
    for number, digest in enumerate(plan.scenes):
        state, stored = "done", None
        try:
            stored = place.read_result(digest, made=plan.made)
        except ForeignError:
            state = "foreign"
        except CorruptError:
            state = "failed" if place.has_failed(digest) else "corrupt"
        else:
            state = "done" if stored else "failed" if place.has_failed(digest) else "missing"
        states.append(state)
        if stored is None:
            continue
        values, own = _variables(*stored, {axis.name for axis in plan.axes}, course)
        if not data:
            coords, attributes = own, stored[0]["attrs"]
            data = {name: (d, _empty(len(plan.scenes), v), a) for name, (d, v, a) in values.items()}
        _check_same_coordinates(coords, own)
        _put(data, number, values)
    for state, why in (("corrupt", "damaged"), ("foreign", "another seed's, backend's or version's")):
        if count := states.count(state):
            log.warning("%s: %d results are %s and left out; run the batch again", place.root, count, why)
    if moved := plan.made.other_versions:
        log.warning("%s: was made with %s", place.root, moved)
    text = "done, missing, failed, corrupt or foreign"
    data["state"] = ((), np.array(states), {"long_name": text})
    data["digest"] = ((), np.array(plan.scenes), {"long_name": "digest of the scene"})
    whole = {name: ((*dims, *own), _over(full, shape), about) for name, (own, full, about) in data.items()}
    dataset = xr.Dataset(whole, coords | _coordinates(plan))
    dataset.attrs = {k: v for k, v in attributes.items() if k in ("engine", "versions")}
    dataset.attrs |= {"title": f"nailoptics: batch {plan.sweep}", "Conventions": "CF-1.11"}
    return dataset.assign_attrs(seed=plan.made.seed, backend=plan.made.backend, study=plan.study)


def _variables(
    header: dict[str, Any], arrays: dict[str, np.ndarray], axes: set[str], course: bool
) -> tuple[dict[str, _Variable], dict[str, _Variable]]:
    """A scene's variables and coordinates, without what runs over time unless that is requested.

    axes : names of the sweep's axes; a result that is called as one of them is renamed: leds.ir.wavelength_nm.
    """
    data: dict[str, _Variable] = {}
    coords: dict[str, _Variable] = {}
    for name, entry in header["variables"].items():
        dims = tuple(entry["dims"])
        if not course and "time" in dims:
            continue
        values = arrays[name] if name in arrays else np.array(entry["text"], dtype=str).reshape(entry["shape"])
        if entry["coord"]:
            coords[name] = dims, values, entry["attrs"]
        else:
            data[f"{name}_result" if name in axes else name] = dims, values, entry["attrs"]
    for name, key, text in _ABOUT:
        value = np.nan if header[key] is None else header[key]
        value = float(value) if key != "reached" else value
        data[f"{name}_result" if name in axes else name] = (), np.asarray(value), {"units": "1", "long_name": text}
    return data, coords


def _empty(scenes: int, values: np.ndarray) -> np.ndarray:
    """An array for a variable of all scenes, of a type that can say that nothing is there."""
    if values.dtype.kind in "bUu":
        empty: Any = {"b": False, "U": "", "u": 0}[values.dtype.kind]
        return np.full((scenes, *values.shape), empty, object if values.dtype.kind == "U" else values.dtype)
    return np.full((scenes, *values.shape), np.nan, np.result_type(values.dtype, np.float32))


def _put(data: dict[str, _Variable], number: int, values: dict[str, _Variable]) -> None:
    """Put in the variables of a scene, by its number; raises InputError where they do not fit the first's."""
    for name, (_, full, _) in data.items():
        if name not in values:
            continue
        if values[name][1].shape != full.shape[1:]:
            raise InputError(
                f'the scenes of this batch differ in the shape of their "{name}", so they are no one dataset; '
                "sweep scenes with as many of each."
            )
        full[number] = values[name][1]


def _over(full: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """A variable of all scenes over the sweep's dimensions."""
    full = full.astype(str) if full.dtype.kind == "O" else full
    return full.reshape(*shape, *full.shape[1:])


def _check_same_coordinates(first: dict[str, _Variable], other: dict[str, _Variable]) -> None:
    """Raise InputError where two scenes do not fit one dataset."""
    for name, (_, values, _) in first.items():
        there = other[name][1] if name in other else None
        if there is None or there.shape != values.shape or not (there == values).all():
            raise InputError(
                f'the scenes of this batch differ in their "{name}", so they are no one dataset; '
                + ("leave course out." if name == "time" else "sweep scenes with the same names.")
            )


def _coordinates(plan: Plan) -> dict[str, Any]:
    """The axes as coordinates; values that are tables or arrays become text."""
    coordinates: dict[str, Any] = {}
    for axis in plan.axes:
        values: Any = list(axis.values)
        if not all(isinstance(v, bool) for v in values) and all(isinstance(v, int | float) for v in values):
            values = np.array(values)
        elif not all(isinstance(v, str) for v in values):
            values = np.array([str(v) for v in values])
        dim = axis.name if axis.name in plan.dims else "sample"
        coordinates[axis.name] = (dim, values, {"long_name": axis.path} if axis.path else {})
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


@dataclass(frozen=True)
class Status:
    """Counts of a batch's scenes; seconds_left at the pace of the last ten minutes, None where there was none.

    below : results that are there, but not yet as accurate as requested.
    other_versions : which versions made them that are others than here, in words.
    """

    total: int
    lights: int
    done: int
    below: int
    corrupt: int
    foreign: int
    failed: dict[str, str]
    seconds_left: float | None
    other_versions: str

    @property
    def left(self) -> int:
        """Scenes that a run would still work on."""
        return self.total - self.done - len(self.failed)

    def __str__(self) -> str:
        lines = [f"{self.done} of {self.total} scenes done, {self.left} left, {len(self.failed)} failed"]
        if self.below:
            lines.append(f"{self.below} of those left are there, but less accurate than requested")
        if self.corrupt:
            lines.append(f"{self.corrupt} results are damaged; the next run makes them again")
        if self.foreign:
            lines.append(
                f"{self.foreign} results are another seed's, backend's or version's; the next run makes them again"
            )
        if self.other_versions:
            lines.append(f"begun with {self.other_versions}; to resume, use that version, or another folder")
        if self.left and self.seconds_left is not None:
            lines.append(f"about {self.seconds_left / 60:.1f} min left at the pace of the last ten minutes")
        lines += [f"failed: {digest[:12]} {why}" for digest, why in self.failed.items()]
        return "\n".join(lines)


def status(folder: str | Path) -> Status:
    """How far a batch is; raises InputError where the folder holds none."""
    place = Folder(Path(folder))
    plan = place.read_plan()
    required = dict(zip(plan.scenes, plan.asked, strict=True))
    standing = {digest: place.standing(digest, accuracy, plan.made) for digest, accuracy in required.items()}
    count, now = Counter(standing.values()), time.time()
    times = [place.result(digest).stat().st_mtime for digest, how in standing.items() if how == "done"]
    recent = [t for t in times if now - t < _WINDOW_S]
    left = len(required) - count["done"] - count["failed"]
    return Status(
        total=len(required),
        lights=plan.lights,
        **{how: count[how] for how in ("done", "below", "corrupt", "foreign")},
        failed={digest: place.why_failed(digest) for digest, how in standing.items() if how == "failed"},
        seconds_left=left * max(now - min(recent), 1.0) / len(recent) if recent else None if left else 0.0,
        other_versions=plan.made.other_versions,
    )
