"""A subject's force, sample by sample: the ensemble's where there is one, else the filter's."""

from typing import NamedTuple

import numpy as np

from .body_noise import REST_FORCE_N
from .ensemble import Features
from .kalman import PressureEstimate
from .person import SIDES, Array
from .subject import Subject
from .uncertainty import ForceEstimate, ForceInterval


class Estimated(NamedTuple):
    """Estimates of T samples.

    force : with its interval. filter_n : (T,) float. The filter's alone. [N]
    over_rest : (R, T) float. ln volts less those at rest.
    """

    force: ForceEstimate
    filter_n: Array
    over_rest: Array


class ForceEstimator:
    """Estimates force from the filter's estimates and the readings of samples that come one after another.

    Readings over rest, and all memory, begin with the first sample, which is taken for one of an untouched finger.
    """

    def __init__(self, subject: Subject) -> None:
        self._ensemble, self._interval = subject.ensemble, ForceInterval(subject)
        # Force of a touch on either side from which its interval has no upper bound. [N]
        open_from_n = self._ensemble.open_from_n if self._ensemble else self._interval.saturated_above_n
        self.open_above_n = dict(zip(SIDES, open_from_n.tolist(), strict=True))
        self._features = Features(self._ensemble.components if self._ensemble else np.empty((0, 0)))
        self._areas_cm2 = subject.person.side_areas_cm2[:, None]

    def of(self, estimates: PressureEstimate, volts: Array, since_s: Array) -> Estimated:
        """The next samples (T,), with volts (R, T) and times from sample to sample (T,) [s]."""
        by_filter = self._interval.of(estimates)
        with np.errstate(invalid="ignore", divide="ignore"):
            over_rest = self._features.over_rest(np.log(volts), by_filter.force_n < REST_FORCE_N, since_s)
        if self._ensemble is None:
            return Estimated(by_filter, by_filter.force_n, over_rest)
        features = self._features.with_memory(over_rest, by_filter.pressure * self._areas_cm2, since_s)
        force_n = self._ensemble.force_n(features, by_filter.force_n)
        low_n, high_n = self._ensemble.interval_n(features, force_n, by_filter.proximal_share)
        force = by_filter._replace(force_n=force_n, force_low_n=low_n, force_high_n=high_n)
        return Estimated(force, by_filter.force_n, over_rest)
