"""What moves the arterial pressure: the heart's beat, the breath, and the slow waves of the vessels' tone."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError
from ..statistics import seed_of

# Height, instant (part of a beat) and sharpness of the systolic, the reflected and the dicrotic wave: chosen so that
# their sum climbs faster than it falls and has the notch of a finger's pulse.
_WAVES = ((1.0, 0.17, 12.0), (0.55, 0.33, 8.0), (0.35, 0.55, 6.0))

MOST_VARIABILITY = 0.2
# Streams of the seed.
_HEART, _BREATH, _SLOW_WAVES = range(3)
# Sines that make the slow waves: as many as make them irregular over minutes.
_LINES = 24


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
    time = finite("time_s", time_s)
    mean = number("mean_pressure_pa", mean_pressure_pa)
    pulse = number("pulse_pressure_pa", pulse_pressure_pa)
    rate = number("rate_per_min", rate_per_min)
    if rate <= 0.0:
        raise InputError(f"rate_per_min must be greater than 0, got {rate:g}; 70 is usual.")
    if pulse < 0.0:
        raise InputError(f"pulse_pressure_pa must be 0 or more, got {pulse:g}; give 0 for a steady pressure.")
    variability = number("rate_variability", rate_variability)
    if not 0.0 <= variability <= MOST_VARIABILITY:
        raise InputError(f"rate_variability must lie in 0..{MOST_VARIABILITY:g}, got {variability:g}; 0.05 is usual.")
    beat = _beat(np.arange(2048) / 2048.0)
    beats = time * rate / 60.0
    phase = _uneven(beats, variability, seed) if variability else beats
    return mean + pulse * (_beat(phase) - beat.mean()) / np.ptp(beat)


def breathing_pressure(
    time_s: ArrayLike, *, amplitude_pa: float, rate_per_min: float = 15.0, seed: int = 0
) -> np.ndarray:
    """What the breath adds to the arterial pressure: a sine whose phase at time 0 follows from the seed. [Pa]

    time_s : any shape, float. [s]
    amplitude_pa : Half of top to bottom. [Pa]
    rate_per_min : Breaths in a minute. [1/min]
    """
    phase = np.random.default_rng(seed_of(seed, _BREATH)).random()
    return amplitude_pa * np.sin(2.0 * np.pi * (finite("time_s", time_s) * rate_per_min / 60.0 + phase))


def vasomotion_pressure(
    time_s: ArrayLike, *, amplitude_pa: float, band_hz: tuple[float, float] = (0.05, 0.15), seed: int = 0
) -> np.ndarray:
    """What the slow waves of the vessels' tone add to the arterial pressure: noise of a band of frequencies. [Pa]

    time_s : any shape, float. [s]
    amplitude_pa : Standard deviation. [Pa]
    band_hz : Lowest and highest frequency. [Hz]
    seed : of the waves: sines of equal height whose frequencies are spread at random over equal parts of the band.
    """
    time = finite("time_s", time_s)
    rng = np.random.default_rng(seed_of(seed, _SLOW_WAVES))
    low, high = band_hz
    frequencies = low + (high - low) * (np.arange(_LINES) + rng.random(_LINES)) / _LINES
    waves = np.zeros_like(time)
    for frequency, phase in zip(frequencies, rng.random(_LINES), strict=True):
        waves += np.sin(2.0 * np.pi * (frequency * time + phase))
    return amplitude_pa * np.sqrt(2.0 / _LINES) * waves


def _uneven(beats: np.ndarray, variability: float, seed: int) -> np.ndarray:
    """The phase of a heart whose beats have random intervals, from the time in mean intervals."""
    most = int(np.ceil(beats.max(initial=0.0) / (1.0 - 3.0 * variability))) + 1
    drawn = np.random.default_rng(seed_of(seed, _HEART)).standard_normal(most)
    intervals = 1.0 + variability * np.clip(drawn, -3.0, 3.0)
    starts = np.concatenate(([0.0], np.cumsum(intervals)))
    return np.where(beats < 0.0, beats, np.interp(beats, starts, np.arange(most + 1.0)))


def _beat(phase: np.ndarray) -> np.ndarray:
    """The pulse before it is scaled, from the phase in beats."""
    waves = [height * np.exp(sharp * (np.cos(2.0 * np.pi * (phase - at)) - 1.0)) for height, at, sharp in _WAVES]
    return sum(waves, start=np.zeros_like(phase))
