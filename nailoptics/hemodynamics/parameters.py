"""The constants of the paper's network: named sets, bounds for tuning, and the check of every value."""

import dataclasses
import difflib
import math

from ..checks import number
from ..errors import InputError

_MAY_BE_ANY_SIGN = ("arterial_pressure_pa", "venous_pressure_pa")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameters:
    """One set of constants for eq. (1)-(4); the defaults are the values that the paper lists.

    A capillary field means the same for both capillary beds (proximal and distal). Pressures are gauge.

    Raises: InputError if a value is not a finite number, or is not positive where it has to be.

    References: Mascaro and Asada 2001, IEEE Trans. Robotics and Automation 17(5), table of parameters.
    """

    capillary_stiffness_n_per_m: float = 1e5
    vein_stiffness_n_per_m: float = 1e3
    capillary_mass_kg: float = 1e-3
    vein_mass_kg: float = 1e-3
    capillary_damping_n_s_per_m: float = 1e4
    vein_damping_n_s_per_m: float = 1e2
    capillary_area_m2: float = 1e-4
    vein_area_m2: float = 1e-4
    capillary_diameter_m: float = 1e-5
    vein_diameter_m: float = 1e-4
    capillary_length_m: float = 1e-3
    vein_length_m: float = 1e-2
    capillary_count: float = 1e5
    vein_count: float = 1e2
    viscosity_pa_s: float = 3e-3
    venule_resistance_pa_s_per_m3: float = 1e11
    arterial_pressure_pa: float = 1e4
    venous_pressure_pa: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = number(f"hemodynamics.{field.name}", getattr(self, field.name))
            if field.name not in _MAY_BE_ANY_SIGN and value <= 0.0:
                raise InputError(
                    f"hemodynamics.{field.name} must be greater than 0, got {value:g}; give a positive value."
                )
            object.__setattr__(self, field.name, value)

    def replace(self, **changes: float) -> "Parameters":
        """A copy with some values changed, checked like a new set; InputError also for an unknown name."""
        known = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
                hint = f"did you mean {near[0]!r}?" if near else f"use one of {', '.join(known)}."
                raise InputError(f"hemodynamics.{name} is not a parameter; {hint}")
        return dataclasses.replace(self, **changes)

    def as_dict(self) -> dict[str, float]:
        """The values by name."""
        return dataclasses.asdict(self)


_SETS: dict[str, dict[str, float]] = {
    "listed": {},
    "figures": {
        "capillary_diameter_m": 6.5e-6,
        "capillary_stiffness_n_per_m": 1.5e5,
        "capillary_damping_n_s_per_m": 1.5e4,
        "capillary_count": 7.5e4,
        "vein_diameter_m": 1.5e-4,
        "vein_count": 200.0,
    },
    "compromise": {
        "capillary_stiffness_n_per_m": 1.2e5,
        "capillary_damping_n_s_per_m": 1.2e4,
        "vein_stiffness_n_per_m": 4e3,
        "capillary_count": 1.4e4,
    },
    # By `paper.parameter_search`, seed 11, 9e4 sets; rounded to three digits.
    "best": {
        "capillary_stiffness_n_per_m": 2.22e5,
        "vein_stiffness_n_per_m": 3.27e3,
        "capillary_damping_n_s_per_m": 1.43e4,
        "vein_damping_n_s_per_m": 209.0,
        "capillary_area_m2": 1.88e-4,
        "vein_area_m2": 3.53e-5,
        "capillary_diameter_m": 2.35e-6,
        "vein_diameter_m": 5.21e-5,
        "capillary_count": 8.71e4,
        "vein_count": 16.4,
        "venule_resistance_pa_s_per_m3": 2.14e10,
    },
}

NAMES = tuple(_SETS)


def parameters(name: str = "listed") -> Parameters:
    """A named set of constants: "listed", "figures", "compromise" or "best".

    - listed: the paper's orders of magnitude.
    - figures: every value within a factor 2 of the list; shows the paper's Figs. 10 and 12.
    - compromise: meets a part of Figs. 10, 11 and 12.
    - best: found by global search within an order of magnitude of the list (`paper.parameter_search`). It meets 20 of
      the 21 claims about two zones (`paper.claims`): all but equal times for distal loading and unloading (Fig. 11),
      which is at odds with the subjects' 0.18 and 0.36 s.

    Raises: InputError if the name is unknown.
    """
    if name not in _SETS:
        raise InputError(f"hemodynamics.parameters {name!r} is not a named set; use one of {', '.join(NAMES)}.")
    return Parameters(**_SETS[name])


def bounds(*, factor: float = 10.0) -> dict[str, tuple[float, float]]:
    """The range for tuning of each value: the listed one divided and multiplied by a factor.

    The paper tunes "within an order of magnitude". P_H and P_L are the body's, not the model's, and stay out.

    Raises: InputError if the factor is not greater than 1.
    """
    if not (math.isfinite(factor) and factor > 1.0):
        raise InputError(f"hemodynamics.bounds factor must be finite and greater than 1, got {factor}; use 10.")
    listed = Parameters().as_dict()
    return {name: (value / factor, value * factor) for name, value in listed.items() if name not in _MAY_BE_ANY_SIGN}
