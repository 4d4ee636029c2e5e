"""The filter's update by one sample: of readings that are linear in the state a mixture of Gaussians, exactly."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from nailoptics.studies.force.kalman import OUTLIER_GATE, KalmanFilter


def test_modes_are_weighted_by_their_likelihood_and_merged_by_their_moments() -> None:
    """Expected: of two modes that differ in the touch's covariance, the moments of their posteriors' mixture."""
    rng = np.random.default_rng(3)
    slopes, root = rng.normal(size=(4, 6)), rng.normal(size=(6, 6))
    usual = 1e-3 * (np.eye(6) + 0.1 * root @ root.T)
    before, variance = np.array([usual, usual + np.diag([0, 0, 0, 0.02, 0.02, 0])]), np.full(4, 1e-3)
    kalman, start = KalmanFilter.__new__(KalmanFilter), np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3])
    kalman.model = SimpleNamespace(
        size=6,
        measurement=lambda state: (slopes @ state, slopes),
        bound_touch=lambda state, covariance: state,
        touch_bounds_n_per_cm2=(np.zeros(2), np.ones(2)),
    )
    kalman.state, kalman.mode_covariance, kalman.mode_probability = start, before, np.array([0.6, 0.4])
    volts = slopes @ (start + [0, 0, 0, 0.12, -0.05, 0])
    kalman._update(volts, np.full(4, True), variance, variance, chi2.ppf(OUTLIER_GATE, 4))
    readings = [multivariate_normal(slopes @ start, slopes @ one @ slopes.T + np.diag(variance)) for one in before]
    weights = np.array([0.6, 0.4]) * [one.pdf(volts) for one in readings]
    weights /= weights.sum()
    after = [np.linalg.inv(np.linalg.inv(one) + slopes.T @ np.diag(1 / variance) @ slopes) for one in before]
    means = [start + one @ slopes.T @ ((volts - slopes @ start) / variance) for one in after]
    mean = weights @ means
    spread = sum(w * np.outer(one - mean, one - mean) for w, one in zip(weights, means, strict=True))
    assert kalman.mode_probability == pytest.approx(weights) and 0.1 < weights[0] < 0.9
    assert kalman.state == pytest.approx(mean, abs=1e-6)
    assert kalman.covariance == pytest.approx(np.tensordot(weights, after, 1) + spread, abs=1e-9)
    assert np.trace(spread) > 0.02 * np.trace(kalman.covariance)
