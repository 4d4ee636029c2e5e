"""Inputs over time: what is between samples, and where an integrator has to stop."""

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.hemodynamics import Waveform
from nailoptics.hemodynamics.drive import Drive


def drive_of(time, values):
    """A drive with a channel for each row of samples."""
    rows = [Waveform(time_s=time, pressure_pa=row) for row in values]
    return Drive(rows, lambda inputs: inputs, begin_s=time[0], end_s=time[-1])


def stops(drive):
    """Instants between two stretches, and both ends."""
    return [drive.starts[first] for first, _ in drive.stretches] + [drive.ends[-1]]


def read(drive, times):
    """Every channel at given times, (times, channels)."""
    return np.array([drive.at(t, 0, len(drive.starts) - 1) for t in times])


def test_values_are_linear_between_samples():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(1e-3, 1e-1, 50))
    values = rng.normal(0, 1e3, (3, 50))
    probe = rng.uniform(time[0], time[-1], 200)
    exact = np.array([np.interp(probe, time, row) for row in values]).T
    assert np.allclose(read(drive_of(time, values), probe), exact, rtol=1e-9, atol=1e-9)


def test_lines_have_no_stops_and_impulses_have_their_own():
    time = np.arange(0.0, 4.0, 1e-3)
    assert stops(drive_of(time, 5.0 * time[None])) == [0.0, time[-1]]
    impulse = np.zeros((1, time.size))
    impulse[0, 1000] = 1e4
    assert stops(drive_of(time, impulse)) == [0.0, time[999], time[1000], time[1001], time[-1]]


def test_the_corner_of_a_ramp_is_a_stop_however_finely_it_is_sampled():
    time = np.linspace(0.0, 1.0, 40001)
    ramp = np.interp(time, [0.0, 0.4, 0.6, 1.0], [0.0, 1e4, 1e4, 0.0])
    assert np.allclose(stops(drive_of(time, ramp[None])), [0.0, 0.4, 0.6, 1.0], atol=3e-5)


def test_a_smooth_curve_has_few_stops_and_a_smooth_slope():
    time = np.arange(0.0, 4.0, 1e-3)
    drive = drive_of(time, 1e4 * np.sin(np.pi * time)[None])
    assert 20 < len(drive.stretches) < 60
    probe = np.linspace(0.01, 3.98, 999)
    pieces = np.searchsorted(drive.ends, probe)
    slopes = np.array([drive.slope(t, i, smooth=True)[0] for t, i in zip(probe, pieces, strict=True)])
    exact = 1e4 * np.pi * np.cos(np.pi * probe)
    assert np.abs(slopes - exact).max() < 1e-4 * np.abs(exact).max()


def test_a_bump_of_any_width_is_resolved_whatever_the_rate_of_samples():
    for rate in (1e3, 1e4):
        time = np.arange(0.0, 4.0, 1 / rate)
        for width in (0.01, 0.1, 0.5):
            bump = 1e4 * np.exp(-0.5 * ((time - 2.0) / width) ** 2)
            near = [t for t in stops(drive_of(time, bump[None])) if abs(t - 2.0) < 2 * width]
            assert 4 < len(near) < 60


def test_within_a_piece_the_slope_is_its_own():
    drive = drive_of(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 1.0, -3.0]]))
    assert drive.slope(0.999, 0, smooth=False) == [1.0] and drive.slope(1.0, 1, smooth=False) == [-4.0]


@pytest.mark.parametrize("rate", [1e3, 1e5, 1e6])
def test_a_smooth_curve_is_kept_however_finely_it_is_sampled(rate):
    time = np.arange(0.0, 1.0, 1 / rate)
    curve = np.sin(np.pi * time)
    drive = drive_of(time, 1e4 * curve[None])
    probe = np.linspace(0.0, time[-1], 333)
    # A line through two samples a millisecond apart misses the curve by (pi/1000)^2/8, some 1e-6.
    assert np.abs(read(drive, probe)[:, 0] / 1e4 - np.sin(np.pi * probe)).max() < 2e-6
    assert len(drive.starts) <= min(time.size, 1e5)


def test_a_waveform_jumps_at_double_knots_and_is_held_outside():
    step = Waveform(time_s=[1.0, 2.0, 2.0, 3.0], pressure_pa=[5.0, 7.0, 0.0, 1.0])
    times = np.array([0.0, 1.0, 1.5, 2.0, 2.5, 9.0])
    assert np.array_equal(step.at(times), [5.0, 5.0, 6.0, 0.0, 0.5, 1.0])
    assert np.array_equal(step.at(times, before_jump=True), [5.0, 5.0, 6.0, 7.0, 0.5, 1.0])


def test_a_jump_is_a_stop_and_neither_side_depends_on_the_other():
    step = Waveform(time_s=[0.0, 1.0, 1.0, 4.0], pressure_pa=[0.0, 0.0, 9.0, 9.0])
    ramp = Waveform(time_s=[0.0, 4.0], pressure_pa=[0.0, 4.0])
    drive = Drive([step, ramp], lambda inputs: inputs, begin_s=0.0, end_s=4.0)
    assert stops(drive) == [0.0, 1.0, 4.0]
    assert drive.at(1.0, 0, 0) == [0.0, 1.0] and drive.at(1.0, 1, 1) == [9.0, 1.0]
    assert drive.slope(1.0, 1, smooth=False) == [0.0, 1.0]


@pytest.mark.parametrize(
    ("time", "pressure", "message"),
    [
        ([0.0, 1.0], [1.0], "two rows of one length"),
        (1.0, 2.0, "two rows of one length"),
        ([0.0, 2.0, 1.0], [0.0, 0.0, 0.0], "times must not fall"),
        ([0.0, np.nan], [0.0, 0.0], r"waveform.time_s\[1\] = nan must be finite"),
    ],
)
def test_a_faulty_waveform_is_one_clear_line(time, pressure, message):
    with pytest.raises(InputError, match=message) as caught:
        Waveform(time_s=time, pressure_pa=pressure)
    assert "\n" not in str(caught.value)
