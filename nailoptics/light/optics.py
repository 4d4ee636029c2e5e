"""What a photon meets: the optics of every region of a scene, and how absorption follows the blood."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import checks, tissue
from ..errors import InputError
from ..geometry import AROUND
from ..hemodynamics.blood import saturation as so2_of_zones
from ..scene import Led, Photodiode, Scene
from ..scene.base import PHOTON_NM_PER_V

# Regions of a finger's geometry that light scatters in or passes; all others are opaque, but for the air.
TISSUES: tuple[str, ...] = tissue.REGIONS
# These opaque regions reflect as the board's field says; all others swallow light.
REFLECTING = ("barrier", "cover")
# Where an LED's line is integrated, from its peak, in widths at half its height.
LINE_WIDTHS = np.linspace(-2.5, 2.5, 5001)


@dataclass(frozen=True)
class Media:
    """The optics of each region at one wavelength, (r,) float each.

    opaque : (r,) bool. Light does not enter; it is reflected diffusely with `reflectance` or swallowed.
    mu_a, mu_s : [mm^-1]. With the blood at rest.
    """

    opaque: np.ndarray
    reflectance: np.ndarray
    mu_a: np.ndarray
    mu_s: np.ndarray
    g: np.ndarray
    n: np.ndarray


def zones(scene: Scene) -> tissue.BloodZones:
    """The blood zones of the nail bed."""
    return tissue.BloodZones(edges_mm=scene.zone_edges_mm, width_mm=scene.zone_width_mm)


@dataclass(frozen=True)
class Absorber:
    """What a trace keeps paths for: a region, or one blood zone of the bed.

    name : as in results; zones of the bed are bed_1, bed_2.
    region : as in the geometry, or the phantom's layer.
    zone : index of the blood zone; None where the region has none.
    """

    name: str
    region: str
    zone: int | None = None


def absorbing(scene: Scene) -> tuple[Absorber, ...]:
    """The absorbers of a scene, in the order of a trace's paths."""
    if scene.phantom is not None:
        return tuple(Absorber(layer.name, layer.name) for layer in scene.phantom.layers)
    beds = [Absorber(tissue.bed_zone_name(k), "bed", zone=k) for k in range(scene.zone_count)]
    return (Absorber("plate", "plate"), *beds, *(Absorber(name, name) for name in TISSUES[2:]))


def absorbers(scene: Scene) -> tuple[str, ...]:
    """The names of the absorbers of a scene, in the order of a trace's paths."""
    return tuple(absorber.name for absorber in absorbing(scene))


def bed_columns(scene: Scene) -> tuple[int, ...]:
    """Which of the absorbers are the bed's blood zones, from the most proximal on; none in a phantom."""
    return tuple(i for i, absorber in enumerate(absorbing(scene)) if absorber.zone is not None)


def finger_media(scene: Scene, regions: tuple[str, ...], wavelength_nm: float) -> Media:
    """The optics of a finger scene's regions at rest, in the order of the geometry's regions."""
    # At rest all zones of the bed hold the same blood.
    rest = {a.region: mu_a for a, mu_a in zip(absorbing(scene), absorption(scene, wavelength_nm)[0], strict=True)}
    rows = []
    for region in regions:
        mu_s, g, n = 0.0, 0.0, 1.0
        if region in TISSUES:
            mu_s, g, n = (float(x) for x in tissue.scattering(_optics_of(scene, region), wavelength_nm))
            mu_s *= _factor(scene, _optics_of(scene, region), "scattering")
            if scene.light.similarity:
                mu_s, g = mu_s * (1 - g), 0.0
        opaque = region not in TISSUES and region != "air"
        reflectance = scene.board.opaque_reflectance if region in REFLECTING else 0.0
        rows.append((opaque, reflectance, rest.get(region, 0.0), mu_s, g, n if scene.light.index_steps else 1.0))
    return Media(*(np.array(column) for column in zip(*rows, strict=True)))


def index_around(scene: Scene, wavelength_nm: float) -> float:
    """Refractive index of what surrounds LEDs and photodiodes. [1]"""
    return float(tissue.scattering("epoxy", wavelength_nm)[2]) if scene.light.index_steps else 1.0


def _optics_of(scene: Scene, region: str) -> Any:
    """The region whose optics a region has: its own, or those around it where it is left out."""
    return AROUND[region] if region in scene.light.left_out else region


def _factor(scene: Scene, region: str, kind: Literal["absorption", "scattering"]) -> float:
    """What the finger multiplies a region's absorption without blood, or its scattering, with."""
    return float(getattr(scene.finger, f"{region}_{kind}", 1.0))


def absorption(
    scene: Scene, wavelength_nm: ArrayLike, *, blood_fraction: ArrayLike | None = None, so2: ArrayLike | None = None
) -> np.ndarray:
    """The absorption of every absorber of a scene at blood states and wavelengths, (..., q, r) float. [mm^-1]

    wavelength_nm : (q,) float. [nm]
    blood_fraction : (..., K) float in 0-1. Blood in each zone of the bed; at rest if not given.
    so2 : (...) float in 0-1. Oxygen saturation; the scene's if not given, zone by zone where its blood pools.

    Returns: one column for each of `absorbers(scene)`.
    """
    wavelength = np.atleast_1d(np.asarray(wavelength_nm, float))
    if scene.phantom is not None:
        if blood_fraction is not None or so2 is not None:
            raise InputError("a phantom has no blood; give mu_a_per_mm by layer name instead of blood_fraction or so2.")
        return np.tile([layer.mu_a_per_mm for layer in scene.phantom.layers], (len(wavelength), 1))
    fraction = np.full(scene.zone_count, scene.blood.rest_blood_fraction)
    if blood_fraction is not None:
        fraction = checks.fraction("blood_fraction", blood_fraction)
    if fraction.shape[-1:] != (scene.zone_count,):
        why = f"its last axis needs one value for each of the {scene.zone_count} zones."
        raise InputError(f"blood_fraction has shape {fraction.shape}; {why}")
    saturation = np.asarray(scene.blood.rest_so2 if so2 is None else so2, float)[..., None]
    pooled = so2_of_zones(scene.blood, fraction) if so2 is None and scene.blood.venous_so2 is not None else None
    columns = []
    shape = np.broadcast_shapes(fraction.shape[:-1], saturation.shape[:-1])
    for absorber in absorbing(scene):
        region = _optics_of(scene, absorber.region)
        zone_so2 = saturation if absorber.zone is None or pooled is None else pooled[..., absorber.zone, None]
        melanin, dermis = scene.fingertip.melanin_fraction, scene.fingertip.dermis
        mixed = tissue.absorption(region, wavelength, so2=zone_so2, melanin_fraction=melanin, dermis_absorption=dermis)
        # Only the pulp outside the bed's zones carries blood.
        blood = scene.blood.pulp_blood_fraction if absorber.zone is None else fraction[..., absorber.zone, None]
        base = _factor(scene, region, "absorption") * np.asarray(mixed.base_per_mm)
        if region == "plate":
            base = base * (wavelength / 500) ** scene.fingertip.plate_absorption_slope
        column = base + blood * np.asarray(mixed.per_blood_fraction_per_mm)
        columns.append(np.broadcast_to(column, (*shape, len(wavelength))))
    return np.stack(columns, -1)


def equivalent_blood(scene: Scene, led: Led, blood_fraction: np.ndarray, so2: np.ndarray) -> np.ndarray:
    """Blood fractions that absorb as much of an LED's light, by the saturation that `absorption` takes for them, as
    others of known saturations, any shape. At the LED's peak, exact but for the width of its line. [1]"""
    rest = scene.blood.rest_blood_fraction
    mixed, pooled = (tissue.blood_mu_a_per_mm(led.wavelength_nm, s) for s in (scene.blood.rest_so2, scene.blood.so2))
    equal = blood_fraction * np.asarray(tissue.blood_mu_a_per_mm(led.wavelength_nm, so2)) / mixed
    # Beyond rest blood is arterial.
    return np.where(equal <= rest, equal, rest + (equal - rest) * mixed / pooled).astype(blood_fraction.dtype)


def spectrum(led: Led, points: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """The wavelengths and weights that integrate over an LED's Gaussian line (Gauss-Hermite), (q,) float each. [nm]"""
    if led.fwhm_nm == 0:
        return np.array([led.wavelength_nm]), np.ones(1)
    node, weight = np.polynomial.hermite.hermgauss(points)
    wavelength = led.wavelength_nm + node * led.fwhm_nm / (2 * np.sqrt(np.log(2)))
    return wavelength, weight / weight.sum()


def responsivity_a_per_w(photodiode: Photodiode, wavelength_nm: ArrayLike) -> np.ndarray:
    """A photodiode's photocurrent per watt of light, by its own table or quantum efficiency times wavelength / 1240 nm,
    of the wavelength's shape. [A/W]"""
    wavelength = np.asarray(wavelength_nm, float)
    if photodiode.responsivity is None:
        return np.asarray(photodiode.quantum_efficiency * wavelength / PHOTON_NM_PER_V)
    at_nm, value = np.asarray(photodiode.responsivity, float).T
    return np.asarray(np.interp(wavelength, at_nm, value, left=0.0, right=0.0))


@lru_cache(maxsize=1024)
def line_response(led: Led, photodiode: Photodiode) -> np.ndarray:
    """Photocurrent that light at each wavelength of `spectrum` makes per watt of the LED's light, (q,) float; they add
    up to the responsivity over the line. One of rows is averaged around each, wherever in the line its edges are. [A/W]
    """
    wavelength, weight = spectrum(led)
    if photodiode.responsivity is None or led.fwhm_nm == 0:
        return weight * responsivity_a_per_w(photodiode, wavelength)
    nm = led.wavelength_nm + led.fwhm_nm * LINE_WIDTHS
    near = np.array([np.interp(nm, wavelength, one) for one in np.eye(len(wavelength))]) * 0.5 ** (4 * LINE_WIDTHS**2)
    current = near @ responsivity_a_per_w(photodiode, nm)
    response = weight * current / near.sum(1)
    return response * (current.sum() / near.sum() / response.sum()) if current.any() else response


def detected_spectrum(led: Led, photodiodes: Sequence[Photodiode]) -> tuple[np.ndarray, np.ndarray]:
    """The wavelengths of `spectrum`, (q,) float [nm], and what each contributes to each photodiode's photocurrent, as a
    fraction of all of them, (photodiodes, q) float; to one that is blind to the line every photon counts alike."""
    wavelength, weight = spectrum(led)
    response = {id(one): line_response(led, one) for one in photodiodes}
    relative = {key: of_one / of_one.sum() if of_one.any() else weight for key, of_one in response.items()}
    return wavelength, np.array([relative[id(one)] for one in photodiodes])


def check_line(scene: Scene, led: int) -> None:
    """Raise InputError where an LED's line reaches beyond the wavelengths at which tissue is known."""
    source, (low, high) = scene.leds[led], tissue.WAVELENGTH_RANGE_NM
    wavelength, _ = spectrum(source)
    first, last = float(wavelength.min()), float(wavelength.max())
    if scene.finger is not None and source.fwhm_nm and (first < low or last > high):
        width = (last - first) / 2 / source.fwhm_nm
        most = max(min(source.wavelength_nm - low, high - source.wavelength_nm) / width, 0.0)
        raise InputError(
            f"leds[{led}].fwhm_nm = {source.fwhm_nm:g}: the line would be read from {first:.0f} to {last:.0f} nm, but "
            f"tissue is known from {low:g} to {high:g} nm; give at most {math.floor(most)}, or 0 for one wavelength."
        )
