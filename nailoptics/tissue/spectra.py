"""Absorption of the pure chromophores, from the shipped tables, at any wavelength from 400 to 1000 nm."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..assets import WAVELENGTH_RANGE_NM, read_table
from ..errors import InputError

HAEMOGLOBIN_G_PER_L = 150.0
HAEMOGLOBIN_G_PER_MOL = 64500.0

Array = NDArray[np.float64]


def checked_wavelength_nm(wavelength_nm: ArrayLike) -> Array:
    """The wavelengths as an array; InputError where one lies outside the tables."""
    wavelength = np.asarray(wavelength_nm, dtype=float)
    low, high = WAVELENGTH_RANGE_NM
    outside = ~((wavelength >= low) & (wavelength <= high))
    if outside.any():
        raise InputError(
            f"wavelength_nm = {wavelength[outside].flat[0]:g} has no optical data; choose from {low:g} to {high:g} nm"
        )
    return wavelength


def tabulated(table: str, column: str, wavelength_nm: ArrayLike) -> Array:
    """Interpolate one column of a shipped spectrum, linearly between its rows."""
    wavelength = checked_wavelength_nm(wavelength_nm)
    rows = read_table(f"spectra/{table}.csv")
    return np.asarray(np.interp(wavelength, rows["wavelength_nm"], rows[column]), dtype=float)


def blood_mu_a_per_mm(wavelength_nm: ArrayLike, so2: ArrayLike) -> Array:
    """Absorption coefficient of whole blood with 150 g/L of haemoglobin, of the broadcast shape. [mm^-1]

    mu_a = ln(10) eps c / 64500 g/mol, with the molar, decadic extinction eps of Prahl's table.

    wavelength_nm : array in `WAVELENGTH_RANGE_NM`. [nm]
    so2 : array that broadcasts with it. Oxygen saturation, 0-1.

    Raises: InputError for a wavelength without data or a saturation outside 0-1.

    The curves of oxygenated and deoxygenated blood cross at 796.8 nm in this table; in Bosschaart's (Lasers Med.
    Sci. 29, 453 (2014)) they cross at 820-825 nm.

    References: S. Prahl, Oregon Medical Laser Center, from W. B. Gratzer and N. Kollias.
    """
    saturation = checks.fraction("so2", so2)
    molar_to_per_mm = np.log(10) * HAEMOGLOBIN_G_PER_L / HAEMOGLOBIN_G_PER_MOL / 10
    oxy = tabulated("hemoglobin", "oxy_per_cm_per_molar", wavelength_nm)
    deoxy = tabulated("hemoglobin", "deoxy_per_cm_per_molar", wavelength_nm)
    return np.asarray(molar_to_per_mm * (saturation * oxy + (1 - saturation) * deoxy))


def melanosome_mu_a_per_mm(wavelength_nm: ArrayLike) -> Array:
    """Absorption of the interior of a melanosome. [mm^-1]

    References: Jacques 2013, Phys. Med. Biol. 58 R37: 519 (wavelength / 500 nm)^-3 per cm.
    """
    return np.asarray(51.9 * (checked_wavelength_nm(wavelength_nm) / 500) ** -3.0)


def bloodless_skin_mu_a_per_mm(wavelength_nm: ArrayLike) -> Array:
    """Absorption of skin without blood, melanin and water: the baseline. [mm^-1]

    References: I. S. Saidi, thesis, Rice University (1992), as given by S. L. Jacques:
    0.244 + 85.3 exp(-(wavelength - 154 nm) / 66.2 nm) per cm, from bloodless neonatal skin.
    """
    return np.asarray(0.0244 + 8.53 * np.exp(-(checked_wavelength_nm(wavelength_nm) - 154) / 66.2))
