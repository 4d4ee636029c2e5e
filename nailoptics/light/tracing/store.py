"""The cache of traced light on disk: a folder for each entry, named by the digest of all that decides its bits."""

import hashlib
import json
import logging
import math
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ... import io
from ...assets import data_dir
from ...errors import WriteError
from ...options import TraceOptions
from ...scene import Scene
from ..identity import led_digest
from ..transfer import current_versions

T = TypeVar("T")

log = logging.getLogger(__name__)

# Where the user's store lies, or "off" for none.
VARIABLE = "NAILOPTICS_STORE"
# The user's store takes at most so much, and of what is free on its disk at most this part. [bytes]
MOST_BYTES = 2e9
MOST_OF_FREE = 0.25
# Code that decides a photon's way beside the scene, so that no other program's light passes for this one's.
CODE = ("statistics.py", "tissue.py", "hemodynamics/blood.py", "geometry/**/*.py", "light/**/*.py", "scene/**/*.py")
ASSETS = ("tissue.toml", "spectra/*.csv")
_KEY = 32


@cache
def program_digest(code: tuple[str, ...] = CODE, assets: tuple[str, ...] = ASSETS) -> str:
    """Digest of code and assets, by patterns of their files, that decide a photon's way, or what is made of it;
    versions alone miss changes between releases."""
    digest = hashlib.sha256()
    for root, patterns in ((Path(__file__).parents[2], code), (data_dir("assets"), assets)):
        for path in sorted(path for pattern in patterns for path in root.glob(pattern) if path.is_file()):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:_KEY]


def led_cache_key(scene: Scene, led: int, *, seed: int, backend: str, what: str = "photons") -> dict[str, Any]:
    """Cache key of one LED's light: all that decides its bits, plain enough for JSON."""
    light, wavelength_nm = led_digest(scene, led), scene.leds[led].wavelength_nm
    return cache_key(what, light, wavelength_nm, seed=seed, backend=backend) | {"led": led}


def cache_key(what: str, light: str, wavelength_nm: float, *, seed: int, backend: str) -> dict[str, Any]:
    """Cache key of some light, all that decides its bits, plain enough for JSON. light : digest of its paths' scene."""
    return {
        "what": what,
        "light": light,
        "wavelength_nm": wavelength_nm,
        "seed": seed,
        "backend": backend,
        "versions": current_versions(),
        "program": program_digest(),
    }


class LightStore:
    """A folder of traced light, safe for many processes at once; whatever is there is whole, and is data only.

    most_bytes : what is oldest in use gives way to keep the store below it. [bytes]
    optional : whether light is traced all the same where nothing can be written.
    """

    def __init__(self, root: Path, *, most_bytes: float = math.inf, optional: bool = False) -> None:
        self.root, self.most_bytes, self.optional, self.closed = root, most_bytes, optional, False
        # The first write checks the bound.
        self._unchecked, self._written = math.inf, 0

    @classmethod
    def of_user(cls) -> "LightStore | None":
        """The store that all commands of a user share; None where it is off."""
        if (root := user_folder()) is None:
            return None
        most_bytes = MOST_BYTES
        with suppress(OSError, StopIteration):
            there = next(path for path in (root, *root.parents) if os.path.exists(path))
            most_bytes = min(MOST_BYTES, MOST_OF_FREE * shutil.disk_usage(there).free)
        return cls(root, most_bytes=most_bytes, optional=True)

    @classmethod
    def of_command(cls, options: TraceOptions) -> "list[LightStore]":
        """The user's store, if it is on and the options have one."""
        store = cls.of_user() if options.store else None
        return [store] if store else []

    def entry(self, key: Mapping[str, Any]) -> "CacheEntry":
        """The entry of one traced light by its key, all that decides it."""
        text = json.dumps(key, sort_keys=True, separators=(",", ":"))
        return CacheEntry(self, self.root / hashlib.sha256(text.encode()).hexdigest()[:_KEY], dict(key))

    def write(self, path: Path, data: memoryview) -> None:
        """Write a file of the store; where it is optional, the first refusal ends storing with a word."""
        # os.path takes what a folder hides for missing, Path does not.
        if self.closed or os.path.isdir(path):
            return
        try:
            io.write_bytes(path, data)
        except WriteError as error:
            if not self.optional:
                raise
            self.closed = True
            log.warning("traced light is not stored: %s", error)
            return
        self._unchecked += len(data)
        self._written += len(data)
        # One command must not push out all others' light and then its own.
        self.closed = self._written > self.most_bytes / 2
        if self._unchecked > self.most_bytes / 8:
            self.trim()

    def folders(self) -> Iterator[Path]:
        """The entries' folders, without symbolic links and what else may be there; OSError if it cannot be listed."""
        there = sorted(self.root.iterdir()) if self.root.exists() else []
        named = (path for path in there if re.fullmatch(f"[0-9a-f]{{{_KEY}}}", path.name))
        yield from (path for path in named if not path.is_symlink())

    def trim(self) -> None:
        """Evict the entries that were not used for longest (LRU), until the rest is within bounds."""
        self._unchecked = 0
        with suppress(OSError):  # another process trims, too
            aged = sorted((folder.stat().st_mtime, folder, size_of(folder)) for folder in self.folders())
            total = sum(size for _, _, size in aged)
            for _, folder, size in aged:
                if total <= self.most_bytes:
                    break
                remove(folder)
                total -= size


@dataclass(frozen=True)
class CacheEntry:
    """What is stored of one traced light: files of which each holds its key and its name."""

    store: LightStore
    folder: Path
    key: dict[str, Any]

    def path(self, name: str) -> Path:
        """The file of this name."""
        return self.folder / f"{name}.dat"

    def read(self, name: str, build: Callable[[dict[str, Any], dict[str, np.ndarray]], T]) -> T | None:
        """What `build` makes of the header and the arrays of a name; None where there is nothing, or a file that is not
        what was written or of which nothing can be made, which is reported."""
        path = self.path(name)
        try:
            header, arrays = io.unpack(path.read_bytes())
            if (header.get("key"), header.get("name")) != (self.key, name):
                raise io.CorruptError("it is another light's")
            with suppress(OSError):  # another user's
                os.utime(self.folder)
            return build(header["about"], arrays)
        except (FileNotFoundError, NotADirectoryError):
            pass
        except PermissionError as error:
            log.warning("%s: stored light cannot be read (%s); traced again", self.store.root, error.strerror)
        except (OSError, io.CorruptError, LookupError, AttributeError, TypeError, ValueError) as error:
            log.warning("%s: is not what was stored there (%s); traced again", path, error)
        return None

    def write(self, name: str, about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Write header and arrays under a name."""
        self.store.write(self.path(name), io.pack({"key": self.key, "name": name, "about": about}, arrays))


def load_or_compute(
    entries: Sequence[CacheEntry],
    name: str,
    make: Callable[[], tuple[dict[str, Any], dict[str, np.ndarray]]],
    build: Callable[[dict[str, Any], dict[str, np.ndarray]], T],
) -> tuple[T, bool]:
    """What `build` makes of a header and arrays that lie stored or, if there are none, are made and go to the first;
    and whether it was stored."""
    for entry in entries:
        if (stored := entry.read(name, build)) is not None:
            return stored, True
    about, arrays = make()
    if entries:
        entries[0].write(name, about, arrays)
    return build(about, arrays), False


def remove(folder: Path) -> None:
    """Remove the files of one entry, and the folder unless something else lies in it, such as a writer's file."""
    for path in folder.glob("*.dat"):
        with suppress(OSError):
            path.unlink()
    io.sweep_leftovers(folder)
    with suppress(OSError):
        folder.rmdir()


def user_folder() -> Path | None:
    """Where the user's store lies; None where it is off."""
    if given := os.environ.get(VARIABLE):
        return None if given.lower() == "off" else Path(given)
    try:
        return io.cache_folder() / "light"
    except RuntimeError:
        return None


def size_of(folder: Path) -> int:
    """Bytes of one light."""
    return sum(path.lstat().st_size for path in folder.glob("*.dat"))
