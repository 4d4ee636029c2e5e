"""A real Dask scheduler with real worker processes on loopback: the same bits, and nothing lost when they go."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nailoptics.batch import run_batch
from nailoptics.errors import InputError, NotReachedError

from .conftest import bits, phantoms

distributed = pytest.importorskip("distributed")
pytestmark = [pytest.mark.jit, pytest.mark.filterwarnings("ignore::ResourceWarning")]


class Cluster:
    """A scheduler and two workers, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        file = folder / "scheduler.json"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder, "start_new_session": True}
        python = [sys.executable, "-m"]
        common = ["--scheduler-file", str(file), "--host", "127.0.0.1", "--no-dashboard"]
        self.scheduler = subprocess.Popen([*python, "distributed.cli.dask_scheduler", *common, "--port", "0"], **quiet)
        worker = [*python, "distributed.cli.dask_worker", *common, "--nthreads", "1", "--local-directory", str(folder)]
        self.workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
        deadline = time.time() + 60
        while not file.exists() and time.time() < deadline:
            time.sleep(0.1)
        import json

        self.address: str = json.loads(file.read_text())["address"]
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


def test_a_cluster_gives_the_same_bits_and_when_it_goes_the_rest_is_done_elsewhere(jit_backend, cluster, tmp_path):
    sweep = phantoms(tmp_path, 30)
    run_batch(sweep, tmp_path / "local", workers=1)
    outcome = run_batch(sweep, tmp_path / "cluster", scheduler=cluster.address)
    assert len(outcome.done) == 30
    assert bits(tmp_path / "cluster") == bits(tmp_path / "local")

    def gone(p) -> None:
        if p.done >= 8 and cluster.scheduler.poll() is None:
            os.killpg(cluster.scheduler.pid, signal.SIGKILL)
            cluster.scheduler.wait()

    with pytest.raises(NotReachedError, match="scheduler went away"):
        run_batch(sweep, tmp_path / "lost", scheduler=cluster.address, progress=gone)
    there = len(bits(tmp_path / "lost"))
    assert 8 <= there < 30
    outcome = run_batch(sweep, tmp_path / "lost", workers=1)
    assert len(outcome.kept) >= there
    assert bits(tmp_path / "lost") == bits(tmp_path / "local")


@pytest.mark.slow
def test_a_scheduler_that_is_not_there_is_told(tmp_path, jit_backend, monkeypatch):
    with pytest.raises(InputError, match="cannot be reached"):
        run_batch(phantoms(tmp_path, 2), tmp_path / "b", scheduler="tcp://127.0.0.1:9")
