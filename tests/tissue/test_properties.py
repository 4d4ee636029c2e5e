"""Tissue: absorption and scattering against their literature, the nail plate against its facts, bad input refused."""

import numpy as np
import pytest

from nailoptics import tissue
from nailoptics.assets import read_table
from nailoptics.errors import InputError


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
def test_every_region_has_physical_properties_from_450_to_1000_nm(region):
    found = tissue.optical_properties(region, np.linspace(450, 1000, 551))
    for values in (found.mu_a_per_mm, found.mu_s_per_mm, found.g, found.n):
        assert values.shape == (551,) and np.isfinite(values).all() and (values >= 0).all()
    assert (found.g < 1).all() and (found.n >= 1).all() and (found.n < 2).all()
    one = tissue.optical_properties(region, 800)
    assert isinstance(one.mu_a_per_mm, float) and one.mu_a_per_mm == pytest.approx(found.mu_a_per_mm[350])


@pytest.mark.parametrize("region", tissue.REGIONS)
@pytest.mark.parametrize("wavelength_nm", [660.0, 800.0, 940.0])
def test_absorption_is_linear_in_blood_fraction(region, wavelength_nm):
    split = tissue.absorption(region, wavelength_nm, so2=0.8)
    for blood in (0.0, 0.02, 0.3):
        whole = tissue.optical_properties(region, wavelength_nm, blood_fraction=blood, so2=0.8).mu_a_per_mm
        assert whole == pytest.approx(split.base_per_mm + blood * split.per_blood_fraction_per_mm, rel=1e-12)
    carries = region in ("bed", "pulp")
    expected = float(tissue.blood_mu_a_per_mm(wavelength_nm, 0.8)) if carries else 0.0
    assert split.per_blood_fraction_per_mm == pytest.approx(expected)


def test_scattering_follows_jacques():
    # Jacques 2013, table 2, at 800 nm: a (800/500)^-b with a 4.60, b 1.421 (skin) and 2.29, 0.716 (bone) per mm.
    for region, reduced in (("bed", 4.60 * 1.6**-1.421), ("bone", 2.29 * 1.6**-0.716)):
        mu_s, g, _ = tissue.scattering(region, 800.0)
        assert mu_s * (1 - g) == pytest.approx(reduced, rel=1e-9)


@pytest.mark.parametrize("wavelength_nm, sd", [(632, 0.62), (694, 0.53), (755, 0.43), (800, 0.39), (980, 0.29)])
def test_the_beds_scattering_lies_within_the_spread_of_measured_dermis(wavelength_nm, sd):
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
    found = tissue.optical_properties("kapton", [660, 800, 940])
    assert found.n == pytest.approx([1.80, 1.78, 1.77], abs=0.005)
    assert found.mu_a_per_mm == pytest.approx([1.42, 0.66, 0.53], abs=0.005)
    passed = np.exp(-0.025 * found.mu_a_per_mm)
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


def test_the_nail_plate_passes_10_to_20_percent_more_in_the_red_and_exponentially_less_with_thickness():
    # The facts and their sources stand in the header of assets/spectra/nail_plate.csv.
    plates = [tissue.optical_properties("plate", wavelength_nm) for wavelength_nm in (450.0, 550.0, 620.0, 700.0)]
    thicknesses_mm = np.linspace(0.3, 0.9, 5)
    passed = np.array(
        [
            [plate_transmission(p.mu_a_per_mm, p.mu_s_per_mm * (1 - p.g), d) for d in (0.44, *thicknesses_mm)]
            for p in plates
        ]
    )
    assert (passed[:, 0] > 0.099).all() and (passed[:, 0] < 0.201).all()
    assert (np.diff(passed[:, 0]) > 0).all()
    # Exponential: the loss per mm is the same at each thickness, within 5 %.
    loss_per_mm = -np.diff(np.log(passed[:, 1:]), axis=1) / np.diff(thicknesses_mm)
    assert (np.ptp(loss_per_mm, axis=1) < 0.05 * loss_per_mm.mean(axis=1)).all()


def test_the_shipped_nail_plate_is_the_fit_that_its_header_describes():
    from scipy.optimize import brentq

    table = read_table("spectra/nail_plate.csv")
    wavelength_nm = table["wavelength_nm"]
    reduced = 7.56 * (wavelength_nm / 500) ** -1.33
    at_450, at_700 = (
        brentq(lambda a, s=s, t=t: plate_transmission(a, s, 0.44) - t, 0.01, 10)
        for s, t in ((reduced[0], 0.10), (reduced[25], 0.20))
    )
    power = np.log(at_450 / at_700) / np.log(700 / 450)
    assert table["mu_s_reduced_per_mm"] == pytest.approx(reduced, rel=1e-3)
    assert table["mu_a_per_mm"] == pytest.approx(at_450 * (wavelength_nm / 450) ** -power, rel=2e-3)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: tissue.blood_mu_a_per_mm(449.9, 0.9), "449.9 .*450 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm([800, 1100], 0.9), "1100 .*450 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm(np.nan, 0.9), "nan .*450 to 1000 nm"),
        (lambda: tissue.blood_mu_a_per_mm(800, 97), "so2 = 97 .*0 to 1"),
        (lambda: tissue.absorption("epoxy", 300), "wavelength_nm = 300"),
        (lambda: tissue.scattering("bone", 2000), "wavelength_nm = 2000"),
        (lambda: tissue.absorption("nail", 800), '"nail" is unknown; choose one of plate, bed'),
        (lambda: tissue.scattering("nail", 800), '"nail" is unknown'),
        (lambda: tissue.absorption("bed", 800, dermis_absorption="x"), "dermis_absorption"),
        (lambda: tissue.absorption("epidermis", 800, melanin_fraction=-0.1), "melanin_fraction = -0.1"),
        (lambda: tissue.optical_properties("bed", 800, blood_fraction=3.0), "blood_fraction = 3"),
    ],
)
def test_impossible_input_is_refused_in_one_line_that_says_what_to_do(call, words):
    with pytest.raises(InputError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
