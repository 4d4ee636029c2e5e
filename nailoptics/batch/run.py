"""The driver of a batch: plans jobs, hands them to workers here or on a cluster, and replaces workers that die."""

import logging
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent import futures
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeAlias, Unpack

import xarray as xr

from ..errors import InputError, NailopticsError, NotReachedError, WriteError, as_far_as_reached, unless_cut_off
from ..io import unblock_dask_import
from ..local_worker import prepare
from ..options import Requested, TraceOptions
from ..scene import SceneIn
from ..scene.sweep import StudyName, Sweep, sweep_over
from .folder import DAMAGE, Folder, open_results
from .jobs import Job, Settings, check_same, cores, in_order, jobs_of, of_shard, plan_of, work

log = logging.getLogger(__name__)

# A scene whose worker crashes so often is recorded as failed.
MOST_CRASHES = 2
# Interval at which the driver reads the clock. [s]
WAIT_S = 0.5
# Read by NumPy's BLAS when a worker imports it; one thread each, so that sums are the same on every machine.
_SINGLE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# What became of a job, and why it failed.
Result: TypeAlias = "futures.Future[tuple[str, str]]"


@dataclass
class Outcome:
    """What a run did: digests of scenes by what became of them, why those failed that did, and worker crashes (deaths).

    kept : they were done before. corrupt : their results were damaged or others', see `DAMAGE`, and were made again.
    """

    total: int
    traces: int
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


class BatchRequested(Requested, total=False):
    """Options of a trace, and of how a batch runs, as in `run_batch`."""

    workers: int | None
    scheduler: str | None
    progress: Callable[[BatchProgress], None] | None


def run_batch(
    sweep: Sweep,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    retry_failed: bool = False,
    progress: Callable[[BatchProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> Outcome:
    """Run the remaining scenes of a sweep in a folder; what is there is kept, or continued if it is not good enough.

    workers : processes on this machine; one per core (on CUDA and Metal: one), and no more than scenes, if not given.
    scheduler : address of a Dask scheduler in place of local workers; its workers must see the folder.
    shard : I/N, to run the I-th of N parts.
    retry_failed : retry scenes that failed before.
    requested : fields of `TraceOptions`; max_seconds is the wall time after which the run stops, to be resumed.

    Raises: InputError; NotReachedError, whose result is the Outcome, where scenes failed, missed their tolerance or
    were not reached.
    """
    if workers is not None and not (isinstance(workers, int) and workers > 0):
        raise InputError(f"workers = {workers!r}; must be a whole number above 0.")
    if workers is not None and scheduler is not None:
        raise InputError("workers and scheduler exclude each other; a scheduler has its own workers.")
    settings = Settings.of(Path(folder), TraceOptions(**requested), sweep.study)
    place, jobs = Folder(settings.folder), jobs_of(sweep, settings)
    mine = of_shard(jobs, shard)
    check_same(place, jobs, settings)
    place.make()
    place.write_plan(plan_of(sweep, jobs, settings))
    driver = _Driver(settings, mine, progress)
    driver.take_out_finished(retry_failed)
    if driver.left:
        usual = 1 if settings.options.backend in ("cuda", "metal") else min(cores(), len(driver.left))
        driver.run(ClusterSlots(scheduler) if scheduler else LocalSlots(workers or usual))
    return driver.checked_outcome()


def sweep(
    scene: SceneIn,
    over: Mapping[str, Any],
    *,
    study: StudyName = "simulate",
    combine: Literal["product", "zip"] = "product",
    folder: str | Path | None = None,
    course: bool = False,
    **requested: Unpack[BatchRequested],
) -> xr.Dataset:
    """Run a study of a scene over values of its fields, in several processes, as one dataset.

    Each field is a dimension, called as its last part, such as so2; its values, with their unit, are the coordinate.
    Scenes that differ in absorption only share one trace.

    over : values by field, such as {"blood.so2": [0.9, 0.97], "leds.ir.flux_mw": [1.0, 2.0]}.
    study : simulate, trace, oximeter or colour.
    combine : product, every combination of values; or zip, the first values of all fields, the second, and so on, along
        the dimension sample.
    folder : where results stay, and a sweep that was ended goes on; a temporary folder if not given.
    course : also what runs over time (volts, blood, force).
    requested : seed, backend, relative_error, max_seconds, photons, store; workers, scheduler, progress of `run_batch`.

    Raises: InputError; NotReachedError, whose result is the dataset, where scenes failed, missed their tolerance or
        were not reached.
    """
    planned = sweep_over(scene, over, study=study, combine=combine)
    with ExitStack() as stack:
        place = folder or stack.enter_context(tempfile.TemporaryDirectory(prefix="nailoptics_"))
        _, unmet = as_far_as_reached(run_batch, planned, place, retry_failed=True, **requested)
        results = open_results(place, course=course)
    return unless_cut_off(results, unmet)


class LocalSlots:
    """Spawned processes of this machine, one per slot, so that a crash identifies its scene.

    killed : what a future raises whose worker crashed. lost : what is raised where no worker will come any more.
    """

    sharers = 0
    killed: tuple[type[BaseException], ...] = (futures.BrokenExecutor,)
    lost: tuple[type[BaseException], ...] = ()

    def __init__(self, workers: int) -> None:
        os.environ.update(dict.fromkeys(_SINGLE, "1"))
        self.threads = max(1, cores() // workers)
        self.executors: list[futures.Executor] = [self._new() for _ in range(workers)]
        try:
            for ready in [executor.submit(os.getpid) for executor in self.executors]:
                ready.result()
        except futures.BrokenExecutor:
            raise NailopticsError("the worker processes die as they start, for the reason that they print.") from None

    def _new(self) -> futures.Executor:
        # Mitsuba and forking do not mix.
        spawn = multiprocessing.get_context("spawn")
        executor = futures.ProcessPoolExecutor(1, mp_context=spawn, initializer=prepare, initargs=(self.threads,))
        # The first call starts the process, which runs what is the main module then: no script of the user.
        main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
        try:
            executor.submit(os.getpid)
        finally:
            sys.modules["__main__"] = main
        return executor

    def submit(self, slot: int, job: Job, settings: Settings) -> Result:
        """Give a slot a job."""
        try:
            return self.executors[slot].submit(work, job, settings)
        except futures.BrokenExecutor:  # it died while idle
            self.renew(slot)
            return self.executors[slot].submit(work, job, settings)

    def renew(self, slot: int) -> None:
        """Replace a slot whose worker died."""
        self.executors[slot].shutdown(wait=False, cancel_futures=True)
        self.executors[slot] = self._new()

    def are_gone(self) -> bool:
        """Whether no worker is left that could end a job."""
        return False

    def close(self, *, now: bool) -> None:
        """Let the workers go; at once, with whatever they do, or when they are done."""
        for executor in self.executors:
            for process in (getattr(executor, "_processes", None) or {}).values() if now else ():
                process.terminate()
        for executor in self.executors:
            executor.shutdown(wait=True, cancel_futures=True)


class ClusterSlots(LocalSlots):
    """The workers of a Dask scheduler, which replaces those that die."""

    def __init__(self, address: str) -> None:
        unblock_dask_import()
        try:
            from distributed import Client, KilledWorker
        except ImportError:
            raise InputError("a scheduler needs Dask: pip install 'nailoptics[cluster]'.") from None
        self.killed, self.lost = (KilledWorker,), (futures.CancelledError, OSError, TimeoutError)
        try:
            self.client = Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as error:
            why = str(error).splitlines()[0]
            raise InputError(f"scheduler {address}: cannot be reached ({why}); start dask scheduler first.") from None
        threads = self.client.nthreads()
        if not threads:
            self.client.close()
            raise InputError(f"scheduler {address}: has no workers; start dask worker {address} --nthreads 1.")
        # One more than there are workers, so that none waits for the driver.
        self.executors = [self.client.get_executor(pure=False)] * (2 * sum(threads.values()))
        # Workers of one machine divide its cores.
        self.sharers = max(Counter(thread.rpartition(":")[0] for thread in threads).values())

    def submit(self, slot: int, job: Job, settings: Settings) -> Result:
        """Give the scheduler a job."""
        try:
            return self.executors[slot].submit(work, job, settings)
        except Exception as error:  # of a client whose scheduler went away, of any kind
            raise ConnectionError(str(error)) from None

    def renew(self, slot: int) -> None:
        """The scheduler does."""

    def are_gone(self) -> bool:
        """Whether the cluster has lost all its workers."""
        return not self.client.nthreads()

    def close(self, *, now: bool) -> None:
        """Leave the cluster."""
        self.client.close(timeout=5)


class _Driver:
    """The loop of one run.

    left : jobs that have not ended yet, by the digest of their scene.
    stored : lights of which a job has ended, so that others read what it stored.
    trouble : why the run ended before its time; full where it was for lack of room.
    """

    def __init__(
        self, settings: Settings, jobs: Sequence[Job], progress: Callable[[BatchProgress], None] | None
    ) -> None:
        self.settings, self.progress, self.folder = settings, progress, Folder(settings.folder)
        self.left = {job.digest: job for job in jobs}
        self.outcome = Outcome(total=len(self.left), traces=len({job.key for job in jobs}))
        self.queue: list[Job] = []
        self.running: dict[Result, tuple[int, Job]] = {}
        self.stored: set[str] = set()
        self.crashes: Counter[str] = Counter()
        self.begin = self.started = time.time()
        self.trouble, self.full, self.retried = "", False, False

    def take_out_finished(self, retry_failed: bool) -> None:
        """Take out of what is left the scenes that are done, and those that failed and are not to be tried again."""
        self.retried = self.retried or retry_failed
        for digest, job in list(self.left.items()):
            if retry_failed:
                self.folder.failure(digest).unlink(missing_ok=True)
            state = self.folder.state(digest, self.settings.required(job.scene), self.settings.made)
            if state in ("done", "failed"):
                self._end(job, "kept" if state == "done" else state, self.folder.why_failed(digest))
            elif state in DAMAGE and digest not in self.outcome.corrupt:
                self.outcome.corrupt.append(digest)
                self.show(f"result {digest[:12]} is {DAMAGE[state]}; made again")

    def _end(self, job: Job, state: str, why: str) -> None:
        """Note what became of a scene: kept, done, unmet or failed."""
        del self.left[job.digest]
        if state == "failed":
            self.outcome.failed[job.digest] = why
        else:
            getattr(self.outcome, state).append(job.digest)

    def run(self, slots: LocalSlots) -> None:
        """Hand out jobs until none is left, the time is over, or nothing more can be written."""
        self.queue, self.started, finished = in_order(self.left.values()), time.time(), False
        try:
            self._hand_out(slots)
            finished = True
        except KeyboardInterrupt:
            self.trouble = "interrupted; what is done is kept, run again to resume"
        except WriteError as error:
            self.trouble, self.full = f"the folder takes no more: {str(error).rstrip('.')}", True
        except slots.lost as error:
            log.debug("scheduler lost: %r", error)
            self.trouble = "the scheduler went away; what is done is kept, run again to resume"
            self.take_out_finished(False)  # what workers did without a word of it coming back
        finally:
            slots.close(now=not finished)

    def _hand_out(self, slots: LocalSlots) -> None:
        free, settings = [*range(len(slots.executors))], replace(self.settings, sharers=slots.sharers)
        while self.queue or self.running:
            if self.settings.is_late():
                self.queue.clear()
                if slots.are_gone():
                    break
            while free and (job := self._next_job()):
                self.queue.remove(job)
                slot = free.pop(0)
                self.running[slots.submit(slot, job, settings)] = slot, job
            for future in futures.wait(self.running, WAIT_S, futures.FIRST_COMPLETED).done:
                slot, job = self.running.pop(future)
                free.append(slot)
                try:
                    state, why = future.result()
                    self.stored.add(job.key)
                except slots.killed:
                    slots.renew(slot)
                    state, why = self._after_crash(job)
                if state != "unfinished":
                    self._end(job, state, why)
                if state == "failed":
                    self.show(f"scene {job.digest[:12]} failed: {why}")
            self.show()

    def _next_job(self) -> Job | None:
        """The first job in the queue whose light nobody is tracing at this moment."""
        traced = {job.key for _, job in self.running.values()} - self.stored
        return next((job for job in self.queue if job.key not in traced), None)

    def _after_crash(self, job: Job) -> tuple[str, str]:
        """What becomes of a scene whose worker crashed: it is tried again, and given up the next time."""
        self.outcome.deaths += 1
        self.crashes[job.digest] += 1
        if self.crashes[job.digest] < MOST_CRASHES:
            self.show(f"a worker was killed; scene {job.digest[:12]} is tried again")
            self.queue.insert(0, job)
            return "unfinished", ""
        why = f"its worker was killed {MOST_CRASHES} times; out of memory?"
        self.folder.write_failure(job.digest, why)
        return "failed", why

    def show(self, news: str = "") -> None:
        """Show how far the run is, and what just happened."""
        if self.progress is None:
            return
        now, outcome = time.time(), self.outcome
        reported = len(outcome.done) + len(outcome.unmet)
        seconds_left = (now - self.started) / reported * len(self.left) if reported else None
        done = reported + len(outcome.kept)
        self.progress(BatchProgress(done, outcome.total, len(outcome.failed), now - self.begin, seconds_left, news))

    def checked_outcome(self) -> Outcome:
        """The outcome; raises NotReachedError with it as result where anything is missing."""
        outcome = self.outcome
        outcome.unfinished, outcome.seconds = len(self.left), time.time() - self.begin
        reasons = [self.trouble] if self.trouble else []
        if outcome.failed:
            first = next(iter(outcome.failed.values())).rstrip(".")
            again = "" if self.retried else "; --retry-failed tries them again"
            reasons.append(f"{len(outcome.failed)} failed (the first: {first}{again})")
        if outcome.unmet:
            reasons.append(f"{len(outcome.unmet)} missed their relative error in their time (run again to continue)")
        if outcome.unfinished and not self.trouble:
            reasons.append(f"max_seconds ended the run with {outcome.unfinished} left (run again to resume)")
        if reasons:
            text = f"{len(outcome.kept) + len(outcome.done)} of {outcome.total} scenes are done; {'; '.join(reasons)}."
            raise NotReachedError(text, result=outcome, full=self.full)
        return outcome
