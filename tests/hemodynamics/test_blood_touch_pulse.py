"""Blood of eq. (7), pressures of a touch, and the pulse of the heart."""

import math

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.hemodynamics import (
    Contact,
    blood_fraction,
    breathing_pressure,
    cardiac_pressure,
    parameters,
    relaxing_pressure,
    spreading_pressure,
    steady_state,
    vasomotion_pressure,
)


def test_blood_fraction_is_that_of_rest_at_rest_and_goes_with_the_square():
    p = parameters("figures")
    rest = steady_state(p).capillary_diameter_m
    assert np.allclose(blood_fraction(p, rest, rest_blood_fraction=0.02), 0.02, rtol=1e-14)
    assert np.allclose(blood_fraction(p, 2 * rest, rest_blood_fraction=0.02), 0.08, rtol=1e-14)


def test_blood_fraction_is_the_volume_of_capillaries_over_that_of_tissue():
    p, diameter = parameters("listed"), 1.3e-5
    capillaries_m2 = p.capillary_count * p.capillary_length_m * math.pi / 4
    tissue_m3 = capillaries_m2 * steady_state(p).capillary_diameter_m[0] ** 2 / 0.03
    direct = capillaries_m2 * diameter**2 / tissue_m3
    assert blood_fraction(p, diameter, rest_blood_fraction=0.03) == pytest.approx(direct, rel=1e-12)


def test_blood_cannot_be_more_than_all_of_the_tissue():
    p = parameters("listed")
    with pytest.raises(
        InputError, match="= .* is not a fraction; lower blood.rest_blood_fraction = 0.03 or the suction"
    ):
        blood_fraction(p, 1e-3, rest_blood_fraction=0.03)
    for bad in (1.1, -0.1, math.nan):
        with pytest.raises(InputError, match="rest_blood_fraction"):
            blood_fraction(p, 1e-5, rest_blood_fraction=bad)
    with pytest.raises(InputError, match="greater than 0"):
        blood_fraction(p, -1e-5)


def test_a_bed_without_blood_stays_without():
    assert not blood_fraction(parameters("listed"), [1e-5, 2e-5], rest_blood_fraction=0.0).any()


def test_a_touch_empties_the_venules_of_its_bed_alone():
    p = parameters("listed").replace(venular_share=(0.0, 0.2), venular_closing_pressure_pa=1e3)
    rest = steady_state(p).capillary_diameter_m[:, None]
    touch_pa = np.array([-1e3, 0.0, 500.0, 1e3, 1e4])
    blood = blood_fraction(p, rest.repeat(5, axis=1), rest_blood_fraction=0.03, touch_pa=touch_pa)
    assert blood[0] == pytest.approx(0.03) and blood[1] / 0.03 == pytest.approx([1.0, 1.0, 0.9, 0.8, 0.8])
    one = blood_fraction(p, rest[1].repeat(5), rest_blood_fraction=0.03, touch_pa=touch_pa, unit=1)
    assert np.array_equal(one, blood[1])


def test_an_even_touch_of_1_n_on_1_cm2_is_1_n_per_cm2_on_both():
    assert Contact().pressures(1.0) == (1e4, 1e4)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 1.0])
def test_the_two_halves_carry_the_force(share):
    force, area = np.array([0.0, 0.5, 3.0]), 80.0
    proximal, distal = Contact(area, share).pressures(force)
    areas = Contact(area, share).side_areas_mm2()
    assert np.allclose(proximal * areas[0] * 1e-6, share * force, rtol=1e-12)
    assert np.allclose(distal * areas[1] * 1e-6, (1.0 - share) * force, rtol=1e-12)
    # The side that carries more feels the force on the whole contact, the other in proportion to its share.
    assert np.allclose(np.maximum(proximal, distal), force / (area * 1e-6), rtol=1e-12)
    assert np.allclose(np.minimum(proximal, distal), 2.0 * min(share, 1.0 - share) * force / (area * 1e-6), rtol=1e-12)


def test_1_n_on_one_side_is_1_n_per_cm2_there_unless_its_area_is_stated():
    assert Contact(proximal_share=1.0).pressures(1.0) == (1e4, 0.0)
    assert Contact(proximal_share=0.0).pressures(1.0) == (0.0, 1e4)
    assert Contact(proximal_share=1.0, proximal_area_mm2=50.0, distal_area_mm2=40.0).pressures(1.0) == (2e4, 0.0)
    assert Contact(distal_area_mm2=25.0).pressures(1.0) == (1e4, 2e4)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((-1.0,), "force_n"),
        ((1.0, 0.0), "contact_area_mm2"),
        ((1.0, 100.0, 1.1), "proximal_share"),
        ((np.nan,), "force_n"),
    ],
)
def test_a_touch_that_cannot_be_is_refused(arguments, name):
    with pytest.raises(InputError, match=name):
        Contact(*arguments[1:]).pressures(arguments[0])


@pytest.mark.parametrize("name", ["proximal_area_mm2", "distal_area_mm2", "contact_force_n"])
def test_an_area_of_a_side_and_the_force_of_a_contact_must_be_positive(name):
    with pytest.raises(InputError, match=name):
        Contact(**{name: 0.0})


def test_the_pulp_yields_at_once_and_recovers_slowly():
    coarse, fine = np.linspace(0.0, 4.0, 9), np.linspace(0.0, 4.0, 4001)
    corners = [0.0, 1.0, 1.5, 4.0], [0.0, 1e4, 2e3, 2e3]
    touches = [np.interp(time, *corners) for time in (coarse, fine)]
    left = [relaxing_pressure(t, p, relaxation_s=0.5) for t, p in zip((coarse, fine), touches, strict=True)]
    assert np.allclose(left[0], left[1][::500], rtol=1e-9)
    assert np.array_equal(left[1][fine <= 1.0], touches[1][fine <= 1.0]) and np.all(left[1] >= touches[1])
    held = fine >= 1.5
    beyond = left[1][held] - 2e3
    assert np.allclose(beyond, beyond[0] * np.exp(-(fine[held] - 1.5) / 0.5), rtol=1e-9)
    assert np.array_equal(relaxing_pressure(coarse, touches[0], relaxation_s=0.0), touches[0])
    # A jump down leaves all of the pressure at its instant, one up is followed.
    jumps = relaxing_pressure([0.0, 1.0, 1.0, 1.5, 1.5], [1e4, 1e4, 0.0, 0.0, 9e3], relaxation_s=0.5)
    assert np.allclose(jumps, [1e4, 1e4, 1e4, 1e4 * np.exp(-1.0), 9e3], rtol=1e-12)
    with pytest.raises(InputError, match="relaxation_s"):
        relaxing_pressure(coarse, touches[0], relaxation_s=-1.0)


def test_pulse_has_the_requested_mean_height_and_rate():
    time = np.arange(0.0, 60.0, 1e-3)
    wave = cardiac_pressure(time, mean_pressure_pa=1.2e4, pulse_pressure_pa=3e3, rate_per_min=72.0)
    assert wave.mean() == pytest.approx(1.2e4, rel=1e-6)
    assert np.ptp(wave) == pytest.approx(3e3, rel=1e-3)
    power = np.abs(np.fft.rfft(wave - wave.mean()))
    assert np.fft.rfftfreq(time.size, 1e-3)[np.argmax(power)] == pytest.approx(72.0 / 60.0)
    # It climbs faster than it falls, as an artery does.
    beat = wave[: int(60e3 / 72.0)]
    assert np.argmax(beat) - np.argmin(beat) < 0.35 * beat.size


@pytest.mark.parametrize(
    "bad",
    [{"rate_per_min": 0.0}, {"pulse_pressure_pa": -1.0}, {"mean_pressure_pa": np.nan}, {"rate_variability": 0.3}],
)
def test_a_pulse_that_cannot_be_is_refused(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        cardiac_pressure([0.0, 1.0], **bad)


def test_an_uneven_heart_has_the_mean_and_the_spread_of_its_intervals():
    """Expected: standard errors of a mean of 1000 intervals, and of their spread; four of them."""
    time = np.arange(0.0, 900.0, 2e-3)
    wave = cardiac_pressure(time, rate_per_min=70.0, rate_variability=0.05, seed=3)
    # One crossing on each systolic rise; the later waves of a beat do not come so high.
    high = wave.min() + 0.8 * np.ptp(wave)
    rises = time[1:][(wave[:-1] < high) & (wave[1:] >= high)]
    interval = np.diff(rises)
    mean = 60.0 / 70.0
    assert interval.size == pytest.approx(900 / mean, rel=0.02)
    assert interval.mean() == pytest.approx(mean, abs=4 * 0.05 * mean / math.sqrt(interval.size))
    # What lies between two rises is parts of two intervals, which evens them out by less than a tenth.
    assert 0.85 < interval.std() / (0.05 * mean) < 1.1
    assert np.ptp(wave) == pytest.approx(2e3, rel=1e-3) and wave.mean() == pytest.approx(1e4, rel=1e-3)


def test_waves_follow_from_the_seed_alone():
    short, fine = np.arange(0.0, 5.0, 0.5), np.arange(0.0, 50.0, 0.125)
    for wave in (
        lambda time, seed: cardiac_pressure(time, rate_variability=0.1, seed=seed),
        lambda time, seed: breathing_pressure(time, amplitude_pa=200.0, seed=seed),
        lambda time, seed: vasomotion_pressure(time, amplitude_pa=600.0, seed=seed),
    ):
        assert np.array_equal(wave(short, 7), wave(fine, 7)[:40:4])
        assert not np.allclose(wave(short, 7), wave(short, 8))


def test_slow_waves_have_their_standard_deviation_and_stay_in_their_band():
    time = np.arange(0.0, 20_000.0, 0.5)
    wave = vasomotion_pressure(time, amplitude_pa=600.0, band_hz=(0.05, 0.15), seed=1)
    assert wave.std() == pytest.approx(600.0, rel=0.02) and abs(wave.mean()) < 10.0
    power = np.abs(np.fft.rfft(wave * np.hanning(time.size))) ** 2
    frequency = np.fft.rfftfreq(time.size, 0.5)
    assert power[(frequency > 0.049) & (frequency < 0.151)].sum() > 0.999 * power.sum()


def test_a_spreading_pulp_does_not_depend_on_knots():
    """Under a step of p the pressure is p (1 - c (1 - exp(-t / tau))); after it nothing is left to press."""
    coarse = [0.0, 1.0, 1.0, 4.0, 4.0, 9.0]
    step = spreading_pressure(coarse, [0.0, 0.0, 1e4, 1e4, 0.0, 0.0], part=0.2, time_constant_s=2.0)
    assert step[2] == 1e4 and step[3] == pytest.approx(1e4 * (1 - 0.2 * (1 - np.exp(-1.5))), rel=1e-12)
    assert step[4:] == pytest.approx([0.0, 0.0])
    fine = np.linspace(0.0, 9.0, 901)
    ramp = [spreading_pressure(t, 1e3 * np.asarray(t), part=0.2, time_constant_s=2.0) for t in (fine[::300], fine)]
    assert ramp[0] == pytest.approx(ramp[1][::300], rel=1e-12)
    # A ramp is followed at its time constant's distance.
    assert ramp[1][-1] == pytest.approx(9e3 - 0.2 * 1e3 * (9.0 - 2.0 * (1 - np.exp(-4.5))), rel=1e-12)
    for wrong in ({"part": 1.1, "time_constant_s": 1.0}, {"part": 0.1, "time_constant_s": 0.0}):
        with pytest.raises(InputError):
            spreading_pressure(fine, fine, **wrong)
