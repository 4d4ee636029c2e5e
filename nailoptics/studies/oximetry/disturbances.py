"""Disturbances of an oximeter: bias of SpO2 by touch, blood, melanin, the LEDs' lines, sunlight and unequal paths."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...light import Transfer, optics
from ...light.board_map import BoardTracer
from ...light.diffusion import DiffusionModel
from ...light.identity import light_scene
from ...light.tracing.store import LightStore
from ...scene import Oximeter, Scene
from ...scene.oximeter import two_leds
from ...sensor.ambient import SOURCES, Ambient, photocurrents_a
from ...sensor.front_end import SampledFrontEnd
from ...statistics import Z95, jackknife, seed_of
from ..pulsatile_blood import BloodBeat, beat_at, rest_force_n
from .ratio import MEASURED, TEXTBOOK, Pulsation, estimate, evaluate, in_scene, read_pulsations, saturation_of

Array = NDArray[np.float64]

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
# The paths of layered diffusion follow from so much less blood.
LESS_BLOOD = 0.01

# Photons that each photodiode sends back out: a leakage of 1e-4 is then known within a few parts in ten.
LEAKAGE_PHOTONS = 1 << 16
SPACING_MM = 0.2
_BACK = 31


@dataclass(frozen=True)
class SensitivityCurve:
    """Bias of SpO2 as one thing changes.

    values : (n,) float, of what changes.
    bias, bias_stderr : (photodiodes, n) float. Displayed less true saturation. [percent]
    """

    name: str
    long_name: str
    units: str
    values: Array
    bias: Array
    bias_stderr: Array


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
    seed: int

    def bias(self, ratio: Array, *, independent: bool = False) -> tuple[Array, Array]:
        """Bias of SpO2 and its standard error, (photodiodes, n) each. [percent]

        ratio : (1 + groups, photodiodes, n) float. With and without the same groups, so that shared noise
            cancels.
        independent : it is of another trace, whose noise is its own.
        """
        displayed, nominal = self._spo2(ratio), self._spo2(self.nominal.ratio)
        if not independent:
            return estimate(displayed - nominal)
        return (displayed - nominal)[0], np.hypot(jackknife(displayed), jackknife(nominal))

    def _spo2(self, ratio: Array) -> Array:
        out = np.full(ratio.shape, np.nan)
        for g, j in np.ndindex(ratio.shape[:2]):
            if np.isfinite(self.curve[g, j]).all():
                out[g, j] = 100 * saturation_of(ratio[g, j], self.so2, self.curve[g, j])
        return out

    def ratios(self, changes: list[tuple[Scene, BloodBeat]]) -> Array:
        """Ratios of ratios in scenes that differ only in absorption and spectra, (1 + groups, photodiodes, n) float."""
        out = []
        for scene, beat in changes:
            light = in_scene(self.transfer, scene)
            out.append(read_pulsations(light, self.leds, [(scene.blood.so2, beat)], seed=self.seed).ratio)
        return np.concatenate(out, -1)

    def beat(self) -> BloodBeat:
        """A beat of its scene at rest."""
        return beat_at(self.scene, rest_force_n(self.scene))

    @property
    def scene(self) -> Scene:
        """The scene as it is."""
        return self.transfer.scene


# What a curve is over (name, long name, units, values), and the scene and beat of each value.
Change = tuple[str, str, str, Array, list[tuple[Scene, BloodBeat]]]


def sensitivity_curves(
    oximeter: CalibratedOximeter, front_ends: list[SampledFrontEnd], sun_a: Array
) -> list[SensitivityCurve]:
    """All curves that follow from the scene's own trace.

    sun_a : (photodiodes,) float. Photocurrent by full sun. [A]
    """
    curves = [
        SensitivityCurve(name, text, units, values, *oximeter.bias(oximeter.ratios(changes)))
        for name, text, units, values, changes in _changes(oximeter)
    ]
    return [*curves, _sunlight(oximeter, front_ends, sun_a)]


def _changes(oximeter: CalibratedOximeter) -> Iterator[Change]:
    scene, beat, leds = oximeter.scene, oximeter.beat(), oximeter.leds
    assert scene.finger is not None
    pressed = [(scene, beat_at(scene, float(force))) for force in FORCES_N]
    yield "touch_force_n", "touch force", "N", FORCES_N, pressed
    bloods = [_with_blood(scene, rest_blood_fraction=float(rest)) for rest in REST_BLOOD]
    filled = [(one, beat_at(one, rest_force_n(one))) for one in bloods]
    yield "rest_blood_fraction", "blood in the bed at rest", "1", REST_BLOOD, filled
    fingers = [scene.finger.model_copy(update={"melanin_fraction": float(melanin)}) for melanin in MELANIN]
    darker = [(scene.model_copy(update={"finger": one}), beat) for one in fingers]
    yield "melanin_fraction", "melanin in the epidermis", "1", MELANIN, darker
    # The light scatters as at the wavelength that was traced.
    wider = [_with_lines(scene, leds, fwhm_nm=float(width)) for width in WIDTHS_NM]
    inside = [_has_tissue_data(one, leds) for one in wider]
    changes = [(one, beat) for one, known in zip(wider, inside, strict=True) if known]
    yield "line_width_nm", "width of both LEDs' lines", "nm", WIDTHS_NM[inside], changes
    for drift in DRIFTS_NM_PER_K:
        warmer = [_with_lines(scene, leds, shift_nm=drift * float(kelvin)) for kelvin in WARMER_K]
        inside = [_has_tissue_data(one, leds) for one in warmer]
        changes = [(one, beat) for one, known in zip(warmer, inside, strict=True) if known]
        text = f"LEDs warmer, lines that drift by {drift:g} nm/K"
        yield f"warmer_k_{round(1000 * drift)}_pm_per_k", text, "K", WARMER_K[inside], changes
    so2 = scene.blood.so2
    venous = [(_with_blood(scene, venous_so2=max(so2 - float(below), 0.0)), beat) for below in VENOUS_BELOW]
    yield "venous_below_arterial", "venous saturation below the arterial one", "1", VENOUS_BELOW, venous


def _sunlight(oximeter: CalibratedOximeter, front_ends: list[SampledFrontEnd], sun_a: Array) -> SensitivityCurve:
    """Sunlight on an oximeter that takes no dark reading away: it adds to what is steady."""
    nominal, ratios = oximeter.nominal, []
    for lux in SUN_LUX:
        level_a = np.stack([_photocurrent_a(one, nominal.dc[:, :, j, 0]) for j, one in enumerate(front_ends)], -1)
        diluted = nominal.perfusion_index[..., 0] * level_a / (level_a + sun_a * lux / SUN_LUX[-1])
        ratios.append(diluted[:, 0] / diluted[:, 1])
    text, bias = "sunlight with the dark slot left out", oximeter.bias(np.stack(ratios, -1))
    return SensitivityCurve("sunlight_lux", text, "lx", SUN_LUX, *bias)


def _photocurrent_a(front_end: SampledFrontEnd, fraction: Array) -> Array:
    """Photocurrent of both LEDs, (groups, 2) float, from their detected fractions. [A]"""
    return np.stack([front_end.photocurrent_a(fraction[:, k], led) for k, led in enumerate(front_end.leds)], -1)


def melanin_bound(oximeter: CalibratedOximeter) -> tuple[Array, Array]:
    """Upper bounds: the part of the detected light that met epidermis, and the bias of SpO2 by melanin.

    With 95 % confidence, (photodiodes,) float each: the larger part of both LEDs' light, and percent. Light that met
    epidermis may all be absorbed, of the steady and of the pulsating light.
    """
    transfer, share, change = oximeter.transfer, [], []
    column = transfer.absorbers.index("epidermis")
    beds = list(optics.bed_columns(oximeter.scene))
    for led in oximeter.leds:
        trace = transfer.traces[led]
        steady, pulsating = trace.weight, trace.weight * trace.path_mm[:, beds].sum(1)
        for values in (steady, pulsating):
            part = np.zeros(len(transfer.photodiodes))
            for j in range(len(part)):
                mine = trace.photodiode == j
                part[j] = _upper_part(values[mine], trace.path_mm[mine, column] > 0)
            change.append(part)
        share.append(change[-2])
    slope = np.abs(np.gradient(100 * oximeter.so2, axis=0) / np.gradient(oximeter.curve[0], axis=-1))
    nearest = int(np.abs(oximeter.so2 - oximeter.scene.blood.so2).argmin())
    return np.max(share, axis=0), slope[:, nearest] * oximeter.nominal.ratio[0, :, 0] * np.sum(change, axis=0)


def _upper_part(values: Array, met: NDArray[np.bool_]) -> float:
    """Upper end of the 95 % interval of the part of a sum that some of its terms make; of none, as if one of the
    largest had been missed three times (the rule of three)."""
    total = float(values.sum())
    if total <= 0:
        return 1.0
    part, effective = float(values[met].sum()) / total, total**2 / float((values**2).sum())
    spread = float(np.sqrt(((values * (met - part)) ** 2).sum())) / total
    return min(max(part + Z95 * spread, part + 3.0 / effective), 1.0)


def _has_tissue_data(scene: Scene, leds: tuple[int, int]) -> bool:
    """Whether tissue is known over both LEDs' lines."""
    low, high = tissue.WAVELENGTH_RANGE_NM
    wavelengths = np.concatenate([optics.spectrum(scene.leds[i])[0] for i in leds])
    return bool(wavelengths.min() >= low and wavelengths.max() <= high)


def _with_blood(scene: Scene, **fields: float) -> Scene:
    return scene.model_copy(update={"blood": scene.blood.model_copy(update=fields)})


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


def path_warnings(scene: Scene, ratio: Array, path_length_ratio: Array, *, how: str = "") -> list[str]:
    """One line for each photodiode on which published lines have a bias above 2 %, and what mends it.

    ratio, path_length_ratio : (photodiodes,) float. At the scene's saturation.
    how : a remark on how the paths were computed.
    """
    red, infrared = two_leds(scene.leds, scene.oximeter.slots if scene.oximeter else None)
    dies, lines = scene.layout.leds, []
    bias = literature_bias(ratio, scene.blood.so2)
    for element, r, paths, percent in zip(scene.layout.photodiodes, ratio, path_length_ratio, bias, strict=True):
        if not abs(percent) > MOST_BIAS:
            continue
        (u, v), name = element.area.center_mm, element.name
        near = [float(np.hypot(u - dies[i].center_mm[0], v - dies[i].center_mm[1])) for i in (red, infrared)]
        line = (
            f'photodiode "{name}": the path of red light in the pulsatile blood is {paths:.2f} times that of '
            f"infrared{how}, R({scene.blood.so2:g}) = {r:.2f}, and a textbook's line has a bias of {percent:+.1f} % "
            "or more; "
        )
        if abs(near[0] - near[1]) > 0.1:
            line += (
                f'it lies {near[0]:.2f} mm from "{scene.leds[red].name}" and {near[1]:.2f} mm from '
                f'"{scene.leds[infrared].name}": put it as far from both, on the axis between two dies side by side'
            )
        else:
            line += "it is as far from both LEDs: move it to 1.2 to 2 mm from them, or use the fit of this scene"
        lines.append(line)
    return lines


def warnings_without_light(scene: Scene) -> list[str]:
    """The same warnings from layered diffusion, in a fraction of a second; nothing where a scene is no oximeter.

    A scene is one if it says so with [oximeter].
    """
    if scene.oximeter is None or scene.finger is None:
        return []
    red, infrared = two_leds(scene.leds, scene.oximeter.slots)
    paths = diffusion_paths_mm(scene)
    path_ratio = paths[red] / paths[infrared]
    mu = [float(tissue.blood_mu_a_per_mm(scene.leds[i].wavelength_nm, scene.blood.so2)) for i in (red, infrared)]
    return path_warnings(scene, path_ratio * mu[0] / mu[1], path_ratio, how=" (by layered diffusion, about 15 %)")


def diffusion_paths_mm(scene: Scene) -> Array:
    """Mean path of each LED's light in the bed by layered diffusion, (led, photodiode) float. [mm]"""
    rest, zones = scene.blood.rest_blood_fraction, len(scene.zone_edges_mm) + 1
    states = np.full((2, zones), rest)
    states[1] *= 1 - LESS_BLOOD
    readings = DiffusionModel(scene).readings(states)
    mu = np.array([float(tissue.blood_mu_a_per_mm(led.wavelength_nm, scene.blood.rest_so2)) for led in scene.leds])
    return np.asarray(np.log(readings[..., 1] / readings[..., 0]) / (mu[:, None] * rest * LESS_BLOOD))


@dataclass(frozen=True)
class AmbientPhotocurrent:
    """Photocurrent by ambient light and its standard error, (photodiodes,) float each. [A]"""

    current_a: Array
    stderr_a: Array


def ambient_source(oximeter: Oximeter) -> Ambient:
    """The ambient light that an oximeter's table names."""
    named = next(source for source in SOURCES if source.name == oximeter.ambient_light)
    return replace(named, lux=oximeter.ambient_lux)


def ambient_leakage(
    scene: Scene,
    sources: list[Ambient],
    *,
    backend: str,
    seed: int,
    photons: int = LEAKAGE_PHOTONS,
    store: LightStore | None = None,
) -> list[AmbientPhotocurrent]:
    """Photocurrents of each ambient light on every photodiode, by reciprocity: from one trace of each photodiode's
    own light.

    Where none of n photons left the finger, the standard error is that of one.

    store : where light is looked for, and kept.
    """
    how: dict[str, Any] = {"backend": backend, "store": store, "seed": seed}
    tracer, rows = BoardTracer(light_scene(scene), spacing_mm=SPACING_MM, **how), []
    traced_nm = max(led.wavelength_nm for led in scene.leds)
    led = next(i for i, one in enumerate(scene.leds) if one.wavelength_nm == traced_nm)
    for j, element in enumerate(scene.layout.photodiodes):
        _, left = tracer.back(j, led, photons=photons, seed=seed_of(seed, _BACK, j))
        diode, area = element.photodiode, element.area.area_mm2
        for source in sources:
            light: dict[str, Any] = {"traced": tracer.scene, "traced_nm": traced_nm}
            each = photocurrents_a(left, scene, source, photodiode=diode, area_mm2=area, **light)
            whole = area * float(source.photocurrent_a_per_mm2(diode)[1].sum())
            one = float(each.max(initial=0.0)) or whole / photons
            total, square = float(each.sum()), float((each**2).sum())
            rows.append((total, np.sqrt(max(square - total**2 / photons, one**2))))
    found = np.array(rows).reshape(len(scene.layout.photodiodes), len(sources), 2)
    return [AmbientPhotocurrent(found[:, k, 0], found[:, k, 1]) for k in range(len(sources))]
