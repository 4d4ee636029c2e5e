"""Intervals have their nominal coverage: every engine and estimator, over hundreds of small runs."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from small_scenes import finger, phantom

import nailoptics as nail
from nailoptics import tissue
from nailoptics.assets import data_dir
from nailoptics.light import Transfer, optics, read_rest
from nailoptics.light.backend import ENGINES, Backend
from nailoptics.light.board_map import Arrivals, BoardTracer, PhotonMap, blood_point, readings
from nailoptics.light.tracing import trace_scene
from nailoptics.light.tracing.stopping import LedStoppingCriterion
from nailoptics.light.tracing.trace_scene import LedSource, LightEngine, take_batches
from nailoptics.light.transfer.records import ENERGY, LedTrace, joined
from nailoptics.light.transfer.series import read_replicates, readings_over_states
from nailoptics.light.walk.finger import FingerTracer
from nailoptics.paper.reduced_optics import fit_curve
from nailoptics.scene import Accuracy, Scene, load_scene, parse_scene
from nailoptics.sensor import information
from nailoptics.statistics import jackknife, leave_one_out, stderr_of_mean

FINGER = finger(
    {"name": "proximal", "position_mm": [0.6, -1.2], "size_mm": [2.0, 2.0]},
    {"name": "distal", "position_mm": [0.6, 1.2], "size_mm": [2.0, 2.0]},
    leds=({"wavelength_nm": 800.0, "fwhm_nm": 30.0},),
    touch={"force_n": 1.0},
    board={"barrier": False},
    electronics={"feedback_ohm": 1e4},
)
# A value and its standard error, each of any shape, by the estimator's name.
Estimates = dict[str, tuple[np.ndarray, np.ndarray]]
RUNS = [
    pytest.param(40, id="40 runs", marks=pytest.mark.long),
    pytest.param(300, id="300 runs", marks=pytest.mark.slow),
]


def slab(u_mm: float, mu_a_per_mm: float = 0.2) -> Scene:
    layer = {"thickness_mm": 2.0, "mu_a_per_mm": mu_a_per_mm, "g": 0.5}
    return parse_scene(phantom(layer, photodiodes=[{"position_mm": [u_mm, 0.0]}]))


def covers(runs: list[Estimates], truth: Estimates) -> None:
    """68 and 95 % intervals cover the truth as often as that, within chance, and values are unbiased."""
    assert runs
    for name, (value, _) in truth.items():
        z = np.array([(run[name][0] - value) / run[name][1] for run in runs])
        assert np.isfinite(z).all(), name
        count = len(runs)
        for limit, nominal in ((1.0, 0.683), (1.96, 0.95)):
            # Errors of one run may be correlated: chance is that of the runs.
            result, chance = float(np.mean(np.abs(z) < limit)), math.sqrt(nominal * (1 - nominal) / count)
            assert abs(result - nominal) < 3.5 * chance, (name, limit, result)
        assert np.abs(z.mean(0)).max() < 4.5 / math.sqrt(count), (name, z.mean(0))


def small_traces(
    scene: Scene, tracer: Any, backend: str, *, runs: int, photons: int
) -> tuple[list[Transfer], Transfer]:
    """Many small traces of a scene's first LED, and all of them as one."""
    engine, traces = tracer(scene), []
    for seed in range(runs):
        traces.append(engine.batch(0, photons=photons, seed=1000 + seed))
    small = [Transfer(scene, (trace,), backend) for trace in traces]
    return small, Transfer(scene, (joined(traces),), backend)


def of_trace(transfer: Transfer) -> Estimates:
    """Everything that is offered of one trace of a finger, with its standard error."""
    rest, other = transfer.at(), transfer.at(blood_fraction=[0.05, 0.01], so2=0.8)
    bed = {"absorber": "bed_1"}
    states = np.linspace([0.03, 0.03], [0.06, 0.015], 9)
    moved = readings_over_states(transfer, states)
    out = {
        "reading": (rest.detected_fraction.values, rest.detected_fraction_stderr.values),
        "other state": (other.detected_fraction.values, other.detected_fraction_stderr.values),
        "mean path": (rest.mean_path_mm.sel(bed).values, rest.mean_path_mm_stderr.sel(bed).values),
        "derivative": (rest.derivative_mm.sel(bed).values, rest.derivative_mm_stderr.sel(bed).values),
        "change": (moved.change[..., -1], moved.change_stderr[..., -1]),
    }
    led = transfer.scene.leds[0]
    wavelength, _ = optics.spectrum(led)
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=states)
    blood = np.asarray(tissue.blood_mu_a_per_mm(wavelength, 0.97))
    reading, path_mm = read_replicates(transfer, 0, mu_a, blood)
    ratio = reading[..., -1] / reading[..., 0]
    x, rows = states[:, 0], reading[:, 0]
    fitted = fit_curve(x, rows[0], curved=True).replicates(x, rows)[:, -1] / reading[:, 0, 0]
    for name, values in (
        ("ratio of states", ratio),
        ("predicted path", path_mm[..., 0]),
        ("fit of (8)", fitted),
    ):
        out[name] = (values[0], jackknife(values))
    return out


@pytest.mark.jit
@pytest.mark.parametrize("runs", RUNS)
def test_intervals_of_everything_read_from_a_trace_of_a_finger(jit_backend, runs):
    small, whole = small_traces(parse_scene(FINGER), FingerTracer, jit_backend.name, runs=runs, photons=8192)
    covers([of_trace(one) for one in small], of_trace(whole))


def of_several_photodiodes(transfer: Transfer) -> Estimates:
    """What is made of readings that share photons: by their covariance, and by groups of photons."""
    x, covariance = transfer.at().detected_fraction.values[0], transfer.covariance()[0]
    assert np.allclose(np.sqrt(np.diag(covariance)), transfer.at().detected_fraction_stderr.values[0], rtol=1e-6)
    a, b, n = x[:-1], x[1:], len(x)
    slopes = {"difference": np.eye(n)[:-1] - np.eye(n)[1:], "sum": np.repeat([[1.0, 0.0], [0.0, 1.0]], n // 2, 1)}
    slopes["ratio"] = np.eye(n)[:-1] / b[:, None] - np.eye(n)[1:] * (a / b**2)[:, None]
    values = {"difference": a - b, "sum": slopes["sum"] @ x, "ratio": a / b}
    out = {k: (values[k], np.sqrt(np.einsum("ij,jk,ik->i", s, covariance, s))) for k, s in slopes.items()}
    rest = np.full((1, transfer.scene.zone_count), transfer.scene.blood.rest_blood_fraction)
    wavelength, _ = optics.spectrum(transfer.scene.leds[0])
    mu_a = optics.absorption(transfer.scene, wavelength, blood_fraction=rest)
    read = read_replicates(transfer, 0, mu_a, np.ones(len(wavelength)))[0][..., 0]
    for name, made in (("sum by groups", read @ slopes["sum"].T), ("ratio by groups", read[:, :-1] / read[:, 1:])):
        out[name] = made[0], jackknife(made)
    return out


@pytest.mark.jit
@pytest.mark.parametrize("runs", RUNS)
def test_intervals_of_what_is_made_of_photodiodes_that_share_photons(jit_backend, runs):
    """Expected: intervals of neighbours' differences and ratios and of each array's sum cover the truth; a sum of
    squares over the photodiodes, as of independent readings, would miss a tenth of a sum's error."""
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    small, whole = small_traces(scene, FingerTracer, jit_backend.name, runs=runs, photons=1 << 14)
    each, truth = [of_several_photodiodes(one) for one in small], of_several_photodiodes(whole)
    covers(each, truth)
    stderr = whole.at().detected_fraction_stderr.values.reshape(2, -1)
    for name in ("sum", "sum by groups"):
        mean = np.mean([one[name][1] for one in each], axis=0) / math.sqrt(runs)
        assert (mean > 1.04 * np.linalg.norm(stderr, axis=1)).all(), name


@pytest.mark.jit
@pytest.mark.parametrize("runs", RUNS)
def test_intervals_of_the_map_and_of_the_force_that_a_layout_resolves(jit_backend, runs):
    """Expected: sums over a rectangle by photons, cells of the map by blocks, the resolution by their jackknife."""
    scene = parse_scene(FINGER)
    tracer, point, at = BoardTracer(scene), blood_point(scene, 0), information.operating_point(scene, 0.5)
    areas, outline = list(scene.layout.photodiode_areas), scene.layout.outline

    def mapped(several: list[Arrivals]) -> Estimates:
        one = PhotonMap(outline, values=4, spacing_mm=1.0)
        for arrivals in several:
            one.add(arrivals, point.values(arrivals))
        together = Arrivals.joined(several)
        left = leave_one_out(one.over(areas))
        volts = information.response(left, scene, 0, scene.photodiodes[0], at)
        resolution = information.force_resolution_n(information.fisher_information(volts).sum(-2), at)
        (over_areas,), error_over_areas = readings(together, point.values(together), areas)
        mean, error = one.per_mm2()
        # The cell in which the first photodiode's centre lies.
        u, v = areas[0].center_mm
        cell = np.searchsorted(one.u_mm, u) - 1, np.searchsorted(one.v_mm, v) - 1
        return {
            "rectangle": (over_areas, error_over_areas),
            "cell": (mean[0][cell], error[0][cell]),
            "resolution": (resolution[0], jackknife(resolution)),
        }

    runs_of = [tracer.arrivals(0, photons=12288, seed=seed) for seed in range(runs)]
    covers([mapped([one]) for one in runs_of], mapped(runs_of))


@pytest.mark.jit
@pytest.mark.slow
@pytest.mark.parametrize("engine", ["photons", "volpath"])
def test_intervals_of_each_engine_on_a_phantom(jit_backend, engine):
    scene = slab(0.8)
    chosen = scene.model_copy(update={"light": scene.light.model_copy(update={"engine": engine})})
    truth = nail.trace(scene, photons=4_000_000, seed=10_000).at()
    photons, runs = 4000 if engine == "photons" else 8192, []
    for seed in range(300):
        row = read_rest(chosen, photons=photons, seed=seed).readings[0]
        runs.append({"reading": (np.array([[row["detected_fraction"]]]), np.array([[row["stderr"]]]))})
    covers(runs, {"reading": (truth.detected_fraction.values, truth.detected_fraction_stderr.values)})


@pytest.mark.jit
@pytest.mark.slow
def test_intervals_of_a_trace_that_stopped_at_a_tolerance(jit_backend, monkeypatch):
    """Paths and a reread state of a trace that stopped by its reading, beside the reading."""
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 11)
    scene = slab(2.0)

    def estimates(transfer: Transfer) -> Estimates:
        rest, other = transfer.at(), transfer.at(mu_a_per_mm={"slab": 0.4})
        return {
            "reading": (rest.detected_fraction.values, rest.detected_fraction_stderr.values),
            "path": (rest.mean_path_mm.values, rest.mean_path_mm_stderr.values),
            "state": (other.detected_fraction.values, other.detected_fraction_stderr.values),
        }

    truth = estimates(nail.trace(scene, photons=4_000_000, seed=10_000))
    covers([estimates(nail.trace(scene, relative_error=0.04, seed=seed)) for seed in range(300)], truth)


class Urn:
    """Replaces an engine by one of known mean: each photon is detected with one probability, at a skewed weight."""

    scene = slab(2.0, mu_a_per_mm=0.0)
    batch_photons = 1024
    probability = 0.05
    truth = probability / 4  # the mean of u^3

    def batch(self, led: int, *, photons: int, seed: int) -> LedTrace:
        rng = np.random.default_rng(seed)
        count = int(rng.binomial(photons, self.probability))
        weight = rng.random(count) ** 3
        path_mm = np.zeros((count, 1), np.float32)
        return LedTrace(
            photons,
            np.zeros(1),
            np.arange(count, dtype=np.uint32),
            np.zeros(count, np.uint16),
            weight,
            path_mm,
            dict.fromkeys(ENERGY, (0.0, 0.0)),
            (seed,),
        )


def stopped(seed: int, target: float) -> tuple[float, float]:
    """Relative error, and relative standard error, of a run that stops at a tolerance."""
    urn = Urn()
    rule = LedStoppingCriterion(urn.scene, 0, Accuracy(relative_error=target), full=urn.batch_photons)
    engine = LightEngine(urn.scene, Backend("llvm", None, ENGINES, "made up"))
    engine._opened = urn
    take_batches(LedSource(urn.scene, 0, engine, seed=seed), rule)
    assert rule.met
    trace = rule.trace()
    total = trace.weight.sum()
    error = stderr_of_mean(total, (trace.weight**2).sum(), trace.photons) * trace.photons / total
    return float(total / trace.photons / Urn.truth - 1), float(error)


def stopped_by_few_batches(seed: int, target: float) -> tuple[float, float]:
    """The same by a rule that stops as soon as a few small batches lie close together by chance."""
    urn, seeds = Urn(), np.random.default_rng(seed)
    count, total, square, error = 0, 0.0, 0.0, math.inf
    while error > target:
        mean = float(urn.batch(0, photons=64, seed=int(seeds.integers(1 << 62))).weight.sum()) / 64
        count, total, square = count + 1, total + mean, square + mean**2
        if count > 1 and total > 0:
            variance = max(square - total**2 / count, 0.0) / (count - 1)
            error = math.sqrt(variance * count) / total
    return total / count / Urn.truth - 1, max(error, 1e-9)


def is_calibrated(rule: Callable[[int, float], tuple[float, float]], *, runs: int, target: float) -> bool:
    """Whether stopped runs are biased by a tenth of their error at most, and intervals have nominal coverage."""
    off, error = np.array([rule(seed, target) for seed in range(runs)]).T
    z = np.abs(off / error)
    inside = all(
        abs(np.mean(z < limit) - nominal) < 3.5 * math.sqrt(nominal * (1 - nominal) / runs)
        for limit, nominal in ((1.0, 0.683), (1.96, 0.95))
    )
    return inside and bool((error <= target).all()) and abs(off.mean()) < (0.1 + 3.5 / math.sqrt(runs)) * target


@pytest.mark.long
def test_stopping_at_a_tolerance_does_not_bias_the_result():
    """Rationale: stopping as soon as the estimated error is small enough prefers runs that are low by chance.
    Expected: the bias of many stopped runs is below a tenth of one run's standard error; intervals cover; and the same
    test detects a rule that relies on the spread of two batches."""
    assert is_calibrated(stopped, runs=600, target=0.05)
    assert not is_calibrated(stopped_by_few_batches, runs=300, target=0.05)
