"""What makes volts of the photodiodes' light: amplifier, converter, an oximeter's timing; and light from outside."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from .base import Fraction, Name, NonNegative, Positive, Table, check_unique
from .parts import Led

DARK = "dark"
# Nearer to each other, two lines see nearly the same blood.
LEAST_APART_NM = 20.0


class Electronics(Table):
    """The transimpedance amplifier and the converter of each photodiode."""

    feedback_ohm: Positive | Literal["auto"] = 1e6
    """Feedback resistance of stages whose photodiode gives none: the gain from photocurrent to volts. auto: for each
    photodiode the largest E24 value, up to 22 Mohm, at which its brightest reading has the headroom. [ohm]"""
    headroom: Annotated[float, Field(ge=1, le=1000)] = 2.0
    """Full scale over the brightest reading for "auto": room for other people and light beyond [ambient]."""
    bandwidth_hz: Positive = 100.0
    """Noise bandwidth, whatever the feedback resistance. [Hz]"""
    capacitance_pf: NonNegative = 50.0
    """Capacitance at the amplifier's input. [pF]"""
    noise_nv_per_rt_hz: NonNegative = 10.0
    """Voltage noise density of the amplifier. [nV/sqrt(Hz)]"""
    adc_bits: Annotated[int, Field(ge=1, le=32)] = 16
    """Resolution of the converter."""
    adc_range_v: Positive = 5.0
    """Full scale of the converter. [V]"""
    temperature_k: Positive = 305.0
    """Temperature of the electronics. [K]"""
    ambient_rejection: Literal["dark_slot", "lock_in"] | None = None
    """How readings are freed of steady ambient light and dark current: dark_slot subtracts a sample with the LED off,
    lock_in demodulates an LED that is lit half of the time. Neither removes their noise, nor saturation. An oximeter
    has the slots of [oximeter] instead."""
    switching_hz: Positive | None = None
    """Rate at which the LED is lit and dark in turn for ambient_rejection; if not given 0.3 of bandwidth_hz for
    dark_slot and ten times it for lock_in. [Hz]"""

    def _check(self) -> None:
        if self.switching_hz is not None and self.ambient_rejection is None:
            raise ValueError("switching_hz is for ambient_rejection; give that, too, or leave it out")
        # A dark slot must settle, and a lock-in's low pass must leave the switching out.
        part = self.rejection_hz / self.bandwidth_hz
        if not {None: True, "dark_slot": part <= 1 / 3, "lock_in": part >= 2}[self.ambient_rejection]:
            why = "must be at most a third of bandwidth_hz for dark_slot, and at least twice it for lock_in"
            raise ValueError(f"switching_hz = {self.rejection_hz:g}: {why}")

    @property
    def rejection_hz(self) -> float:
        """Rate at which the LED is lit and dark in turn. [Hz]"""
        return self.switching_hz or self.bandwidth_hz * (10.0 if self.ambient_rejection == "lock_in" else 0.3)


class Ambient(Table):
    """Light from outside on the finger, from all sides."""

    kind: Literal["sun", "lamp", "led"] = "lamp"
    """Spectrum: sun, a black body of 5778 K; lamp, an incandescent lamp, a black body of 2856 K; led, the white LED-B3
    of CIE 015:2018, without infrared."""
    illuminance_lux: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Illuminance of the finger; full sun has 100 000, an office 500. Give this or irradiance_w_per_m2. [lux]"""
    irradiance_w_per_m2: Annotated[float, Field(ge=0, le=1e4)] | None = None
    """Irradiance of the finger over all wavelengths; full sun has some 1000. [W/m^2]"""
    flicker: Fraction = 0.0
    """Amplitude of its modulation, relative to its mean; 0 for a steady light."""
    flicker_hz: Annotated[float, Field(gt=0, le=1e6)] = 100.0
    """Frequency of the modulation; of lamps twice that of the mains. [Hz]"""

    def _check(self) -> None:
        if (self.illuminance_lux is None) == (self.irradiance_w_per_m2 is None):
            raise ValueError("[ambient] takes either illuminance_lux or irradiance_w_per_m2; give exactly one of them")

    @property
    def words(self) -> str:
        """The source and its level."""
        lux = self.illuminance_lux
        return f"{self.kind} of {self.irradiance_w_per_m2:g} W/m^2" if lux is None else f"{self.kind} of {lux:,g} lux"


class Slot(Table):
    """A part of a frame with one LED lit, or none."""

    light: Name
    """Name of the LED that is lit; "dark" for none, to measure ambient light."""
    start_ms: NonNegative
    """From the start of the frame. [ms]"""
    length_ms: Positive
    """Duration. [ms]"""

    @property
    def end_ms(self) -> float:
        """From the start of the frame. [ms]"""
        return self.start_ms + self.length_ms


class Oximeter(Table):
    """The timing of a pulse oximeter, repeated every frame."""

    frame_hz: Annotated[float, Field(ge=10, le=10_000)] = 100.0
    """Frame rate: each frame gives one reading of each LED. [Hz]"""
    slots: Annotated[tuple[Slot, ...], Field(min_length=2, max_length=66)] | None = None
    """Slots in order of time; if not given one for each LED and a dark one, each a third of the frame."""
    settle: Annotated[float, Field(ge=0, lt=1)] = 0.5
    """Fraction of a slot at its start in which the amplifier settles and nothing is sampled."""
    samples: Annotated[int, Field(ge=1, le=1000)] = 4
    """Number of samples averaged over the rest of a slot."""
    hold_pf: Positive = 10.0
    """Capacitor of the sample-and-hold, which adds its thermal noise to each sample. [pF]"""

    def _check(self) -> None:
        slots = self.slots or ()
        for i, (before, after) in enumerate(pairwise(slots)):
            if after.start_ms < before.end_ms - 1e-9:
                why = f"which ends at {before.end_ms:g} ms; start it later, or shorten that one"
                raise ValueError(f"slots[{i + 1}].start_ms = {after.start_ms:g} overlaps slots[{i}], {why}")
        if slots and slots[-1].end_ms > 1e3 / self.frame_hz + 1e-9:
            why = f"after their frame of {1e3 / self.frame_hz:g} ms; shorten them or lower frame_hz"
            raise ValueError(f"slots end at {slots[-1].end_ms:g} ms, {why}")
        check_unique([slot.light for slot in slots], "slots")

    def schedule(self, leds: Sequence[Led]) -> tuple[Slot, ...]:
        """The slots as given, or one for each of these LEDs and a dark one."""
        if self.slots is not None:
            return self.slots
        names = [*(led.name for led in leds), DARK]
        length_ms = 1e3 / self.frame_hz / len(names)
        return tuple(Slot(light=name, start_ms=k * length_ms, length_ms=length_ms) for k, name in enumerate(names))


def two_leds(leds: Sequence[Led], slots: Sequence[Slot] | None) -> tuple[int, int]:
    """The numbers of the red and the infrared LED, distinguished by their wavelengths, among those that have slots.

    Raises: ValueError where there are not two of different wavelengths.
    """
    lit = [i for i, led in enumerate(leds) if slots is None or led.name in {slot.light for slot in slots}]
    if len(lit) != 2:
        those = f"{len(lit)} of the scene's {len(leds)} {'would be lit' if slots is None else 'have slots'}"
        why = f"and {those}; give two, such as led_660 and led_940, each a slot"
        raise ValueError(f"an oximeter takes two LEDs, a red and an infrared one, {why}")
    red, infrared = sorted(lit, key=lambda i: leds[i].wavelength_nm)
    apart_nm = leds[infrared].wavelength_nm - leds[red].wavelength_nm
    if apart_nm < LEAST_APART_NM:
        both = " and ".join(f'"{leds[i].name}" of {leds[i].wavelength_nm:g} nm' for i in (red, infrared))
        why = f"see the same blood; take two at least {LEAST_APART_NM:g} nm apart, such as 660 and 940"
        raise ValueError(f"LEDs {both} {why}")
    return red, infrared
