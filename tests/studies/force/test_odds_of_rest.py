"""The probability that a finger rests, from the estimate of its touch."""

import numpy as np
import pytest

from nailoptics.studies.force.kalman import TOUCH_RANGE_N_PER_CM2, rest_odds


def test_the_probability_of_rest_follows_from_the_readings() -> None:
    """Expected: the odds of Bayes' rule for rest and for any touch within reach, with equal priors."""
    covariance = np.diag([0.03**2, 0.02**2])

    def likelihood(measured: np.ndarray, touch: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-0.5 * (((measured - touch) / np.sqrt(np.diag(covariance))) ** 2).sum(-1)))

    # A touch is taken to lie anywhere around, as the filter's own pressures may: no edge of the range matters.
    around = np.stack(np.meshgrid(*2 * [np.linspace(-0.3, 0.5, 401)], indexing="ij"), axis=-1)
    cell = (0.8 / 400 / TOUCH_RANGE_N_PER_CM2) ** 2
    measured = np.array([[0.0, 0.0], [0.05, 0.0], [0.1, 0.03]])
    bayes = [likelihood(one, np.zeros(2)) / (likelihood(one, around).sum() * cell) for one in measured]
    assert rest_odds(measured, np.repeat(covariance[None], 3, axis=0)) == pytest.approx(np.array(bayes), rel=1e-3)
