"""Disturbances of an oximeter: bias of SpO2 by touch, blood, melanin, the LEDs' lines, sunlight and unequal paths."""

from dataclasses import dataclass, replace

import numpy as np

from ... import tissue
from ...hemodynamics.for_scene import BloodBeat, beat_at, rest_beat
from ...light import Transfer, optics
from ...scene import Scene
from ...sensor.front_end import SampledFrontEnd, red_and_infrared
from ...statistics import Array
from ...variables import Variables, jackknifed, variable
from ..prior_uncertainty import at_value
from .ratio import MEASURED, TEXTBOOK, Pulsation, evaluate, read_pulsations, saturation_of

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
        out = []
        for scene, beat in changes:
            light = replace(self.transfer, scene=scene)
            out.append(read_pulsations(light, self.leds, [(scene.blood.so2, beat)]).ratio)
        return np.concatenate(out, -1)


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
    """Bias of SpO2 as one thing changes; values : (n,) float. bias, stderr : (photodiodes, n) float. [percent]"""
    data = variable(
        f"off_by_{name}", ("photodiode", name), bias, f"bias of SpO2 over: {text}", units="percent", stderr=stderr
    )
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
    red, infrared = red_and_infrared(scene)
    dies, lines = scene.layout.leds, []
    bias = literature_bias(ratio, scene.blood.so2)
    for element, r, paths, percent in zip(scene.layout.photodiodes, ratio, path_length_ratio, bias, strict=True):
        if not abs(percent) > MOST_BIAS:
            continue
        (u, v), name = element.area.center_mm, element.name
        near = [float(np.hypot(u - dies[i].center_mm[0], v - dies[i].center_mm[1])) for i in (red, infrared)]
        line = (
            f'photodiode "{name}": the path of red light in the pulsatile blood is {paths:.2f} times that of '
            f"infrared, R({scene.blood.so2:g}) = {r:.2f}, and a textbook's line has a bias of {percent:+.1f} % "
            "or more; "
        )
        if abs(near[0] - near[1]) > 0.1:
            line += (
                f'it lies {near[0]:.2f} mm from "{scene.leds[red].name}" and {near[1]:.2f} mm from '
                f'"{scene.leds[infrared].name}": put it as far from both, on the axis between two dies side by side'
            )
        else:
            line += "it is as far from both LEDs: move it to 2.5 to 3.5 mm from them, or use the fit of this scene"
        lines.append(line)
    return lines
