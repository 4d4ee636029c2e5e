"""Fit the nail plate's absorption to the few published measurements, and print assets/spectra/nail_plate.csv.

    python assets/spectra/fit_nail_plate.py > assets/spectra/nail_plate.csv

No table of the nail plate's optics was found. Measured: a healthy fingernail transmits about 20 % of blue light,
gradually more at longer wavelengths, and little UV-A; transmittance decreases exponentially with thickness.
Transmittance alone does not separate scattering from absorption, so scattering is taken from epidermis, and

    mu_a = plateau + edge exp(-(wavelength - 450 nm) / width) + water

has three parameters for three conditions:

- a transmittance of 20 % at 450 nm, and
- of 1.65 % at 365 nm, which determine edge and width for a given plateau;
- the plateau, the absorption in the red, lies between the smallest absorption at which the transmittance is still
  exponential in thickness, and the largest, at which red is absorbed like blue. Their geometric mean is used.

The plate of 0.44 mm with n 1.5 and g 0.9 is in air; its total transmittance counts
(adding-doubling, S. A. Prahl et al., Appl. Opt. 32, 559 (1993), by iadpython).
"""

import csv
import sys
import textwrap
from pathlib import Path

import iadpython
import numpy as np
from scipy.optimize import brentq

THICKNESS_MM = 0.44  # the middle of 0.40-0.48 mm, adults' index fingers
INDEX, ANISOTROPY = 1.5, 0.9
BLUE_NM, BLUE_PASSES = 450.0, 0.20
UV_A_NM, UV_A_PASSES = 365.0, 0.0165  # a lamp of 320-400 nm, modelled as one line
RED_NM = 700.0
# Tolerance on the attenuation per mm between these thicknesses for a transmittance that counts as exponential.
THICKNESSES_MM, EXPONENTIAL_WITHIN = np.linspace(0.3, 0.9, 5), 0.05
WATER = 0.20  # volume fraction; 7-35 % were measured
WAVELENGTHS_NM = np.arange(400.0, 1001.0, 10.0)
# From the first wavelength to the last; brackets the absorption at any of them. [mm^-1]
LEAST_MU_A, MOST_MU_A = 1e-4, 50.0

# One paragraph of the table's header each.
HEADER = (
    "FITTED, not measured: absorption and reduced scattering of the human nail plate. No published table was found. "
    "Written by assets/spectra/fit_nail_plate.py, which describes the fit.",
    "Measured: healthy fingernails transmit about 20 % of blue light, gradually more at longer wavelengths, and "
    "exponentially less with thickness (400-750 nm; Effect of nail thickness on visible radiation transmittance: "
    "implications for new photodynamic therapy technologies in onychomycosis, Photochem. Photobiol. 96, 1267-1272 "
    "(2020), doi 10.1111/php.13296). UV-A: 1.65 % (0.56 to 2.43) through ten cadaver nails (Arch. Dermatol. 147, 439 "
    "(2011), doi 10.1001/archdermatol.2010.375). n 1.5; thickness 0.40-0.48 mm; water 7-35 %.",
    "Borrowed: mu_s' = 7.56 (wavelength/500)^-1.33 /mm, a power law through epidermis at 532-980 nm (Y. Shimojo et "
    "al., J. Biomed. Opt. 25, 045002 (2020)), of which nail is the keratinised form; g 0.9.",
    "Fit: mu_a = {plateau:.4f} + {edge:.4f} exp(-(wavelength - 450)/{width:.2f}) + {water:.2f} mu_a,water /mm, so that "
    "0.44 mm in air transmit 20 % at 450 nm and 1.65 % at 365 nm in all directions. The plateau is the geometric mean "
    "of {least:.3f} /mm, below which the transmittance at 700 nm is not exponential within 5 % from 0.3 to 0.9 mm, and "
    "{most:.3f} /mm, the absorption at 450 nm. So 0.44 mm transmit {at_400:.0%} at 400 nm, {at_550:.0%} at 550 nm, "
    "{at_700:.0%} at 700 nm. Above 750 nm nothing was measured: the plateau is extrapolated.",
    "Transmittance alone does not separate absorption from scattering: both are uncertain, mu_a by a factor 2.",
)
COLUMNS = "wavelength_nm,mu_a_per_mm,mu_s_reduced_per_mm"


def reduced_scattering_per_mm(wavelength_nm: float) -> float:
    """Reduced scattering borrowed from epidermis. [mm^-1]"""
    return float(7.56 * (wavelength_nm / 500) ** -1.33)


def passes(mu_a_per_mm: float, wavelength_nm: float, thickness_mm: float = THICKNESS_MM) -> float:
    """Total transmittance of a plate in air."""
    mu_s = reduced_scattering_per_mm(wavelength_nm) / (1 - ANISOTROPY)
    extinction = mu_a_per_mm + mu_s
    slab = iadpython.Sample(
        a=mu_s / extinction, b=extinction * thickness_mm, g=ANISOTROPY, n=INDEX, n_above=1, n_below=1, quad_pts=16
    )
    return float(slab.rt()[1])


def absorption_that_passes(part: float, wavelength_nm: float) -> float:
    """Absorption at which a plate of the usual thickness has this transmittance. [mm^-1]"""
    return float(brentq(lambda mu_a: passes(mu_a, wavelength_nm) - part, LEAST_MU_A, MOST_MU_A))


def uneven_loss(mu_a_per_mm: float, wavelength_nm: float) -> float:
    """Relative range of the attenuation per mm over thickness; 0 for an exponential transmittance."""
    passed = [passes(mu_a_per_mm, wavelength_nm, thickness) for thickness in THICKNESSES_MM]
    loss = -np.diff(np.log(passed)) / np.diff(THICKNESSES_MM)
    return float(np.ptp(loss) / loss.mean())


def water_mu_a_per_mm(wavelength_nm: float) -> float:
    """Absorption of the plate's water, constant below the shipped table of water. [mm^-1]"""
    path = Path(__file__).with_name("water.csv")
    rows = csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    wavelength, mu_a = np.array([[float(x) for x in row.values()] for row in rows]).T
    return float(WATER * np.interp(wavelength_nm, wavelength, mu_a, left=mu_a[0]))


def table() -> str:
    """The table, with the fitted parameters in its header."""
    most, at_uv = absorption_that_passes(BLUE_PASSES, BLUE_NM), absorption_that_passes(UV_A_PASSES, UV_A_NM)
    least = float(brentq(lambda mu_a: uneven_loss(mu_a, RED_NM) - EXPONENTIAL_WITHIN, 0.05, most))
    plateau = float(np.sqrt(least * most))
    edge = most - water_mu_a_per_mm(BLUE_NM) - plateau
    width = (BLUE_NM - UV_A_NM) / np.log((at_uv - water_mu_a_per_mm(UV_A_NM) - plateau) / edge)

    def mu_a(wavelength_nm: float) -> float:
        return float(plateau + edge * np.exp(-(wavelength_nm - BLUE_NM) / width) + water_mu_a_per_mm(wavelength_nm))

    fitted = {"plateau": plateau, "edge": edge, "width": width, "water": WATER, "least": least, "most": most}
    seen = {f"at_{nm}": passes(mu_a(nm), nm) for nm in (400, 550, 700)}
    rows = [f"{nm:.0f},{mu_a(nm):.4f},{reduced_scattering_per_mm(nm):.4f}" for nm in WAVELENGTHS_NM]
    header = [
        line
        for paragraph in HEADER
        for line in textwrap.wrap(
            paragraph.format(**fitted, **seen), 118, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False
        )
    ]
    return "\n".join([*header, COLUMNS, *rows]) + "\n"


if __name__ == "__main__":
    sys.stdout.write(table())
