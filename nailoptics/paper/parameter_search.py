"""Global search for parameter sets near the listed one that meet as many claims at once as possible."""

import dataclasses
import logging
import math
import time

import numpy as np

from ..errors import InputError
from ..hemodynamics.parameters import Parameters, bounds
from .claims import RULES
from .responses import Responses, simulate_responses_of_many

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
_MARGIN = 0.03
# Weight of the distance from the list: of sets that meet the same claims, the nearest wins. [1]
_NEAR = 0.1
# The bound by which a miss is divided is no less than this: some bounds are 0. [1]
_LEAST_BOUND = 0.05
# The miss of a claim that cannot be measured: far off. [1]
_UNMEASURED = 10.0
# A static curve jumps if it changes by more than this part of its range in 500 Pa; each part more costs so much. [1]
_JUMP, _JUMP_COST = 0.2, 5.0


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
    """What the search makes small, B float: a half for each claim missed, plus by how much, at most a half each.

    A static curve that jumps (a fold) is no model of a sensor, and adds to it.
    """
    miss = misses(responses, margin=_MARGIN)
    total = (0.5 * (miss > 0.0) + 0.5 * np.minimum(miss, 1.0)).sum(axis=0)
    for curve in (responses.proximal, responses.both):
        jump = np.abs(np.diff(curve, axis=-1)).max(axis=-1) / np.maximum(np.ptp(curve, axis=-1), 1e-30)
        total = total + np.maximum(jump[:2] - _JUMP, 0.0).sum(axis=0) * _JUMP_COST
    return total


def search(*, seed: int, max_seconds: float = 600.0, population: int = 150, factor: float = 10.0) -> Found:
    """The best set that differential evolution finds in a time, each value within a factor of the listed one.

    seed : Of the random numbers. max_seconds : Wall time. population : Sets in each generation.

    Raises: InputError if the time or the population is too small.

    References: Storn and Price 1997, J. Global Optimization 11:341.
    """
    from scipy.optimize import differential_evolution

    if not max_seconds > 0.0:
        raise InputError(f"max_seconds must be greater than 0, got {max_seconds}.")
    if population < 5:
        raise InputError(f"population must be 5 or more, got {population}.")
    limits = bounds(factor=factor)
    ranges = [tuple(np.log10(limits[name])) for name in SEARCHED]
    centre = np.mean(ranges, axis=1)[:, None]
    deadline = time.monotonic() + max_seconds
    tried = 0

    def objective(points: np.ndarray) -> np.ndarray:
        nonlocal tried
        columns = points.reshape(len(SEARCHED), -1)
        tried += columns.shape[1]
        return loss(simulate_responses_of_many(values_of(columns))) + _NEAR * np.mean((columns - centre) ** 2, axis=0)

    result = differential_evolution(
        objective,
        ranges,
        strategy="rand1bin",
        maxiter=100_000,
        popsize=max(1, -(-population // len(SEARCHED))),
        mutation=(0.4, 0.9),
        recombination=0.8,
        tol=0.0,
        seed=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=lambda intermediate_result: time.monotonic() > deadline,
    )
    values = {name: float(f"{10.0**x:.3g}") for name, x in zip(SEARCHED, result.x, strict=True)}
    responses = simulate_responses_of_many(values_of(np.log10(np.array([[values[name]] for name in SEARCHED]))))
    met = int((misses(responses)[:, 0] == 0.0).sum())
    _LOG.info("search with seed %d: %d of %d claims met after %d sets", seed, met, len(RULES), tried)
    return Found(Parameters(**values), met, float(loss(responses)[0]), tried)


def values_of(logarithms: np.ndarray) -> dict[str, np.ndarray]:
    """Every parameter as a (B,) array from (len(SEARCHED), B) decimal logarithms of those searched."""
    size = logarithms.shape[1]
    values = {name: np.full(size, value) for name, value in Parameters().as_dict().items()}
    return values | {name: 10.0**row for name, row in zip(SEARCHED, logarithms, strict=True)}
