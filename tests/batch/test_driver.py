"""What the driver does about dead workers, played by executors that die when they are told to."""

import math
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future

import pytest

from nailoptics.batch import run
from nailoptics.batch.jobs import CHUNK, Job, Planned, Settings
from nailoptics.batch.run import DEATHS, FATAL, LocalSlots, Outcome
from nailoptics.batch.work import JobReport
from nailoptics.errors import NotReachedError
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


class Played(LocalSlots):
    """Executors of the test's own."""

    def __init__(self, kills: Callable[[Job], bool]) -> None:
        self.executors = [Dying(kills)] * 3

    def start(self) -> None:
        pass

    def renew(self, slot: int) -> None:
        pass

    def close(self, *, now: bool) -> None:
        pass


@pytest.fixture
def played(tmp_path, monkeypatch) -> Callable[..., Outcome]:
    """A run of 100 scenes of two lights whose workers die where `kills(job)`."""
    monkeypatch.setattr(run.Folder, "standing", lambda *_: "missing")
    monkeypatch.setattr(run.Folder, "gone", lambda _: False)
    monkeypatch.setattr(run.Settings, "required", lambda *_: None)
    (tmp_path / "failed").mkdir()

    def play(kills: Callable[[Job], bool], lights: int = 2, each: int = 50) -> Outcome:
        planned = [Planned(f"{k}-{i}", f"{k:064}", f"scene {k}-{i}") for k in range(lights) for i in range(each)]
        driver = run._Driver(Settings(tmp_path, TraceOptions(backend="llvm")), planned, False, None, time.time())
        driver.run(Played(kills))
        try:
            outcome = driver.judged()
        except NotReachedError as error:
            outcome = error.result
        assert outcome.unfinished == 0 and len(outcome.done) + len(outcome.failed) == lights * each
        assert len(set(outcome.done)) == len(outcome.done) and not set(outcome.done) & set(outcome.failed)
        assert {path.stem for path in (tmp_path / "failed").iterdir()} == set(outcome.failed)
        return outcome

    return play


@pytest.mark.parametrize("which", ["1-0", "1-7", "1-49"])
def test_of_many_scenes_with_one_light_only_the_one_that_kills_fails(played, which):
    outcome = played(lambda job: which in dict(job.scenes))
    assert list(outcome.failed) == [which]
    assert outcome.deaths <= 2 + DEATHS


def test_a_light_that_kills_every_worker_costs_few_of_them(played):
    outcome = played(lambda job: int(job.key) == 1)
    assert sorted(outcome.failed) == sorted(f"1-{i}" for i in range(50))
    assert outcome.deaths <= math.ceil(50 / CHUNK) + DEATHS * FATAL + 3  # three work at once


def test_a_kill_by_chance_costs_no_scene(played):
    killed = []

    def once(job: Job) -> bool:
        killed.append(job)
        return len(killed) in (1, 4, 5, 9)

    assert not played(once).failed
