"""Touch to blood: the paper's network of vessels under the nail, eq. (1)-(4), and the blood of eq. (7)."""

from nailoptics.hemodynamics.blood import blood_fraction, tissue_volume_m3
from nailoptics.hemodynamics.energy import energy
from nailoptics.hemodynamics.parameters import NAMES, Parameters, bounds, parameters
from nailoptics.hemodynamics.pulse import cardiac_pressure
from nailoptics.hemodynamics.respond import respond
from nailoptics.hemodynamics.steady import SteadyState, steady_state
from nailoptics.hemodynamics.touch import pressures
from nailoptics.hemodynamics.zones import PAPER_ZONES, Zones, zones

__all__ = [
    "NAMES",
    "PAPER_ZONES",
    "Parameters",
    "SteadyState",
    "Zones",
    "blood_fraction",
    "bounds",
    "cardiac_pressure",
    "energy",
    "parameters",
    "pressures",
    "respond",
    "steady_state",
    "tissue_volume_m3",
    "zones",
]
