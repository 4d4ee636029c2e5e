"""A batch folder: where plan, traced light, results and failures lie, and its results as one dataset."""

import errno
import json
import logging
import math
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from pydantic import ConfigDict, Field

from ..checks import as_input_error
from ..errors import InputError
from ..io import CorruptError, check_writable, make_folder, plain_cell, unpack, write_bytes, write_text
from ..light.tracing.store import program_digest
from ..light.transfer import current_versions
from ..scene import Accuracy
from ..scene.base import Table
from ..scene.sweep import Axis, StudyName
from ..variables import from_record, unit_of, variable
from .studies import STUDIES

log = logging.getLogger(__name__)

FORMAT = 3
# Errors of the disk, which are not those of one file.
STORAGE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ESTALE}
_SCENE = "the scene"  # a dimension that no result has
# Results that are made again, and why.
DAMAGE = {"corrupt": "damaged (checksum, name or content)", "foreign": "another seed's, backend's or program's"}


class PlanError(InputError):
    """A plan is missing or damaged; a run writes it anew."""


class Provenance(Table):
    """Provenance of results: what decides them beside the scene and its accuracy."""

    seed: int
    backend: str
    versions: dict[str, str | None]
    program: str = "unknown"  # as of earlier ones

    @classmethod
    def here(cls, seed: int, backend: str) -> "Provenance":
        """What decides results in this process; its program is all code and what that may read."""
        # A wheel has the assets in the package, as _assets.
        program = program_digest(("*.py", "[!_]*/**/*.py"), ("**/*.toml", "**/*.csv"))[:12]
        return cls(seed=seed, backend=backend, versions={**current_versions()}, program=program)

    def unlike(self, other: "Provenance", *, program: bool = True) -> str:
        """What of another is not as here, in words; empty where all is the same. program : whether that counts."""
        left_out = {"versions"} if program else {"versions", "program"}
        then, now = (made.versions | made.model_dump(exclude=left_out) for made in (self, other))
        moved = (name for name in now if then.get(name) != now[name])
        return ", ".join(f"{name} {then.get(name)} and is {now[name]} here" for name in moved)


class Plan(Table):
    """What a batch is to do, with the accuracy of each scene: enough to open its results and to show its progress."""

    model_config = ConfigDict(extra="ignore")  # earlier ones have more

    format: int
    sweep: str
    study: StudyName
    dims: dict[str, Annotated[int, Field(gt=0)]]
    axes: tuple[Axis, ...]
    made: Provenance
    scenes: tuple[Annotated[str, Field(pattern="^[0-9a-f]+$")], ...]
    required: tuple[Accuracy, ...]
    traces: int

    def _check(self) -> None:
        if not math.prod(self.dims.values()) == len(self.scenes) == len(self.required):
            raise ValueError("its scenes do not fill its dims")
        if any(len(axis.values) not in self.dims.values() for axis in self.axes):
            raise ValueError("its axes do not fit its dims")


@dataclass(frozen=True)
class Folder:
    """The files of one batch; whatever is there is whole, and is data only."""

    root: Path

    def make(self) -> None:
        """Make the folder; raises WriteError where nothing can be written."""
        for name in ("results", "light", "failed"):
            make_folder(self.root / name)
            check_writable(self.root / name)

    def result(self, digest: str) -> Path:
        """The file of a scene's result."""
        return self.root / "results" / f"{digest}.dat"

    def failure(self, digest: str) -> Path:
        """The file that says why a scene failed."""
        return self.root / "failed" / f"{digest}.json"

    def read_plan(self) -> Plan:
        """The plan of the last run; raises PlanError where there is none, InputError where it is not for this user."""
        path = self.root / "plan.json"
        try:
            if not path.exists():
                what = "it has no plan.json" if self.root.exists() else "no such file or folder"
                why = f"is not a batch folder ({what}); give the folder of a batch."
                raise PlanError(f"{self.root}: {why}")
            data = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(data, dict):
                raise ValueError("it holds no table")
            if (made_in := data.get("format", FORMAT)) != FORMAT:
                why = f"has format {made_in}, and {FORMAT} is known here: another nailoptics wrote it"
                raise InputError(f"{path}: {why}; use that one, or another folder.")
            for name, old in {"required": "asked", "traces": "lights"}.items():  # their names until 0.2.0
                if old in data:
                    data[name] = data.pop(old)
            return Plan.model_validate(data, strict=False)  # JSON has no tuples
        except PermissionError as error:
            line = f"{path}: cannot be read: {error.strerror}; have it made readable, or use another folder."
            raise InputError(line) from None
        except (OSError, ValueError, RecursionError) as error:
            why = as_input_error(error, Plan).args[0].rstrip(".")
            raise PlanError(f"{path}: cannot be read ({why}); run the batch again to write it anew.") from None

    def write_plan(self, plan: Plan) -> None:
        """Write the plan, whole or not at all."""
        write_bytes(self.root / "plan.json", plan.model_dump_json(exclude_none=False).encode())

    def read(self, digest: str, made: Provenance) -> tuple[str, dict[str, Any], xr.Dataset]:
        """State of a scene, and header and dataset of its result, which are empty unless that is done.

        The state is done, failed, missing, corrupt (not what a run writes), or foreign: made with another seed,
        backend, version or program. Raises OSError where the disk is at fault.
        """
        state = "missing"
        try:
            header, arrays = unpack(self.result(digest).read_bytes())
            if header["digest"] != digest:
                raise CorruptError("it belongs to another scene")
            if Provenance(**header["made"]) != made:
                return "foreign", {}, xr.Dataset()
            return "done", header, from_record(header, arrays)
        except FileNotFoundError:
            pass
        except Exception as error:  # what is not a result of ours fails in many ways
            if isinstance(error, OSError) and error.errno in STORAGE:
                raise
            state = "corrupt"
        return "failed" if os.path.exists(self.failure(digest)) else state, {}, xr.Dataset()

    def state(self, digest: str, required: Accuracy, made: Provenance) -> str:
        """State of a scene as `read` says, or below: done, but less accurate than required."""
        state, header, _ = self.read(digest, made)
        if state != "done" or meets(header, required):
            return state
        return "failed" if os.path.exists(self.failure(digest)) else "below"

    def why_failed(self, digest: str) -> str:
        """Why a scene failed, in one line."""
        try:
            return str(json.loads(self.failure(digest).read_text(encoding="utf-8"))["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return "unknown"

    def write_failure(self, digest: str, why: str, details: Sequence[str] = ()) -> None:
        """Record why a scene failed, and the lines of its traceback."""
        record = {"error": why, "traceback": details, "time": time.time()}
        write_bytes(self.failure(digest), json.dumps(record).encode())


def meets(header: dict[str, Any], required: Accuracy) -> bool:
    """Whether a stored result is at least as accurate as is required."""
    if header["reached"] and header.get("required", header.get("asked")) == required.model_dump(exclude_none=True):
        return True
    if required.photons is not None:
        return bool(header["photons_per_led"] >= required.photons)
    if required.relative_error is not None:
        reached = header["relative_error"]
        return reached is not None and reached <= required.relative_error
    return True


@dataclass(frozen=True)
class Status:
    """Counts of a batch's scenes; below are those with results that are not yet as accurate as requested.

    other_versions : which versions made them that are others than here, in words.
    """

    total: int
    traces: int
    done: int
    below: int
    corrupt: int
    foreign: int
    failed: dict[str, str]
    other_versions: str

    @property
    def left(self) -> int:
        """Scenes that a run would still work on."""
        return self.total - self.done - len(self.failed)

    def __str__(self) -> str:
        lines = [f"{self.done} of {self.total} scenes done, {self.left} left, {len(self.failed)} failed"]
        if self.below:
            lines.append(f"{self.below} of those left are there, but less accurate than requested")
        for name, why in DAMAGE.items():
            if count := getattr(self, name):
                lines.append(f"{count} results are {why}; the next run makes them again")
        if self.other_versions:
            lines.append(f"begun with {self.other_versions}; to resume, use that version, or another folder")
        return "\n".join([*lines, *(f"failed: {digest[:12]} {why}" for digest, why in self.failed.items())])


def status(folder: str | Path) -> Status:
    """How far a batch is; raises InputError where the folder holds none."""
    place = Folder(Path(folder))
    plan = place.read_plan()
    required = dict(zip(plan.scenes, plan.required, strict=True))
    now = Provenance.here(plan.made.seed, plan.made.backend)
    other_versions = plan.made.unlike(now, program=False)
    made = plan.made if other_versions else now  # what another program made is made again
    states = {digest: place.state(digest, accuracy, made) for digest, accuracy in required.items()}
    count = Counter(states.values())
    return Status(
        total=len(required),
        traces=plan.traces,
        **{state: count[state] for state in ("done", "below", "corrupt", "foreign")},
        failed={digest: place.why_failed(digest) for digest, state in states.items() if state == "failed"},
        other_versions=other_versions,
    )


def open_results(folder: str | Path, *, course: bool = False) -> xr.Dataset:
    """All results of a batch as one dataset, with the sweep's axes as its first dimensions and as coordinates.

    Scenes without a result of this batch are NaN (numbers), False, empty text or black (photographs); `state` says why:
    missing, failed, corrupt, or foreign, which is another seed's, backend's, version's or program's. So is what a
    scene lacks of others' zones, times, LEDs or photodiodes.

    course : also what runs over time (volts, blood, force).

    Raises: InputError where the folder holds no batch.
    """
    place = Folder(Path(folder))
    plan = place.read_plan()
    axes, dims = {axis.name for axis in plan.axes}, dict(plan.dims)
    results = [place.read(digest, plan.made) for digest in plan.scenes]
    states = [state for state, *_ in results]
    for state, why in DAMAGE.items():
        if count := states.count(state):
            log.warning("%s: %d results are %s and left out; run the batch again", place.root, count, why)
    if moved := plan.made.unlike(Provenance.here(plan.made.seed, plan.made.backend)):
        log.warning("%s: was made with %s", place.root, moved)
    scenes = {
        i: _of_scene(header, dataset, axes, course)
        for i, (state, header, dataset) in enumerate(results)
        if state == "done"
    }
    joined = _joined(scenes, len(results)) if scenes else xr.Dataset()
    joined["state"] = _SCENE, states, {"long_name": "done, missing, failed, corrupt or foreign"}
    joined["digest"] = _SCENE, list(plan.scenes), {"long_name": "digest of the scene"}
    dataset = xr.Dataset(coords=_coordinates(plan) | {n: coord for n, coord in joined.coords.items() if n != _SCENE})
    for name, one in joined.data_vars.items():
        values = one.transpose(_SCENE, ...).values.reshape(*dims.values(), *one.isel({_SCENE: 0}).shape)
        dataset[name] = (*dims, *one.isel({_SCENE: 0}).dims), values, one.attrs
    attributes = {k: v for k, v in joined.attrs.items() if k in ("engine", "versions")}
    attributes |= {"title": f"nailoptics: batch {plan.sweep}"}
    return dataset.assign_attrs(attributes, seed=plan.made.seed, backend=plan.made.backend, study=plan.study)


def _of_scene(header: dict[str, Any], dataset: xr.Dataset, axes: set[str], course: bool) -> xr.Dataset:
    """A scene's dataset with what its header says of it, without what runs over time unless that is requested.

    axes : names of the sweep's axes; a variable that is called as one of them is renamed, as of leds.ir.wavelength_nm.
    """
    dataset = dataset if course else dataset.drop_dims("time", errors="ignore")
    error, photons = header["relative_error"], float(header["photons_per_led"])
    dataset = dataset.assign(
        variable("relative_error", (), np.nan if error is None else error, "largest relative error")
        | variable("photons", (), photons, "photons per LED")
        | variable("reached", (), header["reached"], "as accurate as requested")
    )
    return dataset.rename({name: f"{name}_result" for name in axes & {str(name) for name in dataset.data_vars}})


def _joined(scenes: dict[int, xr.Dataset], count: int) -> xr.Dataset:
    """The datasets of scenes, by their numbers among so many, as one; what a scene lacks of others' is empty."""
    found, fills = [pair for scene in scenes.values() for pair in scene.items()], {"b": False, "U": "", "u": 0}
    empty: Any = {name: fills.get(one.dtype.kind, np.nan) for name, one in found}
    counted = {str(d): n for scene in scenes.values() for d, n in scene.sizes.items() if d not in scene.indexes}
    alike = [scene.assign_coords({d: range(scene.sizes[d]) for d in counted}) for scene in scenes.values()]
    how: Any = {"data_vars": "all", "coords": "minimal", "compat": "equals", "join": "outer"}
    how |= {"combine_attrs": "override", "fill_value": empty}
    joined = xr.concat(alike, xr.Variable(_SCENE, list(scenes)), **how).drop_vars(counted)
    return joined.reindex({_SCENE: range(count)}, fill_value=empty)


def _coordinates(plan: Plan) -> dict[str, Any]:
    """The axes as coordinates; values that are tables or arrays become text."""
    coordinates: dict[str, Any] = {}
    for axis in plan.axes:
        values: Any = list(axis.values)
        attributes = {"long_name": axis.path} if axis.path else {}
        if not all(isinstance(v, bool) for v in values) and all(isinstance(v, int | float) for v in values):
            values, attributes = np.array(values), attributes | {"units": unit_of(axis.path)}
        elif not all(isinstance(v, str) for v in values):
            values = np.array([str(v) for v in values])
        coordinates[axis.name] = (axis.name if axis.name in plan.dims else "sample", values, attributes)
    return coordinates


def write_table(results: xr.Dataset, path: str | Path) -> Path:
    """Write what `open_results` returns as CSV: a column per quantity, and a row per scene and what its study is over.

    That is each LED and photodiode; for colours, each force and place.
    """
    for dim in ("absorber", "band"):
        for name in [str(n) for n, v in results.data_vars.items() if dim in v.dims] if dim in results.coords else ():
            items = {f"{name}_{item}": results[name].sel({dim: item}, drop=True) for item in results[dim].values}
            results = results.drop_vars(name).assign(items)
    study = STUDIES.get(results.attrs.get("study", ""))
    rows = [*results.state.dims, *(study.rows if study else ("led", "photodiode"))]
    columns = results[[n for n, v in results.data_vars.items() if set(v.dims) <= {*rows}]]
    table = columns.to_dataframe(dim_order=[dim for dim in rows if dim in columns.dims]).reset_index()
    texts = [name for name in table if table[name].dtype.kind not in "biuf"]
    table[texts] = table[texts].map(plain_cell)
    write_text(Path(path), table.rename(columns=plain_cell).to_csv(index=False))
    return Path(path)
