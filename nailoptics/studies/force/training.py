"""Train the ensemble of a subject on its calibration: touches below closure, held out one by one.

Weights, errors and intervals are those of touches that the members were not trained on, with the drift of minutes drawn
onto the readings. The filter itself was fitted to all touches.

References: Hoerl, Kennard 1970, Technometrics 12:55 (ridge); Saunders, Gammerman, Vovk 1998, ICML (kernel ridge);
Wolpert 1992, Neural Netw. 5:241, and Breiman 1996, Mach. Learn. 24:49 (stacking by weights that are not negative);
Vovk, Gammerman, Shafer 2005, Algorithmic Learning in a Random World (conformal intervals).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from ...scene.importers.sensor_recordings import Recording
from ...scene.protocol import LEVEL_N
from ...statistics import covariance_root
from .baselines import Baseline, train_baselines
from .body_noise import REST_FORCE_N
from .ensemble import COMPONENTS, HALF_WIDTH_TERMS, Ensemble, Features, gaussians, half_width_terms, terms_of
from .fit import averaged
from .kalman import PressureEstimate, estimate_pressures
from .person import Array
from .scores import TOUCH_N, is_still, touches_by_kind
from .state_space import touch_pressure
from .subject import Subject

# Samples a second that the filter reads, and of which one of so many is a sample of the training. [Hz, 1]
RATE_HZ, STRIDE = 25.0, 4
# Forces that members are trained on, the protocol's but for overshoot; after a harder touch so long is left out. [N, s]
TOP_N, AFTER_S = 1.05 * LEVEL_N[1], 1.0
# Copies of the calibration, all but the first with offsets and drifts: offsets of so many minutes' drift. [1, min]
COPIES, OFFSET_MIN = 8, 1.0
# Centres of the kernel.
CENTRES = 300
# Ridge penalties that are tried, as parts of a term's variance, and groups of touches that are held out in turn.
PENALTIES, FOLDS = np.array([1e-5, 1e-4, 1e-3, 1e-2]), 5
# Fewer touches teach members nothing.
LEAST_TOUCHES = 8
# Prior standard deviation of a member's weight, about the filter alone; errors within a touch count as one.
WEIGHT_SPREAD = 0.5
# Part of samples within intervals, and the quantile of estimates of touches past TOP_N from which they are open.
COVERED, OPEN_FROM = 0.95, 0.05
# How much wider they are for another recording than for another touch of the same; chosen on people of an independent
# simulator.
ANOTHER_RECORDING = 1.2


@dataclass(frozen=True)
class Lesson:
    """What members are trained on, n samples.

    features : (D, n) float. force_n, filter_n : (n,) float. Known, and the filter's. [N]
    share : (n,) float. Proximal share of the filter's force. block : (n,) int. Number of the touch and its rest.
    is_proximal, is_still : (n,) bool. Where the touch is, and whether its force stays.
    """

    features: Array
    force_n: Array
    filter_n: Array
    share: Array
    block: NDArray[np.int64]
    is_proximal: NDArray[np.bool_]
    is_still: NDArray[np.bool_]

    @property
    def fold(self) -> NDArray[np.int64]:
        """Which group of touches a sample is of, (n,) int."""
        return self.block % FOLDS


@dataclass(frozen=True)
class Heard:
    """A recording of the calibration as the ensemble reads it, T samples.

    estimates : the filter's. over_rest : (R, T) float. ln volts less those at rest.
    pressure_n : (2, T) float. Of the filter, times areas. [N]
    filter_n, share : (T,) float. Of the filter. since_s : (T,) float. From sample to sample. [s]
    block : (T,) int. Number of the touch. is_taught : (T,) bool. Whether members are trained on a sample.
    """

    recording: Recording
    estimates: PressureEstimate
    over_rest: Array
    pressure_n: Array
    filter_n: Array
    share: Array
    since_s: Array
    block: NDArray[np.int64]
    is_taught: NDArray[np.bool_]


def hear(subject: Subject, recordings: Sequence[Recording]) -> list[Heard]:
    """Recordings of known force and site as the ensemble reads them."""
    heard: list[Heard] = []
    for recording in recordings:
        heard.append(_hear(subject, averaged(recording, RATE_HZ), heard[-1].block[-1] + 1 if heard else 0))
    return heard


def baselines_of(subject: Subject, heard: Sequence[Heard]) -> dict[str, Baseline]:
    """The regressions that estimates are compared with, by name."""
    taught = [one.is_taught for one in heard]
    over_rest = np.concatenate([one.over_rest[:, at] for one, at in zip(heard, taught, strict=True)], axis=1)
    force_n = np.concatenate([np.asarray(one.recording.force_n)[at] for one, at in zip(heard, taught, strict=True)])
    volts, by_zone = subject.light.slopes(subject.person.blood(np.ones(2)))
    return train_baselines(over_rest, force_n, np.abs(by_zone[:, 0]) >= np.abs(by_zone[:, 1]))


def teach(subject: Subject, heard: Sequence[Heard]) -> tuple[Ensemble, dict[str, dict[str, float]]] | None:
    """The ensemble that recordings teach, and how well it estimates held-out touches; None of too few touches."""
    low = np.concatenate([one.is_taught & (np.asarray(one.recording.force_n) >= REST_FORCE_N) for one in heard])
    blocks = np.concatenate([one.block for one in heard])
    if len(np.unique(blocks[low])) < LEAST_TOUCHES:
        return None
    over_rest = np.concatenate([one.over_rest for one in heard], axis=1)[:, low]
    vectors, sizes, _ = np.linalg.svd(over_rest, full_matrices=False)
    count = min(COMPONENTS, len(sizes))
    components = (vectors[:, :count] / sizes[:count] * np.sqrt(over_rest.shape[1])).T
    rng = np.random.default_rng(0)
    parts = [_lesson(subject, one, components, rng) for one in heard]
    columns = (np.concatenate(column, axis=-1) for column in zip(*parts, strict=True))
    lesson = Lesson(*columns)
    ensemble, held_out_n = _trained(lesson, components)
    half_width_n = _conformal_half_width(lesson, held_out_n, count, np.ones(len(held_out_n), bool))
    open_from_n = _open_from(ensemble, heard)
    ensemble = replace(ensemble, half_width_n=half_width_n, open_from_n=open_from_n)
    return ensemble, _held_out_quality(lesson, held_out_n, count)


def _hear(subject: Subject, recording: Recording, first_block: int) -> Heard:
    """A recording as the ensemble reads it."""
    force_n, person = np.asarray(recording.force_n), subject.person
    estimates = estimate_pressures(subject, recording.time_s, recording.volts)
    pressure = touch_pressure(estimates.touch.T)
    filter_n, share = person.force(pressure)
    since_s = np.diff(recording.time_s, prepend=recording.time_s[0])
    features = Features(np.empty(0))
    with np.errstate(invalid="ignore"):
        samples = zip(np.log(recording.volts).T, filter_n < REST_FORCE_N, since_s, strict=True)
    over_rest = np.array([features.over_rest(*sample) for sample in samples]).T
    touched = np.flatnonzero(np.diff(np.r_[False, force_n >= REST_FORCE_N, False])).reshape(-1, 2)
    block = first_block + np.searchsorted(touched[:, 1], np.arange(len(force_n)), side="right")
    is_taught = force_n <= TOP_N
    varied = [span for span in touched if force_n[slice(*span)].max() <= TOP_N]
    # A touch that closes the vessels is left out with its recovery, unless others are too few.
    for start, stop in touched if len(varied) >= LEAST_TOUCHES else ():
        if force_n[start:stop].max() > TOP_N:
            is_taught[start : stop + round(AFTER_S * RATE_HZ)] = False
    areas_cm2 = person.side_areas_cm2[:, None]
    return Heard(recording, estimates, over_rest, pressure * areas_cm2, filter_n, share, since_s, block, is_taught)


def _lesson(subject: Subject, heard: Heard, components: Array, rng: np.random.Generator) -> tuple[NDArray[Any], ...]:
    """The fields of a `Lesson` of one recording: copies of it, one after the other, with drifts drawn onto them."""
    root = covariance_root(subject.drift_covariance)
    draws = rng.normal(size=(2, len(root), COPIES, len(heard.since_s)))
    walk = np.cumsum(draws[0] * np.sqrt(heard.since_s / 60.0), axis=-1) + np.sqrt(OFFSET_MIN) * draws[1, ..., :1]
    walk[:, 0] = 0.0
    drift = np.einsum("rs,sct->trc", root, walk)
    memory = Features(components)
    features = np.array(
        [
            memory.with_memory(sample[:, None] + drawn, np.repeat(pressure_n[:, None], COPIES, axis=1), since_s)
            for sample, drawn, pressure_n, since_s in zip(
                heard.over_rest.T, drift, heard.pressure_n.T, heard.since_s, strict=True
            )
        ]
    )
    taught = np.flatnonzero(heard.is_taught)
    chosen = [taught[copy % STRIDE :: STRIDE] for copy in range(COPIES)]
    every = np.concatenate(chosen)
    force_n, time_s = np.asarray(heard.recording.force_n), heard.recording.time_s
    proximal = np.asarray(heard.recording.site) > 0.5
    columns = force_n, heard.filter_n, heard.share, heard.block, proximal, is_still(time_s, force_n)
    of_copies = np.concatenate([features[at, :, copy] for copy, at in enumerate(chosen)]).T
    return of_copies, *(column[every] for column in columns)


def _trained(lesson: Lesson, components: Array) -> tuple[Ensemble, Array]:
    """The ensemble that a lesson teaches, and its force of every sample when its touch was held out, (n,) float. [N]"""
    features, force_n, terms = lesson.features, lesson.force_n, terms_of(len(components))
    middle, scale = features.mean(1), features.std(1) + 1e-9
    standardised = (features - middle[:, None]) / scale[:, None]
    chosen = np.linspace(0, features.shape[1] - 1, CENTRES).astype(int)
    centres, monomials = np.round(standardised[:, chosen].T, 3), terms.of(features)
    designs = {name: monomials[members] for name, members in terms.members.items()}
    designs["kernel"] = np.concatenate([designs["kernel"], gaussians(standardised, centres)])
    fold, held_out, solved = lesson.fold, {"filter": lesson.filter_n}, {}
    for name, design in designs.items():
        predictions = np.empty((len(PENALTIES), len(force_n)))
        for k in range(FOLDS):
            coefficients, intercepts = _ridge(design[:, fold != k], force_n[fold != k])
            predictions[:, fold == k] = coefficients @ design[:, fold == k] + intercepts[:, None]
        best = int(np.argmin(((predictions - force_n) ** 2).mean(1)))
        held_out[name] = predictions[best]
        coefficients, intercepts = _ridge(design, force_n)
        solved[name] = coefficients[best], float(intercepts[best])
    weights = _weights(np.stack(list(held_out.values())), lesson)
    share = dict(zip(held_out, weights.tolist(), strict=True))
    polynomial_n = np.zeros(len(terms.indices))
    for name, members in terms.members.items():
        polynomial_n[members] += share[name] * solved[name][0][: members.sum()]
    errors_n = {name: float(np.sqrt(((series - force_n) ** 2).mean())) for name, series in held_out.items()}
    ensemble = Ensemble(
        components=components,
        least=features.min(1),
        most=features.max(1),
        middle=middle,
        scale=scale,
        filter_weight=share["filter"],
        intercept_n=sum(share[name] * intercept for name, (_, intercept) in solved.items()),
        polynomial_n=polynomial_n,
        centres=centres,
        kernel_n=share["kernel"] * solved["kernel"][0][-len(centres) :],
        top_n=float(force_n.max()),
        half_width_n=np.zeros((2, HALF_WIDTH_TERMS)),
        open_from_n=np.full(2, TOP_N),
        weights=share,
        errors_n=errors_n,
    )
    return ensemble, np.maximum(weights @ np.stack(list(held_out.values())), 0.0)


def _ridge(design: Array, force_n: Array) -> tuple[Array, Array]:
    """Coefficients (P, n) and intercepts (P,) of a ridge regression on standardised terms (n, T), by PENALTIES."""
    middle, scale = design.mean(1), design.std(1) + 1e-12
    terms = (design - middle[:, None]) / scale[:, None]
    sizes, vectors = np.linalg.eigh(terms @ terms.T / len(force_n))
    along = vectors.T @ (terms @ (force_n - force_n.mean())) / len(force_n)
    coefficients = (along / (np.maximum(sizes, 0.0) + PENALTIES[:, None])) @ vectors.T / scale
    return coefficients, force_n.mean() - coefficients @ middle


def _weights(held_out: Array, lesson: Lesson) -> Array:
    """Weights (M,) of members (M, n), the filter first, which few touches leave alone; none is negative."""
    force_n, touches = lesson.force_n, len(np.unique(lesson.block))
    scale = np.sqrt(touches / len(force_n) / ((held_out - force_n) ** 2).mean(1).min())
    alone = np.eye(len(held_out))
    design = np.concatenate([scale * held_out.T, alone / WEIGHT_SPREAD])
    return np.asarray(nnls(design, np.concatenate([scale * force_n, alone[0] / WEIGHT_SPREAD]))[0])


def _conformal_half_width(lesson: Lesson, held_out_n: Array, components: int, at: NDArray[np.bool_]) -> Array:
    """Coefficients (2, 3) of the 95 % interval's half width, from the errors of some samples' held-out touches. [N]"""
    error_n, by_side = np.abs(held_out_n - lesson.force_n), []
    terms = half_width_terms(lesson.features, held_out_n, components)
    for side in (lesson.is_proximal, ~lesson.is_proximal):
        of_side = at & side & (lesson.force_n >= TOUCH_N)
        usual_n = np.maximum(nnls(terms[:, of_side].T, error_n[of_side])[0], 1e-6)
        ratio = error_n[of_side] / (usual_n @ terms[:, of_side])
        by_side.append(ANOTHER_RECORDING * usual_n * float(np.quantile(ratio, COVERED)))
    return np.array(by_side)


def _open_from(ensemble: Ensemble, heard: Sequence[Heard]) -> Array:
    """Proximal and distal estimates (2,) from which a touch may be harder than any that members were trained on. [N]"""
    hard_n: tuple[list[Array], list[Array]] = ([], [])
    for one in heard:
        memory = Features(ensemble.components)
        samples = zip(one.over_rest.T, one.pressure_n.T, one.since_s, strict=True)
        estimated_n = ensemble.force_n(np.array([memory.with_memory(*sample) for sample in samples]).T, one.filter_n)
        hard = np.asarray(one.recording.force_n) > TOP_N
        for side, is_side in enumerate((one.share > 0.5, one.share <= 0.5)):
            hard_n[side].append(estimated_n[hard & is_side])
    return np.array([np.quantile(np.append(np.concatenate(side), TOP_N), OPEN_FROM) for side in hard_n])


def _held_out_quality(lesson: Lesson, held_out_n: Array, components: int) -> dict[str, dict[str, float]]:
    """rms error, coverage and median half width of the 95 % interval over held-out touches, all and by kind. [N, 1, N]

    The interval of a group of touches is that which the others give.
    """
    terms = half_width_terms(lesson.features, held_out_n, components)
    half_n, side = np.empty_like(held_out_n), np.where(lesson.is_proximal, 0, 1)
    for k in range(FOLDS):
        at = lesson.fold == k
        width_n = _conformal_half_width(lesson, held_out_n, components, ~at) @ terms[:, at]
        half_n[at] = width_n[side[at], np.arange(at.sum())]
    bounds_n = np.maximum(held_out_n - half_n, 0.0), held_out_n + half_n
    return touches_by_kind(lesson.force_n, held_out_n, bounds_n, lesson.is_proximal, lesson.is_still)
