"""Force with its 95 % interval from the filter's estimates of pressures.

The interval is of the filter, the calibration's uncertainty and the ensemble; it has no upper bound where the vessels
are closed.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr, ndtri

from ...statistics import covariance_root
from .body_noise import REST_FORCE_N
from .ensemble import Features, by_share
from .kalman import PressureEstimate, rest_odds, touch_pressure
from .person import NAMES, SIDES, Array, Person
from .subject import Subject

# Held touches of either side at which the error is computed, as fractions of closure.
PARTS = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
# Steps of derivatives: of the factors' logarithms, and of pressures in N/cm^2.
STEP_LN, STEP_N_PER_CM2 = 0.05, 0.02
# Prior of a pressure, where readings hardly depend on it. [N/cm^2]
PRESSURE_PRIOR_N_PER_CM2 = 0.5
AREAS = [NAMES.index("contact_area"), NAMES.index("proximal_area")]
# Points that stand for the Gaussian of both pressures: quantiles to some 2 % of a spread.
POINTS = 256
QUANTILES = (0.025, 0.975)
# Weights of the sorted points that give these, (POINTS, 2): np.quantile takes ten times as long.
QUANTILE_WEIGHTS = np.maximum(1.0 - np.abs(np.arange(POINTS)[:, None] - np.multiply(QUANTILES, POINTS - 1)), 0.0)
# Below this force, where pressures bend to 0, there may be no touch at all, and it has no place. [N]
LEAST_FORCE_N = 0.03
# Factor on the standard errors of filter and calibration, both of which count some of the model's error: chosen on the
# virtual people, of whose touches the 95 % intervals otherwise cover 97 to 100 %.
INTERVAL_SCALE = 0.82
# Shares of a touch of both sides, and the least error of a share. [1]
BOTH_SHARES, LEAST_SHARE_ERROR = (0.2, 0.8), 0.05


class ForceEstimate(NamedTuple):
    """Force of T samples, with 95 % bounds.

    force_n, force_low_n, force_high_n : (T,) float; the last is infinite where the vessels are closed. [N]
    proximal_share, with its bounds : (T,) float. Part of it, the mean; bounds are 0 and 1 where it is not known.
    probability_proximal, _distal, _both : (T,) float. That the touch is of that side, or of both; a third where there
        may be none, else NaN without an ensemble.
    pressure_n_per_cm2, pressure_stderr_n_per_cm2 : (2, T) float. Proximal and distal. [N/cm^2]
    """

    force_n: Array
    force_low_n: Array
    force_high_n: Array
    proximal_share: Array
    proximal_share_low: Array
    proximal_share_high: Array
    probability_proximal: Array
    probability_distal: Array
    probability_both: Array
    pressure_n_per_cm2: Array
    pressure_stderr_n_per_cm2: Array

    def where(self, known: Array) -> "ForceEstimate":
        """The estimates, NaN where not known (T,)."""
        return ForceEstimate(*(np.where(known, column, np.nan) for column in self))


SITE_PROBABILITIES = ForceEstimate._fields[6:9]


class ForceInterval:
    """Forces with 95 % intervals of the filter's estimates, for one sample or many."""

    def __init__(self, subject: Subject) -> None:
        from scipy.stats import qmc

        self.subject, self.person = subject, subject.person
        closure_n_per_cm2 = self.person.closure_n_per_cm2()
        self._closed_n_per_cm2 = closure_n_per_cm2[:, None]
        root, rest_v = covariance_root(subject.covariance), subject.rest_v
        # Of readings at rest: white noise and a minute's drift. [V^2]
        noise_v2 = np.outer(rest_v, rest_v) * subject.drift_covariance + np.diag(subject.readings.noise_v**2)
        self._information = np.linalg.inv(noise_v2)
        bends = closure_n_per_cm2[:, None] * PARTS
        roots = self._jacobians((np.eye(2)[..., None] * bends).reshape(2, -1)) @ root
        self._roots = [make_interp_spline(*side, k=1) for side in zip(bends, np.split(roots, 2), strict=True)]
        self._points = ndtri(qmc.Sobol(2, scramble=True, seed=0).random(POINTS)).T
        covariance = self._calibration_covariance(np.diag(closure_n_per_cm2))[0]
        part = np.sqrt(np.einsum("tii->ti", covariance).diagonal()) / closure_n_per_cm2
        # Force of a touch on either side from which its interval may have no upper bound, and its lower bound. [N]
        self.closed_above_n = self.person.side_areas_cm2 * closure_n_per_cm2
        self._least_closing_n = self.closed_above_n * np.exp(-2 * part)

    def estimate(self, estimates: PressureEstimate) -> ForceEstimate:
        """The forces of some samples."""
        touch, by_filter = estimates.touch_n_per_cm2, estimates.covariance * INTERVAL_SCALE**2
        pressure_n_per_cm2 = touch_pressure(touch.T)
        by_calibration, pressure_by_calibration = self._calibration_covariance(pressure_n_per_cm2)
        covariance = by_filter + by_calibration
        cloud = np.einsum("tij,jp->itp", covariance_root(covariance), self._points)
        pressures_n_per_cm2 = touch_pressure(touch.T[:, :, None] + cloud)
        force, share = self.person.force(pressures_n_per_cm2)
        low, high = (np.sort(force) @ QUANTILE_WEIGHTS).T
        share_low, share_high = (np.sort(share) @ QUANTILE_WEIGHTS).T
        middle, _ = self.person.force(pressure_n_per_cm2)
        highest_n_per_cm2 = np.sort(pressures_n_per_cm2) @ QUANTILE_WEIGHTS[:, 1]
        is_closed = highest_n_per_cm2 >= self._closed_n_per_cm2
        # Past closure a harder touch reads the same: neither bound lies above it.
        low = np.minimum(low, np.where(is_closed, self._least_closing_n[:, None], np.inf).min(0))
        # Where rest is no less likely than the quantile, the bound is 0.
        low = np.where((low < LEAST_FORCE_N) | (rest_odds(touch, covariance) > QUANTILES[0]), 0.0, low)
        pressure_variance = np.einsum("tii->it", by_filter + pressure_by_calibration)
        return ForceEstimate(
            force_n=middle,
            force_low_n=np.minimum(low, middle),
            force_high_n=np.where(is_closed.any(0), np.inf, np.maximum(high, middle)),
            proximal_share=share.mean(1),
            proximal_share_low=share_low,
            proximal_share_high=share_high,
            **dict.fromkeys(SITE_PROBABILITIES, np.full_like(middle, np.nan)),
            pressure_n_per_cm2=pressure_n_per_cm2,
            pressure_stderr_n_per_cm2=np.sqrt(np.maximum(pressure_variance, 0.0)),
        )

    def _calibration_covariance(self, pressure_n_per_cm2: Array) -> tuple[Array, Array]:
        """Covariances (T, 2, 2) of forces over the contact's areas, and of the pressures themselves. An error of an
        area is one of the pressure, too, the other way: forces were known."""
        total = np.maximum(pressure_n_per_cm2.sum(0), 1e-9)
        proximal, distal = (root(np.minimum(total, root.t[-1])) for root in self._roots)
        share = (pressure_n_per_cm2[0] / total)[:, None, None]
        root = share * proximal + (1.0 - share) * distal
        known = root @ root.swapaxes(1, 2) * INTERVAL_SCALE**2
        jacobian = np.zeros((total.size, 2, 4))
        jacobian[:, [0, 1], [0, 1]] = 1.0
        jacobian[:, [0, 1], 2], jacobian[:, 0, 3] = pressure_n_per_cm2.T, pressure_n_per_cm2[0]
        return jacobian @ known @ jacobian.swapaxes(1, 2), known[:, :2, :2]

    def _jacobians(self, held_n_per_cm2: Array) -> Array:
        """Derivatives of the estimates of held touches (2, H) by all parameters of the calibration, (H, 4, P + 4 R)
        float. Of both pressures and of the logarithms of the contact's areas. A person who is not quite the calibrated
        one gives other readings; the pressures that explain them best, beside drift and noise, are off by so much."""
        subject, person, held = self.subject, self.subject.scene.person, held_n_per_cm2[..., None]
        count, touches, eye = len(NAMES), held.shape[1], np.eye(2)
        steps = subject.factors_ln[:, None] + STEP_LN * np.hstack([np.eye(count), -np.eye(count)])
        moved, _ = self._risen_v(person(np.tile(steps, touches)), np.repeat(held_n_per_cm2, 2 * count, axis=1))
        higher, lower = np.moveaxis(moved.reshape(-1, touches, 2, count), (2, 1), (0, 1))
        around = np.maximum(held + STEP_N_PER_CM2 * np.hstack([eye, -eye, 0.0 * eye])[:, None, :5], 0.0)
        near, steeper = self._risen_v(subject.person, around.reshape(2, -1))
        near, steeper = near.reshape(-1, touches, 5).swapaxes(0, 1), steeper.reshape(2, -1, touches, 5)[..., 4]
        slopes = (near[..., :2] - near[..., 2:4]) / np.einsum("iti->ti", around[..., :2] - around[..., 2:4])[:, None]
        by_gain = near[..., 4] / subject.readings.gain
        diagonal = [part[..., None] * np.eye(near.shape[1]) for part in (by_gain, 0 * by_gain, *steeper.swapaxes(1, 2))]
        by_parameter = np.concatenate([(higher - lower) / (2 * STEP_LN), *diagonal], axis=2)
        weighted = slopes.swapaxes(1, 2) @ self._information
        precision = weighted @ slopes + eye / PRESSURE_PRIOR_N_PER_CM2**2
        by_touch = -np.linalg.solve(precision, weighted @ by_parameter)
        return np.hstack([by_touch, np.broadcast_to(np.eye(by_parameter.shape[2])[AREAS], by_touch.shape)])

    def _risen_v(self, who: Person, pressure_n_per_cm2: Array) -> tuple[Array, Array]:
        """Volts of every reading over those at rest, (R, S), of one or many people under held pressures (2, S). And
        what steeper slopes by the blood of either zone add to them, (2, R, S)."""
        diameter, light = who.steady_diameters(pressure_n_per_cm2), self.subject.light
        blood, rest = who.blood(diameter), who.blood(np.ones_like(diameter))
        volts = light.volts(blood)
        risen = self.subject.readings.gain[:, None] * (volts - light.volts(rest))
        return risen, (volts.T - light.dark_v).T * (blood - rest)[:, None]


def _site_probabilities(share: Array, error: Array) -> Array:
    """Probabilities (3, T) that a touch with an estimated proximal share (T,) is of the proximal side, the distal one,
    or both.

    All force of a touch of one side is there; that of both has any of BOTH_SHARES. None is more likely before.

    error : (2,) float. Of the share of the calibration's proximal and distal touches, rms.
    """
    of_side = np.maximum(error, LEAST_SHARE_ERROR)[:, None]
    of_both, (low, high) = np.sqrt((of_side**2).mean(0)), BOTH_SHARES
    one = np.exp(-0.5 * ((share - [[1.0], [0.0]]) / of_side) ** 2) / (np.sqrt(2.0 * np.pi) * of_side)
    both = (ndtr((high - share) / of_both) - ndtr((low - share) / of_both)) / (high - low)
    density = np.stack([*one, both])
    return np.asarray(density / density.sum(0))


class ForceEstimator:
    """A subject's force from the filter's estimates and the readings of samples that come one after another.

    It is the ensemble's where there is one and no reading is missing, else the filter's, and may be 0 where that may.
    Readings over rest, and all memory, begin with the first sample, which is taken for one of an untouched finger.
    """

    def __init__(self, subject: Subject) -> None:
        self._ensemble, self._interval = subject.ensemble, ForceInterval(subject)
        # Force of a touch on either side from which its interval has no upper bound. [N]
        open_above_n = self._ensemble.open_above_n if self._ensemble else self._interval.closed_above_n
        self.open_above_n = dict(zip(SIDES, open_above_n.tolist(), strict=True))
        self._features = Features(self._ensemble.components if self._ensemble else np.empty((0, len(subject.rest_v))))
        self._areas_cm2 = subject.person.side_areas_cm2[:, None]

    def estimate(self, estimates: PressureEstimate, volts: Array, since_s: Array) -> tuple[ForceEstimate, Array, Array]:
        """Force of the next samples (T,), that of the filter alone [N], and ln volts less those at rest, (R, T).

        volts : (R, T) float. since_s : (T,) float. Time from sample to sample. [s]
        """
        by_filter, since_s = self._interval.estimate(estimates), np.where(estimates.informed, since_s, np.inf)
        over_rest = self._features.over_rest(volts, by_filter.force_n < REST_FORCE_N, since_s)
        force = by_filter
        if (ensemble := self._ensemble) is not None:
            features = self._features.with_memory(over_rest, by_filter.pressure_n_per_cm2 * self._areas_cm2, since_s)
            force_n, low_n, high_n, share = ensemble.estimate(features, by_filter.force_n, by_filter.proximal_share)
            low_n = np.where(by_filter.force_low_n > 0.0, low_n, 0.0)
            error = ensemble.share_error
            within = ndtri(QUANTILES[1]) * by_share(error[:, None], share)
            learnt = by_filter._replace(
                force_n=force_n,
                force_low_n=low_n,
                force_high_n=high_n,
                proximal_share=share,
                proximal_share_low=np.maximum(share - within, 0.0),
                proximal_share_high=np.minimum(share + within, 1.0),
                **dict(zip(SITE_PROBABILITIES, _site_probabilities(share, error), strict=True)),
            )
            known = np.isfinite(over_rest).all(0)
            force = ForceEstimate(*(np.where(known, *column) for column in zip(learnt, by_filter, strict=True)))
        # Where there may be no touch, none of the sides is any more likely.
        unknown = dict.fromkeys(SITE_PROBABILITIES, 1.0 / 3.0) | {"proximal_share_low": 0.0, "proximal_share_high": 1.0}
        at_rest = {name: np.where(force.force_low_n <= 0.0, x, getattr(force, name)) for name, x in unknown.items()}
        return force._replace(**at_rest), by_filter.force_n, over_rest
