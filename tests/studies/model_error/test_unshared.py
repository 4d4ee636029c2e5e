"""Photons that two traces share: those that never meet what differs, so that a difference has little noise."""

from dataclasses import replace

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.geometry import AROUND
from nailoptics.light import Transfer
from nailoptics.scene import Scene, load_scene
from nailoptics.studies.model_error.paired import difference, paired_readings, weighted_mean

pytestmark = pytest.mark.jit


def prototype(*left_out: str) -> Scene:
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    return scene.model_copy(update={"light": scene.light.model_copy(update={"left_out": left_out})})


@pytest.fixture(scope="module")
def whole(chosen_jit):
    return nail.trace(prototype(), with_faces=AROUND, photons=60_000, seed=7)


@pytest.fixture(scope="module")
def boneless(chosen_jit):
    return nail.trace(prototype("bone"), with_faces=AROUND, photons=60_000, seed=7)


def same_records(one: Transfer, other: Transfer) -> np.ndarray:
    """Which records of the first LED of one trace are in another, bit for bit, (n,) bool."""
    pairs = [t.photon.astype(int) * len(one.photodiodes) + t.photodiode for t in (one.traces[0], other.traces[0])]
    _, i, j = np.intersect1d(*pairs, return_indices=True)
    same = np.zeros(len(pairs[0]), bool)
    columns = ((getattr(one.traces[0], name)[i], getattr(other.traces[0], name)[j]) for name in ("weight", "path_mm"))
    same[i] = np.all([(a == b).reshape(len(i), -1).all(1) for a, b in columns], axis=0)
    return same


def test_photons_that_never_meet_the_bone_are_the_same_without_it(whole, boneless):
    """Rationale: a photon's random numbers are its own, whatever the lives before it in its lane.
    Expected: all but the few that meet the bone are shared, and the traces differ by the others alone."""
    same, paths = same_records(whole, boneless), whole.traces[0].path_mm
    met = paths[:, whole.absorbers.index("bone")] > 0
    # Besides those in the bone, those that its face reflects, and copies of either: a few percent.
    assert not (same & met).any() and met.any()
    assert met.sum() <= (~same).sum() <= 1.3 * met.sum() + 5 < 0.1 * len(same)
    result = difference(paired_readings(whole), paired_readings(boneless))
    ratio = boneless.at().detected_fraction / whole.at().detected_fraction - 1
    assert np.allclose(result.reading.value, ratio, rtol=0, atol=1e-6)
    alone = whole.at().detected_fraction_stderr / whole.at().detected_fraction
    assert (result.reading.stderr < 0.7 * alone).all()


@pytest.mark.long
def test_standard_errors_of_a_mean_over_photodiodes_are_calibrated(chosen_jit):
    """Rationale: copies of one photon at several photodiodes have correlated errors. Expected: over 24 seeds the mean
    change by the bone scatters by its standard error, which a sum of squares over the photodiodes would not be."""
    means, errors, sums = [], [], []
    for seed in range(100, 124):
        base, other = (
            paired_readings(nail.trace(prototype(*parts), with_faces=AROUND, photons=1 << 13, seed=seed))
            for parts in ((), ("bone",))
        )
        change = difference(base, other).reading
        weight = np.full(change.value.shape, 1 / change.value.size)
        means.append(change.value.mean())
        errors.append(np.sqrt(change.covariance.mean()))
        sums.append(np.linalg.norm(weight * change.stderr))
    # Of 24 values the scatter is estimated to a seventh.
    assert 0.7 < np.std(means, ddof=1) / np.sqrt(np.mean(np.square(errors))) < 1.4
    assert np.mean(errors) > 1.1 * np.mean(sums)


@pytest.mark.slow
def test_paired_and_independent_differences_agree(whole, boneless):
    """Expected: over several seeds, paired differences and independent ones agree within their errors."""
    paired, other = [], []
    for seed in range(20, 24):
        with_bone, without = (
            nail.trace(prototype(*parts), with_faces=AROUND, photons=50_000, seed=seed) for parts in ((), ("bone",))
        )
        alone = nail.trace(prototype("bone"), photons=50_000, seed=seed + 100)
        one = with_bone.at().detected_fraction.sum()
        paired.append(float(without.at().detected_fraction.sum() / one - 1))
        other.append(float(alone.at().detected_fraction.sum() / one - 1))
    spread = [np.std(values, ddof=1) / 2 for values in (paired, other)]
    assert abs(np.mean(paired) - np.mean(other)) < 4 * np.hypot(*spread)


def test_other_seeds_share_nothing(whole):
    other = nail.trace(prototype(), with_faces=AROUND, photons=60_000, seed=8)
    assert not same_records(whole, other).any()
    result = difference(*(base := [paired_readings(one) for one in (whole, other)])).reading
    ratio = 1 + result.value
    assert np.allclose(result.stderr, ratio * np.hypot(*(one.relative_stderr for one in base)), rtol=0.01)


def test_a_trace_shares_all_with_itself(whole):
    again = replace(whole, traces=tuple(replace(trace) for trace in whole.traces))
    assert same_records(whole, again).all()
    result = difference(paired_readings(whole), paired_readings(again)).reading
    assert not result.value.any() and weighted_mean(result, paired_readings(whole))[0] == 0
