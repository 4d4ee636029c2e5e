"""Inputs over time: what is between samples, and where an integrator has to stop."""

import numpy as np

from nailoptics.hemodynamics.drive import Drive


def test_values_are_linear_between_samples():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(1e-3, 1e-1, 50))
    values = rng.normal(0, 1e3, (3, 50))
    drive = Drive(time, values)
    for t in rng.uniform(time[0], time[-1], 200):
        assert np.allclose(drive.at(t), [np.interp(t, time, row) for row in values], rtol=1e-9, atol=1e-9)


def test_a_line_has_no_stops_and_an_impulse_of_one_sample_has_all_of_its_own():
    time = np.arange(0.0, 4.0, 1e-3)
    assert Drive(time, 5.0 * time[None]).stops == [0.0, time[-1]]
    impulse = np.zeros((1, time.size))
    impulse[0, 1000] = 1e4
    assert Drive(time, impulse).stops == [0.0, time[999], time[1000], time[1001], time[-1]]


def test_the_corner_of_a_ramp_is_a_stop_however_finely_it_is_sampled():
    time = np.linspace(0.0, 1.0, 40001)
    ramp = np.interp(time, [0.0, 0.4, 0.6, 1.0], [0.0, 1e4, 1e4, 0.0])
    assert np.allclose(Drive(time, ramp[None]).stops, [0.0, 0.4, 0.6, 1.0], atol=3e-5)


def test_a_smooth_curve_has_few_stops_and_a_smooth_slope():
    time = np.arange(0.0, 4.0, 1e-3)
    drive = Drive(time, 1e4 * np.sin(np.pi * time)[None])
    assert 20 < len(drive.stops) < 60
    probe = np.linspace(0.01, 3.98, 999)
    slopes = np.array([drive.slope(t)[0] for t in probe])
    exact = 1e4 * np.pi * np.cos(np.pi * probe)
    assert np.abs(slopes - exact).max() < 1e-4 * np.abs(exact).max()


def test_a_bump_of_any_width_is_seen_whatever_the_rate_of_samples():
    for rate in (1e3, 1e4):
        time = np.arange(0.0, 4.0, 1 / rate)
        for width in (0.01, 0.1, 0.5):
            bump = 1e4 * np.exp(-0.5 * ((time - 2.0) / width) ** 2)
            near = [t for t in Drive(time, bump[None]).stops if abs(t - 2.0) < 2 * width]
            assert 4 < len(near) < 60


def test_at_a_kink_the_slope_is_that_of_what_follows():
    drive = Drive(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 1.0, -3.0]]))
    assert drive.slope(0.999) == [1.0] and drive.slope(1.0) == [-4.0]
