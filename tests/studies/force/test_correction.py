"""The curve from pressures told to pressures pressed: learned from touches, left alone where none are."""

import numpy as np
import pytest

from nailoptics.studies.force.subject import Correction
from nailoptics.studies.force.uncertainty import fit_correction, no_correction

TIME_S = np.arange(0.0, 60.0, 0.1)
TRUE = 1.0 - np.cos(2 * np.pi * 0.05 * TIME_S)
NONE = (np.empty(0),) * 3


def test_overestimates_are_corrected_on_their_own_side_alone() -> None:
    told = 1.25 * TRUE + 0.08 * np.random.default_rng(0).normal(size=TRUE.size)
    found = Correction(fit_correction(2.6, TIME_S, told, TRUE), fit_correction(2.0, *NONE))
    asked = np.array([[0.4, 1.0, 2.0], [0.4, 1.0, 1.5]])
    assert found.apply(asked)[0] == pytest.approx(asked[0] / 1.25, rel=0.05)
    assert found.apply(asked)[1] == pytest.approx(asked[1], rel=1e-6)


def test_few_samples_move_the_curve_less_than_many() -> None:
    few = slice(0, 30)
    short = fit_correction(2.6, TIME_S[few], 1.5 * TRUE[few], TRUE[few])
    long = fit_correction(2.6, TIME_S, 1.5 * TRUE, TRUE)
    assert short.applied_n_per_cm2[3] > 1.05 * long.applied_n_per_cm2[3]


def test_a_harder_touch_is_never_estimated_as_a_softer_one() -> None:
    folded = np.where(TRUE < 1.0, 2.0 * TRUE, 2.0 + 0.2 * TRUE)
    found = Correction(fit_correction(2.4, TIME_S, folded[::-1], TRUE), fit_correction(2.0, *NONE))
    pressures = np.tile(np.linspace(0.0, 3.0, 200), (2, 1))
    assert (np.diff(found.apply(pressures)) >= -1e-9).all()
    assert no_correction().apply(pressures) == pytest.approx(pressures)
