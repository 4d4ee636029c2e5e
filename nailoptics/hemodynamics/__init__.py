"""Touch to blood: the paper's network of vessels under the nail, eq. (1)-(4), and the blood of eq. (7)."""

from .arterial_gain import arterial_gain_m_per_pa
from .blood import blood_fraction, saturation, tissue_volume_m3, white_band_mm
from .contact import creeping_pressure, pressures, side_areas_mm2, spreading_pressure
from .drive import Waveform
from .parameters import NAMES, Parameters, bounds, parameters
from .respond import respond
from .steady import SteadyState, steady_state
from .waves import breathing_pressure, cardiac_pressure, vasomotion_pressure
from .zones import PAPER_ZONES, Zones, with_shear, zones, zones_between

__all__ = [
    "NAMES",
    "PAPER_ZONES",
    "Parameters",
    "SteadyState",
    "Waveform",
    "Zones",
    "arterial_gain_m_per_pa",
    "blood_fraction",
    "bounds",
    "breathing_pressure",
    "cardiac_pressure",
    "creeping_pressure",
    "parameters",
    "pressures",
    "respond",
    "saturation",
    "side_areas_mm2",
    "spreading_pressure",
    "steady_state",
    "tissue_volume_m3",
    "vasomotion_pressure",
    "white_band_mm",
    "with_shear",
    "zones",
    "zones_between",
]
