"""Detected light to volts: responsivity, photocurrent, transimpedance gain, noise and the converter's range."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array, not_negative
from ..errors import InputError
from ..light.optics import line_response
from ..scene import Electronics, Led, Photodiode, Scene
from ..statistics import quotient
from ..variables import Estimate, Variables, described

Photodiodes: TypeAlias = Photodiode | Sequence[Photodiode]
Ohm: TypeAlias = Array | float | None

# Exact, as the SI is defined by them.
BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C = 1.380649e-23, 1.602176634e-19

# Preferred numbers of the series E24 (IEC 60063), and the largest chip resistor in common series of them. [ohm]
E24 = np.array([10, 11, 12, 13, 15, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 43, 47, 51, 56, 62, 68, 75, 82, 91])
MOST_OHM = 22e6
# A recorded reading of so much of the converter's range is at its limit: its last codes cannot be distinguished.
RECORDED_LIMIT = 0.998


class NoiseBudget(NamedTuple):
    """Variances of one reading by their cause in stage and converter, which broadcast; they add. [V^2]"""

    shot_v2: Array
    feedback_v2: Array
    shunt_v2: Array
    amplifier_v2: Array
    adc_v2: Array
    ambient_v2: Array | float = 0.0


@dataclass(frozen=True)
class Output:
    """What a photodiode's stage and the converter behind it make of light, arrays of one shape.

    amplified_v : The stage's output, dark current included, as if the converter had no limit. [V]
    volts : What the converter reads: the same, held at `adc_range_v`, less what ambient rejection takes away. [V]
    noise : Variances that stage and converter add to one reading. [V^2]
    saturated : bool. The converter is at its limit: neither volts nor noise depend on the light.
    """

    amplified_v: Array
    volts: Array
    noise: NoiseBudget
    saturated: NDArray[np.bool_]

    @property
    def noise_v2(self) -> Array:
        """Variance of one reading. [V^2]"""
        return np.asarray(sum(self.noise))

    @property
    def volts_noise_rms(self) -> Array:
        """Noise of one reading. [V]"""
        return np.sqrt(self.noise_v2)


def _of_each(photodiodes: Photodiodes, value: Callable[[Photodiode], float]) -> Array:
    """A number of a photodiode, or of each of several, () or (photodiodes,) float."""
    if isinstance(photodiodes, Photodiode):
        return np.asarray(value(photodiodes))
    # Thousands of places have one and the same photodiode.
    by_id = {key: value(element) for key, element in {id(photodiode): photodiode for photodiode in photodiodes}.items()}
    return np.array([by_id[id(photodiode)] for photodiode in photodiodes])


def fitted_ohm(current_a: ArrayLike, amplifier: Electronics) -> Array:
    """The largest E24 resistor that holds currents, dark and ambient ones included, below the converter's limit by the
    stage's headroom, of any shape. [ohm]"""
    most_v = limit_v(amplifier) / amplifier.headroom
    # A relative 1e-9 lets a resistor be its own fit, whatever the rounding; log10 may round up to a power of ten.
    most = most_v / np.maximum(current_a, most_v / MOST_OHM) * (1 + 1e-9)
    step = 10.0 ** np.floor(np.log10(most) - 1)
    return np.asarray(E24[np.searchsorted(E24, np.maximum(most / step, 10.0), side="right") - 1] * step)


def stage_ohm(photodiodes: Photodiodes, amplifier: Electronics, *, largest_a: Array | float | None = None) -> Array:
    """Feedback resistance of a photodiode's stage, or of each of several, () or (photodiodes,) float. [ohm]

    largest_a : (..., photodiodes) float. Their largest photocurrents, to which "auto" fits; InputError without. [A]
    """

    def of(photodiode: Photodiode) -> float:
        ohm = amplifier.feedback_ohm if photodiode.feedback_ohm is None else photodiode.feedback_ohm
        assert not isinstance(ohm, tuple), "the elements of an array have one each"
        return np.nan if ohm == "auto" else ohm

    given = _of_each(photodiodes, of)
    if not np.isnan(given).any():
        return given
    if largest_a is None:
        raise InputError('electronics.feedback_ohm = "auto" is not known here; give the resistance in ohm.')
    return np.where(np.isnan(given), fitted_ohm(largest_a + _dark_a(photodiodes, amplifier), amplifier), given)


def has_resistors(scene: Scene) -> bool:
    """Whether no photodiode's resistor is left to be fitted: the amplifier's is stated, or each has its own."""
    return scene.electronics.feedback_ohm != "auto" or all(p.feedback_ohm is not None for p in scene.photodiodes)


def with_resistors(scene: Scene, largest_a: Array) -> Scene:
    """The scene with a resistor at every photodiode where it has "auto", fitted to the largest photocurrents of the
    layout's elements, (photodiodes,) float. [A]"""
    ohm = iter(stage_ohm(scene.elements, scene.electronics, largest_a=largest_a).tolist())
    photodiodes = []
    for photodiode in scene.photodiodes:
        of_elements = tuple(next(ohm) for _ in photodiode.wired_elements)
        update = {"feedback_ohm": of_elements if photodiode.elements > 1 else of_elements[0]}
        photodiodes.append(photodiode.model_copy(update=update))
    return scene.model_copy(update={"photodiodes": tuple(photodiodes)})


def _dark_a(photodiodes: Photodiodes, amplifier: Electronics) -> Array:
    """Dark current of a photodiode, or of each of several, at the amplifier's temperature. [A]"""
    return _of_each(photodiodes, lambda p: p.dark_current_a(amplifier.temperature_k))


def lsb_v(amplifier: Electronics) -> float:
    """The converter's step. [V]"""
    return amplifier.adc_range_v / 2.0**amplifier.adc_bits


def limit_v(amplifier: Electronics) -> float:
    """Where the converter's last code begins, one step below its range: more light does not change it. [V]"""
    return amplifier.adc_range_v - lsb_v(amplifier)


def noise_budget(
    current_a: Array | float, photodiode: Photodiodes, amplifier: Electronics, *, feedback_ohm: Ohm = None
) -> NoiseBudget:
    """Noise of a stage's output at a photocurrent without its dark current [A]: shot, Johnson, amplifier, quantization.

    Current noise density 2q(I + I_d) + 4kT/R_f + 4kT/R_sh + (1/R_f^2 + (2 pi f C)^2) e_n^2, integrated from 0 to the
    bandwidth B (f^2 gives B^3 / 3) and multiplied by R_f^2; the converter adds LSB^2/12.

    feedback_ohm : that of the stage if not given. [ohm]
    """
    bandwidth, ohm = amplifier.bandwidth_hz, stage_ohm(photodiode, amplifier) if feedback_ohm is None else feedback_ohm
    gain2, thermal_j = np.asarray(ohm) ** 2, 4 * BOLTZMANN_J_PER_K * amplifier.temperature_k
    capacitance_f = 1e-12 * (amplifier.capacitance_pf + _of_each(photodiode, lambda p: p.capacitance_pf))
    # The amplifier's voltage noise is at the output as it is, and by the current through the capacitance.
    voltage_v2 = (1e-9 * amplifier.noise_nv_per_rt_hz) ** 2 * bandwidth
    through_capacitance = (2 * np.pi * bandwidth * capacitance_f) ** 2 / 3
    return NoiseBudget(
        shot_v2=2 * ELEMENTARY_CHARGE_C * (current_a + _dark_a(photodiode, amplifier)) * bandwidth * gain2,
        feedback_v2=np.asarray(thermal_j * bandwidth * ohm),
        shunt_v2=np.asarray(thermal_j / _of_each(photodiode, lambda p: 1e6 * p.shunt_mohm) * bandwidth * gain2),
        amplifier_v2=np.asarray(voltage_v2 * (1 + through_capacitance * gain2)),
        adc_v2=np.asarray(lsb_v(amplifier) ** 2 / 12),
    )


def flicker_gain(flicker_hz: float, amplifier: Electronics) -> float:
    """What a reading has of ambient light's modulation, rms, relative to that in the stage's input.

    The stage, or the lock-in's low pass, is of first order. A lock-in turns a frequency f into f_switching - f and
    f_switching + f, by a square wave whose fundamental is 4 / pi.
    """

    def low_pass(hz: float) -> float:
        return float(1 / np.hypot(1.0, hz * np.pi / (2 * amplifier.bandwidth_hz)))

    switching_hz = amplifier.rejection_hz
    if amplifier.ambient_rejection == "lock_in":
        sidebands = (low_pass(switching_hz - flicker_hz), low_pass(switching_hz + flicker_hz))
        return float(4 / np.pi * np.hypot(*sidebands))
    later = abs(2 * np.sin(np.pi * flicker_hz / (2 * switching_hz))) if amplifier.ambient_rejection else 1.0
    return float(later * low_pass(flicker_hz))


def converted(amplified_v: Array, amplifier: Electronics) -> tuple[Array, NDArray[np.bool_]]:
    """Saturation: the converter's reading of a stage's output [V], within 0 and its range; where it is at its limit."""
    within = np.clip(amplified_v, 0.0, amplifier.adc_range_v)
    return np.asarray(within), np.asarray(amplified_v >= limit_v(amplifier))


def recorded_at_limit(volts: Array, range_v: float) -> NDArray[np.bool_]:
    """Saturation: where recorded readings [V] of a converter of some range are at its limit, of their shape."""
    return np.asarray(volts >= RECORDED_LIMIT * range_v)


def read(
    detected_fraction: ArrayLike,
    led: Led,
    photodiode: Photodiodes,
    amplifier: Electronics,
    *,
    ambient_a: ArrayLike = 0.0,
    feedback_ohm: Ohm = None,
) -> Output:
    """What the converter reads of one LED's light on a photodiode: the mean, its noise, and whether it is at its limit.

    detected_fraction : array. Fraction of the LED's light that the photodiode detects.
    photodiode : or several, along the last axis.
    amplifier : The stage and its converter, a scene's `[electronics]`.
    ambient_a : photocurrent by light from outside; as feedback_ohm a number or an array that broadcasts. [A]
    feedback_ohm : the photodiode's own if not given. [ohm]

    A dark slot adds the noise of its own sample. A lock-in has the mean noise of both states times 4 at the same
    bandwidth, as a reading is twice what the demodulator sees of an LED that is lit half of the time.

    Raises: InputError for a fraction or a current that is negative or not finite.
    """
    lit_a, outside_a = photocurrent_a(detected_fraction, led, photodiode), not_negative("ambient_a", ambient_a)
    ohm = stage_ohm(photodiode, amplifier) if feedback_ohm is None else feedback_ohm
    dark_a = _dark_a(photodiode, amplifier)
    amplified = np.asarray((lit_a + outside_a + dark_a) * ohm)
    volts, saturated = converted(amplified, amplifier)
    # What the converter cuts off adds no noise to what it reads.
    read_a = np.clip(lit_a + quotient(limit_v(amplifier) - amplified, ohm), 0.0, lit_a)
    lit, outside, dark = (
        noise_budget(current_a, photodiode, amplifier, feedback_ohm=ohm) for current_a in (read_a, outside_a, 0.0)
    )
    noise = lit._replace(ambient_v2=outside.shot_v2 - dark.shot_v2)
    if amplifier.ambient_rejection is not None:
        volts = volts - converted(np.asarray((outside_a + dark_a) * ohm), amplifier)[0]
        factor = 1 if amplifier.ambient_rejection == "dark_slot" else 2
        unlit = dark._replace(ambient_v2=noise.ambient_v2)
        noise = NoiseBudget(*(np.asarray(factor * (a + b)) for a, b in zip(noise, unlit, strict=True)))
    return Output(amplified_v=amplified, volts=volts, noise=noise, saturated=saturated)


def photocurrent_a(detected_fraction: ArrayLike, led: Led, photodiode: Photodiodes) -> Array:
    """Photocurrent of a fraction of an LED's light on a photodiode, or on each of several along the last axis. [A]"""
    per_w = _of_each(photodiode, lambda p: float(line_response(led, p).sum()))
    return np.asarray(not_negative("detected_fraction", detected_fraction) * led.flux_mw * 1e-3 * per_w)


def volts_per_fraction(led: Led, photodiode: Photodiodes, amplifier: Electronics) -> Array:
    """What all of an LED's light on a photodiode would give, or on each of several, by which changes and errors scale,
    () or (photodiodes,) float. [V]"""
    return np.asarray(photocurrent_a(1.0, led, photodiode) * stage_ohm(photodiode, amplifier))


def ambient_in_readings(scene: Scene, current: Array, error: Array, bare: Array) -> Variables:
    """The light from outside on a scene's photodiodes, and what of it is in a reading; current, error, bare :
    (photodiodes,) float. Photocurrent, its standard error, and that in the open. [A]"""
    stage, diodes = scene.electronics, scene.elements
    assert scene.ambient is not None
    flicker = scene.ambient.flicker / np.sqrt(2) * flicker_gain(scene.ambient.flicker_hz, stage)
    to_v, left = stage_ohm(diodes, stage), 1.0 if stage.ambient_rejection is None else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):  # of 0 lux
        factors = {"a": 1.0, "fraction": 1 / bare, "volts": to_v, "left_v": left * to_v, "flicker_v": flicker * to_v}
        on_each = {f"ambient_{name}": Estimate(factor * current, factor * error) for name, factor in factors.items()}
    shot_v2 = read(0.0, scene.leds[0], diodes, stage, ambient_a=current).noise.ambient_v2
    return described(__package__, **on_each, ambient_noise_v=np.sqrt(shot_v2))
