"""What layouts are ranked by: force, the share of its sides, oxygen, or these by weight, over all fingers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...scene import Placement
from ...sensor.information import (
    OperatingPoint,
    Response,
    fisher_information,
    force_resolution_n,
    over_fingers,
    share_resolution,
)
from .oxygen_rank import OxygenRule

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Objective:
    """What less is better of, from what single photodiodes tell.

    rules : with the weights of worst, mean, share and oxygen.
    points : the touch on each finger.
    oxygen : what SpO2 is judged by, if it counts.
    """

    rules: Placement
    points: Sequence[OperatingPoint]
    oxygen: OxygenRule | None = None

    def columns(self, finger: int, led: int, read: Response) -> Array:
        """What photodiodes get of one LED, (..., c) float: the information, then the relative variance of its pulse."""
        information = fisher_information(read)
        if self.oxygen is None:
            return information
        variance = self.oxygen.relative_variance(finger, led, read)
        return np.concatenate([information, variance[..., None]], -1)

    def together(self, by_led: Sequence[Array]) -> Array:
        """What photodiodes tell by all LEDs' columns, each (fingers, ..., c): adds up over photodiodes."""
        total = np.sum(by_led, axis=0)
        if self.oxygen is not None:
            told = [self.oxygen.told_per_percent2(k, variance) for k, variance in enumerate(total[..., -1])]
            total = np.concatenate([total[..., :-1], np.stack(told)[..., None]], -1)
        return np.asarray(total)

    def score(self, total: Array) -> Array:
        """What layouts are ranked by, of sums over photodiodes (fingers, ..., n) -> (...)."""
        information = self._information(total)
        values: dict[str, Array] = {}
        weights = self.rules.weights
        if self.rules.over_fingers in weights:
            values[self.rules.over_fingers] = self.force_n(information)
        if "share" in weights:
            values["share"] = self.share(information)
        if "oxygen" in weights:
            with np.errstate(divide="ignore"):
                values["oxygen"] = np.max(1 / np.sqrt(total[..., -1]), axis=0)
        return weighted(values, weights)

    def force_of(self, total: Array) -> Array:
        """Force resolution of such sums. [N]"""
        return self.force_n(self._information(total))

    def _information(self, total: Array) -> Array:
        return total if self.oxygen is None else total[..., :-1]

    def force_n(self, information: Array) -> Array:
        """Force resolution over the fingers from sums of information, (fingers, ..., n) -> (...). [N]"""
        each = [force_resolution_n(*both) for both in zip(information, self.points, strict=True)]
        return over_fingers(np.stack(each), self.rules.over_fingers)

    def share(self, information: Array) -> Array:
        """Resolution of the proximal share of the force on the worst finger, likewise."""
        return np.max([share_resolution(*both) for both in zip(information, self.points, strict=True)], axis=0)


def weighted(values: Mapping[str, Array], weights: Mapping[str, float]) -> Array:
    """The mean of several values by weights, of logarithms, as their units differ."""
    if len(weights) == 1:
        return values[next(iter(weights))]
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.sum([weight * np.log(values[name]) for name, weight in weights.items()], axis=0)))
