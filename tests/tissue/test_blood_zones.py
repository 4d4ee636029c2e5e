"""Blood zones: a smooth partition of unity."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from nailoptics.tissue import BloodZones


@settings(max_examples=50, deadline=None)
@given(
    start_mm=st.floats(-20, 20),
    width_mm=st.floats(1e-3, 5),
    gaps=st.lists(st.floats(1.001, 5), max_size=4),
    seed=st.integers(0, 1000),
)
def test_weights_sum_to_exactly_one_and_stay_between_0_and_1(start_mm, width_mm, gaps, seed):
    edges_mm = tuple(start_mm + np.concatenate([[0.0], np.cumsum(gaps)]) * width_mm)
    zones = BloodZones(edges_mm, width_mm)
    v_mm = np.random.default_rng(seed).uniform(edges_mm[0] - 5, edges_mm[-1] + 5, 500)
    weights = zones.weights(v_mm)
    assert weights.shape == (500, len(edges_mm) + 1)
    assert (weights.sum(axis=-1) == 1.0).all()
    assert (weights >= 0).all() and (weights <= 1).all()


def test_zone_0_is_proximal_and_half_way_at_the_edge():
    zones = BloodZones(edges_mm=(0.0,), width_mm=2.0)
    assert zones.weights([-1.0, 0.0, 1.0]) == pytest.approx(np.array([[1, 0], [0.5, 0.5], [0, 1]]))


def test_weights_have_a_continuous_slope():
    h_mm = 1e-4
    v_mm = np.arange(-3, 3, h_mm)
    slope = np.gradient(BloodZones((0.0,), 2.0).weights(v_mm)[:, 1], h_mm)
    # The curvature of the smoothstep is at most 6 / width^2; a step of slope would show as a jump of order 1.
    assert np.abs(np.diff(slope)).max() < 1.01 * 6 / 2.0**2 * h_mm
    assert slope.max() == pytest.approx(1.5 / 2.0, rel=1e-3)


def test_one_zone_needs_no_edge():
    weights = BloodZones(edges_mm=()).weights(np.linspace(-5, 5, 7))
    assert weights.shape == (7, 1) and (weights == 1.0).all()
