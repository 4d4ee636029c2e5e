"""Train the ensemble of a subject on its calibration: touches below closure, held out one by one.

Weights, errors and intervals are of touches that the members were not trained on, with the drift of minutes drawn onto
the readings; where the sensor was put on several times, of another time than those. The filter itself was fitted to
all touches.

References: Hoerl, Kennard 1970, Technometrics 12:55 (ridge); Saunders, Gammerman, Vovk 1998, ICML (kernel ridge);
Wolpert 1992, Neural Netw. 5:241, and Breiman 1996, Mach. Learn. 24:49 (stacking by weights that are not negative);
Vovk, Gammerman, Shafer 2005, Algorithmic Learning in a Random World (conformal intervals).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ...scene.importers.sensor_recordings import Recording
from ...scene.protocol import LEVEL_N
from ...statistics import covariance_root
from .body_noise import REST_FORCE_N
from .ensemble import COMPONENTS, HALF_WIDTH_TERMS, Ensemble, Features, by_share, gaussians, half_width_terms, terms_of
from .fit import LEAST_TOUCHES_OF_ALL, averaged, joined
from .interval import ForceEstimate, ForceEstimator
from .kalman import estimate_pressures
from .person import LONGEST_GAP_S, Array
from .scores import TOUCH_N, Baseline, is_still, rms, runs, touches_by_kind, train_baselines
from .subject import Subject

# Samples a second that the filter reads. [Hz]
RATE_HZ = 25.0
# Forces that members are trained on, the protocol's but for overshoot; after a harder touch so long is left out. [N, s]
TOP_N, AFTER_S = 1.05 * LEVEL_N[1], 1.0
# Recordings are read one after the other, with a gap after which filter and memory restart. [s]
APART_S = LONGEST_GAP_S + 1.0
# Copies of the calibration, all but the first with drifts, of each of which one of so many samples is trained on.
COPIES = 4
# Centres of the kernel.
CENTRES = 300
# Ridge penalties that are tried, as parts of a term's variance, and groups of touches that are held out in turn.
PENALTIES, FOLDS = np.array([1e-5, 1e-4, 1e-3, 1e-2]), 5
# Prior standard deviation of a member's weight; errors within a touch count as one.
WEIGHT_SPREAD = 0.5
# Part of samples within intervals, and the quantile of estimates of touches past TOP_N from which they are open.
COVERED, OPEN_FROM = 0.95, 0.05
# How much wider they are for another recording than for another touch of the same, proximal and distal; chosen on
# people of an independent simulator.
ANOTHER_RECORDING = (1.2, 1.0)


@dataclass(frozen=True)
class CalibrationSeries:
    """Recordings of a calibration as the ensemble reads them, one after the other, T samples.

    by_filter : the force by the filter alone. over_rest : (R, T) float. ln volts less those at rest.
    force_n : (T,) float. Known. [N] since_s : (T,) float. From sample to sample. [s]
    block : (T,) int. Number of the touch and the rest before it. fold : (T,) int. Group of touches held out at once.
    site : (T,) float. Where the touch is: 1 proximal, 0 distal, NaN even.
    is_still : (T,) bool. Whether its force stays.
    is_varied : (T,) bool. Whether a sample is of the touches below closure that members are trained on.
    """

    by_filter: ForceEstimate
    over_rest: Array
    force_n: Array
    since_s: Array
    block: NDArray[np.int64]
    fold: NDArray[np.int64]
    site: Array
    is_still: NDArray[np.bool_]
    is_varied: NDArray[np.bool_]

    def at(self, samples: NDArray[np.int64]) -> "CalibrationSeries":
        """Some of the samples."""
        columns = {name: column[..., samples] for name, column in vars(self).items() if name != "by_filter"}
        return CalibrationSeries(ForceEstimate(*(column[..., samples] for column in self.by_filter)), **columns)

    @property
    def is_proximal(self) -> NDArray[np.bool_]:
        """Whether the touch is of the proximal side alone, (n,) bool."""
        return np.asarray(self.site > 0.5)


def calibration_series(subject: Subject, recordings: Sequence[Recording]) -> CalibrationSeries:
    """Recordings of known force and site, read by the subject's filter at RATE_HZ."""
    parts = [averaged(recording, RATE_HZ) for recording in recordings]
    every, first_s = joined(parts), np.cumsum([0.0, *(np.ptp(part.time_s) + APART_S for part in parts)])
    time_s = np.concatenate([start + part.time_s - part.time_s[0] for start, part in zip(first_s, parts, strict=False)])
    since_s, force_n = np.diff(time_s, prepend=0.0), np.asarray(every.force_n)
    estimates = estimate_pressures(subject, time_s, every.volts)
    by_filter, _, over_rest = ForceEstimator(subject).of(estimates, every.volts, since_s)
    touches, is_varied = runs(force_n >= REST_FORCE_N), force_n <= TOP_N
    hard = [span for span in touches if force_n[slice(*span)].max() > TOP_N]
    # A touch that closes the vessels is left out from there on with its recovery, unless others are too few: its slow
    # rise is the only one of the protocol.
    for start, stop in hard if len(touches) - len(hard) >= LEAST_TOUCHES_OF_ALL else ():
        is_varied[start + np.argmax(force_n[start:stop] > TOP_N) : stop + round(AFTER_S * RATE_HZ)] = False
    block = np.searchsorted(touches[:, 1], np.arange(len(force_n)), side="right")
    donning, site = np.repeat(np.arange(len(parts)), [len(part.time_s) for part in parts]), np.asarray(every.site)
    _, counts = np.unique(np.stack([donning, site])[:, touches[:, 0]], axis=1, return_counts=True)
    by_donning = len(parts) > 1 and len(counts) == 2 * len(parts) and min(counts) >= LEAST_TOUCHES_OF_ALL // 2
    return CalibrationSeries(
        by_filter=by_filter,
        over_rest=over_rest,
        force_n=force_n,
        since_s=since_s,
        block=block,
        fold=donning if by_donning else block % FOLDS,
        site=site,
        is_still=is_still(time_s, force_n),
        is_varied=is_varied,
    )


def compared(subject: Subject, series: CalibrationSeries) -> dict[str, Baseline]:
    """The regressions that estimates are compared with, by name."""
    at, (_, by_zone) = series.is_varied, subject.light.slopes(subject.person.blood(np.ones(2)))
    is_proximal = np.abs(by_zone[:, 0]) >= np.abs(by_zone[:, 1])
    return train_baselines(series.over_rest[:, at], series.force_n[at], is_proximal)


def train(subject: Subject, series: CalibrationSeries) -> tuple[Ensemble, dict[str, dict[str, float]]] | None:
    """The ensemble, and how well it estimates held-out touches; None of too few touches."""
    touched = series.is_varied & (series.force_n >= REST_FORCE_N)
    if len(np.unique(series.block[touched])) < LEAST_TOUCHES_OF_ALL:
        return None
    vectors, sizes, _ = np.linalg.svd(series.over_rest[:, touched], full_matrices=False)
    count = min(COMPONENTS, len(sizes))
    components = (vectors[:, :count] / sizes[:count] * np.sqrt(touched.sum())).T
    features = _features_with_drift(subject, series, components)
    varied = np.flatnonzero(series.is_varied)
    chosen = [varied[copy::COPIES] for copy in range(COPIES)]
    samples = series.at(np.concatenate(chosen))
    trained_on = np.concatenate([features[:, copy, of_copy] for copy, of_copy in enumerate(chosen)], axis=1)
    ensemble, held_out_n = _trained(trained_on, samples, components)
    terms = half_width_terms(trained_on, held_out_n, count)
    half_width_n = _conformal_half_width(terms, samples, held_out_n, np.ones(len(held_out_n), bool))
    # From these estimates a touch may be harder than any that members were trained on.
    share = series.by_filter.proximal_share
    estimated_n = ensemble.force_n(features[:, 0], series.by_filter.force_n, share)
    hard, proximal = series.force_n > TOP_N, share > 0.5
    sides = estimated_n[hard & proximal], estimated_n[hard & ~proximal]
    open_above_n = np.array([np.quantile(np.append(side, TOP_N), OPEN_FROM) for side in sides])
    ensemble = replace(ensemble, half_width_n=half_width_n, open_above_n=open_above_n)
    # The interval of a group of touches is that which the others give.
    half_n, side = np.empty_like(held_out_n), np.where(samples.is_proximal, 0, 1)
    for k in np.unique(samples.fold):
        at = samples.fold == k
        width_n = _conformal_half_width(terms, samples, held_out_n, ~at) @ terms[:, at]
        half_n[at] = width_n[side[at], np.arange(at.sum())]
    bounds_n = np.maximum(held_out_n - half_n, 0.0), held_out_n + half_n
    return ensemble, touches_by_kind(samples.force_n, held_out_n, bounds_n, samples.is_proximal, samples.is_still)


def _features_with_drift(subject: Subject, series: CalibrationSeries, components: Array) -> Array:
    """Features (D, COPIES, T) of a calibration; drifts are drawn onto the readings of all copies but 0. Of a drift is
    left what readings at rest, which follow it, leave of it."""
    root, shape = covariance_root(subject.drift_covariance), (-1, COPIES, len(series.since_s))
    draws = np.random.default_rng(0).normal(size=(len(root), *shape[1:]))
    walk = np.einsum("rs,sct->rct", root, np.cumsum(draws * np.sqrt(series.since_s / 60.0), axis=-1))
    walk[:, 0], is_resting = 0.0, series.by_filter.force_n < REST_FORCE_N
    followed = Features(components).over_rest(walk.reshape(-1, shape[-1]), is_resting, series.since_s)
    readings = series.over_rest[:, None] + followed.reshape(shape)
    pressure_n = series.by_filter.pressure_n_per_cm2 * subject.person.side_areas_cm2[:, None]
    pressure_n = np.repeat(pressure_n[:, None], COPIES, axis=1)
    return Features(components).with_memory(readings, pressure_n, series.since_s)


def _trained(features: Array, samples: CalibrationSeries, components: Array) -> tuple[Ensemble, Array]:
    """The ensemble of samples, and its force of every sample when its touch was held out, (n,) float. [N]"""
    force_n, terms = samples.force_n, terms_of(len(components))
    middle, scale = features.mean(1), features.std(1) + 1e-9
    standardised = (features - middle[:, None]) / scale[:, None]
    chosen = np.linspace(0, features.shape[1] - 1, CENTRES).astype(int)
    centres, monomials = np.round(standardised[:, chosen].T, 3), terms.of(features)
    designs = {name: monomials[members] for name, members in terms.members.items()}
    designs["kernel"] = np.concatenate([designs["kernel"], gaussians(standardised, centres)])
    fold, held_out, solved = samples.fold, {"filter": samples.by_filter.force_n}, {}
    for name, design in designs.items():
        predictions = np.empty((len(PENALTIES), len(force_n)))
        for k in np.unique(fold):
            coefficients, intercepts = _ridge(design[:, fold != k], force_n[fold != k])
            predictions[:, fold == k] = coefficients @ design[:, fold == k] + intercepts[:, None]
        best = int(np.argmin(((predictions - force_n) ** 2).mean(1)))
        held_out[name] = predictions[best]
        coefficients, intercepts = _ridge(design, force_n)
        solved[name] = coefficients[best], float(intercepts[best])
    by_member = np.stack(list(held_out.values()))
    # Those of either side, which few touches of it leave at those of both together, and these at the filter alone.
    of_both = _weights(by_member, samples, np.eye(len(by_member))[0])
    sides = (np.flatnonzero(side) for side in (samples.is_proximal, ~samples.is_proximal))
    weights = [_weights(by_member[:, at], samples.at(at), of_both) if at.size else of_both for at in sides]
    shares = dict(zip(held_out, np.transpose(weights), strict=True))
    polynomial_n = np.zeros((2, len(terms.indices)))
    for name, members in terms.members.items():
        polynomial_n[:, members] += np.outer(shares[name], solved[name][0][: members.sum()])
    weighted_n = np.maximum(by_share(np.array(weights) @ by_member, samples.by_filter.proximal_share), 0.0)
    errors_n = {name: rms(series - force_n) for name, series in (held_out | {"ensemble": weighted_n}).items()}
    ensemble = Ensemble(
        components=components,
        least=features.min(1),
        most=features.max(1),
        middle=middle,
        scale=scale,
        intercept_n=np.sum([shares[name] * intercept for name, (_, intercept) in solved.items()], axis=0),
        polynomial_n=polynomial_n,
        centres=centres,
        kernel_n=np.outer(shares["kernel"], solved["kernel"][0][-len(centres) :]),
        top_n=float(force_n.max()),
        half_width_n=np.zeros((2, HALF_WIDTH_TERMS)),
        open_above_n=np.full(2, TOP_N),
        weights=shares,
        errors_n=errors_n,
    )
    return ensemble, weighted_n


def _ridge(design: Array, force_n: Array) -> tuple[Array, Array]:
    """Coefficients (P, n) and intercepts (P,) of a ridge regression on standardised terms (n, T), by PENALTIES."""
    middle, scale = design.mean(1), design.std(1) + 1e-12
    terms = (design - middle[:, None]) / scale[:, None]
    sizes, vectors = np.linalg.eigh(terms @ terms.T / len(force_n))
    along = vectors.T @ (terms @ (force_n - force_n.mean())) / len(force_n)
    coefficients = (along / (np.maximum(sizes, 0.0) + PENALTIES[:, None])) @ vectors.T / scale
    return coefficients, force_n.mean() - coefficients @ middle


def _weights(held_out: Array, samples: CalibrationSeries, few: Array) -> Array:
    """Weights (M,) of members (M, n), of which few touches leave `few` (M,); none is negative."""
    force_n, touches = samples.force_n, len(np.unique(samples.block))
    scale = np.sqrt(touches / len(force_n) / ((held_out - force_n) ** 2).mean(1).min())
    design = np.concatenate([scale * held_out.T, np.eye(len(held_out)) / WEIGHT_SPREAD])
    return np.asarray(nnls(design, np.concatenate([scale * force_n, few / WEIGHT_SPREAD]))[0])


def _conformal_half_width(terms: Array, samples: CalibrationSeries, held_out_n: Array, at: NDArray[np.bool_]) -> Array:
    """Coefficients (2, k) of the 95 % interval's half width, from the errors of some samples' held-out touches. [N]"""
    error_n, touched, by_side = np.abs(held_out_n - samples.force_n), at & (samples.force_n >= TOUCH_N), []
    for wider, side in zip(ANOTHER_RECORDING, (samples.is_proximal, ~samples.is_proximal), strict=True):
        # Of a side without touches it is that of all.
        of_side = next(some for some in (touched & side, touched, at) if some.any())
        usual_n = np.maximum(nnls(terms[:, of_side].T, error_n[of_side])[0], 1e-6)
        ratio = error_n[of_side] / (usual_n @ terms[:, of_side])
        by_side.append(wider * usual_n * float(np.quantile(ratio, COVERED)))
    return np.array(by_side)
