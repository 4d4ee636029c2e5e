"""The body that wears the sensor: what moves its readings beside the touch."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from .base import ArterialPressure, Positive, Table, VenousPressure, WaveAmplitude
from .importers.sensor_recordings import check_columns, with_recording

# Columns of a recording of the body.
RECORDED = ("arterial_pressure_pa", "venous_pressure_pa", "hand_height_m")


class WaveTable(Table):
    """What users set of a wave of the arterial pressure; `WAVES` of hemodynamics.waves has its physics by its name."""


class Heartbeat(WaveTable):
    """The heart's beat in the arterial pressure."""

    mean_pressure_pa: ArterialPressure | None = None
    """Mean of the pressure over a beat; the vessels' own P_H if not given. [Pa]"""
    # Between the finger's artery (45 mmHg, Imholz 1998, Cardiovasc. Res. 38:605) and its capillaries (up to some 10
    # mmHg, Mahler 1979, Am. J. Physiol. 236:H888), which beat by 4 to 14 mmHg under this in the named sets.
    pulse_pressure_pa: WaveAmplitude = 2000.0
    """Highest less lowest pressure of a beat behind the small arteries, where P_H acts. [Pa]"""
    rate_per_min: Annotated[float, Field(ge=20, le=300)] = 70.0
    """Beats in a minute."""
    # Healthy adults lying at rest: intervals of 926 ms with a standard deviation of 50 ms (Nunan 2010, PACE 33:1407).
    rate_variability: Annotated[float, Field(ge=0, le=0.2)] = 0.05
    """Standard deviation of the interval from beat to beat, relative to its mean."""
    # The artery of a resting finger (45 mmHg, Imholz 1998).
    arterial_pulse_pressure_pa: WaveAmplitude = 6000.0
    """Highest less lowest pressure of a beat in small arteries and arterioles. [Pa]"""
    # Fitted: in reflectance at one finger 0.57 % of the light pulse in the infrared and 0.26 % in the red, from top to
    # bottom at 95 to 98 % saturation (public recordings of aarusso/OxiWear).
    arteriolar_blood_fraction: Annotated[float, Field(ge=0, le=0.2)] = 0.016
    """Volume fraction of blood in small arteries and arterioles of the bed at rest, in addition to
    blood.rest_blood_fraction; 0 for capillaries alone, as in the paper."""
    # Fitted to the pulse over contact pressure of 136 to 140 people (CardioWorks 2025), largest at 50 mmHg, with P_H of
    # 75 mmHg. Vessels under tone shut at 20 to 60 mmHg (Nichol, Girling, Burton 1951, Am. J. Physiol. 164:330).
    arteriolar_peak_pa: WaveAmplitude = 5000.0
    """Transmural pressure at which small arteries and arterioles are most compliant. [Pa]"""


class Breathing(WaveTable):
    """The breath in the arterial pressure, a sine."""

    # Adults at rest breathe 12 to 20 times a minute. The systolic pressure in their fingers follows by 2 to 4 mmHg from
    # top to bottom (Elghozi 1991, Clin. Exp. Pharmacol. Physiol. 18:735), but light through fingertips by 0.5 of the
    # heartbeat's rms, medians of 12 hands (assets/priors.toml), as the veins' blood follows the breath, too: fitted.
    rate_per_min: Annotated[float, Field(ge=2, le=60)] = 15.0
    """Breaths in a minute."""
    amplitude_pa: WaveAmplitude = 600.0
    """Amplitude of the pressure, half of top to bottom. [Pa]"""


class Vasomotion(WaveTable):
    """The slow, irregular waves of the vessels' tone (Mayer waves), as arterial pressure."""

    # Variance 14 to 39 mmHg^2 in healthy adults, 0.05 to 0.15 Hz (Taylor 1998, Am. J. Physiol. 274:H1194); waves of
    # 0.07 to 0.2 Hz were seen in the capillaries of the nailfold, too (Mahler 1979, Am. J. Physiol. 236:H888). In light
    # through fingertips their rms is 0.51 of the heartbeat's; with set "best" 600 Pa make 0.54 in the blood.
    amplitude_pa: WaveAmplitude = 600.0
    """Standard deviation of the pressure. [Pa]"""
    band_hz: tuple[Positive, Annotated[float, Field(gt=0, le=5)]] = (0.05, 0.15)
    """Lowest and highest frequency of the waves, at most 5, as fast as a heart beats. [Hz]"""

    def _check(self) -> None:
        if self.band_hz[1] <= self.band_hz[0]:
            raise ValueError(f"band_hz = {list(self.band_hz)} must rise from the lowest to the highest frequency")


class Drift(Table):
    """Slow drift of the sensor's gain (random walks)."""

    # An infrared die loses 0.35 to 0.6 % of its light with each kelvin (data sheets of TSHG6200 and TSAL6200); that it
    # warms and cools with the finger by some 0.4 K within a minute is an assumption.
    led_per_rt_min: Annotated[float, Field(ge=0, le=0.1)] = 0.002
    """Relative standard deviation of an LED's flux after a minute; common to all its readings. [1/sqrt(min)]"""
    # Amplifiers and photodiodes drift by less than 1e-4 for each kelvin; the bond between board and nail takes up
    # moisture and sweat, which nobody has measured: an assumption.
    reading_per_rt_min: Annotated[float, Field(ge=0, le=0.1)] = 0.0005
    """Relative standard deviation after a minute of each reading alone: bond, photodiode, amplifier. [1/sqrt(min)]"""
    # How alike a sensor sits that is bonded anew nobody has measured: an assumption.
    donning: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Relative standard deviation of each reading from one time that the sensor is put on to the next, independently,
    in touches of profile "protocol" with protocol_donnings."""


class Motion(Table):
    """Motion of the sensor relative to the nail about its mean position; its effect on readings is traced."""

    # Nobody has measured how far a sensor moves that is bonded to a nail: all three are assumptions. The adhesive is
    # some 50 um thick, and readings with a micrometre more of it differ by some 0.2 %.
    lift_um: Annotated[float, Field(ge=0, le=100)] = 1.0
    """Standard deviation of its distance from the nail. [um]"""
    slide_um: Annotated[float, Field(ge=0, le=1000)] = 5.0
    """Standard deviation of its position along the nail. [um]"""
    correlation_s: Annotated[float, Field(ge=0.1, le=3600)] = 2.0
    """Correlation time of the displacement (decrease by a factor e). [s]"""


class Body(Table):
    """What changes readings besides the touch: arterial pressure P_H, and the sensor itself; constant unless given."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of intervals between beats, of phases, of slow waves, of drift and of motion."""
    heartbeat: Heartbeat | None = None
    """The heart's beat."""
    breathing: Breathing | None = None
    """The breath."""
    vasomotion: Vasomotion | None = None
    """Slow waves of the vessels' tone (Mayer waves)."""
    hand_height_m: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """Height of the hand above that at which P_H and P_L hold, by which both fall (rho g h); veins of a raised hand
    collapse at a P_L of 0. The blood at rest is that without it. [m]"""
    venous_pressure_pa: VenousPressure | None = None
    """Venous pressure P_L, in place of the vessels' own, at which the blood at rest holds. [Pa]"""
    drift: Drift | None = None
    """Slow drift of LEDs and readings."""
    motion: Motion | None = None
    """Motion of the sensor relative to the nail."""
    file: str | None = None
    """Recording beside the scene file: a CSV with columns time_s (from the start of the touch) and one or more of
    arterial_pressure_pa, in place of heartbeat, breathing and vasomotion, venous_pressure_pa and hand_height_m, in
    place of the fields of these names. Blood at rest holds at the mean arterial pressure."""
    recorded_time_s: tuple[float, ...] | None = None
    """The recorded times; filled from file. [s]"""
    recorded_arterial_pressure_pa: tuple[float, ...] | None = None
    """The recorded arterial pressures; filled from file. [Pa]"""
    recorded_venous_pressure_pa: tuple[float, ...] | None = None
    """The recorded venous pressures; filled from file. [Pa]"""
    recorded_hand_height_m: tuple[float, ...] | None = None
    """The recorded heights of the hand; filled from file. [m]"""

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        return with_recording(data, folder, "body", RECORDED, either=[(name,) for name in RECORDED])

    def _check(self) -> None:
        if self.recorded_time_s is None:
            return
        check_columns({"time_s": self.recorded_time_s} | self.recorded, "body.file")
        for name in self.waves if "arterial_pressure_pa" in self.recorded else ():
            raise ValueError(f"file holds the whole pressure; leave out [body.{name}], or file")
        for name in self.recorded.keys() & {"venous_pressure_pa", "hand_height_m"}:
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"file holds {name} over time; leave out {name} = {getattr(self, name):g}")

    @property
    def recorded(self) -> dict[str, tuple[float, ...]]:
        """The recorded columns beside time_s, by name."""
        columns = {name: getattr(self, f"recorded_{name}") for name in RECORDED}
        return {name: column for name, column in columns.items() if column is not None}

    @property
    def waves(self) -> dict[str, WaveTable]:
        """The waves of the arterial pressure that are given, by name."""
        return {name: table for name, table in self if isinstance(table, WaveTable)}

    @property
    def moves(self) -> bool:
        """Whether the arterial pressure changes over time, the hand's height aside."""
        return self.recorded_arterial_pressure_pa is not None or bool(self.waves)
