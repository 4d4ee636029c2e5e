"""A calibrated person as a file: everything that estimating force from volts takes, readable, in TOML."""

import hashlib
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AliasChoices, BaseModel, BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from ...checks import as_input_error
from ...display import Displayed
from ...errors import InputError
from ...hemodynamics.waves import CardiacOscillator, DampedOscillator
from ...scene.base import Fraction
from ...scene.importers.sensor_recordings import MOST_VOLTS
from ...scene.text_files import parse_toml, read_text
from .ensemble import Ensemble
from .person import MOST_GAIN, NAMES, PRIORS, SPREAD_LN, TABLE, Array, NominalFinger, Numbers, Person, within
from .reading_table import POWERS, ReadingTable
from .scores import Baseline

# No calibration finds more: factors on the scene's constants.
MOST_FACTOR = 100.0
# A calibration whose own touches come out further off than this fraction of their size, rms, does not fit its person;
# those of files without touches, further than this. [1, N]
MOST_ERROR, MOST_RMS_N = 0.15, 0.15
# Parameters that are calibrated of each reading: gain, offset and an added slope by the blood of either zone.
LINEAR = 4
# A factor is informed by a calibration that leaves less than this fraction of the prior's standard deviation.
INFORMED = 0.7
# Measurement noise by the model's error, as fractions of a reading's recent change and of its distance from rest.
# Chosen on the virtual people, and on light known to 2 %: without the first a touch released past closure leads the
# filter far astray, without the second a held touch persists. [1]
DYNAMIC_ERROR, STATIC_ERROR = 0.03, 0.01
# Correlation time of that error, and time over whose means the noise of readings is stated. [s]
READING_CORRELATION_S, NOISE_S = 0.4, 0.04


@dataclass(frozen=True, config=TABLE)
class Quality:
    """How well a calibration fits its own recordings.

    chi2_per_dof : of the whitened residuals. rms_n : error of touches' force; NaN where it could not be judged. [N]
    outliers : fraction of the samples of a force that stays that the filter takes for outliers. [1]
    touches : rms_n, relative_error (of the touches' rms force), coverage_95 and half_width_n of touches by kind. [N, 1]
    lacking : what recordings lack of the protocol.
    """

    chi2_per_dof: float
    rms_n: Annotated[float, Field(allow_inf_nan=True)]
    outliers: Fraction = 0.0
    touches: dict[str, dict[str, Annotated[float, Field(allow_inf_nan=True)]]] = Field(default_factory=dict)
    lacking: tuple[str, ...] = ()

    @property
    def relative_error(self) -> float:
        """rms error of the calibration's touches over their rms force; NaN where it could not be judged. [1]"""
        return self.touches.get("all", {}).get("relative_error", float("nan"))

    @property
    def fault(self) -> str:
        """That the force of the calibration's own touches came out so far off that others will, too; else empty."""
        is_wrong = self.relative_error > MOST_ERROR if self.touches else self.rms_n > MOST_RMS_N
        off = f"{1e3 * self.rms_n:.0f} mN off on its own touches (rms)"
        return f"the calibration itself was {off}: calibrate again." if is_wrong else ""


@dataclass(frozen=True, config=TABLE)
class Readings:
    """What was calibrated of the readings: (R,) float each. Volts are offset_v + gain * the table's.

    residual_rms_v : of the fit. noise_v : white noise, rms, of means over NOISE_S of faster samples. [V]
    """

    gain: Annotated[Numbers, within(1 / MOST_GAIN, MOST_GAIN)]
    offset_v: Annotated[Numbers, within(0, MOST_VOLTS)]
    residual_rms_v: Numbers
    noise_v: Annotated[Numbers, within(1e-12, MOST_VOLTS, np.positive)]


def _columns(rows: Any) -> Any:
    """The columns of a file's table that has a row for each reading."""
    if not isinstance(rows, dict):
        return rows
    if not all(isinstance(row, dict) for row in rows.values()):
        raise ValueError("must have a table for each reading")
    fields = {field for row in rows.values() for field in row}
    return {field: [row.get(field) for row in rows.values()] for field in fields}


@dataclass(frozen=True, config=TABLE)
class Noise:
    """What moves readings beside the touch, and beside their white noise.

    drift_per_min : random walk of each reading in a minute, of its volts. [1]
    led_drift_per_min : that of all readings of an LED together. [1]
    donning : by how much a reading's gain differs when the sensor is put on anew, as far as recordings show. [1]
    beat : the heart's; None where none was detected. waves : slower ones of the arterial pressure.
    dynamic_error, static_error : of the model, as fractions of a reading's recent change and of its distance from rest;
        not in the file. [1]
    """

    drift_per_min: Fraction
    led_drift_per_min: Fraction
    waves: Annotated[tuple[DampedOscillator, ...], Field(validation_alias=AliasChoices("waves", "rhythms"))]
    # Files of version 0.2 have an empty table where none was detected.
    beat: Annotated[CardiacOscillator | None, BeforeValidator(lambda beat: beat or None)] = None
    donning: Fraction = 0.0
    dynamic_error: Annotated[float, Field(exclude=True)] = DYNAMIC_ERROR
    static_error: Annotated[float, Field(exclude=True)] = STATIC_ERROR

    def drift_covariance(self, led: Array) -> Array:
        """Covariance of R readings' drift in a minute, over the readings, (R, R) float; led : as of `same_led`."""
        return np.asarray(self.drift_per_min**2 * np.eye(len(led)) + self.led_drift_per_min**2 * led @ led.T)

    def model_error2(self, from_rest: Array, moved: Array, since_s: float | None) -> Array:
        """Variance of readings by the model's error, of their distance from rest and their recent change, (...) float.

        since_s : time of a sample. [s]
        """
        # Samples within the correlation time count as one.
        correlated = max(1.0, READING_CORRELATION_S / since_s) if since_s else 1.0
        return np.asarray(correlated * ((self.dynamic_error * moved) ** 2 + (self.static_error * from_rest) ** 2))


def _factor_values(table: Any) -> Any:
    """The factors of a file's table, which says more of each."""
    if isinstance(table, dict) and list(table) != list(NAMES):
        raise ValueError("must be those of this version")
    return [factor["value"] for factor in table.values()] if isinstance(table, dict) else table


@dataclass(frozen=True, kw_only=True, config=TABLE)
class Subject(Displayed):
    """A person's calibrated sensor, P factors and R readings.

    scene_digest : of the scene whose board and finger it was calibrated for.
    factors : (P,) float, by NAMES. scene : what they multiply.
    light : volts over blood. ensemble : regressions beside the filter; none in files of version 0.2, or of few touches.
    comparisons : regressions that estimates are compared with, by name.
    covariance : (P + 4 R, P + 4 R) float. Of the factors' logarithms, gains, offsets [V], and added slopes of ln volts
        by the blood of either zone.
    """

    schema_version: Literal[3] = 3
    # Of 0.2.0, which could fit the optics of the paper, too; what was fitted is in `scene` and `light`.
    model: Literal["network", "paper"] = "network"
    scene_digest: str
    quality: Quality
    factors: Annotated[Numbers, BeforeValidator(_factor_values), within(1 / MOST_FACTOR, MOST_FACTOR, np.positive)]
    readings: Annotated[Readings, BeforeValidator(_columns)]
    noise: Noise
    scene: NominalFinger
    light: ReadingTable
    covariance: Annotated[Numbers, within(0, MOST_GAIN**2, np.diag)]
    ensemble: Ensemble | None = None
    comparisons: dict[str, Baseline] = Field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.light.names)
        sizes = {"covariance": len(self.covariance) - len(NAMES) - (LINEAR - 1) * count}
        sizes |= {f"readings.{name}": len(column) for name, column in vars(self.readings).items()}
        sizes |= {f"comparisons.{name}": line.projection.shape[1] for name, line in self.comparisons.items()}
        sizes |= {} if self.ensemble is None else {"ensemble.components": self.ensemble.components.shape[1]}
        if wrong := [name for name, size in sizes.items() if size != count]:
            raise ValueError(f"{wrong[0]} is not that of {count} readings")

    def __repr__(self) -> str:
        """What was calibrated, in a line."""
        rms = f"{1e3 * self.quality.rms_n:.0f} mN"
        return f"<Subject: {len(self.light.names)} readings; rms error of the calibration's force {rms}>"

    @cached_property
    def factors_ln(self) -> Array:
        """Logarithms of the factors, (P,) float."""
        return np.asarray(np.log(self.factors))

    @cached_property
    def person(self) -> Person:
        """The calibrated person."""
        return self.scene.person(self.factors_ln)

    @cached_property
    def rest_v(self) -> Array:
        """Readings at rest, less the offset, (R,) float. [V]"""
        return np.asarray(self.readings.gain * self.light.slopes(self.person.blood(np.ones(2)))[0])

    @cached_property
    def drift_covariance(self) -> Array:
        """Covariance of the readings' drift in a minute, over the readings, (R, R) float."""
        return self.noise.drift_covariance(self.light.same_led())

    def measurement_noise(self, blood_v: Array, moved_v: Array, since_s: float | None) -> Array:
        """Diagonal of the filter's measurement noise covariance R, (R,) float: white noise and the model's error. [V^2]

        blood_v, moved_v : (R,) float. Readings less drift, and their recent change. since_s : time of a sample. [s]
        """
        from_rest_v = blood_v - self.readings.offset_v - self.rest_v
        white_v2 = self.readings.noise_v**2 * (max(1.0, NOISE_S / since_s) if since_s else 1.0)
        return np.asarray(white_v2 + self.noise.model_error2(from_rest_v, moved_v, since_s))

    @property
    def stderr(self) -> Array:
        """Standard errors of factors' logarithms, gains, offsets and slopes, (P + 4 R,)."""
        return np.sqrt(np.diag(self.covariance))

    def factor_table(self) -> dict[str, dict[str, Any]]:
        """What is known of every factor, by name."""
        rows = zip(PRIORS.items(), self.factors.tolist(), self.stderr.tolist(), SPREAD_LN.tolist(), strict=False)
        return {
            name: {
                "value": value,
                "stderr": stderr * value,
                "prior": f"lognormal about 1, a factor {prior.spread:g} either way",
                "informed": stderr < INFORMED * spread,
                "what": prior.text,
            }
            for (name, prior), value, stderr, spread in rows
        }

    def reading_table(self) -> dict[str, dict[str, float]]:
        """Gain, offset and noise of every reading, by name."""
        gain_stderr, offset_stderr_v, *_ = np.split(self.stderr[len(NAMES) :], LINEAR)
        columns = vars(self.readings) | {"gain_stderr": gain_stderr, "offset_stderr_v": offset_stderr_v}
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        return {name: dict(zip(columns, row, strict=True)) for name, row in zip(self.light.names, rows, strict=True)}


FILE = TypeAdapter(Subject)


def subject_toml(subject: Subject) -> str:
    """A subject as the text of its file."""
    import tomli_w

    tables = FILE.dump_python(subject, exclude_none=True)
    tables["light"]["powers"] = POWERS
    text = tomli_w.dumps(tables | {"factors": subject.factor_table(), "readings": subject.reading_table()})
    return f'digest = "{_digest(parse_toml(text, "subject"))}"\n{text}'


def _digest(tables: dict[str, Any]) -> str:
    """SHA-256 of a file's tables, which shows whether a number was changed."""
    return hashlib.sha256(repr(tables).encode()).hexdigest()


def load_subject(path: str | Path) -> Subject:
    """Read a subject file; raises InputError where it is none, or not complete."""
    return parse_subject(read_text(path, "a subject file that nailoptics calibrate wrote"), name=str(path))


def parse_subject(text: str, *, name: str = "subject") -> Subject:
    """Read a subject from the text of its file, which has a digest but in version 0.2."""
    tables = parse_toml(text, name, "subject file")
    written = tables.pop("digest", None)
    try:
        subject = FILE.validate_python(tables)
    except (ValidationError, InputError, KeyError, TypeError, OverflowError) as error:
        why = as_input_error(error, BaseModel).args[0]
        raise InputError(f"{name}: is not a valid subject file: {why} Calibrate again.") from None
    if written not in (None, _digest(tables)):
        raise InputError(f"{name}: was changed after calibrate wrote it; calibrate again.")
    return subject
