"""The comparison against synthetic light with a closed-form answer, and once on the prototype."""

import itertools
import json

import numpy as np
import pytest
import xarray as xr
from hostile_names import HOSTILE, assert_text_alone
from listed_variables import assert_listed
from shown import all_shown

from nailoptics import cli, load_scene, tissue
from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import steady_blood
from nailoptics.light import Transfer, optics
from nailoptics.light.transfer.records import LedTrace
from nailoptics.light.transfer.series import GROUPS, read_replicates
from nailoptics.options import TraceOptions
from nailoptics.report.pages import compare as compare_page
from nailoptics.report.pages.compare import page, summary, verdict_line
from nailoptics.scene import Scene
from nailoptics.statistics import Z95, jackknife
from nailoptics.studies import compare as formula_errors
from nailoptics.studies.compare import (
    Over,
    _scattering_slopes,
    compare,
    compare_transfer,
    state_sweep,
    verdict,
)

NO_SCATTERING = np.zeros((2, 1, 8))


def prototype(**led) -> Scene:
    scene = load_scene(data_dir("scenes") / "prototype.toml")
    return scene.model_copy(update={"leds": tuple(one.model_copy(update=led) for one in scene.leds)})


def synthetic(own_mm, other_mm, *, seed: int = 0, scene: Scene | None = None) -> Transfer:
    """A trace of light with given paths in the photodiode's own zone and in the other one, eight photodiodes alike.

    own_mm, other_mm : (n,) float. [mm]
    """
    scene = prototype(fwhm_nm=0.0) if scene is None else scene
    names = optics.absorbers(scene)
    zone = [0, 0, 0, 0, 1, 1, 1, 1]
    n = len(own_mm)
    path = np.zeros((8 * n, len(names)), np.float32)
    for j, own in enumerate(zone):
        rows = slice(j * n, (j + 1) * n)
        path[rows, names.index(f"bed_{own + 1}")] = own_mm
        path[rows, names.index(f"bed_{2 - own}")] = other_mm
    trace = LedTrace(
        photons=10 * n,
        mu_a=optics.absorption(scene, scene.leds[0].wavelength_nm)[0],
        photon=np.random.default_rng(seed).permutation(10 * n)[: 8 * n],
        photodiode=np.repeat(np.arange(8), n),
        weight=np.ones(8 * n),
        path_mm=path,
        energy={name: (0.0, 0.0) for name in ("reflected", "transmitted", "absorbed", "lost")},
        seeds=(seed,),
    )
    return Transfer(scene, (trace,), "none", engine="made up", versions={"numpy": "0"})


def evaluated(transfer: Transfer, *over: Over, slopes: np.ndarray = NO_SCATTERING):
    return compare_transfer(transfer, [state_sweep(transfer.scene, one) for one in over], slopes)


def per_blood(scene: Scene) -> float:
    return float(tissue.blood_mu_a_per_mm(scene.leds[0].wavelength_nm, scene.blood.so2))


def test_light_of_one_path_in_one_zone_is_beer_lambert():
    """Rationale: the paper's assumptions, all met. Expected: (8) exact; (9) in error by its truncation only."""
    transfer = synthetic(np.full(4000, 4.0), np.zeros(4000))
    result = evaluated(transfer, "force", "blood").isel(led=0)
    depth = 4.0 * per_blood(transfer.scene) * result.setting.sel(sweep="blood").values
    assert np.allclose(result.alpha_d2.sel(sweep="blood"), depth, rtol=1e-5)
    assert np.abs(result.error.sel(model="beer_lambert", way="fitted")).max() < 1e-5
    assert np.abs(result.error.sel(model="beer_lambert", way="predicted")).max() < 1e-5
    blood = result.sel(sweep="blood", way="predicted")
    curve, line = (
        blood.model_reading.sel(model=model) / blood.reading[:, :1].values for model in ("beer_lambert", "taylor")
    )
    assert np.allclose(curve, np.exp(-depth), rtol=1e-5) and np.allclose(line, 1 - depth, atol=1e-5)
    exact = (1 - depth - np.exp(-depth)) / (1 - np.exp(-depth[-1]))
    assert np.allclose(blood.error.sel(model="taylor"), exact, atol=1e-5)
    assert np.allclose(blood.part_error.sel(part="truncation"), exact, atol=1e-5)
    assert np.abs(result.part_error.sel(part=["one_path", "both_zones", "blood_scattering"])).max() < 2e-5


def test_a_spread_of_paths_is_separated_from_truncation():
    """Gamma-distributed paths of shape k and scale s read (1 + s x)^-k; the error of (8) by their mean is the rest."""
    shape, scale = 2.0, 2.5
    draw = np.random.default_rng(3).gamma(shape, scale, 20_000)
    transfer = synthetic(draw, np.zeros_like(draw))
    blood = evaluated(transfer, "blood").isel(led=0, sweep=0, photodiode=0)
    # Drawn at rest; without blood longer paths count more: gamma again, of a larger scale.
    scale /= 1 - scale * transfer.scene.blood.rest_blood_fraction * per_blood(transfer.scene)
    x = per_blood(transfer.scene) * blood.setting.values
    traced = (1 + scale * x) ** -shape
    part = (np.exp(-shape * scale * x) - traced) / (1 - traced[-1])
    computed, error = (
        blood[name].sel(way="predicted", part="one_path") for name in ("part_error", "part_error_stderr")
    )
    assert np.all(np.abs(computed - part)[1:] < 4 * error[1:]) and float(error[-1]) < 0.05 * abs(part[-1])
    assert np.abs(blood.part_error.sel(part="both_zones")).max() < 1e-8


def test_blood_that_pools_is_arterial_to_light_and_formulas_alike():
    """Of one path in one zone Beer-Lambert is exact, whatever the saturation. Expected: readings fall by the absorption
    that the touch over time has, in which blood beyond that at rest is arterial."""
    scene = prototype(wavelength_nm=660.0, fwhm_nm=0.0).with_({"blood.venous_so2": 0.86, "touch.proximal_share": 1.0})
    result = evaluated(synthetic(np.full(3000, 2.0), np.zeros(3000), scene=scene), "force").isel(sweep=0, led=0)
    assert np.abs(result.error.sel(way="predicted", model="beer_lambert")).max() < 1e-5
    blood = steady_blood(scene, result.setting.values)
    mu_a = optics.absorption(scene, 660.0, blood_fraction=blood)[:, 0, optics.bed_columns(scene)[0]]
    expected = np.exp(-2.0 * (mu_a - mu_a[0]))
    assert (result.reading[0] / result.reading[0, 0]).values == pytest.approx(expected, rel=1e-6)


def test_the_error_by_the_other_zone_is_reported_and_vanishes_with_paths_in_both():
    n = 4000
    blood = evaluated(synthetic(np.full(n, 2.0), np.full(n, 6.0)), "blood").isel(led=0, sweep=0)
    exponent = blood.setting.values * per_blood(prototype(fwhm_nm=0.0))
    own, both = np.exp(-2 * exponent), np.exp(-8 * exponent)
    expected = (own - both) / (1 - both[-1])
    assert np.allclose(blood.part_error.sel(way="predicted", part="both_zones"), expected, atol=1e-5)
    assert np.abs(blood.error.sel(way="predicted_both", model="beer_lambert")).max() < 1e-5
    assert np.allclose(blood.bed_alpha_d2, 4 * blood.alpha_d2, rtol=1e-5)


def test_the_parts_add_up_to_the_error_of_taylor():
    draw = np.random.default_rng(5).gamma(2.0, 2.0, (2, 3000))
    result = evaluated(synthetic(*draw), "force", "blood", "saturation", slopes=np.full((2, 1, 8), 0.3))
    total = result.part_error.sel(part=["truncation", "one_path", "both_zones"]).sum("part")
    assert np.allclose(total, result.error.sel(model="taylor"), atol=1e-11)
    assert np.abs(result.part_error.sel(part="blood_scattering")).max() > 0


def test_the_page_names_no_part_that_was_not_estimated():
    """Rationale: a comparison cut off before the bed's scattering was traced has no estimate of it.
    Expected: the largest of the parts that were estimated; none where none was.
    """
    draw = np.random.default_rng(4).gamma(2.0, 2.5, 2000)
    computed = evaluated(synthetic(draw, draw), "blood", slopes=np.full((2, 1, 8), np.nan))
    assert np.isnan(computed.part_error.sel(part="blood_scattering")).any()
    *_, (_, words) = compare_page._cards(computed)
    assert "largest part" in words and "scatters" not in words
    computed["part_error"] = computed.part_error * np.nan
    assert not any("largest part" in words for _, words in compare_page._cards(computed))


def test_a_straight_line_fits_an_exponential_up_to_the_theoretical_limit():
    """Over a depth d the best line misses exp by d / 12 (n - 2) / (n - 1) of the swing, by n points and least squares.

    At 1 % there are 15 of the 41 points: d = 0.129."""
    transfer = synthetic(np.full(4000, 8.0), np.zeros(4000))
    blood = evaluated(transfer, "blood").isel(led=0, sweep=0, photodiode=0)
    depth = float(blood.limit_alpha_d2.sel(way="fitted", model="taylor", within=0.01))
    assert depth == pytest.approx(0.129, rel=0.02)
    depth = float(blood.limit_alpha_d2.sel(way="predicted", model="taylor", within=0.05))
    assert depth == pytest.approx(0.10, rel=0.05)  # the tangent misses half the depth


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_traces():
    """The jackknife's errors against the spread of 30 synthetic traces, for ratios and for a difference of readings."""
    rng = np.random.default_rng(11)
    values, errors = [], []
    for seed in range(30):
        blood = evaluated(synthetic(*rng.gamma(2.0, 2.0, (2, 400)), seed=seed), "blood").isel(
            led=0, sweep=0, photodiode=0
        )
        one = blood.isel(point=-1)
        values.append([*one.part_error.sel(way="predicted").values[:3], float(one.alpha_d2), float(one.path_mm)])
        errors.append(
            [
                *one.part_error_stderr.sel(way="predicted").values[:3],
                float(one.alpha_d2_stderr),
                float(one.path_mm_stderr),
            ]
        )
    ratio = np.mean(errors, 0) / np.std(values, 0, ddof=1)
    assert np.all((ratio > 0.65) & (ratio < 1.5)), ratio


@pytest.mark.slow
def test_printed_intervals_of_a_comparison_have_their_nominal_coverage():
    """Rationale: every number of a comparison has a standard error, every limit a 95 % interval. Expected: over 20
    synthetic traces they cover the value of twenty times the photons in 17 or more (fewer only once in 60 times)."""
    rng = np.random.default_rng(21)

    def computed(photons: int, seed: int) -> xr.Dataset:
        transfer = synthetic(*rng.gamma(2.0, 2.0, (2, photons)), seed=seed)
        # The slope by the bed's scattering comes from traces of its own.
        error = 0.1 * np.sqrt(3_000 / photons)
        slopes = np.stack([0.5 + error * rng.standard_normal((1, 8)), np.full((1, 8), error)])
        return evaluated(transfer, "blood", slopes=slopes).isel(led=0, sweep=0, photodiode=0)

    truth, each = computed(60_000, 77), [computed(3_000, seed) for seed in range(20)]
    for name in ("range_error", "error", "part_error", "alpha_d2", "bed_alpha_d2", "reading"):
        exact, error = (truth[f"{name}{end}"].isel(point=-1) for end in ("", "_stderr"))
        ends = [one.isel(point=-1) for one in each]
        z = [(one[name] - exact) / np.hypot(one[f"{name}_stderr"], error) for one in ends]
        known = [abs(one).fillna(0.0) < Z95 for one in z]
        assert int(sum(known).min()) >= 17, (name, sum(known))
    for name in ("swing", "relative_swing", "path_mm", "path_fitted_mm"):
        z = [abs(one[name] - truth[name]) / np.hypot(one[f"{name}_stderr"], truth[f"{name}_stderr"]) for one in each]
        assert sum(float(one) < Z95 for one in z) >= 17, name
    for name in ("limit", "limit_blood_fraction", "limit_alpha_d2", "limit_bed_alpha_d2"):
        held = sum((one[f"{name}_low"] <= truth[name]) & (truth[name] <= one[f"{name}_high"]) for one in each)
        assert int(held.min()) >= 17, (name, held)


@pytest.mark.slow
@pytest.mark.jit
def test_the_slope_by_the_beds_scattering_has_a_calibrated_standard_error(jit_backend):
    """Expected: over 20 seeds, of photodiodes that some 25 photons or more reach, 95 % intervals cover the slope of
    sixteen times the photons at their nominal rate."""
    scene = prototype(fwhm_nm=0.0)

    def slopes(photons: int, seed: int) -> np.ndarray:
        transfer = synthetic(np.full(photons // 10, 4.0), np.zeros(photons // 10), scene=scene)
        return _scattering_slopes(transfer, TraceOptions(seed=seed), None)[:, 0]

    truth, each = slopes(2_560_000, 99), np.array([slopes(160_000, seed) for seed in range(20)])
    sure = each[:, 1].mean(0) < 0.4
    assert sure.sum() >= 4
    z = ((each[:, 0] - truth[0]) / np.hypot(each[:, 1], truth[1]))[:, sure]
    assert (np.abs(z) < Z95).mean() > 0.87 and 0.7 < np.sqrt(np.mean(z**2)) < 1.3


def test_replicates_include_the_noise_of_the_count():
    """The number of detected photons is random: its error belongs to a reading, not only that of the weights."""
    transfer = synthetic(np.full(10_000, 1.0), np.zeros(10_000))
    mu_a = optics.absorption(transfer.scene, [800.0])[None]
    reading, _ = read_replicates(transfer, 0, mu_a, np.array([0.4]))
    assert reading.shape == (1 + GROUPS, 8, 1) and np.allclose(reading[0], 0.1)
    # Of eight photodiodes by 40 groups each; binomial, of 10 000 in 100 000.
    assert np.mean(jackknife(reading) / 0.1) == pytest.approx(0.01 * np.sqrt(1 - 0.1), rel=0.15)


def test_limits_and_their_intervals():
    setting, error = np.linspace(0, 10, 11), np.linspace(0, 1, 11)
    assert formula_errors.limit(setting, error, np.full(11, 0.1 / Z95), 0.55) == pytest.approx((5.5, 4.5, 6.5, True))
    assert formula_errors.limit(setting, error, np.zeros(11), 2.0) == (10.0, 10.0, 10.0, False)
    assert formula_errors.crossing(setting, error + 1, 0.5) == (0.0, True)


def test_limits_in_a_measure_that_is_traced_have_its_error_too():
    """An error that grows to 10 % over ten points, where alpha D^2 has an error of 0.03."""
    points, shape = np.arange(11.0), (len(formula_errors.WAYS), len(formula_errors.MODELS), 11)
    alpha, error = 0.2 * points, np.full(11, 0.03)
    errors = {"range_error": np.broadcast_to(0.01 * points, shape), "range_error_stderr": np.full(shape, 0.01 / Z95)}
    errors |= {"alpha_d2": alpha, "alpha_d2_stderr": error, "bed_alpha_d2": alpha, "bed_alpha_d2_stderr": 0 * error}
    sweep = formula_errors.StateSweep("blood", points, np.repeat(points[:, None], 2, 1), np.ones(11))
    limits = formula_errors._limits(errors, sweep, 0)
    at = 0, 0, formula_errors.TOLERANCES.index(0.05)
    assert [limits[f"limit{end}"][at] for end in ("", "_low", "_high")] == pytest.approx([5.0, 4.0, 6.0])
    spread = Z95 * 0.03
    expected = [1.0, 0.8 - spread, 1.2 + spread]
    assert [limits[f"limit_alpha_d2{end}"][at] for end in ("", "_low", "_high")] == pytest.approx(expected)
    assert limits["limit_bed_alpha_d2_high"][at] == pytest.approx(1.2)


@pytest.mark.parametrize(("tolerance", "outcome"), [(0.5, "met"), (1e-6, "missed")])
def test_the_verdict_needs_all_readings(tolerance, outcome):
    draw = np.random.default_rng(5).gamma(2.0, 2.0, (2, 3000))
    result = evaluated(synthetic(*draw), "blood")
    assert verdict(result, tolerance).outcome == outcome
    largest = float(result.range_error[..., -1].sel(way="fitted", model="taylor").max())
    assert verdict(result, largest).outcome == "undecided"
    for within in (tolerance, largest, 2 * largest):
        one = verdict(result, within)
        assert (one.surely_within == one.readings) == (one.outcome == "met")
        assert bool(one.undecided) == (one.outcome == "undecided")
        assert f" {100 * within:g} % of the swing" in verdict_line(one)


def test_a_verdict_on_many_readings_has_its_nominal_error_rate():
    """Rationale: of eight photodiodes one lies above a tolerance by chance more often than a single one does.
    Expected: where all errors lie at the tolerance, a model is rejected in at most 5 % of the repeats, and to
    meet it in fewer; where they lie two standard errors above it, it mostly misses; and the worst one is named."""
    rng, outcomes, held = np.random.default_rng(0), {0.05: [], 0.09: [], 0.01: []}, []
    dims, shape = ("sweep", "led", "photodiode", "way", "model", "point"), (1, 1, 8, 1, 1, 1)
    names = {"sweep": ["force"], "led": ["ir"], "photodiode": list("abcdefgh"), "way": ["fitted"], "model": ["taylor"]}
    for truth, computed in outcomes.items():
        for _ in range(150):
            error = truth + 0.01 * rng.standard_normal(shape)
            data = {"range_error": (dims, error), "range_error_stderr": (dims, np.full(shape, 0.01))}
            one = verdict(xr.Dataset(data, names), 0.05)
            computed.append(one.outcome)
            held.append(one.worst_low <= truth <= one.worst_high)
            assert one.worst_error == error.max() and one.photodiode == "abcdefgh"[error.argmax()]
    share = {
        truth: {word: computed.count(word) / 150 for word in set(computed)} for truth, computed in outcomes.items()
    }
    assert share[0.05].get("missed", 0) < 0.1 and share[0.05].get("met", 0) < 0.01
    # The largest of eight lies above the truth by chance; the printed interval includes that.
    assert 0.95 <= np.mean(held) < 1
    assert share[0.09]["missed"] > 0.95 and share[0.01]["met"] > 0.8


def test_the_worst_reading_is_named_where_all_are_within_the_tolerance():
    """Rationale: all of them then meet it with a probability of 1, to the last bit. Expected: still the largest error,
    and within the interval that is printed beside it."""
    dims = ("sweep", "led", "photodiode", "way", "model", "point")
    error = np.reshape([0.007, 0.043, 0.02], (1, 1, 3, 1, 1, 1))
    names = {"sweep": ["force"], "led": ["ir"], "photodiode": list("abc"), "way": ["fitted"], "model": ["taylor"]}
    data = {"range_error": (dims, error), "range_error_stderr": (dims, np.full(error.shape, 0.002))}
    one = verdict(xr.Dataset(data, names), 0.5)
    assert one.outcome == "met" and one.photodiode == "b" and one.worst_error == 0.043
    assert one.worst_low <= one.worst_error <= one.worst_high


@pytest.mark.long
def test_neighbouring_seeds_share_no_streams(monkeypatch):
    """Rationale: the scattering is traced with seeds of its own. Expected: no two studies have one in common."""
    used = []

    def trace(scene, *, seed, **_):
        used.append(seed)
        return synthetic(np.full(50, 4.0), np.zeros(50), scene=scene)

    monkeypatch.setattr("nailoptics.studies.compare.trace", trace)
    for seed in range(4):
        compare(prototype(fwhm_nm=0.0), over=["blood"], photons=400, seed=seed)
    assert len(used) == len(set(used)) == 12 and max(used) < 2**63


def test_the_terminal_reports_whether_both_formulas_hold_and_the_tolerance():
    draw = np.random.default_rng(4).gamma(2.0, 2.5, 2000)
    computed = evaluated(synthetic(draw, draw), "blood", slopes=np.full((2, 1, 8), np.nan))
    taylor, exact, meaning = compare_page.lines(computed, 0.1)
    for line, name in ((taylor, "Taylor (9)"), (exact, "Beer-Lambert (8)")):
        assert name in line and "10 % of the swing" in line
    assert "5 % where --require gives no other" in meaning


def test_what_cannot_be_compared_is_one_line():
    scene = prototype()
    still = scene.model_copy(update={"touch": scene.touch.model_copy(update={"force_n": 0.0})})
    with pytest.raises(InputError, match="force never leaves 0"):
        compare(still)
    with pytest.raises(InputError, match="over is empty"):
        compare(scene, over=())


@pytest.mark.long
@pytest.mark.jit
def test_the_prototype_is_compared_from_the_command_line(jit_backend, tmp_path, capsys):
    folder = ["-o", str(tmp_path), "--photons", "60000", "--json"]
    assert cli.run(["compare", "prototype", *folder, "--require", "1e-4"]) == 4
    printed = capsys.readouterr()
    computed = json.loads(printed.out)
    assert computed["verdict"]["outcome"] == "missed" and "does not stay within 0.01 % of the swing" in printed.err
    assert len(computed["comparisons"]) == 16
    page = (tmp_path / "compare.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 5 and "src=" not in page and "http:" not in page and "https:" not in page
    assert cli.run(["compare", "prototype", "-o", str(tmp_path), "--require", "-1"]) == 2
    all_shown(xr.load_dataset(tmp_path / "compare.nc"), page=False)
    assert_listed(tmp_path, "compare.nc")


@pytest.mark.slow
@pytest.mark.jit
def test_the_prototype_agrees_with_itself_within_its_errors(jit_backend):
    """Two seeds of the whole study: every error of (9) and (8) agrees within the errors that each states."""
    scene = prototype()
    one, two = (compare(scene, photons=1_500_000, seed=seed) for seed in (1, 20))
    for name in ("range_error", "alpha_d2", "part_error", "swing"):
        spread = np.hypot(one[f"{name}_stderr"], two[f"{name}_stderr"])
        z = ((one[name] - two[name]) / spread.where(spread > 0)).values
        z = z[np.isfinite(z)]
        assert np.abs(z).max() < 6 and np.sqrt(np.mean(z**2)) < 1.7, name
    rows = summary(one)["comparisons"]
    assert {row["sweep"] for row in rows} == {"force", "blood"}
    for row, way in itertools.product(rows, ("fitted", "predicted")):
        assert row[f"beer_lambert_{way}"]["error_of_swing"]["value"] >= 0


@pytest.mark.long
def test_a_sweeps_settings_have_a_unit_that_all_of_them_share_or_none():
    transfer = synthetic(np.array([0.5, 1.0]), np.array([0.2, 0.1]))
    for over, units in ((("blood", "saturation"), "1"), (("force",), "N"), (("force", "blood"), None)):
        computed = evaluated(transfer, *over)
        for name in ("setting", "limit"):
            assert computed[name].attrs.get("units") == units
            assert (computed[name].attrs.get("ancillary_variables") == "setting_units") == (units is None)


@pytest.mark.long
def test_the_page_shows_hostile_names_as_text(tmp_path):
    rng = np.random.default_rng(1)
    result = evaluated(synthetic(rng.uniform(1, 6, 400), rng.uniform(0, 3, 400)), "force", "blood")
    names = [f"{HOSTILE[i % len(HOSTILE)]}{i}" for i in range(result.sizes["photodiode"])]
    text = page(result.assign_coords(led=[HOSTILE[0]], photodiode=names))
    for name in names:
        assert_text_alone(text, name)


@pytest.mark.long
def test_the_page_names_undecided_readings_apart():
    """Expected: where errors lie at the tolerance the page says that it is open, elsewhere no word of it."""
    draw = np.random.default_rng(5).gamma(2.0, 2.0, (2, 3000))
    result = evaluated(synthetic(*draw), "blood")
    none = 0 * result.range_error
    for error, words in ((0.05, "0 of {0} ({0} undecided)"), (0.2, "0 of {0}"), (1e-3, "{0} of {0}")):
        alike = result.assign(range_error=none + error, range_error_stderr=none + 1e-3)
        title = f"Taylor (9) holds to 5 % for {words.format(verdict(alike, 0.05).readings)} readings over"
        assert title in page(alike)
