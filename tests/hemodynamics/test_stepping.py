"""Steps of 10 ms for many networks at once agree with the integrator that works to a tolerance."""

import numpy as np
import pytest

from nailoptics import hemodynamics
from nailoptics.hemodynamics.rosenbrock import step
from nailoptics.hemodynamics.walls import Walls, build_walls
from nailoptics.hemodynamics.zones import PAPER_ZONES

TIME_S = np.arange(0.0, 3.0, 0.01)


@pytest.mark.parametrize("name", hemodynamics.NAMES)
@pytest.mark.parametrize("side", ["proximal", "distal", "both"])
def test_a_press_agrees_with_respond(name: str, side: str) -> None:
    parameters = hemodynamics.parameters(name)
    # As fast as a finger presses: 0.16 s up, 0.12 s down.
    force = np.where(TIME_S < 1.5, 1 - np.exp(-TIME_S / 0.16), np.exp(-(TIME_S - 1.5) / 0.12)) * 0.8e4
    proximal, distal = force * (side != "distal"), force * (side != "proximal")
    walls, high, low = build_walls(parameters, PAPER_ZONES), parameters.arterial_pressure_pa, 0.0
    rest = hemodynamics.steady_state(parameters)
    diameter = np.append(rest.capillary_diameter_m, rest.vein_diameter_m)
    start = diameter
    path = [diameter]
    outside = np.stack([np.zeros_like(force), distal, proximal])
    for k in range(TIME_S.size - 1):
        change = outside[:, k + 1] - outside[:, k]
        diameter = step(walls, diameter, outside[:, k], high, low, step_s=0.01, outside_change=change)
        path.append(diameter)
    run = hemodynamics.respond(parameters, TIME_S, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
    exact = np.vstack([run.capillary_diameter_m.values, run.vein_diameter_m.values])
    # Blood goes with the square of a capillary's diameter: 0.5 % of it at most, of a change by tens of percent.
    assert np.abs(np.transpose(path) - exact)[:2].max() < 2.5e-3 * start[0]


def test_many_networks_step_as_each_alone() -> None:
    sets = [hemodynamics.parameters(name) for name in hemodynamics.NAMES]
    rest = [hemodynamics.steady_state(one) for one in sets]
    diameters = np.transpose([np.append(one.capillary_diameter_m, one.vein_diameter_m) for one in rest])
    each = [build_walls(one, PAPER_ZONES) for one in sets]
    many = Walls(*(np.stack(columns, axis=1) for columns in zip(*(one.constants for one in each), strict=True)))
    outside = np.repeat(np.array([[0.0], [3e3], [5e3]]), len(sets), axis=1)
    together = step(many, diameters, outside, 1e4, 0.0, step_s=0.01)
    for k, walls in enumerate(each):
        alone = step(walls, diameters[:, k], outside[:, k], 1e4, 0.0, step_s=0.01)
        np.testing.assert_array_equal(together[:, k], alone)


def test_steps_far_longer_than_a_wall_takes_end_in_the_steady_state() -> None:
    parameters = hemodynamics.parameters("best")
    walls, rest = build_walls(parameters, PAPER_ZONES), hemodynamics.steady_state(parameters)
    diameter = np.append(rest.capillary_diameter_m, rest.vein_diameter_m)
    outside = np.array([0.0, 5e3, 5e3])
    for _ in range(400):
        diameter = step(walls, diameter, outside, 1e4, 0.0, step_s=0.05)
    held = hemodynamics.steady_state(parameters, proximal_pressure_pa=5e3, distal_pressure_pa=5e3)
    np.testing.assert_allclose(diameter[:2], held.capillary_diameter_m, rtol=1e-6)
