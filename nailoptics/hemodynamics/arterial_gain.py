"""How far small waves of the arterial pressure move the vessels, by their frequency, while a touch is held."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite
from ..errors import InputError
from .parameters import Parameters
from .steady import solve_walls, wall_pressures
from .walls import build_walls, massless_jacobian, massless_rates
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
    walls, n = build_walls(parameters, zones), zones.count
    outside = wall_pressures(zones, np.asarray(pressure_pa, dtype=float)[:, None])
    high, low = parameters.arterial_pressure_pa, parameters.venous_pressure_pa
    width, pressure = solve_walls(walls, outside, np.array([high]), np.array([low]))
    free = np.where(width > np.array(walls.closed)[:, None] * (1.0 + 1e-9), 1.0, 0.0)
    diagonal, left, right = (
        np.array(part)[:, 0] for part in massless_jacobian(walls, width, free, pressure, high, low)
    )
    # Speeds are linear in P_H.
    _, by_high = massless_rates(walls, width, np.zeros_like(width), free, 1.0, 0.0)
    slopes = np.diag(diagonal) + np.outer(left, right)
    turning = 2j * np.pi * frequency[:, None, None] * np.eye(n + 1)
    return np.linalg.solve(turning - slopes, np.broadcast_to(np.array(by_high), (frequency.size, n + 1, 1)))[:, :n, 0].T
