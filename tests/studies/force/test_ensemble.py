"""The ensemble beside the filter: trained on enough touches alone, kept in the subject's file, live as in a file."""

from dataclasses import replace
from functools import cache

import made_sensor
import numpy as np
import pytest
from scipy.signal import lfilter

from nailoptics.scene.importers.sensor_recordings import Recording, recording_csv
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.ensemble import LAGS_S, Features
from nailoptics.studies.force.predict import csv_rows, live, predict
from nailoptics.studies.force.subject import Subject, parse_subject, subject_toml

# Readings of a body that follows a touch more slowly than any vessel of the model. [s]
UNLIKE_S = 0.5


def unlike(recording: Recording) -> Recording:
    """The recording of such a body."""
    keep = np.exp(-made_sensor.STEP_S / UNLIKE_S)
    rest_v = recording.volts[:, :50].mean(1, keepdims=True)
    return replace(recording, volts=rest_v + lfilter([1 - keep], [1, -keep], recording.volts - rest_v, axis=1))


@cache
def subject() -> Subject:
    recording = unlike(made_sensor.record_touches(seed=1))
    text = calibrate_with(made_sensor.scene(), made_sensor.table(), [recording]).attrs["subject"]
    return parse_subject(str(text))


@pytest.mark.long
@pytest.mark.parametrize("site", ["proximal", "distal"])
def test_a_body_that_the_filter_does_not_know_is_estimated_better(site):
    told = predict(subject(), unlike(made_sensor.record(0.9 * made_sensor.touches(), site, seed=7)))
    touched = told.known_force_n.values >= 0.15
    assert told.touch_rms_n.sel(kind="all") < 0.7 * told.attrs["touch_rms_filter_n"]
    inside = (told.force_low_n <= told.known_force_n) & (told.known_force_n <= told.force_high_n)
    assert inside.values[touched].mean() > 0.8
    assert np.median((told.force_high_n - told.force_low_n).values[touched]) < 1.0


def test_errors_are_of_touches_that_were_held_out():
    quality, ensemble = subject().quality, subject().ensemble
    assert ensemble is not None and quality.is_held_out
    assert set(quality.touches) == {"all", *(f"{s} {m}" for s in ("proximal", "distal") for m in ("still", "moving"))}
    assert 0.8 < quality.touches["all"]["coverage_95"] <= 1.0
    assert min(ensemble.weights.values()) >= 0 and ensemble.weights["filter"] == ensemble.filter_weight


def test_few_touches_leave_the_filter_alone():
    alone = parse_subject(made_sensor.subject())
    assert alone.ensemble is None and not alone.quality.is_held_out
    told = predict(alone, made_sensor.record(made_sensor.cycle(0.6), "proximal", seed=2))
    assert np.array_equal(told.force_n, told.force_filter_n)


@pytest.mark.long
def test_a_subject_file_keeps_the_ensemble():
    again = parse_subject(subject_toml(subject()))
    recording = made_sensor.record(made_sensor.cycle(0.6), "distal", seed=2)
    assert np.array_equal(predict(again, recording).force_n, predict(subject(), recording).force_n)
    wrong = replace(subject().ensemble, filter_weight=0.5)
    assert not np.array_equal(
        predict(replace(again, ensemble=wrong), recording).force_n, predict(again, recording).force_n
    )


def test_lines_that_come_one_by_one_are_answered_as_a_file_is():
    recording = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=2)
    recording.volts[0, 50:60] = np.nan
    lines = recording_csv(recording).splitlines(keepends=True)
    written = replace(recording, volts=np.array([[float(f"{v:.7g}") for v in row] for row in recording.volts]))
    assert list(live(subject(), lines)) == list(csv_rows(predict(subject(), written)))


def test_memory_is_of_constant_size_and_forgets():
    features, forces = Features(np.eye(2)), []
    for k in range(5000):
        over_rest = features.over_rest(np.full(2, 0.1 * (k < 100)), False, 0.02)
        forces.append(features.with_memory(over_rest, np.zeros(2), 0.02))
    assert {one.shape for one in forces} == {((1 + len(LAGS_S)) * 4,)}
    assert np.abs(forces[-1][4:]).max() < 1e-9 < np.abs(forces[101][4:]).max()


def test_the_zero_follows_a_slow_drift_at_rest_alone():
    for is_resting, left in ((True, 0.003), (False, 0.1)):
        features = Features(np.eye(1))
        values = [features.over_rest(np.array([k / 500 * 0.1]), is_resting, 2.0) for k in range(501)]
        assert values[-1][0] == pytest.approx(left, abs=0.001)
