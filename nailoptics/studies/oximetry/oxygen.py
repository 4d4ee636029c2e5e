"""A pulse oximeter from touch to SpO2: R against saturation, its calibration, its error, and what disturbs it."""

import time
from typing import Unpack

import numpy as np
import xarray as xr

from ...errors import as_far_as_reached, unless_cut_off
from ...hemodynamics.for_scene import BloodBeat, heart_rate_per_min, rest_beat
from ...light import ProgressCallback, Transfer
from ...light.tracing import accuracy
from ...options import Requested, TraceOptions
from ...scene import Oximeter, SceneIn, as_scene
from ...sensor.ambient import LAMP, SUN, trace_ambient
from ...sensor.front_end import AVERAGE_S, CAUSES, SampledFrontEnd, front_end_of, oximeter_leds, ratio_stderr
from ...statistics import Array, jackknife, seed_of
from ...variables import Estimate, Variables, described, jackknifed
from .disturbances import CalibratedOximeter, path_warnings, sensitivity_curves
from .ratio import (
    FIT_SO2,
    calibrate_curve,
    path_length_ratios,
    read_pulsations,
    read_states,
    saturation_curve,
    trace_for_ratio,
)
from .recording import light_of_touch

SO2 = np.linspace(0.5, 1.0, 51)
# Part of one slot's light that may be left in the next.
MOST_CROSSTALK = 0.01
_LEAKAGE = 52


def oximeter(scene: SceneIn, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]) -> xr.Dataset:
    """R against saturation for every photodiode of a two-LED scene, from one trace per wavelength.

    relative_error, of the scene or as requested, is that of the ratio of ratios on the photodiode that knows the
    saturation best.

    Returns: Dataset over photodiode, led (red, infrared), so2 and beat_time: ratio, perfusion index, calibrations,
    errors of SpO2 by cause for a beat and for 8 s, volts over a beat, paths, and curves of what disturbs, each estimate
    with its standard error; its attributes hold the warnings.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the light went.
    """
    scene = as_scene(scene)
    scene.require_blood("oximeter")
    cpu, begin = time.process_time(), time.perf_counter()
    options, leds = TraceOptions(**requested), oximeter_leds(scene)
    states = [(scene.blood.so2, rest_beat(scene))]

    def error_of(light: Transfer) -> float:
        value, error = jackknifed(read_pulsations(light, leds, states).ratio[..., 0])
        return float(np.nanmin(np.where(value > 0, error / value, np.inf), initial=np.inf))

    how = {"max_seconds": accuracy(scene, options).max_seconds, "progress": progress}
    transfer, unmet = as_far_as_reached(trace_for_ratio, scene, error_of, options, **how)
    result = oximeter_from(transfer, options=options)
    result.attrs |= {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}
    return unless_cut_off(result, unmet)


def oximeter_from(transfer: Transfer, *, options: TraceOptions) -> xr.Dataset:
    """What `oximeter` returns, from light that is already traced."""
    scene, leds = transfer.scene, oximeter_leds(transfer.scene)
    beat = rest_beat(scene)
    curve = saturation_curve(transfer, leds, beat, low=min(SO2[0], scene.blood.so2), high=1.0)
    oximeter = CalibratedOximeter(transfer, leds, SO2, curve(SO2).ratio, curve(scene.blood.so2))
    sources = (scene.ambient or LAMP, SUN)
    outside_a = trace_ambient(scene, sources, options, seed=seed_of(options.seed, _LEAKAGE))
    (ambient_a, sun_a), (ambient_stderr_a, sun_stderr_a), _ = outside_a
    front_end = front_end_of(scene, leds, ambient_a)
    path_ratio = path_length_ratios(transfer, leds, beat)
    calibrations = _calibrations(curve(FIT_SO2).ratio)
    slope = np.abs(calibrations["linear"][1][:, 1])
    volts = _volts(transfer, leds, beat, front_end)
    time_s, light = light_of_touch(scene, transfer, leds)
    data = calibrations | volts | _error_variables(oximeter, slope, front_end, volts)
    data |= described(
        __package__,
        ratio=jackknifed(oximeter.curve),
        ratio_at_rest=jackknifed(oximeter.nominal.ratio[..., 0]),
        perfusion_index=jackknifed(oximeter.nominal.perfusion_index[..., 0]),
        path_ratio=jackknifed(path_ratio),
        detected_fraction=light,
        ambient_a=Estimate(ambient_a, ambient_stderr_a),
        sun_a=Estimate(sun_a, sun_stderr_a),
    )
    disturbances = sensitivity_curves(oximeter, front_end, sun_a)
    for curves in disturbances.values():
        data |= curves
    names = {
        "photodiode": list(transfer.photodiodes),
        "led": [scene.leds[i].name for i in leds],
        "so2": SO2,
        "cause": [*CAUSES, "trace"],
        "beat_time": ("beat_time", beat.time_s, {"units": "s", "long_name": "time from the start of a beat"}),
        "time": ("time", time_s, {"units": "s", "long_name": "time from the start of the touch"}),
    }
    # A photodiode that sees no light has no error.
    best = str(transfer.photodiodes[int(np.nan_to_num(data["spo2_stderr"][1], nan=np.inf).argmin())])
    about = {
        "title": "nailoptics: oxygen from volts",
        "seed": options.seed,
        "warnings": _warnings(oximeter, front_end, path_ratio[0]),
        "best": best,
        "so2": scene.blood.so2,
        "disturbances": list(disturbances),
        "rate_per_min": heart_rate_per_min(scene.body),
    }
    return xr.Dataset(data, names, transfer.attributes() | about)


def _calibrations(ratio: Array) -> Variables:
    """The quadratic and the line of every photodiode with their residuals; ratio : at `FIT_SO2`."""
    data: Variables = {}
    for degree, name in ((2, "quadratic"), (1, "linear")):
        fits, miss = calibrate_curve(FIT_SO2, ratio, degree)
        data |= described(__package__, **{name: jackknifed(fits), f"{name}_miss": miss})
    return data


def _volts(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, front_end: SampledFrontEnd) -> Variables:
    """Both LEDs' readings over a beat, less the dark slot's, and the volts of every slot."""
    states = [(transfer.scene.blood.so2, beat.resting, beat.pulse)]
    light = np.stack([read_states(transfer, led, states) for led in leds])
    slots, full = front_end.slot_volts(np.swapaxes(light, 2, 3))
    volts = np.einsum("ls,sgtj->gljt", front_end.weights, slots)
    return described(
        __package__,
        volts=jackknifed(volts),
        volts_pulse=jackknifed(volts - volts.mean(-1, keepdims=True)),
        slot_volts=slots[:, 0].mean(1).T,
        saturated=full[:, 0].any((0, 1)),
        slot=np.array(front_end.slot_names),
    )


def _error_variables(
    oximeter: CalibratedOximeter, slope: Array, front_end: SampledFrontEnd, volts: Variables
) -> Variables:
    """Error of SpO2 by its cause, for one beat and for 8 s. [percent]

    slope : (photodiodes,) float. Of SpO2 over R. [percent]
    """
    scene, nominal = oximeter.transfer.scene, oximeter.nominal
    ratio, index = nominal.ratio[0, :, 0], nominal.perfusion_index[0, ..., 0].T
    level_v, pulse = volts["volts"][1].mean(-1).T, volts["volts_pulse"][1][1]
    shape = pulse.std(-1) / np.ptp(pulse, axis=-1)
    frame_hz = (scene.oximeter or Oximeter()).frame_hz
    of_slots_v2 = front_end.slot_noise_v2(nominal.dc[0, ..., 0])
    noise_v2 = [(front_end.weights**2 @ of_slots_v2[name]).T for name in CAUSES]
    data: dict[str, Array] = {}
    for end, seconds in (("_beat", 60.0 / heart_rate_per_min(scene.body)), ("", AVERAGE_S)):
        how = {"shape_rms": shape, "frames": seconds * frame_hz}
        by_noise = [ratio_stderr(ratio, index, level_v, of_cause, **how) for of_cause in noise_v2]
        by_cause = slope * np.stack([*by_noise, jackknife(nominal.ratio[..., 0])])
        data |= {f"spo2_stderr{end}_by_cause": by_cause, f"spo2_stderr{end}": np.linalg.norm(by_cause, axis=0)}
    return described(__package__, **data)


def _warnings(oximeter: CalibratedOximeter, front_end: SampledFrontEnd, path_ratio: Array) -> list[str]:
    scene, nominal = oximeter.transfer.scene, oximeter.nominal
    lines = path_warnings(scene, nominal.ratio[0, :, 0], path_ratio)
    _, full = front_end.slot_volts(nominal.dc[0, ..., 0])
    for name, over in zip(oximeter.transfer.photodiodes, full.T, strict=True):
        if over.any():
            lines.append(
                f'photodiode "{name}" saturates in slot "{front_end.slot_names[int(over.argmax())]}": its volts do not '
                "measure the light; lower the LED's flux_mw or electronics.feedback_ohm"
            )
    crosstalk = float(np.abs(front_end.corrected - np.eye(2)).max())
    if crosstalk > MOST_CROSSTALK:
        lines.append(
            f"slots: {100 * crosstalk:.1f} % of a reading is not its own LED's settled light; raise "
            "electronics.bandwidth_hz or oximeter.settle, or lengthen the slots"
        )
    return lines
