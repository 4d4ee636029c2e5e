"""How the light is traced, and how accurately."""

from typing import Annotated, Literal

from pydantic import Field

from .base import Positive, Table


class Light(Table):
    """How the light is traced."""

    engine: Literal["auto", "photons", "volpath"] = "auto"
    """photons: forward walk, one trace for every blood state; volpath: stock Mitsuba, reference and fallback."""
    index_steps: bool = True
    """Refraction and Fresnel reflection where the refractive index changes."""
    similarity: bool = False
    """Isotropic scattering with equal mu_s (1 - g) in a finger: ten times fewer scatterings, biased near the LED."""
    left_out: tuple[Literal["bone", "epidermis", "kapton"], ...] = ()
    """Parts with the optics of their surroundings: bone and epidermis those of the pulp, Kapton those of epoxy."""


class Accuracy(Table):
    """Required accuracy."""

    relative_error: Annotated[float, Field(gt=0, le=1)] | None = None
    """Required relative standard error of every reading."""
    max_seconds: Positive | None = None
    """Wall time after which tracing stops. [s]"""
    photons: Annotated[int, Field(ge=1, le=10_000_000_000)] | None = None
    """Photons per LED wavelength, instead of a tolerance."""
