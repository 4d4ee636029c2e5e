"""Standard errors of what levels are told to be off by are the spread that other seeds show."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import nailoptics as nail
from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.geometry import build
from nailoptics.light import optics
from nailoptics.light.backend import choose
from nailoptics.light.reference.integrate import FingerPaths
from nailoptics.light.reference.led_readings import bed_absorption
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene
from nailoptics.statistics import Z95, jackknife
from nailoptics.studies.model_error.answers import Level
from nailoptics.studies.model_error.levels import (
    CHEAPER,
    FULL,
    MAP,
    THICKER_PLATE,
    Bench,
    _mapped,
    diffusion,
    formulas,
    one_wavelength,
)
from nailoptics.studies.model_error.paired import PairedReadings, PairedTracer, error_of_ratio, paired_readings
from nailoptics.studies.model_error.stock import StockPass
from nailoptics.studies.model_error.stored_map import StoredMap
from nailoptics.studies.model_error.variants import ONE_WAVELENGTH, revised

PHOTONS, SEEDS = 40_000, range(24)
NEAR = {"proximal": (10, 12), "distal": (3, 5)}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return revised(load_scene(data_dir("scenes") / "prototype.toml"), FULL)


@pytest.fixture(scope="module")
def traced(chosen_jit, scene) -> list[PairedReadings]:
    return [paired_readings(nail.trace(scene, photons=PHOTONS, seed=seed)) for seed in SEEDS]


def pull(values: np.ndarray, errors: np.ndarray) -> float:
    """Root mean square of distances from the mean over the seeds, in standard errors; 1 where these are true."""
    away = (values - values.mean(0)) / errors * np.sqrt(len(values) / (len(values) - 1))
    return float(np.sqrt(np.mean(away**2)))


def benches(scene: Scene, traced: list[PairedReadings]) -> list[Bench]:
    """What levels are measured with, for every seed."""
    made = []
    for seed, base in zip(SEEDS, traced, strict=True):
        options = TraceOptions(photons=PHOTONS, seed=seed)
        made.append(Bench(scene, {}, (), (), 0.0, options, PairedTracer(1, options, None), base))
    return made


def assert_pull_of_one(found: list[dict[str, Level]], name: str, which: str) -> None:
    """A pull of 1 within the 45 % that three times the chance of 24 seeds is."""
    biases = [getattr(one[name], which) for one in found]
    value, stderr = (np.array([getattr(b, field) for b in biases]) for field in ("value", "stderr"))
    assert 0.55 < pull(value, stderr) < 1.45, (name, which, pull(value, stderr))


def test_a_bias_and_its_bound_hold_the_truth_as_often_as_they_say():
    """Rationale: what is told of a level is a mean over photodiodes and what none of them exceeds. Expected: of 400
    draws of readings with known errors, 95 % of the means' intervals hold the mean, and of the bounds the largest."""
    draw, errors = np.random.default_rng(4), np.array([[0.01, 0.02, 0.02, 0.05]])
    truth, held = np.array([[0.03, -0.05, 0.0, 0.02]]), []
    for shared in (0.0, 0.3):
        for _ in range(400):
            base = cast(PairedReadings, SimpleNamespace(relative_stderr=errors))
            bench = cast(Bench, SimpleNamespace(base=base))
            noisy = truth * (1 + shared * draw.normal()) + errors * draw.normal(size=errors.shape)
            found = Bench.bias(bench, noisy, errors, shared=shared)
            mean = float(np.average(truth, weights=errors**-2.0))
            held.append((abs(found.value - mean) < Z95 * found.stderr, found.bound >= np.abs(truth).max()))
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
def test_errors_of_what_formulas_and_diffusion_are_off_by(traced, scene):
    """Expected: the told errors are what other seeds scatter by, of every level without photons of its own."""
    measures = (diffusion, formulas, one_wavelength)
    found = [{one.name: one for m in measures for one in m(bench)} for bench in benches(scene, traced)]
    for which in ("reading", "signal"):
        assert_pull_of_one(found, "layered diffusion", which)
        assert_pull_of_one(found, "one wavelength", which)
    for name in ("Taylor (9)", "Beer-Lambert (8)"):
        for constants in ("literature", "traced"):
            assert_pull_of_one(found, f"{name}, {constants}", "signal")


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("name", ["no bone either", "similarity", THICKER_PLATE])
def test_errors_of_what_walked_levels_are_off_by(traced, scene, name):
    """Expected: as above, for a level that shares most photons with the reference, and for two that share none."""
    thicker = {"finger": {"nail_thickness_mm": 1.1 * scene.finger.nail_thickness_mm}}
    other = revised(scene, CHEAPER.get(name, thicker))
    found = []
    for bench in benches(scene, traced):
        walked = paired_readings(nail.trace(other, photons=PHOTONS, seed=bench.options.seed))
        found.append({name: bench.measured(name, {}, walked)})
    for which in ("reading", "signal"):
        assert_pull_of_one(found, name, which)


def test_a_photodiode_that_saw_too_little_has_the_noise_of_the_others():
    """Rationale: paths weigh alike, so that a variance is in proportion to its reading. Expected: where few came, the
    relative error that so many paths have at what is expected there; where many did, its own."""
    expected = np.array([[4e-3, 1e-3, 1e-4, 1e-4]])
    stderr = np.sqrt(expected * 1e-5) * [[1.0, 1.0, 3.0, 0.0]]
    one = StockPass(expected * [[1.1, 0.9, 2.0, 0.0]], stderr, 1.0, 2.0)
    found, own = one.relative_stderr(expected)[0], stderr[0, :2] / one.level[0, :2]
    assert np.allclose(found[:2], own) and np.isfinite(found).all()
    shared = (stderr**2).sum() / expected.sum()
    assert np.allclose(found[2:], np.sqrt(shared / 1e-4)) and one.effective_paths > 1 / own[0] ** 2


@pytest.mark.slow
@pytest.mark.jit
def test_errors_of_stock_mitsuba(chosen_jit, scene):
    """Expected: of three photodiodes near the LED, each seen by some ten effective paths, a pull of 1 within the 45 %
    that 24 seeds allow, and a mean that is the trace's at that wavelength within four errors of both."""
    finger, narrow = build(scene), revised(scene, ONE_WAVELENGTH)
    rest = np.full((1, optics.zones(scene).count), scene.blood.rest_blood_fraction)
    media = optics.finger_media(scene, finger.regions, scene.leds[0].wavelength_nm)
    bed = bed_absorption(scene, finger, rest, 0)
    paths = FingerPaths(finger, media, bed=bed, led=0, photodiodes=(2, 3, 4), backend=choose("scalar", volpath=True))
    value, stderr = np.moveaxis([paths.spread(paths=4096, seed=seed) for seed in SEEDS], 1, 0)
    trace = paired_readings(nail.trace(narrow, photons=400_000, seed=3))
    level, known = trace.level[:, 2:5], trace.relative_stderr[:, 2:5]
    ratio = value / level - 1
    relative = [
        StockPass(v[None], e[None], 0.0, 1.0).relative_stderr(level)[0] for v, e in zip(value, stderr, strict=True)
    ]
    told = error_of_ratio(ratio, np.array(relative), known)
    assert 0.55 < pull(ratio, told) < 1.45, pull(ratio, told)
    error = np.hypot(ratio.std(0, ddof=1) / np.sqrt(len(ratio)), known[0])
    assert (np.abs(ratio.mean(0)) < 4 * error).all() and (error < 0.15).all(), (ratio.mean(0), error)


@pytest.mark.slow
@pytest.mark.jit
def test_errors_of_a_stored_map(chosen_jit, scene, monkeypatch):
    """Expected: where some 25 photons or more arrived, a pull of 1 within the 25 % that the few of them allow."""
    photons = 4 * PHOTONS
    maps = [StoredMap.of(scene, photons=photons, seed=seed, backend="auto") for seed in SEEDS]
    read = np.array([one.read(scene)[0] for one in maps])
    relative = np.array([jackknife(one) for one in read[..., 0]]) / read[:, 0, :, 0]
    sure = relative.mean(0) < 0.2
    assert sure.sum() >= 4
    for values in (read[..., 0], read[..., 1] / read[..., 0], read[..., 2] / read[..., 0]):
        errors = np.array([jackknife(one) for one in values])
        assert pull(values[:, 0][:, sure], errors[:, sure]) == pytest.approx(1, abs=0.25)
    # And of what the level is told to be off by, where all photodiodes lie near enough to the LED to be seen.
    wired = tuple(one.model_copy(update={"wired": NEAR[one.name]}) for one in scene.photodiodes)
    near, found = scene.model_copy(update={"photodiodes": wired}), []
    traced = [paired_readings(nail.trace(near, photons=PHOTONS, seed=seed)) for seed in SEEDS]
    for one, bench in zip(maps, benches(near, traced), strict=True):
        monkeypatch.setattr(StoredMap, "of", lambda *_, _one=one, **__: _one)
        found.append({MAP: _mapped(bench)})
    for which in ("reading", "signal"):
        assert_pull_of_one(found, MAP, which)
