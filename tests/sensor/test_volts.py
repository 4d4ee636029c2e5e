"""Drift and motion of the worn sensor: as strong as the scene states, the same for one seed, and traced."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import SMALL_FINGER

from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.light import DetectedLight, optics
from nailoptics.light.transfer.series import ReadingSeries
from nailoptics.scene import Body, Drift, Motion, parse_scene
from nailoptics.sensor.volts import WornLight, drift_and_motion, motion_artefact, moved_boards, read_volts
from nailoptics.studies.simulate import simulate


def worn(seed=0, **parts):
    return parse_scene(SMALL_FINGER).model_copy(update={"body": Body(seed=seed, **parts)})


def test_a_still_body_moves_no_sensor():
    assert not drift_and_motion(parse_scene(SMALL_FINGER), np.arange(3.0)).data_vars
    assert not drift_and_motion(worn(), np.arange(3.0)).data_vars and moved_boards(worn()) == []


def slid(board="", led_v=0.0):
    text = SMALL_FINGER.replace("[-1.2, 0.0]", f"[-1.2, {led_v}]") + f"[board]\n{board}\n[body.motion]\nlift_um = 0.0"
    scene = parse_scene(text)
    ((name, distance_um, moved),) = moved_boards(scene)
    there = scene.model_copy(update={"board": moved}).layout
    assert name == "slide"
    assert there.leds[0].v_min - scene.layout.leds[0].v_min == pytest.approx(1e-3 * distance_um)
    return distance_um, scene.layout.outline, there.outline


def test_a_board_as_long_as_the_nail_is_slid_and_ends_at_the_nails_edge():
    distance_um, outline, there = slid()
    assert distance_um == 250 and there.v_max == outline.v_max + 0.25
    # 11.8 of 12 mm: 0.05 mm short of the edge the board ends.
    distance_um, outline, there = slid("size_mm = [9.0, 11.8]")
    assert distance_um == 250 and (there.v_min, there.v_max) == pytest.approx((-5.65, 5.95))
    # With a part at the tip it is slid the other way; with one at the root, too, there is none.
    assert slid("size_mm = [9.0, 11.8]", led_v=5.7)[0] == -250
    both = parse_scene(
        SMALL_FINGER.replace("[-1.2, 0.0]", "[-1.2, 5.7]").replace("[0.5, 0.0]", "[0.5, -5.3]")
        + "[board]\nsize_mm = [9.0, 11.8]\n[body.motion]"
    )
    with pytest.raises(InputError, match="body.motion.slide_um: the parts lie within 0.25 mm of both ends"):
        moved_boards(both)


def test_drifts_have_the_stated_standard_deviation_after_a_minute_and_begin_at_zero():
    drift, time_s = Drift(led_per_rt_min=0.01, reading_per_rt_min=0.002), np.array([0.0, 60.0])
    made = [drift_and_motion(worn(seed, drift=drift), time_s) for seed in range(300)]
    for name, spread in (("led_drift", 0.01), ("reading_drift", 0.002)):
        walks = np.array([np.log(one[name].values).reshape(-1, 2)[0] for one in made])
        assert (walks[:, 0] == 0).all()
        # 300 of them estimate a standard deviation to 4 %.
        assert walks[:, 1].std() == pytest.approx(spread, rel=0.16) and abs(walks[:, 1].mean()) < 4 * spread / 300**0.5


def test_motion_has_the_stated_standard_deviation_and_correlation_time():
    motion = Motion(lift_um=2.0, slide_um=0.0, correlation_s=1.0)
    time_s = np.arange(0.0, 3000.0, 0.1)
    lift = drift_and_motion(worn(3, motion=motion), time_s).sensor_lift_um.values
    # 3000 correlation times of 1 s estimate a standard deviation to 2 %, a correlation of 0.37 to 2 %.
    assert lift.std() == pytest.approx(2.0, rel=0.08)
    assert np.corrcoef(lift[:-10], lift[10:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.08)
    assert np.allclose(drift_and_motion(worn(3, motion=motion), time_s[:50:7]).sensor_lift_um, lift[:50:7])
    assert "sensor_slide_um" not in drift_and_motion(worn(3, motion=motion), time_s[:5])


def test_readings_change_exponentially_with_the_lift_from_the_moved_boards_light():
    scene, time_s = worn(1, motion=Motion(slide_um=0.0)), np.arange(4.0)
    fraction, zero = np.array([[[1.0, 1.0, 2.0, 2.0]]]), np.zeros((1, 1, 4))
    here = ReadingSeries(fraction, 0.01 * fraction, zero, zero)

    class Lifted:
        def readings_at(self, blood):
            return ReadingSeries(0.8 * fraction, 0.01 * fraction, zero, zero)

    course = drift_and_motion(scene, time_s)
    ((name, distance_um, board),) = moved_boards(scene)
    assert name == "lift" and board.adhesive_um - scene.board.adhesive_um == pytest.approx(distance_um) == 40.0
    factor, data = motion_artefact(course, here, {"lift": (40.0, Lifted())}, np.zeros((4, 2)))
    assert factor[0, 0] == pytest.approx(0.8 ** (course.sensor_lift_um.values / 40.0))
    assert data["lift_per_um"][1] == pytest.approx(np.log(0.8) / 40.0)
    assert data["lift_per_um_stderr"][1] == pytest.approx(np.hypot(0.01, 0.0125) / 40.0)
    with pytest.raises(InputError, match="traced by simulate alone"):
        motion_artefact(course, here, {}, np.zeros((4, 2)))


@pytest.mark.parametrize("distance_um", [250.0, -250.0])
def test_a_slide_of_either_sign_scales_with_the_moved_boards_light(distance_um):
    """Light that falls by a tenth in 250 um one way, and a sensor that slides the same way or the other."""
    scene, time_s = worn(1, motion=Motion(lift_um=0.0)), np.arange(4.0)
    ones, zero = np.ones((1, 1, 4)), np.zeros((1, 1, 4))
    there = SimpleNamespace(readings_at=lambda blood: ReadingSeries(0.9 * ones, 0.01 * ones, zero, zero))
    course = drift_and_motion(scene, time_s)
    here = ReadingSeries(ones, 0.01 * ones, zero, zero)
    factor, _ = motion_artefact(course, here, {"slide": (distance_um, there)}, np.zeros((4, 2)))
    assert factor[0, 0] == pytest.approx(0.9 ** (course.sensor_slide_um.values / distance_um))


def test_the_error_of_a_change_has_that_of_the_reading_as_far_as_drift_scales_it():
    """Light of a relative error of 2 % that never changes: the change by drift is known to 2 %, but for a term of
    second order, the drift itself."""
    scene = worn(3, drift=Drift(led_per_rt_min=0.1, reading_per_rt_min=0.0)).with_({"electronics.feedback_ohm": 1e5})
    course = blood_over_touch(scene.model_copy(update={"body": None}))
    ones = np.ones((1, 1, course.sizes["time"]))
    series = [part * 1e-3 * ones for part in (1.0, 0.02, 0.0, 0.0)]
    none = np.full((1, 1, len(optics.absorbers(scene))), np.nan)
    light = DetectedLight(lambda states: ReadingSeries(*map(np.copy, series)), none, none, optics.absorbers(scene), {})
    result = read_volts(WornLight(scene, light, None), course)
    change_v, stderr_v = result.volts_change.values[0, 0], result.volts_change_stderr.values[0, 0]
    known, drift = 0.02 * np.abs(change_v), np.abs(result.led_drift.values[0] - 1)
    assert known[1:].min() > 0 and 0.005 < drift.max() < 0.1
    assert np.all(np.abs(stderr_v - known) <= 1.01 * drift * known + 1e-15)


@pytest.mark.jit
def test_a_worn_sensor_reads_light_times_motion_and_drift(chosen_jit, coarse_cells, store, caplog):
    touch = "[touch]\nduration_s = 1.0\nsample_rate_hz = 20.0\nstart_s = 0.2\nrelease_s = 0.8\n"
    still = parse_scene(SMALL_FINGER + touch + "[electronics]\nfeedback_ohm = 1e5\n[priors]\nspread = false\n")
    body = Body(seed=2, drift=Drift(led_per_rt_min=0.1), motion=Motion(lift_um=50.0, slide_um=0.0))
    plain, moved = (
        simulate(scene, photons=1 << 16, seed=4) for scene in (still, still.model_copy(update={"body": body}))
    )
    by_lift = np.exp(moved.lift_per_um.values[0, 0] * moved.sensor_lift_um.values)
    drift = moved.led_drift.values[0] * moved.reading_drift.values[0, 0]
    # That a lift does the same under a touch as at rest holds to a part of the lift's own effect.
    assert moved.volts.values[0, 0] == pytest.approx(plain.volts.values[0, 0] * by_lift * drift, rel=2e-3)
    assert not plain.saturated.any() and np.abs(moved.volts / plain.volts - 1).max() > 5e-3
    assert np.abs(by_lift - 1).max() > 4e-3 and np.abs(drift - 1).max() > 4e-3
    assert float(moved.lift_per_um_stderr.max()) > 0
    # Where the converter is at its limit volts have no uncertainty, and changes have that of the other reading.
    mid_v = float(plain.volts.min() + plain.volts.max()) / 2
    full = simulate(still.with_({"electronics.feedback_ohm": 1e5 * 5.0 / mid_v}), photons=1 << 16, seed=4)
    at_limit, stderr = full.saturated.values[0, 0], full.volts_stderr.values[0, 0]
    assert at_limit.any() and not at_limit[0] and "saturated: pd; lower leds.flux_mw or" in caplog.text
    assert (stderr[at_limit] == 0).all() and (stderr[~at_limit] > 0).all()
    assert (full.volts_change_stderr.values[0, 0, at_limit] == stderr[0]).all()
    # One seed, one time series.
    again = simulate(still.model_copy(update={"body": body}), photons=1 << 16, seed=4)
    assert np.array_equal(again.volts, moved.volts)
