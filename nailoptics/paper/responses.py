"""What vessels do in the paper's figures, for a set of parameters: steady states, and steps of pressure on and off.

For one set the library's own solvers are used; for thousands of sets at once (the search) a coarse stepper that works
on arrays. Both give the same `Responses`, so the claims are judged by one code.
"""

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..hemodynamics.parameters import Parameters
from ..hemodynamics.respond import respond
from ..hemodynamics.steady import solve_walls, steady_state
from ..hemodynamics.walls import Walls, build_walls, massless_jacobian, massless_rates
from ..hemodynamics.zones import PAPER_ZONES

# 1 N/cm^2, the paper's unit of pressure. [Pa]
N_PER_CM2 = 1e4
# Pressures of the static curves: 0 to 2 N/cm^2. (41,) [Pa]
CURVE_PA = np.linspace(0.0, 2e4, 41)
# The paper's steps: 0.1 to 1 N/cm^2. (10,) [Pa]
STEPS_PA = 1e3 * np.arange(1, 11)
# Each step is on from 0 to this instant and then off for as long. [s]
ON_S = 2.0
# Instants within each phase, dense after the step. (81,) [s]
PHASE_S = ON_S * np.linspace(0.0, 1.0, 81) ** 2
# Time constants of the subjects' force in the paper's Figs. 17-18. [s]
LOADING_S, UNLOADING_S = 0.16, 0.12
# The release is a ramp this short, so that the touch is a step for every model here. [s]
_RELEASE_S = 1e-6


@dataclasses.dataclass(frozen=True)
class Responses:
    """Diameters of [proximal capillary, distal capillary, vein] under touch; B is a batch shape, () for one set. [m]

    proximal, both : (3, *B, 41) float. Steady, with P_F1 alone or P_F1 = P_F2 on CURVE_PA.
    proximal_on, proximal_off, both_on, both_off : (3, *B, 10, 81) float. Over PHASE_S after each step on and off.
    force_on, force_off : (3, *B, 1, 81) float. The same for the subjects' force of 1 N on 1 cm^2 (`subject_force`).
    """

    proximal: np.ndarray
    both: np.ndarray
    proximal_on: np.ndarray
    proximal_off: np.ndarray
    both_on: np.ndarray
    both_off: np.ndarray
    force_on: np.ndarray
    force_off: np.ndarray


def subject_force(time_s: ArrayLike, *, force_n: float = 1.0, on_s: float = 0.5, off_s: float = 2.5) -> np.ndarray:
    """The force of the paper's subjects over time: exponential, with 0.16 s on loading and 0.12 s on unloading. [N]

    References: Mascaro and Asada 2001, Figs. 17-18.
    """
    time = np.asarray(time_s, dtype=float)
    top = force_n * (1.0 - np.exp(-(off_s - on_s) / LOADING_S))
    loading = force_n * (1.0 - np.exp(-np.maximum(time - on_s, 0.0) / LOADING_S))
    return np.where(time < off_s, loading, top * np.exp(-np.maximum(time - off_s, 0.0) / UNLOADING_S))


def simulate_responses(parameters: Parameters) -> Responses:
    """The responses of one set, by `steady_state` and `respond`."""
    time = np.concatenate([PHASE_S, ON_S + PHASE_S[1:]])
    knots = np.sort(np.append(time, ON_S + _RELEASE_S))
    size = PHASE_S.size
    fields: dict[str, np.ndarray] = {}
    for name, distal_part in (("proximal", 0.0), ("both", 1.0)):
        state = steady_state(parameters, proximal_pressure_pa=CURVE_PA, distal_pressure_pa=distal_part * CURVE_PA)
        fields[name] = np.vstack([state.capillary_diameter_m, state.vein_diameter_m[None]])
        touches = [np.where(knots <= ON_S, pressure, 0.0) for pressure in STEPS_PA]
        widths = [_widths(parameters, knots, touch, distal_part * touch) for touch in touches]
        width = np.delete(np.stack(widths, axis=1), size, axis=2)
        fields[f"{name}_on"], fields[f"{name}_off"] = width[..., :size], width[..., size - 1 :]
    fine = np.union1d(np.arange(0.0, 2.0 * ON_S, 1e-3), time)
    touch = N_PER_CM2 * subject_force(fine, on_s=0.0, off_s=ON_S)
    width = _widths(parameters, fine, touch, touch)[:, None, np.searchsorted(fine, time)]
    fields["force_on"], fields["force_off"] = width[..., :size], width[..., size - 1 :]
    return Responses(**fields)


def _widths(parameters: Parameters, time: np.ndarray, proximal: np.ndarray, distal: np.ndarray) -> np.ndarray:
    run = respond(parameters, time, proximal_pressure_pa=proximal, distal_pressure_pa=distal)
    return np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])


def simulate_responses_of_many(values: dict[str, np.ndarray]) -> Responses:
    """The responses of many sets at once, coarsely: (B,) float values of every field of `Parameters` by name."""
    # Each constant of the walls becomes a column of sets, beside which pressures are rows.
    columns = {name: np.asarray(value)[:, None] for name, value in values.items()}
    walls = build_walls(cast(Parameters, SimpleNamespace(**columns)), PAPER_ZONES)
    high, low = columns["arterial_pressure_pa"], columns["venous_pressure_pa"]
    fields: dict[str, np.ndarray] = {}
    for name, distal_part in (("proximal", 0.0), ("both", 1.0)):
        fields[name] = _balances(walls, CURVE_PA, distal_part, high, low)
        rest = np.repeat(fields[name][:, :, :1], STEPS_PA.size, axis=2)
        fields[f"{name}_on"] = _relax(walls, rest, STEPS_PA, distal_part, high, low)
        fields[f"{name}_off"] = _relax(walls, fields[f"{name}_on"][..., -1], 0.0 * STEPS_PA, distal_part, high, low)
    loading = 1.0 - np.exp(-PHASE_S / LOADING_S)
    unloading = loading[-1] * np.exp(-PHASE_S / UNLOADING_S)
    top = np.array([N_PER_CM2])
    fields["force_on"] = _relax(walls, fields["both"][..., :1], top, 1.0, high, low, course=loading)
    fields["force_off"] = _relax(walls, fields["force_on"][..., -1], top, 1.0, high, low, course=unloading)
    return Responses(**fields)


def _balances(walls: Walls, touch: np.ndarray, distal_part: float, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Steady diameters, (3, B, pressures) float."""
    shape = (high.shape[0], touch.size)
    outside = np.stack([np.zeros(shape), np.broadcast_to(distal_part * touch, shape), np.broadcast_to(touch, shape)])
    return solve_walls(walls, outside, np.broadcast_to(high, shape), np.broadcast_to(low, shape), tolerance=1e-9)[0]


def _relax(
    walls: Walls,
    start: np.ndarray,
    touch: np.ndarray,
    distal_part: float,
    high: np.ndarray,
    low: np.ndarray,
    *,
    course: np.ndarray | None = None,
) -> np.ndarray:
    """Diameters over PHASE_S, (3, B, steps, 81) float, by ROS2, a Rosenbrock method of order 2 that is L-stable.

    course : (81,) float. Factor of the touch over PHASE_S; None is a constant touch. [1]

    References: Verwer, Spee, Blom, Hundsdorfer 1999, SIAM J. Sci. Comput. 20:1456.
    """
    gamma = 1.0 - np.sqrt(0.5)
    area, stiffness, listed, closed = map(np.stack, (walls.area, walls.stiffness, walls.diameter, walls.closed))
    force = np.stack([0.0 * area[0] * touch, area[1] * distal_part * touch, area[2] * touch])
    part = np.ones(PHASE_S.size) if course is None else course

    def load(width: np.ndarray, factor: float) -> np.ndarray:
        return np.asarray(factor * force + stiffness * (width - listed))

    path = [start]
    for h, now, then in zip(np.diff(PHASE_S), part[:-1], part[1:], strict=True):
        width, loads = path[-1], load(path[-1], now)
        held = np.where(width <= closed, 0.0, 1.0)
        pressures, _ = massless_rates(walls, width, loads, held, high, low)
        free = np.where((held > 0.0) | (area * pressures > loads), 1.0, 0.0)
        pressures, speeds = massless_rates(walls, width, loads, free, high, low)
        jacobian = massless_jacobian(walls, width, free, pressures, high, low)
        drift = np.zeros_like(width)
        if course is not None:
            # What the touch's own change does to the speeds.
            _, rates = massless_rates(walls, width, (then - now) / h * force, free, 0.0 * high, 0.0 * low)
            drift = gamma * h * np.array(rates)
        k1 = _rank_one_solve(speeds + drift, jacobian, gamma * h)
        middle = np.maximum(width + h * k1, closed)
        _, later = massless_rates(walls, middle, load(middle, then), free, high, low)
        k2 = _rank_one_solve(later - 2.0 * k1 - drift, jacobian, gamma * h)
        path.append(np.maximum(width + h * (1.5 * k1 + 0.5 * k2), closed))
    return np.stack(path, axis=-1)


def _rank_one_solve(rhs: np.ndarray, jacobian: tuple[Any, Any, Any], gh: float) -> np.ndarray:
    """The x of (I - gh (diag(d) + outer(p, q))) x = rhs, by the formula of Sherman and Morrison."""
    diagonal, left, right = map(np.array, jacobian)
    inverse = 1.0 / (1.0 - gh * diagonal)
    reach = (right * inverse * rhs).sum(axis=0)
    loss = 1.0 - gh * (right * inverse * left).sum(axis=0)
    return np.asarray(inverse * (rhs + gh * left * reach / loss))
