"""Readings over blood and saturation as polynomials: a few columns of sums stand for every state."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Degrees in the blood of both zones together, in the saturation, and in all.
BLOOD_DEGREE, SO2_DEGREE, DEGREE = 4, 2, 4


@dataclass(frozen=True)
class BloodPolynomial:
    """Polynomials in the blood of both zones and the saturation, over a box of states.

    blood_fraction, so2 : lowest and highest of the box.
    """

    blood_fraction: tuple[float, float]
    so2: tuple[float, float]

    @property
    def exponents(self) -> list[tuple[int, int, int]]:
        """Exponents of both zones' blood and of the saturation in each monomial, all scaled to -1 to 1."""
        blood, so2 = range(BLOOD_DEGREE + 1), range(SO2_DEGREE + 1)
        return [e for e in product(blood, blood, so2) if e[0] + e[1] <= BLOOD_DEGREE and sum(e) <= DEGREE]

    @property
    def states(self) -> Array:
        """Where a reading must be known, (n, 3): blood of both zones and saturation, denser towards the box's faces."""
        blood, so2 = (
            low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))
            for (low, high), count in ((self.blood_fraction, BLOOD_DEGREE + 1), (self.so2, SO2_DEGREE + 1))
        )
        return np.array(list(product(blood, blood, so2)))

    def monomials(self, states: Array) -> Array:
        """Each monomial at states (n, 3), (n, monomials) float."""
        bounds = np.array([self.blood_fraction, self.blood_fraction, self.so2])
        scaled = 2 * (states - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0]) - 1
        powers = np.array(self.exponents)
        return np.asarray(np.prod(scaled[:, None, :] ** powers[None], axis=-1))

    @property
    def coefficients(self) -> Array:
        """What makes the coefficients from values in all states, (monomials, states) float: least squares."""
        return np.asarray(np.linalg.pinv(self.monomials(self.states)), float)
