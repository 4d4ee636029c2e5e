"""The massless model over time: adaptive steps with error control, and walls that stop at contact.

A wall in contact stands still while the load presses it on; it leaves when the blood lifts it. Both instants are
located, so that between them the equations are smooth and the method keeps its order.
"""

import dataclasses
import functools
import logging
import math
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import NotReachedError
from . import rodas
from .drive import Drive
from .rodas import Vector
from .unroll import larger, unroll
from .walls import PerWall, Walls, massless_jacobian, massless_rates

_LOG = logging.getLogger(__name__)
_MOST_STEPS = 2_000_000
# Samples whose pressures are worked out at once: what is between fills the processor's cache, not the memory.
_AT_ONCE = 1 << 14
_FIRST_STEP_S = 1e-3
# Of the listed diameter: closer than this a wall counts as touching.
_SNAP = 1e-9
# A step that would end no further than this beyond its piece of the drive, in lengths of what is left of it, stays
# inside: there the drive's slope is exact.
_BEYOND = 1.5

# One wall over a step, as `rodas.interpolate` takes it.
Curve = tuple[float, float, float, float]


def _load(walls: Walls, inputs: PerWall, width: PerWall) -> list[Any]:
    """Force that presses each wall inward against the blood. [N]"""
    each = zip(walls.area, inputs[2:], walls.stiffness, width, walls.diameter, strict=True)
    return [a * f + k * (d - rest) for a, f, k, d, rest in each]


def _rates(walls: Walls, inputs: PerWall, width: PerWall, free: PerWall) -> tuple[list[Any], list[Any]]:
    """Pressures [Pa] and wall speeds [m/s]; a wall that a stage has pushed past contact lets blood through as there."""
    open_width = [larger(d, c) for d, c in zip(width, walls.closed, strict=True)]
    return massless_rates(walls, open_width, _load(walls, inputs, width), free, inputs[0], inputs[1])


def _lift(*arguments: Any) -> list[Any]:
    """Force that would move each wall outwards if nothing held it: of constants, inputs, widths, who is free. [N]"""
    *constants, inputs, width, free = arguments
    walls = Walls(*constants)
    pressures, _ = _rates(walls, inputs, width, free)
    return [a * p - f for a, p, f in zip(walls.area, pressures, _load(walls, inputs, width), strict=True)]


def _try_step(*arguments: Any) -> tuple[Any, ...]:
    """A step of one length: its error over what is allowed, how near a wall comes to contact, and its curve.

    Of constants, inputs at each of `rodas.INSTANTS`, their slopes, widths, who is free, the step and rtol.
    """
    *rest, change, width, free, step_s, rtol = arguments
    constants, inputs = rest[: -len(rodas.INSTANTS)], rest[-len(rodas.INSTANTS) :]
    walls = Walls(*constants)
    pressures, _ = _rates(walls, inputs[0], width, free)
    rise = [a * f for a, f in zip(walls.area, change[2:], strict=True)]
    middle, after, error, first, second = rodas.step(
        lambda instant, state: _rates(walls, inputs[instant], state, free)[1],
        width,
        slope_in_time=massless_rates(walls, width, rise, free, change[0], change[1])[1],
        jacobian=massless_jacobian(walls, width, free, pressures, inputs[0][0], inputs[0][1]),
        step_s=step_s,
    )
    excess: Any = 0.0
    depth: Any = 0.0
    for e, begin, half, end, listed, closed in zip(
        error, width, middle, after, walls.diameter, walls.closed, strict=True
    ):
        excess = larger(excess, e / (rtol * larger(larger(begin, end), listed)))
        depth = larger(depth, larger(closed - half, closed - end) / listed)
    # A sum, other than a maximum, cannot lose a number that is none.
    return excess + 0.0 * sum(after), depth, after, first, second


@functools.cache
def _unrolled(units: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`_try_step` and `_lift` for a number of capillary units."""
    walls, channels = units + 1, units + 3
    constants = [units if field.name == "venule" else walls for field in dataclasses.fields(Walls)]
    instants = [channels] * len(rodas.INSTANTS)
    return (
        unroll(_try_step, *constants, *instants, channels, walls, walls, None, None),
        unroll(_lift, *constants, channels, walls, walls),
    )


class _Motion:
    """The walls on their way: where they are, which are in contact, and every step so far."""

    def __init__(self, walls: Walls, drive: Drive, width: Vector, *, rtol: float) -> None:
        self.walls, self.drive, self.width, self.rtol = walls, drive, width, float(rtol)
        self.free, self.piece = [1.0] * len(width), 0
        self.time, self.step_s = drive.starts[0], min(_FIRST_STEP_S, drive.ends[-1] - drive.starts[0])
        self.steps = array("d")
        self._constants = tuple(getattr(walls, field.name) for field in dataclasses.fields(walls))
        self._try_step, self._lift = _unrolled(len(walls.venule))

    def snap(self) -> bool:
        """Put free walls that all but touch into contact; True if there are any."""
        touched = False
        for i, (c, listed) in enumerate(zip(self.walls.closed, self.walls.diameter, strict=True)):
            if self.free[i] and self.width[i] - c <= _SNAP * listed:
                self.width[i], touched = c, True
        return touched

    def settle(self) -> None:
        """Choose which of the touching walls are held: the contact problem at one instant."""
        touching = [d <= c for d, c in zip(self.width, self.walls.closed, strict=True)]
        self.free = [0.0 if t else 1.0 for t in touching]
        if not any(touching):
            return
        inputs = self.drive.at(self.time, self.piece, self.piece)
        for _ in range(2 * len(touching) + 2):
            lift = self._lift(*self._constants, inputs, self.width, self.free)
            wrong = [(abs(f), i) for i, f in enumerate(lift) if touching[i] and (f > 0.0) != (self.free[i] > 0.0)]
            if not wrong:
                return
            i = max(wrong)[1]
            self.free[i] = 1.0 - self.free[i]

    def step(self, last: int) -> None:
        """One step within pieces of the drive, as long as its error allows and no wall meets or leaves another."""
        ends, piece = self.drive.ends, self.piece
        while True:
            inside = self.step_s < _BEYOND * (ends[piece] - self.time)
            until = piece if inside else last
            wanted_s, left_s = self.step_s, ends[until] - self.time
            at_end = wanted_s * (1.0 + 1e-9) >= left_s or self.time + wanted_s >= ends[until]
            step_s = left_s if at_end else wanted_s
            change = self.drive.slope(self.time, piece, smooth=until > piece)
            inputs = self.drive.read([self.time + part * step_s for part in rodas.INSTANTS], piece, until)
            try:
                excess, depth, after, first, second = self._try_step(
                    *self._constants, *inputs, change, self.width, self.free, step_s, self.rtol
                )
            except ZeroDivisionError:
                # The step hit a pole of the method's stability function, at a growing mode: any other will do.
                excess = math.inf
            if not excess <= 1.0:
                # The error goes with the fourth power of the step: aim a little below what is allowed.
                self.step_s = step_s * (max(0.2, min(0.9, 0.9 * excess**-0.25)) if excess < 1e6 else 0.2)
                continue
            part = 1.0
            if depth > _SNAP or 0.0 in self.free:
                curves = list(zip(self.width, after, first, second, strict=True))
                part = _first_contact(self.walls, self.free, curves)
                if part == 1.0:
                    part = self._first_release(step_s, curves, until)
            if part < 1.0:
                self.step_s = part * step_s
                continue
            self.steps.extend([self.time, step_s, *self.width, *after, *first, *second, *self.free])
            self.time = ends[until] if at_end else self.time + step_s
            while self.piece < last and ends[self.piece] <= self.time:
                self.piece += 1
            scale = 5.0 if excess < 1e-3 else 0.9 * excess**-0.25
            self.step_s = max(wanted_s, step_s * scale) if at_end and scale >= 1.0 else step_s * scale
            self.width = after
            return

    def _first_release(self, step_s: float, curves: list[Curve], until: int) -> float:
        """The part of the step at which the blood first lifts a held wall, 1 if it lifts none."""

        def lifted(part: float) -> bool:
            inputs = self.drive.at(self.time + part * step_s, self.piece, until)
            width = [rodas.interpolate(*curve, part) for curve in curves]
            force = self._lift(*self._constants, inputs, width, self.free)
            return any(f > 0.0 and not free for f, free in zip(force, self.free, strict=True))

        if not lifted(1.0):
            return 1.0
        low, high = 0.0, 1.0
        while high - low > 1e-4:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if lifted(middle) else (middle, high)
        return 1.0 if high > 1.0 - 1e-3 else high


def integrate(
    walls: Walls,
    drive: Drive,
    time_s: np.ndarray,
    start_m: np.ndarray,
    inputs: np.ndarray | None,
    *,
    rtol: float,
    most_steps: int = _MOST_STEPS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diameters D + x [m], pressures [Pa] and contact (bool) of walls at given times, (N+1, T) each.

    start_m : (N+1,) float. D + x at time_s[0]. [m]
    inputs : (N+3, T) float. What `drive` gives at time_s: P_H, P_L and the touch pressure on each wall; None where no
        pressures are wanted, which are then (N+1, 0). [Pa]
    rtol : Allowed local error of a step, relative to the diameter or the listed one if that is larger. [1]

    Raises: NotReachedError if the tolerance needs more than `most_steps` steps.
    """
    motion = _Motion(walls, drive, [max(float(d), c) for d, c in zip(start_m, walls.closed, strict=True)], rtol=rtol)
    taken = 0
    for motion.piece, last in drive.stretches:
        motion.settle()
        while motion.time < drive.ends[last]:
            motion.step(last)
            taken += 1
            if taken > most_steps:
                raise NotReachedError(
                    f"hemodynamics: the response needs more than {most_steps} steps (reached {motion.time:g} s); "
                    "raise rtol or soften the parameters."
                )
            if motion.snap() or 0.0 in motion.free:
                motion.settle()
    _LOG.debug("massless model: %d steps over %g s", taken, drive.ends[-1] - drive.starts[0])
    width, free = _sample(np.frombuffer(motion.steps).reshape(taken, -1), time_s, walls.closed)
    pressure = np.empty((len(width), 0 if inputs is None else time_s.size))
    if inputs is None:
        return width, pressure, ~free
    for start in range(0, time_s.size, _AT_ONCE):
        given, at, loose = (rows[:, start : start + _AT_ONCE] for rows in (inputs, width, free))
        found, _ = massless_rates(walls, at, _load(walls, given, at), loose.astype(float), given[0], given[1])
        pressure[:, start : start + _AT_ONCE] = found
    return width, pressure, ~free


def _sample(steps: np.ndarray, time_s: np.ndarray, closed: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Accepted steps, a row each, read at given times: diameters [m], and which walls are free of contact, (N+1, T)."""
    starts, lengths = steps[:, 0], steps[:, 1]
    row = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, starts.size - 1)
    part = np.clip((time_s - starts[row]) / lengths[row], 0.0, 1.0)
    # Wall by wall: of a million samples the arrays between are the largest.
    width, free = np.empty((len(closed), time_s.size)), np.empty((len(closed), time_s.size), bool)
    for i, (begin, end, first, second, is_free) in enumerate(zip(*np.split(steps[:, 2:].T, 5), strict=True)):
        free[i] = is_free[row] > 0.0
        path = rodas.interpolate(begin[row], end[row], first[row], second[row], part)
        width[i] = np.where(free[i], np.maximum(path, closed[i]), closed[i])
    return width, free


def _first_contact(walls: Walls, free: list[float], curves: list[Curve]) -> float:
    """The part of the step at which a free wall first reaches contact, 1 if none does."""
    each = zip(curves, walls.closed, walls.diameter, free, strict=True)
    return min(
        [_contact_of_one(curve, shut, _SNAP * listed) if is_free else 1.0 for curve, shut, listed, is_free in each]
    )


def _contact_of_one(curve: Curve, closed: float, slack: float) -> float:
    """The part of the step at which one wall reaches contact, 1 if it does not."""
    begin, end = curve[:2]
    high = 1.0
    if end >= closed - slack:
        # Open at the end, it may have touched on the way.
        high = 0.5
        end = rodas.interpolate(*curve, high)
        if end >= closed - slack:
            return 1.0
    if begin <= closed + slack:
        # It has just left contact: go on to a depth that still counts as touching.
        return max(1e-9, 0.5 * slack / (closed - end + slack))
    low = 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if rodas.interpolate(*curve, middle) < closed else (middle, high)
    return high
