"""The heart's beat as the observer follows it: harmonics of one rate that keep their height while their phase wanders.

A touch changes how much of a beat reaches the blood. Because the beat's own height is known from the calibration,
what is seen of it tells the touch, as in a cuff: that parts a touch from a slow change of the arterial pressure.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics.steady import solve_walls
from .network import touch_on_walls
from .person import Person

Array = NDArray[np.float64]

# Intervals between beats scatter by this part of their mean (Nunan 2010, PACE 33:1407), each by itself.
INTERVAL_SPREAD = 0.05
# Between recordings, and slowly within one, the rate itself differs by this part; it changes over so long. [s]
RATE_SPREAD, RATE_MEMORY_S = 0.1, 30.0
# Half the width of the band in which a harmonic lies, of the beat's rate; it is seen below this part of half of the
# samples' rate.
BAND, SEEN_BELOW = 0.35, 0.75
# Pressures of either side at which a beat's effect is found, and the change of arterial pressure by which. [Pa]
PULSED, STEP_PA = 9, 200.0
# How long a beat that is too high or too low stays so. [s]
HEIGHT_MEMORY_S = 10.0


def seen_harmonics(rate_hz: float, count: int, highest_hz: float) -> NDArray[np.bool_]:
    """Which of so many harmonics lie below what samples show, whose highest frequency is given."""
    return np.asarray((np.arange(1, 1 + count) + BAND) * rate_hz < SEEN_BELOW * highest_hz)


@dataclass(frozen=True)
class Beat:
    """A heart's beat in the arterial pressure.

    rate_hz : beats in a second. rms_pa : of each harmonic. spread : by how much their heights vary, of themselves.
    """

    rate_hz: float
    rms_pa: tuple[float, ...]
    spread: float

    @property
    def size(self) -> int:
        """Numbers of its state: logarithm of the rate over its mean, then two of each harmonic [Pa]."""
        return 1 + 2 * len(self.rms_pa)

    def seen(self, since_s: float) -> NDArray[np.bool_]:
        """Which harmonics samples so far apart show."""
        return seen_harmonics(self.rate_hz, len(self.rms_pa), 0.5 / since_s)

    def start(self) -> Array:
        """Variances of a beat whose phase is not known yet."""
        return np.concatenate([[RATE_SPREAD**2], np.repeat(np.square(self.rms_pa), 2)])

    def go_on(self, state: Array, step_s: float) -> tuple[Array, Array, Array]:
        """The state after a step, its slopes by the state before, and the covariance of what comes in between.

        Each harmonic turns, and its height r returns to the usual one h, a limit cycle: dr/dt = r (1 - r^2/h^2) / 2 t,
        solved over the step, so that none is ever thrown further off.
        """
        order = np.arange(1, len(self.rms_pa) + 1)
        before, height2 = state[1:].reshape(-1, 2), 2.0 * np.square(self.rms_pa)
        turn = 2 * np.pi * self.rate_hz * np.exp(state[0]) * step_s * order
        cos, sin = np.cos(turn), np.sin(turn)
        rotation = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), -1, 0)
        forgotten, part = -np.expm1(-step_s / HEIGHT_MEMORY_S), (before**2).sum(1) / height2
        grown = 1.0 / np.sqrt(1.0 + (part - 1.0) * forgotten)
        after = np.einsum("kij,kj->ki", rotation, grown[:, None] * before)
        inner = (
            grown[:, None, None] * np.eye(2)
            - (grown**3 * forgotten / height2)[:, None, None] * before[:, :, None] * before[:, None, :]
        )
        slopes, first = np.zeros((self.size, self.size)), 1 + 2 * np.arange(len(order))
        kept = np.exp(-step_s / RATE_MEMORY_S)
        slopes[0, 0] = kept
        block = rotation @ inner
        for i in range(2):
            for j in range(2):
                slopes[first + i, first + j] = block[:, i, j]
        across = np.column_stack([-after[:, 1], after[:, 0]])
        slopes[1:, 0] = (turn[:, None] * across).ravel()
        # All harmonics belong to one beat: when it is late, all are.
        late = np.concatenate([[0.0], (order[:, None] * across).ravel()])
        wander2 = (2 * np.pi * INTERVAL_SPREAD) ** 2 * self.rate_hz * step_s
        each = np.concatenate([[(1 - kept**2) * RATE_SPREAD**2], np.repeat(forgotten * self.spread**2 * height2, 2)])
        return (
            np.concatenate([[kept * state[0]], after.ravel()]),
            slopes,
            wander2 * np.outer(late, late) + np.diag(each),
        )


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
