"""From what the observer tells of each sample to a force with its interval, open above where the vessels are shut."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from .network import closure_of
from .observer import TOUCHES_REACH, PressureEstimate, pressure_of
from .open_error import OpenError
from .person import force_of
from .subject import Subject

Array = NDArray[np.float64]

# Points that stand for the Gaussian of both pressures: quantiles to some 2 % of a spread.
POINTS = 256
QUANTILES = (0.025, 0.975)
# Below this force, where pressures bend to 0, there may be no touch at all, and it has no place. [N]
LEAST_FORCE_N = 0.03
# Errors are this part of what the filter and the calibration state together, as both count some of what the model
# misses: chosen on the virtual people, of whose touches the 95 % intervals otherwise cover 97 to 100 %.
PART_OF_STATED = 0.82
# An interval of the share as wide as this tells nothing.
UNKNOWN_SHARE = 0.9


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


class ForceInterval:
    """Makes forces of estimates, for one sample or many."""

    def __init__(self, subject: Subject) -> None:
        person = subject.person()
        self.areas_cm2 = float(person.area_cm2) * np.array([float(person.proximal_area), 1.0])
        self.person, self.correction = person, subject.correction
        self.scale = PART_OF_STATED * subject.widening
        closure = closure_of(person)
        self._shut = self.correction.of(np.array([[closure.proximal], [closure.distal]]))
        self._open = OpenError(subject.calibrated, subject.noise)
        self._points = norm.ppf(qmc.Sobol(2, scramble=True, seed=0).random(POINTS)).T
        ends = np.diag([closure.proximal, closure.distal])
        part = np.sqrt(np.einsum("tii->ti", self._left_open(ends)[0]).diagonal()) / ends.diagonal()
        # The least force that shuts the vessels on either side. [N]
        self._least_shut_n = self.areas_cm2 * self._shut[:, 0] * np.exp(-2 * part)

    @property
    def open_above_n(self) -> dict[str, float]:
        """Force of a touch on either side from which its interval may be open above. [N]"""
        return dict(zip(("proximal", "distal"), (self.areas_cm2 * self._shut[:, 0]).tolist(), strict=True))

    def tell(self, estimates: list[PressureEstimate]) -> ForceEstimate:
        """The forces of some samples."""
        touch = np.array([one.touch for one in estimates])
        left_open, open_pressure = self._left_open(pressure_of(touch.T))
        known = np.array([one.covariance for one in estimates]) * self.scale**2
        covariance = known + left_open
        values, vectors = np.linalg.eigh(covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        cloud = np.einsum("tij,jp->itp", root, self._points)
        pressures = self.correction.of(pressure_of(touch.T[:, :, None] + cloud))
        area_cm2, proximal_area = float(self.person.area_cm2), float(self.person.proximal_area)
        force, share = force_of(pressures, area_cm2, proximal_area)
        low, high = np.quantile(force, QUANTILES, axis=1)
        share_low, share_high = np.quantile(share, QUANTILES, axis=1)
        pressure = self.correction.of(pressure_of(touch.T))
        middle, middle_share = force_of(pressure, area_cm2, proximal_area)
        shut = self._shut
        highest = np.quantile(pressures, QUANTILES[1], axis=2)
        is_open = (highest >= shut).any(0)
        # Past closure a harder touch reads the same: neither bound lies above it.
        floor = np.where(highest >= shut, self._least_shut_n[:, None], np.inf).min(0)
        low = np.where(is_open, np.minimum(low, floor), low)
        # Where rest is no less likely than the quantile, nothing is told from none.
        resting = _odds_of_rest(touch, covariance)
        low = np.where((low < LEAST_FORCE_N) | (resting > QUANTILES[0]), 0.0, low)
        nowhere = (middle < LEAST_FORCE_N) | (share_high - share_low > UNKNOWN_SHARE)
        return ForceEstimate(
            force_n=middle,
            low_n=np.minimum(low, middle),
            high_n=np.where(is_open, np.inf, np.maximum(high, middle)),
            share=middle_share,
            share_low=np.where(nowhere, 0.0, share_low),
            share_high=np.where(nowhere, 1.0, share_high),
            pressure=pressure,
            pressure_stderr=np.sqrt(np.maximum(np.einsum("tii->it", known + open_pressure), 0.0)),
        )

    def _left_open(self, pressure: Array) -> tuple[Array, Array]:
        """Covariances (T, 2, 2) of forces over the contact's areas, and of the pressures themselves.

        What calibration leaves open of an area it leaves open of the pressure, too, the other way: forces were known.
        """
        found = self._open.covariance(pressure) * self.scale**2
        by_open = np.zeros((pressure.shape[1], 2, 4))
        by_open[:, [0, 1], [0, 1]] = 1.0
        by_open[:, 0, 2], by_open[:, 0, 3], by_open[:, 1, 2] = pressure[0], pressure[0], pressure[1]
        return by_open @ found @ np.moveaxis(by_open, 1, 2), found[:, :2, :2]


def _odds_of_rest(touch: Array, covariance: Array) -> Array:
    """Odds (T,) of a resting finger over one that touches, for touches (T, 2) known to covariances (T, 2, 2)."""
    far = np.einsum("ti,tij,tj->t", touch, np.linalg.inv(covariance), touch)
    return np.asarray(TOUCHES_REACH**2 * np.exp(-0.5 * far) / (2 * np.pi * np.sqrt(np.linalg.det(covariance))))
