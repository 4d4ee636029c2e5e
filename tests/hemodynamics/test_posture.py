"""The hand's height and the venous pressure: how they change the blood, and the false force that they produce."""

import numpy as np
import pytest
from small_scenes import SMALL_FINGER_BEST

from nailoptics.errors import InputError
from nailoptics.hemodynamics import parameters, steady_state
from nailoptics.hemodynamics.for_scene import blood_model, blood_over_touch, steady_blood
from nailoptics.scene import Body, parse_scene
from nailoptics.sensor.information import (
    operating_point,
    physiological_noise_force_n,
)
from nailoptics.studies.scene_check import check

FORCES_N = [0.0, 0.5, 1.0]


def scene_with(body: str, more: str = ""):
    return parse_scene(SMALL_FINGER_BEST + more + body)


def false_n(scene, force_n):
    return blood_model(scene).false_forces_n(force_n, bandwidth_hz=scene.electronics.bandwidth_hz)


def test_a_height_moves_both_pressures_by_the_weight_of_the_blood() -> None:
    usual = parameters("best")
    for height_m, low_pa in ((-0.2, 2080.0), (0.2, 0.0)):
        scene = scene_with(f"[body]\nhand_height_m = {height_m}\n")
        worn = blood_model(scene).parameters
        assert worn.arterial_pressure_pa == pytest.approx(1e4 - 1.04e4 * height_m)
        # Veins of a raised hand collapse instead.
        assert worn.venous_pressure_pa == pytest.approx(low_pa)
        moved = usual.replace(arterial_pressure_pa=worn.arterial_pressure_pa, venous_pressure_pa=low_pa)
        width, rest = (steady_state(one).capillary_diameter_m for one in (moved, usual))
        assert steady_blood(scene, [0.0])[0] == pytest.approx(0.03 * (width / rest) ** 2, rel=1e-9)


def test_a_venous_pressure_fills_the_bed() -> None:
    filled = steady_blood(scene_with("[body]\nvenous_pressure_pa = 1000.0\n"), FORCES_N)
    assert (filled > steady_blood(scene_with(""), FORCES_N)).all()


def test_without_height_and_venous_pressure_nothing_moves() -> None:
    touch = "[touch]\nforce_n = 1.0\nduration_s = 2.0\n"
    plain, level = (blood_over_touch(scene_with(body, touch)) for body in ("", "[body]\nhand_height_m = 0.0\n"))
    assert np.array_equal(plain.blood_fraction, level.blood_fraction)


def test_a_lowered_hands_arterioles_are_wider() -> None:
    body = "[body.heartbeat]\n[body]\nhand_height_m = {}\n"
    low, level, high = (steady_blood(scene_with(body.format(h)), [0.0])[0, 0] for h in (-0.3, 0.0, 0.3))
    assert low > level > high and level == pytest.approx(0.046)


def test_the_false_force_of_a_small_change_moves_the_blood_as_it_does() -> None:
    scene, force_n = scene_with("[body]\nvenous_pressure_pa = 20.0\n"), 0.3
    change = steady_blood(scene, [force_n]) - steady_blood(scene_with(""), [force_n])
    # A touch on both sides whose pressures change by what the force of either side is.
    shift_n = blood_model(scene).posture_force_n(force_n)
    areas_m2 = blood_model(scene).touch.contact_at(force_n)[2]
    per_pa = []
    for step in np.eye(2):
        moved = blood_model(scene_with("")).touch.held_pa([force_n])[:, 0] + step
        per_pa.append(
            blood_model(scene_with("")).steady(moved[:, None])[0] - steady_blood(scene_with(""), [force_n])[0]
        )
    assert shift_n == pytest.approx(areas_m2 @ np.linalg.solve(np.transpose(per_pa), change[0]), rel=0.02)
    assert blood_model(scene_with("[body]\nhand_height_m = 0.0\n")).posture_force_n(force_n) == 0.0


def test_false_forces_are_parts_of_that_of_the_whole_body() -> None:
    """Expected: squares of waves add up; each part is at the mean pressure, posture and arterioles of the scene."""
    body = "[body]\nhand_height_m = 0.3\nvenous_pressure_pa = {}\n[body.breathing]\n[body.heartbeat]\n"
    tuning = "mean_pressure_pa = 9000.0\n[blood.tuning]\nvenous_pressure_pa = 1000.0\n"
    scene = scene_with(body.format(1000.0) + tuning)
    parts = false_n(scene, 0.5)
    waves_n = physiological_noise_force_n(operating_point(scene, 0.5))
    assert np.hypot(parts["breathing"], parts["heartbeat"]) == pytest.approx(waves_n, rel=1e-9)
    assert parts["hand_height_m"] == blood_model(scene).posture_force_n(0.5) and parts["venous_pressure_pa"] == 0.0
    assert false_n(scene_with(body.format(0.0) + tuning), 0.5)["venous_pressure_pa"] < -0.001
    assert false_n(scene_with(""), 0.5) == {}
    time_s = np.linspace(0.0, 10.0, 501)
    columns = {"time_s": time_s, "arterial_pressure_pa": 1e4 + 2e3 * np.sin(6.0 * time_s)}
    body = Body(**{f"recorded_{name}": tuple(column) for name, column in columns.items()})
    recorded = scene_with("").model_copy(update={"body": body})
    waves_n = physiological_noise_force_n(operating_point(recorded, 0.5))
    assert false_n(recorded, 0.5) == {"file": pytest.approx(waves_n, rel=1e-9)} and waves_n > 0.01


def moving(**columns) -> Body:
    return Body(recorded_time_s=(0.0, 4.0, 6.0, 20.0), **{f"recorded_{name}": row for name, row in columns.items()})


def worn(body: Body, force_n: float = 0.0):
    touch = f'[touch]\nprofile = "hold"\nforce_n = {force_n}\nduration_s = 20.0\nsample_rate_hz = 10.0\n'
    return scene_with("", touch).model_copy(update={"body": body})


@pytest.mark.parametrize(
    ("columns", "ends"),
    [
        ({"hand_height_m": (0.0, 0.0, 0.2, 0.2)}, ("hand_height_m = 0.0", "hand_height_m = 0.2")),
        ({"hand_height_m": (-0.1, -0.1, -0.3, -0.3)}, ("hand_height_m = -0.1", "hand_height_m = -0.3")),
        ({"venous_pressure_pa": (0.0, 0.0, 800.0, 800.0)}, ("venous_pressure_pa = 0.0", "venous_pressure_pa = 800.0")),
    ],
)
def test_blood_goes_from_one_posture_to_the_other_as_it_was_recorded(columns, ends) -> None:
    course = blood_over_touch(worn(moving(**columns)))
    for at, line in zip((30, -1), ends, strict=True):
        still = steady_blood(scene_with(f"[body]\n{line}\n"), [0.0])[0]
        assert course.blood_fraction.values[:, at] == pytest.approx(still, rel=1e-4)
    assert "venous_pressure_pa" in course and course.venous_pressure_pa.dims == ("time",)


def test_a_recorded_height_moves_what_beats() -> None:
    """Expected: the pressure of the beating artery is that of the level hand, less the weight of the blood."""
    beats = scene_with("[body.heartbeat]\n").body
    bodies = [
        beats.model_copy(update={"recorded_time_s": (0.0, 20.0), "recorded_hand_height_m": (h, h)}) for h in (0.0, 0.2)
    ]
    level, raised = (blood_over_touch(worn(body)) for body in bodies)
    fall_pa = level.arterial_pressure_pa - raised.arterial_pressure_pa
    assert fall_pa.values == pytest.approx(2080.0, rel=1e-9)
    still = blood_over_touch(worn(beats.model_copy(update={"hand_height_m": 0.2})))
    assert raised.blood_fraction.values == pytest.approx(still.blood_fraction.values, rel=1e-4)


def test_the_false_force_of_a_recording_is_its_largest_shift_from_the_start() -> None:
    columns = {"hand_height_m": (0.1, 0.12, 0.05, 0.1), "venous_pressure_pa": (200.0, 200.0, 250.0, 210.0)}
    recorded_n = false_n(worn(moving(**columns), 0.5), 0.5)
    lowered = blood_model(scene_with("[body]\nhand_height_m = 0.05\n"))
    at_rest = {"hand_height_m": 0.1, "venous_pressure_pa": None}
    assert recorded_n["hand_height_m"] == pytest.approx(lowered.posture_force_n(0.5, at_rest), rel=1e-9)
    filled = blood_model(scene_with("[body]\nvenous_pressure_pa = 250.0\n"))
    shift_n = filled.posture_force_n(0.5, {"venous_pressure_pa": 200.0})
    assert recorded_n["venous_pressure_pa"] == pytest.approx(shift_n, rel=1e-9)
    assert 0.01 < abs(recorded_n["hand_height_m"]) < 0.1 and "file" not in recorded_n


def test_check_states_the_false_force(shared_light: None) -> None:
    (line,) = [x for x in check(scene_with("[body]\nhand_height_m = -0.1\n"))["warnings"] if "hand_height" in x]
    assert "false force of +0." in line and "N at 0.5 N" in line


@pytest.mark.parametrize(
    ("line", "words"),
    [("hand_height_m = 1.5", "hand_height_m = 1.5"), ("venous_pressure_pa = 2e4", "venous_pressure_pa")],
)
def test_a_posture_that_cannot_be_is_refused_in_one_line(line: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        scene_with(f"[body]\n{line}\n")
    assert "\n" not in str(error.value)


def test_where_touch_hardly_moves_blood_there_is_no_false_force() -> None:
    """A vein that is shut at 1.5 N would take hundreds of newtons to first order."""
    scene = scene_with("[body]\nhand_height_m = 0.3\n[body.heartbeat]\n")
    assert all(np.isfinite(x) for x in false_n(scene, 0.3).values())
    assert all(np.isnan(x) for x in false_n(scene, 1.5).values())
