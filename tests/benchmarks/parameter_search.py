"""Global search for a simulation and its subject, near the listed set, that meet as many rules as possible."""

import dataclasses
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from nailoptics.errors import InputError
from nailoptics.hemodynamics.parameters import OF_BEDS, Parameters, beds, bounds, each_bed
from nailoptics.hemodynamics.rosenbrock import step
from nailoptics.hemodynamics.steady import solve_walls
from nailoptics.hemodynamics.walls import Walls, build_walls
from nailoptics.hemodynamics.zones import Zones
from nailoptics.paper.claims import RULES, SIMULATION, SUBJECT, Rule
from nailoptics.paper.responses import Responses, TouchProtocol, responses_of

_LOG = logging.getLogger(__name__)

# What is varied. The rest changes nothing of its own: lengths and viscosity act as counts do, masses do not matter.
OF_SUBJECT = (
    "capillary_stiffness_n_per_m",
    "vein_stiffness_n_per_m",
    "capillary_damping_n_s_per_m",
    "vein_damping_n_s_per_m",
)
SHARED = (
    *OF_SUBJECT,
    "capillary_area_m2",
    "vein_area_m2",
    "capillary_diameter_m",
    "vein_diameter_m",
    "capillary_count",
    "vein_count",
    "venule_resistance_pa_s_per_m3",
)
DISTAL = tuple(name for name in SHARED if name.startswith(OF_BEDS))
# Coordinates of the search: constants of the proximal bed and the vein, of the distal bed, and both of the subject.
SEARCHED = (*SHARED, *DISTAL, *OF_SUBJECT, *(name for name in OF_SUBJECT if name in DISTAL))
# Beyond the paper: a part of the distal bed's blood lies in venules that close early, as much as Fig. 12 needs.
FIXED: dict[str, Any] = {"venular_share": (0.0, 0.0318), "venular_closing_pressure_pa": 1e3}
# How far inside its bounds a claim has to be: the search measures coarsely, and its result is rounded. [1]
_MARGIN = 0.01
# A miss of this size costs half a claim. Less for more, so that one claim missed by far is better than several missed
# by a little; smooth, so that the search follows every gain. [1]
_HALF_MISS = 0.3
# Weight of the distance from the list: of sets that meet the same claims, the nearest wins. [1]
_NEAR = 0.2
# The bound by which a miss is divided is no less than this: some bounds are 0. [1]
_LEAST_BOUND = 0.05
# The miss of a claim that cannot be measured: far off. [1]
_UNMEASURED = 10.0
# A bed has one balance at any touch if its loop gain stays below 1: what exceeds this costs so much. [1]
_GAIN, _GAIN_COST = 0.98, 5.0
# After a touch this part of the change may be left. [1]
_LEFT = 0.1
# Cost of a value outside its bounds, for each square of a decade. [1]
_OUTSIDE = 10.0
# Instants further apart are walked in two steps: where a zone closes within one, a slow cycle misses some of it. [s]
LONGEST_STEP_S = 0.15
# An evolution ends once its steps are smaller than this. [decades]
_SMALLEST_STEP = 2e-3


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """The best pair of sets of a search. met : rules met of all. loss : the objective. pairs : number tried."""

    simulation: Parameters
    subject: Parameters
    met: int
    loss: float
    pairs: int


def misses(responses: Responses, *, margin: float = 0.0, rules: Sequence[Rule] = RULES) -> np.ndarray:
    """How far each rule is from being met, (rules, *B) float: 0 if met, else relative to its bound. [1]

    margin : How far inside its bounds a measure has to be, relative to them. [1]
    """
    rows = []
    for rule in rules:
        with np.errstate(all="ignore"):
            value = np.asarray(rule.measure(responses), dtype=float)
        miss = np.zeros(value.shape)
        if math.isfinite(rule.low):
            miss = np.maximum(miss, (rule.low - value) / max(abs(rule.low), _LEAST_BOUND) + margin * (rule.low != 0.0))
        if math.isfinite(rule.high):
            miss = np.maximum(
                miss, (value - rule.high) / max(abs(rule.high), _LEAST_BOUND) + margin * (rule.high != 0.0)
            )
        rows.append(np.where(np.isfinite(value), miss, _UNMEASURED))
    return np.array(rows)


def loss(responses: Responses, rules: Sequence[Rule]) -> np.ndarray:
    """What the search makes small, B float: nearly 1 for each rule missed by far, less for one missed by little.

    Vessels that do not come back from a touch are no model of a sensor, and add to it.
    """
    r = responses
    miss = misses(r, margin=_MARGIN, rules=rules)
    total = (miss / (miss + _HALF_MISS)).sum(axis=0)
    steps = ((r.proximal_on, r.proximal_off), (r.both_on, r.both_off)) if rules[0].applies_to == SIMULATION else ()
    for on, off in steps:
        left = np.abs(off[..., -1] - on[..., 0]) / np.maximum(np.abs(on[..., -1] - on[..., 0]), 1e-30)
        total = total + np.maximum(left[:2, ..., -1] - _LEFT, 0.0).sum(axis=0)
    return np.where(np.isfinite(total), total, float(len(rules)))


def largest_loop_gain(values: Mapping[str, Any]) -> np.ndarray:
    """The largest gain of the feedback of R_A on D_C in each bed, (2, B) float, for any touch and node pressure. [1]

    A capillary opened to u = (D+x)/D has the pressure P_H u^4 / (u^4 + B) above the vein node, B = R_A / R_V at u = 1:
    its slope, at most 1.065 P_H / B^(1/4), over the wall's tension k D / A is the gain. Above 1 a bed can be wide or
    narrow under the same touch: two balances, and a jump from one to the other. The vein node adds little.
    """
    gains = []
    for bed in (0, 1):
        v = {name: np.asarray(beds(value)[bed]) for name, value in values.items()}
        tension = v["capillary_stiffness_n_per_m"] * v["capillary_diameter_m"] / v["capillary_area_m2"]
        resistance = 128.0 * v["capillary_length_m"] * v["viscosity_pa_s"] / (math.pi * v["capillary_count"])
        barrier = resistance / v["capillary_diameter_m"] ** 4 / v["venule_resistance_pa_s_per_m3"]
        # The steepest point is u^4 = 3/5 B.
        steepest = 4.0 * 0.6**0.75 / 1.6**2 / barrier**0.25
        gains.append(v["arterial_pressure_pa"] * steepest / tension)
    return np.array(gains)


def rules_of(name: str) -> list[Rule]:
    """The rules that apply to a set."""
    return [rule for rule in RULES if rule.applies_to == name]


def loss_of_pairs(logarithms: np.ndarray) -> np.ndarray:
    """The loss (B,) of pairs of sets, from (len(SEARCHED), B) decimal logarithms."""
    return np.sum(
        [
            loss(simulate_responses_of_many(values, rules_of(name)), rules_of(name))
            + _GAIN_COST * np.maximum(largest_loop_gain(values) - _GAIN, 0.0).sum(axis=0)
            for name, values in zip((SIMULATION, SUBJECT), values_of(logarithms), strict=True)
        ],
        axis=0,
    )


def search(
    *,
    seed: int,
    max_seconds: float = 600.0,
    population: int = 60,
    factor: float = 10.0,
    start: tuple[Parameters, Parameters] | None = None,
    step: float = 0.3,
) -> SearchResult:
    """The best pair of evolutions within a time limit, each value within a factor of the listed one.

    seed : Of the random numbers. max_seconds : Wall time. population : Pairs in each generation, 6 or more.
    start : Where the first evolution starts, simulation and subject; later ones, and without it all, start at the best
        of a random population. step : Standard deviation of the first generation. [decades]

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
        return loss_of_pairs(inside.T) + _OUTSIDE * outside + _NEAR * far

    best, at = math.inf, 0.5 * (low + high)
    first = None if start is None else logarithms_of(*start)
    while math.isinf(best) or time.monotonic() < deadline:
        if first is None:
            scattered = rng.uniform(low, high, (3 * population, len(SEARCHED)))
            first = scattered[np.argmin(objective(scattered))]
        value, point = _evolve(objective, first, rng=rng, population=population, deadline=deadline, step=step)
        if value < best:
            best, at = value, np.clip(point, low, high)
            _LOG.info("search with seed %d: loss %.3f after %d pairs", seed, best, tried)
        first = None
    rounded = np.log10([float(f"{10.0**x:.3g}") for x in at])[:, None]
    met = sum(
        int((misses(simulate_responses_of_many(values), rules=rules_of(name)) == 0.0).sum())
        for name, values in zip((SIMULATION, SUBJECT), values_of(rounded), strict=True)
    )
    _LOG.info("search with seed %d: %d of %d rules met after %d pairs", seed, met, len(RULES), tried)
    return SearchResult(*pair_of(rounded[:, 0]), met, float(loss_of_pairs(rounded)[0]), tried)


def _evolve(
    objective: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    rng: np.random.Generator,
    population: int,
    deadline: float,
    step: float = 0.3,
) -> tuple[float, np.ndarray]:
    """Minimum, and where, by an evolution strategy with an adapted covariance from a start.

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


def values_of(logarithms: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    """The constants of both sets, simulation and subject, each (B,), from (len(SEARCHED), B) decimal logarithms."""
    rows = iter(10.0**logarithms)
    simulation: dict[str, Any] = Parameters(**FIXED).as_dict()
    simulation |= {name: next(rows) for name in SHARED}
    simulation |= {name: (simulation[name], next(rows)) for name in DISTAL}
    subject = simulation | {name: next(rows) for name in OF_SUBJECT}
    return simulation, subject | {name: (subject[name], next(rows)) for name in OF_SUBJECT if name in DISTAL}


def pair_of(logarithms: np.ndarray) -> tuple[Parameters, Parameters]:
    """One pair of sets, from (len(SEARCHED),) decimal logarithms."""

    def single(values: dict[str, Any]) -> Parameters:
        return Parameters(**{name: each_bed(lambda v: float(np.squeeze(v)), one) for name, one in values.items()})

    simulation, subject = values_of(logarithms[:, None])
    return single(simulation), single(subject)


def logarithms_of(simulation: Parameters, subject: Parameters) -> np.ndarray:
    """The inverse of `values_of` for one pair, (len(SEARCHED),)."""
    first, own = simulation.as_dict(), {name: subject.as_dict()[name] for name in OF_SUBJECT}
    rows = [beds(first[name])[0] for name in SHARED] + [beds(first[name])[1] for name in DISTAL]
    rows += [beds(value)[0] for value in own.values()] + [beds(own[name])[1] for name in DISTAL if name in own]
    return np.log10(rows)


def simulate_responses_of_many(values: dict[str, Any], rules: Sequence[Rule] = RULES) -> Responses:
    """The responses of many sets at once, coarsely: (B,) float values of every field of `Parameters` by name.

    rules : The rules that are to be measured; what only others need is left out.
    """
    # Each constant of the walls becomes a column of sets, beside which pressures are rows.
    columns = {
        name: each_bed(lambda value: np.asarray(value, dtype=float)[..., None], one) for name, one in values.items()
    }
    size = max(np.size(one) for value in columns.values() for one in beds(value))
    # Networks side by side have their constants on the axis of sets.
    high, low = (np.broadcast_to(columns[f"{side}_pressure_pa"], (size, 1)) for side in ("arterial", "venous"))

    def steady(touch: np.ndarray, zones: Zones, stiffness: tuple[float, float]) -> Any:
        person = {
            "capillary_stiffness_n_per_m": each_bed(lambda k: k * stiffness[0], columns["capillary_stiffness_n_per_m"]),
            "vein_stiffness_n_per_m": columns["vein_stiffness_n_per_m"] * stiffness[1],
        }
        given = cast(Parameters, SimpleNamespace(**columns | person))
        outside = zones.on_walls(touch)[:, None]
        each = (size, outside.shape[-1])
        pressures = np.broadcast_to(high, each), np.broadcast_to(low, each)
        width, pressure = solve_walls(
            build_walls(given, zones), np.broadcast_to(outside, (len(outside), *each)), *pressures, tolerance=1e-9
        )
        return width, pressure / high

    def follow_all(touch: TouchProtocol, zones: Zones) -> np.ndarray:
        if not any(rule.applies_to == (SIMULATION if zones.count == 2 else SUBJECT) for rule in rules):
            return np.ones((zones.count + 1, size, touch.touch_pa.shape[1], touch.time_s.size))
        rest = steady(np.zeros((2, 1)), zones, (1.0, 1.0))[0].repeat(touch.touch_pa.shape[1], axis=-1)
        outside = zones.on_walls(touch.touch_pa)[:, None]
        given = cast(Parameters, SimpleNamespace(**columns))
        return march(build_walls(given, zones), rest, touch.time_s, outside, high, low)

    return responses_of(steady, follow_all, (values["venular_share"], values["venular_closing_pressure_pa"]))


def march(
    walls: Walls, start: np.ndarray, time_s: np.ndarray, outside: np.ndarray, high: np.ndarray, low: np.ndarray
) -> np.ndarray:
    """Diameters over time, (N+1, B, S, T) float, in one step from each instant to the next, or two where it is far.

    outside : (N+1, 1, S, T) float. Touch pressure on each wall. [Pa]
    """
    path = [start]
    for i, step_s in enumerate(np.diff(time_s)):
        count = 1 if step_s < LONGEST_STEP_S else 2
        width, change = path[-1], (outside[..., i + 1] - outside[..., i]) / count
        for k in range(count):
            here = outside[..., i] + k * change
            width = step(walls, width, here, high, low, step_s=step_s / count, outside_change=change)
        path.append(width)
    return np.stack(path, axis=-1)
