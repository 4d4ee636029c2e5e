"""How the light is traced, how accurately, and how the bare nail is viewed: forces, light, observer, photographs."""

from typing import Annotated, Literal

from pydantic import Field

from ..options import MAX_PHOTONS, Illuminant, LightFrom, Observer
from .base import Positive, Table
from .touch import Force

Pixels = Annotated[int, Field(ge=16, le=4096)]


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
    photons: Annotated[int, Field(ge=1, le=MAX_PHOTONS)] | None = None
    """Photons per LED wavelength, instead of a tolerance."""


class Viewing(Table):
    """Viewing conditions for the colour of the bare nail, for nailoptics colour."""

    forces_n: Annotated[tuple[Force, ...], Field(min_length=1, max_length=20)] = (0.0, 0.3, 1.0, 2.0, 4.0)
    """Forces, each held to the steady state; the first is the reference. [N]"""
    illuminant: Illuminant = "D65"
    """D65 is daylight, A an incandescent lamp, LED-B3 a white LED of 4103 K (CIE 015:2018)."""
    observer: Observer = "2"
    """Field of the standard observer, in degrees."""
    lit_by: LightFrom = "sky"
    """sky: diffuse illumination; lamp: at 45 degrees from all azimuths. Viewed from above."""
    gloss: bool = False
    """Whether specular reflection is included in the colour."""
    tolerance: Positive = 0.3
    """Required standard error of the colour at every position. [CIEDE2000]"""
    change_tolerance: Positive = 0.05
    """Required standard error of every change of colour with force. [CIEDE2000]"""
    photograph_px: tuple[Pixels, Pixels] = (800, 600)
    """Width and height of a photograph. [px]"""
    camera_mm: tuple[float, float, float] = (-12.0, 38.0, 58.0)
    """Camera position of a photograph, from the nail's centre: across, towards the tip, and above. [mm]"""
