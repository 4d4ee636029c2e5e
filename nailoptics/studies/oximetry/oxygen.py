"""A pulse oximeter from touch to SpO2: R against saturation, its calibration, its error, and what disturbs it."""

import time
from typing import Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import NotReachedError, as_far_as_reached
from ...light import ProgressCallback, Transfer, trace
from ...light.tracing import accuracy
from ...light.tracing.store import LightStore
from ...options import Requested, TraceOptions
from ...scene import Oximeter, Scene
from ...sensor.front_end import AVERAGE_S, CAUSES, SampledFrontEnd, front_ends_of, ratio_stderr
from ...statistics import jackknife, seed_of
from ...variables import Variables, variable
from ..pulsatile_blood import BloodBeat, beat_at, heart_rate_per_min, oximeter_leds, rest_force_n
from .disturbances import (
    SUN_LUX,
    AmbientPhotocurrent,
    CalibratedOximeter,
    SensitivityCurve,
    ambient_leakage,
    ambient_source,
    melanin_bound,
    path_warnings,
    sensitivity_curves,
)
from .ratio import (
    FIT_SO2,
    Calibration,
    Pulsation,
    SaturationCurve,
    calibrate_curve,
    estimate,
    path_length_ratios,
    read_pulsations,
    read_states,
)
from .ratio_trace import trace_for_ratio
from .recording import light_of_touch

Array = NDArray[np.float64]

SO2 = np.linspace(0.5, 1.0, 51)
# Of nails as thin and as thick as these a trace of their own is made, of so many of the scene's photons. [mm]
NAILS_MM = (0.35, 0.55, 0.70)
NAIL_SHARE, LEAST_NAIL_PHOTONS = 0.15, 1 << 17
# Part of the time, where it is limited, for the scene itself; the nails have equal parts of the rest.
OWN_TIME = 0.7
# Part of one slot's light that may be left in the next.
MOST_CROSSTALK = 0.01
_GROUPS, _LEAKAGE, _NAIL = 51, 52, 53


def oximeter(scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]) -> xr.Dataset:
    """R against saturation for every photodiode of a two-LED scene, from one trace per wavelength.

    relative_error, of the scene or as requested, is that of the ratio of ratios on the photodiode that knows the
    saturation best.

    Returns: Dataset over photodiode, led (red, infrared), so2 and beat_time: ratio, perfusion index, calibrations,
    errors of SpO2 by cause for a beat and for 8 s, volts over a beat, paths, and curves of what disturbs, each estimate
    with its standard error; its attributes hold the warnings.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the light went.
    """
    cpu, begin = time.process_time(), time.perf_counter()
    options = TraceOptions(**requested)
    leds = oximeter_leds(scene)
    beat = beat_at(scene, rest_force_n(scene))
    groups = seed_of(options.seed, _GROUPS)

    def error_of(light: Transfer) -> float:
        found = read_pulsations(light, leds, [(scene.blood.so2, beat)], seed=groups)
        value, error = estimate(found.ratio[..., 0])
        return float(np.nanmin(np.where(value > 0, error / value, np.inf), initial=np.inf))

    limit_s = accuracy(scene, options).max_seconds
    own_s = None if limit_s is None else OWN_TIME * limit_s
    how = {"max_seconds": own_s, "progress": progress}
    transfer, unmet = as_far_as_reached(trace_for_ratio, scene, error_of, options, **how)
    nails = {} if unmet else _nails(transfer, options, progress)
    cut_off = str(unmet) if unmet else _missing(nails)
    result = oximeter_from(transfer, beat, nails=nails, options=options)
    result.attrs |= {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}
    if cut_off:
        result.attrs["cut_off"] = cut_off
        raise NotReachedError(cut_off, result=result)
    return result


def oximeter_from(
    transfer: Transfer, beat: BloodBeat, *, nails: dict[float, Transfer], options: TraceOptions
) -> xr.Dataset:
    """What `oximeter` returns, from light that is already traced.

    nails : traces of the scene with a nail plate of other thicknesses, by thickness. [mm]
    """
    scene, leds, seed = transfer.scene, oximeter_leds(transfer.scene), seed_of(options.seed, _GROUPS)
    low, high = min(SO2[0], scene.blood.so2), 1.0
    curve = SaturationCurve(transfer, leds, beat, low=low, high=high, seed=seed)
    nominal = curve.at(scene.blood.so2)
    calibrated = CalibratedOximeter(transfer, leds, SO2, curve.at(SO2).ratio, nominal, seed)
    fits = calibrate_curve(FIT_SO2, curve.at(FIT_SO2).ratio)
    ambient, sun = _ambient(scene, options)
    front_ends = front_ends_of(scene, leds, ambient.current_a)
    paths = path_length_ratios(transfer, leds, beat, seed=seed)
    data = _curve_variables(curve, nominal, fits, paths)
    time_s, light = light_of_touch(scene, transfer, leds, seed=seed)
    volts = _volts(transfer, leds, beat, front_ends, seed)
    text = "detected fraction of the emitted power over the touch, frame by frame"
    data |= variable("detected_fraction", ("led", "photodiode", "time"), light, text)
    data |= volts | _error_variables(calibrated, fits, front_ends, volts)
    disturbances = [*sensitivity_curves(calibrated, front_ends, sun.current_a), *_nail_curve(calibrated, nails)]
    for disturbance in disturbances:
        data |= _disturbance_variables(disturbance)
    met, most = melanin_bound(calibrated)
    data |= variable("epidermis_part_bound", "photodiode", met, "part of the light that met epidermis, at most (95 %)")
    data |= variable("melanin_bound", "photodiode", most, "change by melanin, at most (95 %)", units="percent")
    for name, one, text in (("ambient_a", ambient, "ambient light"), ("sun_a", sun, "full sun")):
        data |= variable(name, "photodiode", one.current_a, f"photocurrent of {text}", units="A", stderr=one.stderr_a)
    names = {
        "photodiode": list(transfer.photodiodes),
        "led": [scene.leds[i].name for i in leds],
        "so2": SO2,
        "cause": [*CAUSES, "trace"],
        "beat_time": ("beat_time", beat.time_s, {"units": "s", "long_name": "time from the start of a beat"}),
        "time": ("time", time_s, {"units": "s", "long_name": "time from the start of the touch"}),
    }
    warnings = _warnings(calibrated, front_ends, paths[1])
    # A photodiode that sees no light has no error.
    best = str(transfer.photodiodes[int(np.nan_to_num(data["spo2_stderr"][1], nan=np.inf).argmin())])
    about = {"title": "nailoptics: oxygen from volts", "seed": options.seed, "warnings": warnings, "best": best}
    about |= {"so2": scene.blood.so2, "disturbances": [disturbance.name for disturbance in disturbances]}
    about["rate_per_min"] = heart_rate_per_min(scene)
    return xr.Dataset(data, names, transfer.attributes() | about)


def _ambient(scene: Scene, options: TraceOptions) -> tuple[AmbientPhotocurrent, AmbientPhotocurrent]:
    """Photocurrents of the ambient light that the scene names, and of full sun."""
    own = ambient_source(scene.oximeter or Oximeter())
    sun = ambient_source(Oximeter(ambient_light="sun", ambient_lux=float(SUN_LUX[-1])))
    store = LightStore.of_user() if options.store else None
    seed = seed_of(options.seed, _LEAKAGE)
    first, second = ambient_leakage(scene, [own, sun], backend=options.backend, seed=seed, store=store)
    if store is not None:
        store.close()
    return first, second


def _nails(transfer: Transfer, options: TraceOptions, progress: ProgressCallback | None) -> dict[float, Transfer]:
    """Traces of the scene with a nail plate of other thicknesses; of these nothing is missed if time ends them.

    An interrupt leaves out the one at work and those after it.
    """
    scene, found = transfer.scene, {}
    assert scene.finger is not None
    limit_s = accuracy(scene, options).max_seconds
    each_s = None if limit_s is None else (1 - OWN_TIME) * limit_s / len(NAILS_MM)
    photons = max(LEAST_NAIL_PHOTONS, round(NAIL_SHARE * transfer.photons / len(scene.leds)))
    for k, thickness_mm in enumerate(NAILS_MM):
        finger = scene.finger.model_copy(update={"nail_thickness_mm": thickness_mm})
        other = scene.model_copy(update={"finger": finger, "accuracy": type(scene.accuracy)()})
        seed = seed_of(options.seed, _NAIL, k) >> 1
        how = TraceOptions(seed=seed, backend=options.backend, photons=photons, max_seconds=each_s)
        light, unmet = as_far_as_reached(trace, other, progress=progress, **how.fields)
        if unmet and unmet.interrupted:
            break
        found[thickness_mm] = light
    return found


def _missing(nails: dict[float, Transfer]) -> str:
    """What an interrupt left out, if it did."""
    done = f"{len(nails)} of {len(NAILS_MM)} other thicknesses of the nail plate are traced."
    return "" if len(nails) == len(NAILS_MM) else f"interrupted: {done}"


def _nail_curve(calibrated: CalibratedOximeter, nails: dict[float, Transfer]) -> list[SensitivityCurve]:
    if not nails:
        return []
    finger, rows = calibrated.scene.finger, []
    assert finger is not None
    for light in nails.values():
        beat = beat_at(light.scene, rest_force_n(light.scene))
        state = (light.scene.blood.so2, beat)
        ratio = read_pulsations(light, calibrated.leds, [state], seed=calibrated.seed).ratio
        rows.append(calibrated.bias(ratio, independent=True))
    bias, stderr = (np.concatenate(parts, -1) for parts in zip(*rows, strict=True))
    none = np.zeros((len(bias), 1))
    thickness, bias = np.append(list(nails), finger.nail_thickness_mm), np.hstack([bias, none])
    order, stderr = np.argsort(thickness), np.hstack([stderr, none])
    text = "thickness of the nail plate"
    return [SensitivityCurve("nail_thickness_mm", text, "mm", thickness[order], bias[:, order], stderr[:, order])]


def _curve_variables(
    curve: SaturationCurve, nominal: Pulsation, fits: Calibration, paths: tuple[Array, Array]
) -> Variables:
    pair, over = ("led", "photodiode"), ("photodiode", "so2")
    value, error = estimate(curve.at(SO2).ratio)
    data = variable("ratio", over, value, "ratio of ratios R", stderr=error)
    value, error = estimate(nominal.ratio[..., 0])
    data |= variable("ratio_at_rest", "photodiode", value, "R at the scene's saturation", stderr=error)
    value, error = estimate(nominal.perfusion_index[..., 0])
    data |= variable("perfusion_index", pair, value, "perfusion index, ac over dc", stderr=error)
    for name, text in (("linear", "a and b of SpO2 = a + b R"), ("quadratic", "a, b, c of SpO2 = a + b R + c R^2")):
        values = getattr(fits, name)
        over = ("photodiode", f"{name}_term")
        data |= variable(name, over, values, text, units="percent", stderr=getattr(fits, f"{name}_stderr"))
        text = f"largest residual of the {name} calibration from 0.70 to 1.00"
        data |= variable(f"{name}_miss", "photodiode", getattr(fits, f"{name}_miss"), text, units="percent")
    (value, error), text = estimate(paths[0]), "mean path in the pulsatile blood"
    data |= variable("pulse_path_mm", pair, value, text, units="mm", stderr=error)
    value, error = estimate(paths[1])
    return data | variable("path_ratio", "photodiode", value, "red mean path over infrared's", stderr=error)


def _volts(
    transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, front_ends: list[SampledFrontEnd], seed: int
) -> Variables:
    """Both LEDs' readings over a beat, less the dark slot's, and the volts of every slot."""
    scene = transfer.scene
    states = [(scene.blood.so2, beat.resting, beat.pulse)]
    light = np.stack([read_states(transfer, led, states, seed=seed) for led in leds], -1)
    slots = np.stack([one.slot_volts(light[:, j])[0] for j, one in enumerate(front_ends)], 1)
    full = np.stack([one.slot_volts(light[0, j])[1].any((0, 1)) for j, one in enumerate(front_ends)])
    weights = np.stack([one.weights for one in front_ends])
    volts = np.einsum("gjts,jls->gljt", slots, weights)
    over, (value, error) = ("led", "photodiode", "beat_time"), estimate(volts)
    data = variable("volts", over, value, "reading over a beat, dark slot taken away", units="V", stderr=error)
    change, error = estimate(volts - volts.mean(-1, keepdims=True))
    data |= variable("volts_pulse", over, change, "reading less its mean over a beat", units="V", stderr=error)
    text = "volts of every slot at the mean of a beat"
    data |= variable("slot_volts", ("photodiode", "slot"), slots[0].mean(1), text, units="V")
    data |= variable("saturated", "photodiode", full, "converter at its limit in some slot")
    return data | variable("slot", "slot", np.array(front_ends[0].slot_names), "what is lit in a slot")


def _error_variables(
    calibrated: CalibratedOximeter, fits: Calibration, front_ends: list[SampledFrontEnd], volts: Variables
) -> Variables:
    """Error of SpO2 by its cause, for one beat and for 8 s. [percent]"""
    scene, nominal = calibrated.scene, calibrated.nominal
    ratio, index = nominal.ratio[0, :, 0], nominal.perfusion_index[0, ..., 0].T
    level_v = volts["volts"][1].mean(-1).T
    pulse = volts["volts_pulse"][1][1]
    shape = pulse.std(-1) / np.ptp(pulse, axis=-1)
    frame_hz = (scene.oximeter or Oximeter()).frame_hz
    spans = {"beat": 60.0 / heart_rate_per_min(scene), "": AVERAGE_S}
    detected = nominal.dc[0, ..., 0].T
    slope = np.abs(fits.linear[:, 1])
    data: Variables = {}
    for span, seconds in spans.items():
        rows = []
        for name in CAUSES:
            noise = np.stack([one.reading_noise_v2(f)[name] for one, f in zip(front_ends, detected, strict=True)])
            how = {"shape_rms": shape, "frames": seconds * frame_hz}
            rows.append(slope * ratio_stderr(ratio, index, level_v, noise, **how))
        rows.append(slope * jackknife(nominal.ratio[..., 0]))
        each, end = np.array(rows), f"_{span}" if span else ""
        text = f"standard error of SpO2 over {seconds:.3g} s"
        data |= variable(f"spo2_stderr{end}_by_cause", ("cause", "photodiode"), each, text, units="percent")
        total = np.sqrt((each**2).sum(0))
        data |= variable(f"spo2_stderr{end}", "photodiode", total, f"{text}, all causes", units="percent")
    return data


def _disturbance_variables(curve: SensitivityCurve) -> Variables:
    over = ("photodiode", curve.name)
    text = f"bias of SpO2 over: {curve.long_name}"
    data = variable(f"off_by_{curve.name}", over, curve.bias, text, units="percent", stderr=curve.bias_stderr)
    return data | variable(curve.name, curve.name, curve.values, curve.long_name, units=curve.units)


def _warnings(calibrated: CalibratedOximeter, front_ends: list[SampledFrontEnd], path_length_ratio: Array) -> list[str]:
    scene, nominal = calibrated.scene, calibrated.nominal
    lines = path_warnings(scene, nominal.ratio[0, :, 0], path_length_ratio[0])
    for j, (front_end, name) in enumerate(zip(front_ends, calibrated.transfer.photodiodes, strict=True)):
        _, full = front_end.slot_volts(nominal.dc[0, :, j, 0])
        lit = [slot for slot, over in zip(front_end.slot_names, full, strict=True) if over]
        if lit:
            lines.append(
                f'photodiode "{name}" saturates in slot "{lit[0]}": its volts do not measure the light; lower the '
                "LED's flux_mw or electronics.feedback_ohm"
            )
    crosstalk = float(np.abs(front_ends[0].corrected - np.eye(2)).max())
    if crosstalk > MOST_CROSSTALK:
        lines.append(
            f"slots: {100 * crosstalk:.1f} % of a reading is not its own LED's settled light; raise "
            "electronics.bandwidth_hz or oximeter.settle, or lengthen the slots"
        )
    return lines
