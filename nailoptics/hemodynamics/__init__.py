"""Touch to blood: the paper's network of vessels under the nail, eq. (1)-(4), and the blood of eq. (7)."""

from .blood import blood_fraction, saturation, saturation_over_time, white_band_mm
from .drive import Waveform
from .parameters import NAMES, Parameters, bounds, parameters
from .respond import respond
from .steady import SteadyState, steady_state
from .touch import Contact, relaxing_pressure, spreading_pressure
from .waves import breathing_pressure, cardiac_pressure, vasomotion_pressure
from .zones import PAPER_ZONES, Zones, zones_between
