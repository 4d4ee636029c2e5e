"""Tissue: absorption and scattering against their literature, the nail plate against its facts, bad input refused."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nailoptics import tissue
from nailoptics.assets import asset_path, read_table
from nailoptics.errors import InputError
from nailoptics.scene import Priors
from nailoptics.scene.base import USUAL_PULP_BLOOD_FRACTION
from nailoptics.scene.priors import shipped_priors


def test_blood_absorbs_as_in_prahls_table():
    # Prahl's extinctions at 660 / 800 / 940 nm are 319.6, 816, 1214 (oxy) and 3226.56, 761.72, 693.44 (deoxy) per cm
    # per molar; times ln(10) * 150 / 64500 / 10 that is 0.171 / 0.437 / 0.650 and 1.728 / 0.408 / 0.371 per mm.
    wavelength_nm = [660, 800, 940]
    assert tissue.blood_mu_a_per_mm(wavelength_nm, 1.0) == pytest.approx([0.171, 0.437, 0.650], abs=5e-4)
    assert tissue.blood_mu_a_per_mm(wavelength_nm, 0.0) == pytest.approx([1.728, 0.408, 0.371], abs=5e-4)


def test_blood_is_isosbestic_at_796_8_nm():
    wavelength_nm = np.arange(780, 820, 0.01)
    difference = tissue.blood_mu_a_per_mm(wavelength_nm, 1.0) - tissue.blood_mu_a_per_mm(wavelength_nm, 0.0)
    crossing = wavelength_nm[:-1][np.diff(np.sign(difference)) != 0]
    assert crossing == pytest.approx([796.8], abs=0.05)


def test_blood_is_linear_in_saturation_and_broadcasts():
    both = tissue.blood_mu_a_per_mm([[660.0], [940.0]], [0.0, 0.25, 1.0])
    assert both.shape == (2, 3)
    assert both[:, 1] == pytest.approx(0.75 * both[:, 0] + 0.25 * both[:, 2], rel=1e-12)


@pytest.mark.parametrize("region", tissue.REGIONS)
def test_every_region_has_physical_properties_from_400_to_1000_nm(region):
    wavelength_nm = np.linspace(400, 1000, 601)
    result, (mu_s, g, n) = tissue.absorption(region, wavelength_nm), tissue.scattering(region, wavelength_nm)
    for values in (result.base_per_mm, result.per_blood_fraction_per_mm, mu_s, g, n):
        assert values.shape == (601,) and np.isfinite(values).all() and (values >= 0).all()
    assert (g < 1).all() and (n >= 1).all() and (n < 2).all()
    one = tissue.absorption(region, 800).base_per_mm
    assert isinstance(one, float) and one == pytest.approx(result.base_per_mm[400])


@pytest.mark.parametrize("region", tissue.REGIONS)
@pytest.mark.parametrize("wavelength_nm", [660.0, 800.0, 940.0])
def test_blood_absorbs_in_the_bed_and_the_pulp_alone(region, wavelength_nm):
    split = tissue.absorption(region, wavelength_nm, so2=0.8)
    carries = region in ("bed", "pulp")
    expected = float(tissue.blood_mu_a_per_mm(wavelength_nm, 0.8)) if carries else 0.0
    assert split.per_blood_fraction_per_mm == pytest.approx(expected)


def test_scattering_follows_jacques():
    # Jacques 2013, table 2, at 800 nm: a (800/500)^-b with a 4.60, b 1.421 (skin) and 2.29, 0.716 (bone) per mm.
    for region, reduced in (("bed", 4.60 * 1.6**-1.421), ("bone", 2.29 * 1.6**-0.716)):
        mu_s, g, _ = tissue.scattering(region, 800.0)
        assert mu_s * (1 - g) == pytest.approx(reduced, rel=1e-9)


@pytest.mark.parametrize("wavelength_nm, sd", [(632, 0.62), (694, 0.53), (755, 0.43), (800, 0.39), (980, 0.29)])
def test_the_beds_scattering_lies_within_two_standard_deviations_of_measured_dermis(wavelength_nm, sd):
    # Shimojo 2020, dermis ex vivo, mu_s' per mm and its standard deviation.
    measured = {632: 3.06, 694: 2.64, 755: 2.20, 800: 2.01, 980: 1.45}[wavelength_nm]
    mu_s, g, _ = tissue.scattering("bed", wavelength_nm)
    assert abs(mu_s * (1 - g) - measured) < 2 * sd


def test_the_epidermis_scatters_as_measured():
    wavelength_nm = np.array([532, 595, 632, 694, 755, 800, 980])
    measured = [7.04, 6.02, 5.55, 4.89, 4.28, 3.98, 3.17]  # mu_s' per mm, Shimojo 2020
    mu_s, g, _ = tissue.scattering("epidermis", wavelength_nm)
    assert mu_s * (1 - g) == pytest.approx(measured, rel=0.03)


def test_melanin_darkens_the_epidermis_alone():
    for region in tissue.REGIONS:
        pale, dark = (tissue.absorption(region, 660, melanin_fraction=f).base_per_mm for f in (0.009, 0.017))
        if region == "epidermis":
            # 519 (660/500)^-3 per cm of melanosome (Jacques 2013), less the tissue that it displaces.
            assert dark - pale == pytest.approx(0.008 * 51.9 * 1.32**-3, rel=0.01)
        else:
            assert pale == dark


def test_dermis_choices_span_the_factor_two_between_laboratories():
    wavelength_nm = [660, 800, 940]
    shimojo, salomatina, baseline = (
        tissue.absorption("bed", wavelength_nm, dermis_absorption=name).base_per_mm
        for name in ("shimojo", "salomatina", "jacques_baseline")
    )
    assert shimojo == pytest.approx([0.065, 0.050, 0.066], abs=0.001)
    assert salomatina == pytest.approx([0.146, 0.122, 0.078], abs=0.001)
    assert (baseline < shimojo).all() and (baseline > 0.2 * shimojo).all()


def test_kapton_of_25_um_passes_96_to_99_percent():
    wavelength_nm = [660, 800, 940]
    mu_a_per_mm = tissue.absorption("kapton", wavelength_nm).base_per_mm
    assert tissue.scattering("kapton", wavelength_nm)[2] == pytest.approx([1.80, 1.78, 1.77], abs=0.005)
    assert mu_a_per_mm == pytest.approx([1.42, 0.66, 0.53], abs=0.005)
    passed = np.exp(-0.025 * mu_a_per_mm)
    assert passed.min() > 0.96 and passed.max() < 0.99


def plate_transmission(mu_a_per_mm, mu_s_reduced_per_mm, thickness_mm):
    """All light that passes a plate in air, by adding-doubling."""
    import iadpython

    mu_s = mu_s_reduced_per_mm / (1 - 0.9)
    extinction = mu_a_per_mm + mu_s
    slab = iadpython.Sample(
        a=mu_s / extinction, b=extinction * thickness_mm, g=0.9, n=1.5, n_above=1, n_below=1, quad_pts=16
    )
    return float(slab.rt()[1])


# How many times as much as a living plate a dry one scatters, on which transmittance was measured: of the fit.
DRY = 3.3


def test_the_nail_plate_transmits_red_more_than_blue_and_hardly_uv():
    # The facts and their sources stand in the header of assets/spectra/nail_plate.csv.
    table = read_table("spectra/nail_plate.csv")
    wavelength_nm = np.arange(400, 760, 50.0)
    rows = np.searchsorted(table["wavelength_nm"], wavelength_nm)
    mu_a, reduced = table["mu_a_per_mm"][rows], table["mu_s_reduced_per_mm"][rows]
    reduced = DRY * reduced
    passed = np.array([plate_transmission(a, s, 0.44) for a, s in zip(mu_a, reduced, strict=True)])
    # Within the standard deviation between nails that the fit has.
    assert abs(np.log(passed[1] / 0.20)) < 0.35
    # "Highest at longer wavelengths, decreasing gradually"; not more than a plate that absorbs nothing would pass.
    assert (np.diff(passed) > 0).all() and (np.diff(passed[1:]) < 0.08).all()
    assert passed[-1] < plate_transmission(0.0, reduced[-1], 0.44)
    # Nails between 0.40 and 0.48 mm differ by less than the 0.56 to 2.43 % of UV-A that ten nails passed.
    assert 0.0165 < passed[0] < 0.5 * passed[1]


def test_transmission_falls_exponentially_with_the_plates_thickness():
    thicknesses_mm = np.linspace(0.3, 0.9, 5)
    for wavelength_nm in (450.0, 550.0, 620.0, 700.0):
        mu_a_per_mm, (mu_s_per_mm, g, _) = (f("plate", wavelength_nm) for f in (tissue.absorption, tissue.scattering))
        reduced = DRY * mu_s_per_mm * (1 - g)
        passed = [plate_transmission(mu_a_per_mm.base_per_mm, reduced, d) for d in thicknesses_mm]
        # Exponential: the loss per mm is the same at each thickness, within 12 %: red is absorbed the least.
        loss_per_mm = -np.diff(np.log(passed)) / np.diff(thicknesses_mm)
        assert np.ptp(loss_per_mm) < 0.12 * loss_per_mm.mean()
        # A plate that only scatters would not do so: this is what shows that it absorbs.
        clear = [plate_transmission(0.0, reduced, d) for d in thicknesses_mm]
        assert np.ptp(np.diff(np.log(clear))) > 0.2 * np.abs(np.diff(np.log(clear)).mean())


@pytest.mark.slow
def test_the_shipped_nail_plate_and_its_priors_are_what_their_script_fits():
    script = Path(__file__).parents[2] / "assets/spectra/fit_nail_plate.py"
    code = "import fit_nail_plate as f; p = f.Posterior(); print(f.table(p) + f.priors(p), end='')"
    run = [sys.executable, "-c", code]
    printed = subprocess.run(run, cwd=script.parent, capture_output=True, text=True, check=True).stdout.splitlines()
    shipped = asset_path("spectra/nail_plate.csv").read_text(encoding="utf-8").splitlines()
    header = [line for line in shipped if line.startswith("#")]
    assert printed[: len(header) + 1] == shipped[: len(header) + 1]
    # The last digit may differ from machine to machine.
    lines = printed[len(header) + 1 : len(shipped)], shipped[len(header) + 1 :]
    fitted, kept = (np.loadtxt(each, delimiter=",") for each in lines)
    assert fitted == pytest.approx(kept, rel=1e-3)
    of = {one.field: one for one in shipped_priors()}
    for line in printed[len(shipped) :]:
        if match := re.fullmatch("(.*): low = (.*), high = (.*)", line):
            low, high = float(match[2]), float(match[3])
            assert (of[match[1]].low, of[match[1]].high) == pytest.approx((low, high), rel=0.01, abs=0.01)
    correlations = re.findall(r'fields = \["(.*)", "(.*)"\]\nvalue = (.*)', "\n".join(printed[len(shipped) :]))
    assert len(correlations) > 5
    for first, second, value in correlations:
        matrix = Priors().correlation([of[first], of[second]])
        assert matrix[0, 1] == pytest.approx(float(value), abs=0.011)


@pytest.mark.long
@pytest.mark.jit
def test_one_more_step_of_its_fit_leaves_the_shipped_pulp_as_it_is(chosen_jit, monkeypatch):
    """Of 100 000 rays; expected: a Gauss-Newton step of less than 2 % in scattering, its power and absorption, and of
    less than 10 % in the blood, four times what six seeds scatter by there (0.4, 0.3, 0.8 and 2.5 %)."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "assets/spectra")
    import fit_fingertip_skin as fit

    logarithms = np.log([tissue.PULP_SCATTERING, 1.0, tissue.PULP_ABSORPTION, USUAL_PULP_BLOOD_FRACTION])
    shipped = np.where([True, False, True, True], logarithms, tissue.PULP_SCATTERING_POWER)
    skin, people = fit.Skin(), fit.pooled(fit.measured("ring finger"))
    skin.walk(*fit.values_of(shipped), photons=100_000)
    here, width = fit.misfit(shipped, skin, people), 1e-3
    slope = np.stack([fit.misfit(shipped + width * one, skin, people) - here for one in np.eye(4)], -1) / width
    step = np.linalg.lstsq(slope, -here)[0]
    assert np.all(np.abs(step) < [0.02, 0.02, 0.02, 0.1]), step


@pytest.mark.slow
def test_ring_fingers_have_the_skin_that_the_pulp_is_fitted_to():
    script = Path(__file__).parents[2] / "assets/spectra/fit_fingertip_skin.py"
    printed = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True).stdout
    fit = re.search(r"scattering x(.*) \(wavelength/500\)\^(.*), absorption x(.*), blood (.*)", printed)
    shipped = (
        *(getattr(tissue, f"PULP_{name}") for name in ("SCATTERING", "SCATTERING_POWER", "ABSORPTION")),
        USUAL_PULP_BLOOD_FRACTION,
    )
    assert [float(one) for one in fit.groups()] == pytest.approx(shipped, abs=0.005)
    assert int(re.search(r"quartiles at (\d+) of 31", printed)[1]) >= 27
    within = [int(one) for one in re.findall(r"back of hand .* within 5-95 % at (\d+)", printed)]
    assert len(within) == 8 and min(within) == 31


def test_the_beds_default_absorption_is_the_median_of_five_measurements():
    wavelength_nm = np.array([633.0, 850.0])
    baseline, shimojo, salomatina = (
        tissue.absorption("bed", wavelength_nm, dermis_absorption=name).base_per_mm
        for name in ("jacques_baseline", "shimojo", "salomatina")
    )
    # Simpson 1998, dermis ex vivo, 12 samples, at 633 nm; Jonasson 2023, 3809 people, dermis in vivo with its blood,
    # medians of upper and lower dermis, at 850 nm. [mm^-1]
    simpson, in_vivo = 0.033, np.array([0.0048, 0.0035])
    assert baseline[0] == pytest.approx(simpson, rel=0.1)
    assert in_vivo.max() < baseline[1] < shimojo[1] < salomatina[1]


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: tissue.blood_mu_a_per_mm(399.9, 0.9), "399.9 .*400 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm([800, 1100], 0.9), "1100 .*400 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm(np.nan, 0.9), "nan .*400 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm(800, 97), "so2 = 97 .*0 to 1"),
        (lambda: tissue.absorption("epoxy", 300), "wavelength_nm = 300"),
        (lambda: tissue.scattering("bone", 2000), "wavelength_nm = 2000"),
        (lambda: tissue.absorption("nail", 800), '"nail" is unknown; choose one of plate, bed'),
        (lambda: tissue.scattering("nail", 800), '"nail" is unknown'),
        (lambda: tissue.absorption("bed", 800, dermis_absorption="x"), "dermis_absorption"),
        (lambda: tissue.absorption("epidermis", 800, melanin_fraction=-0.1), "melanin_fraction = -0.1"),
    ],
)
def test_impossible_input_is_refused_in_one_line_with_advice(call, words):
    with pytest.raises(InputError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
