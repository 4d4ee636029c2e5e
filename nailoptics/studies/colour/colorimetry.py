"""From reflectance to colour: tristimulus values, Lab, sRGB and colour differences, all by colour-science."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...scene.viewing import Illuminant, Observer
from ...statistics import Array

OBSERVERS = {"2": "CIE 1931 2 Degree Standard Observer", "10": "CIE 1964 10 Degree Standard Observer"}
# The wavelengths at which reflectance is taken. At 5 nm haemoglobin's bands are resolved; the eye sees little beyond
# 400 and 780 nm. [nm]
WAVELENGTHS_NM = np.arange(400.0, 781.0, 5.0)


@dataclass(frozen=True)
class Viewer:
    """An eye, and the light by which it sees.

    illuminant : D65 is daylight, A an incandescent lamp, LED-B3 a white LED of 4103 K (CIE 015:2018).
    observer : 2 or 10 degrees.
    """

    illuminant: Illuminant = "D65"
    observer: Observer = "2"

    @cached_property
    def weights(self) -> Array:
        """What each of `WAVELENGTHS_NM` adds to X, Y, Z per reflectance, (q, 3) float; a white surface has Y = 1."""
        colour = _science()
        light = colour.SDS_ILLUMINANTS[self.illuminant]
        observer = colour.MSDS_CMFS[OBSERVERS[self.observer]]
        spectrum = np.interp(WAVELENGTHS_NM, light.wavelengths, light.values)
        matching = np.stack([np.interp(WAVELENGTHS_NM, observer.wavelengths, band) for band in observer.values.T], -1)
        weights = spectrum[:, None] * matching
        return np.asarray(weights / weights[:, 1].sum())

    @property
    def white(self) -> Array:
        """X, Y, Z of a white surface, (3,) float."""
        return np.asarray(self.weights.sum(0))

    def lab(self, reflectance: Array) -> Array:
        """CIE 1976 L*a*b* of reflectances (..., q), (..., 3) float."""
        return lab_of(np.maximum(reflectance @ self.weights, 0.0), self.white)

    def srgb(self, reflectance: Array) -> Array:
        """The colour on a screen, seen by an eye that is used to the light, (..., 3) float in 0-1."""
        colour = _science()
        xyz = np.maximum(reflectance @ self.weights, 0.0)
        return np.clip(colour.XYZ_to_sRGB(xyz, illuminant=colour.XYZ_to_xy(self.white)), 0.0, 1.0)


def lab_of(xyz: Array, white: Array) -> Array:
    """CIE 1976 L*a*b* of X, Y, Z, (..., 3) float, beside those of a white surface, (3,) float with Y = 1."""
    colour = _science()
    return np.asarray(colour.XYZ_to_Lab(xyz, illuminant=colour.XYZ_to_xy(white)))


def delta_e_2000(lab: Array, other: Array) -> Array:
    """Colour difference by CIEDE2000, of arrays of Lab that broadcast, (...) float."""
    return np.asarray(_science().delta_E(*np.broadcast_arrays(lab, other), method="CIE 2000"))


def linear(srgb: Array) -> Array:
    """Linear red, green and blue of colours on a screen."""
    return np.asarray(_science().models.eotf_sRGB(srgb))


def _science() -> Any:
    # Half a second, paid only where a colour is requested.
    import colour

    return colour
