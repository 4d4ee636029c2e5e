"""What an answer of some error costs: bias and noise together, and the fastest within an error."""

import math

import pytest

from nailoptics.studies.model_error.tradeoff import OWN, REFERENCE, Bias, Level, fastest


def level(name: str, *, bound: float = 0.0, signal: float = 0.0, noise: float = 0.1, setup: float = 2.0) -> Level:
    """A traced level: bound on the bias of reading and signal, noise after one second, seconds before the photons."""
    of_reading, of_signal = Bias(bound, 0.0, bound), Bias(signal, 0.0, signal)
    return Level(name, of_reading, of_signal, setup, noise, noise, {})


FULL = level(REFERENCE)
DIM = level("dim", bound=0.3, signal=0.1, noise=0.01, setup=0.02)
UNKNOWN_BIAS = level("unknown", bound=math.inf)


def test_bias_and_standard_error_add_in_squares():
    biased = level("biased", bound=0.03, signal=0.01)
    # As many photons as needed, and no more; below the bias no number is enough.
    for error in (0.05, 0.04):
        stderr = biased.reading_noise / math.sqrt(biased.photon_seconds(error))
        assert math.hypot(0.03, stderr) == pytest.approx(error)
        assert biased.relative_error(error) == pytest.approx(stderr)
        assert biased.seconds(error) == 2 + biased.photon_seconds(error)
    assert biased.photon_seconds(0.029) == math.inf and level("x", signal=0.04).photon_seconds(0.03) == math.inf


def test_a_level_of_unknown_bias_reaches_no_error():
    assert UNKNOWN_BIAS.seconds(0.9) == math.inf and UNKNOWN_BIAS.relative_error(0.9) == 0
    assert DIM.photon_seconds(0.31) < 0.02 and DIM.photon_seconds(0.29) == math.inf


def test_the_fastest_within_an_error():
    cheap = level("cheap", bound=0.03, noise=0.03)
    levels = [FULL, cheap, UNKNOWN_BIAS, DIM]
    assert fastest(levels, 0.4) is DIM and fastest(levels, 0.05) is cheap
    assert fastest(levels, 0.02) is FULL and FULL.seconds(0.02) == pytest.approx(2 + 25)
    assert FULL.relative_error(0.02) == pytest.approx(0.02)
    assert fastest([cheap, UNKNOWN_BIAS], 0.02) is None


def test_the_usual_level_stays_within_the_noise_of_costs():
    near, cheap, own = level("near", noise=0.096), level("cheap", noise=0.05), level(OWN, noise=0.098)
    assert fastest([near, FULL], 0.02) is FULL
    assert fastest([near, cheap, FULL], 0.02) is cheap
    assert fastest([near, FULL, own], 0.02) is own
