"""Light by layered diffusion: nail plate, bed and bone as flat layers under the epoxy, solved in milliseconds.

Each layer is laterally infinite, so that the diffusion equation falls apart into one equation in depth for every
spatial frequency across the board, which has a closed solution. Dies and photodiodes enter by what they light, and
see, of the nail through the clear epoxy; the barrier and the rim cut that off.

What it leaves out: the bend of the nail, its edges and the fingertip; epidermis, pulp and bone's end; that light
near where it enters is not yet diffuse, and goes on in the direction in which it came (nail plate and epoxy are about
as thin as the mean path between scatterings, so that readings near the LED come out too low by tens of percent);
light that the board or the barrier sends back; Kapton; the LED's line width; any pattern but Lambertian.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array
from ..errors import InputError
from ..scene import Scene
from ..scene.layout import Layout
from ..scene.rectangles import Rectangle
from . import optics
from .transfer.interpolation import ChebyshevBox

REGIONS = ("plate", "bed", "bone", "epoxy")
# The nail is computed in cells and repeats itself beyond the board with a gap that no light crosses. [mm]
CELL_MM, GAP_MM = 0.1, 8.0
# A function of the spatial frequency is computed at so many, closer together where they are low, and interpolated.
FREQUENCIES = 384
# Gauss-Legendre points over the bed's depth and over a hemisphere; Chebyshev points over a range of absorption.
DEPTHS, ANGLES, NODES = 3, 64, 5
# Lambertian light goes this part of its path into the depth.
MEAN_COSINE = 2 / 3
# Of a blood fraction: a range that divides where the states are all the same.
TINY = 1e-9


@lru_cache
def fresnel_moments(n_in: float, n_out: float) -> tuple[float, float]:
    """Reflected parts of diffuse light at a step of the refractive index, of its fluence and of its flux.

    Returns: 2 int R(c) c dc and 3 int R(c) c^2 dc over cosines c from 0 to 1.
    """
    node, weight = np.polynomial.legendre.leggauss(ANGLES)
    # Where reflection becomes total the integrand has a kink: the integral is split there.
    critical = np.sqrt(max(0.0, 1 - (n_out / n_in) ** 2))
    cosine = critical + (1 - critical) * (node + 1) / 2
    weight = weight * (1 - critical) / 2
    beyond = np.sqrt(np.maximum(1 - (n_in / n_out) ** 2 * (1 - cosine**2), 0))
    across = (n_in * cosine - n_out * beyond) / (n_in * cosine + n_out * beyond)
    along = (n_in * beyond - n_out * cosine) / (n_in * beyond + n_out * cosine)
    reflected = (across**2 + along**2) / 2
    fluence = critical**2 + 2 * weight @ (reflected * cosine)
    return float(fluence), float(critical**3 + 3 * weight @ (reflected * cosine**2))


@dataclass(frozen=True, kw_only=True)
class DiffusiveStack:
    """Flat layers in which light diffuses, from the top down; the last one reaches down without end.

    thickness_mm : (layers - 1,) float. Of all layers but the last. [mm]
    mu_a_per_mm, mu_s_reduced_per_mm : (layers,) float. mu_a and mu_s (1 - g). [mm^-1]
    n : (layers,) float. Refractive indices.
    n_above : Refractive index above.

    Index steps between layers hold the fluence apart in proportion to the flux; the top is an extrapolated boundary.

    References: layers: Kienle et al. 1998, Appl. Opt. 37, 779; Liemert, Kienle 2010, J. Biomed. Opt. 15, 025003.
    Boundary: Contini, Martelli, Zaccanti 1997, Appl. Opt. 36, 4587. Steps: Aronson 1995, J. Opt. Soc. Am. A 12, 2532.
    """

    thickness_mm: Array
    mu_a_per_mm: Array
    mu_s_reduced_per_mm: Array
    n: Array
    n_above: float

    @property
    def diffusion_mm(self) -> Array:
        """Diffusion coefficient of each layer, (layers,) float. [mm]"""
        return np.asarray(1 / (3 * (self.mu_a_per_mm + self.mu_s_reduced_per_mm)))

    @property
    def mean_path_mm(self) -> float:
        """Path after which light has lost its direction in the first layer. [mm]"""
        return float(1 / (self.mu_a_per_mm[0] + self.mu_s_reduced_per_mm[0]))

    @cached_property
    def extrapolated_mm(self) -> float:
        """How far above the top the fluence would come to nothing. [mm]"""
        fluence, flux = fresnel_moments(self.n[0], self.n_above)
        return float(2 * self.diffusion_mm[0] * (1 + flux) / (1 - fluence))

    @cached_property
    def _steps(self) -> list[float]:
        """Fall of fluence / n^2 from layer to layer, per flux."""
        out = []
        for above, below in zip(self.n, self.n[1:], strict=False):
            (fluence, flux), (_, back) = fresnel_moments(above, below), fresnel_moments(below, above)
            out.append(2 * (flux + back) / (1 - fluence) / above**2)
        return out

    def escape(self, frequency_per_mm: Array, depth_mm: ArrayLike) -> Array:
        """Light of an isotropic source at a depth that leaves through the top, per spatial frequency.

        frequency_per_mm : (k,) float. Angular spatial frequencies across the layers. [mm^-1]
        depth_mm : (m,) float. Depths of the source. [mm]

        Returns: (m, k) float; at frequency 0 the part of the light that leaves. By reciprocity the fluence / n^2 that
        light from a source above these depths makes there is in proportion to it.
        """
        diffusion, last = self.diffusion_mm[:, None], len(self.n) - 1
        decay = np.sqrt(self.mu_a_per_mm[:, None] / diffusion + frequency_per_mm**2)
        source = diffusion * self.n[:, None] ** 2 * decay
        # Flux per fluence / n^2: own of each medium, then at the top and at the bottom of each layer.
        top, bottom = source.copy(), source.copy()
        for i in reversed(range(last)):
            bottom[i] = top[i + 1] / (1 + self._steps[i] * top[i + 1])
            slope = np.tanh(decay[i] * self.thickness_mm[i])
            top[i] = source[i] * (bottom[i] + source[i] * slope) / (source[i] + bottom[i] * slope)

        def fall(i: int, x: float) -> Array:
            """Fluence at x below a layer's top, as a part of that there."""
            if i == last:
                return np.asarray(np.exp(-decay[i] * x))
            passed, rest, whole = (
                np.exp(-decay[i] * length) for length in (x, self.thickness_mm[i] - x, self.thickness_mm[i])
            )
            ratio = bottom[i] / source[i]
            part = (1 + rest**2) + ratio * (1 - rest**2)
            return np.asarray(passed * part / ((1 + whole**2) + ratio * (1 - whole**2)))

        above = np.tanh(decay[0] * self.extrapolated_mm) / decay[0] / (diffusion[0] * self.n[0] ** 2)
        at_top = [1 / (1 + above * top[0])]
        for i in range(last):
            at_top.append(at_top[i] * fall(i, self.thickness_mm[i]) / (1 + self._steps[i] * top[i + 1]))
        edges = np.concatenate([[0.0], np.cumsum(self.thickness_mm)])
        depths = np.atleast_1d(np.asarray(depth_mm, float))
        layers = np.searchsorted(edges, depths, side="right") - 1
        return np.stack([at_top[i] * fall(i, x - edges[i]) for i, x in zip(layers, depths, strict=True)])


class DiffusionModel:
    """The light of a finger scene's LEDs on its photodiodes by layered diffusion, in any state of the blood.

    zone_share : (led, photodiode, zones) float. How much of what a reading owes to the blood each zone of the bed has,
        as the light at rest sees them.

    Raises: InputError for a phantom.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.finger is None:
            raise InputError("layered diffusion is for a [finger] scene; a [phantom] is traced exactly.")
        self.scene, layout = scene, scene.layout
        self._deep_mm = np.array([scene.finger.nail_thickness_mm, scene.finger.bed_thickness_mm])
        self._cells = _Cells(layout)
        height = scene.board.height_mm
        dies, areas = layout.leds, layout.photodiode_areas
        self._emitted = [np.fft.rfft2(self._cells.view_factor(die, height) / die.area_mm2) for die in dies]
        self._detected = np.stack([np.fft.rfft2(self._cells.view_factor(area, height)) for area in areas])
        self._stacks = [self._stack(led.wavelength_nm) for led in scene.leds]
        self.zone_share = np.stack([self._zone_share(i) for i in range(len(dies))])

    def readings(self, blood_fraction: ArrayLike) -> Array:
        """Detected fractions of the emitted power at each LED's peak wavelength, (led, photodiode, states) float.

        blood_fraction : (states, zones) float in 0-1. Blood in each zone of the bed.

        The blood of the zones counts as one, mixed by `zone_share`. Over what that absorbs the logarithm of a reading
        is interpolated, so that a thousand states cost as much as two.
        """
        states = np.asarray(blood_fraction, float)
        return np.stack([self._over(i, states @ share.T) for i, share in enumerate(self.zone_share)])

    def _over(self, led: int, blood: Array) -> Array:
        """Readings of one LED where each photodiode sees one blood fraction in each state, (photodiode, states)."""
        beds = optics.bed_columns(self.scene)
        low = float(blood.min())
        box = ChebyshevBox([low], [low + max(float(np.ptp(blood)), TINY)], [NODES])
        mu_a = optics.absorption(
            self.scene, self.scene.leds[led].wavelength_nm, blood_fraction=np.repeat(box.nodes, len(beds), 1)
        )
        logarithm = np.log([self._read(led, bed) for bed in mu_a[:, 0, beds[0]]])
        return np.exp([box.weights(state) @ curve for state, curve in zip(blood.T, logarithm.T, strict=True)])

    def _stack(self, wavelength_nm: float) -> DiffusiveStack:
        """The layers with the blood at rest."""
        media = optics.finger_media(self.scene, REGIONS, wavelength_nm)
        return DiffusiveStack(
            thickness_mm=self._deep_mm,
            mu_a_per_mm=media.mu_a[:3],
            mu_s_reduced_per_mm=(media.mu_s * (1 - media.g))[:3],
            n=media.n[:3],
            n_above=float(media.n[3]),
        )

    def _read(self, led: int, bed_mu_a_per_mm: float) -> Array:
        """Readings of one LED at one absorption of the bed, (photodiodes,) float."""
        plate, _, bone = self._stacks[led].mu_a_per_mm
        stack = replace(self._stacks[led], mu_a_per_mm=np.array([plate, bed_mu_a_per_mm, bone]))
        scattered = stack.mu_s_reduced_per_mm[0] * stack.mean_path_mm
        escaping = stack.escape(self._cells.tabulated_per_mm, MEAN_COSINE * stack.mean_path_mm)[0]
        light = self._emitted[led] * self._cells.between(scattered * escaping)
        return np.array([self._cells.overlap(light, detected) for detected in self._detected])

    def _zone_share(self, led: int) -> Array:
        """The part of each blood zone in the derivative of each reading to the bed's absorption, (photodiodes, zones).

        By place that is the fluence that the LED makes times the chance that light is detected from there.
        """
        stack, cells = self._stacks[led], self._cells
        node, weight = np.polynomial.legendre.leggauss(DEPTHS)
        depths = self._deep_mm[0] + (node + 1) / 2 * self._deep_mm[1]
        source = min(MEAN_COSINE * stack.mean_path_mm, self._deep_mm[0])
        decay = np.sqrt(stack.mu_a_per_mm[0] / stack.diffusion_mm[0] + cells.tabulated_per_mm**2)
        # Up from the source the fluence falls to nothing at the extrapolated boundary.
        over, up = (np.exp(-2 * decay * length) for length in (stack.extrapolated_mm, source + stack.extrapolated_mm))
        entered = np.exp(decay * source) * (1 - up) / (1 + over) / decay
        share = np.zeros((len(self._detected), len(cells.v_mm)))
        for escape, part in zip(stack.escape(cells.tabulated_per_mm, depths), weight, strict=True):
            lit = cells.field(self._emitted[led] * cells.between(entered * escape))
            sees = cells.field(self._detected * cells.between(escape))
            share += part * np.einsum("uv,puv->pv", lit, sees)
        by_zone = share @ optics.zones(self.scene).weights(cells.v_mm)
        return np.asarray(by_zone / by_zone.sum(1, keepdims=True))


class _Cells:
    """The nail's outer face under a board as a square of cells, and the spatial frequencies of fields on it.

    u_mm, v_mm : (n,) float. The cells' middles. [mm]
    tabulated_per_mm : (k,) float. Frequencies at which functions of the frequency are computed. [mm^-1]
    """

    def __init__(self, layout: Layout) -> None:
        # Whole dozens of cells transform fast.
        self.count = 12 * int(np.ceil((max(layout.outline.size_mm) + GAP_MM) / (12 * CELL_MM)))
        place = (np.arange(self.count) - (self.count - 1) / 2) * CELL_MM
        self.layout = layout
        self.u_mm, self.v_mm = (np.asarray(middle + place) for middle in layout.outline.center_mm)
        axis = np.abs(2 * np.pi * np.fft.fftfreq(self.count, CELL_MM))
        self._frequency = np.hypot(axis[:, None], axis[: self.count // 2 + 1])
        # Of a real field's spectrum half is kept; the frequencies that are their own opposites count once.
        self._counted = np.full(self.count // 2 + 1, 2.0)
        self._counted[[0, -1]] = 1.0
        self.tabulated_per_mm = self._frequency.max() * np.linspace(0, 1, FREQUENCIES) ** 2

    def between(self, values: np.ndarray) -> np.ndarray:
        """A function of the frequency that was computed where it is tabulated, at every frequency of the cells."""
        return np.interp(self._frequency, self.tabulated_per_mm, values)

    def field(self, spectrum: np.ndarray) -> np.ndarray:
        """The field of a spectrum."""
        return np.fft.irfft2(spectrum, s=(self.count, self.count))

    def overlap(self, spectrum: np.ndarray, other: np.ndarray) -> float:
        """The integral of the product of two fields over the nail. [mm^2]"""
        total = np.einsum("uv,uv,v->", spectrum, other.conj(), self._counted).real
        return float(total) * (CELL_MM / self.count) ** 2

    def view_factor(self, face: Rectangle, height_mm: float) -> np.ndarray:
        """The part of Lambertian light from each cell of the nail that falls on a face on the board, (u, v) float.

        By reciprocity, divided by the face's area, it is the irradiance of the nail by a Lambertian die there.
        """
        factor = np.zeros((len(self.u_mm), len(self.v_mm)))
        for part in face.strips():
            left, right = part.u_min - self.u_mm[:, None], part.u_max - self.u_mm[:, None]
            near, far = part.v_min - self.v_mm, part.v_max - self.v_mm
            factor += _corner(right, far, height_mm) - _corner(left, far, height_mm)
            factor += _corner(left, near, height_mm) - _corner(right, near, height_mm)
        outline = self.layout.outline
        low_u, high_u, low_v, high_v = outline.u_min, outline.u_max, outline.v_min, outline.v_max
        # A wall from the board to the nail hides all that lies behind it.
        for wall in self.layout.barriers:
            if wall.name in ("left", "right"):
                high_u = min(high_u, wall.u_min) if face.u_max <= wall.u_min else high_u
                low_u = max(low_u, wall.u_max) if face.u_min >= wall.u_max else low_u
            else:
                high_v = min(high_v, wall.v_min) if face.v_max <= wall.v_min else high_v
                low_v = max(low_v, wall.v_max) if face.v_min >= wall.v_max else low_v
        return np.asarray(factor * _covered(self.u_mm, low_u, high_u)[:, None] * _covered(self.v_mm, low_v, high_v))


def _corner(x: np.ndarray, y: np.ndarray, height_mm: float) -> np.ndarray:
    """View factor from a small face to a parallel rectangle with one corner above it (Howell, A Catalog of Radiation
    Heat Transfer Configuration Factors)."""
    a, b = np.hypot(x, height_mm), np.hypot(y, height_mm)
    return np.asarray((x / a * np.arctan(y / a) + y / b * np.arctan(x / b)) / (2 * np.pi))


def _covered(middle_mm: np.ndarray, low_mm: float, high_mm: float) -> np.ndarray:
    """The part of each cell along an axis that lies between two places, (n,) float."""
    half = CELL_MM / 2
    return np.clip((np.minimum(middle_mm + half, high_mm) - np.maximum(middle_mm - half, low_mm)) / CELL_MM, 0, 1)
