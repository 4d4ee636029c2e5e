"""What layouts are ranked by: force, the share of its sides, SpO2, or these by weight, over all fingers; and a layout's
score from traced light, of which there is more where the best is undecided."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...errors import InputError, NotReachedError
from ...hemodynamics.for_scene import beat_at, oximeter_leds
from ...light.tracing import StageProgress, Trigger
from ...scene import FingerCase, Oximeter, Placement, Scene, digest
from ...scene.oximeter import two_leds
from ...sensor.front_end import AVERAGE_S
from ...sensor.information import (
    OperatingPoint,
    Response,
    fisher_information,
    force_resolution_n,
    over_fingers,
    physiological_noise_force_n,
    pressure_information,
    share_resolution,
    total_information,
)
from ...statistics import jackknife, t95
from . import boards
from .candidates import CandidateLayout
from .photon_maps import PhotonMapCache

Array = NDArray[np.float64]

# Photons per LED and finger of the first round of judging.
JUDGE_PHOTONS = 1 << 18
# Part of the time by whose end the judging ends; the rest is for the last check.
JUDGE_SHARE = 0.85
# Change of the saturation over which its part in the logarithm of R is taken.
STEP = 0.005


@dataclass(frozen=True)
class Spo2Objective:
    """What a layout's SpO2 is judged by, finger by finger.

    leds : numbers of the red and the infrared LED.
    pulse : (fingers, led, zones) float. What a beat adds to the blood of each zone, as blood of the resting kind.
    shape_rms : (fingers,) float. rms of a beat's waveform over its height.
    log_ratio_per_percent : change of ln R with the saturation.
    frames : readings of each LED that are averaged.
    """

    leds: tuple[int, int]
    pulse: Array
    shape_rms: Array
    log_ratio_per_percent: float
    frames: float

    def error_percent(self, responses: Sequence[Sequence[Response]]) -> Array:
        """Standard error of SpO2 by all photodiodes together, on the worst finger, (1 + blocks,) float. [percent]

        responses : by finger and LED, (1 + blocks, photodiodes). Photodiodes whose converter is at its limit tell
            nothing.
        """
        worst = []
        for k, by_led in enumerate(responses):
            variance = np.sum([self.relative_variance(k, i, read) for i, read in enumerate(by_led)], axis=0)
            with np.errstate(divide="ignore"):
                worst.append(1 / np.sqrt(self.information_per_percent2(k, variance).sum(-1)))
        return np.max(worst, axis=0)

    def relative_variance(self, finger: int, led: int, read: Response) -> Array:
        """Variance of the height of an LED's pulse in one reading over its square; of LEDs that tell no oxygen 0."""
        if led not in self.leds:
            return np.zeros(np.shape(read.volts))
        # In volts over noise: the light itself cancels.
        pulsating = (read.zone_v @ self.pulse[finger, self.leds.index(led)]) ** 2 * read.unsaturated
        with np.errstate(divide="ignore"):
            return np.asarray(read.noise_v2 / pulsating)

    def information_per_percent2(self, finger: int, variance: Array) -> Array:
        """What a photodiode tells of SpO2 by the sum of both LEDs' relative variances: one over its variance."""
        return np.asarray((self.log_ratio_per_percent * self.shape_rms[finger]) ** 2 * self.frames / variance)


def spo2_objective(base: Scene, cases: Sequence[FingerCase], force_n: float) -> Spo2Objective:
    """The rule for a scene's fingers, under the force at which layouts are judged.

    Raises: InputError for a scene without a pulse or without two LEDs of different wavelengths.
    """
    try:
        leds = two_leds(base.leds, base.oximeter.slots if base.oximeter else None)
    except ValueError as error:
        raise InputError(f"placement.rank_by, oxygen: {error}.") from None
    oximeter_leds(base)
    pulse, shape, blood = [], [], base.blood
    wavelength = np.array([base.leds[i].wavelength_nm for i in leds])
    fresher = tissue.blood_mu_a_per_mm(wavelength, blood.so2) / tissue.blood_mu_a_per_mm(wavelength, blood.rest_so2)
    for case in cases:
        beat = beat_at(boards.worn_on(base, case), force_n)
        least, most = beat.extremes
        pulse.append(fresher[:, None] * (most - least))
        together = beat.blood_fraction.sum(0)
        shape.append(together.std() / np.ptp(together))
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
    """What less is better of, from what single photodiodes tell.

    rules : with the weights of worst, mean, share and oxygen.
    points : the touch on each finger.
    oxygen : what SpO2 is judged by, if it counts.
    """

    rules: Placement
    points: Sequence[OperatingPoint]
    oxygen: Spo2Objective | None = None

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
            spo2 = [self.oxygen.information_per_percent2(k, variance) for k, variance in enumerate(total[..., -1])]
            total = np.concatenate([total[..., :-1], np.stack(spo2)[..., None]], -1)
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


@dataclass(frozen=True)
class LayoutScore:
    """How finely a layout resolves force: by all photons and without each block of them.

    resolution_n : (1 + blocks, fingers) float. Whatever the split of the force, through the body's noise. [N]
    score_n : (1 + blocks,) float. Over the fingers. [N]
    electronics_resolution_n, electronics_score_n : the same, were the body still. [N]
    noise_floor_n : float. False force by the body, the same with every layout, over the fingers: no score is less. [N]
    information_per_pa2 : (1 + blocks, fingers, 3) float. Of both pressures, whatever the body does. [Pa^-2]
    responses : by finger and LED, (1 + blocks, photodiodes).
    share : (1 + blocks,) float. Resolution of the proximal share of the force, on the worst finger.
    spo2_percent : (1 + blocks,) float. Standard error of SpO2 over 8 s on the worst finger; None where it does not
        rank. [percent]
    ranked : (1 + blocks,) float. What layouts are ranked by, less is better.
    by_force : whether that is the force alone.
    """

    resolution_n: np.ndarray
    score_n: np.ndarray
    electronics_resolution_n: np.ndarray
    electronics_score_n: np.ndarray
    noise_floor_n: float
    information_per_pa2: np.ndarray
    responses: list[list[Response]]
    share: np.ndarray
    spo2_percent: np.ndarray | None
    ranked: np.ndarray
    by_force: bool

    @property
    def ranked_interval(self) -> tuple[float, float]:
        """95 % interval of what layouts are ranked by."""
        if self.by_force:
            return self.interval_n
        best, spread = float(self.ranked[0]), t95(len(self.ranked) - 1) * self.relative_error
        return best * math.exp(-spread), best * math.exp(spread)

    @property
    def interval_n(self) -> tuple[float, float]:
        """95 % interval of the score. [N]"""
        return resolution_interval_n(self.score_n, self.noise_floor_n)

    @property
    def electronics_interval_n(self) -> tuple[float, float]:
        """95 % interval of the score, were the body still. [N]"""
        return resolution_interval_n(self.electronics_score_n)

    @property
    def relative_error(self) -> float:
        """Relative standard error of what layouts are ranked by."""
        return float(jackknife(np.log(self.ranked)))


def resolution_stderr_n(resolution_n: np.ndarray, noise_floor_n: float | np.ndarray = 0.0) -> np.ndarray:
    """Standard error of resolutions by all photons and without each block of them, (1 + blocks, ...) float. [N]

    noise_floor_n : what of them is the body's own and has no error. [N]

    It is the error of the logarithm of the rest, to first order. A resolution is the root of an inverse sum of squares,
    to which the photons' noise adds: where it comes out small, so does its error, and only their ratio is the scatter.
    """
    above = _above(resolution_n, noise_floor_n)
    return np.asarray(above[0] ** 2 / resolution_n[0] * jackknife(np.log(above)))


def resolution_interval_n(resolution_n: np.ndarray, noise_floor_n: float = 0.0) -> tuple[float, float]:
    """95 % interval of one resolution, symmetric in the logarithm of what it is above the body's own part. [N]"""
    above = _above(resolution_n, noise_floor_n)
    spread = t95(len(above) - 1) * float(jackknife(np.log(above)))
    low, high = (math.hypot(float(above[0]) * math.exp(sign * spread), noise_floor_n) for sign in (-1, 1))
    return low, high


def _above(resolution_n: np.ndarray, noise_floor_n: float | np.ndarray) -> np.ndarray:
    """The part of resolutions that adds in squares to the noise floor; all of them where that is not known. [N]"""
    return np.asarray(np.sqrt(np.maximum(resolution_n**2 - np.nan_to_num(noise_floor_n) ** 2, np.finfo(float).tiny)))


def score_layout(layout: CandidateLayout, cache: PhotonMapCache, objective: Objective) -> LayoutScore:
    """A layout's score from light that is traced; a further layout on a traced board costs milliseconds."""
    responses = cache.read(layout.scene, layout.board)
    information = [total_information(by_led) for by_led in responses]
    still = [total_information(by_led, electronics_alone=True) for by_led in responses]
    points = [condition.point for condition in cache.conditions]
    floors_n = np.array([[physiological_noise_force_n(point)] for point in points])
    resolution, electronics = (
        np.stack([force_resolution_n(*both) for both in zip(one, points, strict=True)]) for one in (information, still)
    )
    over, weights = objective.rules.over_fingers, objective.rules.weights
    score_n, share = over_fingers(resolution, over), objective.share(np.stack(information))
    spo2 = None if objective.oxygen is None else objective.oxygen.error_percent(responses)
    values = {over: score_n, "share": share} | ({} if spo2 is None else {"oxygen": spo2})
    return LayoutScore(
        resolution_n=resolution.T,
        score_n=score_n,
        electronics_resolution_n=electronics.T,
        electronics_score_n=over_fingers(electronics, over),
        noise_floor_n=float(over_fingers(floors_n, over)[0]),
        information_per_pa2=np.stack([pressure_information(one) for one in information], 1),
        responses=responses,
        share=share,
        spo2_percent=spo2,
        ranked=weighted(values, weights),
        by_force=set(weights) == {over},
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

    photons : per layout, LED and finger, in place of a tolerance.
    relative_error : of the scores of those tied with the best, at which tracing ends as well.

    Returns: the layouts that were traced on every finger, their scores, and why the best was not distinguished, if so.

    Raises: NotReachedError where time ends before one layout is traced.
    """
    traced = {layout.name: 0 for layout in layouts}
    first = JUDGE_PHOTONS if report_progress.interrupted else photons or JUDGE_PHOTONS
    every, more = len(layouts), (set(traced), first)
    complete = _extend(layouts, cache, *more, traced, report_progress)
    layouts = [layout for layout in layouts if cache.photons_of(layout.board)]
    if not layouts:
        raise NotReachedError(f"{report_progress.why} before one layout was traced on every finger; allow more time.")
    trigger = Trigger(target=relative_error, first=JUDGE_PHOTONS, least=JUDGE_PHOTONS, growth=0.5)
    while True:
        scores = [score_layout(layout, cache, objective) for layout in layouts]
        highest = min(scores, key=lambda score: float(score.ranked[0])).ranked_interval[1]
        tied = {
            layout.name: score.relative_error
            for layout, score in zip(layouts, scores, strict=True)
            if score.ranked_interval[0] <= highest
        }
        worst = max(tied.values())
        report_progress("judge", trigger.share_done(worst) if len(tied) > 1 else 1.0, worst, relative_error)
        left = f"{len(tied)} layouts tied at relative error {worst:.3g}, {relative_error:g} requested"
        if report_progress.interrupted:
            return layouts, scores, f"interrupted: {len(layouts)} of {every} layouts traced, {left}."
        if not complete or len(layouts) < every:
            return layouts, scores, f"max_seconds ended with {len(layouts)} of {every} layouts traced, {left}."
        if photons or len(tied) == 1 or worst <= relative_error:
            return layouts, scores, None
        undecided = {name for name, error in tied.items() if error > relative_error}
        more = undecided, trigger.needed(max(traced[name] for name in undecided), worst)
        complete = _extend(layouts, cache, *more, traced, report_progress)


def _extend(
    layouts: Sequence[CandidateLayout],
    cache: PhotonMapCache,
    names: set[str],
    photons: int,
    traced: dict[str, int],
    report_progress: StageProgress,
) -> bool:
    """Trace the boards of the named layouts further and count it in `traced`; False where time ran out before."""
    for key, board in {digest(layout.board): layout.board for layout in layouts if layout.name in names}.items():
        if cache.stop():
            return False
        cache.extend(board, photons)
        for layout in layouts:
            traced[layout.name] += photons if digest(layout.board) == key else 0
        report_progress.repeat()
    return True
