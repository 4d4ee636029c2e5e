"""Errors and bounds of differences that few photons carry: synthetic photons, of known truth."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import chi2

from nailoptics.light import Transfer
from nailoptics.statistics import Z95, magnitude_bound_95
from nailoptics.studies.model_error.paired import (
    UNDETECTED,
    Difference,
    PairedReadings,
    _expected_next_fraction,
    difference,
)

PHOTONS, DIODES = 20_000, 200


def drawn(draw: np.random.Generator, *, arrive: float, carry: float, depth: float) -> Difference:
    """Photons of as many alike photodiodes: weights of exponential paths, some of which lose a part by a depth.

    arrive : how many of the photons a photodiode detects; carry : how many of these lose something.
    depth : mean of the exponential optical depth that they lose; inf where they are lost whole.
    """
    count = draw.poisson(arrive, DIODES)
    photodiode = np.repeat(np.arange(DIODES), count)
    weight = draw.exponential(size=len(photodiode))
    pressed = weight * np.exp(-0.05 * draw.exponential(size=len(weight)))
    left = np.exp(-depth * draw.exponential(size=len(weight))) if np.isfinite(depth) else 0.0
    left = np.where(draw.random(len(weight)) < carry, left, 1.0)
    traces = SimpleNamespace(photon=np.arange(len(photodiode)), photodiode=photodiode, photons=PHOTONS, seeds=(0,))
    transfer = cast(Transfer, SimpleNamespace(traces=(traces,), photodiodes=tuple(map(str, range(DIODES)))))
    parts = np.column_stack([weight, pressed]) / PHOTONS
    return difference(PairedReadings(transfer, (parts,)), PairedReadings(transfer, (parts * left[:, None],)))


@pytest.mark.parametrize(
    ("arrive", "carry", "depth"),
    [
        (120, 0.025, 1.0),
        (150, 0.02, 0.5),
        (400, 0.02, np.inf),
        (120, 0.075, np.inf),
        (200, 1.0, 1e-3),
        (1000, 0.1, 0.1),
    ],
)
def test_errors_and_bounds_of_what_few_photons_carry(arrive, carry, depth):
    """Rationale: of some three carriers the error is estimated as badly as the value. Expected: of 2000 photodiodes,
    intervals have about their nominal coverage, bounds, which are one-sided, more; and the error is what
    the values scatter by where ten photons carry the change, at most twice that where three do."""
    draw, truth = np.random.default_rng(6), -carry * (depth / (1 + depth) if np.isfinite(depth) else 1.0)
    result = [drawn(draw, arrive=arrive, carry=carry, depth=depth) for _ in range(10)]
    ratio, stderr = (np.concatenate([getattr(one.reading, name)[0] for one in result]) for name in ("value", "stderr"))
    z = (ratio - truth) / stderr
    assert np.isfinite(z).all()
    held = np.concatenate([one.reading.bound[0] for one in result]) >= abs(truth)
    assert (np.abs(z) < Z95).mean() > 0.915 and held.mean() > 0.95, ((np.abs(z) < Z95).mean(), held.mean())
    scatter = ratio.std() / np.sqrt(np.mean(stderr**2))
    assert (0.75 if arrive * carry > 7 else 0.45) < scatter < 1.05, scatter
    # What photons lose is no part of their modulation here: that stays, within the reported error.
    swing = np.concatenate([one.signal.value[0] for one in result])
    errors = np.concatenate([one.signal.stderr[0] for one in result])
    assert (np.abs(swing) < Z95 * errors).mean() > 0.92


def test_the_bound_of_a_count_is_the_exact_one():
    """Expected: with the term for one that was not detected, the upper limit of 95 % of a Poisson count within half of
    one, from 1 on; of none, 3, which is the limit of one side (Garwood 1936, Biometrika 28, 437)."""
    counts = np.array([1, 2, 3, 5, 10, 30, 100, 1000, 10_000])
    exact = chi2.ppf(0.975, 2 * (counts + 1)) / 2
    assert np.abs(magnitude_bound_95(counts, np.hypot(np.sqrt(counts), UNDETECTED), 1.0) - exact).max() < 0.52
    assert magnitude_bound_95(0, UNDETECTED) == pytest.approx(-np.log(0.05), abs=0.01)
    # It is the same on either side of 0.
    assert np.isnan(magnitude_bound_95(np.inf, np.inf)) and np.isinf(magnitude_bound_95(1.0, np.inf))
    assert (
        magnitude_bound_95(-10.0, 3.0, -1.0) == magnitude_bound_95(10.0, 3.0, 1.0) > magnitude_bound_95(10.0, 3.0, -1.0)
    )


def test_the_next_photon_is_like_the_others_the_more_of_them_there_are():
    """Expected: lost whole without data, as the others in the mean with many, and between these the mean of draws of
    a depth whose scale is estimated from so few only."""
    assert _expected_next_fraction(np.array([0.0]), np.array([0.0])) == 1
    assert _expected_next_fraction(np.array([1e4]), np.array([1e-3])) == pytest.approx(1e-3, rel=1e-3)
    draw = np.random.default_rng(1)
    for carriers, taken in ((1.0, 0.5), (2.5, 0.5), (10.0, 0.1), (40.0, 1e-3)):
        scale = carriers * taken / draw.gamma(carriers, size=400_000)
        drawn = np.minimum(scale * draw.exponential(size=400_000), 1)
        assert _expected_next_fraction(np.array([carriers]), np.array([taken])) == pytest.approx(drawn.mean(), rel=0.02)
