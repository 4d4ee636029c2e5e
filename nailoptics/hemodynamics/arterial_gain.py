"""How far small waves of the arterial pressure move the vessels, by their frequency, while a touch is held."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite
from ..errors import InputError
from .parameters import Parameters
from .steady import solve_walls, wall_pressures
from .walls import Walls, build_walls, massless_jacobian, massless_rates
from .zones import PAPER_ZONES, Zones


def arterial_gain_m_per_pa(
    parameters: Parameters, frequency_hz: ArrayLike, *, pressure_pa: ArrayLike, zones: Zones = PAPER_ZONES
) -> np.ndarray:
    """Change of every capillary unit's diameter with a small wave of P_H, (N, F) complex. [m/Pa]

    frequency_hz : (F,) float, above 0. The slowest waves find the steady states' own change. [Hz]
    pressure_pa : (M,) float. The touch pressures that are held; at P_H of the parameters. [Pa]
    zones : Units along the nail and the reach of each pressure.

    The absolute value is the amplitude of a unit's diameter over that of the wave, the angle its phase. The massless
    network, linearised where it rests: a wall that touches does not move.

    Raises: InputError for a frequency that is not positive and finite.
    """
    frequency = np.atleast_1d(finite("frequency_hz", frequency_hz))
    if np.any(frequency <= 0.0):
        raise InputError(
            f"frequency_hz must be above 0, got {frequency.min():g}; take steady_state for a pressure held."
        )
    outside = wall_pressures(zones, np.asarray(pressure_pa, dtype=float)[:, None])
    ends = np.array([parameters.arterial_pressure_pa]), np.array([parameters.venous_pressure_pa])
    return linear_response(build_walls(parameters, zones), frequency, outside, *ends)[:-1]


def linear_response(
    walls: Walls, frequency_hz: np.ndarray, outside_pa: np.ndarray, high_pa: np.ndarray, low_pa: np.ndarray
) -> np.ndarray:
    """Change of the diameter of every wall with a small wave of P_H, (N+1, F) complex. [m/Pa]

    frequency_hz : (F,) float; 0 is a change that is held. outside_pa : (N+1, 1) float. Touch pressure on each wall.
    high_pa, low_pa : (1,) float. P_H and P_L.
    """
    width, pressure = solve_walls(walls, outside_pa, high_pa, low_pa)
    free = np.where(width > np.array(walls.closed)[:, None] * (1.0 + 1e-9), 1.0, 0.0)
    diagonal, left, right = (
        np.array(part)[:, 0] for part in massless_jacobian(walls, width, free, pressure, high_pa, low_pa)
    )
    # Speeds are linear in P_H.
    _, by_high = massless_rates(walls, width, np.zeros_like(width), free, 1.0, 0.0)
    slopes, count = np.diag(diagonal) + np.outer(left, right), len(width)
    turning = 2j * np.pi * frequency_hz[:, None, None] * np.eye(count)
    driven = np.broadcast_to(np.array(by_high), (frequency_hz.size, count, 1))
    return np.linalg.solve(turning - slopes, driven)[..., 0].T
