"""What moves a person's readings beside the touch, estimated from the residuals of a fit."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...hemodynamics.beat_detection import beats_per_second
from ...hemodynamics.steady import linear_response
from ...hemodynamics.waves import HARMONIC_BAND, CardiacOscillator, resolved_harmonics, slow_waves
from ...scene.importers.sensor_recordings import Recording
from ...statistics import MEDIAN_OF_GAUSSIAN
from .person import Array, Person
from .reading_table import ReadingTable
from .scores import runs
from .subject import NOISE_S, Noise

# Harmonics of the beat that carry a pulse's shape; a beat weaker than this is none: judgement. [Pa]
HARMONICS, LEAST_BEAT_PA = 5, 40.0
# By how much the heights of beats vary, of themselves: judgement.
HEIGHT_SPREAD = 0.1
# The highest part of a spectrum, where all is noise of the readings.
NOISE_FROM = 0.75
# A step of arterial pressure by which its effect is computed. [Pa]
STEP_PA = 100.0
# How far the arterial pressure and an LED's light wander at most, rms: where readings do not separate them, a little of
# both is likelier than much of both, one against the other. [Pa, 1]
PRESSURE_SPREAD_PA, LIGHT_SPREAD = 3000.0, 0.03
# Readings show too little of a wave with less gain than this to be scaled by it: judgement.
LEAST_GAIN = 0.05
# A finger rests below this force. Drift is taken from one rest to a later one: touches leave the model's error. [N]
REST_FORCE_N = 0.05
# Drift in a minute of a reading and of an LED where a recording has one rest only, and the least that is believed.
USUAL_DRIFT, USUAL_LED_DRIFT, LEAST_DRIFT = 1e-3, 2e-3, 1e-4
# The model error of a held touch is taken for a polynomial of this degree in the force.
MODEL_ERROR_DEGREE = 4
# Spectra are of windows as long as two of the slowest waves. [s]
WINDOW_S = 40.0


def arterial_response(person: Person, table: ReadingTable, gain: Array, recording: Recording) -> Array:
    """Change of every reading with a slow change of arterial pressure, over a touch, (R, T) float. [V/Pa]"""
    assert recording.force_n is not None and recording.site is not None
    high = person.arterial_pa + STEP_PA * np.array([-0.5, 0.5])
    pressure_n_per_cm2 = np.repeat(person.pressures_n_per_cm2(recording.force_n, recording.site)[:, None], 2, axis=1)
    both = replace(person, rest_m=np.repeat(person.rest_m[:, None], 2, axis=1))
    blood = person.blood(both.diameters_over(recording.time_s, pressure_n_per_cm2, arterial_pa=high[:, None]))
    volts = gain[:, None, None] * table.volts(blood)
    return np.asarray((volts[:, 1] - volts[:, 0]) / STEP_PA)


def pressure_to_blood_gain(person: Person, frequency_hz: float) -> float:
    """Gain from a wave of the arterial pressure to the blood of both zones at rest, over that of a slow one. [1] The
    vessels are sluggish, so that a heartbeat moves them less than a breath."""
    ends = np.array([person.arterial_pa]), np.array([person.venous_pa])
    gain = linear_response(person.walls, np.array([0.0, frequency_hz]), np.zeros((3, 1)), *ends)
    slow, fast = np.abs((gain[:2] / person.rest_m[:2, None]).sum(0))
    return float(fast / slow)


def estimate_noise(
    person: Person,
    table: ReadingTable,
    gain: Array,
    recordings: Sequence[Recording],
    residual_v: Sequence[Array],
    rest_v: Array,
) -> tuple[Array, Noise]:
    """White noise of each reading (R,) [V]; drift and waves of the arterial pressure. From residuals (R, T) each.

    rest_v : (R,) float. Readings at rest. [V]
    """
    from scipy.signal import welch

    # Samples whose mean has the noise that is stated.
    group = max(1, round(NOISE_S / float(np.median(np.diff(recordings[0].time_s)))))
    least_v = gain * table.noise_v / np.sqrt(group)
    first_v = np.maximum(np.median([_white(residuals, 1) for residuals in residual_v], axis=0), gain * table.noise_v)
    leds = table.same_led() * rest_v[:, None]
    white_v, spectra, reading_drift2, led_drift2, rates_hz = [], [], [], [], []
    for recording, residual in zip(recordings, residual_v, strict=True):
        time_s, force_n = recording.time_s, np.asarray(recording.force_n)
        response = arterial_response(person, table, gain, recording)
        pressure_pa, light, unexplained = _decompose(response, leds, residual, first_v**2 + (1e-3 * rest_v) ** 2)
        # What follows the force is the model's error, not the body's.
        degree = min(MODEL_ERROR_DEGREE, len(np.unique(force_n)) - 1)
        pressure_pa -= np.polynomial.Polynomial.fit(force_n, pressure_pa, degree)(force_n)
        step_s = float(np.median(np.diff(time_s)))
        spectra.append(welch(pressure_pa, fs=1.0 / step_s, nperseg=min(len(pressure_pa), round(WINDOW_S / step_s))))
        with suppress(InputError):  # no heartbeat in it
            rates_hz.append(beats_per_second(time_s, pressure_pa))
        # A reading's own noise and drift lie where neither pressure nor LED took it along, in fewer degrees of freedom.
        share = len(unexplained) / max(len(unexplained) - 1 - leds.shape[1], 1)
        white_v.append(np.sqrt(share) * _white(unexplained, group))
        untouched = force_n < REST_FORCE_N
        reading_drift2.append(share * _random_walk_variance(unexplained / rest_v[:, None], time_s, untouched))
        led_drift2.append(_random_walk_variance(light, time_s, untouched))
    frequency = spectra[int(np.argmax([len(recording.time_s) for recording in recordings]))][0]
    power = np.mean([np.interp(frequency, *spectrum) for spectrum in spectra], axis=0)
    power = np.maximum(power - np.median(power[frequency > NOISE_FROM * frequency[-1]]), 0.0)
    waves = slow_waves(frequency, power * (frequency[1] - frequency[0]))
    # Readings show what the vessels passed on of the pressure.
    gains = [max(pressure_to_blood_gain(person, wave.frequency_hz), LEAST_GAIN) for wave in waves]
    return np.maximum(np.median(white_v, axis=0), least_v), Noise(
        drift_per_min=_drift(reading_drift2, USUAL_DRIFT),
        led_drift_per_min=_drift(led_drift2, USUAL_LED_DRIFT),
        waves=tuple(replace(wave, rms_pa=wave.rms_pa / shown) for wave, shown in zip(waves, gains, strict=True)),
        beat=_heartbeat(float(np.median(rates_hz)), frequency, power) if rates_hz else None,
    )


def _decompose(response: Array, leds: Array, residual: Array, noise_v2: Array) -> tuple[Array, Array, Array]:
    """MAP estimate (ridge regression) by sample, from residuals (R, T), of the arterial pressure with the LEDs' light
    fixed, as none follows the heart (T,) [Pa], of each LED's light beside it (L, T) [1], interpolated where there is no
    reading at all; and residuals of both (R, T), NaN in gaps.

    response : (R, T) float, of every reading to the pressure. leds : (R, L) float, to the light. noise_v2 : (R,) float.
    """
    valid, seen = np.isfinite(residual), np.flatnonzero(np.isfinite(residual).any(0))
    design = np.concatenate([response.T[:, :, None], np.broadcast_to(leds, (response.shape[1], *leds.shape))], axis=2)
    weighted = design / noise_v2[:, None] * valid.T[..., None]
    normal = np.einsum("trp,trq->tpq", weighted, design)
    strength = normal[:, 0, 0]
    # Where a touch all but shuts the vessels, readings hardly depend on the arterial pressure, which is taken as 0.
    normal[:, 0, 0] += np.where(
        strength > 0.01 * np.median(strength[seen]), PRESSURE_SPREAD_PA**-2, 1e9 * strength.max()
    )
    np.einsum("tpp->tp", normal)[:, 1:] += LIGHT_SPREAD**-2
    rhs = np.einsum("trp,rt->tp", weighted, np.nan_to_num(residual))
    parts = np.linalg.solve(normal, rhs[..., None])[..., 0]
    unexplained = residual - np.einsum("trp,tp->rt", design, parts)
    parts[:, 0] = rhs[:, 0] / normal[:, 0, 0]
    parts = np.stack([np.interp(np.arange(len(parts)), seen, part) for part in parts[seen].T])
    return parts[0], parts[1:], unexplained


def _random_walk_variance(drifting: Array, time_s: Array, untouched: NDArray[np.bool_]) -> Array:
    """Mean variances that random walks (N, T) gain in a minute, from each rest to the next, (rests - 1,) float."""
    rests = [slice(start, stop) for start, stop in runs(untouched) if stop - start > 1]
    means = np.array([np.ma.masked_invalid(drifting[:, rest]).mean(1) for rest in rests]).reshape(-1, len(drifting))
    return np.asarray((np.diff(means, axis=0) ** 2).mean(1) * 60.0 / np.diff([time_s[rest].mean() for rest in rests]))


def _drift(variances: Sequence[Array], usual: float) -> float:
    """Standard deviation of a drift in a minute, of variances by recording; the usual one where there are none."""
    all_of_them = np.concatenate(variances)
    return max(float(np.sqrt(all_of_them.mean())), LEAST_DRIFT) if all_of_them.size else usual


def cardiac_oscillator(rate_hz: float, rms_pa: Sequence[float]) -> CardiacOscillator:
    """The heartbeat by its harmonics, none of which is less than a hundredth of the largest. [Pa]"""
    return CardiacOscillator(rate_hz, tuple(max(one, 0.01 * max(rms_pa)) for one in rms_pa), HEIGHT_SPREAD)


def _heartbeat(rate_hz: float, frequency: Array, power: Array) -> CardiacOscillator | None:
    """The heartbeat of a rate in a spectrum of the arterial pressure [Pa^2/Hz]; None where it is too weak."""

    def rms_pa(middle: float, half: float) -> float:
        return float(np.sqrt(np.trapezoid(power * (np.abs(frequency - middle) < half), frequency)))

    orders = 1 + np.flatnonzero(resolved_harmonics(rate_hz, HARMONICS, frequency[-1]))
    heights = [rms_pa(k * rate_hz, HARMONIC_BAND * rate_hz) for k in orders]
    if not orders.size or np.hypot.reduce(heights) < LEAST_BEAT_PA:
        return None
    return cardiac_oscillator(rate_hz, heights)


def _white(residual: Array, group: int) -> Array:
    """White noise of each row's means of so many samples, rms: of third differences, which take out what is slow."""
    # Robust; var(third difference) = 20 sigma^2. Across a gap they are those of the samples beside it.
    rows = (row[np.isfinite(row)] for row in residual)
    means = (row[: len(row) // group * group].reshape(-1, group).mean(1) for row in rows)
    third = [np.median(np.abs(np.diff(row, n=3))) for row in means]
    return np.array(third) / MEDIAN_OF_GAUSSIAN / np.sqrt(20.0)
