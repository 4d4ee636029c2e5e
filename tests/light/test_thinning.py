"""Traces of more photons than are kept: nothing at rest depends on what is dropped, and errors elsewhere are true."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from small_scenes import phantom

import nailoptics as nail
from nailoptics.errors import NotReachedError
from nailoptics.light import Transfer, optics
from nailoptics.light.tracing import trace_scene
from nailoptics.light.transfer import records, rest_state
from nailoptics.light.transfer.records import LedTrace, joined
from nailoptics.light.transfer.series import readings_over_states
from nailoptics.scene import Scene, parse_scene

FINGER = """
schema_version = 1
[finger]
[[leds]]
name = "ir"
wavelength_nm = 800.0
fwhm_nm = {fwhm}
position_mm = [-1.2, 0.0]
[[photodiodes]]
name = "near"
position_mm = [0.0, -1.6]
size_mm = [1.0, 1.0]
"""
TRACED = 0.1
# Of the made-up light: how many photons are detected, and their mean path. [mm]
DETECTED, PATH_MM = 1e-4, 3.0
SEEN = ("detected_fraction", "mean_path_mm", "derivative_mm")


def limited(monkeypatch, count: int) -> None:
    """Keep so many photons only."""
    monkeypatch.setattr(records, "MAX_RECORDS", count)


def slab(*, mu_a: float = TRACED, mu_s: float = 1.0, n: float = 1.4, size: float = 2.0) -> Scene:
    layer = {"name": "layer", "thickness_mm": 1.0, "mu_a_per_mm": mu_a, "mu_s_per_mm": mu_s, "n": n}
    everywhere = {"name": "all", "position_mm": [0.0, 0.0], "size_mm": [size, size]}
    return parse_scene(phantom(layer, photodiodes=[everywhere]))


def made_up(seed: int, photons: int, *, scene: Scene | None = None) -> LedTrace:
    """A batch of light whose statistics are known: skewed weights, exponential paths, few photons detected."""
    scene = scene or slab()
    rng = np.random.default_rng(seed)
    count, absorbers = int(rng.binomial(photons, DETECTED)), optics.absorbers(scene)
    path = np.zeros((count, len(absorbers)), np.float32)
    for column in ("layer",) if scene.finger is None else ("bed_1", "bed_2"):
        path[:, absorbers.index(column)] = rng.exponential(PATH_MM, count)
    wavelength = scene.leds[0].wavelength_nm
    return LedTrace(
        photons=photons,
        mu_a=optics.absorption(scene, wavelength)[0],
        photodiode=np.zeros(count, np.uint16),
        weight=rng.random(count) ** 2,
        path_mm=path,
        energy={name: (1.0, 1.0) for name in ("reflected", "transmitted", "absorbed", "lost")},
        seeds=(seed,),
        rest=rest_state(scene, 0),
    )


def light(trace: LedTrace, scene: Scene | None = None) -> Transfer:
    return Transfer(scene or slab(), (trace,), "none")


def expected(mu_a: float) -> dict[str, float]:
    """What is read of the made-up light: weights have a mean of 1/3, and exponential paths stay exponential."""
    fraction = DETECTED / 3 / (1 + (mu_a - TRACED) * PATH_MM)
    path = PATH_MM / (1 + (mu_a - TRACED) * PATH_MM)
    return {"detected_fraction": fraction, "mean_path_mm": path, "derivative_mm": -fraction * path}


def is_true(z: np.ndarray) -> None:
    """Departures in units of their stated errors, (runs,): a normal deviate's mean, spread and share within 1."""
    runs = len(z)
    assert abs(z.mean()) < 4 / math.sqrt(runs)
    # The spread of a sample of n normal deviates has a standard error of 1 / sqrt(2 n).
    assert abs(z.std(ddof=1) - 1) < 4 / math.sqrt(2 * runs)
    assert abs(np.mean(np.abs(z) < 1) - 0.683) < 4 * math.sqrt(0.683 * 0.317 / runs)


def merged(parts: list[LedTrace]) -> LedTrace:
    whole = parts[0]
    for part in parts[1:]:
        whole = joined([whole, part])
    return whole


def test_a_thousand_million_photons_are_as_good_as_that_many(monkeypatch):
    """Rationale: of 1e9 photons 1e5 are detected here, of which 2000 at most are kept.
    Expected: the error at rest falls with the root of the photons, to what all records would give."""
    parts = [made_up(seed, 10_000_000) for seed in range(100)]
    everything = light(joined(parts)).at().squeeze()
    limited(monkeypatch, 2000)
    whole, errors = None, []
    for i, part in enumerate(parts, 1):
        whole = joined([whole, part]) if whole else part
        if i in (1, 10, 100):
            seen = light(whole).at().squeeze()
            errors.append(float(seen.detected_fraction_stderr / seen.detected_fraction))
    assert whole.photons == 10**9 and len(whole.weight) <= 2000 and whole.keep <= 1 / 32
    assert all(a / b == pytest.approx(math.sqrt(10), rel=0.1) for a, b in pairwise(errors))
    for name in SEEN:
        for one in (name, f"{name}_stderr"):
            assert float(seen[one]) == pytest.approx(float(everything[one]), rel=1e-9), one
    assert float(seen.effective_photons) == pytest.approx(float(everything.effective_photons), rel=1e-9)


@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
def test_errors_at_every_state_are_true(monkeypatch):
    """Expected: over many traces of 64 merges each, readings, paths and slopes lie around the truth as they state;
    near rest they are nearly as sharp as with all records, and far from it never worse than the sample alone."""
    limited(monkeypatch, 1000)
    states = (TRACED, TRACED + 0.02, 0.5, 2.0, 0.03)
    found: dict[tuple[float, str], list[float]] = {(s, n): [] for s in states for n in SEEN}
    ratios: dict[float, list[float]] = {s: [] for s in states}
    for run in range(80):
        parts = [made_up(1000 * run + i, 2_000_000) for i in range(64)]
        thin = merged(parts)
        assert thin.keep == 1 / 16
        alone = replace(thin, full=None, rest=None)
        for state in states:
            seen, sample = (light(t).at(mu_a_per_mm={"layer": state}).squeeze() for t in (thin, alone))
            for name in SEEN:
                off = float(seen[name]) - expected(state)[name]
                found[state, name].append(off / float(seen[f"{name}_stderr"]))
            ratios[state].append(float(seen.detected_fraction_stderr / sample.detected_fraction_stderr))
    for values in found.values():
        is_true(np.array(values))
    # The whole light is 16 times the sample, so its error is a quarter.
    assert np.mean(ratios[TRACED]) == pytest.approx(0.25, rel=0.03)
    assert np.mean(ratios[TRACED + 0.02]) < 0.27
    assert np.mean(ratios[TRACED + 0.02]) < np.mean(ratios[0.5]) < np.mean(ratios[2.0]) < 1


def test_the_order_of_merging_does_not_matter(monkeypatch):
    """Expected: the same photons are kept, each for as many, however the batches came together."""
    limited(monkeypatch, 500)
    parts = [made_up(seed, 1_000_000) for seed in range(40)]
    ways = [
        merged(parts),
        merged(parts[::-1]),
        joined(parts),
        joined([merged(parts[:3]), joined(parts[3:25]), merged(parts[25:])]),
    ]
    own = {float(draw): float(weight) for part in parts for draw, weight in zip(part.draw, part.weight, strict=True)}
    for one in ways:
        assert one.keep == ways[0].keep < 1 and 250 / 2 < len(one.weight) <= 500
        assert np.array_equal(np.sort(one.draw), np.sort(ways[0].draw))
        # Every record stands for the same number of photons.
        assert all(w * one.keep == own[float(d)] for w, d in zip(one.weight, one.draw, strict=True))
        for name, value in vars(one.full).items():
            assert value == pytest.approx(getattr(ways[0].full, name), rel=1e-12), name


def test_a_trace_below_the_limit_keeps_every_bit():
    parts = [made_up(seed, 1_000_000) for seed in range(3)]
    whole = joined(parts)
    assert whole.keep == 1.0 and whole.full is None
    for name in ("photodiode", "weight", "path_mm"):
        assert np.array_equal(getattr(whole, name), np.concatenate([getattr(part, name) for part in parts]))


@pytest.mark.long
def test_a_course_reads_what_each_state_reads(monkeypatch):
    """Expected: a course over blood states and single states are one estimate with one error; a change's error is
    true, and at rest there is none."""
    scene = parse_scene(FINGER.format(fwhm=30.0))
    limited(monkeypatch, 1000)
    states = np.array([[0.03, 0.03], [0.05, 0.02], [0.1, 0.1]])
    rest = scene.blood.rest_blood_fraction
    z = []
    for run in range(100):
        parts = [made_up(100 * run + i, 4_000_000, scene=scene) for i in range(20)]
        thin = light(joined(parts), scene)
        assert thin.traces[0].keep < 1
        moved = readings_over_states(thin, states)
        if run == 0:
            for k, state in enumerate(states):
                one = thin.at(state).squeeze()
                assert moved.fraction[0, 0, k] == pytest.approx(float(one.detected_fraction), rel=1e-9)
                assert moved.stderr[0, 0, k] == pytest.approx(float(one.detected_fraction_stderr), rel=1e-6)
            still = readings_over_states(thin, np.array([[rest, rest], [0.1, 0.1]]))
            assert still.fraction[0, 0, 0] == pytest.approx(thin.traces[0].full.fraction[0], rel=1e-12)
            assert still.change[0, 0, 0] == still.change_stderr[0, 0, 0] == 0
        # The light is known: paths in both zones are exponential and independent.
        wavelength, share = optics.spectrum(scene.leds[0])
        more = optics.absorption(scene, wavelength, blood_fraction=states) - thin.traces[0].mu_a
        beds = [thin.absorbers.index(name) for name in ("bed_1", "bed_2")]
        truth = DETECTED / 3 * (share / np.prod(1 + more[..., beds] * PATH_MM, -1)).sum(-1)
        z.append((moved.change[0, 0, 2] - (truth[2] - truth[0])) / moved.change_stderr[0, 0, 2])
    is_true(np.array(z))


def test_a_thinned_trace_is_stored_and_continued(monkeypatch, tmp_path):
    limited(monkeypatch, 300)
    parts = [made_up(seed, 2_000_000) for seed in range(6)]
    light(joined(parts[:5])).save(tmp_path / "thin")
    again = Transfer.load(tmp_path / "thin")
    for state in ({}, {"layer": 0.3}):
        assert again.at(mu_a_per_mm=state).identical(light(joined(parts[:5])).at(mu_a_per_mm=state))
    more = again.merge(light(parts[5])).traces[0]
    at_once = joined(parts)
    assert np.array_equal(more.draw, at_once.draw) and np.array_equal(more.weight, at_once.weight)
    assert more.full.weight == pytest.approx(at_once.full.weight, rel=1e-12)


@pytest.mark.jit
@pytest.mark.parametrize("which", ["phantom", pytest.param("finger", marks=pytest.mark.long)])
def test_the_error_that_stops_a_trace_is_the_one_that_is_read(jit_backend, monkeypatch, which):
    """With a broad line, too, over which the state at rest is not the traced one."""
    limited(monkeypatch, 300)
    scene, target = (slab(), 0.01) if which == "phantom" else (parse_scene(FINGER.format(fwhm=50.0)), 0.016)
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    told = []
    traced = nail.trace(scene, relative_error=target, seed=2, progress=told.append)
    seen = traced.at().squeeze()
    error = float(seen.detected_fraction_stderr / seen.detected_fraction)
    assert traced.traces[0].keep < 1
    assert error == pytest.approx(told[-1].relative_error, rel=1e-9) and 0.5 * target < error <= target


@pytest.mark.jit
def test_a_trace_out_of_time_tells_the_error_that_is_read(jit_backend, monkeypatch):
    limited(monkeypatch, 300)
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    told = []
    with pytest.raises(NotReachedError, match="max_seconds") as caught:
        nail.trace(slab(), relative_error=1e-5, max_seconds=0.5, progress=told.append)
    seen = caught.value.result.at().squeeze()
    error = float(seen.detected_fraction_stderr / seen.detected_fraction)
    assert error == pytest.approx(told[-1].relative_error, rel=1e-9)


def plate(mu_a: float) -> float:
    """Reflectance of a plate of n 4, 1 mm thick, at normal incidence: all orders of its ghosts (Fresnel)."""
    r, t = (3 / 5) ** 2, math.exp(-mu_a)
    return r + (1 - r) ** 2 * r * t**2 / (1 - r**2 * t**2)


def plate_errors(traced: Transfer) -> list[float]:
    """Departures of a clear plate's reflectance in units of their errors, at rest and at two absorptions."""
    z = []
    for mu_a in (0.0, 0.01, 0.3):
        seen = traced.at(mu_a_per_mm={"layer": mu_a}).squeeze()
        z.append(float((seen.detected_fraction - plate(mu_a)) / seen.detected_fraction_stderr))
        if mu_a == 0.0:
            ideal = math.sqrt((1 / plate(0.0) - 1) / traced.photons)
            error = float(seen.detected_fraction_stderr / seen.detected_fraction)
            assert error == pytest.approx(ideal, rel=0.02)
    return z


@pytest.mark.long
@pytest.mark.jit
def test_a_clear_plate_far_past_the_limit(jit_backend, monkeypatch):
    """Expected: errors as small as the photons allow, and intervals that hold the plate's exact reflectance."""
    limited(monkeypatch, 1000)
    monkeypatch.setattr(trace_scene, "PHANTOM_BATCH_PHOTONS", 1 << 12)
    scene = slab(mu_a=0.0, mu_s=0.0, n=4.0, size=1000.0)
    z = []
    for seed in range(40):
        traced = nail.trace(scene, photons=100_000, seed=seed)
        assert len(traced.traces[0].weight) <= 1000
        z.append(plate_errors(traced))
    for column in np.array(z).T:
        is_true(column)


@pytest.mark.jit
@pytest.mark.slow
def test_a_clear_plate_past_the_real_limit(jit_backend):
    """6e7 photons, of which 3.2e7 are detected and 8e6 at most kept."""
    traced = nail.trace(slab(mu_a=0.0, mu_s=0.0, n=4.0, size=1000.0), photons=60_000_000, seed=1)
    assert traced.traces[0].keep == 1 / 4
    assert max(map(abs, plate_errors(traced))) < 4
