"""Pressures over time: linear between samples, with the instants at which an integrator must stop."""

import bisect

import numpy as np

# An integrator that meets a corner inside a step loses its order, so that it stops at corners. A sample is a corner if
# the input would miss the next sample by more than this part of its range, did its slope go on unchanged. [1]
_CORNER = 0.01
# On a smooth curve it stops each time the square roots of such misses have summed to this: over a bump of any width
# they sum to some 4, so that no bump lies unseen between two stops. [1]
_ROOTS_PER_STOP = 0.3
# Less than this is a sample on the line through its neighbours, which only costs time. [1]
_ON_A_LINE = 1e-9


class Drive:
    """Inputs that can be read at any time, from samples.

    time_s : (T,) float, increasing. [s]
    values : (channels, T) float. Linear between the samples.

    Samples on a line with their neighbours are dropped (nothing is lost). `stops` holds the instants of corners, and
    enough instants of a smooth curve that no feature can hide between two: an impulse of one sample is never missed.
    """

    def __init__(self, time_s: np.ndarray, values: np.ndarray) -> None:
        kept = np.concatenate(([0], 1 + np.flatnonzero(_misses(time_s, values) > _ON_A_LINE), [time_s.size - 1]))
        times, points = time_s[kept], values[:, kept]
        piece_slopes = np.diff(points, axis=1) / np.diff(times)
        misses = _misses(times, points)
        # The root, since a smooth curve's miss goes with the square of the samples' distance.
        roots = np.cumsum(np.sqrt(np.where(misses < _CORNER, misses, 0.0)))
        level = np.floor(np.concatenate(([0.0], roots)) / _ROOTS_PER_STOP)
        is_stop = np.ones(times.size, dtype=bool)
        is_stop[1:-1] = (np.diff(level) > 0) | (misses >= _CORNER)
        self.stops: list[float] = times[is_stop].tolist()
        self._times: list[float] = times.tolist()
        self._values: list[list[float]] = points.T.tolist()
        self._slopes: list[list[float]] = piece_slopes.T.tolist()
        left, right = _node_slopes(times, piece_slopes, is_stop)
        self._left: list[list[float]] = left.T.tolist()
        self._slope_rate: list[list[float]] = ((right - left) / np.diff(times)).T.tolist()
        self._last = len(self._slopes) - 1

    def _piece(self, time: float) -> int:
        return min(max(bisect.bisect_right(self._times, time) - 1, 0), self._last)

    def at(self, time: float) -> list[float]:
        """Every channel at a time."""
        i = self._piece(time)
        dt = time - self._times[i]
        return [v + s * dt for v, s in zip(self._values[i], self._slopes[i], strict=True)]

    def slope(self, time: float) -> list[float]:
        """The time derivative of every channel just after a time, smooth between stops."""
        i = self._piece(time)
        dt = time - self._times[i]
        return [v + s * dt for v, s in zip(self._left[i], self._slope_rate[i], strict=True)]


def _misses(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """By how much the slope's change at each inner sample moves the input over its shorter side, of its range. [1]"""
    sides = np.diff(times)
    slopes = np.diff(values, axis=1) / sides
    span = np.maximum(np.ptp(values, axis=1), 1.0)[:, None]
    misses = np.abs(np.diff(slopes, axis=1)) * np.minimum(sides[1:], sides[:-1]) / span
    return misses.max(axis=0, initial=0.0)


def _node_slopes(times: np.ndarray, slopes: np.ndarray, is_stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The slope at the left and at the right end of each piece, second order within a smooth stretch."""
    width = np.diff(times)
    left, right = slopes.copy(), slopes.copy()
    inner = (slopes[:, :-1] * width[1:] + slopes[:, 1:] * width[:-1]) / (width[1:] + width[:-1])
    smooth = ~is_stop[1:-1]
    right[:, :-1][:, smooth] = inner[:, smooth]
    left[:, 1:][:, smooth] = inner[:, smooth]
    # At a stop the slope on the other side does not count: mirror the one at the far end of the piece.
    starts, ends = is_stop[:-1] & ~is_stop[1:], ~is_stop[:-1] & is_stop[1:]
    left[:, starts] = 2.0 * slopes[:, starts] - right[:, starts]
    right[:, ends] = 2.0 * slopes[:, ends] - left[:, ends]
    return left, right
