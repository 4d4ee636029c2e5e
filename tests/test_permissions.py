"""What a user may not read or write: one line, nothing lost, and light is traced where its store is closed."""

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from test_io import PHANTOM

ROOT = Path(__file__).parents[1]
# Of Linux: what lets root read and write what modes forbid, and the call that gives it up.
DAC, DROP = (1, 2), 24
RUN = """
import contextlib, io, os, sys
from nailoptics.cli import run
for line in sys.stdin:
    folder, store, *arguments = line.split()
    os.chdir(folder)
    os.environ["NAILOPTICS_STORE"] = store
    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
        code = run([*arguments])
    print(code, errors.getvalue().replace(chr(10), " | "), flush=True)
"""
SWEEP = """
schema_version = 1
base = "slab.toml"
[[axes]]
path = "phantom.layers.slab.thickness_mm"
values = [0.5, 1.0, 1.5]
"""


def as_ordinary_user() -> None:
    """Let modes hold for root, too, who runs tests in containers; for others they do."""
    libc = ctypes.CDLL(None)
    for capability in DAC:
        libc.prctl(DROP, capability, 0, 0, 0)


Commands = Callable[..., list[tuple[int, str]]]


@pytest.fixture(scope="module")
def commands() -> Iterator[Commands]:
    """Runs commands in a folder, each after its store, in one process of a user whom modes hold: their codes and
    messages."""
    process = subprocess.Popen(
        [sys.executable, "-c", RUN],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=as_ordinary_user,
    )
    assert process.stdin and process.stdout

    def run(folder: Path, *lines: str) -> list[tuple[int, str]]:
        result = []
        for line in lines:
            print(folder, line, file=process.stdin, flush=True)
            code, _, message = process.stdout.readline().partition(" ")
            result.append((int(code), message))
        return result

    with process:
        yield run
        process.stdin.close()
    assert process.returncode == 0


@pytest.fixture
def folder(tmp_path):
    """A slab, a sweep over its thickness, and rights that are given back in the end."""
    (tmp_path / "slab.toml").write_text(PHANTOM)
    (tmp_path / "sweep.toml").write_text(SWEEP)
    yield tmp_path
    for path, _, _ in os.walk(tmp_path, onerror=lambda error: os.chmod(error.filename, 0o700)):
        os.chmod(path, 0o700)


@pytest.mark.long
@pytest.mark.jit
def test_light_is_traced_where_its_store_may_not_be_read(jit_backend, commands, folder):
    """Rationale: a store that could not be searched once ended every command."""
    trace = "trace slab.toml --photons 500"
    assert commands(folder, f"open {trace}")[0][0] == 0 and any((folder / "open").iterdir())
    for mode, name in ((0o000, "hidden"), (0o444, "listed"), (0o555, "shown")):
        (folder / name).mkdir(mode=mode)
    for path in (folder / "open").iterdir():
        path.chmod(0o000)
    result = commands(folder, *(f"{store} {trace}" for store in ("hidden", "listed", "shown", "hidden/deep", "open")))
    for code, message in result:
        assert code == 0 and "traced light is not stored" in message and "Permission denied" in message
    for path in (folder / "open").iterdir():
        path.chmod(0o700)
        for file in path.iterdir():
            file.chmod(0o000)
    ((code, message),) = commands(folder, f"open {trace}")
    assert code == 0 and "open: stored light cannot be read (Permission denied); traced again" in message


@pytest.mark.long
@pytest.mark.jit
def test_a_batch_overwrites_no_plan_that_it_may_not_read(jit_backend, commands, folder):
    batch, out = "off batch sweep.toml -o out --photons 500 --workers 1", folder / "out"
    assert commands(folder, batch)[0][0] == 0
    before = (out / "plan.json").read_text()
    (out / "plan.json").chmod(0o000)
    for code, message in commands(folder, batch, "off batch --status out"):
        assert code == 2 and "plan.json: cannot be read: Permission denied; have it made readable" in message
    (out / "plan.json").chmod(0o600)
    assert (out / "plan.json").read_text() == before
    first, *others = sorted((out / "results").iterdir())
    stamps = [path.stat().st_mtime_ns for path in others]
    first.chmod(0o000)
    ((code, message),) = commands(folder, batch)
    assert code == 0 and "made again" in message and [path.stat().st_mtime_ns for path in others] == stamps
    (out / "failed").chmod(0o000)
    first.unlink()
    assert commands(folder, "off batch --status out")[0][0] == 0
    (out / "failed").chmod(0o700)
    out.chmod(0o000)
    for code, message in commands(folder, batch, "off batch --status out"):
        assert code == 2 and "Permission denied" in message and "internal" not in message


def test_unreadable_files_give_one_line(commands, folder):
    for name in ("shut.toml", "shut.csv", "shut.npz"):
        (folder / name).touch(mode=0o000)
    (folder / "shut").mkdir(mode=0o000)
    lines = [f"off {name} shut.toml" for name in ("simulate", "trace", "place", "check", "explain", "oximeter")]
    lines += ["off batch shut.toml -o b", "off predict shut.toml shut.csv", "off calibrate prototype shut.csv"]
    lines += ["off compare-with shut.npz", "off check shut/in.toml"]
    for code, message in commands(folder, *lines):
        assert code == 2 and "cannot be read: Permission denied; give" in message and message.count("nailoptics:") == 1
    lines = ["off export prototype -o shut/x.glb", "off export prototype -o shut/x --format mcx"]
    for code, message in commands(
        folder, *lines, "off simulate prototype -o shut/x", "off explore prototype -o shut/x.html"
    ):
        assert code == 2 and "cannot be written: Permission denied; choose another place." in message
