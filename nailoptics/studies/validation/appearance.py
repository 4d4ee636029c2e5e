"""Colours of the model's nails and spectra of its skin beside those of people."""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d

from ...checks import Array
from ...light import backend
from ...light.identity import light_digest
from ...light.tracing.store import LightStore
from ...light.walk.nail_reflectance import NailReflectance, Patch
from ...options import TraceOptions
from ...scene import Finger, Scene, load_scene
from ...scene.base import USUAL_PULP_BLOOD_FRACTION
from ...statistics import Z95
from ..colour.nail_colour import ALONG, patches_of
from ..colour.reflectance import WAVELENGTHS_NM, ColourRays, Viewer, lab_of, walk_colour
from ..prior_uncertainty import PriorSensitivity, at_value, over_priors
from . import people_tables
from .comparison import Comparison, interval, moments, part_between, texts_of
from .people_tables import NAIL_RGB, SKIN_RGB, SPECTRUM_NM, people_count, percentile, pooled, read_people

# Rays of all wavelengths where no photons are requested; those of the nail are a part of them.
RAYS, NAIL_SHARE = 400_000, 0.25
# Rays of all nodes for each optics whose light the priors need.
OWN_RAYS = 24_000
# Groups of people with whose skin photographs are scaled.
SCALED_TO = ("CA", "CN")
# Of a ring finger's pulp, what a spectrophotometer measures: light from all sides (CIE 15, d:8), gloss included, falls
# through a port of 11 mm onto the skin, of which 8 mm are seen (Konica Minolta CM-700d; that it was that is judgement).
PAD = Patch((0.0, 0.0), (7.1, 7.1), port_mm=11.0)
# Its bandwidth is some 10 nm at half height: the mean of three of `WAVELENGTHS_NM` has the variance of such a triangle.
BAND = 3
# Melanin, and blood of the skin, between which those of a group of people are sought.
MELANIN = np.geomspace(0.005, 0.4, 24)
SKIN_BLOOD = np.geomspace(0.1, 1.0, 6) * USUAL_PULP_BLOOD_FRACTION
# Linear sRGB to X, Y, Z (IEC 61966-2-1).
XYZ_OF_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
# Every third person was left out when the nail plate was fitted (assets/spectra/fit_nail_plate.py).
FOLDS = 3
# What of a finger decides the colour of its pulp; of the nail, all of the finger and its blood at rest do.
OF_SKIN = ("finger.pulp_absorption", "finger.pulp_scattering", "blood.so2")
OF_FITTED_SKIN = ("finger.melanin_fraction", "blood.pulp_blood_fraction")
BLOOD_OF_NAIL = ("blood.rest_blood_fraction", "blood.pulp_blood_fraction", "blood.so2")
# Between two bands of oxyhaemoglobin lies the middle of the W. [nm]
W_NM = (540.0, 560.0, 580.0)


class _Reflectance:
    """Reflectance of one place on a shipped finger, without its board, over its optics."""

    def __init__(self, scene: Scene, patch: Patch, options: TraceOptions, *, share: float = 1.0) -> None:
        self.patch, self.options = patch, options
        self.backend = backend.activate_jit(options.backend, "validate").name
        self.rays = self._walked(scene, round(share * (options.photons or RAYS)))
        self.scene, self._few = self.rays.scene, dict[str, ColourRays]()

    def _walked(self, scene: Scene, photons: int) -> ColourRays:
        nail = NailReflectance(scene, backend=self.backend, stores=LightStore.of_command(self.options))
        return walk_colour(nail, (self.patch,), photons=photons, seed=self.options.seed)

    def read(self, scene: Scene, rays: ColourRays | None = None, *, gloss: bool = False) -> Array:
        """At the wavelengths of colours, by all rays and without each group of them, (1 + groups, q) float."""
        rest = np.full((1, scene.zone_count), scene.blood.rest_blood_fraction)
        viewing = scene.colour.model_copy(update={"gloss": gloss})
        return (rays or self.rays).read(rest, viewing, scene=scene).reflectance[:, 0, 0]

    def over_priors(
        self, scene: Scene, fields: Sequence[str], quantities: Callable[[Scene, ColourRays], Array]
    ) -> PriorSensitivity:
        """Quantities of a scene and its rays, (1 + groups, ...) float, over priors: what scatters is walked anew."""
        priors = [prior for prior in scene.finger_priors if prior.field in fields]
        base, twin = quantities(scene, self.rays), quantities(scene, self.few(scene))
        return over_priors(scene, priors, lambda varied: base + quantities(varied, self.few(varied)) - twin)

    def few(self, scene: Scene) -> ColourRays:
        """Fewer rays, of any scattering, with the same random numbers, so that what all have in common cancels."""
        key = light_digest(scene)
        if key not in self._few:
            self._few[key] = self._walked(scene, min(OWN_RAYS, self.options.photons or RAYS))
        return self._few[key]


def nails(photos: pd.DataFrame, options: TraceOptions) -> dict[str, Comparison]:
    """L*, a*, b* of nails, one value for each person, and how colours change with haemoglobin."""
    scene, viewer = load_scene("prototype"), Viewer()
    more = 1 + people_tables.HAEMOGLOBIN_STEP_G_PER_L / photos["hb_g_per_l"].mean()
    nail = _Reflectance(scene, patches_of(scene)[ALONG // 2], options, share=NAIL_SHARE)

    def quantities(varied: Scene, rays: ColourRays) -> Array:
        bled = at_value(varied, "blood.rest_blood_fraction", float(more * varied.blood.rest_blood_fraction))
        both = np.stack([nail.read(varied, rays), nail.read(bled, rays)])
        effects = _effects(_linear_rgb(both))
        return np.column_stack([viewer.lab(both[0]), *(after - before for before, after in effects.values())])

    fields = [p.field for p in scene.finger_priors if p.field.startswith("finger.")]
    middle, spread, noise = moments(nail.over_priors(nail.scene, [*fields, *BLOOD_OF_NAIL], quantities))
    return _colours(photos, middle, spread) | _slopes(photos, middle[3:], spread[3:], noise[3:])


def _colours(photos: pd.DataFrame, middle: Array, spread: Array) -> dict[str, Comparison]:
    """L*, a*, b* of people who were not fitted, and of the model, (3,) float or more each."""
    held_out = np.arange(len(photos)) % FOLDS == FOLDS - 1
    people = nails_lab(photos[held_out] if photos.attrs["shipped"] else photos)
    result = {}
    for k, band in enumerate(("L*", "a*", "b*")):
        texts = texts_of("nail", photos, band=band, people=len(people))
        result[f"nail_{band[0]}"] = Comparison.by_coverage(texts, people[:, k], interval(middle[k], spread[k]))
    return result


def _slopes(photos: pd.DataFrame, middle: Array, spread: Array, noise: Array) -> dict[str, Comparison]:
    """Changes of colours with haemoglobin, of people and of the model, (3,) float each in the order of `_effects`."""
    result = {}
    for k, (name, values) in enumerate(_effects(photos[NAIL_RGB].to_numpy()).items()):
        people, model = people_tables.slope_within_days(photos, values), (float(middle[k]), float(noise[k]))
        texts = texts_of(f"haemoglobin_{name}", photos, step=people_tables.HAEMOGLOBIN_STEP_G_PER_L)
        result[f"haemoglobin_{name}"] = Comparison.by_standard_errors(texts, people, model, float(spread[k]))
    return result


def _effects(rgb: Array) -> dict[str, Array]:
    """What of linear sRGB, (..., 3) float, is compared over haemoglobin: ln in percent, and a*, (...) float each."""
    red, green, _ = 100 * np.moveaxis(np.log(rgb), -1, 0)
    return {"green": green, "green_over_red": green - red, "redness": _lab(rgb)[..., 1]}


def _linear_rgb(reflectance: Array) -> Array:
    """Linear sRGB by daylight of reflectances (..., q), (..., 3) float."""
    return np.asarray(reflectance @ Viewer().weights @ np.linalg.inv(XYZ_OF_RGB).T)


def _lab(rgb: Array) -> Array:
    """CIE 1976 L*a*b* of linear sRGB by daylight, (..., 3) float each."""
    return lab_of(rgb @ XYZ_OF_RGB.T, XYZ_OF_RGB.sum(1))


def nails_lab(photos: pd.DataFrame) -> Array:
    """L*, a*, b* of people's nails, (p, 3) float. The level of a nail is that of the skin beside it, times what a
    spectrophotometer measured on the shipped hands."""
    spectra = read_people("skin_spectra")
    hands = spectra[spectra.place == "back of hand"]
    skin = np.mean([percentile(hands[hands.group == group], 50) for group in SCALED_TO], 0) / 100
    skin_rgb = _linear_rgb(np.interp(WAVELENGTHS_NM, SPECTRUM_NM, skin))
    return _lab(photos[NAIL_RGB].to_numpy() / photos[SKIN_RGB].to_numpy() * skin_rgb)


class Skin(_Reflectance):
    """A ring finger's pulp, as a spectrophotometer measures it."""

    def __init__(self, options: TraceOptions) -> None:
        super().__init__(load_scene("prototype").model_copy(update={"finger": Finger(digit="ring")}), PAD, options)

    def spectrum(self, scene: Scene, rays: ColourRays | None = None) -> Array:
        """At `SPECTRUM_NM`, by all rays and without each group of them, (1 + groups, q) float. [percent]"""
        read = uniform_filter1d(self.read(scene, rays, gloss=True), BAND, axis=-1, mode="nearest")
        return np.asarray(100 * read[:, np.isin(WAVELENGTHS_NM, SPECTRUM_NM)])

    def bands(self, scene: Scene, fields: Sequence[str]) -> tuple[Array, Array]:
        """The spectrum [percent] and its W over priors: low, the scene's and high, (3, q) and (3,) float."""

        def quantities(varied: Scene, rays: ColourRays) -> Array:
            spectrum = self.spectrum(varied, rays)
            return np.log(np.column_stack([spectrum, _w(spectrum)]))

        answers = self.over_priors(scene, fields, quantities)
        middle, spread, _ = moments(answers)
        both = np.exp([middle - Z95 * spread, answers.base_answer[0], middle + Z95 * spread])
        return both[:, :-1], both[:, -1]

    def fingers(self, table: pd.DataFrame) -> dict[str, Comparison]:
        """Ring fingers beside the shipped skin, and the depth of the W of oxyhaemoglobin."""
        model, w = self.bands(self.scene, (*OF_SKIN, *OF_FITTED_SKIN))
        people, inside = pooled(table, (5, 50, 95)), part_between(model[1], *pooled(table, (25, 75)))
        texts = texts_of("ring_finger", table, people=people_count(table))
        result = {"ring_finger": Comparison.of_curve(texts, inside, people, model, SPECTRUM_NM)}
        return result | _w_depth("w_of_ring_finger", table, [w] * table.group.nunique())

    def hands(self, table: pd.DataFrame) -> dict[str, Comparison]:
        """Hands of each group with the melanin and the blood that come nearest to its median, and their W."""
        few, depths, result = self.few(self.scene), list[Array](), dict[str, Comparison]()
        more = self.spectrum(self.scene)[0] / self.spectrum(self.scene, few)[0]
        skins = []
        for blood, melanin in product(SKIN_BLOOD.tolist(), MELANIN.tolist()):
            scene = at_value(self.scene, "blood.pulp_blood_fraction", blood)
            scene = at_value(scene, "finger.melanin_fraction", melanin)
            skins.append((blood, melanin, scene, more * self.spectrum(scene, few)[0]))
        for group, rows in table.groupby("group", sort=False):
            people = np.stack([percentile(rows, percent) for percent in people_tables.PERCENTILES["back of hand"]])
            blood, melanin, scene, _ = min(skins, key=lambda skin: float((np.log(skin[3] / people[1]) ** 2).sum()))
            model, w = self.bands(scene, OF_SKIN)
            depths.append(w)
            words = {"group": group, "people": people_count(rows), "melanin": 100 * melanin, "blood": 100 * blood}
            inside = part_between(model[1], people[0], people[2])
            texts = texts_of("back_of_hand", table, **words)
            result[f"back_of_hand_{group}"] = Comparison.of_curve(texts, inside, people, model, SPECTRUM_NM)
        return result | _w_depth("w_of_back_of_hand", table, depths)


def _w(spectrum: Array) -> Array:
    """Reflectance in the middle of the W of oxyhaemoglobin over that of its sides, of (..., q), (...) float."""
    left, middle, right = np.moveaxis(spectrum[..., np.searchsorted(SPECTRUM_NM, W_NM)], -1, 0)
    return np.asarray(2 * middle / (left + right))


def _w_depth(name: str, table: pd.DataFrame, model: Sequence[Array]) -> dict[str, Comparison]:
    """The W of groups' medians beside the model's of each, (3,) float; of one group nothing, as it has no error."""
    people = np.array([_w(percentile(group, 50)) for _, group in table.groupby("group", sort=False)])
    if len(people) < 2:
        return {}
    low, middle, high = np.transpose(model)
    stderr, spread = (middle - people).std(ddof=1) / np.sqrt(len(people)), (high - low).mean() / (2 * Z95)
    both = (float(people.mean()), float(stderr)), (float(middle.mean()), 0.0)
    return {name: Comparison.by_standard_errors(texts_of(name, table), *both, float(spread))}
