"""Which scenes of a batch belong together, what all jobs share, and what a worker does with a job."""

import hashlib
import math
import os
import re
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np

from ..errors import InputError, NailopticsError, WriteError
from ..io import pack, write_bytes
from ..light import ReweightWarning
from ..light import backend as backends
from ..light.identity import light_digest, traced_absorption
from ..light.tracing import accuracy
from ..light.tracing.store import LightStore
from ..light.transfer import current_versions
from ..options import BackendName, Requested, TraceOptions
from ..scene import Accuracy, Scene, digest, to_toml
from ..scene.sweep import StudyName, Sweep
from ..variables import to_record
from .folder import FORMAT, STORAGE, Folder, Made, Plan, PlanError
from .studies import STUDIES, relative_error

# Scenes of one light that one job studies.
CHUNK = 16
# Mitsuba's variant is one per process: a worker with several threads still does one job at a time.
_one_job = threading.Lock()


@dataclass(frozen=True)
class Settings:
    """What all jobs of a batch share.

    options : of every scene; the time that a run may take is in deadline, in seconds since the epoch.
    study : what is done with every scene.
    """

    folder: Path
    options: TraceOptions
    deadline: float | None = None
    study: StudyName = "simulate"

    @classmethod
    def of(cls, folder: Path, options: TraceOptions, study: StudyName = "simulate") -> "Settings":
        """The settings of a run that begins now, with the backend that this machine offers."""
        deadline = None if options.max_seconds is None else time.time() + options.max_seconds
        chosen = cast(BackendName, backends.choose_jit(options.backend, "batch").name)
        if study == "colour" and options.relative_error is not None:
            raise InputError("relative_error: a sweep of colours has none; give colour.tolerance in its base scene.")
        return cls(folder.resolve(), replace(options, backend=chosen, max_seconds=None), deadline, study)

    def required(self, scene: Scene) -> Accuracy:
        """What a scene's light must reach."""
        return accuracy(scene, self.options)

    def options_of(self, scene: Scene) -> TraceOptions:
        """The options of a scene's study, which takes no longer than the run has left."""
        requested = self.options.photons or self.options.relative_error
        own_light = STUDIES[self.study].own_light
        required = scene.accuracy if own_light and not requested else self.required(scene)
        if self.deadline is not None:
            left = max(self.deadline - time.time(), 1e-3)
            required = required.model_copy(update={"max_seconds": min(left, required.max_seconds or left)})
        return replace(self.options, **required.model_dump())

    def made(self) -> Made:
        """What decides a scene's result beside the scene and how accurate it is to be."""
        return Made(seed=self.options.seed, backend=self.options.backend, versions=dict(current_versions()))

    def stores(self, on_damage: Callable[[Path, Exception], None] | None = None) -> list[LightStore]:
        """Where light is stored, first that of the batch; what single commands traced is read, too."""
        return [LightStore(self.folder / "light", on_damage=on_damage), *LightStore.of_command(self.options)]

    def is_late(self) -> bool:
        """Whether the run's time is over."""
        return self.deadline is not None and time.time() >= self.deadline


@dataclass(frozen=True)
class Planned:
    """One scene of a batch: its digest, the key of its light, and what is traced in its place."""

    digest: str
    key: str
    scene: Scene
    traced: Scene | None = None


# Scenes of the same light.
Job = tuple[Planned, ...]


def plan(sweep: Sweep, settings: Settings) -> list[Planned]:
    """Digest and light of every scene, in the sweep's order."""
    planned, study = [], settings.study
    for scene, traced in zip(sweep.scenes, traced_absorption(sweep.scenes), strict=True):
        # Another study of the same scene is another result.
        scene_id = digest(scene)
        scene_id = scene_id if study == "simulate" else hashlib.sha256(f"{study} {scene_id}".encode()).hexdigest()
        key = f"{light_digest(traced or scene)}{study if STUDIES[study].own_light else ''}"
        planned.append(Planned(scene_id, key, scene, traced))
    return planned


def of_shard(planned: list[Planned], shard: str | None) -> list[Planned]:
    """The scenes of a shard I/N, of all without one: whole groups, so that no light is traced by two shards."""
    if shard is None:
        return planned
    match = re.fullmatch(r"(\d+)/(\d+)", shard)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"shard {shard}: must be I/N with I of 1 to N, such as 1/8 (job arrays that count from 1).")
    keys = {key: i for i, key in enumerate(dict.fromkeys(p.key for p in planned))}
    return [p for p in planned if keys[p.key] % int(match[2]) == int(match[1]) - 1]


def jobs_of(planned: Iterable[Planned]) -> list[Job]:
    """Jobs of at most 16 scenes of the same light; the first of every light come before any second."""
    groups: dict[str, list[Planned]] = {}
    for p in planned:
        groups.setdefault(p.key, []).append(p)
    parts = [(i, tuple(group[i : i + CHUNK])) for group in groups.values() for i in range(0, len(group), CHUNK)]
    return [job for _, job in sorted(parts, key=lambda part: part[0])]


def plan_of(sweep: Sweep, planned: list[Planned], settings: Settings) -> Plan:
    """The plan for the folder."""
    return Plan(
        format=FORMAT,
        sweep=sweep.name,
        study=settings.study,
        dims=dict(sweep.dims),
        axes=sweep.axes,
        made=settings.made(),
        photons=settings.options.photons,
        relative_error=settings.options.relative_error,
        scenes=tuple(p.digest for p in planned),
        required=tuple(settings.required(p.scene) for p in planned),
        lights=len({p.key for p in planned}),
    )


def check_same(folder: Folder, planned: list[Planned], settings: Settings) -> str:
    """Raise InputError where the folder was begun with another sweep, seed, backend or version.

    A sweep may grow: one that holds all scenes that were planned before resumes in their folder.

    Returns: what is wrong with the plan that lies there, and so will be written anew; empty if nothing is.
    """
    try:
        old = folder.read_plan()
    except PlanError as error:
        return str(error) if (folder.root / "plan.json").exists() else ""
    made = settings.made()
    for name in ("seed", "backend"):
        if (then := getattr(old.made, name)) != (now := getattr(made, name)):
            raise InputError(
                f"{folder.root}: was begun with {name} {then}, and {now} is requested; "
                f"give {name} {then}, or another folder."
            )
    if old.made != made:
        raise InputError(
            f"{folder.root}: was begun with {old.made.other_versions}; use that version, or another folder."
        )
    others = len(set(old.scenes) - {p.digest for p in planned})
    if others:
        raise InputError(
            f'{folder.root}: holds the sweep "{old.sweep}", and {others} of its {len(old.scenes)} scenes are not '
            "in this one; use another folder."
        )
    return ""


def count(sweep: Sweep, **requested: Unpack[Requested]) -> dict[str, int]:
    """How many scenes a sweep has, and how many traces: scenes that differ only in absorption share one."""
    planned = plan(sweep, Settings.of(Path(), TraceOptions(**requested), sweep.study))
    return {"scenes": len({p.digest for p in planned}), "lights": len({p.key for p in planned})}


@dataclass
class JobReport:
    """What became of a job: digests of its scenes, and of light that was damaged, by what happened to them."""

    done: list[str] = field(default_factory=list)
    unmet: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    corrupt: list[str] = field(default_factory=list)


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work(job: Job, settings: Settings, sharers: int = 0) -> JobReport:
    """Do a job; what goes wrong with a scene is in the report. The first scene traces what is missing of the light.

    sharers : workers among which this machine's cores are to be divided, if that has not been done.

    Raises: WriteError where the folder takes no more.
    """
    report = JobReport()
    with _one_job:
        if sharers:
            backends.set_threads(max(1, cores() // sharers))
        for p in job:
            _study(p, settings, report)
    return report


def _study(p: Planned, settings: Settings, report: JobReport) -> None:
    """Study one scene, unless that is done, and write its result or why it failed; raises if the disk is at fault."""
    folder, made = Folder(settings.folder), settings.made()
    try:
        if folder.state(p.digest, settings.required(p.scene), made) == "done":
            report.done.append(p.digest)
            return
        header, arrays = _result(p, settings, report)
        if not header:
            return
        path = folder.result(p.digest)
        if path.is_dir():
            raise InputError(f"{path}: is a folder where a result is to be written; remove it")
        write_bytes(path, pack({"digest": p.digest, "made": made.model_dump()} | header, arrays), flush=True)
        folder.failure(p.digest).unlink(missing_ok=True)
        (report.done if header["reached"] else report.unmet).append(p.digest)
    except Exception as error:
        # A disk at fault is nobody's among the scenes: it ends the batch.
        if isinstance(error, WriteError):
            raise
        if isinstance(error, OSError) and error.errno in STORAGE:
            raise WriteError(f"{error}; correct that and run again") from None
        why = str(error) if isinstance(error, NailopticsError) else f"{type(error).__name__}: {error}"
        if isinstance(error, MemoryError):
            why = f"not enough memory for it ({error})"
        report.failed[p.digest] = why = " ".join(why.splitlines())
        record = {"error": why, "traceback": traceback.format_exception(error), "time": time.time()}
        folder.write_failure(p.digest, record)


def _result(p: Planned, settings: Settings, report: JobReport) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a scene's result; both empty where the batch's time ended before its light was traced."""
    scene = p.scene
    required, options = settings.required(scene), settings.options_of(scene)
    if settings.is_late():
        return {}, {}
    stores = settings.stores(lambda path, why: report.corrupt.append(path.parent.name))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReweightWarning)
        dataset, photons, reached = STUDIES[settings.study].run(scene, options, stores, p.traced)
    timed = required.photons is None and required.relative_error is None
    if options.max_seconds != required.max_seconds and settings.is_late() and (timed or not reached):
        return {}, {}
    worst = relative_error(dataset)
    header, arrays = to_record(dataset)
    return {
        **header,
        "required": required.model_dump(exclude_none=True),
        "scene": to_toml(scene),
        "seed": settings.options.seed,
        "backend": settings.options.backend,
        "photons_per_led": photons,
        "relative_error": worst if math.isfinite(worst) else None,
        "reached": reached,
        "warnings": sorted({str(w.message) for w in caught if issubclass(w.category, ReweightWarning)}),
    }, arrays
