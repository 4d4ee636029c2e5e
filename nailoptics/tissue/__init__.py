"""Blood to media: from chromophores to mu_a, mu_s, g and n of every region, and the blood zones under the nail."""

from .properties import (
    REGIONS,
    REST_BLOOD_FRACTION,
    BloodZones,
    absorption,
    bed_zone_name,
    blood_scattering_contrast,
    optical_properties,
    scattering,
)
from .spectra import WAVELENGTH_RANGE_NM, blood_mu_a_per_mm
