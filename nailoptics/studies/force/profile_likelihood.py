"""How much worse recordings fit as one factor of a person is moved away and all others follow: profile likelihoods."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fit import FARTHEST_SPREADS, Fit
from .person import NAMES, SPREAD_LN

Array = NDArray[np.float64]

# Factors are moved by so many of the spreads that the curvature at the best fit gives them.
OFFSETS = np.array([-3.0, -2.25, -1.5, -0.75, 0.0, 0.75, 1.5, 2.25, 3.0])
# Gauss-Newton steps in which all other factors follow.
ROUNDS = 2
# So many of a reading's values are held in memory at once, of all samples and of everybody who is tried. [about 0.1 GB]
MOST_VALUES = 800_000
# A profile is bent if, where a parabola leaves 95 %, the root of its deviance is off the parabola's by this part.
JUDGED_TO, BENT = 2.25, 0.25


@dataclass(frozen=True)
class Profile:
    """Profile likelihoods of P free factors at N places each.

    names : (P,) str. Of the factors.
    factors_ln : (P, N) float. Logarithms to which each factor was moved, rising.
    deviance : (P, N) float. Squares of the whitened residuals and priors beyond those of the best fit; NaN where the
        factor is at the limit of its search.
    offset : (P, N) float. How far it was moved, in spreads; a parabola's deviance is the square of it.
    """

    names: tuple[str, ...]
    factors_ln: Array
    deviance: Array
    offset: Array

    @property
    def bent(self) -> tuple[str, ...]:
        """Factors whose errors are not those of a parabola."""
        found = []
        for name, deviance, offset in zip(self.names, self.deviance, self.offset, strict=True):
            judged = (np.abs(offset) > 0.1) & (np.abs(offset) <= JUDGED_TO) & np.isfinite(deviance)
            root = np.sqrt(np.maximum(deviance[judged], 0.0))
            if (np.abs(root / np.abs(offset[judged]) - 1.0) > BENT).any():
                found.append(name)
        return tuple(found)


def profile_of(fit: Fit, free_ln: Array, report: Callable[[float], None] = lambda done: None) -> Profile:
    """The profiles about the best fit of some free factors' logarithms (P,); report : told which part is done."""
    own, slopes = fit.residuals(free_ln[:, None])
    least = float((own**2).sum())
    covariance = np.linalg.inv(slopes[:, 0].T @ slopes[:, 0])
    spread = np.sqrt(np.diag(covariance))
    most = (FARTHEST_SPREADS * SPREAD_LN)[fit.free][:, None]
    # A parabola's valley is where the others begin; (P, factor moved, place).
    valley = free_ln[:, None, None] + (covariance / spread)[..., None] * OFFSETS
    start = np.clip(valley, -most[..., None], most[..., None])
    moved = np.arange(len(free_ln))
    places = start[moved, moved]
    each = max(1, MOST_VALUES // (fit.volts.size * OFFSETS.size * (1 + moved.size)))
    parts = [moved[k : k + each] for k in range(0, moved.size, each)]
    found = []
    for number, part in enumerate(parts):
        report(number / len(parts))
        found.append(_least_along(fit, start[:, part], part, most))
    deviances = np.concatenate(found) - least
    deviances[places != valley[moved, moved]] = np.nan
    names = tuple(NAMES[factor] for factor in fit.free)
    return Profile(names, places, deviances, (places - free_ln[:, None]) / spread[:, None])


def _least_along(fit: Fit, start: Array, held: NDArray[np.intp], most: Array) -> Array:
    """The least sums of squares (H, N) with one factor of `held` (H,) at its starts (P, H, N), the others free."""
    (factors, holding, places), moved = start.shape, start.reshape(len(start), -1).copy()
    free = (np.arange(factors)[:, None] != np.repeat(held, places)).astype(float)
    own, slopes = fit.residuals(moved)
    least = (own**2).sum(0)
    for _ in range(ROUNDS):
        # A held factor has no slope, and its equation says that it stays.
        down = np.moveaxis(slopes * free.T, 1, 0)
        normal = np.swapaxes(down, 1, 2) @ down + np.eye(factors) * (1.0 - free.T)[:, None]
        step = np.linalg.solve(normal, np.swapaxes(down, 1, 2) @ own.T[..., None])[..., 0]
        moved = np.clip(moved - step.T, -most, most)
        own, slopes = fit.residuals(moved)
        least = np.minimum(least, (own**2).sum(0))
    return np.asarray(least.reshape(holding, places))
