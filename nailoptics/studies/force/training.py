"""Train the ensemble of a subject on its calibration: stacked regressions by grouped cross-validation over touches.

Weights, errors and intervals are of touches that the members were not trained on, with the drift of minutes drawn onto
the readings; where the sensor was put on several times, of another time than those. The filter itself was fitted to
all touches.

References: Hoerl, Kennard 1970, Technometrics 12:55 (ridge); Saunders, Gammerman, Vovk 1998, ICML (kernel ridge);
Wolpert 1992, Neural Netw. 5:241, and Breiman 1996, Mach. Learn. 24:49 (stacking by weights that are not negative);
Vovk, Gammerman, Shafer 2005, Algorithmic Learning in a Random World (conformal intervals; the
coverage that they guarantee is of exchangeable samples, which those of one touch are not).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree

from ...scene.importers.sensor_recordings import Recording
from ...scene.protocol import LEVEL_N
from .body_noise import REST_FORCE_N
from .ensemble import COMPONENTS, HALF_WIDTH_TERMS, Ensemble, Features, gaussians, half_width_terms, mixed, terms_of
from .fit import LEAST_TOUCHES_OF_ALL, averaged, joined
from .interval import ForceEstimate, ForceInterval
from .kalman import estimate_pressures
from .person import LONGEST_GAP_S, Array
from .scores import ROUNDING, TOUCH_N, is_still, rms, runs, touches_by_kind
from .subject import Subject

# Samples a second that the filter reads. [Hz]
RATE_HZ = 25.0
# Forces that members are trained on, the protocol's but for overshoot; after a harder touch so long is left out. [N, s]
TOP_N, AFTER_S = 1.05 * LEVEL_N[1], 1.0
# Recordings are read one after the other, with a gap after which filter and memory restart. [s]
APART_S = LONGEST_GAP_S + 1.0
# Touches of both sides are made of those of either whose forces are alike now and so long before. [s]
ALIKE_S = np.array([0.0, 0.15])
# Copies of the calibration, all but the first with drifts, of each of which one of so many samples is trained on.
COPIES = 4
# Centres of the kernel.
CENTRES = 300
# Ridge penalties that are tried, as fractions of a term's variance, and groups of touches that are held out in turn.
PENALTIES, FOLDS = np.array([1e-5, 1e-4, 1e-3, 1e-2]), 5
# Weight of touches over that of rest, and prior spread of half a coefficient's difference between sides over its own.
TOUCH_WEIGHT, SIDE_SPREAD = 3.0, 0.1
# Prior standard deviation of a member's weight; errors within a touch count as one.
WEIGHT_SPREAD = 0.5
# Fraction of samples within intervals, and the quantile of estimates of touches past TOP_N from which they are open.
COVERED, OPEN_FROM = 0.95, 0.05
# How much wider they are for another recording than for another touch of it; chosen on people of another simulator.
ANOTHER_RECORDING = 1.15


@dataclass(frozen=True)
class CalibrationSeries:
    """Recordings of a calibration as the ensemble reads them, one after the other, T samples.

    by_filter : the force by the filter alone. over_rest : (R, T) float. ln volts less those at rest.
    force_n : (T,) float. Known. before_n : (2, T) float. That of ALIKE_S before. [N]
    since_s : (T,) float. From sample to sample. [s]
    block : (T,) int. Number of the touch and the rest before it. fold : (T,) int. Group of touches held out at once.
    site : (T,) float. Where the touch is: 1 proximal, 0 distal, NaN even.
    is_still : (T,) bool. Whether its force stays. is_outlier : (T,) bool. To the filter.
    is_varied : (T,) bool. Whether a sample is of the touches below closure that members are trained on.
    """

    by_filter: ForceEstimate
    over_rest: Array
    force_n: Array
    before_n: Array
    since_s: Array
    block: NDArray[np.int64]
    fold: NDArray[np.int64]
    site: Array
    is_still: NDArray[np.bool_]
    is_outlier: NDArray[np.bool_]
    is_varied: NDArray[np.bool_]

    def select(self, samples: NDArray[np.int64]) -> "CalibrationSeries":
        """Some of the samples."""
        columns = {name: column[..., samples] for name, column in vars(self).items() if name != "by_filter"}
        return CalibrationSeries(ForceEstimate(*(column[..., samples] for column in self.by_filter)), **columns)


def calibration_series(subject: Subject, recordings: Sequence[Recording]) -> CalibrationSeries:
    """Recordings of known force and site, read by the subject's filter at RATE_HZ."""
    parts = [averaged(recording, RATE_HZ) for recording in recordings]
    every, first_s = joined(parts), np.cumsum([0.0, *(np.ptp(part.time_s) + APART_S for part in parts)])
    time_s = np.concatenate([start + part.time_s - part.time_s[0] for start, part in zip(first_s, parts, strict=False)])
    since_s, force_n = np.diff(time_s, prepend=0.0), np.asarray(every.force_n)
    estimates = estimate_pressures(subject, time_s, every.volts)
    by_filter, no_touches = ForceInterval(subject).estimate(estimates), Features(np.empty((0, len(every.volts))))
    over_rest = no_touches.over_rest(every.volts, force_n < REST_FORCE_N, since_s)
    touches, is_varied = runs(force_n >= REST_FORCE_N), (force_n <= TOP_N) & np.isfinite(over_rest).all(0)
    hard = [span for span in touches if force_n[slice(*span)].max() > TOP_N]
    # A touch that closes the vessels is left out from there on with its recovery, unless others are too few: its slow
    # rise is the only one of the protocol.
    for start, stop in hard if len(touches) - len(hard) >= LEAST_TOUCHES_OF_ALL else ():
        after = np.searchsorted(time_s, time_s[stop - 1] + AFTER_S, side="right")
        is_varied[start + np.argmax(force_n[start:stop] > TOP_N) : after] = False
    block = np.searchsorted(touches[:, 1], np.arange(len(force_n)), side="right")
    donning, site = np.repeat(np.arange(len(parts)), [len(part.time_s) for part in parts]), np.asarray(every.site)
    _, counts = np.unique(np.stack([donning, site])[:, touches[:, 0]], axis=1, return_counts=True)
    by_donning = len(parts) > 1 and len(counts) == 2 * len(parts) and min(counts) >= LEAST_TOUCHES_OF_ALL // 2
    return CalibrationSeries(
        by_filter=by_filter,
        over_rest=over_rest,
        force_n=force_n,
        before_n=np.interp(time_s - ALIKE_S[:, None], time_s, force_n),
        since_s=since_s,
        block=block,
        fold=donning if by_donning else block % FOLDS,
        site=site,
        is_still=is_still(time_s, force_n),
        is_outlier=estimates.outlier,
        is_varied=is_varied,
    )


def train(subject: Subject, series: CalibrationSeries) -> tuple[Ensemble, dict[str, dict[str, float]]] | None:
    """The ensemble, and how well it estimates held-out touches; None of too few touches."""
    touched = series.is_varied & (series.force_n >= REST_FORCE_N)
    if len(np.unique(series.block[touched])) < LEAST_TOUCHES_OF_ALL:
        return None
    vectors, sizes, _ = np.linalg.svd(series.over_rest[:, touched], full_matrices=False)
    count = min(COMPONENTS, int((sizes > ROUNDING * sizes[0]).sum()))
    components = (vectors[:, :count] / sizes[:count] * np.sqrt(touched.sum())).T
    features = _features_with_drift(subject, series, components)
    chosen = [np.flatnonzero(series.is_varied)[copy::COPIES] for copy in range(COPIES)]
    samples = series.select(np.concatenate(chosen))
    trained_on = np.concatenate([features[:, copy, of_copy] for copy, of_copy in enumerate(chosen)], axis=1)
    ensemble, held_out_n = _trained(*_with_both_sides(subject, trained_on, samples), components)
    held_out_n = held_out_n[: len(samples.force_n)]
    terms = half_width_terms(trained_on, held_out_n, count)
    half_width_n = _conformal_half_width(terms, samples, held_out_n, np.ones(len(held_out_n), bool))
    # From these estimates a touch may be harder than any that members were trained on.
    by_filter = series.by_filter
    estimated_n, *_, share = ensemble.estimate(features[:, 0], by_filter.force_n, by_filter.proximal_share)
    hard, proximal = series.force_n > TOP_N, share > 0.5
    sides = estimated_n[hard & proximal], estimated_n[hard & ~proximal]
    open_above_n = np.array([np.quantile(np.append(side, TOP_N), OPEN_FROM) for side in sides])
    ensemble = replace(ensemble, half_width_n=half_width_n, open_above_n=open_above_n)
    # The interval of a group of touches is that which the others give.
    half_n, share = np.empty_like(held_out_n), np.stack([samples.site, 1.0 - samples.site])
    for k in np.unique(samples.fold):
        at = samples.fold == k
        width_n = _conformal_half_width(terms, samples, held_out_n, ~at) @ terms[:, at]
        half_n[at] = (np.nan_to_num(share[:, at], nan=0.5) * width_n).sum(0)
    bounds_n = np.maximum(held_out_n - half_n, 0.0), held_out_n + half_n
    return ensemble, touches_by_kind(samples.force_n, held_out_n, bounds_n, samples.site, samples.is_still)


def _features_with_drift(subject: Subject, series: CalibrationSeries, components: Array) -> Array:
    """Features (D, COPIES, T) of a calibration; drifts are drawn onto the readings of all copies but 0, by Cholesky's
    factor, the same whatever rounding does. Of a drift is left what readings at rest, which follow it, leave of it."""
    root = np.linalg.cholesky(subject.drift_covariance + 1e-12 * np.eye(len(series.over_rest)))  # of no drift, too
    draws = np.random.default_rng(0).normal(size=(len(root), COPIES, len(series.since_s)))
    draws *= (np.arange(COPIES) > 0)[:, None]
    walk = np.einsum("rs,sct->rct", root, np.cumsum(draws * np.sqrt(series.since_s / 60.0), axis=-1))
    drifting = np.exp(walk).reshape(-1, walk.shape[-1])
    followed = Features(np.empty((0, len(drifting)))).over_rest(drifting, series.force_n < REST_FORCE_N, series.since_s)
    readings = series.over_rest[:, None] + followed.reshape(walk.shape)
    pressure_n = series.by_filter.pressure_n_per_cm2 * subject.person.side_areas_cm2[:, None]
    return Features(components).with_memory(readings, np.repeat(pressure_n[:, None], COPIES, axis=1), series.since_s)


def _with_both_sides(subject: Subject, features: Array, samples: CalibrationSeries) -> tuple[Array, CalibrationSeries]:
    """Features (D, n) and samples, and after them those of touches of both sides: features of proximal and distal
    samples of alike forces add, as they are linear in changes of ln volts and in pressures."""
    is_touched, pairs = samples.force_n >= REST_FORCE_N, [np.empty((2, 0), int)]
    for fold in np.unique(samples.fold):
        in_fold = is_touched & (samples.fold == fold)
        proximal, distal = (np.flatnonzero(in_fold & (samples.site == site)) for site in (1.0, 0.0))
        if proximal.size and distal.size:
            _, alike = KDTree(samples.before_n[:, distal].T).query(samples.before_n[:, proximal].T)
            pairs.append(np.stack([proximal, distal[alike]]))
    pair, count = np.concatenate(pairs, axis=1), len(samples.force_n)
    both = samples.select(np.append(np.arange(count), pair[0]))  # a copy
    both.force_n[count:], both.site[count:] = samples.force_n[pair].mean(0), np.nan
    pressure_n_per_cm2 = samples.by_filter.pressure_n_per_cm2[:, pair].sum(1)
    both.by_filter.force_n[count:], both.by_filter.proximal_share[count:] = subject.person.force(pressure_n_per_cm2)
    return np.concatenate([features, features[:, pair].sum(1)], axis=1), both


def _trained(features: Array, samples: CalibrationSeries, components: Array) -> tuple[Ensemble, Array]:
    """The ensemble of samples, and its force of every sample when its touch was held out, (n,) float. [N]"""
    force_n, terms = samples.force_n, terms_of(len(components))
    middle, scale = features.mean(1), features.std(1) + 1e-9
    standardised = (features - middle[:, None]) / scale[:, None]
    chosen = np.linspace(0, features.shape[1] - 1, CENTRES).astype(int)
    centres, monomials = np.round(standardised[:, chosen].T, 3), terms.monomials(features)
    designs = {name: monomials[members] for name, members in terms.members.items()}
    designs["kernel"] = np.concatenate([designs["kernel"], gaussians(standardised, centres)])
    # Members are trained beside a gate that, too, has not seen the touch.
    is_touched, fold, by_filter = np.where(force_n >= REST_FORCE_N, 1.0, 0.0), samples.fold, samples.by_filter
    of_gate, site = np.vstack([by_filter.proximal_share, designs["quadratic"]]), np.nan_to_num(samples.site, nan=0.5)
    share, by_term, at_zero = _regress(of_gate, site, is_touched, fold, np.zeros_like(site))
    share, gate = np.clip(share, 0.0, 1.0), np.append(at_zero[0], by_term[0])
    share_error = np.array([rms(share[(force_n >= TOUCH_N) & (samples.site == side)] - side) for side in (1.0, 0.0)])
    weight = 1.0 + (TOUCH_WEIGHT - 1.0) * is_touched
    held_out, by_side = {"filter": by_filter.force_n}, {}
    for name, design in designs.items():
        held_out[name], *by_side[name] = _regress(design, force_n, weight, fold, 2.0 * share - 1.0)
    by_member = np.stack(list(held_out.values()))
    # Those of either side, which few touches of it leave at those of both together, and these at the filter alone. What
    # is made of both sides stands with the distal: without it, quick distal touches of three people err 7 % more.
    of_both = _weights(by_member, samples, np.eye(len(by_member))[0])
    sides = (np.flatnonzero(side) for side in (samples.site == 1.0, samples.site != 1.0))
    weights = [_weights(by_member[:, at], samples.select(at), of_both) if at.size else of_both for at in sides]
    shares = dict(zip(held_out, np.transpose(weights), strict=True))
    polynomial_n = np.zeros((2, len(terms.indices)))
    for name, members in terms.members.items():
        polynomial_n[:, members] += shares[name][:, None] * by_side[name][0][:, : members.sum()]
    weighted_n, _ = mixed(np.array(weights) @ by_member, np.minimum(by_filter.force_n, force_n.max()), share)
    errors_n = {name: rms(series - force_n) for name, series in (held_out | {"ensemble": weighted_n}).items()}
    ensemble = Ensemble(
        components=components,
        least=features.min(1),
        most=features.max(1),
        middle=middle,
        scale=scale,
        intercept_n=np.sum([shares[name] * at_zero for name, (_, at_zero) in by_side.items()], axis=0),
        polynomial_n=polynomial_n,
        centres=centres,
        kernel_n=shares["kernel"][:, None] * by_side["kernel"][0][:, -len(centres) :],
        gate=gate,
        share_error=np.nan_to_num(share_error, nan=1.0),
        top_n=float(force_n.max()),
        half_width_n=np.zeros((2, HALF_WIDTH_TERMS)),
        open_above_n=np.full(2, TOP_N),
        weights=shares,
        errors_n=errors_n,
    )
    return ensemble, weighted_n


def _regress(
    design: Array, target: Array, weight: Array, fold: NDArray[np.int64], side: Array
) -> tuple[Array, Array, Array]:
    """Weighted ridge regression of a target (T,) on terms (n, T): estimates (T,) when their fold was held out, and
    coefficients (2, n) and values at zero (2,) of a side (T,) of 1, proximal, and -1, distal."""
    middle, scale = design.mean(1), design.std(1) + 1e-12
    even, predictions = (design - middle[:, None]) / scale[:, None], np.empty((len(PENALTIES), len(side)))
    terms = np.concatenate([even, SIDE_SPREAD * side * even, side[None]])
    for k in np.unique(fold):
        coefficients, at_zero = _ridge(terms[:, fold != k], target[fold != k], weight[fold != k])
        predictions[:, fold == k] = coefficients @ terms[:, fold == k] + at_zero[:, None]
    best = int(np.argmin((predictions - target) ** 2 @ weight))
    (fitted, at_zero), sides = (of_all[best] for of_all in _ridge(terms, target, weight)), np.array([1.0, -1.0])
    of_both, sided = fitted[:-1].reshape(2, -1)
    coefficients = (of_both + SIDE_SPREAD * np.outer(sides, sided)) / scale
    return predictions[best], coefficients, at_zero + fitted[-1] * sides - coefficients @ middle


def _ridge(terms: Array, target: Array, weight: Array) -> tuple[Array, Array]:
    """Coefficients (P, n) and values at zero (P,) of a ridge regression on terms (n, T), weighted, by PENALTIES."""
    part = weight / weight.sum()
    middle, mean = terms @ part, target @ part
    centred = terms - middle[:, None]
    sizes, vectors = np.linalg.eigh((centred * part) @ centred.T)
    along = vectors.T @ (centred @ (part * (target - mean)))
    coefficients = (along / (np.maximum(sizes, 0.0) + PENALTIES[:, None])) @ vectors.T
    return coefficients, mean - coefficients @ middle


def _weights(held_out: Array, samples: CalibrationSeries, few: Array) -> Array:
    """Weights (M,) of members (M, n), of which few touches leave `few` (M,); none is negative."""
    force_n, touches = samples.force_n, len(np.unique(samples.block))
    scale = np.sqrt(touches / len(force_n) / ((held_out - force_n) ** 2).mean(1).min())
    design = np.concatenate([scale * held_out.T, np.eye(len(held_out)) / WEIGHT_SPREAD])
    return np.asarray(nnls(design, np.concatenate([scale * force_n, few / WEIGHT_SPREAD]))[0])


def _conformal_half_width(terms: Array, samples: CalibrationSeries, held_out_n: Array, at: NDArray[np.bool_]) -> Array:
    """Coefficients (2, k) of the 95 % interval's half width: quantile of errors held out over their usual size. [N]"""
    error_n, touched, by_side = np.abs(held_out_n - samples.force_n), at & (samples.force_n >= TOUCH_N), []
    for side in (samples.site == 1.0, samples.site == 0.0):
        # Of a side without touches it is that of all.
        of_side = next(some for some in (touched & side, touched, at) if some.any())
        usual_n = np.maximum(nnls(terms[:, of_side].T, error_n[of_side])[0], 1e-6)
        ratio = error_n[of_side] / (usual_n @ terms[:, of_side])
        by_side.append(ANOTHER_RECORDING * usual_n * float(np.quantile(ratio, COVERED)))
    return np.array(by_side)
