"""The driver of a batch: plans jobs, hands them to workers here or on a cluster, and replaces workers that die."""

import contextlib
import logging
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent import futures
from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

from ..errors import InputError, NailopticsError, NotReachedError, WriteError
from ..io import let_dask_in
from ..local_worker import prepare
from ..options import Requested, TraceOptions
from ..scene.sweep import Sweep
from .folder import DAMAGE, Folder
from .jobs import Job, JobReport, Planned, Settings, check_same, cores, jobs_of, of_shard, plan, plan_of, work

log = logging.getLogger(__name__)

# A scene whose worker dies so often is recorded as failed.
DEATHS = 2
# How a run ends whose folder lies on a full disk, or is no longer there, or whose cluster is lost.
TAKES_NO_MORE = "the folder takes no more"
SCHEDULER_LOST = "the scheduler went away; what is done is kept, run again to resume"
# How often the driver looks at the clock. [s]
WAIT_S = 0.5
# Read by NumPy's BLAS when a worker imports it; one thread each, so that sums are the same on every machine.
_SINGLE = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


@dataclass(kw_only=True)
class Outcome(JobReport):
    """What a run did: digests by what became of them; kept were there before, corrupt are files made again."""

    total: int
    lights: int
    kept: list[str] = field(default_factory=list)
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
    """The fields of `BatchOptions` as keyword arguments."""

    workers: int | None
    threads: int | None
    scheduler: str | None


@dataclass(frozen=True, kw_only=True)
class BatchOptions(TraceOptions):
    """How light is traced, and by whom; max_seconds is the wall time after which the run stops.

    What was traced stays, and the next run resumes from there. Raises InputError for values that none can have.
    """

    workers: int | None = None
    """Processes on this machine; one per core (on CUDA: one) if not given."""
    threads: int | None = None
    """Threads of each; the cores divided among the workers if not given."""
    scheduler: str | None = None
    """Address of a Dask scheduler in place of local workers; its workers must see the folder."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in (("workers", self.workers), ("threads", self.threads)):
            if value is not None and not value > 0:
                raise InputError(f"{name} = {value}; must be above 0.")
        if self.workers is not None and self.scheduler is not None:
            raise InputError("workers and scheduler exclude each other; a scheduler has its own workers.")

    def slots(self, backend: str) -> "LocalSlots":
        """Who does the jobs on a backend."""
        if self.scheduler is not None:
            return ClusterSlots(self.scheduler)
        workers = self.workers or (1 if backend in ("cuda", "metal") else cores())
        return LocalSlots(workers, self.threads or max(1, cores() // workers))


def run_batch(
    sweep: Sweep,
    folder: str | Path,
    *,
    shard: str | None = None,
    retry_failed: bool = False,
    progress: Callable[[BatchProgress], None] | None = None,
    **requested: Unpack[BatchRequested],
) -> Outcome:
    """Run the remaining scenes of a sweep in a folder; what is there is kept, or continued if it is not good enough.

    shard : I/N, to run the I-th of N parts.
    retry_failed : retry scenes that failed before.
    requested : fields of `BatchOptions`.

    Raises: InputError; NotReachedError, whose result is the Outcome, where scenes failed, missed their tolerance or
    were not reached.
    """
    begin = time.time()
    options = BatchOptions(**requested)
    settings = Settings.of(Path(folder), options, sweep.study)
    place, planned = Folder(settings.folder), plan(sweep, settings)
    mine = of_shard(planned, shard)
    damage = check_same(place, planned, settings)
    place.make()
    place.write_plan(plan_of(sweep, planned, settings))
    driver = _Driver(settings, mine, retry_failed, progress, begin)
    if damage:
        driver.show(f"plan.json was damaged and is written anew: {damage}")
    if driver.queue:
        driver.run(options.slots(settings.options.backend))
    return driver.checked_outcome()


class LocalSlots:
    """Spawned processes of this machine, one per slot, so that a death identifies its job."""

    sharers = 0

    def __init__(self, workers: int, threads: int) -> None:
        self.threads = threads
        os.environ.update(dict.fromkeys(_SINGLE, "1"))
        # Mitsuba and forking do not mix.
        self.context = multiprocessing.get_context("spawn")
        self.executors: list[futures.Executor] = [self._new() for _ in range(workers)]

    def _new(self) -> futures.Executor:
        return futures.ProcessPoolExecutor(1, mp_context=self.context, initializer=prepare, initargs=(self.threads,))

    def start(self) -> None:
        """Wait until all are ready."""
        try:
            for ready in [executor.submit(os.getpid) for executor in self.executors]:
                ready.result()
        except futures.BrokenExecutor:
            why = "in a script, run batches under if __name__ == '__main__': only"
            raise NailopticsError(f"the worker processes die as they start; {why}.") from None

    def renew(self, slot: int) -> None:
        """Replace a slot whose worker died."""
        self.executors[slot].shutdown(wait=False, cancel_futures=True)
        self.executors[slot] = self._new()

    def deserted(self) -> bool:
        """Whether nobody is left to work, though others may come."""
        return False

    def close(self, *, now: bool) -> None:
        """Let the workers go; at once, with whatever they do, or when they are done."""
        if now:
            for executor in self.executors:
                for process in (getattr(executor, "_processes", None) or {}).values():
                    process.terminate()
        for executor in self.executors:
            executor.shutdown(wait=True, cancel_futures=True)


class ClusterSlots(LocalSlots):
    """The workers of a Dask scheduler, which replaces those that die."""

    def __init__(self, address: str) -> None:
        let_dask_in()
        try:
            from distributed import Client
        except ImportError:
            raise InputError("a scheduler needs Dask: pip install 'nailoptics[cluster]'.") from None
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

    def start(self) -> None:
        """They are there."""

    def renew(self, slot: int) -> None:
        """The scheduler does."""

    def deserted(self) -> bool:
        """Whether the cluster has lost all its workers."""
        with contextlib.suppress(Exception):  # the scheduler went away, which its futures report
            return not self.client.nthreads()
        return False

    def close(self, *, now: bool) -> None:
        """Leave the cluster."""
        self.client.close(timeout=5)


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
        self.folder, self.made = Folder(settings.folder), settings.made()
        # Scenes that no report or result of this run has ended yet.
        self.left = {p.digest: p for p in planned}
        self.outcome = Outcome(total=len(self.left), lights=len({p.key for p in planned}))
        self.running: dict[futures.Future[JobReport], tuple[int, Job]] = {}
        # Lights of which a job has ended, so that others read what it stored.
        self.stored: set[str] = set()
        self.deaths: Counter[str] = Counter()
        self.trouble = ""
        for p in [*self.left.values()]:
            self._check(p, retry_failed)
        self.queue = jobs_of(self.left.values())
        self.started = time.time()

    def _settle(self, p: Planned, done: list[str]) -> str:
        """The state of a scene as the folder has it; one that is done goes to a list and is no longer left."""
        state = self.folder.state(p.digest, self.settings.required(p.scene), self.made)
        if state == "done":
            done.append(p.digest)
        elif state == "failed":
            self.outcome.failed[p.digest] = self.folder.why_failed(p.digest)
        if state in ("done", "failed"):
            del self.left[p.digest]
        return state

    def _check(self, p: Planned, retry_failed: bool) -> None:
        """Take a scene out of those that are left if it was done before, or failed and is not to be retried."""
        if retry_failed:
            self.folder.failure(p.digest).unlink(missing_ok=True)
        if (state := self._settle(p, self.outcome.kept)) in DAMAGE:
            self.outcome.corrupt.append(p.digest)
            self.show(f"result {p.digest[:12]} is {DAMAGE[state]}; made again")

    def run(self, slots: LocalSlots) -> None:
        """Hand out jobs until none is left, the time is over, or nothing more can be written."""
        free, finished = [*range(len(slots.executors))], False
        try:
            slots.start()
            while self.queue or self.running:
                if self.settings.is_late() or self.trouble:
                    self.queue.clear()
                while free and (job := self._next_job()):
                    self._submit(job, slots, free)
                for future in futures.wait(self.running, WAIT_S, futures.FIRST_COMPLETED).done:
                    slot, job = self.running.pop(future)
                    free.append(slot)
                    try:
                        self._book(future, slot, job, slots)
                    except WriteError as error:
                        self.trouble = f"{TAKES_NO_MORE}: {str(error).rstrip('.')}"
                if self.trouble == SCHEDULER_LOST or (self.settings.is_late() and slots.deserted()):
                    break
                self.show()
            finished = True
        except KeyboardInterrupt:
            self.trouble = "interrupted; what is done is kept, run again to resume"
        finally:
            slots.close(now=not finished)

    def _next_job(self) -> Job | None:
        """The first job in the queue whose light nobody is tracing at this moment."""
        traced = {job[0].key for _, job in self.running.values()} - self.stored
        return next((job for job in self.queue if job[0].key not in traced), None)

    def _submit(self, job: Job, slots: LocalSlots, free: list[int]) -> None:
        slot = free.pop(0)
        try:
            self.running[slots.executors[slot].submit(work, job, self.settings, slots.sharers)] = slot, job
            self.queue.remove(job)
        except futures.BrokenExecutor:  # it died while idle
            slots.renew(slot)
            free.append(slot)
        except Exception as error:  # a scheduler that went away
            self._lost(error)

    def _book(self, future: "futures.Future[JobReport]", slot: int, job: Job, slots: LocalSlots) -> None:
        """Book a job's report, or its worker's death."""
        try:
            report = future.result()
        except futures.BrokenExecutor:
            slots.renew(slot)
            return self._died(job)
        except WriteError:
            raise
        except (futures.CancelledError, Exception) as error:
            if type(error).__name__ == "KilledWorker":  # of the cluster, and maybe for another job of that worker
                return self._died(job)
            if isinstance(slots, ClusterSlots) and isinstance(error, futures.CancelledError | OSError | TimeoutError):
                return self._lost(error)
            raise
        self.stored.add(job[0].key)
        self.outcome.done += report.done
        self.outcome.unmet += report.unmet
        self.outcome.corrupt += report.corrupt
        for name in report.corrupt:
            self.show(f"light {name[:12]} is damaged or another's (checksum, name); traced again")
        for digest, why in report.failed.items():
            self._failed(digest, why)
        for digest in (*report.done, *report.unmet):
            self.left.pop(digest, None)

    def _failed(self, digest: str, why: str) -> None:
        self.outcome.failed[digest] = why
        self.left.pop(digest, None)
        self.show(f"scene {digest[:12]} failed: {why}")

    def _died(self, job: Job) -> None:
        """A worker died at the first scene of a job that has no result: it is tried again, and given up the next time.

        The scenes after it go on without it.
        """
        self.outcome.deaths += 1
        # Of some a result is there, though no report came.
        left = [p for p in job if p.digest in self.left]
        rest = [p for p in left if self._settle(p, self.outcome.done) not in ("done", "failed")]
        if rest:
            first = rest[0].digest
            self.deaths[first] += 1
            if self.deaths[first] < DEATHS:
                self.show(f"a worker was killed; scene {first[:12]} is tried again")
            else:
                rest, why = rest[1:], f"its worker was killed {DEATHS} times; out of memory?"
                self.folder.write_failure(first, {"error": why, "time": time.time()})
                self._failed(first, why)
        if rest:
            self.queue.insert(0, tuple(rest))

    def _lost(self, error: BaseException) -> None:
        log.debug("scheduler lost: %r", error)
        self.trouble = SCHEDULER_LOST

    def show(self, news: str = "") -> None:
        """Show how far the run is, and what just happened."""
        if self.progress is None:
            return
        now, outcome = time.time(), self.outcome
        reported = len(outcome.done) + len(outcome.unmet)
        seconds_left = (now - self.started) / reported * len(self.left) if reported else None
        done = outcome.total - len(self.left) - len(outcome.failed)
        self.progress(BatchProgress(done, outcome.total, len(outcome.failed), now - self.begin, seconds_left, news))

    def checked_outcome(self) -> Outcome:
        """The outcome, or NotReachedError with it as result where anything is missing."""
        outcome, trouble = self.outcome, self.trouble
        if trouble:
            for p in [*self.left.values()]:
                self._settle(p, outcome.done)
        outcome.unfinished, outcome.seconds = len(self.left), time.time() - self.begin
        reasons = [trouble] if trouble else []
        if outcome.failed:
            first = next(iter(outcome.failed.values())).rstrip(".")
            reasons.append(f"{len(outcome.failed)} failed (the first: {first}; retry_failed tries them again)")
        if outcome.unmet:
            reasons.append(f"{len(outcome.unmet)} missed their relative error in their time (run again to continue)")
        if outcome.unfinished and not trouble:
            reasons.append(f"max_seconds ended the run with {outcome.unfinished} left (run again to resume)")
        if reasons:
            good = len(outcome.kept) + len(outcome.done)
            text = f"{good} of {outcome.total} scenes are done; {'; '.join(reasons)}."
            raise NotReachedError(text, result=outcome, full=trouble.startswith(TAKES_NO_MORE))
        return outcome
