"""The massless model over time: adaptive steps with error control, and walls that stop at contact.

A wall in contact stands still while the load presses it on; it leaves when the blood lifts it. Both instants are
located, so that between them the equations are smooth and the method keeps its order.
"""

import logging

import numpy as np

from ..errors import NotReachedError
from . import rodas
from .drive import Drive
from .rodas import Vector
from .walls import Walls, massless_jacobian, massless_rates

_LOG = logging.getLogger(__name__)
_MOST_STEPS = 2_000_000
_FIRST_STEP_S = 1e-3
# Of the listed diameter: closer than this a wall counts as touching.
_SNAP = 1e-9

# One wall over a step, as `rodas.interpolate` takes it.
Curve = tuple[float, float, float, float]


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
        """Speed of each wall. [m/s]"""
        inputs = self.drive.at(time)
        load = self._load(inputs, width)
        return massless_rates(self.walls, self._open(width), load, self.free, inputs[0], inputs[1])[1]

    def lift(self, time: float, width: list[float]) -> list[float]:
        """Force that would move each wall outwards if nothing held it. [N]"""
        inputs = self.drive.at(time)
        load = self._load(inputs, width)
        pressures, _ = massless_rates(self.walls, self._open(width), load, self.free, inputs[0], inputs[1])
        return [a * p - f for a, p, f in zip(self.walls.area, pressures, load, strict=True)]

    def linearise(self, time: float, width: Vector) -> tuple[Vector, Vector, tuple[Vector, Vector, Vector]]:
        """Speeds, their derivatives by time, and by the widths as diag(d) + outer(p, q)."""
        inputs = self.drive.at(time)
        load = self._load(inputs, width)
        pressures, speeds = massless_rates(self.walls, width, load, self.free, inputs[0], inputs[1])
        change = self.drive.slope(time)
        rise = [a * f for a, f in zip(self.walls.area, change[2:], strict=True)]
        _, in_time = massless_rates(self.walls, width, rise, self.free, change[0], change[1])
        return speeds, in_time, massless_jacobian(self.walls, width, self.free, pressures, inputs[0], inputs[1])

    def snap(self, width: list[float]) -> bool:
        """Put free walls that all but touch into contact; True if there are any."""
        walls, touched = self.walls, False
        for i, c in enumerate(walls.closed):
            if self.free[i] and width[i] - c <= _SNAP * walls.diameter[i]:
                width[i], touched = c, True
        return touched

    def settle(self, time: float, width: list[float]) -> None:
        """Choose which of the touching walls are held: the contact problem at one instant."""
        touching = [d <= c for d, c in zip(width, self.walls.closed, strict=True)]
        self.free = [0.0 if t else 1.0 for t in touching]
        if not any(touching):
            return
        for _ in range(2 * len(touching) + 2):
            lift = self.lift(time, width)
            wrong = [(abs(f), i) for i, f in enumerate(lift) if touching[i] and (f > 0.0) != (self.free[i] > 0.0)]
            if not wrong:
                return
            i = max(wrong)[1]
            self.free[i] = 1.0 - self.free[i]


def integrate(
    walls: Walls,
    drive: Drive,
    time_s: np.ndarray,
    start_m: np.ndarray,
    inputs: np.ndarray,
    *,
    rtol: float,
    most_steps: int = _MOST_STEPS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diameters D + x [m], pressures [Pa] and contact (bool) of walls at given times, (N+1, T) each.

    start_m : (N+1,) float. D + x at time_s[0]. [m]
    inputs : (N+3, T) float. What `drive` gives at time_s: P_H, P_L and the touch pressure on each wall. [Pa]
    rtol : Allowed local error of a step, relative to the diameter or the listed one if that is larger. [1]

    Raises: NotReachedError if the tolerance needs more than `most_steps` steps.
    """
    system = _System(walls, drive)
    steps: list[list[float]] = []
    width = [max(float(d), c) for d, c in zip(start_m, walls.closed, strict=True)]
    time, end = drive.stops[0], drive.stops[-1]
    step_s = min(_FIRST_STEP_S, end - time)
    for stop in drive.stops[1:]:
        system.settle(time, width)
        while time < stop:
            step_s, after, first, second, next_step_s = _step(system, time, width, step_s, stop=stop, rtol=rtol)
            steps.append([time, step_s, *width, *after, *first, *second, *system.free])
            if len(steps) > most_steps:
                raise NotReachedError(
                    f"hemodynamics: the response needs more than {most_steps} steps (reached {time:g} s); "
                    "raise rtol or soften the parameters."
                )
            time = stop if step_s == stop - time else time + step_s
            width, step_s = after, next_step_s
            if system.snap(width) or 0.0 in system.free:
                system.settle(time, width)
    _LOG.debug("massless model: %d steps over %g s", len(steps), end - drive.stops[0])
    diameters, free = _sample(np.array(steps), time_s, walls.closed)
    high, low, *outside = inputs
    each = zip(walls.area, outside, walls.stiffness, diameters, walls.diameter, strict=True)
    load = [a * f + k * (d - rest) for a, f, k, d, rest in each]
    return diameters, np.array(massless_rates(walls, diameters, load, free, high, low)[0]), free == 0.0


def _sample(steps: np.ndarray, time_s: np.ndarray, closed: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Accepted steps, a row each, read at given times."""
    starts, lengths = steps[:, 0], steps[:, 1]
    row = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, starts.size - 1)
    part = np.clip((time_s - starts[row]) / lengths[row], 0.0, 1.0)[:, None]
    begin, end, first, second, free = (block[row] for block in np.split(steps[:, 2:], 5, axis=1))
    width = (1.0 - part) * begin + part * (end + (1.0 - part) * (first + part * second))
    width = np.where(free > 0.0, np.maximum(width, closed), closed)
    return width.T.copy(), free.T.copy()


def _step(
    system: _System, time: float, width: Vector, step_s: float, *, stop: float, rtol: float
) -> tuple[float, Vector, Vector, Vector, float]:
    """Shorten a step until its error is allowed and no wall meets or leaves another before its end.

    Returns: the step, the walls after it, the two vectors of `rodas.interpolate`, and the step to try next.
    """
    slope, in_time, jacobian = system.linearise(time, width)
    while True:
        wanted_s = step_s
        at_stop = time + step_s * (1.0 + 1e-9) >= stop
        if at_stop:
            step_s = stop - time
        after, error, first, second = rodas.step(
            system.slope, time, width, slope_now=slope, slope_in_time=in_time, jacobian=jacobian, step_s=step_s
        )
        listed = system.walls.diameter
        size = max([abs(e) / (rtol * max(d, a, r)) for e, d, a, r in zip(error, width, after, listed, strict=True)])
        if not size < float("inf"):
            size = 1e6
        # The error goes with the fourth power of the step: aim a little below what is allowed, and not far at once.
        scale = 5.0 if size < 1e-3 else max(0.2, 0.9 * size**-0.25)
        if size > 1.0:
            step_s *= min(scale, 0.9)
            continue
        curves = list(zip(width, after, first, second, strict=True))
        part = _first_contact(system, curves)
        if part == 1.0:
            part = _first_release(system, time, step_s, curves)
        if part == 1.0:
            next_step_s = max(wanted_s, step_s * scale) if at_stop and scale >= 1.0 else step_s * scale
            return step_s, after, first, second, next_step_s
        step_s *= part


def _first_contact(system: _System, curves: list[Curve]) -> float:
    """The part of the step at which a free wall first reaches contact, 1 if none does."""
    each = zip(curves, system.walls.closed, system.walls.diameter, system.free, strict=True)
    return min([_contact_of_one(curve, shut, _SNAP * listed) if free else 1.0 for curve, shut, listed, free in each])


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


def _first_release(system: _System, time: float, step_s: float, curves: list[Curve]) -> float:
    """The part of the step at which the blood first lifts a held wall, 1 if it lifts none."""
    held = [i for i, free in enumerate(system.free) if not free]
    if not held:
        return 1.0

    def lifted(part: float) -> bool:
        force = system.lift(time + part * step_s, [rodas.interpolate(*curve, part) for curve in curves])
        return any(force[i] > 0.0 for i in held)

    if not lifted(1.0):
        return 1.0
    low, high = 0.0, 1.0
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if lifted(middle) else (middle, high)
    return 1.0 if high > 1.0 - 1e-3 else high
