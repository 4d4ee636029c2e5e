"""Where the work of heart and touch goes in a response: walls, flow and dampers; a check on the integrator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .parameters import Parameters
from .steady import wall_pressures
from .walls import build_walls, massless_rates
from .zones import PAPER_ZONES, Zones

if TYPE_CHECKING:
    import xarray


def energy(parameters: Parameters, run: xarray.Dataset, *, zones: Zones = PAPER_ZONES) -> xarray.Dataset:
    """Return the energy account of a response of the reduced model, from ``respond`` with the same zones.

    work_w (time) : power that P_H, P_L and the touch put in. [W]
    dissipated_w (time) : power lost to viscosity and to the walls' dampers. [W]
    stored_j (time) : energy in the walls' springs. [J]

    Contact does no work: a wall in contact stands still. So d(stored)/dt = work - dissipated at every instant, and over
    any span the integrals balance within the integrator's error.
    """
    import xarray

    walls = build_walls(parameters, zones)
    n = zones.count
    width = np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values])
    closed = np.vstack([run["capillary_closed"].values, run["vein_closed"].values])
    high, low = run["arterial_pressure_pa"].values, run["venous_pressure_pa"].values
    if "touch_pressure_pa" in run:
        touch = run["touch_pressure_pa"].values
    else:
        touch = np.vstack([run["proximal_pressure_pa"].values, run["distal_pressure_pa"].values])
    outside = wall_pressures(zones, touch)
    area, damping, stiffness, rest, factor = (
        np.array(values)[:, None]
        for values in (walls.area, walls.damping, walls.stiffness, walls.diameter, walls.flow_factor)
    )
    stretch = width - rest
    load = area * outside + stiffness * stretch
    pressures, speeds = massless_rates(walls, list(width), list(load), list(np.where(closed, 0.0, 1.0)), high, low)
    pressure, speed = np.array(pressures), np.array(speeds)
    conductance = factor * width**4
    venule = np.array(walls.venule)[:, None]
    entering = (high - pressure[:n]) * conductance[:n]
    leaving = (pressure[n] - low) * conductance[n]
    work = high * entering.sum(axis=0) - low * leaving - (outside * area * speed).sum(axis=0)
    lost = (
        ((high - pressure[:n]) * entering).sum(axis=0)
        + ((pressure[:n] - pressure[n]) ** 2 * venule).sum(axis=0)
        + (pressure[n] - low) * leaving
        + (damping * speed**2).sum(axis=0)
    )
    stored = 0.5 * (stiffness * stretch**2).sum(axis=0)
    return xarray.Dataset(
        {
            "work_w": ("time", work, {"units": "W", "long_name": "power of heart and touch"}),
            "dissipated_w": ("time", lost, {"units": "W", "long_name": "power lost to viscosity and damping"}),
            "stored_j": ("time", stored, {"units": "J", "long_name": "energy in the walls' springs"}),
        },
        {"time": run["time"]},
    )
