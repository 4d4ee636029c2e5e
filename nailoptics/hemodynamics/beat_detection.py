"""Beat detection: the rate of a pulse waveform by its autocorrelation, and the time of each beat."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import Array
from ..errors import InputError

Marks = NDArray[np.bool_]

# What a heart can do. [1/min]
SLOWEST, FASTEST = 30.0, 240.0
LEAST_BEATS = 3
# A pulse's shape lies in this band, its lower end below the slowest rate. [Hz]
BAND_HZ = (0.4, 8.0)
# The least correlation of a waveform with itself a beat later.
LEAST_CORRELATION = 0.15
# A recording is searched for its rate in parts of about so long. [s]
PART_S = 8.0
# A beat whose height is more than this many times the usual one, or less than its inverse, is no usual one.
MOST_HEIGHT = 2.0


@dataclass(frozen=True)
class Beats:
    """Beats of a recording.

    peak_s : (n,) float. When the blood is at its most. [s]
    rate_per_min : over all of it, from the median interval of beats that follow each other.
    usual : (n,) bool. Whether a beat has about the height and interval of the others.
    """

    peak_s: Array
    rate_per_min: float
    usual: Marks

    def rate_at(self, time_s: float, within_s: float) -> float:
        """Rate in a window around a time, from the median of its usual intervals; NaN without two. [1/min]"""
        return _rate(self.peak_s, self.usual & (np.abs(self.peak_s - time_s) <= within_s / 2))


def find_beats(time_s: ArrayLike, signal: ArrayLike, name: str = "the recording") -> Beats:
    """Find the beats of a pulse waveform that rises with the blood, as a plethysmogram does.

    time_s, signal : (T,) float, evenly sampled or nearly; any unit. NaN in gaps.

    Raises: InputError where there are fewer than three beats, or no heartbeat.
    """
    from scipy.signal import find_peaks

    even_s, wave, rate_hz, expected_hz = _periodic(time_s, signal, name)
    gap = max(int(0.55 * rate_hz / expected_hz), 1)
    swing = float(np.median([np.ptp(part) for part in np.array_split(wave, max(1, int(len(wave) / (2 * gap))))]))
    peaks, properties = find_peaks(wave, distance=gap, prominence=0.3 * swing)
    if len(peaks) < LEAST_BEATS:
        raise InputError(f"{name}: holds {len(peaks)} beats; at least {LEAST_BEATS} are needed, record longer.")
    peak_s = even_s[0] + _summits(wave, peaks) / rate_hz
    height, interval = properties["prominences"] / np.median(properties["prominences"]), np.diff(peak_s)
    middle = float(np.median(interval))
    even = np.abs(interval - middle) < 0.35 * middle
    usual = (height < MOST_HEIGHT) & (height > 1 / MOST_HEIGHT) & (np.append(even, True) | np.insert(even, 0, True))
    return Beats(peak_s, _rate(peak_s, usual), usual)


def beats_per_second(time_s: ArrayLike, signal: ArrayLike) -> float:
    """The rate of a waveform in which a heart beats, from its autocorrelation. [Hz]

    time_s, signal, raises : as `find_beats`.
    """
    return _periodic(time_s, signal, "the recording")[-1]


def _periodic(time_s: ArrayLike, signal: ArrayLike, name: str) -> tuple[Array, Array, float, float]:
    """Even times, the waveform in the pulse's band, its sampling rate [Hz] and the heart's [Hz]."""
    from scipy.signal import find_peaks

    even_s, values, rate_hz = resampled(np.asarray(time_s, float), np.asarray(signal, float), name)
    wave = band(values, rate_hz)
    # The lag at which the waveform repeats itself best. Parts of the recording count alike, so that motion in one of
    # them does not decide.
    parts = np.array_split(wave, max(1, int(len(wave) / (PART_S * rate_hz))))
    longest = min(int(np.ceil(60 * rate_hz / SLOWEST)), min(len(part) for part in parts) // 2)
    lags = np.arange(int(60 * rate_hz / FASTEST), longest)
    if not len(lags):
        raise InputError(f"{name}: is too short for three beats; record longer.")
    correlation = np.median([_autocorrelation(part, longest) for part in parts], axis=0)
    inner = lags[np.isin(lags, find_peaks(correlation)[0])]
    inner = inner if len(inner) else lags[[np.argmax(correlation[lags])]]
    # Two periods correlate as well as one: the first lag that is nearly as good is one beat.
    first = int(inner[np.argmax(correlation[inner] > 0.7 * correlation[inner].max())])
    if correlation[first] < LEAST_CORRELATION and len(wave) < LEAST_BEATS * 60 * rate_hz / SLOWEST:
        raise InputError(f"{name}: no three beats were found in {len(wave) / rate_hz:.3g} s; record longer.")
    if correlation[first] < LEAST_CORRELATION:
        raise InputError(f"{name}: no heartbeat was found in it; check the finger and the light.")
    return even_s, wave, rate_hz, float(rate_hz / _summits(correlation, np.array([first]))[0])


def resampled(time_s: Array, signal: Array, name: str) -> tuple[Array, Array, float]:
    """Evenly spaced times [s] and values, (n,) float each, over a recording, and their rate [Hz]; gaps are bridged.

    time_s, signal, raises : as `find_beats`.
    """
    there = np.isfinite(signal)
    length_s, least_s = float(time_s[-1] - time_s[0]), LEAST_BEATS * 60.0 / FASTEST
    if there.sum() < 8 or length_s < least_s:
        raise InputError(f"{name}: lasts {length_s:.3g} s; three beats are needed, record some seconds.")
    rate_hz = 1.0 / float(np.median(np.diff(time_s)))
    if rate_hz < 2 * FASTEST / 60.0:
        raise InputError(f"{name}: has {rate_hz:.3g} samples in a second; give 20 or more to see a pulse.")
    even_s = time_s[0] + np.arange(int(length_s * rate_hz + 1e-6) + 1) / rate_hz
    return even_s, np.interp(even_s, time_s[there], signal[there]), rate_hz


def upper_hz(rate_hz: float) -> float:
    """Upper edge of the band of samples of this rate, below half of it. [Hz]"""
    return min(BAND_HZ[1], 0.45 * rate_hz)


def band(values: Array, rate_hz: float, low_hz: float = BAND_HZ[0]) -> Array:
    """Evenly sampled values, (..., T) float, after a zero-phase Butterworth band-pass along the last axis."""
    from scipy import signal

    filtered = signal.butter(2, (low_hz, upper_hz(rate_hz)), btype="bandpass", fs=rate_hz, output="sos")
    pad = min(values.shape[-1] - 1, int(3 * rate_hz / low_hz))
    return np.asarray(signal.sosfiltfilt(filtered, values, axis=-1, padtype="odd", padlen=pad))


def _autocorrelation(wave: Array, longest: int) -> Array:
    """Correlation of a waveform with itself at lags up to the longest, 1 at lag 0, (longest + 1,) float."""
    held = wave - wave.mean()
    product = np.fft.irfft(np.abs(np.fft.rfft(held, 2 * len(held))) ** 2)[: longest + 1]
    overlap = 1.0 - np.arange(longest + 1) / len(held)
    return np.asarray(product / max(product[0], np.finfo(float).tiny) / overlap)


def _summits(wave: Array, peaks: NDArray[np.intp]) -> Array:
    """Places of peaks between samples, by a parabola through three."""
    before, at, after = wave[peaks - 1], wave[peaks], wave[np.minimum(peaks + 1, len(wave) - 1)]
    bend = before - 2 * at + after
    step = np.divide(0.5 * (before - after), bend, out=np.zeros_like(at), where=bend < 0)
    return np.asarray(peaks + np.clip(step, -0.5, 0.5))


def _rate(peak_s: Array, usual: Marks) -> float:
    """Beats in a minute from intervals between usual beats that follow each other. [1/min]"""
    intervals = np.diff(peak_s)[usual[1:] & usual[:-1]]
    if len(intervals) == 0:
        return float("nan")
    # One that was missed makes an interval of two.
    middle = np.median(intervals)
    return float(60.0 / intervals[np.abs(intervals - middle) < 0.35 * middle].mean())
