"""Files on disk: the one writer of whole files, datasets as NetCDF, arrays of numbers as archives."""

import contextlib
import errno
import json
import os
import secrets
import stat
import sys
import time
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .assets import read_toml
from .errors import WriteError

if TYPE_CHECKING:
    import xarray as xr

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NUMBERS = "biuf"
CONVENTIONS = "CF-1.11"
# What a spreadsheet takes for the beginning of a formula.
FORMULA = ("=", "+", "-", "@", "\t", "\r")
# What writers that were killed left in a folder goes with the next write into it when it is so old. [s]
LEFTOVER_S = 86400.0
_SWEPT: set[Path] = set()


class CorruptError(Exception):
    """A file is not what was written."""


def write_bytes(path: Path, data: bytes | memoryview) -> None:
    """Write a file whole or not at all: whatever happens, what lies at path is the old file or the new one.

    Its folder is made unless it is there. The data go to a new file of a random name in it, which then takes the place
    of the old one. A symbolic link at path is replaced, and what it points to stays as it was.

    Raises: WriteError where the file cannot be written.
    """
    make_folder(path.parent)
    sweep_leftovers(path.parent)
    aside = path.with_name(f".nailoptics-{secrets.token_hex(8)}.part")
    try:
        if path.exists() and not path.is_file():
            raise WriteError(f"{path}: is a folder or device where a file is to be written; choose another name.")
        # Exclusive creation opens no file of another and follows no link.
        file = open(aside, "xb")
        try:
            with file:
                file.write(data)
            os.replace(aside, path)
        except BaseException:
            aside.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise _refused(path, error, size=len(data)) from None


def sweep_leftovers(folder: Path) -> None:
    """Remove old files that killed writers left in a folder, once in this process; follows no link."""
    if folder in _SWEPT or folder.is_symlink():
        return
    _SWEPT.add(folder)
    with contextlib.suppress(OSError):  # it cannot be listed, or another process swept first
        for path in folder.glob(".nailoptics-*.part"):
            if stat.S_ISREG(path.lstat().st_mode) and path.lstat().st_mtime < time.time() - LEFTOVER_S:
                path.unlink(missing_ok=True)


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
    """Write a dataset to NetCDF by the CF conventions, its axes in words; raises WriteError.

    It is made in memory, so that a full disk leaves the old file.
    """
    written = dataset.assign_attrs({"Conventions": CONVENTIONS} | dataset.attrs)
    words = read_toml("axes.toml")
    for name in written.coords.keys() & words.keys():
        units = {"units": "1"} if written[name].dtype.kind in _NUMBERS else {}
        written[name].attrs = {"long_name": words[str(name)], **units} | written[name].attrs
    write_bytes(path, written.to_netcdf(engine="netcdf4"))


def block_dask_import() -> None:
    """Keep xarray, if it is not loaded yet, from loading Dask: 0.6 s of processor time, and no array is Dask's."""
    if "xarray" not in sys.modules:
        sys.modules.setdefault("dask", None)  # type: ignore[arg-type]


def unblock_dask_import() -> None:
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


def pack(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> memoryview:
    """A header for JSON and arrays of numbers as a NumPy archive (.npz), which has a checksum of each."""
    for name, array in arrays.items():
        if np.asarray(array).dtype.kind not in _NUMBERS:
            raise TypeError(f"{name} holds {np.asarray(array).dtype}, which is no number")
    text = json.dumps(header, separators=(",", ":"), default=np.generic.item).encode()
    data = BytesIO()
    columns: dict[str, Any] = {"header": np.frombuffer(text, np.uint8), **arrays}
    np.savez(data, **columns)
    return data.getbuffer()


def unpack(data: bytes | memoryview) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays; raises CorruptError unless they are as they were written."""
    try:
        with np.load(BytesIO(data), allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
            read = {name: file[name] for name in file.files if name != "header"}
    except Exception as error:  # what is not an archive of ours fails in many ways
        raise CorruptError(f"it is not an archive of numbers ({error})") from None
    if others := [name for name, array in read.items() if array.dtype.kind not in _NUMBERS]:
        raise CorruptError(f"it is not an archive of numbers ({others[0]} holds {read[others[0]].dtype})")
    return header, read


def _refused(path: Path, error: OSError, *, size: int = 0) -> WriteError:
    """Why nothing can be written at path, and what helps. [size: bytes]"""
    line = f"{path}: cannot be written: {error.strerror or error}; "
    if error.errno in _FULL:
        needed = f"{size / 1e6:.3g} MB are needed: " if size else ""
        return WriteError(f"{line}{needed}make room and run again.", full=True)
    return WriteError(f"{line}choose another place.")
