"""Photons that two traces share: those that never meet what differs, so that a difference has little noise."""

from dataclasses import replace

import numpy as np
import pytest

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.geometry import AROUND
from nailoptics.scene import Scene, load_scene
from nailoptics.studies.model_error.paired import difference, paired_readings, shared_photons

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


def test_photons_that_never_meet_the_bone_are_the_same_without_it(whole, boneless):
    """Rationale: a photon's random numbers are its own, whatever the lives before it in its lane.
    Expected: all but the few that meet the bone are shared, and the traces differ by the others alone."""
    trace, other = whole.traces[0], boneless.traces[0]
    in_whole, in_boneless = shared_photons(trace, other)
    for name in ("photodiode", "weight", "path_mm"):
        assert np.array_equal(getattr(trace, name)[in_whole], getattr(other, name)[in_boneless])
    assert len(np.unique(in_whole)) == len(in_whole) and len(np.unique(in_boneless)) == len(in_boneless)
    bone = whole.absorbers.index("bone")
    met, apart = int((trace.path_mm[:, bone] > 0).sum()), len(trace.weight) - len(in_whole)
    # Besides those in the bone, those that its face reflects: a few percent; and single ones by rounding.
    assert met <= apart <= 1.3 * met + 5 < 0.1 * len(trace.weight)
    found = difference(paired_readings(whole), paired_readings(boneless))
    ratio = boneless.at().detected_fraction / whole.at().detected_fraction - 1
    assert np.allclose(found.reading.value, ratio, rtol=0, atol=1e-6)
    alone = whole.at().detected_fraction_stderr / whole.at().detected_fraction
    assert (found.reading.stderr < 0.7 * alone).all()


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


def test_other_seeds_share_nothing(chosen_jit):
    one, other = (nail.trace(prototype(), photons=8192, seed=seed) for seed in (7, 8))
    a, b = shared_photons(one.traces[0], other.traces[0])
    assert len(one.traces[0].weight) > 0 and len(a) == len(b) == 0


def test_a_trace_shares_all_with_itself(whole):
    every = np.arange(len(whole.traces[0].weight))
    a, b = shared_photons(whole.traces[0], replace(whole.traces[0]))
    assert np.array_equal(np.sort(a), every) and np.array_equal(np.sort(b), every)


def test_photons_that_look_alike_are_shared_one_by_one(whole):
    """Rationale: light that met no absorber leaves equal records. Expected: as many of them as both traces have."""
    trace = whole.traces[0]
    same = trace.select(np.zeros(len(trace.weight), int))
    three, two = same.select(np.arange(3)), same.select(np.arange(2))
    a, b = shared_photons(three, two)
    assert len(a) == len(b) == 2 == len(set(a.tolist())) == len(set(b.tolist()))
