"""Touch to blood: the paper's network of vessels under the nail, eq. (1)-(4), and the blood of eq. (7)."""

from nailoptics.hemodynamics.parameters import NAMES, Parameters, bounds, parameters
from nailoptics.hemodynamics.respond import respond
from nailoptics.hemodynamics.steady import SteadyState, steady_state
from nailoptics.hemodynamics.zones import PAPER_ZONES, Zones, zones

__all__ = [
    "NAMES",
    "PAPER_ZONES",
    "Parameters",
    "SteadyState",
    "Zones",
    "bounds",
    "parameters",
    "respond",
    "steady_state",
    "zones",
]
