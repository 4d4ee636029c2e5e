"""A stored record comes back as it was, or is found out."""

import numpy as np
import pytest

from nailoptics.batch import record

ARRAYS = {
    "a": np.arange(12.0).reshape(3, 4),
    "b": np.array([1, 2], np.uint16),
    "none": np.zeros((0, 3), np.float32),
    "flag": np.array(True),
}


def test_a_record_comes_back_as_it_was():
    header, arrays = record.unpack(record.pack({"name": "x", "n": np.int64(3)}, ARRAYS))
    assert header == {"name": "x", "n": 3}
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype and np.array_equal(arrays[name], array)
        assert arrays[name].shape == array.shape


def test_every_single_changed_or_missing_byte_is_found():
    data = record.pack({"name": "x"}, ARRAYS)
    for i in range(len(data)):
        with pytest.raises(record.CorruptError):
            record.unpack(data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :])
        with pytest.raises(record.CorruptError):
            record.unpack(data[:i])


def test_objects_are_neither_written_nor_read():
    """A record with a valid checksum that asks for Python objects is refused, not unpickled."""
    with pytest.raises(TypeError):
        record.pack({}, {"a": np.array([object()])})
    honest = record.pack({}, {"a": np.zeros(2)})
    body = honest.partition(b"\n")[2].replace(b'"<f8"', b'"|O8"')
    import hashlib

    with pytest.raises(record.CorruptError):
        record.unpack(record.MAGIC + hashlib.sha256(body).hexdigest().encode() + b"\n" + body)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "r.dat"
    record.write_whole(path, b"old")

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(record.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        record.write_whole(path, b"new")
    assert path.read_bytes() == b"old" and [p.name for p in tmp_path.iterdir()] == ["r.dat"]
