"""The vessels of one person or many over a touch: steps of 10 ms from sample to sample, in the units of the fits."""

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics.stepping import step
from .person import N_PER_CM2, Person

Array = NDArray[np.float64]

# Samples further apart are walked in as many steps of at most this length. [s]
LONGEST_STEP_S = 0.05


def touch_on_walls(pressure: Array) -> Array:
    """Touch pressure on each wall (3, *S) [Pa], from P_F1 and P_F2 (2, *S) [N/cm^2]."""
    return N_PER_CM2 * np.stack([np.zeros_like(pressure[0]), pressure[1], pressure[0]])


def widths_over(person: Person, time_s: Array, pressure: Array, *, arterial_pa: Array | None = None) -> Array:
    """Diameters over those at rest, (3, *S, T) float, of walls that are in balance with the first pressures' absence.

    pressure : (2, *S, T) float. P_F1 and P_F2, linear between samples. [N/cm^2]
    arterial_pa : (*S,) float. P_H all the time, in place of the person's. [Pa]
    """
    outside, high = touch_on_walls(pressure), person.arterial_pa if arterial_pa is None else arterial_pa
    width, out = person.rest_m, np.empty(person.rest_m.shape + time_s.shape)
    out[..., 0] = width
    for k, sample_s in enumerate(np.diff(time_s)):
        count = max(1, int(np.ceil(sample_s / LONGEST_STEP_S - 1e-9)))
        change = (outside[..., k + 1] - outside[..., k]) / count
        for i in range(count):
            width = step(
                person.walls,
                width,
                outside[..., k] + i * change,
                high,
                person.venous_pa,
                step_s=sample_s / count,
                outside_change=change,
            )
        out[..., k + 1] = width
    return out / person.rest_m[..., None]
