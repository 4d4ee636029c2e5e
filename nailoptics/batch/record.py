"""A file of numbers that knows its checksum: written aside, flushed and renamed, read without running anything."""

import hashlib
import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

MAGIC = b"nailoptics-record 1 "
_KINDS = "biuf"


class CorruptError(Exception):
    """A file is not what was written."""


def pack(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> bytes:
    """A header for JSON and arrays of numbers as bytes: a line with the rest's checksum, a line of JSON, the data."""
    table, chunks, offset = {}, [], 0
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"{name} holds {array.dtype}, which is no number")
        data = array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()
        table[name] = [array.dtype.newbyteorder("<").str, list(np.shape(arrays[name])), offset, len(data)]
        chunks.append(data)
        offset += len(data)
    body = (
        json.dumps({"header": header, "arrays": table}, separators=(",", ":"), default=_plain).encode()
        + b"\n"
        + b"".join(chunks)
    )
    return MAGIC + hashlib.sha256(body).hexdigest().encode() + b"\n" + body


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} is no data")


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays; raises CorruptError unless every byte is as it was written."""
    first, _, body = data.partition(b"\n")
    if not first.startswith(MAGIC) or hashlib.sha256(body).hexdigest().encode() != first[len(MAGIC) :]:
        raise CorruptError("its checksum does not hold")
    line, _, raw = body.partition(b"\n")
    try:
        found = json.loads(line)
        arrays = {}
        for name, (kind, shape, offset, size) in found["arrays"].items():
            dtype = np.dtype(str(kind))
            if dtype.kind not in _KINDS:
                raise ValueError(kind)
            arrays[name] = np.frombuffer(raw[offset : offset + size], dtype).reshape(shape)
        return found["header"], arrays
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CorruptError(f"it is not a record ({error})") from None


def read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """A record, or None where there is no file; raises CorruptError."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    return unpack(data)


def write_whole(path: Path, data: bytes, *, flush: bool = True) -> None:
    """Write a file whole or not at all, so that even after a power cut it is there as written or not there.

    flush : whether it must be on disk before this returns; what only saves time need not.
    """
    aside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.part")
    try:
        with open(aside, "xb") as file:
            file.write(data)
            file.flush()
            if flush:
                os.fsync(file.fileno())
        os.replace(aside, path)
    except BaseException:
        aside.unlink(missing_ok=True)
        raise
    if flush and hasattr(os, "O_DIRECTORY"):
        handle = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
