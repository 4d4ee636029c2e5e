"""What a worker does with a job: light that is missing is traced, then every scene of the job is read from it."""

import math
import os
import threading
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import InputError, NailopticsError, NotReachedError, WriteError
from ..io import CorruptError, pack, write_bytes
from ..light import ReweightWarning, Transfer
from ..light import backend as backends
from ..light.tracing import PHOTONS_ENGINE, LedTrigger, LightEngine, accuracy, extend, led_sources
from ..light.tracing.store import LightStore
from ..light.transfer import current_versions
from ..light.transfer.records import LedBatches
from ..options import BackendName, TraceOptions
from ..scene import Accuracy, Scene, to_toml
from ..scene.sweep import StudyName
from ..variables import to_record
from . import reading
from .folder import STORAGE, Folder, ForeignError
from .study_runs import STUDIES

# Mitsuba's variant is one per process, and so is a claim: a worker with several threads still does one job at a time.
_one_job = threading.Lock()
# How a run ends whose folder lies on a full disk.
TAKES_NO_MORE = "the folder takes no more"
GONE = "the folder was removed during the run, and what was in it; run again to begin anew"


def other_versions(made: dict[str, Any]) -> str:
    """Which versions made a batch that are others than here, in words; nothing where they are the same."""
    here = current_versions()
    moved = [(name, made["versions"].get(name), now) for name, now in here.items()]
    return ", ".join(f"{name} {then} and is {now} here" for name, then, now in moved if then != now)


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
        chosen = cast(BackendName, backends.choose(options.backend).name)
        if study == "colour" and options.relative_error is not None:
            raise InputError("a sweep of colours has no --relative-error; give colour.tolerance in its base scene.")
        return cls(folder.resolve(), replace(options, backend=chosen, max_seconds=None), deadline, study)

    def required(self, scene: Scene) -> Accuracy:
        """What a scene's light must reach."""
        return accuracy(scene, self.options)

    def in_time(self, required: Accuracy) -> TraceOptions:
        """The options that reach it, but take no longer than the run has left."""
        if self.deadline is not None:
            left = max(self.deadline - time.time(), 1e-3)
            required = required.model_copy(update={"max_seconds": min(left, required.max_seconds or left)})
        return replace(self.options, **required.model_dump())

    def alone(self, scene: Scene) -> TraceOptions:
        """The options of a study that traces its own light: as requested or as the scene says, and no more."""
        asked = self.options
        given = asked.photons is not None or asked.relative_error is not None
        own = Accuracy(photons=asked.photons, relative_error=asked.relative_error) if given else scene.accuracy
        return self.in_time(own)

    def made(self) -> dict[str, Any]:
        """What decides a scene's result beside the scene and how accurate it is to be."""
        return {"seed": self.options.seed, "backend": self.options.backend, "versions": current_versions()}

    def stores(self, tell: Callable[[Path, Exception], None] | None = None) -> list[LightStore]:
        """Where light is kept, first that of the batch; what single commands traced is taken, too."""
        user = LightStore.of_user() if self.options.store else None
        return [LightStore(Folder(self.folder).light, tell=tell), *([user] if user else [])]

    def is_late(self) -> bool:
        """Whether the run's time is over."""
        return self.deadline is not None and time.time() >= self.deadline


@dataclass(frozen=True)
class Job:
    """Scenes that share their light.

    scenes : (digest, scene) of those to read now.
    also : scenes that will be read later from the same light, which is traced for them too.
    """

    key: str
    scenes: tuple[tuple[str, Scene], ...]
    also: tuple[Scene, ...] = ()

    @property
    def claim(self) -> str:
        """What nobody else should work on meanwhile."""
        return self.key if self.also or len(self.scenes) == 1 else self.scenes[0][0]


@dataclass
class JobReport:
    """What became of a job: digests of the scenes by what happened to them."""

    done: list[str] = field(default_factory=list)
    unmet: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    corrupt: list[str] = field(default_factory=list)
    busy: bool = False
    storage: str = ""


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def work(job: Job, settings: Settings, sharers: int = 0) -> JobReport:
    """Do a job; what goes wrong with a scene is in the report, never raised.

    sharers : workers among which this machine's cores are to be divided, if that has not been done.
    """
    report, folder = JobReport(), Folder(settings.folder)
    with _one_job:
        if sharers:
            backends.set_threads(max(1, cores() // sharers))
        try:
            with folder.claimed(job.claim) as mine:
                if folder.gone():
                    report.storage = GONE
                elif mine:
                    _do(job, settings, report)
                else:
                    report.busy = True
        except (OSError, WriteError) as error:
            if folder.gone():
                report.storage = GONE
                return report
            if not _is_storage(error):
                raise
            why = f"{error.strerror or error}; make room and run again" if isinstance(error, OSError) else str(error)
            report.storage = f"{TAKES_NO_MORE}: {why.rstrip('.')}"
    return report


def _do(job: Job, settings: Settings, report: JobReport) -> None:
    folder = Folder(settings.folder)
    made = settings.made()
    todo = [one for one in job.scenes if standing(folder, one[0], settings.required(one[1]), made) != "done"]
    report.done += [digest for digest, _ in job.scenes if digest not in dict(todo)]
    if not todo:
        return
    light = None
    try:
        if reads_transfer(todo[0][1], settings):
            light = _Light(job, [scene for _, scene in todo], settings, report)
    except Exception as error:
        if _is_storage(error):
            raise
        if len(todo) > 1 or job.also:
            # One of the scenes may ask for what cannot be done, and the others not.
            for one in todo:
                _do(Job(job.key, (one,)), settings, report)
        else:
            _failed(folder, todo[0][0], error, report)
        return
    for digest, scene in todo:
        try:
            header, arrays = _result(scene, light, settings)
            if header is None:  # too late for it
                continue
            if folder.result(digest).is_dir():
                raise InputError(f"{folder.result(digest)}: is a folder where a result is to be written; remove it")
            folder.result(digest).parent.mkdir(exist_ok=True)
            write_bytes(folder.result(digest), pack({"digest": digest, "made": made} | header, arrays), flush=True)
            folder.failure(digest).unlink(missing_ok=True)
            (report.done if header["reached"] else report.unmet).append(digest)
        except Exception as error:
            if _is_storage(error):
                raise
            _failed(folder, digest, error, report)


def _is_storage(error: Exception) -> bool:
    """Whether the disk is at fault, which is nobody's among the scenes: it ends the batch."""
    return isinstance(error, WriteError) or (isinstance(error, OSError) and error.errno in STORAGE)


def _failed(folder: Folder, digest: str, error: Exception, report: JobReport) -> None:
    why = str(error) if isinstance(error, NailopticsError) else f"{type(error).__name__}: {error}"
    if isinstance(error, MemoryError):
        why = f"not enough memory for it ({error})"
    why = " ".join(why.splitlines())
    folder.write_failure(digest, {"error": why, "traceback": traceback.format_exception(error), "time": time.time()})
    report.failed[digest] = why


def reads_transfer(scene: Scene, settings: Settings) -> bool:
    """Whether a scene is read from light that the batch stores; volpath and some studies trace their own."""
    by_walk = scene.light.engine != "volpath" and settings.options.backend != "scalar"
    return by_walk and settings.study not in STUDIES


def meets(header: dict[str, Any], required: Accuracy) -> bool:
    """Whether a stored result is at least as accurate as is required."""
    if header["reached"] and header.get("asked") == required.model_dump(exclude_none=True):
        return True  # volpath answers a finger's tolerance as well as it can
    if required.photons is not None:
        return header["photons_per_led"] >= required.photons
    if required.relative_error is not None:
        reached = header["relative_error"]
        return reached is not None and reached <= required.relative_error
    return True


def standing(folder: Folder, digest: str, required: Accuracy, made: dict[str, Any]) -> str:
    """How a scene stands: done, below what is required, foreign, corrupt, failed or missing."""
    try:
        found = folder.read_result(digest, made=made)
    except ForeignError:
        return "foreign"
    except CorruptError:
        return "failed" if folder.has_failed(digest) else "corrupt"
    if found is not None and meets(found[0], required):
        return "done"
    if folder.has_failed(digest):
        return "failed"
    return "missing" if found is None else "below"


class _Light:
    """The light of a job's scenes: stored batches, and those that were missing."""

    def __init__(self, job: Job, scenes: list[Scene], settings: Settings, report: JobReport) -> None:
        self.settings = settings
        first, asked = scenes[0], settings.options
        engine = LightEngine(first, backends.choose_jit(asked.backend, PHOTONS_ENGINE))
        stores = settings.stores(lambda path, why: report.corrupt.append(path.parent.name))
        self.leds: list[LedBatches] = []
        self.rules: list[dict[Any, LedTrigger]] = []
        for led, source in enumerate(led_sources(first, engine, stores, seed=asked.seed, backend=asked.backend)):
            # Scenes that differ only in what comes after the light need the same of it.
            rules: dict[Any, LedTrigger] = {}
            for scene in (*scenes, *job.also):
                need = self._need(scene, led)
                if need not in rules:
                    rules[need] = LedTrigger(scene, led, settings.required(scene), source.mu_a, full=engine.full)
            self.leds.append(extend(source, list(rules.values()), stop=settings.is_late))
            self.rules.append(rules)

    def _need(self, scene: Scene, led: int) -> Any:
        return scene.blood, scene.finger, scene.leds[led].fwhm_nm, self.settings.required(scene)

    def transfer(self, scene: Scene) -> tuple[Transfer, bool, float | None] | None:
        """The scene's light, whether it is as accurate as required, and its largest relative error if that is known.

        None where the batch's time ended before.
        """
        settings, traces, reached = self.settings, [], True
        errors: list[float | None] = []
        for led, (batches, rules) in enumerate(zip(self.leds, self.rules, strict=True)):
            rule = rules[self._need(scene, led)]
            if rule.unlit:
                raise NotReachedError(rule.unlit)
            sizes, met = rule.accepted_batches(batches.pieces)
            if not sizes or (not met and settings.is_late()):
                return None
            reached &= met
            errors.append(rule.errors[len(sizes) - 1] if sizes[-1] == rule.full else None)
            traces.append(batches.trace(sizes, seed=settings.options.seed, led=led, rest=rule.rest))
        worst = None if None in errors else max(error for error in errors if error is not None)
        return Transfer(scene, tuple(traces), settings.options.backend), reached, worst


def _result(
    scene: Scene, light: _Light | None, settings: Settings
) -> tuple[dict[str, Any] | None, dict[str, np.ndarray]]:
    """Header and arrays of a scene's result; no header where the batch's time ended before its light was traced."""
    own: dict[str, Any] = {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReweightWarning)
        if light is None:
            required = settings.required(scene)
            limited = settings.in_time(required)
            if study := STUDIES.get(settings.study):
                dataset, photons, reached = study.run(scene, settings.alone(scene), settings.stores())
                timed, worst = False, math.inf
            else:
                dataset, photons, reached = reading.by_volpath(scene, limited, settings.study)
                timed = required.photons is None and required.relative_error is None
                worst = reading.relative_error(dataset)
            if limited.max_seconds != required.max_seconds and settings.is_late() and (timed or not reached):
                return None, {}
            own = {"asked": required.model_dump(exclude_none=True)}
        else:
            found = light.transfer(scene)
            if found is None:
                return None, {}
            transfer, reached, error = found
            dataset = reading.of_transfer(transfer, settings.study, seed=settings.options.seed)
            worst = reading.relative_error(dataset) if error is None else error
            photons = min(t.photons for t in transfer.traces)
    header, arrays = to_record(dataset)
    return {
        **header,
        **own,
        "scene": to_toml(scene),
        "seed": settings.options.seed,
        # volpath may have run on another backend than photons would.
        "backend": dataset.attrs["backend"],
        "photons_per_led": photons,
        "relative_error": worst if math.isfinite(worst) else None,
        "reached": reached,
        "warnings": sorted({str(w.message) for w in caught if issubclass(w.category, ReweightWarning)}),
    }, arrays
