"""Touch to blood: what a scene's force makes of the blood under the nail, over time or held until nothing moves."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import hemodynamics
from ..scene import Body, Scene, Touch
from ..scene.base import USUAL_DECAY_LENGTH
from ..scene.touch import PRESSURES, value_at
from ..variables import Variables, precision, variable
from .waves import fastest_hz, waves_pressure

# A body begins to beat so long before the touch. [s]
WARM_UP_S = 5.0
# Its pressure goes through so many knots in the shortest of its periods: a pulse is off by 0.4 % of its height at most.
KNOTS_PER_PERIOD = 128
# A relaxation goes through so many knots in its time constant: between them it is off by 5e-4 of what is left.
KNOTS_PER_RELAXATION = 16


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
    """Times [s], (k,) float, and pressures [Pa], (M, k) float, between which they are linear.

    The pressures are the proximal one, the distal one and, where the touch shears, that of the shear.
    """
    time_s, force_n = force_course(scene)
    recorded_pa = _recorded_pressures_pa(scene)
    rows = np.array(touch_pressures_pa(scene, force_n)) if recorded_pa is None else recorded_pa
    shear_n = shear_course_n(scene)
    if shear_n is not None:
        rows = np.vstack([rows, np.abs(shear_n) / _distal_area_m2(scene)])
    return _with_recovery(*_with_creep(time_s, rows, scene.touch), relaxation_s=scene.touch.distal_relaxation_s)


def _with_creep(time_s: np.ndarray, rows: np.ndarray, touch: Touch) -> tuple[np.ndarray, np.ndarray]:
    """The same course where the pulp spreads under the touch."""
    if not touch.creep:
        return time_s, rows
    time_s, rows = _with_knots_after(time_s, rows, touch.creep_s)
    return time_s, hemodynamics.spreading_pressure(time_s, rows, part=touch.creep, time_constant_s=touch.creep_s)


def _with_recovery(
    time_s: np.ndarray, rows: np.ndarray, *, relaxation_s: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """The same course where the distal pulp, row 1, recovers slowly."""
    if relaxation_s is None:
        return time_s, rows
    time_s, rows = _with_knots_after(time_s, rows, relaxation_s)
    rows[1] = hemodynamics.creeping_pressure(time_s, rows[1], relaxation_s=relaxation_s)
    return time_s, rows


def _with_knots_after(time_s: np.ndarray, rows: np.ndarray, relaxation_s: float) -> tuple[np.ndarray, np.ndarray]:
    """The same course at as many more times as it takes to follow what dies away after each of its own."""
    after_s = relaxation_s * np.arange(1, 10 * KNOTS_PER_RELAXATION) / KNOTS_PER_RELAXATION
    gaps_s = np.append(np.diff(time_s), np.inf)
    more_s = np.concatenate([t + after_s[after_s < gap] for t, gap in zip(time_s, gaps_s, strict=True)])
    more = [hemodynamics.Waveform(time_s=time_s, pressure_pa=row).at(more_s) for row in rows]
    order = np.argsort(np.concatenate([time_s, more_s]), kind="stable")
    return np.concatenate([time_s, more_s])[order], np.hstack([rows, more])[:, order]


def shear_course_n(scene: Scene) -> np.ndarray | None:
    """The longitudinal force at the times of `force_course`, (k,) float, positive towards the tip; None if off. [N]"""
    touch, force_n = scene.touch, force_course(scene)[1]
    if touch.recorded_shear_n is not None:
        return np.array(touch.recorded_shear_n)
    if touch.shear_n is None:
        return None
    return touch.shear_n * force_n / max(float(force_n.max()), np.finfo(float).tiny)


def capillary_zones(scene: Scene) -> hemodynamics.Zones:
    """How the scene cuts the nail bed into capillary units, and how far the touch's pressures reach."""
    blood, edges_mm = scene.blood, scene.zone_edges_mm
    if len(edges_mm) == 1 and blood.decay_length is None:
        cut = hemodynamics.PAPER_ZONES
    else:
        decay_length = USUAL_DECAY_LENGTH if blood.decay_length is None else blood.decay_length
        cut = hemodynamics.zones_between(
            [0.5 + edge / _nail_length_mm(scene) for edge in edges_mm], decay_length=decay_length
        )
    return cut if shear_course_n(scene) is None else hemodynamics.with_shear(cut)


def arterial_waveform(scene: Scene) -> hemodynamics.Waveform | None:
    """The arterial pressure P_H of the scene's body over its touch and a while before; None where it does not move."""
    body = scene.body
    if body is None or not body.moves:
        return None
    if body.recorded_time_s is not None and body.recorded_arterial_pressure_pa is not None:
        return hemodynamics.Waveform(time_s=body.recorded_time_s, pressure_pa=body.recorded_arterial_pressure_pa)
    times_s = scene.touch.times_s()
    spacing_s = 1.0 / (KNOTS_PER_PERIOD * fastest_hz(body))
    since_s = np.arange(-WARM_UP_S, times_s[-1] - times_s[0] + spacing_s, spacing_s)
    pressure = waves_pressure(body, since_s, mean_pressure_pa=vessels(scene).arterial_pressure_pa)
    return hemodynamics.Waveform(time_s=times_s[0] + since_s, pressure_pa=pressure)


def blood_over_touch(
    scene: Scene, *, model: Literal["massless", "inertial"] = "massless", rtol: float = 1e-6
) -> xr.Dataset:
    """The touch over time and what it does: force, pressures, vessel diameters, and the blood fraction by zone.

    The touch and the body are followed corner by corner, so that nothing depends on how often results are sampled.

    model, rtol : as for `hemodynamics.respond`.
    """
    time_s, parameters = scene.touch.times_s(), vessels(scene)
    corner_s, corner_pa = pressure_course(scene)
    touch = [hemodynamics.Waveform(time_s=corner_s, pressure_pa=row) for row in corner_pa]
    high = arterial_waveform(scene)
    # Vessels that beat forget within seconds that they began at rest.
    before_s = time_s[:1] - WARM_UP_S if high is not None else time_s[:0]
    run = hemodynamics.respond(
        parameters,
        np.concatenate([before_s, time_s]),
        pressure_pa=touch,
        arterial_pressure_pa=high,
        zones=capillary_zones(scene),
        start="steady",
        model=model,
        rtol=rtol,
        only_diameters=True,
    ).isel(time=slice(len(before_s), None))
    run = run.drop_vars("zone_position")
    pressure_pa = np.array([row.at(time_s) for row in touch])
    high_pa = high.at(time_s) if high is not None else None
    # Zone by zone: of very many samples the arrays between are large.
    diameter_m, kept = run.capillary_diameter_m, precision(len(time_s))
    fraction = np.empty(diameter_m.shape, kept)
    for zone, row_m in zip(fraction, diameter_m.values, strict=True):
        zone[:] = _fraction(scene, parameters, row_m)
    # One by one, as they come as parts of one array.
    for name in ("capillary_diameter_m", "vein_diameter_m"):
        run[name] = run[name].astype(kept if name == "capillary_diameter_m" else float)
    return run.assign(_touch_variables(scene, time_s, pressure_pa, high_pa) | _blood_variables(scene, fraction))


def _touch_variables(
    scene: Scene, time_s: np.ndarray, pressure_pa: np.ndarray, high_pa: np.ndarray | None
) -> Variables:
    corner_s, force_n = force_course(scene)
    data = variable("force_n", "time", value_at(corner_s, force_n, time_s), "touch force", units="N")
    text = "touch pressure on the vein P_F1"
    data |= variable("proximal_pressure_pa", "time", pressure_pa[0], text, units="Pa")
    text = "touch pressure on the distal capillaries P_F2"
    data |= variable("distal_pressure_pa", "time", pressure_pa[1], text, units="Pa")
    shear_n = shear_course_n(scene)
    if shear_n is not None:
        text = "longitudinal force, positive towards the tip"
        data |= variable("shear_n", "time", value_at(corner_s, shear_n, time_s), text, units="N")
    if high_pa is not None:
        data |= variable("arterial_pressure_pa", "time", high_pa, "arterial pressure P_H", units="Pa")
    return data


def _blood_variables(scene: Scene, fraction: np.ndarray) -> Variables:
    over = ("zone", "time")
    data = variable("blood_fraction", over, fraction, "blood fraction of the nail bed")
    if scene.blood.venous_so2 is not None:
        data |= variable("so2", over, zone_so2(scene, fraction), "oxygen saturation of the nail bed's blood")
    if len(fraction) > 2:
        text = "width of the band at the tip that holds less than half of its blood at rest"
        data |= variable("white_band_mm", "time", white_band_mm(scene, fraction), text, units="mm")
    return data


def zone_so2(scene: Scene, blood_fraction: np.ndarray) -> np.ndarray:
    """Oxygen saturation of the bed's blood, from how much of it there is, any shape. [1]"""
    blood = scene.blood
    if blood.venous_so2 is None:
        return np.full(np.shape(blood_fraction), blood.so2)
    return hemodynamics.saturation(
        blood_fraction,
        rest_blood_fraction=blood.rest_blood_fraction,
        arterial_so2=blood.so2,
        venous_so2=blood.venous_so2,
    )


def white_band_mm(scene: Scene, blood_fraction: np.ndarray) -> np.ndarray:
    """Width of the white band at the tip, where the bed holds less than half of its blood at rest, (t,) float. [mm]

    blood_fraction : (zones, t) float. Taken for that at the middle of each zone, and for linear between.
    """
    half_mm = _nail_length_mm(scene) / 2
    ends = np.array([-half_mm, *scene.zone_edges_mm, half_mm])
    middle, part = 0.5 * (ends[1:] + ends[:-1]), blood_fraction / scene.blood.rest_blood_fraction
    return hemodynamics.white_band_mm(middle, part, ends_mm=(-half_mm, half_mm))


def steady_blood(scene: Scene, force_n: ArrayLike) -> np.ndarray:
    """Blood fractions once each of the forces has been held for long, (n, zones) float for (n,) forces. [1]"""
    return _steady(scene, capillary_zones(scene), _held_pressures_pa(scene, force_n))


def forces_with_two_balances_n(scene: Scene) -> np.ndarray:
    """The forces, of 101 from 0 to the touch's largest, under which the vessels could rest in two states. [N]

    There the blood depends on whether the force has grown or fallen to what it is.
    """
    force_n = np.linspace(0.0, largest_force_n(scene), 101)
    rows = np.array(np.broadcast_arrays(*_held_pressures_pa(scene, force_n)))
    state = hemodynamics.steady_state(vessels(scene), pressure_pa=rows, zones=capillary_zones(scene))
    return force_n[state.two_branches]


def _held_pressures_pa(scene: Scene, force_n: ArrayLike) -> list[np.ndarray]:
    rows = list(touch_pressures_pa(scene, force_n))
    shear_n = shear_course_n(scene)
    if shear_n is not None:
        forces_n = force_course(scene)[1]
        most = int(np.argmax(forces_n))
        rows.append(np.abs(shear_n[most]) / forces_n[most] * np.asarray(force_n) / _distal_area_m2(scene))
    return [(1.0 - (scene.touch.creep or 0.0)) * row for row in rows]


def steady_blood_at(scene: Scene, *, proximal_pressure_pa: ArrayLike, distal_pressure_pa: ArrayLike) -> np.ndarray:
    """Blood fractions once both pressures have been held for long, (n, zones) float for (n,) pressures. [1]

    A touch that shears is taken without its shear.
    """
    return _steady(scene, _without_shear(scene), [proximal_pressure_pa, distal_pressure_pa])


def blood_by_arterial_pressure(scene: Scene, frequency_hz: ArrayLike, force_n: float) -> np.ndarray:
    """Change of the blood fraction of each zone with a small wave of P_H while a force is held, (zones, F) complex.

    frequency_hz : (F,) float. [Hz]

    Returns: amplitude and phase against the wave's. A touch that shears is taken without its shear. [Pa^-1]
    """
    parameters, cut = vessels(scene), _without_shear(scene)
    pressure_pa = np.array(touch_pressures_pa(scene, force_n))
    gain = hemodynamics.arterial_gain_m_per_pa(parameters, frequency_hz, pressure_pa=pressure_pa, zones=cut)
    diameter = hemodynamics.steady_state(parameters, pressure_pa=pressure_pa[:, None], zones=cut).capillary_diameter_m
    # Blood goes with the square of the diameter.
    return np.asarray(2.0 * _fraction(scene, parameters, diameter) / diameter * gain)


def _without_shear(scene: Scene) -> hemodynamics.Zones:
    """The scene's cut of the bed for the proximal and the distal pressure alone."""
    cut = capillary_zones(scene)
    return hemodynamics.Zones(
        share=cut.share, reach=tuple((a, b) for a, b, *_ in cut.reach), vein_reach=cut.vein_reach[:2]
    )


def _steady(scene: Scene, cut: hemodynamics.Zones, pressures_pa: Sequence[ArrayLike]) -> np.ndarray:
    parameters = vessels(scene)
    rows = np.array(np.broadcast_arrays(*pressures_pa))
    state = hemodynamics.steady_state(parameters, pressure_pa=rows, zones=cut)
    return _fraction(scene, parameters, state.capillary_diameter_m).T


def _fraction(scene: Scene, parameters: hemodynamics.Parameters, diameter_m: np.ndarray) -> np.ndarray:
    rest = scene.blood.rest_blood_fraction
    return hemodynamics.blood_fraction(parameters, diameter_m, rest_blood_fraction=rest)


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
    """The blood zone above which each photodiode lies, (photodiodes,) int: 0 is the most proximal."""
    middle_mm = [element.area.center_mm[1] for element in scene.layout.photodiodes]
    return np.searchsorted(scene.zone_edges_mm, middle_mm, side="right")


def _contact(scene: Scene) -> dict[str, Any]:
    names = ("contact_area_mm2", "proximal_share", "proximal_area_mm2", "distal_area_mm2")
    return {name: getattr(scene.touch, name) for name in names}


def _recorded_pressures_pa(scene: Scene) -> np.ndarray | None:
    """The recorded proximal and distal pressure, (2, k) float; None of a touch that is given by its force. [Pa]"""
    recorded = [getattr(scene.touch, f"recorded_{name}") for name in PRESSURES]
    return None if recorded[0] is None else np.array(recorded)


def _mean_pressure_pa(body: Body | None) -> float | None:
    """The mean arterial pressure that a body states; None where it leaves that to the vessels. [Pa]"""
    if body is not None and body.recorded_time_s is not None and body.recorded_arterial_pressure_pa is not None:
        time_s, pressure_pa = np.array(body.recorded_time_s), np.array(body.recorded_arterial_pressure_pa)
        return float(np.trapezoid(pressure_pa, time_s) / (time_s[-1] - time_s[0]))
    return body.heartbeat.mean_pressure_pa if body is not None and body.heartbeat is not None else None


def _nail_length_mm(scene: Scene) -> float:
    assert scene.finger is not None
    return scene.finger.nail_length_mm


def _distal_area_m2(scene: Scene) -> float:
    return touch_areas_mm2(scene)[1] * 1e-6
