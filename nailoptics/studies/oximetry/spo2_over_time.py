"""Back from a recording: R, SpO2 with its interval, pulse rate and perfusion index over time, motion marked."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...commit import code_attributes
from ...errors import InputError
from ...hemodynamics.beat_detection import BAND_HZ, LEAST_BEATS, Beats, Marks, band, find_beats, resampled
from ...scene import Scene
from ...scene.importers.sensor_recordings import SATURATED, OximeterRecording
from ...sensor.front_end import AVERAGE_S
from ...statistics import Z95
from ...variables import variable
from .ratio import saturation_of

Array = NDArray[np.float64]

# Interval between two estimates. [s]
STEP_S = 1.0
# Of a channel whose converter was at its limit in more samples than this nothing can be estimated.
MOST_SATURATED = 0.01
# Above this the heart has nothing to say, and what is there is noise. [Hz]
NOISE_FROM_HZ = 12.0
# A sample moved if what both LEDs do not share is so many times its usual size, or if light jumps by so many pulses.
MOST_UNSHARED, MOST_JUMP = 6.0, 4.0
# Around a sample that moved so much is marked, as filters spread it. [s]
AROUND_S = 0.5
# Of a window at least this part must be still.
LEAST_STILL = 0.5


@dataclass(frozen=True)
class CalibrationCurve:
    """What a scene says of its photodiodes, to read recordings by.

    so2 : (n,) float, rising. ratio, ratio_stderr : (photodiodes, n) float, at these saturations.
    """

    photodiodes: tuple[str, ...]
    so2: Array
    ratio: Array
    ratio_stderr: Array

    @staticmethod
    def of(result: xr.Dataset) -> "CalibrationCurve":
        """From what `oximeter` returned."""
        names = tuple(str(name) for name in result.photodiode.values)
        return CalibrationCurve(names, result.so2.values, result.ratio.values, result.ratio_stderr.values)

    def spo2(self, photodiode: str, ratio: Array, stderr: Array) -> tuple[Array, Array]:
        """SpO2 and its standard error, that of the curve included. [percent]"""
        j = self.photodiodes.index(photodiode)
        curve, own = self.ratio[j], self.ratio_stderr[j]
        value = saturation_of(ratio, self.so2, curve)
        slope = np.abs(np.interp(value, self.so2, np.gradient(self.so2, curve)))
        of_curve = np.interp(value, self.so2, own)
        return 100 * value, 100 * slope * np.hypot(stderr, of_curve)


def spo2_over_time(
    recording: OximeterRecording, known: CalibrationCurve, scene: Scene, *, window_s: float = AVERAGE_S
) -> xr.Dataset:
    """Oxygen over time from a recording.

    known : the scene's curve; its photodiodes include the recording's.
    window_s : each value is of the window around its time. [s]

    Returns: Dataset over photodiode and time: ratio, spo2 with spo2_low and spo2_high (95 %), pulse rate, perfusion
    index, motion; `best` in its attributes is the photodiode with the narrowest intervals.

    Raises: InputError for fewer than three beats, a channel at the converter's limit, or no pulse.
    """
    unknown = [name for name in recording.photodiodes if name not in known.photodiodes]
    if unknown:
        raise InputError(f"{recording.name}: photodiode {unknown[0]!r} is none of {', '.join(known.photodiodes)}.")
    times_s, rows = pulses_over_time(recording, scene, window_s=window_s)
    found = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    spo2, error = np.array(
        [known.spo2(name, found["ratio"][j], found["ratio_stderr"][j]) for j, name in enumerate(recording.photodiodes)]
    ).swapaxes(0, 1)
    return _dataset(recording, scene, times_s, found, spo2, error)


def pulses_over_time(
    recording: OximeterRecording, scene: Scene, *, window_s: float = AVERAGE_S
) -> tuple[Array, list[dict[str, Array]]]:
    """Times of the windows, and what each photodiode tells in them without any calibration.

    Raises: InputError as `spo2_over_time`.
    """
    _check_limit(recording, scene.electronics.adc_range_v)
    found = [_photodiode(recording, j, window_s) for j in range(len(recording.photodiodes))]
    return found[0][0], [row for _, row in found]


def _photodiode(recording: OximeterRecording, j: int, window_s: float) -> tuple[Array, dict[str, Array]]:
    """Times of the windows and what one photodiode tells in each."""
    name = f"{recording.name}, photodiode {recording.photodiodes[j]}"
    light = recording.volts[:, j] - recording.dark_v[j]
    low = float(np.nanmedian(light[0])), float(np.nanmedian(light[1]))
    if min(low) <= 0:
        raise InputError(f"{name}: less its dark reading an LED gives no light; check the slots' names.")
    with np.errstate(invalid="ignore", divide="ignore"):
        logarithm = -np.log(np.where(light > 0, light, np.nan))
    even_s, _, rate_hz = resampled(recording.time_s, logarithm[0], name)
    both = np.stack([resampled(recording.time_s, one, name)[1][: len(even_s)] for one in logarithm])
    beats = find_beats(even_s, both[1], name)
    low_hz, high_hz = max(BAND_HZ[0], 0.6 * beats.rate_per_min / 60.0), BAND_HZ[1]
    pulse = band(both, rate_hz, low_hz, high_hz)
    moved = _motion(recording, j, even_s, both, pulse, rate_hz)
    moved |= _near(even_s, beats.peak_s[~beats.usual], 0.5 * 60.0 / beats.rate_per_min)
    noise = _noise_variance(both, rate_hz, high_hz - low_hz)
    centres = _centres(even_s, window_s)
    estimates = [_window(pulse, moved, noise, beats, even_s, c, window_s, rate_hz, high_hz - low_hz) for c in centres]
    return centres, {key: np.array([one[key] for one in estimates]) for key in estimates[0]}


def _window(
    pulse: Array,
    moved: Marks,
    noise: Array,
    beats: Beats,
    even_s: Array,
    centre_s: float,
    window_s: float,
    rate_hz: float,
    width_hz: float,
) -> dict[str, float]:
    """What one window tells: the slope of red over infrared where both have noise, and its standard error."""
    inside = np.abs(even_s - centre_s) <= window_s / 2
    still = inside & ~moved
    out = {"motion": float(moved[inside].mean()), "rate_per_min": beats.rate_at(centre_s, window_s)}
    unknown = dict.fromkeys(("ratio", "ratio_stderr", "perfusion_red", "perfusion_infrared"), np.nan)
    if still.sum() < LEAST_STILL * inside.sum():
        return out | unknown
    red, infrared = pulse[:, still]
    ratio, stderr = slope_of_two(red, infrared, noise, values=2 * width_hz * still.sum() / rate_hz)
    # A pulse's height from the middle of its beats' own.
    edges = [beats.peak_s[k : k + 2] for k in range(len(beats.peak_s) - 1)]
    heights = [
        np.ptp(pulse[:, one], axis=1)
        for start, end in edges
        if (one := still & (even_s >= start) & (even_s < end)).sum() > 0.8 * rate_hz * (end - start)
    ]
    index = np.median(heights, axis=0) if heights else np.full(2, np.nan)
    return out | {"ratio": ratio, "ratio_stderr": stderr, "perfusion_red": index[0], "perfusion_infrared": index[1]}


def slope_of_two(red: Array, infrared: Array, noise: Array, *, values: float) -> tuple[float, float]:
    """Slope of red over infrared and its standard error, where both have noise.

    red, infrared : (n,) float, of mean 0 or nearly.
    noise : (2,) float. Variance of their noise: its ratio keeps the slope unbiased (Deming).
    values : how many of them are independent, as filtered noise is correlated.

    References: Fuller 1987, Measurement Error Models, ch. 1.3.
    """
    balance = float(noise[0] / noise[1]) if noise.min() > 0 else 1.0
    yy, xx, xy = float(np.mean(red**2)), float(np.mean(infrared**2)), float(np.mean(red * infrared))
    apart = yy - balance * xx
    ratio = (apart + np.sqrt(apart**2 + 4 * balance * xy**2)) / (2 * xy) if xy > 0 else np.nan
    left = float(np.mean((red - ratio * infrared) ** 2)) * values / max(values - 1, 1)
    pulsating = max(xx - left / (balance + ratio**2), 0.0) if np.isfinite(ratio) else 0.0
    if pulsating <= 0.1 * xx:
        return np.nan, np.nan
    # Of a slope between two noisy values the error of the values themselves adds (Fuller's second term).
    own = left / (balance + ratio**2)
    variance = (left * pulsating + balance * own**2) / (values * pulsating**2)
    return float(ratio), float(np.sqrt(variance))


def _noise_variance(both: Array, rate_hz: float, width_hz: float) -> Array:
    """Variance of each LED's noise in the pulse's band, (2,) float, from what lies above all pulses."""
    top_hz = 0.5 * rate_hz
    if top_hz < 1.3 * NOISE_FROM_HZ:
        return np.ones(2)
    step_hz, power = 1.0 / (both.shape[1] / rate_hz), np.abs(np.fft.rfft(both - both.mean(1, keepdims=True))) ** 2
    frequency = np.arange(power.shape[1]) * step_hz
    above = power[:, (frequency > NOISE_FROM_HZ) & (frequency < 0.95 * top_hz)]
    # The median of an exponential distribution is ln 2 of its mean; motion's few lines do not move it.
    density = np.median(above, axis=1) / np.log(2) / both.shape[1] ** 2 * 2
    return np.asarray(np.maximum(density * width_hz / step_hz, np.finfo(float).tiny))


def _motion(recording: OximeterRecording, j: int, even_s: Array, both: Array, pulse: Array, rate_hz: float) -> Marks:
    """Where the finger moved: a gap, a jump of the light, or a change that both LEDs do not share as in a pulse."""
    usual = np.median(np.abs(pulse), axis=1) / 0.6745
    slope = float(np.median(np.abs(pulse[0]))) / max(float(np.median(np.abs(pulse[1]))), np.finfo(float).tiny)
    unshared = pulse[0] - slope * pulse[1]
    spread = np.median(np.abs(unshared - np.median(unshared))) / 0.6745
    marks = np.abs(unshared) > MOST_UNSHARED * max(float(spread), np.finfo(float).tiny)
    marks &= np.abs(unshared) > usual[0]
    marks |= (np.abs(pulse) > MOST_JUMP * usual[:, None]).any(0)
    gaps = recording.time_s[~np.isfinite(recording.volts[:, j]).all(0)]
    return _near(even_s, np.concatenate([even_s[marks], gaps]), AROUND_S)


def _near(even_s: Array, places_s: Array, within_s: float) -> Marks:
    """Which times lie near some places."""
    if not len(places_s):
        return np.zeros(len(even_s), bool)
    places = np.sort(places_s)
    after = np.searchsorted(places, even_s)
    before_s = np.abs(even_s - places[np.maximum(after - 1, 0)])
    return np.asarray(np.minimum(before_s, np.abs(places[np.minimum(after, len(places) - 1)] - even_s)) <= within_s)


def _centres(even_s: Array, window_s: float) -> Array:
    """Middles of the windows; of a recording shorter than one its own middle."""
    length_s = float(even_s[-1] - even_s[0])
    if length_s <= window_s:
        return np.array([(even_s[0] + even_s[-1]) / 2])
    return np.asarray(even_s[0] + window_s / 2 + np.arange(int((length_s - window_s) / STEP_S) + 1) * STEP_S)


def _check_limit(recording: OximeterRecording, range_v: float) -> None:
    for k, light in enumerate(("red", "infrared")):
        for name, volts in zip(recording.photodiodes, recording.volts[k], strict=True):
            full = float(np.mean(volts[np.isfinite(volts)] >= SATURATED * range_v))
            if full > MOST_SATURATED:
                raise InputError(
                    f'{recording.name}: photodiode "{name}" is saturated in {100 * full:.0f} % of its {light} readings '
                    f"({range_v:g} V is the converter's limit); lower the LED's power and record again."
                )


def _dataset(
    recording: OximeterRecording, scene: Scene, times_s: Array, found: dict[str, Array], spo2: Array, error: Array
) -> xr.Dataset:
    over = ("photodiode", "time")
    data = variable("ratio", over, found["ratio"], "ratio of ratios R", stderr=found["ratio_stderr"])
    data |= variable("spo2", over, spo2, "oxygen saturation from the pulse", units="percent", stderr=error)
    bounds = np.clip([spo2 - Z95 * error, spo2 + Z95 * error], 0.0, 100.0)
    data |= variable("spo2_low", over, bounds[0], "lower bound of SpO2, 95 %", units="percent")
    data |= variable("spo2_high", over, bounds[1], "upper bound of SpO2, 95 %", units="percent")
    data |= variable("rate_per_min", over, found["rate_per_min"], "pulse rate", units="min-1")
    for light in ("red", "infrared"):
        index = found[f"perfusion_{light}"]
        data |= variable(f"perfusion_index_{light}", over, index, f"perfusion index of the {light} LED")
    data |= variable("motion", over, found["motion"], "part of the window in which the finger moved")
    typical = [float(np.nanmedian(one)) if np.isfinite(one).any() else np.inf for one in error]
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


CSV_COLUMNS = (
    "ratio",
    "spo2",
    "spo2_low",
    "spo2_high",
    "rate_per_min",
    "perfusion_index_red",
    "perfusion_index_infrared",
)


def spo2_rows(result: xr.Dataset) -> list[str]:
    """The lines of oxygen.csv; what is not known is left empty."""
    lines = [",".join(("time_s", "photodiode", *CSV_COLUMNS, "motion"))]
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        for k, time_s in enumerate(one.time.values):
            cells = [float(one[column].values[k]) for column in (*CSV_COLUMNS, "motion")]
            lines.append(f"{float(time_s)!r},{name}," + ",".join("" if np.isnan(x) else f"{x:.6g}" for x in cells))
    return lines
