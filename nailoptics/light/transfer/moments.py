"""Sums over the photons of each photodiode at one state, and what follows from them."""

from dataclasses import dataclass

import numpy as np

from ...statistics import effective_count, stderr_of_mean, stderr_or_nan


@dataclass(frozen=True)
class Moments:
    """Sums over the photons of each photodiode at one state: of weights, squares and weighted paths."""

    photons: int
    weight: np.ndarray  # (p,)
    square: np.ndarray  # (p,)
    path: np.ndarray  # (p, r)
    path_square: np.ndarray  # (p, r)
    path_cross: np.ndarray  # (p, r): sum of w^2 L
    fourth: np.ndarray  # (p,): sum of w^4

    @property
    def fraction(self) -> np.ndarray:
        """Detected fraction, (p,)."""
        return self.weight / self.photons

    @property
    def stderr(self) -> np.ndarray:
        """Its standard error, (p,); photons are independent and each has one record for a photodiode.

        NaN where it rests on fewer than 25 effective photons; so are those of mean paths and derivatives.
        """
        return stderr_or_nan(stderr_of_mean(self.weight, self.square, self.photons), self.weight, self.square)

    @property
    def effective_photons(self) -> np.ndarray:
        """Effective number of detected photons (sum w)^2 / sum w^2, (p,)."""
        return effective_count(self.weight, self.square)

    @property
    def error_photons(self) -> np.ndarray:
        """Effective number of photons that the standard error rests on (sum w^2)^2 / sum w^4, (p,)."""
        return np.divide(self.square**2, self.fourth, out=np.zeros_like(self.square), where=self.fourth > 0)

    @property
    def mean_path(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean path of the detected light in each absorber and its standard error, (p, r) each. [mm]"""
        total = self.weight[:, None]
        mean = np.divide(self.path, total, out=np.full_like(self.path, np.nan), where=total > 0)
        spread = np.maximum(self.path_square - 2 * mean * self.path_cross + mean**2 * self.square[:, None], 0)
        stderr = np.divide(np.sqrt(spread), total, out=np.full_like(mean, np.nan), where=total > 0)
        return mean, stderr_or_nan(stderr, self.path, self.path_square)

    @property
    def derivative(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the fraction to each absorber's mu_a and its standard error, (p, r) each. [mm]"""
        stderr = stderr_of_mean(self.path, self.path_square, self.photons)
        return -self.path / self.photons, stderr_or_nan(stderr, self.path, self.path_square)


def moments_of(photons: int, photodiode: np.ndarray, weight: np.ndarray, path_mm: np.ndarray, count: int) -> Moments:
    """Moments of records; weights are those of the state that is read."""

    def by_absorber(values: np.ndarray, power: int) -> np.ndarray:
        return np.stack([_total(photodiode, values * column**power, count) for column in path_mm.T], -1)

    return Moments(
        photons=photons,
        weight=_total(photodiode, weight, count),
        square=_total(photodiode, weight**2, count),
        path=by_absorber(weight, 1),
        path_square=by_absorber(weight**2, 2),
        path_cross=by_absorber(weight**2, 1),
        fourth=_total(photodiode, weight**4, count),
    )


def _total(photodiode: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    # Of no photons at all numpy makes integers.
    return np.bincount(photodiode, values, minlength=count).astype(float)
