"""The constants of the paper's network: named sets, bounds for tuning, and the check of every value."""

import dataclasses
import math
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from ..assets import read_toml
from ..checks import number, positive
from ..errors import InputError
from ..scene import Body, Scene
from ..scene.vessels import OF_BEDS

PerBed = float | tuple[float, float]
"""A constant of both beds, or those of the proximal and of the distal one."""
_MAY_BE_ANY_SIGN = ("arterial_pressure_pa", "venous_pressure_pa")
# With less damping a wall's own force is lost beside the blood's, in floats: results are wrong, not slow.
LEAST_DAMPING_N_S_PER_M = 1e-12
# Of blood, rho g: 1060 kg/m^3 times 9.81 m/s^2; and of the paper's unit of pressure. [Pa/m, Pa]
PA_PER_M_OF_BLOOD, PA_PER_N_PER_CM2 = 1.04e4, 1e4
# The paper's constants are orders of magnitude: a hundredfold beyond them a value is probably mistyped.
FAR_FROM_LIST = 100.0
# Of those so many are named.
FAR_NAMED = 10
# Fingertips touch with less than this where a pin presses, or centimetres were meant. [mm^2]
SMALL_AREA_MM2 = 10.0
_BEYOND_THE_PAPER = ("venular_share", "venular_closing_pressure_pa")


def each_bed(function: Callable[..., Any], *values: Any) -> Any:
    """The function of constants: a pair where one of them is a pair, and else one value for both beds."""
    if not any(isinstance(value, tuple) for value in values):
        return function(*values)
    return tuple(function(*pair) for pair in zip(*map(beds, values), strict=True))


def beds(value: Any) -> tuple[Any, Any]:
    """A constant of the proximal and of the distal bed."""
    return value if isinstance(value, tuple) else (value, value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameters:
    """One set of constants for eq. (1)-(4); the defaults are the values that the paper lists.

    A field of capillaries or venules is one number for both capillary beds or, as the paper has it, a pair of the
    proximal and the distal bed's. Pressures are gauge. The venular fields are beyond the paper, and off by default: a
    share of a bed's blood in venules, which a touch on that bed empties in proportion to its pressure, entirely at
    their closing pressure. They change the blood, not the network.

    Raises: InputError if a value is not a finite number, or is not positive where it has to be.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), table of parameters.
    """

    capillary_stiffness_n_per_m: PerBed = 1e5
    vein_stiffness_n_per_m: float = 1e3
    capillary_mass_kg: PerBed = 1e-3
    vein_mass_kg: float = 1e-3
    capillary_damping_n_s_per_m: PerBed = 1e4
    vein_damping_n_s_per_m: float = 1e2
    capillary_area_m2: PerBed = 1e-4
    vein_area_m2: float = 1e-4
    capillary_diameter_m: PerBed = 1e-5
    vein_diameter_m: float = 1e-4
    capillary_length_m: PerBed = 1e-3
    vein_length_m: float = 1e-2
    capillary_count: PerBed = 1e5
    vein_count: float = 1e2
    viscosity_pa_s: float = 3e-3
    venule_resistance_pa_s_per_m3: PerBed = 1e11
    venular_share: PerBed = 0.0
    venular_closing_pressure_pa: PerBed = 1e3
    arterial_pressure_pa: float = 1e4
    venous_pressure_pa: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name.startswith(OF_BEDS) and isinstance(value, list | tuple) and len(value) == 2:
                pair = tuple(_checked(field.name, item) for item in value)
                value = pair[0] if pair[0] == pair[1] else pair
            else:
                value = _checked(field.name, value)
            object.__setattr__(self, field.name, value)

    def replace(self, **changes: Any) -> "Parameters":
        """A copy with some values changed, checked like a new set; InputError also for an unknown name."""
        if unknown := sorted(set(changes) - set(vars(self))):
            raise InputError(f"{unknown[0]} is not a parameter; use one of {', '.join(vars(self))}.")
        return dataclasses.replace(self, **changes)

    def as_dict(self) -> dict[str, Any]:
        """The values by name."""
        return dataclasses.asdict(self)


def _checked(name: str, given: Any) -> float:
    value = number(name, given)
    if name == "venular_share":
        if not 0.0 <= value < 1.0:
            raise InputError(f"{name} must be 0 or more and less than 1, got {value:g}; 0 is none.")
    elif "damping" in name and 0.0 < value < LEAST_DAMPING_N_S_PER_M:
        raise InputError(f"{name} must be {LEAST_DAMPING_N_S_PER_M:g} or more, got {value:g}; 1e-6 is as good as none.")
    elif name not in _MAY_BE_ANY_SIGN and value <= 0.0:
        raise InputError(f"{name} must be greater than 0, got {value:g}; give a positive value.")
    return value


_SETS: dict[str, dict[str, Any]] = read_toml("vessels.toml")
NAMES = tuple(_SETS)


def parameters(name: str = "listed") -> Parameters:
    """A named set of constants: those of `NAMES`.

    - listed: the paper's orders of magnitude.
    - simulation, subject: what the paper's simulation shows (Figs. 8 and 10-12), and its subjects (Figs. 2 and 15-18),
      to which stiffness and damping alone are tuned. Each bed has its own constants, within an order of magnitude of
      the list; 3 % of the distal bed's blood is in venules, beyond the paper. Together they meet all 40 rules
      of `paper.claims`.
    - best: of the prototype and most scenes; figures, compromise, sluggish: of earlier versions (assets/vessels.toml).

    Raises: InputError if the name is unknown.
    """
    if name not in _SETS:
        raise InputError(f"parameters {name!r} is not a named set; use one of {', '.join(NAMES)}.")
    return Parameters(**_SETS[name])


def bounds(*, factor: float = 10.0) -> dict[str, tuple[float, float]]:
    """The range for tuning of each value: the listed one divided and multiplied by a factor, in the paper an order of
    magnitude. P_H and P_L are the body's, not the model's, and stay out. InputError unless it is above 1."""
    positive("factor - 1", factor - 1.0)
    listed = Parameters().as_dict()
    left_out = _MAY_BE_ANY_SIGN + _BEYOND_THE_PAPER
    return {name: (value / factor, value * factor) for name, value in listed.items() if name not in left_out}


def vessels(scene: Scene) -> Parameters:
    """The constants of the scene's vessels: those of the named set, but for what the scene tunes; P_H is the mean of a
    body whose pressure moves. Raises InputError if there is no such set, or a constant cannot be."""
    blood, body = scene.blood, scene.body
    constants = parameters(blood.parameters)
    if blood.tuning:
        try:
            constants = _scaled(constants, blood.tuning.factors or {}).replace(**blood.tuning.values())
        except InputError as error:
            raise InputError(f"blood.tuning.{error}") from None
    factors: dict[str, PerBed] = {
        "capillary_stiffness_n_per_m": (blood.wall_stiffness, blood.wall_stiffness * blood.distal_stiffness),
        "vein_stiffness_n_per_m": blood.wall_stiffness * blood.vein_stiffness,
        "vein_length_m": blood.vein_resistance,
    }
    constants = _scaled(constants, factors)
    if body is None:
        return constants
    if body.recorded_arterial_pressure_pa is not None:
        return constants.replace(arterial_pressure_pa=time_mean(np.array(body.recorded_arterial_pressure_pa), body))
    stated_pa = body.heartbeat.mean_pressure_pa if body.heartbeat is not None else None
    return constants if stated_pa is None else constants.replace(arterial_pressure_pa=stated_pa)


def _scaled(constants: Parameters, factors: Mapping[str, PerBed]) -> Parameters:
    scaled = {name: each_bed(operator.mul, getattr(constants, name), factor) for name, factor in factors.items()}
    return constants.replace(**scaled)


def implausible_constants(*scenes: Scene) -> list[str]:
    """Warnings, one each for all scenes, of constants of the vessels that are farther off the paper's than a factor of
    `FAR_FROM_LIST`, where they can be, and of a small area of contact."""
    far = dict[str, None]()
    for scene in scenes:
        with suppress(InputError):
            constants = vessels(scene)
            for name, (low, high) in bounds(factor=FAR_FROM_LIST).items():
                outside = [value for value in beds(getattr(constants, name)) if not low <= value <= high]
                far |= {f"{name} = {value:g} (listed {math.sqrt(low * high):g})": None for value in outside}
    text = f"more than {FAR_FROM_LIST:g} times off the paper's list, whose orders of magnitude are right"
    more = [f"and {len(far) - FAR_NAMED} more"] if len(far) > FAR_NAMED else []
    lines = [f"blood.tuning: {text}: {', '.join([*far][:FAR_NAMED] + more)}"] if far else []
    if (area_mm2 := min(scene.touch.contact_area_mm2 for scene in scenes)) < SMALL_AREA_MM2:
        lines.append(
            f"touch.contact_area_mm2 = {area_mm2:g}: fingertips touch with 50 to 200 mm^2 (1 cm^2 is 100 mm^2)"
        )
    return lines


def with_posture(parameters: Parameters, body: Body | None) -> Parameters:
    """The vessels under the pressures that the hand's height and the veins give them; of a recording, their means."""
    if body is None:
        return parameters
    fall_pa, low_pa = (time_mean(values, body) for values in posture_pa(parameters, body))
    return parameters.replace(arterial_pressure_pa=parameters.arterial_pressure_pa - fall_pa, venous_pressure_pa=low_pa)


def posture_pa(parameters: Parameters, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """By how much the hand's height lowers P_H, and P_L under it: (K,) float each at the times of a recording that has
    either, else (). [Pa]"""
    recorded = body.recorded
    fall_pa = PA_PER_M_OF_BLOOD * np.asarray(recorded.get("hand_height_m", body.hand_height_m))
    stated_pa = parameters.venous_pressure_pa if body.venous_pressure_pa is None else body.venous_pressure_pa
    low_pa = np.asarray(recorded.get("venous_pressure_pa", stated_pa))
    # Veins above the heart collapse: their pressure falls no further than to that around them.
    return fall_pa, np.maximum(low_pa - fall_pa, np.minimum(low_pa, 0.0))


def time_mean(values: np.ndarray, body: Body) -> float:
    """Mean over the time of a body's recording; of one value, that."""
    if values.ndim == 0 or body.recorded_time_s is None:
        return float(values)
    time_s = np.array(body.recorded_time_s)
    return float(np.trapezoid(values, time_s) / (time_s[-1] - time_s[0]))
