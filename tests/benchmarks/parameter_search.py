"""Global search for parameter sets near the listed one that meet as many claims at once as possible."""

import dataclasses
import logging
import math
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np

from nailoptics.errors import InputError
from nailoptics.hemodynamics.parameters import Parameters, bounds
from nailoptics.hemodynamics.rosenbrock import step
from nailoptics.hemodynamics.steady import solve_walls
from nailoptics.hemodynamics.touch import Zones
from nailoptics.hemodynamics.walls import Walls, build_walls
from nailoptics.paper.claims import RULES
from nailoptics.paper.protocols import Protocol
from nailoptics.paper.responses import Responses, responses_of

_LOG = logging.getLogger(__name__)

# What is varied. The rest changes nothing of its own: lengths and viscosity act as counts do, masses do not matter.
SEARCHED = (
    "capillary_stiffness_n_per_m",
    "vein_stiffness_n_per_m",
    "capillary_damping_n_s_per_m",
    "vein_damping_n_s_per_m",
    "capillary_area_m2",
    "vein_area_m2",
    "capillary_diameter_m",
    "vein_diameter_m",
    "capillary_count",
    "vein_count",
    "venule_resistance_pa_s_per_m3",
)
# How far inside its bounds a claim has to be: the search measures coarsely, and what it finds is rounded. [1]
_MARGIN = 0.01
# A miss of this size costs half a claim. Less for more, so that one claim missed by far is better than several missed
# by a little; smooth, so that the search sees every gain. [1]
_HALF_MISS = 0.3
# Weight of the distance from the list: of sets that meet the same claims, the nearest wins. [1]
_NEAR = 0.02
# The bound by which a miss is divided is no less than this: some bounds are 0. [1]
_LEAST_BOUND = 0.05
# The miss of a claim that cannot be measured: far off. [1]
_UNMEASURED = 10.0
# A static curve jumps if it changes by more than this part of its range in 500 Pa; each part more costs so much. [1]
_JUMP, _JUMP_COST = 0.2, 5.0
# After a touch this part of the change may be left. [1]
_LEFT = 0.1
# Cost of a value outside its bounds, for each square of a decade. [1]
_OUTSIDE = 10.0
# An evolution ends once its steps are smaller than this. [decades]
_SMALLEST_STEP = 2e-3


@dataclasses.dataclass(frozen=True)
class Found:
    """The best set of a search. met : claims met of `len(RULES)`. loss : the objective. sets : number tried."""

    parameters: Parameters
    met: int
    loss: float
    sets: int


def misses(responses: Responses, *, margin: float = 0.0) -> np.ndarray:
    """How far each claim is from being met, (claims, *B) float: 0 if met, else relative to its bound. [1]

    margin : How far inside its bounds a claim has to be, relative to them. [1]
    """
    rows = []
    for rule in RULES:
        with np.errstate(all="ignore"):
            value = np.asarray(rule.measure(responses), dtype=float)
        miss = np.zeros(value.shape)
        if math.isfinite(rule.low):
            miss = np.maximum(miss, (rule.low - value) / max(abs(rule.low), _LEAST_BOUND) + margin * (rule.low != 0.0))
        if math.isfinite(rule.high):
            miss = np.maximum(miss, (value - rule.high) / max(abs(rule.high), _LEAST_BOUND) + margin)
        rows.append(np.where(np.isfinite(value), miss, _UNMEASURED))
    return np.array(rows)


def loss(responses: Responses) -> np.ndarray:
    """What the search makes small, B float: nearly 1 for each claim missed by far, less for one missed by little.

    A static curve that jumps (a fold), or vessels that do not come back from a touch, are no model of a sensor, and add
    to it.
    """
    r = responses
    miss = misses(r, margin=_MARGIN)
    total = (miss / (miss + _HALF_MISS)).sum(axis=0)
    for curve in (r.proximal, r.distal, r.both):
        jump = np.abs(np.diff(curve, axis=-1)).max(axis=-1) / np.maximum(np.ptp(curve, axis=-1), 1e-30)
        total = total + np.maximum(jump[:2] - _JUMP, 0.0).sum(axis=0) * _JUMP_COST
    for on, off in ((r.proximal_on, r.proximal_off), (r.both_on, r.both_off)):
        left = np.abs(off[..., -1] - on[..., 0]) / np.maximum(np.abs(on[..., -1] - on[..., 0]), 1e-30)
        total = total + np.maximum(left[:2, ..., -1] - _LEFT, 0.0).sum(axis=0)
    return np.where(np.isfinite(total), total, float(len(RULES)))


def search(
    *,
    seed: int,
    max_seconds: float = 600.0,
    population: int = 60,
    factor: float = 10.0,
    start: Parameters | None = None,
) -> Found:
    """The best set that evolutions find in a time, each value within a factor of the listed one.

    seed : Of the random numbers. max_seconds : Wall time. population : Sets in each generation, 6 or more.
    start : Where the first evolution starts; later ones, and without it all, start at the best of a random population.

    Raises: InputError if the time or the population is too small.
    """
    if not max_seconds > 0.0:
        raise InputError(f"max_seconds must be greater than 0, got {max_seconds}.")
    if population < 6:
        raise InputError(f"population must be 6 or more, got {population}.")
    limits = bounds(factor=factor)
    low, high = np.log10([limits[name] for name in SEARCHED]).T
    deadline, rng, tried = time.monotonic() + max_seconds, np.random.default_rng(seed), 0

    def objective(points: np.ndarray) -> np.ndarray:
        nonlocal tried
        tried += len(points)
        inside = np.clip(points, low, high)
        outside, far = ((points - inside) ** 2).sum(axis=1), ((inside - 0.5 * (low + high)) ** 2).mean(axis=1)
        return loss(simulate_responses_of_many(values_of(inside.T))) + _OUTSIDE * outside + _NEAR * far

    best, at = math.inf, 0.5 * (low + high)
    first = None if start is None else np.log10([start.as_dict()[name] for name in SEARCHED])
    while math.isinf(best) or time.monotonic() < deadline:
        if first is None:
            scattered = rng.uniform(low, high, (3 * population, len(SEARCHED)))
            first = scattered[np.argmin(objective(scattered))]
        value, point = _evolve(objective, first, rng=rng, population=population, deadline=deadline)
        if value < best:
            best, at = value, np.clip(point, low, high)
        first = None
    values = {name: float(f"{10.0**x:.3g}") for name, x in zip(SEARCHED, at, strict=True)}
    responses = simulate_responses_of_many(values_of(np.log10(np.array([[values[name]] for name in SEARCHED]))))
    met = int((misses(responses)[:, 0] == 0.0).sum())
    _LOG.info("search with seed %d: %d of %d claims met after %d sets", seed, met, len(RULES), tried)
    return Found(Parameters(**values), met, float(loss(responses)[0]), tried)


def _evolve(
    objective: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    rng: np.random.Generator,
    population: int,
    deadline: float,
    step: float = 0.3,
) -> tuple[float, np.ndarray]:
    """The least value, and where, that an evolution strategy with an adapted covariance finds from a start.

    step : Standard deviation of the first generation. [decades]

    References: Hansen 2016, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772.
    """
    n, parents = start.size, population // 2
    weight = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weight /= weight.sum()
    mass = 1.0 / (weight**2).sum()
    path_rate, cov_rate = (mass + 2) / (n + mass + 5), (4 + mass / n) / (n + 4 + 2 * mass / n)
    damping = 1 + 2 * max(0.0, math.sqrt((mass - 1) / (n + 1)) - 1) + path_rate
    one_rate = 2 / ((n + 1.3) ** 2 + mass)
    many_rate = min(1 - one_rate, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    usual = math.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n))
    mean, covariance, step_path, cov_path = start, np.eye(n), np.zeros(n), np.zeros(n)
    best, at, spread = math.inf, start, np.ones(n)
    while math.isinf(best) or (time.monotonic() < deadline and step * spread.max() > _SMALLEST_STEP):
        square, axes = np.linalg.eigh(covariance)
        spread = np.sqrt(np.maximum(square, 1e-20))
        moves = (rng.standard_normal((population, n)) * spread) @ axes.T
        value = objective(mean + step * moves)
        order = np.argsort(value)
        if value[order[0]] < best:
            best, at = float(value[order[0]]), mean + step * moves[order[0]]
        kept = moves[order[:parents]]
        move = weight @ kept
        mean = mean + step * move
        step_path *= 1 - path_rate
        step_path += math.sqrt(path_rate * (2 - path_rate) * mass) * (axes @ ((axes.T @ move) / spread))
        length = float(np.linalg.norm(step_path)) / usual
        steady = length < 1.4 + 2 / (n + 1)
        cov_path = (1 - cov_rate) * cov_path + steady * math.sqrt(cov_rate * (2 - cov_rate) * mass) * move
        covariance = (1 - one_rate - many_rate) * covariance + many_rate * (kept.T * weight) @ kept
        covariance += one_rate * np.outer(cov_path, cov_path)
        step *= math.exp(path_rate / damping * (length - 1))
    return best, at


def values_of(logarithms: np.ndarray) -> dict[str, np.ndarray]:
    """Every parameter as a (B,) array from (len(SEARCHED), B) decimal logarithms of those searched."""
    size = logarithms.shape[1]
    values = {name: np.full(size, value) for name, value in Parameters().as_dict().items()}
    return values | {name: 10.0**row for name, row in zip(SEARCHED, logarithms, strict=True)}


def simulate_responses_of_many(values: dict[str, np.ndarray]) -> Responses:
    """The responses of many sets at once, coarsely: (B,) float values of every field of `Parameters` by name."""
    # Each constant of the walls becomes a column of sets, beside which pressures are rows.
    columns = {name: np.asarray(value)[:, None] for name, value in values.items()}
    given = cast(Parameters, SimpleNamespace(**columns))
    high, low = columns["arterial_pressure_pa"], columns["venous_pressure_pa"]

    def steady(proximal: np.ndarray, distal: np.ndarray, zones: Zones) -> np.ndarray:
        outside = zones.on_walls(np.stack([proximal, distal]))[:, None]
        each = np.broadcast_shapes(high.shape, outside.shape[1:])
        pressures = np.broadcast_to(high, each), np.broadcast_to(low, each)
        return solve_walls(build_walls(given, zones), outside, *pressures, tolerance=1e-9)[0]

    def follow_all(touch: Protocol, zones: Zones) -> np.ndarray:
        none = np.zeros(touch.proximal_pa.shape[0])
        rest = steady(none[:1], none[:1], zones).repeat(none.size, axis=-1)
        outside = zones.on_walls(np.stack([touch.proximal_pa, touch.distal_pa]))[:, None]
        return march(build_walls(given, zones), rest, touch.time_s, outside, high, low)

    return responses_of(steady, follow_all)


def march(
    walls: Walls, start: np.ndarray, time_s: np.ndarray, outside: np.ndarray, high: np.ndarray, low: np.ndarray
) -> np.ndarray:
    """Diameters over time, (N+1, B, S, T) float, in one step from each instant to the next.

    outside : (N+1, 1, S, T) float. Touch pressure on each wall. [Pa]
    """
    path = [start]
    for i, step_s in enumerate(np.diff(time_s)):
        here, change = outside[..., i], outside[..., i + 1] - outside[..., i]
        path.append(step(walls, path[-1], here, high, low, step_s=step_s, outside_change=change))
    return np.stack(path, axis=-1)
