"""Items sorted into the boxes of a grid, so that whoever asks at a place finds the few that may lie there."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Boxes:
    """Layers of bins x bins boxes, and the items that may reach into each.

    start : (boxes + 1,) int. Where the list of each box begins in members.
    members : (l,) int. Items, box by box.
    """

    bins: int
    start: Integers
    members: NDArray[np.int32]

    @classmethod
    def sort(cls, first: Integers, last: Integers, *, bins: int, layer: Integers | int = 0, layers: int = 1) -> Self:
        """Sort items into all boxes from the first to the last bin that each reaches, (n, 2) int, within its layer."""
        wide = last - first + 1
        count = wide[:, 0] * wide[:, 1]
        item = np.repeat(np.arange(len(count), dtype=np.int32), count)
        rank = np.arange(len(item)) - np.repeat(np.cumsum(count) - count, count)
        column, row = first[item, 0] + rank // wide[item, 1], first[item, 1] + rank % wide[item, 1]
        box = (np.broadcast_to(layer, count.shape)[item] * bins + column) * bins + row
        start = np.concatenate([[0], np.cumsum(np.bincount(box, minlength=layers * bins**2))])
        # Box and item as one number: plain numbers are sorted many times as fast as their places.
        pairs = np.sort((box.astype(np.int64) << 32) | item)
        return cls(bins, start, (pairs & 0xFFFFFFFF).astype(np.int32))

    def at(self, bins: Integers, layer: Integers | int = 0) -> Integers:
        """Boxes (k,) at bins (k, 2) of a layer."""
        return (layer * self.bins + bins[:, 0]) * self.bins + bins[:, 1]

    def count(self, box: Integers) -> Integers:
        """How many items each box (k,) lists."""
        return self.start[box + 1] - self.start[box]

    def items(self, box: Integers) -> NDArray[np.int32]:
        """The items of each box (k,), one list after the other."""
        count = self.count(box)
        begin = np.cumsum(count) - count
        return self.members[np.repeat(self.start[box] - begin, count) + np.arange(count.sum())]
