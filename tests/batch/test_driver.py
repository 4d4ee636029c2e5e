"""What the driver does about dead workers, played by executors that die where they are made to."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future

import pytest

from nailoptics.batch import run
from nailoptics.batch.folder import Folder
from nailoptics.batch.jobs import Job, Settings, in_order
from nailoptics.batch.run import MOST_CRASHES, LocalSlots, Outcome
from nailoptics.errors import NotReachedError
from nailoptics.options import TraceOptions


class Dying(Executor):
    """Does jobs, and breaks at a scene where `kills(digest)`."""

    def __init__(self, kills: Callable[[str], bool]) -> None:
        self.kills = kills

    def submit(self, fn, /, job, settings):
        future = Future()
        if self.kills(job.digest):
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(("done", ""))
        return future


class Played(LocalSlots):
    """Executors of the test's own."""

    def __init__(self, kills: Callable[[str], bool]) -> None:
        self.executors = [Dying(kills)] * 3

    def renew(self, slot: int) -> None:
        pass

    def close(self, *, now: bool) -> None:
        pass


def driver_of(folder, lights: int, each: int) -> run._Driver:
    """The driver of so many scenes of each of some lights."""
    jobs = [Job(f"{k}-{i}", f"{k:064}", f"scene {k}-{i}") for k in range(lights) for i in range(each)]
    return run._Driver(Settings(folder, TraceOptions(backend="llvm", photons=1)), jobs, None)


@pytest.fixture
def played(tmp_path) -> Callable[..., Outcome]:
    """A run of 100 scenes of two lights whose workers die at scenes where `kills(digest)`."""
    (tmp_path / "failed").mkdir()

    def play(kills: Callable[[str], bool], lights: int = 2, each: int = 50) -> Outcome:
        driver = driver_of(tmp_path, lights, each)
        driver.run(Played(kills))
        try:
            outcome = driver.checked_outcome()
        except NotReachedError as error:
            outcome = error.result
        assert outcome.unfinished == 0 and len(outcome.done) + len(outcome.failed) == lights * each
        assert len(set(outcome.done)) == len(outcome.done) and not set(outcome.done) & set(outcome.failed)
        assert {path.stem for path in (tmp_path / "failed").iterdir()} == set(outcome.failed)
        return outcome

    return play


@pytest.mark.parametrize("which", ["1-0", "1-7", "1-49"])
def test_of_one_light_only_the_scene_that_kills_fails(played, which):
    outcome = played(lambda digest: digest == which)
    assert list(outcome.failed) == [which]
    assert outcome.deaths == MOST_CRASHES


def test_of_a_light_that_kills_every_worker_each_scene_fails_and_no_other(played):
    outcome = played(lambda digest: digest.startswith("1-"))
    assert sorted(outcome.failed) == sorted(f"1-{i}" for i in range(50))
    assert outcome.deaths == 50 * MOST_CRASHES


def test_a_kill_by_chance_costs_no_scene(played):
    tried = []

    def once(digest: str) -> bool:
        tried.append(digest)
        return len(tried) in (1, 4, 9, 20)

    assert not played(once).failed


def test_what_workers_had_done_as_the_scheduler_went_away_counts(tmp_path, monkeypatch):
    class Gone(Played):
        lost = (ConnectionError,)

        def submit(self, slot, job, settings):
            states["0-1"] = "done"
            raise ConnectionError

    driver, states = driver_of(tmp_path, lights=1, each=3), {}
    monkeypatch.setattr(Folder, "state", lambda folder, digest, *_: states.get(digest, "missing"))
    driver.run(Gone(lambda digest: False))
    with pytest.raises(NotReachedError, match="1 of 3 scenes are done; the scheduler went away"):
        driver.checked_outcome()


def test_while_a_light_is_traced_nobody_else_begins_with_it(tmp_path):
    driver = driver_of(tmp_path, lights=2, each=50)
    driver.queue = in_order(driver.left.values())
    first, other = driver.queue[:2]
    for slot, job in enumerate((first, other)):
        assert driver._next_job() == job and job.key == f"{slot:064}"
        driver.queue.remove(job)
        driver.running[Future()] = slot, job
    assert driver.queue and driver._next_job() is None
    driver.stored.add(other.key)
    following = driver._next_job()
    assert following and following.key == other.key
