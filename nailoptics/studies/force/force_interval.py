"""From what the observer tells of each sample to a force with its interval, open above where the vessels are shut."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from ...hemodynamics.steady import solve_walls
from .network import touch_on_walls
from .observer import PressureEstimate, pressure_of
from .person import Person, force_of

Array = NDArray[np.float64]

# Points that stand for the Gaussian of both pressures and the contact's area: quantiles to some 2 % of a spread.
POINTS = 256
QUANTILES = (0.025, 0.975)
# A touch past which less than this part of the change by pressure is left cannot be told from a harder one.
LEFT_AT_CLOSURE = 0.05
# Pressures at which closure is looked for. [N/cm^2]
SEARCHED = np.linspace(0.0, 4.0, 401)
# Below this force, where pressures bend to 0, there may be no touch at all, and it has no place. [N]
LEAST_FORCE_N = 0.03
# An interval of the share as wide as this tells nothing.
UNKNOWN_SHARE = 0.9


@dataclass(frozen=True)
class Closure:
    """Pressures past which readings stay as they are: proximal and distal. [N/cm^2]"""

    proximal: float
    distal: float


@dataclass(frozen=True)
class ForceEstimate:
    """Force of T samples.

    force_n, low_n, high_n : (T,) float; high_n is infinite where the interval is open above. [N]
    share, share_low, share_high : (T,) float. Proximal part of it; 0 to 1 where it cannot be told.
    pressure, pressure_stderr : (2, T) float. Proximal and distal. [N/cm^2]
    """

    force_n: Array
    low_n: Array
    high_n: Array
    share: Array
    share_low: Array
    share_high: Array
    pressure: Array
    pressure_stderr: Array


def closure_of(person: Person) -> Closure:
    """Where a proximal and a distal touch have done all but a part of what they can, held for long."""
    ends = []
    for side in range(2):
        pressure = np.zeros((2, SEARCHED.size))
        pressure[side] = SEARCHED
        full = np.full(SEARCHED.size, 1.0)
        rest = solve_walls(person.walls, touch_on_walls(pressure), person.arterial_pa * full, person.venous_pa * full)[
            0
        ]
        blood = rest[side] ** 2
        change = np.abs(blood - blood[0])
        left = change < (1 - LEFT_AT_CLOSURE) * change.max()
        ends.append(float(SEARCHED[min(int(np.flatnonzero(left).max(initial=0)) + 1, SEARCHED.size - 1)]))
    return Closure(*ends)


class ForceInterval:
    """Makes forces of estimates, for one sample or many."""

    def __init__(self, person: Person, *, widening: float) -> None:
        self.area_cm2, self.widening, self.closure = float(person.area_cm2), widening, closure_of(person)
        self._points = norm.ppf(qmc.Sobol(3, scramble=True, seed=0).random(POINTS)).T

    @property
    def open_above_n(self) -> float:
        """Force from which an interval may be open above. [N]"""
        return self.area_cm2 * min(self.closure.proximal, self.closure.distal)

    def tell(self, estimates: list[PressureEstimate]) -> ForceEstimate:
        """The forces of some samples."""
        touch = np.array([one.touch for one in estimates])
        covariance = np.array([one.covariance for one in estimates]) * self.widening**2
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        cloud = np.einsum("tij,jp->itp", root, self._points)
        pressures = pressure_of(touch.T[:, :, None] + cloud[:2])
        force, share = force_of(pressures, 1.0)
        low, high = np.quantile(self.area_cm2 * np.exp(cloud[2]) * force, QUANTILES, axis=1)
        share_low, share_high = np.quantile(share, QUANTILES, axis=1)
        pressure = pressure_of(touch.T)
        middle, middle_share = force_of(pressure, self.area_cm2)
        shut = np.array([[self.closure.proximal], [self.closure.distal]])
        highest = np.quantile(pressures, QUANTILES[1], axis=2)
        is_open = (highest >= shut).any(0)
        # Past closure a harder touch reads the same: neither bound lies above it.
        floor = self.area_cm2 * np.where(highest >= shut, shut, np.inf).min(0)
        low = np.where(is_open, np.minimum(low, floor * np.exp(-2 * np.sqrt(covariance[:, 2, 2]))), low)
        low = np.where(low < LEAST_FORCE_N, 0.0, low)
        nowhere = (middle < LEAST_FORCE_N) | (share_high - share_low > UNKNOWN_SHARE)
        return ForceEstimate(
            force_n=middle,
            low_n=np.minimum(low, middle),
            high_n=np.where(is_open, np.inf, np.maximum(high, middle)),
            share=middle_share,
            share_low=np.where(nowhere, 0.0, share_low),
            share_high=np.where(nowhere, 1.0, share_high),
            pressure=pressure,
            pressure_stderr=np.sqrt(np.maximum(np.einsum("tii->it", covariance)[:2], 0.0)),
        )
