"""What the light goes through: a finger, whose sizes from anatomy can be overridden, or a phantom of layers."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from ..assets import read_toml
from .base import USUAL_MELANIN_FRACTION, Fraction, Name, Table, check_unique

ANATOMY: dict[str, dict[str, float]] = read_toml("anatomy.toml")
"""Sizes of adult digits, by digit and field. [mm]"""
Digit = Literal["thumb", "index", "middle", "ring", "little"]
DermisAbsorption = Literal["jacques_baseline", "shimojo", "salomatina"]
Factor = Annotated[float, Field(ge=0.01, le=100)]
# From farther behind the nail less than 1e-4 of a photodiode's light returns, as explain measures.
BEYOND_NAIL_MM = 4.0
# Beyond this a mean free path is below an atom, and single precision ends soon after. [mm^-1]
Coefficient = Annotated[float, Field(ge=0, le=1e9)]


class Finger(Table):
    """A fingertip; the digit sets the default of every size. Lengths in mm."""

    digit: Digit = "index"
    """Which digit; sets the sizes from anatomy."""
    width_mm: Annotated[float, Field(ge=5, le=40)] = ANATOMY["index"]["width_mm"]
    """Width of the fingertip. [mm]"""
    thickness_mm: Annotated[float, Field(ge=5, le=40)] = ANATOMY["index"]["thickness_mm"]
    """Thickness of the fingertip, nail to pulp. [mm]"""
    nail_width_mm: Annotated[float, Field(ge=2, le=30)] = ANATOMY["index"]["nail_width_mm"]
    """Width of the nail plate along its curve. [mm]"""
    nail_length_mm: Annotated[float, Field(ge=2, le=30)] = ANATOMY["index"]["nail_length_mm"]
    """Length of the visible nail plate. [mm]"""
    nail_radius_mm: Annotated[float, Field(ge=2, le=100)] = ANATOMY["index"]["nail_radius_mm"]
    """Transverse radius of the nail plate. [mm]"""
    bone_to_tip_mm: Annotated[float, Field(ge=1, le=15)] = ANATOMY["index"]["bone_to_tip_mm"]
    """Distance from the end of the distal phalanx to the tip. [mm]"""
    nail_thickness_mm: Annotated[float, Field(ge=0.05, le=3)] = 0.45
    """Thickness of the nail plate. [mm]"""
    bed_thickness_mm: Annotated[float, Field(ge=0.1, le=5)] = 1.7
    """Thickness of the nail bed, plate to bone. [mm]"""
    epidermis_thickness_mm: Annotated[float, Field(ge=0.02, le=1)] = 0.1
    """Thickness of the epidermis outside the nail. [mm]"""
    length_mm: Annotated[float, Field(gt=0, le=100)] = ANATOMY["index"]["nail_length_mm"] + BEYOND_NAIL_MM
    """Modelled length of the finger from the tip; if not given the nail's length plus 4 mm. [mm]"""
    melanin_fraction: Fraction = USUAL_MELANIN_FRACTION
    """Volume fraction of melanosomes in the epidermis."""
    dermis: DermisAbsorption = "jacques_baseline"
    """Absorption of the bloodless nail bed; the two tables measured ex vivo are two and five times the default."""
    plate_absorption: Factor = 1.0
    """Factor on the nail plate's absorption."""
    plate_absorption_slope: Annotated[float, Field(ge=-10, le=10)] = 0.0
    """Power of the wavelength over 500 nm by which the nail plate's absorption is multiplied, too."""
    plate_scattering: Factor = 1.0
    """Factor on the nail plate's scattering."""
    bed_absorption: Factor = 1.0
    """Factor on the absorption of the bloodless nail bed."""
    bed_scattering: Factor = 1.0
    """Factor on the nail bed's scattering."""
    bone_absorption: Factor = 1.0
    """Factor on the bone's absorption."""
    bone_scattering: Factor = 1.0
    """Factor on the bone's scattering."""
    pulp_absorption: Factor = 1.0
    """Factor on the absorption of the bloodless pulp."""
    pulp_scattering: Factor = 1.0
    """Factor on the pulp's scattering."""

    def with_usual(self, fields: Iterable[str]) -> Self:
        """The finger with these fields at their defaults."""
        return self.model_copy(update={name: type(self).model_fields[name].default for name in fields})

    @property
    def beyond_nail_mm(self) -> float:
        """How far the tip reaches beyond the nail."""
        return min(max(0.15 * self.thickness_mm, 1.0), 2.0)

    @property
    def bone_end_mm(self) -> float:
        """Place of the end of the distal phalanx along the nail, relative to the nail's centre."""
        return self.nail_length_mm / 2 + self.beyond_nail_mm - self.bone_to_tip_mm

    @classmethod
    def _filled(cls, data: dict[str, Any], folder: Path | None) -> dict[str, Any]:
        sizes = ANATOMY.get(str(data.get("digit", "index")), {}) | data
        nail = sizes.get("nail_length_mm")
        return {"length_mm": nail + BEYOND_NAIL_MM} | sizes if isinstance(nail, int | float) else sizes

    def _check(self) -> None:
        radius, half_width = self.nail_radius_mm, self.width_mm / 2
        if self.nail_width_mm > 2.6 * min(radius, half_width):
            why = f"on a finger {self.width_mm} mm wide; at most {2.6 * min(radius, half_width):.2f}"
            raise ValueError(f"nail_width_mm = {self.nail_width_mm} does not fit a nail of radius {radius} mm {why}")
        deep = self.nail_thickness_mm + self.bed_thickness_mm
        if deep > 0.6 * min(self.thickness_mm, 2 * radius) - 1:
            why = f"in a finger {self.thickness_mm} mm thick with a nail radius of {radius} mm; make them thinner"
            raise ValueError(f"nail_thickness_mm + bed_thickness_mm = {deep:.2f} leaves no room for the bone {why}")
        least = self.nail_length_mm + BEYOND_NAIL_MM
        if self.length_mm < least:
            raise ValueError(f"length_mm = {self.length_mm} is too short for the nail; at least {least}")


# Fields that decide how much light tissue absorbs, and how it scatters; all others are sizes.
ABSORBING = ("melanin_fraction", "dermis", *(name for name in Finger.model_fields if "_absorption" in name))
SCATTERING = tuple(name for name in Finger.model_fields if name.endswith("_scattering"))


class Layer(Table):
    """One layer of a phantom, laterally infinite."""

    name: Name
    """Name of the layer, unique in the phantom."""
    thickness_mm: Annotated[float, Field(gt=0, allow_inf_nan=True)]
    """Thickness; inf closes the stack. [mm]"""
    mu_a_per_mm: Coefficient
    """Absorption coefficient. [mm^-1]"""
    mu_s_per_mm: Coefficient
    """Scattering coefficient. [mm^-1]"""
    g: Annotated[float, Field(ge=-0.9999, le=0.9999)] = 0.0
    """Anisotropy of Henyey-Greenstein scattering."""
    n: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Refractive index."""


class Phantom(Table):
    """A laterally infinite stack of layers instead of the finger, its top face at z = 0."""

    n_above: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Refractive index above the stack."""
    n_below: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Refractive index below the stack."""
    layers: Annotated[tuple[Layer, ...], Field(min_length=1, max_length=50)]
    """The layers from the top down."""

    def _check(self) -> None:
        check_unique([layer.name for layer in self.layers], "layers")
        for layer in self.layers[:-1]:
            if math.isinf(layer.thickness_mm):
                why = "has thickness_mm = inf but is not the last; only the last can be infinite"
                raise ValueError(f'layers: "{layer.name}" {why}')
