"""A batch folder: where plan, traced light, results and failures lie, and who works on what."""

import errno
import json
import math
import os
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io import CorruptError, check_writable, claimed, make_folder, unpack, write_bytes

FORMAT = 3
# What a plan holds, each of its type.
_PLAN: dict[str, type | tuple[type, ...]] = {
    "sweep": str,
    "study": str,
    "dims": dict,
    "axes": list,
    "made": dict,
    "scenes": list,
    "asked": list,
    "lights": int,
}
# What makes a result's header.
_RESULT = {"digest", "made", "variables", "attrs", "photons_per_led", "relative_error", "reached"}
# Trouble of the disk, which is not that of one file.
STORAGE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO, errno.ESTALE}


class HiddenError(InputError):
    """A plan is there, but nobody lets this user read it: it may be another batch's."""


class ForeignError(CorruptError):
    """A result is whole, but of another run: another seed, backend or version made it."""


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

    def read_plan(self) -> dict[str, Any]:
        """The plan of the last run; raises InputError where there is none, HiddenError where it cannot be read."""
        path = self.root / "plan.json"
        try:
            plan = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(plan, dict):
                raise ValueError("it holds no table")
            if plan["format"] != FORMAT:
                raise InputError(
                    f"{path}: has format {plan['format']}, and {FORMAT} is known here: another nailoptics wrote it; "
                    "use that one, or another folder."
                )
            _check_plan(plan)
            return plan
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(
                f"{self.root}: is not a batch folder (it has no plan.json); give the folder of a batch."
            ) from None
        except PermissionError as error:
            line = f"{path}: cannot be read: {error.strerror}; have it made readable, or use another folder."
            raise HiddenError(line) from None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            why = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
            raise InputError(f"{path}: cannot be read ({why}); run the batch again to write it anew.") from None

    def write_plan(self, plan: dict[str, Any]) -> None:
        """Write the plan, whole or not at all."""
        write_bytes(self.root / "plan.json", json.dumps({"format": FORMAT} | plan).encode(), flush=True)

    def read_result(self, digest: str, *, made: dict[str, Any]) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """Header and arrays of a scene's result, or None; raises CorruptError where it is not what a run writes.

        made : with which seed, backend and versions it must have been made; else ForeignError.
        """
        found = _read(self.result(digest))
        if found is None:
            return None
        if not found[0].keys() >= _RESULT:
            raise CorruptError("it is no result")
        if found[0]["digest"] != digest:
            raise CorruptError("it belongs to another scene")
        if found[0]["made"] != made:
            raise ForeignError("it was made with another seed, backend or version")
        try:
            _check_result(*found)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise CorruptError(f"its content is no result's ({error})") from None
        return found

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


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Header and arrays of a file, or None where there is none; raises CorruptError."""
    try:
        return unpack(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        if error.errno in STORAGE:
            raise
        raise CorruptError(f"it cannot be read: {error.strerror}") from None


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
        raise ValueError("it does not tell whether it reached its accuracy")


def _check_plan(plan: dict[str, Any]) -> None:
    """Raise KeyError or ValueError where a plan is not whole."""
    for name, kind in _PLAN.items():
        if not isinstance(plan[name], kind):
            raise ValueError(f"its {name} is no {kind}")
    sizes = list(plan["dims"].values())
    if not all(isinstance(size, int) and size > 0 for size in sizes):
        raise ValueError("its dims are no sizes")
    if not math.prod(sizes) == len(plan["scenes"]) == len(plan["asked"]):
        raise ValueError("its scenes do not fill its dims")
    if not all(isinstance(one, str) and one.isalnum() for one in plan["scenes"]):
        raise ValueError("its scenes are no digests")
    for axis in plan["axes"]:
        if not isinstance(axis["values"], list) or len(axis["values"]) not in sizes:
            raise ValueError(f"its axis {axis['name']} fits no dimension")
        axis["path"]
    for name in ("seed", "backend", "versions"):
        plan["made"][name]
    if not isinstance(plan["made"]["versions"], dict):
        raise ValueError("its versions are no table")
