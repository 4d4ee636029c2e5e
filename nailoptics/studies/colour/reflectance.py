"""Reflectance of the nail at every wavelength from traced rays, and the colour that an eye sees in it.

Scattering changes slowly with wavelength and absorption does not: so rays are walked at a few nodes, each is dimmed by
the absorption of every wavelength, and between the nodes of scattering reflectance is interpolated.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...light import optics
from ...light.identity import light_scene
from ...light.transfer.records import attenuation
from ...light.transfer.series import ChebyshevBox
from ...light.walk.nail_reflectance import NailReflectance, Patch, ReflectedLight
from ...options import Illuminant, Observer
from ...scene import Scene, Viewing
from ...statistics import Array, leave_one_out

OBSERVERS = {"2": "CIE 1931 2 Degree Standard Observer", "10": "CIE 1964 10 Degree Standard Observer"}
# Wavelengths of reflectances: 5 nm resolve haemoglobin's bands, and the eye sees little beyond 400 and 780. [nm]
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


# Groups of independent rays, from which standard errors are made.
GROUPS = 32
# Chebyshev nodes in the logarithm of the wavelength: three err by 0.002 (CIEDE2000), two by 0.07, four by 0.0003.
NODES = 3
# A lamp's light leaves, read backwards, within 5 degrees of 45 degrees all round (CIE 15, 45a:0).
LAMP_COSINES = (np.cos(np.radians(50.0)), np.cos(np.radians(40.0)))
# Records that are read at once: what is left of them in all states and at all wavelengths fills the processor's cache.
CHUNK = 1024
# Rays are walked at so many times the least absorption that is read, where the figure of merit of the prototype's
# colours is 1.25 times, of their changes 1.35 times that at once. With `ANALOG_FRACTION` of absorption ending rays,
# fourth moments of weights are bounded up to 8/3 at any length of path, second ones up to 4.
ABSORPTION = 2.5

_BOX = ChebyshevBox(np.log(WAVELENGTHS_NM[:1]), np.log(WAVELENGTHS_NM[-1:]), [NODES])
# The wavelengths at which rays are walked, rising, [nm], and what each counts for at `WAVELENGTHS_NM`, (nodes, q).
NODES_NM, WEIGHTS = np.exp(_BOX.nodes[:, 0]), _BOX.weights(np.log(WAVELENGTHS_NM)).T


@dataclass(frozen=True)
class ColourRays:
    """Rays of all nodes, from which the reflectance of every patch can be read.

    scene : whose finger they were walked in.
    light : rays of each node.
    sums : (NODES, GROUPS, patches, states, q) float. Over the rays, dimmed in the states that were read.
    """

    scene: Scene
    patches: tuple[Patch, ...]
    light: tuple[ReflectedLight, ...]
    sums: Array = field(default_factory=lambda: np.zeros(()))

    @property
    def photons(self) -> int:
        """Rays of all nodes together."""
        return int(sum(cell.rays.sum() for cell in self.light))

    def with_more(self, other: "ColourRays") -> "ColourRays":
        """These rays and others of the same finger, read in the same states, as one."""
        light = tuple(a.with_more(b) for a, b in zip(self.light, other.light, strict=True))
        return replace(self, light=light, sums=self.sums + other.sums)

    def read(self, states: Array, viewing: Viewing, *, scene: Scene | None = None) -> "ColourRays":
        """The rays with their sums in some states.

        states : (s, zones) float. Blood in each zone of the bed. [1]
        viewing : where light comes from, and whether what the surface mirrors counts.
        scene : whose absorption it is; that of the traced scene if not given.
        """
        absorbing = self.scene if scene is None else scene
        mu_a = optics.absorption(absorbing, WAVELENGTHS_NM, blood_fraction=states)
        return replace(self, sums=np.stack([_sums(_weighted(cell, viewing), mu_a) for cell in self.light]))

    @property
    def reflectance(self) -> Array:
        """Reflectance factor in these states, by all rays and without each group, (1 + GROUPS, patches, states, q)."""
        means = (GROUPS * sums / cell.rays[:, None, None] for sums, cell in zip(self.sums, self.light, strict=True))
        return leave_one_out(sum(mean * weight for mean, weight in zip(means, WEIGHTS, strict=True)))


def _weighted(light: ReflectedLight, viewing: Viewing) -> ReflectedLight:
    """The rays that go back to where light comes from, in proportion to those from a white surface."""
    weight = np.where(light.gloss, np.float32(viewing.gloss), np.float32(1)) * light.weight
    if viewing.lit_by == "lamp":
        low, high = LAMP_COSINES
        weight *= ((light.cosine > low) & (light.cosine < high)) / np.float32(high**2 - low**2)
    return replace(light, weight=weight)


def _sums(light: ReflectedLight, mu_a: Array) -> Array:
    """Sums over the rays of each group, (GROUPS, patches, states, q) float.

    mu_a : (states, q, r) float. [mm^-1]
    """
    cell = light.group.astype(int) * len(light.rays) + light.patch
    seen = np.flatnonzero(light.weight)
    order = seen[np.argsort(cell[seen], kind="stable")]
    # float32 halves the time of the exponentials; sums over the rays of a group and a patch are taken in float64.
    change = (mu_a - light.mu_a).reshape(-1, mu_a.shape[-1]).astype(np.float32)
    sums = np.zeros((GROUPS * len(light.rays), len(change)))
    for start in range(0, len(order), CHUNK):
        rows = order[start : start + CHUNK]
        left, weight = attenuation(light.path_mm[rows].astype(np.float32), change), light.weight[rows]
        cells, first = np.unique(cell[rows], return_index=True)
        for at, begin, end in zip(cells, first, [*first[1:], len(rows)], strict=True):
            sums[at] += weight[begin:end] @ left[begin:end]
    return sums.reshape(GROUPS, len(light.rays), *mu_a.shape[:2])


def walk_colour(
    nail: NailReflectance,
    patches: Sequence[Patch],
    *,
    photons: int,
    seed: int,
    shares: Sequence[float] = (1 / NODES,) * NODES,
    progress: Callable[[int], None] = lambda photons: None,
) -> ColourRays:
    """Walk rays of every node to the patches.

    photons : Rays of all nodes together. shares : parts of them that each node gets.
    progress : called after each node with its rays.
    """
    # The same for all fingers of one shape, whatever they absorb, so that they share their rays.
    usual, none = light_scene(nail.scene), np.zeros(nail.scene.zone_count)
    traced = ABSORPTION * optics.absorption(usual, WAVELENGTHS_NM, blood_fraction=none).min(0)
    # All nodes take the same random numbers, so that their errors hardly change the hue.
    how: dict[str, Any] = {"seed": seed, "groups": GROUPS, "mu_a": traced}
    lights = []
    for wavelength_nm, share in zip(NODES_NM, shares, strict=True):
        lights.append(nail.reflect(float(wavelength_nm), patches, photons=math.ceil(share * photons), **how))
        progress(int(lights[-1].rays.sum()))
    return ColourRays(nail.scene, tuple(patches), tuple(lights))
