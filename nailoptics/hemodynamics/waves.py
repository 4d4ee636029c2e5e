"""The body's waves in the arterial pressure P_H: heartbeat, breathing, vasomotion.

`WAVES` lists them, and all studies take them from there: `simulate` and `oximeter` their pressure over time, `place`
their spectral lines, `predict` the band in which a recording shows them and the oscillator by which its filter follows
them. A further wave is one more entry here, with a stream of the seed of its own, and what users set of it is a
`WaveTable` and a field of `Body` in scene/body.py, whose name is the wave's; its band must not overlap another's, as
the filter sums their powers. `validate` compares single waves by name.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ..checks import Array, finite, not_negative, number, positive
from ..errors import InputError
from ..scene import Body
from ..statistics import seed_of

# Height, instant (fraction of a beat) and sharpness of the systolic, the reflected and the dicrotic wave: chosen so
# that their sum climbs faster than it falls and has the notch of a finger's pulse.
_PULSE_COMPONENTS = ((1.0, 0.17, 12.0), (0.55, 0.33, 8.0), (0.35, 0.55, 6.0))

# Streams of the seed.
_HEART, _BREATH, _SLOW_WAVES = range(3)
# Sines that make the slow waves: as many as make them irregular over minutes.
_SINES = 24
# Samples of one beat, whose harmonics make its variance; those beyond a tenth of them hold nothing.
BEAT_SAMPLES = 512
# Frequencies that stand for the band of the slow waves.
BAND_LINES = 16

# Intervals between beats scatter by this fraction of their mean (Nunan 2010, PACE 33:1407), each by itself.
INTERVAL_SPREAD = 0.05
# Between recordings, and slowly within one, the heart's rate differs by this part; it changes over so long. [s]
RATE_SPREAD, RATE_MEMORY_S = 0.1, 30.0
# Half the width of the band in which a harmonic lies, of the beat's rate; a harmonic is resolved where its band ends
# below this fraction of the Nyquist frequency.
HARMONIC_BAND, RESOLVED_BELOW = 0.35, 0.75
# How long a beat that is too high or too low stays so. [s]
HEIGHT_MEMORY_S = 10.0


def cardiac_pressure(
    time_s: ArrayLike,
    *,
    mean_pressure_pa: float = 1e4,
    pulse_pressure_pa: float = 2e3,
    rate_per_min: float = 70.0,
    rate_variability: float = 0.0,
    seed: int = 0,
) -> np.ndarray:
    """The arterial pressure P_H over time with a beating heart, to be given to `respond`. [Pa]

    time_s : any shape, float. [s]
    mean_pressure_pa : Average over a beat; the paper's P_H is 1e4. [Pa]
    pulse_pressure_pa : Highest minus lowest, 0 or more. [Pa]
    rate_per_min : Beats in a minute. [1/min]
    rate_variability : Standard deviation of the intervals between beats, relative to their mean, 0 to 0.2; each is
        drawn by itself, and none is off by more than three of it. 0 is a heart as even as a clock. [1]
    seed : of the intervals. The first beat begins at time 0; a longer course only adds beats.

    One beat is the sum of three smooth periodic bumps exp(s (cos(phase - phase_0) - 1)): the systolic wave, its
    reflection and the dicrotic wave, the shape of a finger's pulse (Allen 2007, Physiol. Meas. 28 R1).

    Raises: InputError if a value is not finite, the rate is not positive, the pulse is negative, or the variability is
    not in 0..0.2.
    """
    mean, pulse = number("mean_pressure_pa", mean_pressure_pa), not_negative("pulse_pressure_pa", pulse_pressure_pa)
    if not 0.0 <= rate_variability <= 0.2:
        raise InputError(f"rate_variability must lie in 0..0.2, got {rate_variability:g}; 0.05 is usual.")
    beat = _beat(np.arange(2048) / 2048.0)
    beats = finite("time_s", time_s) * positive("rate_per_min", rate_per_min) / 60.0
    phase = beats
    if rate_variability:
        most = int(np.ceil(beats.max(initial=0.0) / (1.0 - 3.0 * rate_variability))) + 1
        drawn = np.random.default_rng(seed_of(seed, _HEART)).standard_normal(most)
        starts = np.concatenate(([0.0], np.cumsum(1.0 + rate_variability * np.clip(drawn, -3.0, 3.0))))
        phase = np.where(beats < 0.0, beats, np.interp(beats, starts, np.arange(most + 1.0)))
    return mean + pulse * (_beat(phase) - beat.mean()) / np.ptp(beat)


def breathing_pressure(
    time_s: ArrayLike, *, amplitude_pa: float, rate_per_min: float = 15.0, seed: int = 0
) -> np.ndarray:
    """What the breath adds to the arterial pressure: a sine whose phase at time 0 follows from the seed. [Pa]

    time_s : any shape, float. [s] amplitude_pa : Half of top to bottom. [Pa]
    """
    phase = np.random.default_rng(seed_of(seed, _BREATH)).random()
    return amplitude_pa * np.sin(2.0 * np.pi * (np.asarray(time_s, float) * rate_per_min / 60.0 + phase))


def vasomotion_pressure(
    time_s: ArrayLike, *, amplitude_pa: float, band_hz: tuple[float, float] = (0.05, 0.15), seed: int = 0
) -> np.ndarray:
    """What the slow waves of the vessels' tone add to the arterial pressure: noise of a band of frequencies. [Pa]

    time_s : any shape, float. [s]
    amplitude_pa : Standard deviation. [Pa]
    band_hz : Lowest and highest frequency. [Hz]
    seed : of the waves: sines of equal height whose frequencies are spread at random over equal parts of the band.
    """
    time = np.asarray(time_s, float)
    rng = np.random.default_rng(seed_of(seed, _SLOW_WAVES))
    low, high = band_hz
    frequencies = low + (high - low) * (np.arange(_SINES) + rng.random(_SINES)) / _SINES
    sines = (np.sin(2.0 * np.pi * (f * time + phase)) for f, phase in zip(frequencies, rng.random(_SINES), strict=True))
    return amplitude_pa * np.sqrt(2.0 / _SINES) * np.asarray(sum(sines))


def _beat(phase: np.ndarray) -> np.ndarray:
    """The pulse before it is scaled, from the phase in beats."""
    bumps = (h * np.exp(sharp * (np.cos(2.0 * np.pi * (phase - at)) - 1.0)) for h, at, sharp in _PULSE_COMPONENTS)
    return np.asarray(sum(bumps))


Lines = tuple[Array, Array]


def _cardiac_lines(*, pulse_pressure_pa: float, rate_per_min: float, **_: Any) -> Lines:
    """That hearts beat unevenly widens their lines by less than the vessels' gain changes over them."""
    period_s = 60.0 / rate_per_min
    times_s = period_s * np.arange(BEAT_SAMPLES) / BEAT_SAMPLES
    beat = cardiac_pressure(times_s, pulse_pressure_pa=pulse_pressure_pa, rate_per_min=rate_per_min)
    return spectral_lines(beat, duration_s=period_s)


def _vasomotion_lines(*, amplitude_pa: float, band_hz: tuple[float, float]) -> Lines:
    low, high = band_hz
    middles = low + (high - low) * (np.arange(BAND_LINES) + 0.5) / BAND_LINES
    return middles, np.full(BAND_LINES, amplitude_pa**2 / BAND_LINES)


@dataclass(frozen=True)
class Wave:
    """A wave of the body; every function takes the fields of its table in a scene's [body].

    name : of that table.
    pressure_pa : its pressure over time about a mean of 0, of times [s], a seed and the fields. [Pa]
    lines : its frequencies [Hz] and the variance of each [Pa^2].
    fastest_hz : the highest frequency at which it repeats itself.
    band_hz : where adults at rest have it. [Hz]
    coherence_s : how long it keeps its phase; None for the heartbeat, whose harmonics `CardiacOscillator` follows.
    """

    name: str
    pressure_pa: Callable[..., Array]
    lines: Callable[..., Lines]
    fastest_hz: Callable[..., float]
    band_hz: tuple[float, float]
    coherence_s: float | None


HEARTBEAT = Wave(
    name="heartbeat",
    pressure_pa=lambda time_s, **fields: cardiac_pressure(time_s, mean_pressure_pa=0.0, **fields),
    lines=_cardiac_lines,
    fastest_hz=lambda rate_per_min, **_: rate_per_min / 60.0,
    band_hz=(0.7, 3.0),
    coherence_s=None,
)
BREATHING = Wave(
    name="breathing",
    pressure_pa=breathing_pressure,
    lines=lambda amplitude_pa, rate_per_min: (np.array([rate_per_min / 60.0]), np.array([amplitude_pa**2 / 2])),
    fastest_hz=lambda rate_per_min, **_: rate_per_min / 60.0,
    band_hz=(0.15, 0.5),
    coherence_s=8.0,  # breaths scatter by some 10 %
)
VASOMOTION = Wave(
    name="vasomotion",
    pressure_pa=vasomotion_pressure,
    lines=_vasomotion_lines,
    fastest_hz=lambda band_hz, **_: band_hz[1],
    band_hz=(0.03, 0.15),
    coherence_s=4.0,  # slow waves come and go
)
WAVES = (HEARTBEAT, BREATHING, VASOMOTION)
# What tables of [body] hold beside the wave in P_H.
NO_WAVE = {"mean_pressure_pa", "arterial_pulse_pressure_pa", "arteriolar_blood_fraction", "arteriolar_peak_pa"}


def waves_of(body: Body) -> list[tuple[Wave, dict[str, Any]]]:
    """The waves that a scene's body has, each with the fields of its table."""
    return [(wave, body.waves[wave.name].model_dump(exclude=NO_WAVE)) for wave in WAVES if wave.name in body.waves]


def fastest_hz(body: Body) -> float:
    """The highest frequency at which a wave of a body repeats itself; 0 without any. [Hz]"""
    return max((wave.fastest_hz(**fields) for wave, fields in waves_of(body)), default=0.0)


def waves_pressure(body: Body, time_s: Array, *, mean_pressure_pa: float, pulse_ratio: float = 1.0) -> Array:
    """The arterial pressure by all waves of a body about a mean, (t,) float; a recorded one is not in it. [Pa]

    pulse_ratio : amplitude of the heartbeat over that in P_H.
    """
    pressure_pa = np.full(time_s.shape, mean_pressure_pa)
    for wave, fields in waves_of(body):
        ratio = pulse_ratio if wave is HEARTBEAT else 1.0
        pressure_pa = pressure_pa + ratio * wave.pressure_pa(time_s, seed=body.seed, **fields)
    return pressure_pa


def pressure_lines(body: Body) -> Lines:
    """The arterial pressure of a body that moves as lines: frequencies (F,) and variances (F,). [Hz], [Pa^2]"""
    if body.recorded_time_s and body.recorded_arterial_pressure_pa:
        time_s, pressure_pa = np.array(body.recorded_time_s), np.array(body.recorded_arterial_pressure_pa)
        even_s = np.linspace(time_s[0], time_s[-1], 2 * len(time_s))
        return spectral_lines(np.interp(even_s, time_s, pressure_pa), duration_s=time_s[-1] - time_s[0])
    lines = [wave.lines(**fields) for wave, fields in waves_of(body)]
    frequency_hz, variance_pa2 = (np.concatenate(parts) for parts in zip(*lines, strict=True))
    return frequency_hz, variance_pa2


def spectral_lines(pressure_pa: Array, *, duration_s: float) -> Lines:
    """Frequencies and variances of a pressure that is sampled evenly over a duration."""
    height, order = np.fft.rfft(pressure_pa)[1:] / len(pressure_pa), np.arange(1, len(pressure_pa) // 2 + 1)
    # All but the Nyquist frequency stand for their negative, too.
    return order / duration_s, np.where(2 * order < len(pressure_pa), 2.0, 1.0) * np.abs(height) ** 2


@dataclass(frozen=True)
class DampedOscillator:
    """State-space model of a wave for a filter: a damped oscillator driven by noise, of two states in Pa.

    frequency_hz : where its power lies. coherence_s : how long it keeps its phase. rms_pa : its strength.
    """

    frequency_hz: Annotated[float, Field(gt=0, lt=100)]
    coherence_s: Annotated[float, Field(gt=0, lt=1e6)]
    rms_pa: Annotated[float, Field(ge=0, lt=1e5)]

    def propagate(self, step_s: float) -> tuple[Array, float]:
        """Transition (2, 2) over a step, and the variance of the process noise of either state. [Pa^2]"""
        angle, decay = 2 * np.pi * self.frequency_hz * step_s, np.exp(-step_s / self.coherence_s)
        rotation = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return decay * np.array(rotation), float((1 - decay**2) * self.rms_pa**2)


def slow_waves(frequency_hz: Array, variance_pa2: Array) -> list[DampedOscillator]:
    """Oscillators for breathing and vasomotion, of the variance (n,) [Pa^2] at frequencies (n,) [Hz] in either band."""
    near = [(wave, (frequency_hz >= wave.band_hz[0]) & (frequency_hz < wave.band_hz[1])) for wave in WAVES]
    return oscillators((wave, (frequency_hz[at], variance_pa2[at])) for wave, at in near)


def oscillators(lines: Iterable[tuple[Wave, Lines]]) -> list[DampedOscillator]:
    """One oscillator of each slow wave, of all the variance in its lines; none of one without any."""
    out = []
    for wave, (frequency_hz, variance_pa2) in lines:
        if wave.coherence_s is not None and (total := float(variance_pa2.sum())) > 0:
            out.append(DampedOscillator(float(frequency_hz @ variance_pa2) / total, wave.coherence_s, total**0.5))
    return out


def resolved_harmonics(rate_hz: float, count: int, nyquist_hz: float) -> NDArray[np.bool_]:
    """Which of so many harmonics of a heart's rate samples resolve, whose Nyquist frequency is given."""
    return np.asarray((np.arange(1, 1 + count) + HARMONIC_BAND) * rate_hz < RESOLVED_BELOW * nyquist_hz)


@dataclass(frozen=True)
class CardiacOscillator:
    """State-space model of the heartbeat for a filter: harmonics that keep their height while their phase drifts.

    rate_hz : beats in a second. rms_pa : of each harmonic. spread : relative standard deviation of their heights.
    """

    rate_hz: Annotated[float, Field(ge=0.1, le=10)]
    rms_pa: tuple[Annotated[float, Field(ge=1e-3, le=1e5)], ...]
    spread: Annotated[float, Field(ge=1e-3, le=1)]

    @property
    def size(self) -> int:
        """Number of its states: logarithm of the rate over its mean, then two of each harmonic [Pa]."""
        return 1 + 2 * len(self.rms_pa)

    def resolved_harmonics(self, step_s: float) -> NDArray[np.bool_]:
        """Which harmonics samples so far apart resolve."""
        return resolved_harmonics(self.rate_hz, len(self.rms_pa), 0.5 / step_s)

    def propagate(self, state: Array, step_s: float) -> tuple[Array, Array, Array]:
        """The state (size,) after a step [s], its Jacobian, and the covariance of the process noise, (size, size) each.

        Each harmonic turns, and its height r returns to the usual one h, a limit cycle: dr/dt = r (1 - r^2/h^2) / 2 t,
        solved over the step, so that none is ever thrown further off.
        """
        order, height2 = np.arange(1, len(self.rms_pa) + 1), 2.0 * np.square(self.rms_pa)
        turn = 2 * np.pi * self.rate_hz * np.exp(state[0]) * step_s * order
        rotation, before = np.exp(1j * turn), state[1::2] + 1j * state[2::2]
        forgotten, part = -np.expm1(-step_s / HEIGHT_MEMORY_S), np.abs(before) ** 2 / height2
        growth = 1.0 / np.sqrt(1.0 + (part - 1.0) * forgotten)
        turned, shrunk = rotation * growth, rotation * growth**3 * forgotten / height2 * before
        jacobian, first = np.zeros((self.size, self.size)), 1 + 2 * np.arange(len(order))
        jacobian[0, 0] = decay = np.exp(-step_s / RATE_MEMORY_S)
        for j, column in enumerate((turned - shrunk * before.real, 1j * turned - shrunk * before.imag)):
            jacobian[first, first + j], jacobian[first + 1, first + j] = column.real, column.imag
        after, across = (turned * before).view(float), (1j * turned * before).view(float)
        jacobian[1:, 0] = np.repeat(turn, 2) * across
        # All harmonics belong to one beat: when it is late, all are.
        late = np.concatenate([[0.0], np.repeat(order, 2) * across])
        phase_variance = (2 * np.pi * INTERVAL_SPREAD) ** 2 * self.rate_hz * step_s
        added = np.concatenate([[(1 - decay**2) * RATE_SPREAD**2], np.repeat(forgotten * self.spread**2 * height2, 2)])
        noise = phase_variance * np.outer(late, late) + np.diag(added)
        return np.concatenate([[decay * state[0]], after]), jacobian, noise
