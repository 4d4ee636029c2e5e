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
    # Both by tests/benchmarks/parameter_search.py: evolutions from several starts, some 6e4 sets, rounded to three
    # digits. Linear programs on the measures of its rules then moved the values of "best" by at most 45 %.
    "best": {
        "capillary_stiffness_n_per_m": 7.69e4,
        "vein_stiffness_n_per_m": 2.57e3,
        "capillary_damping_n_s_per_m": 1e3,
        "vein_damping_n_s_per_m": 10.0,
        "capillary_area_m2": 1.27e-5,
        "vein_area_m2": 1.35e-5,
        "capillary_diameter_m": 2.94e-6,
        "vein_diameter_m": 2.8e-5,
        "capillary_count": 8.97e5,
        "vein_count": 608.0,
        "venule_resistance_pa_s_per_m3": 1e10,
    },
    "sluggish": {
        "capillary_stiffness_n_per_m": 1.71e5,
        "vein_stiffness_n_per_m": 1.52e3,
        "capillary_damping_n_s_per_m": 1.78e3,
        "vein_damping_n_s_per_m": 308.0,
        "capillary_area_m2": 4.61e-5,
        "vein_area_m2": 1e-5,
        "capillary_diameter_m": 4.13e-6,
        "vein_diameter_m": 2.32e-5,
        "capillary_count": 3.77e4,
        "vein_count": 70.0,
        "venule_resistance_pa_s_per_m3": 1.06e10,
    },
}

NAMES = tuple(_SETS)


def parameters(name: str = "listed") -> Parameters:
    """A named set of constants: "listed", "figures", "compromise", "best" or "sluggish".

    - listed: the paper's orders of magnitude.
    - figures: every value within a factor 2 of the list; shows the paper's Fig. 10.
    - compromise: meets a part of Figs. 10, 11 and 12.
    - best: found by global search within an order of magnitude of the list
      (`tests/benchmarks/parameter_search.py`). It meets 24 of the 28 rules of `paper.claims`. Its capillaries are
      hardly slower on release than on loading (Fig. 10), V_P2 begins a little less steeply and levels off at higher
      pressure than in Fig. 12, and the proximal reading takes 0.153 s to follow a falling force, where 0.15 were
      allowed (Fig. 16).
    - sluggish: from the same search, with 24 rules, too: much slower capillaries on release (Fig. 10), for which the
      proximal reading takes 0.29 s to follow a falling force (Fig. 16) and the distal one overshoots under steps of
      both pressures (Fig. 11). No set was found without one of these.

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
