"""The body's waves: each one's spectral lines are those of its pressure, a new one reaches all studies, and the
oscillators by which a filter follows them."""

from dataclasses import replace

import numpy as np
import pytest

from nailoptics.hemodynamics import waves
from nailoptics.hemodynamics.waves import BREATHING, CardiacOscillator, DampedOscillator
from nailoptics.scene import Body, Breathing, Heartbeat, Vasomotion

BEAT = CardiacOscillator(1.1, (400.0, 200.0, 90.0), 0.1)


def test_the_cardiac_oscillators_jacobian_is_that_of_its_step() -> None:
    state = np.array([0.05, 300.0, -500.0, 120.0, 210.0, -80.0, 60.0])
    after, slopes, _ = BEAT.propagate(state, 0.01)
    reach = 1e-4 * np.maximum(np.abs(state), 1.0)
    moved = [BEAT.propagate(state + one, 0.01)[0] - BEAT.propagate(state - one, 0.01)[0] for one in np.diag(reach)]
    assert np.array(moved).T / (2 * reach) == pytest.approx(slopes, rel=1e-5, abs=1e-6)
    assert after.shape == state.shape


def test_the_cardiac_oscillator_returns_to_its_rate_and_height() -> None:
    height = np.sqrt(2) * np.array(BEAT.rms_pa)
    state = np.concatenate([[0.0], (0.5 * height[:, None] * [1.0, 0.0]).ravel()])
    for _ in range(int(60 / 0.01)):
        state = BEAT.propagate(state, 0.01)[0]
    result = np.hypot(*state[1:].reshape(-1, 2).T)
    assert result == pytest.approx(height, rel=0.01)
    # 66 whole beats.
    assert state[1:].reshape(-1, 2)[:, 1] == pytest.approx(0.0, abs=0.01 * height[0])


def test_process_noise_delays_all_harmonics_together() -> None:
    state = np.array([0.0, 500.0, 0.0, 250.0, 0.0, 100.0, 0.0])
    after, _, noise = BEAT.propagate(state, 0.01)
    across = np.arange(2, 7, 2)
    deviation = np.sqrt(np.diag(noise)[across])
    alike = noise[np.ix_(across, across)] / np.outer(deviation, deviation)
    assert alike.min() > 0.8
    # Intervals of a second that scatter by 5 % move the phase of the first harmonic by 0.31 radians a beat.
    height = np.hypot(after[1], after[2])
    assert deviation[0] / height == pytest.approx(2 * np.pi * 0.05 * np.sqrt(1.1 * 0.01), rel=0.1)


def test_a_beat_far_too_high_returns_to_its_height() -> None:
    state = np.concatenate([[0.0], 1e4 * np.array(BEAT.rms_pa).repeat(2)])
    for _ in range(int(100 / 0.05)):
        before, state = state, BEAT.propagate(state, 0.05)[0]
        assert (np.hypot(*state[1:].reshape(-1, 2).T) < 1.01 * np.hypot(*before[1:].reshape(-1, 2).T)).all()
    assert np.hypot(*state[1:].reshape(-1, 2).T) == pytest.approx(np.sqrt(2) * np.array(BEAT.rms_pa), rel=0.01)


def test_harmonics_above_the_samples_rate_are_not_followed() -> None:
    # Half of 10 Hz is 5 Hz, of which 3.75 Hz are used; a third harmonic of 1.1 Hz reaches up to 3.7 Hz.
    assert BEAT.resolved_harmonics(0.1).tolist() == [True, True, True]
    assert CardiacOscillator(1.1, (1.0,) * 5, 0.1).resolved_harmonics(0.1).tolist() == [True, True, True, False, False]
    assert not BEAT.resolved_harmonics(1.0).any()


def test_a_damped_oscillator_keeps_its_power_and_loses_its_phase():
    one = DampedOscillator(frequency_hz=0.1, coherence_s=4.0, rms_pa=300.0)
    transition, noise = one.propagate(0.05)
    covariance, response = 1e5 * np.eye(2), np.array([1.0, 0.0])
    for _ in range(2000):
        covariance = transition @ covariance @ transition.T + noise * np.eye(2)
    assert covariance == pytest.approx(300.0**2 * np.eye(2), abs=1.0)
    for _ in range(200):  # a whole period
        response = transition @ response
    assert response == pytest.approx([np.exp(-10.0 / 4.0), 0.0], abs=1e-6)


def test_every_waves_lines_have_the_variance_of_its_pressure():
    body = Body(heartbeat=Heartbeat(rate_variability=0.0), breathing=Breathing(), vasomotion=Vasomotion())
    time_s = np.arange(0.0, 1200.0, 0.02)
    assert (
        [wave.name for wave, _ in waves.waves_of(body)] == list(body.waves) == ["heartbeat", "breathing", "vasomotion"]
    )
    for wave, fields in waves.waves_of(body):
        pressure_pa = wave.pressure_pa(time_s, seed=1, **fields)
        frequency_hz, variance_pa2 = wave.lines(**fields)
        assert variance_pa2.sum() == pytest.approx(pressure_pa.var(), rel=0.05), wave.name
        assert wave.band_hz[0] <= frequency_hz[0] <= wave.band_hz[1]


def test_a_further_wave_is_one_entry_of_the_list(monkeypatch):
    """Of its table here breathing's own stands in; expected: it is in the pressure, the lines and the fastest rate."""
    third = replace(BREATHING, name="breathing", lines=lambda **_: (np.array([0.7]), np.array([5.0])))
    third = replace(third, pressure_pa=lambda time_s, **_: 7.0 * np.ones_like(time_s), fastest_hz=lambda **_: 0.7)
    monkeypatch.setattr(waves, "WAVES", (third,))
    body, time_s = Body(breathing=Breathing()), np.linspace(0.0, 1.0, 5)
    assert waves.waves_pressure(body, time_s, mean_pressure_pa=1e4) == pytest.approx(np.full(5, 1e4 + 7.0))
    assert [part.tolist() for part in waves.pressure_lines(body)] == [[0.7], [5.0]]
    assert waves.fastest_hz(body) == 0.7


@pytest.mark.parametrize("duration_s", [10.0, 300.0])
def test_lines_of_a_recording_hold_its_whole_variance(duration_s):
    """The heart beats in a recording of minutes, too. Expected: its variance is the sum of its lines, as far up as
    samples resolve it, also at the Nyquist frequency, of which there is one line and not a pair."""
    time_s = np.arange(0.0, duration_s, 0.01)
    pressure_pa = waves.cardiac_pressure(time_s, rate_per_min=70.0)
    body = Body(recorded_time_s=tuple(time_s), recorded_arterial_pressure_pa=tuple(pressure_pa))
    frequency_hz, variance_pa2 = waves.pressure_lines(body)
    assert variance_pa2.sum() == pytest.approx(pressure_pa.var(), rel=0.03)
    assert frequency_hz[np.argmax(variance_pa2)] == pytest.approx(70.0 / 60.0, rel=0.05)
    assert waves.spectral_lines(np.array([1.0, -1.0, 1.0, -1.0]), duration_s=1.0)[1] == pytest.approx([0.0, 1.0])
