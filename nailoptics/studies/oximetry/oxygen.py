"""A pulse oximeter from touch to SpO2: curve and lines of every photodiode, their error, and what disturbs them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import xarray as xr

from ... import hemodynamics, tissue
from ...errors import InputError, as_far_as_reached, unless_cut_off
from ...hemodynamics.for_scene import BloodBeat, beat_at, blood_over_touch, heart_rate_per_min, rest_beat
from ...light import ProgressCallback, Transfer, optics
from ...light.detect import light_of, unseen_leds
from ...light.tracing.store import LightStore
from ...options import Requested, TraceOptions
from ...scene import Oximeter, Scene, SceneIn, as_scene
from ...sensor.ambient import LAMP, SUN, trace_ambient
from ...sensor.front_end import AVERAGE_S, CAUSES, SampledFrontEnd, front_end_of, oximeter_leds, ratio_stderr
from ...statistics import Array, jackknife, seed_of
from ...variables import Estimate, Variables, described, jackknifed, stopwatch, variable
from ..prior_uncertainty import at_value
from . import ratio as pulsations

FORCES_N = np.linspace(0.0, 2.0, 9)
REST_BLOOD = np.linspace(0.01, 0.06, 6)
# From pale to the darkest skin, by volume of the epidermis.
MELANIN = np.array([0.0, 0.013, 0.05, 0.1, 0.2, 0.43])
WIDTHS_NM = np.linspace(0.0, 40.0, 6)
WARMER_K = np.linspace(-20.0, 20.0, 5)
# Shift of an LED's line with temperature, the least and the most of usual ones. [nm/K]
DRIFTS_NM_PER_K = (0.13, 0.25)
SUN_LUX = np.array([0.0, 1e3, 1e4, 3e4, 6e4, 1e5])
VENOUS_BELOW = np.linspace(0.0, 0.30, 7)


@dataclass(frozen=True)
class CalibratedOximeter:
    """An oximeter that was calibrated with the scene as it is.

    so2 : (n,) float. Saturations that rise.
    curve : (1 + groups, photodiodes, n) float. Its ratio of ratios there.
    nominal : pulsation in the scene as it is.
    """

    transfer: Transfer
    leds: tuple[int, int]
    so2: Array
    curve: Array
    nominal: pulsations.Pulsation

    def bias(self, ratio: Array) -> tuple[Array, Array]:
        """Bias of SpO2 and its standard error, (photodiodes, n) each. [percent]

        ratio : (1 + groups, photodiodes, n) float. With and without the same groups, so that shared noise
            cancels.
        """
        return jackknifed(self._spo2(ratio) - self._spo2(self.nominal.ratio))

    def _spo2(self, ratio: Array) -> Array:
        out = np.full(ratio.shape, np.nan)
        for g, j in np.ndindex(ratio.shape[:2]):
            if np.isfinite(self.curve[g, j]).all():
                out[g, j] = 100 * pulsations.saturation_of(ratio[g, j], self.so2, self.curve[g, j])
        return out

    def ratio(self, changes: list[tuple[Scene, BloodBeat]]) -> Array:
        """Ratios of ratios in scenes that differ only in absorption and spectra, (1 + groups, photodiodes, n) float."""
        changed = ((replace(self.transfer, scene=scene), (scene.blood.so2, beat)) for scene, beat in changes)
        read = (pulsations.read_pulsations(light, self.leds, [state]) for light, state in changed)
        return np.concatenate([one.ratio for one in read], -1)


def sensitivity_curves(oximeter: CalibratedOximeter, front_end: SampledFrontEnd, sun_a: Array) -> dict[str, Variables]:
    """Bias of SpO2 over each disturbance, by its name. sun_a : (photodiodes,) float. Photocurrent by full sun. [A]"""
    scene, leds, curves = oximeter.transfer.scene, oximeter.leds, dict[str, Variables]()
    beat, (low_nm, high_nm) = rest_beat(scene), tissue.WAVELENGTH_RANGE_NM

    def add(name: str, text: str, units: str, values: Array, changes: list[tuple[Scene, BloodBeat]]) -> None:
        # Light scatters as at the wavelength that was traced, however an LED's line moves.
        both_nm = [np.concatenate([optics.spectrum(variant.leds[i])[0] for i in leds]) for variant, _ in changes]
        known = [bool(nm.min() >= low_nm and nm.max() <= high_nm) for nm in both_nm]
        bias = oximeter.bias(oximeter.ratio([change for change, inside in zip(changes, known, strict=True) if inside]))
        curves[name] = _curve(name, text, units, values[known], *bias)

    def at(field: str, values: Array) -> list[tuple[Scene, BloodBeat]]:
        return [(at_value(scene, field, float(value)), beat) for value in values]

    def lines(name: str, values: Array) -> list[tuple[Scene, BloodBeat]]:
        return [(_with_lines(scene, leds, **{name: float(value)}), beat) for value in values]

    add("touch_force_n", "touch force", "N", FORCES_N, [(scene, beat_at(scene, float(x))) for x in FORCES_N])
    filled = [(variant, rest_beat(variant)) for variant, _ in at("blood.rest_blood_fraction", REST_BLOOD)]
    add("rest_blood_fraction", "blood in the bed at rest", "1", REST_BLOOD, filled)
    add("melanin_fraction", "melanin in the epidermis", "1", MELANIN, at("finger.melanin_fraction", MELANIN))
    add("line_width_nm", "width of both LEDs' lines", "nm", WIDTHS_NM, lines("fwhm_nm", WIDTHS_NM))
    for drift in DRIFTS_NM_PER_K:
        name, text = f"warmer_k_{round(1000 * drift)}_pm_per_k", f"LEDs warmer, lines that drift by {drift:g} nm/K"
        add(name, text, "K", WARMER_K, lines("shift_nm", drift * WARMER_K))
    text, venous = "venous saturation below the arterial one", np.maximum(scene.blood.so2 - VENOUS_BELOW, 0.0)
    add("venous_below_arterial", text, "1", VENOUS_BELOW, at("blood.venous_so2", venous))
    # Where no dark reading is taken away, sunlight adds to what is steady.
    lit = zip(np.moveaxis(oximeter.nominal.dc, 1, 0), front_end.leds, strict=True)
    level_a = np.stack([front_end.photocurrent_a(dc[..., 0], led)[..., None] for dc, led in lit], 1)
    diluted = oximeter.nominal.perfusion_index * level_a / (level_a + sun_a[:, None] * SUN_LUX / SUN_LUX[-1])
    text, bias = "sunlight with the dark slot left out", oximeter.bias(diluted[:, 0] / diluted[:, 1])
    curves["sunlight_lux"] = _curve("sunlight_lux", text, "lx", SUN_LUX, *bias)
    return curves


def _curve(name: str, text: str, units: str, values: Array, bias: Array, stderr: Array) -> Variables:
    """Bias of SpO2 as one thing changes; values : (n,) float. bias, stderr : (photodiodes, n) float. [percent]"""
    how: Any = {"long_name": f"bias of SpO2 over: {text}", "units": "percent", "stderr": stderr}
    data = variable(f"off_by_{name}", ("photodiode", name), bias, **how)
    return data | variable(name, name, values, text, units=units)


def _with_lines(scene: Scene, which: tuple[int, int], *, fwhm_nm: float | None = None, shift_nm: float = 0.0) -> Scene:
    leds = list(scene.leds)
    for i in which:
        fields = {"wavelength_nm": leds[i].wavelength_nm + shift_nm}
        leds[i] = leds[i].model_copy(update=fields | ({} if fwhm_nm is None else {"fwhm_nm": fwhm_nm}))
    return scene.model_copy(update={"leds": tuple(leds)})


SO2 = np.linspace(0.5, 1.0, 51)
# Part of one slot's light that may be left in the next.
MOST_CROSSTALK = 0.01
_LEAKAGE, ROUNDING_V = 52, 1e-9


def oximeter(
    scene: SceneIn,
    *,
    stores: Sequence[LightStore] | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """R against saturation for every photodiode of a two-LED scene, from one trace per wavelength.

    relative_error, of the scene or as requested, is that of the ratio of ratios on the photodiode where that is least.
    The best photodiode is that with the least error of SpO2 by the sensor's noise.

    stores : where light is read from and, in the first, stored; that of the user if not given.

    Returns: Dataset over photodiode, led (red, infrared), so2 and beat_time: ratio, perfusion index, calibrations,
    errors of SpO2 by cause for a beat and for 8 s, volts over a beat, paths, and curves of what disturbs, each estimate
    with its standard error; its attributes hold the warnings.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the light went.
    """
    scene = as_scene(scene)
    scene.require_blood("oximeter")
    run_time, options, leds = stopwatch(), TraceOptions(**requested), oximeter_leds(scene)
    states = [(scene.blood.so2, rest_beat(scene))]

    def error_of(light: Transfer) -> float:
        value, error = jackknifed(pulsations.read_pulsations(light, leds, states).ratio[..., 0])
        return float(np.nanmin(np.where(value > 0, error / value, np.inf), initial=np.inf))

    transfer, unmet = as_far_as_reached(
        pulsations.trace_for_ratio, scene, error_of, options, progress=progress, stores=stores
    )
    result = oximeter_from(transfer, options=options)
    result.attrs |= run_time()
    return unless_cut_off(result, unmet)


def oximeter_from(transfer: Transfer, *, options: TraceOptions) -> xr.Dataset:
    """What `oximeter` returns, from light that is already traced."""
    scene, leds = transfer.scene, oximeter_leds(transfer.scene)
    beat = rest_beat(scene)
    curve = pulsations.saturation_curve(transfer, leds, beat, low=min(SO2[0], scene.blood.so2), high=1.0)
    oximeter = CalibratedOximeter(transfer, leds, SO2, curve(SO2).ratio, curve(scene.blood.so2))
    sources, seed = (scene.ambient or LAMP, SUN), seed_of(options.seed, _LEAKAGE)
    (ambient_a, sun_a), (ambient_stderr_a, sun_stderr_a), _ = trace_ambient(scene, sources, options, seed=seed)
    front_end = front_end_of(scene, leds, ambient_a)
    path_ratio = pulsations.path_length_ratios(transfer, leds, beat)
    calibrations, ratio = Variables(), curve(pulsations.FIT_SO2).ratio
    for degree, name in ((2, "quadratic"), (1, "linear")):
        fits, miss = pulsations.calibrate_curve(pulsations.FIT_SO2, ratio, degree)
        calibrations |= described(__package__, **{name: jackknifed(fits), f"{name}_miss": miss})
    slope = np.abs(calibrations["linear"][1][:, 1])
    volts = _volts(transfer, leds, beat, front_end)
    level_v, bandwidth_hz = volts["volts"][1].mean(-1), scene.electronics.bandwidth_hz
    for k, j in np.argwhere((level_v < -ROUNDING_V) & ~volts["saturated"][1])[:1]:
        read = f'reads {level_v[k, j]:.2g} V in slot "{front_end.lights[k]}" less the dark one'
        cure = f"raise electronics.bandwidth_hz = {bandwidth_hz:g} or lengthen the slots, which do not settle"
        raise InputError(f'photodiode "{transfer.photodiodes[j]}" {read}; {cure}.')
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
        "cause": [*CAUSES],
    }
    # A photodiode that sees no light has no error. More photons do not change which has the least noise.
    noise, simulation = data["spo2_stderr"][1], data["spo2_simulation_stderr"][1]
    best = str(transfer.photodiodes[int(np.where(np.isfinite(noise + simulation), noise, np.inf).argmin())])
    about = {
        "title": "nailoptics: oxygen from volts",
        "seed": options.seed,
        "warnings": _warnings(oximeter, front_end, path_ratio[0]),
        "best": best,
        "so2": scene.blood.so2,
        "disturbances": list(disturbances),
        "rate_per_min": heart_rate_per_min(scene.body),
    }
    times = described(__package__, beat_time=beat.time_s, time=time_s)
    return xr.Dataset(data, names | times, transfer.attributes() | about)


def light_of_touch(scene: Scene, transfer: Transfer, leds: tuple[int, int]) -> tuple[Array, Array]:
    """Times of the frames over a scene's touch [s], and the light that is detected then, (2, photodiodes, t) float.

    The median of the blood is mixed, all else arterial, or as saturated as the balance of oxygen has it.
    """
    touch = scene.touch.model_copy(update={"sample_rate_hz": (scene.oximeter or Oximeter()).frame_hz})
    course = blood_over_touch(scene.model_copy(update={"touch": touch}))
    blood, light = course.blood_fraction.values, light_of(transfer)
    if scene.blood.oxygen_balance:
        so2 = course.so2.values
    else:
        resting = np.median(blood, axis=1, keepdims=True)
        mixed = hemodynamics.saturation(scene.blood, resting)
        so2 = scene.blood.so2 + (mixed - scene.blood.so2) * resting / np.maximum(blood, np.finfo(float).tiny)
    states = [optics.equivalent_blood(scene, scene.leds[led], blood, so2).T for led in leds]
    fractions = [light.readings_at(of_led).fraction[led] for led, of_led in zip(leds, states, strict=True)]
    return course.time.values, np.stack(fractions)


def _volts(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, front_end: SampledFrontEnd) -> Variables:
    """Both LEDs' readings over a beat, less the dark slot's, and the volts of every slot."""
    states = [(transfer.scene.blood.so2, beat.resting, beat.pulse)]
    light = np.stack([pulsations.read_states(transfer, led, states) for led in leds])
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
    """Error of SpO2 by the sensor's noise and its causes, for one beat and for 8 s, and by the trace. [percent]

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
        by_cause = slope * np.stack(by_noise)
        data |= {f"spo2_stderr{end}_by_cause": by_cause, f"spo2_stderr{end}": np.linalg.norm(by_cause, axis=0)}
    return described(__package__, spo2_simulation_stderr=slope * jackknife(nominal.ratio[..., 0]), **data)


def _warnings(oximeter: CalibratedOximeter, front_end: SampledFrontEnd, path_ratio: Array) -> list[str]:
    scene, nominal = oximeter.transfer.scene, oximeter.nominal
    lines = unseen_leds(scene) + pulsations.path_warnings(scene, nominal.ratio[0, :, 0], path_ratio)
    _, full = front_end.slot_volts(nominal.dc[0, ..., 0])
    for name, over in zip(oximeter.transfer.photodiodes, full.T, strict=True):
        if over.any():
            full_in = f'photodiode "{name}" saturates in slot "{front_end.slot_names[int(over.argmax())]}"'
            cure = "lower the LED's flux_mw or electronics.feedback_ohm"
            lines.append(f"{full_in}: its volts do not measure the light; {cure}")
    # How much of each LED's own light is in the red and the infrared reading, less the dark one.
    crosstalk = float(np.abs((front_end.weights @ front_end.mixing)[:, :2] - np.eye(2)).max())
    if crosstalk > MOST_CROSSTALK:
        cure = "raise electronics.bandwidth_hz or oximeter.settle, or lengthen the slots"
        lines.append(f"slots: {crosstalk:.1%} of a reading is not its own LED's settled light; {cure}")
    return lines
