"""A phantom: laterally infinite layers in place of the finger."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from .base import Name, Table, check_unique

# Beyond this a mean free path is below an atom, and single precision ends soon after. [mm^-1]
Coefficient = Annotated[float, Field(ge=0, le=1e9)]


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

    @model_validator(mode="after")
    def _layers_are_a_stack(self) -> Self:
        check_unique([layer.name for layer in self.layers], "layers")
        for layer in self.layers[:-1]:
            if math.isinf(layer.thickness_mm):
                raise ValueError(
                    f'layers: "{layer.name}" has thickness_mm = inf but is not the last; only the last can be infinite'
                )
        return self
