"""Sampled front end: from light to the volts of an oximeter's slots, with settling, averaging and noise by cause."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array
from ..errors import InputError
from ..hemodynamics.for_scene import heart_rate_per_min
from ..scene import Oximeter, Photodiode, Scene, Slot
from ..scene.electronics import DARK, two_leds
from . import electronics
from .volts import with_fitted_resistors

# A usual oximeter averages over so long. [s]
AVERAGE_S = 8.0
CAUSES = ("electronics", "converter", "ambient light")


@dataclass(frozen=True)
class SampledFrontEnd:
    """The photodiodes' transimpedance stages, sampled in an oximeter's slots.

    leds : numbers of the red and the infrared LED.
    ambient_a : (photodiodes,) float. Photocurrent by ambient light. [A]
    """

    scene: Scene
    photodiodes: tuple[Photodiode, ...]
    leds: tuple[int, int]
    ambient_a: Array

    @cached_property
    def oximeter(self) -> Oximeter:
        """The scene's schedule, or the usual one."""
        return self.scene.oximeter or Oximeter()

    @cached_property
    def slots(self) -> tuple[Slot, ...]:
        """The slots of a frame."""
        return self.oximeter.schedule([self.scene.leds[i] for i in self.leds])

    @property
    def slot_names(self) -> tuple[str, ...]:
        """What is lit in each slot."""
        return tuple(slot.light for slot in self.slots)

    @property
    def lights(self) -> tuple[str, str, str]:
        """What a slot can hold: the two LEDs and nothing."""
        red, infrared = (self.scene.leds[i].name for i in self.leds)
        return red, infrared, DARK

    @property
    def delays_s(self) -> dict[str, float]:
        """How much later than the red slot each slot is. [s]"""
        start_ms = {slot.light: slot.start_ms for slot in self.slots}
        return {name: 1e-3 * (start - start_ms[self.lights[0]]) for name, start in start_ms.items()}

    @property
    def settling_s(self) -> float:
        """Time constant of the stage, a first-order low pass of its noise bandwidth. [s]"""
        return 1.0 / (4.0 * self.scene.electronics.bandwidth_hz)

    def sample_times_ms(self, length_ms: float) -> Array:
        """When a slot of a length is sampled, from its start, (samples,) float. [ms]"""
        first, count = self.oximeter.settle, self.oximeter.samples
        return length_ms * (first + (1 - first) * (np.arange(count) + 1) / count)

    @cached_property
    def mixing(self) -> Array:
        """How much of each light a slot's samples hold, (slots, lights): red, infrared, none.

        The stage settles exponentially; what it has not yet left is the slot before, on the whole that of the frame
        before for the first. Between slots nothing is lit.
        """

        def settled(level: Array, target: Array, after_ms: float) -> Array:
            left = float(np.exp(-1e-3 * max(after_ms, 0.0) / self.settling_s))
            return np.asarray(target + (level - target) * left)

        slots, none = self.slots, np.array([0.0, 0.0, 1.0])
        lights = np.array([[float(slot.light == name) for name in self.lights] for slot in slots])
        frame_ms = 1e3 / self.oximeter.frame_hz
        level, out = none, np.zeros_like(lights)
        # Twice around: after the first the stage has forgotten how it began.
        for _ in range(2):
            end_ms = slots[-1].end_ms - frame_ms
            for k, slot in enumerate(slots):
                level = settled(level, none, slot.start_ms - end_ms)
                out[k] = np.mean([settled(level, lights[k], t) for t in self.sample_times_ms(slot.length_ms)], axis=0)
                level = settled(level, lights[k], slot.length_ms)
                end_ms = slot.end_ms
        return out

    @property
    def weights(self) -> Array:
        """The red and the infrared reading as sums of slots, (2, slots) float: the LED's own less the dark one."""
        lit = [[float(name == light) - float(name == DARK) for name in self.slot_names] for light in self.lights[:2]]
        return np.array(lit)

    def slot_volts(self, fraction: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Mean volts of every slot and where the converter is at its limit, (slots, ..., photodiodes) each.

        fraction : (2, ..., photodiodes) float. Detected fractions of the red and the infrared LED.
        """
        amplifier, how = self.scene.electronics, {"ambient_a": self.ambient_a}
        settled = [
            electronics.read(part, self.scene.leds[led], self.photodiodes, amplifier, **how).amplified_v
            for part, led in self._lit(fraction)
        ]
        return electronics.converted(np.tensordot(self.mixing, settled, 1), amplifier)

    def photocurrent_a(self, fraction: ArrayLike, led: int) -> Array:
        """Photocurrent of one LED's light from its detected fraction, (..., photodiodes) float. [A]"""
        return electronics.photocurrent_a(fraction, self.scene.leds[led], self.photodiodes)

    def slot_noise_v2(self, fraction: ArrayLike) -> dict[str, Array]:
        """Variance of every slot's average by its cause, (slots, photodiodes) float each. [V^2]

        fraction : (2, photodiodes) float. Detected fraction of the red and the infrared LED's light. [1]
        """
        amplifier, samples = self.scene.electronics, self.oximeter.samples
        lit_a = dict(zip(self.lights, (self.photocurrent_a(*lit) for lit in self._lit(fraction)), strict=True))
        current_a = np.stack([lit_a[name] for name in self.slot_names])
        quiet, bright = (
            electronics.noise_budget(current_a + ambient_a, self.photodiodes, amplifier)
            for ambient_a in (0.0, self.ambient_a)
        )
        # Noise of a first-order stage is correlated over its time constant, between the samples of a slot.
        times_s = [1e-3 * self.sample_times_ms(slot.length_ms) for slot in self.slots]
        averaged = np.array([[np.exp(-np.abs(t[:, None] - t) / self.settling_s).mean()] for t in times_s])
        held = electronics.BOLTZMANN_J_PER_K * amplifier.temperature_k / (1e-12 * self.oximeter.hold_pf)
        return {
            "electronics": (sum(quiet) - quiet.adc_v2) * averaged + held / samples,
            "converter": np.full_like(current_a, quiet.adc_v2 / samples),
            "ambient light": (bright.shot_v2 - quiet.shot_v2) * averaged,
        }

    def _lit(self, fraction: ArrayLike) -> list[tuple[Array, int]]:
        """Detected fraction of each of `lights`, and the number of an LED."""
        detected = np.asarray(fraction, float)
        return list(zip([*detected, np.zeros_like(detected[0])], (*self.leds, self.leds[0]), strict=True))


def oximeter_leds(scene: Scene) -> tuple[int, int]:
    """The numbers of a scene's red and infrared LED.

    Raises: InputError without a finger, two LEDs of different wavelengths, or a pulse.
    """
    if scene.finger is None:
        raise InputError("oximeter needs a [finger] scene, whose blood beats; a [phantom] has none.")
    try:
        leds = two_leds(scene.leds, scene.oximeter.slots if scene.oximeter else None)
    except ValueError as error:
        raise InputError(f"leds: {error}.") from None
    heart_rate_per_min(scene.body)
    return leds


def front_end_of(scene: Scene, leds: tuple[int, int], ambient_a: Array | None = None) -> SampledFrontEnd:
    """The front end of a scene; ambient_a : (photodiodes,) float, photocurrent by ambient light. [A]"""
    scene = with_fitted_resistors(scene)
    photodiodes = tuple(element.photodiode for element in scene.layout.photodiodes)
    return SampledFrontEnd(scene, photodiodes, leds, np.zeros(len(photodiodes)) if ambient_a is None else ambient_a)


def ratio_stderr(
    ratio: Array, index: Array, level_v: Array, noise_v2: Array, *, shape_rms: float, frames: float
) -> Array:
    """Standard error of a ratio of ratios that the noise of so many frames leaves.

    The slope of red's logarithm over infrared's, both known with errors: their noise over what of infrared pulsates.

    ratio : (...) float. index : (..., 2) float, ac/dc of red and infrared. level_v : (..., 2) float. [V]
    noise_v2 : (..., 2) float. Variance of one frame's reading. [V^2]
    shape_rms : rms of a pulse's waveform, as a fraction of its height.
    """
    relative = noise_v2 / level_v**2
    return np.sqrt((relative[..., 0] + ratio**2 * relative[..., 1]) / frames) / (shape_rms * index[..., 1])
