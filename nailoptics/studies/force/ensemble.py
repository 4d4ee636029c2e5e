"""Force from readings and filter by an ensemble of regressions with memory: features, terms, and what a subject holds.

The filter knows the vessels of its model; what another body does is learnt from its calibration (`training`). Every
member is linear in its terms, so that their weighted sum is one polynomial and one sum of Gaussians, on either side.
A gate says which side is touched. Constants were chosen on virtual people of two simulators that share nothing with
this package, of which docs/force.md tells.

Reference: Jacobs, Jordan, Nowlan, Hinton 1991, Neural Comput. 3:79 (mixture of experts with a gate).
"""

import itertools
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from .person import LONGEST_GAP_S, MOST_GAIN, TABLE, Array, Numbers, require_shapes, within
from .scores import TOUCH_N

# Time constants of the exponential means from which departures are features: a press, a pulse, a refill. [s]
LAGS_S = np.array([0.15, 0.5, 1.5, 4.0])
# Readings at rest are the mean of the first seconds at rest, and follow slowly wherever the finger rests later, down to
# a part where the main components are far from it, in their units: touches taken for rest, or drift. [s, s, 1, 1]
FIRST_REST_S, ZERO_S, REST_SPREAD, LEAST_NEARNESS = 6.0, 30.0, 0.6, 0.25
# A reading that is missing for longer leaves the force to the filter. [s]
MISSING_S = 0.25
# Principal components of the readings that are features, the main ones of these, and the two pressures of the filter.
COMPONENTS, MAIN_COMPONENTS, PRESSURES = 4, 2, 2
# Exponent of the kernel for features that lie a standard deviation each apart. [1]
NARROWNESS = 0.2
# An interval depends on a constant, the estimate, how far the filter's force is from it, and how far that has moved
# over this lag, on either side.
HALF_WIDTH_TERMS, MOTION_LAG = 4, 1
# A touch of a proximal share s is of one side alone where |2 s - 1| is this or more. [1]
ONE_SIDED = 0.6
# The estimate follows the filter from where members say this fraction of the largest force they are trained on. [1]
HANDED_OVER = 0.9


class Features:
    """Features of samples that come one after another: components of the readings and pressures, with their departures.

    Readings at rest and all memory begin anew after a gap, as the filter does.
    """

    def __init__(self, components: Array) -> None:
        self.components = components
        self._zero, self._last, self._before, self._rest_s = np.zeros(0), np.zeros(0), np.zeros(0), 0.0

    def over_rest(self, volts: Array, is_resting: NDArray[np.bool_], since_s: Array) -> Array:
        """ln volts of the next samples (R, T) less those at rest; a gap repeats the reading before it, NaN after
        MISSING_S, and before the first reading at rest, but where there was none at all before.

        is_resting : (T,) bool. since_s : (T,) float. Time from sample to sample. [s]
        """
        ln_v, out = np.log(np.where(volts > 0.0, volts, np.nan)), np.empty_like(volts)
        for k, (now, rests, step_s) in enumerate(zip(ln_v.T, is_resting, since_s, strict=True)):
            if not self._zero.size or step_s > LONGEST_GAP_S:
                self._zero = self._last = np.full_like(now, np.nan)
                self._missing_s, self._rest_s, step_s = np.zeros_like(now), 0.0, 0.0
            self._missing_s = np.where(np.isfinite(now), 0.0, self._missing_s + step_s)
            self._last = np.where(np.isfinite(now), now, self._last)
            if rests or np.isnan(self._zero).all():
                self._zero = np.where(np.isfinite(self._zero), self._zero, now)
            if rests:
                self._rest_s += step_s
                first = step_s / self._rest_s if 0.0 < self._rest_s < FIRST_REST_S else 0.0
                off = np.nan_to_num(now - self._zero)
                nearness = np.exp(-0.5 * ((self.components[:MAIN_COMPONENTS] @ off / REST_SPREAD) ** 2).sum())
                self._zero = self._zero + max(first, -np.expm1(-step_s / ZERO_S) * max(nearness, LEAST_NEARNESS)) * off
            out[:, k] = np.where(self._missing_s > MISSING_S, np.nan, self._last - self._zero)
        return out

    def with_memory(self, over_rest: Array, pressure_n: Array, since_s: Array) -> Array:
        """All features (D, *S, T) of the next samples.

        over_rest : (R, *S, T) float. pressure_n : (2, *S, T) float. Of the filter, times the contact's areas. [N]
        since_s : (T,) float. Time from sample to sample. [s]
        """
        now = np.concatenate([np.tensordot(self.components, np.nan_to_num(over_rest), axes=1), pressure_n])
        out = np.concatenate([now[None]] * (1 + len(LAGS_S)))
        for k, step_s in enumerate(since_s):
            if not self._before.size or step_s > LONGEST_GAP_S:
                self._before, step_s = np.zeros((1 + len(LAGS_S), *now.shape[:-1])), 0.0
            # What is linear between samples departs alike at any rate.
            over = (max(step_s, 1e-9) / LAGS_S).reshape(-1, *[1] * (now.ndim - 1))
            rise, keep = now[..., k] - self._before[0], np.exp(-over)
            out[1:, ..., k] = keep * self._before[1:] + (1.0 - keep) / over * rise
            self._before = out[..., k]
        return out.reshape(-1, *now.shape[1:])


class Terms(NamedTuple):
    """Indices of the features that each monomial multiplies, and which monomials a member has.

    indices : (n, 3) int; past the last feature stands a 1. members : n bool each.
    """

    indices: NDArray[np.int64]
    members: dict[str, NDArray[np.bool_]]

    def monomials(self, features: Array) -> Array:
        """Monomials (n, *S) of features (D, *S)."""
        with_one = np.concatenate([features, np.ones_like(features[:1])])
        return np.asarray(with_one[self.indices].prod(1))


def terms_of(components: int) -> Terms:
    """The monomials of so many components of readings, with the pressures, each with its departures."""
    every = np.arange((1 + len(LAGS_S)) * (components + PRESSURES)).reshape(1 + len(LAGS_S), -1)
    readings, one = every[:, :components].ravel().tolist(), every.size
    products = itertools.combinations_with_replacement(readings, 2)
    cubes = itertools.combinations_with_replacement(range(components), 3)
    indices = np.array([*((i, one, one) for i in range(one)), *((*pair, one) for pair in products), *cubes])
    of_readings, of_now = (np.isin(indices, [*features, one]).all(1) for features in (readings, range(components)))
    members = {"quadratic": of_readings & (indices[:, 2] == one), "kernel": indices[:, 1] == one, "cubic": of_now}
    return Terms(indices, members)


@dataclass(frozen=True, config=TABLE)
class Ensemble:
    """Force = weights[filter] * the filter's + intercept + polynomial + kernel, of D features, R readings, M centres,
    each for proximal touches and for distal ones, and a mean of both by the proximal share that the gate estimates.

    components : (K, R) float. Of ln volts over those at rest; with standard deviation 1 over the calibration's touches.
    least, most : (D,) float. Range of the features in the calibration; beyond they count as its ends.
    middle, scale : (D,) float. By which features are standardised for the kernel.
    intercept_n, polynomial_n : (2,) and (2, n) float, by `terms_of`. [N] centres : (M, D) float.
    kernel_n : (2, M) float. [N] gate : (2 + k,) float. Proximal share at 0, by the filter's, and by k quadratic terms.
    share_error : (2,) float. rms, of held-out proximal and distal touches.
    top_n : the largest force that members are trained on. [N]
    half_width_n : (2, 4) float. 95 % interval either way, proximal and distal: constant [N], and by `half_width_terms`.
    open_above_n : (2,) float. Proximal and distal estimate from which intervals have no upper bound. [N]
    weights : (2,) float of every member. errors_n : rms error over held-out touches of each, and of all together. [N]
    """

    components: Numbers
    least: Numbers
    most: Numbers
    middle: Numbers
    scale: Annotated[Numbers, within(1e-12, MOST_GAIN)]
    intercept_n: Numbers
    polynomial_n: Numbers
    centres: Numbers
    kernel_n: Numbers
    gate: Numbers
    share_error: Annotated[Numbers, within(0, 1, np.positive)]
    top_n: Annotated[float, Field(gt=0, le=MOST_GAIN)]
    half_width_n: Annotated[Numbers, within(0, MOST_GAIN, np.positive)]
    open_above_n: Annotated[Numbers, within(0, MOST_GAIN, np.positive)]
    weights: dict[str, Annotated[Numbers, within(0, MOST_GAIN, np.positive)]]
    errors_n: dict[str, float]

    def __post_init__(self) -> None:
        if self.components.ndim != 2 or self.centres.ndim != 2:
            raise ValueError("components and centres must be tables of numbers")
        if "filter" not in self.weights:
            raise ValueError("weights have no filter")
        features, centres = (1 + len(LAGS_S)) * (len(self.components) + PRESSURES), len(self.centres)
        by_side = dict.fromkeys(("intercept_n", "open_above_n", "share_error"), (2,))
        require_shapes(self, **dict.fromkeys(("least", "most", "middle", "scale"), (features,)), **by_side)
        require_shapes(self, polynomial_n=(2, len(self.terms.indices)), half_width_n=(2, HALF_WIDTH_TERMS))
        require_shapes(self, centres=(centres, features), kernel_n=(2, centres))
        require_shapes(self, gate=(2 + self.terms.members["quadratic"].sum(),))

    @cached_property
    def terms(self) -> Terms:
        """Of its polynomial."""
        return terms_of(len(self.components))

    def estimate(self, features: Array, filter_n: Array, filter_share: Array) -> tuple[Array, Array, Array, Array]:
        """Force, its bounds, the upper one infinite where vessels may be closed, [N] and proximal share, (T,) each, of
        features (D, T), the filter's force and its share."""
        inside = np.clip(features, self.least[:, None], self.most[:, None])
        terms = self.terms.monomials(inside)
        by_gate = self.gate[0] + self.gate[1] * filter_share + self.gate[2:] @ terms[self.terms.members["quadratic"]]
        share = np.clip(by_gate, 0.0, 1.0)
        by_side_n = self.intercept_n[:, None] + np.outer(self.weights["filter"], filter_n) + self.polynomial_n @ terms
        standardised = (inside - self.middle[:, None]) / self.scale[:, None]
        by_side_n = by_side_n + self.kernel_n @ gaussians(standardised, self.centres)
        force_n, moved_n = mixed(by_side_n, np.minimum(filter_n, self.top_n), share)
        # Where members say that a touch is past what they know, the filter says how much harder it is.
        past = np.clip(((force_n - moved_n) / self.top_n - HANDED_OVER) / (1.0 - HANDED_OVER), 0.0, 1.0)
        force_n = force_n + past * np.maximum(filter_n - np.maximum(force_n, self.top_n), 0.0)
        terms = half_width_terms(features, force_n, len(self.components))
        # No calibration shows how far off touches of both sides are: half of what the filter moves them by is added.
        half_n = by_share(self.half_width_n @ terms, share) + 0.5 * np.abs(moved_n)
        is_open = force_n >= by_share(self.open_above_n[:, None], share)
        return force_n, np.maximum(force_n - half_n, 0.0), np.where(is_open, np.inf, force_n + half_n), share


def by_share(values: Array, share: Array) -> Array:
    """The mean (T,) of what holds for proximal and for distal touches (2, T), by the proximal share (T,)."""
    return np.asarray(share * values[0] + (1.0 - share) * values[1])


def mixed(by_side_n: Array, filter_n: Array, share: Array) -> tuple[Array, Array]:
    """Force (T,) by that of proximal and of distal touches (2, T), and of both sides up to half by the filter's (T,):
    no calibration has any, and both are but models. And by how much the filter moves it (T,). [N]"""
    members_n = np.maximum(by_share(by_side_n, share), 0.0)
    both = np.maximum(1.0 - np.abs(2.0 * share - 1.0) / ONE_SIDED, 0.0) * np.minimum(members_n / TOUCH_N, 1.0)
    moved_n = 0.5 * both * (filter_n - members_n)
    return members_n + moved_n, moved_n


def gaussians(standardised: Array, centres: Array) -> Array:
    """Gaussians (M, T) of features (D, T) about centres (M, D), narrow by NARROWNESS."""
    square = (centres**2).sum(1)[:, None] + (standardised**2).sum(0) - 2.0 * centres @ standardised
    return np.asarray(np.exp(-NARROWNESS * square / len(standardised)))


def half_width_terms(features: Array, force_n: Array, components: int) -> Array:
    """What the width of intervals (T,) depends on, (4, T): a constant; force, disagreement and motion. [N]"""
    filter_n = features.reshape(1 + len(LAGS_S), -1, features.shape[-1])[:, components:].sum(1)
    return np.stack([np.ones_like(force_n), force_n, np.abs(filter_n[0] - force_n), np.abs(filter_n[1 + MOTION_LAG])])
