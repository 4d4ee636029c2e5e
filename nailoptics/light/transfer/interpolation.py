"""Interpolation between Chebyshev nodes over a box of states: the one way from a few readings to all.

References: Berrut, Trefethen 2004, SIAM Rev. 46, 501 (barycentric Lagrange interpolation).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...checks import Array


@dataclass(frozen=True)
class ChebyshevBox:
    """Chebyshev nodes over a box, so many in each direction, and the weights that interpolate between them.

    low, high : (d,) float. Ends of the box.
    counts : (d,) int. Nodes in each direction; of one alone the value is the same all along it.
    """

    low: Sequence[float] | Array
    high: Sequence[float] | Array
    counts: Sequence[int]

    @property
    def axes(self) -> list[Array]:
        """The nodes along each direction, from its high end on, (n,) float each."""
        middle, half = (np.add(self.high, self.low) / 2, np.subtract(self.high, self.low) / 2)
        return [m + h * np.cos(_angles(n)) for m, h, n in zip(middle, half, self.counts, strict=True)]

    @property
    def nodes(self) -> Array:
        """All nodes, (m, d) float; along the last direction they follow each other."""
        return np.stack([grid.ravel() for grid in np.meshgrid(*self.axes, indexing="ij")], -1).reshape(
            -1, len(self.counts)
        )

    def weights(self, places: ArrayLike) -> Array:
        """What each node's value counts for at places in the box, (t, d) or, of one direction, (t,): (t, m) float."""
        places = np.asarray(places, float).reshape(-1, len(self.counts))
        weights = np.ones((len(places), 1))
        for column, axis, low, high in zip(places.T, self.axes, self.low, self.high, strict=True):
            if (n := len(axis)) == 1:
                continue
            sign = np.sin(_angles(n)) * (-1.0) ** np.arange(n)
            away = column[:, None] - axis
            on_node = np.abs(away) < 1e-14 * (high - low)
            share = sign / np.where(on_node, 1, away)
            share = np.where(on_node.any(1, keepdims=True), on_node, share / share.sum(1, keepdims=True))
            weights = (weights[:, :, None] * share[:, None, :]).reshape(len(places), -1)
        return weights


def _angles(n: int) -> Array:
    return np.asarray((2 * np.arange(n) + 1) * np.pi / (2 * n))
