"""Traces of many photons: the error that ends them, the memory that they may fill, and an exact plate."""

import math

import numpy as np
import pytest
from small_scenes import PLAIN_FINGER, phantom

import nailoptics as nail
from nailoptics.errors import NotReachedError
from nailoptics.light import Transfer
from nailoptics.light.tracing import stopping, trace_scene
from nailoptics.light.transfer.records import COLUMNS
from nailoptics.scene import Scene, parse_scene

# Of a broad line, on a larger photodiode beside it.
FINGER = PLAIN_FINGER.replace("800.0", "800.0\nfwhm_nm = 50.0").replace("0.0]\nsize_mm", "-1.6]\nsize_mm")
FINGER = FINGER.replace("[1.0, 0.25]", "[1.0, 1.0]")


def slab(*, mu_a: float = 0.1, mu_s: float = 1.0, n: float = 1.4, size: float = 2.0) -> Scene:
    layer = {"name": "layer", "thickness_mm": 1.0, "mu_a_per_mm": mu_a, "mu_s_per_mm": mu_s, "n": n}
    everywhere = {"name": "all", "position_mm": [0.0, 0.0], "size_mm": [size, size]}
    return parse_scene(phantom(layer, photodiodes=[everywhere]))


def is_true(z: np.ndarray) -> None:
    """Departures in units of their stated errors, (runs,): a normal deviate's mean, spread and share within 1."""
    runs = len(z)
    assert abs(z.mean()) < 4 / math.sqrt(runs)
    # The spread of a sample of n normal deviates has a standard error of 1 / sqrt(2 n).
    assert abs(z.std(ddof=1) - 1) < 4 / math.sqrt(2 * runs)
    assert abs(np.mean(np.abs(z) < 1) - 0.683) < 4 * math.sqrt(0.683 * 0.317 / runs)


@pytest.mark.jit
@pytest.mark.parametrize("required", [{"photons": 100_000}, {"relative_error": 1e-4}])
def test_a_trace_that_fills_the_memory_ends_with_what_it_has(jit_backend, monkeypatch, required):
    monkeypatch.setattr(stopping, "MAX_BYTES", 1e5)
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    with pytest.raises(NotReachedError, match=r'LED "beam" fill .* of memory after \d+ photons') as caught:
        nail.trace(slab(), **required)
    (recorded,) = caught.value.result.traces
    assert 1e5 < sum(getattr(recorded, column).nbytes for column in COLUMNS) < 3e5


@pytest.mark.jit
@pytest.mark.parametrize("which", ["phantom", pytest.param("finger", marks=pytest.mark.long)])
def test_the_error_that_stops_a_trace_is_the_one_that_is_read(jit_backend, monkeypatch, which):
    """With a broad line, too, over which the state at rest is not the traced one."""
    scene, target = (slab(), 0.01) if which == "phantom" else (parse_scene(FINGER), 0.016)
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    reports = []
    traced = nail.trace(scene, relative_error=target, seed=2, progress=reports.append)
    result = traced.at().squeeze()
    error = float(result.detected_fraction_stderr / result.detected_fraction)
    assert error == pytest.approx(reports[-1].relative_error, rel=1e-9) and 0.5 * target < error <= target


@pytest.mark.jit
def test_a_trace_out_of_time_reports_the_error_of_the_reading(jit_backend, monkeypatch):
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    reports = []
    with pytest.raises(NotReachedError, match="max_seconds") as caught:
        nail.trace(slab(), relative_error=1e-5, max_seconds=0.5, progress=reports.append)
    result = caught.value.result.at().squeeze()
    error = float(result.detected_fraction_stderr / result.detected_fraction)
    assert error == pytest.approx(reports[-1].relative_error, rel=1e-9)


def plate(mu_a: float) -> float:
    """Reflectance of a plate of n 4, 1 mm thick, at normal incidence: all orders of its ghosts (Fresnel)."""
    r, t = (3 / 5) ** 2, math.exp(-mu_a)
    return r + (1 - r) ** 2 * r * t**2 / (1 - r**2 * t**2)


def plate_errors(traced: Transfer) -> list[float]:
    """Departures of a clear plate's reflectance in units of their errors, at rest and at two absorptions."""
    z = []
    for mu_a in (0.0, 0.01, 0.3):
        result = traced.at(mu_a_per_mm={"layer": mu_a}).squeeze()
        z.append(float((result.detected_fraction - plate(mu_a)) / result.detected_fraction_stderr))
        if mu_a == 0.0:
            ideal = math.sqrt((1 / plate(0.0) - 1) / traced.photons)
            error = float(result.detected_fraction_stderr / result.detected_fraction)
            assert error == pytest.approx(ideal, rel=0.02)
    return z


@pytest.mark.long
@pytest.mark.jit
def test_a_clear_plate_reads_its_exact_reflectance(jit_backend, monkeypatch):
    """Expected: errors as small as the photons allow, and intervals that hold the plate's exact reflectance."""
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    scene = slab(mu_a=0.0, mu_s=0.0, n=4.0, size=1000.0)
    z = []
    for seed in range(40):
        traced = nail.trace(scene, photons=50_000, seed=seed)
        z.append(plate_errors(traced))
    for column in np.array(z).T:
        is_true(column)
