"""Blood zones along the nail: a smooth partition of unity."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .spectra import Array


def bed_zone_name(zone: int) -> str:
    """Name of a blood zone's absorber in results: bed_1 is the most proximal, zone 0."""
    return f"bed_{zone + 1}"


@dataclass(frozen=True)
class BloodZones:
    """Zones of the nail bed along v, each smoothly handing over to the next.

    Zone 0 is the most proximal, zone K - 1 reaches the tip (v grows towards the tip). Around each edge the weight
    passes from one zone to the next over `width_mm`, with a continuous slope (cubic smoothstep).

    Raises: InputError when the edges do not rise, or lie closer together than `width_mm`.
    """

    edges_mm: tuple[float, ...] = (0.0,)
    width_mm: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges_mm", tuple(float(edge) for edge in self.edges_mm))
        if not np.isfinite(self.edges_mm).all():
            raise InputError(f"zones.edges_mm = {list(self.edges_mm)} must be finite numbers; correct them")
        if not (np.isfinite(self.width_mm) and self.width_mm > 0):
            raise InputError(f"zones.width_mm = {self.width_mm:g} must be above 0; a zone's edge is smooth, not a step")
        for first, second in pairwise(self.edges_mm):
            # Closer, three zones would overlap and a weight could turn negative.
            if second - first < self.width_mm:
                raise InputError(
                    f"zones.edges_mm {first:g} and {second:g} lie closer than width_mm = {self.width_mm:g}; "
                    "move them apart (in rising order) or narrow the width"
                )

    @property
    def count(self) -> int:
        """The number of zones K, one more than edges."""
        return len(self.edges_mm) + 1

    def weights(self, v_mm: ArrayLike) -> Array:
        """How much of each zone is at v, (..., K) float in 0-1, summing to exactly 1.

        v_mm : (...) float. Place along the nail, towards the tip positive. [mm]
        """
        v = np.asarray(v_mm, dtype=float)[..., None]
        t = np.clip((v - np.asarray(self.edges_mm)) / self.width_mm + 0.5, 0.0, 1.0)
        passed = t * t * (3 - 2 * t)
        ones, zeros = np.ones_like(v), np.zeros_like(v)
        # Edges are a width apart, so at most one step is under way at any v and the sum is exact in floating point.
        return np.asarray(np.concatenate([ones, passed], axis=-1) - np.concatenate([passed, zeros], axis=-1))
