"""What makes volts of the photodiodes' light: amplifier and converter, and the light from outside that they meet."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from .base import Fraction, NonNegative, Positive, Table


class Electronics(Table):
    """The transimpedance amplifier and the converter of each photodiode."""

    feedback_ohm: Positive | Literal["auto"] = 1e6
    """Feedback resistance of stages whose photodiode gives none: the gain from photocurrent to volts. auto: for each
    photodiode the largest E24 value, up to 22 Mohm, at which its brightest reading has the headroom. [ohm]"""
    headroom: Annotated[float, Field(ge=1, le=1000)] = 2.0
    """Full scale over the brightest reading for "auto": room for other people and for light from outside beyond
    [ambient]."""
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

    @model_validator(mode="after")
    def _switching_suits_the_bandwidth(self) -> Self:
        if self.switching_hz is not None and self.ambient_rejection is None:
            raise ValueError("switching_hz is for ambient_rejection; give that, too, or leave it out")
        # A dark slot must settle, and a lock-in's low pass must leave the switching out.
        part = self.rejection_hz / self.bandwidth_hz
        if not {None: True, "dark_slot": part <= 1 / 3, "lock_in": part >= 2}[self.ambient_rejection]:
            raise ValueError(
                f"switching_hz = {self.rejection_hz:g}: must be at most a third of bandwidth_hz for dark_slot, and at "
                "least twice it for lock_in"
            )
        return self

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

    @model_validator(mode="after")
    def _has_one_level(self) -> Self:
        if (self.illuminance_lux is None) == (self.irradiance_w_per_m2 is None):
            raise ValueError("[ambient] takes either illuminance_lux or irradiance_w_per_m2; give exactly one of them")
        return self

    @property
    def words(self) -> str:
        """The source and its level."""
        lux = self.illuminance_lux
        return f"{self.kind} of {self.irradiance_w_per_m2:g} W/m^2" if lux is None else f"{self.kind} of {lux:,g} lux"
