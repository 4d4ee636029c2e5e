"""Blood zones: a smooth partition of unity, its table, and the absorption field that it carries."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nailoptics.errors import InputError
from nailoptics.tissue import BloodZones, absorption, blood_mu_a_per_mm, mu_a_field


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
    assert weights.shape == (500, zones.count)
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
    zones = BloodZones(edges_mm=())
    assert zones.count == 1 and (zones.weights(np.linspace(-5, 5, 7)) == 1.0).all()


def test_the_table_reads_linearly_to_second_order():
    zones = BloodZones((-1.0, 2.0), 2.0)
    v_mm = np.linspace(-6, 6, 10_001)

    def error(n):
        nodes, table = np.linspace(-6, 6, n), zones.table(-6.0, 6.0, n)
        read = np.stack([np.interp(v_mm, nodes, column) for column in table.T], axis=-1)
        assert read.sum(axis=-1) == pytest.approx(1.0, abs=1e-14)
        return np.abs(read - zones.weights(v_mm)).max()

    assert error(121) <= 0.75 * (0.1 / 2.0) ** 2
    assert error(121) / error(241) == pytest.approx(4, rel=0.1)


def test_the_field_joins_the_zones_absorption():
    zones = BloodZones((0.0,), 2.0)
    field = mu_a_field(zones, [0.03, 0.01], [0.97, 0.6], 660.0, [-4.0, 0.0, 4.0])
    base = absorption("bed", 660.0).base_per_mm
    proximal = base + 0.03 * blood_mu_a_per_mm(660, 0.97)
    distal = base + 0.01 * blood_mu_a_per_mm(660, 0.6)
    assert field == pytest.approx([proximal, (proximal + distal) / 2, distal])


def test_equal_zones_make_a_constant_field():
    field = mu_a_field(BloodZones((-2.0, 2.0), 1.5), [0.03] * 3, 0.97, 800.0, np.linspace(-6, 6, 97))
    assert np.ptp(field) < 1e-15


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: BloodZones((0.0, 1.0), 2.0), "closer than width_mm = 2"),
        (lambda: BloodZones((3.0, 0.0), 2.0), "rising order"),
        (lambda: BloodZones((0.0,), 0.0), "width_mm = 0"),
        (lambda: BloodZones((0.0,), float("nan")), "width_mm"),
        (lambda: BloodZones((float("inf"),)), "finite"),
        (lambda: BloodZones().table(1.0, 1.0, 5), "v_min < v_max"),
        (lambda: BloodZones().table(0.0, 1.0, 1), "n >= 2"),
        (lambda: mu_a_field(BloodZones(), [0.03], 0.97, 800.0, [0.0]), "2 zones"),
        (lambda: mu_a_field(BloodZones(), [0.03, 2.0], 0.97, 800.0, [0.0]), "blood_fraction = 2"),
        (lambda: mu_a_field(BloodZones(), [0.03, 0.02], 1.5, 800.0, [0.0]), "so2 = 1.5"),
        (lambda: mu_a_field(BloodZones(), [0.03, 0.02], 0.9, 300.0, [0.0]), "450 to 1000"),
    ],
)
def test_impossible_zones_are_refused(call, words):
    with pytest.raises(InputError, match=words):
        call()
