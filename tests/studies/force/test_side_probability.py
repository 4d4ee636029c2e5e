"""The probability that a touch is of the proximal side, of the distal one, or of both."""

from dataclasses import replace
from functools import cache

import made_sensor
import numpy as np
import pytest

from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.interval import BOTH_SHARES, ForceInterval, _site_probabilities
from nailoptics.studies.force.kalman import PressureEstimate
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.subject import Subject, parse_subject, subject_toml


def test_stated_probabilities_are_calibrated() -> None:
    """Expected: of shares that were drawn as stated, the sides' frequencies are the stated probabilities."""
    rng, count, error = np.random.default_rng(1), 200_000, np.array([0.15, 0.3])
    site = rng.integers(3, size=count)
    true = np.select([site == 0, site == 1], [1.0, 0.0], rng.uniform(*BOTH_SHARES, count))
    of_both = np.sqrt((error**2).mean())
    share = true + np.array([*error, of_both])[site] * rng.normal(size=count)
    stated = _site_probabilities(share, error)
    assert stated.sum(0) == pytest.approx(np.ones(count))
    for k in range(3):
        for low in np.arange(0.0, 1.0, 0.1):
            within = (stated[k] >= low) & (stated[k] < low + 0.1)
            if within.sum() > 1000:
                assert (site == k)[within].mean() == pytest.approx(stated[k][within].mean(), abs=0.02)


@cache
def subject() -> Subject:
    recording = made_sensor.record_touches(seed=1)
    return parse_subject(str(calibrate_with(made_sensor.scene(), made_sensor.table(), [recording]).attrs["subject"]))


@pytest.mark.long
@pytest.mark.parametrize("site", ["proximal", "distal", "even"])
def test_the_side_of_a_touch_is_the_likeliest(site: str) -> None:
    estimated = predict(subject(), made_sensor.record(0.9 * made_sensor.touches(), site, seed=7))
    names = [f"probability_{name}" for name in ("proximal", "distal", "both")]
    probabilities = np.stack([estimated[name].values for name in names])
    assert probabilities.sum(0) == pytest.approx(np.ones(estimated.sizes["time"]))
    likeliest = names[int(np.argmax(probabilities[:, estimated.known_force_n.values >= 0.3].mean(1)))]
    assert likeliest == f"probability_{'both' if site == 'even' else site}"
    # Where nothing touches, no side is more probable than another.
    assert probabilities[:, :50].mean(1) == pytest.approx(np.full(3, 1 / 3), abs=0.01)


@pytest.mark.long
def test_touches_of_both_sides_are_estimated_though_none_was_calibrated() -> None:
    """Expected: a tenth of the largest force, where members of one-sided touches alone have errors of two thirds."""
    recording = made_sensor.record(0.9 * made_sensor.touches(), "even", seed=7)
    estimated, known_n = predict(subject(), recording), np.asarray(recording.force_n)
    touched = known_n >= 0.15
    inside = (estimated.force_low_n.values <= known_n) & (known_n <= estimated.force_high_n.values)
    assert estimated.touch_rms_n.sel(kind="all") < 0.1 * known_n.max() and inside[touched].mean() > 0.8


def test_at_rest_the_share_does_not_follow_the_noise() -> None:
    """Expected: pressures that are small beside their errors leave the share near the middle, whichever is larger."""
    least = np.array([[0.01, -0.02], [-0.02, 0.01]])
    rest = PressureEstimate(least, np.full((2, 1, 1), 0.01) * np.eye(2), *np.zeros((3, 2)), *np.ones((2, 2), bool))
    share = ForceInterval(subject()).estimate(rest).proximal_share
    assert ((share > 0.2) & (share < 0.8)).all() and abs(share[0] - share[1]) < 0.3


def test_the_share_is_within_its_interval_and_without_an_ensemble_no_side_is_likelier() -> None:
    recording = made_sensor.record(0.9 * made_sensor.touches(), "distal", seed=7)
    touched, error = np.asarray(recording.force_n) >= 0.3, subject().ensemble.share_error
    known = predict(subject(), recording)
    assert parse_subject(subject_toml(subject())).ensemble.share_error == pytest.approx(error)
    assert error.max() < 0.2 and np.abs(known.proximal_share.values[touched]).mean() < 2.0 * max(error[1], 0.05)
    inside = (known.proximal_share_low <= 0.0).values[touched]
    assert inside.mean() > 0.8
    alone = predict(replace(subject(), ensemble=None), recording)
    assert np.isnan(alone.probability_both.values[touched]).all() and np.isfinite(alone.force_n).all()
