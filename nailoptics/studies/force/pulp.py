"""How the pulp gives way under a touch: it spreads by and by, and its distal part recovers slowly."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics import creeping_pressure, spreading_pressure

Array = NDArray[np.float64]

# A time constant of this or less is none. [s]
SHORTEST_S = 1e-9


@dataclass(frozen=True)
class Pulp:
    """What lies between a touch and the vessels, of one person or of many (arrays of shape S in place of numbers).

    creep : S float. Part of its pressure that a held touch loses in the end. [1]
    creep_s : float. Time constant of that loss. [s]
    recovery_s : S float. Time constant with which the distal pulp recovers where a touch presses less. [s]
    """

    creep: Array | float
    creep_s: float
    recovery_s: Array | float

    def course(self, time_s: Array, pressure: Array) -> Array:
        """What is left for the vessels of both touch pressures, (2, *S, T) float, linear between times (T,)."""
        spread = spreading_pressure(time_s, pressure, part=self.creep, time_constant_s=self.creep_s)
        return np.stack([spread[0], creeping_pressure(time_s, spread[1], relaxation_s=self.recovery_s)])

    def spread(self, pressure: Array, followed: Array) -> Array:
        """The pressures (2, *S) of a touch that the pulp has spread under.

        followed : (2,) float. What `follow` has made of the pressures so far.
        """
        lost = self.creep * followed
        return np.asarray(np.maximum(pressure - lost.reshape((2,) + (1,) * (pressure.ndim - 1)), 0.0))

    def follow(self, followed: Array, pressure: Array, step_s: float) -> Array:
        """The pressures as the pulp follows them, a step later."""
        return np.asarray(pressure + (followed - pressure) * np.exp(-step_s / self.creep_s))

    def recover(self, left: Array, pressure: Array, step_s: float) -> Array:
        """The pressure that is left in the distal pulp a step later, of that before and that of the touch."""
        kept = np.exp(-step_s / np.maximum(self.recovery_s, SHORTEST_S))
        return np.asarray(np.maximum(pressure, pressure + (left - pressure) * kept))
