"""What moves the saturation that an oximeter shows, though the arteries' is the same: curves, each with its error."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import tissue
from ...light import Transfer, optics
from ...scene import Scene
from ...statistics import Z95, jackknife
from .beating_blood import BloodBeat, beat_at, rest_force_n
from .calibration_line import saturation_of
from .pulsation import Pulsation, changed, estimate, read_pulsations
from .slots import Stage

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


@dataclass(frozen=True)
class Curve:
    """How far the shown saturation is off as one thing changes.

    values : (n,) float of what changes.
    off, off_stderr : (photodiodes, n) float. Shown less true saturation. [percent]
    """

    name: str
    long_name: str
    units: str
    values: Array
    off: Array
    off_stderr: Array


@dataclass(frozen=True)
class Shown:
    """An oximeter that was calibrated with the scene as it is.

    curve : (1 + groups, photodiodes, n) float. Its ratio of ratios at saturations that rise, so2, (n,) float.
    """

    transfer: Transfer
    leds: tuple[int, int]
    so2: Array
    curve: Array
    own: Pulsation
    seed: int

    def off(self, ratio: Array, *, independent: bool = False) -> tuple[Array, Array]:
        """Change of the shown saturation and its standard error, (photodiodes, n) each. [percent]

        ratio : (1 + groups, photodiodes, n) float. With and without the same groups, so that shared noise cancels.
        independent : it is of another trace, whose noise is its own.
        """
        shown = self._shown(ratio)
        own = self._shown(self.own.ratio)
        if not independent:
            return estimate(shown - own)
        return (shown - own)[0], np.hypot(jackknife(shown), jackknife(own))

    def _shown(self, ratio: Array) -> Array:
        out = np.full(ratio.shape, np.nan)
        for g, j in np.ndindex(ratio.shape[:2]):
            if np.isfinite(self.curve[g, j]).all():
                out[g, j] = 100 * saturation_of(ratio[g, j], self.so2, self.curve[g, j])
        return out

    def reads(self, changes: list[tuple[Scene, BloodBeat]]) -> Array:
        """Ratios of ratios in scenes that only dim the light otherwise, (1 + groups, photodiodes, n) float."""
        found = []
        for scene, beat in changes:
            same = changed(self.transfer, scene)
            found.append(read_pulsations(same, self.leds, [(scene.blood.so2, beat)], seed=self.seed).ratio)
        return np.concatenate(found, -1)

    @property
    def scene(self) -> Scene:
        """The scene as it is."""
        return self.transfer.scene


def curves(shown: Shown, stages: list[Stage], sun_a: Array) -> list[Curve]:
    """All curves that the scene's own trace tells.

    sun_a : (photodiodes,) float. Photocurrent by full sun. [A]
    """
    made: list[Callable[[Shown], Iterator[Curve]]] = [_force, _blood, _melanin, _lines, _venous]
    found = [curve for make in made for curve in make(shown)]
    return [*found, _sunlight(shown, stages, sun_a)]


def _curve(shown: Shown, name: str, long_name: str, units: str, values: Array, ratio: Array) -> Curve:
    return Curve(name, long_name, units, values, *shown.off(ratio))


def _force(shown: Shown) -> Iterator[Curve]:
    changes = [(shown.scene, beat_at(shown.scene, float(force))) for force in FORCES_N]
    yield _curve(shown, "touch_force_n", "touch force", "N", FORCES_N, shown.reads(changes))


def _blood(shown: Shown) -> Iterator[Curve]:
    scenes = [_with_blood(shown.scene, rest_blood_fraction=float(rest)) for rest in REST_BLOOD]
    changes = [(scene, beat_at(scene, rest_force_n(scene))) for scene in scenes]
    yield _curve(shown, "rest_blood_fraction", "blood in the bed at rest", "1", REST_BLOOD, shown.reads(changes))


def _venous(shown: Shown) -> Iterator[Curve]:
    so2, beat = shown.scene.blood.so2, _own_beat(shown)
    scenes = [_with_blood(shown.scene, venous_so2=max(so2 - float(below), 0.0)) for below in VENOUS_BELOW]
    text = "venous saturation below the arterial one"
    ratio = shown.reads([(scene, beat) for scene in scenes])
    yield _curve(shown, "venous_below_arterial", text, "1", VENOUS_BELOW, ratio)


def _melanin(shown: Shown) -> Iterator[Curve]:
    finger, beat = shown.scene.finger, _own_beat(shown)
    assert finger is not None
    scenes = [
        shown.scene.model_copy(update={"finger": finger.model_copy(update={"melanin_fraction": float(melanin)})})
        for melanin in MELANIN
    ]
    ratio = shown.reads([(scene, beat) for scene in scenes])
    yield _curve(shown, "melanin_fraction", "melanin in the epidermis", "1", MELANIN, ratio)


def _lines(shown: Shown) -> Iterator[Curve]:
    """Line width and drift; the light scatters as at the wavelength that was traced."""
    beat = _own_beat(shown)
    scenes = [_with_lines(shown.scene, shown.leds, fwhm_nm=float(width)) for width in WIDTHS_NM]
    known = [_is_known(scene, shown.leds) for scene in scenes]
    ratio = shown.reads([(scene, beat) for scene, inside in zip(scenes, known, strict=True) if inside])
    yield _curve(shown, "line_width_nm", "width of both LEDs' lines", "nm", WIDTHS_NM[known], ratio)
    for drift in DRIFTS_NM_PER_K:
        scenes = [_with_lines(shown.scene, shown.leds, shift_nm=drift * float(kelvin)) for kelvin in WARMER_K]
        known = [_is_known(scene, shown.leds) for scene in scenes]
        scenes, warmer = [scene for scene, inside in zip(scenes, known, strict=True) if inside], WARMER_K[known]
        ratio = shown.reads([(scene, beat) for scene in scenes])
        text = f"LEDs warmer, lines that drift by {drift:g} nm/K"
        yield _curve(shown, f"warmer_k_{round(1000 * drift)}_pm_per_k", text, "K", warmer, ratio)


def _sunlight(shown: Shown, stages: list[Stage], sun_a: Array) -> Curve:
    """Sunlight on an oximeter that takes no dark reading away: it adds to what is steady."""
    own, ratios = shown.own, []
    for lux in SUN_LUX:
        level_a = np.stack([_photocurrent_a(stage, own.dc[:, :, j, 0]) for j, stage in enumerate(stages)], -1)
        diluted = own.perfusion_index[..., 0] * level_a / (level_a + sun_a * lux / SUN_LUX[-1])
        ratios.append(diluted[:, 0] / diluted[:, 1])
    text = "sunlight with the dark slot left out"
    return _curve(shown, "sunlight_lux", text, "lx", SUN_LUX, np.stack(ratios, -1))


def _photocurrent_a(stage: Stage, fraction: Array) -> Array:
    """Photocurrent of both LEDs, (groups, 2) float, from their detected fractions. [A]"""
    return np.stack([stage.photocurrent_a(fraction[:, k], led) for k, led in enumerate(stage.leds)], -1)


def melanin_bound(shown: Shown) -> tuple[Array, Array]:
    """How much of the detected light met epidermis, and by how much melanin can move what is shown, at most.

    With 95 % confidence, (photodiodes,) float each: the larger part of both LEDs' light, and percent. Light that met
    epidermis may all be swallowed, of what is steady and of what pulsates.
    """
    transfer, share, change = shown.transfer, [], []
    column = transfer.absorbers.index("epidermis")
    beds = list(optics.bed_columns(shown.scene))
    for led in shown.leds:
        trace = transfer.traces[led]
        steady, pulsating = trace.weight, trace.weight * trace.path_mm[:, beds].sum(1)
        for values in (steady, pulsating):
            part = np.zeros(len(transfer.photodiodes))
            for j in range(len(part)):
                mine = trace.photodiode == j
                part[j] = _upper_part(values[mine], trace.path_mm[mine, column] > 0)
            change.append(part)
        share.append(change[-2])
    slope = np.abs(np.gradient(100 * shown.so2, axis=0) / np.gradient(shown.curve[0], axis=-1))
    nearest = int(np.abs(shown.so2 - shown.scene.blood.so2).argmin())
    return np.max(share, axis=0), slope[:, nearest] * shown.own.ratio[0, :, 0] * np.sum(change, axis=0)


def _upper_part(values: Array, met: NDArray[np.bool_]) -> float:
    """Upper end of the 95 % interval of the part of a sum that some of its terms make; of none, as if one of the
    largest had been missed three times (the rule of three)."""
    total = float(values.sum())
    if total <= 0:
        return 1.0
    part, effective = float(values[met].sum()) / total, total**2 / float((values**2).sum())
    spread = float(np.sqrt(((values * (met - part)) ** 2).sum())) / total
    return min(max(part + Z95 * spread, part + 3.0 / effective), 1.0)


def _is_known(scene: Scene, leds: tuple[int, int]) -> bool:
    """Whether tissue is known over both LEDs' lines."""
    low, high = tissue.WAVELENGTH_RANGE_NM
    wavelengths = np.concatenate([optics.spectrum(scene.leds[i])[0] for i in leds])
    return bool(wavelengths.min() >= low and wavelengths.max() <= high)


def _own_beat(shown: Shown) -> BloodBeat:
    return beat_at(shown.scene, rest_force_n(shown.scene))


def _with_blood(scene: Scene, **fields: float) -> Scene:
    return scene.model_copy(update={"blood": scene.blood.model_copy(update=fields)})


def _with_lines(scene: Scene, which: tuple[int, int], *, fwhm_nm: float | None = None, shift_nm: float = 0.0) -> Scene:
    leds = list(scene.leds)
    for i in which:
        fields = {"wavelength_nm": leds[i].wavelength_nm + shift_nm}
        leds[i] = leds[i].model_copy(update=fields | ({} if fwhm_nm is None else {"fwhm_nm": fwhm_nm}))
    return scene.model_copy(update={"leds": tuple(leds)})
