"""The response over time to touch and pulse: inputs checked, a model chosen, results labelled; the model with mass."""

from typing import TYPE_CHECKING, Any, Literal, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite
from ..errors import InputError, NotReachedError
from ..variables import described
from . import massless
from .drive import Drive, waveform_of
from .parameters import Parameters
from .steady import solve_walls
from .touch import Pressures, named_pressures
from .walls import Walls, build_walls, inertial_pressures
from .zones import PAPER_ZONES, Zones

if TYPE_CHECKING:
    import xarray

Model = Literal["massless", "inertial"]
# Stiffness of two walls in contact over that of one wall: large, so that contact is hard. [1]
_CONTACT_OVER_WALL = 1e6
# Steps of the differences for the Jacobian: in diameters over the listed ones, and in speeds over those per second.
_DIAMETER_STEP, _SPEED_STEP = 1e-7, 1.0


def respond(
    parameters: Parameters,
    time_s: ArrayLike,
    *,
    zones: Zones = PAPER_ZONES,
    start: Literal["untouched", "steady"] = "untouched",
    model: Model = "massless",
    rtol: float = 1e-6,
    only_diameters: bool = False,
    **pressures: Unpack[Pressures],
) -> "xarray.Dataset":
    """What a touch does to the vessels under the nail: their diameters and pressures over time.

    time_s : (T,) float, increasing, T of 2 or more. [s]
    zones : Units along the nail and the reach of each pressure; the paper's two by default.
    start : At time_s[0] the vessels are in balance with no touch ("untouched": a pressure there is a step at that
        instant) or with the first pressures ("steady"; before a waveform's jump, if it has one there).
    model : "massless" walls are the tool; "inertial" is the paper's six-state model (2 N + 2 states for N units), the
        check: it agrees within 1e-5 um and takes many times as long.
    rtol : Allowed error of a step, relative to a diameter. With noisy records 1e-4 is several times as fast. [1]
    only_diameters : Return no pressures, contacts and inputs, which of many samples are most of the memory.
    pressures : as in `Pressures`, in which samples (T,) are linear between times; a waveform has knots of its own and
        jumps, so that no motion depends on time_s.

    Returns: Dataset with dims zone and time; capillary_diameter_m (zone, time), capillary_pressure_pa (zone, time),
    vein_diameter_m (time), vein_pressure_pa (time), capillary_closed (zone, time), vein_closed (time), and the inputs.
    Eq. (3)-(4) of the paper move A dx/dt of blood, which is not the change of its eq. (7): the paper's areas and
    diameters disagree on volume. Here (3)-(4) give the motion, (7) the blood (`blood_fraction`), as in the paper.

    Raises: InputError if times do not increase, shapes differ, or a value is not finite; NotReachedError if the
    tolerance cannot be met.

    References: Mascaro and Asada 2001, eq. (1)-(4).
    """
    time = _checked(time_s, model, start, rtol)
    p = parameters
    waveforms = [waveform_of(name, value, time) for name, value in named_pressures(p, zones, pressures).items()]

    def to_channels(rows: np.ndarray) -> np.ndarray:
        """P_H, P_L and the touch pressure on each wall, from P_H, P_L and the touch pressures."""
        return np.vstack([rows[:2], zones.on_walls(rows[2:])])

    drive = Drive(waveforms, to_channels, begin_s=time[0], end_s=time[-1])
    over_time = np.array([waveform.at(time) for waveform in waveforms])
    walls = build_walls(p, zones)
    first = np.array([waveform.at(time[:1], before_jump=True) for waveform in waveforms])
    if start == "untouched":
        first[2:] = 0.0
    high, low, *outside = to_channels(first)
    begin = solve_walls(walls, np.array(outside), high, low)[0][:, 0]
    inputs = None if only_diameters and model == "massless" else to_channels(over_time)
    integrate = massless.integrate if model == "massless" else integrate_with_mass
    run = integrate(walls, drive, time, begin, inputs, rtol=rtol)
    attributes = {"model": model} | {f"parameter_{k}": v for k, v in p.as_dict().items()}
    return _dataset(zones, time, run, None if only_diameters else over_time).assign_attrs(attributes)


def _checked(time_s: ArrayLike, model: str, start: str, rtol: float) -> np.ndarray:
    """The times, (T,) float."""
    if not 1e-13 <= rtol <= 0.1:
        raise InputError(f"rtol must lie between 1e-13 and 0.1, got {rtol}; 1e-6 is usual.")
    if model not in get_args(Model):
        raise InputError(f"model must be 'massless' or 'inertial', got {model!r}.")
    if start not in ("untouched", "steady"):
        raise InputError(f"start must be 'untouched' or 'steady', got {start!r}.")
    time = finite("time_s", time_s)
    if time.ndim != 1 or time.size < 2 or np.any(np.diff(time) <= 0.0):
        raise InputError(f"time_s must be one row of two or more times that rise, got shape {time.shape}; sort them.")
    return time


def _dataset(
    zones: Zones, time: np.ndarray, run: tuple[np.ndarray, np.ndarray, np.ndarray], over_time: np.ndarray | None
) -> "xarray.Dataset":
    """Diameters and, with the inputs over time, pressures, contacts and inputs."""
    import xarray

    (diameter, pressure, closed), n = run, zones.count
    data = {"capillary_diameter_m": diameter[:n], "vein_diameter_m": diameter[n]}
    if over_time is not None:
        data |= {"capillary_pressure_pa": pressure[:n], "capillary_closed": closed[:n]}
        data |= {"vein_pressure_pa": pressure[n], "vein_closed": closed[n]}
        high, low, *touch = over_time
        data |= {"arterial_pressure_pa": high, "venous_pressure_pa": low}
        sides = dict(zip(("proximal_pressure_pa", "distal_pressure_pa"), touch, strict=False))
        data |= sides if zones.inputs == 2 else {"touch_pressure_pa": np.array(touch)}
    coordinates = described(__package__, time=time, zone_position=zones.position)
    coordinates["zone"] = ("zone",), np.array(zones.names), {"long_name": "capillary unit, from the cuticle to the tip"}
    about = {
        "title": "touch to blood: vessel diameters and pressures under the nail",
        "references": "Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), eq. (1)-(4)",
    }
    return xarray.Dataset(described(__package__, **data), coordinates, about)


def integrate_with_mass(
    walls: Walls, drive: Drive, time_s: np.ndarray, start_m: np.ndarray, inputs: Any, *, rtol: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `massless.integrate`, of walls with mass, the paper's six-state model, by scipy's Radau.

    Walls push back once closed: a spring a million times as stiff as the wall, with its damping.
    """
    from scipy.integrate import solve_ivp

    rest, closed, n = walls.diameter, walls.closed, walls.diameter.size

    def rates(time: float, state: np.ndarray, pieces: tuple[int, int]) -> np.ndarray:
        diameter, speed = state[:n] * rest, state[n:] * rest
        inputs = drive.at(time, *pieces)
        pressure = inertial_pressures(walls, np.maximum(diameter, closed), speed, inputs[0], inputs[1])
        force = walls.area * (pressure - inputs[2:]) - walls.stiffness * (diameter - rest) - walls.damping * speed
        force += _CONTACT_OVER_WALL * walls.stiffness * np.maximum(closed - diameter, 0.0)
        return np.concatenate([speed, force / walls.mass]) / np.tile(rest, 2)

    # Rates are linear in the speeds, and smooth in the diameters: fixed differences serve, where adaptive ones stall.
    steps = np.diag(np.repeat([_DIAMETER_STEP, _SPEED_STEP], n))

    def jacobian(time: float, state: np.ndarray, pieces: tuple[int, int]) -> np.ndarray:
        sides = [(rates(time, state + e, pieces), rates(time, state - e, pieces), 2.0 * e.sum()) for e in steps]
        return np.stack([(above - below) / distance for above, below, distance in sides], axis=1)

    state = np.concatenate([start_m / rest, np.zeros(n)])
    samples = np.empty((2 * n, time_s.size))
    for first, last in drive.stretches:
        begin, end = drive.starts[first], drive.ends[last]
        inside = (time_s >= begin) & (time_s <= end)
        samples_s = np.unique(np.append(time_s[inside], end))
        how: Any = {"args": ((first, last),), "jac": jacobian, "rtol": max(rtol, 3e-14), "atol": rtol}
        solution = solve_ivp(rates, (begin, end), state, "Radau", samples_s, **how)
        if not solution.success:
            why = f"the inertial model stopped at {begin:g} s ({solution.message}); raise rtol."
            raise NotReachedError(f"hemodynamics: {why}")
        samples[:, inside] = solution.y[:, : np.count_nonzero(inside)]
        state = solution.y[:, -1]
    diameter, speed = np.split(samples * np.tile(rest, 2)[:, None], 2)
    touching = diameter <= closed[:, None]
    diameter = np.maximum(diameter, closed[:, None])
    return diameter, inertial_pressures(walls, diameter, speed, *inputs[:2]), touching
