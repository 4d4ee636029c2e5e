"""What moves a person's readings beside the touch, learned from what a fit leaves over."""

import itertools
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...errors import InputError
from ...hemodynamics.beat_detection import beats_per_second
from ...hemodynamics.steady import linear_response
from ...hemodynamics.waves import HARMONIC_BAND, WAVES, CardiacOscillator, DampedOscillator, resolved_harmonics
from ...scene.importers.sensor_recordings import Recording
from .person import Person, widths_over
from .reading_table import ReadingTable
from .state_space import Noise

Array = NDArray[np.float64]

# Harmonics of the beat that carry a pulse's shape; a beat weaker than this is none. [Pa]
HARMONICS, LEAST_BEAT_PA = 5, 40.0
# By how much the heights of beats vary, of themselves.
HEIGHT_SPREAD = 0.1
# The highest part of a spectrum, where all is noise of the readings.
NOISE_FROM = 0.75
# A step of arterial pressure by which its effect is found. [Pa]
STEP_PA = 100.0
# How far the arterial pressure and an LED's light wander at most, rms: where readings do not part them, a little of
# both is likelier than much of both, one against the other. [Pa, 1]
PRESSURE_SPREAD_PA, LIGHT_SPREAD = 3000.0, 0.03
# A rhythm with less gain than this is not seen well enough to be scaled by it.
LEAST_GAIN = 0.05
# A finger rests below this force. Drift is seen from one rest to a later one: touches leave the model's own misfit. [N]
REST_FORCE_N = 0.05
# Drift in a minute of a reading and of an LED where a recording has one rest only, and the least that is believed.
USUAL_DRIFT, USUAL_LED_DRIFT, LEAST_DRIFT = 1e-3, 2e-3, 1e-4
# The misfit of a held touch is taken for a polynomial of this degree in the force.
MISFIT_DEGREE = 4
# Spectra are of windows as long as two of the slowest waves. [s]
WINDOW_S = 40.0
# How fast touches are expected to change: a force that wanders by this in a second, and ten times as much while it
# steps. Chosen on the virtual people: three times as fast takes more of the body's waves for touches.
# [N/cm^2 / sqrt(s)]
TOUCH_RATE = 0.1
# Nobody's readings quite follow the blood of two zones: while it moves they are off by so much of every change, while a
# touch is held by so much of their distance from rest. Chosen on the virtual people, and on light known to 2 %: without
# the first a touch let go past closure leads the filter far astray, without the second one that was held stays. [1]
MOVED_ERROR, HELD_ERROR = 0.03, 0.01


def arterial_response(person: Person, table: ReadingTable, gain: Array, recording: Recording) -> Array:
    """Change of every reading with a slow change of arterial pressure, over a touch, (R, T) float. [V/Pa]"""
    assert recording.force_n is not None and recording.site is not None
    high = person.arterial_pa + STEP_PA * np.array([-0.5, 0.5])
    pressure = np.repeat(person.pressures(recording.force_n, recording.site)[:, None], 2, axis=1)
    start = replace(person, rest_m=np.repeat(person.rest_m[:, None], 2, axis=1))
    blood = person.blood(widths_over(start, recording.time_s, pressure, arterial_pa=high[:, None]))
    volts = gain[:, None, None] * table.volts(blood)
    return np.asarray((volts[:, 1] - volts[:, 0]) / STEP_PA)


def pressure_to_blood_gain(person: Person, frequency_hz: float) -> float:
    """Gain from a wave of the arterial pressure to the blood of both zones at rest, over that of a slow one. [1]

    The vessels are sluggish, so that a heartbeat moves them less than a breath.
    """
    ends = np.array([person.arterial_pa]), np.array([person.venous_pa])
    gain = linear_response(person.walls, np.array([0.0, frequency_hz]), np.zeros((3, 1)), *ends)
    slow, fast = np.abs((gain[:2] / person.rest_m[:2, None]).sum(0))
    return float(fast / slow)


def learn_noise(
    person: Person,
    table: ReadingTable,
    gain: Array,
    recordings: Sequence[Recording],
    residual_v: Sequence[Array],
    rest_v: Array,
) -> Noise:
    """Noise of each reading, drift, and the rhythms of the arterial pressure, from the residuals (R, T) of recordings.

    rest_v : (R,) float. Readings at rest. [V]
    """
    white = np.maximum(np.median([_white(one) for one in residual_v], axis=0), gain * table.noise_v)
    leds = table.same_led() * rest_v[:, None]
    spectra, own2, led2, spans, rates_hz = [], [], [], [], []
    for recording, residual in zip(recordings, residual_v, strict=True):
        response = arterial_response(person, table, gain, recording)
        step = float(np.median(np.diff(recording.time_s)))
        pressure, light, left = _decompose(response, leds, residual, white**2 + (1e-3 * rest_v) ** 2)
        # What follows the force is the model's misfit, not the body's.
        force_n = np.asarray(recording.force_n)
        degree = min(MISFIT_DEGREE, len(np.unique(force_n)) - 1)
        pressure -= np.polynomial.Polynomial.fit(force_n, pressure, degree)(force_n)
        window = min(len(pressure), round(WINDOW_S / step))
        spectra.append(signal.welch(pressure, fs=1.0 / step, nperseg=window, detrend="constant"))
        spans.append(len(pressure))
        with suppress(InputError):  # no heartbeat in it
            rates_hz.append(beats_per_second(recording.time_s, pressure))
        # A reading's own drift lies where neither pressure nor LED took it along.
        seen = len(left) / max(len(left) - 1 - leds.shape[1], 1)
        untouched = force_n < REST_FORCE_N
        own2 += [seen * one for one in _random_walk_variance(left / rest_v[:, None], recording.time_s, untouched)]
        led2 += _random_walk_variance(light, recording.time_s, untouched)
    frequency = spectra[int(np.argmax(spans))][0]
    power = np.mean([np.interp(frequency, *one) for one in spectra], axis=0)
    power = np.maximum(power - np.median(power[frequency > NOISE_FROM * frequency[-1]]), 0.0)
    drift, led_drift = (
        max(float(np.sqrt(np.mean(one))), LEAST_DRIFT) if one else usual
        for one, usual in ((own2, USUAL_DRIFT), (led2, USUAL_LED_DRIFT))
    )
    slow = [
        # What was seen is what the vessels passed on.
        replace(one, rms_pa=one.rms_pa / max(pressure_to_blood_gain(person, one.frequency_hz), LEAST_GAIN))
        for one in _rhythms(frequency, power)
    ]
    beat = _cardiac_oscillator(float(np.median(rates_hz)), frequency, power) if rates_hz else None
    return Noise(white, drift, led_drift, beat, tuple(slow), TOUCH_RATE, MOVED_ERROR, HELD_ERROR)


def _decompose(response: Array, leds: Array, residual: Array, noise_v2: Array) -> tuple[Array, Array, Array]:
    """Residuals (R, T) as the arterial pressure (T,) [Pa], the light of each LED (L, T) [1], and what is left (R, T).

    response : (R, T) float, of every reading to the pressure. leds : (R, L) float, to the light. noise_v2 : (R,) float.
    """
    filled = np.where(np.isfinite(residual), residual, 0.0)
    design = np.concatenate([response.T[:, :, None], np.broadcast_to(leds, (response.shape[1], *leds.shape))], axis=2)
    weighted = design / noise_v2[:, None]
    normal = np.einsum("trp,trq->tpq", weighted, design)
    strength = normal[:, 0, 0]
    # Where a touch has all but shut the vessels the arterial pressure is not seen: there it is taken for none.
    normal[:, 0, 0] += np.where(strength > 0.01 * strength.max(), PRESSURE_SPREAD_PA**-2, 1e9 * strength.max())
    light = np.arange(1, design.shape[2])
    normal[:, light, light] += LIGHT_SPREAD**-2
    found = np.linalg.solve(normal, np.einsum("trp,rt->tp", weighted, filled)[..., None])[..., 0]
    return found[:, 0], found[:, 1:].T, filled - np.einsum("trp,tp->rt", design, found)


def _random_walk_variance(drifting: Array, time_s: Array, untouched: NDArray[np.bool_]) -> list[float]:
    """Variances that random walks (N, T) gain in a minute, from each rest to the next."""
    ends = np.flatnonzero(np.diff(np.r_[False, untouched, False]))
    rests = [slice(start, stop) for start, stop in ends.reshape(-1, 2) if stop - start > 1]
    means = [(time_s[rest].mean(), drifting[:, rest].mean(1)) for rest in rests]
    return [
        float(np.mean((later - before) ** 2) * 60.0 / (end - start))
        for (start, before), (end, later) in itertools.pairwise(means)
    ]


def _cardiac_oscillator(rate_hz: float, frequency: Array, power: Array) -> CardiacOscillator | None:
    """The heartbeat of a rate in a spectrum of the arterial pressure [Pa^2/Hz]; None where it is too weak."""

    def rms_pa(middle: float, half: float) -> float:
        return float(np.sqrt(np.trapezoid(power * (np.abs(frequency - middle) < half), frequency)))

    orders = 1 + np.flatnonzero(resolved_harmonics(rate_hz, HARMONICS, frequency[-1]))
    heights = [rms_pa(k * rate_hz, HARMONIC_BAND * rate_hz) for k in orders]
    if not orders.size or np.hypot.reduce(heights) < LEAST_BEAT_PA:
        return None
    return CardiacOscillator(rate_hz, tuple(max(one, 0.01 * max(heights)) for one in heights), HEIGHT_SPREAD)


def _rhythms(frequency: Array, power: Array) -> tuple[DampedOscillator, ...]:
    """Oscillators with the power of the slow waves' bands in a spectrum of the arterial pressure [Pa^2/Hz]."""
    width, rhythms = frequency[1] - frequency[0], []
    for wave in WAVES:
        if wave.coherence_s is None:
            continue
        near = (frequency >= wave.band_hz[0]) & (frequency < wave.band_hz[1])
        if near.any() and power[near].sum() > 0:
            middle = float((frequency[near] * power[near]).sum() / power[near].sum())
            rhythms.append(DampedOscillator(middle, wave.coherence_s, float(np.sqrt(power[near].sum() * width))))
    return tuple(rhythms)


def _white(residual: Array) -> Array:
    """White noise of each row, rms: from third differences, which take out what moves slowly."""
    # Robust: the median of |x| of a Gaussian is 0.6745 of its standard deviation; third differences have 20 variances.
    # Across a gap they are those of the samples beside it.
    third = [np.median(np.abs(np.diff(row[np.isfinite(row)], n=3))) for row in residual]
    return np.array(third) / 0.6745 / np.sqrt(20.0)
