"""A sensor that is taken off and put on again: the protocol, what is recorded, what a calibration learns of it."""

from dataclasses import replace

import made_sensor
import numpy as np
import pytest
from scipy.linalg import hadamard

from nailoptics import load_scene
from nailoptics.errors import InputError
from nailoptics.hemodynamics.parameters import parameters
from nailoptics.scene import Touch
from nailoptics.scene.body import Body, Drift
from nailoptics.scene.importers.sensor_recordings import Recording
from nailoptics.scene.protocol import FIRST_REST_S, OFF_S, protocol
from nailoptics.sensor.volts import drift_and_motion
from nailoptics.studies.force.calibrate import calibrate_with, checked
from nailoptics.studies.force.fit import Fit
from nailoptics.studies.force.kalman import StateSpace
from nailoptics.studies.force.person import NAMES
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.subject import Subject, parse_subject

# Standard deviation of the readings' gains from one time to the next.
SPREAD = 0.05


def gains(readings: int, pattern: int) -> np.ndarray:
    """Gains whose logarithms are all of this size, with the signs of a Hadamard matrix's row: the error of a touch by
    them depends on how similar they are to what blood does, for random ones by a factor of ten."""
    return np.exp(SPREAD * hadamard(readings)[pattern])


def put_on(recording: Recording, pattern: int) -> Recording:
    """What the sensor reads of the same after another donning."""
    return replace(recording, volts=recording.volts * gains(len(recording.names), pattern)[:, None])


def next_from_mean(gain: np.ndarray) -> float:
    """Of gains of two times, whose first are 1: the spread of a next one from their mean, 1 + 1/2 of their variance."""
    return float(np.sqrt(1.5 * 2.0 * np.mean(((gain - 1.0) / (gain + 1.0)) ** 2)))


def twice() -> Recording:
    """A recording with a pause in which the sensor was donned again."""
    first, second = made_sensor.record_touches(seed=4), put_on(made_sensor.record_touches(seed=5), 1)
    time_s = np.concatenate([first.time_s, first.time_s[-1] + 40.0 + second.time_s])
    force_n, site = (np.concatenate([getattr(one, name) for one in (first, second)]) for name in ("force_n", "site"))
    return Recording("made", first.names, time_s, np.hstack([first.volts, second.volts]), force_n, site)


def calibrated(recording: Recording) -> Subject:
    own = made_sensor.scene()
    result = calibrate_with(own, made_sensor.table(), checked([recording], own))
    return parse_subject(result.attrs["subject"])


def every_other(recording: Recording) -> Recording:
    """The recording at 25 Hz."""
    return recording.select(np.arange(0, len(recording.time_s), 2))


def slowly_recorded(seed: int) -> Recording:
    return every_other(made_sensor.record_touches(seed=seed))


@pytest.mark.long
def test_a_calibration_estimates_how_readings_differ_between_donnings() -> None:
    once, subject = calibrated(slowly_recorded(4)), calibrated(every_other(twice()))
    assert once.noise.donning == 0.0 and subject.noise.donning == pytest.approx(next_from_mean(gains(8, 1)), rel=0.2)
    # What an estimate begins from is as uncertain in every reading, and nowhere else.
    still = replace(subject, noise=replace(subject.noise, donning=0.0))
    begins = [StateSpace(one) for one in (subject, still)]
    more = np.diag([0.0] * begins[0].drift.start + [subject.noise.donning**2] * 8)
    assert begins[0].initial()[1] - begins[1].initial()[1] == pytest.approx(more, rel=1e-6, abs=1e-12)
    # Every other reading, every other two, and the first four against the last, as where blood shifts between zones.
    redonned = [put_on(slowly_recorded(9 + pattern), pattern) for pattern in (1, 2, 4)]
    results = [predict(subject, one) for one in redonned]
    assert all(result.attrs["consistent"] for result in results)
    assert max(float(result.touch_rms_n[0]) for result in results) < 0.06
    assert np.mean([float(result.touch_coverage_95[0]) for result in results]) > 0.8
    # A calibration without it mistakes the other gains for touches, and reports a misfit: the rms errors
    # are 0.04, 0.07 and 0.18 N, and 0.01, 0.03 and 0.05 N by the calibration with it, whatever the noise.
    without_donnings = [predict(once, one) for one in redonned]
    assert not any(result.attrs["consistent"] for result in without_donnings)
    off, known = (
        np.sqrt(np.mean([float(one.touch_rms_n[0]) ** 2 for one in some])) for some in (without_donnings, results)
    )
    assert off > max(0.1, 3 * known)


def test_two_files_are_two_donnings() -> None:
    """Expected: gains that differ between them, by as much as they do, and hardly any residuals."""
    first, second = slowly_recorded(4), put_on(slowly_recorded(5), 1)
    finger = made_sensor.nominal_finger(parameters(made_sensor.scene().blood.parameters))
    fit = Fit([first, second], made_sensor.table(), finger, free=np.isin(NAMES, ["rest_blood"]))
    fitted = fit.solve()
    assert fitted.donning == pytest.approx(next_from_mean(gains(8, 1)), rel=0.01)
    assert np.std(np.hstack(fitted.residual_v)) < 1e-3


def test_a_pause_in_which_the_sensor_may_be_off_splits_a_recording() -> None:
    own, recording = made_sensor.scene(), twice()
    parts = checked([recording], own)
    assert [part.name for part in parts] == ["made from time_s = 0 on", "made from time_s = 71.98 on"]
    assert np.array_equal(np.hstack([part.volts for part in parts]), recording.volts)
    # Within a touch the sensor was on.
    split, touched = len(parts[0].time_s), replace(recording, force_n=np.asarray(recording.force_n).copy())
    touched.force_n[split - 3 : split + 3] = 0.5  # type: ignore[index]
    assert len(checked([touched], own)) == 1
    late = recording.select(np.flatnonzero((recording.time_s < 40) | (recording.time_s > 71.98 + 1.5)))
    with pytest.raises(
        InputError, match=r"made from time_s = 73.5 on: .* for 0.5 s before the first touch; begin with"
    ):
        checked([late], own)


def test_the_protocol_touches_both_sides_each_time_and_rests_before() -> None:
    drawn, once = protocol(3, donnings=2), protocol(3)
    touch = Touch(profile="protocol", protocol_seed=3, protocol_donnings=2)
    time_s = touch.times_s()
    off = touch.is_off(time_s)
    (start, stop), before = np.flatnonzero(np.diff(off)), np.diff(drawn.time_s)
    assert off.sum() == pytest.approx(100 * OFF_S, abs=1) and OFF_S in before.round(9)
    force_n, share = (np.interp(time_s, drawn.time_s, column) for column in drawn[1:])
    assert not force_n[off].any() and not force_n[stop : stop + round(99 * FIRST_REST_S)].any()
    for part in (slice(start), slice(stop, None)):
        assert {*np.round(share[part][force_n[part] > 0])} == {0.0, 1.0}
    assert force_n[:start].max() < 1.5 < force_n[stop:].max()
    assert not Touch(profile="protocol").is_off(once.time_s).any()
    for wrong in (0, 5, 1.5):
        with pytest.raises(InputError, match="a whole number from 1 to 4"):
            protocol(donnings=wrong)  # type: ignore[arg-type]


def test_readings_of_a_simulated_sensor_change_between_donnings(tmp_path) -> None:  # type: ignore[no-untyped-def]
    touch = Touch(profile="protocol", protocol_donnings=2, sample_rate_hz=20.0)
    still = Drift(led_per_rt_min=0.0, reading_per_rt_min=0.0, donning=SPREAD)
    scene = load_scene("prototype").model_copy(update={"touch": touch, "body": Body(drift=still)})
    time_s, factor = touch.times_s(), np.empty((40, 8, len(touch.times_s())))
    for seed, course in enumerate(factor):
        worn = scene.model_copy(update={"body": Body(drift=still, seed=seed)})
        course[:] = drift_and_motion(worn, time_s).reading_drift.values[0]
    assert (factor[..., 0] == 1.0).all() and ((np.diff(factor[0], axis=1) != 0).sum(1) == 1).all()
    assert len(np.unique(factor[..., -1])) == 320
    # They estimate a standard deviation to 4 %.
    assert np.log(factor[..., -1]).std() == pytest.approx(SPREAD, rel=0.15)
    # The rows of the file to follow leave the pause out.
    protocol(donnings=2).save(tmp_path / "protocol.csv", sample_rate_hz=20.0)
    written_s = np.loadtxt(tmp_path / "protocol.csv", delimiter=",", skiprows=1)[:, 0]
    assert np.diff(written_s).max() == pytest.approx(OFF_S, abs=0.1)
