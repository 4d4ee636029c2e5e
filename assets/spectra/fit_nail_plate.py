"""Fit the nail plate's absorption to the few facts that are known of it, and print assets/spectra/nail_plate.csv.

    python assets/spectra/fit_nail_plate.py > assets/spectra/nail_plate.csv

No table of the nail plate's optics was found, so this makes one. The facts: a healthy fingernail passes about 20 % of
blue light and more, gradually, the longer the wavelength; UV-A hardly passes; what passes falls exponentially with
thickness. Transmission alone cannot tell scattering from absorption, so scattering is taken from epidermis, and

    mu_a = plateau + edge exp(-(wavelength - 450 nm) / width) + water

has three unknowns for three facts:

- 20 % passes at 450 nm, and
- 1.65 % at 365 nm, which tell edge and width for a given plateau;
- the plateau, which is what remains in the red, lies between the least absorption with which what passes is still
  exponential in thickness, and the most, at which the red would absorb as much as the blue. It is put in the middle.

A plate of 0.44 mm with n 1.5 and g 0.9 lies in air; all light that passes counts, whatever its direction
(adding-doubling, S. A. Prahl et al., Appl. Opt. 32, 559 (1993), as iadpython has it).
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
UV_A_NM, UV_A_PASSES = 365.0, 0.0165  # a lamp of 320-400 nm, taken in one line
RED_NM = 700.0
# Loss per mm, from slice to slice of these thicknesses, may differ by this part where it is called exponential.
THICKNESSES_MM, EXPONENTIAL_WITHIN = np.linspace(0.3, 0.9, 5), 0.05
WATER = 0.20  # of the volume; 7-35 % were measured
WAVELENGTHS_NM = np.arange(400.0, 1001.0, 10.0)
# From the first wavelength to the last; brackets the absorption at any of them. [mm^-1]
LEAST_MU_A, MOST_MU_A = 1e-4, 50.0

# One paragraph of the table's header each.
HEADER = (
    "FITTED, not measured: absorption and reduced scattering of the human nail plate. No published table was found. "
    "Made by assets/spectra/fit_nail_plate.py, which says how.",
    "Facts: through healthy fingernails about 20 % of the blue light passes, more at longer wavelengths, gradually, "
    "and exponentially less with thickness (400-750 nm; Effect of nail thickness on visible radiation transmittance: "
    "implications for new photodynamic therapy technologies in onychomycosis, Photochem. Photobiol. 96, 1267-1272 "
    "(2020), doi 10.1111/php.13296). Of UV-A 1.65 %, 0.56 to 2.43, passes ten cadaver nails (Arch. Dermatol. 147, 439 "
    "(2011), doi 10.1001/archdermatol.2010.375). n 1.5; thickness 0.40-0.48 mm; water 7-35 %.",
    "Borrowed: mu_s' = 7.56 (wavelength/500)^-1.33 /mm, a power law through epidermis at 532-980 nm (Y. Shimojo et "
    "al., J. Biomed. Opt. 25, 045002 (2020)), of which nail is the keratinised form; g 0.9.",
    "Fit: mu_a = {plateau:.4f} + {edge:.4f} exp(-(wavelength - 450)/{width:.2f}) + {water:.2f} mu_a,water /mm, so that "
    "0.44 mm in air pass 20 % at 450 nm and 1.65 % at 365 nm, all directions counted. The plateau is the geometric "
    "mean of {least:.3f} /mm, below which what passes at 700 nm is not exponential within 5 % from 0.3 to 0.9 mm, and "
    "{most:.3f} /mm, the absorption at 450 nm. So 0.44 mm pass {at_400:.0%} at 400 nm, {at_550:.0%} at 550 nm, "
    "{at_700:.0%} at 700 nm. Above 750 nm nothing was measured: the plateau goes on.",
    "Transmission alone cannot tell absorption from scattering: both are uncertain, mu_a by a factor 2.",
)
COLUMNS = "wavelength_nm,mu_a_per_mm,mu_s_reduced_per_mm"


def reduced_scattering_per_mm(wavelength_nm: float) -> float:
    """Reduced scattering borrowed from epidermis. [mm^-1]"""
    return float(7.56 * (wavelength_nm / 500) ** -1.33)


def passes(mu_a_per_mm: float, wavelength_nm: float, thickness_mm: float = THICKNESS_MM) -> float:
    """Part of the light that passes a plate in air, all directions counted."""
    mu_s = reduced_scattering_per_mm(wavelength_nm) / (1 - ANISOTROPY)
    extinction = mu_a_per_mm + mu_s
    slab = iadpython.Sample(
        a=mu_s / extinction, b=extinction * thickness_mm, g=ANISOTROPY, n=INDEX, n_above=1, n_below=1, quad_pts=16
    )
    return float(slab.rt()[1])


def absorption_that_passes(part: float, wavelength_nm: float) -> float:
    """Absorption of a plate of the usual thickness that passes this part. [mm^-1]"""
    return float(brentq(lambda mu_a: passes(mu_a, wavelength_nm) - part, LEAST_MU_A, MOST_MU_A))


def uneven_loss(mu_a_per_mm: float, wavelength_nm: float) -> float:
    """By which part the loss per mm differs between thicknesses; 0 where what passes is exponential."""
    passed = [passes(mu_a_per_mm, wavelength_nm, thickness) for thickness in THICKNESSES_MM]
    loss = -np.diff(np.log(passed)) / np.diff(THICKNESSES_MM)
    return float(np.ptp(loss) / loss.mean())


def water_mu_a_per_mm(wavelength_nm: float) -> float:
    """Absorption of the plate's water; none where the shipped table of water has not begun. [mm^-1]"""
    path = Path(__file__).with_name("water.csv")
    rows = csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#"))
    wavelength, mu_a = np.array([[float(x) for x in row.values()] for row in rows]).T
    return float(WATER * np.interp(wavelength_nm, wavelength, mu_a, left=mu_a[0]))


def table() -> str:
    """The table, with what was fitted in its header."""
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
