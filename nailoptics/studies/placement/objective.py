"""What layouts are ranked by: force, the share of its sides, SpO2, or these by weight, over all fingers; and a layout's
score from traced light, of which there is more where the best is undecided."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...errors import InputError, NotReachedError
from ...hemodynamics.blood import added_saturation
from ...hemodynamics.for_scene import beat_at
from ...light.tracing import StageProgress, StoppingCriterion
from ...scene import FingerCase, Oximeter, Placement, Scene, digest
from ...sensor import information as sensor_information
from ...sensor.front_end import AVERAGE_S, oximeter_leds
from ...statistics import Array, coarsened_replicates, jackknife, quotient, t95
from ..force.touch_error import TouchError
from . import boards
from .candidates import CandidateLayout
from .photon_maps import PhotonMapCache

# Photons per LED and finger of the first round of the evaluation.
JUDGE_PHOTONS = 1 << 18
# Fraction of the time by whose end the evaluation ends; the rest is for the last check.
JUDGE_SHARE = 0.85
# A layout is tied with the best unless it is worse by more than this fraction of the score and so many standard errors
# of the difference; the simplest of those that are worse by less than twice this fraction is proposed.
ALIKE, TIED = 0.02, 2.0
# Fraction of the waves that a filter leaves, rms, where a search is by one sample in place of touches. Of 88 layouts
# beside LEDs at six places orders had a rank correlation of 0.87 with all waves, 0.90 with none, 0.91 with this one.
WAVES_LEFT = 0.05
UNRESOLVED = (
    "no layout resolves what rank_by asks for: readings are dark, without a pulse, or at the converter's limit; "
    'trace more photons, or set electronics.feedback_ohm = "auto"'
)
# Noise of a reading, over itself, that says nothing: a dark photodiode, or one whose converter is at its limit.
UNREADABLE = 1e3
# Layouts that are filtered at once: with more of them covariances leave the processor's cache, and take twice as long.
AT_ONCE = 5
# Change of the saturation over which its part in the logarithm of R is taken.
STEP = 0.005


# What a layout reads, by finger and LED, each (1 + blocks, photodiodes).
ByFinger = Sequence[Sequence[sensor_information.Response]]


@dataclass(frozen=True)
class Spo2Objective:
    """What a layout's SpO2 is evaluated by, finger by finger.

    leds : numbers of the red and the infrared LED.
    pulse : (fingers, led, zones) float. What a beat adds to the blood of each zone, as blood of the slopes' saturation.
    shape_rms : (fingers,) float. rms of a beat's waveform over its height.
    log_ratio_per_percent : change of ln R with the saturation.
    frames : readings of each LED that are averaged.
    """

    leds: tuple[int, int]
    pulse: Array
    shape_rms: Array
    log_ratio_per_percent: float
    frames: float

    def relative_variance(self, finger: int, led: int, read: sensor_information.Response) -> Array:
        """Variance of the height of an LED's pulse in one reading over its square; 0 of LEDs that measure no oxygen.

        It is infinite where the converter is at its limit.
        """
        if led not in self.leds:
            return np.zeros(np.shape(read.amplified_v))
        # In volts over noise: the light itself cancels.
        pulsating = (read.zone_v @ self.pulse[finger, self.leds.index(led)]) ** 2 * read.unsaturated
        return quotient(read.noise_v2, pulsating)


def spo2_objective(base: Scene, cases: Sequence[FingerCase | boards.PersonCase], force_n: float) -> Spo2Objective:
    """The rule for a scene's fingers, under the force at which layouts are evaluated.

    Raises: InputError for a scene without a pulse or without two LEDs of different wavelengths.
    """
    leds = oximeter_leds(base)
    pulse, shape, blood = [], [], base.blood
    wavelength = np.array([base.leds[i].wavelength_nm for i in leds])
    arterial = tissue.blood_mu_a_per_mm(wavelength, blood.so2)[:, None]
    for case in cases:
        beat = beat_at(boards.worn_on(base, case), force_n)
        least, most = beat.extremes
        # What pulsates is arterial, as the blood of the slopes need not be.
        of_slopes = tissue.blood_mu_a_per_mm(wavelength[:, None], added_saturation(blood, beat.blood_fraction.mean(1)))
        pulse.append(arterial / of_slopes * (most - least))
        shape.append(beat.rms_per_swing)
    ratio = [np.log(np.divide(*tissue.blood_mu_a_per_mm(wavelength, so2))) for so2 in (blood.so2 - STEP, blood.so2)]
    return Spo2Objective(
        leds=leds,
        pulse=np.array(pulse),
        shape_rms=np.array(shape),
        log_ratio_per_percent=float(ratio[0] - ratio[1]) / (100 * STEP),
        frames=AVERAGE_S * (base.oximeter or Oximeter()).frame_hz,
    )


@dataclass(frozen=True)
class Objective:
    """The quantity to minimise, from the information of single photodiodes.

    rules : with the weights of worst, mean, share and oxygen, and the number of people.
    points : the touch on each finger; those of people come last.
    oxygen : what SpO2 is evaluated by, if it counts.
    filters : what the force over touches is evaluated by on each finger, if it counts.
    filter_groups : of photons, without each of which it is evaluated; of all blocks that takes as long as the trace.
    waves_left : fraction of the waves that counts for "force" in one sample.
    """

    rules: Placement
    points: Sequence[sensor_information.OperatingPoint]
    oxygen: Spo2Objective | None = None
    filters: Sequence[TouchError] = ()
    filter_groups: int = 8
    waves_left: float = 1.0

    def information_columns(self, finger: int, led: int, read: sensor_information.Response) -> Array:
        """Columns of photodiodes for one LED, (..., c) float: the `fisher_information` [Pa^-2] and, with an oxygen
        objective, the relative variance of the LED's pulse [1].
        """
        information = sensor_information.fisher_information(read)
        if self.oxygen is None:
            return information
        variance = self.oxygen.relative_variance(finger, led, read)
        return np.concatenate([information, variance[..., None]], -1)

    def sum_over_leds(self, by_led: Sequence[Array]) -> Array:
        """Sum over LEDs of `information_columns`, (fingers, ..., c) float each; it adds up over photodiodes. The last
        column, if of oxygen, becomes the information on SpO2. [percent^-2]
        """
        total = np.sum(by_led, axis=0)
        if (oxygen := self.oxygen) is not None:
            # Of a photodiode on SpO2: one over its variance, by the sum of both LEDs' relative variances.
            for sums, shape_rms in zip(total, oxygen.shape_rms, strict=True):
                sums[..., -1] = (oxygen.log_ratio_per_percent * shape_rms) ** 2 * oxygen.frames / sums[..., -1]
        return np.asarray(total)

    def total(self, responses: ByFinger) -> Array:
        """Information of all photodiodes and LEDs, (fingers, ..., n) float, by finger and LED (..., photodiodes)."""
        by_led = [
            np.stack([self.information_columns(finger, led, of_leds[led]) for finger, of_leds in enumerate(responses)])
            for led in range(len(responses[0]))
        ]
        return np.asarray(self.sum_over_leds(by_led).sum(-2))

    def value(self, name: str, total: Array) -> Array:
        """One of what layouts are ranked by over all fingers, of sums over photodiodes (fingers, ..., n) -> (...).

        name : worst, mean, force : force resolution of one sample [N]; share : resolution of the proximal share of the
            force, on the worst finger; oxygen : standard error of SpO2 on the worst finger [percent].
        """
        if name == "oxygen":
            return self.over_fingers(quotient(1.0, np.sqrt(total[..., -1])), name)
        resolution = sensor_information.share_resolution if name == "share" else sensor_information.force_resolution_n
        information = total if self.oxygen is None else total[..., :-1]
        if name == "force" and self.waves_left < 1 and self.points[0].body is not None:
            part = np.ones(math.isqrt(2 * information.shape[-1]))
            part[2:4] = self.waves_left  # the waves' two shapes come after the pressures
            information = information * np.outer(part, part)[np.triu_indices(len(part))]
        resolutions = [resolution(*both) for both in zip(information, self.points, strict=True)]
        return self.over_fingers(np.stack(resolutions), name)

    def over_fingers(self, resolution: Array, name: str | None = None) -> Array:
        """One resolution, as of `value`, for all fingers or people, (fingers, ...) -> (...); name : the force's."""
        rules = self.rules
        people, quantile, over = rules.people, rules.quantile, name or rules.over_fingers
        return sensor_information.over_fingers(resolution, over, people=people, quantile=quantile)

    def score(self, total: Array, over_touches_n: Array | None = None) -> Array:
        """What layouts are ranked by, (fingers, ..., n) -> (...): the weighted geometric mean of the values, or the
        only value in its unit.

        over_touches_n : (...) float. The error of the force over touches; that of one sample if not given, as for the
            search. [N]
        """
        weights, known = self.rules.weights, {} if over_touches_n is None else {"force": over_touches_n}
        values = {name: known[name] if name in known else self.value(name, total) for name in weights}
        if len(weights) == 1:
            return next(iter(values.values()))
        with np.errstate(divide="ignore"):
            logs = [weight * np.log(values[name]) for name, weight in weights.items()]
        return np.asarray(np.exp(np.sum(logs, axis=0)))

    def force_over_touches(self, layouts: Sequence[ByFinger]) -> "Sequence[ForceResolution | None]":
        """Error of the force that a filter estimates over touches, of layouts of equal size; None where unused."""
        if not self.filters:
            return [None] * len(layouts)
        fingers_n = []
        for touches, by_led in zip(self.filters, zip(*layouts, strict=True), strict=True):
            light_v, noise_v, unsaturated, zone_v = (
                np.stack([np.concatenate([getattr(read, name) for read in of_leds], 1) for of_leds in by_led], 1)
                for name in ("light_v", "noise_v", "unsaturated", "zone_v")
            )
            noise = np.nan_to_num(quotient(noise_v, light_v * np.sqrt(unsaturated)), nan=UNREADABLE)
            slopes = np.where(noise[..., None] < UNREADABLE, quotient(zone_v, light_v[..., None]), 0.0)
            led = np.repeat(np.eye(len(by_led[0])), by_led[0][0].amplified_v.shape[-1], axis=0)
            noise = np.minimum(noise, UNREADABLE)
            slopes, noise = (coarsened_replicates(values, self.filter_groups) for values in (slopes, noise))
            fingers_n.append(touches.rms_n(slopes, noise, led))
        floors_n = np.array([one.floor_n for one in self.filters])
        return [ForceResolution(layout_n, floors_n, self) for layout_n in np.stack(fingers_n, 2).swapaxes(0, 1)]


@dataclass(frozen=True)
class ForceResolution:
    """How finely a layout resolves force, by all photons and without each block of them, whatever the force's split.

    fingers_n : (1 + blocks, fingers) float. On each finger. [N]
    floors_n : (fingers,) float. False force by the body, the same with every layout, to which the rest adds in squares;
        it has no error. [N]
    objective : by which all fingers together are the worst of them, their mean or, of people, a quantile.
    """

    fingers_n: Array
    floors_n: Array
    objective: Objective

    @property
    def all_n(self) -> Array:
        """Over the fingers, (1 + blocks,) float. [N]"""
        return self.objective.over_fingers(self.fingers_n.T)

    @property
    def floor_n(self) -> float:
        """The noise floor over the fingers: no layout resolves less; 0 of people, of whom each has another. [N]"""
        return 0.0 if self.objective.rules.people else float(self.objective.over_fingers(self.floors_n))

    @property
    def interval_n(self) -> tuple[float, float]:
        """95 % interval over the fingers, symmetric in the logarithm of what is above the body's own part. [N]"""
        floor_n = self.floor_n
        above = _above(self.all_n, floor_n)
        spread = t95(len(above) - 1) * float(jackknife(np.log(above)))
        low, high = (math.hypot(float(above[0]) * math.exp(min(sign * spread, 700.0)), floor_n) for sign in (-1, 1))
        return low, high


@dataclass(frozen=True)
class LayoutScore:
    """What a layout resolves: by all photons and without each block of them.

    force, electronics : of one sample, through the body's noise, and were the body still.
    over_touches : of a filter, by fewer blocks; None where it does not rank.
    information_per_pa2 : (1 + blocks, fingers, 3) float. Of both pressures, whatever the body does. [Pa^-2]
    responses : by finger and LED, (1 + blocks, photodiodes).
    share : (1 + blocks,) float. Resolution of the proximal share of the force, on the worst finger.
    spo2_percent : (1 + blocks,) float. Standard error of SpO2 over 8 s on the worst finger, by lit readings: what
        `oximeter` has is larger by the dark slot's noise; None where it does not rank. [percent]
    ranked : (1 + blocks,) float. What layouts are ranked by, less is better.
    """

    force: ForceResolution
    electronics: ForceResolution
    over_touches: ForceResolution | None
    information_per_pa2: Array
    responses: ByFinger
    share: Array
    spo2_percent: Array | None
    ranked: Array

    @property
    def relative_error(self) -> float:
        """Relative standard error of what layouts are ranked by."""
        return float(jackknife(np.log(self.ranked)))


def ties(scores: Sequence[LayoutScore]) -> NDArray[np.bool_]:
    """Which layouts are tied with the best: in the difference the noise of light that they share cancels.

    Raises: InputError where none resolves anything.
    """
    logs = np.log([score.ranked for score in scores])
    if not np.isfinite(logs[:, 0]).any():
        raise InputError(f"placement: {UNRESOLVED}.")
    with np.errstate(invalid="ignore"):
        behind = (logs - logs[logs[:, 0].argmin()]).T
        return np.asarray(behind[0] <= ALIKE + TIED * jackknife(behind))


def resolution_stderr_n(resolution_n: Array, noise_floor_n: float | Array = 0.0) -> Array:
    """Standard error of resolutions by all photons and without each block of them, (1 + blocks, ...) float. [N]

    noise_floor_n : what of them is the body's own and has no error. [N]

    It is the error of the logarithm of the rest, to first order. A resolution is the root of an inverse sum of squares,
    to which the photons' noise adds: where it comes out small, so does its error, and only their ratio is the scatter.
    """
    above = _above(resolution_n, noise_floor_n)
    return np.asarray(above[0] ** 2 / resolution_n[0] * jackknife(np.log(above)))


def _above(resolution_n: Array, noise_floor_n: float | Array) -> Array:
    """The part of resolutions that adds in squares to the noise floor; all of them where that is not known. [N]"""
    return np.asarray(np.sqrt(np.maximum(resolution_n**2 - np.nan_to_num(noise_floor_n) ** 2, np.finfo(float).tiny)))


def scores_of(layouts: Sequence[ByFinger], objective: Objective) -> list[LayoutScore]:
    """Scores of layouts from what they read: milliseconds for one, and half as long for each of many."""
    groups = groupby(enumerate(layouts), lambda one: (one[0] // AT_ONCE, one[1][0][0].amplified_v.shape[-1]))
    alike = ([by_finger for _, by_finger in group] for _, group in groups)
    return [one for some in alike for one in map(partial(_score, objective), some, objective.force_over_touches(some))]


def _score(objective: Objective, responses: ByFinger, over_touches: ForceResolution | None) -> LayoutScore:
    """A layout's score from what it reads and its error over touches, if that counts."""
    points = objective.points
    total = objective.total(responses)
    information = total if objective.oxygen is None else total[..., :-1]
    still = [sensor_information.total_information(by_led, electronics_alone=True) for by_led in responses]
    through, alone = (
        np.stack([sensor_information.force_resolution_n(*both) for both in zip(matrix, points, strict=True)], 1)
        for matrix in (information, still)
    )
    floors_n = np.array([sensor_information.physiological_noise_force_n(point) for point in points])
    ranked_total = total
    if over_touches is not None:
        ranked_total = np.stack([coarsened_replicates(of_finger, objective.filter_groups) for of_finger in total])
    ranked = objective.score(ranked_total, None if over_touches is None else over_touches.all_n)
    return LayoutScore(
        force=ForceResolution(through, floors_n, objective),
        electronics=ForceResolution(alone, np.zeros(len(points)), objective),
        information_per_pa2=np.stack([sensor_information.pressure_information(matrix) for matrix in information], 1),
        responses=responses,
        share=objective.value("share", total),
        spo2_percent=None if objective.oxygen is None else objective.value("oxygen", total),
        over_touches=over_touches,
        ranked=np.nan_to_num(ranked, nan=np.inf, posinf=np.inf),
    )


def score_layouts(
    layouts: Sequence[CandidateLayout],
    cache: PhotonMapCache,
    *,
    objective: Objective,
    photons: int | None,
    relative_error: float,
    report_progress: StageProgress,
) -> tuple[list[CandidateLayout], list[LayoutScore], str | None]:
    """Trace until the best is distinguished from all others, more photons where that is undecided.

    cache : records the light on all their photodiodes, too.
    photons : per layout, LED and finger, in place of a tolerance.
    relative_error : of the scores of those tied with the best, at which tracing ends as well.

    Returns: the layouts that were traced on every finger, the simplest of those tied with the best first, the others
    by their scores; these; and why the best was not distinguished, if so.

    Raises: NotReachedError where time ends before one layout is traced.
    """
    count, first = len(layouts), JUDGE_PHOTONS if report_progress.interrupted else photons or JUDGE_PHOTONS
    for layout in layouts:
        cache.traced_board(layout.board).areas.extend(layout.scene.layout.photodiode_areas)
    complete = _extend(layouts, cache, first, report_progress)
    layouts = [layout for layout in layouts if cache.traced_board(layout.board).photons]
    if not layouts:
        raise NotReachedError(f"{report_progress.why} before one layout was traced on every finger; allow more time.")
    criterion = StoppingCriterion(target=relative_error, first=JUDGE_PHOTONS, least=JUDGE_PHOTONS, growth=0.5)
    scored: dict[tuple[int, int], LayoutScore] = {}
    while True:
        # Those whose board was not traced further have the scores that they had.
        known = [(i, cache.traced_board(layout.board).photons) for i, layout in enumerate(layouts)]
        unknown = [key for key in known if key not in scored]
        read = [cache.read(layouts[i].scene, layouts[i].board, len(objective.points)) for i, _ in unknown]
        scored |= zip(unknown, scores_of(read, objective), strict=True)
        scores = [scored[key] for key in known]
        tied = np.flatnonzero(ties(scores))
        worst = max(scores[i].relative_error for i in tied)
        report_progress("evaluate", criterion.share_done(worst) if len(tied) > 1 else 1.0, worst, relative_error)
        if photons or len(tied) == 1 or worst <= relative_error or not complete or report_progress.interrupted:
            break
        undecided = [layouts[i] for i in tied if scores[i].relative_error > relative_error]
        more = criterion.needed(max(cache.traced_board(layout.board).photons for layout in undecided), worst)
        complete = _extend(undecided, cache, more, report_progress)
    close = [i for i in tied if scores[i].ranked[0] <= (1 + 2 * ALIKE) * min(score.ranked[0] for score in scores)]
    simplest = min(close, key=lambda i: (layouts[i].complexity, scores[i].ranked[0]))
    order = sorted(range(len(layouts)), key=lambda i: (i != simplest, scores[i].ranked[0]))
    unmet, best = None, f"{len(tied)} layouts tied" if len(tied) > 1 else "the best"
    if report_progress.interrupted or not complete or len(layouts) < count:
        why = "interrupted:" if report_progress.interrupted else "max_seconds ended with"
        unmet = f"{why} {len(layouts)} of {count} layouts traced, {best} to {worst:.3g} ({relative_error:g} requested)."
    return [layouts[i] for i in order], [scores[i] for i in order], unmet


def _extend(
    layouts: Sequence[CandidateLayout], cache: PhotonMapCache, photons: int, report_progress: StageProgress
) -> bool:
    """Trace the boards of layouts further; False where time ran out before."""
    for board in {digest(layout.board): layout.board for layout in layouts}.values():
        if cache.stop():
            return False
        cache.extend(board, photons)
        report_progress.repeat()
    return True
