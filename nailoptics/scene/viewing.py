"""How the bare nail is looked at: under which forces, in which light, by whose eye."""

from typing import Annotated, Literal

from pydantic import Field

from .base import Positive, Table

Illuminant = Literal["D65", "A", "LED-B3"]
Observer = Literal["2", "10"]
LightFrom = Literal["sky", "lamp"]
Pixels = Annotated[int, Field(ge=16, le=4096)]
Force = Annotated[float, Field(ge=0, le=100)]


class Viewing(Table):
    """How the colour of the bare nail is seen, for nailoptics colour."""

    forces_n: Annotated[tuple[Force, ...], Field(min_length=1, max_length=20)] = (0.0, 0.3, 1.0, 2.0, 4.0)
    """Forces, each held until nothing moves; the first is what the others are compared with. [N]"""
    illuminant: Illuminant = "D65"
    """D65 is daylight, A an incandescent lamp, LED-B3 a white LED of 4103 K (CIE 015:2018)."""
    observer: Observer = "2"
    """Field of the standard observer, in degrees."""
    lit_by: LightFrom = "sky"
    """sky: from all sides; lamp: at 45 degrees all round. The eye looks down from above."""
    gloss: bool = False
    """Whether what the surface mirrors is part of the colour."""
    tolerance: Positive = 0.3
    """Standard error that the colour of every place must reach. [CIEDE2000]"""
    change_tolerance: Positive = 0.05
    """Standard error that every change of colour by force must reach. [CIEDE2000]"""
    photograph_px: tuple[Pixels, Pixels] = (800, 600)
    """Width and height of a photograph. [px]"""
    camera_mm: tuple[float, float, float] = (-12.0, 38.0, 58.0)
    """From where a photograph is taken: across, towards the tip, and above the middle of the nail. [mm]"""
