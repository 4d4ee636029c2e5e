"""Lines from the ratio of ratios to the saturation: the textbook's, a finger's, and those fitted to a curve."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...statistics import jackknife

Array = NDArray[np.float64]

# SpO2 = intercept + slope R, in percent. The first is that of textbooks, the second was measured on fingers against a
# reference, 70 to 98 %, with residuals of 3.2 % rms.
TEXTBOOK = (110.0, -25.0)
MEASURED = (110.9, -33.2)
# Saturations over which lines are fitted, those at which oximeters are tested.
FIT_FROM, FIT_TO, FIT_POINTS = 0.70, 1.00, 31


@dataclass(frozen=True)
class Calibration:
    """SpO2 = intercept + slope R and SpO2 = a + b R + c R^2, in percent, of each photodiode.

    linear, linear_stderr : (photodiodes, 2) float. Intercept and slope.
    quadratic, quadratic_stderr : (photodiodes, 3) float. a, b and c.
    linear_miss, quadratic_miss : (photodiodes,) float. The most by which they miss the curve. [percent]
    """

    linear: Array
    linear_stderr: Array
    quadratic: Array
    quadratic_stderr: Array
    linear_miss: Array
    quadratic_miss: Array


def calibrate_curve(so2: Array, ratio: Array) -> Calibration:
    """Both fits to ratios of ratios, (1 + groups, photodiodes, n) float, at saturations, (n,) float in parts of 1."""
    found: dict[str, Array] = {}
    for name, degree in (("linear", 1), ("quadratic", 2)):
        fits = np.array([[_fit(one, so2, degree) for one in replicate] for replicate in ratio])
        missed = [evaluate(fit, one) - 100 * so2 for fit, one in zip(fits[0], ratio[0], strict=True)]
        found |= {name: fits[0], f"{name}_stderr": jackknife(fits), f"{name}_miss": np.abs(missed).max(1)}
    return Calibration(**found)


def _fit(ratio: Array, so2: Array, degree: int) -> Array:
    if not np.isfinite(ratio).all():
        return np.full(degree + 1, np.nan)
    return np.asarray(np.polynomial.polynomial.polyfit(ratio, 100 * so2, degree), dtype=np.float64)


def evaluate(coefficients: ArrayLike, ratio: ArrayLike) -> Array:
    """SpO2 of a ratio of ratios by a line or a parabola. [percent]"""
    return np.asarray(np.polynomial.polynomial.polyval(np.asarray(ratio, float), np.asarray(coefficients, float)))


def saturation_of(ratio: ArrayLike, so2: Array, curve: Array) -> Array:
    """The saturation at which a curve has a ratio of ratios; beyond its ends it goes on as it ends. [parts of 1]

    so2, curve : (n,) float. Saturations that rise, and ratios there that fall.
    """
    asked = np.asarray(ratio, float)
    inside = np.interp(asked, curve[::-1], so2[::-1])
    first, last = (so2[1] - so2[0]) / (curve[1] - curve[0]), (so2[-1] - so2[-2]) / (curve[-1] - curve[-2])
    inside = np.where(asked > curve[0], so2[0] + first * (asked - curve[0]), inside)
    return np.asarray(np.where(asked < curve[-1], so2[-1] + last * (asked - curve[-1]), inside))
