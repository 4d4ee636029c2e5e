"""The model beside measurements on people: nails, skin, pulse and slow waves, each with the spread of both.

The tables are in assets/real, each with its source; tables of one's own with the same names and columns replace them.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ..assets import asset_path, data_dir
from ..checks import Array
from ..errors import InputError
from ..hemodynamics.for_scene import blood_by_arterial_pressure, blood_model, heart_rate_per_min, rest_beat
from ..hemodynamics.waves import HEARTBEAT, Lines, waves_of, waves_pressure
from ..light import ProgressCallback, backend, trace
from ..light.optics import zones
from ..light.tracing.store import LightStore
from ..light.walk.nail_reflectance import NailReflectance, Patch
from ..options import Requested, TraceOptions
from ..scene import Body, Finger, Scene, load_scene
from ..scene.base import USUAL_PULP_BLOOD_FRACTION
from ..scene.priors import shipped_priors
from ..statistics import Z95, jackknife, seed_of
from .colour.adaptive_sampling import ALONG, patches_of
from .colour.colorimetry import WAVELENGTHS_NM, Viewer
from .colour.nail_colour import spread_of_colours
from .colour.reflectance import ColourRays, walk_colour
from .oximetry.ratio import FIT_SO2, calibrate_curve, read_pulsations, saturation_curve
from .prior_uncertainty import at_value

if TYPE_CHECKING:
    import pandas as pd

MMHG_PA = 133.322
# Between these the coverage of a 95 % interval agrees with it; of few or one person only the lower end counts.
COVERAGE, COVERAGE_OF_FEW = (0.85, 0.99), (0.85, 1.0)
# Rays of all wavelengths and places, and photons of each LED, where none are requested.
RAYS, PHOTONS = 400_000, 1_000_000
# Step of haemoglobin, and the skin with which photographs are scaled. [g/l]
HAEMOGLOBIN_STEP, SCALED_TO = 10.0, ("CA", "CN")
# Of a ring finger's pulp, what a spectrophotometer measures: light from all sides (CIE 15, d:8), gloss included, falls
# through a port of 11 mm onto the skin, of which 8 mm are seen (Konica Minolta CM-700d; that it was that is judgement).
PAD = Patch((0.0, 0.0), (7.1, 7.1), port_mm=11.0)
EFFECTS = {"green": "ln(green) in percent", "green_over_red": "ln(green/red) in percent", "redness": "a*"}
# Recordings in which motion spoils the pulse correlate less than this.
LEAST_CORRELATION = 0.9
# Of the module MAXM86161 that recorded the finger; judgement, its data sheet was not at hand. Red is 660 nm as here.
MODULE_INFRARED_NM = 880.0
# Of the reference oximeter, one on one person, so that it is common to all recordings: the root mean square error that
# makers state for 70 to 100 % (ISO 80601-2-61 requires 4 or less). [percent]
REFERENCE_SPO2_ERROR = 2.0
# Of the finger's recordings, those at a saturation near the scene's. [percent]
NORMAL_SPO2 = 94.0
# Melanin, and blood of the skin, between which those of a group of people are sought.
MELANIN = np.geomspace(0.005, 0.4, 24)
SKIN_BLOOD = np.geomspace(0.1, 1.0, 6) * USUAL_PULP_BLOOD_FRACTION
# Linear sRGB to X, Y, Z (IEC 61966-2-1).
XYZ_OF_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
SPECTRUM_NM = np.arange(400.0, 701.0, 10.0)
_SPECTRUM = [f"{nm:.0f}_nm" for nm in SPECTRUM_NM]
_RGB = [f"{part}_{channel}" for part in ("nail", "skin") for channel in "rgb"]
# Columns that a table must have, and those that must be positive in every row.
COLUMNS: dict[str, tuple[list[str], list[str]]] = {
    "nail_photos": (["day"], ["hb_g_per_l", *_RGB]),
    "skin_spectra": (["place", "group"], ["people", "percentile", *_SPECTRUM]),
    "red_infrared_pulse": (
        ["correlation"],
        ["spo2_percent", "ratio_of_ratios", "red_ac_over_dc_percent", "infrared_ac_over_dc_percent"],
    ),
    "fingertip_waves": (
        [],
        [f"{wave}_g" for wave in ("vasomotion_0.05_0.15_hz", "breathing_0.15_0.4_hz", "heart_0.7_3_hz")],
    ),
    "pulse_against_contact_pressure": ([], ["pressure_mmhg", "red_660_nm", "infrared_850_nm"]),
}


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One measured quantity beside the model's.

    people, model : (3, n) float. Lower end, middle and upper end: 95 % of people, or of what is known of their mean;
        and the 95 % interval of the model over the priors, or by its standard error.
    statistic : z, the difference in its standard errors, or coverage, the part of people within the model's interval.
    accepted : between which the statistic agrees.
    x, x_label : (n,) float. What the quantity is measured over, where it is.
    """

    quantity: str
    units: str
    source: str
    people: Array
    model: Array
    statistic: str
    value: float
    accepted: tuple[float, float]
    x: Array = field(default_factory=lambda: np.zeros(1))
    x_label: str = ""
    remark: str = ""

    @property
    def agrees(self) -> bool:
        """Whether model and people agree."""
        return bool(self.accepted[0] <= self.value <= self.accepted[1])

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and texts."""
        out: dict[str, Any] = {"quantity": self.quantity, "units": self.units}
        for name, rows in (("people", self.people), ("model", self.model)):
            values = rows if self.x_label else rows[:, 0]
            out[name] = dict(zip(("low", "middle", "high"), np.asarray(values).tolist(), strict=True))
        if self.x_label:
            out["over"] = {self.x_label: self.x.tolist()}
        out |= {self.statistic: self.value, "accepted": list(self.accepted), "agrees": self.agrees}
        return out | {"source": self.source} | ({"remark": self.remark} if self.remark else {})


@dataclass(frozen=True)
class Validation:
    """Every table beside the model, by name; attributes say how it was made."""

    tables: dict[str, Comparison]
    attributes: Mapping[str, Any]


def validate(
    *, data: Path | None = None, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> Validation:
    """Compare the model of the shipped scenes with what was measured on people.

    data : folder of tables of one's own; those that it lacks are the shipped ones.
    requested : fields of `TraceOptions`; photons are those of each LED and the rays of all colours.

    Raises: InputError for a table that lacks a column or whose light is not positive.
    """
    cpu, begin, options = time.process_time(), time.perf_counter(), TraceOptions(**requested)
    if options.relative_error is not None or options.max_seconds is not None:
        raise InputError("validate has no relative_error and no max_seconds; give photons.")
    if data is not None and not any((data / f"{name}.csv").is_file() for name in COLUMNS):
        raise InputError(
            f"{data}: holds none of {', '.join(f'{name}.csv' for name in COLUMNS)}; see docs/validation.md."
        )
    tables = {name: read_people(name, data) for name in COLUMNS}
    result = _waves(tables["fingertip_waves"])
    result["pulse_over_contact_pressure"] = _contact_pressure(tables["pulse_against_contact_pressure"])
    result |= _pulse(tables["red_infrared_pulse"], options, progress)
    surface, photos, spectra = _Surface(options), tables["nail_photos"], tables["skin_spectra"]
    result |= surface.colours(photos, spectra) | surface.haemoglobin(photos) | surface.skin(spectra)
    seconds = {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}
    return Validation(result, {"seed": options.seed, "engine": "photons"} | seconds)


def read_people(name: str, folder: Path | None = None) -> "pd.DataFrame":
    """A table of `COLUMNS`: from a folder where it has one, else the shipped one.

    Raises: InputError for a missing column, or a value that is no positive number where it must be one.
    """
    import pandas as pd

    path = folder / f"{name}.csv" if folder else asset_path(f"real/{name}.csv")
    if not path.is_file():
        path = asset_path(f"real/{name}.csv")
    try:
        table = pd.read_csv(path, comment="#")
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as a table ({error}); give a CSV with named columns.") from None
    others, positive = COLUMNS[name]
    missing = [column for column in (*others, *positive) if column not in table]
    if missing:
        raise InputError(f"{path}: lacks the column {missing[0]}; it needs {', '.join((*others, *positive))}.")
    for column in positive:
        values = pd.to_numeric(table[column], errors="coerce").to_numpy(float)
        wrong = np.flatnonzero(~(values > 0))
        if wrong.size:
            text = table[column].iloc[wrong[0]]
            raise InputError(
                f"{path}: {column} must be a number above 0, got {text} in row {wrong[0] + 1}; correct it."
            )
        table[column] = values
    return table


def _source(name: str) -> str:
    lines = asset_path(f"real/{name}.csv").read_text(encoding="utf-8").splitlines()
    text = " ".join(line[1:].strip() for line in lines if line.startswith("#"))
    return text[text.index("Source: ") + len("Source: ") :]


def _spread_of(values: ArrayLike) -> Array:
    """2.5th, 50th and 97.5th percentile, (3, 1) float."""
    return np.percentile(np.asarray(values, float), [2.5, 50, 97.5])[:, None]


def _interval(value: float, stderr: float) -> Array:
    return np.array([[value - Z95 * stderr], [value], [value + Z95 * stderr]])


def _z(people: tuple[float, float], model: tuple[float, float], **about: Any) -> Comparison:
    """Two numbers, each with its standard error."""
    z = (model[0] - people[0]) / float(np.hypot(people[1], model[1]))
    how: dict[str, Any] = {"statistic": "z", "value": z, "accepted": (-2.0, 2.0)}
    return Comparison(people=_interval(*people), model=_interval(*model), **how, **about)


def _coverage(values: ArrayLike, model: Array, *, few: bool = False, **about: Any) -> Comparison:
    """People's values beside the model's interval, (3, 1) float."""
    inside = (np.asarray(values, float) >= model[0]) & (np.asarray(values, float) <= model[2])
    how: dict[str, Any] = {"statistic": "coverage", "value": float(inside.mean())}
    accepted = COVERAGE_OF_FEW if few else COVERAGE
    return Comparison(people=_spread_of(values), model=model, **how, accepted=accepted, **about)


def _curve(inside: Array, people: Array, model: Array, **about: Any) -> Comparison:
    """A quantity over something, (3, n) float each, and at which of its points the two agree, (n,) bool."""
    how: dict[str, Any] = {"statistic": "coverage", "value": float(inside.mean()), "accepted": COVERAGE_OF_FEW}
    return Comparison(people=people, model=model, **how, **about)


def _shipped_scene(name: str) -> Scene:
    return load_scene(data_dir("scenes") / f"{name}.toml")


def _waves(people: "pd.DataFrame") -> dict[str, Comparison]:
    """Breathing and vasomotion in the blood of the bed, over the heartbeat, rms."""
    scene, ranges = _shipped_scene("heartbeat"), {prior.field: prior for prior in shipped_priors()}
    assert scene.body is not None
    waves = {wave.name: wave.lines(**fields) for wave, fields in waves_of(scene.body)}
    rms = {name: _blood_rms(scene, lines) for name, lines in waves.items()}
    result = {}
    for name, column in (("vasomotion", "vasomotion_0.05_0.15_hz"), ("breathing", "breathing_0.15_0.4_hz")):
        amplitude_pa = getattr(scene.body, name).amplitude_pa
        prior = ranges[f"body.{name}.amplitude_pa"]
        factors = np.array([[prior.low / amplitude_pa], [1.0], [prior.high / amplitude_pa]])
        result[f"{name}_over_heartbeat"] = _coverage(
            people[f"{column}_g"] / people["heart_0.7_3_hz_g"],
            rms[name] / rms[HEARTBEAT.name] * factors,
            few=True,
            quantity=f"{name} over heartbeat, rms",
            units="1",
            source=_source("fingertip_waves"),
            remark="People: green light through fingertips, with their arteries; model: blood of the nail bed.",
        )
    return result


def _blood_rms(scene: Scene, lines: Lines) -> float:
    """Of the bed's blood by a wave of the arterial pressure without touch. [1]"""
    gain = blood_by_arterial_pressure(scene, lines[0], 0.0).mean(0)
    return float(np.sqrt(lines[1] @ np.abs(gain) ** 2))


def _contact_pressure(people: "pd.DataFrame") -> Comparison:
    """The heartbeat in arteriolar blood under a contact pressure; both shapes over their means."""
    scene, pressure = _shipped_scene("pulse_oximeter"), people["pressure_mmhg"].to_numpy()
    prior = {prior.field: prior for prior in shipped_priors()}["body.heartbeat.arteriolar_peak_pa"]

    def shape(peak_pa: float | None) -> Array:
        one = scene if peak_pa is None else at_value(scene, prior.field, peak_pa)
        assert one.body is not None and one.body.heartbeat is not None
        small = blood_model(one).arterioles
        assert small is not None
        beat = Body(heartbeat=one.body.heartbeat.model_copy(update={"rate_variability": 0.0}))
        times_s = np.linspace(0.0, 60.0 / heart_rate_per_min(one), 256)
        arterial_pa = waves_pressure(beat, times_s, mean_pressure_pa=small.mean_pa, pulse_ratio=small.pulse_ratio)
        amplitude = np.ptp(small.fraction(arterial_pa - MMHG_PA * pressure[:, None]), axis=1)
        return np.asarray(amplitude / amplitude.mean())

    curves = np.stack([shape(peak) for peak in (prior.low, prior.high, None)])
    model = np.stack([curves.min(0), curves[2], curves.max(0)])
    both = people[["red_660_nm", "infrared_850_nm"]].to_numpy()
    measured = both / both.mean(0)
    middle = measured.mean(1)
    return _curve(
        (middle >= model[0]) & (middle <= model[2]),
        np.stack([measured.min(1), middle, measured.max(1)]),
        model,
        quantity="amplitude of the pulse under a contact pressure, over its mean",
        units="1",
        source=_source("pulse_against_contact_pressure"),
        x=pressure,
        x_label="contact pressure [mmHg]",
        remark="People: red and infrared; means of all, whose records were normalised before.",
    )


def _pulse(people: "pd.DataFrame", options: TraceOptions, progress: ProgressCallback | None) -> dict[str, Comparison]:
    """Saturation over the ratio of ratios, and the pulse's amplitude in red and infrared light."""
    scene, source, seed = _shipped_scene("pulse_oximeter"), _source("red_infrared_pulse"), seed_of(options.seed, 1)
    red, infrared = scene.leds
    leds = red, infrared.model_copy(update={"wavelength_nm": MODULE_INFRARED_NM})
    scene = scene.model_copy(update={"leds": leds, "accuracy": type(scene.accuracy)()})
    how = options.fields | {"photons": options.photons or PHOTONS, "relative_error": None}
    transfer = trace(scene, progress=progress, **how)
    curve = saturation_curve(transfer, (0, 1), rest_beat(scene), low=FIT_SO2[0], high=FIT_SO2[-1], seed=seed)
    lines, _ = calibrate_curve(FIT_SO2, curve(FIT_SO2).ratio, 1)
    still = people[people["correlation"] > LEAST_CORRELATION]
    measured, spo2 = still["ratio_of_ratios"].to_numpy(), still["spo2_percent"].to_numpy()
    line, covariance = np.polyfit(measured, spo2, 1, cov=True)
    at = float(measured.mean())
    scatter = float(np.std(spo2 - np.polyval(line, measured), ddof=2) / np.sqrt(len(spo2)))
    remark = (
        f"One finger on a reflectance module; the model is the shipped oximeter, at {MODULE_INFRARED_NM:g} nm "
        "as the module, with an error as large as its photodiodes differ, whose distances are not the module's."
    )
    about: dict[str, Any] = {"units": "percent", "source": source}
    result = {
        "spo2_slope": _z(
            (float(line[0]), float(np.sqrt(covariance[0, 0]))),
            _over_photodiodes(lines[..., 1]),
            quantity="slope of SpO2 over the ratio of ratios, 70 to 100 %",
            remark=remark,
            **about,
        ),
        "spo2_level": _z(
            (float(spo2.mean()), float(np.hypot(scatter, REFERENCE_SPO2_ERROR))),
            _over_photodiodes(lines @ [1.0, at]),
            quantity=f"SpO2 at a ratio of ratios of {at:.3f}",
            remark=f"{remark} The reference, an oximeter on the same person, may be off by {REFERENCE_SPO2_ERROR:g} %.",
            **about,
        ),
    }
    prior = {prior.field: prior for prior in shipped_priors()}["body.heartbeat.arteriolar_blood_fraction"]
    scenes = [scene, *(at_value(scene, prior.field, value) for value in (prior.low, prior.high))]
    beats = [rest_beat(one) for one in scenes]
    index = read_pulsations(transfer, (0, 1), [(scene.blood.so2, beat) for beat in beats], seed=seed).perfusion_index
    # From peak to peak to the amplitude of a sine of the same root mean square, as the table has it.
    as_sine = [np.sqrt(2) * beat.pulse.sum(1).std() / np.ptp(beat.extremes.sum(1)) for beat in beats]
    normal = still[still["spo2_percent"] >= NORMAL_SPO2]
    for k, name in enumerate(("red", "infrared")):
        middle, low, high = 100 * np.nanmean(index[0, k], axis=0) * as_sine
        result[f"pulse_{name}"] = _coverage(
            normal[f"{name}_ac_over_dc_percent"],
            np.array([[low], [middle], [high]]),
            few=True,
            quantity=f"amplitude of the pulse over the mean, {name}",
            remark=f"{remark} Recordings at {NORMAL_SPO2:g} % saturation or more; rms times the root of 2.",
            **about,
        )
    return result


def _over_photodiodes(replicates: Array) -> tuple[float, float]:
    """Mean of (1 + groups, photodiodes) float, and its error for a photodiode of another distance."""
    mean = np.nanmean(replicates, axis=1)
    return float(mean[0]), float(np.hypot(np.nanstd(replicates[0], ddof=1), jackknife(mean)))


class _Surface:
    """Reflectance of the shipped prototype's nail, without its board, and of a ring finger's pulp."""

    def __init__(self, options: TraceOptions) -> None:
        self.options, scene = options, _shipped_scene("prototype")
        self.backend = backend.activate_jit(options.backend, "validate")
        self.nail, self.rays = self._walked(scene, patches_of(scene))
        self.finger, self.rays_of_pad = self._walked(scene.model_copy(update={"finger": Finger(digit="ring")}), (PAD,))

    def _walked(self, scene: Scene, patches: tuple[Patch, ...]) -> tuple[NailReflectance, ColourRays]:
        nail = NailReflectance(scene, backend=self.backend.name, stores=LightStore.of_command(self.options))
        return nail, walk_colour(nail, patches, photons=self.options.photons or RAYS, seed=self.options.seed)

    def of_nail(self, scene: Scene) -> Array:
        """Of the nail's middle, gloss excluded, by all rays and without each group of them, (1 + groups, q) float."""
        return self.rays.reflectance(_rest(scene), scene.colour, scene=scene, patches=(ALONG // 2,))[:, 0, 0]

    def of_skin(self, scene: Scene) -> Array:
        """Of the pulp, gloss included, at the wavelengths of the tables, (q,) float. [percent]"""
        viewing = scene.colour.model_copy(update={"gloss": True})
        read = self.rays_of_pad.reflectance(_rest(scene), viewing, scene=scene)[0, 0, 0]
        return 100 * np.interp(SPECTRUM_NM, WAVELENGTHS_NM, read)

    def colours(self, photos: "pd.DataFrame", spectra: "pd.DataFrame") -> dict[str, Comparison]:
        """L*, a*, b* of nails, one value for each person."""
        people, scene, viewer = nails_lab(photos, spectra), self.nail.scene, Viewer()
        own = viewer.lab(self.of_nail(scene))
        spread = spread_of_colours(self.nail, self.rays, viewer, scene.colour, seed=self.options.seed).sel(site="nail")
        # The mean over the priors, which the scene's own values need not be.
        lab, sd = own[0] + spread.lab_shift.values, np.hypot(spread.lab_spread.values, jackknife(own))
        remark = (
            "Photographs, scaled to skin under a spectrophotometer: exposure and tone curve are unknown. Every third "
            "person was left out when the nail plate was fitted."
        )
        return {
            f"nail_{band[0]}": _coverage(
                people[:, k],
                _interval(float(lab[k]), float(sd[k])),
                quantity=f"{band} of nails, one value for each person",
                units="1",
                source=_source("nail_photos"),
                remark=remark,
            )
            for k, band in enumerate(("L*", "a*", "b*"))
        }

    def haemoglobin(self, photos: "pd.DataFrame") -> dict[str, Comparison]:
        """Change of nails' colours with haemoglobin."""
        scene, more = self.nail.scene, 1 + HAEMOGLOBIN_STEP / float(photos["hb_g_per_l"].mean())
        bled = at_value(scene, "blood.rest_blood_fraction", more * scene.blood.rest_blood_fraction)
        both = np.stack([self.of_nail(scene), self.of_nail(bled)]) @ Viewer().weights
        people, model = _effects(photos[_RGB[:3]].to_numpy()), _effects(both @ np.linalg.inv(XYZ_OF_RGB).T)
        result = {}
        for name, words in EFFECTS.items():
            change = model[name][1] - model[name][0]
            result[f"haemoglobin_{name}"] = _z(
                slope_within_days(photos, people[name]),
                (float(change[0]), float(jackknife(change))),
                quantity=f"{words} of nails per 10 g/l of haemoglobin",
                units="1",
                source=_source("nail_photos"),
                remark="Within days of photographs. Exposure and what else goes with haemoglobin are not modelled.",
            )
        return result

    def skin(self, spectra: "pd.DataFrame") -> dict[str, Comparison]:
        """Ring fingers beside the shipped skin; hands of each group with the melanin and the blood that come nearest to
        its median, all through the spectrophotometer's port."""
        result = {}
        fingers = spectra[spectra.place == "ring finger"]
        everyone, quartiles = self._pooled(fingers, (5, 50, 95)), self._pooled(fingers, (25, 75))
        what, count = "reflectance of skin: ring finger", int(fingers[fingers.percentile == 50].people.sum())
        result["ring_finger"] = self._spectrum(
            self.of_skin(self.finger.scene),
            everyone,
            quartiles,
            quantity=f"{what}, {count} people",
            remark="Coverage is the part of wavelengths within 25-75 % of people.",
        )
        blood, melanin, skins = self._skins()
        for group, table in spectra[spectra.place == "back of hand"].groupby("group", sort=False):
            low, middle, high = (self._percentile(table, percent) for percent in (5, 50, 95))
            best = int((np.log(skins / middle) ** 2).sum(-1).argmin())
            result[f"back_of_hand_{group}"] = self._spectrum(
                skins[best],
                np.stack([low, middle, high]),
                np.stack([low, high]),
                quantity=f"reflectance of skin: back of hand, group {group}, {int(table.people.iloc[0])} people",
                remark=f"Melanin of {100 * melanin[best]:.2g} % and blood of {100 * blood[best]:.2g} % are fitted to "
                "its median; coverage is the part of wavelengths within 5-95 % of people.",
            )
        return result

    @staticmethod
    def _spectrum(model: Array, people: Array, ends: Array, **about: Any) -> Comparison:
        over: dict[str, Any] = {"x": SPECTRUM_NM, "x_label": "wavelength [nm]", "units": "percent"}
        inside = (model >= ends[0]) & (model <= ends[1])
        return _curve(inside, people, np.stack([model] * 3), source=_source("skin_spectra"), **over, **about)

    def _pooled(self, table: "pd.DataFrame", percentiles: tuple[int, ...]) -> Array:
        """Percentiles of all groups' people together, from those of each, (n, q) float."""
        known, samples = sorted(set(table.percentile)), []
        for _, group in table.groupby("group"):
            rows = np.stack([self._percentile(group, int(percent)) for percent in known])
            at = 100 * (np.arange(count := int(group.people.iloc[0])) + 0.5) / count
            samples.append(np.stack([np.interp(at, known, column) for column in rows.T], -1))
        return np.asarray(np.percentile(np.concatenate(samples), percentiles, axis=0))

    @staticmethod
    def _percentile(table: "pd.DataFrame", percent: int) -> Array:
        row = table[table.percentile == percent]
        if len(row) != 1:
            raise InputError(f"skin_spectra.csv: needs one row of percentile {percent} for each place and group.")
        return np.asarray(row[_SPECTRUM].to_numpy(float)[0])

    def _skins(self) -> tuple[Array, Array, Array]:
        """Blood and melanin, (n,) float each [1], and the reflectance of such skin, (n, q) float. [percent]"""
        blood, melanin = (axis.ravel() for axis in np.meshgrid(SKIN_BLOOD, MELANIN))
        scenes = [
            at_value(at_value(self.finger.scene, "blood.pulp_blood_fraction", b), "finger.melanin_fraction", m)
            for b, m in zip(blood.tolist(), melanin.tolist(), strict=True)
        ]
        return blood, melanin, np.stack([self.of_skin(scene) for scene in scenes])


def _rest(scene: Scene) -> Array:
    """The bed's blood at rest, (1, zones) float. [1]"""
    return np.full((1, zones(scene).count), scene.blood.rest_blood_fraction)


def _effects(rgb: Array) -> dict[str, Array]:
    """What of linear sRGB, (..., 3) float, is compared over haemoglobin, by the names of `EFFECTS`."""
    red, green, _ = 100 * np.moveaxis(np.log(rgb), -1, 0)
    return {"green": green, "green_over_red": green - red, "redness": lab_of(rgb @ XYZ_OF_RGB.T)[..., 1]}


def lab_of(xyz: Array) -> Array:
    """CIE 1976 L*a*b* under D65, (..., 3) float, of X, Y, Z as `XYZ_OF_RGB` scales them, (..., 3) float."""
    x, y, z = np.moveaxis(np.cbrt(xyz / XYZ_OF_RGB.sum(1)), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], -1)


def nails_lab(photos: "pd.DataFrame", spectra: "pd.DataFrame") -> Array:
    """L*, a*, b* of people's nails, (p, 3) float.

    The level of a nail is that of the skin beside it, times what a spectrophotometer measured on backs of hands.
    """
    viewer = Viewer()
    hands = spectra[(spectra.place == "back of hand") & spectra.group.isin(SCALED_TO) & (spectra.percentile == 50)]
    skin = np.interp(WAVELENGTHS_NM, SPECTRUM_NM, hands[_SPECTRUM].to_numpy(float).mean(0) / 100)
    skin_rgb = skin @ viewer.weights @ np.linalg.inv(XYZ_OF_RGB).T
    nail, beside = (photos[[f"{part}_{c}" for c in "rgb"]].to_numpy() for part in ("nail", "skin"))
    return lab_of(nail / beside * skin_rgb @ XYZ_OF_RGB.T)


def slope_within_days(photos: "pd.DataFrame", values: Array) -> tuple[float, float]:
    """Of people's values per 10 g/l of haemoglobin within a day of photographs, and its standard error."""
    day = photos["day"].to_numpy()
    x, y = (v - np.array([v[day == d].mean() for d in day]) for v in (photos["hb_g_per_l"].to_numpy(), values))
    slope = float(x @ y / (x @ x))
    freedom = len(x) - len(set(day)) - 1
    stderr = float(np.sqrt(((y - slope * x) ** 2).sum() / freedom / (x @ x)))
    return HAEMOGLOBIN_STEP * slope, HAEMOGLOBIN_STEP * stderr
