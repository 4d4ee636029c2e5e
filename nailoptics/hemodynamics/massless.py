"""The massless model over time: adaptive steps of RODAS with error control, and walls that stop at contact.

A wall in contact stands still while the load presses it on; it leaves when the blood lifts it. Both instants are
located, so that between them the equations are smooth and the method keeps its order.

A step is written as formulas on arrays, yet for a few vessels an interpreter would spend most of its time on their
overhead: the formulas run once on symbols, and become code on floats without loops.
"""

import functools
import logging
import math
import re
from array import array
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import NotReachedError
from .drive import Drive
from .rosenbrock import RODAS, RODAS_CURVE, combine, interpolate, solver, stages
from .walls import MasslessNetwork, Walls

_LOG = logging.getLogger(__name__)
MOST_STEPS = 2_000_000
# Samples whose pressures are worked out at once: what is between fills the processor's cache, not the memory.
_AT_ONCE = 1 << 14
_FIRST_STEP_S = 1e-3
_EPS = float(np.finfo(float).eps)
# Of the listed diameter: closer than this a wall counts as touching.
_SNAP = 1e-9
# A step that would end no further than this beyond its piece of the drive, in lengths of what is left of it, stays
# inside: there the drive's slope is exact.
_BEYOND = 1.5
# Parts of a step at which the inputs are needed: those of the stages, and the middle.
_INSTANTS = (*dict.fromkeys(RODAS.instants), 0.5)
# Weight of the defect within a step beside the error at its end: of ordinary steps the end decides.
_DEFECT_WEIGHT = 0.3

# One wall over a step, as `interpolate` takes it.
Curve = tuple[float, float, float, float]


class _Symbol:
    """Stands for a float while a function is unrolled: each operation on it becomes a line of code, once."""

    def __init__(self, name: str, lines: dict[str, "_Symbol"]) -> None:
        self.name, self.lines = name, lines

    def __repr__(self) -> str:
        return self.name

    def write(self, code: str) -> "_Symbol":
        """The symbol of the value of an expression."""
        return self.lines.setdefault(code, _Symbol(f"v{len(self.lines)}", self.lines))

    def __neg__(self) -> "_Symbol":
        return self.write(f"-{self}")

    def __abs__(self) -> "_Symbol":
        return self.write(f"{self} if {self} > 0.0 else -{self}")


def _operator(code: str) -> Callable[[_Symbol, Any], Any]:
    # An array beside a symbol works element by element, by its own operator.
    return lambda a, b: NotImplemented if isinstance(b, np.ndarray) else a.write(code.format(a, b))


for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}.items():
    setattr(_Symbol, f"__{_name}__", _operator(f"{{0}} {_sign} {{1}}"))
    setattr(_Symbol, f"__r{_name}__", _operator(f"{{1}} {_sign} {{0}}"))
# The larger of two symbols, one by one of arrays.
_larger = np.frompyfunc(lambda a, b: a.write(f"{a} if {a} > {b} else {b}"), 2, 1)


def _unroll(function: Callable[..., list[Any]], *shapes: tuple[int, ...]) -> Callable[..., Any]:
    """The function, of + - * / abs and `_larger` of arrays of given shapes alone, compiled for lists (of one axis) and
    floats (of none)."""
    lines: dict[str, _Symbol] = {}
    names, arguments, unpack = [f"a{i}" for i in range(len(shapes))], [], []
    for name, shape in zip(names, shapes, strict=True):
        items = [_Symbol(f"{name}_{item}", lines) for item in range(math.prod(shape))]
        arguments.append(np.array(items, dtype=object).reshape(shape)[()])
        unpack.append(f"{items if shape else items[0]} = {name}")
    result = str([np.asarray(output, dtype=object).tolist() for output in function(*arguments)])
    code_of = {symbol.name: code for code, symbol in lines.items()}
    uses = Counter(name for code in [*lines, result, result] for name in re.findall(r"\bv\d+", code))

    def in_place(code: str) -> str:
        """The code with what is used once written out where it is used."""
        return re.sub(r"\bv\d+", lambda m: m[0] if uses[m[0]] > 1 else f"({in_place(code_of[m[0]])})", code)

    body = [*unpack, *(f"{name} = {in_place(code)}" for name, code in code_of.items() if uses[name] > 1)]
    space: dict[str, Any] = {}
    exec("\n    ".join([f"def unrolled({', '.join(names)}):", *body, f"return {in_place(result)}"]), space)
    unrolled: Callable[..., Any] = space["unrolled"]
    return unrolled


@functools.cache
def _unrolled(units: int) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """`_try_step` and `_lift` for a number of capillary units."""
    walls, channels = (units + 1,), (units + 3,)
    constants = [walls] * 7 + [(units,), walls]
    inputs = [channels] * (len(_INSTANTS) + 1)
    return (
        _unroll(_try_step, *constants, *inputs, walls, walls, (), ()),
        _unroll(_lift, *constants, channels, walls, walls),
    )


def _load(walls: Walls, inputs: np.ndarray, diameter: np.ndarray) -> np.ndarray:
    """Force that presses each wall inward against the blood. [N]"""
    walls = walls.with_axes(diameter.ndim)
    return walls.area * inputs[2:] + walls.stiffness * (diameter - walls.diameter)


def _lift(*arguments: Any) -> list[Any]:
    """Force that would move each wall outwards if nothing held it: of constants, inputs, diameters, who is free. [N]"""
    *constants, inputs, diameter, free = arguments
    walls = Walls(*constants)
    load = _load(walls, inputs, diameter)
    pressures, _ = MasslessNetwork(walls, _larger(diameter, walls.closed), free).rates(load, inputs[0], inputs[1])
    return list(walls.area * pressures - load)


def _try_step(*arguments: Any) -> list[Any]:
    """A step of one length: its error over what is allowed, how near a wall comes to contact, and its curve; of
    constants, inputs at each of _INSTANTS, their slopes, diameters, who is free, the step and rtol."""
    *instants, change, diameter, free, step_s, rtol = arguments[9:]
    walls, inputs = Walls(*arguments[:9]), dict(zip(_INSTANTS, instants, strict=True))

    network, (high, low) = MasslessNetwork(walls, diameter, free), inputs[0.0][:2]
    pressures, speeds = network.rates(_load(walls, inputs[0.0], diameter), high, low)
    by_time = network.speeds(walls.area * change[2:], change[0], change[1])

    def slope(part: float, state: np.ndarray) -> np.ndarray:
        """A wall that a stage has pushed past contact lets blood through as there."""
        if part == 0.0:
            return speeds
        later = MasslessNetwork(walls, _larger(state, walls.closed), free)
        return later.speeds(_load(walls, inputs[part], state), inputs[part][0], inputs[part][1])

    inverse_step = 1.0 / step_s
    solve = solver(network.jacobian(pressures, high, low), inverse_step / RODAS.gamma)
    done = stages(RODAS, slope, diameter, slope_in_time=by_time, solve=solve, step_s=step_s)
    after = combine(diameter, RODAS.result, done)
    first, second = (combine(factors[0] * done[0], factors[1:], done[1:]) for factors in RODAS_CURVE)
    # In a long stiff step the ends can be right and the curve between them wrong: its defect in the middle, brought
    # back to an error of the state, counts too.
    middle = interpolate(diameter, after, first, second, 0.5)
    between = solve((after - diameter + 0.25 * second) * inverse_step - slope(0.5, middle))
    error = _larger(abs(done[-1]), _DEFECT_WEIGHT * abs(between))
    excess = _larger.reduce(error / (rtol * _larger(_larger(diameter, after), walls.diameter)))
    depth = _larger.reduce(_larger(walls.closed - middle, walls.closed - after) / walls.diameter)
    # A sum, other than a maximum, cannot lose a number that is none.
    return [excess + 0.0 * np.add.reduce(after), depth, after, first, second]


class _Motion:
    """The walls on their way: where they are, which are in contact, and every step so far."""

    def __init__(self, walls: Walls, drive: Drive, start_m: np.ndarray, *, rtol: float) -> None:
        self.drive, self.rtol = drive, float(rtol)
        self.constants = [constant.tolist() for constant in walls.constants]
        self.closed, self.snap_m = walls.closed.tolist(), (_SNAP * walls.diameter).tolist()
        self.diameter: list[float] = np.maximum(start_m, walls.closed).tolist()
        self.free, self.piece = [1.0] * len(self.diameter), 0
        self.time, self.step_s = drive.starts[0], min(_FIRST_STEP_S, drive.ends[-1] - drive.starts[0])
        # A failed step this short cannot move the time: it would be repeated for ever.
        self.least_step_s = 1e-3 * _EPS * max(abs(drive.starts[0]), abs(drive.ends[-1]))
        self.steps = array("d")
        self._try_step, self._lift = _unrolled(len(self.diameter) - 1)

    def snap(self) -> bool:
        """Put free walls that all but touch into contact; True if there are any."""
        near = [i for i, free in enumerate(self.free) if free and self.diameter[i] - self.closed[i] <= self.snap_m[i]]
        for i in near:
            self.diameter[i] = self.closed[i]
        return bool(near)

    def settle(self) -> None:
        """Choose which of the touching walls are held: the contact problem at one instant."""
        touching = [d <= c for d, c in zip(self.diameter, self.closed, strict=True)]
        self.free = [0.0 if t else 1.0 for t in touching]
        if not any(touching):
            return
        inputs = self.drive.at(self.time, self.piece, self.piece)
        for _ in range(2 * len(touching) + 2):
            lift = self._lift(*self.constants, inputs, self.diameter, self.free)
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
            proposed_s, left_s = self.step_s, ends[until] - self.time
            at_end = proposed_s * (1.0 + 1e-9) >= left_s or self.time + proposed_s >= ends[until]
            step_s = left_s if at_end else proposed_s
            change = self.drive.slope(self.time, piece, smooth=until > piece)
            inputs = self.drive.read([self.time + part * step_s for part in _INSTANTS], piece, until)
            try:
                excess, depth, after, first, second = self._try_step(
                    *self.constants, *inputs, change, self.diameter, self.free, step_s, self.rtol
                )
            except ZeroDivisionError:
                # The step hit a pole of the method's stability function, at a growing mode: any other will do.
                excess = math.inf
            if not excess <= 1.0:
                if step_s < self.least_step_s:
                    raise _not_reached(f"stops at {self.time:g} s, where no step is short enough for the tolerance")
                # The error goes with the fourth power of the step: aim a little below what is allowed.
                self.step_s = step_s * (max(0.2, min(0.9, 0.9 * excess**-0.25)) if excess < 1e6 else 0.2)
                continue
            part = 1.0
            if depth > _SNAP or 0.0 in self.free:
                part = self._contact_changes(step_s, list(zip(self.diameter, after, first, second, strict=True)), until)
            if part < 1.0:
                self.step_s = part * step_s
                continue
            self.steps.extend([self.time, step_s, *self.diameter, *after, *first, *second, *self.free])
            self.time = ends[until] if at_end else self.time + step_s
            while self.piece < last and ends[self.piece] <= self.time:
                self.piece += 1
            scale = 5.0 if excess < 1e-3 else 0.9 * excess**-0.25
            self.step_s = max(proposed_s, step_s * scale) if at_end and scale >= 1.0 else step_s * scale
            self.diameter = after
            return

    def _contact_changes(self, step_s: float, curves: list[Curve], until: int) -> float:
        """Fraction of a step at which a free wall first reaches contact or the blood lifts a held one; 1 without."""

        def lifted(part: float) -> bool:
            inputs = self.drive.at(self.time + part * step_s, self.piece, until)
            force = self._lift(*self.constants, inputs, [interpolate(*curve, part) for curve in curves], self.free)
            return any(f > 0.0 and not free for f, free in zip(force, self.free, strict=True))

        walls = zip(curves, self.closed, self.snap_m, self.free, strict=True)
        part = min(_contact(curve, shut, slack) if free else 1.0 for curve, shut, slack, free in walls)
        if part == 1.0 and lifted(1.0):
            part = _first_part(lifted, 1.0, within=1e-4)
            part = 1.0 if part > 1.0 - 1e-3 else part
        return part


def _not_reached(how: str) -> NotReachedError:
    cure = "raise rtol, or take constants of the vessels nearer to those listed"
    return NotReachedError(f"hemodynamics: the response {how}; {cure}.")


def integrate(
    walls: Walls, drive: Drive, time_s: np.ndarray, start_m: np.ndarray, inputs: np.ndarray | None, *, rtol: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diameters D + x [m], pressures [Pa] and contact (bool) of walls at given times, (N+1, T) each.

    start_m : (N+1,) float. D + x at time_s[0]. [m]
    inputs : (N+3, T) float. What `drive` gives at time_s: P_H, P_L and the touch pressure on each wall; None where no
        pressures are needed, which are then (N+1, 0). [Pa]
    rtol : Allowed local error of a step, relative to the diameter or the listed one if that is larger. [1]

    Raises: NotReachedError if the tolerance needs more than `MOST_STEPS` steps.
    """
    motion, taken = _Motion(walls, drive, start_m, rtol=rtol), 0
    for motion.piece, last in drive.stretches:
        motion.settle()
        while motion.time < drive.ends[last]:
            motion.step(last)
            taken += 1
            if taken > MOST_STEPS:
                raise _not_reached(f"needs more than {MOST_STEPS} steps (reached {motion.time:g} s)")
            if motion.snap() or 0.0 in motion.free:
                motion.settle()
    _LOG.debug("massless model: %d steps over %g s", taken, drive.ends[-1] - drive.starts[0])
    diameter, free = _sample(np.frombuffer(motion.steps).reshape(taken, -1), time_s, walls.closed)
    pressure = np.empty((len(diameter), 0 if inputs is None else time_s.size))
    for start in range(0, pressure.shape[1], _AT_ONCE):
        assert inputs is not None
        given, at, loose = (rows[:, start : start + _AT_ONCE] for rows in (inputs, diameter, free))
        network = MasslessNetwork(walls, at, loose.astype(float))
        pressure[:, start : start + _AT_ONCE] = network.rates(_load(walls, given, at), given[0], given[1])[0]
    return diameter, pressure, ~free


def _sample(steps: np.ndarray, time_s: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accepted steps, a row each, read at given times: diameters [m], and which walls are free of contact, (N+1, T)."""
    starts, lengths = steps[:, 0], steps[:, 1]
    row = np.clip(np.searchsorted(starts, time_s, side="right") - 1, 0, starts.size - 1)
    part = np.clip((time_s - starts[row]) / lengths[row], 0.0, 1.0)
    # Wall by wall: of a million samples the arrays between are the largest.
    diameter, free = np.empty((len(closed), time_s.size)), np.empty((len(closed), time_s.size), bool)
    for i, (begin, end, first, second, is_free) in enumerate(zip(*np.split(steps[:, 2:].T, 5), strict=True)):
        free[i] = is_free[row] > 0.0
        path = interpolate(begin[row], end[row], first[row], second[row], part)
        diameter[i] = np.where(free[i], np.maximum(path, closed[i]), closed[i])
    return diameter, free


def _contact(curve: Curve, closed: float, slack: float) -> float:
    """The fraction of the step at which a wall reaches contact, 1 if it does not."""
    begin, end = curve[:2]
    high = 1.0
    if end >= closed - slack:
        # Open at the end, it may have touched on the way.
        high = 0.5
        end = interpolate(*curve, high)
        if end >= closed - slack:
            return 1.0
    if begin <= closed + slack:
        # It has just left contact: go on to a depth that still counts as touching.
        return max(1e-9, 0.5 * slack / (closed - end + slack))
    return _first_part(lambda part: interpolate(*curve, part) < closed, high, within=1e-12)


def _first_part(holds: Callable[[float], bool], high: float, *, within: float) -> float:
    """The fraction of a step, no more than `within` too high, from which on something holds, as it does at `high`."""
    low = 0.0
    while high - low > within:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
