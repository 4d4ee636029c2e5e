"""The curves of the paper's figures from any set: steps on and off, steady readings, and a press by a measured force.

Readings are those of eq. (9) with unit gain, counted from rest: minus the change of blood, relative to rest. [1]
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..hemodynamics.contact import pressures
from ..hemodynamics.parameters import Parameters
from ..hemodynamics.respond import respond
from ..hemodynamics.steady import steady_state
from ..hemodynamics.zones import PAPER_ZONES, Zones
from ..variables import variable
from .responses import N_PER_CM2, ON_S, STEPS_PA

if TYPE_CHECKING:
    import xarray


def readings(capillary_diameter_m: np.ndarray, rest_m: np.ndarray, zones: Zones = PAPER_ZONES) -> np.ndarray:
    """The proximal and the distal reading, (2, ...) float, from (N, ...) diameters and (N,) at rest. [1]

    Each photodiode sees its half of the bed: the mean over its units, weighted by their shares.
    """
    blood = (capillary_diameter_m / rest_m.reshape((-1,) + (1,) * (capillary_diameter_m.ndim - 1))) ** 2
    share, proximal = np.asarray(zones.share), zones.position < 0.5
    halves = [np.tensordot(share[half], blood[half], axes=1) / share[half].sum() for half in (proximal, ~proximal)]
    return 1.0 - np.array(halves)


def steps(parameters: Parameters, *, distal_part: float) -> "xarray.Dataset":
    """The response to the paper's steps of pressure, on at 0 and off at 2 s: Fig. 10 (distal_part 0) and Fig. 11 (1).

    Dims pressure (10, N/cm^2), zone, time (1 kHz to 4 s).
    """
    import xarray

    time = np.arange(0.0, 2.0 * ON_S, 1e-3)
    touches = [np.where(time < ON_S, pressure, 0.0) for pressure in STEPS_PA]
    runs = [respond(parameters, time, proximal_pressure_pa=t, distal_pressure_pa=distal_part * t) for t in touches]
    axis = variable("pressure", "pressure", STEPS_PA / N_PER_CM2, "touch pressure of the step", units="N cm-2")
    return xarray.concat(runs, dim="pressure", data_vars="all").assign_coords(axis)


def static_readings(parameters: Parameters, pressure_pa: ArrayLike, *, zones: Zones = PAPER_ZONES) -> np.ndarray:
    """The (2, S) steady readings where both pressures are the same (Figs. 12, 15, 16). [1]"""
    touch = np.asarray(pressure_pa, dtype=float)
    state = steady_state(parameters, proximal_pressure_pa=touch, distal_pressure_pa=touch, zones=zones)
    rest = steady_state(parameters, zones=zones).capillary_diameter_m
    return readings(state.capillary_diameter_m, rest, zones)


def press(parameters: Parameters, time_s: ArrayLike, force_n: ArrayLike, *, zones: Zones = PAPER_ZONES) -> np.ndarray:
    """The (2, T) readings of an even touch on 1 cm^2 with a force over time (Figs. 17, 18). [1]"""
    proximal, distal = pressures(force_n)
    run = respond(parameters, time_s, proximal_pressure_pa=proximal, distal_pressure_pa=distal, zones=zones)
    rest = steady_state(parameters, zones=zones).capillary_diameter_m
    return readings(run["capillary_diameter_m"].values, rest, zones)
