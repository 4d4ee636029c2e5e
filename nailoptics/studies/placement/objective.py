"""What layouts are ranked by: force, the share of its sides, SpO2, or these by weight, over all fingers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...errors import InputError
from ...hemodynamics.for_scene import beat_at, oximeter_leds
from ...scene import FingerCase, Oximeter, Placement, Scene
from ...scene.oximeter import two_leds
from ...sensor.front_end import AVERAGE_S
from ...sensor.information import (
    OperatingPoint,
    Response,
    fisher_information,
    force_resolution_n,
    over_fingers,
    share_resolution,
)
from . import boards

Array = NDArray[np.float64]

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
