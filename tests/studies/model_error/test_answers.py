"""What an answer of some error costs: bias and noise together, and the fastest within an error."""

import math

import pytest

from nailoptics.studies.model_error.tradeoff import OWN, REFERENCE, Bias, Level, fastest


def level(name: str, *, bound: float = 0.0, signal: float = 0.0, noise: float = 0.1, setup: float = 2.0) -> Level:
    """A traced level: bound on the bias of reading and signal, noise after one second, seconds before the photons."""
    of_reading, of_signal = Bias(bound, 0.0, bound), Bias(signal, 0.0, signal)
    return Level(name, "llvm", of_reading, of_signal, setup, reading_noise=noise, signal_noise=noise)


FULL = level(REFERENCE)
DIM = Level("dim", "numpy", Bias(0.3, 0.0, 0.3), Bias(0.1, 0.0, 0.1), 0.02)
FORMULA = Level("formula", "numpy", None, Bias(0.3, 0.0, 0.3), 1e-5)


def test_bias_and_standard_error_add_in_squares():
    biased = level("biased", bound=0.03, signal=0.01)
    # As many photons as needed, and no more; below the bias no number is enough.
    for error in (0.05, 0.04):
        stderr = biased.reading_noise / math.sqrt(biased.photon_seconds(error))
        assert math.hypot(0.03, stderr) == pytest.approx(error) == biased.within(error).error
    assert biased.photon_seconds(0.029) == math.inf and level("x", signal=0.04).photon_seconds(0.03) == math.inf


def test_a_level_without_a_reading_at_rest_answers_nothing():
    assert FORMULA.photon_seconds(0.9) == math.inf and FORMULA.within(0.9) is None
    assert DIM.photon_seconds(0.31) == 0 and DIM.photon_seconds(0.29) == math.inf
    assert DIM.within(0.31).error == 0.3 and DIM.within(0.29) is None


def test_the_fastest_within_an_error():
    cheap = level("cheap", bound=0.03, noise=0.03)
    levels = [FULL, cheap, FORMULA, DIM]
    assert fastest(levels, 0.4).level is DIM and fastest(levels, 0.05).level is cheap
    found = fastest(levels, 0.02)
    assert found.level is FULL and found.seconds == pytest.approx(2 + 25) and found.relative_error == 0.02
    assert fastest([cheap, FORMULA], 0.02) is None


def test_the_usual_level_stays_within_the_noise_of_costs():
    near, cheap, own = level("near", noise=0.096), level("cheap", noise=0.05), level(OWN, noise=0.098)
    assert fastest([near, FULL], 0.02).level is FULL
    assert fastest([near, cheap, FULL], 0.02).level is cheap
    assert fastest([near, FULL, own], 0.02).level is own
