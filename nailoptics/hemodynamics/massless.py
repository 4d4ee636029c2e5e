"""The massless model over time: adaptive steps with error control, and walls that stop at contact.

A wall in contact stands still while the load presses it on; it leaves when the blood lifts it. Both instants are
located, so that between them the equations are smooth and the method keeps its order.
"""

from __future__ import annotations

import dataclasses
import logging

import numpy as np

from ..errors import NotReachedError
from . import rodas
from .drive import Drive
from .walls import Walls, massless_jacobian, massless_rates

_LOG = logging.getLogger(__name__)
_MOST_STEPS = 2_000_000
_SNAP = 1e-9  # of the listed diameter: closer than this a wall counts as touching


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """Walls over time.

    width_m : (N+1, T) float. D + x of each unit and the vein. [m]
    free : (N+1, T) float. 0 where the wall is in contact, else 1.
    steps : int. Accepted steps.
    """

    width_m: np.ndarray
    free: np.ndarray
    steps: int


class _System:
    """The massless equations with a given set of walls in contact."""

    def __init__(self, walls: Walls, drive: Drive) -> None:
        self.walls, self.drive = walls, drive
        self.free = [1.0] * len(walls.area)

    def _load(self, inputs: list[float], width: list[float]) -> list[float]:
        w = self.walls
        return [
            a * f + k * (d - rest)
            for a, f, k, d, rest in zip(w.area, inputs[2:], w.stiffness, width, w.diameter, strict=True)
        ]

    def _open(self, width: list[float]) -> list[float]:
        return [d if d > c else c for d, c in zip(width, self.walls.closed, strict=True)]

    def slope(self, time: float, width: list[float]) -> list[float]:
        inputs = self.drive.at(time)
        return massless_rates(
            self.walls, self._open(width), self._load(inputs, width), self.free, inputs[0], inputs[1]
        )[1]

    def lift(self, time: float, width: list[float]) -> list[float]:
        """Force that would move each wall outwards if nothing held it. [N]"""
        inputs = self.drive.at(time)
        load = self._load(inputs, width)
        pressures, _ = massless_rates(self.walls, self._open(width), load, self.free, inputs[0], inputs[1])
        return [a * p - f for a, p, f in zip(self.walls.area, pressures, load, strict=True)]

    def linearise(
        self, time: float, width: list[float]
    ) -> tuple[list[float], list[float], tuple[list[float], list[float], list[float]]]:
        inputs = self.drive.at(time)
        load = self._load(inputs, width)
        pressures, speeds = massless_rates(self.walls, width, load, self.free, inputs[0], inputs[1])
        change = self.drive.slope(time)
        rise = [a * f for a, f in zip(self.walls.area, change[2:], strict=True)]
        _, in_time = massless_rates(self.walls, width, rise, self.free, change[0], change[1])
        return speeds, in_time, massless_jacobian(self.walls, width, self.free, pressures, inputs[0], inputs[1])

    def settle(self, time: float, width: list[float]) -> None:
        """Choose which of the touching walls are held: the contact problem at one instant."""
        touching = [d <= c for d, c in zip(width, self.walls.closed, strict=True)]
        self.free = [0.0 if t else 1.0 for t in touching]
        if not any(touching):
            return
        for _ in range(2 * len(touching) + 2):
            lift = self.lift(time, width)
            wrong = [
                (abs(force), i) for i, force in enumerate(lift) if touching[i] and (force > 0.0) != (self.free[i] > 0.0)
            ]
            if not wrong:
                return
            i = max(wrong)[1]
            self.free[i] = 1.0 - self.free[i]


def integrate(
    walls: Walls, drive: Drive, time_s: np.ndarray, start_m: np.ndarray, *, rtol: float, most_steps: int = _MOST_STEPS
) -> Trajectory:
    """Return the walls at given times.

    start_m : (N+1,) float. D + x at time_s[0]. [m]
    rtol : float. Allowed local error of a step, relative to the diameter or the listed one if that is larger. [1]

    Raises
    ------
    NotReachedError
        If the tolerance needs more than ``most_steps`` steps.
    """
    system = _System(walls, drive)
    closed, rest = walls.closed, walls.diameter
    time, end = drive.stops[0], drive.stops[-1]
    width = [max(float(d), c) for d, c in zip(start_m, closed, strict=True)]
    record = _Record()
    h = min(1e-3, end - time)
    for stop in drive.stops[1:]:
        system.settle(time, width)
        at_stop = False
        while not at_stop:
            slope, in_time, jacobian = system.linearise(time, width)
            while True:
                at_stop = time + h * (1.0 + 1e-9) >= stop
                wanted = h
                if at_stop:
                    h = stop - time
                after, error, first, second = rodas.step(
                    system.slope,
                    time=time,
                    state=width,
                    slope_now=slope,
                    slope_in_time=in_time,
                    jacobian=jacobian,
                    step_s=h,
                )
                size = max(
                    [abs(e) / (rtol * max(d, a, r)) for e, d, a, r in zip(error, width, after, rest, strict=True)]
                )
                if not size < float("inf"):
                    size = 1e6
                scale = 5.0 if size < 1e-3 else max(0.2, 0.9 * size**-0.25)
                if size > 1.0:
                    h *= min(scale, 0.9)
                    continue
                part = _first_contact(system, width, after, first, second)
                if part < 1.0:
                    h *= part
                    continue
                part = _first_release(system, time, h, width, after, first, second)
                if part < 1.0:
                    h *= part
                    continue
                break
            record.add(time, h, width, after, first, second, system.free)
            if record.count > most_steps:
                raise NotReachedError(
                    f"hemodynamics: the response needs more than {most_steps} steps (reached {time:g} s); "
                    "raise rtol or soften the parameters."
                )
            time = stop if at_stop else time + h
            touched = False
            for i, c in enumerate(closed):
                if system.free[i] and after[i] - c <= _SNAP * rest[i]:
                    after[i], touched = c, True
            width = after
            if touched or 0.0 in system.free:
                system.settle(time, width)
            h = max(wanted, h * scale) if at_stop and scale >= 1.0 else h * scale
    _LOG.debug("massless model: %d steps over %g s", record.count, end - drive.stops[0])
    return record.sample(time_s, closed)


def _first_contact(
    system: _System, width: list[float], after: list[float], first: list[float], second: list[float]
) -> float:
    """Return the part of the step at which a free wall first reaches contact, 1 if none does."""
    walls, found = system.walls, 1.0
    for i, c in enumerate(walls.closed):
        if not system.free[i]:
            continue
        slack = _SNAP * walls.diameter[i]
        begin, end = width[i], after[i]
        if end >= c - slack:
            end_part = 0.5
            end = rodas.interpolate(begin, after[i], first[i], second[i], end_part)
            if end >= c - slack:
                continue
        else:
            end_part = 1.0
        if begin <= c + slack:
            # It has just left contact: go on to a depth that still counts as touching.
            found = min(found, max(1e-9, 0.5 * slack / (c - end + slack)))
            continue
        low, high = 0.0, end_part
        for _ in range(40):
            middle = 0.5 * (low + high)
            if rodas.interpolate(begin, after[i], first[i], second[i], middle) < c:
                high = middle
            else:
                low = middle
        found = min(found, high)
    return found


def _first_release(
    system: _System,
    time: float,
    step_s: float,
    width: list[float],
    after: list[float],
    first: list[float],
    second: list[float],
) -> float:
    """Return the part of the step at which the blood first lifts a held wall, 1 if it lifts none."""
    held = [i for i, free in enumerate(system.free) if not free]
    if not held:
        return 1.0

    def lifted(part: float) -> bool:
        here = [rodas.interpolate(a, b, k1, k2, part) for a, b, k1, k2 in zip(width, after, first, second, strict=True)]
        force = system.lift(time + part * step_s, here)
        return any(force[i] > 0.0 for i in held)

    if not lifted(1.0):
        return 1.0
    low, high = 0.0, 1.0
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if lifted(middle) else (middle, high)
    return 1.0 if high > 1.0 - 1e-3 else high


class _Record:
    """Accepted steps, to be read at any time afterwards."""

    def __init__(self) -> None:
        self._rows: list[list[float]] = []

    @property
    def count(self) -> int:
        return len(self._rows)

    def add(self, time: float, step_s: float, *vectors: list[float]) -> None:
        row = [time, step_s]
        for vector in vectors:
            row += vector
        self._rows.append(row)

    def sample(self, time_s: np.ndarray, closed: tuple[float, ...]) -> Trajectory:
        table = np.array(self._rows)
        starts, steps = table[:, 0], table[:, 1]
        row = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, starts.size - 1)
        part = np.clip((time_s - starts[row]) / steps[row], 0.0, 1.0)[:, None]
        begin, end, first, second, free = (block[row] for block in np.split(table[:, 2:], 5, axis=1))
        width = (1.0 - part) * begin + part * (end + (1.0 - part) * (first + part * second))
        width = np.where(free > 0.0, np.maximum(width, closed), closed)
        return Trajectory(width_m=width.T.copy(), free=free.T.copy(), steps=self.count)
