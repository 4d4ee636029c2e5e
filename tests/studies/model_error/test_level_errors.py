"""Standard errors of the reported errors of levels are the scatter over other seeds."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.scene import Scene
from nailoptics.statistics import Z95
from nailoptics.studies.model_error.explain import ONE_WAVELENGTH, revised
from nailoptics.studies.model_error.paired import Estimates, PairedReadings, paired_readings, reweighted
from nailoptics.studies.model_error.tradeoff import CHEAPER, FULL, Level, bias_of, formulas, measured

PHOTONS, SEEDS = 40_000, range(24)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return revised(load_scene(data_dir("scenes") / "prototype.toml"), FULL)


@pytest.fixture(scope="module")
def traced(chosen_jit, scene) -> list[PairedReadings]:
    return [paired_readings(nail.trace(scene, photons=PHOTONS, seed=seed)) for seed in SEEDS]


def pull(values: np.ndarray, errors: np.ndarray) -> float:
    """Root mean square of distances from the mean over the seeds, in standard errors; 1 where these are calibrated."""
    away = (values - values.mean(0)) / errors * np.sqrt(len(values) / (len(values) - 1))
    return float(np.sqrt(np.mean(away**2)))


def assert_pull_of_one(result: list[dict[str, Level]], name: str, which: str) -> None:
    """A pull of 1 within the 45 % that three times the chance of 24 seeds is."""
    biases = [getattr(one[name], which) for one in result]
    value, stderr = (np.array([getattr(b, field) for b in biases]) for field in ("value", "stderr"))
    assert 0.55 < pull(value, stderr) < 1.45, (name, which, pull(value, stderr))


def test_intervals_and_bounds_of_a_bias_have_their_nominal_coverage():
    """Rationale: the reported error of a level is a mean over photodiodes and what none of them exceeds. Expected: of
    400 draws of readings with known errors, 95 % of the intervals cover the mean, and of the bounds the largest."""
    draw, errors = np.random.default_rng(4), np.array([[0.01, 0.02, 0.02, 0.05]])
    truth, held = np.array([[0.03, -0.05, 0.0, 0.02]]), []
    for shared in (0.0, 0.3):
        for _ in range(400):
            base = cast(PairedReadings, SimpleNamespace(relative_stderr=errors))
            noisy = truth * (1 + shared * draw.normal()) + errors * draw.normal(size=errors.shape)
            result = bias_of(base, Estimates(noisy, errors), shared=shared)
            mean = float(np.average(truth, weights=errors**-2.0))
            held.append((abs(result.value - mean) < Z95 * result.stderr, result.bound >= np.abs(truth).max()))
    assert (np.mean(held, axis=0) > 0.93).all(), np.mean(held, axis=0)


@pytest.mark.slow
@pytest.mark.jit
def test_errors_of_readings_and_modulations(traced):
    """Expected: of 24 seeds and eight photodiodes, a pull of 1 within 15 % (three times what chance leaves)."""
    levels, modulations = (np.array([getattr(one, name) for one in traced]) for name in ("level", "modulation"))
    errors = np.array([one.relative_stderr for one in traced]) * levels
    assert pull(levels, errors) == pytest.approx(1, abs=0.15)
    assert pull(modulations, np.array([one.modulation_stderr for one in traced])) == pytest.approx(1, abs=0.15)


@pytest.mark.slow
@pytest.mark.jit
def test_errors_of_the_bias_of_formulas_and_one_wavelength(traced, scene):
    """Expected: the reported errors are what other seeds scatter by, of every level without photons of its own."""
    result = []
    for base in traced:
        narrow = measured(scene, "one wavelength", base, reweighted(base, revised(scene, ONE_WAVELENGTH)))
        result.append({one.name: one for one in (narrow, *formulas(scene, base))})
    for which in ("reading", "signal"):
        assert_pull_of_one(result, "one wavelength", which)
    for name in ("Taylor (9)", "Beer-Lambert (8)"):
        assert_pull_of_one(result, f"{name}, traced", "signal")


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("name", ["no bone either", "similarity"])
def test_errors_of_the_bias_of_walked_levels(traced, scene, name):
    """Expected: as above, for a level that shares most photons with the reference, and for one that shares none."""
    other = revised(scene, CHEAPER[name])
    result = []
    for seed, base in zip(SEEDS, traced, strict=True):
        walked = paired_readings(nail.trace(other, photons=PHOTONS, seed=seed))
        result.append({name: measured(scene, name, base, walked)})
    for which in ("reading", "signal"):
        assert_pull_of_one(result, name, which)
