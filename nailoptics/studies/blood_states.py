"""Touch to blood: what a scene's force makes of the blood under the nail, over time or held until nothing moves."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import hemodynamics
from ..scene import Scene


def largest_force_n(scene: Scene) -> float:
    """The largest force of the scene's touch, recorded or stated. [N]"""
    touch = scene.touch
    return max(touch.recorded_force_n) if touch.recorded_force_n else touch.force_n


def blood_over_touch(scene: Scene) -> xr.Dataset:
    """The touch over time and what it does: force, pressures, vessel diameters, and the blood fraction by zone."""
    time_s = scene.touch.times_s()
    force_n = scene.touch.force_at(time_s)
    parameters = hemodynamics.parameters(scene.blood.parameters)
    proximal_pa, distal_pa = touch_pressures_pa(scene, force_n)
    run = hemodynamics.respond(
        parameters, time_s, proximal_pressure_pa=proximal_pa, distal_pressure_pa=distal_pa, start="steady"
    )
    run = run[["capillary_diameter_m", "vein_diameter_m", "proximal_pressure_pa", "distal_pressure_pa"]]
    fraction = hemodynamics.blood_fraction(
        parameters, run.capillary_diameter_m.values, rest_blood_fraction=scene.blood.rest_blood_fraction
    )
    run["blood_fraction"] = (("zone", "time"), fraction, {"units": "1", "long_name": "blood fraction of the nail bed"})
    run["force_n"] = ("time", force_n, {"units": "N", "long_name": "touch force"})
    return run.drop_vars("zone_position")


def steady_blood(scene: Scene, force_n: ArrayLike) -> np.ndarray:
    """Blood fractions once each of the forces has been held for long, (n, zones) float for (n,) forces. [1]"""
    proximal_pa, distal_pa = touch_pressures_pa(scene, force_n)
    return steady_blood_at(scene, proximal_pressure_pa=proximal_pa, distal_pressure_pa=distal_pa)


def steady_blood_at(scene: Scene, *, proximal_pressure_pa: ArrayLike, distal_pressure_pa: ArrayLike) -> np.ndarray:
    """Blood fractions once both pressures have been held for long, (n, zones) float for (n,) pressures. [1]"""
    parameters = hemodynamics.parameters(scene.blood.parameters)
    state = hemodynamics.steady_state(
        parameters, proximal_pressure_pa=proximal_pressure_pa, distal_pressure_pa=distal_pressure_pa
    )
    fraction = hemodynamics.blood_fraction(
        parameters, state.capillary_diameter_m, rest_blood_fraction=scene.blood.rest_blood_fraction
    )
    return fraction.T


def touch_pressures_pa(scene: Scene, force_n: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Proximal and distal pressure of a force that presses as the scene's touch does. [Pa]"""
    return hemodynamics.pressures(force_n, **_contact(scene))


def touch_areas_mm2(scene: Scene) -> tuple[float, float]:
    """Area on which the scene's touch presses the proximal and the distal pulp. [mm^2]"""
    return hemodynamics.side_areas_mm2(**_contact(scene))


def _contact(scene: Scene) -> dict[str, Any]:
    names = ("contact_area_mm2", "proximal_share", "proximal_area_mm2", "distal_area_mm2")
    return {name: getattr(scene.touch, name) for name in names}


def zones_of_photodiodes(scene: Scene) -> np.ndarray:
    """The blood zone above which each photodiode lies, (photodiodes,) int: 0 is proximal."""
    edge_mm = scene.blood.zone_edges_mm[0]
    return np.array([int(element.area.center_mm[1] >= edge_mm) for element in scene.layout.photodiodes])
