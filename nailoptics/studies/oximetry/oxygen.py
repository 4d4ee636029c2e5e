"""A pulse oximeter from touch to SpO2: the ratio of ratios R against saturation, lines from R to SpO2 with their error,
and what disturbs them."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from ... import hemodynamics, tissue
from ...errors import NotReachedError, as_far_as_reached, unless_cut_off
from ...hemodynamics.for_scene import BloodBeat, beat_at, blood_over_touch, heart_rate_per_min, rest_beat
from ...light import ProgressCallback, Transfer, optics, trace
from ...light.detect import light_of
from ...light.tracing import Trigger, accuracy
from ...light.transfer.series import ChebyshevBox, read_replicates
from ...options import Requested, TraceOptions
from ...scene import Oximeter, Scene, SceneIn, as_scene
from ...sensor.ambient import LAMP, SUN, trace_ambient
from ...sensor.front_end import AVERAGE_S, CAUSES, SampledFrontEnd, front_end_of, oximeter_leds, ratio_stderr
from ...statistics import Array, jackknife, seed_of
from ...variables import Estimate, Variables, described, jackknifed, variable
from ..prior_uncertainty import at_value

# Readings are smooth in the saturation: over half of its range polynomials of this many nodes miss them by 1e-6.
NODES = 7
# SpO2 = intercept + slope R, in percent. The first is that of textbooks; the second is from 56 public recordings of one
# finger, 70 to 98 % by another oximeter, with residuals of 3.2 % rms (tests/benchmarks/real_oximeter.py).
TEXTBOOK = (110.0, -25.0)
MEASURED = (109.5, -31.2)
# Saturations over which lines are fitted, those at which oximeters are tested.
FIT_SO2 = np.linspace(0.70, 1.00, 31)
# Photons of the first round, whose error decides how many more are needed; rounds have seeds of their own.
FIRST_PHOTONS = 1 << 19
_ROUND = 41


def trace_for_ratio(
    scene: Scene,
    error_of: Callable[[Transfer], float],
    options: TraceOptions,
    *,
    max_seconds: float | None,
    progress: ProgressCallback | None = None,
) -> Transfer:
    """Light of every LED until an answer's relative error is that of the scene, or of the options.

    error_of : relative standard error of the answer from what was traced; inf where it is not known.
    max_seconds : wall time, in place of that of the scene and the options. [s]

    Raises: NotReachedError with the Transfer so far.
    """
    required, begin = accuracy(scene, options), time.perf_counter()
    plain, target = scene.model_copy(update={"accuracy": type(scene.accuracy)()}), required.relative_error
    if target is None:
        how = replace(options, relative_error=None, max_seconds=max_seconds, photons=required.photons)
        return replace(trace(plain, progress=progress, **how.fields), scene=scene)
    trigger = Trigger(target=target, first=FIRST_PHOTONS, least=FIRST_PHOTONS // 4, margin=1.15, growth=16)
    light: Transfer | None = None
    photons, left_s, rounds = trigger.first, max_seconds, 0
    while True:
        seed = seed_of(options.seed, _ROUND, rounds) >> 1 if rounds else options.seed
        how = replace(options, seed=seed, relative_error=None, max_seconds=left_s, photons=photons)
        more, unmet = as_far_as_reached(trace, plain, progress=progress, **how.fields)
        more = replace(more, scene=scene)
        light, rounds = light.merge(more) if light else more, rounds + 1
        per_led, error = light.photons // len(scene.leds), error_of(light)
        if not (photons := trigger.needed(per_led, error)):
            return light
        left_s = None if max_seconds is None else max_seconds - (time.perf_counter() - begin)
        if unmet or (left_s is not None and left_s <= 0):
            reached = f"{per_led} photons for each LED with a relative error of {error:.3g}"
            why = f"the trace ended at {reached} of the best photodiode's ratio of ratios, {target:g} requested"
            interrupted = bool(unmet and unmet.interrupted)
            raise NotReachedError(f"{why}; allow more time or require less.", result=light, interrupted=interrupted)


@dataclass(frozen=True)
class Pulsation:
    """Pulsating and steady light of the red and the infrared LED, by all photons and without each group of them.

    ac, dc : (1 + groups, 2, photodiodes, states) float. Fractions of the LED's power, weighted by the photodiode's
        response; ac is from the most blood in a beat to the least, dc at its mean.
    """

    ac: Array
    dc: Array

    @property
    def perfusion_index(self) -> Array:
        """ac over dc, (1 + groups, 2, photodiodes, states) float."""
        return _quotient(self.ac, self.dc)

    @property
    def ratio(self) -> Array:
        """The ratio of ratios, R = (ac/dc of red) / (ac/dc of infrared), (1 + groups, photodiodes, states) float."""
        index = self.perfusion_index
        return _quotient(index[:, 0], index[:, 1])


def _quotient(a: Array, b: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(a / b)


def absorption(scene: Scene, wavelength_nm: Array, so2: float, resting: Array, pulse: Array) -> Array:
    """Absorption where resting blood, arterial and venous, and a pulse of arterial blood fill the bed. [mm^-1]

    so2 : of the arteries.
    resting : (zones,) float. Mean blood of each zone.
    pulse : (m, zones) float. Blood over that.

    Returns: (m, q, absorbers) float.
    """
    saturated = scene.model_copy(update={"blood": scene.blood.with_so2(so2)})
    rest = optics.absorption(saturated, wavelength_nm, blood_fraction=resting)
    arterial = tissue.blood_mu_a_per_mm(wavelength_nm, so2)
    out = np.repeat(rest[None], len(pulse), 0)
    out[:, :, list(optics.bed_columns(scene))] += arterial[None, :, None] * pulse[:, None, :]
    return out


def read_states(transfer: Transfer, led: int, states: list[tuple[float, Array, Array]]) -> Array:
    """One LED's readings in states of the blood, (1 + groups, photodiodes, all rows of all pulses) float.

    states : saturation, resting blood and pulse of each, as in `absorption`.
    """
    wavelength, _ = optics.spectrum(transfer.scene.leds[led])
    mu_a = np.concatenate([absorption(transfer.scene, wavelength, *state) for state in states])
    return read_replicates(transfer, led, mu_a)[0]


def read_pulsations(transfer: Transfer, leds: tuple[int, int], states: list[tuple[float, BloodBeat]]) -> Pulsation:
    """Pulsation in some states, each a saturation and a beat.

    leds : numbers of the red and the infrared LED.
    """
    rows = [(so2, beat.resting, np.vstack([np.zeros_like(beat.resting), beat.extremes])) for so2, beat in states]
    read = np.stack([read_states(transfer, led, rows) for led in leds], 1)
    read = read.reshape(*read.shape[:3], len(states), 3)
    return Pulsation(ac=read[..., 1] - read[..., 2], dc=read[..., 0])


def saturation_curve(
    transfer: Transfer, leds: tuple[int, int], beat: BloodBeat, *, low: float, high: float
) -> Callable[[ArrayLike], Pulsation]:
    """Pulsation at every saturation in a range, (n,) float in parts of 1, for no more photons.

    It is interpolated between Chebyshev nodes.
    """
    box = ChebyshevBox([low], [high], [NODES])
    at_nodes = read_pulsations(transfer, leds, [(float(so2), beat) for (so2,) in box.nodes])

    def at(so2: ArrayLike) -> Pulsation:
        weights = box.weights(so2).T
        return Pulsation(ac=at_nodes.ac @ weights, dc=at_nodes.dc @ weights)

    return at


def path_length_ratios(transfer: Transfer, leds: tuple[int, int], beat: BloodBeat) -> Array:
    """Mean path of red light in the pulsatile blood over that of infrared, (1 + groups, photodiodes) float."""
    scene, paths = transfer.scene, []
    swing = np.ptp(beat.extremes, axis=0)
    for led in leds:
        wavelength, _ = optics.spectrum(scene.leds[led])
        mu_a = absorption(scene, wavelength, scene.blood.so2, beat.resting, np.zeros((1, len(swing))))
        paths.append(read_replicates(transfer, led, mu_a)[1] @ swing / swing.sum())
    return _quotient(*paths)


def calibrate_curve(so2: Array, ratio: Array, degree: int) -> tuple[Array, Array]:
    """Polynomials, from the constant up, that make SpO2 in percent of R; what they miss at most. [percent]

    so2 : (n,) float. In parts of 1.
    ratio : (1 + groups, photodiodes, n) float. Ratios of ratios there.

    Returns: (1 + groups, photodiodes, degree + 1) and (photodiodes,) float; NaN where a ratio is not known.
    """
    percent, fits = 100 * so2, np.full((*ratio.shape[:2], degree + 1), np.nan)
    for at in np.argwhere(np.isfinite(ratio).all(-1)):
        fits[tuple(at)] = np.polynomial.polynomial.polyfit(ratio[tuple(at)], percent, degree)
    residual = [evaluate(fit, ratios) - percent for fit, ratios in zip(fits[0], ratio[0], strict=True)]
    return fits, np.abs(residual).max(1)


def evaluate(coefficients: ArrayLike, ratio: ArrayLike) -> Array:
    """SpO2 of a ratio of ratios by a line or a parabola. [percent]"""
    return np.asarray(np.polynomial.polynomial.polyval(np.asarray(ratio, float), np.asarray(coefficients, float)))


def saturation_of(ratio: ArrayLike, so2: Array, curve: Array) -> Array:
    """The saturation at which a curve has a ratio of ratios, extrapolated beyond its ends. [parts of 1]

    so2, curve : (n,) float. Saturations that rise, and ratios there that fall.
    """
    from scipy.interpolate import interp1d

    at = interp1d(curve[::-1], so2[::-1], fill_value="extrapolate", assume_sorted=True)
    return np.asarray(at(ratio))


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

# By a larger bias of SpO2 a published line misleads. [percent]
MOST_BIAS = 2.0


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
    nominal: Pulsation

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
                out[g, j] = 100 * saturation_of(ratio[g, j], self.so2, self.curve[g, j])
        return out

    def ratio(self, changes: list[tuple[Scene, BloodBeat]]) -> Array:
        """Ratios of ratios in scenes that differ only in absorption and spectra, (1 + groups, photodiodes, n) float."""
        changed = ((replace(self.transfer, scene=scene), (scene.blood.so2, beat)) for scene, beat in changes)
        return np.concatenate([read_pulsations(light, self.leds, [state]).ratio for light, state in changed], -1)


def sensitivity_curves(oximeter: CalibratedOximeter, front_end: SampledFrontEnd, sun_a: Array) -> dict[str, Variables]:
    """Bias of SpO2 over each disturbance, by its name.

    sun_a : (photodiodes,) float. Photocurrent by full sun. [A]
    """
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
    text, bias = "sunlight with the dark slot left out", _sunlight(oximeter, front_end, sun_a)
    curves["sunlight_lux"] = _curve("sunlight_lux", text, "lx", SUN_LUX, *bias)
    return curves


def _curve(name: str, text: str, units: str, values: Array, bias: Array, stderr: Array) -> Variables:
    """Bias of SpO2 as one thing changes; values : (n,) float.

    bias, stderr : (photodiodes, n) float. [percent]
    """
    how: Any = {"long_name": f"bias of SpO2 over: {text}", "units": "percent", "stderr": stderr}
    data = variable(f"off_by_{name}", ("photodiode", name), bias, **how)
    return data | variable(name, name, values, text, units=units)


def _sunlight(oximeter: CalibratedOximeter, front_end: SampledFrontEnd, sun_a: Array) -> tuple[Array, Array]:
    """Bias by sunlight where no dark reading is taken away: it adds to what is steady."""
    nominal, ratios = oximeter.nominal, []
    steady = nominal.dc[..., 0]
    level_a = np.stack([front_end.photocurrent_a(steady[:, k], led) for k, led in enumerate(front_end.leds)], 1)
    for lux in SUN_LUX:
        diluted = nominal.perfusion_index[..., 0] * level_a / (level_a + sun_a * lux / SUN_LUX[-1])
        ratios.append(diluted[:, 0] / diluted[:, 1])
    return oximeter.bias(np.stack(ratios, -1))


def _with_lines(scene: Scene, which: tuple[int, int], *, fwhm_nm: float | None = None, shift_nm: float = 0.0) -> Scene:
    leds = list(scene.leds)
    for i in which:
        fields = {"wavelength_nm": leds[i].wavelength_nm + shift_nm}
        leds[i] = leds[i].model_copy(update=fields | ({} if fwhm_nm is None else {"fwhm_nm": fwhm_nm}))
    return scene.model_copy(update={"leds": tuple(leds)})


def literature_bias(ratio: Array, so2: float) -> Array:
    """Bias of SpO2 by the nearer of both published lines, the textbook's and that of fingers. [percent]

    ratio : (photodiodes,) float. Ratio of ratios at a saturation in parts of 1.
    """
    bias = np.stack([evaluate(line, ratio) - 100 * so2 for line in (TEXTBOOK, MEASURED)])
    return np.asarray(np.take_along_axis(bias, np.abs(bias).argmin(0)[None], 0)[0])


def path_warnings(scene: Scene, ratio: Array, path_length_ratio: Array) -> list[str]:
    """One line for each photodiode on which published lines have a larger bias, and what mends it.

    ratio, path_length_ratio : (photodiodes,) float. At the scene's saturation.
    """
    red, infrared = oximeter_leds(scene)
    dies, lines = scene.layout.leds, []
    bias = literature_bias(ratio, scene.blood.so2)
    for element, r, paths, percent in zip(scene.layout.photodiodes, ratio, path_length_ratio, bias, strict=True):
        if not abs(percent) > MOST_BIAS:
            continue
        near = [math.dist(element.area.center_mm, dies[i].center_mm) for i in (red, infrared)]
        cure = "it is as far from both LEDs: move it to 2.5 to 3.5 mm from them, or use the fit of this scene"
        if abs(near[0] - near[1]) > 0.1:
            from_both = [
                f'{mm:.2f} mm from "{scene.leds[i].name}"' for mm, i in zip(near, (red, infrared), strict=True)
            ]
            place = "put it as far from both, on the axis between two dies side by side"
            cure = f"it lies {' and '.join(from_both)}: {place}"
        longer = f"the path of red light in the pulsatile blood is {paths:.2f} times that of infrared"
        bias_of_line = f"R({scene.blood.so2:g}) = {r:.2f}, and a textbook's line has a bias of {percent:+.1f} % or more"
        lines.append(f'photodiode "{element.name}": {longer}, {bias_of_line}; {cure}')
    return lines


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
    sources, seed = (scene.ambient or LAMP, SUN), seed_of(options.seed, _LEAKAGE)
    (ambient_a, sun_a), (ambient_stderr_a, sun_stderr_a), _ = trace_ambient(scene, sources, options, seed=seed)
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
            full_in = f'photodiode "{name}" saturates in slot "{front_end.slot_names[int(over.argmax())]}"'
            cure = "lower the LED's flux_mw or electronics.feedback_ohm"
            lines.append(f"{full_in}: its volts do not measure the light; {cure}")
    crosstalk = float(np.abs(front_end.corrected - np.eye(2)).max())
    if crosstalk > MOST_CROSSTALK:
        cure = "raise electronics.bandwidth_hz or oximeter.settle, or lengthen the slots"
        lines.append(f"slots: {crosstalk:.1%} of a reading is not its own LED's settled light; {cure}")
    return lines
