"""The driver of a batch: hands out jobs, takes reports, replaces dead workers, stops when all that can be is done."""

import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

from ..errors import InputError, NotReachedError, WriteError
from ..options import Requested, TraceOptions
from ..scene.sweep import Sweep
from . import plan as plans
from .executors import ClusterSlots, LocalSlots, Slots, single_threaded_blas
from .folder import Folder
from .work import GONE, TAKES_NO_MORE, Job, JobReport, Settings, cores, standing, work

log = logging.getLogger(__name__)

# A scene whose worker dies so often is recorded as failed, and after so many of one light all the others of it.
DEATHS = 2
FATAL = 3
# What somebody else works on is asked for again after this time.
_BUSY_WAIT_S = 0.5


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
    """Do what is left of a sweep in a folder; what is there already is kept, or continued if it is not good enough.

    workers : processes on this machine; one per core (on CUDA: one) if not given.
    threads : threads of each; the cores divided among the workers if not given.
    scheduler : address of a Dask scheduler in place of local workers; its workers must see the folder.
    shard : I/N, to do the I-th of N parts.
    retry_failed : try scenes again that failed before.
    max_seconds : wall time after which the run stops; what was traced stays, and the next run goes on from there.

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
    place, part = Folder(settings.folder), plans.parse_shard(shard)
    planned = plans.plan(sweep, settings)
    damage = plans.check_same(place, planned, settings)
    place.make()
    place.write_plan(plans.as_json(sweep, planned, settings))
    mine = plans.of_shard(planned, part)
    todo = plans.left(mine, place, settings, retry_failed=retry_failed)
    failed = {digest: place.why_failed(digest) for digest in todo.failed}
    total, lights = len({p.digest for p in mine}), len({p.key for p in mine})
    outcome = Outcome(total, lights, kept=todo.kept, failed=failed, corrupt=todo.corrupt + todo.foreign)
    driver = _Driver(settings, todo.jobs, outcome, begin, progress)
    if damage:
        driver.show(f"plan.json was damaged and is written anew: {damage}")
    for digest in todo.corrupt:
        driver.show(f"result {digest[:12]} is damaged (checksum, name or content); made again")
    for digest in todo.foreign:
        driver.show(f"result {digest[:12]} is another seed's, backend's or version's; made again")
    if todo.jobs:
        with single_threaded_blas():
            workers = workers or (1 if settings.options.backend == "cuda" else cores())
            threads = threads or max(1, cores() // workers)
            driver.run(ClusterSlots(scheduler) if scheduler is not None else LocalSlots(workers, threads))
        if driver.trouble and not place.gone():
            _recount(outcome, driver.left, mine, place, settings)
        elif place.gone():
            outcome.done, outcome.kept = [], []
            driver.trouble = GONE
    outcome.seconds = time.time() - begin
    return _judged(outcome, driver.trouble)


def _recount(outcome: Outcome, left: set[str], planned: list[plans.Planned], place: Folder, settings: Settings) -> None:
    """Count what workers did whose reports did not come any more."""
    for p in planned:
        if p.digest in left and standing(place, p.digest, settings.required(p.scene), settings.made()) == "done":
            left.discard(p.digest)
            outcome.done.append(p.digest)
    outcome.unfinished = len(left)


def _judged(outcome: Outcome, trouble: str) -> Outcome:
    """The outcome, or NotReachedError with it as result where anything is missing."""
    reasons = [trouble] if trouble else []
    if outcome.failed:
        first = next(iter(outcome.failed.values()))
        reasons.append(
            f"{len(outcome.failed)} failed (the first: {first.rstrip('.')}; --retry-failed tries them again)"
        )
    if outcome.unmet:
        reasons.append(f"{len(outcome.unmet)} missed their relative error in their time (run again to continue them)")
    if outcome.unfinished and not trouble:
        reasons.append(f"max_seconds ended the run with {outcome.unfinished} left (run again to go on)")
    if reasons:
        good = len(outcome.kept) + len(outcome.done)
        text = f"{good} of {outcome.total} scenes are done; {'; '.join(reasons)}."
        raise NotReachedError(text, result=outcome, full=trouble.startswith(TAKES_NO_MORE))
    return outcome


@dataclass
class _Driver:
    """The loop of one run."""

    settings: Settings
    jobs: list[Job]
    outcome: Outcome
    begin: float
    progress: Callable[[BatchProgress], None] | None

    def __post_init__(self) -> None:
        self.queue = deque(plans.first_of(job) for job in self.jobs)
        self.later = {job.key: plans.rest_of(job) for job in self.jobs}
        self.running: dict[Future[JobReport], tuple[int, Job]] = {}
        self.asleep: deque[tuple[float, Job]] = deque()
        # Deaths by scene; and by light, scenes given up since one of it was reported.
        self.deaths: Counter[str] = Counter()
        self.fatal: Counter[str] = Counter()
        self.left = {digest for job in self.jobs for digest, _ in job.scenes}
        self.started = self.begin
        self.reported, self.trouble, self.deserted = 0, "", False

    def run(self, slots: Slots) -> None:
        """Hand out jobs until none is left, the time is over, or nothing more can be written."""
        free = deque(range(len(slots.executors)))
        orderly = False
        try:
            slots.start()
            self.started = time.time()
            while self.queue or self.running or self.asleep:
                now = time.time()
                if self.settings.is_late() or self.trouble:
                    self.queue.clear()
                    self.asleep.clear()
                while self.asleep and self.asleep[0][0] <= now:
                    self.queue.append(self.asleep.popleft()[1])
                while free and self.queue:
                    slot = free.popleft()
                    job = self.queue.popleft()
                    try:
                        self.running[slots.executors[slot].submit(work, job, self.settings, slots.sharers)] = slot, job
                    except BrokenExecutor:  # it died while idle
                        slots.renew(slot)
                        self.queue.appendleft(job)
                        free.append(slot)
                    except Exception as error:  # a scheduler that went away
                        self._lost(error)
                        break
                if not self.running:
                    time.sleep(0.05 if self.asleep else 0)
                    continue
                finished, _ = wait(self.running, timeout=_BUSY_WAIT_S, return_when=FIRST_COMPLETED)
                if not finished:
                    self._look_for_workers(slots)
                for future in finished:
                    slot, job = self.running.pop(future)
                    free.append(slot)
                    self._book(future, slot, job, slots)
                if self.trouble.startswith("the scheduler"):
                    self.running.clear()
                self.show()
            orderly = True
        except KeyboardInterrupt:
            self.trouble = "interrupted; what is done is kept, run again to go on"
        finally:
            self.outcome.unfinished = len(self.left)
            slots.close(now=not orderly)

    def _book(self, future: "Future[JobReport]", slot: int, job: Job, slots: Slots) -> None:
        """Book a job's report, or its worker's death."""
        try:
            report = future.result()
        except BrokenExecutor:
            slots.renew(slot)
            self._died(job)
            return
        except (CancelledError, Exception) as error:
            if type(error).__name__ == "KilledWorker":  # of the cluster, and maybe for another job of that worker
                self._died(job)
            elif isinstance(error, CancelledError | OSError | TimeoutError) and not slots.own_process:
                self._lost(error)
            else:
                raise
            return
        if report.busy:
            self.asleep.append((time.time() + _BUSY_WAIT_S, job))
            return
        if report.storage:
            self.trouble = report.storage
            return
        self.reported += len(report.done) + len(report.unmet) + len(report.failed)
        self.outcome.done += report.done
        self.outcome.unmet += report.unmet
        self.outcome.failed |= report.failed
        self.outcome.corrupt += report.corrupt
        self.left -= {*report.done, *report.unmet, *report.failed}
        for name in report.corrupt:
            self.show(f"light {name[:12]} is damaged or another's (checksum, name); traced again")
        for digest, why in report.failed.items():
            self.show(f"scene {digest[:12]} failed: {why}")
        # The others can read the light now.
        self.fatal.pop(job.key, None)
        self.queue.extendleft(reversed(self.later.pop(job.key, [])))

    def _look_for_workers(self, slots: Slots) -> None:
        """Say once that nobody is left to work; nothing comes from them in time."""
        deserted = slots.deserted()
        if deserted and not self.deserted:
            self.show("the cluster has no workers any more; waiting for new ones (Ctrl-C keeps what is done)")
        self.deserted = deserted
        if deserted and self.settings.is_late():
            self.running.clear()

    def _died(self, job: Job) -> None:
        """After a worker's death: the scenes of its light wait until one of them alone has come through.

        A scene that kills again is given up, and so is a light that killed with several of its scenes.
        """
        self.outcome.deaths += 1
        alone = len(job.scenes) == 1 and not job.also
        others = [*job.scenes[1:], *(s for part in self.later.pop(job.key, []) for s in part.scenes)]
        digest = job.scenes[0][0]
        self.deaths[digest] += alone
        if self.deaths[digest] < DEATHS:
            self.queue.append(Job(job.key, job.scenes[:1]))
            self.show(
                f"a worker was killed; scene {digest[:12]} is tried again"
                + ("" if alone else ", and those with it one by one")
            )
        else:
            self._give_up([digest], f"its worker was killed {self.deaths[digest]} times; out of memory?")
            self.fatal[job.key] += 1
            if self.fatal[job.key] >= FATAL and others:
                why = f"{FATAL} scenes with its light had their workers killed; out of memory?"
                self._give_up([digest for digest, _ in others], why)
                return
            if others:
                self.queue.append(Job(job.key, (others.pop(0),)))
        if others:
            self.later[job.key] = [Job(job.key, (scene,)) for scene in others]

    def _give_up(self, digests: list[str], why: str) -> None:
        """Record scenes as failed."""
        for digest in digests:
            try:
                Folder(self.settings.folder).write_failure(digest, {"error": why, "time": time.time()})
            except WriteError as error:
                self.trouble = f"{TAKES_NO_MORE}: {str(error).rstrip('.')}"
                return
            self.outcome.failed[digest] = why
            self.left.discard(digest)
            self.show(f"scene {digest[:12]} failed: {why}")

    def _lost(self, error: BaseException) -> None:
        log.debug("scheduler lost: %r", error)
        self.trouble = "the scheduler went away; what is done is kept, run again to go on"

    def show(self, news: str = "") -> None:
        """Show how far the run is, and what just happened."""
        if self.progress is None:
            return
        now, seconds_left = time.time(), None
        if self.reported:
            seconds_left = (now - self.started) / self.reported * len(self.left)
        done = self.outcome.total - len(self.left) - len(self.outcome.failed)
        self.progress(
            BatchProgress(done, self.outcome.total, len(self.outcome.failed), now - self.begin, seconds_left, news)
        )
