"""Readings over blood states against direct evaluation, fresh traces, and what shared noise promises."""

import time

import numpy as np
import pytest
from small_scenes import finger

import nailoptics as nail
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.light import ReweightWarning, Transfer, optics
from nailoptics.light.transfer import series as course_module
from nailoptics.light.transfer.records import LedTrace
from nailoptics.light.transfer.series import readings_over_states
from nailoptics.scene import Scene, parse_scene


def scene(*, wavelength_nm: float = 800.0, blood: str = "") -> Scene:
    near = {"name": "near", "position_mm": [0.0, -1.6], "size_mm": [1.0, 1.0]}
    far = {"name": "far", "position_mm": [0.0, 2.0], "size_mm": [1.0, 1.0]}
    return parse_scene(finger(near, far, leds=({"wavelength_nm": wavelength_nm, "fwhm_nm": 30.0},)) + blood)


def synthetic(records: int = 20_000, *, path_mm: float = 8.0, blood: str = "") -> Transfer:
    """A synthetic trace of given statistics: long-tailed paths in all zones, two photodiodes."""
    rng = np.random.default_rng(1)
    varied = scene(blood=blood)
    names = optics.absorbers(varied)
    path = np.zeros((records, len(names)), np.float32)
    beds = [names[column] for column in optics.bed_columns(varied)]
    for name, mean in (*((bed, 2 * path_mm / len(beds)) for bed in beds), ("plate", 2.0), ("epoxy", 1.0)):
        path[:, names.index(name)] = rng.exponential(mean, records)
    trace = LedTrace(
        photons=10**6,
        mu_a=optics.absorption(varied, 800.0)[0],
        photon=rng.permutation(10**6)[:records],
        photodiode=rng.integers(0, 2, records).astype(np.uint16),
        weight=rng.uniform(0.2, 1.0, records),
        path_mm=path,
        energy={"absorbed": (0.0, 0.0)},
        seeds=(1,),
    )
    return Transfer(varied, (trace,), "none")


@pytest.fixture(scope="module")
def traced(chosen_jit) -> Transfer:
    """Half a million photons through a finger at rest, 3 % of blood, at 605 nm, where blood absorbs more."""
    return nail.trace(scene(wavelength_nm=605.0), photons=1 << 19, seed=1)


def read_alone(transfer: Transfer, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Detected fractions of the only LED in one state, and their standard errors, (1, photodiodes) float each; of its
    line, weighed as the photodiodes respond to it."""
    (trace,), (led,), count = transfer.traces, transfer.scene.leds, len(transfer.photodiodes)
    wavelength, share = optics.spectrum(led)
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=state)
    moments = trace.moments(mu_a, share * wavelength / led.wavelength_nm, count=count)
    return moments.fraction[None], moments.stderr[None]


def random_states(count: int, *, low: float = 0.0, high: float = 0.1, seed: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


@pytest.mark.parametrize("high", [0.031, 0.06, pytest.param(0.2, marks=pytest.mark.long)])
def test_between_nodes_interpolated_readings_are_those_of_each_state_alone(high):
    """Expected: fraction, change and their errors at random states as evaluated one by one, to far less than the
    standard error; the states are so many that they are interpolated, and read directly they are few."""
    transfer = synthetic()
    states = random_states(2000, low=0.02, high=high)
    smooth = readings_over_states(transfer, states)
    for k in (0, 1, 500, 1999):
        fraction, stderr = read_alone(transfer, states[k])
        assert np.all(abs(smooth.fraction[:, :, k] - fraction) < 1e-6 * fraction)
        assert np.all(abs(smooth.fraction[:, :, k] - fraction) < 1e-3 * stderr)
        assert np.allclose(smooth.stderr[:, :, k], stderr, rtol=1e-4)
    direct = readings_over_states(transfer, states[[0, 700, 1500]])
    assert np.allclose(smooth.change[..., [0, 700, 1500]], direct.change, rtol=0, atol=1e-6 * direct.fraction.max())
    assert np.allclose(smooth.change_stderr[..., [700, 1500]], direct.change_stderr[..., 1:], rtol=1e-3)


@pytest.mark.parametrize("blood", ["zones = 8", "zones = 8\nvenous_so2 = 0.6", "venous_so2 = 0.6"])
def test_joint_zones_and_arterial_blood_are_interpolated(monkeypatch, blood):
    """Expected: as each state reads on its own, to far less than the standard error, from fewer nodes than states."""
    text = '[blood]\nparameters = "best"\n' + blood + "\n[touch]\nforce_n = 4.0\nsample_rate_hz = 2000.0\n"
    transfer, calls = synthetic(5000, blood=text), []
    states = blood_over_touch(transfer.scene).blood_fraction.values.T
    sums = course_module._Course.sums
    monkeypatch.setattr(course_module._Course, "sums", lambda c, s, *a: (calls.append(len(s)), sums(c, s, *a))[1])
    smooth = readings_over_states(transfer, states)
    assert sum(calls) < len(states) / 2
    for k in (0, 505, 1200, 4490, 4600, 8000):
        fraction, stderr = read_alone(transfer, states[k])
        assert np.all(abs(smooth.fraction[:, :, k] - fraction) < 1e-3 * stderr)
        assert np.allclose(smooth.stderr[:, :, k], stderr, rtol=1e-3)
    at = [0, 505, 4600]
    direct = readings_over_states(transfer, states[at])
    assert np.allclose(smooth.change[..., at], direct.change, rtol=0, atol=1e-5 * direct.fraction.max())
    assert np.allclose(smooth.change_stderr[..., at[1:]], direct.change_stderr[..., 1:], rtol=2e-3)


def test_one_zone_alone_may_move():
    transfer = synthetic()
    states = np.column_stack([np.linspace(0.01, 0.05, 300), np.full(300, 0.03)])
    smooth = readings_over_states(transfer, states)
    for k in (0, 123, 299):
        assert np.allclose(smooth.fraction[:, :, k], read_alone(transfer, states[k])[0], rtol=1e-7)


def test_states_that_are_all_alike_read_alike_and_do_not_change():
    read = readings_over_states(synthetic(), np.full((50, 2), 0.03))
    assert np.ptp(read.fraction, axis=-1).max() == 0
    assert np.all(read.change == 0) and np.all(read.change_stderr == 0) and np.all(read.stderr > 0)


def test_a_change_shares_its_noise_with_what_it_starts_from():
    """Rationale: both states are read from the same photons. Expected: a change of 10 % of the blood has less than a
    fifth of the readings' standard error, and resampling photons gives the reported standard error."""
    transfer = synthetic()
    states = np.array([[0.03, 0.03], [0.033, 0.03]])
    read = readings_over_states(transfer, states)
    assert np.all(read.change_stderr[..., 1] < 0.2 * read.stderr[..., 1])
    assert np.all(abs(read.change[..., 1]) > 20 * read.change_stderr[..., 1])
    trace = transfer.traces[0]
    slope = optics.absorption(transfer.scene, 800.0, blood_fraction=states)[:, 0] - trace.mu_a
    rng, result = np.random.default_rng(4), []
    mine = trace.photodiode == 0
    weight = trace.weight[mine, None] * np.exp(-trace.path_mm[mine] @ slope.T)
    for _ in range(400):
        count = rng.poisson(1.0, mine.sum())
        result.append(float(count @ (weight[:, 1] - weight[:, 0])) / trace.photons)
    # The line of 30 nm hardly matters for the spread; 400 resamplings determine a standard deviation to 3.5 %.
    assert np.std(result) == pytest.approx(float(read.change_stderr[0, 0, 1]), rel=0.15)


def test_electrons_weigh_wavelengths_by_photons_per_watt():
    """A watt at wavelength l holds l / 800 times the photons of one at 800 nm; over a symmetrical line nearly nothing
    is left of it, and what is left is the sum over the line."""
    transfer = synthetic()
    state = np.array([[0.03, 0.05]])
    read = readings_over_states(transfer, state).fraction[0, :, 0]
    wavelength, share = optics.spectrum(transfer.scene.leds[0])
    trace = transfer.traces[0]
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=state[0]) - trace.mu_a
    factor = np.exp(-(trace.path_mm.astype(float) @ mu_a.T))
    weighted, plain = (
        np.bincount(trace.photodiode, trace.weight * (factor @ weights), minlength=2) / trace.photons
        for weights in (share * wavelength / 800.0, share)
    )
    assert np.allclose(read, weighted, rtol=1e-9)
    assert np.all(read != plain) and np.allclose(read, plain, rtol=0.01)


def test_ten_thousand_states_take_little_longer_than_a_hundred():
    """A whole press takes about a second, also where two other processes have the machine."""
    transfer = synthetic(100_000)
    t = np.linspace(0, 1, 10_000)
    states = np.column_stack([0.03 - 0.02 * np.sin(9 * t) ** 2, 0.03 + 0.01 * np.sin(5 * t) ** 2])
    took = {}
    for count in (100, 10_000):
        start = time.process_time()
        read = readings_over_states(transfer, states[:: len(states) // count])
        took[count] = time.process_time() - start
        assert read.fraction.shape == (1, 2, count)
    assert took[10_000] < 5 and took[10_000] < 4 * took[100] + 1


def test_reweighting_to_states_too_far_away_warns():
    """Even where only one state of many is, and only between nodes; nearer ones do not warn (warnings are errors)."""
    trace = synthetic(600)
    readings_over_states(trace, random_states(50, high=0.1))
    states = np.full((200, 2), 0.03)
    states[77] = 1.0
    with pytest.warns(ReweightWarning, match='photodiode "(near|far)".*effective photons'):
        readings_over_states(trace, states)


def test_states_of_the_wrong_shape_are_refused_in_one_line():
    for states in (np.zeros(2), np.zeros((3, 3)), np.zeros((0, 2)), np.zeros((2, 2, 2))):
        with pytest.raises(InputError, match="one value for each zone") as caught:
            readings_over_states(synthetic(10), states)
        assert "\n" not in str(caught.value)
    for value in (-0.01, 1.01, float("nan")):
        with pytest.raises(InputError, match="0 to 1"):
            readings_over_states(synthetic(10), np.full((3, 2), value))


def test_a_trace_without_detected_light_reads_zero():
    read = readings_over_states(synthetic(0), random_states(500))
    assert read.fraction.shape == (1, 2, 500) and not read.fraction.any() and not read.stderr.any()


@pytest.mark.long
@pytest.mark.jit
@pytest.mark.parametrize("blood, so2", [(0.0, 0.97), (0.1, 0.0), pytest.param(0.03, 0.0, marks=pytest.mark.slow)])
def test_reading_another_state_is_tracing_it_afresh(jit_backend, traced, blood, so2):
    """Rationale: one trace reads every state. Expected: a fresh trace at another blood fraction and saturation, with
    other seeds, agrees within 4 combined standard errors of at most 8 %, and rest lies further off than the noise; the
    paths distinguish the states better still."""
    other = scene(wavelength_nm=605.0, blood=f"[blood]\nrest_blood_fraction = {blood}\nso2 = {so2}\n")
    fresh = nail.trace(other, photons=1 << 18, seed=7).at()
    again = traced.at(blood_fraction=[blood, blood], so2=so2)
    stderr = np.hypot(fresh.detected_fraction_stderr, again.detected_fraction_stderr)
    assert np.all(abs(fresh.detected_fraction - again.detected_fraction) < 4 * stderr)
    assert np.all(stderr < 0.08 * fresh.detected_fraction)
    moved = abs(traced.at().detected_fraction - again.detected_fraction)
    assert np.any(moved > 2.5 * stderr)
    for name in ("bed_1", "plate"):
        a, b = fresh.sel(absorber=name), again.sel(absorber=name)
        error = np.hypot(a.mean_path_mm_stderr, b.mean_path_mm_stderr)
        assert np.all(abs(a.mean_path_mm - b.mean_path_mm) < 4.5 * error)


@pytest.mark.slow
@pytest.mark.jit
def test_a_real_trace_is_interpolated_as_well_as_a_synthetic_one(traced):
    states = random_states(1000, low=0.005, high=0.08)
    smooth = readings_over_states(traced, states)
    for k in (3, 400, 999):
        fraction, stderr = read_alone(traced, states[k])
        assert np.all(abs(smooth.fraction[:, :, k] - fraction) < 1e-3 * stderr)
