"""What a calibration leaves open of a person, as an error of the pressures that are told of a touch."""

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics.steady import solve_walls
from .network import closure_of, touch_on_walls
from .observer import Calibrated, Noise
from .person import NAMES, Person

Array = NDArray[np.float64]

# Held touches of either side at which the error is found, in parts of closure.
PARTS = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
# Steps of derivatives: of the factors' logarithms, and of pressures in N/cm^2.
STEP_LN, STEP = 0.05, 0.02
# Where readings hardly tell the pressure it is known to this beforehand. [N/cm^2]
BEFORE = 0.5
AREAS = [NAMES.index("contact_area"), NAMES.index("proximal_area")]


class OpenError:
    """Errors of told pressures and of the contact's areas by errors of a calibration: factors, gains, offsets, slopes.

    A person who is not quite the calibrated one gives other readings under a held touch; the pressures that explain
    them best, beside drift and noise, are off by so much.
    """

    def __init__(self, calibrated: Calibrated, noise: Noise) -> None:
        self._calibrated = calibrated
        closure = closure_of(calibrated.make(calibrated.factors_ln))
        self._bends = np.array([closure.proximal, closure.distal])[:, None] * PARTS
        rest_v = calibrated.gain * calibrated.table.slopes(calibrated.make(calibrated.factors_ln).blood(np.ones(2)))[0]
        led = calibrated.table.same_led() * rest_v[:, None]
        drift = noise.drift_per_min**2 * np.diag(rest_v**2) + noise.led_drift_per_min**2 * led @ led.T
        self._information = np.linalg.inv(drift + np.diag(noise.reading_v**2))
        values, vectors = np.linalg.eigh(calibrated.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        sides = [[self._by_open(side, pressure) @ root for pressure in self._bends[side]] for side in range(2)]
        self._root = np.array(sides)

    def covariance(self, pressure: Array) -> Array:
        """Covariance (T, 4, 4) of told pressures (2, T) and of the logarithms of the contact's areas."""
        part = pressure[0] / np.maximum(pressure.sum(0), 1e-9)
        root = np.zeros((pressure.shape[1], *self._root.shape[2:]))
        for side, weight in enumerate((part, 1.0 - part)):
            at = np.interp(pressure.sum(0), self._bends[side], np.arange(PARTS.size))
            low = np.minimum(at.astype(int), PARTS.size - 2)
            between = (at - low)[:, None, None]
            found = self._root[side, low] * (1 - between) + self._root[side, low + 1] * between
            root += weight[:, None, None] * found
        return np.asarray(root @ np.moveaxis(root, 1, 2))

    def _by_open(self, side: int, pressure: float) -> Array:
        """Derivatives (4, P + 4 R) of what is told of a held touch by all that the calibration leaves open."""
        one, factors = self._calibrated, np.repeat(self._calibrated.factors_ln[:, None], 2 * len(NAMES), axis=1)
        each = np.arange(len(NAMES))
        factors[each, each] += STEP_LN
        factors[each, each + len(NAMES)] -= STEP_LN
        held = np.zeros(2)
        held[side] = pressure
        moved, _ = self._risen_v(one.make(factors), held[:, None])
        by_factor = (moved[:, : len(NAMES)] - moved[:, len(NAMES) :]) / (2 * STEP_LN)
        around = np.maximum(
            held[:, None] + STEP * np.array([[1.0, 0.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, -1.0, 0.0]]), 0
        )
        near, steeper = self._risen_v(one.make(np.repeat(one.factors_ln[:, None], 5, axis=1)), around)
        slopes = (near[:, :2] - near[:, 2:4]) / np.diag(around[:, :2] - around[:, 2:4])
        by_slope = [np.diag(zone[:, 4]) for zone in steeper]
        by_gain, by_offset = np.diag(near[:, 4] / one.gain), np.zeros((len(one.gain),) * 2)
        by_open = np.column_stack([by_factor, by_gain, by_offset, *by_slope])
        weighed = slopes.T @ self._information
        told = -np.linalg.solve(weighed @ slopes + np.eye(2) / BEFORE**2, weighed @ by_open)
        return np.vstack([told, np.eye(by_open.shape[1])[AREAS]])

    def _risen_v(self, who: Person, pressure: Array) -> tuple[Array, Array]:
        """Volts of every reading over those at rest, (R, S), of many people under held pressures (2, S).

        And what steeper slopes by the blood of either zone add to them, (2, R, S).
        """
        shape = who.rest_m.shape[1:]
        outside = touch_on_walls(np.broadcast_to(pressure, (2, *shape)), who.distal_reach)
        full = np.ones(shape)
        held, _ = solve_walls(who.walls, outside, who.arterial_pa * full, who.venous_pa * full)
        blood, rest = who.blood(held / who.rest_m), who.blood(np.ones_like(held))
        volts = self._calibrated.table.volts(blood)
        risen = self._calibrated.gain[:, None] * (volts - self._calibrated.table.volts(rest))
        return risen, volts * (blood - rest)[:, None]
