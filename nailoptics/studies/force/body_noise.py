"""What moves a person's readings beside the touch, learned from what a fit leaves over."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...hemodynamics.steady import solve_walls
from ...hemodynamics.stepping import step
from ...scene.sensor_recordings import Recording
from .network import widths_over
from .observer import Noise, Oscillation
from .person import Person
from .reading_table import ReadingTable

Array = NDArray[np.float64]

# Bands of the body's rhythms: heartbeat and breathing of a resting adult, slow waves of the vessels' tone. [Hz]
HEART_HZ, BREATH_HZ, SLOW_HZ = (0.7, 3.0), (0.15, 0.5), (0.03, 0.15)
# Harmonics of the beat that carry a pulse's shape.
HARMONICS = 3
# How long rhythms keep their phase: beats scatter by some 5 %, breaths by 10 %, slow waves come and go. [s]
HEART_COHERENCE_S, BREATH_COHERENCE_S, SLOW_COHERENCE_S = 4.0, 8.0, 4.0
# A step of arterial pressure by which its effect is found. [Pa]
STEP_PA = 100.0
# How finely and for how long a rhythm is followed to see how much of it the vessels pass on.
STEPS_PER_PERIOD, PERIODS, SETTLING_S = 40, 3, 2.0
# A rhythm that the vessels pass on less than this is not seen well enough to be scaled by it.
LEAST_PASSED = 0.05
# Drift is seen in means over so long. [s]
DRIFT_S = 5.0
# How fast touches are expected to change: a force that wanders by this in a second. A step of 1 N in 0.16 s, the
# fastest of the paper's subjects, is then 8 standard deviations of what 0.16 s bring, which a filter still follows.
# [N/cm^2 / sqrt(s)]
TOUCH_RATE = 0.3


def arterial_response(person: Person, table: ReadingTable, gain: Array, recording: Recording) -> Array:
    """Change of every reading with a slow change of arterial pressure, over a touch, (R, T) float. [V/Pa]"""
    assert recording.force_n is not None and recording.site is not None
    high = person.arterial_pa + STEP_PA * np.array([-0.5, 0.5])
    pressure = np.repeat(person.pressures(recording.force_n, recording.site)[:, None], 2, axis=1)
    start = replace(person, rest_m=np.repeat(person.rest_m[:, None], 2, axis=1))
    blood = person.blood(widths_over(start, recording.time_s, pressure, arterial_pa=high))
    volts = gain[:, None, None] * table.volts(blood)
    return np.asarray((volts[:, 1] - volts[:, 0]) / STEP_PA)


def passed(person: Person, frequency_hz: float) -> float:
    """Part of a rhythm of the arterial pressure that the vessels at rest follow, over that of a slow one. [1]

    Blood of both zones together; the vessels are sluggish, so that a beat moves them less than a breath.
    """
    step_s = min(0.02, 1.0 / (STEPS_PER_PERIOD * frequency_hz))
    count = max(round(PERIODS / (frequency_hz * step_s)), round(SETTLING_S / step_s))
    last = round(1.0 / (frequency_hz * step_s))
    width, blood = person.rest_m, []
    for k in range(count):
        high = person.arterial_pa + STEP_PA * np.sin(2 * np.pi * frequency_hz * (k + 0.5) * step_s)
        width = step(person.walls, width, np.zeros(3), high, person.venous_pa, step_s=step_s)
        blood.append(float((width[:2] / person.rest_m[:2]).sum()))
    swing = np.ptp(blood[-last:])
    high = person.arterial_pa + STEP_PA * np.array([-1.0, 1.0])
    slow, _ = solve_walls(person.walls, np.zeros((3, 2)), high, np.full(2, person.venous_pa))
    return float(swing / np.ptp((slow[:2] / person.rest_m[:2, None]).sum(0)))


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
    spectra, drifts, spans = [], [], []
    for recording, residual in zip(recordings, residual_v, strict=True):
        time = recording.time_s
        response, step = arterial_response(person, table, gain, recording), float(np.median(np.diff(time)))
        filled = np.where(np.isfinite(residual), residual, 0.0)
        weight = response / (white**2 + (1e-3 * rest_v) ** 2)[:, None]
        strength = (weight * response).sum(0)
        # Where a touch has all but shut the vessels the arterial pressure is not seen.
        seen = strength > 0.01 * strength.max()
        pressure = np.where(seen, (weight * filled).sum(0) / np.where(seen, strength, 1.0), 0.0)
        window = min(len(time), round(40.0 / step))
        spectra.append(signal.welch(pressure, fs=1.0 / step, nperseg=window, detrend="constant"))
        spans.append(len(time))
        left = (filled - response * pressure) / rest_v[:, None]
        group = max(1, min(len(time) // 2, round(DRIFT_S / step)))
        blocks = left[:, : len(time) // group * group].reshape(len(left), -1, group).mean(-1)
        drifts.append(np.sqrt(np.mean(np.diff(blocks, axis=1) ** 2) * 60.0 / DRIFT_S))
    longest = int(np.argmax(spans))
    frequency, power = spectra[longest]
    drift = float(max(np.median(drifts), 1e-4))
    slow = _rhythms(frequency, power)
    # What was seen is what the vessels passed on.
    rhythms = [replace(one, rms_pa=one.rms_pa / max(passed(person, one.frequency_hz), LEAST_PASSED)) for one in slow]
    return Noise(white, drift, tuple(rhythms), TOUCH_RATE)


def _rhythms(frequency: Array, power: Array) -> tuple[Oscillation, ...]:
    """Oscillators with the power of each band of a spectrum of the arterial pressure [Pa^2/Hz]."""
    width = frequency[1] - frequency[0]
    inside = (frequency > HEART_HZ[0]) & (frequency < HEART_HZ[1])
    rhythms = []
    if inside.any():
        beat = float(frequency[inside][np.argmax(power[inside])])
        for k in range(1, HARMONICS + 1):
            near = (frequency > (k - 0.35) * beat) & (frequency < (k + 0.35) * beat)
            rms = float(np.sqrt(power[near].sum() * width))
            rhythms.append(Oscillation(k * beat, HEART_COHERENCE_S / k, rms))
    for band, coherence_s in ((BREATH_HZ, BREATH_COHERENCE_S), (SLOW_HZ, SLOW_COHERENCE_S)):
        near = (frequency >= band[0]) & (frequency < band[1])
        if near.any() and power[near].sum() > 0:
            middle = float((frequency[near] * power[near]).sum() / power[near].sum())
            rhythms.append(Oscillation(middle, coherence_s, float(np.sqrt(power[near].sum() * width))))
    return tuple(rhythms)


def _white(residual: Array) -> Array:
    """White noise of each row, rms: from third differences, which take out what moves slowly."""
    # Robust: the median of |x| of a Gaussian is 0.6745 of its standard deviation; third differences have 20 variances.
    # Across a gap they are those of the samples beside it.
    third = [np.median(np.abs(np.diff(row[np.isfinite(row)], n=3))) for row in residual]
    return np.array(third) / 0.6745 / np.sqrt(20.0)
