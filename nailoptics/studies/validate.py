"""The model beside measurements on people: nails, skin, pulse and slow waves, each with the spread of both.

The tables are in assets/real, each with its source; tables of one's own with the same names and columns replace them.
Each quantity states whether the model was fitted to these people.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ..assets import asset_path, data_dir
from ..checks import Array
from ..errors import InputError
from ..hemodynamics.for_scene import blood_by_arterial_pressure, blood_model, heart_rate_per_min, rest_beat
from ..hemodynamics.waves import HEARTBEAT, Lines, waves_of, waves_pressure
from ..light import ProgressCallback, backend, trace
from ..light.identity import light_digest
from ..light.optics import zones
from ..light.tracing.store import LightStore
from ..light.walk.nail_reflectance import NailReflectance, Patch, as_seen
from ..options import Requested, TraceOptions
from ..scene import Body, Finger, Prior, Scene, load_scene
from ..scene.base import USUAL_PULP_BLOOD_FRACTION
from ..scene.priors import shipped_priors
from ..statistics import Z95, jackknife, seed_of
from .colour.adaptive_sampling import ALONG, patches_of
from .colour.colorimetry import WAVELENGTHS_NM, Viewer
from .colour.reflectance import ColourRays, walk_colour
from .oximetry.ratio import FIT_SO2, calibrate_curve, saturation_curve
from .prior_uncertainty import PriorSensitivity, at_value, only_absorbs, over_priors

if TYPE_CHECKING:
    import pandas as pd

MMHG_PA = 133.322
# Between these the coverage of a 95 % interval agrees with it; of few or one person only the lower end counts.
COVERAGE, COVERAGE_OF_FEW = (0.85, 0.99), (0.85, 1.0)
# Rays of all wavelengths, those of the nail as a part of the skin's, and photons of each LED, where none are requested.
RAYS, NAIL_SHARE, PHOTONS = 400_000, 0.25, 1_000_000
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
_PERCENT = (0.0, 100.0)
# Columns of each table: None for text, else the numbers above the first and up to the second of which all must be.
COLUMNS: dict[str, Mapping[str, tuple[float, float] | None]] = {
    "nail_photos": {"day": None, "hb_g_per_l": (20.0, 300.0)} | dict.fromkeys(_RGB, (0.0, 1.0)),
    # Reflectance as a part of 1 is refused: skin reflects more than 1 %.
    "skin_spectra": {"place": None, "group": None, "people": (0.0, np.inf), "percentile": _PERCENT}
    | dict.fromkeys(_SPECTRUM, (1.0, 100.0)),
    "red_infrared_pulse": {"correlation": (-1.0, 1.0), "spo2_percent": (1.0, 100.0), "ratio_of_ratios": (0.0, 10.0)}
    | dict.fromkeys(("red_ac_over_dc_percent", "infrared_ac_over_dc_percent"), _PERCENT),
    "fingertip_waves": {
        "vasomotion_0.05_0.15_hz_g": _PERCENT,
        "breathing_0.15_0.4_hz_g": _PERCENT,
        "heart_0.7_3_hz_g": _PERCENT,
    },
    "pulse_against_contact_pressure": {
        "pressure_mmhg": (0.0, 300.0),
        "red_660_nm": (0.0, np.inf),
        "infrared_850_nm": (0.0, np.inf),
    },
}
# Places of skin, and the percentiles that a table has of each; those of ring fingers are pooled over groups.
PERCENTILES = {"ring finger": (5, 25, 50, 75, 95), "back of hand": (5, 50, 95)}
# Every third person was left out when the nail plate was fitted (assets/spectra/fit_nail_plate.py).
FOLDS = 3
Basis = Literal["fitted", "held out", "prediction"]
# What of a finger decides the colour of its pulp; of the nail, all of the finger and its blood at rest do.
OF_SKIN = ("finger.pulp_absorption", "finger.pulp_scattering", "blood.so2")
OF_FITTED_SKIN = ("finger.melanin_fraction", "blood.pulp_blood_fraction")
BLOOD_OF_NAIL = ("blood.rest_blood_fraction", "blood.pulp_blood_fraction", "blood.so2")
# Between two bands of oxyhaemoglobin lies the middle of the W. [nm]
W_NM = (540.0, 560.0, 580.0)
PRIORS_95 = "95 % over the priors"
# Rays of all nodes for each optics whose light the priors need.
OWN_RAYS = 24_000


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One measured quantity beside the model's.

    people, model : (3, n) float. Lower end, middle and upper end.
    bands : what these intervals are, of people and of the model.
    basis, fit : whether the model was fitted to these people, to others of the table, or to none; and how.
    statistic : z, the difference in its standard errors, or coverage, the part that agrees.
    counted : of what coverage is that part.
    accepted : between which the statistic agrees.
    x, x_label : (n,) float. What the quantity is measured over, where it is.
    """

    quantity: str
    units: str
    source: str
    people: Array
    model: Array
    bands: tuple[str, str]
    basis: Basis
    fit: str
    statistic: str
    value: float
    accepted: tuple[float, float]
    counted: str = ""
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
        texts = {name: getattr(self, name) for name in ("basis", "fit", "counted", "source", "remark")}
        return out | {"bands": list(self.bands)} | {name: text for name, text in texts.items() if text}


@dataclass(frozen=True)
class Validation:
    """Every quantity beside the model, by name; attributes say how it was made.

    no_data : quantities of which the tables have nothing.
    """

    tables: dict[str, Comparison]
    attributes: Mapping[str, Any]
    no_data: Sequence[str] = ()

    def counts(self) -> dict[str, tuple[int, int]]:
        """How many quantities agree, and of how many: of those that were not fitted, and of the fitted ones."""
        sides: dict[str, list[bool]] = {"unfitted": [], "fitted": []}
        for one in self.tables.values():
            sides["fitted" if one.basis == "fitted" else "unfitted"].append(one.agrees)
        return {words: (sum(agree), len(agree)) for words, agree in sides.items()}


def validate(
    *, data: Path | None = None, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> Validation:
    """Compare the model of the shipped scenes with what was measured on people.

    data : folder of tables of one's own; those that it lacks are the shipped ones.
    requested : fields of `TraceOptions`; photons are those of each LED and the rays of all colours.

    Raises: InputError for a table that lacks columns or rows, or has values that none can have.
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
    result |= _nails(tables["nail_photos"], options)
    skin, spectra = _Skin(options), tables["skin_spectra"]
    fit = _of(spectra, "fitted", "scattering, bloodless absorption and blood of the pulp, to their median")
    result |= skin.fingers(spectra[spectra.place == "ring finger"], **fit)
    result |= skin.hands(spectra[spectra.place == "back of hand"], source=fit["source"], basis="fitted")
    no_data = [place for place in PERCENTILES if not (spectra.place == place).any()]
    seconds = {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}
    return Validation(result, {"seed": options.seed, "engine": "photons"} | seconds, no_data)


def read_people(name: str, folder: Path | None = None) -> "pd.DataFrame":
    """A table of `COLUMNS`: from a folder where it has one, else the shipped one.

    Its attrs are the source, and whether it is the shipped one.

    Raises: InputError for missing or unknown columns, values outside of their ranges, or too few rows.
    """
    import pandas as pd

    path, shipped = folder / f"{name}.csv" if folder else Path(), asset_path(f"real/{name}.csv")
    own = path.is_file()
    path = path if own else shipped
    try:
        table = pd.read_csv(path, comment="#")
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: cannot be read as a table ({error}); give a CSV with named columns.") from None
    columns = COLUMNS[name]
    missing = [column for column in columns if column not in table]
    if missing:
        raise InputError(f"{path}: lacks the column {missing[0]}; it needs {', '.join(columns)}.")
    unknown = [column for column in table if column.endswith("_nm") and column not in columns]
    if unknown:
        raise InputError(f"{path}: has an unknown column {unknown[0]}; its columns are {', '.join(columns)}.")
    for column, ends in columns.items():
        text = table[column]
        values = text if ends is None else pd.to_numeric(text, errors="coerce").to_numpy(float)
        wrong = text.isna() if ends is None else ~((values > ends[0]) & (values <= ends[1]) & np.isfinite(values))
        if (rows := np.flatnonzero(wrong)).size:
            kind = "a name" if ends is None else f"a finite number above {ends[0]:g}"
            kind += f" and at most {ends[1]:g}" if ends and np.isfinite(ends[1]) else ""
            raise InputError(
                f"{path}: {column} must be {kind}, got {text.iloc[rows[0]]} in row {rows[0] + 1}; correct it."
            )
        table[column] = values
    lacking = _lacking(name, table)
    if lacking:
        raise InputError(f"{path}: needs {lacking}; add rows or leave the table out.")
    table.attrs = {"source": str(path) if own else _source(name), "shipped": not own}
    return table


def _lacking(name: str, table: "pd.DataFrame") -> str:
    """What rows a table lacks for its comparison, in words; empty if none."""
    if name == "nail_photos":
        days = table.groupby("day")["hb_g_per_l"]
        enough = len(table) > len(days) + 1 and (days.max() > days.min()).any()
        return "" if enough else "two people more than days, of different haemoglobin within a day"
    if name == "red_infrared_pulse":
        still = table[table["correlation"] > LEAST_CORRELATION]
        if still["ratio_of_ratios"].nunique() < 3:
            return f"three recordings of different ratio with a correlation above {LEAST_CORRELATION:g}"
        high = (still["spo2_percent"] >= NORMAL_SPO2).any()
        return "" if high else f"one of these recordings at a saturation of {NORMAL_SPO2:g} % or more"
    if name == "skin_spectra":
        unknown = set(table["place"]) - set(PERCENTILES)
        if unknown or not len(table):
            return f"rows of place {' or '.join(PERCENTILES)}" + "".join(f" and none of {one}" for one in unknown)
        for (place, group), rows in table.groupby(["place", "group"]):
            for percent in PERCENTILES[place]:
                if (rows["percentile"] == percent).sum() != 1:
                    return f"one row of percentile {percent} for {place}, group {group}"
        return ""
    return "" if len(table) > 1 else "two rows"


def _source(name: str) -> str:
    lines = asset_path(f"real/{name}.csv").read_text(encoding="utf-8").splitlines()
    text = " ".join(line[1:].strip() for line in lines if line.startswith("#"))
    return text[text.index("Source: ") + len("Source: ") :]


def _of(table: "pd.DataFrame", basis: Basis, fit: str) -> dict[str, Any]:
    """Source of a table, and what was fitted to it: nothing to a table of the user's own."""
    if not table.attrs["shipped"]:
        basis, fit = "prediction", "nothing was fitted to this table"
    return {"source": table.attrs["source"], "basis": basis, "fit": fit}


def _spread_of(values: ArrayLike) -> Array:
    """2.5th, 50th and 97.5th percentile, (3, 1) float."""
    return np.percentile(np.asarray(values, float), [2.5, 50, 97.5])[:, None]


def _interval(value: float, stderr: float) -> Array:
    return np.array([[value - Z95 * stderr], [value], [value + Z95 * stderr]])


def _z(people: tuple[float, float], model: tuple[float, float], spread: float = 0.0, **about: Any) -> Comparison:
    """Two numbers, each with its standard error; spread: standard deviation of the model over the priors, shown."""
    z = (model[0] - people[0]) / float(np.hypot(people[1], model[1]))
    how: dict[str, Any] = {"statistic": "z", "value": z, "accepted": (-2.0, 2.0)}
    shown = float(np.hypot(model[1], spread))
    return Comparison(people=_interval(*people), model=_interval(model[0], shown), **how, **about)


def _coverage(values: ArrayLike, model: Array, *, few: bool = False, **about: Any) -> Comparison:
    """People's values beside the model's interval, (3, 1) float."""
    inside = (np.asarray(values, float) >= model[0]) & (np.asarray(values, float) <= model[2])
    how: dict[str, Any] = {"statistic": "coverage", "value": float(inside.mean())}
    how |= {"bands": ("95 % of people", PRIORS_95), "counted": "people within the model's interval"}
    accepted = COVERAGE_OF_FEW if few else COVERAGE
    return Comparison(people=_spread_of(values), model=model, accepted=accepted, **how | about)


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
            counted="hands within the model's interval",
            **_of(people, "fitted", "the default amplitude and the range of its prior are from these recordings"),
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
        bands=("red and infrared", PRIORS_95),
        counted="pressures at which people's mean is within the model's interval",
        **_of(people, "fitted", "pressure of the maximum and width of the compliance curve are from these means"),
        x=pressure,
        x_label="contact pressure [mmHg]",
        remark="People: red and infrared; means of all, whose records were normalised before.",
    )


def _pulse(people: "pd.DataFrame", options: TraceOptions, progress: ProgressCallback | None) -> dict[str, Comparison]:
    """Saturation over the ratio of ratios, and the pulse's amplitude in red and infrared light."""
    scene, seed = _shipped_scene("pulse_oximeter"), seed_of(options.seed, 1)
    red, infrared = scene.leds
    leds = red, infrared.model_copy(update={"wavelength_nm": MODULE_INFRARED_NM})
    scene = scene.model_copy(update={"leds": leds, "accuracy": type(scene.accuracy)()})
    how = options.fields | {"photons": options.photons or PHOTONS, "relative_error": None}
    transfer = trace(scene, progress=progress, **how)
    still = people[people["correlation"] > LEAST_CORRELATION]
    measured, spo2 = still["ratio_of_ratios"].to_numpy(), still["spo2_percent"].to_numpy()
    line, covariance = np.polyfit(measured, spo2, 1, cov=True)
    at = float(measured.mean())
    scatter = float(np.std(spo2 - np.polyval(line, measured), ddof=2) / np.sqrt(len(spo2)))

    def answers(varied: Scene) -> Array:
        """Slope, level, logarithm of both perfusion indices, (1 + groups, 4, photodiodes) float."""
        beat = rest_beat(varied)
        light = replace(transfer, scene=varied)
        curve = saturation_curve(light, (0, 1), beat, low=FIT_SO2[0], high=FIT_SO2[-1], seed=seed)
        lines, _ = calibrate_curve(FIT_SO2, curve(FIT_SO2).ratio, 1)
        # From peak to peak to the amplitude of a sine of the same root mean square, as the table has it.
        as_sine = np.sqrt(2) * beat.pulse.sum(1).std() / np.ptp(beat.extremes.sum(1))
        index = np.log(100 * as_sine * curve([varied.blood.so2]).perfusion_index[..., 0])
        return np.stack([lines[..., 1], lines @ [1.0, at], index[:, 0], index[:, 1]], 1)

    by_photodiode = answers(scene)
    priors = [prior for prior in scene.finger_priors if only_absorbs(scene, prior)]
    middle, spread, _ = _moments(over_priors(scene, priors, lambda varied: np.nanmean(answers(varied), -1)))
    # One finger, so that the model's error is its spread over fingers, and over the photodiodes' distances.
    error = np.hypot(spread, np.nanstd(by_photodiode[0], axis=-1, ddof=1))
    remark = (
        f"One finger on a reflectance module; the model is the shipped oximeter, at {MODULE_INFRARED_NM:g} nm "
        "as the module, over the priors that only absorb, and as its photodiodes differ, whose distances are not the "
        "module's."
    )
    bands = ("95 % interval of the estimate", f"{PRIORS_95} and photodiodes")
    about = {"units": "percent", "bands": bands} | _of(people, "prediction", "no optics were fitted to it")
    reference = f" The reference, an oximeter on the same person, may be off by {REFERENCE_SPO2_ERROR:g} %."
    level = float(spo2.mean()), float(np.hypot(scatter, REFERENCE_SPO2_ERROR))
    slope, words = (
        (float(line[0]), float(np.sqrt(covariance[0, 0]))),
        "slope of SpO2 over the ratio of ratios, 70 to 100 %",
    )
    result = {}
    for k, (name, both, quantity, more) in enumerate(
        (("slope", slope, words, ""), ("level", level, f"SpO2 at a ratio of ratios of {at:.3f}", reference))
    ):
        model = float(middle[k]), float(error[k])
        result[f"spo2_{name}"] = _z(both, model, quantity=quantity, remark=remark + more, **about)
    normal = still[still["spo2_percent"] >= NORMAL_SPO2]
    for k, name in enumerate(("red", "infrared"), start=2):
        result[f"pulse_{name}"] = _coverage(
            normal[f"{name}_ac_over_dc_percent"],
            np.exp(_interval(float(middle[k]), float(error[k]))),
            few=True,
            quantity=f"amplitude of the pulse over the mean, {name}",
            units="percent",
            counted="recordings within the model's interval",
            bands=("95 % of recordings", bands[1]),
            remark=f"{remark} Recordings at {NORMAL_SPO2:g} % saturation or more; rms times the root of 2.",
            **_of(people, "fitted", "the arteriolar blood is fitted to the pulse of this finger at 95 to 98 %"),
        )
    return result


def _moments(answers: PriorSensitivity) -> tuple[Array, Array, Array]:
    """Mean over the priors, which the scene's own answer need not be; standard deviation with the noise of the
    light, and that noise, (...) float each."""
    shift, error = answers.shift
    noise = np.hypot(error, jackknife(answers.base_answer))
    return answers.base_answer[0] + shift, np.hypot(answers.total[0], noise), noise


class _Reflectance:
    """Reflectance of one place on a shipped finger, without its board, over its optics."""

    def __init__(self, scene: Scene, patch: Patch, options: TraceOptions, share: float = 1.0) -> None:
        self.scene, self.patch, self.options = as_seen(scene), patch, options
        count = round(share * (options.photons or RAYS))
        self.backend = backend.activate_jit(options.backend, "validate")
        self.rays, self._own = self._walked(self.scene, count), dict[str, ColourRays]()

    def _walked(self, scene: Scene, photons: int) -> ColourRays:
        nail = NailReflectance(scene, backend=self.backend.name, stores=LightStore.of_command(self.options))
        return walk_colour(nail, (self.patch,), photons=photons, seed=self.options.seed)

    def read(self, scene: Scene, rays: ColourRays | None = None, *, gloss: bool = False) -> Array:
        """At the wavelengths of colours, by all rays and without each group of them, (1 + groups, q) float."""
        viewing = scene.colour.model_copy(update={"gloss": gloss})
        return (rays or self.rays).reflectance(_rest(scene), viewing, scene=scene)[:, 0, 0]

    def over_priors(
        self, scene: Scene, priors: Sequence[Prior], quantities: Callable[[Scene, ColourRays], Array]
    ) -> PriorSensitivity:
        """Quantities of a scene and its rays, (1 + groups, ...) float, over priors: what scatters is walked anew."""
        base, twin = quantities(scene, self.rays), quantities(scene, self.few(scene))
        return over_priors(scene, priors, lambda varied: base + quantities(varied, self.few(varied)) - twin)

    def few(self, scene: Scene) -> ColourRays:
        """Fewer rays, of any scattering, with the same random numbers, so that what all have in common cancels."""
        key = light_digest(scene)
        if key not in self._own:
            self._own[key] = self._walked(scene, min(OWN_RAYS, self.options.photons or RAYS))
        return self._own[key]


def _nails(photos: "pd.DataFrame", options: TraceOptions) -> dict[str, Comparison]:
    """L*, a*, b* of nails, one value for each person, and how colours change with haemoglobin."""
    scene, viewer, more = _shipped_scene("prototype"), Viewer(), 1 + HAEMOGLOBIN_STEP / photos["hb_g_per_l"].mean()
    nail = _Reflectance(scene, patches_of(scene)[ALONG // 2], options, NAIL_SHARE)
    scene = nail.scene

    def quantities(varied: Scene, rays: ColourRays) -> Array:
        bled = at_value(varied, "blood.rest_blood_fraction", float(more * varied.blood.rest_blood_fraction))
        both = np.stack([nail.read(varied, rays), nail.read(bled, rays)])
        effects = _effects(both @ viewer.weights @ np.linalg.inv(XYZ_OF_RGB).T)
        return np.column_stack([viewer.lab(both[0]), *(after - before for before, after in effects.values())])

    priors = [p for p in scene.finger_priors if p.field.startswith("finger.") or p.field in BLOOD_OF_NAIL]
    middle, spread, noise = _moments(nail.over_priors(scene, priors, quantities))
    return _colours(photos, middle, spread) | _slopes(photos, middle[3:], spread[3:], noise[3:])


def _colours(photos: "pd.DataFrame", middle: Array, spread: Array) -> dict[str, Comparison]:
    """L*, a*, b* of people who were not fitted, and of the model, (3,) float or more each."""
    held_out = np.arange(len(photos)) % FOLDS == FOLDS - 1
    people = nails_lab(photos[held_out] if photos.attrs["shipped"] else photos)
    return {
        f"nail_{band[0]}": _coverage(
            people[:, k],
            _interval(float(middle[k]), float(spread[k])),
            quantity=f"{band} of nails, {len(people)} people",
            units="1",
            remark="Photographs, scaled to skin under a spectrophotometer: exposure and tone curve are unknown.",
            **_of(photos, "held out", f"these {len(people)} were left out when the plate was fitted to the others"),
        )
        for k, band in enumerate(("L*", "a*", "b*"))
    }


class _Skin(_Reflectance):
    """A ring finger's pulp, gloss included."""

    def __init__(self, options: TraceOptions) -> None:
        scene = _shipped_scene("prototype").model_copy(update={"finger": Finger(digit="ring")})
        super().__init__(scene, PAD, options)

    def spectrum(self, scene: Scene, rays: ColourRays | None = None) -> Array:
        """At the wavelengths of the tables, by all rays and without each group, (1 + groups, q) float. [percent]"""
        read = self.read(scene, rays, gloss=True)
        return 100 * np.stack([np.interp(SPECTRUM_NM, WAVELENGTHS_NM, one) for one in read])

    def bands(self, scene: Scene, fields: Sequence[str]) -> Array:
        """The spectrum [percent] and its W over priors: low, the scene's and high, (3, q + 1) float."""

        def quantities(varied: Scene, rays: ColourRays) -> Array:
            spectrum = self.spectrum(varied, rays)
            return np.log(np.column_stack([spectrum, _w(spectrum)]))

        answers = self.over_priors(scene, [p for p in scene.finger_priors if p.field in fields], quantities)
        (middle, spread, _), own = _moments(answers), answers.base_answer[0]
        return np.exp(np.stack([middle - Z95 * spread, own, middle + Z95 * spread]))

    def of_group(self, blood: float, melanin: float) -> Scene:
        """The scene with the blood and the melanin of a group of people. [1]"""
        bled = at_value(self.scene, "blood.pulp_blood_fraction", float(blood))
        return at_value(bled, "finger.melanin_fraction", float(melanin))

    def fingers(self, table: "pd.DataFrame", **about: Any) -> dict[str, Comparison]:
        """Ring fingers beside the shipped skin, and the depth of the W of oxyhaemoglobin."""
        if not len(table):
            return {}
        everyone, quartiles = _pooled(table, (5, 50, 95)), _pooled(table, (25, 75))
        model = self.bands(self.scene, (*OF_SKIN, *OF_FITTED_SKIN))
        what = f"reflectance of skin: ring finger, {_people(table)} people"
        counted = "wavelengths at which the model is within 25-75 % of people"
        result = {"ring_finger": _spectrum(model, everyone, quartiles, quantity=what, counted=counted, **about)}
        return result | _w_depth("ring finger", table, [model] * table.group.nunique(), **about)

    def hands(self, table: "pd.DataFrame", **about: Any) -> dict[str, Comparison]:
        """Hands of each group with the melanin and the blood that come nearest to its median, and their W."""
        blood, melanin = (axis.ravel() for axis in np.meshgrid(SKIN_BLOOD, MELANIN))
        scenes = [self.of_group(*both) for both in zip(blood, melanin, strict=True)]
        few = self.few(self.scene)
        more = self.spectrum(self.scene)[0] / self.spectrum(self.scene, few)[0]
        skins, models, result = list[Array](), list[Array](), dict[str, Comparison]()
        for group, rows in table.groupby("group", sort=False):
            skins = skins or [more * self.spectrum(scene, few)[0] for scene in scenes]
            low, middle, high = (_percentile(rows, percent) for percent in PERCENTILES["back of hand"])
            best = int((np.log(skins / middle) ** 2).sum(-1).argmin())
            models.append(self.bands(scenes[best], OF_SKIN))
            result[f"back_of_hand_{group}"] = _spectrum(
                models[-1],
                np.stack([low, middle, high]),
                (low, high),
                quantity=f"reflectance of skin: back of hand, group {group}, {_people(rows)} people",
                counted="wavelengths at which the model is within 5-95 % of people",
                fit=f"melanin of {100 * melanin[best]:.2g} % and blood of {100 * blood[best]:.2g} %, to their median",
                **about,
            )
        return result | _w_depth("back of hand", table, models, fit="melanin and blood, to the medians", **about)


def _pooled(table: "pd.DataFrame", percentiles: tuple[int, ...]) -> Array:
    """Percentiles of all groups' people together, from those of each, (n, q) float."""
    known, samples = PERCENTILES["ring finger"], []
    for _, group in table.groupby("group"):
        rows = np.stack([_percentile(group, percent) for percent in known])
        at = 100 * (np.arange(count := _people(group)) + 0.5) / count
        samples.append(np.stack([np.interp(at, known, column) for column in rows.T], -1))
    return np.asarray(np.percentile(np.concatenate(samples), percentiles, axis=0))


def _percentile(table: "pd.DataFrame", percent: int) -> Array:
    return np.asarray(table[table.percentile == percent][_SPECTRUM].to_numpy(float)[0])


def _people(table: "pd.DataFrame") -> int:
    """How many people a table of spectra has."""
    return int(np.ceil(table[table.percentile == 50].people.sum()))


def _spectrum(model: Array, people: Array, ends: ArrayLike, **about: Any) -> Comparison:
    """People's spectra and the model's with its W, (3, q) and (3, q + 1), and the ends between which it agrees."""
    low, high = np.asarray(ends)
    model = model[:, :-1]
    inside = (model[1] >= low) & (model[1] <= high)
    over: dict[str, Any] = {"x": SPECTRUM_NM, "x_label": "wavelength [nm]", "units": "percent"}
    return _curve(inside, people, model, bands=("5 to 95 % of people", PRIORS_95), **over, **about)


def _w(spectrum: Array) -> Array:
    """Reflectance in the middle of the W of oxyhaemoglobin over that of its sides, of (..., q), (...) float."""
    left, middle, right = np.moveaxis(spectrum[..., np.searchsorted(SPECTRUM_NM, W_NM)], -1, 0)
    return np.asarray(2 * middle / (left + right))


def _w_depth(place: str, table: "pd.DataFrame", model: Sequence[Array], **about: Any) -> dict[str, Comparison]:
    """The W of groups' medians beside the last of the model's of each, (3, n) float; of one group alone nothing, as its
    standard error is not known."""
    people = np.array([_w(_percentile(group, 50)) for _, group in table.groupby("group", sort=False)])
    if len(people) < 2:
        return {}
    low, middle, high = np.array([one[:, -1] for one in model]).T
    stderr = float((middle - people).std(ddof=1) / np.sqrt(len(people)))
    return {
        f"w_of_{place.replace(' ', '_')}": _z(
            (float(people.mean()), stderr),
            (float(middle.mean()), 0.0),
            float((high - low).mean() / (2 * Z95)),
            quantity=f"W of oxyhaemoglobin, {place}",
            units="1",
            bands=("95 % interval of the mean of groups", PRIORS_95),
            remark="Reflectance at 560 nm over the mean of that at 540 and 580 nm, of groups' medians. The "
            "standard error is that of the difference to the model; z is without the spread over the priors.",
            **about,
        )
    }


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


def nails_lab(photos: "pd.DataFrame") -> Array:
    """L*, a*, b* of people's nails, (p, 3) float.

    The level of a nail is that of the skin beside it, times what a spectrophotometer measured on the shipped hands.
    """
    viewer, spectra = Viewer(), read_people("skin_spectra")
    hands = spectra[(spectra.place == "back of hand") & spectra.group.isin(SCALED_TO) & (spectra.percentile == 50)]
    skin = np.interp(WAVELENGTHS_NM, SPECTRUM_NM, hands[_SPECTRUM].to_numpy(float).mean(0) / 100)
    skin_rgb = skin @ viewer.weights @ np.linalg.inv(XYZ_OF_RGB).T
    nail, beside = (photos[[f"{part}_{c}" for c in "rgb"]].to_numpy() for part in ("nail", "skin"))
    return lab_of(nail / beside * skin_rgb @ XYZ_OF_RGB.T)


def _slopes(photos: "pd.DataFrame", middle: Array, spread: Array, noise: Array) -> dict[str, Comparison]:
    """Changes of colours with haemoglobin, of people and of the model, (3,) float each in the order of `EFFECTS`."""
    people, result = _effects(photos[_RGB[:3]].to_numpy()), {}
    fitted = _of(photos, "fitted", "plate and bed are fitted to two thirds of these people, with this slope")
    untouched = _of(photos, "prediction", "plate and bed are fitted to changes relative to red and of a*, not to this")
    for k, (name, words) in enumerate(EFFECTS.items()):
        result[f"haemoglobin_{name}"] = _z(
            slope_within_days(photos, people[name]),
            (float(middle[k]), float(noise[k])),
            float(spread[k]),
            quantity=f"{words} of nails per 10 g/l of haemoglobin",
            units="1",
            bands=("95 % interval of the mean", PRIORS_95),
            remark="Within days of photographs. Exposure and what else goes with haemoglobin are not modelled; z is of "
            "means, without the spread over the priors.",
            **(untouched if name == "green" else fitted),
        )
    return result


def slope_within_days(photos: "pd.DataFrame", values: Array) -> tuple[float, float]:
    """Of people's values per 10 g/l of haemoglobin within a day of photographs, and its standard error."""
    day = photos["day"].to_numpy()
    x, y = (v - np.array([v[day == d].mean() for d in day]) for v in (photos["hb_g_per_l"].to_numpy(), values))
    slope = float(x @ y / (x @ x))
    freedom = len(x) - len(set(day)) - 1
    stderr = float(np.sqrt(((y - slope * x) ** 2).sum() / freedom / (x @ x)))
    return HAEMOGLOBIN_STEP * slope, HAEMOGLOBIN_STEP * stderr
