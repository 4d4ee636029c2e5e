"""The response over time to touch and pulse: inputs checked, a model chosen, results labelled."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite
from ..errors import InputError
from ..variables import Variable, variable
from . import inertial, massless
from .drive import Drive, Waveform, waveform_of
from .parameters import Parameters
from .steady import solve_walls, touch_inputs, wall_pressures
from .walls import Walls, build_walls
from .zones import PAPER_ZONES, Zones

if TYPE_CHECKING:
    import xarray

Model = Literal["massless", "inertial"]


def respond(
    parameters: Parameters,
    time_s: ArrayLike,
    *,
    proximal_pressure_pa: ArrayLike | Waveform = 0.0,
    distal_pressure_pa: ArrayLike | Waveform = 0.0,
    arterial_pressure_pa: ArrayLike | Waveform | None = None,
    venous_pressure_pa: ArrayLike | Waveform | None = None,
    zones: Zones = PAPER_ZONES,
    pressure_pa: ArrayLike | Sequence[ArrayLike | Waveform] | None = None,
    start: Literal["untouched", "steady"] = "untouched",
    model: Model = "massless",
    contact: bool = True,
    rtol: float = 1e-6,
    only_diameters: bool = False,
) -> "xarray.Dataset":
    """What a touch does to the vessels under the nail: their diameters and pressures over time.

    time_s : (T,) float, increasing, T of 2 or more. [s]
    proximal_pressure_pa, distal_pressure_pa : (T,) float, one number or a `Waveform`. P_F1 and P_F2. Samples are
        linear between times; a waveform has knots of its own and jumps, so that no motion depends on time_s. [Pa]
    arterial_pressure_pa, venous_pressure_pa : The same. P_H (see `cardiac_pressure`) and P_L; None takes the
        parameters' values. [Pa]
    zones : Units along the nail and the reach of each pressure; the paper's two by default.
    pressure_pa : (M, T) float, or M of the above. All touch pressures, for zones with other than two inputs. [Pa]
    start : At time_s[0] the vessels are in balance with no touch ("untouched": a pressure there is a step at that
        instant) or with the first pressures ("steady"; before a waveform's jump, if it has one there).
    model : "massless" walls are the tool; "inertial" is the paper's six-state model (2 N + 2 states for N units), the
        check: it agrees within 1e-5 um and takes many times as long.
    contact : False, in the inertial model only, lets walls pass through each other as printed.
    rtol : Allowed error of a step, relative to a diameter. With noisy records 1e-4 is several times as fast. [1]
    only_diameters : Return no pressures, contacts and inputs, which of many samples are most of the memory.

    Returns: Dataset with dims zone and time; capillary_diameter_m (zone, time), capillary_pressure_pa (zone, time),
    vein_diameter_m (time), vein_pressure_pa (time), capillary_closed (zone, time), vein_closed (time), and the inputs.
    Eq. (3)-(4) of the paper move A dx/dt of blood, which is not the change of its eq. (7): the paper's areas and
    diameters disagree on volume. Here (3)-(4) give the motion, (7) the blood (`blood_fraction`), as in the paper.

    Raises: InputError if times do not increase, shapes differ, or a value is not finite; NotReachedError if the
    tolerance cannot be met.

    References: Mascaro and Asada 2001, eq. (1)-(4).
    """
    time = _times(time_s)
    _check_choices(model, start, contact=contact, rtol=rtol)
    p, touches = parameters, touch_inputs(zones, proximal_pressure_pa, distal_pressure_pa, pressure_pa)
    given = _vessel_pressures(p, arterial_pressure_pa, venous_pressure_pa) | touches
    waveforms = [waveform_of(name, value, time) for name, value in given.items()]
    to_channels = partial(_to_channels, zones)
    drive = Drive(waveforms, to_channels, begin_s=time[0], end_s=time[-1])
    over_time = np.array([waveform.at(time) for waveform in waveforms])
    walls = build_walls(p, zones)
    begin = _balance(walls, to_channels(_first_pressures(waveforms, time[:1], touched=start == "steady")))
    inputs = None if only_diameters and model == "massless" else to_channels(over_time)
    integrate: Any = massless.integrate if model == "massless" else partial(inertial.integrate, contact=contact)
    width, *others = integrate(walls, drive, time, begin, inputs, rtol=rtol)
    variables = _diameters(zones, width)
    if not only_diameters:
        variables |= _state_variables(zones, *others) | _input_variables(zones, over_time)
    return _dataset(variables, zones, time, {"model": model} | {f"parameter_{k}": v for k, v in p.as_dict().items()})


def _vessel_pressures(
    parameters: Parameters, arterial: ArrayLike | Waveform | None, venous: ArrayLike | Waveform | None
) -> dict[str, ArrayLike | Waveform]:
    """P_H and P_L by name; the parameters' where none is given. [Pa]"""
    return {
        "arterial_pressure_pa": parameters.arterial_pressure_pa if arterial is None else arterial,
        "venous_pressure_pa": parameters.venous_pressure_pa if venous is None else venous,
    }


def _to_channels(zones: Zones, rows: np.ndarray) -> np.ndarray:
    """P_H, P_L and the touch pressure on each wall, (N+3, T), from P_H, P_L and the touch pressures (2 + M, T). [Pa]"""
    return np.vstack([rows[:2], wall_pressures(zones, rows[2:])])


def _first_pressures(waveforms: list[Waveform], begin_s: np.ndarray, *, touched: bool) -> np.ndarray:
    """P_H, P_L and the touch pressures before the start, (2 + M, 1) float; those of a touch are 0 without one. [Pa]"""
    first = np.array([waveform.at(begin_s, before_jump=True) for waveform in waveforms])
    if not touched:
        first[2:] = 0.0
    return first


def _balance(walls: Walls, channels: np.ndarray) -> np.ndarray:
    """Diameters at which the walls rest, (N+1,) float, under P_H, P_L and the pressure on each wall, (N+3, 1). [m]"""
    high, low, *outside = channels
    return np.asarray(solve_walls(walls, np.array(outside), high, low)[0][:, 0])


def _check_choices(model: str, start: str, *, contact: bool, rtol: float) -> None:
    if not (np.isfinite(rtol) and 1e-13 <= rtol <= 0.1):
        raise InputError(f"rtol must lie between 1e-13 and 0.1, got {rtol}; 1e-6 is usual.")
    if model not in ("massless", "inertial"):
        raise InputError(f"model must be 'massless' or 'inertial', got {model!r}.")
    if start not in ("untouched", "steady"):
        raise InputError(f"start must be 'untouched' or 'steady', got {start!r}.")
    if model == "massless" and not contact:
        raise InputError("contact can be left out of model 'inertial' only; use model='inertial'.")


def _times(time_s: ArrayLike) -> np.ndarray:
    time = finite("time_s", time_s)
    if time.ndim != 1 or time.size < 2:
        raise InputError(f"time_s must be one row of two or more times, got shape {time.shape}.")
    step = np.diff(time)
    if np.any(step <= 0.0):
        i = int(np.argmax(step <= 0.0)) + 1
        raise InputError(f"time_s[{i}] must come after {time[i - 1]:g} s, got {time[i]:g} s; sort the times.")
    return time


def _diameters(zones: Zones, width: np.ndarray) -> dict[str, Variable]:
    n = zones.count
    found = variable("capillary_diameter_m", ("zone", "time"), width[:n], "capillary diameter D_C + x_C", units="m")
    return found | variable("vein_diameter_m", "time", width[n], "vein diameter D_V + x_V", units="m")


def _state_variables(zones: Zones, pressure: np.ndarray, closed: np.ndarray) -> dict[str, Variable]:
    n, over = zones.count, ("zone", "time")
    return (
        variable("capillary_pressure_pa", over, pressure[:n], "capillary blood pressure", units="Pa")
        | variable("capillary_closed", over, closed[:n], "capillary walls in contact")
        | variable("vein_pressure_pa", "time", pressure[n], "vein blood pressure", units="Pa")
        | variable("vein_closed", "time", closed[n], "vein walls in contact")
    )


def _input_variables(zones: Zones, over_time: np.ndarray) -> dict[str, Variable]:
    high, low, *touch = over_time
    found = variable("arterial_pressure_pa", "time", high, "arterial pressure P_H", units="Pa")
    found |= variable("venous_pressure_pa", "time", low, "venous pressure P_L", units="Pa")
    if zones.inputs != 2:
        return found | variable("touch_pressure_pa", ("input", "time"), touch, "touch pressure inputs", units="Pa")
    found |= variable("proximal_pressure_pa", "time", touch[0], "touch pressure on the vein P_F1", units="Pa")
    text = "touch pressure on the distal capillaries P_F2"
    return found | variable("distal_pressure_pa", "time", touch[1], text, units="Pa")


def _dataset(
    variables: dict[str, Variable], zones: Zones, time: np.ndarray, attributes: dict[str, Any]
) -> "xarray.Dataset":
    import xarray

    text = "centre of the unit along the bed, 0 cuticle to 1 tip"
    coordinates = variable("time", "time", time, "time", units="s")
    coordinates |= variable("zone_position", "zone", zones.position, text)
    names = {"long_name": "capillary unit, from the cuticle to the tip"}
    coordinates["zone"] = (("zone",), np.array(zones.names), names)
    about = {
        "Conventions": "CF-1.11",
        "title": "touch to blood: vessel diameters and pressures under the nail",
        "references": "Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (1)-(4)",
    }
    return xarray.Dataset(variables, coordinates, about | attributes)
