"""The vessels of one person or many over a touch: steps of 10 ms from sample to sample, in the units of the fits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics.steady import solve_walls
from ...hemodynamics.stepping import step
from .person import N_PER_CM2, Person

Array = NDArray[np.float64]

# Samples further apart are walked in as many steps of at most this length. [s]
LONGEST_STEP_S = 0.05
# A touch past which less than this part of the change by pressure is left cannot be told from a harder one.
LEFT_AT_CLOSURE = 0.05
# Pressures at which closure is looked for. [N/cm^2]
SEARCHED = np.linspace(0.0, 4.0, 401)


@dataclass(frozen=True)
class Closure:
    """Pressures past which readings stay as they are: proximal and distal. [N/cm^2]"""

    proximal: float
    distal: float


def touch_on_walls(pressure: Array, distal_reach: Array | float) -> Array:
    """Touch pressure on each wall (3, *S) [Pa], from P_F1 and P_F2 (2, *S) [N/cm^2].

    distal_reach : part of P_F2 that acts on the proximal capillaries.
    """
    return N_PER_CM2 * np.stack([distal_reach * pressure[1], pressure[1], pressure[0]])


def widths_over(
    person: Person,
    time_s: Array,
    pressure: Array,
    *,
    arterial_pa: Array | None = None,
    longest_step_s: float = LONGEST_STEP_S,
) -> Array:
    """Diameters over those at rest, (3, *S, T) float, of walls that are in balance with the first pressures' absence.

    pressure : (2, *S, T) float. P_F1 and P_F2, linear between samples. [N/cm^2]
    arterial_pa : (*S, T) float, or (*S, 1) where it stays. P_H in place of the person's. [Pa]
    longest_step_s : samples further apart are walked in several steps. [s]
    """
    outside = touch_on_walls(person.pulp.course(time_s, pressure), np.asarray(person.distal_reach)[..., None])
    mean_pa = np.full(person.rest_m.shape[1:] + (1,), person.arterial_pa)
    high = np.broadcast_to(mean_pa if arterial_pa is None else arterial_pa, mean_pa.shape[:-1] + time_s.shape)
    width, out = person.rest_m, np.empty(person.rest_m.shape + time_s.shape)
    out[..., 0] = width
    for k, sample_s in enumerate(np.diff(time_s)):
        count = max(1, int(np.ceil(sample_s / longest_step_s - 1e-9)))
        change = (outside[..., k + 1] - outside[..., k]) / count
        for i in range(count):
            width = step(
                person.walls,
                width,
                outside[..., k] + i * change,
                high[..., k],
                person.venous_pa,
                step_s=sample_s / count,
                outside_change=change,
            )
        out[..., k + 1] = width
    return out / person.rest_m[..., None]


def closure_of(person: Person) -> Closure:
    """Where a proximal and a distal touch have done all but a part of what they can, held for long."""
    ends = []
    for side in range(2):
        pressure = np.zeros((2, SEARCHED.size))
        pressure[side] = SEARCHED
        full = np.full(SEARCHED.size, 1.0)
        outside = touch_on_walls(pressure, person.distal_reach)
        rest, _ = solve_walls(person.walls, outside, person.arterial_pa * full, person.venous_pa * full)
        blood = rest[side] ** 2
        change = np.abs(blood - blood[0])
        left = change < (1 - LEFT_AT_CLOSURE) * change.max()
        ends.append(float(SEARCHED[min(int(np.flatnonzero(left).max(initial=0)) + 1, SEARCHED.size - 1)]))
    return Closure(*ends)
