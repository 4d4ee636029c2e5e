"""Responses over time: the massless model against the six-state one, the tolerance, the energy, the labels."""

import numpy as np
import pytest
from equal_zones import equal_zones
from printed_equations import state_matrices
from scipy.integrate import simpson, solve_ivp

from nailoptics.errors import InputError, NotReachedError
from nailoptics.hemodynamics import (
    NAMES,
    PAPER_ZONES,
    Waveform,
    Zones,
    blood_fraction,
    cardiac_pressure,
    parameters,
    respond,
    steady_state,
)
from nailoptics.hemodynamics.walls import MasslessNetwork, build_walls

TIME = np.arange(0.0, 4.0, 1e-3)


def press(pressure_pa, *, on_s=0.5, off_s=2.5, time=TIME):
    return np.where((time >= on_s) & (time < off_s), pressure_pa, 0.0)


def smooth_press(pressure_pa, time=TIME):
    return pressure_pa * np.sin(np.pi * time / time[-1]) ** 2


@pytest.mark.parametrize("name", [*NAMES, "own beds"])
def test_massless_model_agrees_with_the_six_states(name):
    own = {"capillary_stiffness_n_per_m": (1e5, 2e5), "capillary_count": (1e5, 3e5), "capillary_area_m2": (1e-4, 5e-5)}
    p = parameters(name) if name in NAMES else parameters("listed").replace(**own)
    time = np.arange(0.0, 3.0, 0.01)
    touch = np.interp(time, [0.2, 0.6, 1.6, 2.0], [0.0, 9e3, 9e3, 0.0])
    inputs = {"proximal_pressure_pa": touch, "distal_pressure_pa": 0.7 * touch}
    quick = respond(p, time, rtol=1e-8, **inputs)
    check = respond(p, time, rtol=1e-8, model="inertial", **inputs)
    gap = np.abs(quick["capillary_diameter_m"] - check["capillary_diameter_m"]).max().item()
    # With masses of a gram the walls follow within 1e-5 um.
    assert gap < 2e-11
    assert np.ptp(check["capillary_diameter_m"].values) > 1e4 * gap
    assert np.abs(quick["vein_diameter_m"] / check["vein_diameter_m"] - 1).max() < 1e-4


@pytest.mark.long
def test_six_states_agree_with_the_printed_matrices():
    p = parameters("figures")
    rest = np.array([p.capillary_diameter_m, p.capillary_diameter_m, p.vein_diameter_m])
    start = steady_state(p)
    begin = np.concatenate([np.append(start.capillary_diameter_m, start.vein_diameter_m) - rest, np.zeros(3)])
    inputs = np.array([p.arterial_pressure_pa, p.venous_pressure_pa, 6e3, 4e3])

    def printed(_, state):
        a, b = state_matrices(p, rest + state[:3])
        return a @ state + b @ inputs

    time = np.linspace(0.0, 1.0, 21)
    exact = solve_ivp(printed, (0.0, 1.0), begin, "Radau", t_eval=time, rtol=1e-9, atol=1e-9 * np.tile(rest, 2))
    run = respond(p, time, proximal_pressure_pa=6e3, distal_pressure_pa=4e3, model="inertial", rtol=1e-9)
    width = np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])
    assert np.abs(width / (exact.y[:3] + rest[:, None]) - 1).max() < 1e-6


@pytest.mark.parametrize("touch", [press(1.3e4), smooth_press(1.3e4)], ids=["step", "smooth"])
def test_tightening_the_tolerance_converges_in_proportion(touch):
    p = parameters("figures")
    inputs = {"proximal_pressure_pa": touch, "distal_pressure_pa": touch}

    def diameters(rtol):
        run = respond(p, TIME, rtol=rtol, **inputs)
        return np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])

    exact = diameters(1e-9)
    rest = exact[:, :1]
    tolerances = np.array([1e-4, 1e-5, 1e-6])
    errors = np.array([np.abs((diameters(tol) - exact) / rest).max() for tol in tolerances])
    order = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.7 < order < 1.3
    assert np.all(errors < 20 * tolerances)


def test_one_step_has_the_order_of_the_method():
    from nailoptics.hemodynamics.rosenbrock import RODAS, RODAS_CURVE, combine, interpolate, solver, stages

    # y' = -y^2 + t, as diag(d) + outer(p, q); local error of an order-4 method falls with h^5.
    def error(step_s):
        jacobian = np.array([-1.0]), np.array([-0.5]), np.array([2.0])
        done = stages(
            RODAS,
            lambda part, state: -(state**2) + part * step_s,
            np.array([1.0]),
            slope_in_time=np.array([1.0]),
            solve=solver(jacobian, 1.0 / (RODAS.gamma * step_s)),
            step_s=step_s,
        )
        after, estimate = combine(1.0, RODAS.result, done), done[-1]
        middle = interpolate(1.0, after, *(combine(0.0, factors, done) for factors in RODAS_CURVE), 0.5)
        exact = solve_ivp(
            lambda t, y: -(y**2) + t, (0, step_s), [1.0], "DOP853", rtol=1e-13, atol=1e-15, t_eval=[step_s / 2, step_s]
        )
        return abs(after[0] - exact.y[0, 1]), abs(estimate[0]), abs(middle[0] - exact.y[0, 0])

    steps = np.array([0.05, 0.025, 0.0125])
    order = np.polyfit(np.log(steps), np.log([error(h) for h in steps]), 1)[0]
    assert order[0] == pytest.approx(5.0, abs=0.2)
    assert order[1] == pytest.approx(4.0, abs=0.2)
    assert order[2] == pytest.approx(4.0, abs=0.2)


def energy(p, run):
    """Work of heart and touch, and loss to viscosity and dampers [W]; energy in the walls' springs [J]; each (time,).

    Contact does no work: a wall in contact stands still. So d(stored)/dt = work - lost at every instant.
    """
    walls = build_walls(p, PAPER_ZONES)
    width = np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])
    closed = np.vstack([run["capillary_closed"].values, run["vein_closed"].values])
    high, low = run["arterial_pressure_pa"].values, run["venous_pressure_pa"].values
    touch = np.vstack([run["proximal_pressure_pa"].values, run["distal_pressure_pa"].values])
    outside = PAPER_ZONES.on_walls(touch)
    area, damping, stiffness, listed, factor = (
        values[:, None] for values in (walls.area, walls.damping, walls.stiffness, walls.diameter, walls.flow_factor)
    )
    stretch = width - listed
    load = area * outside + stiffness * stretch
    pressure, speed = MasslessNetwork(walls, width, np.where(closed, 0.0, 1.0)).rates(load, high, low)
    conductance, venule = factor * width**4, walls.venule[:, None]
    entering = (high - pressure[:2]) * conductance[:2]
    leaving = (pressure[2] - low) * conductance[2]
    work = high * entering.sum(axis=0) - low * leaving - (outside * area * speed).sum(axis=0)
    lost = (
        ((high - pressure[:2]) * entering).sum(axis=0)
        + ((pressure[:2] - pressure[2]) ** 2 * venule).sum(axis=0)
        + (pressure[2] - low) * leaving
        + (damping * speed**2).sum(axis=0)
    )
    return work, lost, 0.5 * (stiffness * stretch**2).sum(axis=0)


@pytest.mark.parametrize("name", NAMES)
def test_energy_of_a_response_balances(name):
    p = parameters(name)
    time = np.concatenate([[0.0], np.geomspace(1e-7, 3.0, 6000)])
    work, lost, stored = energy(p, respond(p, time, proximal_pressure_pa=8e3, distal_pressure_pa=6e3, rtol=1e-9))
    gained = simpson(work - lost, x=time)
    assert gained == pytest.approx(stored[-1] - stored[0], abs=1e-6 * np.ptp(stored))
    assert np.all(lost > 0.0)


def test_energy_balances_through_contact_too():
    p = parameters("listed")
    inputs = {"proximal_pressure_pa": 2e4, "distal_pressure_pa": 3e4, "rtol": 1e-9}
    time = np.concatenate([[0.0], np.geomspace(1e-7, 3.0, 10000)])
    for _ in range(2):
        # Power jumps at contact: crowd the samples around both instants.
        run = respond(p, time, **inputs)
        closed = [run["vein_closed"].values, run["capillary_closed"].values[1]]
        for wall in closed:
            i = int(np.argmax(wall))
            assert wall[i] and not wall[i - 1] and wall[i:].all()
            time = np.union1d(time, np.linspace(run["time"].values[i - 1], run["time"].values[i], 1000))
    work, lost, stored = energy(p, respond(p, time, **inputs))
    gained = np.trapezoid(work - lost, x=time)
    assert gained == pytest.approx(stored[-1] - stored[0], abs=1e-5 * np.ptp(stored))


def test_a_response_ends_in_the_steady_state():
    p = parameters("figures")
    run = respond(p, np.linspace(0.0, 20.0, 201), proximal_pressure_pa=5e3, distal_pressure_pa=3e3)
    s = steady_state(p, proximal_pressure_pa=5e3, distal_pressure_pa=3e3)
    last = run.isel(time=-1)
    assert np.allclose(last["capillary_diameter_m"], s.capillary_diameter_m, rtol=1e-6)
    assert np.allclose(last["capillary_pressure_pa"], s.capillary_pressure_pa, rtol=1e-6)
    assert last["vein_diameter_m"].item() == pytest.approx(s.vein_diameter_m, rel=1e-6)
    assert last["vein_pressure_pa"].item() == pytest.approx(s.vein_pressure_pa, rel=1e-5)


def test_start_is_untouched_unless_steady_is_requested():
    p = parameters("figures")
    rest, held = steady_state(p), steady_state(p, proximal_pressure_pa=5e3)
    step = respond(p, TIME, proximal_pressure_pa=5e3)
    still = respond(p, TIME, proximal_pressure_pa=5e3, start="steady")
    assert np.allclose(step["capillary_diameter_m"][:, 0], rest.capillary_diameter_m, rtol=1e-12)
    assert np.allclose(still["capillary_diameter_m"], held.capillary_diameter_m[:, None], rtol=1e-7)


def test_times_of_output_do_not_change_the_motion():
    p = parameters("figures")
    knots = np.array([0.0, 0.5, 0.6, 2.5, 2.6, 4.0])
    touch = np.array([0.0, 0.0, 8e3, 8e3, 0.0, 0.0])
    few = respond(p, knots, proximal_pressure_pa=touch)
    fine = np.union1d(knots, TIME)
    many = respond(p, fine, proximal_pressure_pa=np.interp(fine, knots, touch))
    at = np.searchsorted(fine, knots)
    assert np.allclose(few["capillary_diameter_m"], many["capillary_diameter_m"][:, at], rtol=2e-6)


def test_a_step_given_by_its_jump_does_not_depend_on_the_times_of_output():
    p = parameters("compromise")
    step = Waveform(time_s=[0.25, 0.25, 2.25, 2.25], pressure_pa=[0.0, 9e3, 9e3, 0.0])
    at = np.array([0.0, 0.25, 0.5, 2.25, 2.4, 4.0])

    def diameters(time):
        run = respond(p, time, proximal_pressure_pa=step, distal_pressure_pa=step, start="steady")
        return run["capillary_diameter_m"].sel(time=at).values

    few, many, irregular = map(diameters, (at, np.linspace(0.0, 4.0, 4001), np.union1d(at, np.geomspace(0.1, 4, 77))))
    assert np.array_equal(few, many) and np.array_equal(few, irregular)
    # A ramp ever shorter comes ever nearer.
    gaps = []
    for ramp_s in (1e-3, 1e-5):
        knots = [0.0, 0.25, 0.25 + ramp_s, 2.25, 2.25 + ramp_s, 4.0]
        time = np.union1d(knots, at)
        touch = np.interp(time, knots, [0.0, 0.0, 9e3, 9e3, 0.0, 0.0])
        run = respond(p, time, proximal_pressure_pa=touch, distal_pressure_pa=touch)
        gaps.append(np.abs(run["capillary_diameter_m"].sel(time=at).values / few - 1).max())
    assert gaps[1] < 1e-5 < gaps[0] < 1e-1


def test_a_jump_at_the_first_instant_starts_from_what_was_before_it():
    p = parameters("figures")
    step = Waveform(time_s=[0.0, 0.0], pressure_pa=[0.0, 5e3])
    jump = respond(p, TIME, proximal_pressure_pa=step, start="steady")
    untouched = respond(p, TIME, proximal_pressure_pa=5e3)
    assert np.allclose(jump["capillary_diameter_m"], untouched["capillary_diameter_m"], rtol=1e-12)
    assert np.array_equal(jump["proximal_pressure_pa"], np.full(TIME.size, 5e3))


def test_waveforms_drive_zones_of_three_inputs():
    cut = Zones(share=(1.0, 1.0), reach=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), vein_reach=(1.0, 0.0, 0.0))
    step = Waveform(time_s=[1.0, 1.0], pressure_pa=[0.0, 3e3])
    three = respond(parameters("listed"), TIME, zones=cut, pressure_pa=[press(2e3), step, 0.0])
    two = respond(parameters("listed"), TIME, proximal_pressure_pa=press(2e3), distal_pressure_pa=step)
    assert np.array_equal(three["capillary_diameter_m"], two["capillary_diameter_m"])


def test_two_units_are_the_paper_bit_for_bit_and_eight_equal_ones_agree():
    p = parameters("listed")
    inputs = {"proximal_pressure_pa": press(1.2e4), "distal_pressure_pa": press(9e3)}
    paper = respond(p, TIME, **inputs)
    two = respond(p, TIME, zones=equal_zones(2), **inputs)
    eight = respond(p, TIME, zones=equal_zones(8), **inputs)
    assert np.array_equal(paper["capillary_diameter_m"], two["capillary_diameter_m"])
    expected = np.repeat(paper["capillary_diameter_m"].values, 4, axis=0)
    assert np.abs(eight["capillary_diameter_m"].values / expected - 1).max() < 1e-6


def test_three_inputs_drive_their_own_walls():
    cut = Zones(share=(1.0, 1.0), reach=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), vein_reach=(1.0, 0.0, 0.0))
    p = parameters("listed")
    touch = np.array([press(2e3), press(3e3), np.zeros(TIME.size)])
    three = respond(p, TIME, zones=cut, pressure_pa=touch)
    two = respond(p, TIME, proximal_pressure_pa=touch[0], distal_pressure_pa=touch[1])
    assert np.array_equal(three["capillary_diameter_m"], two["capillary_diameter_m"])
    assert three["touch_pressure_pa"].dims == ("input", "time")


def test_pulse_gives_a_steady_and_a_pulsating_part():
    p = parameters("figures")
    time = np.arange(0.0, 10.0, 5e-3)
    beat = cardiac_pressure(time, mean_pressure_pa=1e4, pulse_pressure_pa=2e3, rate_per_min=60.0)
    blood = blood_fraction(p, respond(p, time, arterial_pressure_pa=beat)["capillary_diameter_m"].values)[0]
    last, before = blood[-200:], blood[-400:-200]
    assert np.abs(last - before).max() < 1e-4 * last.mean()  # periodic with the heart
    assert 0.005 < np.ptp(last) / last.mean() < 0.2
    assert last.mean() == pytest.approx(0.03, rel=0.05)
    # A pulse of half the height pulsates half as much, nearly.
    half = cardiac_pressure(time, mean_pressure_pa=1e4, pulse_pressure_pa=1e3, rate_per_min=60.0)
    less = blood_fraction(p, respond(p, time, arterial_pressure_pa=half)["capillary_diameter_m"].values)[0][-200:]
    assert np.ptp(less) / np.ptp(last) == pytest.approx(0.5, abs=0.02)


def test_dataset_is_labelled_and_carries_its_inputs():
    p = parameters("listed")
    run = respond(p, TIME, proximal_pressure_pa=press(2e3))
    assert run["capillary_diameter_m"].dims == ("zone", "time")
    assert list(run["zone"].values) == ["proximal", "distal"]
    for name, variable in run.variables.items():
        assert "long_name" in variable.attrs, name
        assert name == "zone" or "units" in variable.attrs, name
    assert np.array_equal(run["proximal_pressure_pa"], press(2e3))
    assert run.attrs["parameter_vein_stiffness_n_per_m"] == 1e3


@pytest.mark.parametrize(
    ("time", "inputs", "message"),
    [
        ([0.0], {}, "time_s must be one row of two or more"),
        ([0.0, 1.0, 1.0], {}, "times that rise"),
        ([0.0, np.nan], {}, "time_s"),
        ([0.0, 1.0], {"proximal_pressure_pa": [1.0, 2.0, 3.0]}, "one for each of 2 times"),
        ([0.0, 1.0], {"distal_pressure_pa": np.inf}, "distal_pressure_pa = inf must be finite"),
        ([0.0, 1.0], {"arterial_pressure_pa": [1.0, np.nan]}, r"arterial_pressure_pa\[1\]"),
        ([0.0, 1.0], {"rtol": 0.0}, "rtol"),
        ([0.0, 1.0], {"model": "quick"}, "'massless' or 'inertial'"),
        ([0.0, 1.0], {"start": "now"}, "'untouched' or 'steady'"),
    ],
)
def test_bad_input_is_one_clear_line(time, inputs, message):
    with pytest.raises(InputError, match=message) as caught:
        respond(parameters("listed"), time, **inputs)
    assert "\n" not in str(caught.value)


def test_a_tolerance_out_of_reach_is_reported(monkeypatch):
    from nailoptics.hemodynamics import PAPER_ZONES, massless
    from nailoptics.hemodynamics.drive import Drive
    from nailoptics.hemodynamics.walls import build_walls

    time, inputs = np.array([0.0, 1.0]), np.array([[1e4] * 2, [0.0] * 2, [0.0] * 2, [0.0] * 2, [5e3] * 2])
    rows = [Waveform(time_s=time, pressure_pa=row) for row in inputs]
    drive = Drive(rows, lambda values: values, begin_s=0.0, end_s=1.0)
    walls = build_walls(parameters("listed"), PAPER_ZONES)
    monkeypatch.setattr(massless, "MOST_STEPS", 5)
    with pytest.raises(NotReachedError, match="more than 5 steps"):
        massless.integrate(walls, drive, time, np.array(walls.diameter), inputs, rtol=1e-9)
