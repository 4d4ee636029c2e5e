"""Values of every LED, photodiode and sample that are worked out when they are read, as those of a file are."""

from collections.abc import Callable
from typing import Any

import numpy as np
from xarray.backends import BackendArray
from xarray.core import indexing

# Samples of a row that are worked out at once.
_AT_ONCE = 1 << 16

# Gives the values of an LED and a photodiode, by their numbers, at some samples, by theirs, (t,) int -> (t,).
Row = Callable[[int, int, np.ndarray], np.ndarray]


def per_sample(row: Row, *, like: np.ndarray, dtype: Any = None) -> indexing.LazilyIndexedArray:
    """An array for a variable over (led, photodiode, time), of the shape and type of another but for `dtype`."""
    return indexing.LazilyIndexedArray(_PerSample(row, like.shape, np.dtype(dtype or like.dtype)))


class _PerSample(BackendArray):
    """Values over (led, photodiode, time) that are worked out whenever they are read, and not kept."""

    def __init__(self, row: Row, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.row, self.shape, self.dtype = row, shape, dtype

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._values)

    def _values(self, key: tuple[Any, ...]) -> np.ndarray:
        asked = [np.arange(size)[one] for size, one in zip(self.shape, key, strict=True)]
        leds, photodiodes, times = (np.atleast_1d(one) for one in asked)
        out = np.empty((len(leds), len(photodiodes), len(times)), self.dtype)
        for i, j in np.ndindex(*out.shape[:2]):
            for start in range(0, len(times), _AT_ONCE):
                part = slice(start, start + _AT_ONCE)
                out[i, j, part] = self.row(int(leds[i]), int(photodiodes[j]), times[part])
        return out.reshape([size for one in asked for size in one.shape])
