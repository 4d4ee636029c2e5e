"""Intervals of the filter's force of people who are the model itself."""

import made_sensor
import numpy as np
import pytest
from force_floor import exactly_calibrated, modelled
from record import SIDES, Site, load_person, steps, touch_of

from nailoptics.hemodynamics.touch import touch_course
from nailoptics.scene.importers.sensor_recordings import SITES, Recording
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.subject import Subject, parse_subject

# Held so that estimates have time to settle. [N]
FORCES_N = (0.5, 0.2, 0.8)


@pytest.fixture(scope="module")
def subject() -> Subject:
    return parse_subject(made_sensor.subject())


@pytest.mark.long
@pytest.mark.parametrize("side", SIDES)
def test_intervals_cover_held_touches_of_the_model_itself(subject: Subject, side: Site) -> None:
    """Rationale: people who are the model itself, with a body's pulse, breath, slow waves and drift.

    Expected: 95 % intervals cover 85 to 99.5 % of touched samples, as some 30 s hold few independent ones.
    """
    person = load_person("person_8")
    person = person.model_copy(update={"touch": touch_of(person, steps(FORCES_N), side, rate_hz=25.0)})
    time_s = person.touch.times_s()
    course = touch_course(person.touch)
    force_n = np.interp(time_s, course.time_s, course.force_n)
    touch = Recording(
        "made", subject.light.names, time_s, np.zeros((8, time_s.size)), force_n, np.full(time_s.shape, SITES[side])
    )
    covered = []
    for seed in (1, 2):
        estimated = predict(exactly_calibrated(subject, person), modelled(subject, person, touch, seed=seed))
        inside = (estimated.force_low_n.values <= force_n) & (force_n <= estimated.force_high_n.values)
        covered.append(inside[force_n > 0.05])
    assert 0.85 < np.mean(np.concatenate(covered)) < 0.995
