"""Standard errors by groups of samples."""

import numpy as np
import pytest

from nailoptics.statistics import coarsened_replicates, leave_one_out


@pytest.mark.parametrize("groups", [4, 10, 20, 40])
def test_means_without_large_groups_are_those_of_all_their_members(groups):
    """Expected: to the last digits, as a mean is of first order in its terms; as they are where groups do not fit."""
    small = np.random.default_rng(1).random((40, 3))
    large = small.reshape(groups, -1, 3).mean(1)
    assert coarsened_replicates(leave_one_out(small), groups) == pytest.approx(leave_one_out(large), rel=1e-12)
    assert np.array_equal(coarsened_replicates(leave_one_out(small[:39]), groups), leave_one_out(small[:39]))
