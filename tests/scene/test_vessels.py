"""Own constants of the vessels: values and factors, and what is refused."""

import dataclasses

import numpy as np
import pytest
from small_scenes import SMALL_FINGER_BEST

from nailoptics.errors import InputError
from nailoptics.hemodynamics import Parameters, parameters
from nailoptics.hemodynamics.for_scene import blood_model, blood_over_touch
from nailoptics.hemodynamics.parameters import vessels
from nailoptics.hemodynamics.zones import capillary_zones
from nailoptics.report.scene_description import blood_words, check_lines
from nailoptics.scene import Tuning, parse_scene

DISTAL = """profile = "hold"
force_n = 1.0
proximal_share = 0.0
"""


def test_every_constant_of_the_network_can_be_tuned():
    assert list(Tuning.model_fields) == [*(field.name for field in dataclasses.fields(Parameters)), "factors"]


def test_values_and_factors_change_what_they_name_and_nothing_else():
    text = (
        "[blood.tuning]\nvein_stiffness_n_per_m = 4e3\nfactors = { capillary_count = 0.5, arterial_pressure_pa = 1.2 }"
    )
    tuned, named = vessels(parse_scene(SMALL_FINGER_BEST + text)), parameters("best")
    assert tuned == named.replace(
        vein_stiffness_n_per_m=4e3, capillary_count=0.5 * named.capillary_count, arterial_pressure_pa=1.2e4
    )
    assert vessels(parse_scene(SMALL_FINGER_BEST)) == named


def test_each_bed_can_have_its_own_constants():
    text = "[blood.tuning]\ncapillary_count = [1e5, 2e5]\nvenular_share = [0.0, 0.05]\n"
    scene = parse_scene(SMALL_FINGER_BEST + text + "factors = { capillary_area_m2 = [1.0, 0.5] }")
    named = parameters("best")
    area = (named.capillary_area_m2, 0.5 * named.capillary_area_m2)
    assert vessels(scene) == named.replace(
        capillary_count=(1e5, 2e5), venular_share=(0.0, 0.05), capillary_area_m2=area
    )
    assert blood_over_touch(scene).blood_fraction[:, 0].values == pytest.approx([0.03, 0.03], rel=1e-9)
    assert "capillary_count = 100000 (proximal) and 200000 (distal)" in blood_words(scene)


def test_factors_of_the_blood_multiply_the_set_and_its_tuning():
    text = SMALL_FINGER_BEST + "wall_stiffness = 2.0\nvein_stiffness = 0.5\ndistal_stiffness = 1.25\n"
    scene = parse_scene(text + "vein_resistance = 3.0\n[blood.tuning]\ncapillary_stiffness_n_per_m = 4e4\n")
    named = parameters("best")
    changed = {"capillary_stiffness_n_per_m": (8e4, 1e5), "vein_length_m": 3.0 * named.vein_length_m}
    assert vessels(scene) == named.replace(**changed)
    assert "wall_stiffness times 2, vein_stiffness times 0.5" in blood_words(scene)
    assert vessels(parse_scene(SMALL_FINGER_BEST)) == named


@pytest.mark.parametrize("zones", [None, 8])
def test_distal_reach_acts_on_the_whole_bed(zones):
    """Expected: where the bone shields in full it is the reach; where nothing shields nothing changes."""
    text = SMALL_FINGER_BEST + (f"zones = {zones}\n" if zones else "")
    usual, reached = (np.array(capillary_zones(parse_scene(f"{text}distal_reach = {q}")).reach) for q in (0.0, 0.25))
    assert reached == pytest.approx(usual + [0.0, 0.25] * (1.0 - usual))
    assert reached[0, 1] == pytest.approx(0.25, abs=1e-3) and reached[-1, 1] > 0.8
    assert "25 % of the distal pressure on the whole bed" in blood_words(parse_scene(text + "distal_reach = 0.25"))


def test_tuned_vessels_answer_a_touch_in_their_own_way():
    """A vein four times as stiff closes later: less blood is dammed up."""
    stiff = SMALL_FINGER_BEST + "[blood.tuning]\nfactors = { vein_stiffness_n_per_m = 4.0 }"
    dammed = [
        blood_over_touch(parse_scene(text)).blood_fraction.isel(zone=0).max() for text in (SMALL_FINGER_BEST, stiff)
    ]
    assert dammed[1] < 0.9 * dammed[0]


def test_bistable_forces_are_reported():
    """Strong feedback on soft capillaries: few of them, with compliant walls."""
    listed = SMALL_FINGER_BEST.replace("best", "listed")
    soft = listed + "[blood.tuning]\ncapillary_count = 1e3\ncapillary_stiffness_n_per_m = 1.5e4\n[touch]\n" + DISTAL
    assert blood_model(parse_scene(listed + "[touch]\n" + DISTAL)).bistable_forces_n().size == 0
    two = blood_model(parse_scene(soft)).bistable_forces_n()
    assert 0.0 < two.min() < two.max() <= 1.0
    result = {"regions": [], "triangles": 1, "vessels": "best"}
    report = result | {"scene": "soft", "valid": True, "two_balances_n": [two.min(), two.max()]}
    assert f"warning: between {two.min():g} and {two.max():g} N" in check_lines(report)[-1]
    assert len(check_lines(report)) == len(check_lines(report | {"two_balances_n": None})) + 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("vein_stifness_n_per_m = 4e3", 'did you mean "vein_stiffness_n_per_m"'),
        ("vein_count = -1.0", "blood.tuning.vein_count = -1.0: must be greater than 0"),
        ("factors = { vein_cuont = 2.0 }", 'factors.vein_cuont is not a parameter; did you mean "vein_count"'),
        (
            "factors = { vein_count = 0.0 }",
            "blood.tuning.factors.vein_count = 0.0: must be greater than 0 or be an array",
        ),
        ("factors = { vein_count = [1.0, 2.0] }", "factors.vein_count has two values, but it belongs to both beds"),
        (
            "capillary_count = [1.0, -2.0]",
            r"blood.tuning.capillary_count\[1\] = -2.0: must be greater than 0",
        ),
        ("venular_share = [0.0, 1.0]", r"blood.tuning.venular_share\[1\] = 1.0: must be less than 1"),
        ("vein_count = 20.0\nfactors = { vein_count = 2.0 }", "vein_count has both a value and a factor"),
    ],
)
def test_a_tuning_that_cannot_be_is_refused_in_one_line(text, words):
    with pytest.raises(InputError, match=words) as caught:
        parse_scene(SMALL_FINGER_BEST + "[blood.tuning]\n" + text)
    assert len(str(caught.value).splitlines()) == 1
