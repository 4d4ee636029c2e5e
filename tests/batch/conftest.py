"""Small sweeps that batches are tested with."""

import os
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from nailoptics.batch import Sweep, load_sweep, run_batch
from nailoptics.batch.run import LocalSlots

PHANTOM = """
schema_version = 1
{top}
[base]
schema_version = 1
[base.phantom]
[[base.phantom.layers]]
name = "slab"
thickness_mm = 1.0
mu_a_per_mm = 0.1
mu_s_per_mm = 5.0
g = 0.8
n = 1.4
[[base.leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[base.photodiodes]]
name = "p"
aperture = true
position_mm = [1.0, 0.0]
[base.accuracy]
{accuracy}
"""


def phantoms(
    folder: Path,
    count: int,
    *,
    accuracy: str = "photons = 500",
    low: float = 0.5,
    high: float = 3.0,
    path: str = "phantom.layers.slab.thickness_mm",
) -> Sweep:
    """So many slabs of different thickness, each a light of its own."""
    file = folder / f"slabs{count}.toml"
    axis = f'[[axes]]\npath = "{path}"\nlinspace = [{low}, {high}, {count}]\n'
    file.write_text(PHANTOM.format(top="", accuracy=accuracy) + axis)
    return load_sweep(file)


@dataclass(frozen=True)
class Calm:
    """A sweep, its file, and the folder that one undisturbed worker makes of it, with all results byte by byte."""

    sweep: Sweep
    file: Path
    folder: Path
    bits: dict[str, bytes]


@pytest.fixture(scope="session")
def calm(chosen_jit, tmp_path_factory) -> Calm:
    """Thirty slabs, done once, by one worker, for all tests that disturb a run of them."""
    folder = tmp_path_factory.mktemp("calm")
    sweep = phantoms(folder, 30)
    run_batch(sweep, folder / "b", workers=1)
    return Calm(sweep, folder / "slabs30.toml", folder / "b", bits(folder / "b"))


class AtOnce(Executor):
    """Does what it is given at once, in this process."""

    def submit(self, do: Callable[..., Any], /, *arguments: Any, **more: Any) -> Future:
        future: Future = Future()
        future.set_result(do(*arguments, **more))
        return future


class Here(LocalSlots):
    """What a run without workers has in their place."""

    def __init__(self, workers: int) -> None:
        assert workers == 1
        self.executors = [AtOnce()]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of a batch start no worker: for tests of the outcome of the scenes, whatever process runs them."""
    monkeypatch.setattr("nailoptics.batch.run.LocalSlots", Here)


FAILING = PHANTOM.replace(
    'pattern = "pencil"', 'pattern = "measured"\npattern_deg = [0, 90]\npattern_relative = [1, 0]'
).format(top="", accuracy="photons = 500")
# A batch does not support volpath, so two of these four scenes fail.
FAILING += """
[[axes]]
path = "light.engine"
values = ["photons", "volpath"]
[[axes]]
path = "phantom.layers.slab.thickness_mm"
values = [1.0, 2.0]
"""

FINGERS = """
schema_version = 1
base = "prototype"
[[axes]]
path = "blood.so2"
values = [0.75, 0.97]
[[axes]]
path = "electronics.feedback_ohm"
values = [2e5, 4e5]
[[axes]]
path = "accuracy.photons"
values = [8000]
"""


@pytest.fixture
def fingers(tmp_path: Path) -> Sweep:
    """Four scenes of one finger that share their light."""
    (tmp_path / "fingers.toml").write_text(FINGERS)
    return load_sweep(tmp_path / "fingers.toml")


def bits(folder: Path) -> dict[str, bytes]:
    """All results of a batch folder, byte by byte."""
    return {path.name: path.read_bytes() for path in sorted((folder / "results").glob("*.dat"))}


def command_of(pid: int) -> bytes:
    """The command line of a process."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def kill_one(pid: int) -> None:
    """SIGKILL, if the process is still there."""
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def offspring(pid: int) -> list[int]:
    """Children of a process."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        return [int(p) for t in tasks for p in (t / "children").read_text().split()]
    except OSError:
        return []
