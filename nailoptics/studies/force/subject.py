"""A calibrated person as a file: everything that estimating force from volts takes, readable, in TOML."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ... import hemodynamics
from ...errors import InputError
from ...hemodynamics.parameters import Parameters
from ...hemodynamics.waves import CardiacOscillator, DampedOscillator
from ...scene.importers.sensor_recordings import MOST_VOLTS
from ...scene.text_files import parse_toml, read_text
from .baselines import Regression
from .person import NAMES, PRIORS, SPREAD_LN, Person, Pulp, person
from .reading_table import POWERS, ReadingTable
from .state_space import LINEAR, CalibratedSensor, Noise
from .uncertainty import Correction, ForceInterval

Array = NDArray[np.float64]

SCHEMA_VERSION = 3
# No calibration finds more: factors on the scene's constants, and gains of readings.
MOST_FACTOR, MOST_GAIN = 100.0, 1e4
# Correlations of a calibration are known to rounding but for this.
ROUNDING = 1e-3
# Nor regressions: newtons for each volt.
MOST_WEIGHT = 1e9
# A calibration whose own touches come out further off than this, rms, does not fit its person. [N]
MOST_RMS_N = 0.15
Model = Literal["network", "paper"]


@dataclass(frozen=True)
class Subject:
    """A person's calibrated sensor, R readings.

    scene_digest : of the scene whose board and finger it was calibrated for.
    base, rest_blood, area_cm2, share, distal_reach : the scene's vessels and touch, which the factors change.
    pulp : what lies between touch and vessels.
    factors_ln : (P,) float. Logarithms of the factors by NAMES.
    gain, offset_v, residual_rms_v : (R,) float.
    covariance : (P + 4 R, P + 4 R) float. Of factors, gains, offsets, and steeper slopes by the blood of either zone.
    correction : of the pressures that the filter estimates.
    coverage_factor : float. How much wider than usual intervals are, where the calibration's own touches need it.
    most_force_n : the largest calibrated force by site.
    chi2_per_dof, rms_n : of the fit's whitened residuals, and of the force estimated from the calibration's readings.
    """

    scene_digest: str
    model: Model
    table: ReadingTable
    base: Parameters
    rest_blood: float
    area_cm2: float
    share: float
    distal_reach: float
    pulp: Pulp
    factors_ln: Array
    gain: Array
    offset_v: Array
    covariance: Array
    residual_rms_v: Array
    noise: Noise
    correction: Correction
    coverage_factor: float
    most_force_n: dict[str, float]
    chi2_per_dof: float
    rms_n: float
    baselines: dict[str, Regression]

    def person(self, factors_ln: Array | None = None) -> Person:
        """The person, or those of other factors (P, *S)."""
        factors = dict(zip(NAMES, np.exp(self.factors_ln if factors_ln is None else factors_ln), strict=True))
        return person(
            self.base,
            factors,
            rest_blood=self.rest_blood,
            area_cm2=self.area_cm2,
            share=self.share,
            distal_reach=self.distal_reach,
            pulp=self.pulp,
        )

    def check(self) -> None:
        """Raise ValueError unless the numbers fit together and are such as a calibration finds."""
        for name, (values, least, most) in self._ranges().items():
            if not np.all((np.asarray(values) >= least) & (np.asarray(values) <= most)):
                raise ValueError(f"{name} lies outside {least:g} to {most:g}")
        usual = hemodynamics.parameters("listed").as_dict()
        for name, value in self.base.as_dict().items():
            # A gauge pressure may be 0, or below.
            most = MOST_GAIN * max(abs(usual[name]), 1.0 if name == "venous_pressure_pa" else 0.0)
            least = 0.0 if "mass" in name else abs(usual[name]) / MOST_GAIN
            if not least <= abs(value) <= most:
                raise ValueError(f"scene.vessels.{name} = {value}")
        for one in self.noise.rhythms:
            if not (0 < one.frequency_hz < 100 and 0 < one.coherence_s < 1e6 and 0 <= one.rms_pa < 1e5):
                raise ValueError(f"rhythm {one}")
        self._check_shapes()
        self._check_covariance()

    def _ranges(self) -> dict[str, tuple[Any, float, float]]:
        """Numbers by name, each with the least and the most that it can be."""
        table = self.table
        within: dict[str, tuple[Any, float, float]] = {
            "model": (self.model in get_args(Model), True, True),
            "factors": (np.abs(self.factors_ln), 0.0, np.log(MOST_FACTOR)),
            "gain": (np.abs(self.gain), 1 / MOST_GAIN, MOST_GAIN),
            "offset_v": (np.abs(self.offset_v), 0.0, MOST_VOLTS),
            "noise_v": (self.noise.reading_v, 1e-12, MOST_VOLTS),
            "light.noise_v": (table.noise_v, 1e-12, MOST_VOLTS),
            "light.dark_v": (table.dark_v, 0.0, MOST_VOLTS),
            "light.range_v": (table.range_v, 1e-3, MOST_VOLTS),
            "light.slope_stderr": (table.slope_stderr, 0.0, MOST_GAIN),
            "light.ln_volts": (np.abs(table.coefficients), 0.0, MOST_GAIN),
            "light.most_blood_fraction": (table.most_blood, 1e-6, 1.0),
            "rest_blood_fraction": (self.rest_blood, 1e-6, 1.0),
            "contact_area_cm2": (self.area_cm2, 1e-3, 1e3),
            "proximal_share": (self.share, 0.0, 1.0),
            "widening": (self.coverage_factor, 1e-3, MOST_GAIN),
            "distal_reach": (self.distal_reach, 0.0, 1.0),
            "creep": (self.pulp.creep, 0.0, 1.0),
            "creep_s": (self.pulp.creep_s, 1e-3, MOST_GAIN),
            "recovery_s": (self.pulp.recovery_s, 0.0, MOST_GAIN),
            "drift_per_min": (self.noise.drift_per_min, 0.0, 1.0),
            "led_drift_per_min": (self.noise.led_drift_per_min, 0.0, 1.0),
            "correction": (np.stack([self.correction.estimated, self.correction.applied]), 0.0, MOST_GAIN),
            "correction, rising": (np.diff(self.correction.estimated), 1e-6, MOST_GAIN),
            "touch_rate_n_per_cm2_rt_s": (self.noise.touch_rate, 1e-6, MOST_GAIN),
            "moved_error": (self.noise.moved_error, 0.0, 1.0),
            "held_error": (self.noise.held_error, 0.0, 1.0),
        }
        if beat := self.noise.beat:
            within["beat.rate_hz"] = (beat.rate_hz, 0.1, 10.0)
            within["beat.rms_pa"] = (np.array(beat.rms_pa), 1e-3, 1e5)
            within["beat.spread"] = (beat.spread, 1e-3, 1.0)
        for name, regression in self.baselines.items():
            numbers = np.abs([regression.intercept_n, *regression.weights_n_per_v.ravel()])
            within[f"baselines.{name}"] = (numbers, 0.0, MOST_WEIGHT)
        return within

    def _check_shapes(self) -> None:
        """Raise ValueError where an array does not have one entry for each reading."""
        count, table = len(self.table.names), self.table
        shapes = {
            "ln_volts": (table.coefficients, (count, len(POWERS))),
            "slope_stderr": (table.slope_stderr, (count, 2)),
            "dark_v": (table.dark_v, (count,)),
            "light.noise_v": (table.noise_v, (count,)),
        } | {name: (one.weights_n_per_v, (count,)) for name, one in self.baselines.items()}
        for name, (values, shape) in shapes.items():
            if values.shape != shape:
                raise ValueError(f"{name} has shape {values.shape}, not {shape}")

    def _check_covariance(self) -> None:
        """Raise ValueError unless the covariance is one."""
        variance = np.diag(self.covariance)
        if not ((variance >= 0) & (variance <= MOST_GAIN**2)).all():
            raise ValueError("covariance holds a variance that is none")
        scale = np.sqrt(np.where(variance > 0, variance, 1.0))
        correlation = self.covariance / np.outer(scale, scale)
        # A covariance is the inverse of a matrix whose numbers differ by many orders: it is symmetric but for rounding.
        if np.abs(correlation - correlation.T).max() > ROUNDING:
            raise ValueError("covariance is not symmetric")
        if np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min() < -ROUNDING:
            raise ValueError("covariance has a direction of negative variance")

    @property
    def is_wrong(self) -> bool:
        """Whether the force of the calibration's own touches came out so far off that no other can be trusted."""
        return self.rms_n > MOST_RMS_N

    @property
    def sensor(self) -> CalibratedSensor:
        """The sensor that the filter takes."""
        make: Callable[[Array], Person] = self.person
        return CalibratedSensor(make, self.table, self.factors_ln, self.gain, self.offset_v, self.covariance)

    def force_interval(self) -> ForceInterval:
        """Forces with their intervals from the filter's estimates."""
        return ForceInterval(self.sensor, self.noise, correction=self.correction, coverage_factor=self.coverage_factor)

    @property
    def stderr(self) -> Array:
        """Standard errors of factors' logarithms, gains, offsets and slopes, (P + 4 R,)."""
        return np.sqrt(np.diag(self.covariance))

    def factors(self) -> dict[str, dict[str, Any]]:
        """What is known of every factor, by name."""
        spread = self.stderr[: len(NAMES)]
        return {
            name: {
                "value": float(np.exp(self.factors_ln[k])),
                "stderr": float(spread[k] * np.exp(self.factors_ln[k])),
                "prior": f"lognormal about 1, a factor {prior.spread:g} either way",
                "informed": bool(spread[k] < 0.7 * SPREAD_LN[k]),
                "what": prior.text,
            }
            for k, (name, prior) in enumerate(PRIORS.items())
        }

    def readings(self) -> dict[str, dict[str, float]]:
        """Gain, offset and noise of every reading, by name."""
        count, errors = len(NAMES), self.stderr
        size = len(self.gain)
        return {
            name: {
                "gain": float(self.gain[k]),
                "gain_stderr": float(errors[count + k]),
                "offset_v": float(self.offset_v[k]),
                "offset_stderr_v": float(errors[count + size + k]),
                "residual_rms_v": float(self.residual_rms_v[k]),
                "noise_v": float(self.noise.reading_v[k]),
            }
            for k, name in enumerate(self.table.names)
        }


def subject_toml(subject: Subject) -> str:
    """A subject as the text of its file."""
    import tomli_w

    table = subject.table
    return str(
        tomli_w.dumps(
            {
                "schema_version": SCHEMA_VERSION,
                "model": subject.model,
                "scene_digest": subject.scene_digest,
                "quality": {
                    "chi2_per_dof": subject.chi2_per_dof,
                    "rms_n": subject.rms_n,
                    "widening": subject.coverage_factor,
                    "most_force_n": subject.most_force_n,
                },
                "factors": subject.factors(),
                "readings": subject.readings(),
                "noise": {
                    "drift_per_min": subject.noise.drift_per_min,
                    "led_drift_per_min": subject.noise.led_drift_per_min,
                    "touch_rate_n_per_cm2_rt_s": subject.noise.touch_rate,
                    "moved_error": subject.noise.moved_error,
                    "held_error": subject.noise.held_error,
                    "beat": vars(subject.noise.beat) if subject.noise.beat else {},
                    "rhythms": [vars(one) for one in subject.noise.rhythms],
                },
                "correction": {
                    side: {"told_n_per_cm2": estimated.tolist(), "pressed_n_per_cm2": applied.tolist()}
                    for side, estimated, applied in zip(
                        ("proximal", "distal"), subject.correction.estimated, subject.correction.applied, strict=True
                    )
                },
                "baselines": {
                    name: {"intercept_n": one.intercept_n, "weights_n_per_v": one.weights_n_per_v.tolist()}
                    for name, one in subject.baselines.items()
                },
                "scene": {
                    "rest_blood_fraction": subject.rest_blood,
                    "contact_area_cm2": subject.area_cm2,
                    "proximal_share": subject.share,
                    "distal_reach": subject.distal_reach,
                    "pulp": vars(subject.pulp),
                    "vessels": subject.base.as_dict(),
                },
                "light": {
                    "most_blood_fraction": table.most_blood,
                    "range_v": table.range_v,
                    "powers": [list(power) for power in POWERS],
                    "ln_volts": dict(zip(table.names, table.coefficients.tolist(), strict=True)),
                    "dark_v": table.dark_v.tolist(),
                    "slope_stderr": table.slope_stderr.tolist(),
                    "noise_v": table.noise_v.tolist(),
                },
                "covariance": subject.covariance.tolist(),
            }
        ),
    )


def read_subject(path: str | Path) -> Subject:
    """Read a subject file; raises InputError where it is none, or not complete."""
    return parse_subject(read_text(Path(path), "a subject file that nailoptics calibrate wrote"), name=str(path))


def parse_subject(text: str, *, name: str = "subject") -> Subject:
    """Read a subject from the text of its file."""
    found = parse_toml(text, name)
    try:
        if found["schema_version"] != SCHEMA_VERSION:
            raise InputError(f"{name}: schema_version = {found['schema_version']} is unknown; calibrate again.")
        for place, value in _numbers(found):
            if not np.isfinite(value) and place != "quality.rms_n":
                raise ValueError(f"{place} = {value}")
        subject = _subject(found)
        subject.check()
        return subject
    except (KeyError, TypeError, ValueError, AttributeError, InputError, OverflowError) as error:
        if isinstance(error, InputError) and str(error).startswith(name):
            raise
        raise InputError(f"{name}: is not a valid subject file ({error!r:.80}); calibrate again.") from None


def _numbers(found: Any, place: str = "") -> Iterator[tuple[str, float]]:
    """Every number of some tables with its place in them."""
    if isinstance(found, dict):
        for key, value in found.items():
            yield from _numbers(value, f"{place}.{key}".lstrip("."))
    elif isinstance(found, list | tuple):
        for value in found:
            yield from _numbers(value, place)
    elif isinstance(found, int | float):
        yield place, float(found)


def _subject(found: dict[str, Any]) -> Subject:
    light, scene, noise, quality = (found[name] for name in ("light", "scene", "noise", "quality"))
    names, readings = tuple(light["ln_volts"]), found["readings"]
    if tuple(map(tuple, light["powers"])) != POWERS or list(found["factors"]) != list(NAMES):
        raise ValueError("another version's factors or powers")

    def each(field: str) -> Array:
        return np.array([readings[name][field] for name in names], dtype=float)

    size = len(NAMES) + LINEAR * len(names)
    covariance = np.array(found["covariance"], dtype=float)
    if covariance.shape != (size, size):
        raise ValueError(f"covariance of shape {covariance.shape}")
    table = ReadingTable(
        names=names,
        coefficients=np.array([light["ln_volts"][name] for name in names], dtype=float),
        dark_v=np.array(light["dark_v"], dtype=float),
        most_blood=float(light["most_blood_fraction"]),
        slope_stderr=np.array(light["slope_stderr"], dtype=float),
        noise_v=np.array(light["noise_v"], dtype=float),
        range_v=float(light["range_v"]),
    )
    factors = np.array([found["factors"][name]["value"] for name in NAMES], dtype=float)
    if not (factors > 0).all():
        raise ValueError("a factor that is not above 0")
    return Subject(
        scene_digest=found["scene_digest"],
        model=found["model"],
        table=table,
        base=Parameters(**scene["vessels"]),
        rest_blood=float(scene["rest_blood_fraction"]),
        area_cm2=float(scene["contact_area_cm2"]),
        share=float(scene["proximal_share"]),
        distal_reach=float(scene["distal_reach"]),
        pulp=Pulp(**{name: float(value) for name, value in scene["pulp"].items()}),
        factors_ln=np.log(factors),
        gain=each("gain"),
        offset_v=each("offset_v"),
        covariance=covariance,
        residual_rms_v=each("residual_rms_v"),
        noise=_noise(noise, each("noise_v")),
        correction=_correction(found["correction"]),
        coverage_factor=float(quality["widening"]),
        most_force_n=dict(quality["most_force_n"]),
        chi2_per_dof=float(quality["chi2_per_dof"]),
        rms_n=float(quality["rms_n"]),
        baselines={
            name: Regression(float(one["intercept_n"]), np.array(one["weights_n_per_v"], dtype=float))
            for name, one in ((name, found["baselines"][name]) for name in ("linear", "components"))
        },
    )


def _beat(found: dict[str, Any]) -> CardiacOscillator:
    return CardiacOscillator(float(found["rate_hz"]), tuple(map(float, found["rms_pa"])), float(found["spread"]))


def _noise(found: dict[str, Any], reading_v: Array) -> Noise:
    return Noise(
        reading_v=reading_v,
        drift_per_min=float(found["drift_per_min"]),
        led_drift_per_min=float(found["led_drift_per_min"]),
        beat=_beat(found["beat"]) if found["beat"] else None,
        rhythms=tuple(DampedOscillator(**one) for one in found["rhythms"]),
        touch_rate=float(found["touch_rate_n_per_cm2_rt_s"]),
        moved_error=float(found["moved_error"]),
        held_error=float(found["held_error"]),
    )


def _correction(found: dict[str, dict[str, list[float]]]) -> Correction:
    sides = [found[side] for side in ("proximal", "distal")]
    estimated, applied = (
        np.array([side[name] for side in sides], dtype=float) for name in ("told_n_per_cm2", "pressed_n_per_cm2")
    )
    return Correction(estimated, applied)
