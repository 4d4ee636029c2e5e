"""Recordings of an oximeter: simulated from a scene's result, slot by slot with noise, and read: SpO2 over time."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...hemodynamics.beat_detection import BAND_HZ, LEAST_BEATS, Beats, Marks, band, find_beats, resampled, upper_hz
from ...scene import Oximeter, Scene
from ...scene.electronics import DARK
from ...scene.importers.sensor_recordings import OximeterRecording, read_oximeter_recording
from ...sensor import electronics
from ...sensor.front_end import AVERAGE_S, front_end_of, oximeter_leds
from ...statistics import MEDIAN_OF_GAUSSIAN, Z95, Array, seed_of
from ...variables import Estimate, described, stacked_rows, variable
from ...version import code_attributes
from .ratio import saturation_of

_NOISE = 61
# Interval between two estimates. [s]
STEP_S = 1.0
# Of a channel whose converter was at its limit in more samples than this nothing can be estimated.
MOST_SATURATED = 0.01
# Above this the heart has nothing to say, and what is there is noise. [Hz]
NOISE_FROM_HZ = 12.0
# A sample moved if what both LEDs do not share is so many times its usual size, or if light jumps by so many pulses.
MOST_UNSHARED, MOST_JUMP = 6.0, 4.0
# No pulse or touch changes the logarithm of the light by so much.
MOST_AWAY = 0.08
# Around a sample that moved so much is marked, as filters spread it. [s]
AROUND_S = 0.5
# Of a window at least this part must be still, without which nothing is known of these.
LEAST_STILL = 0.5
WHILE_STILL = ("ratio", "ratio_stderr", "perfusion_index_red", "perfusion_index_infrared")


def simulated(scene: Scene, result: xr.Dataset, *, seed: int) -> OximeterRecording:
    """What the oximeter would record of its scene's touch, in the ambient light that the scene names. result : what
    `oximeter` returned for the scene."""
    front_end = front_end_of(scene, oximeter_leds(scene), np.asarray(result.ambient_a))
    time_s, (red, infrared) = result.time.values, result.detected_fraction.values
    delay_s, rng = front_end.delays_s[front_end.lights[1]], np.random.default_rng(seed_of(seed, _NOISE))
    later = [np.interp(time_s + delay_s, time_s, course) for course in infrared]
    fraction = np.stack([red.T, np.transpose(later)])
    slots, _ = front_end.slot_volts(fraction)
    noise_v = np.sqrt(sum(front_end.slot_noise_v2(fraction.mean(1)).values()))[:, None]
    drawn = np.transpose(rng.standard_normal((len(red), len(time_s), len(slots))))
    noisy, _ = electronics.converted(slots + noise_v * drawn, scene.electronics)
    by_slot = dict(zip(front_end.slot_names, np.swapaxes(noisy, 1, 2), strict=True))
    volts = np.stack([by_slot[name] for name in front_end.lights[:2]])
    names = tuple(str(name) for name in result.photodiode.values)
    return OximeterRecording("simulated", names, time_s, volts, by_slot.get(DARK, np.zeros_like(red)))


def read_for(scene: Scene, path: str | Path) -> OximeterRecording:
    """Read a recording of a scene's oximeter; raises InputError, also where it holds no pulse."""
    leds = oximeter_leds(scene)
    front_end = front_end_of(scene, leds)
    how: dict[str, Any] = {"photodiodes": scene.layout.photodiode_names, "delays_s": front_end.delays_s}
    how["frame_hz"] = (scene.oximeter or Oximeter()).frame_hz
    recording = read_oximeter_recording(path, leds=front_end.lights[:2], **how)
    # Checked here, before any light is traced.
    pulses_over_time(recording, scene)
    return recording


def spo2_over_time(recording: OximeterRecording, result: xr.Dataset, scene: Scene) -> xr.Dataset:
    """Oxygen over time from a recording, each value of the 8 s around its time.

    result : what `oximeter` returned for the scene; its photodiodes include the recording's.

    Returns: Dataset over photodiode and time: ratio, spo2 with spo2_low and spo2_high (95 %), pulse rate, perfusion
    index, motion; `best` in its attributes is the photodiode with the narrowest intervals.

    Raises: InputError for fewer than three beats, a channel at the converter's limit, or no pulse.
    """
    known = [str(name) for name in result.photodiode.values]
    unknown = [name for name in recording.photodiodes if name not in known]
    if unknown:
        raise InputError(f"{recording.name}: photodiode {unknown[0]!r} is not one of {', '.join(known)}.")
    times_s, rows = pulses_over_time(recording, scene)
    estimates = stacked_rows(rows)
    spo2, error = np.zeros((2, *estimates["ratio"].shape))
    for j, name in enumerate(recording.photodiodes):
        so2, curve = result.so2.values, result.sel(photodiode=name)
        if np.ptp(np.sign(np.diff(curve.ratio))) > 0:
            raise InputError(f"{recording.name}: R of photodiode {name!r} both rises and falls with SpO2; omit it.")
        value = saturation_of(estimates["ratio"][j], so2, curve.ratio.values)
        slope = np.abs(np.interp(value, so2, np.gradient(so2, curve.ratio.values)))
        of_curve = np.interp(value, so2, curve.ratio_stderr.values)
        spo2[j], error[j] = 100 * value, 100 * slope * np.hypot(estimates["ratio_stderr"][j], of_curve)
    bounds = np.clip([spo2 - Z95 * error, spo2 + Z95 * error], 0.0, 100.0)
    ratio, stderr = estimates.pop("ratio"), estimates.pop("ratio_stderr")
    data = variable("ratio", ("photodiode", "time"), ratio, "ratio of ratios R", stderr=stderr)
    saturation = {"spo2": Estimate(spo2, error), "spo2_low": bounds[0], "spo2_high": bounds[1]}
    data |= described(__package__, **saturation, **estimates)
    typical = [float(np.nanmedian(errors)) if np.isfinite(errors).any() else np.inf for errors in error]
    about: dict[str, Any] = {
        "title": "oxygen from a recording",
        "recording": recording.name,
        "best": recording.photodiodes[int(np.argmin(typical))],
        "window_s": AVERAGE_S,
        "least_beats": LEAST_BEATS,
        "so2": scene.blood.so2,
    } | code_attributes()
    times = variable("time", "time", times_s, "middle of the window", units="s")
    return xr.Dataset(data, times | {"photodiode": list(recording.photodiodes)}, about)


def pulses_over_time(recording: OximeterRecording, scene: Scene) -> tuple[Array, list[dict[str, Array]]]:
    """Times of the windows, and the estimates of each photodiode in them without any calibration. Raises: InputError
    as `spo2_over_time`."""
    if not recording.counts:
        range_v, valid = scene.electronics.adc_range_v, np.isfinite(recording.volts)
        full = (electronics.recorded_at_limit(recording.volts, range_v) & valid).sum(-1) / valid.sum(-1)
        for k, j in np.argwhere(full > MOST_SATURATED):
            where = f'photodiode "{recording.photodiodes[j]}" is saturated in {full[k, j]:.0%} of its'
            limit = f"{('red', 'infrared')[k]} readings ({range_v:g} V is the converter's limit)"
            raise InputError(f"{recording.name}: {where} {limit}; lower the LED's power and record again.")
    estimates = [_photodiode(recording, j) for j in range(len(recording.photodiodes))]
    return estimates[0][0], [row for _, row in estimates]


def _photodiode(recording: OximeterRecording, j: int) -> tuple[Array, dict[str, Array]]:
    """Times of the windows and the estimates of one photodiode in each."""
    name = f"{recording.name}, photodiode {recording.photodiodes[j]}"
    light = recording.volts[:, j] - recording.dark_v[j]
    if (least := (of_led := np.nanmedian(light, axis=1)).min()) <= 0:
        of = f"{('red', 'infrared')[of_led.argmin()]} LED by {-least:.3g} {'counts' if recording.counts else 'V'}"
        cure = "check the columns' names, or let readings settle in longer slots"
        raise InputError(f"{name}: the dark slot is brighter than that of the {of}; {cure}.")
    logarithm = -np.log(np.where(light > 0, light, np.nan))
    away = np.abs(logarithm - np.nanmedian(logarithm, axis=1, keepdims=True)) > MOST_AWAY
    # LEDs that are not lit yet; a filter would spread one such sample over a second.
    logarithm[:, away.any(0)] = np.nan
    even_s, _, rate_hz = resampled(recording.time_s, logarithm[0], name)
    both = np.stack([resampled(recording.time_s, reading, name)[1][: len(even_s)] for reading in logarithm])
    beats = find_beats(even_s, both[1], name)
    low_hz = max(BAND_HZ[0], 0.6 * beats.rate_per_min / 60.0)
    pulse = band(both, rate_hz, low_hz)
    moved = _motion(recording, j, even_s, pulse)
    moved |= _near(even_s, beats.peak_s[~beats.usual], 0.5 * 60.0 / beats.rate_per_min)
    noise = _noise_covariance(both, rate_hz)
    length_s = float(even_s[-1] - even_s[0])
    steps = np.arange(max(int((length_s - AVERAGE_S) / STEP_S), 0) + 1)
    centres = even_s[0] + min(AVERAGE_S, length_s) / 2 + steps * STEP_S
    # Filtered noise is correlated: so many values of a sample are independent.
    independent = 2 * (upper_hz(rate_hz) - low_hz) / rate_hz
    windows = (_window(pulse, moved, noise, beats, even_s, centre_s, independent) for centre_s in centres)
    return centres, stacked_rows([*windows])


def _window(
    pulse: Array, moved: Marks, noise: Array, beats: Beats, even_s: Array, centre_s: float, independent: float
) -> dict[str, float]:
    """Estimates from one window: the slope of red over infrared where both have noise, and its standard error.

    independent : how many independent values a sample has.
    """
    inside = np.abs(even_s - centre_s) <= AVERAGE_S / 2
    still = inside & ~moved
    out = {"motion": float(moved[inside].mean()), "rate_per_min": beats.rate_at(centre_s, AVERAGE_S)}
    if still.sum() < LEAST_STILL * inside.sum():
        return out | dict.fromkeys(WHILE_STILL, np.nan)
    ratio, stderr = deming_slope(pulse[0, still], pulse[1, still], noise, values=independent * still.sum())
    # A pulse's height from the middle of its beats' own.
    peaks = np.searchsorted(even_s, beats.peak_s)
    heights = [
        np.ptp(pulse[:, beat][:, still[beat]], axis=1)
        for beat in map(slice, peaks, peaks[1:])
        if still[beat].sum() > 0.8 * (beat.stop - beat.start)
    ]
    index = np.median(heights, axis=0) if heights else np.full(2, np.nan)
    return out | dict(zip(WHILE_STILL, (ratio, stderr, *index), strict=True))


def deming_slope(red: Array, infrared: Array, noise: Array, *, values: float) -> tuple[float, float]:
    """Slope of red over infrared and its standard error, where both have noise.

    red, infrared : (n,) float, of mean 0 or nearly.
    noise : (2, 2) float. Covariance of their noise, in any unit. Less what it shares, red's noise is independent.
    values : how many of them are independent, as filtered noise is correlated.

    References: Fuller 1987, Measurement Error Models, ch. 1.3.
    """
    balance, shared = (noise[0] / noise[1, 1]).tolist()
    red, balance = red - shared * infrared, max(balance - shared**2, 0.0)
    yy, xx, xy = float(np.mean(red**2)), float(np.mean(infrared**2)), float(np.mean(red * infrared))
    difference = yy - balance * xx
    ratio = (difference + np.sqrt(difference**2 + 4 * balance * xy**2)) / (2 * xy) if xy != 0 else np.nan
    left = float(np.mean((red - ratio * infrared) ** 2)) * values / max(values - 1, 1)
    residual = left / (balance + ratio**2)
    pulsating = max(xx - residual, 0.0) if ratio > -shared else 0.0
    if pulsating <= 0.1 * xx:
        return np.nan, np.nan
    # Of a slope between two noisy values the error of the values themselves adds (Fuller's second term).
    variance = (left * pulsating + balance * residual**2) / (values * pulsating**2)
    return float(ratio + shared), float(np.sqrt(variance))


def _noise_covariance(both: Array, rate_hz: float) -> Array:
    """Covariance of both LEDs' noise, (2, 2) float in any unit, by medians above all pulses, or the identity."""
    from scipy.signal import periodogram

    if rate_hz < 2.6 * NOISE_FROM_HZ:
        return np.eye(2)
    frequency, density = periodogram([*both, both[0] + both[1], both[0] - both[1]], rate_hz)
    above = density[:, (frequency > NOISE_FROM_HZ) & (frequency < 0.475 * rate_hz)]
    red, infrared, total, difference = np.maximum(np.median(above, axis=1), np.finfo(float).tiny)
    shared = 0.25 * (total - difference)
    return np.array([[red, shared], [shared, infrared]])


def _motion(recording: OximeterRecording, j: int, even_s: Array, pulse: Array) -> Marks:
    """Where the finger moved: a gap, a jump of the light, or a change that both LEDs do not share as in a pulse."""
    usual = np.median(np.abs(pulse), axis=1) / MEDIAN_OF_GAUSSIAN
    slope = float(np.median(np.abs(pulse[0]))) / max(float(np.median(np.abs(pulse[1]))), np.finfo(float).tiny)
    unshared = pulse[0] - slope * pulse[1]
    spread = np.median(np.abs(unshared - np.median(unshared))) / MEDIAN_OF_GAUSSIAN
    marks = np.abs(unshared) > max(MOST_UNSHARED * float(spread), float(usual[0]), np.finfo(float).tiny)
    marks |= (np.abs(pulse) > MOST_JUMP * usual[:, None]).any(0)
    gaps = recording.time_s[~np.isfinite(recording.volts[:, j]).all(0)]
    return _near(even_s, np.concatenate([even_s[marks], gaps]), AROUND_S)


def _near(even_s: Array, places_s: Array, within_s: float) -> Marks:
    """Which times lie near some places."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(places_s[:, None]).query(even_s[:, None])[0] <= within_s)


def spo2_csv(result: xr.Dataset) -> str:
    """The text of oxygen.csv; what is not known is left empty."""
    names = ["ratio", "spo2", "spo2_low", "spo2_high", "rate_per_min", *WHILE_STILL[2:], "motion"]
    rows = result[names].to_dataframe(dim_order=["photodiode", "time"]).reset_index()
    rows.insert(0, "time_s", rows.pop("time").map(repr))
    return str(rows[["time_s", "photodiode", *names]].to_csv(index=False, float_format="%.6g", lineterminator="\n"))
