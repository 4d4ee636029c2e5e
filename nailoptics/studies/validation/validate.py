"""The model beside measurements on people: nails, skin, pulse and slow waves, each with the spread of both.

Each quantity states whether the model was fitted to these people (assets/real/quantities.toml).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pandas as pd
from scipy.constants import mmHg

from ...checks import Array
from ...display import Displayed
from ...errors import InputError
from ...hemodynamics.for_scene import blood_model, heart_rate_per_min, rest_beat
from ...hemodynamics.waves import HEARTBEAT, waves_of, waves_pressure
from ...light import ProgressCallback, trace
from ...options import Requested, TraceOptions
from ...scene import Body, Scene, load_scene
from ...scene.priors import shipped_priors
from ...variables import stopwatch
from ..oximetry.ratio import FIT_SO2, calibrate_curve, saturation_curve
from ..prior_uncertainty import at_value, only_absorbs, over_priors
from . import people_tables
from .appearance import Skin, nails
from .comparison import Comparison, interval, moments, part_between, texts_of
from .people_tables import COLUMNS, read_people

# Photons of each LED where none are requested.
PHOTONS = 1_000_000
# Of the module MAXM86161 that recorded the finger; judgement, its data sheet was not at hand. Red is 660 nm as here.
MODULE_INFRARED_NM = 880.0
# Of the reference oximeter, one on one person, so that it is common to all recordings: the root mean square error that
# makers state for 70 to 100 % (ISO 80601-2-61 requires 4 or less). [percent]
REFERENCE_SPO2_ERROR = 2.0


@dataclass(frozen=True, repr=False)
class Validation(Displayed):
    """Every quantity beside the model, by name; attributes say how it was made.

    no_data : quantities of which the tables have nothing.
    """

    tables: dict[str, Comparison]
    attributes: Mapping[str, Any]
    no_data: Sequence[str] = ()

    def counts(self) -> dict[str, tuple[int, int]]:
        """How many quantities agree, and of how many: of those that were not fitted, and of the fitted ones."""
        sides: dict[str, list[bool]] = {"unfitted": [], "fitted": []}
        for comparison in self.tables.values():
            sides["fitted" if comparison.texts["basis"] == "fitted" else "unfitted"].append(comparison.agrees)
        return {words: (sum(agree), len(agree)) for words, agree in sides.items()}


def validate(
    *, data: Path | None = None, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> Validation:
    """Compare the model of the shipped scenes with what was measured on people.

    data : folder of tables of one's own; those that it lacks are the shipped ones.
    requested : fields of `TraceOptions`; photons are those of each LED and the rays of all colours.

    Raises: InputError for a table that lacks columns or rows, or has values that none can have.
    """
    run_time, options = stopwatch(), TraceOptions(**requested)
    if options.relative_error is not None or options.max_seconds is not None:
        raise InputError("validate has no relative_error and no max_seconds; give photons.")
    if data is not None and not any((data / f"{name}.csv").is_file() for name in COLUMNS):
        files = ", ".join(f"{name}.csv" for name in COLUMNS)
        raise InputError(f"{data}: holds none of {files}; see docs/validation.md.")
    tables = {name: read_people(name, data) for name in COLUMNS}
    result = _waves(tables["fingertip_waves"])
    result["pulse_over_contact_pressure"] = _contact_pressure(tables["pulse_against_contact_pressure"])
    result |= _pulse(tables["red_infrared_pulse"], options, progress) | nails(tables["nail_photos"], options)
    skin, spectra, no_data = Skin(options), tables["skin_spectra"], []
    for place, compare in (("ring finger", skin.fingers), ("back of hand", skin.hands)):
        if (there := spectra.place == place).any():
            result |= compare(spectra[there])
        else:
            no_data.append(place)
    return Validation(result, {"seed": options.seed, "engine": "photons"} | run_time(), no_data)


def _waves(people: pd.DataFrame) -> dict[str, Comparison]:
    """Breathing and vasomotion in the blood of the bed, over the heartbeat, rms."""
    scene, ranges = load_scene("heartbeat"), {prior.field: prior for prior in shipped_priors()}
    assert scene.body is not None
    rms, model = {}, blood_model(scene)
    for wave, fields in waves_of(scene.body):
        frequency_hz, power = wave.lines(**fields)
        gain = model.by_arterial_pressure(frequency_hz, 0.0).mean(0)
        rms[wave.name] = float(np.sqrt(power @ np.abs(gain) ** 2))
    result = {}
    for name, column in (("vasomotion", "vasomotion_0.05_0.15_hz_g"), ("breathing", "breathing_0.15_0.4_hz_g")):
        prior = ranges[f"body.{name}.amplitude_pa"]
        amplitudes_pa = np.array([[prior.low], [getattr(scene.body, name).amplitude_pa], [prior.high]])
        modelled = rms[name] / rms[HEARTBEAT.name] * amplitudes_pa / amplitudes_pa[1]
        texts, values = texts_of("waves", people, wave=name), people[column] / people["heart_0.7_3_hz_g"]
        result[f"{name}_over_heartbeat"] = Comparison.by_coverage(texts, values, modelled)
    return result


def _contact_pressure(people: pd.DataFrame) -> Comparison:
    """The heartbeat in arteriolar blood under a contact pressure; both shapes over their means."""
    scene, pressure = load_scene("pulse_oximeter"), people["pressure_mmhg"].to_numpy()
    prior = {prior.field: prior for prior in shipped_priors()}["body.heartbeat.arteriolar_peak_pa"]

    def shape(varied: Scene) -> Array:
        small = blood_model(varied).arterioles
        assert small is not None and varied.body is not None and varied.body.heartbeat is not None
        beat = Body(heartbeat=varied.body.heartbeat.model_copy(update={"rate_variability": 0.0}))
        times_s = np.linspace(0.0, 60.0 / heart_rate_per_min(varied.body), 256)
        arterial_pa = waves_pressure(beat, times_s, mean_pressure_pa=small.mean_pa, pulse_ratio=small.pulse_ratio)
        amplitude = np.ptp(small.fraction(arterial_pa - mmHg * pressure[:, None]), axis=1)
        return np.asarray(amplitude / amplitude.mean())

    ends = [shape(at_value(scene, prior.field, end)) for end in (prior.low, prior.high)]
    model = np.stack([np.minimum(*ends), shape(scene), np.maximum(*ends)])
    both = people[["red_660_nm", "infrared_850_nm"]].to_numpy()
    measured = both / both.mean(0)
    shown = np.stack([measured.min(1), measured.mean(1), measured.max(1)])
    inside = part_between(shown[1], model[0], model[2])
    return Comparison.of_curve(texts_of("contact_pressure", people), inside, shown, model, pressure)


def _pulse(people: pd.DataFrame, options: TraceOptions, progress: ProgressCallback | None) -> dict[str, Comparison]:
    """Saturation over the ratio of ratios, and the pulse's amplitude in red and infrared light."""
    still = people[people["correlation"] > people_tables.LEAST_CORRELATION]
    ratio, spo2 = still["ratio_of_ratios"].to_numpy(), still["spo2_percent"].to_numpy()
    line, covariance = np.polyfit(ratio, spo2, 1, cov=True)
    scatter = float(np.std(spo2 - np.polyval(line, ratio), ddof=2) / np.sqrt(len(spo2)))
    measured = {
        "slope": (float(line[0]), float(np.sqrt(covariance[0, 0]))),
        "level": (float(spo2.mean()), float(np.hypot(scatter, REFERENCE_SPO2_ERROR))),
    }
    middle, error = _model_pulse(float(ratio.mean()), options, progress)
    words = {"infrared_nm": MODULE_INFRARED_NM, "ratio": ratio.mean(), "normal_percent": people_tables.NORMAL_SPO2}
    words, result = words | {"reference_percent": REFERENCE_SPO2_ERROR}, dict[str, Comparison]()
    for k, (name, both) in enumerate(measured.items()):
        texts = texts_of(f"spo2_{name}", people, **words)
        result[f"spo2_{name}"] = Comparison.by_standard_errors(texts, both, (float(middle[k]), float(error[k])))
    normal = still[still["spo2_percent"] >= people_tables.NORMAL_SPO2]
    for k, name in enumerate(("red", "infrared"), start=2):
        texts, values = texts_of("pulse", people, light=name, **words), normal[f"{name}_ac_over_dc_percent"]
        result[f"pulse_{name}"] = Comparison.by_coverage(texts, values, np.exp(interval(middle[k], error[k])))
    return result


def _model_pulse(ratio: float, options: TraceOptions, progress: ProgressCallback | None) -> tuple[Array, Array]:
    """Slope of the line of saturation over the ratio of ratios, its level at a ratio [percent], and logarithms of both
    perfusion indices in percent, with their errors, (4,) float each."""
    scene = load_scene("pulse_oximeter")
    red, infrared = scene.leds
    leds = red, infrared.model_copy(update={"wavelength_nm": MODULE_INFRARED_NM})
    scene = scene.without_accuracy().model_copy(update={"leds": leds})
    how = options.fields | {"photons": options.photons or PHOTONS, "relative_error": None}
    transfer = trace(scene, progress=progress, **how)

    def answers(varied: Scene) -> Array:
        """By photodiode, (1 + groups, 4, photodiodes) float."""
        beat = rest_beat(varied)
        curve = saturation_curve(replace(transfer, scene=varied), (0, 1), beat, low=FIT_SO2[0], high=FIT_SO2[-1])
        lines, _ = calibrate_curve(FIT_SO2, curve(FIT_SO2).ratio, 1)
        # From peak to peak to the amplitude of a sine of the same root mean square, as the table has it.
        index = np.log(100 * np.sqrt(2) * beat.rms_per_swing * curve([varied.blood.so2]).perfusion_index[..., 0])
        return np.stack([lines[..., 1], lines @ [1.0, ratio], index[:, 0], index[:, 1]], 1)

    priors = [prior for prior in scene.finger_priors if only_absorbs(scene, prior)]
    middle, spread, _ = moments(over_priors(scene, priors, lambda varied: np.nanmean(answers(varied), -1)))
    # One finger, so that the model's error is its spread over fingers, and over the photodiodes' distances.
    return middle, np.hypot(spread, np.nanstd(answers(scene)[0], axis=-1, ddof=1))
