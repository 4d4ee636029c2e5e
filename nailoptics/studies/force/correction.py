"""What a fitted network gets wrong of a touch, as a curve for each side that the calibration's own readings teach."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .network import Closure

Array = NDArray[np.float64]

# The curve bends at these parts of the pressure at closure.
BENDS = np.array([0.0, 0.15, 0.3, 0.5, 0.75, 1.0])
# Touches up to this part of closure teach the curve.
SEEN = 0.8
# Beforehand the network is trusted to this part of a pressure, and neighbouring bends differ by no more than that.
SPREAD, SMOOTHNESS = 0.3, 0.15
# A pressure told and the true one differ by chance by so much, and stay so for so long. [N/cm^2, s]
CHANCE, CHANCE_S = 0.1, 1.0


@dataclass(frozen=True)
class Correction:
    """Pressures that press beside those that the observer tells.

    told, pressed : (2, K) float. Proximal and distal, rising from 0; straight between them. [N/cm^2]
    """

    told: Array
    pressed: Array

    def of(self, told: Array) -> Array:
        """The pressures (2, *S) that touches have, from those that are told. [N/cm^2]"""
        sides = zip(told, self.told, self.pressed, strict=True)
        # Past its end the curve goes on in proportion.
        return np.stack([np.interp(one, bends, ends) * np.maximum(one / bends[-1], 1.0) for one, bends, ends in sides])


def no_correction() -> Correction:
    """The curve of a network that is right."""
    return Correction(np.tile(BENDS, (2, 1)), np.tile(BENDS, (2, 1)))


def learn_correction(closure: Closure, sides: Sequence[tuple[Array, Array, Array]]) -> Correction:
    """The curve from touches of one side each.

    sides : proximal and distal: times [s], pressures told and true pressures [N/cm^2], (T,) each; none without samples.
    """
    found = [_curve(shut, *side) for shut, side in zip((closure.proximal, closure.distal), sides, strict=True)]
    return Correction(*(np.stack(one) for one in zip(*found, strict=True)))


def _curve(shut: float, time_s: Array, told: Array, true: Array) -> tuple[Array, Array]:
    """One side's curve: least squares on its factors at the bends, held to 1 and to be smooth."""
    bends = shut * BENDS
    ones = np.eye(BENDS.size)
    rows = [ones / SPREAD, np.diff(ones, axis=0) / SMOOTHNESS]
    wanted = [np.full(BENDS.size, 1 / SPREAD), np.zeros(BENDS.size - 1)]
    if time_s.size > 1:
        # Past closure what is told is chance, and says nothing of the force.
        below = np.maximum(told, true) < SEEN * shut
        together = max(1.0, CHANCE_S / float(np.median(np.diff(time_s))))
        hats = np.stack([np.interp(told[below], bends, one) for one in ones], axis=1)
        rows.append(hats * bends / CHANCE / np.sqrt(together))
        wanted.append(true[below] / CHANCE / np.sqrt(together))
    factor = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    # A harder touch is never told as a softer one.
    return bends, np.maximum.accumulate(np.maximum(factor, 0.1) * bends)
