"""What a scene's touch, vessels and body make of the blood under the nail."""

import numpy as np
import pytest

from nailoptics.scene import parse_scene
from nailoptics.studies.blood_states import blood_over_touch, largest_force_n, steady_blood, touch_pressures_pa, vessels

SCENE = """
schema_version = 1
[finger]
[[leds]]
name = "ir"
part = "led_800"
position_mm = [-1.2, 0.0]
[[photodiodes]]
name = "pd"
position_mm = [0.5, 0.0]
[blood]
parameters = "best"
"""


def scene_with(text, folder=None):
    return parse_scene(SCENE + text, folder=folder)


def test_recorded_pressures_drive_the_blood_and_their_force_is_that_on_both_areas(tmp_path):
    (tmp_path / "touch.csv").write_text(
        "time_s,proximal_pressure_pa,distal_pressure_pa\n0,0,0\n0.5,8000,2000\n2,8000,2000\n"
    )
    scene = scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path)
    run = blood_over_touch(scene)
    assert run.proximal_pressure_pa[-1] == 8000.0 and run.distal_pressure_pa[25] == 1000.0
    # Half of 100 mm^2 on either side.
    assert run.force_n[-1] == pytest.approx(0.5) and largest_force_n(scene) == pytest.approx(0.5)
    assert np.array(touch_pressures_pa(scene, 0.25)) == pytest.approx([4000.0, 1000.0])
    assert steady_blood(scene, [0.0])[0] == pytest.approx([0.03, 0.03], rel=1e-9)


def test_recorded_pressures_go_before_the_force_beside_them(tmp_path):
    (tmp_path / "touch.csv").write_text(
        "time_s,force_n,proximal_pressure_pa,distal_pressure_pa\n0,0,0,0\n1,2,0,5000\n2,2,0,5000\n"
    )
    run = blood_over_touch(scene_with('[touch]\nprofile = "recorded"\nfile = "touch.csv"\n', tmp_path))
    assert run.force_n[-1] == 2.0 and run.proximal_pressure_pa.max() == 0 and run.distal_pressure_pa[-1] == 5000.0


def test_a_distal_cycle_leaves_the_proximal_vein_alone_and_shows_hysteresis():
    text = '[touch]\nprofile = "cycle"\nforce_n = 0.8\nsite = "distal"\nstart_s = 0.0\nperiod_s = 2.0\ncycles = 3\n'
    run = blood_over_touch(scene_with(text + "sample_rate_hz = 50.0"))
    assert run.proximal_pressure_pa.max() == 0 and run.distal_pressure_pa.max() == pytest.approx(8e3)
    distal = run.blood_fraction.isel(zone=1)
    up, down = (float(distal.sel(time=t, method="nearest")) for t in (4.5, 5.5))  # the same force
    assert down < 0.97 * up


def test_a_heartbeat_beats_in_the_blood_and_is_off_unless_asked_for():
    still, beating = (
        scene_with('[touch]\nprofile = "hold"\nforce_n = 0.0\n'),
        "[body.heartbeat]\nrate_variability = 0.0",
    )
    beating = scene_with('[touch]\nprofile = "hold"\nforce_n = 0.0\nduration_s = 6.0\n' + beating)
    run = blood_over_touch(still)
    assert np.ptp(run.blood_fraction.values) < 1e-9 and "arterial_pressure_pa" not in run
    run = blood_over_touch(beating)
    beat = run.blood_fraction.isel(zone=0).sel(time=slice(2.0, None)).values
    assert 0.05 < np.ptp(beat) / beat.mean() < 0.25
    assert np.fft.rfftfreq(beat.size, 0.01)[np.argmax(np.abs(np.fft.rfft(beat - beat.mean())))] == pytest.approx(
        70 / 60, abs=0.15
    )
    assert np.ptp(run.arterial_pressure_pa.values) == pytest.approx(2e3, rel=0.01)


def test_breath_and_slow_waves_add_to_the_beat_and_the_seed_decides():
    parts = "[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n"
    runs = [blood_over_touch(scene_with(f"[body]\nseed = {seed}\n{parts}")) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0].blood_fraction, runs[1].blood_fraction)
    assert not np.allclose(runs[0].blood_fraction, runs[2].blood_fraction)


def test_a_recorded_pulse_is_the_arterial_pressure_and_its_mean_that_of_rest(tmp_path):
    (tmp_path / "pulse.csv").write_text("time_s,arterial_pressure_pa\n0,9000\n2,11000\n4,9000\n")
    scene = scene_with('[body]\nfile = "pulse.csv"\n', tmp_path)
    run = blood_over_touch(scene)
    assert run.arterial_pressure_pa.sel(time=1.0, method="nearest") == pytest.approx(10_000.0)
    assert vessels(scene).arterial_pressure_pa == pytest.approx(10_000.0)
    assert steady_blood(scene, [0.0])[0] == pytest.approx([0.03, 0.03], rel=1e-9)
