"""Beats and rate of pulse waveforms, synthetic and recorded."""

from pathlib import Path

import numpy as np
import pytest

from nailoptics.errors import InputError
from nailoptics.hemodynamics import cardiac_pressure
from nailoptics.hemodynamics.beat_detection import find_beats

RECORDED = Path(__file__).parent / "plethysmogram.csv"
# The estimate of HeartPy 1.2.7, whose example it is.
RATE_BY_HEARTPY = 58.899


def test_the_rate_of_a_recorded_plethysmogram_is_that_of_another_library():
    counts = np.loadtxt(RECORDED, skiprows=12)
    result = find_beats(np.arange(len(counts)) / 100.0, counts)
    assert abs(result.rate_per_min - RATE_BY_HEARTPY) < 1.0
    assert abs(len(result.peak_s) - len(counts) / 100.0 * RATE_BY_HEARTPY / 60.0) < 1.5


@pytest.mark.parametrize("rate", [40.0, 70.0, 110.0, 180.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_the_rate_of_a_pulse_is_estimated_through_noise_and_drift(rate, noise):
    """Rationale: two beats are as like two beats, and a dicrotic wave is like a beat. Expected: neither is taken."""
    time_s = np.arange(0.0, 30.0, 0.01)
    pulse = cardiac_pressure(time_s, rate_per_min=rate, mean_pressure_pa=0.0, pulse_pressure_pa=1.0)
    drift = 3.0 * np.sin(2 * np.pi * 0.07 * time_s) + 0.1 * time_s
    noisy = pulse + drift + noise * np.random.default_rng(3).standard_normal(len(time_s))
    result = find_beats(time_s, noisy)
    assert abs(result.rate_per_min - rate) < 0.5 + 0.005 * rate
    assert abs(len(result.peak_s) - 30.0 * rate / 60.0) < 2
    assert result.usual.mean() > 0.9


def test_the_rate_follows_a_heart_that_quickens():
    time_s = np.arange(0.0, 60.0, 0.01)
    slow = cardiac_pressure(time_s, rate_per_min=60.0, mean_pressure_pa=0.0, pulse_pressure_pa=1.0)
    fast = cardiac_pressure(time_s, rate_per_min=75.0, mean_pressure_pa=0.0, pulse_pressure_pa=1.0)
    result = find_beats(time_s, np.where(time_s < 30.0, slow, fast))
    assert abs(result.rate_at(15.0, 8.0) - 60.0) < 1.0 and abs(result.rate_at(45.0, 8.0) - 75.0) < 1.0


def test_beats_lie_between_samples_where_the_wave_is_at_its_most():
    """A sine of which 20 samples in a second hold no peak: parabolas estimate it to a fiftieth of a sample."""
    time_s, rate_hz = np.arange(0.0, 30.0, 0.05), 1.37
    peak_s = find_beats(time_s, np.cos(2 * np.pi * rate_hz * time_s)).peak_s[3:-3]
    assert peak_s == pytest.approx(np.round(peak_s * rate_hz) / rate_hz, abs=0.001)
    assert np.abs(peak_s - time_s[np.searchsorted(time_s, peak_s)]).max() > 0.02


@pytest.mark.parametrize(
    ("time_s", "signal", "words"),
    [
        (np.arange(0.0, 0.5, 0.01), np.sin(np.arange(50) / 8.0), "three beats"),
        (np.arange(0.0, 20.0, 0.01), np.random.default_rng(1).standard_normal(2000), "no heartbeat"),
        (np.arange(0.0, 20.0, 0.5), np.sin(np.arange(40)), "20 or more"),
    ],
    ids=["short", "noise", "slow"],
)
def test_what_holds_no_beats_is_refused_in_one_line(time_s, signal, words):
    with pytest.raises(InputError, match=words) as error:
        find_beats(time_s, signal)
    assert "\n" not in str(error.value)
