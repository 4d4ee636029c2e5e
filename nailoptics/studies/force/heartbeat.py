"""By how much a beat of the arterial pressure moves the blood under a touch.

A touch changes how much of a beat reaches the blood. Because the beat's own height is known from the calibration, its
height in the readings measures the touch, as in a cuff: that separates a touch from a slow change of the pressure.
"""

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics.steady import solve_walls
from .network import touch_on_walls
from .person import Person

Array = NDArray[np.float64]

# Pressures of either side at which a beat's effect is computed, and the change of arterial pressure by which. [Pa]
PULSED, STEP_PA = 9, 200.0


class PulsedBlood:
    """By how much a beat of the arterial pressure moves the blood of both zones, under any touch.

    It is taken to reach the blood at once, as a slow change of the pressure does in the end: what is seen of a beat at
    rest says how strong it is, whether vessels follow within one or not.

    highest : (2,) float. Touch pressures up to which it is found; it stays beyond. [N/cm^2]
    """

    def __init__(self, person: Person, highest: Array) -> None:
        self._bends = [np.linspace(0.0, end, PULSED) for end in highest]
        touch = np.stack(np.meshgrid(*self._bends, indexing="ij")).reshape(2, -1)
        outside = touch_on_walls(np.repeat(touch, 2, axis=1), person.distal_reach)
        high = person.arterial_pa + STEP_PA * np.tile([1.0, -1.0], touch.shape[1])
        held, _ = solve_walls(person.walls, outside, high, np.full(high.shape, person.venous_pa))
        blood = person.blood(held / person.rest_m[:, None]).reshape(2, PULSED, PULSED, 2)
        self._part = (blood[..., 0] - blood[..., 1]) / STEP_PA / (blood[..., 0] + blood[..., 1])

    def part(self, touch: Array) -> tuple[Array, Array]:
        """Part (2,) by which the blood grows under a touch (2,) in N/cm^2, [1/Pa], and its slopes (2, 2) by that."""
        steps = np.array([bends[1] for bends in self._bends])
        place = np.clip(touch / steps, 0.0, PULSED - 1.001)
        (i, j), (x, y) = place.astype(int), place % 1.0
        here = self._part[:, i : i + 2, j : j + 2]
        across, along = np.array([1.0 - x, x]), np.array([1.0 - y, y])
        rise = np.array([-1.0, 1.0])
        by_touch = np.column_stack([rise @ (here @ along).T, across @ (here @ rise).T]) / steps
        return across @ (here @ along).T, by_touch
