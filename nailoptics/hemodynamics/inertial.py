"""Walls with mass over time, the paper's six-state model: the check on the massless one."""

from typing import Any

import numpy as np

from ..errors import NotReachedError
from .drive import Drive
from .walls import Walls, inertial_pressures

# Stiffness of two walls in contact over that of one wall: large, so that contact is hard. [1]
_CONTACT_OVER_WALL = 1e6
# Steps of the differences for the Jacobian: in diameters over the listed ones, and in speeds over those per second.
_WIDTH_STEP, _SPEED_STEP = 1e-7, 1.0


def integrate(
    walls: Walls,
    drive: Drive,
    time_s: np.ndarray,
    start_m: np.ndarray,
    inputs: np.ndarray,
    *,
    rtol: float,
    contact: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diameters D + x [m], pressures [Pa] and contact (bool) of walls at given times, (N+1, T) each, by scipy's Radau.

    start_m : (N+1,) float. D + x at time_s[0], at rest. [m]
    inputs : (N+3, T) float. What `drive` gives at time_s: P_H, P_L and the touch pressure on each wall. [Pa]
    contact : Walls push back once closed (a spring a million times as stiff as the wall, with its damping); without,
        they pass through each other, as printed in the paper.

    Raises: NotReachedError if the integrator gives up.
    """
    from scipy.integrate import solve_ivp

    rest, closed, n = walls.diameter, walls.closed, walls.diameter.size

    def rates(time: float, state: np.ndarray, pieces: tuple[int, int]) -> np.ndarray:
        width, speed = state[:n] * rest, state[n:] * rest
        inputs = drive.at(time, *pieces)
        open_width = np.maximum(width, closed) if contact else width
        pressure = inertial_pressures(walls, open_width, speed, inputs[0], inputs[1])
        force = walls.area * (pressure - inputs[2:]) - walls.stiffness * (width - rest) - walls.damping * speed
        if contact:
            force += _CONTACT_OVER_WALL * walls.stiffness * np.maximum(closed - width, 0.0)
        return np.concatenate([speed, force / walls.mass]) / np.tile(rest, 2)

    # Rates are linear in the speeds, and smooth in the diameters: fixed differences serve, where adaptive ones stall.
    steps = np.diag(np.repeat([_WIDTH_STEP, _SPEED_STEP], n))

    def jacobian(time: float, state: np.ndarray, pieces: tuple[int, int]) -> np.ndarray:
        sides = [(rates(time, state + e, pieces), rates(time, state - e, pieces), 2.0 * e.sum()) for e in steps]
        return np.stack([(above - below) / distance for above, below, distance in sides], axis=1)

    state = np.concatenate([start_m / rest, np.zeros(n)])
    samples = np.empty((2 * n, time_s.size))
    for first, last in drive.stretches:
        begin, end = drive.starts[first], drive.ends[last]
        inside = (time_s >= begin) & (time_s <= end)
        samples_s = np.unique(np.append(time_s[inside], end))
        how: Any = {"args": ((first, last),), "jac": jacobian, "rtol": max(rtol, 3e-14), "atol": rtol}
        solution = solve_ivp(rates, (begin, end), state, "Radau", samples_s, **how)
        if not solution.success:
            raise NotReachedError(
                f"hemodynamics: the inertial model stopped at {begin:g} s ({solution.message}); raise rtol."
            )
        samples[:, inside] = solution.y[:, : np.count_nonzero(inside)]
        state = solution.y[:, -1]
    width, speed = np.split(samples * np.tile(rest, 2)[:, None], 2)
    touching = contact & (width <= closed[:, None])
    if contact:
        width = np.maximum(width, closed[:, None])
    return width, inertial_pressures(walls, width, speed, *inputs[:2]), touching
