"""Sampled front end: from light to the volts of an oximeter's slots, with settling, averaging and noise by cause."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..scene import Electronics, Oximeter, Photodiode, Scene, Slot
from ..scene.oximeter import DARK
from . import electronics

Array = NDArray[np.float64]

# A usual oximeter averages over so long. [s]
AVERAGE_S = 8.0
CAUSES = ("electronics", "converter", "ambient light")


@dataclass(frozen=True)
class SampledFrontEnd:
    """A photodiode's transimpedance stage, sampled in an oximeter's slots.

    photodiode : whose light it amplifies.
    leds : numbers of the red and the infrared LED.
    ambient_a : photocurrent by ambient light. [A]
    """

    scene: Scene
    photodiode: Photodiode
    leds: tuple[int, int]
    ambient_a: float = 0.0

    @property
    def oximeter(self) -> Oximeter:
        """The scene's schedule, or the usual one."""
        return self.scene.oximeter or Oximeter()

    @property
    def mixing(self) -> Array:
        """How much of each light a slot's samples hold, (slots, lights): red, infrared, none.

        The stage settles exponentially; what it has not yet left is the slot before, on the whole that of the frame
        before for the first. Between slots nothing is lit.
        """
        slots = self._slots
        lights = np.array([[float(slot.light == name) for name in self.lights] for slot in slots])
        frame_ms = 1e3 / self.oximeter.frame_hz
        level, out = np.array([0.0, 0.0, 1.0]), np.zeros_like(lights)
        # Twice around: after the first the stage has forgotten how it began.
        for _ in range(2):
            end_ms = slots[-1].start_ms + slots[-1].length_ms - frame_ms
            for k, slot in enumerate(slots):
                level = self._settled(level, np.array([0.0, 0.0, 1.0]), slot.start_ms - end_ms)
                times_ms = self.sample_times_ms(slot.length_ms)
                out[k] = np.mean([self._settled(level, lights[k], t) for t in times_ms], axis=0)
                level = self._settled(level, lights[k], slot.length_ms)
                end_ms = slot.start_ms + slot.length_ms
        return out

    @property
    def lights(self) -> tuple[str, str, str]:
        """What a slot can hold: the two LEDs and nothing."""
        red, infrared = (self.scene.leds[i].name for i in self.leds)
        return red, infrared, DARK

    @property
    def corrected(self) -> Array:
        """How much of each LED's own light is in the red and the infrared reading, less the dark one, (2, 2) float."""
        return (self.weights @ self.mixing)[:, :2]

    @property
    def weights(self) -> Array:
        """The red and the infrared reading as sums of slots, (2, slots) float: the LED's own less the dark one."""
        names = [slot.light for slot in self._slots]
        out = np.zeros((2, len(names)))
        for row, light in enumerate(self.lights[:2]):
            out[row, names.index(light)] = 1.0
            if DARK in names:
                out[row, names.index(DARK)] -= 1.0
        return out

    @property
    def slot_names(self) -> tuple[str, ...]:
        """What is lit in each slot."""
        return tuple(slot.light for slot in self._slots)

    @property
    def delays_s(self) -> dict[str, float]:
        """How much later than the red slot each slot is. [s]"""
        start_ms = {slot.light: slot.start_ms for slot in self._slots}
        return {name: 1e-3 * (start - start_ms[self.lights[0]]) for name, start in start_ms.items()}

    @property
    def has_dark_slot(self) -> bool:
        """Whether ambient light is read by itself and taken away."""
        return any(slot.light == DARK for slot in self._slots)

    def sample_times_ms(self, length_ms: float) -> Array:
        """When a slot of a length is sampled, from its start, (samples,) float. [ms]"""
        first, count = self.oximeter.settle, self.oximeter.samples
        return length_ms * (first + (1 - first) * (np.arange(count) + 1) / count)

    def slot_volts(self, fraction: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
        """Mean volts of every slot and where the converter is at its limit, (..., slots) each.

        fraction : (..., 2) float. Detected fractions of the red and the infrared LED.
        """
        dark = self._light_v(np.zeros_like(np.asarray(fraction, float)))
        lit = self._light_v(np.asarray(fraction, float))
        each = np.concatenate([lit, dark[..., :1]], -1)
        volts = each @ self.mixing.T
        return np.minimum(volts, self._amplifier.adc_range_v), volts >= electronics.limit_v(self._amplifier)

    def _light_v(self, fraction: Array) -> Array:
        """The stage's output in either LED's light, settled and without a converter's limit, (..., 2) float. [V]"""
        return np.stack([self._read(fraction[..., k], led).amplified_v for k, led in enumerate(self.leds)], -1)

    def slot_noise_v2(self, fraction: ArrayLike) -> dict[str, Array]:
        """Variance of every slot's average by its cause, (slots,) float each. [V^2]"""
        detected = np.asarray(fraction, float)
        out: dict[str, list[float]] = {name: [] for name in CAUSES}
        outside_v = self.ambient_a * self._amplifier.feedback_ohm
        for slot in self._slots:
            lit = slot.light in self.lights[:2]
            which = self.lights.index(slot.light) if lit else 0
            light = float(detected[which]) if lit else 0.0
            quiet = self._budget(light, self.leds[which], 0.0)
            bright = self._budget(light, self.leds[which], self.ambient_a)
            averaged = self._averaging(slot.length_ms)
            held = electronics.BOLTZMANN_J_PER_K * self._amplifier.temperature_k / (1e-12 * self.oximeter.hold_pf)
            own = sum(float(v) for name, v in quiet._asdict().items() if name != "adc_v2")
            out["electronics"].append(own * averaged + held / self.oximeter.samples)
            out["converter"].append(float(quiet.adc_v2) / self.oximeter.samples)
            out["ambient light"].append(float(bright.shot_v2 - quiet.shot_v2) * averaged if outside_v else 0.0)
        return {name: np.array(values) for name, values in out.items()}

    def reading_noise_v2(self, fraction: ArrayLike) -> dict[str, Array]:
        """Variance of the red and the infrared reading of one frame by its cause, (2,) float each. [V^2]"""
        return {name: self.weights**2 @ values for name, values in self.slot_noise_v2(fraction).items()}

    def _averaging(self, length_ms: float) -> float:
        """Variance of the average of a slot's samples, as a part of one sample's.

        Noise of a first-order stage is correlated over its time constant.
        """
        times_s = 1e-3 * self.sample_times_ms(length_ms)
        apart = np.abs(times_s[:, None] - times_s)
        return float(np.exp(-apart / self.settling_s).mean())

    @property
    def settling_s(self) -> float:
        """Time constant of the stage, a first-order low pass of its noise bandwidth. [s]"""
        return 1.0 / (4.0 * self._amplifier.bandwidth_hz)

    def _settled(self, level: Array, target: Array, after_ms: float) -> Array:
        left = float(np.exp(-1e-3 * max(after_ms, 0.0) / self.settling_s))
        return np.asarray(target + (level - target) * left)

    def _read(self, fraction: Array, led: int) -> electronics.Output:
        source = self.scene.leds[led]
        return electronics.read(fraction, source, self.photodiode, self._amplifier, ambient_a=self.ambient_a)

    def photocurrent_a(self, fraction: ArrayLike, led: int) -> Array:
        """Photocurrent of one LED's light from its detected fraction, of any shape. [A]"""
        per_fraction_v = electronics.volts_per_fraction(self.scene.leds[led], self.photodiode, self._amplifier)
        return np.asarray(fraction, float) * per_fraction_v / self._amplifier.feedback_ohm

    def _budget(self, fraction: float, led: int, ambient_a: float) -> electronics.NoiseBudget:
        diode, amplifier = self.photodiode, self._amplifier
        return electronics.noise_budget(
            self.photocurrent_a(fraction, led) + ambient_a,
            amplifier,
            dark_current_na=1e9 * diode.dark_current_a(amplifier.temperature_k),
            shunt_ohm=diode.shunt_mohm * 1e6,
            capacitance_pf=diode.capacitance_pf,
        )

    @property
    def _amplifier(self) -> Electronics:
        return self.scene.electronics

    @property
    def _slots(self) -> tuple[Slot, ...]:
        return self.oximeter.schedule([self.scene.leds[i] for i in self.leds])


def front_ends_of(scene: Scene, leds: tuple[int, int], ambient_a: Array | None = None) -> list[SampledFrontEnd]:
    """The front end of every photodiode; ambient_a : (photodiodes,) float, photocurrent by ambient light. [A]"""
    elements = scene.layout.photodiodes
    currents = np.zeros(len(elements)) if ambient_a is None else ambient_a
    return [SampledFrontEnd(scene, one.photodiode, leds, float(a)) for one, a in zip(elements, currents, strict=True)]


def ratio_stderr(
    ratio: Array, index: Array, level_v: Array, noise_v2: Array, *, shape_rms: float, frames: float
) -> Array:
    """Standard error of a ratio of ratios that the noise of so many frames leaves.

    The slope of red's logarithm over infrared's, both known with errors: their noise over what of infrared pulsates.

    ratio : (...) float. index : (..., 2) float, ac/dc of red and infrared. level_v : (..., 2) float. [V]
    noise_v2 : (..., 2) float. Variance of one frame's reading. [V^2]
    shape_rms : rms of a pulse's waveform, as a part of its height.
    """
    relative = noise_v2 / level_v**2
    return np.sqrt((relative[..., 0] + ratio**2 * relative[..., 1]) / frames) / (shape_rms * index[..., 1])
