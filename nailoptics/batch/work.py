"""What a worker does with a job: each of its scenes is studied, and light that is missing is traced into the folder."""

import math
import os
import threading
import time
import traceback
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import InputError, NailopticsError, WriteError
from ..io import pack, write_bytes
from ..light import ReweightWarning
from ..light import backend as backends
from ..scene import to_toml
from ..variables import to_record
from .folder import STORAGE, Folder
from .jobs import Job, Planned, Settings
from .studies import STUDIES, relative_error

# Mitsuba's variant is one per process: a worker with several threads still does one job at a time.
_one_job = threading.Lock()


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
