"""A batch folder: where plan, traced light, results and failures lie, and who works on what."""

import json
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io import CorruptError, check_writable, claimed, make_folder, pack, unpack, write_bytes
from ..light.records import Batch, LedBatches

FORMAT = 1
# Older leftovers of killed writers are swept away; a writer at work is never this slow. [s]
_LEFTOVER_S = 3600.0
_COLUMNS = ("photodiode", "weight", "path_mm")
_SUMS = ("energy", "absorbed")


@dataclass(frozen=True)
class Folder:
    """The files of one batch; whatever is there is whole, and is data only."""

    root: Path

    def make(self) -> None:
        """Make the folder; raises WriteError where nothing can be written."""
        for name in ("results", "light", "failed"):
            make_folder(self.root / name)
            check_writable(self.root / name)
        old = time.time() - _LEFTOVER_S
        try:
            for part in self.root.glob("*/.*.part"):
                if part.stat().st_mtime < old:
                    part.unlink(missing_ok=True)
        except OSError:
            pass  # another run swept first, or they are another user's

    def result(self, digest: str) -> Path:
        """The result of one scene."""
        return self.root / "results" / f"{digest}.dat"

    def failure(self, digest: str) -> Path:
        """Why a scene failed."""
        return self.root / "failed" / f"{digest}.json"

    def light(self, key: str, led: int) -> Path:
        """The traced light of one LED."""
        return self.root / "light" / f"{key}-{led}.dat"

    def read_plan(self) -> dict[str, Any]:
        """The plan of the last run; raises InputError where there is none."""
        path = self.root / "plan.json"
        try:
            plan = json.loads(path.read_text(encoding="utf-8"))
            if plan["format"] != FORMAT:
                raise InputError(f"{path}: format {plan['format']} is not known here; use a newer nailoptics.")
            return plan
        except FileNotFoundError:
            raise InputError(
                f"{self.root}: is not a batch folder (it has no plan.json); give the folder of a batch."
            ) from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: cannot be read ({error}); run the batch again to write it anew.") from None

    def write_plan(self, plan: dict[str, Any]) -> None:
        """Write the plan, whole or not at all."""
        write_bytes(self.root / "plan.json", json.dumps({"format": FORMAT} | plan).encode(), flush=True)

    def read_result(self, digest: str, *, arrays: bool = True) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """A scene's result or its header alone, or None; raises CorruptError where it is not what was written."""
        found = _read(self.result(digest), arrays=arrays)
        if found is not None and found[0].get("digest") != digest:
            raise CorruptError("it belongs to another scene")
        return found

    def why_failed(self, digest: str) -> str:
        """Why a scene failed, in one line."""
        try:
            return str(json.loads(self.failure(digest).read_text(encoding="utf-8"))["error"])
        except (OSError, ValueError, KeyError, TypeError):
            return "unknown"

    def write_failure(self, digest: str, failure: dict[str, Any]) -> None:
        """Record why a scene failed."""
        write_bytes(self.failure(digest), json.dumps(failure).encode(), flush=True)

    def read_light(self, key: str, led: int, *, made: dict[str, Any]) -> LedBatches | None:
        """The batches that are traced, or None; raises CorruptError where they are not what was written.

        made : how the light must have been made.
        """
        found = _read(self.light(key, led))
        if found is None:
            return None
        header, arrays = found
        if header["made"] != made or not all("absorbed" in piece for piece in header["pieces"]):
            return None
        pieces, end = {}, 0
        for piece in header["pieces"]:
            start, end = end, end + piece["records"]
            columns: dict[str, Any] = {name: arrays[name][start:end] for name in _COLUMNS}
            columns |= {name: {part: (a, b) for part, (a, b) in piece[name].items()} for name in _SUMS}
            one = Batch(photons=piece["photons"], events=piece["events"], **columns)
            pieces[piece["number"], piece["photons"]] = one
        return LedBatches(arrays["mu_a"], pieces)

    def write_light(self, key: str, led: int, light: LedBatches, *, made: dict[str, Any]) -> None:
        """Write the batches that are traced; losing them costs time only."""
        pieces = [
            {
                "number": number,
                "photons": photons,
                "records": len(batch.weight),
                "events": batch.events,
            }
            | {name: getattr(batch, name) for name in _SUMS}
            for (number, photons), batch in light.pieces.items()
        ]
        arrays = {name: np.concatenate([getattr(b, name) for b in light.pieces.values()]) for name in _COLUMNS}
        write_bytes(self.light(key, led), pack({"made": made, "pieces": pieces}, arrays | {"mu_a": light.mu_a}))

    def claimed(self, digest: str) -> AbstractContextManager[bool]:
        """Whether this process is the only one that works on what has this digest."""
        return claimed(self.root / ".claims", int(digest[:15], 16))


def _read(path: Path, *, arrays: bool = True) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Header and arrays of a file, or None where there is none; raises CorruptError."""
    try:
        return unpack(path.read_bytes(), arrays=arrays)
    except FileNotFoundError:
        return None
