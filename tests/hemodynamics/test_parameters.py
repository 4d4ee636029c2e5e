"""Named sets, bounds for tuning, and what happens to values that cannot be."""

import math

import pytest
from equal_zones import equal_zones

from nailoptics.errors import InputError
from nailoptics.hemodynamics import NAMES, Parameters, bounds, parameters
from nailoptics.hemodynamics.parameters import beds
from nailoptics.hemodynamics.zones import Zones, zones_between


def test_listed_set_holds_the_values_of_the_paper():
    # Mascaro and Asada 2001, table of parameters.
    p = parameters("listed")
    assert (p.capillary_stiffness_n_per_m, p.vein_stiffness_n_per_m) == (1e5, 1e3)
    assert (p.capillary_mass_kg, p.vein_mass_kg) == (1e-3, 1e-3)
    assert (p.capillary_damping_n_s_per_m, p.vein_damping_n_s_per_m) == (1e4, 1e2)
    assert (p.capillary_area_m2, p.vein_area_m2) == (1e-4, 1e-4)
    assert (p.capillary_diameter_m, p.vein_diameter_m) == (1e-5, 1e-4)
    assert (p.capillary_length_m, p.vein_length_m) == (1e-3, 1e-2)
    assert (p.capillary_count, p.vein_count) == (1e5, 1e2)
    assert (p.viscosity_pa_s, p.venule_resistance_pa_s_per_m3) == (3e-3, 1e11)
    assert (p.arterial_pressure_pa, p.venous_pressure_pa) == (1e4, 0.0)


def test_named_sets_keep_within_their_distance_from_the_list():
    within_two, within_ten = bounds(factor=2.0 + 1e-12), bounds(factor=10.0)
    for name in NAMES:
        values = parameters(name).as_dict()
        for field, (low, high) in within_ten.items():
            assert all(low <= value <= high for value in beds(values[field])), (name, field)
    figures = parameters("figures").as_dict()
    assert all(low <= figures[field] <= high for field, (low, high) in within_two.items())


def test_replace_returns_a_checked_copy():
    p = parameters("listed")
    softer = p.replace(vein_stiffness_n_per_m=2e3)
    assert softer.vein_stiffness_n_per_m == 2e3 and p.vein_stiffness_n_per_m == 1e3
    assert softer.replace(vein_stiffness_n_per_m=1e3) == p
    with pytest.raises(InputError, match="vein_stifness is not a parameter"):
        p.replace(vein_stifness=2e3)


def test_a_constant_of_the_beds_is_one_number_or_two():
    p = parameters("listed").replace(capillary_count=[1e5, 2e5], venule_resistance_pa_s_per_m3=(1e11, 1e11))
    assert p.capillary_count == (1e5, 2e5) and p.venule_resistance_pa_s_per_m3 == 1e11
    assert p.replace(capillary_count=1e5) == parameters("listed")
    for name, value in (
        ("vein_count", (1.0, 2.0)),
        ("capillary_count", (1.0, 2.0, 3.0)),
        ("capillary_count", (1.0, 0.0)),
    ):
        with pytest.raises(InputError, match=f"^{name} must be"):
            p.replace(**{name: value})
    for share in (1.0, -0.1):
        with pytest.raises(InputError, match="venular_share must be 0 or more and less than 1"):
            p.replace(venular_share=share)


def test_units_have_the_constants_of_the_half_in_which_they_lie():
    pair = (2.0, 4.0)
    assert equal_zones(2).of_beds(pair) == [2.0, 4.0] and equal_zones(4).of_beds(pair) == [2.0, 2.0, 4.0, 4.0]
    assert equal_zones(3, decay_length=0.3).of_beds(pair) == pytest.approx([2.0, 3.0, 4.0])
    assert equal_zones(8, decay_length=0.3).of_beds(pair) == [2.0] * 4 + [4.0] * 4
    assert equal_zones(3, decay_length=0.3).of_beds(5.0) == [5.0] * 3


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, -math.inf, "stiff", None])
@pytest.mark.parametrize("name", ["vein_stiffness_n_per_m", "capillary_mass_kg", "viscosity_pa_s", "vein_count"])
def test_a_value_that_cannot_be_is_named_in_the_error(name, value):
    with pytest.raises(InputError, match=f"^{name} (= -?(nan|inf) )?must be") as caught:
        parameters("listed").replace(**{name: value})
    assert "\n" not in str(caught.value) and caught.value.exit_code == 2


def test_body_pressures_may_have_any_sign_but_must_be_finite():
    p = Parameters(arterial_pressure_pa=-1e3, venous_pressure_pa=2e3)
    assert p.arterial_pressure_pa == -1e3
    with pytest.raises(InputError, match="arterial_pressure_pa = .* must be finite"):
        p.replace(arterial_pressure_pa=math.nan)


def test_unknown_sets_and_factors_are_refused():
    with pytest.raises(InputError, match="'listd' is not a named set; use one of listed"):
        parameters("listd")
    with pytest.raises(InputError, match="factor"):
        bounds(factor=1.0)


def test_zones_check_their_shapes_and_numbers():
    for wrong in ({"decay_length": 0.0}, {"shield": (0.5, 0.0)}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            zones_between([0.5], **wrong)
    with pytest.raises(InputError, match="sum of 2"):
        Zones(share=(1.0, 0.5), reach=((0.0,), (1.0,)), vein_reach=(1.0,))
    with pytest.raises(InputError, match="shape"):
        Zones(share=(1.0, 1.0), reach=((0.0,), (1.0,)), vein_reach=(1.0, 0.0))
    with pytest.raises(InputError, match="finite"):
        Zones(share=(1.0, 1.0), reach=((0.0,), (math.nan,)), vein_reach=(1.0,))
    with pytest.raises(InputError, match="greater than 0"):
        Zones(share=(2.0, 0.0), reach=((0.0,), (1.0,)), vein_reach=(1.0,))


def test_reach_falls_off_from_the_tip():
    for count in (2, 5, 8, 9):
        cut = equal_zones(count, decay_length=0.3)
        reach = [row[1] for row in cut.reach]
        assert all(a < b for a, b in zip(reach[:-1], reach[1:], strict=True))
        inside = [min(max(count * (x - 0.5) + 0.5, 0.0), 1.0) for x in cut.position]
        assert sum(r * w for r, w in zip(reach, inside, strict=True)) == pytest.approx(sum(inside))
