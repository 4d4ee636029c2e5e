"""Phantoms and fingers as scenes for Mitsuba's stock volpath, which traces from the LED back to the photodiode.

Roles are swapped: the LED is the sensor and the photodiode the emitter, which by reciprocity gives the same reading
with less noise. Up to three blood states travel as channels of one path, so that their difference carries little noise.

A spectral variant's four wavelengths per path are four channels: its axis of wavelengths holds the LED's line four
times, one after the other. Mitsuba draws the four a quarter of all light apart, which is the same wavelength of the
line in each: so scattering changes along the line without the noise of chromatic media. Where no JIT backend works
the scalar variant does the main job, at the line's peak; its three channels are the colours of rgb, as plain floats.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...assets import WAVELENGTH_RANGE_NM
from ...errors import InputError
from ...geometry import Geometry
from ...scene import Led, Phantom
from ..optics import Media

# Wavelengths on which a line is given, and how far it reaches to both sides, in widths: 0.04 % lies beyond.
LINE_POINTS, LINE_REACH = 41, 1.5
# The first wavelength on a spectral variant's axis, on which they lie 1 apart. [nm]
AXIS_START = 400.0
# The least interaction of a medium that is clear at some wavelengths of a line; volpath divides by it. [mm^-1]
CLEAR_PER_MM = 1e-9
# The film adds up in float32, which loses counts past about 1e4 samples per pixel; so many pixels, few samples.
FILM = 16
# Half-size of "laterally infinite" planes. [mm]
INFINITE_MM = 1e3
# Mitsuba leaves a surface by 9e-5 (1 + |p|); what lies above a face must stay clear of that.
GAP = 5e-4
MAJORANT = 1.1
BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
# It keeps the three colours as they are.
RGB_FILM: dict[str, Any] = {"type": "hdrfilm", "width": FILM, "height": FILM, "rfilter": {"type": "box"}}
RGB_FILM |= {"pixel_format": "rgb", "component_format": "float32"}
Spectrum = NDArray[np.float64]


@dataclass(frozen=True)
class BedAbsorption:
    """Absorption of the nail bed along the nail, in up to three blood states.

    v_mm : (k,) float. Equally spaced places along the nail, k >= 2. [mm]
    mu_a_per_mm : (states, k) float, or (states, k, LINE_POINTS) along an LED's line. [mm^-1]
    """

    v_mm: NDArray[np.float64]
    mu_a_per_mm: NDArray[np.float64]


@dataclass(frozen=True)
class Window:
    """A rectangle on the top or bottom face of a phantom through which light is counted. [mm]"""

    center_mm: tuple[float, float]
    size_mm: tuple[float, float]
    top: bool = True


EVERYTHING = (0.9 * 2 * INFINITE_MM, 0.9 * 2 * INFINITE_MM)
# All light that a phantom reflects (specular included), and all that it transmits.
LEAVING = (Window((0.0, 0.0), EVERYTHING), Window((0.0, 0.0), EVERYTHING, top=False))


def line_wavelengths_nm(led: Led) -> Spectrum:
    """The wavelengths of an LED's line, (LINE_POINTS,) float; those beyond the tables are at their end. [nm]"""
    offset = led.fwhm_nm * np.linspace(-LINE_REACH, LINE_REACH, LINE_POINTS)
    return np.asarray(np.clip(led.wavelength_nm + offset, *WAVELENGTH_RANGE_NM))


def channel_count(variant: str) -> int:
    """How many readings a path carries."""
    return 4 if variant.endswith("spectral") else 3


def _on_axis(values: Spectrum, first: int = 0) -> dict[str, Any]:
    """Values on a spectral variant's axis, from one of its points on."""
    low, text = AXIS_START + first, ",".join(map(repr, values.tolist()))
    return {"type": "regular", "wavelength_min": low, "wavelength_max": low + len(values) - 1, "values": text}


def spectral(part: Any) -> Any:
    """A part of an rgb scene for a spectral variant: colours and values along a line as spectra on its axis."""
    if isinstance(part, list):
        # Mitsuba takes no spectrum of zeros, such as the albedo of a film that only absorbs.
        return _on_axis(np.tile(part, 4)) if any(part) else {"type": "uniform", "value": 0.0}
    if not isinstance(part, dict):
        return part
    if part.get("type") == "hdrfilm":
        # A film that weighs by a Gaussian line in each of four channels.
        line = np.exp2(-((2 * np.linspace(-LINE_REACH, LINE_REACH, LINE_POINTS)) ** 2))
        channels = {f"channel_{k}": _on_axis(line / np.trapezoid(line), k * LINE_POINTS) for k in range(4)}
        film = {name: value for name, value in part.items() if name != "pixel_format"}
        return film | {"type": "specfilm"} | channels
    if part.get("type") != "rgb":
        return {name: spectral(value) for name, value in part.items()}
    if np.ndim(part["value"]) == 0:
        return {"type": "uniform", "value": part["value"]}
    return _on_axis(np.repeat(part["value"], LINE_POINTS))


def medium(*, mu_a: ArrayLike, mu_s: ArrayLike, g: float) -> dict[str, Any] | None:
    """A homogeneous medium, None where light meets nothing; mu_a, mu_s : numbers, or (LINE_POINTS,) float. [mm^-1]"""
    mu_t = np.add(mu_a, mu_s)
    if not mu_t.any():
        return None
    if mu_t.ndim:
        mu_t = np.maximum(mu_t, CLEAR_PER_MM)
    return {
        "type": "homogeneous",
        "sigma_t": mu_t.tolist(),
        "albedo": np.divide(mu_s, mu_t).tolist(),
        "phase": {"type": "hg", "g": g},
        # Shadow rays through an index-matched boundary to an emitter close behind it are lost.
        "sample_emitters": False,
    }


def bed_medium(mi: Any, bed: BedAbsorption, *, mu_s: Any, g: float, bounds_mm: NDArray[np.float64]) -> dict[str, Any]:
    """The nail bed as a heterogeneous medium whose absorption varies along y; bounds_mm (2, 3) must hold all of it.
    mu_s : a number, or (LINE_POINTS,) float. [mm^-1]"""
    v, mu_a = np.asarray(bed.v_mm, float), np.asarray(bed.mu_a_per_mm, float)
    if len(mu_a) > 1:
        mu_a = mu_a[np.minimum(np.arange(channel_count(mi.variant())), len(mu_a) - 1)]
    mu_t = mu_a + mu_s
    # Values sit at the centres of cells.
    half = (v[1] - v[0]) / 2
    low, high = np.array(bounds_mm, float)
    low[1], high[1] = v[0] - half, v[-1] + half
    transform = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    volume = partial(_spectral_volume if mi.variant().endswith("spectral") else _grid_volume, mi, transform)
    # Without room below the majorant, the states' weights at null collisions would spread without bound.
    majorant = MAJORANT * float(mu_t.max())
    medium = {"type": "heterogeneous", "sigma_t": volume(mu_t, max_value=majorant), "albedo": volume(mu_s / mu_t)}
    return medium | {"phase": {"type": "hg", "g": g}, "sample_emitters": False}


def _grid_volume(mi: Any, to_world: Any, values: Spectrum, **more: float) -> dict[str, Any]:
    """Values (states, k) along y of a box, a state in each colour."""
    grid = mi.VolumeGrid(np.ascontiguousarray(values.T[None, :, None, :], np.float32))
    return {"type": "gridvolume", "grid": grid, "raw": True, "to_world": to_world, "wrap_mode": "clamp"} | more


def _spectral_volume(mi: Any, to_world: Any, values: Spectrum, *, max_value: float = 1.0) -> Any:
    """Values (states, k) or (states, k, LINE_POINTS) along y of a box and along the axis of wavelengths.

    Mitsuba has grids of one value or of three colours, none of spectra.
    """
    if values.ndim == 2:
        values = np.repeat(values[..., None], LINE_POINTS, axis=2)
    values = np.concatenate(np.broadcast_to(values, (4, *values.shape[1:])), axis=1)
    places, points = values.shape
    table = mi.Texture2f(mi.TensorXf(values[..., None]), use_accel=False)
    to_local = mi.AffineTransform4f(to_world.inverse())

    class SpectralVolume(mi.Volume):
        """A table of values by place and wavelength."""

        def eval(self, it: Any, active: Any = True) -> Any:
            """The values at a place at each wavelength of a path."""
            along, result = (to_local @ it.p).y, mi.UnpolarizedSpectrum(0)
            for i in range(4):
                column = (it.wavelengths[i] - AXIS_START + 0.5) / points
                result[i] = table.eval(mi.Point2f(column, along), active)[0]
            return result

        def max(self) -> float:
            """The bound of all values."""
            return max_value

    properties = mi.Properties()
    properties["to_world"] = to_world
    return SpectralVolume(properties)


def boundary(*, n_below: float, n_above: float) -> dict[str, Any]:
    """The BSDF between two media: refraction where the index changes, else nothing."""
    if math.isclose(n_below, n_above, rel_tol=1e-9):
        return {"type": "null"}
    return {"type": "dielectric", "int_ior": n_below, "ext_ior": n_above}


def integrator(*, mu_a: NDArray[np.float64], mu_s: NDArray[np.float64]) -> dict[str, Any]:
    """volpath that drops no weight that counts: roulette only where less than e^-10 is left of it.

    From 400 scatterings on it would leave what comes from far to rare bright paths: half of a skylight was missed.
    """
    scattering = mu_s > 0
    share = np.min(mu_a[scattering] / (mu_a + mu_s)[scattering], initial=1.0)
    depth = int(min(50 + 10 / max(share, 1e-9), 1e6))
    # Blocks of fixed size give the same bits whatever the number of threads.
    return {"type": "volpath", "rr_depth": depth, "max_depth": depth + 400, "block_size": 4}


def emitter(colour: list[float]) -> dict[str, Any]:
    """Lambertian emission of the given radiance in each colour."""
    return {"type": "area", "radiance": {"type": "rgb", "value": colour}}


def rectangle(to_world: Any, **more: Any) -> dict[str, Any]:
    """A rectangle; more : its BSDF, media, emitter or sensor."""
    return {"type": "rectangle", "to_world": to_world} | more


def check_pattern(led: Led) -> None:
    """Raise InputError for an LED that stock sensors cannot stand for."""
    if led.pattern == "measured":
        why = 'set light.engine = "photons" (with a backend that compiles kernels) or pattern = "lambertian".'
        raise InputError(f'led "{led.name}": pattern = "measured" needs the photons engine; {why}')


def phantom_scene(mi: Any, phantom: Phantom, led: Led, windows: Sequence[Window]) -> dict[str, Any]:
    """A phantom seen from its LED; window i emits in colour i, and windows of one face must not overlap."""
    check_pattern(led)
    T = mi.ScalarTransform4f
    layers = phantom.layers
    mu_a, mu_s = np.array([[layer.mu_a_per_mm, layer.mu_s_per_mm] for layer in layers]).T
    scene: dict[str, Any] = {"type": "scene", "integrator": integrator(mu_a=mu_a, mu_s=mu_s)}
    made = [medium(mu_a=layer.mu_a_per_mm, mu_s=layer.mu_s_per_mm, g=layer.g) for layer in layers]
    scene |= {f"medium_{i}": one for i, one in enumerate(made) if one}
    media = [None, *(f"medium_{i}" if one else None for i, one in enumerate(made)), None]
    n = [phantom.n_above, *(layer.n for layer in layers), phantom.n_below]
    z = -np.cumsum([0.0, *(layer.thickness_mm for layer in layers)])
    for i in range(len(layers) + 1):
        if math.isinf(z[i]):
            break
        place = T().translate([0, 0, float(z[i])]).scale([INFINITE_MM, INFINITE_MM, 1])
        between = sides(below=media[i + 1], above=media[i])
        scene[f"face_{i}"] = rectangle(place, bsdf=boundary(n_below=n[i + 1], n_above=n[i]), **between)
    reach = max(math.hypot(*(abs(c) + s / 2 for c, s in zip(w.center_mm, w.size_mm, strict=True))) for w in windows)
    gap = GAP * (1 + reach)
    for i, window in enumerate(windows):
        if not window.top and math.isinf(z[-1]):
            continue
        flip = T().rotate([1, 0, 0], 180) if window.top else T()
        height = gap if window.top else float(z[-1]) - gap
        place = (T().translate([*window.center_mm, height]) @ flip).scale([*np.divide(window.size_mm, 2), 1])
        colour = [float(i == k) for k in range(channel_count(mi.variant()))]
        scene[f"window_{i}"] = rectangle(place, bsdf=BLACK, emitter=emitter(colour))
    x, y = led.position_mm
    if led.pattern == "pencil":
        look = T().look_at(origin=[x, y, gap / 2], target=[x, y, -1.0], up=[0, 1, 0])
        scene["sensor"] = {
            # Collimated, and narrow beside everything: a pencil that can have many pixels.
            "type": "orthographic",
            "near_clip": 1e-6,
            "to_world": look @ T().scale([1e-4, 1e-4, 1]),
            "film": RGB_FILM,
        }
    else:
        place = T().translate([x, y, gap / 2]) @ T().rotate([1, 0, 0], 180)
        place = place @ T().scale([*np.divide(led.size_mm, 2), 1])
        # In a phantom the die stands in nobody's way.
        scene["die"] = rectangle(place, bsdf={"type": "null"}, sensor={"type": "irradiancemeter", "film": RGB_FILM})
    return scene


def sides(*, below: str | None, above: str | None) -> dict[str, Any]:
    """The media on both sides of a face whose normal points above."""
    return {side: {"type": "ref", "id": name} for side, name in {"interior": below, "exterior": above}.items() if name}


def finger_scene(
    mi: Any,
    geometry: Geometry,
    media: Media,
    bed: BedAbsorption | None,
    *,
    sensor: int,
    emitters: dict[int, list[float]],
    folder: Path,
) -> dict[str, Any]:
    """A finger seen from the region `sensor`, lit by `emitters`; its meshes are written to a folder.

    mi : Mitsuba, for a bed that changes along the nail; without one all values are plain.
    bed : Absorption along the nail, in place of the bed's own in `media`.
    emitters : Colours, one value per channel, by region.

    The sensor looks into the epoxy with its lower face only. Emitters shine from all that light can meet of them, so
    that they read what a photodiode does; without `bed`, for other programs, from their lower face.
    """
    epoxy = geometry.regions.index("epoxy")
    parts = (*geometry.leds, *geometry.photodiodes)
    looking = {face.region: face for face in parts if face.region == sensor or face.region in emitters}
    scene, refs = _inside(mi, geometry, media, bed)
    for (below, above), triangles in geometry.interfaces().items():
        if media.opaque[below] and media.opaque[above]:
            continue
        if media.opaque[above]:
            # An opaque face reflects and emits on the side that its normal points to.
            below, above, triangles = above, below, triangles[:, ::-1]
        shape: dict[str, Any] = {"face_normals": True}
        if media.opaque[below]:
            grey = {"type": "rgb", "value": float(media.reflectance[below])}
            shape |= {"bsdf": {"type": "diffuse", "reflectance": grey}} | sides(below=None, above=refs[above])
            if bed is not None and below in emitters:
                # What is reciprocal is radiance over n squared.
                relative = float(media.n[above] / media.n[epoxy]) ** 2
                shape["emitter"] = emitter([relative * value for value in emitters[below]])
            elif above == epoxy and below in looking:
                inside = {"medium": {"type": "ref", "id": refs[epoxy]}} if refs[epoxy] else {}
                meter = {"sensor": {"type": "irradiancemeter", "film": RGB_FILM} | inside}
                # Those of the face towards the nail, not of the sides.
                facing = (geometry.normals(triangles) @ looking[below].normal.T).max(axis=1) > 0.5
                _write_mesh(geometry, triangles[facing], folder / f"{below}.ply")
                scene[f"face_{below}"] = {"type": "ply", "filename": str(folder / f"{below}.ply")} | shape
                scene[f"face_{below}"] |= meter if below == sensor else {"emitter": emitter(emitters[below])}
                triangles = triangles[~facing]
                if not len(triangles):
                    continue
        else:
            bsdf = boundary(n_below=float(media.n[below]), n_above=float(media.n[above]))
            if bsdf["type"] == "null" and refs[below] is refs[above] is None:
                continue
            shape |= {"bsdf": bsdf} | sides(below=refs[below], above=refs[above])
        file = folder / f"{below}_{above}.ply"
        _write_mesh(geometry, triangles, file)
        scene[f"face_{below}_{above}"] = {"type": "ply", "filename": str(file)} | shape
    return scene


def _inside(
    mi: Any, geometry: Geometry, media: Media, bed: BedAbsorption | None
) -> tuple[dict[str, Any], list[str | None]]:
    """The scene without surfaces: its integrator and media, and the name of each region's medium, if it has one."""
    bed_region, clear, mu_a = geometry.regions.index("bed"), ~media.opaque, media.mu_a.copy()
    if bed is not None:
        mu_a[bed_region] = np.min(bed.mu_a_per_mm)
    scene: dict[str, Any] = {"type": "scene", "integrator": integrator(mu_a=mu_a[clear], mu_s=media.mu_s[clear])}
    refs: list[str | None] = []
    for region in range(len(geometry.regions)):
        made, scattering = None, {"mu_s": media.mu_s[region], "g": media.g[region].item()}
        if region == bed_region and bed is not None:
            touching = (geometry.below == region) | (geometry.above == region)
            points = geometry.vertices[np.unique(geometry.triangles[touching])]
            bounds_mm = np.stack([points.min(axis=0) - 0.1, points.max(axis=0) + 0.1])
            made = bed_medium(mi, bed, bounds_mm=bounds_mm, **scattering)
        elif clear[region]:
            made = medium(mu_a=mu_a[region], **scattering)
        refs.append(f"medium_{region}" if made else None)
        if made:
            scene[f"medium_{region}"] = made
    return scene, refs


def _write_mesh(geometry: Geometry, triangles: np.ndarray, file: Path) -> None:
    """Write some of a geometry's triangles, with the vertices that they need."""
    import trimesh

    mesh = trimesh.Trimesh(geometry.vertices, triangles, process=False)
    mesh.remove_unreferenced_vertices()
    mesh.export(file)
