"""What moves the arterial pressure, as a scene states it: off unless requested, or recorded."""

import pytest
from small_scenes import SMALL_FINGER

from nailoptics.errors import InputError
from nailoptics.scene import Body, Drift, Heartbeat, Motion, Vasomotion, digest, parse_scene
from nailoptics.scene.files import to_toml


def test_a_scene_without_a_body_has_none_and_an_empty_one_moves_nothing():
    assert parse_scene(SMALL_FINGER).body is None
    assert not parse_scene(SMALL_FINGER + "[body]\n").body.moves


def test_each_part_is_on_with_its_defaults_once_it_is_named():
    body = parse_scene(SMALL_FINGER + "[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n").body
    assert body.moves and body.seed == 0
    assert (body.heartbeat.rate_per_min, body.heartbeat.mean_pressure_pa) == (70.0, None)
    assert body.breathing.rate_per_min == 15.0 and body.vasomotion.band_hz == (0.05, 0.15)


def test_drift_and_motion_are_the_sensors_and_leave_the_pressure_alone(tmp_path):
    scene = parse_scene(SMALL_FINGER + "[body.drift]\n[body.motion]\n")
    assert scene.body.drift.led_per_rt_min > scene.body.drift.reading_per_rt_min > 0
    assert scene.body.motion.lift_um == 1.0 and not scene.body.moves
    (tmp_path / "pulse.csv").write_text("time_s,arterial_pressure_pa\n0,9e3\n4,1.1e4\n")
    both = parse_scene(SMALL_FINGER + '[body]\nfile = "pulse.csv"\n[body.drift]\n', folder=tmp_path)
    assert both.body.moves and both.body.drift is not None


def test_the_mean_pressure_is_stated_once():
    twice = "[blood.tuning]\nfactors = { arterial_pressure_pa = 1.1 }\n[body.heartbeat]\nmean_pressure_pa = 1.2e4\n"
    with pytest.raises(InputError, match="both set P_H; give one of them"):
        parse_scene(SMALL_FINGER + twice)


def recorded(tmp_path, text, end_s=4.0):
    (tmp_path / "pulse.csv").write_text(text)
    return parse_scene(SMALL_FINGER + f'[touch]\nduration_s = {end_s}\n[body]\nfile = "pulse.csv"\n', folder=tmp_path)


def test_a_recorded_pressure_becomes_part_of_the_scene(tmp_path):
    scene = recorded(tmp_path, "time_s,arterial_pressure_pa\n0,9e3\n4,1.1e4\n")
    assert scene.body.recorded_arterial_pressure_pa == (9e3, 1.1e4) and scene.body.moves
    assert digest(parse_scene(to_toml(scene))) == digest(scene)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,force_n\n0,1\n4,1\n", "needs a header with time_s and arterial_pressure_pa, or"),
        (
            "time_s,arterial_pressure_pa\n0,75\n4,7e4\n",
            "line 3: arterial_pressure_pa = 70000 must lie in -10000 to 60000 Pa",
        ),
        ("time_s,hand_height_m\n0,0\n4,1.2\n", "line 3: hand_height_m = 1.2 must lie in -1 to 1 m"),
        ("time_s,venous_pressure_pa\n0,0\n4,90000\n", "line 3: venous_pressure_pa = 90000 must lie in -5000 to 10000"),
        ("time_s,arterial_pressure_pa\n0,1e4\n3,1e4\n", "reaches from 0 to 3 s, but the touch from 0 to 4 s"),
    ],
)
def test_a_recorded_pressure_that_cannot_be_used_is_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as caught:
        recorded(tmp_path, text)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Heartbeat(rate_per_min=0.0), "greater than or equal to 20"),
        (lambda: Heartbeat(rate_variability=0.5), "less than or equal to 0.2"),
        (lambda: Heartbeat(mean_pressure_pa=1e300), "mean_pressure_pa = 1e.300: must be less than or"),
        (lambda: Vasomotion(amplitude_pa=1e5), "less than or equal to 60000"),
        (lambda: Vasomotion(band_hz=(0.2, 0.1)), "must rise"),
        (lambda: Vasomotion(band_hz=(0.05, 2000.0)), "less than or equal to 5"),
        (lambda: Drift(led_per_rt_min=-0.1), "greater than or equal to 0"),
        (lambda: Motion(correlation_s=0.0), "greater than or equal to 0.1"),
        (
            lambda: Body(heartbeat=Heartbeat(), recorded_time_s=(0.0, 1.0), recorded_arterial_pressure_pa=(1e4, 1e4)),
            r"leave out \[body.heartbeat\]",
        ),
        (
            lambda: Body(hand_height_m=0.1, recorded_time_s=(0.0, 1.0), recorded_hand_height_m=(0.0, 0.2)),
            "file holds hand_height_m over time; leave out hand_height_m = 0.1",
        ),
    ],
)
def test_a_body_that_cannot_be_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
