"""Arteriolar blood: its pulse over contact pressure, its part in small waves, and when it is there."""

import numpy as np
import pytest
from small_scenes import SMALL_FINGER_BEST

from nailoptics.hemodynamics.blood import WIDTH_PA, Arterioles
from nailoptics.hemodynamics.for_scene import beat_at, blood_model, blood_over_touch, steady_blood
from nailoptics.hemodynamics.waves import waves_of
from nailoptics.scene import parse_scene

PA_PER_MMHG = 133.322
BODY = "[body.heartbeat]\n[body.breathing]\n[body.vasomotion]\n"
# Of 136 to 140 people at 30 to 80 mmHg, red and infrared: CardioWorks contact pressure data set, 2025.
PEOPLE = np.array([[1.11, 1.17, 1.30, 1.23, 1.13, 0.92], [1.00, 1.01, 1.07, 1.01, 0.99, 0.85]])


def scene_with(text: str, *, named: str = "best"):
    return parse_scene(SMALL_FINGER_BEST.replace('"best"', f'"{named}"') + text)


def pulses(scene, pressures_mmhg):
    """Highest less lowest blood of a beat in the distal zone, on which an even touch of 1 N presses with 1 N/cm^2."""
    return np.array([np.ptp(beat_at(scene, x * PA_PER_MMHG / 1e4).blood_fraction[-1]) for x in pressures_mmhg])


def test_the_pulse_over_contact_pressure_is_peoples() -> None:
    pressures = np.arange(30, 81, 10)
    pulse = pulses(scene_with(BODY), pressures)
    part, people = pulse / pulse.max(), PEOPLE / PEOPLE.max(1, keepdims=True)
    assert 40 <= pressures[pulse.argmax()] <= 60 and 0.15 < 1 - part[-1] < 0.40
    assert np.abs(part - people.mean(0)).max() < 0.06
    # The network's linear walls have no such maximum.
    alone = pulses(scene_with("[body.heartbeat]\narteriolar_blood_fraction = 0.0\n"), pressures)
    assert alone.argmax() == len(pressures) - 1


def test_arterioles_are_there_only_where_a_heart_beats() -> None:
    for text in ("", "[body.breathing]\n", "[body.heartbeat]\npulse_pressure_pa = 0.0\n"):
        assert steady_blood(scene_with(text), [0.0])[0] == pytest.approx([0.03, 0.03], rel=1e-9)
    held = '[touch]\nprofile = "hold"\nforce_n = 0.0\n'
    assert steady_blood(scene_with(BODY), [0.0])[0] == pytest.approx([0.046, 0.046], rel=1e-9)
    without = blood_over_touch(scene_with(held + BODY.replace("]\n", "]\narteriolar_blood_fraction = 0.0\n", 1)))
    added = blood_over_touch(scene_with(held + BODY)).blood_fraction - without.blood_fraction
    assert float(added.min()) > 0.01 and float(added.mean()) == pytest.approx(0.016, rel=0.05)


def test_arterioles_collapse_under_a_touch_and_shielded_ones_do_not() -> None:
    text = BODY.replace("]\n", "]\narteriolar_blood_fraction = {}\n", 1)
    proximal, distal = (
        steady_blood(scene_with(text.format(0.02)), [5.0]) - steady_blood(scene_with(text.format(0.0)), [5.0])
    )[0]
    assert proximal == pytest.approx(0.02, rel=1e-9) and 0 < distal < 1e-8


def test_the_compliance_is_the_slope_of_the_volume() -> None:
    arterioles = Arterioles(0.02, 5000.0, 1e4, 3.0)
    pressure = np.linspace(-4e4, 4e4, 81)
    slope = (arterioles.fraction(pressure + 1.0) - arterioles.fraction(pressure - 1.0)) / 2.0
    assert arterioles.compliance_per_pa(pressure) == pytest.approx(slope, rel=1e-6)
    assert pressure[slope.argmax()] == 5000.0
    # Collapse: exponential, by a factor e in each width.
    low = arterioles.fraction([-4e4, -4e4 + WIDTH_PA])
    assert low[1] / low[0] == pytest.approx(np.e, rel=1e-4)


def test_the_compliance_has_its_maximum_at_the_pressure_that_the_scene_gives() -> None:
    pressure_pa = np.linspace(0.0, 1e4, 101)
    for peak_pa in (3e3, 7e3):
        small = blood_model(scene_with(f"[body.heartbeat]\narteriolar_peak_pa = {peak_pa}\n")).arterioles
        assert small is not None and pressure_pa[small.compliance_per_pa(pressure_pa).argmax()] == peak_pa


def test_a_small_beat_moves_the_blood_as_its_course_does() -> None:
    body = "[body.heartbeat]\nrate_variability = 0.0\npulse_pressure_pa = 20.0\narterial_pulse_pressure_pa = 60.0\n"
    scene = scene_with(body)
    for force_n in (0.0, 0.5):
        beat = beat_at(scene, force_n).blood_fraction
        lines, variance = waves_of(scene.body)[0][0].lines(**waves_of(scene.body)[0][1])
        gain = blood_model(scene).by_arterial_pressure(lines, force_n)
        assert (np.abs(gain) ** 2 * variance).sum(1) == pytest.approx(beat.var(1), rel=0.01)


@pytest.mark.parametrize("named", ["best", "sluggish"])
def test_waves_over_the_heartbeat_are_as_in_light_through_fingertips(named: str) -> None:
    """Of 12 hands: vasomotion 0.51 (0.39-1.14), breathing 0.50, rms over the heartbeat's (Hoffman 2022)."""
    scene, rms = scene_with(BODY, named=named), {}
    for wave, fields in waves_of(scene.body):
        frequency_hz, variance = wave.lines(**fields)
        gain = blood_model(scene).by_arterial_pressure(frequency_hz, 0.0)
        rms[wave.name] = np.sqrt((np.abs(gain) ** 2 * variance).sum())
    assert 0.4 < rms["vasomotion"] / rms["heartbeat"] < 0.8
    assert 0.3 < rms["breathing"] / rms["heartbeat"] < 0.7
