"""What an answer of some error costs: bias and noise together, the fastest within an error, the best within a time."""

import math

import pytest

from nailoptics.studies.model_error.answers import Bias, Cost, Level, best, fastest, percent


def level(name: str, *, bound: float = 0.0, signal: float = 0.0, noise: float = 0.1, fixed: float = 2.0) -> Level:
    """A traced level: bound on the bias of reading and signal, noise after one second, seconds before the photons."""
    return Level(
        name=name,
        backend="llvm",
        reading=Bias(bound, 0.0, bound),
        signal=Bias(signal, 0.0, signal),
        first=Cost(fixed, 1.0),
        states=Cost(0.0, 0.01),
        layouts=Cost(1000 * fixed, 1000.0),
        reading_noise=noise,
        signal_noise=2 * noise,
    )


FULL = level("full")
FORMULA = Level("formula", "numpy", None, Bias(0.3, 0.0, 0.3), Cost(1e-5), Cost(1e-4), Cost(1e-2))


def test_bias_and_standard_error_add_in_squares():
    biased = level("biased", bound=0.03, signal=0.01)
    assert biased.error("reading", 100.0) == pytest.approx(math.hypot(0.03, 0.1 / 10))
    assert biased.error("signal", 100.0) == pytest.approx(math.hypot(0.01, 0.2 / 10))
    assert biased.error("both", 100.0) == biased.error("reading", 100.0)
    # As many photons as needed, and no more; below the bias no number is enough.
    for judge, error in (("reading", 0.05), ("signal", 0.02), ("both", 0.05)):
        needed = biased.photon_seconds(judge, error)
        assert biased.error(judge, needed) == pytest.approx(error)
    assert biased.photon_seconds("reading", 0.029) == math.inf


def test_what_a_level_does_not_tell_it_cannot_answer():
    """Expected: a formula without a reading at rest answers for the signal alone, at once or never."""
    assert FORMULA.photon_seconds("signal", 0.31) == 0 and FORMULA.photon_seconds("signal", 0.29) == math.inf
    assert FORMULA.error("signal", 0.0) == 0.3
    for judge in ("reading", "both"):
        assert FORMULA.error(judge, 0.0) == math.inf and FORMULA.photon_seconds(judge, 0.9) == math.inf
        assert FORMULA.seconds_within(judge, 0.9) == math.inf
    assert FORMULA.seconds_within("signal", 0.31) == 1e-5 and FORMULA.seconds_within("signal", 0.29) == math.inf
    assert FULL.seconds_within("reading", 0.02) == pytest.approx(27.0)


def test_the_fastest_within_an_error():
    cheap = level("cheap", bound=0.03, noise=0.03)
    levels = [FULL, cheap, FORMULA]
    assert fastest(levels, 0.4, "signal").level is FORMULA
    assert fastest(levels, 0.05, "reading").level is cheap
    found = fastest(levels, 0.02, "reading")
    assert found.level is FULL and found.seconds() == pytest.approx(2 + 25) and found.relative_error == 0.02
    assert found.seconds("states") == pytest.approx(0.25) and found.seconds("layouts") == pytest.approx(27_000)
    assert fastest([cheap], 0.02, "reading") is None


def test_the_usual_level_stays_unless_another_is_cheaper_beyond_the_noise_of_costs():
    near, cheap = level("near", noise=0.096), level("cheap", noise=0.05)
    assert fastest([near, FULL], 0.02, "reading", usual=["full"]).level is FULL
    assert fastest([near, cheap, FULL], 0.02, "reading", usual=["full"]).level is cheap
    # The first of the usual that will do.
    assert fastest([near, FULL], 0.02, "reading", usual=["none", "near", "full"]).level is near


def test_the_best_within_a_time():
    levels = [FULL, level("cheap", bound=0.03, noise=0.03), FORMULA]
    assert best(levels, 1.0, "signal").level is FORMULA and best(levels, 1.0, "reading") is None
    assert best(levels, 3.0, "reading").level.name == "cheap"
    found = best(levels, 102.0, "reading")
    assert found.level is FULL and found.error == pytest.approx(0.01) and found.seconds() == pytest.approx(102.0)


@pytest.mark.parametrize(
    ("value", "stderr", "words"),
    [
        (-0.402, 0.0338, "-40.2 +- 3.4%"),
        (-7.4e-5, 1.8e-5, "-0.0074 +- 0.0018%"),
        (0.31, 1.2, "+31 +- 120%"),
        (0.01, math.inf, "+1.00 +- inf%"),
        (0.0, 0.0, "0%"),
    ],
)
def test_no_error_is_rounded_to_none(value, stderr, words):
    assert percent(value, stderr) == words
