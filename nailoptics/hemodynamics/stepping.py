"""One short step of many networks at once, on arrays: for fits and filters, which step thousands of them side by side.

ROS2 (Verwer, Spee, Blom, Hundsdorfer 1999, SIAM J. Sci. Comput. 20:1456) is linearly implicit, of order 2 and L-stable:
steps of 10 ms are stable however stiff the walls are. For one network, to a tolerance, take `respond`.
"""

from typing import Any

import numpy as np

from .walls import MasslessNetwork, Walls, massless_jacobian

_GAMMA = 1.0 - np.sqrt(0.5)


def step(
    walls: Walls,
    width: np.ndarray,
    outside: np.ndarray,
    high: Any,
    low: Any,
    *,
    step_s: float,
    outside_change: np.ndarray | None = None,
) -> np.ndarray:
    """Diameters D + x of every wall after one step, (N+1, *S) float. [m]

    walls : its constants may be arrays that broadcast to S.
    width : (N+1, *S) float. Diameters before it. [m]
    outside : (N+1, *S) float. Touch pressure on each wall at its start. [Pa]
    high, low : S float or one number. P_H and P_L. [Pa]
    outside_change : (N+1, *S) float. By how much the touch pressures grow over the step; None where they stay. [Pa]
    """
    walls = walls.stacked(width.ndim)
    area, stiffness, listed, closed = walls.area, walls.stiffness, walls.diameter, walls.closed
    force, gh = area * outside, _GAMMA * step_s
    load = force + stiffness * (width - listed)
    touching = width <= closed
    free = np.where(touching, 0.0, 1.0)
    network = MasslessNetwork(walls, width, free)
    pressures, speeds = network.rates(load, high, low)
    if touching.any() and (lifted := touching & (area * pressures > load)).any():
        free = np.where(lifted, 1.0, free)
        network = MasslessNetwork(walls, width, free)
        pressures, speeds = network.rates(load, high, low)
    jacobian = massless_jacobian(walls, width, free, pressures, high, low)
    drift: Any = 0.0
    if outside_change is not None:
        change = area * outside_change
        # What the touch's own change does to the speeds.
        drift, force = gh * network.speeds(change / step_s, 0.0, 0.0), force + change
    first = _solve(speeds + drift, jacobian, gh)
    middle = np.maximum(width + step_s * first, closed)
    later = MasslessNetwork(walls, middle, free).speeds(force + stiffness * (middle - listed), high, low)
    second = _solve(later - 2.0 * first - drift, jacobian, gh)
    return np.maximum(width + step_s * (1.5 * first + 0.5 * second), closed)


def _solve(rhs: np.ndarray, jacobian: tuple[np.ndarray, np.ndarray, np.ndarray], gh: float) -> np.ndarray:
    """The x of (I - gh (diag(d) + outer(p, q))) x = rhs, by the formula of Sherman and Morrison."""
    diagonal, left, right = jacobian
    inverse = 1.0 / (1.0 - gh * diagonal)
    weighted = right * inverse
    reach = np.add.reduce(weighted * rhs)
    loss = 1.0 - gh * np.add.reduce(weighted * left)
    return np.asarray(inverse * (rhs + gh * left * reach / loss))
