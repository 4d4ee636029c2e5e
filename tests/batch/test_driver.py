"""What the driver does about dead workers, played by executors that die when they are told to."""

import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future

import pytest

from nailoptics.batch.executors import Slots
from nailoptics.batch.run import DEATHS, FATAL, Outcome, _Driver
from nailoptics.batch.work import Job, JobReport, Settings
from nailoptics.options import TraceOptions


class Dying(Executor):
    """Reports every scene done, but breaks where `kills(job)`."""

    def __init__(self, kills: Callable[[Job], bool]) -> None:
        self.kills = kills

    def submit(self, fn, /, job, settings, sharers):
        future = Future()
        if self.kills(job):
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(JobReport(done=[digest for digest, _ in job.scenes]))
        return future


class Played(Slots):
    own_process = True

    def __init__(self, kills: Callable[[Job], bool]) -> None:
        self.executors = [Dying(kills)] * 3

    def start(self) -> None:
        pass

    def renew(self, slot: int) -> None:
        pass

    def close(self, *, now: bool) -> None:
        pass


def played(tmp_path, kills: Callable[[Job], bool], lights: int = 2, each: int = 50) -> Outcome:
    (tmp_path / "failed").mkdir()
    jobs = [Job(f"{k:064}", tuple((f"{k}-{i}", f"scene {k}-{i}") for i in range(each))) for k in range(lights)]
    outcome = Outcome(total=lights * each, lights=lights)
    _Driver(Settings(tmp_path, TraceOptions(backend="llvm")), jobs, outcome, time.time(), None).run(Played(kills))
    assert outcome.unfinished == 0 and len(outcome.done) + len(outcome.failed) == lights * each
    assert len(set(outcome.done)) == len(outcome.done) and not set(outcome.done) & set(outcome.failed)
    assert {path.stem for path in (tmp_path / "failed").iterdir()} == set(outcome.failed)
    return outcome


@pytest.mark.parametrize("which", ["1-0", "1-7", "1-49"])
def test_of_many_scenes_with_one_light_only_the_one_that_kills_fails(tmp_path, which):
    outcome = played(tmp_path, lambda job: which in dict(job.scenes) or f"scene {which}" in job.also)
    assert list(outcome.failed) == [which]
    assert outcome.deaths <= 2 + DEATHS


def test_a_light_that_kills_every_worker_costs_few_of_them(tmp_path):
    outcome = played(tmp_path, lambda job: int(job.key) == 1)
    assert sorted(outcome.failed) == sorted(f"1-{i}" for i in range(50))
    assert outcome.deaths == 1 + DEATHS * FATAL


def test_a_kill_by_chance_costs_no_scene(tmp_path):
    killed = []

    def once(job: Job) -> bool:
        killed.append(job)
        return len(killed) in (1, 4, 5, 9)

    assert not played(tmp_path, once).failed
