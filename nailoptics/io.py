"""Files on disk: the one writer of whole files, datasets as NetCDF, arrays of numbers as archives."""

import contextlib
import errno
import json
import math
import os
import secrets
import stat
import struct
import sys
import time
import zlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from io import BytesIO, FileIO, RawIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import WriteError

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
# The end of an archive, its checksum in hexadecimal.
_CHECKSUM = 8
_NUMBERS = "biuf"
# HDF5's bookkeeping is written in pieces of at most this size. [bytes]
_SMALL_PIECE = 1 << 20
CONVENTIONS = "CF-1.11"
# What an axis of names is in words, where a dataset does not say it itself.
AXES = {
    "led": "LED",
    "photodiode": "photodiode",
    "zone": "blood zone of the nail bed, from the cuticle to the tip",
    "absorber": "absorbing region or blood zone",
    "sweep": "what is swept",
    "model": "model of the paper",
    "way": "where the model's constants come from",
    "part": "part of a whole",
    "within": "largest error that is allowed, as a part of the swing",
    "band": "coordinate of the colour space",
    "channel": "channel of the screen",
    "axis": "axis in space",
    "site": "site on the finger",
    "node": "node within a prior's range",
    "prior": "what is unknown of the finger",
    "so2": "oxygen saturation",
    "cause": "cause of the error",
    "level": "level of model",
    "layout": "layout of LEDs and photodiodes",
    "searched_led": "LED whose place was searched",
    "finger": "finger that the layout must serve",
    "pressure": "side of the pulp that the pressure acts on",
    "pressure_too": "side of the pulp that the other pressure acts on",
    "blood_zone": "blood zone of the nail bed, from the cuticle to the tip",
    "best_photodiode": "photodiode of the best layout",
    "photodiode_count": "number of photodiodes",
    "chosen_for": "noise for which so many photodiodes were chosen",
    "cover": "whether the board is covered against light from outside",
    "ambient": "source of light from outside",
}
# What a spreadsheet takes for the beginning of a formula.
FORMULA = ("=", "+", "-", "@", "\t", "\r")
# What a file is: a result of the user's, or light that is kept for the next time.
RESULT, LIGHT = "result", "light"
# Those who note what is finished.
_NOTES: list[list[tuple[str, Path]]] = []
# New files that have not taken their places yet.
_ASIDE: list[Path] = []
# What writers that were killed left in a folder goes with the next write into it when it is so old. [s]
LEFTOVER_S = 86400.0
_SWEPT: set[Path] = set()
# What a member of an archive begins with, and the flag of one whose size is told after it.
_MEMBER, _SIZE_FOLLOWS = b"PK\x03\x04", 8


class CorruptError(Exception):
    """A file is not what was written."""


@contextlib.contextmanager
def files_noted() -> Iterator[list[tuple[str, Path]]]:
    """What the files are, and their paths, that this process finishes meanwhile, in their order."""
    noted: list[tuple[str, Path]] = []
    _NOTES.append(noted)
    try:
        yield noted
    finally:
        _NOTES.pop()


def write_bytes(path: Path, data: bytes | memoryview, *, flush: bool = False, what: str = RESULT) -> None:
    """Write a file whole or not at all: whatever happens, what lies at path is the old file or the new one.

    The data go to a new file of a random name in the same folder, which then takes the place of the old one. A
    symbolic link at path is replaced, and what it points to stays as it was. The new file has the old one's mode.

    flush : whether it must be on disk before this returns, so that a power cut cannot undo it.
    what : what the file is, for those who note it.

    Raises: WriteError where the file cannot be written.
    """
    try:
        with _in_place_of(path, flush=flush, what=what) as file:
            _write_all(file, data)
        if flush and hasattr(os, "O_DIRECTORY"):
            handle = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
    except OSError as error:
        raise _refused(path, error, size=len(data)) from None


def _write_all(file: FileIO, data: Any) -> None:
    left = memoryview(data).cast("B")
    while left.nbytes:
        left = left[file.write(left) :]


@contextlib.contextmanager
def _in_place_of(path: Path, *, flush: bool = False, what: str = RESULT) -> Iterator[FileIO]:
    """A new file aside, unbuffered, which takes the place of that at path if the block ends well, and else goes."""
    sweep_leftovers(path.parent)
    aside = path.with_name(f".nailoptics-{secrets.token_hex(8)}.part")
    if path.exists() and not path.is_file():
        raise WriteError(f"{path}: is a folder or device where a file is to be written; choose another name.")
    mode = None if path.is_symlink() or not path.exists() else path.stat().st_mode & 0o777
    # Exclusive creation opens no file of another and follows no link.
    file = FileIO(aside, "x+", opener=lambda name, flags: os.open(name, flags, 0o666 if mode is None else 0o600))
    _ASIDE.append(aside)
    try:
        with file:
            if mode is not None:
                with contextlib.suppress(OSError):  # a file system without modes
                    os.chmod(aside, mode)
            yield file
            if flush:
                os.fsync(file.fileno())
        os.replace(aside, path)
        for noted in _NOTES:
            noted.append((what, path))
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)
        raise
    finally:
        _ASIDE.remove(aside)


def sweep_leftovers(folder: Path) -> None:
    """Remove old files that killed writers left in a folder, once in this process; follows no link."""
    if folder in _SWEPT or folder.is_symlink():
        return
    _SWEPT.add(folder)
    old = time.time() - LEFTOVER_S
    with contextlib.suppress(OSError):  # it cannot be listed, or another process swept first
        for path in folder.glob(".nailoptics-*.part"):
            if stat.S_ISREG(path.lstat().st_mode) and path.lstat().st_mtime < old:
                path.unlink(missing_ok=True)


def abandon_files() -> None:
    """Remove what is half written, before a process ends where it is."""
    for aside in _ASIDE:
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, whole or not at all; raises WriteError."""
    write_bytes(path, text.encode())


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it, unless it is there; raises WriteError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _refused(folder, error) from None


def check_writable(folder: Path, *files: str) -> None:
    """Raise WriteError where a folder cannot be made, or these files not be written in it; leaves nothing."""
    try:
        nearest = next(path for path in (folder, *folder.parents) if path.exists())
        probe = nearest / f".nailoptics-{secrets.token_hex(8)}.part"
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise _refused(folder, error) from None
    for name in files:
        if (folder / name).is_dir():
            raise WriteError(f"{folder / name}: is a folder where a file is to be written; choose another.")


@contextlib.contextmanager
def turn(folder: Path) -> Iterator[None]:
    """Make a folder and wait until nobody else writes results in it, so that files that belong together stay together.

    Where the file system knows no locks (some network file systems) nobody waits.
    """
    make_folder(folder)
    if fcntl is None:
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise _refused(folder, error) from None
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def claimed(file: Path, number: int) -> Iterator[bool]:
    """Whether no other process has claimed this number in a file; the system frees the claims of the dead.

    Claims save work; without them (some network file systems) two processes do the same twice.
    """
    if fcntl is None:
        yield True
        return
    try:
        handle = open(file, "ab")
    except PermissionError:  # another user's
        yield True
        return
    with handle:
        try:
            fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, number, os.SEEK_SET)
        except (BlockingIOError, PermissionError):
            yield False
            return
        except OSError:  # no locks here
            pass
        yield True


def cache_folder() -> Path:
    """Where this system keeps a user's files that a program can make again, in a folder of this package's own.

    Raises: RuntimeError for a user without a home.
    """
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "nailoptics"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "nailoptics"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nailoptics"


def write_dataset(dataset: "xr.Dataset", path: Path) -> None:
    """Write a dataset to NetCDF by the CF conventions, and make its folder; raises WriteError.

    HDF5 writes piece by piece: the dataset is never copied as a whole. Of what is worked out when it is read there is
    one variable at a time.
    """
    make_folder(path.parent)
    try:
        with _in_place_of(path) as file:
            patient = _Patient(file)
            for number, part in enumerate(_parts(_as_cf(dataset))):
                try:
                    part.to_netcdf(patient, mode="a" if number else "w", engine="h5netcdf")
                finally:
                    if patient.refused is not None:
                        raise patient.refused
    except OSError as error:
        raise _refused(path, error, size=dataset.nbytes) from None


def _parts(dataset: "xr.Dataset") -> "Iterator[xr.Dataset]":
    """A dataset in parts whose variables follow each other as in the whole, the first with all coordinates.

    xarray works out all that it is to write before it writes: each part has one variable at most that is not in memory.
    """
    begin, names = 0, list(dataset.data_vars)
    ends = [k + 1 for k, name in enumerate(names) if not dataset[name].variable._in_memory]
    for end in dict.fromkeys([*ends, len(names)]):
        if begin:
            yield dataset[names[begin:end]].drop_attrs(deep=False).drop_vars(dataset.indexes, errors="ignore")
        else:
            yield dataset.drop_vars(names[end:])
        begin = end


class _Patient(RawIOBase):
    """A file that takes whatever is written and remembers that the disk refused: HDF5 does not outlive a full one.

    From then on its bookkeeping, small pieces that it reads again, is kept in memory; the data themselves are dropped.
    """

    def __init__(self, file: FileIO) -> None:
        self.file, self.at, self.end = file, 0, 0
        self.refused: OSError | None = None
        self.pieces: list[tuple[int, bytes]] = []

    def write(self, data: Any) -> int:
        """Write all of it; once a write was refused, keep it if it is small."""
        size = memoryview(data).nbytes
        if self.refused is None:
            try:
                self.file.seek(self.at)
                _write_all(self.file, data)
            except OSError as error:
                self.refused = error
        if self.refused is not None and size <= _SMALL_PIECE:
            self.pieces.append((self.at, bytes(data)))
        self.at += size
        self.end = max(self.end, self.at)
        return size

    def readinto(self, buffer: Any) -> int:
        """What was last written at the place."""
        memory = memoryview(buffer).cast("B")
        size = memory.nbytes
        self.file.seek(self.at)
        memory[:] = self.file.read(size).ljust(size, b"\0")
        for at, piece in self.pieces:
            first, last = max(at, self.at), min(at + len(piece), self.at + size)
            if first < last:
                memory[first - self.at : last - self.at] = piece[first - at : last - at]
        self.at += size
        return size

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        self.at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self.at, os.SEEK_END: self.end}[whence]
        return self.at

    def tell(self) -> int:
        """The place."""
        return self.at

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length."""
        self.end = self.at if size is None else size
        try:
            if self.refused is None:
                self.file.truncate(self.end)
        except OSError as error:
            self.refused = error
        return self.end


def _as_cf(dataset: "xr.Dataset") -> "xr.Dataset":
    """A copy of a dataset that says by which conventions it is written, and in words what each axis is."""
    written = dataset.copy()
    written.attrs = {"Conventions": CONVENTIONS} | dataset.attrs
    for name in written.coords.keys() & AXES.keys():
        attributes = {"long_name": AXES[str(name)]}
        if written[name].dtype.kind in _NUMBERS:
            attributes["units"] = "1"
        written[name].attrs = attributes | written[name].attrs
    return written


def leave_dask_out() -> None:
    """Keep xarray, if it is not loaded yet, from loading Dask: 0.6 s of processor time, and no array is Dask's."""
    if "xarray" not in sys.modules:
        sys.modules.setdefault("dask", None)  # type: ignore[arg-type]


def let_dask_in() -> None:
    """Let Dask be imported again."""
    if sys.modules.get("dask", sys) is None:
        del sys.modules["dask"]


def plain_cell(value: Any) -> Any:
    """A cell of a table for spreadsheets: a text that one would run as a formula stays text, behind an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value[:1] in FORMULA else value


def of_plain_cell(cell: str) -> str:
    """The text of which `plain_cell` made a cell."""
    return cell[1:] if cell[:1] == "'" and cell[1:2] in FORMULA else cell


def to_json(value: Any, *, indent: int = 2) -> str:
    """A value as JSON text; what is NaN or infinite, and so unknown to JSON, becomes null."""
    plain = json.loads(json.dumps(value, default=float), parse_constant=lambda name: None)
    return json.dumps(plain, indent=indent, allow_nan=False)


def pack(header: Mapping[str, Any], arrays: Mapping[str, "np.ndarray"]) -> memoryview:
    """A header for JSON and arrays of numbers as a NumPy archive (.npz), which ends with the checksum of its bytes."""
    import numpy as np

    for name, array in arrays.items():
        if np.asarray(array).dtype.kind not in _NUMBERS:
            raise TypeError(f"{name} holds {np.asarray(array).dtype}, which is no number")
    text = json.dumps(header, separators=(",", ":"), default=np.generic.item).encode()
    data = BytesIO()
    columns: dict[str, Any] = {"header": np.frombuffer(text, np.uint8), **arrays}
    np.savez(data, **columns)
    # The archive's last two bytes are the length of a comment that it does not have: the checksum becomes one.
    data.seek(-2, os.SEEK_END)
    data.write(_CHECKSUM.to_bytes(2, "little"))
    checksum = zlib.crc32(data.getbuffer())
    data.write(f"{checksum:0{_CHECKSUM}x}".encode())
    return data.getbuffer()


def unpack(data: bytes | memoryview, *, arrays: bool = True) -> tuple[dict[str, Any], dict[str, "np.ndarray"]]:
    """Header and arrays; raises CorruptError unless every byte is as it was written.

    arrays : whether they are wanted; the header alone takes a tenth of the time.
    """
    data = memoryview(data)
    if f"{zlib.crc32(data[:-_CHECKSUM]):0{_CHECKSUM}x}".encode() != data[-_CHECKSUM:]:
        raise CorruptError("its checksum does not hold")
    try:
        found = {}
        for name, array in _members(data):
            found[name] = array
            if not arrays and name == "header":
                break
        header = json.loads(found.pop("header").tobytes())
    except Exception as error:  # what is no archive of ours fails in many ways
        raise CorruptError(f"it is no archive of numbers ({error})") from None
    if not isinstance(header, dict):
        raise CorruptError("its header is no table")
    return header, found


def _members(data: memoryview) -> "Iterator[tuple[str, np.ndarray]]":
    """The arrays of an archive that `pack` wrote, one after the other.

    Ten times as fast as `numpy.load`, which looks every member up and parses its description anew.
    """
    import numpy as np

    at = 0
    while data[at : at + 4] == _MEMBER:
        flags, method = struct.unpack_from("<HH", data, at + 6)
        name, extra = struct.unpack_from("<HH", data, at + 26)
        if method or flags & _SIZE_FOLLOWS:
            raise ValueError("it is compressed")
        first = at + 30 + name + extra
        (length,) = struct.unpack_from("<H", data, first + 8)
        body = first + 10 + length
        dtype, shape, fortran = _described(bytes(data[first:body]))
        array = np.frombuffer(data, dtype, math.prod(shape), body)
        array = array.reshape(shape[::-1]).T.copy("F") if fortran else array.reshape(shape).copy()
        yield str(data[at + 30 : at + 30 + name], "utf-8").removesuffix(".npy"), array
        at = body + array.nbytes


@lru_cache(maxsize=4096)
def _described(head: bytes) -> "tuple[np.dtype[Any], tuple[int, ...], bool]":
    """Type, shape and whether columns come first, of an array's description; many files share theirs."""
    from numpy.lib import format as npy

    file = BytesIO(head)
    if npy.read_magic(file) != (1, 0):
        raise ValueError("it is described in another version")
    shape, fortran, dtype = npy.read_array_header_1_0(file)
    if dtype.kind not in _NUMBERS:
        raise ValueError(f"it holds {dtype}, which is no number")
    return dtype, shape, fortran


def _refused(path: Path, error: OSError, *, size: int = 0) -> WriteError:
    """Why nothing can be written at path, and what helps. [size: bytes]"""
    line = f"{path}: cannot be written: {error.strerror or error}; "
    if error.errno in _FULL:
        needed = f"{size / 1e6:.3g} MB are needed: " if size else ""
        return WriteError(f"{line}{needed}make room and run again.", full=True)
    return WriteError(f"{line}choose another place.")
