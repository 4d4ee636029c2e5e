"""Items over the boxes of a plane grid, so that places find the few items that they may lie in."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]

PAIRS = 2_000_000  # at once, to keep the work arrays small


@dataclass(frozen=True)
class Boxes:
    """Layers of bins x bins boxes, numbered row by row in each column, and the runs of them that items reach into.

    item : (s,) int. The item of each run, rising; an item has one run in each column that it reaches into.
    first, last : (s,) int. The first and the last box of each run.
    """

    bins: int
    layers: int
    item: NDArray[np.int32]
    first: Integers
    last: Integers

    @classmethod
    def sort(cls, first: Integers, last: Integers, *, bins: int, layer: Integers | int = 0, layers: int = 1) -> Self:
        """Items by all boxes from the first to the last bin that each reaches, (n, 2) int, within its layer."""
        count = last[:, 0] - first[:, 0] + 1
        item = np.repeat(np.arange(len(count), dtype=np.int32), count)
        rank = np.arange(len(item)) - np.repeat(np.cumsum(count) - count, count)
        column = (np.broadcast_to(layer, count.shape)[item] * bins + first[item, 0] + rank) * bins
        return cls(bins, layers, item, column + first[item, 1], column + last[item, 1])

    def at(self, bins: Integers, layer: Integers | int = 0) -> Integers:
        """Boxes (k,) at bins (k, 2) of a layer."""
        return (layer * self.bins + bins[:, 0]) * self.bins + bins[:, 1]

    def pairs(self, box: Integers) -> Iterator[tuple[NDArray[np.int32], Integers]]:
        """All pairs of an item and of one of the places in boxes (k,) that it reaches into, in parts; items rise."""
        order = np.argsort(box, kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(box, minlength=self.layers * self.bins**2))])
        begin, end = start[self.first], start[self.last + 1]
        some = np.nonzero(end > begin)[0]
        item, begin, count = self.item[some], begin[some], (end - begin)[some]
        work = np.cumsum(count)
        cuts = [0, *np.searchsorted(work, np.arange(PAIRS, work[-1] if len(work) else 0, PAIRS)), len(work)]
        for low, high in zip(cuts[:-1], cuts[1:], strict=True):
            n, ends = count[low:high], work[low:high]
            done = work[low - 1] if low else 0
            place = np.repeat(begin[low:high] - (ends - n - done), n) + np.arange(n.sum())
            yield np.repeat(item[low:high], n), order[place]
