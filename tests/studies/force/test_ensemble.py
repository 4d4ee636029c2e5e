"""The ensemble beside the filter: trained on enough touches alone, kept in the subject's file, live as in a file."""

from dataclasses import replace
from functools import cache

import made_sensor
import numpy as np
import pytest
from scipy.signal import lfilter

from nailoptics.scene.importers.sensor_recordings import Recording, recording_csv
from nailoptics.studies.force import training
from nailoptics.studies.force.body_noise import REST_FORCE_N
from nailoptics.studies.force.calibrate import calibrate_with
from nailoptics.studies.force.ensemble import LAGS_S, MISSING_S, ZERO_S, Features, mixed
from nailoptics.studies.force.fit import averaged
from nailoptics.studies.force.person import LONGEST_GAP_S
from nailoptics.studies.force.predict import csv_rows, live, predict
from nailoptics.studies.force.scores import touches_by_kind
from nailoptics.studies.force.subject import Subject, parse_subject, subject_toml
from nailoptics.studies.force.training import AFTER_S, RATE_HZ, TOP_N, calibration_series, train

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


# Errors of this body's proximal side, whose vessels fill and empty, are twice those of the distal one.
@pytest.mark.long
@pytest.mark.parametrize(("site", "width_n"), [("proximal", 0.95), ("distal", 0.6)])
def test_the_ensemble_estimates_an_unmodelled_body_better_than_the_filter(site, width_n):
    estimated = predict(subject(), unlike(made_sensor.record(0.9 * made_sensor.touches(), site, seed=7)))
    touched = estimated.known_force_n.values >= 0.15
    assert estimated.touch_rms_n.sel(kind="all") < 0.7 * estimated.attrs["touch_rms_filter_n"]
    inside = (estimated.force_low_n <= estimated.known_force_n) & (estimated.known_force_n <= estimated.force_high_n)
    assert inside.values[touched].mean() > 0.8
    assert np.median((estimated.force_high_n - estimated.force_low_n).values[touched]) < width_n


@pytest.mark.long
def test_a_calibrations_zero_is_that_of_recorded_rest():
    recording = unlike(made_sensor.record_touches(seed=1))
    series, read = calibration_series(subject(), [recording]), averaged(recording, RATE_HZ)
    rests = read.force_n < REST_FORCE_N
    assert (rests != (series.by_filter.force_n < REST_FORCE_N)).any()
    since_s, known = np.diff(read.time_s, prepend=read.time_s[0]), Features(np.empty((0, len(read.volts))))
    assert series.over_rest == pytest.approx(known.over_rest(read.volts, rests, since_s))


@pytest.mark.long
def test_errors_are_those_of_held_out_touches():
    quality, ensemble = subject().quality, subject().ensemble
    assert ensemble is not None
    assert set(quality.touches) == {"all", *(f"{s} {m}" for s in ("proximal", "distal") for m in ("still", "moving"))}
    assert 0.8 < quality.touches["all"]["coverage_95"] <= 1.0
    assert min(both.min() for both in ensemble.weights.values()) >= 0
    assert [*ensemble.weights] == ["filter", "quadratic", "kernel", "cubic"]
    members_n = [error_n for name, error_n in ensemble.errors_n.items() if name != "ensemble"]
    # Weights that are drawn towards the filter cost little even where the filter is wrong.
    assert ensemble.errors_n["ensemble"] < 1.01 * min(members_n)
    assert ensemble.errors_n["ensemble"] < 0.6 * ensemble.errors_n["filter"]
    # Half of the 0.293 N error of a filter that mistakes a part of the pressure's waves for light.
    assert ensemble.errors_n["ensemble"] < 0.146


def test_after_a_hard_touch_a_second_is_left_out_at_any_rate():
    force_n = 1.2 * np.tile(made_sensor.touches(), 4)
    recording = made_sensor.record(force_n, np.repeat([1.0, 0.0], force_n.size // 2), seed=1)
    for every in (2, 4):
        read = recording.select(slice(None, None, every))
        series, hard = calibration_series(subject(), [read]), read.force_n > TOP_N
        (end, *_), out_s = read.time_s[:-1][hard[:-1] & ~hard[1:]], read.time_s[~series.is_varied]
        begin = read.time_s[np.argmax(hard)]
        rested = read.time_s[(read.time_s > end) & (read.force_n < REST_FORCE_N)][0]
        first = out_s[out_s < rested + 2.0]
        after_s, step_s = first[-1] - rested, every * made_sensor.STEP_S
        assert first[0] == begin and AFTER_S - 2.0 * step_s < after_s < AFTER_S - step_s + 1e-6


def test_touches_of_both_sides_are_of_neither():
    force_n, site = np.ones(3), np.array([1.0, 0.0, np.nan])
    estimated_n, still = np.array([1.1, 0.7, 0.5]), np.ones(3, bool)
    kinds = touches_by_kind(force_n, estimated_n, (estimated_n, estimated_n), site, still)
    assert kinds["distal still"]["rms_n"] == pytest.approx(0.3) and kinds["proximal still"]["rms_n"] == pytest.approx(
        0.1
    )
    assert kinds["all"]["rms_n"] == pytest.approx(np.sqrt(0.35 / 3))


def test_few_touches_give_the_filter_without_an_ensemble():
    alone = parse_subject(made_sensor.subject())
    assert alone.ensemble is None
    estimated = predict(alone, made_sensor.record(made_sensor.cycle(0.6), "proximal", seed=2))
    assert np.array_equal(estimated.force_n, estimated.force_filter_n)


@pytest.mark.long
def test_a_subject_file_keeps_the_ensemble():
    again = parse_subject(subject_toml(subject()))
    recording = made_sensor.record(made_sensor.cycle(0.6), "distal", seed=2)
    assert np.array_equal(predict(again, recording).force_n, predict(subject(), recording).force_n)
    wrong = replace(subject().ensemble, weights=subject().ensemble.weights | {"filter": 0.5})
    assert not np.array_equal(
        predict(replace(again, ensemble=wrong), recording).force_n, predict(again, recording).force_n
    )


def test_estimates_line_by_line_are_those_of_a_file():
    recording = made_sensor.record(made_sensor.cycle(0.6, lasting_s=4.0), "proximal", seed=2)
    recording.volts[0, 50:60] = np.nan
    lines = recording_csv(recording).splitlines(keepends=True)
    written = replace(recording, volts=np.array([[float(f"{v:.7g}") for v in row] for row in recording.volts]))
    assert list(live(subject(), lines)) == list(csv_rows(predict(subject(), written)))


def test_memory_is_of_constant_size_and_decays():
    memory, since_s = Features(np.eye(2)), np.full(5000, 0.02)
    ln_v = np.tile(np.where(np.arange(5000) < 100, 0.1, 0.0), (2, 1))
    over_rest = memory.over_rest(np.exp(ln_v), np.zeros(5000, bool), since_s)
    features = memory.with_memory(over_rest, np.zeros((2, 5000)), since_s)
    assert features.shape == ((1 + len(LAGS_S)) * 4, 5000)
    assert np.abs(features[4:, -1]).max() < 1e-9 < np.abs(features[4:, 101]).max()


@pytest.mark.parametrize("step_s", [0.08, 0.04, 0.002])
def test_departures_of_a_ramp_are_those_of_its_slope_at_any_rate(step_s):
    """Expected: from an exponential mean a ramp departs by slope times time constant, in the end."""
    time_s = np.arange(0.0, 10.0, step_s)
    ramp = np.stack([0.3 * time_s, 0.0 * time_s])
    features = Features(np.empty((0, 1))).with_memory(np.zeros((1, time_s.size)), ramp, np.full(time_s.size, step_s))
    assert features[2::2, -1] == pytest.approx(0.3 * LAGS_S * -np.expm1(-time_s[-1] / LAGS_S), rel=1e-6)


def test_the_zero_follows_a_slow_drift_at_rest_alone():
    for is_resting, left in ((True, 0.003), (False, 0.1)):
        drifting = np.linspace(0.0, 0.1, 501)[None]
        values = Features(np.eye(1)).over_rest(np.exp(drifting), np.full(501, is_resting), np.full(501, 2.0))
        assert values[0, -1] == pytest.approx(left, abs=0.001)


def test_the_zero_follows_readings_that_are_far_from_it_four_times_slower():
    """Rationale: a filter that mistakes a slow touch for a wave estimates that the finger rests."""
    for far, slower in ((3.0, 4.0), (0.1, 1.0)):
        step = np.where(np.arange(100) < 10, 0.0, far)[None]
        values = Features(np.eye(1)).over_rest(np.exp(step), np.full(100, True), np.full(100, 1.0))
        assert values[0, -1] == pytest.approx(far * np.exp(-90.0 / (slower * ZERO_S)), rel=0.05)


def test_the_zero_follows_a_light_that_drifts_for_long():
    """Rationale: a drift that leads the zero astray takes it further away, where it follows less. Expected: it lies
    behind by no more than the drift of four time constants."""
    fading = 0.03 * np.arange(3600.0)[None]
    values = Features(np.eye(1)).over_rest(np.exp(fading), np.full(3600, True), np.full(3600, 1.0))
    assert values[0, -1] == pytest.approx(0.03 * 4.0 * ZERO_S, rel=0.05)


def test_readings_at_rest_and_memory_restart_after_a_gap_as_the_filter_does():
    memory, since_s = Features(np.eye(1)), np.array([0.0, 0.02, LONGEST_GAP_S + 1.0, 0.02])
    over_rest = memory.over_rest(np.exp([[0.0, 0.1, 0.3, 0.4]]), np.zeros(4, bool), since_s)
    assert over_rest == pytest.approx(np.array([[0.0, 0.1, 0.0, 0.1]]))
    again = Features(np.eye(1)).with_memory(over_rest[:, :2], np.zeros((2, 2)), since_s[:2])
    assert memory.with_memory(over_rest, np.zeros((2, 4)), since_s)[:, 2:] == pytest.approx(again)


def test_the_filter_counts_half_in_touches_of_both_sides_and_nothing_in_those_of_one():
    share = np.array([0.0, 0.2, 0.35, 0.5, 0.8, 1.0])
    assert mixed(np.ones((2, 6)), np.full(6, 2.0), share)[0] == pytest.approx(np.array([1.0, 1.0, 1.25, 1.5, 1.0, 1.0]))
    # Nor where members estimate no touch, whatever the gate.
    assert (mixed(np.zeros((2, 6)), np.full(6, 2.0), share)[0] == 0.0).all()


def estimate_of(members_n: float, share: float, filter_n: float) -> list[float]:
    """Force, bounds and share where members agree on a force and have no errors of their own."""
    ensemble = subject().ensemble
    assert ensemble is not None
    nothing = {name: 0.0 * getattr(ensemble, name) for name in ("polynomial_n", "kernel_n", "half_width_n", "gate")}
    by_side = {"intercept_n": np.full(2, members_n), "open_above_n": np.full(2, 9.0)}
    known = replace(ensemble, **nothing | by_side, weights={"filter": np.zeros(2)}, top_n=1.2)
    known.gate[0] = share
    by_filter = np.array([filter_n])
    return [float(one[0]) for one in known.estimate(np.zeros((len(known.least), 1)), by_filter, by_filter)]


def test_what_the_filter_moves_a_touch_of_both_sides_by_widens_its_interval_by_half():
    assert estimate_of(0.4, 0.5, 0.8) == pytest.approx([0.6, 0.5, 0.7, 0.5])
    assert estimate_of(0.4, 1.0, 0.8) == pytest.approx([0.4, 0.4, 0.4, 1.0])


def test_a_filter_that_overshoots_is_followed_only_where_members_estimate_a_hard_touch():
    """Expected: of both sides it counts as the largest calibrated force of the members, 1.2 N here."""
    assert estimate_of(0.4, 1.0, 3.0)[0] == pytest.approx(0.4) and estimate_of(0.4, 0.5, 3.0)[0] == pytest.approx(0.8)
    assert estimate_of(1.2, 1.0, 3.0)[0] == estimate_of(1.2, 0.5, 3.0)[0] == pytest.approx(3.0)


@pytest.mark.long
def test_errors_of_the_share_are_those_of_each_side(monkeypatch):
    """Rationale: of one calibration and one recording they differ by half, and by two where drifts are drawn. Expected:
    without drifts, over three calibrations, those of other recordings of the same touches."""
    monkeypatch.setattr(training, "COPIES", 1)
    recordings = [unlike(made_sensor.record_touches(seed=seed)) for seed in (7, 8, 9)]
    touched = (recordings[0].force_n >= 0.15) & (recordings[0].force_n <= TOP_N)
    stated, squares = [], []
    for seed in (1, 2, 3):
        ensemble, _ = train(subject(), calibration_series(subject(), [unlike(made_sensor.record_touches(seed=seed))]))
        stated.append(ensemble.share_error)
        for recording in recordings:
            off = predict(replace(subject(), ensemble=ensemble), recording).proximal_share.values - recording.site
            squares.append([np.mean(off[touched & (recording.site == side)] ** 2) for side in (1.0, 0.0)])
    expected = np.sqrt(np.mean(np.square(stated), axis=0))
    assert np.sqrt(np.mean(squares, axis=0)) == pytest.approx(expected, rel=0.3)


def test_intervals_hold_rest_where_the_filter_may_be_at_rest():
    """Whatever the ensemble's estimate, whose narrow interval excludes 0 here."""
    ensemble = subject().ensemble
    assert ensemble is not None
    moved = replace(ensemble, intercept_n=ensemble.intercept_n + 0.3, half_width_n=np.full((2, 4), 1e-6))
    rest = unlike(made_sensor.record(np.zeros(150), "proximal", seed=7))
    estimated = predict(replace(subject(), ensemble=moved), rest)
    assert estimated.force_n.median() > 0.2 and (estimated.force_low_n == 0.0).all()


@pytest.mark.long
def test_one_touch_of_a_side_calibrates():
    """While it is held out, the interval of its side is that of all touches."""
    force_n = np.tile(made_sensor.touches(), 2)
    site = np.where(made_sensor.STEP_S * np.arange(force_n.size) < 3.2, 1.0, 0.0)
    recording = made_sensor.record(force_n, site, seed=4)
    result = calibrate_with(made_sensor.scene(), made_sensor.table(), [recording])
    known = parse_subject(result.attrs["subject"])
    assert known.ensemble is not None and (known.ensemble.half_width_n.sum(1) > 0).all()
    assert "proximal touches lack touches (1 of 6)" in result.attrs["warnings"][0]


@pytest.mark.parametrize("site", ["proximal", "distal"])
def test_a_step_of_force_within_one_sample_is_not_overestimated(site):
    time_s = made_sensor.STEP_S * np.arange(150)
    step = made_sensor.record(np.where(time_s < 2.0, 0.0, 0.5), site, seed=3)
    alone = parse_subject(made_sensor.subject())
    force_n = predict(alone, step).force_n.values
    assert 0.4 < force_n[-1] and force_n.max() < 1.15 * force_n[-1]


def test_a_reading_that_begins_with_a_gap_is_compared_with_its_own_first_value_at_rest():
    """Expected: unknown until then, in a touch, too; then its change since, whatever the other readings do."""
    ln_v = np.array([[-1.0, -1.0, -0.9, -1.0, -0.8], [np.nan, np.nan, -2.5, -2.0, -1.7]])
    rests = np.array([True, True, False, True, False])
    over_rest = Features(np.zeros((1, 2))).over_rest(np.exp(ln_v), rests, np.full(5, 1e-9))
    expected = np.array([[0.0, 0.0, 0.1, 0.0, 0.2], [np.nan, np.nan, np.nan, 0.0, 0.3]])
    assert over_rest == pytest.approx(expected, nan_ok=True)


def test_a_reading_that_is_lost_leaves_the_force_to_the_filter_and_is_named():
    """Rationale: regressions do without no reading; its last one is no reading of now. Expected: of the filter while it
    is lost for longer than a quarter of a second, as is its interval, and else of the ensemble."""
    recording = unlike(made_sensor.record(made_sensor.cycle(0.6, lasting_s=6.0), "proximal", seed=2))
    whole, lost = predict(subject(), recording), slice(*np.searchsorted(recording.time_s, [2.995, 5.0]))
    quality = subject().quality
    assert whole.attrs["warnings"] == [quality.fault, *map("calibration: {}".format, quality.lacking)]
    assert (whole.force_n != whole.force_filter_n).mean() > 0.9
    recording.volts[2, lost] = np.nan
    estimated = predict(subject(), recording)
    by_filter, filtered = slice(lost.start + round(MISSING_S / made_sensor.STEP_S), lost.stop), estimated.force_filter_n
    assert np.array_equal(estimated.force_n[by_filter], filtered[by_filter])
    assert (np.delete(estimated.force_n.values != filtered.values, np.r_[by_filter]))[100:].mean() > 0.9
    alone = predict(replace(subject(), ensemble=None), recording)
    assert np.array_equal(estimated.force_high_n[by_filter], alone.force_high_n[by_filter])
    *others, warning = estimated.attrs["warnings"]
    assert others == whole.attrs["warnings"]
    assert warning.startswith(f"{recording.names[2]} ({by_filter.stop - by_filter.start}) missing")


@pytest.mark.long
def test_rounding_changes_no_training():
    """Rationale: drifts that are drawn along eigenvectors of equal eigenvalues are others wherever digits end."""
    recording = unlike(made_sensor.record_touches(seed=1))
    errors_n = []
    for part in (0.0, 1e-13):
        noise = replace(subject().noise, drift_per_min=2e-3, led_drift_per_min=1e-3 * (1.0 + part))
        series = calibration_series(known := replace(subject(), noise=noise), [recording])
        ensemble, _ = train(known, series)
        errors_n.append(ensemble.errors_n)
    assert errors_n[1] == pytest.approx(errors_n[0], rel=1e-5)
