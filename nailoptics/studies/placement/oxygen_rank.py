"""How well layouts tell the oxygen saturation: the error of SpO2 that the electronics leave to all photodiodes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...errors import InputError
from ...scene import FingerCase, Oximeter, Scene
from ...scene.oximeter import two_leds
from ...sensor.front_end import AVERAGE_S
from ...sensor.information import Response
from ..pulsatile_blood import beat_at, oximeter_leds
from . import boards

Array = NDArray[np.float64]

# Change of the saturation over which its part in the logarithm of R is taken.
STEP = 0.005


@dataclass(frozen=True)
class OxygenRule:
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
                worst.append(1 / np.sqrt(self.told_per_percent2(k, variance).sum(-1)))
        return np.max(worst, axis=0)

    def relative_variance(self, finger: int, led: int, read: Response) -> Array:
        """Variance of the height of an LED's pulse in one reading over its square; of LEDs that tell no oxygen 0."""
        if led not in self.leds:
            return np.zeros(np.shape(read.volts))
        # In volts over noise: the light itself cancels.
        pulsating = (read.zone_v @ self.pulse[finger, self.leds.index(led)]) ** 2 * read.telling
        with np.errstate(divide="ignore"):
            return np.asarray(read.noise_v2 / pulsating)

    def told_per_percent2(self, finger: int, variance: Array) -> Array:
        """What a photodiode tells of SpO2 by the sum of both LEDs' relative variances: one over its variance."""
        return np.asarray((self.log_ratio_per_percent * self.shape_rms[finger]) ** 2 * self.frames / variance)


def oxygen_rule(base: Scene, cases: Sequence[FingerCase], force_n: float) -> OxygenRule:
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
        beat = beat_at(boards.on_finger(base, case), force_n)
        least, most = beat.extremes
        pulse.append(fresher[:, None] * (most - least))
        together = beat.blood_fraction.sum(0)
        shape.append(together.std() / np.ptp(together))
    ratio = [np.log(np.divide(*tissue.blood_mu_a_per_mm(wavelength, so2))) for so2 in (blood.so2 - STEP, blood.so2)]
    return OxygenRule(
        leds=leds,
        pulse=np.array(pulse),
        shape_rms=np.array(shape),
        log_ratio_per_percent=float(ratio[0] - ratio[1]) / (100 * STEP),
        frames=AVERAGE_S * (base.oximeter or Oximeter()).frame_hz,
    )
