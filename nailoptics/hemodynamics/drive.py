"""Inputs over time: linear between samples, with the instants at which an integrator must stop."""

from __future__ import annotations

import bisect

import numpy as np

_KINK = 0.01
"""Change of slope, over the shorter side and relative to the input's range, that is a kink. [1]"""
_TURN = 0.3
"""Sum of the roots of such changes after which a smooth curve gets a stop; a bump of any width sums to some 4. [1]"""


class Drive:
    """Piecewise linear inputs that can be read at any time.

    time_s : (T,) float, increasing. values : (channels, T) float.

    Samples on a line with their neighbours are dropped (nothing is lost). ``stops`` holds the instants of a kink, and
    enough instants of a smooth curve that no feature can hide between two: an impulse of one sample is never missed.
    """

    def __init__(self, time_s: np.ndarray, values: np.ndarray) -> None:
        kept = np.concatenate(([0], 1 + np.flatnonzero(_bends(time_s, values) > 1e-9), [time_s.size - 1]))
        times, points = time_s[kept], values[:, kept]
        piece_slopes = np.diff(points, axis=1) / np.diff(times)
        bends = _bends(times, points)
        # The root, since a change of slope over a sample goes with the square of the samples' distance.
        level = np.floor(np.concatenate(([0.0], np.cumsum(np.sqrt(np.where(bends < _KINK, bends, 0.0))))) / _TURN)
        is_stop = np.ones(times.size, dtype=bool)
        is_stop[1:-1] = (np.diff(level) > 0) | (bends >= _KINK)
        self.stops: list[float] = times[is_stop].tolist()
        self._times: list[float] = times.tolist()
        self._values: list[list[float]] = points.T.tolist()
        self._slopes: list[list[float]] = piece_slopes.T.tolist()
        left, right = _node_slopes(times, piece_slopes, is_stop)
        self._left: list[list[float]] = left.T.tolist()
        self._turn: list[list[float]] = ((right - left) / np.diff(times)).T.tolist()
        self._last = len(self._slopes) - 1

    def _piece(self, time: float) -> int:
        return min(max(bisect.bisect_right(self._times, time) - 1, 0), self._last)

    def at(self, time: float) -> list[float]:
        """Return every channel at a time."""
        i = self._piece(time)
        dt = time - self._times[i]
        return [v + s * dt for v, s in zip(self._values[i], self._slopes[i], strict=True)]

    def slope(self, time: float) -> list[float]:
        """Return the time derivative of every channel just after a time, smooth between stops."""
        i = self._piece(time)
        dt = time - self._times[i]
        return [v + s * dt for v, s in zip(self._left[i], self._turn[i], strict=True)]


def _bends(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the change of slope at each inner sample over the shorter of its sides, relative to the range. [1]"""
    sides = np.diff(times)
    slopes = np.diff(values, axis=1) / sides
    span = np.maximum(np.ptp(values, axis=1), 1.0)[:, None]
    bends = np.abs(np.diff(slopes, axis=1)) * np.minimum(sides[1:], sides[:-1]) / span
    return bends.max(axis=0, initial=0.0)


def _node_slopes(times: np.ndarray, slopes: np.ndarray, is_stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the slope at the left and at the right end of each piece, second order within a smooth stretch."""
    width = np.diff(times)
    left, right = slopes.copy(), slopes.copy()
    inner = (slopes[:, :-1] * width[1:] + slopes[:, 1:] * width[:-1]) / (width[1:] + width[:-1])
    smooth = ~is_stop[1:-1]
    right[:, :-1][:, smooth] = inner[:, smooth]
    left[:, 1:][:, smooth] = inner[:, smooth]
    # At a stop the slope on the other side means nothing: mirror the one at the far end of the piece.
    starts, ends = is_stop[:-1] & ~is_stop[1:], ~is_stop[:-1] & is_stop[1:]
    left[:, starts] = 2.0 * slopes[:, starts] - right[:, starts]
    right[:, ends] = 2.0 * slopes[:, ends] - left[:, ends]
    return left, right
