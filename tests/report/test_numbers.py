"""Numbers for people: never more digits than are significant, never an unsuitable unit."""

import math

import pytest
from hypothesis import example, given, settings, strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg

from nailoptics.report import style
from nailoptics.report.numbers import fixed, polynomial, prefix, quantity, significant, with_error
from nailoptics.report.style import spread
from nailoptics.variables import unit_of


@pytest.mark.parametrize(
    "value, error, text",
    [
        (1.23456, 0.012, "1.235 ± 0.012"),
        (-0.0, 0.5, "0.00 ± 0.50"),
        (1234.5, 67.0, "1234 ± 67"),
        (3.2e9, 4.1e7, "(3.200 ± 0.041) × 10⁹"),
        (5.0, 0.0, "5.000"),
        (5.0, math.inf, "5.00 ± ?"),
        (0.0, math.nan, "0 ± ?"),
        (math.nan, 1.0, "–"),
        (235.908955401, 1e-13, "235.9"),
        (6534.285834, 4e-4, "6534"),
    ],
)
def test_a_value_is_rounded_to_its_error(value, error, text):
    assert with_error(value, error) == text


@pytest.mark.parametrize(
    "value, error, text",
    [
        (-5.09e-14, math.inf, "0"),
        (-5.09e-14, 3e-15, "0"),
        (1e-5, 2e-6, "(1.00 ± 0.20) × 10⁻⁵"),
        (0.5, math.inf, "0.500 ± ?"),
    ],
)
def test_what_is_rounding_beside_what_it_is_a_part_of_is_nothing(value, error, text):
    assert with_error(value, error, scale=235.9) == text


@pytest.mark.parametrize(
    "field, unit",
    [
        ("touch.force_n", "N"),
        ("leds[0].position_mm[1]", "mm"),
        ("blood.tuning.vein_stiffness_n_per_m", "N/m"),
        ("blood.tuning.viscosity_pa_s", "Pa s"),
        ("body.drift.led_per_rt_min", "1/√min"),
        ("electronics.noise_nv_per_rt_hz", "nV/√Hz"),
        ("blood.so2", "1"),
        ("blood.zones", "1"),
    ],
)
def test_a_fields_name_ends_with_its_unit(field, unit):
    assert unit_of(field) == unit


@pytest.mark.parametrize(
    "coefficients, text",
    [
        ([110.93, -32.77, 0.9527], "110.9 − 32.77 R + 0.9527 R²"),
        ([-1.0, 2.0, -3.0, 4.0], "−1.000 + 2.000 R − 3.000 R² + 4.000 R³"),
    ],
)
def test_a_polynomial_has_its_signs_between_its_terms(coefficients, text):
    assert polynomial(coefficients) == text


@pytest.mark.parametrize(
    "value, text", [(0.0123, "12.3\u00a0mV"), (-4.7e-5, "−47.0\u00a0µV"), (0.0, "0\u00a0V"), (math.inf, "∞")]
)
def test_a_quantity_takes_the_prefix_that_suits(value, text):
    assert quantity(value, "V") == text


@pytest.mark.parametrize(
    "value, digits, text",
    [(0.9994, 3, "999 mV"), (0.9996, 3, "1.00 V"), (0.9996, 4, "999.6 mV"), (0.996, 2, "1.0 V"), (999.7, 3, "1.00 kV")],
)
def test_rounding_up_to_a_thousand_takes_the_next_prefix(value, digits, text):
    assert quantity(value, "V", digits=digits) == text.replace(" ", "\u00a0")


@settings(deadline=None)
@given(st.floats(1e-11, 1e11))
def test_a_prefix_leaves_one_to_a_thousand(value):
    scale, _ = prefix(value)
    assert 0.999 <= value / scale < 1000 or scale == 1e9


@settings(deadline=None)
@given(st.floats(allow_nan=True), st.integers(1, 6))
@example(5e-324, 3)
@example(1e-291, 3)
def test_every_number_can_be_shown(value, digits):
    assert significant(value, digits, sign=True) and fixed(value, digits) and with_error(value, abs(value) / 3)


@settings(deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=20), st.floats(0.01, 2))
def test_labels_keep_their_order_and_their_distance(places, gap):
    moved = spread(places, gap)
    order = sorted(range(len(places)), key=lambda i: (places[i], i))
    sorted_places = [moved[i] for i in order]
    assert all(b - a >= gap * (1 - 1e-6) for a, b in zip(sorted_places, sorted_places[1:], strict=False))
    assert sum(moved) == pytest.approx(sum(places), abs=1e-6)


def test_a_logarithmic_axis_has_numbers_of_one_kind():
    with style.drawing():
        figure, axes = style.panels(4, 3)
        axes.plot([1, 2], [3, 60])
        axes.set_yscale("log")
        style.plain_log(axes.yaxis)
        FigureCanvasAgg(figure).draw()
        labels = [one.get_text() for minor in (False, True) for one in axes.get_yticklabels(minor=minor)]
    assert {"10", "20", "40"} <= set(labels)
    assert all(label == "" or label == f"{float(label):g}" for label in labels)
