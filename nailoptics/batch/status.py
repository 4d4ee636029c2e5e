"""How far the batch in a folder is, seen from outside."""

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..scene import Accuracy
from .folder import Folder
from .work import other_versions, standing

# The pace is that of the results of the last minutes.
_WINDOW_S = 600.0


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
    last_result_s_ago: float | None
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
            lines.append(f"begun with {self.other_versions}; to go on, use that version, or another folder")
        if self.left:
            pace = "no new result in the last ten minutes"
            if self.seconds_left is not None:
                pace = f"about {duration_text(self.seconds_left)} left at the pace of the last ten minutes"
            lines.append(pace)
        lines += [f"failed: {digest[:12]} {why}" for digest, why in self.failed.items()]
        return "\n".join(lines)


def duration_text(seconds: float) -> str:
    """A duration for people."""
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def status(folder: str | Path) -> Status:
    """How far a batch is; raises InputError where the folder holds none."""
    place = Folder(Path(folder))
    plan = place.read_plan()
    try:
        asked = zip(plan["scenes"], plan["asked"], strict=True)
        required = {digest: Accuracy(**wanted) for digest, wanted in asked}
    except (TypeError, ValueError):
        why = "plan.json asks for no accuracy; run the batch again to write it anew"
        raise InputError(f"{place.root}: {why}.") from None
    stands = {digest: standing(place, digest, wanted, plan["made"]) for digest, wanted in required.items()}
    count, now = Counter(stands.values()), time.time()
    times = [place.result(digest).stat().st_mtime for digest, how in stands.items() if how == "done"]
    failed = {digest: place.why_failed(digest) for digest, how in stands.items() if how == "failed"}
    left = len(required) - count["done"] - count["failed"]
    recent = sorted(t for t in times if now - t < _WINDOW_S)
    pace = len(recent) / max(now - recent[0], 1.0) if recent else 0.0
    return Status(
        total=len(required),
        lights=plan["lights"],
        **{how: count[how] for how in ("done", "below", "corrupt", "foreign")},
        failed=failed,
        seconds_left=0.0 if not left else (left / pace if pace else None),
        last_result_s_ago=now - max(times) if times else None,
        other_versions=other_versions(plan["made"]),
    )
