"""A virtual person calibrated and read as a user would: what the benchmark of force prints of eight, held for one."""

import numpy as np
import pytest
from force_scores import PROTOTYPE
from record import SIDES, TOUCHES, Corners, Site, load_person, record_touch, slow_cycles, touch_of
from untraced_light import untraced, untraced_table

from nailoptics import load_scene
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.fit import joined
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.scores import rms
from nailoptics.studies.force.subject import Subject, parse_subject

PERSON = "person_4"


def recording(corners: Corners, side: Site, seed: int):
    person = load_person(PERSON)
    return record_touch(person, untraced(person), touch_of(person, corners, side, rate_hz=20.0), seed=seed)


def calibration():
    """Slow touches past closure, one a side."""
    return [recording(slow_cycles((2.0,)), side, seed) for seed, side in enumerate(SIDES)]


@pytest.fixture(scope="module")
def subject() -> Subject:
    """A person of eight zones, other vessels, creep, pulse and drift, calibrated with the prototype's model."""
    scene = load_scene(PROTOTYPE)
    return parse_subject(calibrate_with(scene, untraced_table(scene), calibration()).attrs["subject"])


def linear_regression_n(read) -> np.ndarray:
    """Force by least squares on the volts of all of the calibration, (T,) float. [N]"""
    known = joined(calibration())
    weights = np.linalg.lstsq(np.vstack([known.volts, np.ones_like(known.force_n)]).T, known.force_n, rcond=None)[0]
    return np.maximum(weights @ np.vstack([read.volts, np.ones_like(read.force_n)]), 0.0)


# Measured: 0.08 N on the proximal and 0.09 N on the distal side, where linear regression reaches 0.12 N; 92 and 94 %
# covered.
@pytest.mark.slow
@pytest.mark.parametrize(("side", "times_better"), [("proximal", 1.8), ("distal", 1.2)])
def test_steps_of_an_unmodelled_person_beat_linear_regression(subject, side, times_better):
    read = recording(TOUCHES["steps"], side, 7)
    estimated = predict(subject, read)
    inside = (estimated.force_low_n <= estimated.known_force_n) & (estimated.known_force_n <= estimated.force_high_n)
    assert estimated.attrs["rms_n"] < 0.12
    assert times_better * estimated.attrs["rms_n"] < rms(linear_regression_n(read) - read.force_n)
    assert estimated.touch_rms_n.sel(kind="all") < estimated.attrs["touch_rms_components_n"]
    assert float(inside.mean()) > 0.85
