"""A real Dask scheduler with real worker processes on loopback: the same bits, and nothing lost when they go."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nailoptics.batch import BatchProgress, Sweep, run_batch
from nailoptics.batch.jobs import cores
from nailoptics.errors import InputError, NotReachedError
from nailoptics.scene import Accuracy

from .conftest import Calm, bits, command_of, kill_one, offspring, phantoms

distributed = pytest.importorskip("distributed")
pytestmark = [pytest.mark.jit, pytest.mark.filterwarnings("ignore::ResourceWarning")]


class Cluster:
    """A scheduler and two workers; with nannies these are parents of who works, and replace it when it dies."""

    def __init__(self, folder: Path, *, nannies: bool = False) -> None:
        self.folder, self.file, self.nanny = folder, folder / "scheduler.json", "--nanny" if nannies else "--no-nanny"
        # A job is given up with the first worker that it kills, not with the fourth.
        impatient = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
        self.scheduler = self._start("dask_scheduler", "--no-dashboard", "--port", "0", env=os.environ | impatient)
        self.workers = [self.add_worker(), self.add_worker()]
        deadline = time.time() + 60
        while not self.file.exists() and time.time() < deadline:
            time.sleep(0.1)
        self.address: str = json.loads(self.file.read_text())["address"]
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)

    def _start(self, what: str, *options: str, **more) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{what}", "--scheduler-file", str(self.file)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": self.folder}
        return subprocess.Popen([*command, "--host", "127.0.0.1", *options], start_new_session=True, **quiet, **more)

    def add_worker(self) -> subprocess.Popen:
        options = ("--no-dashboard", "--nthreads", "1", "--local-directory", str(self.folder))
        return self._start("dask_worker", self.nanny, *options)

    def nursed(self) -> list[int]:
        """The processes that work under nannies."""
        computed = [child for nanny in self.workers for child in offspring(nanny.pid)]
        return [pid for pid in computed if b"spawn_main" in command_of(pid)]

    def end(self, process: subprocess.Popen) -> None:
        """Kill a process of this cluster with all its children."""
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        process.wait()

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            self.end(process)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


@pytest.fixture
def cluster_with_nannies(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path, nannies=True)
    yield cluster
    cluster.close()


def once(at: int, act) -> tuple[list[str], object]:
    """A progress callback that acts when so many scenes are done, and the news that it got."""
    news, left = [], [act]

    def progress(p: BatchProgress) -> None:
        if p.news:
            news.append(p.news)
        if p.done >= at and left:
            left.pop()()

    return news, progress


def done_with(cluster: Cluster, calm: Calm, folder: Path, progress) -> None:
    """Run the calm sweep on a cluster, which must give the calm bits."""
    outcome = run_batch(calm.sweep, folder, scheduler=cluster.address, progress=progress)
    assert len(outcome.done) == 30 and bits(folder) == calm.bits


@pytest.mark.long
def test_a_cluster_gives_the_same_bits_and_loses_nothing(calm, cluster, tmp_path):
    # A worker is killed.
    _, progress = once(8, lambda: cluster.end(cluster.workers[0]))
    done_with(cluster, calm, tmp_path / "workers", progress)
    with distributed.Client(cluster.address, set_as_default=False) as client:
        [threads] = client.run(eval, "__import__('drjit').thread_count()").values()
    assert threads == max(1, cores() // 2)  # the cores of this machine, for each of two workers

    # The scheduler goes.
    _, progress = once(8, lambda: cluster.end(cluster.scheduler))
    with pytest.raises(NotReachedError, match="scheduler went away") as caught:
        run_batch(calm.sweep, tmp_path / "lost", scheduler=cluster.address, progress=progress)
    there = len(bits(tmp_path / "lost"))
    # What was done without a report of it coming back counts; four jobs, each of one scene, were out at that moment.
    assert 8 <= there < 30 and there - 4 <= len(caught.value.result.done) <= there
    outcome = run_batch(calm.sweep, tmp_path / "lost", workers=1)
    assert len(outcome.kept) >= there and bits(tmp_path / "lost") == calm.bits


@pytest.mark.slow
def test_a_run_without_workers_continues_with_new_ones(calm, cluster, tmp_path):
    def replace_all() -> None:
        for worker in cluster.workers:
            cluster.end(worker)
        cluster.workers.append(cluster.add_worker())

    _, progress = once(8, replace_all)
    done_with(cluster, calm, tmp_path / "b", progress)


@pytest.mark.slow
def test_max_seconds_ends_a_run_that_has_lost_all_workers(calm, cluster, tmp_path):
    _, progress = once(0, lambda: [cluster.end(worker) for worker in cluster.workers])
    with pytest.raises(NotReachedError, match="max_seconds ended the run") as caught:
        run_batch(calm.sweep, tmp_path / "b", scheduler=cluster.address, max_seconds=5, progress=progress)
    assert 0 < caught.value.result.unfinished <= 30


@pytest.mark.slow
def test_a_scene_that_kills_every_worker_of_a_cluster_fails_alone(jit_backend, cluster_with_nannies, tmp_path):
    cluster = cluster_with_nannies
    sweep = phantoms(tmp_path, 5)
    endless = sweep.scenes[0].model_copy(update={"accuracy": Accuracy(photons=10_000_000_000)})
    sweep = Sweep(sweep.name, sweep.axes, sweep.dims, (endless, *sweep.scenes[1:]))
    killed = [time.time()]

    def kill(p: BatchProgress) -> None:
        """The others take milliseconds: any worker still busy works on the endless one."""
        if p.done == 4 and time.time() - killed[-1] > 5:
            killed.append(time.time())
            for pid in cluster.nursed():
                kill_one(pid)

    with pytest.raises(NotReachedError, match="its worker was killed") as caught:
        run_batch(sweep, tmp_path / "b", scheduler=cluster.address, progress=kill)
    outcome = caught.value.result
    assert len(outcome.done) == 4 and len(outcome.failed) == 1 and 2 <= len(killed) <= 4


@pytest.mark.slow
def test_a_scheduler_that_cannot_be_reached_is_an_error(tmp_path, jit_backend, monkeypatch):
    with pytest.raises(InputError, match="cannot be reached"):
        run_batch(phantoms(tmp_path, 2), tmp_path / "b", scheduler="tcp://127.0.0.1:9")
