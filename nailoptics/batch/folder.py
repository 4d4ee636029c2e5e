"""A batch folder: where plan, traced light, results and failures lie, and who works on what."""

import errno
import json
import math
import os
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ..checks import explain
from ..errors import InputError
from ..io import CorruptError, check_writable, claimed, make_folder, unpack, write_bytes
from ..light.transfer import current_versions
from ..scene import Accuracy
from ..scene.base import Table
from ..scene.sweep import StudyName

FORMAT = 3
# What makes a result's header.
_RESULT = {"digest", "made", "variables", "attrs", "photons_per_led", "relative_error", "reached"}
# Trouble of the disk, which is not that of one file.
STORAGE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ESTALE}


class PlanError(InputError):
    """A plan is missing or damaged; a run writes it anew."""


class ForeignError(CorruptError):
    """A result is whole, but of another run: another seed, backend or version made it."""


class PlannedAxis(Table):
    """An axis of a sweep."""

    name: str
    path: str | None
    values: tuple[Any, ...]


class Made(Table):
    """What decides a scene's result beside the scene and its accuracy."""

    seed: int
    backend: str
    versions: dict[str, str | None]

    @property
    def other_versions(self) -> str:
        """Which versions are others than here, in words; empty where they are the same."""
        moved = [(name, self.versions.get(name), now) for name, now in current_versions().items()]
        return ", ".join(f"{name} {then} and is {now} here" for name, then, now in moved if then != now)


class Plan(Table):
    """What a batch is to do: enough to open its results and to show its progress.

    asked : accuracy required of each scene.
    """

    format: int
    sweep: str
    study: StudyName
    dims: dict[str, Annotated[int, Field(gt=0)]]
    axes: tuple[PlannedAxis, ...]
    made: Made
    photons: int | None
    relative_error: float | None
    scenes: tuple[Annotated[str, Field(pattern="^[0-9a-f]+$")], ...]
    asked: tuple[Accuracy, ...]
    lights: int

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not math.prod(self.dims.values()) == len(self.scenes) == len(self.asked):
            raise ValueError("its scenes do not fill its dims")
        for axis in self.axes:
            if len(axis.values) not in self.dims.values():
                raise ValueError(f"its axis {axis.name} fits no dimension")
        return self


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
        """The result of one scene."""
        return self.root / "results" / f"{digest}.dat"

    def failure(self, digest: str) -> Path:
        """Why a scene failed."""
        return self.root / "failed" / f"{digest}.json"

    @property
    def light(self) -> Path:
        """Where the traced light lies."""
        return self.root / "light"

    def read_plan(self) -> Plan:
        """The plan of the last run; raises PlanError where there is none, InputError where it is not for this user."""
        path = self.root / "plan.json"
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(data, dict):
                raise ValueError("it holds no table")
            if data.get("format", FORMAT) != FORMAT:
                raise InputError(
                    f"{path}: has format {data['format']}, and {FORMAT} is known here: another nailoptics wrote it; "
                    "use that one, or another folder."
                )
            return Plan.model_validate_json(json.dumps(data))
        except (FileNotFoundError, NotADirectoryError):
            why = "is not a batch folder (it has no plan.json); give the folder of a batch."
            raise PlanError(f"{self.root}: {why}") from None
        except PermissionError as error:
            line = f"{path}: cannot be read: {error.strerror}; have it made readable, or use another folder."
            raise InputError(line) from None
        except (OSError, ValueError, RecursionError) as error:
            why = explain(error, Plan) if isinstance(error, ValidationError) else str(error)
            raise PlanError(
                f"{path}: cannot be read ({why.rstrip('.')}); run the batch again to write it anew."
            ) from None

    def write_plan(self, plan: Plan) -> None:
        """Write the plan, whole or not at all."""
        text = plan.model_dump_json(exclude_none=False)
        write_bytes(self.root / "plan.json", text.encode(), flush=True)

    def read_result(self, digest: str, *, made: Made) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """Header and arrays of a scene's result, or None; raises CorruptError where it is not what a run writes.

        made : with which seed, backend and versions it must have been made; else ForeignError.
        """
        try:
            found = unpack(self.result(digest).read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            if error.errno in STORAGE:
                raise
            raise CorruptError(f"it cannot be read: {error.strerror}") from None
        if not found[0].keys() >= _RESULT:
            raise CorruptError("it is no result")
        if found[0]["digest"] != digest:
            raise CorruptError("it belongs to another scene")
        if found[0]["made"] != made.model_dump():
            raise ForeignError("it was made with another seed, backend or version")
        try:
            _check_result(*found)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise CorruptError(f"its content is no result's ({error})") from None
        return found

    def standing(self, digest: str, required: Accuracy, made: Made) -> str:
        """How a scene stands: done, below what is required, foreign, corrupt, failed or missing."""
        try:
            found = self.read_result(digest, made=made)
        except ForeignError:
            return "foreign"
        except CorruptError:
            return "failed" if self.has_failed(digest) else "corrupt"
        if found is not None and meets(found[0], required):
            return "done"
        if self.has_failed(digest):
            return "failed"
        return "missing" if found is None else "below"

    def gone(self) -> bool:
        """Whether somebody removed the folder, or the plan in it, since the run began."""
        return not os.path.exists(self.root / "plan.json")

    def has_failed(self, digest: str) -> bool:
        """Whether a scene failed, as far as can be seen."""
        return os.path.exists(self.failure(digest))

    def why_failed(self, digest: str) -> str:
        """Why a scene failed, in one line."""
        try:
            return str(json.loads(self.failure(digest).read_text(encoding="utf-8"))["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return "unknown"

    def write_failure(self, digest: str, failure: dict[str, Any]) -> None:
        """Record why a scene failed."""
        write_bytes(self.failure(digest), json.dumps(failure).encode(), flush=True)

    def claimed(self, digest: str) -> AbstractContextManager[bool]:
        """Whether this process is the only one that works on what has this digest."""
        return claimed(self.root / ".claims", int(digest[:15], 16))


def meets(header: dict[str, Any], required: Accuracy) -> bool:
    """Whether a stored result is at least as accurate as is required."""
    if header["reached"] and header.get("asked") == required.model_dump(exclude_none=True):
        return True  # volpath answers a finger's tolerance as well as it can
    if required.photons is not None:
        return bool(header["photons_per_led"] >= required.photons)
    if required.relative_error is not None:
        reached = header["relative_error"]
        return reached is not None and reached <= required.relative_error
    return True


def _check_result(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Raise ValueError, TypeError, KeyError or AttributeError unless a result's content makes a dataset of readings."""
    sizes: dict[str, int] = {}
    if not header["variables"] or arrays.keys() - header["variables"].keys():
        raise ValueError("its variables are not those of its arrays")
    for name, entry in header["variables"].items():
        values = arrays[name] if name in arrays else np.array(entry["text"], dtype=str).reshape(entry["shape"])
        for dim, size in zip(entry["dims"], values.shape, strict=True):
            if sizes.setdefault(dim, size) != size:
                raise ValueError(f"{name} has {size} along {dim}, others {sizes[dim]}")
        if name == "detected_fraction_rest" and not (np.isfinite(values) & (values >= 0)).all():
            raise ValueError(f"{name} is negative or not finite")
        entry["attrs"].keys(), entry["coord"]
    header["attrs"].keys()
    error = header["relative_error"]
    if not (error is None or math.isfinite(error)) or not math.isfinite(header["photons_per_led"]):
        raise ValueError("its photons or their error are not finite")
    if not isinstance(header["reached"], bool):
        raise ValueError("it does not say whether it reached its accuracy")
