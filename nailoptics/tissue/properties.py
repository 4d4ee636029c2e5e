"""mu_a, mu_s, g and n of every region between the board and the bone, at any wavelength from 400 to 1000 nm.

And blood zones along the nail: a smooth partition of unity.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import checks
from ..errors import InputError
from ..scene.base import USUAL_MELANIN_FRACTION, USUAL_SO2
from ..scene.finger import DermisAbsorption
from .spectra import (
    Array,
    blood_mu_a_per_mm,
    bloodless_skin_mu_a_per_mm,
    checked_wavelength_nm,
    melanosome_mu_a_per_mm,
    tabulated,
)

Region = Literal["plate", "bed", "bone", "pulp", "epidermis", "epoxy", "kapton"]

REGIONS: tuple[Region, ...] = get_args(Region)

# Scalar in, scalar out: one wavelength gives floats, an array of them gives arrays.
Values = float | NDArray[np.float64]

# Reduced scattering a (wavelength / 500 nm)^-b. Skin, bone, fatty, other soft: Jacques 2013, Phys. Med. Biol. 58 R37,
# table 2. Epidermis: power law through Y. Shimojo et al., J. Biomed. Opt. 25, 045002 (2020), 532-980 nm; table 2 has
# whole skin only, which is mostly dermis and scatters 0.6 times as much.
_REDUCED_SCATTERING_PER_MM: dict[str, tuple[float, float]] = {
    "skin": (4.60, 1.421),
    "bone": (2.29, 0.716),
    "fatty": (1.84, 0.672),
    "other_soft": (1.89, 1.286),
    "epidermis": (7.56, 1.33),
}

# Dermis 1.38, epidermis 1.43, fat 1.46, nail 1.5, epoxy 1.55: the project's physics. Pulp: dermis and fat by volume.
# Bone 1.55: A. Ascenzi, C. Fabry, J. Biophys. Biochem. Cytol. 6, 139 (1959), about 1.556 for compact bone.
_INDEX: dict[str, float] = {"plate": 1.50, "bed": 1.38, "bone": 1.55, "pulp": 1.40, "epidermis": 1.43, "epoxy": 1.55}

# Tissue scatters forward alike at all these wavelengths, about 0.9 (Jacques 2013).
ANISOTROPY = 0.9

# Water by volume: dermis about 0.65, epidermis 0.6 (Jacques 2013). The pulp is taken as dermis with 0.3 of fat by
# volume (an assumption: it was found in no table), and fitted to the skin of ring fingers (assets/spectra/
# fit_fingertip_skin.py) by a factor on its scattering, with a power of the wavelength over 500 nm, and one on its
# bloodless absorption.
_BED_WATER, _EPIDERMIS_WATER, _PULP_FAT = 0.65, 0.60, 0.30
PULP_SCATTERING, PULP_SCATTERING_POWER, PULP_ABSORPTION = 1.297, 0.096, 0.572

# mu_s' of whole blood at a haematocrit of 45 %, computed by N. Bosschaart et al., Lasers Med. Sci. 29, 453 (2014): 1.34
# per mm at 800 nm, 1.26 to 1.47 between 450 and 1000 nm.
BLOOD_REDUCED_SCATTERING_PER_MM = 1.34

# Bone of the phalanx with the blood that it holds, no spectrum known that holds for it.
_BONE_MU_A_PER_MM = 0.18


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
    baseline = bloodless_skin_mu_a_per_mm(wavelength)
    match region:
        case "bed" if dermis_absorption == "jacques_baseline":
            return baseline + _BED_WATER * water
        case "bed":
            return tabulated(f"dermis_{dermis_absorption}", "mu_a_per_mm", wavelength)
        case "pulp":
            fat = tabulated("fat", "mu_a_per_mm", wavelength)
            return PULP_ABSORPTION * ((1 - _PULP_FAT) * (baseline + _BED_WATER * water) + _PULP_FAT * fat)
        case "epidermis":
            clear = baseline + _EPIDERMIS_WATER * water
            return (1 - melanin) * clear + melanin * melanosome_mu_a_per_mm(wavelength)
        case "plate":
            return tabulated("nail_plate", "mu_a_per_mm", wavelength)
        case "bone":
            return np.full_like(wavelength, _BONE_MU_A_PER_MM)
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

    g = ANISOTROPY
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


def blood_scattering_contrast(wavelength_nm: float, *, bed_scattering: float = 1.0) -> float:
    """Relative change of the bed's mu_s' by the blood fraction, where blood takes the place of dermis.

    bed_scattering : factor on the bed's scattering.

    Below 0, as dermis scatters more than blood: at 800 nm 2.36 against 1.34 per mm.
    """
    mu_s, g, _ = scattering("bed", wavelength_nm)
    return BLOOD_REDUCED_SCATTERING_PER_MM / (bed_scattering * float(mu_s * (1 - g))) - 1


def _plain(value: ArrayLike) -> Values:
    array = np.asarray(value, dtype=float)
    return float(array) if array.ndim == 0 else array


def _unknown(field: str, value: object, known: tuple[str, ...]) -> str:
    return f'{field} "{value}" is unknown; choose one of {", ".join(known)}'


def bed_zone_name(zone: int) -> str:
    """Name of a blood zone's absorber in results: bed_1 is the most proximal, zone 0."""
    return f"bed_{zone + 1}"


@dataclass(frozen=True)
class BloodZones:
    """Zones of the nail bed along v, each smoothly handing over to the next.

    Zone 0 is the most proximal, zone K - 1 reaches the tip (v grows towards the tip). Around each edge the weight
    passes from one zone to the next over `width_mm`, with a continuous slope (cubic smoothstep).

    Raises: InputError when the edges do not rise, or lie closer together than `width_mm`.
    """

    edges_mm: tuple[float, ...] = (0.0,)
    width_mm: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges_mm", tuple(float(edge) for edge in self.edges_mm))
        if not np.isfinite(self.edges_mm).all():
            raise InputError(f"zones.edges_mm = {list(self.edges_mm)} must be finite numbers; correct them")
        if not (np.isfinite(self.width_mm) and self.width_mm > 0):
            raise InputError(f"zones.width_mm = {self.width_mm:g} must be above 0; a zone's edge is smooth, not a step")
        for first, second in pairwise(self.edges_mm):
            # Closer, three zones would overlap and a weight could turn negative.
            if second - first < self.width_mm:
                raise InputError(
                    f"zones.edges_mm {first:g} and {second:g} lie closer than width_mm = {self.width_mm:g}; "
                    "move them apart (in rising order) or narrow the width"
                )

    @property
    def count(self) -> int:
        """The number of zones K, one more than edges."""
        return len(self.edges_mm) + 1

    def weights(self, v_mm: ArrayLike) -> Array:
        """How much of each zone is at v, (..., K) float in 0-1, summing to exactly 1.

        v_mm : (...) float. Place along the nail, towards the tip positive. [mm]
        """
        v = np.asarray(v_mm, dtype=float)[..., None]
        t = np.clip((v - np.asarray(self.edges_mm)) / self.width_mm + 0.5, 0.0, 1.0)
        passed = t * t * (3 - 2 * t)
        ones, zeros = np.ones_like(v), np.zeros_like(v)
        # Edges are a width apart, so at most one step is under way at any v and the sum is exact in floating point.
        return np.asarray(np.concatenate([ones, passed], axis=-1) - np.concatenate([passed, zeros], axis=-1))
