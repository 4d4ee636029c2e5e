"""Blood to media: from chromophores to mu_a, mu_s, g and n of every region, and the blood zones under the nail."""

from .properties import (
    REGIONS,
    BloodZones,
    absorption,
    bed_zone_name,
    blood_scattering_contrast,
    scattering,
)
from .spectra import WAVELENGTH_RANGE_NM, blood_mu_a_per_mm
