"""Steady states: that they balance, close where they should, and agree one by one and all together."""

import numpy as np
import pytest
from equal_zones import equal_zones
from printed_equations import pair, state_matrices

from nailoptics.errors import InputError
from nailoptics.hemodynamics import NAMES, parameters, steady_state
from nailoptics.hemodynamics.steady import two_branches

TWO_BEDS = {
    "capillary_stiffness_n_per_m": (1e5, 2e5),
    "capillary_damping_n_s_per_m": (5e3, 2e4),
    "capillary_area_m2": (1e-4, 5e-5),
    "capillary_diameter_m": (8e-6, 5e-6),
    "capillary_length_m": (1e-3, 2e-3),
    "capillary_count": (1e5, 3e5),
    "venule_resistance_pa_s_per_m3": (1e11, 3e10),
}


@pytest.mark.parametrize("own", [{}, TWO_BEDS], ids=["shared", "own"])
@pytest.mark.parametrize("name", NAMES)
def test_open_steady_states_are_fixed_points_of_the_printed_equations(name, own):
    p = parameters(name).replace(**own)
    rest = np.array([*pair(p.capillary_diameter_m), p.vein_diameter_m])
    for proximal, distal in [(0.0, 0.0), (2e3, 0.0), (5e3, 3e3), (-1e3, -2e3), (8e3, 8e3)]:
        s = steady_state(p, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
        width = np.append(s.capillary_diameter_m, s.vein_diameter_m)
        a, b = state_matrices(p, width)
        state = np.concatenate([width - rest, np.zeros(3)])
        pull = a @ state
        push = b @ [p.arterial_pressure_pa, p.venous_pressure_pa, proximal, distal]
        assert np.abs(pull + push).max() < 1e-9 * np.abs(push).max()


def test_results_have_the_shapes_of_the_contract():
    rest = steady_state(parameters("listed"), proximal_pressure_pa=0.0, distal_pressure_pa=0.0)
    assert rest.capillary_diameter_m.shape == (2,) and rest.capillary_diameter_m.dtype == float
    assert rest.capillary_pressure_pa.shape == (2,)
    assert np.ndim(rest.vein_diameter_m) == 0 and np.ndim(rest.vein_pressure_pa) == 0
    many = steady_state(
        parameters("listed"), proximal_pressure_pa=np.zeros((3, 1)), distal_pressure_pa=np.zeros((1, 4))
    )
    assert many.capillary_diameter_m.shape == (2, 3, 4) and many.vein_diameter_m.shape == (3, 4)


def test_many_states_at_once_are_the_states_one_by_one():
    p = parameters("figures")
    rng = np.random.default_rng(1)
    proximal, distal = rng.uniform(-5e3, 2e4, (2, 40))
    together = steady_state(p, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
    for i in range(40):
        alone = steady_state(p, proximal_pressure_pa=proximal[i], distal_pressure_pa=distal[i])
        assert np.allclose(alone.capillary_diameter_m, together.capillary_diameter_m[:, i], rtol=1e-12)
        assert alone.vein_diameter_m == pytest.approx(together.vein_diameter_m[i], rel=1e-11)


def test_listed_set_gives_the_analytic_rise_and_closing_pressure():
    # With the listed values eq. (1)-(4) give a rise of D_C1^2 by 7.7 %, and a vein that closes at
    # P_H + k_V D_V/A_V = 1.1 N/cm^2.
    p = parameters("listed")
    touch = np.array([0.0, 1.0985e4, 1.1e4, 1.2e4, 1e6])
    s = steady_state(p, proximal_pressure_pa=touch)
    rise = (s.capillary_diameter_m[0] / s.capillary_diameter_m[0, 0]) ** 2 - 1
    assert rise[-1] == pytest.approx(0.077, abs=5e-4)
    assert s.vein_diameter_m[1] > 1.4e-3 * p.vein_diameter_m
    assert np.all(s.vein_diameter_m[2:] == 1e-3 * p.vein_diameter_m)
    assert np.ptp(s.capillary_diameter_m[:, 2:]) < 1e-12 * p.capillary_diameter_m


def test_without_a_pressure_difference_there_is_no_flow():
    p = parameters("listed").replace(arterial_pressure_pa=3e3, venous_pressure_pa=3e3)
    s = steady_state(p)
    assert s.vein_pressure_pa == pytest.approx(3e3) and np.allclose(s.capillary_pressure_pa, 3e3)
    assert s.vein_diameter_m == pytest.approx(p.vein_diameter_m * (1 + 3e3 / 1e3))


@pytest.mark.parametrize("count", [2, 4, 8])
def test_cutting_a_bed_into_units_that_feel_the_same_changes_nothing(count):
    p = parameters("figures").replace(**TWO_BEDS)
    s2 = steady_state(p, proximal_pressure_pa=4e3, distal_pressure_pa=7e3)
    s = steady_state(p, proximal_pressure_pa=4e3, distal_pressure_pa=7e3, zones=equal_zones(count))
    expected = np.repeat(s2.capillary_diameter_m, count // 2)
    if count == 2:
        assert np.array_equal(s.capillary_diameter_m, expected)  # bit for bit
    assert np.allclose(s.capillary_diameter_m, expected, rtol=1e-11)
    assert s.vein_diameter_m == pytest.approx(s2.vein_diameter_m, rel=1e-11)


def test_where_a_unit_could_balance_twice_the_widest_balance_is_returned():
    # Strong feedback (R_A0/R_V1 about 120) on a soft wall: open and nearly closed both balance.
    p = parameters("listed").replace(capillary_count=1e3, capillary_stiffness_n_per_m=1.5e4)
    touch = np.linspace(0.0, 9e3, 2000)
    s = steady_state(p, distal_pressure_pa=touch)
    width = s.capillary_diameter_m[1] / p.capillary_diameter_m
    jumps = -np.diff(width)
    assert jumps.max() > 0.3 and np.sum(jumps > 0.05) == 1  # one fold, and smooth elsewhere
    # At each pressure the state balances, before the fold and after it.
    tension = p.capillary_stiffness_n_per_m * p.capillary_diameter_m / p.capillary_area_m2
    balance = s.capillary_pressure_pa[1] - touch - tension * (width - 1)
    assert np.abs(balance[width > 1.0001e-3]).max() < 1e-6
    at_fold = int(np.argmax(jumps))
    assert width[at_fold] > width[at_fold + 1]
    # All balances lie at crossings of zero, sampled at very many pressures of the vein node: the widest of the highest.
    for k in (at_fold, at_fold + 1):
        assert width[k] == pytest.approx(widest_of_all(p, touch[k]), rel=0.02)


def widest_of_all(p, distal_pa, count=4000):
    """D_C + x_C over D_C of the distal unit where the widest units bring as much to the vein as leaves it, at the
    highest pressure of the vein node; by polynomials, P_F2 alone pressing."""
    from nailoptics.hemodynamics import PAPER_ZONES
    from nailoptics.hemodynamics.walls import build_walls

    walls = build_walls(p, PAPER_ZONES)
    tension, conductance = walls.stiffness * walls.diameter / walls.area, walls.flow_factor * walls.diameter**4
    high, low = p.arterial_pressure_pa, p.venous_pressure_pa
    node, widest, inflow = np.linspace(high, low, count), np.empty((2, count)), np.zeros(count)
    for unit, outside in enumerate((0.0, distal_pa)):
        # (tension (u - 1) - (P_N - P_F)) (u^4 + barrier) = (P_H - P_N) u^4, whose roots are a matrix's eigenvalues.
        barrier, constant = walls.venule[unit] / conductance[unit], outside - node - tension[unit]
        companion = np.repeat(np.eye(5, k=-1)[None], count, axis=0)
        companion[:, 0, 0], companion[:, 0, 3] = -(constant - (high - node)) / tension[unit], -barrier
        companion[:, 0, 4] = -barrier * constant / tension[unit]
        roots = np.linalg.eigvals(companion)
        widest[unit] = np.where(np.abs(roots.imag) < 1e-9, roots.real, 1e-3).max(1, initial=1e-3)
        arteriole = conductance[unit] * widest[unit] ** 4
        inflow += (high - node) * arteriole * walls.venule[unit] / (arteriole + walls.venule[unit])
    opening = np.maximum(1e-3, 1.0 + node / tension[2])
    excess = conductance[2] * opening**4 * (node - low) - inflow
    return widest[1, np.flatnonzero(excess <= 0.0)[0]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, "much", [1.0, np.nan]])
def test_pressures_must_be_finite_numbers(bad):
    with pytest.raises(InputError, match="proximal_pressure_pa"):
        steady_state(parameters("listed"), proximal_pressure_pa=bad)


def test_zones_with_other_inputs_take_all_pressures_together():
    from nailoptics.hemodynamics import Zones

    cut = Zones(share=(1.0, 1.0), reach=((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)), vein_reach=(1.0, 0.0, 0.0))
    p = parameters("listed")
    with pytest.raises(InputError, match="zones take 3 pressures"):
        steady_state(p, zones=cut)
    with pytest.raises(InputError, match="must hold 3 inputs"):
        steady_state(p, zones=cut, pressure_pa=[1.0, 2.0])
    three = steady_state(p, zones=cut, pressure_pa=[2e3, 3e3, 0.0])
    two = steady_state(p, proximal_pressure_pa=2e3, distal_pressure_pa=3e3)
    assert np.array_equal(three.capillary_diameter_m, two.capillary_diameter_m)


def unbalanced(p, touch, branch="wide"):
    """Largest force that would still move a free wall, over that of the arterial pressure. [1]"""
    from nailoptics.hemodynamics import PAPER_ZONES
    from nailoptics.hemodynamics.walls import MasslessNetwork, build_walls

    s = steady_state(p, proximal_pressure_pa=touch[0], distal_pressure_pa=touch[1], branch=branch)
    walls = build_walls(p, PAPER_ZONES)
    width = np.vstack([s.capillary_diameter_m, s.vein_diameter_m[None]])
    area, stiffness, rest, closed, damping = (
        v[:, None] for v in (walls.area, walls.stiffness, walls.diameter, walls.closed, walls.damping)
    )
    free = np.where(width <= closed * (1 + 1e-12), 0.0, 1.0)
    load = area * np.stack([0.0 * touch[0], touch[1], touch[0]]) + stiffness * (width - rest)
    pressure, speed = MasslessNetwork(walls, width, free).rates(load, 1e4, 0.0)
    lift = area * pressure - load
    assert np.all(lift[free == 0.0] <= 1e-9 * area.max() * 1e4)  # what is closed is pressed shut
    return np.max(np.abs(speed) * damping / (area * 1e4))


@pytest.mark.long
@pytest.mark.parametrize("feedback", [1.0, 100.0])
def test_any_set_within_bounds_balances_at_any_touch(feedback):
    from benchmarks.parameter_search import SEARCHED

    from nailoptics.hemodynamics import bounds

    rng = np.random.default_rng(int(feedback))
    limits = bounds()
    for _ in range(60):
        values = {name: float(np.exp(rng.uniform(*np.log(limits[name])))) for name in SEARCHED}
        p = parameters("listed").replace(**values)
        p = p.replace(capillary_count=p.capillary_count / feedback, capillary_stiffness_n_per_m=2e4)
        touch = rng.uniform(0.0, 2e4, (2, 50))
        assert unbalanced(p, touch) < 1e-6 and unbalanced(p, touch, "narrow") < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_named_sets_have_one_balance_at_any_touch(name):
    touch = np.linspace(0.0, 4e4, 201)
    for proximal, distal in ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
        pressures = {"proximal_pressure_pa": proximal * touch, "distal_pressure_pa": distal * touch}
        wide, narrow = (steady_state(parameters(name), branch=branch, **pressures) for branch in ("wide", "narrow"))
        assert not two_branches(parameters(name), **pressures).any()
        assert np.allclose(wide.capillary_diameter_m, narrow.capillary_diameter_m, rtol=1e-9)


# From random sets within a factor of 10 of the list: soft capillaries that a touch on them shuts, and such that
# a shut vein fills, which then feed it.
SHUT, FILLED = (
    {
        "capillary_stiffness_n_per_m": stiffness[0],
        "vein_stiffness_n_per_m": stiffness[1],
        "capillary_damping_n_s_per_m": damping[0],
        "vein_damping_n_s_per_m": damping[1],
        "capillary_area_m2": area[0],
        "vein_area_m2": area[1],
        "capillary_diameter_m": diameter[0],
        "vein_diameter_m": diameter[1],
        "capillary_count": count[0],
        "vein_count": count[1],
        "venule_resistance_pa_s_per_m3": venule,
    }
    for stiffness, damping, area, diameter, count, venule in (
        ((8e4, 260.0), (1.2e3, 23.0), (5.2e-4, 4.8e-5), (6.9e-6, 3.4e-5), (3e5, 250.0), 5.9e10),
        ((5e4, 3.7e3), (5.4e4, 20.0), (1.1e-4, 2e-5), (2.3e-6, 1.2e-4), (3.2e4, 410.0), 5.4e10),
    )
)


def test_sets_with_two_branches_have_a_loop_gain_above_1():
    from benchmarks.parameter_search import largest_loop_gain

    for changed in (SHUT, FILLED):
        assert largest_loop_gain(parameters("listed").replace(**changed).as_dict()).max() > 1.0


@pytest.mark.parametrize("distal", [0.0, 1.0])
def test_two_branches_are_what_slow_loading_and_unloading_follow(distal):
    from nailoptics.hemodynamics import respond

    p = parameters("listed").replace(**(SHUT if distal else FILLED))
    time = np.linspace(0.0, 1e5, 2001)
    touch = 2e4 * np.interp(time, [0.0, 4e4, 6e4, 1e5], [0.0, 1.0, 1.0, 0.0])
    pressures = {"proximal_pressure_pa": (1.0 - distal) * touch, "distal_pressure_pa": distal * touch}
    moved = respond(p, time, **pressures)["capillary_diameter_m"].values
    wide, narrow = (steady_state(p, branch=b, **pressures).capillary_diameter_m for b in ("wide", "narrow"))
    two = two_branches(p, **pressures)
    up, down = two & (time < 4e4), two & (time > 6e4)
    assert 20 < up.sum() and abs(int(up.sum()) - int(down.sum())) <= 1 and not two[900:1100].any()
    # A touch on the capillaries shuts them, one on the vein fills them: what it led to stays.
    before, after = (wide, narrow) if distal else (narrow, wide)
    listed = p.capillary_diameter_m
    for part, branch in ((up, before), (down, after), (~two, wide)):
        # Near a fold motion takes its time, which a ramp does not leave.
        assert np.quantile(np.abs(moved - branch)[:, part] / listed, 0.9) < 0.01
    assert np.abs(before - after)[:, two].max() > 0.1 * listed


def test_a_branch_has_a_name():
    with pytest.raises(InputError, match="branch must be 'wide' or 'narrow', got 'up'"):
        steady_state(parameters("listed"), branch="up")
