"""Standard errors by groups of samples."""

import numpy as np
import pytest

from nailoptics.statistics import coarsened_replicates, leave_one_out, tail_index


@pytest.mark.parametrize("groups", [4, 10, 20, 40])
def test_means_without_large_groups_are_those_of_all_their_members(groups):
    """Expected: to the last digits, as a mean is of first order in its terms; as they are where groups do not fit."""
    small = np.random.default_rng(1).random((40, 3))
    large = small.reshape(groups, -1, 3).mean(1)
    assert coarsened_replicates(leave_one_out(small), groups) == pytest.approx(leave_one_out(large), rel=1e-12)
    assert np.array_equal(coarsened_replicates(leave_one_out(small[:39]), groups), leave_one_out(small[:39]))


@pytest.mark.parametrize("index", [0.2, 0.5, 1.0])
def test_the_tail_index_is_that_of_a_pareto_distribution(index):
    """Expected: within the estimator's standard error, xi / sqrt(k) of the k = 3 sqrt(n) largest values, whatever scale
    they have; values of 0 count for nothing, and few or equal values have no tail."""
    values = 7.0 * np.random.default_rng(2).random((200, 4096)) ** -index
    estimates = np.array([tail_index(np.append(one, np.zeros(99))) for one in values])
    assert estimates.mean() == pytest.approx(index, abs=4 * index / np.sqrt(192 * 200))
    assert estimates.std() == pytest.approx(index / np.sqrt(192), rel=0.2)
    assert tail_index(np.ones(100)) == tail_index(values[0, :4]) == tail_index(np.zeros(0)) == 0
