"""How well forces are estimated over touches, and the regressions that a sceptic would estimate them by."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.optimize import least_squares
from scipy.special import expit

from .person import MOST, TABLE, Array, Numbers, require_shapes

# Samples of this force or more are of a touch: at rest an interval from 0 covers by itself. [N]
TOUCH_N = 0.15
# Force is still where it has changed by less than this within a while. [N, s]
STILL_N, SETTLING_S = 0.1, 0.5
# What is said of the touches of a kind.
TOUCH_SCORES = ("rms_n", "relative_error", "coverage_95", "half_width_n")


def is_still(time_s: Array, force_n: Array) -> NDArray[np.bool_]:
    """Whether a force (T,) has hardly changed for a while."""
    known = np.isfinite(force_n)
    before_n = np.interp(time_s - SETTLING_S, time_s[known], force_n[known]) if known.any() else force_n
    return np.abs(force_n - before_n) < STILL_N


def runs(is_within: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Where samples (T,) that are within something begin and end, (n, 2) int."""
    return np.flatnonzero(np.diff(np.r_[False, is_within, False])).reshape(-1, 2)


def rms(error: Array) -> float:
    """Root mean square of the finite values; NaN of none."""
    valid = np.isfinite(error)
    return float(np.sqrt(np.mean(error[valid] ** 2))) if valid.any() else float("nan")


def touches_by_kind(
    force_n: Array,
    estimated_n: Array,
    bounds_n: tuple[Array, Array],
    site: Array,
    still: NDArray[np.bool_],
) -> dict[str, dict[str, float]]:
    """rms error [N] and its part of the rms force, coverage and half width [N] of the interval, by kind of touch.

    force_n, estimated_n : (T,) float. Known and estimated. bounds_n : (T,) float each, of the 95 % interval.
    site : (T,) float. Proximal above 0.5, distal below; NaN is no side's.
    """
    kinds = {"all": np.full(force_n.shape, True)}
    for side, at_side in (("proximal", site > 0.5), ("distal", site < 0.5)):
        kinds |= {f"{side} still": at_side & still, f"{side} moving": at_side & ~still}
    low_n, high_n = bounds_n
    inside, half_n = (low_n <= force_n) & (force_n <= high_n), 0.5 * (high_n - low_n)
    scores, error_n = dict[str, dict[str, float]](), estimated_n - force_n
    for kind, at in kinds.items():
        touched = at & (force_n >= TOUCH_N)
        error, size = rms(error_n[touched]), rms(force_n[touched])
        covered, half = (np.mean(inside[touched]), np.median(half_n[touched])) if touched.any() else (np.nan, np.nan)
        values = error, error / size, float(covered), float(half)
        scores[kind] = dict(zip(TOUCH_SCORES, values, strict=True))
    return scores


# Part of the readings' variance that the principal components hold; readings that hang together have components of
# rounding alone, so small a part of the largest.
COMPONENT_VARIANCE, ROUNDING = 0.999, 1e-13
BASELINES = ("cubic", "components", "sigmoid")


@dataclass(frozen=True, config=TABLE)
class Baseline:
    """Force = intercept_n + coefficients_n . shape(shift + projection @ ln volts over rest), of R readings.

    projection : (k, R) float. shift : (k,) float. coefficients_n : (m,) float, of the shape's m terms. [N]
    """

    shape: Literal["cubic", "linear", "sigmoid"]
    projection: Numbers
    shift: Numbers
    coefficients_n: Numbers
    intercept_n: Annotated[float, Field(ge=-MOST, le=MOST)] = 0.0

    def __post_init__(self) -> None:
        size, readings = (*self.projection.shape, 0, 0)[:2]
        count = 2 if self.shape == "cubic" else size
        terms = len(_terms(self.shape, np.zeros((count, 1))))
        require_shapes(self, projection=(count, readings), shift=(count,), coefficients_n=(terms,))

    def force_n(self, over_rest: Array) -> Array:
        """Force (T,) for readings over those at rest (R, T), NaN where one has a gap; never below 0. [N]"""
        terms = _terms(self.shape, self.shift[:, None] + self.projection @ over_rest)
        return np.maximum(self.intercept_n + self.coefficients_n @ terms, 0.0)


def _terms(shape: str, values: Array) -> Array:
    if shape == "sigmoid":
        return np.asarray(expit(values))
    if shape == "linear":
        return values
    first, second = values
    return np.stack([first**i * second**j for i in range(4) for j in range(4 - i) if i + j])


def train_baselines(over_rest: Array, force_n: Array, is_proximal: NDArray[np.bool_]) -> dict[str, Baseline]:
    """The baselines by name, of readings over those at rest (R, T) and their forces (T,).

    is_proximal : (R,) bool. Readings of the proximal zone.
    """
    zones = np.stack([is_proximal, ~is_proximal]).astype(float)
    zones /= np.maximum(zones.sum(1, keepdims=True), 1.0)
    vectors, sizes, _ = np.linalg.svd(over_rest, full_matrices=False)
    held = np.cumsum(sizes**2) / (sizes**2).sum()
    count = min(int(np.searchsorted(held, COMPONENT_VARIANCE)) + 1, int(np.sum(sizes > ROUNDING * sizes[0])))
    return {
        "cubic": _linear("cubic", np.array([[1.0, 1.0], [1.0, -1.0]]) @ zones, over_rest, force_n),
        "components": _linear("linear", vectors[:, :count].T, over_rest, force_n),
        "sigmoid": _sigmoid(over_rest, force_n),
    }


def _linear(shape: Literal["cubic", "linear"], projection: Array, over_rest: Array, force_n: Array) -> Baseline:
    terms = _terms(shape, projection @ over_rest)
    scale = np.maximum(np.abs(terms).max(1), 1e-300)
    design = np.vstack([np.ones_like(force_n), terms / scale[:, None]]).T
    intercept, *coefficients = np.linalg.lstsq(design, force_n, rcond=ROUNDING)[0]
    return Baseline(shape, projection, np.zeros(len(projection)), np.array(coefficients) / scale, float(intercept))


def _sigmoid(over_rest: Array, force_n: Array) -> Baseline:
    """Each reading's sigmoid, of the largest force, weighted by the inverse of its squared error."""
    top_n, scale = float(force_n.max()), over_rest.std(1) + 1e-12

    def error(pair: Array, reading: Array) -> Array:
        return np.asarray(top_n * expit(pair[0] + pair[1] * reading) - force_n)

    starts = [[least_squares(error, [0.0, s], args=(one,)) for s in (-1.0, 1.0)] for one in over_rest / scale[:, None]]
    fits = [min(both, key=lambda fit: fit.cost) for both in starts]
    weights = 1.0 / np.maximum([fit.cost for fit in fits], 1e-12)
    shift, slope = np.array([fit.x for fit in fits]).T
    return Baseline("sigmoid", np.diag(slope / scale), shift, top_n * weights / weights.sum())
