"""Virtual people, calibrated and read: how well their force is estimated, for the benchmark and the tests of it."""

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import record
from numpy.typing import NDArray

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.for_scene import steady_blood
from nailoptics.io import write_text
from nailoptics.light import DetectedLight
from nailoptics.scene import Scene, digest
from nailoptics.scene.importers.sensor_recordings import Recording, read_sensor_recording, recording_csv
from nailoptics.studies import force
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.interval import ForceEstimator
from nailoptics.studies.force.kalman import KalmanFilter, stacked
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.reading_table import ReadingTable
from nailoptics.studies.force.scores import TOUCH_N
from nailoptics.studies.force.subject import Subject

KINDS = ("slow", "steps")
# Where people touch: on either side, of which they are calibrated, and on both at once, of which they are not.
SITES: tuple[record.Site, ...] = (*record.SIDES, "even")
# What people are calibrated on: the protocol, or slow cycles and quick steps.
CALIBRATIONS = {"protocol": ("protocol",), "cycles": ("calibration", "quick")}
# Touches up to here are what the goals of rms are for; the last slow cycle is for closure. [N]
MOST_N = 1.0
# A reading past which less than this part of its change is left is past closure; searched up to MOST_SEARCHED_N.
LEFT_AT_CLOSURE, MOST_SEARCHED_N = 0.05, 4.0
# An interval that covers so much covers.
COVERED = 0.9
# Pairs of people are read with no more samples a second than this. [Hz]
PAIR_RATE_HZ = 25.0


def _updated(part: Any, **fields: Any) -> dict[str, Any]:
    return {type(part).__name__.lower(): part.model_copy(update=fields)}


PROTOTYPE = data_dir("scenes") / "prototype.toml"
# In what people differ from the model that is fitted, and how each difference is taken away: the fields of the scene.
DIFFERENCES: dict[str, Callable[[Scene, Scene], dict[str, Any]]] = {
    "zones": lambda one, usual: _updated(one.blood, zones=None, decay_length=None),
    "vessels": lambda one, usual: _updated(one.blood, tuning=None),
    "optics": lambda one, usual: {
        "finger": usual.finger,
        "board": usual.board,
        "light": usual.light,
        "leds": usual.leds,
    },
    "creep": lambda one, usual: _updated(one.touch, creep=None, distal_relaxation_s=None),
    "heartbeat": lambda one, usual: _updated(one.body, heartbeat=None),
    "breathing": lambda one, usual: _updated(one.body, breathing=None),
    "vasomotion": lambda one, usual: _updated(one.body, vasomotion=None),
    "rhythms": lambda one, usual: _updated(one.body, heartbeat=None, breathing=None, vasomotion=None),
    "drift": lambda one, usual: _updated(one.body, drift=None),
}


@dataclass(frozen=True)
class Score:
    """How well one person's touches of one kind on one side were estimated.

    rms_n : over touches; filter_n, cubic_n, components_n, sigmoid_n : of the filter alone and of the baselines. [N]
    covered : part of the touches' samples below closure that the interval covers.
    half_width_n : median of the interval over these. [N] open : part of these whose interval has no upper bound.
    open_above : part of samples above closure whose interval is open; NaN where there are none.
    consistent : whether the readings are consistent with the person's own calibration.
    """

    person: str
    site: str
    kind: str
    rms_n: float
    filter_n: float
    cubic_n: float
    components_n: float
    sigmoid_n: float
    covered: float
    half_width_n: float
    open: float
    open_above: float
    consistent: bool


@dataclass(frozen=True)
class VirtualPerson:
    """One person, with a folder where traced light and recordings are kept."""

    name: str
    scene: Scene
    folder: Path
    model: Literal["massless", "inertial"] = "inertial"
    rate_hz: float = record.SAMPLE_RATE_HZ
    photons: int = record.PHOTONS

    @cached_property
    def light(self) -> DetectedLight:
        """The light under the nail, traced unless it was before."""
        return record.light_of_person(self.scene, self.folder / f"{self.name}.transfer", photons=self.photons)

    def recording(self, kind: str, site: record.Site, *, seed: int = 0) -> Recording:
        """What the sensor reads under some touches, made unless it was before."""
        # A person who was changed is recorded again.
        made_of = f"{digest(self.scene)} {self.photons} {self.model}"
        own = hashlib.sha256(made_of.encode()).hexdigest()[:8]
        path = self.folder / f"{self.name}_{kind}_{site}_{seed}_{self.rate_hz:g}hz_{own}.csv"
        if not path.exists():
            options: dict[str, Any] = {"seed": seed, "model": self.model, "rate_hz": self.rate_hz}
            write_text(path, recording_csv(record.record_person(self.scene, self.light, kind, site, **options)))
        return read_sensor_recording(path)

    def closure_n(self, site: record.Site) -> float:
        """The force past which readings stay as they are, were it held. [N]"""
        force_n = np.linspace(0.0, MOST_SEARCHED_N, 201)
        touched = self.scene.model_copy(update={"touch": record.touch_of(self.scene, record.TOUCHES["slow"], site)})
        readings = np.log(self.light.readings_at(steady_blood(touched, force_n)).fraction).reshape(-1, force_n.size)
        left = np.linalg.norm(readings - readings[:, -1:], axis=0)
        return float(force_n[np.flatnonzero(left > LEFT_AT_CLOSURE * left[0])[-1]])


def virtual_person(name: str, folder: Path, *, without: str | None = None, **options: Any) -> VirtualPerson:
    """A person by name.

    without : one of `DIFFERENCES`, in which the person is then as the model that is fitted.
    options : further fields of `VirtualPerson`.
    """
    scene, own = record.load_person(name), name
    if without is not None:
        scene = scene.model_copy(update=DIFFERENCES[without](scene, load_scene(PROTOTYPE)))
        own = f"{name}_without_{without}"
    return VirtualPerson(own, scene, folder, **options)


def calibrated(
    person: VirtualPerson,
    scene: Scene,
    table: ReadingTable,
    *,
    kinds: tuple[str, ...],
) -> str:
    """The file of a person's sensor, calibrated on some kinds of touches; on either side, but for the protocol."""
    return str(calibrate_with(scene, table, recordings_of(person, kinds)).attrs["subject"])


def recordings_of(person: VirtualPerson, kinds: tuple[str, ...]) -> list[Recording]:
    """A person's recordings for a calibration."""
    sides = {kind: record.SIDES[: 1 if kind == "protocol" else 2] for kind in kinds}
    return [person.recording(kind, site) for kind in kinds for site in sides[kind]]


def required_samples(kind: str, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which samples of some touches are scored: the last of the slow cycles goes beyond what is required."""
    last = record.REST_S + record.PERIOD_S * np.flatnonzero(np.array(record.SLOW_N) > MOST_N)[0]
    return np.asarray(time_s < last) if kind == "slow" else np.ones(time_s.shape, bool)


def score(subject: Subject, person: VirtualPerson, kind: str, site: record.Site) -> Score:
    """How well held-out touches are estimated."""
    recording = person.recording(kind, site, seed=1)
    estimated = predict(subject, recording)
    force_n, closure_n = estimated.known_force_n.values, person.closure_n(site)
    requested = required_samples(kind, estimated.time.values) & (force_n >= TOUCH_N)
    below, above = requested & (force_n < closure_n), force_n > closure_n
    inside = (estimated.force_low_n.values <= force_n) & (force_n <= estimated.force_high_n.values)
    is_open = np.isinf(estimated.force_high_n.values)
    half_n = 0.5 * (estimated.force_high_n.values - estimated.force_low_n.values)
    names = ("force_n", *(f"force_{name}_n" for name in ("filter", "cubic", "components", "sigmoid")))
    return Score(
        person.name,
        site,
        kind,
        *(float(np.sqrt(np.nanmean((estimated[name].values - force_n)[requested] ** 2))) for name in names),
        covered=float(inside[below].mean()),
        half_width_n=float(np.median(half_n[below])),
        open=float(is_open[below].mean()),
        open_above=float(is_open[above].mean()) if above.any() else float("nan"),
        consistent=bool(estimated.attrs["consistent"]),
    )


def pair(subject: Subject, recording: Recording) -> str:
    """How a recording fares with a calibration: flagged, covers, or is estimated wrongly and with confidence."""
    estimated = predict(subject, thinned(recording, PAIR_RATE_HZ))
    if not estimated.attrs["consistent"]:
        return "flagged"
    return "covers" if estimated.attrs["coverage_95"] >= COVERED else "WRONG"


def thinned(recording: Recording, rate_hz: float) -> Recording:
    """Every so-manieth sample of a recording, so that no more than so many are left in a second."""
    stride = max(1, round(1.0 / (rate_hz * float(np.median(np.diff(recording.time_s))))))
    return recording.select(slice(None, None, stride))


def presses_at_rest(subject: Subject, person: VirtualPerson, rest_s: float) -> int:
    """Presses of the virtual switch without a touch."""
    corners = (np.array([0.0, rest_s]), np.zeros(2))
    untouched = record.touch_of(person.scene, corners, "proximal", rate_hz=person.rate_hz)
    still = record.record_touch(person.scene, person.light, untouched, seed=77)
    return sum(str(kind) == "press" for kind in predict(subject, still).event_kind.values)


def seconds_per_sample(subject: Subject, recording: Recording) -> float:
    """Median processor time of one sample, read alone. [s]"""
    observer, estimator, spent = KalmanFilter(subject), ForceEstimator(subject), []
    for k, volts in enumerate(recording.volts.T[:500]):
        begin = time.process_time()
        estimate = observer.update_sample(volts, 0.01 if k else None)
        estimator.estimate(stacked([estimate]), volts[:, None], np.array([0.01]))
        spent.append(time.process_time() - begin)
    return float(np.median(spent))


def code_of_force() -> str:
    """A few characters that change with the code that estimates force, so that no result of other code is reused."""
    sources = sorted(Path(force.__file__).parent.glob("*.py"))
    made = b"".join(path.read_bytes() for path in [*sources, Path(__file__)])
    return hashlib.sha256(made).hexdigest()[:8]


def kept(path: Path, find: Callable[[], Any]) -> Any:
    """What a file holds in JSON, computed and written unless it is there."""
    if not path.exists():
        result = find()
        write_text(path, json.dumps(asdict(result) if isinstance(result, Score) else result))
    return json.loads(path.read_text(encoding="utf-8"))
