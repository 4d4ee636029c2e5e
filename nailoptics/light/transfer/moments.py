"""Sums over the photons of each photodiode at one state, and how those of all photons sharpen those of a sample."""

from dataclasses import dataclass

import numpy as np

from ...statistics import effective_count, known_from, stderr_of_mean


@dataclass(frozen=True)
class RestState:
    """The state in which a trace keeps sums over all of its photons, whatever records it drops.

    mu_a : (q, r) float. Absorption over the LED's line. [mm^-1]
    share : (q,) float. Weights of the line.
    photodiodes : How many photodiodes there are.
    """

    mu_a: np.ndarray
    share: np.ndarray
    photodiodes: int


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
    def as_array(self) -> np.ndarray:
        """All sums side by side, (p, 3 + 3 r) float."""
        return np.column_stack([self.weight, self.square, self.path, self.path_square, self.path_cross, self.fourth])

    @classmethod
    def from_array(cls, table: np.ndarray, photons: int) -> "Moments":
        """The sums that `as_array` put side by side."""
        path, path_square, path_cross = np.split(table[:, 2:-1], 3, axis=1)
        return cls(photons, table[:, 0], table[:, 1], path, path_square, path_cross, table[:, -1])

    def __add__(self, other: "Moments") -> "Moments":
        return Moments(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    @property
    def fraction(self) -> np.ndarray:
        """Detected fraction, (p,)."""
        return self.weight / self.photons

    @property
    def stderr(self) -> np.ndarray:
        """Its standard error, (p,); photons are independent and each reaches a photodiode once.

        NaN where it rests on fewer than 25 effective photons; so are those of mean paths and derivatives.
        """
        return known_from(stderr_of_mean(self.weight, self.square, self.photons), self.weight, self.square)

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
        return mean, known_from(stderr, self.path, self.path_square)

    @property
    def derivative(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the fraction to each absorber's mu_a and its standard error, (p, r) each. [mm]"""
        stderr = stderr_of_mean(self.path, self.path_square, self.photons)
        return -self.path / self.photons, known_from(stderr, self.path, self.path_square)


def moments_of(photons: int, photodiode: np.ndarray, weight: np.ndarray, path_mm: np.ndarray, count: int) -> Moments:
    """Moments of records that stand for all photons; weights are those of the state that is read."""

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


def moments_of_sample(
    full: Moments, keep: float, photodiode: np.ndarray, weight: np.ndarray, rest: np.ndarray, path_mm: np.ndarray
) -> Moments:
    """Moments at a state from a sample of the photons, held against the sums over all photons at rest.

    Each sum is fitted by a multiple of the same sum at rest; all photons determine the fitted part, the sample only
    what is left. At rest nothing is left, so that this returns `full`; far from rest the multiple is small and the
    sample speaks alone.

    full : over all photons at rest.
    keep : probability with which each photon came into the sample.
    weight, rest : (n,) float. Weights in the state that is read and at rest, both divided by `keep`.

    References: regression estimator, Saerndal, Swensson, Wretman 1992, Model Assisted Survey Sampling, ch. 6.
    """
    count, absorbers = full.path.shape

    def total(values: np.ndarray) -> np.ndarray:
        return _total(photodiode, values, count)

    def fitted(values: np.ndarray, at_rest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slope = slope_of(total(values * at_rest), total(at_rest**2), 1.0)
        predicted = slope[photodiode] * at_rest
        return slope, predicted, values - predicted

    slope, light, light_left = fitted(weight, rest)
    path, path_square, path_cross = (np.zeros((count, absorbers)) for _ in range(3))
    for k, column in enumerate(path_mm.T):
        factor, predicted, left = fitted(weight * column, rest * column)
        path[:, k] = factor * full.path[:, k] + total(left)
        path_square[:, k] = factor**2 * full.path_square[:, k] + total(left**2)
        # What is predicted and what is left are orthogonal within one sum, not between two.
        both = keep * total(light * left + predicted * light_left) + total(light_left * left)
        path_cross[:, k] = slope * factor * full.path_cross[:, k] + both
    return Moments(
        photons=full.photons,
        weight=slope * full.weight + total(light_left),
        square=slope**2 * full.square + total(light_left**2),
        path=path,
        path_square=path_square,
        path_cross=path_cross,
        # Each record stands for 1 / keep photons of its own weight.
        fourth=keep**3 * total(weight**4),
    )


def slope_of(cross: np.ndarray, square: np.ndarray, unseen: float) -> np.ndarray:
    """Multiple of x that fits y best, from sums of x y and of x^2; `unseen` where nothing was kept."""
    return np.divide(cross, square, out=np.full_like(cross, unseen), where=square > 0)


def _total(photodiode: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    # Of no photons at all numpy makes integers.
    return np.bincount(photodiode, values, minlength=count).astype(float)
