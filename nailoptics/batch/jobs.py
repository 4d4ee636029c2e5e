"""The jobs of a batch, one for each scene: what they share, what was there before, and what a worker does with one."""

import hashlib
import itertools
import logging
import math
import os
import re
import threading
import time
import traceback
import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Unpack

from ..errors import InputError, NailopticsError, WriteError
from ..io import pack, write_bytes
from ..light import ReweightWarning, backend as backends
from ..light.identity import light_digest, traced_absorption
from ..light.tracing import accuracy
from ..light.tracing.store import LightStore
from ..options import Requested, TraceOptions
from ..scene import Accuracy, Scene, digest, to_toml
from ..scene.sweep import StudyName, Sweep
from ..variables import to_record
from .folder import FORMAT, STORAGE, Folder, Plan, PlanError, Provenance
from .studies import STUDIES, relative_error

log = logging.getLogger(__name__)

# Mitsuba's variant is one per process: a worker with several threads still does one job at a time.
_one_job = threading.Lock()


@dataclass(frozen=True)
class Settings:
    """What all jobs of a batch share, with the end of the run's time (deadline, in seconds since the epoch).

    sharers : workers among which a machine's cores are to be divided, if that has not been done.
    made : what decides the results beside their scenes, where they are planned.
    """

    folder: Path
    options: TraceOptions
    deadline: float | None = None
    study: StudyName = "simulate"
    sharers: int = 0
    made: Provenance = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "made", Provenance.here(self.options.seed, self.options.backend))

    @classmethod
    def of(cls, folder: Path, options: TraceOptions, study: StudyName = "simulate") -> "Settings":
        """The settings of a run that begins now, with the backend that this machine offers."""
        deadline = None if options.max_seconds is None else time.time() + options.max_seconds
        chosen = backends.choose_jit(options.backend, "batch").name
        if study == "colour" and options.relative_error is not None:
            raise InputError("relative_error: a sweep of colours has none; give colour.tolerance in its base scene.")
        return cls(folder.resolve(), replace(options, backend=chosen, max_seconds=None), deadline, study)

    def required(self, scene: Scene) -> Accuracy:
        """What a scene's light must reach."""
        return accuracy(scene, self.options)

    def options_of(self, scene: Scene) -> TraceOptions:
        """The options of a scene's study, which takes no longer than the run has left."""
        requested = self.options.photons or self.options.relative_error
        required = scene.accuracy if STUDIES[self.study].own_accuracy and not requested else self.required(scene)
        if self.deadline is not None:
            left = max(self.deadline - time.time(), 1e-3)
            required = required.model_copy(update={"max_seconds": min(left, required.max_seconds or left)})
        return replace(self.options, **required.model_dump())

    def is_late(self) -> bool:
        """Whether the run's time is over."""
        return self.deadline is not None and time.time() >= self.deadline


@dataclass(frozen=True)
class Job:
    """One scene of a batch: its digest, the key of its light, and what is traced in its place."""

    digest: str
    key: str
    scene: Scene
    traced: Scene | None = None


def jobs_of(sweep: Sweep, settings: Settings) -> list[Job]:
    """A job for every scene, in the sweep's order."""
    jobs, study = [], settings.study
    for scene, traced in zip(sweep.scenes, traced_absorption(sweep.scenes), strict=True):
        # Another study of the same scene is another result.
        scene_id = digest(scene)
        scene_id = scene_id if study == "simulate" else hashlib.sha256(f"{study} {scene_id}".encode()).hexdigest()
        jobs.append(Job(scene_id, light_digest(traced or scene), scene, traced))
    return jobs


def of_shard(jobs: list[Job], shard: str | None) -> list[Job]:
    """The jobs of a shard I/N, all without one; those of one light go together, so that no two shards trace it."""
    if shard is None:
        return jobs
    match = re.fullmatch(r"(\d+)/(\d+)", shard)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"shard {shard}: must be I/N with I of 1 to N, such as 1/8 (job arrays that count from 1).")
    keys = {key: i for i, key in enumerate(dict.fromkeys(job.key for job in jobs))}
    return [job for job in jobs if keys[job.key] % int(match[2]) == int(match[1]) - 1]


def in_order(jobs: Iterable[Job]) -> list[Job]:
    """Jobs in the order in which they begin: the first of every light before any second."""
    earlier: defaultdict[str, Iterator[int]] = defaultdict(itertools.count)
    return sorted(jobs, key=lambda job: next(earlier[job.key]))


def plan_of(sweep: Sweep, jobs: Sequence[Job], settings: Settings) -> Plan:
    """The plan for the folder."""
    return Plan(
        format=FORMAT,
        sweep=sweep.name,
        study=settings.study,
        dims=dict(sweep.dims),
        axes=sweep.axes,
        made=settings.made,
        scenes=tuple(job.digest for job in jobs),
        required=tuple(settings.required(job.scene) for job in jobs),
        traces=len({job.key for job in jobs}),
    )


def check_same(folder: Folder, jobs: Sequence[Job], settings: Settings) -> None:
    """Raise InputError where the folder was begun with another sweep, seed, backend or version.

    A sweep may grow: one that holds all scenes that were planned before resumes in their folder.
    """
    try:
        old = folder.read_plan()
    except PlanError as error:
        if (folder.root / "plan.json").exists():
            log.warning("plan.json was damaged and is written anew: %s", error)
        return
    if unlike := old.made.unlike(settings.made, program=False):
        raise InputError(f"{folder.root}: was begun with {unlike}; use the same, or another folder.")
    if others := len(set(old.scenes) - {job.digest for job in jobs}):
        why = f"{others} of its {len(old.scenes)} scenes are not in this one; use another folder."
        raise InputError(f'{folder.root}: holds the sweep "{old.sweep}", and {why}')


def count(sweep: Sweep, **requested: Unpack[Requested]) -> dict[str, int]:
    """How many scenes a sweep has, and how many traces: scenes that differ only in absorption share one."""
    jobs = jobs_of(sweep, Settings.of(Path(), TraceOptions(**requested), sweep.study))
    return {"scenes": len({job.digest for job in jobs}), "traces": len({job.key for job in jobs})}


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work(job: Job, settings: Settings) -> tuple[str, str]:
    """Study a scene, unless that is done, and write its result or why it failed; WriteError where no more fits.

    Returns: done, unmet, failed, or unfinished, where the run's time ended before; and why it failed.
    """
    with _one_job:
        if settings.sharers:
            backends.set_threads(max(1, cores() // settings.sharers))
        try:
            return _study(job, settings), ""
        except WriteError:  # a disk at fault is no scene's: it ends the batch
            raise
        except Exception as error:
            if isinstance(error, OSError) and error.errno in STORAGE:
                raise WriteError(f"{error}; correct that and run again") from None
            why = str(error) if isinstance(error, NailopticsError) else f"{type(error).__name__}: {error}"
            if isinstance(error, MemoryError):
                why = f"not enough memory for it ({error})"
            why = " ".join(why.splitlines())
            Folder(settings.folder).write_failure(job.digest, why, traceback.format_exception(error))
            return "failed", why


def _study(job: Job, settings: Settings) -> str:
    """Study a scene and write its result: done, or unmet; or unfinished, with nothing written."""
    folder, made = Folder(settings.folder), settings.made
    if unlike := made.unlike(Provenance.here(made.seed, made.backend)):
        raise InputError(f"planned with {unlike}, in the worker; give it the same installation and try again")
    required = settings.required(job.scene)
    if folder.state(job.digest, required, made) == "done":
        return "done"
    if settings.is_late():
        return "unfinished"
    # What single commands traced is read, too.
    stores = [LightStore(settings.folder / "light"), *LightStore.of_command(settings.options)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ReweightWarning)
        options = settings.options_of(job.scene)
        dataset, photons, reached = STUDIES[settings.study].run(job.scene, options, stores, job.traced)
    if settings.is_late() and not (reached and (required.photons or required.relative_error)):
        return "unfinished"
    path = folder.result(job.digest)
    if path.is_dir():
        raise InputError(f"{path}: is a folder where a result is to be written; remove it")
    if not path.parent.is_dir():  # it was removed meanwhile, with what was done before
        raise WriteError(f"{path.parent}: is gone; run again to make all scenes anew")
    (header, arrays), worst = to_record(dataset), relative_error(dataset)
    header |= {
        "digest": job.digest,
        "made": made.model_dump(),
        "required": required.model_dump(exclude_none=True),
        "scene": to_toml(job.scene),
        "photons_per_led": photons,
        "relative_error": worst if math.isfinite(worst) else None,
        "reached": reached,
    }
    write_bytes(path, pack(header, arrays))
    folder.failure(job.digest).unlink(missing_ok=True)
    return "done" if reached else "unmet"
