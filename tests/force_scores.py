"""Virtual people, calibrated and read: how well their force is told, for the benchmark and the tests of it."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.light import DetectedLight
from nailoptics.scene import Scene
from nailoptics.scene.sensor_recordings import Recording
from nailoptics.studies.blood_states import steady_blood
from nailoptics.studies.force import virtual_people as record
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.observer import Observer
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.reading_table import ReadingTable
from nailoptics.studies.force.subject import Subject, parse_subject
from nailoptics.studies.force.virtual_recording import record_touch

KINDS = ("slow", "steps")
# Touches up to here are what rms is asked of; the last slow cycle is for closure. [N]
MOST_N = 1.0
# A reading past which less than this part of its change is left is past closure; looked for up to MOST_SEARCHED_N.
LEFT_AT_CLOSURE, MOST_SEARCHED_N = 0.05, 4.0
# Of pairs of people every so-manieth sample is read.
PAIR_STRIDE = 4
# An interval that covers so much covers.
COVERED = 0.9


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
    "rhythms": lambda one, usual: _updated(one.body, heartbeat=None, breathing=None, vasomotion=None),
    "drift": lambda one, usual: _updated(one.body, drift=None),
}


@dataclass(frozen=True)
class Score:
    """How well one person's touches of one kind on one side were told.

    rms_n, linear_n, components_n : of the filter and of the regressions. [N]
    covered : part of samples below closure that the interval covers.
    open_above : part of samples above closure whose interval is open; NaN where there are none.
    """

    person: str
    site: str
    kind: str
    rms_n: float
    linear_n: float
    components_n: float
    covered: float
    open_above: float

    @property
    def row(self) -> tuple[float, ...]:
        return self.rms_n, self.linear_n, self.components_n, self.covered, self.open_above


@dataclass(frozen=True)
class VirtualPerson:
    """One person with the light that is traced under the nail, and what is recorded so far."""

    name: str
    scene: Scene
    light: DetectedLight
    model: str

    def recording(self, kind: str, site: str, *, seed: int = 0) -> Recording:
        return record.record_person(self.scene, self.light, kind, site, seed=seed, model=self.model)

    def closure_n(self, site: str) -> float:
        """The force past which readings stay as they are, were it held. [N]"""
        force_n = np.linspace(0.0, MOST_SEARCHED_N, 201)
        touched = self.scene.model_copy(update={"touch": record.touch_of(self.scene, record.TOUCHES["slow"], site)})
        readings = np.log(self.light.over(steady_blood(touched, force_n)).fraction).reshape(-1, force_n.size)
        left = np.linalg.norm(readings - readings[:, -1:], axis=0)
        return float(force_n[np.flatnonzero(left > LEFT_AT_CLOSURE * left[0])[-1]])


def virtual_person(
    name: str, keep: Path, model: str = "inertial", *, without: str | None = None, photons: int = record.PHOTONS
) -> VirtualPerson:
    """A person by name, whose light is kept in a folder.

    without : one of `DIFFERENCES`, in which the person is then as the model that is fitted.
    """
    scene, kept = record.load_person(name), name
    if without is not None:
        scene = scene.model_copy(update=DIFFERENCES[without](scene, load_scene(PROTOTYPE)))
        kept = f"{name}_{without}"
    light = record.light_of_person(scene, keep / f"{kept}.transfer", photons=photons)
    return VirtualPerson(name, scene, light, model)


def calibrated(person: VirtualPerson, scene: Scene, table: ReadingTable) -> Subject:
    """A person's sensor, calibrated on slow cycles on either side."""
    recordings = [person.recording("calibration", site) for site in record.SIDES]
    return parse_subject(calibrate_with(scene, table, recordings).attrs["subject"])


def score(subject: Subject, person: VirtualPerson, kind: str, site: str) -> Score:
    """How well touches are told that the calibration has not seen."""
    recording = person.recording(kind, site, seed=1)
    told = predict(subject, recording)
    force_n, closure_n = told.known_force_n.values, person.closure_n(site)
    # The last of the slow cycles goes beyond the touches that are judged.
    last = record.REST_S + record.PERIOD_S * np.flatnonzero(np.array(record.SLOW_N) > MOST_N)[0]
    asked = told.time.values < last if kind == "slow" else np.ones(force_n.shape, bool)
    below, above = asked & (force_n < closure_n), force_n > closure_n
    inside = (told.force_low_n.values <= force_n) & (force_n <= told.force_high_n.values)
    is_open = np.isinf(told.force_high_n.values)
    names = ("force_n", "force_linear_n", "force_components_n")
    errors = [np.sqrt(np.nanmean((told[name].values - force_n)[asked] ** 2)) for name in names]
    covered = float(inside[below].mean())
    return Score(person.name, site, kind, *errors, covered, float(is_open[above].mean()) if above.any() else np.nan)


def pair(subject: Subject, recording: Recording) -> str:
    """How a recording fares with a calibration: flagged, covers, or is told wrongly and with confidence."""
    told = predict(subject, recording)
    if not told.attrs["consistent"]:
        return "flagged"
    return "covers" if told.attrs["coverage_95"] >= COVERED else "WRONG"


def thinned(recording: Recording, stride: int) -> Recording:
    """Every so-manieth sample of a recording."""
    take = slice(None, None, stride)
    force_n, site = (None if one is None else one[take] for one in (recording.force_n, recording.site))
    return replace(recording, time_s=recording.time_s[take], volts=recording.volts[:, take], force_n=force_n, site=site)


def presses_at_rest(subject: Subject, person: VirtualPerson, rest_s: float) -> int:
    """Presses that the virtual switch tells while nobody touches, from ten samples a second."""
    untouched = record.touch_of(person.scene, (np.array([0.0, rest_s]), np.zeros(2)), "proximal", rate_hz=10.0)
    still = record_touch(person.scene, person.light, untouched, seed=77)
    return sum(str(kind) == "press" for kind in predict(subject, still).event_kind.values)


def seconds_per_sample(subject: Subject, recording: Recording) -> float:
    """Median processor time of one sample, read alone. [s]"""
    observer, spent = Observer(subject.calibrated, subject.noise), []
    for k, volts in enumerate(recording.volts.T[:500]):
        begin = time.process_time()
        observer.see(volts, 0.01 if k else None)
        spent.append(time.process_time() - begin)
    return float(np.median(spent))
