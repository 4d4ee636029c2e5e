"""How well forces are estimated over touches, by side and by whether the force changes."""

import numpy as np
from numpy.typing import NDArray

from .person import Array

# Samples of this force or more are of a touch: at rest an interval from 0 covers by itself. [N]
TOUCH_N = 0.15
# Force is still where it has changed by less than this within a while. [N, s]
STILL_N, SETTLING_S = 0.1, 0.5
# What is said of the touches of a kind.
TOUCH_SCORES = ("rms_n", "relative_error", "coverage_95", "half_width_n")


def is_still(time_s: Array, force_n: Array) -> NDArray[np.bool_]:
    """Whether a force (T,) has hardly changed for a while."""
    return np.abs(force_n - np.interp(time_s - SETTLING_S, time_s, force_n)) < STILL_N


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
    is_proximal: NDArray[np.bool_],
    still: NDArray[np.bool_],
) -> dict[str, dict[str, float]]:
    """rms error [N] and its part of the rms force, coverage and half width [N] of the interval, by kind of touch.

    force_n, estimated_n : (T,) float. Known and estimated. bounds_n : (T,) float each, of the 95 % interval.
    """
    kinds = {"all": np.full(force_n.shape, True)}
    for side, at_side in (("proximal", is_proximal), ("distal", ~is_proximal)):
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
