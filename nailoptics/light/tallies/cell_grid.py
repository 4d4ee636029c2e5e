"""A regular grid whose cells kernels look up."""

from collections.abc import Iterable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi


class CellGrid:
    """Cells of equal size along each axis, from a lowest corner on."""

    def __init__(self, low_mm: Iterable[float], cell_mm: Iterable[float], count: Iterable[int]) -> None:
        self.low = [dr.opaque(mi.Float, float(low)) for low in low_mm]
        self.per_mm = [dr.opaque(mi.Float, float(1 / size)) for size in cell_mm]
        self.count = [dr.opaque(mi.UInt32, int(n)) for n in count]

    def cell(self, place: Sequence[Any], active: Any) -> tuple[Any, Any]:
        """Index of the cell at a place, the last axis counting fastest, and whether there is one."""
        index, inside = mi.UInt32(0), mi.Bool(active)
        for value, low, per_mm, count in zip(place, self.low, self.per_mm, self.count, strict=True):
            cell = mi.Int32(dr.floor((value - low) * per_mm))
            inside &= (cell >= 0) & (mi.UInt32(cell) < count)
            index = index * count + mi.UInt32(cell)
        return index, inside
