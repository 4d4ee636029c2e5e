"""The blood under the nail and the vessels that carry it: which set of constants, and what a scene changes in it."""

from itertools import pairwise
from typing import Annotated, Any, Self

from pydantic import Field

from ..checks import nearest
from . import base
from .base import ArterialPressure, Fraction, Positive, Table, VenousPressure

MOST_ZONES = 32
# Fields of the blood that are factors on constants of the vessels, named set and tuning alike.
FACTORS = ("wall_stiffness", "vein_stiffness", "distal_stiffness", "vein_resistance")


PerBed = Positive | tuple[Positive, Positive]
Share = Annotated[float, Field(ge=0, lt=1)]

# Constants of the beds, each of which may have a different one, begin so.
OF_BEDS = ("capillary_", "venul")


class Tuning(Table):
    """Constants of the vessels that replace those of the named set.

    Those of capillaries and venules are one number for both beds, or two: of the proximal and of the distal bed.
    """

    capillary_stiffness_n_per_m: PerBed | None = None
    """Stiffness k_C of a capillary wall. [N/m]"""
    vein_stiffness_n_per_m: Positive | None = None
    """Stiffness k_V of the vein's wall. [N/m]"""
    capillary_mass_kg: PerBed | None = None
    """Mass m_C of a capillary wall; used by the inertial model only. [kg]"""
    vein_mass_kg: Positive | None = None
    """Mass m_V of the vein's wall; used by the inertial model only. [kg]"""
    capillary_damping_n_s_per_m: PerBed | None = None
    """Damping b_C of a capillary wall. [N s/m]"""
    vein_damping_n_s_per_m: Positive | None = None
    """Damping b_V of the vein's wall. [N s/m]"""
    capillary_area_m2: PerBed | None = None
    """Area A_C of a capillary wall. [m^2]"""
    vein_area_m2: Positive | None = None
    """Area A_V of the vein's wall. [m^2]"""
    capillary_diameter_m: PerBed | None = None
    """Diameter D_C of a capillary without pressure. [m]"""
    vein_diameter_m: Positive | None = None
    """Diameter D_V of a vein without pressure. [m]"""
    capillary_length_m: PerBed | None = None
    """Length L_C of a capillary. [m]"""
    vein_length_m: Positive | None = None
    """Length L_V of a vein. [m]"""
    capillary_count: PerBed | None = None
    """Number N_C of capillaries in each half of the bed."""
    vein_count: Positive | None = None
    """Number N_V of veins."""
    viscosity_pa_s: Positive | None = None
    """Viscosity of the blood. [Pa s]"""
    venule_resistance_pa_s_per_m3: PerBed | None = None
    """Resistance R_V1 and R_V2 of the venules of each half of the bed. [Pa s/m^3]"""
    venular_share: Share | tuple[Share, Share] | None = None
    """Share of a bed's blood in venules that a touch on that bed empties; beyond the paper, which has none."""
    venular_closing_pressure_pa: PerBed | None = None
    """Touch pressure at which these venules are empty. [Pa]"""
    arterial_pressure_pa: ArterialPressure | None = None
    """Arterial pressure P_H. [Pa]"""
    venous_pressure_pa: VenousPressure | None = None
    """Venous pressure P_L. [Pa]"""
    factors: dict[str, PerBed] | None = None
    """Factors on constants of the named set, by their names, instead of values."""

    def _check(self) -> None:
        known = [name for name in type(self).model_fields if name != "factors"]
        for name in self.factors or {}:
            if name not in known:
                near = nearest(name, known, cutoff=0.4)
                hint = f'did you mean "{near}"?' if near else f"use one of {', '.join(known)}"
                raise ValueError(f"factors.{name} is not a parameter; {hint}")
            if isinstance((self.factors or {})[name], tuple) and not name.startswith(OF_BEDS):
                raise ValueError(f"factors.{name} has two values, but it belongs to both beds; give one")
            if getattr(self, name) is not None:
                raise ValueError(f"{name} has both a value and a factor; give one of them")

    def __hash__(self) -> int:
        # Pydantic's own hash of a frozen model cannot take the dictionary of factors.
        values = self.model_dump(exclude={"factors"})
        return hash((frozenset(values.items()), frozenset((self.factors or {}).items())))

    def values(self) -> dict[str, Any]:
        """The constants that it replaces, by name."""
        return self.model_dump(exclude_none=True, exclude={"factors"})


class Blood(Table):
    """The blood in the nail bed and the vessels that carry it."""

    parameters: str = "listed"
    """Named set of constants: listed (the paper's table, which does not reproduce its figures), best (the prototype's),
    simulation or subject (found for the paper's figures); figures, compromise and sluggish are older."""
    tuning: Tuning | None = None
    """Values of parameters that replace those of the named set, or factors on them."""
    wall_stiffness: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Factor on the stiffness of all walls, of capillaries and vein."""
    vein_stiffness: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Further factor on the stiffness of the vein's wall."""
    distal_stiffness: Annotated[float, Field(ge=0.1, le=10)] = 1.0
    """Further factor on the stiffness of the distal bed's capillaries."""
    vein_resistance: Annotated[float, Field(ge=0.01, le=100)] = 1.0
    """Factor on the resistance of the vein, which a longer one has."""
    rest_blood_fraction: Fraction = base.USUAL_BLOOD_FRACTION
    """Volume fraction of blood in the nail bed at rest."""
    pulp_blood_fraction: Fraction = base.USUAL_PULP_BLOOD_FRACTION
    """Volume fraction of blood in the pulp."""
    so2: Fraction = base.USUAL_SO2
    """Oxygen saturation of the blood; of arterial blood if venous_so2 is given."""
    venous_so2: Fraction | None = None
    """Oxygen saturation of venous blood. If given, the bed at rest contains a mixture of half arterial, half venous
    blood, and additional blood that pools is arterial; 0.86 is typical of a finger with an arterial saturation of
    0.95. If not given all blood has so2."""
    oxygen_balance: bool = False
    """Compute the bed's oxygen from inflow and consumption over a touch: pooled blood gradually desaturates. Needs
    venous_so2, from which consumption follows. If not set, pooled blood keeps its oxygen."""
    # (so2 - venous_so2) / exchange_s is the desaturation of stagnant blood: 13 to 18 % in a minute in the hand
    # (vascular occlusion of 3 min, thenar: PMC2786105), and in a finger to some 26 % within 25 min (Marcinkevics 2018,
    # Proc. SPIE 10685, 106851A). Arteries and veins of fingers differ by 0.083 (Nitzan 2000, J. Biomed. Opt. 5:155).
    exchange_s: Positive = 40.0
    """Time in which as much blood flows through the bed at rest as it holds; 20 to 80 are plausible. [s]"""
    zones: Annotated[int, Field(ge=2, le=MOST_ZONES)] | None = None
    """Number of equal blood zones along the nail, instead of zone_edges_mm."""
    zone_edges_mm: Annotated[tuple[float, ...], Field(min_length=1, max_length=MOST_ZONES - 1)] = (0.0,)
    """Boundaries of the blood zones along the nail, relative to its centre, the most proximal first. [mm]"""
    zone_width_mm: Positive = 2.0
    """Width of the smooth transition between zones; at most one zone if their number is given by zones. [mm]"""
    bone_edge_mm: Annotated[float, Field(ge=0.01, le=30)] = base.USUAL_BONE_EDGE_MM
    """Length over which the end of the bone stops shielding the bed from the distal pressure, with more than two zones;
    of two it acts on the distal one only. [mm]"""
    decay_length: Annotated[float, Field(ge=0.01, le=100)] | None = None
    """Decay length of the distal pressure, in lengths of the nail, instead of the bone's shield: it decreases as
    exp(-d/decay_length) with the distance d from the tip."""
    distal_reach: Fraction = 0.0
    """Fraction of the distal pressure that acts on the whole bed, whatever shields it; 0 in the paper, where the bone
    keeps all of it from the bed behind."""

    def _check(self) -> None:
        edges = self.zone_edges_mm
        if self.zones is not None and edges != (0.0,):
            raise ValueError(f"zones = {self.zones} and zone_edges_mm = {list(edges)} both cut the bed; give one")
        for first, second in pairwise(edges):
            # Closer, three zones would pass into each other at one place.
            if second - first < self.zone_width_mm:
                why = f"than zone_width_mm = {self.zone_width_mm:g}; move them apart (in rising order) or narrow it"
                raise ValueError(f"zone_edges_mm {first:g} and {second:g} lie closer {why}")
        if self.venous_so2 is not None and self.venous_so2 > self.so2:
            raise ValueError(f"venous_so2 = {self.venous_so2} must not be above so2 = {self.so2}, that of the arteries")
        if self.oxygen_balance and self.venous_so2 is None:
            raise ValueError(f"oxygen_balance needs venous_so2; {max(self.so2 - 0.08, 0.0):.2g} is usual in a finger")

    def with_so2(self, so2: float) -> Self:
        """The blood with another arterial saturation; that of the veins stays as far below."""
        venous = None if self.venous_so2 is None else max(so2 - (self.so2 - self.venous_so2), 0.0)
        return self.model_copy(update={"so2": so2, "venous_so2": venous})

    @property
    def rest_so2(self) -> float:
        """Oxygen saturation of the bed's blood at rest."""
        return self.so2 if self.venous_so2 is None else 0.5 * (self.so2 + self.venous_so2)
