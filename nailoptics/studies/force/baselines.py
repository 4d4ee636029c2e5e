"""What the literature does without a model: linear regression and principal component regression of force on volts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Components that hold this part of the readings' variance are kept.
KEPT_VARIANCE = 0.999


@dataclass(frozen=True)
class Regression:
    """Force = intercept + weights . volts."""

    intercept_n: float
    weights_n_per_v: Array

    def force_n(self, volts: Array) -> Array:
        """Force for volts (R, T), NaN where a reading has a gap; never below 0. [N]"""
        return np.maximum(self.intercept_n + self.weights_n_per_v @ volts, 0.0)


def whole_samples(volts: Array) -> Array:
    """Volts (R, T) whose gaps are bridged where no sample is whole, as where LEDs are lit in turn."""
    there = np.isfinite(volts)
    if there.all(0).any():
        return volts
    samples = np.arange(volts.shape[1])
    return np.array([np.interp(samples, samples[seen], one[seen]) for one, seen in zip(volts, there, strict=True)])


def linear_regression(volts: Array, force_n: Array) -> Regression:
    """Least squares on all readings, (R, T) volts."""
    design = np.column_stack([np.ones(volts.shape[1]), volts.T])
    found = np.linalg.lstsq(design, force_n, rcond=None)[0]
    return Regression(float(found[0]), np.asarray(found[1:], float))


def component_regression(volts: Array, force_n: Array) -> Regression:
    """Least squares on the principal components of the readings.

    References: Grieve, Hollerbach, Mascaro 2015, which takes it for fingernail images.
    """
    middle = volts.mean(1)
    vectors, sizes, _ = np.linalg.svd((volts - middle[:, None]), full_matrices=False)
    kept = int(np.searchsorted(np.cumsum(sizes**2) / (sizes**2).sum(), KEPT_VARIANCE)) + 1
    basis = vectors[:, :kept]
    scores = basis.T @ (volts - middle[:, None])
    inner = linear_regression(scores, force_n)
    weights = np.asarray(basis @ inner.weights_n_per_v, float)
    return Regression(inner.intercept_n - float(weights @ middle), weights)
