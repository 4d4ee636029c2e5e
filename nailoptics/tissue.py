"""BLOOD -> MEDIA: mu_a, mu_s, g and n of every region at 400 to 1000 nm, and blood zones under the nail."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks
from .assets import WAVELENGTH_RANGE_NM, read_table, read_toml
from .errors import InputError
from .scene.base import USUAL_MELANIN_FRACTION, USUAL_SO2
from .scene.finger import DermisAbsorption

Array = NDArray[np.float64]
Region = Literal["plate", "bed", "bone", "pulp", "epidermis", "epoxy", "kapton"]

REGIONS: tuple[Region, ...] = get_args(Region)

# Scalar in, scalar out: one wavelength gives floats, an array of them gives arrays.
Values = float | NDArray[np.float64]

_FACTS = read_toml("tissue.toml")
_REDUCED_SCATTERING_PER_MM: dict[str, tuple[float, float]] = _FACTS["reduced_scattering_per_mm"]
_INDEX: dict[str, float] = _FACTS["index"]
_PULP_FAT: float = _FACTS["pulp"]["fat"]
PULP_SCATTERING, PULP_SCATTERING_POWER, PULP_ABSORPTION = (
    float(_FACTS["pulp"][name]) for name in ("scattering", "scattering_power", "absorption")
)


def checked_wavelength_nm(wavelength_nm: ArrayLike) -> Array:
    """The wavelengths as an array; InputError where one lies outside the tables."""
    wavelength = np.asarray(wavelength_nm, dtype=float)
    low, high = WAVELENGTH_RANGE_NM
    outside = ~((wavelength >= low) & (wavelength <= high))
    if outside.any():
        why = f"has no optical data; choose from {low:g} to {high:g} nm"
        raise InputError(f"wavelength_nm = {wavelength[outside].flat[0]:g} {why}")
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
    molar_to_per_mm = np.log(10) * 150.0 / 64500.0 / 10
    oxy = tabulated("hemoglobin", "oxy_per_cm_per_molar", wavelength_nm)
    deoxy = tabulated("hemoglobin", "deoxy_per_cm_per_molar", wavelength_nm)
    return np.asarray(molar_to_per_mm * (saturation * oxy + (1 - saturation) * deoxy))


@dataclass(frozen=True)
class Absorption:
    """Absorption that is linear in the blood: mu_a = base_per_mm + blood_fraction * per_blood_fraction_per_mm."""

    base_per_mm: Values
    per_blood_fraction_per_mm: Values


def absorption(
    region: Region,
    wavelength_nm: ArrayLike,
    *,
    so2: ArrayLike = USUAL_SO2,
    melanin_fraction: float = USUAL_MELANIN_FRACTION,
    dermis_absorption: DermisAbsorption = "jacques_baseline",
) -> Absorption:
    """The absorption of a region as a base and a slope in the blood fraction.

    The two numbers are all that a stored trace needs to be reweighted to another blood state, saturation or wavelength.
    Blood is added to the tissue, it displaces none: at 5 % that misjudges the base, itself a small part, by 5 %.

    region : One of `REGIONS`. Bed and pulp carry blood; the slope of the others is 0.
    wavelength_nm : array in `WAVELENGTH_RANGE_NM`. [nm]
    so2 : array that broadcasts with it. Oxygen saturation of the blood, 0-1.
    melanin_fraction : Volume of melanosomes in the epidermis, 0-1; other regions have none.
    dermis_absorption : What the bed absorbs without blood. "jacques_baseline" is the bloodless baseline and 65 %
        water. "shimojo" and "salomatina" are dermis measured ex vivo, water included, a factor 2 apart; blood left in
        those samples is then counted twice. The baseline is the default because it is the median of five measurements:
        ex vivo at 633 nm 0.031 per mm (Saidi 1992, bloodless, newborns, and water), 0.033 (Simpson 1998, 12 samples,
        a method made for absorption), 0.070 (Shimojo 2020) and 0.149 (Salomatina 2006); in vivo at 850 nm, where the
        baseline has 0.027, 0.005 with its blood (Jonasson 2023, median of 3809 people).

    Raises: InputError for an unknown region or choice, or a value out of range.

    References: Jacques 2013, Phys. Med. Biol. 58 R37; C. R. Simpson et al., Phys. Med. Biol. 43, 2465 (1998); Jonasson
    et al., J. Biomed. Opt. 28, 115001 (2023); on why values in vivo are smaller R. Graaff et al., Appl. Opt. 32, 435
    (1993); the headers of the shipped spectra.
    """
    wavelength = checked_wavelength_nm(wavelength_nm)
    checks.fraction("so2", so2)
    melanin = checks.fraction("melanin_fraction", melanin_fraction)
    if dermis_absorption not in get_args(DermisAbsorption):
        raise InputError(_unknown("dermis_absorption", dermis_absorption, get_args(DermisAbsorption)))
    base = _base_per_mm(region, wavelength, melanin, dermis_absorption)
    slope = blood_mu_a_per_mm(wavelength, so2) if region in ("bed", "pulp") else np.zeros_like(wavelength)
    return Absorption(base_per_mm=_plain(base), per_blood_fraction_per_mm=_plain(slope))


def _base_per_mm(region: Region, wavelength: Array, melanin: Array, dermis_absorption: DermisAbsorption) -> Array:
    """Absorption of a region without blood, of the shape of the wavelengths [nm]. [mm^-1]"""
    water = tabulated("water", "mu_a_per_mm", wavelength)
    # Skin without blood, melanin and water (neonatal): I. S. Saidi, thesis, Rice University (1992), as given by S. L.
    # Jacques: 0.244 + 85.3 exp(-(wavelength - 154 nm) / 66.2 nm) per cm.
    baseline = 0.0244 + 8.53 * np.exp(-(wavelength - 154) / 66.2)
    match region:
        case "bed" if dermis_absorption == "jacques_baseline":
            return baseline + _FACTS["water"]["bed"] * water
        case "bed":
            return tabulated(f"dermis_{dermis_absorption}", "mu_a_per_mm", wavelength)
        case "pulp":
            fat = tabulated("fat", "mu_a_per_mm", wavelength)
            return PULP_ABSORPTION * ((1 - _PULP_FAT) * (baseline + _FACTS["water"]["bed"] * water) + _PULP_FAT * fat)
        case "epidermis":
            clear = baseline + _FACTS["water"]["epidermis"] * water
            # The interior of a melanosome: Jacques 2013, Phys. Med. Biol. 58 R37: 519 (wavelength / 500 nm)^-3 per cm.
            return (1 - melanin) * clear + melanin * (51.9 * (wavelength / 500) ** -3.0)
        case "plate":
            return tabulated("nail_plate", "mu_a_per_mm", wavelength)
        case "bone":
            return np.full_like(wavelength, _FACTS["bone_mu_a_per_mm"])
        case "epoxy":
            return np.zeros_like(wavelength)
        case "kapton":
            return 4 * np.pi * tabulated("kapton", "k", wavelength) / (wavelength * 1e-6)
        case _:
            raise InputError(_unknown("region", region, REGIONS))


def scattering(region: Region, wavelength_nm: ArrayLike) -> tuple[Values, Values, Values]:
    """Scattering of a region, (mu_s [mm^-1], g, n): it depends on the wavelength alone.

    mu_s = mu_s' / (1 - g). Blood's own scattering is part of the measured tissue values and does not change with
    the blood fraction here.

    Raises: InputError for an unknown region or a wavelength without data.

    References: Jacques 2013, Phys. Med. Biol. 58 R37, table 2; the headers of the shipped spectra.
    """
    wavelength = checked_wavelength_nm(wavelength_nm)

    def power_law(tissue: str) -> Array:
        a, b = _REDUCED_SCATTERING_PER_MM[tissue]
        return np.asarray(a * (wavelength / 500) ** -b)

    g: float = _FACTS["anisotropy"]
    match region:
        case "bed":
            reduced = power_law("skin")
        case "bone" | "epidermis":
            reduced = power_law(region)
        case "pulp":
            mixed = (1 - _PULP_FAT) * power_law("other_soft") + _PULP_FAT * power_law("fatty")
            reduced = PULP_SCATTERING * (wavelength / 500) ** PULP_SCATTERING_POWER * mixed
        case "plate":
            reduced = tabulated("nail_plate", "mu_s_reduced_per_mm", wavelength)
        case "epoxy" | "kapton":
            reduced, g = np.zeros_like(wavelength), 0.0
        case _:
            raise InputError(_unknown("region", region, REGIONS))
    n = tabulated("kapton", "n", wavelength) if region == "kapton" else np.full_like(wavelength, _INDEX[region])
    return _plain(reduced / (1 - g)), _plain(np.full_like(wavelength, g)), _plain(n)


def blood_scattering_contrast(wavelength_nm: float, *, bed_scattering: float) -> float:
    """Relative change of the bed's mu_s' by the blood fraction, where blood takes the place of dermis.

    bed_scattering : factor on the bed's scattering.

    Below 0, as dermis scatters more than blood: at 800 nm 2.36 against 1.34 per mm.
    """
    mu_s, g, _ = scattering("bed", wavelength_nm)
    return _FACTS["blood_reduced_scattering_per_mm"] / (bed_scattering * float(mu_s * (1 - g))) - 1


def _plain(value: ArrayLike) -> Values:
    array = np.asarray(value, dtype=float)
    return float(array) if array.ndim == 0 else array


def _unknown(field: str, value: object, known: tuple[str, ...]) -> str:
    return f'{field} "{value}" is unknown; choose one of {", ".join(known)}'


def bed_zone_name(zone: int) -> str:
    """Name of a blood zone's absorber in results: bed_1 is the most proximal, zone 0."""
    return f"bed_{zone + 1}"


def smoothstep(x: ArrayLike) -> Array:
    """0 below 0, 1 above 1, and smooth between."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


@dataclass(frozen=True)
class BloodZones:
    """Zones of the nail bed along v, each smoothly handing over to the next.

    Zone 0 is the most proximal, zone K - 1 reaches the tip (v grows towards the tip). Around each edge the weight
    passes from one zone to the next over `width_mm`, with a continuous slope (cubic smoothstep).
    `[blood]` sees to it that edges rise, by at least that width.
    """

    edges_mm: tuple[float, ...] = (0.0,)
    width_mm: float = 2.0

    def weights(self, v_mm: ArrayLike) -> Array:
        """How much of each zone is at v, (..., K) float in 0-1, summing to exactly 1.

        v_mm : (...) float. Place along the nail, towards the tip positive. [mm]
        """
        v = np.asarray(v_mm, dtype=float)[..., None]
        passed = smoothstep((v - np.asarray(self.edges_mm)) / self.width_mm + 0.5)
        ones, zeros = np.ones_like(v), np.zeros_like(v)
        # Edges are a width apart, so at most one step is under way at any v and the sum is exact in floating point.
        return np.asarray(np.concatenate([ones, passed], axis=-1) - np.concatenate([passed, zeros], axis=-1))
