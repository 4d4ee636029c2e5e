"""One trace read at other states: against fresh traces, finite differences, and what is merged and stored."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from small_scenes import SMALL_FINGER, phantom

import nailoptics as nail
from nailoptics import io
from nailoptics.errors import InputError
from nailoptics.light import ReweightWarning, Transfer, optics
from nailoptics.light.transfer import mean_of_leds
from nailoptics.light.transfer.records import LedTrace, joined
from nailoptics.light.walk.layered import LayeredTracer
from nailoptics.scene import Scene, parse_scene
from nailoptics.statistics import Z95


def two_layers(*, upper: float = 0.05, lower: float = 0.1, photodiodes: int = 2, led: dict | None = None) -> Scene:
    """A nearly clear plate on a deep bed, read by squares 1.5 and 2.5 mm from a beam."""
    optics = {"g": 0.8, "n": 1.4}
    layers = [
        optics | {"name": "upper", "thickness_mm": 0.5, "mu_a_per_mm": upper},
        optics | {"name": "lower", "thickness_mm": np.inf, "mu_a_per_mm": lower, "mu_s_per_mm": 8.0},
    ]
    squares = [{"name": f"p{i}", "position_mm": [1.5 + i, 0.0], "size_mm": [1.0, 1.0]} for i in range(photodiodes)]
    return parse_scene(phantom(*layers, leds=[led or {}], photodiodes=squares))


@pytest.fixture(scope="module")
def traced(chosen_jit) -> Transfer:
    return nail.trace(two_layers(), photons=1 << 18, seed=1)


def small(weights: np.ndarray, paths: np.ndarray, *, photons: int = 1000, seeds: tuple[int, ...] = (1,)) -> LedTrace:
    """A trace made by hand, of one photodiode."""
    return LedTrace(
        photons=photons,
        mu_a=np.zeros(paths.shape[1]),
        photon=np.arange(len(weights), dtype=np.uint16),
        photodiode=np.zeros(len(weights), np.uint16),
        weight=weights,
        path_mm=paths.astype(np.float32),
        energy={name: (1.0, 1.0) for name in ("reflected", "transmitted", "absorbed", "lost")},
        seeds=seeds,
    )


def by_hand(trace: LedTrace) -> Transfer:
    return Transfer(two_layers(photodiodes=1), (trace,), "none", versions={"nailoptics": "0"}, events=1)


def test_sums_are_those_of_the_definition():
    """w exp(-sum mu_a L) over all emitted photons, its standard error, its mean path and its derivative."""
    rng = np.random.default_rng(0)
    weight, path = rng.uniform(0.5, 1, 400), rng.exponential(3.0, (400, 2)).astype(np.float32)
    result = by_hand(small(weight, path)).at(mu_a_per_mm={"upper": 0.02, "lower": 0.05}).squeeze()
    w = np.concatenate([weight * np.exp(-path @ np.array([0.02, 0.05])), np.zeros(600)])
    every = np.concatenate([path, np.zeros((600, 2))])
    assert float(result.detected_fraction) == pytest.approx(w.mean(), rel=1e-12)
    assert float(result.detected_fraction_stderr) == pytest.approx(w.std(ddof=1) / np.sqrt(1000), rel=1e-6)
    assert float(result.effective_photons) == pytest.approx(w.sum() ** 2 / (w**2).sum(), rel=1e-12)
    assert result.mean_path_mm.values == pytest.approx((w @ every) / w.sum(), rel=1e-6)
    assert result.derivative_mm.values == pytest.approx(-(w @ every) / 1000, rel=1e-6)
    expected = (w[:, None] * every).std(axis=0, ddof=1) / np.sqrt(1000)
    assert result.derivative_mm_stderr.values == pytest.approx(expected, rel=1e-6)


def test_the_standard_error_of_a_mean_path_is_that_of_resampling():
    rng = np.random.default_rng(1)
    weight, path = rng.uniform(0.1, 1, 2000), rng.exponential(3.0, (2000, 2))
    result = by_hand(small(weight, path, photons=2000)).at(mu_a_per_mm={"upper": 0.0, "lower": 0.0}).squeeze()
    picks = rng.integers(0, 2000, (800, 2000))
    means = np.array([weight[p] @ path[p] / weight[p].sum() for p in picks])
    assert result.mean_path_mm_stderr.values == pytest.approx(means.std(axis=0), rel=0.1)


# Of some seeds, or by another backend, few photons make up the error of the state farthest away.
@pytest.mark.filterwarnings("ignore::nailoptics.light.ReweightWarning")
@pytest.mark.jit
@pytest.mark.parametrize(("upper", "lower"), [(0.05, 0.3), (0.0, 0.05), (0.2, 0.02)])
def test_another_state_meets_a_fresh_trace_of_it(jit_backend, traced, upper, lower):
    reread = traced.at(mu_a_per_mm={"upper": upper, "lower": lower})
    fresh = nail.trace(two_layers(upper=upper, lower=lower), photons=1 << 18, seed=77).at()
    for name in ("detected_fraction", "mean_path_mm", "derivative_mm"):
        difference = reread[name] - fresh[name]
        assert np.all(abs(difference) < 3.5 * np.hypot(reread[f"{name}_stderr"], fresh[f"{name}_stderr"])), name
    assert np.all(reread.detected_fraction_stderr < 0.02 * reread.detected_fraction)


@pytest.mark.jit
def test_the_derivative_is_the_limit_of_finite_differences(traced):
    """Expected: the error of central differences of the same photons falls with the square of their step."""
    state = {"upper": 0.05, "lower": 0.1}
    exact = traced.at(mu_a_per_mm=state).derivative_mm
    for absorber, value in state.items():
        errors = []
        for step in (0.02, 0.01, 0.005):
            up, down = (traced.at(mu_a_per_mm=state | {absorber: value + s}).detected_fraction for s in (step, -step))
            errors.append(float(abs((up - down) / (2 * step) / exact.sel(absorber=absorber) - 1).max()))
        order = np.log2(np.divide(errors[:-1], errors[1:]))
        assert order == pytest.approx(2.0, abs=0.1) and errors[-1] < 1e-2


@pytest.mark.jit
def test_the_derivative_meets_the_difference_of_two_fresh_traces(jit_backend, traced):
    step = 0.05
    ends = [
        nail.trace(two_layers(lower=0.1 + s), photons=1 << 18, seed=50 + i).at() for i, s in enumerate((-step, step))
    ]
    slope = (ends[1].detected_fraction - ends[0].detected_fraction) / (2 * step)
    spread = np.hypot(*(end.detected_fraction_stderr for end in ends)) / (2 * step)
    # What a central difference leaves out, from the same photons.
    up, down = (traced.at(mu_a_per_mm={"lower": 0.1 + s}).detected_fraction for s in (step, -step))
    here = traced.at().sel(absorber="lower")
    bias = (up - down) / (2 * step) - here.derivative_mm
    assert np.all(abs(slope - bias - here.derivative_mm) < 3.5 * np.hypot(spread, here.derivative_mm_stderr))
    assert np.all(spread < 0.05 * abs(slope))


@pytest.mark.jit
def test_a_small_change_is_sharper_than_either_reading(traced):
    """Rationale: states share their photons, so that their noise goes out of a difference.
    Expected: the change for 10 % of absorption matches its first and second order far within the reading's error."""
    before, after = traced.at(), traced.at(mu_a_per_mm={"lower": 0.11})
    change = after.detected_fraction - before.detected_fraction
    assert np.all(change < 0)
    first_order = 0.005 * (before.derivative_mm + after.derivative_mm).sel(absorber="lower")
    assert np.all(abs(change - first_order) < 0.01 * abs(change))


@pytest.mark.jit
def test_merged_traces_are_one_trace_of_all_their_photons(jit_backend, traced):
    other = nail.trace(two_layers(), photons=1 << 17, seed=2)
    merged = traced.merge(other)
    a, b, both = traced.at(), other.at(), merged.at()
    assert merged.photons == traced.photons + other.photons and merged.events == traced.events + other.events
    assert merged.cpu_seconds == traced.cpu_seconds + other.cpu_seconds
    mean = (2 * a.detected_fraction + b.detected_fraction) / 3
    assert both.detected_fraction.values == pytest.approx(mean.values, rel=1e-12)
    spread = np.hypot(2 * a.detected_fraction_stderr, b.detected_fraction_stderr) / 3
    assert both.detected_fraction_stderr.values == pytest.approx(spread.values, rel=1e-3)
    expected = (2 * traced.energy()["reflected"]["value"] + other.energy()["reflected"]["value"]) / 3
    assert merged.energy()["reflected"]["value"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.jit
def test_traces_that_share_a_seed_are_not_merged(jit_backend, traced):
    with pytest.raises(InputError, match="share seeds"):
        traced.merge(nail.trace(two_layers(), photons=1 << 10, seed=1))
    with pytest.raises(InputError, match="share"):
        traced.merge(traced)
    more = nail.trace(two_layers(), photons=1 << 10, seed=2)
    with pytest.raises(InputError, match="share"):
        traced.merge(more).merge(more)


@pytest.mark.jit
def test_traces_of_different_light_are_not_merged(jit_backend, traced):
    for other in (two_layers(upper=0.06), two_layers(photodiodes=1), two_layers(led={"flux_mw": 2.0})):
        with pytest.raises(InputError, match="different scenes, engines"):
            traced.merge(nail.trace(other, photons=1 << 10, seed=9))
    with pytest.raises(InputError, match="absorption"):
        traced.merge(nail.trace(two_layers(), traced=two_layers(upper=0.04), photons=1 << 10, seed=9))
    with pytest.raises(InputError, match="engines"):
        traced.merge(replace(traced, engine="other"))


@pytest.mark.jit
def test_a_stored_transfer_reads_as_before(traced, tmp_path):
    path = tmp_path / "new" / "transfer.nc"
    traced.save(path)
    again = Transfer.load(path)
    assert [p.name for p in path.parent.iterdir()] == ["transfer.nc"]
    assert again.at(mu_a_per_mm={"lower": 0.2}).identical(traced.at(mu_a_per_mm={"lower": 0.2}))
    assert again.energy() == traced.energy() and again.scene == traced.scene
    for name in (
        "photodiodes",
        "absorbers",
        "engine",
        "backend",
        "versions",
        "cpu_seconds",
        "wall_seconds",
        "events",
        "photons",
    ):
        assert getattr(again, name) == getattr(traced, name), name
    for a, b in zip(again.traces, traced.traces, strict=True):
        assert a.seeds == b.seeds
        for name in ("photodiode", "weight", "path_mm", "mu_a"):
            assert getattr(a, name).dtype == getattr(b, name).dtype
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    with pytest.raises(InputError, match="share"):
        again.merge(traced)


@pytest.mark.jit
def test_a_transfer_without_detected_light_is_stored_too(jit_backend, tmp_path):
    nothing = nail.trace(two_layers(photodiodes=0), photons=1 << 10, seed=1)
    nothing.save(tmp_path / "nothing.nc")
    again = Transfer.load(tmp_path / "nothing.nc")
    assert again.energy() == nothing.energy() and again.photodiodes == ()


def test_files_that_are_no_transfer_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.nc").write_text("no")
    for name in ("text.nc", "none.nc"):
        with pytest.raises(InputError, match="not a transfer") as caught:
            Transfer.load(tmp_path / name)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(InputError, match="cannot be written"):
        by_hand(small(np.ones(3), np.ones((3, 2)))).save(tmp_path / "text.nc" / "below.nc")


@pytest.fixture(scope="module")
def finger() -> Transfer:
    """A finger of synthetic light, to be read in any blood state."""
    scene = parse_scene(SMALL_FINGER)
    rng, count = np.random.default_rng(0), len(optics.absorbers(scene))
    trace = small(rng.random(200), rng.exponential(1.0, (200, count)))
    return Transfer(scene, (trace,), "none", versions={"nailoptics": "0"})


def test_states_of_blood_and_saturation_are_a_dimension(finger):
    blood, so2 = [[0.03, 0.03], [0.02, 0.05], [0.01, 0.0]], [0.9, 0.95, 0.97]
    both, one, other = finger.at(blood, so2), finger.at(so2=so2), finger.at(blood_fraction=blood)
    for result, states in (
        (both, zip(blood, so2, strict=True)),
        (one, ((None, each) for each in so2)),
        (other, ((each, None) for each in blood)),
        (finger.at([0.03, 0.02], so2), (([0.03, 0.02], each) for each in so2)),
    ):
        assert result.sizes["state"] == 3 and result.wavelength_nm.dims == ("led",)
        for k, state in enumerate(states):
            assert result.isel(state=k).identical(finger.at(*state))
    assert finger.at(so2=[0.9]).sizes["state"] == 1 and "state" not in finger.at(so2=0.9).dims


@pytest.mark.parametrize(
    ("blood", "so2"),
    [
        ([[0.03, 0.02]] * 3, [0.9, 0.8]),
        (np.full((2, 2, 2), 0.03), None),
        (None, [[0.9]]),
        (None, []),
        (None, [0.9, 1.2]),
        ([0.03, 0.02, 0.01], None),
        (0.03, None),
        ([[0.03], [0.02, 0.01]], None),
        ([0.03, float("nan")], None),
    ],
)
def test_blood_of_another_shape_is_refused_in_one_line(finger, blood, so2):
    with pytest.raises(InputError, match="blood_fraction|so2") as caught:
        finger.at(blood, so2)
    assert len(str(caught.value).splitlines()) == 1


def test_no_standard_error_is_given_for_few_photons():
    """0 +- 0 passes for exact: of a dark photodiode, of an absorber that few photons visit, of light that was lost."""
    rng, photons = np.random.default_rng(0), 100_000
    path = rng.exponential(3.0, (400, 2))
    path[20:, 0] = 0.0
    lit = small(rng.random(400), path, photons=photons)
    lit = replace(lit, energy=lit.energy | {"lost": (0.0, 0.0), "reflected": (3.0, 3.0)})
    transfer = Transfer(two_layers(photodiodes=2), (lit,), "none", versions={"nailoptics": "0"})
    result = transfer.at().squeeze()
    lit, dark = result.isel(photodiode=0), result.isel(photodiode=1)
    assert float(lit.detected_fraction_stderr) > 0 and np.isnan(lit.upper_limit_95)
    for name in ("mean_path_mm_stderr", "derivative_mm_stderr"):
        assert np.isnan(lit[name][0]) and lit[name][1] > 0, name
        assert np.isnan(dark[name]).all(), name
    assert float(dark.detected_fraction) == 0 and np.isnan(dark.detected_fraction_stderr)
    assert float(dark.upper_limit_95) == pytest.approx(3 / photons, rel=0.01)
    energy = transfer.energy()
    assert energy["lost"]["stderr"] == pytest.approx(3 / photons / Z95, rel=0.01)
    assert energy["reflected"]["stderr"] == pytest.approx(np.sqrt(3) / photons, rel=0.01)


@pytest.mark.long
@pytest.mark.jit
def test_intervals_of_95_percent_hold_for_few_photons(jit_backend):
    """Readings, mean paths and derivatives of 200 traces so short that some photodiodes detect a handful of photons."""
    scene = two_layers(upper=0.3, photodiodes=4)
    tracer, count, low, high, known = LayeredTracer(scene), 200, 0, 0, 0
    runs = []
    for seed in range(count):
        trace = tracer.batch(0, photons=1 << 11, seed=seed)
        runs.append(Transfer(scene, (trace,), "llvm", versions={"nailoptics": "0"}))
    merged = replace(runs[0], traces=(joined([run.traces[0] for run in runs]),))
    truth, result = merged.at(), xr.concat([run.at() for run in runs], "run")
    for name in ("detected_fraction", "mean_path_mm", "derivative_mm"):
        off = ((result[name] - truth[name]) / result[f"{name}_stderr"]).values
        known += np.isfinite(off).sum()
        low, high = low + (off < -Z95).sum(), high + (off > Z95).sum()
    assert known > 1000 and np.isnan(result.detected_fraction_stderr).any()
    assert 0.92 < 1 - (low + high) / known < 0.97


def _rewrite(path, change) -> None:
    header, arrays = io.unpack(path.read_bytes())
    change(header, arrays)
    path.write_bytes(io.pack(header, arrays))


@pytest.mark.parametrize(
    "change",
    [
        lambda header, arrays: arrays.update(weight=arrays["weight"] * np.nan),
        lambda header, arrays: arrays.update(photodiode=arrays["photodiode"] + np.uint16(9)),
        lambda header, arrays: arrays.update(path_mm=arrays["path_mm"][:, :1]),
        lambda header, arrays: arrays.update(mu_a_per_mm=arrays["mu_a_per_mm"][:, :1]),
        lambda header, arrays: header.update(leds=header["leds"] * 2),
        lambda header, arrays: header.update(leds=3),
        lambda header, arrays: header["leds"][0].update(photons=0),
        lambda header, arrays: header["leds"][0]["energy"].pop("lost"),
        lambda header, arrays: header.update(version_table=None),
    ],
)
def test_a_file_of_wrong_content_is_refused_in_one_line(change, tmp_path):
    path = tmp_path / "light.npz"
    rng = np.random.default_rng(0)
    by_hand(small(rng.random(50), rng.random((50, 2)))).save(path)
    Transfer.load(path)
    _rewrite(path, change)
    with pytest.raises(InputError, match="not a transfer that this version can read"):
        Transfer.load(path)


@pytest.mark.jit
def test_a_state_too_far_away_warns(traced):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traced.at(mu_a_per_mm={"lower": 0.2})
    with pytest.warns(ReweightWarning, match=r'photodiode "p[01]".*effective photons'):
        traced.at(mu_a_per_mm={"upper": 200.0, "lower": 50.0})


def deep_tissue(mu_a_per_mm: float) -> Scene:
    layer = {"name": "deep", "thickness_mm": np.inf, "mu_a_per_mm": mu_a_per_mm, "mu_s_per_mm": 10.0, "g": 0.9}
    everywhere = {"name": "all", "position_mm": [0.0, 0.0], "size_mm": [1000.0, 1000.0]}
    return parse_scene(phantom(layer | {"n": 1.0}, photodiodes=[everywhere]))


@pytest.mark.long
@pytest.mark.jit
def test_a_state_of_far_less_absorption_warns(jit_backend):
    """Rationale: without absorption all light comes back from deep tissue, much of it by paths so long that a trace
    with absorption has detected hardly any; the few that it has outweigh all others. Weights have no finite variance
    where their tail index exceeds 1/2: an eighth of the absorption makes it 3/4, less in what a trace has detected.
    Expected: a warning where reading and error are wrong, and none where both are right; of twelve traces more than
    three are off by more than three errors, most of them in fact, where of calibrated ones none in thirty would be;
    three of the thirteen here by more than five."""
    off = {}
    for seed in (*range(12), 74):
        deep = nail.trace(deep_tissue(0.1), photons=1 << 17, seed=seed)
        for less in (0.0, 0.00625, 0.0125):
            with pytest.warns(ReweightWarning, match='photodiode "all".*tail index 0.*a check has few$'):
                wrong = deep.at(mu_a_per_mm={"deep": less}).squeeze()
            # Nothing absorbs, so that all comes back.
            if not less:
                off[seed] = float((1 - wrong.detected_fraction) / wrong.detected_fraction_stderr)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            deep.at(mu_a_per_mm={"deep": 0.025})
    assert np.sum(np.array(list(off.values())) > 3) > 3, off
    assert min(off[seed] for seed in (1, 2, 74)) > 5, off
    for near in (0.05, 0.2):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reread = deep.at(mu_a_per_mm={"deep": near})
        fresh = nail.trace(deep_tissue(near), photons=1 << 17, seed=4).at()
        spread = np.hypot(reread.detected_fraction_stderr, fresh.detected_fraction_stderr)
        assert abs(reread.detected_fraction - fresh.detected_fraction) < 4 * spread < 0.05 * fresh.detected_fraction


@pytest.mark.jit
def test_an_absorber_that_is_none_is_refused(traced):
    with pytest.raises(InputError, match="known: upper, lower"):
        traced.at(mu_a_per_mm={"bed": 0.1})
    for wrong in (-0.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match="mu_a_per_mm of lower"):
            traced.at(mu_a_per_mm={"lower": wrong})
    with pytest.raises(InputError, match="has no blood"):
        traced.at(blood_fraction=[0.03, 0.02])


@pytest.mark.jit
def test_datasets_carry_units_errors_and_their_scene(traced):
    result = traced.at()
    for name in ("detected_fraction", "mean_path_mm", "derivative_mm"):
        assert result[name].attrs["ancillary_variables"] == f"{name}_stderr" and result[name].attrs["units"]
        assert result[f"{name}_stderr"].attrs["long_name"].startswith("standard error")
    assert parse_scene(result.attrs["scene"]) == traced.scene
    assert result.attrs["Conventions"].startswith("CF-") and result.attrs["photons"] == traced.photons


def test_parts_of_the_light_of_several_leds_have_the_error_of_a_mean():
    by_led = [{"lost": (0.2, 0.03)}, {"lost": (0.4, 0.04)}]
    assert mean_of_leds(by_led)["lost"] == {"value": pytest.approx(0.3), "stderr": pytest.approx(0.025)}
