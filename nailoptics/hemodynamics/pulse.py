"""Arterial pressure with the heart's beat, so that readings have a steady and a pulsating part."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError

# Height, instant (part of a beat) and sharpness of the systolic, the reflected and the dicrotic wave: chosen so that
# their sum climbs faster than it falls and has the notch of a finger's pulse.
_WAVES = ((1.0, 0.17, 12.0), (0.55, 0.33, 8.0), (0.35, 0.55, 6.0))


def cardiac_pressure(
    time_s: ArrayLike,
    *,
    mean_pressure_pa: float = 1e4,
    pulse_pressure_pa: float = 2e3,
    rate_per_min: float = 70.0,
) -> np.ndarray:
    """The arterial pressure P_H over time with a beating heart, to be given to `respond`. [Pa]

    time_s : any shape, float. [s]
    mean_pressure_pa : Average over a beat; the paper's P_H is 1e4. [Pa]
    pulse_pressure_pa : Highest minus lowest, 0 or more. [Pa]
    rate_per_min : Beats in a minute. [1/min]

    One beat is the sum of three smooth periodic bumps exp(s (cos(phase - phase_0) - 1)): the systolic wave, its
    reflection and the dicrotic wave, the shape of a finger's pulse (Allen 2007, Physiol. Meas. 28 R1).

    Raises: InputError if a value is not finite, the rate is not positive, or the pulse is negative.
    """
    time = finite("time_s", time_s)
    mean = number("mean_pressure_pa", mean_pressure_pa)
    pulse = number("pulse_pressure_pa", pulse_pressure_pa)
    rate = number("rate_per_min", rate_per_min)
    if rate <= 0.0:
        raise InputError(f"rate_per_min must be greater than 0, got {rate:g}; 70 is usual.")
    if pulse < 0.0:
        raise InputError(f"pulse_pressure_pa must be 0 or more, got {pulse:g}; give 0 for a steady pressure.")
    beat = _beat(np.arange(2048) / 2048.0)
    return mean + pulse * (_beat(time * rate / 60.0) - beat.mean()) / np.ptp(beat)


def _beat(phase: np.ndarray) -> np.ndarray:
    """The pulse before it is scaled, from the phase in beats."""
    waves = [height * np.exp(sharp * (np.cos(2.0 * np.pi * (phase - at)) - 1.0)) for height, at, sharp in _WAVES]
    return sum(waves, start=np.zeros_like(phase))
