"""Steady states: the diameters at which blood, wall and touch balance, for many touches at once, and their response to
small waves of the arterial pressure.

Two nested roots, each bracketed, by Newton's method: the pressure of the vein node, and at a given one the diameter of
each unit.
"""

import dataclasses
from collections.abc import Callable
from typing import Literal, Unpack

import numpy as np

from ..checks import Array, finite
from ..errors import InputError
from .parameters import Parameters
from .touch import Pressures, named_pressures
from .walls import CLOSED_FRACTION, MasslessNetwork, Walls, build_walls
from .zones import PAPER_ZONES, Zones

Branch = Literal["wide", "narrow"]
_BRANCHES: tuple[Branch, ...] = ("wide", "narrow")
# Diameters over the listed ones that differ by less are the same. [1]
_SAME = 1e-6
# Where the pressure of the vein node is tried first, from P_L to P_H: crowded near both, where vessels shut. [1]
_NODE_PARTS = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 12))
_MOST_ITERATIONS = 100


@dataclasses.dataclass(frozen=True)
class SteadyState:
    """Balanced diameters and pressures; S is the shape of the pressures given, () for single numbers.

    capillary_diameter_m : (N, *S) float. D_C + x_C; N is 2 unless other zones were given, proximal first. [m]
    vein_diameter_m : S float. D_V + x_V. [m]
    capillary_pressure_pa : (N, *S) float. Blood pressure. [Pa]
    vein_pressure_pa : S float. Blood pressure. [Pa]
    """

    capillary_diameter_m: np.ndarray
    vein_diameter_m: np.ndarray
    capillary_pressure_pa: np.ndarray
    vein_pressure_pa: np.ndarray


def steady_state(
    parameters: Parameters, *, zones: Zones = PAPER_ZONES, branch: Branch = "wide", **pressures: Unpack[Pressures]
) -> SteadyState:
    """The vessels once a touch has been held for long; arrays of pressures are broadcast and solved together.

    zones : Units along the nail and the reach of each pressure.
    branch : Which balance is returned where there are several: "wide", that of an untouched finger, whose vessels are
        all wider than in any other, or "narrow", whose vessels are all narrower.
    pressures : as in `Pressures`.

    Vessels close on contact at a thousandth of their listed diameter, past which nothing moves. Strong feedback of R_A
    on D_C makes a second balance: vessels that a touch on them has shut may stay narrow after it, and those that a shut
    vein has filled may stay wide. `two_branches` says where.

    Raises: InputError if a pressure is not finite, the shapes do not fit, or the branch is neither.
    """
    if branch not in _BRANCHES:
        raise InputError(f"branch must be 'wide' or 'narrow', got {branch!r}.")
    given = named_pressures(parameters, zones, pressures)
    high, low, *touch = np.broadcast_arrays(*[finite(name, value) for name, value in given.items()])
    walls, n, shape = build_walls(parameters, zones), zones.count, high.shape
    outside = zones.on_walls(np.array([pressure.ravel() for pressure in touch]))
    diameter, pressure = solve_walls(walls, outside, high.ravel(), low.ravel(), branch=branch)
    return SteadyState(
        capillary_diameter_m=diameter[:n].reshape((n, *shape)),
        vein_diameter_m=diameter[n].reshape(shape)[()],
        capillary_pressure_pa=pressure[:n].reshape((n, *shape)),
        vein_pressure_pa=pressure[n].reshape(shape)[()],
    )


def two_branches(parameters: Parameters, *, zones: Zones = PAPER_ZONES, **pressures: Unpack[Pressures]) -> np.ndarray:
    """Where there are two steady states, so that unloading may end in another than loading led to, S bool; arguments as
    of `steady_state`."""
    states = [steady_state(parameters, zones=zones, branch=branch, **pressures) for branch in _BRANCHES]
    wide, narrow = (np.stack([*state.capillary_diameter_m, state.vein_diameter_m]) for state in states)
    gap = np.abs(wide - narrow).T / build_walls(parameters, zones).diameter
    return np.asarray(gap.max(axis=-1).T > _SAME)


def linear_response(
    walls: Walls, frequency_hz: np.ndarray, outside_pa: np.ndarray, high_pa: np.ndarray, low_pa: np.ndarray
) -> np.ndarray:
    """Change of the diameter of every wall with a small wave of P_H while a touch is held, (N+1, F) complex. [m/Pa]

    frequency_hz : (F,) float; 0 is a change that is held. outside_pa : (N+1, 1) float. Touch pressure on each wall.
    high_pa, low_pa : (1,) float. P_H and P_L.

    The absolute value is the amplitude of a diameter over that of the wave, the angle its phase. The massless network,
    linearised where it rests: a wall that touches does not move.
    """
    diameter, pressure = solve_walls(walls, outside_pa, high_pa, low_pa)
    free = np.where(diameter > walls.with_axes(2).closed * (1.0 + 1e-9), 1.0, 0.0)
    network = MasslessNetwork(walls, diameter, free)
    diagonal, left, right = (part[:, 0] for part in network.jacobian(pressure, high_pa, low_pa))
    # Speeds are linear in P_H.
    by_high = network.speeds(np.zeros_like(diameter), 1.0, 0.0)
    slopes, count = np.diag(diagonal) + np.outer(left, right), len(diameter)
    turning = 2j * np.pi * frequency_hz[:, None, None] * np.eye(count)
    return np.linalg.solve(turning - slopes, np.broadcast_to(by_high, (frequency_hz.size, count, 1)))[..., 0].T


def solve_walls(
    walls: Walls,
    outside: np.ndarray,
    high: np.ndarray,
    low: np.ndarray,
    *,
    tolerance: float = 1e-14,
    branch: Branch = "wide",
) -> tuple[np.ndarray, np.ndarray]:
    """Diameters [m] and pressures [Pa], (N+1, *S), of the walls in steady states.

    outside : (N+1, *S) float. Touch pressure on each wall. high, low : S float. P_H and P_L. [Pa]
    tolerance : error of the vein's pressure, relative to P_H and P_L, and of the diameters. [1]
    branch : The balance whose vessels are the widest, or the narrowest, of all.

    The constants of `walls` may be arrays that broadcast to S.
    """
    # Along the last axis several pressures of the vein node are tried together.
    walls = Walls(*(constant[..., None] for constant in walls.with_axes(outside.ndim).constants))
    n, (outside, high, low) = len(walls.venule), (values[..., None] for values in (outside, high, low))
    tension = walls.stiffness * walls.diameter / walls.area
    conductance, venule = walls.flow_factor * walls.diameter**4, walls.venule
    barrier = venule / conductance[:n]
    # The sign of P_H - P_L says which end has more outflow.
    sign = np.where(high >= low, 1.0, -1.0)

    def vein_opening(node: np.ndarray) -> np.ndarray:
        return np.maximum(CLOSED_FRACTION, 1.0 + (node - outside[n]) / tension[n])

    def unit_openings(node: np.ndarray, *known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        push, head = node - outside[:n], high - node
        return _openings(tension[:n], barrier, push, head, *known, tolerance=tolerance, branch=branch)

    def excess_outflow(node: np.ndarray, opening: np.ndarray, by_node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What flows out of the vein node less what flows in, and its slope."""
        inflow, inflow_slope = _inflow(conductance[:n], venule, high - node, opening, by_node)
        vein = vein_opening(node)
        outlet = conductance[n] * np.square(np.square(vein))
        widens = np.where(vein > CLOSED_FRACTION, 4.0 / (tension[n] * vein), 0.0)
        slope = outlet * (1.0 + widens * (node - low)) - inflow_slope
        return sign * (outlet * (node - low) - inflow), sign * slope

    tried = np.minimum(high, low) + _NODE_PARTS * np.abs(high - low)
    openings = unit_openings(tried)
    # The higher the vein node's pressure, the wider all units.
    (lower, upper), known = _brackets(excess_outflow(tried, *openings)[0], branch, tried, openings[0])
    node, _ = _newton_root(
        lambda node: excess_outflow(node, *unit_openings(node, *known)),
        lower,
        upper,
        start=lower if branch == "narrow" else upper,
        tolerance=tolerance * (np.maximum(np.abs(high), np.abs(low)) + 1.0),
    )
    opening = unit_openings(node, *known)[0]
    arteriole = conductance[:n] * np.square(np.square(opening))
    pressure = (arteriole * high + venule * node) / (arteriole + venule)
    diameter = np.concatenate([opening, vein_opening(node)[None]]) * walls.diameter
    return diameter[..., 0], np.concatenate([pressure, node[None]])[..., 0]


def _brackets(excess: Array, branch: Branch, *tried: Array) -> list[list[Array]]:
    """What was tried, (..., k) each, on either side of where the excess outflow (..., k) rises through zero, (..., 1)
    each: all balances lie between its lowest crossing with narrow units and its highest with wide ones."""
    above = excess > 0.0
    above[..., 0], above[..., -1] = False, True
    rising = above[..., 1:] & ~above[..., :-1]
    last = rising.shape[-1] - 1
    at = np.argmax(rising, axis=-1) if branch == "narrow" else last - np.argmax(rising[..., ::-1], axis=-1)
    sides = at[..., None], at[..., None] + 1
    return [
        [np.take_along_axis(values, side[(None,) * (values.ndim - side.ndim)], axis=-1) for side in sides]
        for values in tried
    ]


def _inflow(conductance: Array, venule: Array, head: Array, opening: Array, by_node: Array) -> tuple[Array, Array]:
    """What flows through all units into the vein node at a head P_H - P_N, and its slope with P_N. [m^3/s, m^3/(Pa s)]

    conductance, venule : of units at their listed diameters and of their venules. [m^3/(Pa s)]
    opening, by_node : of the units, and its slope with P_N. [1, 1/Pa]
    """
    arteriole = conductance * np.square(np.square(opening))
    part = venule / (arteriole + venule)
    slope = part * arteriole * (4.0 * part * head * by_node / opening - 1.0)
    return (part * arteriole * head).sum(axis=0), slope.sum(axis=0)


def _openings(
    tension: Array,
    barrier: Array,
    push: Array,
    head: Array,
    lowest: Array | float = 0.0,
    highest: Array | float = np.inf,
    *,
    tolerance: float,
    branch: Branch,
) -> tuple[Array, Array]:
    """The widest (or narrowest) opening u = (D+x)/D at which a capillary wall balances, or that of contact, and its
    slope with the vein node's pressure P_N. [1, 1/Pa]

    tension (u-1) = push + head u^4/(u^4 + barrier), all arrays that broadcast:
    push : P_N - P_F. head : P_H - P_N. tension : k D/A. [Pa]
    barrier : R_A0/R_Vi, the capillary's resistance at its listed diameter over its venule's. [1]
    lowest, highest : bounds of the opening that are known.
    """
    feedback = 4.0 * head * barrier

    def balance(u: Array) -> tuple[Array, Array]:
        """The wall's tension less what opens it, and its slope."""
        square = u * u
        u4 = square * square
        below = u4 + barrier
        return tension * (u - 1.0) - push - head * u4 / below, tension - feedback * square * u / (below * below)

    bottom = np.maximum(np.maximum(lowest, CLOSED_FRACTION), 1.0 + (push + np.minimum(head, 0.0)) / tension)
    top = np.maximum(bottom, np.minimum(highest, 1.0 + (push + np.maximum(head, 0.0)) / tension))
    # Where the feedback u^4/(u^4 + barrier) is steeper than the wall's tension there may be three roots. Right of the
    # feedback's steepest point, u^4 = 3/5 barrier, the balance is convex: Newton's method from the right passes no
    # root there. Left of it the balance is concave, and the method passes none from the left.
    start, at_low = bottom if branch == "narrow" else top, balance(bottom)[0] >= 0.0
    u, slope = _newton_root(balance, bottom, top, start=start, at_low=at_low, tolerance=tolerance * top)
    # Where two roots meet, the slope has no bound.
    by_node = barrier / (np.square(np.square(u)) + barrier) / np.maximum(slope, tolerance * tension)
    return u, np.where(u > CLOSED_FRACTION, by_node, 0.0)


def _newton_root(
    function: Callable[[Array], tuple[Array, Array]],
    low: Array,
    high: Array,
    *,
    start: Array,
    tolerance: Array,
    at_low: np.ndarray | bool = False,
) -> tuple[Array, Array]:
    """A root of each component of a smooth function, which gives values and slopes, <= 0 at low and >= 0 at high, by
    Newton's method kept inside; and the slope there.

    at_low : whether the function is positive at low already, which is the root if the method leaves without another.
    """
    first, x = low, start
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(_MOST_ITERATIONS):
            value, slope = function(x)
            positive = value > 0.0
            at_low = at_low & positive
            low, high = np.where(positive, low, x), np.where(positive, x, high)
            newton = x - value / slope
            inside = (newton >= low) & (newton <= high)
            last, x = x, np.where(inside, newton, np.where(at_low, first, 0.5 * (low + high)))
            if (np.abs(x - last) <= tolerance).all():
                break
    return x, slope
