"""Reduced optics: constants of (8) and (9) are recovered, with calibrated standard errors; no input breaks the fit."""

import warnings

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings, strategies as st

from nailoptics.errors import InputError
from nailoptics.paper import reduced_optics
from nailoptics.paper.reduced_optics import fit_beer_lambert, fit_reduced_optics, fit_taylor
from nailoptics.statistics import leave_one_out

DIAMETER_M = np.linspace(8e-6, 11e-6, 50)
V0_V, V1_V = 0.1, 0.2


def beer_lambert(diameter_m, *, v0_v, v1_v, alpha_per_m2):
    return v0_v + v1_v * np.exp(-alpha_per_m2 * np.square(diameter_m))


def taylor(diameter_m, *, v0_v, v1_v_per_m2):
    return v0_v - v1_v_per_m2 * np.square(diameter_m)


def readings(alpha_d2, diameter_m=DIAMETER_M):
    """Readings by (8), with alpha D^2 given at the listed diameter of 10 um."""
    return beer_lambert(diameter_m, v0_v=V0_V, v1_v=V1_V, alpha_per_m2=alpha_d2 / 1e-10)


@pytest.mark.parametrize("alpha_d2", [1e-3, 1e-2, 0.06, 0.5, 5.0])
def test_beer_lambert_constants_come_back_up_to_strong_absorption(alpha_d2):
    fit = fit_beer_lambert(DIAMETER_M, readings(alpha_d2))
    exact = {"v0_v": V0_V, "v1_v": V1_V, "alpha_per_m2": alpha_d2 / 1e-10}
    assert fit.constants == pytest.approx(exact, rel=1e-5)
    assert fit.residual_rms_v < 1e-10 and fit.note == ""


def test_a_closing_capillary_is_fitted_down_to_zero_diameter():
    diameter_m = np.linspace(0, 1e-5, 400)
    fit = fit_beer_lambert(diameter_m, readings(0.3, diameter_m))
    assert fit.constants["alpha_per_m2"] == pytest.approx(0.3e10, rel=1e-6)
    assert fit.predict(0.0) == pytest.approx(V0_V + V1_V, rel=1e-9)


def test_taylor_constants_come_back():
    volts = taylor(DIAMETER_M, v0_v=0.3, v1_v_per_m2=2e8)
    fit = fit_taylor(DIAMETER_M, volts)
    assert fit.constants == pytest.approx({"v0_v": 0.3, "v1_v_per_m2": 2e8}, rel=1e-9)
    assert fit.residual_rms_v < 1e-14


def test_taylor_misses_by_the_square_of_the_absorption():
    # The term of (8) that (9) drops is V1 (alpha D^2)^2 / 2: ten times alpha, a hundred times the residual.
    weak, strong = (fit_taylor(DIAMETER_M, readings(alpha_d2)).residual_rms_v for alpha_d2 in (1e-3, 1e-2))
    assert strong / weak == pytest.approx(100, rel=0.02)


@pytest.mark.parametrize(
    "fit, truth",
    [
        (fit_beer_lambert, {"v0_v": V0_V, "v1_v": V1_V, "alpha_per_m2": 0.3e10}),
        (fit_taylor, {"v0_v": 0.3, "v1_v_per_m2": 2e8}),
    ],
)
@pytest.mark.parametrize("shared", [True, False])
def test_jackknifed_errors_are_those_of_repeated_readings(fit, truth, shared):
    """Groups of photons whose noise every reading has by itself, or all readings share but for a tenth."""
    exact = (taylor if fit is fit_taylor else beer_lambert)(DIAMETER_M, **truth)
    rng = np.random.default_rng(7)
    pulls = []
    for _ in range(400):
        noise = rng.normal(0, 5e-6, (40, DIAMETER_M.size))
        replicates = leave_one_out(exact + (rng.normal(0, 5e-5, (40, 1)) + noise if shared else noise))
        got = fit(DIAMETER_M, replicates[0])
        pulls.append([got.constants[name] - value for name, value in truth.items()])
        pulls[-1] /= got.stderr(DIAMETER_M, replicates)
    # The spread of 400 pulls is estimated to 1 / sqrt(800) = 3.5 %; of 40 groups an error is to 11 %, which adds 1.3 %.
    assert np.std(pulls, axis=0) == pytest.approx(1.02, abs=4 * 0.037)
    assert np.abs(np.mean(pulls, axis=0)).max() < 4 / np.sqrt(400)


def test_noise_that_hides_the_curvature_is_reported_and_degrades_no_prediction():
    """Rationale: alpha is a five hundredth of its standard error. Expected: in 40 draws of the noise it is left out
    wherever it is below its error, 90 % of them, and nowhere else; predictions miss by no more than three constants do,
    three variances in the sum over all readings."""
    random, left_out, missed = np.random.default_rng(4), [], []
    for _ in range(40):
        replicates = leave_one_out(readings(1e-2) + random.normal(0, 1e-3 * np.sqrt(40), (40, DIAMETER_M.size)))
        fit = fit_beer_lambert(DIAMETER_M, replicates[0])
        stderr = fit.stderr(DIAMETER_M, replicates)
        left_out.append("alpha" in fit.remark(stderr))
        assert left_out[-1] == (stderr[2] > fit.constants["alpha_per_m2"])
        missed.append(np.sum((fit.predict(DIAMETER_M) - readings(1e-2)) ** 2) / 1e-6)
    assert np.mean(left_out) > 0.9 - 4 * np.sqrt(0.09 / 40)
    assert np.mean(missed) < 3 + 4 * np.sqrt(2 * 3 / 40)


def test_constants_of_a_curve_of_unresolved_curvature_are_left_out_of_the_result():
    """Expected: NaN and a note; Taylor (9) and the curve itself stay."""
    data = {
        "volts": (("led", "photodiode", "time"), (1.0 + 1e7 * DIAMETER_M**2)[None, None]),
        "capillary_diameter_m": (("zone", "time"), DIAMETER_M[None]),
        "zone_of_photodiode": ("photodiode", [0]),
    }
    made = fit_reduced_optics(xr.Dataset(data), np.arange(len(DIAMETER_M)), None)
    constants = [made[f"beer_lambert_{name}"][1] for name in ("v0_v", "v1_v", "alpha_per_m2")]
    assert np.isnan(constants).all() and "straight" in str(made["fit_note"][1])
    assert np.isfinite([made["taylor_v0_v"][1], made["beer_lambert_residual_rms_v"][1]]).all()


def test_scale_does_not_matter():
    fit = fit_beer_lambert(DIAMETER_M, readings(0.1))
    tiny = fit_beer_lambert(DIAMETER_M * 1e-3, readings(0.1) * 1e-9)
    assert tiny.constants["alpha_per_m2"] == pytest.approx(fit.constants["alpha_per_m2"] * 1e6, rel=1e-6)
    assert tiny.constants["v1_v"] == pytest.approx(fit.constants["v1_v"] * 1e-9, rel=1e-6)


@pytest.mark.parametrize("fit", [fit_beer_lambert, fit_taylor])
@pytest.mark.parametrize(
    "diameter_m, volts",
    [([1e-5], [0.1]), ([1e-5] * 4, [0.1, 0.1, 0.2, 0.2]), ([0.0] * 3, [0.1, 0.2, 0.3])],
)
def test_constant_diameters_give_the_mean_and_report_it(fit, diameter_m, volts):
    got = fit(diameter_m, volts)
    assert got.predict(diameter_m) == pytest.approx(np.mean(volts))
    assert "do not vary" in got.note
    assert np.isinf(got.stderr(diameter_m, np.tile(volts, (5, 1)))).all()


def test_readings_that_do_not_change_have_no_slope():
    assert fit_taylor(DIAMETER_M, np.full(50, 0.3)).constants["v1_v_per_m2"] * 1e-10 == pytest.approx(0, abs=1e-12)
    fit = fit_beer_lambert(DIAMETER_M, np.full(50, 0.3))
    assert fit.predict(5e-6) == pytest.approx(0.3) and "do not change" in fit.note


def test_two_states_make_a_straight_line_of_unresolved_curvature():
    fit = fit_beer_lambert([1e-5, 1.1e-5, 1e-5], [0.20, 0.18, 0.20])
    assert fit.predict([1e-5, 1.1e-5]) == pytest.approx([0.20, 0.18])
    assert "two different diameters" in fit.note


def test_a_curve_bent_the_wrong_way_is_met_by_the_straight_line():
    volts = 0.3 - 0.05 * (DIAMETER_M / 1e-5) ** 4
    fit = fit_beer_lambert(DIAMETER_M, volts)
    assert "low end" in fit.note
    assert fit.residual_rms_v == pytest.approx(fit_taylor(DIAMETER_M, volts).residual_rms_v, rel=1e-2)


@settings(max_examples=60, deadline=None)
@given(
    diameter_um=st.lists(st.floats(0, 100), min_size=1, max_size=8),
    seed=st.integers(0, 2**32 - 1),
    scale_v=st.sampled_from([0.0, 1e-12, 1.0, 1e6]),
)
def test_any_readings_give_finite_predictions_and_no_warning(diameter_um, seed, scale_v):
    diameter_m = np.array(diameter_um) * 1e-6
    volts = scale_v * np.random.default_rng(seed).normal(size=diameter_m.size)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for fit in (fit_beer_lambert(diameter_m, volts), fit_taylor(diameter_m, volts)):
            assert np.isfinite(fit.predict(diameter_m)).all()
            assert not np.isnan(fit.stderr(diameter_m, np.tile(volts, (3, 1)))).any()
            # A fit with a constant is at least as good as the mean.
            assert fit.residual_rms_v <= volts.std() * (1 + 1e-6) + 1e-9 * scale_v


@pytest.mark.parametrize("fit", [fit_beer_lambert, fit_taylor])
@pytest.mark.parametrize(
    "diameter_m, volts, word",
    [
        ([], [], "empty"),
        ([1e-5], [0.1, 0.2], "one length"),
        ([-1e-5, 1e-5], [0.1, 0.2], "diameter_m"),
        ([1e-5, 2e-5], [0.1, np.nan], "volts"),
    ],
)
def test_impossible_readings_are_refused(fit, diameter_m, volts, word):
    with pytest.raises(InputError, match=word):
        fit(diameter_m, volts)


@pytest.mark.parametrize("fit", [fit_beer_lambert, fit_taylor])
def test_very_many_readings_are_fitted_as_their_means_in_narrow_ranges(fit, monkeypatch):
    """Expected: the constants of 60 000 readings, that drift and scatter, as from each of them by itself."""
    rng, time = np.random.default_rng(2), np.linspace(0.0, 1.0, 60_000)
    diameter_m = 7e-6 + 2e-6 * np.sin(9 * time) * np.exp(-time)
    volts = 0.3 + 0.2 * np.exp(-1.2e10 * diameter_m**2) + 1e-5 * rng.normal(size=time.size) + 2e-4 * time
    result = fit(diameter_m, volts)
    monkeypatch.setattr(reduced_optics, "MOST_READINGS", time.size)
    one_by_one = fit(diameter_m, volts)
    assert result.constants == pytest.approx(one_by_one.constants, rel=1e-6)
    assert result.residual_rms_v == pytest.approx(one_by_one.residual_rms_v, rel=1e-6)
