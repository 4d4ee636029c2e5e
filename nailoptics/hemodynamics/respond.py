"""The response over time to touch and pulse: inputs checked, a model chosen, results labelled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from . import inertial, massless
from .drive import Drive
from .parameters import Parameters
from .steady import finite, steady_state, touch_inputs, wall_pressures
from .walls import build_walls, massless_rates, moving
from .zones import PAPER_ZONES, Zones

if TYPE_CHECKING:
    import xarray


def respond(
    parameters: Parameters,
    time_s: ArrayLike,
    *,
    proximal_pressure_pa: ArrayLike = 0.0,
    distal_pressure_pa: ArrayLike = 0.0,
    arterial_pressure_pa: ArrayLike | None = None,
    venous_pressure_pa: ArrayLike | None = None,
    zones: Zones = PAPER_ZONES,
    pressure_pa: ArrayLike | None = None,
    start: Literal["untouched", "steady"] = "untouched",
    model: Literal["reduced", "full"] = "reduced",
    contact: bool = True,
    rtol: float = 1e-6,
) -> xarray.Dataset:
    """Return diameters and pressures over time.

    time_s : (T,) float, increasing, T of 2 or more. [s]
    proximal_pressure_pa, distal_pressure_pa : (T,) float or one number. P_F1 and P_F2, linear between samples. [Pa]
    arterial_pressure_pa, venous_pressure_pa : (T,) float or one number. P_H (see ``pulse``) and P_L; None takes the
        parameters' values. [Pa]
    zones : units along the nail and the reach of each pressure; the paper's two by default.
    pressure_pa : (M, T) float. All touch pressures, for zones with other than two inputs. [Pa]
    start : at time_s[0] the vessels are in balance with no touch ("untouched": a pressure there is a step at that
        instant) or with the first pressures ("steady").
    model : "reduced" has massless walls, the tool; "full" is the paper's six-state model (4 N + 2 - N states for N
        units), the check: it agrees within 1e-5 um and takes many times as long.
    contact : False, in the full model only, lets walls pass through each other as printed.
    rtol : allowed error of a step, relative to a diameter. A noisy record has a kink at every sample to be resolved:
        1e-4 is then several times as fast. [1]

    The Dataset has dims zone and time; capillary_diameter_m (zone, time), capillary_pressure_pa (zone, time),
    vein_diameter_m (time), vein_pressure_pa (time), capillary_closed (zone, time), vein_closed (time), and the inputs.
    Eq. (3)-(4) of the paper move A dx/dt of blood, which is not the change of its eq. (7): the paper's areas and
    diameters disagree on volume. Here (3)-(4) give the motion, (7) the blood (``blood_fraction``), as in the paper.

    Raises
    ------
    InputError
        If times do not increase, shapes differ, or a value is not finite.
    NotReachedError
        If the tolerance cannot be met.

    References: Mascaro and Asada 2001, eq. (1)-(4).
    """
    time = _times(time_s)
    if not (np.isfinite(rtol) and 1e-13 <= rtol <= 0.1):
        raise InputError(f"hemodynamics.rtol must lie between 1e-13 and 0.1, got {rtol}; 1e-6 is usual.")
    if model not in ("reduced", "full"):
        raise InputError(f"hemodynamics.model must be 'reduced' or 'full', got {model!r}.")
    if start not in ("untouched", "steady"):
        raise InputError(f"hemodynamics.start must be 'untouched' or 'steady', got {start!r}.")
    if model == "reduced" and not contact:
        raise InputError("hemodynamics.contact can be left out of model 'full' only; use model='full'.")
    p = parameters
    touch = np.array(
        [
            _over_time("pressure_pa", t, time)
            for t in touch_inputs(zones, proximal_pressure_pa, distal_pressure_pa, pressure_pa)
        ]
    )
    high = _over_time(
        "arterial_pressure_pa", p.arterial_pressure_pa if arterial_pressure_pa is None else arterial_pressure_pa, time
    )
    low = _over_time(
        "venous_pressure_pa", p.venous_pressure_pa if venous_pressure_pa is None else venous_pressure_pa, time
    )
    rest = steady_state(
        p,
        arterial_pressure_pa=high[0],
        venous_pressure_pa=low[0],
        zones=zones,
        pressure_pa=touch[:, 0] if start == "steady" else np.zeros(zones.inputs),
    )
    first = np.append(rest.capillary_diameter_m, rest.vein_diameter_m)
    walls = build_walls(p, zones)
    outside = wall_pressures(zones, touch)
    drive = Drive(time, np.vstack([high, low, outside]))
    if model == "reduced":
        run = massless.integrate(walls, drive, time, first, rtol=rtol)
        force = [
            a * f + k * (w - d)
            for a, f, k, w, d in zip(walls.area, outside, walls.stiffness, run.width_m, walls.diameter, strict=True)
        ]
        pressure, _ = massless_rates(walls, run.width_m, force, run.free, high, low)
        width, closed = run.width_m, run.free == 0.0
    else:
        state = inertial.integrate(walls, drive, time, first, rtol=rtol, contact=contact)
        pressure = moving(walls, state.width_m, state.speed_m_per_s, high, low)
        width, closed = state.width_m, state.closed
    return _dataset(p, zones, time, width, np.array(pressure), closed, touch, high, low, model)


def _times(time_s: ArrayLike) -> np.ndarray:
    time = finite("time_s", time_s)
    if time.ndim != 1 or time.size < 2:
        raise InputError(f"hemodynamics.time_s must be one row of two or more times, got shape {time.shape}.")
    step = np.diff(time)
    if np.any(step <= 0.0):
        i = int(np.argmax(step <= 0.0)) + 1
        raise InputError(
            f"hemodynamics.time_s[{i}] must come after {time[i - 1]:g} s, got {time[i]:g} s; sort the times."
        )
    return time


def _over_time(name: str, value: ArrayLike, time: np.ndarray) -> np.ndarray:
    array = finite(name, value)
    if array.shape not in ((), time.shape):
        raise InputError(
            f"hemodynamics.{name} must be one number or one for each of {time.size} times, got shape {array.shape}."
        )
    return np.broadcast_to(array, time.shape)


def _dataset(
    parameters: Parameters,
    zones: Zones,
    time: np.ndarray,
    width: np.ndarray,
    pressure: np.ndarray,
    closed: np.ndarray,
    touch: np.ndarray,
    high: np.ndarray,
    low: np.ndarray,
    model: str,
) -> xarray.Dataset:
    import xarray

    n = zones.count

    def over(dims: Any, data: np.ndarray, units: str, long_name: str) -> tuple[Any, np.ndarray, dict[str, str]]:
        return dims, data, {"units": units, "long_name": long_name}

    variables = {
        "capillary_diameter_m": over(("zone", "time"), width[:n], "m", "capillary diameter D_C + x_C"),
        "capillary_pressure_pa": over(("zone", "time"), pressure[:n], "Pa", "capillary blood pressure"),
        "capillary_closed": over(("zone", "time"), closed[:n], "1", "capillary walls in contact"),
        "vein_diameter_m": over("time", width[n], "m", "vein diameter D_V + x_V"),
        "vein_pressure_pa": over("time", pressure[n], "Pa", "vein blood pressure"),
        "vein_closed": over("time", closed[n], "1", "vein walls in contact"),
        "arterial_pressure_pa": over("time", np.array(high), "Pa", "arterial pressure P_H"),
        "venous_pressure_pa": over("time", np.array(low), "Pa", "venous pressure P_L"),
    }
    if zones.inputs == 2:
        variables["proximal_pressure_pa"] = over("time", touch[0], "Pa", "touch pressure on the vein P_F1")
        variables["distal_pressure_pa"] = over("time", touch[1], "Pa", "touch pressure on the distal capillaries P_F2")
    else:
        variables["touch_pressure_pa"] = over(("input", "time"), touch, "Pa", "touch pressure inputs")
    coordinates = {
        "time": over("time", time, "s", "time"),
        "zone": ("zone", zones.names, {"long_name": "capillary unit, from the cuticle to the tip"}),
        "zone_position": over("zone", zones.position, "1", "centre of the unit along the bed, 0 cuticle to 1 tip"),
    }
    attributes = {
        "Conventions": "CF-1.11",
        "title": "touch to blood: vessel diameters and pressures under the nail",
        "references": "Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (1)-(4)",
        "model": model,
        **{f"parameter_{name}": value for name, value in parameters.as_dict().items()},
    }
    return xarray.Dataset(variables, coordinates, attributes)
