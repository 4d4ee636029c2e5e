"""The network of eq. (1)-(4): its closed form and its eliminations against a direct Kirchhoff solution."""

import numpy as np
import pytest
from equal_zones import equal_zones
from printed_equations import coefficients, resistances, state_matrices

from nailoptics.hemodynamics import PAPER_ZONES, parameters, steady_state
from nailoptics.hemodynamics.walls import MasslessNetwork, build_walls, inertial_pressures


def kirchhoff(arteriole, venule, vein, injected, high, low):
    """Node pressures from flow balance written node by node: units 1..N, then the vein node."""
    n = len(arteriole)
    matrix, flow = np.zeros((n + 1, n + 1)), np.array(injected, dtype=float)
    for i in range(n):
        matrix[i, i] = 1 / arteriole[i] + 1 / venule[i]
        matrix[i, n] = matrix[n, i] = -1 / venule[i]
        flow[i] += high / arteriole[i]
    matrix[n, n] = sum(1 / v for v in venule) + 1 / vein
    flow[n] += low / vein
    return np.linalg.solve(matrix, flow)


def test_printed_coefficients_agree_with_kirchhoff_in_500_random_networks():
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(500):
        a1, a2, v1, v2, rv = 10.0 ** rng.uniform(9, 13, 5)
        area, damping = 10.0 ** rng.uniform(-5, -3, 3), 10.0 ** rng.uniform(1, 5, 3)
        c = coefficients(
            arteriole_resistance=(a1, a2),
            venule_resistance=(v1, v2),
            vein_resistance=rv,
            area=tuple(area),
            damping=tuple(damping),
        )
        r1, r2 = a1 + v1, a2 + v2
        assert c.total == pytest.approx(r1 * r2 + rv * (r1 + r2), rel=1e-12)
        # Column j of R: the force against wall j moving alone at 1 m/s, which takes area_j of flow out of its node.
        for j in range(3):
            speed = np.eye(3)[j]
            node = kirchhoff((a1, a2), (v1, v2), rv, -area * speed, 0.0, 0.0)
            force = damping * speed - area * node
            worst = max(worst, np.max(np.abs(c.damping[:, j] / force - 1)))
        for column, (high, low) in enumerate([(1.0, 0.0), (0.0, 1.0)]):
            node = kirchhoff((a1, a2), (v1, v2), rv, np.zeros(3), high, low)
            worst = max(worst, np.max(np.abs(c.drive[:, column] / (area * node) - 1)))
        assert np.array_equal(c.drive[:, 2:], np.array([[0, 0], [0, -area[1]], [-area[2], 0]]))
        assert np.array_equal(c.damping, c.damping.T) or np.allclose(c.damping, c.damping.T, rtol=1e-12)
        assert np.linalg.eigvalsh(c.damping).min() > 0.0
    assert worst < 1e-9


def test_listed_set_is_as_stiff_as_the_masses_make_it():
    # The fastest rate is damper over mass, b_C / m = 1e4 / 1e-3 1/s; the slowest is hydraulic, some 1/s.
    p = parameters("listed")
    rest = steady_state(p)
    diameter = np.append(rest.capillary_diameter_m, rest.vein_diameter_m)
    rates = np.linalg.eigvals(state_matrices(p, diameter)[0])
    assert np.all(np.abs(rates.imag) < 1e-6 * np.abs(rates.real))
    assert -1.1e7 < rates.real.min() < -0.9e7
    assert -10.0 < rates.real.max() < -5.0


def test_listed_resistances_are_of_the_order_of_the_venules():
    p = parameters("listed")
    (arteriole, same), vein = resistances(p, np.array([1e-5, 1e-5, 1e-4]))
    assert arteriole == same == pytest.approx(128 * 1e-3 * 3e-3 / (1e5 * np.pi * 1e-20))
    # Eq. (3) with the listed values: 128 L mu / (N pi D^4) = 1.2e11 Pa s/m^3, R_V1 is 1e11.
    assert arteriole / p.venule_resistance_pa_s_per_m3 == pytest.approx(1.2, abs=0.03)
    assert vein == pytest.approx(128 * 1e-2 * 3e-3 / (1e2 * np.pi * 1e-16))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_eliminations_agree_with_kirchhoff_for_any_number_of_units(count):
    rng = np.random.default_rng(count)
    walls = build_walls(parameters("listed"), equal_zones(count, decay_length=0.3))
    n = count + 1
    for _ in range(100):
        diameter = walls.diameter * 10.0 ** rng.uniform(-1, 0.5, n)  # narrower, the direct solution loses digits
        high, low = rng.uniform(0, 2e4, 2)
        resistance = 1 / (walls.flow_factor * diameter**4)
        network = (resistance[:-1], 1 / walls.venule, resistance[-1])
        speed = rng.normal(0, 1e-5, n)
        direct = kirchhoff(*network, -walls.area * speed, high, low)
        assert np.allclose(inertial_pressures(walls, diameter, speed, high, low), direct, rtol=1e-9, atol=1e-6)

        load = walls.area * rng.uniform(-1e4, 2e4, n)
        free = np.where(rng.random(n) < 0.7, 1.0, 0.0)
        pressure, speed = MasslessNetwork(walls, diameter, free).rates(load, high, low)
        assert np.allclose(pressure, kirchhoff(*network, -walls.area * speed, high, low), rtol=1e-9, atol=1e-6)
        force = walls.area * pressure - load
        assert np.allclose(walls.damping * speed, force * free, rtol=1e-9)


def test_jacobian_agrees_with_finite_differences():
    rng = np.random.default_rng(5)
    walls = build_walls(parameters("figures"), PAPER_ZONES)
    rest, stiffness = walls.diameter, walls.stiffness
    outside = walls.area * rng.uniform(0, 1e4, 3)

    def speed(diameter, free):
        return MasslessNetwork(walls, diameter, free).speeds(outside + stiffness * (diameter - rest), 1e4, 0.0)

    for free in np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]):
        diameter = rest * rng.uniform(0.3, 2.0, 3)
        network = MasslessNetwork(walls, diameter, free)
        pressure = network.rates(outside + stiffness * (diameter - rest), 1e4, 0.0)[0]
        diagonal, left, right = network.jacobian(pressure, 1e4, 0.0)
        exact = np.diag(diagonal) + np.outer(left, right)
        step = 1e-5 * rest
        numeric = np.column_stack(
            [(speed(diameter + e, free) - speed(diameter - e, free)) / (2 * e.sum()) for e in np.diag(step)]
        )
        scale = np.abs(exact).max()
        assert np.abs(exact - numeric).max() < 1e-6 * scale


def test_massless_speeds_solve_the_printed_equations_without_mass():
    p = parameters("listed")
    walls = build_walls(p, PAPER_ZONES)
    diameter = np.array([1.3e-5, 0.8e-5, 1.7e-4])
    stretch = diameter - walls.diameter
    inputs = np.array([1e4, 200.0, 3e3, 5e3])
    a, b = state_matrices(p, diameter)
    load = walls.area * [0.0, 5e3, 3e3] + walls.stiffness * stretch
    speed = MasslessNetwork(walls, diameter, np.ones(3)).speeds(load, 1e4, 200.0)
    acceleration = (a @ np.concatenate([stretch, speed]) + b @ inputs)[3:]
    largest = np.abs(a[3:, 3:] @ speed).max()
    assert np.abs(acceleration).max() < 1e-12 * largest
