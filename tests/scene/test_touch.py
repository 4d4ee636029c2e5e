"""Touch profiles: the force they mean at each time, and recordings that are refused."""

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.scene import Touch
from nailoptics.scene.touch import ForceStep


def force_at(touch, time_s):
    return np.interp(time_s, *touch.corners())


def test_a_step_begins_at_start_and_ends_at_release():
    touch = Touch(force_n=2.0, start_s=0.25, release_s=2.25)
    assert force_at(touch, np.array([0.0, 0.2499, 0.25, 1.0, 2.2499, 2.25, 4.0])).tolist() == [0, 0, 2, 2, 2, 0, 0]


def test_a_ramp_has_linear_edges_of_equal_length():
    touch = Touch(profile="ramp", force_n=2.0, start_s=0.5, ramp_s=1.0, release_s=2.0)
    expected = [0, 0, 1, 2, 2, 2, 1, 0, 0]
    assert force_at(touch, np.array([0, 0.5, 1, 1.5, 1.75, 2, 2.5, 3, 4])) == pytest.approx(expected, abs=1e-12)


def test_a_hold_is_constant():
    assert force_at(Touch(profile="hold", force_n=3.0), np.linspace(0, 4, 5)).tolist() == [3.0] * 5


def test_samples_span_the_duration_without_drift():
    times = Touch(duration_s=4.0, sample_rate_hz=100.0).times_s()
    assert len(times) == 401 and times[0] == 0 and times[-1] == 4.0
    assert np.ptp(np.diff(times)) < 1e-12


def recorded(tmp_path, text, **fields):
    path = tmp_path / "touch.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Touch(profile="recorded", file=str(path), **fields)


def test_a_recording_is_followed_between_its_samples(tmp_path):
    touch = recorded(tmp_path, "# pressed by hand\ntime_s,force_n\n1.0,0\n2.0,4\n4.0,0\n", sample_rate_hz=2.0)
    assert touch.times_s().tolist() == [1, 1.5, 2, 2.5, 3, 3.5, 4]
    assert force_at(touch, touch.times_s()) == pytest.approx([0, 2, 4, 3, 2, 1, 0])


def test_a_recording_may_have_other_columns_and_a_byte_order_mark(tmp_path):
    touch = recorded(tmp_path, "\ufeffnote, force_n, time_s\na, 1, 0\nb, 2, 1\n".encode())
    assert touch.recorded_time_s == (0.0, 1.0) and touch.recorded_force_n == (1.0, 2.0)


def test_a_load_cell_that_reads_just_below_zero_is_not_pressed(tmp_path):
    touch = recorded(tmp_path, "time_s,force_n\n0,-0.002\n1,2\n2,-0.05\n")
    assert touch.recorded_force_n == (0.0, 2.0, 0.0)


def test_a_cycle_reaches_its_force_the_requested_number_of_times():
    for waveform, quarter in (("sine", 1.0), ("triangle", 1.0)):
        touch = Touch(profile="cycle", force_n=2.0, start_s=1.0, period_s=4.0, cycles=2, waveform=waveform)
        assert touch.duration_s == 9.0
        times = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 9.0])
        assert force_at(touch, times) == pytest.approx([0, 0, quarter, 2, quarter, 0, 2, 0], abs=1e-12)
    usual = Touch(profile="cycle")
    assert (usual.period_s, usual.cycles, usual.waveform) == (20.0, 3, "sine") and usual.duration_s == 60.25
    fine = np.linspace(0.25, 20.25, 5001)
    assert np.abs(force_at(usual, fine) - np.sin(np.pi * (fine - 0.25) / 20) ** 2).max() < 5e-5


def test_a_list_of_steps_holds_each_force_until_the_next():
    touch = Touch(profile="steps", steps=(ForceStep(start_s=0.5, force_n=1.0), ForceStep(start_s=1.5, force_n=0.25)))
    assert touch.duration_s == 3.5
    assert force_at(touch, np.array([0, 0.499, 0.5, 1.4, 1.5, 3.5])).tolist() == [0, 0, 1, 1, 0.25, 0.25]


def test_corners_are_where_the_force_bends_or_jumps():
    time_s, force_n = Touch(force_n=2.0, start_s=0.5, release_s=1.0).corners()
    assert time_s.tolist() == [0.5, 0.5, 1.0, 1.0] and force_n.tolist() == [0.0, 2.0, 2.0, 0.0]


@pytest.mark.parametrize(("site", "share"), [("proximal", 1.0), ("distal", 0.0), ("even", 0.5)])
def test_a_site_sets_the_share(site, share):
    assert Touch(site=site).proximal_share == share
    assert Touch(site=site, proximal_share=share).proximal_share == share


def test_a_recording_may_hold_pressures_and_shear(tmp_path):
    text = "time_s,proximal_pressure_pa,distal_pressure_pa,shear_n\n0,0,0,0\n1,1e4,5e3,-0.5\n"
    touch = recorded(tmp_path, text)
    assert touch.recorded_proximal_pressure_pa == (0.0, 1e4) and touch.recorded_distal_pressure_pa == (0.0, 5e3)
    assert touch.recorded_force_n is None and touch.recorded_shear_n == (0.0, -0.5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "",
            "needs a header with time_s and force_n, or time_s and proximal_pressure_pa",
        ),
        ("t,f\n0,0\n1,1\n", "needs a header with time_s and force_n, or"),
        ("time_s,force_n\n0,0\n", "has 1 sample; two or more are needed"),
        ("time_s,force_n\n0,0\n1,one\n", "line 3: force_n = 'one' is not a finite number"),
        ("# by hand\ntime_s,force_n\n0,0\n1\n", "line 4: force_n = '' is not a finite number"),
        ("time_s,force_n\n0,0\n2,1\n1,1\n", "line 4: time_s = 1 does not come after 2"),
        ("time_s,force_n\n0,0\n1,1\n1,1\n", "line 4: time_s = 1 does not come after 1"),
        ("time_s,force_n\n0,0\nnan,1\n", "not a finite number; every row needs one"),
        ("time_s,force_n\n0,0\n1,inf\n", "not a finite number; every row needs one"),
        ("time_s,force_n\n0,0\n1,-0.06\n", "line 3: force_n = -0.06 must lie in 0 to 30 N"),
        ("time_s,force_n\n0,0\n1,-0.5\n", "force_n = -0.5 must lie in 0 to 30 N"),
        ("time_s,force_n\n0,0\n1,1000\n", "force_n = 1000 must lie in 0 to 30 N"),
        ("time_s,force_n\n1e12,0\n1000000000001,1\n", "line 2: time_s = 1e+12 must lie in -1e+10 to 1e+10 s"),
        (
            "time_s,distal_pressure_pa\n0,0\n1,1\n",
            "proximal_pressure_pa and distal_pressure_pa; write one",
        ),
        ("time_s,force_n,shear_n\n0,0,0\n1,1,200\n", "shear_n = 200 must lie in -100 to 100 N"),
        ("time_s,force_n,shear_n\n0,0,0\n1,1,x\n", "line 3: shear_n = 'x' is not a finite number"),
        (b"\xff\xfe\x00\x01", "not a text file"),
    ],
)
def test_a_recording_that_cannot_be_followed_is_refused_in_one_line(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        recorded(tmp_path, text)
    line = str(caught.value)
    assert words in line and line.startswith("touch.file ") and "touch.csv" in line
    assert len(line.splitlines()) == 1 and caught.value.exit_code == 2
    assert caught.value.__cause__ is None


def test_a_recording_of_too_many_samples_is_refused_before_they_are_made(tmp_path):
    with pytest.raises(InputError, match="sample_rate_hz = 100 takes 1e.11 samples of the touch; at most 1e7"):
        recorded(tmp_path, "time_s,force_n\n0,0\n1e9,1\n")


def test_a_recording_that_is_not_there_is_named(tmp_path):
    for place in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            Touch(profile="recorded", file=str(place))


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"profile": "recorded"}, "go together"),
        ({"start_s": 2.0, "release_s": 2.0}, "must come after start_s"),
        ({"profile": "ramp", "start_s": 0.0, "ramp_s": 3.0, "release_s": 2.0}, "cuts the ramp"),
        ({"period_s": 2.0}, 'period_s = 2.0 belongs to profile = "cycle"'),
        ({"profile": "steps"}, 'profile = "steps" and the list steps go together'),
        ({"profile": "cycle", "cycles": 0}, "greater than or equal to 1"),
        ({"site": "distal", "proximal_share": 0.5}, 'site = "distal" sets proximal_share to 0, but it is 0.5'),
        ({"duration_s": 80_000.0, "sample_rate_hz": 1000.0}, "at most 1e7"),
    ],
)
def test_impossible_profiles_are_refused(fields, words):
    with pytest.raises(InputError, match=words):
        Touch(**fields)


def test_steps_must_follow_each_other():
    steps = (ForceStep(start_s=1.0, force_n=1.0), ForceStep(start_s=1.0, force_n=0.0))
    with pytest.raises(InputError, match=r"steps\[1\].start_s = 1.0 must come after steps\[0\].start_s = 1.0"):
        Touch(profile="steps", steps=steps)
