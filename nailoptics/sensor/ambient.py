"""Light from outside on a photodiode: by reciprocity, from the part of its own light that would leave the finger."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from .. import tissue
from ..assets import read_table
from ..checks import Array
from ..light import optics
from ..light.board_map import BoardTracer
from ..light.tracing.store import LightStore
from ..options import TraceOptions
from ..scene import Ambient, Photodiode, Scene
from ..statistics import Z95, seed_of

LUMENS_PER_WATT = 683.0  # by definition (CIE 1931, photopic)
# Second constant of Planck's law, as CIE illuminants have it. [nm K]
C2_NM_K = 1.4388e7
STEP_NM = 10.0
# Wavelengths that silicon sees, and in tissue, where that of the nearest wavelength stands for what has no data.
SILICON_NM = np.arange(380.0, 1100.0 + STEP_NM / 2, STEP_NM)
FINE_NM = np.linspace(SILICON_NM[0], SILICON_NM[-1], 7201)
INSIDE_NM = np.clip(SILICON_NM, *tissue.WAVELENGTH_RANGE_NM)
KELVIN = {"sun": 5778.0, "lamp": 2856.0}  # effective temperature of the Sun; CIE standard illuminant A
# Over these wavelengths a black body's irradiance is taken. [nm]
ALL_NM = np.arange(100.0, 60_000.0)
# Full sun, and a bright place in the light of incandescent lamps, the kind with the most infrared for its lux.
SOURCES = SUN, LAMP = Ambient(kind="sun", illuminance_lux=1e5), Ambient(kind="lamp", illuminance_lux=1e3)
# Photons that each photodiode sends back out: a leakage of 1e-4 is then known within a few parts in ten.
PHOTONS = 1 << 16
# The same for its bound, to which resistors fit.
BOUND_PHOTONS = 1 << 13
_BACK = 31


def sources_of(scene: Scene) -> tuple[Ambient, ...]:
    """The light from outside that a scene names, or the usual sun and lamp."""
    return SOURCES if scene.ambient is None else (scene.ambient,)


def spectral_irradiance(ambient: Ambient, wavelength_nm: ArrayLike) -> Array:
    """Irradiance of the finger by wavelength; every part of the skin gets so much of it. [W m^-2 nm^-1]"""

    def relative(nm: ArrayLike) -> Array:
        nm = np.asarray(nm, float)
        if ambient.kind in KELVIN:
            return np.asarray(nm**-5 / np.expm1(C2_NM_K / (nm * KELVIN[ambient.kind])))
        lamp = read_table("photometry/led_b3.csv")
        return np.interp(nm, lamp["wavelength_nm"], lamp["relative"], left=0.0, right=0.0)

    if ambient.irradiance_w_per_m2 is not None:
        return relative(wavelength_nm) * ambient.irradiance_w_per_m2 / np.trapezoid(relative(ALL_NM), ALL_NM)
    seen_nm, efficiency = read_table("photometry/photopic.csv").values()
    lumens = LUMENS_PER_WATT * np.trapezoid(efficiency * relative(seen_nm), seen_nm)
    return relative(wavelength_nm) * (ambient.illuminance_lux or 0.0) / lumens


@lru_cache(maxsize=16)
def photocurrent_a_per_mm2(ambient: Ambient, photodiode: Photodiode) -> Array:
    """Photocurrent around each wavelength of `SILICON_NM` per area without a finger, (q,) float; they add up to that of
    the whole spectrum, between them linear. [A/mm^2]"""
    step_nm = FINE_NM[1] - FINE_NM[0]
    current = 1e-6 * spectral_irradiance(ambient, FINE_NM) * optics.responsivity_a_per_w(photodiode, FINE_NM) * step_nm
    current[[0, -1]] *= 0.5
    place = (FINE_NM - SILICON_NM[0]) / STEP_NM
    cell = np.minimum(place.astype(int), len(SILICON_NM) - 2)
    low, high = (np.bincount(cell, part * current) for part in (1 - (place - cell), place - cell))
    return np.asarray(np.append(low, 0.0) + np.append(0.0, high))


def trace_ambient(
    scene: Scene, sources: Sequence[Ambient], options: TraceOptions, *, seed: int, photons: int = PHOTONS
) -> Array:
    """Trace the photocurrents of a scene's photodiodes by sources outside, through cover, edges and skin, (3, sources,
    photodiodes) float: the estimate, its standard error, and that of the bare photodiode in the open. [A]

    By reciprocity, from one trace of each photodiode's own light, at the longest wavelength of the scene's LEDs. Where
    none of n photons left, the standard error is that of one.
    """
    elements, led = scene.layout.photodiodes, int(np.argmax([led.wavelength_nm for led in scene.leds]))
    mu_a, n = optics.absorption(scene, INSIDE_NM), optics.index_around(scene, scene.leds[led].wavelength_nm)
    stores = LightStore.of_command(options)
    tracer = BoardTracer(scene, backend=options.backend, stores=stores, seed=seed)
    result = np.empty((3, len(sources), len(elements)))
    for j, element in enumerate(elements):
        area_mm2 = element.area.area_mm2
        bare = np.stack([photocurrent_a_per_mm2(source, element.photodiode) for source in sources])
        left = tracer.leaving(j, led, photons=photons, seed=seed_of(seed, _BACK, j))
        currents_a, whole_a = left.from_outside(bare, mu_a, area_mm2=area_mm2, n=n), area_mm2 * bare.sum(1)
        largest_a = currents_a.max(1, initial=0.0)
        largest_a = np.where(largest_a > 0, largest_a, whole_a / photons)
        total, square = currents_a.sum(1), (currents_a**2).sum(1)
        result[..., j] = total, np.sqrt(np.maximum(square - total**2 / photons, largest_a**2)), whole_a
    return result


def ambient_bound_a(scene: Scene, *, usual: Ambient | None = None) -> Array:
    """Upper end of the 95 % interval of each photodiode's photocurrent by the scene's [ambient] at the crest of its
    flicker, or by the usual light where it has none, (photodiodes,) float; 0 without either. [A]"""
    source = scene.ambient or usual
    if source is None:
        return np.zeros(len(scene.layout.photodiodes))
    traced = trace_ambient(scene, [source], TraceOptions(), seed=0, photons=BOUND_PHOTONS)
    return np.asarray((1.0 + source.flicker) * (traced[0, 0] + Z95 * traced[1, 0]))


def scene_ambient_a(scene: Scene, options: TraceOptions) -> Array | None:
    """Photocurrents by a scene's [ambient]: estimate, standard error, and that of the bare photodiode, (3, photodiodes)
    float; None without. [A]"""
    if scene.ambient is None:
        return None
    return trace_ambient(scene, [scene.ambient], options, seed=options.seed)[:, 0]
