"""A pulse oximeter from touch to SpO2: R against saturation, its calibration, its error, and what disturbs it."""

import time
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import NotReachedError, as_far_as_reached
from ...light import ProgressCallback, Transfer, trace
from ...light.store import LightStore
from ...light.tracing import INTERRUPTED, accuracy
from ...options import Requested, TraceOptions
from ...scene import Oximeter, Scene
from ...statistics import jackknife, seed_of
from ...variables import Variables, variable
from .beating_blood import BloodBeat, beat_at, oximeter_leds, rate_per_min, rest_force_n
from .calibration_line import FIT_FROM, FIT_POINTS, FIT_TO, Calibration, calibrate_curve
from .disturbances import SUN_LUX, Curve, Shown, curves, melanin_bound
from .leaking_light import Leak, leaks, source_of
from .path_balance import path_warnings
from .pulsation import Pulsation, SaturationCurve, estimate, path_ratios, read_pulsations, read_states
from .ratio_trace import trace_for_ratio
from .simulated_recording import light_of_touch
from .slots import AVERAGE_S, CAUSES, Stage, ratio_stderr, stages_of

Array = NDArray[np.float64]

SO2 = np.linspace(0.5, 1.0, 51)
# Of nails as thin and as thick as these a trace of their own is made, of so many of the scene's photons. [mm]
NAILS_MM = (0.35, 0.55, 0.70)
NAIL_SHARE, LEAST_NAIL_PHOTONS = 0.15, 1 << 17
# Part of the time, where it is limited, for the scene itself; the nails have equal parts of the rest.
OWN_TIME = 0.7
# What of one slot's light may be left in the next.
MOST_CARRIED = 0.01
_GROUPS, _LEAK, _NAIL = 51, 52, 53


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
    shown = Shown(transfer, leds, SO2, curve.at(SO2).ratio, curve.at(scene.blood.so2), seed)
    fits = calibrate_curve(
        np.linspace(FIT_FROM, FIT_TO, FIT_POINTS), curve.at(np.linspace(FIT_FROM, FIT_TO, FIT_POINTS)).ratio
    )
    inside, sun = _ambient(scene, options)
    stages = stages_of(scene, leds, inside.current_a)
    paths = path_ratios(transfer, leds, beat, seed=seed)
    data = _curve_variables(curve, shown.own, fits, paths)
    time_s, light = light_of_touch(scene, transfer, leds, seed=seed)
    volts = _volts(transfer, leds, beat, stages, seed)
    text = "detected fraction of the emitted power over the touch, frame by frame"
    data |= variable("detected_fraction", ("led", "photodiode", "time"), light, text)
    data |= volts | _error_variables(shown, fits, stages, beat, volts)
    found = [*curves(shown, stages, sun.current_a), *_nail_curve(shown, nails)]
    for one in found:
        data |= _disturbance_variables(one)
    met, most = melanin_bound(shown)
    data |= variable("epidermis_part_bound", "photodiode", met, "part of the light that met epidermis, at most (95 %)")
    data |= variable("melanin_bound", "photodiode", most, "change by melanin, at most (95 %)", units="percent")
    for name, leak, text in (("ambient_a", inside, "light from outside"), ("sun_a", sun, "full sun")):
        data |= variable(name, "photodiode", leak.current_a, f"photocurrent of {text}", units="A", stderr=leak.stderr_a)
    names = {
        "photodiode": list(transfer.photodiodes),
        "led": [scene.leds[i].name for i in leds],
        "so2": SO2,
        "cause": [*CAUSES, "trace"],
        "beat_time": ("beat_time", beat.time_s, {"units": "s", "long_name": "time from the start of a beat"}),
        "time": ("time", time_s, {"units": "s", "long_name": "time from the start of the touch"}),
    }
    told = _warnings(shown, stages, paths[1])
    # A photodiode that sees no light has no error.
    best = str(transfer.photodiodes[int(np.nan_to_num(data["spo2_stderr"][1], nan=np.inf).argmin())])
    about = {"title": "nailoptics: oxygen from volts", "seed": options.seed, "warnings": told, "best": best}
    about |= {"so2": scene.blood.so2, "disturbances": [one.name for one in found], "rate_per_min": rate_per_min(scene)}
    return xr.Dataset(data, names, transfer.attributes() | about)


def _ambient(scene: Scene, options: TraceOptions) -> tuple[Leak, Leak]:
    """The light from outside that the scene names, and full sun."""
    own = source_of(scene.oximeter or Oximeter())
    sun = source_of(Oximeter(ambient_light="sun", ambient_lux=float(SUN_LUX[-1])))
    store = LightStore.of_user() if options.store else None
    one, two = leaks(scene, [own, sun], backend=options.backend, seed=seed_of(options.seed, _LEAK), store=store)
    if store is not None:
        store.close()
    return one, two


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
        if str(unmet).startswith(INTERRUPTED):
            break
        found[thickness_mm] = light
    return found


def _missing(nails: dict[float, Transfer]) -> str:
    """What an interrupt left out, if it did."""
    done = f"{len(nails)} of {len(NAILS_MM)} other thicknesses of the nail plate are traced."
    return "" if len(nails) == len(NAILS_MM) else f"{INTERRUPTED}: {done}"


def _nail_curve(shown: Shown, nails: dict[float, Transfer]) -> list[Curve]:
    if not nails:
        return []
    finger, rows = shown.scene.finger, []
    assert finger is not None
    for light in nails.values():
        beat = beat_at(light.scene, rest_force_n(light.scene))
        ratio = read_pulsations(light, shown.leds, [(light.scene.blood.so2, beat)], seed=shown.seed).ratio
        rows.append(shown.off(ratio, independent=True))
    off, stderr = (np.concatenate(each, -1) for each in zip(*rows, strict=True))
    own = np.zeros((len(off), 1))
    thickness, off = np.append(list(nails), finger.nail_thickness_mm), np.hstack([off, own])
    order, stderr = np.argsort(thickness), np.hstack([stderr, own])
    text = "thickness of the nail plate"
    return [Curve("nail_thickness_mm", text, "mm", thickness[order], off[:, order], stderr[:, order])]


def _curve_variables(
    curve: SaturationCurve, own: Pulsation, fits: Calibration, paths: tuple[Array, Array]
) -> Variables:
    pair, over = ("led", "photodiode"), ("photodiode", "so2")
    value, error = estimate(curve.at(SO2).ratio)
    data = variable("ratio", over, value, "ratio of ratios R", stderr=error)
    value, error = estimate(own.ratio[..., 0])
    data |= variable("ratio_at_rest", "photodiode", value, "R at the scene's saturation", stderr=error)
    value, error = estimate(own.perfusion_index[..., 0])
    data |= variable("perfusion_index", pair, value, "perfusion index, ac over dc", stderr=error)
    for name, text in (("linear", "a and b of SpO2 = a + b R"), ("quadratic", "a, b, c of SpO2 = a + b R + c R^2")):
        values = getattr(fits, name)
        over = ("photodiode", f"{name}_term")
        data |= variable(name, over, values, text, units="percent", stderr=getattr(fits, f"{name}_stderr"))
        text = f"the most by which the {name} calibration misses from 0.70 to 1.00"
        data |= variable(f"{name}_miss", "photodiode", getattr(fits, f"{name}_miss"), text, units="percent")
    (value, error), text = estimate(paths[0]), "mean path in the blood that beats"
    data |= variable("pulse_path_mm", pair, value, text, units="mm", stderr=error)
    value, error = estimate(paths[1])
    return data | variable("path_ratio", "photodiode", value, "red mean path over infrared's", stderr=error)


def _volts(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, stages: list[Stage], seed: int) -> Variables:
    """Both LEDs' readings over a beat, less the dark slot's, and the volts of every slot."""
    scene = transfer.scene
    states = [(scene.blood.so2, beat.resting, beat.pulse)]
    light = np.stack([read_states(transfer, led, states, seed=seed) for led in leds], -1)
    slots = np.stack([stage.slot_volts(light[:, j])[0] for j, stage in enumerate(stages)], 1)
    full = np.stack([stage.slot_volts(light[0, j])[1].any((0, 1)) for j, stage in enumerate(stages)])
    weights = np.stack([stage.weights for stage in stages])
    each = np.einsum("gjts,jls->gljt", slots, weights)
    over, (value, error) = ("led", "photodiode", "beat_time"), estimate(each)
    data = variable("volts", over, value, "reading over a beat, dark slot taken away", units="V", stderr=error)
    change, error = estimate(each - each.mean(-1, keepdims=True))
    data |= variable("volts_pulse", over, change, "reading less its mean over a beat", units="V", stderr=error)
    text = "volts of every slot at the mean of a beat"
    data |= variable("slot_volts", ("photodiode", "slot"), slots[0].mean(1), text, units="V")
    data |= variable("saturated", "photodiode", full, "converter at its limit in some slot")
    own = [slot.light for slot in (scene.oximeter or Oximeter()).schedule([scene.leds[i] for i in leds])]
    return data | variable("slot", "slot", np.array(own), "what is lit in a slot")


def _error_variables(
    shown: Shown, fits: Calibration, stages: list[Stage], beat: BloodBeat, volts: Variables
) -> Variables:
    """Error of SpO2 by its cause, for one beat and for 8 s. [percent]"""
    ratio, index = shown.own.ratio[0, :, 0], shown.own.perfusion_index[0, ..., 0].T
    level_v = volts["volts"][1].mean(-1).T
    pulse = volts["volts_pulse"][1][1]
    shape = pulse.std(-1) / np.ptp(pulse, axis=-1)
    frame_hz = (shown.scene.oximeter or Oximeter()).frame_hz
    spans = {"beat": 60.0 / rate_per_min(shown.scene), "": AVERAGE_S}
    detected = shown.own.dc[0, ..., 0].T
    slope = np.abs(fits.linear[:, 1])
    data: Variables = {}
    for span, seconds in spans.items():
        rows = []
        for name in CAUSES:
            noise = np.stack([stage.reading_noise_v2(f)[name] for stage, f in zip(stages, detected, strict=True)])
            how = {"shape_rms": shape, "frames": seconds * frame_hz}
            rows.append(slope * ratio_stderr(ratio, index, level_v, noise, **how))
        rows.append(slope * jackknife(shown.own.ratio[..., 0]))
        each, end = np.array(rows), f"_{span}" if span else ""
        text = f"standard error of SpO2 over {seconds:.3g} s"
        data |= variable(f"spo2_stderr{end}_by_cause", ("cause", "photodiode"), each, text, units="percent")
        total = np.sqrt((each**2).sum(0))
        data |= variable(f"spo2_stderr{end}", "photodiode", total, f"{text}, all causes", units="percent")
    return data


def _disturbance_variables(curve: Curve) -> Variables:
    over = ("photodiode", curve.name)
    text = f"shown less true saturation over: {curve.long_name}"
    data = variable(f"off_by_{curve.name}", over, curve.off, text, units="percent", stderr=curve.off_stderr)
    return data | variable(curve.name, curve.name, curve.values, curve.long_name, units=curve.units)


def _warnings(shown: Shown, stages: list[Stage], path_ratio: Array) -> list[str]:
    scene, own = shown.scene, shown.own
    lines = path_warnings(scene, own.ratio[0, :, 0], path_ratio[0])
    for stage, name, j in zip(stages, shown.transfer.photodiodes, range(len(stages)), strict=True):
        _, full = stage.slot_volts(own.dc[0, :, j, 0])
        lit = [slot for slot, over in zip(stage.slot_names, full, strict=True) if over]
        if lit:
            lines.append(
                f'photodiode "{name}" saturates in slot "{lit[0]}": its volts do not tell the light; lower the '
                "LED's flux_mw or electronics.feedback_ohm"
            )
    carried = float(np.abs(stages[0].corrected - np.eye(2)).max())
    if carried > MOST_CARRIED:
        lines.append(
            f"slots: {100 * carried:.1f} % of a reading is not its own LED's settled light; raise "
            "electronics.bandwidth_hz or oximeter.settle, or lengthen the slots"
        )
    return lines


def summary(result: xr.Dataset) -> dict[str, Any]:
    """What an oximeter's result says, ready for JSON; so2 in parts of 1, everything called SpO2 in percent."""
    scene_so2, leds = float(result.attrs["so2"]), [str(name) for name in result.led.values]
    readings = {}
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        terms, errors = one.linear.values.tolist(), one.linear_stderr.values.tolist()
        readings[str(name)] = {
            "so2": one.so2.values.tolist(),
            "ratio": one.ratio.values.tolist(),
            "ratio_stderr": one.ratio_stderr.values.tolist(),
            "ratio_at_rest": {
                "so2": scene_so2,
                "value": float(one.ratio_at_rest),
                "stderr": float(one.ratio_at_rest_stderr),
            },
            "fit": {"intercept": terms[0], "slope": terms[1], "intercept_stderr": errors[0], "slope_stderr": errors[1]}
            | {"miss": float(one.linear_miss), "quadratic": one.quadratic.values.tolist()},
            "perfusion_index": dict(zip(leds, one.perfusion_index.values.tolist(), strict=True)),
            "perfusion_index_stderr": dict(zip(leds, one.perfusion_index_stderr.values.tolist(), strict=True)),
            "path_ratio": float(one.path_ratio),
            "path_ratio_stderr": float(one.path_ratio_stderr),
            "spo2_stderr": float(one.spo2_stderr),
            "spo2_stderr_beat": float(one.spo2_stderr_beat),
            "spo2_stderr_by_cause": dict(
                zip(map(str, one.cause.values), one.spo2_stderr_by_cause.values.tolist(), strict=True)
            ),
            "saturated": bool(one.saturated),
            "melanin_bound": float(one.melanin_bound),
            "disturbances": {
                key: {
                    "values": one[key].values.tolist(),
                    "spo2_off": one[f"off_by_{key}"].values.tolist(),
                    "stderr": one[f"off_by_{key}_stderr"].values.tolist(),
                }
                for key in result.attrs["disturbances"]
            },
        }
    kept = ("best", "warnings", "photons", "engine", "backend", "cpu_seconds", "wall_seconds", "digest")
    return {"readings": readings} | {name: result.attrs[name] for name in kept}
