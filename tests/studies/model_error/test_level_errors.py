"""Standard errors of what levels are told to be off by are the spread that other seeds show."""

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene
from nailoptics.statistics import jackknife
from nailoptics.studies.model_error.levels import Bench, diffusion, formulas
from nailoptics.studies.model_error.paired import PairedReadings, PairedTracer, paired_readings
from nailoptics.studies.model_error.stored_map import StoredMap

pytestmark = [pytest.mark.slow, pytest.mark.jit]
PHOTONS, SEEDS = 40_000, range(24)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(data_dir("scenes") / "prototype.toml")


@pytest.fixture(scope="module")
def traced(chosen_jit, scene) -> list[PairedReadings]:
    return [paired_readings(nail.trace(scene, photons=PHOTONS, seed=seed)) for seed in SEEDS]


def pull(values: np.ndarray, errors: np.ndarray) -> float:
    """Root mean square of distances from the mean over the seeds, in standard errors; 1 where these are true."""
    away = (values - values.mean(0)) / errors * np.sqrt(len(values) / (len(values) - 1))
    return float(np.sqrt(np.mean(away**2)))


def test_errors_of_readings_and_modulations(traced):
    """Expected: of 24 seeds and eight photodiodes, a pull of 1 within 15 % (three times what chance leaves)."""
    levels, modulations = (np.array([getattr(one, name) for one in traced]) for name in ("level", "modulation"))
    errors = np.array([one.relative_stderr for one in traced]) * levels
    assert pull(levels, errors) == pytest.approx(1, abs=0.15)
    assert pull(modulations, np.array([one.modulation_stderr for one in traced])) == pytest.approx(1, abs=0.15)


def test_errors_of_what_formulas_and_diffusion_are_off_by(traced, scene):
    """Expected: a pull of 1 within the 45 % that three times the chance of 24 seeds is."""
    options = TraceOptions(photons=PHOTONS)
    benches = [Bench(scene, {}, (), (), 0.0, options, PairedTracer(1, options, None), base) for base in traced]
    found = [{one.name: one for bench in [b] for m in (diffusion, formulas) for one in m(bench)} for b in benches]
    for name, which in (
        ("layered diffusion", "reading"),
        ("layered diffusion", "signal"),
        ("Taylor (9), literature", "signal"),
        ("Taylor (9), traced", "signal"),
    ):
        biases = [getattr(one[name], which) for one in found]
        value, stderr = (np.array([getattr(b, field) for b in biases]) for field in ("value", "stderr"))
        assert 0.55 < pull(value, stderr) < 1.45, (name, which)


def test_errors_of_a_stored_map(chosen_jit, scene):
    """Expected: where some 25 photons or more arrived, a pull of 1 within the 25 % that the few of them allow."""
    photons = 4 * PHOTONS
    read = np.array([StoredMap.of(scene, photons=photons, seed=seed, backend="auto").read(scene)[0] for seed in SEEDS])
    relative = np.array([jackknife(one) for one in read[..., 0]]) / read[:, 0, :, 0]
    sure = relative.mean(0) < 0.2
    assert sure.sum() >= 4
    for values in (read[..., 0], read[..., 1] / read[..., 0], read[..., 2] / read[..., 0]):
        errors = np.array([jackknife(one) for one in values])
        assert pull(values[:, 0][:, sure], errors[:, sure]) == pytest.approx(1, abs=0.25)
