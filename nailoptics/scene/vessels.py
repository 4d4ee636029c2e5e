"""The blood under the nail and the vessels that carry it: which set of constants, and what a scene changes in it."""

import difflib
from typing import Annotated, Self

from pydantic import Field, model_validator

from .base import USUAL_BLOOD_FRACTION, USUAL_SO2, Fraction, Positive, Table


class Tuning(Table):
    """Own constants of the vessels in place of those of the named set."""

    capillary_stiffness_n_per_m: Positive | None = None
    """Stiffness k_C of a capillary wall. [N/m]"""
    vein_stiffness_n_per_m: Positive | None = None
    """Stiffness k_V of the vein's wall. [N/m]"""
    capillary_mass_kg: Positive | None = None
    """Mass of a capillary wall; only the inertial model, a check, reads it. [kg]"""
    vein_mass_kg: Positive | None = None
    """Mass of the vein's wall; only the inertial model, a check, reads it. [kg]"""
    capillary_damping_n_s_per_m: Positive | None = None
    """Damping b_C of a capillary wall. [N s/m]"""
    vein_damping_n_s_per_m: Positive | None = None
    """Damping b_V of the vein's wall. [N s/m]"""
    capillary_area_m2: Positive | None = None
    """Area A_C of a capillary wall. [m^2]"""
    vein_area_m2: Positive | None = None
    """Area A_V of the vein's wall. [m^2]"""
    capillary_diameter_m: Positive | None = None
    """Diameter D_C of a capillary without pressure. [m]"""
    vein_diameter_m: Positive | None = None
    """Diameter D_V of a vein without pressure. [m]"""
    capillary_length_m: Positive | None = None
    """Length L_C of a capillary. [m]"""
    vein_length_m: Positive | None = None
    """Length L_V of a vein. [m]"""
    capillary_count: Positive | None = None
    """Number N_C of capillaries in each half of the bed."""
    vein_count: Positive | None = None
    """Number N_V of veins."""
    viscosity_pa_s: Positive | None = None
    """Viscosity of the blood. [Pa s]"""
    venule_resistance_pa_s_per_m3: Positive | None = None
    """Resistance R_V1 = R_V2 of the venules of each half of the bed. [Pa s/m^3]"""
    arterial_pressure_pa: float | None = None
    """Arterial pressure P_H. [Pa]"""
    venous_pressure_pa: float | None = None
    """Venous pressure P_L. [Pa]"""
    factors: dict[str, Positive] | None = None
    """Factors on constants of the named set, by their names, in place of own values."""

    @model_validator(mode="after")
    def _factors_are_of_constants(self) -> Self:
        known = [name for name in type(self).model_fields if name != "factors"]
        for name in self.factors or {}:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
                hint = f'did you mean "{near[0]}"?' if near else f"use one of {', '.join(known)}"
                raise ValueError(f"factors.{name} is not a parameter; {hint}")
            if getattr(self, name) is not None:
                raise ValueError(f"{name} has both a value and a factor; give one of them")
        return self

    def changed(self) -> tuple[str, ...]:
        """Names of the constants that a value or a factor changes."""
        return (*self.model_dump(exclude_none=True, exclude={"factors"}), *(self.factors or {}))

    def of(self, constants: dict[str, float]) -> dict[str, float]:
        """The constants that differ from a set's, by name."""
        own = self.model_dump(exclude_none=True, exclude={"factors"})
        return own | {name: factor * constants[name] for name, factor in (self.factors or {}).items()}


class Blood(Table):
    """The blood in the nail bed and the vessels that carry it."""

    parameters: str = "listed"
    """Named set of hemodynamic parameters."""
    tuning: Tuning | None = None
    """Own values of parameters of the named set, or factors on them."""
    rest_blood_fraction: Fraction = USUAL_BLOOD_FRACTION
    """Volume fraction of blood in the nail bed at rest."""
    so2: Fraction = USUAL_SO2
    """Oxygen saturation of the blood."""
    zone_edges_mm: Annotated[tuple[float, ...], Field(min_length=1, max_length=1)] = (0.0,)
    """Where proximal and distal blood zone meet, along the nail from its centre. [mm]"""
    zone_width_mm: Positive = 2.0
    """Width of the smooth passage from zone to zone. [mm]"""
