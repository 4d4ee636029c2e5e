"""The driver of a batch: plans jobs, hands them to workers here or on a cluster, and replaces workers that die."""

import contextlib
import hashlib
import logging
import multiprocessing
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

from ..errors import InputError, NailopticsError, NotReachedError, WriteError
from ..io import let_dask_in
from ..light.identity import light_digest
from ..local_worker import prepare
from ..options import Requested, TraceOptions
from ..scene import Scene, digest
from ..scene.sweep import Sweep
from .folder import FORMAT, Folder, Plan, PlanError, PlannedAxis
from .studies import STUDIES, by_volpath
from .work import GONE, TAKES_NO_MORE, Job, JobReport, Settings, cores, work

log = logging.getLogger(__name__)

# Scenes of one light that one job studies.
CHUNK = 16
# A scene whose worker dies so often is recorded as failed, and after so many of one light all the others of it.
DEATHS, FATAL = 2, 3
# How often the driver looks at the clock. [s]
WAIT_S = 0.5
# Read by NumPy's BLAS when a worker imports it; one thread each, so that sums are the same on every machine.
_SINGLE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@dataclass
class Outcome:
    """What a run did: digests by what became of them; kept were there before, corrupt are files made again."""

    total: int
    lights: int
    kept: list[str] = field(default_factory=list)
    done: list[str] = field(default_factory=list)
    unmet: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)
    corrupt: list[str] = field(default_factory=list)
    unfinished: int = 0
    deaths: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class BatchProgress:
    """How far a run is; news is what happened since, such as a failure, empty if nothing. [s]"""

    done: int
    total: int
    failed: int
    seconds: float
    seconds_left: float | None
    news: str = ""


@dataclass(frozen=True)
class Planned:
    """One scene of a batch: its digest, and the key of its light."""

    digest: str
    key: str
    scene: Scene


def run_batch(
    sweep: Sweep,
    folder: str | Path,
    *,
    workers: int | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    retry_failed: bool = False,
    progress: Callable[[BatchProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> Outcome:
    """Run the remaining scenes of a sweep in a folder; what is there is kept, or continued if it is not good enough.

    workers : processes on this machine; one per core (on CUDA: one) if not given.
    threads : threads of each; the cores divided among the workers if not given.
    scheduler : address of a Dask scheduler in place of local workers; its workers must see the folder.
    shard : I/N, to run the I-th of N parts.
    retry_failed : retry scenes that failed before.
    max_seconds : wall time after which the run stops; what was traced stays, and the next run resumes from there.

    Raises: InputError; NotReachedError, whose result is the Outcome, where scenes failed, missed their tolerance or
    were not reached.
    """
    for name, value in (("workers", workers), ("threads", threads)):
        if value is not None and not value > 0:
            raise InputError(f"{name} = {value}; must be above 0.")
    if workers is not None and scheduler is not None:
        raise InputError("--workers and --scheduler exclude each other; a scheduler has its own workers.")
    begin = time.time()
    settings = Settings.of(Path(folder), TraceOptions(**requested), sweep.study)
    place, part = Folder(settings.folder), parse_shard(shard)
    planned = plan(sweep, settings)
    damage = check_same(place, planned, settings)
    place.make()
    place.write_plan(plan_of(sweep, planned, settings))
    mine = of_shard(planned, part)
    driver = _Driver(settings, mine, retry_failed, progress, begin)
    if damage:
        driver.show(f"plan.json was damaged and is written anew: {damage}")
    if driver.queue:
        with _single_threaded_blas():
            workers = workers or (1 if settings.options.backend == "cuda" else cores())
            threads = threads or max(1, cores() // workers)
            driver.run(ClusterSlots(scheduler) if scheduler is not None else LocalSlots(workers, threads))
    return driver.judged()


def plan(sweep: Sweep, settings: Settings) -> list[Planned]:
    """Digest and light of every scene, in the sweep's order."""
    planned, study = [], settings.study
    for scene in sweep.scenes:
        # Another study of the same scene is another result.
        own = digest(scene)
        own = own if study == "simulate" else hashlib.sha256(f"{study} {own}".encode()).hexdigest()
        key = f"{light_digest(scene)}{study if STUDIES[study].own_light else ''}"
        stores_none = by_volpath(scene, settings.options.backend) and not STUDIES[study].own_light
        planned.append(Planned(own, own if stores_none else key, scene))
    return planned


def parse_shard(text: str | None) -> tuple[int, int]:
    """A shard I/N as numbers: I of 1 to N."""
    if text is None:
        return 1, 1
    part, slash, count = text.partition("/")
    if not (slash and part.isdigit() and count.isdigit() and 1 <= int(part) <= int(count)):
        raise InputError(f"--shard {text}: must be I/N with I of 1 to N, such as 1/8 (job arrays that count from 1).")
    return int(part), int(count)


def of_shard(planned: list[Planned], shard: tuple[int, int]) -> list[Planned]:
    """The scenes of one shard: whole groups, so that no light is traced by two shards."""
    keys = {key: i for i, key in enumerate(dict.fromkeys(p.key for p in planned))}
    return [p for p in planned if keys[p.key] % shard[1] == shard[0] - 1]


def jobs_of(planned: list[Planned]) -> list[Job]:
    """Jobs of at most 16 scenes of the same light; the first of every light come before any second."""
    groups: dict[str, list[tuple[str, Scene]]] = {}
    for p in planned:
        groups.setdefault(p.key, []).append((p.digest, p.scene))
    parts = [
        (i, Job(key, tuple(some[i : i + CHUNK]))) for key, some in groups.items() for i in range(0, len(some), CHUNK)
    ]
    return [job for _, job in sorted(parts, key=lambda part: part[0])]


def plan_of(sweep: Sweep, planned: list[Planned], settings: Settings) -> Plan:
    """The plan for the folder."""
    options = settings.options
    return Plan(
        format=FORMAT,
        sweep=sweep.name,
        study=settings.study,
        dims=dict(sweep.dims),
        axes=tuple(PlannedAxis(name=a.name, path=a.path, values=tuple(a.values)) for a in sweep.axes),
        made=settings.made(),
        photons=options.photons,
        relative_error=options.relative_error,
        scenes=tuple(p.digest for p in planned),
        asked=tuple(settings.required(p.scene) for p in planned),
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
        return "" if folder.gone() else str(error)
    made = settings.made()
    for name in ("seed", "backend"):
        if (then := getattr(old.made, name)) != (now := getattr(made, name)):
            raise InputError(
                f"{folder.root}: was begun with {name} {then}, and {now} is requested; "
                f"use --{name} {then} or another folder."
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


class LocalSlots:
    """Spawned processes of this machine, one per slot, so that a death tells which job it was."""

    sharers = 0

    def __init__(self, workers: int, threads: int) -> None:
        self.threads = threads
        # Mitsuba and forking do not mix.
        self.context = multiprocessing.get_context("spawn")
        self.executors: list[Executor] = [self._new() for _ in range(workers)]

    def _new(self) -> Executor:
        return ProcessPoolExecutor(1, mp_context=self.context, initializer=prepare, initargs=(self.threads,))

    def start(self) -> None:
        """Wait until all are ready."""
        try:
            for ready in [executor.submit(os.getpid) for executor in self.executors]:
                ready.result()
        except BrokenExecutor:
            why = "in a script, run batches under if __name__ == '__main__': only"
            raise NailopticsError(f"the worker processes die as they start; {why}.") from None

    def renew(self, slot: int) -> None:
        """Replace a slot whose worker died."""
        self.executors[slot].shutdown(wait=False, cancel_futures=True)
        self.executors[slot] = self._new()

    def deserted(self) -> bool:
        """Whether nobody is left to work."""
        return False

    def close(self, *, now: bool) -> None:
        """Let the workers go; at once, with whatever they do, or when they are done."""
        if now:
            mine = {pid for e in self.executors for pid in (getattr(e, "_processes", None) or {})}
            for child in multiprocessing.active_children():
                if child.pid in mine:
                    child.terminate()
        for executor in self.executors:
            executor.shutdown(wait=True, cancel_futures=True)


class ClusterSlots(LocalSlots):
    """The workers of a Dask scheduler, which replaces those that die."""

    def __init__(self, address: str) -> None:
        let_dask_in()
        try:
            from distributed import Client
        except ImportError:
            raise InputError("--scheduler needs Dask: pip install 'nailoptics[cluster]'.") from None
        try:
            self.client = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            why = str(error).splitlines()[0]
            raise InputError(f"--scheduler {address}: cannot be reached ({why}); start dask scheduler first.") from None
        found = self.client.nthreads()
        if not found:
            self.client.close()
            raise InputError(f"--scheduler {address}: has no workers; start dask worker {address} --nthreads 1.")
        # One more than there are workers, so that none waits for the driver.
        self.executors = [self.client.get_executor(pure=False)] * (2 * sum(found.values()))
        # Workers of one machine divide its cores.
        self.sharers = max(Counter(address.rpartition(":")[0] for address in found).values())

    def start(self) -> None:
        """They are there."""

    def renew(self, slot: int) -> None:
        """The scheduler does."""

    def deserted(self) -> bool:
        """Whether nobody is left to work, though somebody may come."""
        with contextlib.suppress(Exception):  # the scheduler went away, which its futures report
            return not self.client.nthreads()
        return False

    def close(self, *, now: bool) -> None:
        """Leave the cluster."""
        self.client.close(timeout=5)


@contextlib.contextmanager
def _single_threaded_blas() -> Iterator[None]:
    """Processes started meanwhile do linear algebra on one thread."""
    before = {name: os.environ[name] for name in _SINGLE if name in os.environ}
    os.environ.update(dict.fromkeys(_SINGLE, "1"))
    try:
        yield
    finally:
        for name in _SINGLE:
            del os.environ[name]
        os.environ.update(before)


class _Driver:
    """The loop of one run."""

    def __init__(
        self,
        settings: Settings,
        planned: list[Planned],
        retry_failed: bool,
        progress: Callable[[BatchProgress], None] | None,
        begin: float,
    ) -> None:
        self.settings, self.progress, self.begin = settings, progress, begin
        self.planned = list({p.digest: p for p in planned}.values())
        self.outcome = Outcome(len(self.planned), len({p.key for p in planned}))
        self.running: dict[Future[JobReport], tuple[int, Job]] = {}
        # Deaths of each scene's worker, and scenes of each light that were given up.
        self.deaths: Counter[str] = Counter()
        self.fatal: Counter[str] = Counter()
        self.trouble, self.deserted = "", False
        self.left: set[str] = set()
        self.queue = deque(jobs_of(self._remaining(retry_failed)))
        self.started = time.time()

    def _remaining(self, retry_failed: bool) -> list[Planned]:
        """What is left to do, checking every result that is there."""
        why = {
            "corrupt": "damaged (checksum, name or content)",
            "foreign": "another seed's, backend's or version's",
        }
        folder, left = Folder(self.settings.folder), []
        for p in self.planned:
            standing = self._standing(p)
            if standing == "done":
                self.outcome.kept.append(p.digest)
            elif standing == "failed" and not retry_failed:
                self.outcome.failed[p.digest] = folder.why_failed(p.digest)
            else:
                left.append(p)
                self.left.add(p.digest)
            if standing in why:
                self.outcome.corrupt.append(p.digest)
                self.show(f"result {p.digest[:12]} is {why[standing]}; made again")
        return left

    def _standing(self, p: Planned) -> str:
        return Folder(self.settings.folder).standing(p.digest, self.settings.required(p.scene), self.settings.made())

    def run(self, slots: LocalSlots) -> None:
        """Hand out jobs until none is left, the time is over, or nothing more can be written."""
        free = deque(range(len(slots.executors)))
        finished = False
        try:
            slots.start()
            while self.queue or self.running:
                if self.settings.is_late() or self.trouble:
                    self.queue.clear()
                while free and self.queue:
                    self._submit(slots, free)
                done, _ = wait(self.running, timeout=WAIT_S, return_when=FIRST_COMPLETED)
                if not done:
                    self._look_for_workers(slots)
                for future in done:
                    slot, job = self.running.pop(future)
                    free.append(slot)
                    self._book(future, slot, job, slots)
                if self.trouble.startswith("the scheduler"):
                    break
                self.show()
            finished = True
        except KeyboardInterrupt:
            self.trouble = "interrupted; what is done is kept, run again to resume"
        finally:
            slots.close(now=not finished)

    def _submit(self, slots: LocalSlots, free: deque[int]) -> None:
        slot, job = free.popleft(), self.queue.popleft()
        try:
            self.running[slots.executors[slot].submit(work, job, self.settings, slots.sharers)] = slot, job
        except BrokenExecutor:  # it died while idle
            slots.renew(slot)
            self.queue.appendleft(job)
            free.append(slot)
        except Exception as error:  # a scheduler that went away
            self._lost(error)

    def _book(self, future: "Future[JobReport]", slot: int, job: Job, slots: LocalSlots) -> None:
        """Book a job's report, or its worker's death."""
        try:
            report = future.result()
        except BrokenExecutor:
            slots.renew(slot)
            return self._died(job)
        except (CancelledError, Exception) as error:
            if type(error).__name__ == "KilledWorker":  # of the cluster, and maybe for another job of that worker
                return self._died(job)
            if isinstance(slots, ClusterSlots) and isinstance(error, CancelledError | OSError | TimeoutError):
                return self._lost(error)
            raise
        if report.busy:
            self.queue.append(job)
        self.trouble = report.storage or self.trouble
        self.outcome.done += report.done
        self.outcome.unmet += report.unmet
        self.outcome.failed |= report.failed
        self.outcome.corrupt += report.corrupt
        self.left -= {*report.done, *report.unmet, *report.failed}
        for name in report.corrupt:
            self.show(f"light {name[:12]} is damaged or another's (checksum, name); traced again")
        for digest_, why in report.failed.items():
            self.show(f"scene {digest_[:12]} failed: {why}")

    def _look_for_workers(self, slots: LocalSlots) -> None:
        """Say once that nobody is left to work; nothing comes from them in time."""
        deserted = slots.deserted()
        if deserted and not self.deserted:
            self.show("the cluster has no workers any more; waiting for new ones (Ctrl-C keeps what is done)")
        self.deserted = deserted
        if deserted and self.settings.is_late():
            self.running.clear()

    def _died(self, job: Job) -> None:
        """After a worker's death its scenes are tried one by one; one that kills again is given up.

        So is a light that killed with several of its scenes.
        """
        self.outcome.deaths += 1
        if len(job.scenes) > 1:
            self.queue.extend(Job(job.key, (one,)) for one in job.scenes)
            return self.show("a worker was killed; its scenes are tried again one by one")
        ((digest_, _),) = job.scenes
        self.deaths[digest_] += 1
        if self.deaths[digest_] < DEATHS:
            self.queue.appendleft(job)
            return self.show(f"a worker was killed; scene {digest_[:12]} is tried again")
        self._give_up([digest_], f"its worker was killed {DEATHS} times; out of memory?")
        self.fatal[job.key] += 1
        if self.fatal[job.key] == FATAL:
            others = [one for other in self.queue if other.key == job.key for one, _ in other.scenes]
            self.queue = deque(other for other in self.queue if other.key != job.key)
            self._give_up(others, f"{FATAL} scenes with its light had their workers killed; out of memory?")

    def _give_up(self, digests: list[str], why: str) -> None:
        """Record scenes as failed."""
        for one in digests:
            try:
                Folder(self.settings.folder).write_failure(one, {"error": why, "time": time.time()})
            except WriteError as error:
                self.trouble = f"{TAKES_NO_MORE}: {str(error).rstrip('.')}"
                return
            self.outcome.failed[one] = why
            self.left.discard(one)
            self.show(f"scene {one[:12]} failed: {why}")

    def _lost(self, error: BaseException) -> None:
        log.debug("scheduler lost: %r", error)
        self.trouble = "the scheduler went away; what is done is kept, run again to resume"

    def show(self, news: str = "") -> None:
        """Show how far the run is, and what just happened."""
        if self.progress is None:
            return
        now, outcome = time.time(), self.outcome
        reported = len(outcome.done) + len(outcome.unmet)
        seconds_left = (now - self.started) / reported * len(self.left) if reported else None
        done = outcome.total - len(self.left) - len(outcome.failed)
        self.progress(BatchProgress(done, outcome.total, len(outcome.failed), now - self.begin, seconds_left, news))

    def judged(self) -> Outcome:
        """The outcome, or NotReachedError with it as result where anything is missing."""
        outcome, folder, trouble = self.outcome, Folder(self.settings.folder), self.trouble
        if folder.gone():
            outcome.done, outcome.kept, trouble = [], [], GONE
        for p in self.planned if trouble else ():  # what workers did whose reports did not come any more
            if (
                p.digest in self.left
                and folder.standing(p.digest, self.settings.required(p.scene), self.settings.made()) == "done"
            ):
                self.left.discard(p.digest)
                outcome.done.append(p.digest)
        outcome.unfinished, outcome.seconds = len(self.left), time.time() - self.begin
        reasons = [trouble] if trouble else []
        if outcome.failed:
            first = next(iter(outcome.failed.values())).rstrip(".")
            reasons.append(f"{len(outcome.failed)} failed (the first: {first}; --retry-failed tries them again)")
        if outcome.unmet:
            reasons.append(f"{len(outcome.unmet)} missed their relative error in their time (run again to continue)")
        if outcome.unfinished and not trouble:
            reasons.append(f"max_seconds ended the run with {outcome.unfinished} left (run again to resume)")
        if reasons:
            good = len(outcome.kept) + len(outcome.done)
            text = f"{good} of {outcome.total} scenes are done; {'; '.join(reasons)}."
            raise NotReachedError(text, result=outcome, full=trouble.startswith(TAKES_NO_MORE))
        return outcome
