"""Pressures over time: linear between knots, with jumps, and the instants at which an integrator must stop."""

import bisect
import dataclasses
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite
from ..errors import InputError

# An integrator that meets a corner inside a step loses its order, so that it stops at corners. A knot is a corner if
# the input would miss the next knot by more than this fraction of its range, did its slope go on unchanged. [1]
_CORNER = 0.01
# On a smooth curve it stops each time the square roots of such misses have summed to this: over a bump of any width
# they sum to some 4, so that no bump is missed between two stops. [1]
_ROOTS_PER_STOP = 0.3
# So is a finely sampled curve thinned: the line through two knots kept misses those between by less than this. [1]
_ON_A_LINE = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Waveform:
    """A pressure over time that is known exactly: linear between knots, held before the first and after the last.

    time_s : (K,) float, not decreasing; two knots at one time are a jump. [s]
    pressure_pa : (K,) float. [Pa]

    Raises: InputError if times decrease, shapes differ, or a value is not finite.
    """

    time_s: np.ndarray
    pressure_pa: np.ndarray

    def __init__(self, *, time_s: ArrayLike, pressure_pa: ArrayLike) -> None:
        time, pressure = finite("waveform.time_s", time_s), finite("waveform.pressure_pa", pressure_pa)
        if time.ndim != 1 or time.size < 1 or pressure.shape != time.shape or np.any(np.diff(time) < 0.0):
            raise InputError(
                f"waveform: time_s and pressure_pa must be two rows of one length, got shapes {time.shape} and "
                f"{pressure.shape}, and times must not fall; give one pressure for each knot, sorted."
            )
        object.__setattr__(self, "time_s", time)
        object.__setattr__(self, "pressure_pa", pressure)

    def at(self, time_s: np.ndarray, *, before_jump: bool = False) -> np.ndarray:
        """The pressure at given times; at the instant of a jump the one after it, or that before. [Pa]"""
        if before_jump:  # the same where time runs backwards
            return np.interp(-time_s, -self.time_s[::-1], self.pressure_pa[::-1])
        return np.interp(time_s, self.time_s, self.pressure_pa)


class Drive:
    """Inputs that an integrator can read at any time, and how far it may go at once.

    waveforms : The inputs. to_channels : Makes the (channels, S) float values to be read from (inputs, S) of them.

    The time is cut into pieces on which every channel is linear; knots on a line with their neighbours are dropped
    (nothing is lost). A stretch is a run of pieces with no jump or corner inside, nor so much of a smooth curve that a
    feature could hide in it: an impulse of one sample is never missed.

    starts, ends : Instants at which each piece begins and ends. [s]
    stretches : First and last piece of each stretch.
    """

    def __init__(
        self,
        waveforms: Sequence[Waveform],
        to_channels: Callable[[np.ndarray], np.ndarray],
        *,
        begin_s: float,
        end_s: float,
    ) -> None:
        knots = np.unique(np.concatenate([waveform.time_s for waveform in waveforms]))
        knots = np.concatenate([[begin_s], knots[(knots > begin_s) & (knots < end_s)], [end_s]])
        first = to_channels(np.array([waveform.at(knots[:-1]) for waveform in waveforms]))
        last = to_channels(np.array([waveform.at(knots[1:], before_jump=True) for waveform in waveforms]))
        misses = _misses(np.diff(knots), first, last)
        used = np.append(True, (misses > _ON_A_LINE) | _is_next_level(misses, np.sqrt(_ON_A_LINE)))
        first, last = first[:, used], last[:, np.append(used[1:], True)]
        starts = knots[:-1][used]
        ends = np.append(starts[1:], end_s)
        sides = ends - starts
        misses = _misses(sides, first, last)
        corner = (misses >= _CORNER) | _is_next_level(np.where(misses < _CORNER, misses, 0.0), _ROOTS_PER_STOP)
        borders = np.concatenate([[0], 1 + np.flatnonzero(corner), [starts.size]]).tolist()
        self.stretches = [(low, high - 1) for low, high in zip(borders[:-1], borders[1:], strict=True)]
        self.starts, self.ends = array("d", starts), array("d", ends)
        slopes = (last - first) / sides
        # The slope at the left and at the right end of each piece, second order within a stretch.
        left, right = slopes.copy(), slopes.copy()
        inner = (slopes[:, :-1] * sides[1:] + slopes[:, 1:] * sides[:-1]) / (sides[1:] + sides[:-1])
        right[:, :-1][:, ~corner] = left[:, 1:][:, ~corner] = inner[:, ~corner]
        # At a stop the slope on the other side does not count: mirror the one at the far end of the piece.
        before, after = np.append(True, corner), np.append(corner, True)
        opens, closes = before & ~after, ~before & after
        left[:, opens] = 2.0 * slopes[:, opens] - right[:, opens]
        right[:, closes] = 2.0 * slopes[:, closes] - left[:, closes]
        self._first, self._slopes, self._left = first.T.copy(), slopes.T.copy(), left.T.copy()
        self._bends = ((right - left) / sides).T.copy()

    def at(self, time: float, first: int, last: int) -> list[float]:
        """Every channel at a time within pieces `first` to `last`."""
        return self.read([time], first, last)[0]

    def read(self, times: list[float], first: int, last: int) -> list[list[float]]:
        """Every channel at each of several times within pieces `first` to `last`."""
        starts, piece, values = self.starts, -1, []
        for time in times:
            at = first if first == last else bisect.bisect_right(starts, time, first + 1, last + 1) - 1
            if at != piece:
                piece, start = at, starts[at]
                line = list(zip(self._first[at].tolist(), self._slopes[at].tolist(), strict=True))
            values.append([v + s * (time - start) for v, s in line])
        return values

    def slope(self, time: float, piece: int, *, smooth: bool) -> list[float]:
        """The time derivative of every channel in a piece, or that of the smooth curve through the stretch."""
        if not smooth:
            slopes: list[float] = self._slopes[piece].tolist()
            return slopes
        dt = time - self.starts[piece]
        return [s + b * dt for s, b in zip(self._left[piece].tolist(), self._bends[piece].tolist(), strict=True)]


def _misses(sides: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """How far each inner knot is from a line through its neighbours, 1 or more at a jump. [1]

    By how much the slope's change there moves the input over the shorter side, of the input's range.
    """
    span = np.maximum(np.maximum(first, last).max(axis=1) - np.minimum(first, last).min(axis=1), 1.0)[:, None]
    misses = np.abs(np.diff((last - first) / sides, axis=1)) * np.minimum(sides[1:], sides[:-1]) / span
    return np.where(first[:, 1:] != last[:, :-1], np.maximum(misses, 1.0), misses).max(axis=0, initial=0.0)


def _is_next_level(misses: np.ndarray, roots: float) -> np.ndarray:
    """Where the square roots of misses, added from knot to knot, pass the next multiple of `roots`."""
    # The root, since a smooth curve's miss goes with the square of the distance of its knots.
    return np.diff(np.floor(np.cumsum(np.sqrt(misses)) / roots), prepend=0.0) > 0.0


def waveform_of(name: str, value: Any, time_s: np.ndarray) -> Waveform:
    """A checked input of a response: a waveform as it is, or one number or one for each time."""
    if isinstance(value, Waveform):
        return value
    samples = finite(name, value)
    if samples.shape not in ((), time_s.shape):
        why = f"one number or one for each of {time_s.size} times, got shape {samples.shape}."
        raise InputError(f"{name} must be a waveform, {why}")
    return Waveform(time_s=time_s[:1] if samples.shape == () else time_s, pressure_pa=np.atleast_1d(samples))
