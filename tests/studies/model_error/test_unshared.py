"""Photons that two traces share: those that never meet what differs, so that a difference has little noise."""

from dataclasses import replace

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.scene import Scene, load_scene
from nailoptics.studies.model_error.paired import unshared_photons

pytestmark = pytest.mark.jit


def prototype(*left_out: str) -> Scene:
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    return scene.model_copy(update={"light": scene.light.model_copy(update={"left_out": left_out})})


@pytest.fixture(scope="module")
def whole(chosen_jit):
    return nail.trace(prototype(), photons=60_000, seed=7)


@pytest.fixture(scope="module")
def boneless(chosen_jit):
    return nail.trace(prototype("bone"), photons=60_000, seed=7)


def test_photons_that_never_meet_the_bone_are_the_same_without_it(whole, boneless):
    """Rationale: a photon's random numbers are its own, whatever the lives before it in its lane.
    Expected: all but the few that meet the bone are shared, and the traces differ by the others alone."""
    a, b = unshared_photons(whole, boneless)
    bone = whole.absorbers.index("bone")
    trace, rest = whole.traces[0], a.traces[0]
    met = int((trace.path_mm[:, bone] > 0).sum())
    # Besides those in the bone, those that its face reflects: a few percent; and single ones by rounding.
    assert met <= len(rest.weight) <= 1.3 * met + 5 < 0.1 * len(trace.weight)
    difference = boneless.at().detected_fraction - whole.at().detected_fraction
    # What both have cancels, up to the order of summation.
    apart_difference = b.at().detected_fraction - a.at().detected_fraction
    assert np.allclose(difference, apart_difference, rtol=0, atol=1e-12)
    noise = np.hypot(a.at().detected_fraction_stderr, b.at().detected_fraction_stderr)
    assert (noise < 0.7 * whole.at().detected_fraction_stderr).all()


@pytest.mark.slow
def test_the_difference_of_traces_with_common_photons_is_that_of_independent_ones(whole, boneless):
    """Expected: over several seeds, paired differences and independent ones agree within their errors."""
    paired, other = [], []
    for seed in range(20, 24):
        with_bone, without = (nail.trace(prototype(*parts), photons=50_000, seed=seed) for parts in ((), ("bone",)))
        alone = nail.trace(prototype("bone"), photons=50_000, seed=seed + 100)
        one = with_bone.at().detected_fraction.sum()
        paired.append(float(without.at().detected_fraction.sum() / one - 1))
        other.append(float(alone.at().detected_fraction.sum() / one - 1))
    spread = [np.std(values, ddof=1) / 2 for values in (paired, other)]
    assert abs(np.mean(paired) - np.mean(other)) < 4 * np.hypot(*spread)


def test_other_seeds_share_nothing(chosen_jit):
    one, other = (nail.trace(prototype(), photons=8192, seed=seed) for seed in (7, 8))
    a, b = unshared_photons(one, other)
    assert 0 < len(a.traces[0].weight) == len(one.traces[0].weight)
    assert len(b.traces[0].weight) == len(other.traces[0].weight)


def test_a_trace_shares_all_with_itself(whole):
    a, b = unshared_photons(whole, replace(whole))
    assert len(a.traces[0].weight) == len(b.traces[0].weight) == 0
