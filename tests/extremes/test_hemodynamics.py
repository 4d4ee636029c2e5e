"""Hemodynamics at every extreme: pressures, closure, reversed flow, masses, dampers, springs, impulses, long ramps."""

import itertools

import numpy as np
import pytest
from equal_zones import equal_zones

from nailoptics.errors import InputError, NotReachedError
from nailoptics.hemodynamics import NAMES, massless, parameters, respond, steady_state
from nailoptics.hemodynamics.parameters import beds

TIME = np.arange(0.0, 4.0, 1e-3)
EXTREMES_PA = (-1e5, 0.0, 1e4, 1.2e4, 1e5, 1e7)


def held(pressure_pa, time=TIME):
    return np.where((time >= 0.5) & (time < 2.5), pressure_pa, 0.0)


def widths(run):
    return np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])


def assert_sound(run):
    for name in ("capillary_diameter_m", "vein_diameter_m", "capillary_pressure_pa", "vein_pressure_pa"):
        assert np.all(np.isfinite(run[name])), name
    assert np.all(widths(run) > 0.0)


@pytest.mark.parametrize("name", NAMES)
def test_pressures_from_suction_to_crushing(name):
    p = parameters(name)
    rest = steady_state(p)
    for proximal, distal in itertools.product(EXTREMES_PA, repeat=2):
        run = respond(p, TIME, proximal_pressure_pa=held(proximal), distal_pressure_pa=held(distal), rtol=1e-5)
        assert_sound(run)
        s = steady_state(p, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        expected = np.append(s.capillary_diameter_m, s.vein_diameter_m)
        listed = np.array([*beds(p.capillary_diameter_m), p.vein_diameter_m])
        assert np.all(np.abs(widths(run)[:, 2499] - expected) < 5e-3 * np.maximum(expected, listed))
        back = np.append(rest.capillary_diameter_m, rest.vein_diameter_m)
        assert np.all(np.abs(widths(run)[:, -1] / back - 1) < 0.03)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("proximal", "distal"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_closure_is_reached_without_a_jump_and_flat_past_it(name, proximal, distal):
    p = parameters(name)
    touch = np.linspace(0.0, 4e4, 8001)  # 5 Pa apart
    s = steady_state(p, proximal_pressure_pa=proximal * touch, distal_pressure_pa=distal * touch)
    listed = np.array([*beds(p.capillary_diameter_m), p.vein_diameter_m])[:, None]
    width = np.vstack([s.capillary_diameter_m, s.vein_diameter_m[None]]) / listed
    assert np.abs(np.diff(width, axis=1)).max() < 0.01  # no fold: 5 Pa never move a wall by a hundredth
    past = touch >= 3e4
    closing = [i for i, part in ((1, distal), (2, proximal)) if part]
    for i in closing:
        assert np.all(width[i, past] == pytest.approx(1e-3, rel=1e-12))
        assert np.all(np.diff(width[i]) <= 1e-9)  # it never opens again
    assert np.all(np.ptp(width[:, past], axis=1) <= 1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("proximal", "distal"), [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
def test_slow_ramps_up_and_down_show_no_hysteresis(name, proximal, distal):
    p = parameters(name)
    time = np.linspace(0.0, 1e6, 4001)
    touch = 3e4 * np.interp(time, [0.0, 4e5, 6e5, 1e6], [0.0, 1.0, 1.0, 0.0])
    run = respond(p, time, proximal_pressure_pa=proximal * touch, distal_pressure_pa=distal * touch)
    assert_sound(run)
    listed = np.array([*beds(p.capillary_diameter_m), p.vein_diameter_m])[:, None]
    width = widths(run) / listed
    scale = width[:, :1]
    assert np.abs((width - width[:, ::-1]) / scale).max() < 5e-4
    plateau = (time > 4e5) & (time < 6e5)
    assert np.abs(np.ptp(width[:, plateau], axis=1) / scale[:, 0]).max() < 1e-5
    s = steady_state(p, proximal_pressure_pa=proximal * touch, distal_pressure_pa=distal * touch)
    static = np.vstack([s.capillary_diameter_m, s.vein_diameter_m[None]]) / listed
    assert np.abs((width - static) / scale).max() < 5e-4


@pytest.mark.parametrize("name", ["listed", pytest.param("best", marks=pytest.mark.long)])
def test_contact_agrees_with_the_six_states(name):
    p = parameters(name)
    time = np.linspace(0.0, 3.0, 301)
    touch = np.interp(time, [0.1, 0.5, 1.5, 2.0], [0.0, 2.5e4, 2.5e4, 0.0])
    inputs = {"proximal_pressure_pa": touch, "distal_pressure_pa": touch}
    quick, check = respond(p, time, **inputs), respond(p, time, model="inertial", rtol=1e-7, **inputs)
    assert quick["vein_closed"].values.any()
    rest = widths(quick)[:, :1]
    assert np.abs((widths(quick) - widths(check)) / rest).max() < 1e-3


@pytest.mark.parametrize(("high", "low"), [(1e4, 1e4), (0.0, 5e3), (-1e4, 1e4), (0.0, 0.0), (1e4, -1e5)])
def test_arteries_no_higher_than_veins(high, low):
    p = parameters("listed").replace(arterial_pressure_pa=high, venous_pressure_pa=low)
    for proximal, distal in itertools.product((0.0, 5e3, 1e6), repeat=2):
        run = respond(p, TIME[::10], proximal_pressure_pa=held(proximal)[::10], distal_pressure_pa=held(distal)[::10])
        assert_sound(run)
        s = steady_state(p, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        assert np.all(s.capillary_diameter_m > 0.0) and s.vein_diameter_m > 0.0
        inside = [min(high, low) - 1e-6, max(high, low) + 1e-6]
        assert inside[0] <= s.vein_pressure_pa <= inside[1]


@pytest.mark.parametrize("mass", [1e-12, 1e-6, 1e-3])
def test_small_masses_do_not_matter(mass):
    p = parameters("listed").replace(capillary_mass_kg=mass, vein_mass_kg=mass)
    time = np.linspace(0.0, 2.0, 101)
    touch = np.interp(time, [0.2, 0.4, 1.0, 1.2], [0.0, 8e3, 8e3, 0.0])
    full = respond(p, time, proximal_pressure_pa=touch, model="inertial")
    quick = respond(p, time, proximal_pressure_pa=touch)
    assert np.abs(widths(full) / widths(quick) - 1).max() < 1e-4


def test_a_mass_of_a_kilogram_has_a_small_transient_effect_alone():
    p = parameters("listed").replace(capillary_mass_kg=1.0, vein_mass_kg=1.0)
    time = np.linspace(0.0, 2.0, 101)
    touch = np.interp(time, [0.2, 0.25], [0.0, 8e3])
    full = respond(p, time, proximal_pressure_pa=touch, model="inertial")
    quick = respond(p, time, proximal_pressure_pa=touch)
    assert_sound(full)
    gap = np.abs(widths(full) / widths(quick) - 1)
    assert gap.max() > 1e-3 and gap[:, -1].max() < 1e-4


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize(
    "field",
    [
        "capillary_damping_n_s_per_m",
        "vein_damping_n_s_per_m",
        "capillary_stiffness_n_per_m",
        "vein_stiffness_n_per_m",
        "venule_resistance_pa_s_per_m3",
        "viscosity_pa_s",
    ],
)
def test_stiffness_damping_and_flow_a_thousand_times_off(field, factor):
    p = parameters("listed")
    p = p.replace(**{field: factor * p.as_dict()[field]})
    for touch in (3e3, 2e4):
        assert_sound(respond(p, TIME, proximal_pressure_pa=held(touch), distal_pressure_pa=held(touch)))


@pytest.mark.parametrize("model", ["massless", "inertial"])
def test_an_impulse_of_a_millisecond_narrows_the_vein_and_decays(model):
    p = parameters("figures")
    time = np.arange(0.0, 2.0, 1e-3)
    touch = np.where(np.arange(time.size) == 1000, 1e5, 0.0)
    run = respond(p, time, proximal_pressure_pa=touch, distal_pressure_pa=touch, model=model)
    assert_sound(run)
    width = widths(run) / widths(run)[:, :1]
    assert np.abs(width[:, :999] - 1).max() < 1e-5
    assert width[2].min() < 0.8  # the vein yields at once
    assert np.abs(width[:, -1] - 1).max() < 0.01


def test_a_ramp_of_an_hour_follows_the_steady_states():
    p = parameters("best")
    time = np.linspace(0.0, 3600.0, 3601)
    touch = 2e4 * time / 3600.0
    run = respond(p, time, proximal_pressure_pa=touch, distal_pressure_pa=touch)
    s = steady_state(p, proximal_pressure_pa=touch, distal_pressure_pa=touch)
    rest = s.capillary_diameter_m[:, :1]
    assert np.abs((run["capillary_diameter_m"].values - s.capillary_diameter_m) / rest).max() < 1e-3


def test_a_response_of_a_nanosecond_and_one_of_a_year():
    p = parameters("listed")
    for span in (1e-9, 3e7):
        run = respond(p, np.linspace(0.0, span, 5), proximal_pressure_pa=5e3)
        assert_sound(run)
    s = steady_state(p, proximal_pressure_pa=5e3)
    assert run["vein_diameter_m"].values[-1] == pytest.approx(s.vein_diameter_m, rel=1e-4)


def test_eight_zones_hold_where_two_do():
    p = parameters("best")
    for touch in (-1e5, 1.2e4, 1e7):
        run = respond(
            p,
            TIME,
            proximal_pressure_pa=held(touch),
            distal_pressure_pa=held(touch),
            zones=equal_zones(8, decay_length=0.15),
            rtol=1e-5,
        )
        assert_sound(run)


def test_hardly_damped_walls_follow_the_blood_and_less_is_refused():
    p = parameters("listed")
    time = np.linspace(0.0, 3.0, 301)
    touch = np.interp(time, [0.2, 0.6, 1.6, 2.0], [0.0, 9e3, 9e3, 0.0])
    runs = []
    for damping in (1e-3, 1e-12):
        light = p.replace(capillary_damping_n_s_per_m=damping, vein_damping_n_s_per_m=damping)
        runs.append(widths(respond(light, time, proximal_pressure_pa=touch, distal_pressure_pa=0.7 * touch)))
    assert np.abs(runs[1] / runs[0] - 1).max() < 1e-5
    with pytest.raises(InputError, match="capillary_damping_n_s_per_m must be 1e-12 or more, got 1e-21"):
        p.replace(capillary_damping_n_s_per_m=1e-21)


def test_a_response_that_no_step_reaches_ends_with_an_error(monkeypatch):
    """A model whose error is never small enough, as of numbers that are none."""
    monkeypatch.setattr(massless, "_unrolled", lambda units: (lambda *_: (np.nan, 0.0, [], [], []), None))
    with pytest.raises(NotReachedError, match="no step is short enough for the tolerance"):
        respond(parameters("listed"), TIME, proximal_pressure_pa=5e3)
