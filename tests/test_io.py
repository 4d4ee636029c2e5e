"""What is written is there whole, whoever else writes, and whatever goes wrong; archives come back as they were."""

import errno
import os
import stat
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from small_scenes import SMALL_FINGER, phantom

from nailoptics import io
from nailoptics.errors import InputError, WriteError

ROOT = Path(__file__).parents[1]
QUIET = SMALL_FINGER + "[priors]\nspread = false\n"
PHANTOM = phantom(
    {"thickness_mm": 1.0, "mu_a_per_mm": 0.1, "g": 0.8, "n": 1.4},
    photodiodes=[{"name": "p", "position_mm": [1.0, 0.0]}],
)


def here() -> dict[str, str]:
    """What a process inherits, to import this package and read this test's store."""
    return os.environ | {"PYTHONPATH": str(ROOT)}


def start(*arguments: str, folder: Path, **options) -> subprocess.Popen:
    """The command line in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "nailoptics", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=here(),
        **options,
    )


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def refusing(monkeypatch, number: int) -> None:
    """Let the disk refuse a file after its data are written, as a delayed allocation does."""

    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(io.os, "replace", refuse)


CODES = {errno.ENOSPC: 1, errno.EDQUOT: 1, errno.EFBIG: 1, errno.EACCES: 2, errno.EROFS: 2}


@pytest.mark.parametrize("number", CODES)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(number, tmp_path, monkeypatch):
    path = tmp_path / "file"
    io.write_text(path, "old")
    refusing(monkeypatch, number)
    with pytest.raises(WriteError, match=f"{path}: cannot be written: {os.strerror(number)}; ") as caught:
        io.write_bytes(path, bytes(12_300_000))
    code = caught.value.exit_code
    assert code == CODES[number] and ("12.3 MB are needed" in str(caught.value)) == (code == 1)
    assert path.read_text() == "old" and names(tmp_path) == ["file"]


def test_an_interrupted_write_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "file"
    io.write_text(path, "old")

    def interrupt(source, target):
        raise KeyboardInterrupt

    monkeypatch.setattr(io.os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        io.write_bytes(path, b"new")
    assert path.read_text() == "old" and names(tmp_path) == ["file"]


def test_an_invalid_output_path_is_an_input_error(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    io.write_text(tmp_path / "file", "x")
    for place, word in (
        (tmp_path / "folder", "folder or device"),
        (tmp_path / "pipe", "folder or device"),
        (tmp_path / "file" / "below", "File exists"),
        (tmp_path / ("x" * 300), "name too long"),
    ):
        with pytest.raises(InputError, match=word) as caught:
            io.write_text(place, "text")
        assert caught.value.exit_code == 2 and len(str(caught.value).splitlines()) == 1
    assert names(tmp_path) == ["file", "folder", "pipe"] and stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_name_as_long_as_the_file_system_takes_can_be_written(tmp_path):
    path = tmp_path / ("x" * 255)
    io.write_text(path, "text")
    assert path.read_text() == "text"


def test_a_folder_that_is_not_there_is_made(tmp_path):
    io.write_text(tmp_path / "new" / "below" / "file", "text")
    assert (tmp_path / "new" / "below" / "file").read_text() == "text"


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_files_have_the_permissions_that_the_umask_leaves(mask, tmp_path):
    before = os.umask(mask)
    try:
        io.write_text(tmp_path / "file", "text")
        io.write_dataset(xr.Dataset({"a": ("x", [1.0])}), tmp_path / "set.nc")
    finally:
        os.umask(before)
    assert {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == {0o666 & ~mask}


def test_a_write_removes_what_killed_writers_left_a_day_ago(tmp_path):
    """Not what another writes at this moment, not what only a link leads to, and nothing of another name."""
    long_ago = time.time() - 2 * io.LEFTOVER_S
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "linked").symlink_to(tmp_path / "elsewhere")
    left = ["here/.nailoptics-0.part", "here/.nailoptics-1.part", "here/other.part", "elsewhere/.nailoptics-2.part"]
    io.make_folder(tmp_path / "here")
    for name in left:
        (tmp_path / name).touch()
        if not name.endswith("1.part"):
            os.utime(tmp_path / name, (long_ago, long_ago))
    for folder in ("here", "linked"):
        io.write_text(tmp_path / folder / "file", "text")
    assert names(tmp_path / "here") == [".nailoptics-1.part", "file", "other.part"]
    assert names(tmp_path / "elsewhere") == [".nailoptics-2.part", "file"]


def test_a_link_is_replaced_and_what_it_points_to_stays(tmp_path):
    victim, link = tmp_path / "victim", tmp_path / "link"
    victim.write_text("precious")
    link.symlink_to(victim)
    io.write_text(link, "text")
    assert victim.read_text() == "precious" and link.read_text() == "text" and not link.is_symlink()


def test_links_planted_where_a_temporary_file_might_lie_are_not_followed(tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    planted = [".result.nc.part", "result.nc.part", ".nailoptics-guessed.part"]
    for name in planted:
        (tmp_path / name).symlink_to(victim)
    io.write_dataset(xr.Dataset({"a": ("x", [1.0])}), tmp_path / "result.nc")
    assert "a" in xr.load_dataset(tmp_path / "result.nc")
    # Even who could predict the random name gains nothing.
    monkeypatch.setattr(io.secrets, "token_hex", lambda size: "guessed")
    with pytest.raises(WriteError, match="File exists"):
        io.write_text(tmp_path / "other", "text")
    with pytest.raises(WriteError, match="File exists"):
        io.check_writable(tmp_path)
    assert victim.read_text() == "precious" and not (tmp_path / "other").exists()


def test_datasets_come_back_as_they_were(tmp_path):
    about = {"Conventions": "CF-1.11", "n": 3}
    given = xr.Dataset({"a": (("t", "x"), np.random.default_rng(1).random((50, 3)))}, {"x": ["p", "q", "r"]}, about)
    io.write_dataset(given, tmp_path / "new" / "set.nc")
    assert xr.load_dataset(tmp_path / "new" / "set.nc").identical(given)


def test_a_full_disk_leaves_the_old_dataset(tmp_path, monkeypatch):
    """HDF5 itself ends the process where its own write fails."""
    given = xr.Dataset({"a": (("t", "x"), np.ones((50, 3)))}, {"x": ["p", "q", "r"]})
    (tmp_path / "set.nc").write_text("old")

    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(io.os, "replace", refuse)
        with pytest.raises(WriteError, match="MB are needed: make room and run again") as caught:
            io.write_dataset(given, tmp_path / "set.nc")
    assert caught.value.exit_code == 1 and names(tmp_path) == ["set.nc"] and (tmp_path / "set.nc").read_text() == "old"


def test_a_written_dataset_states_its_conventions_and_axes(tmp_path):
    given = xr.Dataset({"a": (("led", "so2"), [[1.0]])}, {"led": ["ir"], "so2": [0.9]})
    io.write_dataset(given, tmp_path / "set.nc")
    written = xr.load_dataset(tmp_path / "set.nc")
    assert written.attrs == {"Conventions": "CF-1.11"} and given.attrs == {} and given.led.attrs == {}
    assert written.led.attrs == {"long_name": "LED"}
    assert written.so2.attrs == {"long_name": "oxygen saturation", "units": "1"}


ARRAYS = {
    "a": np.arange(12.0).reshape(3, 4),
    "b": np.array([1, 2], np.uint16),
    "none": np.zeros((0, 3), np.float32),
    "flag": np.array(True),
}


def test_an_archive_comes_back_as_it_was_and_numpy_reads_it_too(tmp_path):
    data = io.pack({"name": "x", "n": np.int64(3)}, ARRAYS)
    header, arrays = io.unpack(data)
    assert header == {"name": "x", "n": 3} and data == io.pack({"name": "x", "n": 3}, ARRAYS)
    (tmp_path / "archive.npz").write_bytes(data)
    with np.load(tmp_path / "archive.npz") as stored:
        for name, array in ARRAYS.items():
            for computed in (arrays[name], stored[name]):
                assert (
                    computed.dtype == array.dtype and computed.shape == array.shape and np.array_equal(computed, array)
                )


def test_no_changed_or_missing_byte_changes_a_number_that_is_read():
    """Expected: each header and array is as it was, or not there."""
    data = bytes(io.pack({"name": "x"}, ARRAYS))
    for i in range(len(data)):
        with pytest.raises(io.CorruptError):
            io.unpack(data[:i])
        try:
            header, arrays = io.unpack(data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :])
        except io.CorruptError:
            continue
        assert header == {"name": "x"}
        for name, array in arrays.items():
            assert array.dtype == ARRAYS[name].dtype and np.array_equal(array, ARRAYS[name]), i


def test_objects_are_neither_written_nor_read():
    """An archive of Python objects is refused, not unpickled."""
    with pytest.raises(TypeError):
        io.pack({}, {"a": np.array([object()])})
    with_objects = BytesIO()
    np.savez(with_objects, header=np.frombuffer(b"{}", np.uint8), a=np.array([object()]))
    with pytest.raises(io.CorruptError, match="not an archive of numbers"):
        io.unpack(with_objects.getvalue())
    for data in (b"", b"nailoptics-record 1 ", b"\x89HDF\r\n\x1a\n", b"12345678"):
        with pytest.raises(io.CorruptError):
            io.unpack(data)


WRITER = """
import sys
from pathlib import Path
from nailoptics.io import write_bytes
for i in range(200):
    write_bytes(Path(sys.argv[1]), sys.argv[2].encode() * 100_000)
"""


def test_concurrent_writers_of_one_file_leave_a_whole_one(tmp_path):
    path = tmp_path / "file"
    writers = [
        subprocess.Popen([sys.executable, "-c", WRITER, str(path), letter], env=here(), stderr=subprocess.PIPE)
        for letter in "abcd"
    ]
    computed_sizes = set()
    while any(writer.poll() is None for writer in writers):
        if path.exists():
            computed = path.read_bytes()
            assert len(computed) == 100_000 and len(set(computed)) == 1
            computed_sizes.add(computed[:1])
    assert [writer.communicate()[1] for writer in writers] == [b""] * 4 and computed_sizes
    assert [writer.returncode for writer in writers] == [0] * 4 and names(tmp_path) == ["file"]


def test_checking_whether_files_can_be_written_creates_nothing(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "out/result.nc").mkdir(parents=True)
    io.check_writable(tmp_path / "new/deep", "result.nc")
    io.check_writable(tmp_path / "out", "other.nc")
    for place, word in (("file", "Not a directory"), ("file/sub", "Not a directory"), ("x" * 300, "name too long")):
        with pytest.raises(WriteError, match=f"{place}: cannot be written: .*{word}"):
            io.check_writable(tmp_path / place)
    with pytest.raises(WriteError, match="result.nc: is a folder"):
        io.check_writable(tmp_path / "out", "result.nc")
    assert names(tmp_path) == ["file", "out"] and names(tmp_path / "out") == ["result.nc"]


@pytest.fixture
def small_disk(tmp_path):
    """Limits a child to files of so many bytes, and a folder for it: a disk of that size where one may be mounted."""
    import resource

    folder = tmp_path / "disk"
    folder.mkdir()

    def of(size: int):
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True)
        if mounted.returncode:
            return folder, {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))}
        return folder, {}

    yield of
    if folder.is_mount():
        subprocess.run(["umount", folder], check=True)


def assert_full(command: subprocess.Popen, folder: Path, kept: list[str]) -> None:
    """One line on stderr that names what is missing, exit code 1, and no debris."""
    out, err = command.communicate(timeout=300)
    lines = [line for line in err.splitlines() if "LED" not in line and "saturated:" not in line]
    assert (command.returncode, out, len(lines)) == (1, "", 1), err
    assert "cannot be written: " in lines[0] and "MB are needed: make room and run again." in lines[0]
    assert names(folder) == kept


@pytest.mark.long
def test_a_full_disk_ends_simulate_with_one_line_and_the_old_result_whole(chosen_jit, small_disk, tmp_path):
    folder, limit = small_disk(40_960)
    (folder / "result.nc").write_text("old")
    (tmp_path / "finger.toml").write_text(QUIET)
    command = start("simulate", "finger.toml", "--photons", "8000", "-o", str(folder), folder=tmp_path, **limit)
    assert_full(command, folder, ["result.nc"])
    assert (folder / "result.nc").read_text() == "old"


@pytest.mark.long
def test_a_full_disk_ends_trace_and_export_with_one_line(chosen_jit, small_disk, tmp_path):
    folder, limit = small_disk(40_960)
    (tmp_path / "slab.toml").write_text(PHANTOM)
    light, mesh = str(folder / "light.npz"), str(folder / "finger.glb")
    assert_full(start("trace", "slab.toml", "--photons", "900000", "-o", light, folder=tmp_path, **limit), folder, [])
    assert_full(start("export", "prototype", "-o", mesh, folder=tmp_path, **limit), folder, [])


def test_a_file_is_put_in_its_place_by_one_module_alone():
    """Rationale: a second way to write files would have faults of its own."""
    ways = ("os.replace", ".replace(path)", "tempfile.mkstemp", "NamedTemporaryFile", ".write_text(", ".savefig(path")
    computed = {
        path.name
        for path in (ROOT / "nailoptics").rglob("*.py")
        if any(way in path.read_text(encoding="utf-8") for way in ways)
    }
    assert computed == {"io.py"}
