"""Rosenbrock methods, for stiff equations, and one short step of many networks at once.

The Jacobian is a diagonal and a product of two vectors, so that a stage costs a sum and no matrix is solved.

References: Hairer and Wanner 1996, Solving Ordinary Differential Equations II, section IV.7.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..assets import read_toml
from .walls import MasslessNetwork, Walls

Jacobian = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Method:
    """Coefficients of a method in the form in which a stage needs no product with the Jacobian.

    gamma : of the diagonal. instants : fraction of the step at which each stage takes the slope. in_time : factor of
    each stage for the slope's derivative by time (d). states, slopes : weights of the earlier stages in the state (A)
    and in the slope (C). result : weights of the stages in the state after the step (m).
    """

    gamma: float
    instants: Sequence[float]
    in_time: Sequence[float]
    states: Sequence[Sequence[float]]
    slopes: Sequence[Sequence[float]]
    result: Sequence[float]


_COEFFICIENTS = dict(read_toml("rodas.toml"))
# Weights of its stages in the curve between.
RODAS_CURVE = _COEFFICIENTS.pop("curve")
# Stiffly accurate, L-stable, of order 4 (Hairer and Wanner 1996, Solving Ordinary Differential Equations II, IV.7).
RODAS = Method(**_COEFFICIENTS)
_GAMMA = 1.0 - 0.5**0.5
# L-stable, of order 2 (Verwer, Spee, Blom, Hundsdorfer 1999, SIAM J. Sci. Comput. 20:1456).
ROS2 = Method(
    gamma=_GAMMA,
    instants=(0.0, 1.0),
    in_time=(_GAMMA, -_GAMMA),
    states=((), (1.0 / _GAMMA,)),
    slopes=((), (-2.0 / _GAMMA,)),
    result=(1.5 / _GAMMA, 0.5 / _GAMMA),
)


def solver(jacobian: Jacobian, shift: Any) -> Callable[[np.ndarray], np.ndarray]:
    """What solves (shift - J) x = r for x of r, by the formula of Sherman and Morrison; jacobian : d, p, q of J =
    diag(d) + outer(p, q)."""
    diagonal, left, right = jacobian
    inverse = 1.0 / (shift - diagonal)
    spread, pull = left * inverse, right * inverse
    weight = 1.0 / (1.0 - np.add.reduce(right * spread))
    return lambda residual: residual * inverse + weight * np.add.reduce(pull * residual) * spread


def stages(
    method: Method,
    slope: Callable[[float, np.ndarray], np.ndarray],
    state: np.ndarray,
    *,
    slope_in_time: np.ndarray | None,
    solve: Callable[[np.ndarray], np.ndarray],
    step_s: Any,
) -> list[np.ndarray]:
    """The stages of one step, each of the shape of the state, (n, ...) float; `combine` makes states of them.

    slope : d state/d time as a function of the fraction of the step and the state.
    slope_in_time : its partial derivative by time at the start; None for 0.
    solve : the `solver` for the Jacobian at the start, with the shift 1 / (gamma step_s).
    """
    done: list[np.ndarray] = []
    inverse_step = 1.0 / step_s
    for part, a, c, d in zip(method.instants, method.states, method.slopes, method.in_time, strict=True):
        residual = combine(slope(part, combine(state, a, done)), [inverse_step * factor for factor in c], done)
        done.append(solve(residual if slope_in_time is None or d == 0.0 else residual + d * step_s * slope_in_time))
    return done


def combine(base: Any, factors: Sequence[Any], stages: Sequence[np.ndarray]) -> Any:
    """The base and the first stages times their factors."""
    for factor, stage in zip(factors, stages, strict=False):
        base = base + factor * stage
    return base


def interpolate(start: Any, end: Any, first: Any, second: Any, part: Any) -> Any:
    """The state at a part 0..1 of a step of RODAS, from its ends and the two sums of its stages by RODAS_CURVE."""
    rest = 1.0 - part
    return rest * start + part * (end + rest * (first + part * second))


def step(
    walls: Walls,
    diameter: np.ndarray,
    outside: np.ndarray,
    high: Any,
    low: Any,
    *,
    step_s: float,
    outside_change: np.ndarray | None = None,
) -> np.ndarray:
    """Diameters D + x of the massless walls of many networks after one step, (N+1, *S) float. [m]

    For fits and filters, which step thousands of networks side by side by some 10 ms, by ROS2.

    walls : its constants may be arrays that broadcast to S.
    diameter : (N+1, *S) float. Diameters before it. [m]
    outside : (N+1, *S) float. Touch pressure on each wall at its start. [Pa]
    high, low : S float or one number. P_H and P_L. [Pa]
    outside_change : (N+1, *S) float. By how much the touch pressures grow over the step; None where they stay. [Pa]
    """
    walls = walls.with_axes(diameter.ndim)
    area, stiffness, closed = walls.area, walls.stiffness, walls.closed
    change = None if outside_change is None else area * outside_change
    forces = {0.0: area * outside}
    forces[1.0] = forces[0.0] if change is None else forces[0.0] + change
    load = forces[0.0] + stiffness * (diameter - walls.diameter)
    touching = diameter <= closed
    free = np.where(touching, 0.0, 1.0)
    network = MasslessNetwork(walls, diameter, free)
    pressures, speeds = network.rates(load, high, low)
    if touching.any() and (lifted := touching & (area * pressures > load)).any():
        free = np.where(lifted, 1.0, free)
        network = MasslessNetwork(walls, diameter, free)
        pressures, speeds = network.rates(load, high, low)

    def slope(part: float, state: np.ndarray) -> np.ndarray:
        if part == 0.0:
            return speeds
        state = np.maximum(state, closed)
        later = MasslessNetwork(walls, state, free)
        return later.speeds(forces[part] + stiffness * (state - walls.diameter), high, low)

    by_time = None if change is None else network.speeds(change / step_s, 0.0, 0.0)
    solve = solver(network.jacobian(pressures, high, low), 1.0 / (ROS2.gamma * step_s))
    done = stages(ROS2, slope, diameter, slope_in_time=by_time, solve=solve, step_s=step_s)
    return np.maximum(combine(diameter, ROS2.result, done), closed)
