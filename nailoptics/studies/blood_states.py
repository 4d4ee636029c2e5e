"""Touch to blood: what a scene's force makes of the blood under the nail, over time or held until nothing moves."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import hemodynamics
from ..scene import Body, Scene
from ..scene.touch import PRESSURES, value_at
from ..variables import variable


def vessels(scene: Scene) -> hemodynamics.Parameters:
    """The constants of the scene's vessels: those of the named set, but for what the scene tunes.

    P_H is the mean of a body whose pressure moves.

    Raises: InputError if there is no such set.
    """
    named, tuning = hemodynamics.parameters(scene.blood.parameters), scene.blood.tuning
    own = named.replace(**tuning.of(named.as_dict())) if tuning else named
    mean_pa = _mean_pressure_pa(scene.body)
    return own if mean_pa is None else own.replace(arterial_pressure_pa=mean_pa)


def largest_force_n(scene: Scene) -> float:
    """The largest force of the scene's touch. [N]"""
    return float(np.max(force_course(scene)[1]))


def force_course(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and forces [N] between which the touch's force is linear, (k,) float; a time twice where it jumps.

    Where pressures alone were recorded the force is theirs, each on the area of its side.
    """
    time_s, force_n = scene.touch.corners()
    if not np.isnan(force_n).any():
        return time_s, force_n
    recorded_pa = _recorded_pressures_pa(scene)
    assert recorded_pa is not None
    return time_s, np.array(touch_areas_mm2(scene)) * 1e-6 @ recorded_pa


def pressure_course(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], (k,) float, and proximal and distal pressures [Pa], (2, k) float, between which they are linear."""
    time_s, force_n = force_course(scene)
    recorded_pa = _recorded_pressures_pa(scene)
    return time_s, np.array(touch_pressures_pa(scene, force_n)) if recorded_pa is None else recorded_pa


def arterial_pressure_pa(scene: Scene, time_s: np.ndarray) -> np.ndarray | None:
    """The arterial pressure P_H of the scene's body at times, (t,) float; None where it does not move. [Pa]"""
    body = scene.body
    if body is None or not body.moves:
        return None
    if body.recorded_time_s is not None and body.recorded_arterial_pressure_pa is not None:
        return np.interp(time_s, body.recorded_time_s, body.recorded_arterial_pressure_pa)
    since = time_s - scene.touch.times_s()[0]
    pressure = np.full(time_s.shape, vessels(scene).arterial_pressure_pa)
    if body.heartbeat is not None:
        beat = body.heartbeat.model_dump(exclude={"mean_pressure_pa"})
        pressure += hemodynamics.cardiac_pressure(since, mean_pressure_pa=0.0, seed=body.seed, **beat)
    if body.breathing is not None:
        pressure += hemodynamics.breathing_pressure(since, seed=body.seed, **body.breathing.model_dump())
    if body.vasomotion is not None:
        pressure += hemodynamics.vasomotion_pressure(since, seed=body.seed, **body.vasomotion.model_dump())
    return pressure


def blood_over_touch(scene: Scene) -> xr.Dataset:
    """The touch over time and what it does: force, pressures, vessel diameters, and the blood fraction by zone."""
    time_s, parameters = scene.touch.times_s(), vessels(scene)
    proximal_pa, distal_pa = (value_at(*one, time_s) for one in _each(*pressure_course(scene)))
    high_pa = arterial_pressure_pa(scene, time_s)
    run = hemodynamics.respond(
        parameters,
        time_s,
        proximal_pressure_pa=proximal_pa,
        distal_pressure_pa=distal_pa,
        arterial_pressure_pa=high_pa,
        start="steady",
    )
    kept = ["capillary_diameter_m", "vein_diameter_m", "proximal_pressure_pa", "distal_pressure_pa"]
    run = run[kept if high_pa is None else [*kept, "arterial_pressure_pa"]]
    fraction = hemodynamics.blood_fraction(
        parameters, run.capillary_diameter_m.values, rest_blood_fraction=scene.blood.rest_blood_fraction
    )
    data = variable("blood_fraction", ("zone", "time"), fraction, "blood fraction of the nail bed")
    data |= variable("force_n", "time", value_at(*force_course(scene), time_s), "touch force", units="N")
    return run.drop_vars("zone_position").assign(data)


def steady_blood(scene: Scene, force_n: ArrayLike) -> np.ndarray:
    """Blood fractions once each of the forces has been held for long, (n, zones) float for (n,) forces. [1]"""
    proximal_pa, distal_pa = touch_pressures_pa(scene, force_n)
    return steady_blood_at(scene, proximal_pressure_pa=proximal_pa, distal_pressure_pa=distal_pa)


def steady_blood_at(scene: Scene, *, proximal_pressure_pa: ArrayLike, distal_pressure_pa: ArrayLike) -> np.ndarray:
    """Blood fractions once both pressures have been held for long, (n, zones) float for (n,) pressures. [1]"""
    parameters = vessels(scene)
    state = hemodynamics.steady_state(
        parameters, proximal_pressure_pa=proximal_pressure_pa, distal_pressure_pa=distal_pressure_pa
    )
    fraction = hemodynamics.blood_fraction(
        parameters, state.capillary_diameter_m, rest_blood_fraction=scene.blood.rest_blood_fraction
    )
    return fraction.T


def touch_pressures_pa(scene: Scene, force_n: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Proximal and distal pressure of a force that presses as the scene's touch does. [Pa]

    Recorded pressures have the ratio that they have where the force is largest.
    """
    recorded_pa = _recorded_pressures_pa(scene)
    if recorded_pa is None:
        return hemodynamics.pressures(force_n, **_contact(scene))
    forces_n = force_course(scene)[1]
    most = int(np.argmax(forces_n))
    per_n = recorded_pa[:, most] / forces_n[most] if forces_n[most] > 0 else np.zeros(2)
    return per_n[0] * np.asarray(force_n, float), per_n[1] * np.asarray(force_n, float)


def touch_areas_mm2(scene: Scene) -> tuple[float, float]:
    """Area on which the scene's touch presses the proximal and the distal pulp. [mm^2]"""
    return hemodynamics.side_areas_mm2(**_contact(scene))


def zones_of_photodiodes(scene: Scene) -> np.ndarray:
    """The blood zone above which each photodiode lies, (photodiodes,) int: 0 is proximal."""
    edge_mm = scene.blood.zone_edges_mm[0]
    return np.array([int(element.area.center_mm[1] >= edge_mm) for element in scene.layout.photodiodes])


def _each(time_s: np.ndarray, rows: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(time_s, row) for row in rows]


def _contact(scene: Scene) -> dict[str, Any]:
    names = ("contact_area_mm2", "proximal_share", "proximal_area_mm2", "distal_area_mm2")
    return {name: getattr(scene.touch, name) for name in names}


def _recorded_pressures_pa(scene: Scene) -> np.ndarray | None:
    """The recorded proximal and distal pressure, (2, k) float; None of a touch that is told by its force. [Pa]"""
    recorded = [getattr(scene.touch, f"recorded_{name}") for name in PRESSURES]
    return None if recorded[0] is None else np.array(recorded)


def _mean_pressure_pa(body: Body | None) -> float | None:
    """The mean arterial pressure that a body states; None where it leaves that to the vessels. [Pa]"""
    if body is not None and body.recorded_time_s is not None and body.recorded_arterial_pressure_pa is not None:
        time_s, pressure_pa = np.array(body.recorded_time_s), np.array(body.recorded_arterial_pressure_pa)
        return float(np.trapezoid(pressure_pa, time_s) / (time_s[-1] - time_s[0]))
    return body.heartbeat.mean_pressure_pa if body is not None and body.heartbeat is not None else None
