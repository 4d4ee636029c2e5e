"""The colour of a nail and the skin around it while a touch presses the finger: the paper's Fig. 2, traced."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import InputError, unless_cut_off
from ...hemodynamics import white_band_mm
from ...hemodynamics.for_scene import steady_blood
from ...light import ProgressCallback, backend
from ...light.photograph import photograph
from ...light.tracing import StageProgress
from ...light.tracing.store import LightStore
from ...light.transfer import provenance
from ...light.walk.nail_reflectance import NailReflectance
from ...options import Requested, TraceOptions
from ...scene import Scene, SceneIn, Viewing, as_scene
from ...scene.viewing import Illuminant, LightFrom, Observer
from ...statistics import Array, seed_of
from ...variables import described, jackknifed
from ..prior_uncertainty import only_absorbs, over_priors
from .adaptive_sampling import ALONG, TILE_MM, sample_until_tolerance, stderr_of_colour
from .colorimetry import WAVELENGTHS_NM, Viewer, delta_e_2000, linear
from .reflectance import ColourRays, walk_colour

# Of the time, after which no spread over unknown fingers begins, which takes as long as 150 000 rays or so.
SPREAD_BEGINS = 0.8
# Rays of all nodes for each value of what needs rays of its own, such as scattering.
OWN_PHOTONS = 24_000
_SPREAD = 61
# Of the linear colour; what is darker has missed the finger: no tissue is.
MISSED = 0.02


class ColourRequested(Requested, total=False):
    """What can be requested of `colour`: fields of `Viewing`, too; what is not given the scene's [colour] says."""

    forces_n: Sequence[float] | None
    illuminant: Illuminant | None
    observer: Observer | None
    lit_by: LightFrom | None
    gloss: bool | None
    tolerance: float | None
    change_tolerance: float | None


def colour(
    scene: SceneIn,
    *,
    stores: Sequence[LightStore] | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[ColourRequested],
) -> xr.Dataset:
    """The colour of the bare nail and the skin around it, over place and force, by day or by a lamp.

    stores : where rays are read from and, in the first, written; that of the user if not given.
    requested : as for `trace`, but relative_error; photons are rays of all wavelengths together; and `ColourRequested`.

    Returns: Dataset over state (force), place, band (L*, a*, b*) and wavelength: reflectance, Lab, sRGB, difference to
    the first state, width of the white band, each with its standard error; prior uncertainty of colours; tiles for
    the photograph.

    Raises: InputError; NotReachedError, whose result is the Dataset so far, when time ends first.
    """
    scene = as_scene(scene)
    given = {name: requested.pop(name) for name in Viewing.model_fields if name in requested}  # type: ignore[misc]
    options = TraceOptions(**requested)  # type: ignore[misc]
    if options.photons is None and options.max_seconds is None:
        options = replace(options, photons=scene.accuracy.photons, max_seconds=scene.accuracy.max_seconds)
    viewing = _viewing(scene, options, **given)
    viewer = Viewer(viewing.illuminant, viewing.observer)
    cpu, begin = time.process_time(), time.perf_counter()
    chosen = backend.choose_jit(options.backend, "colour")
    stage = StageProgress(progress, options.max_seconds or math.inf, unit="CIEDE2000")
    stores = LightStore.of_command(options) if stores is None else stores
    states = steady_blood(scene, viewing.forces_n)
    backend.activate(chosen)
    nail = NailReflectance(scene, backend=chosen.name, stores=stores)
    rays, unmet = sample_until_tolerance(nail, states, viewer, viewing, options, stage)
    result = _dataset(scene, rays, states, viewer, viewing)
    if scene.priors.spread and not unmet:
        if stage.is_late(SPREAD_BEGINS):
            unmet = "max_seconds left no time for the spread of colours over unknown fingers."
        else:
            result = result.merge(spread_of_colours(nail, rays, viewer, viewing, seed=options.seed))
    for store in stores:
        store.close()
    result.attrs = _attributes(scene, viewing, options, chosen, rays.photons) | {
        "cpu_seconds": time.process_time() - cpu,
        "wall_seconds": time.perf_counter() - begin,
    }
    return unless_cut_off(result, unmet)


def _attributes(
    scene: Scene, viewing: Viewing, options: TraceOptions, chosen: backend.Backend, photons: int
) -> dict[str, Any]:
    """What the result says of how it came about, but for the time that it took."""
    made: dict[str, Any] = {"engine": "photons", "backend": chosen.name, "seeds": str(options.seed)}
    shown = viewing.model_dump(include={"illuminant", "observer", "lit_by", "tolerance", "change_tolerance"})
    return provenance(scene, photons=photons, **made) | {
        "title": "nailoptics: colour of the nail under force",
        "seed": options.seed,
        **shown,
        "gloss": int(viewing.gloss),
        "tile_size_mm": TILE_MM,
        "references": "CIE 015:2018; S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
    }


def _viewing(scene: Scene, options: TraceOptions, **given: Any) -> Viewing:
    """How the nail is looked at: as the scene says, but for what is given; raises InputError."""
    if scene.finger is None:
        raise InputError("colour needs a [finger] scene; a [phantom] has no nail.")
    if options.relative_error is not None:
        raise InputError("colour has no relative_error; give tolerance, a difference of colour (CIEDE2000).")
    given = {name: value for name, value in given.items() if value is not None}
    return Viewing(**(dict(scene.colour) | given))


def _redness_left(redness: Array, pale: Array) -> Array:
    """Part of its blood's redness that each place has in each state, (..., p, s) float; 1 where it never had any.

    redness : (..., p, s) float. a* of each state; the first is at rest. pale : (..., p) float. a* without blood.
    """
    by_blood = redness - pale[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = by_blood / by_blood[..., :1]
    return np.where(np.isfinite(part), part, 1.0)


def _dataset(scene: Scene, rays: ColourRays, states: Array, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """Colours in every state, with standard errors."""
    none = np.zeros((1, states.shape[1]))
    read = rays.reflectance(np.vstack([states, none]), viewing)
    lab = viewer.lab(read)
    middle, pale, tiles = lab[:, :ALONG, :-1], lab[:, :ALONG, -1], read[0, ALONG:, :-1]
    change = delta_e_2000(middle, middle[:, :, :1])
    on_nail, v_mm = slice(1, ALONG - 1), np.array([patch.center_mm[1] for patch in rays.patches[:ALONG]])
    half = scene.fingertip.nail_length_mm / 2
    part = _redness_left(middle[:, on_nail, :, 1], pale[:, on_nail, 1])
    band = white_band_mm(v_mm[on_nail], part, ends_mm=(-half, half))
    reflected = read[:, :ALONG, :-1]
    data = described(
        __package__,
        reflectance=jackknifed(reflected),
        lab=jackknifed(middle),
        lab_without_blood=pale[0],
        colour_stderr=stderr_of_colour(middle),
        srgb=viewer.srgb(reflected[0]),
        delta_e_2000=jackknifed(change),
        white_band_mm=jackknifed(band),
        blood_fraction=states.T,
        tile_srgb=viewer.srgb(tiles),
        tile_mm=np.array([patch.center_mm for patch in rays.patches[ALONG:]]).reshape(-1, 2),
    )
    coordinates = described(__package__, force_n=viewing.forces_n, v_mm=v_mm, wavelength=WAVELENGTHS_NM)
    names = {"band": ["L*", "a*", "b*"], "channel": ["red", "green", "blue"], "axis": ["u", "v"]}
    return xr.Dataset(data, coordinates | names)


def spread_of_colours(
    nail: NailReflectance, rays: ColourRays, viewer: Viewer, viewing: Viewing, *, seed: int
) -> xr.Dataset:
    """Standard deviation of L*, a* and b* over each prior of the scene, and over all together.

    On the middle of the nail and on the skin behind it, at the first of the forces. What only absorbs is reread from
    the rays; what scatters or is shaped otherwise is walked anew, with the same random numbers at each of its values.
    """
    scene, sites = nail.scene, (ALONG // 2, 0)
    priors = sorted(scene.finger_priors, key=lambda prior: not only_absorbs(scene, prior))

    def lab(light: ColourRays, changed: Scene, chosen: tuple[int, ...]) -> Array:
        states = steady_blood(changed, viewing.forces_n[:1])
        read = light.reflectance(states, viewing, scene=changed, patches=chosen)
        return np.asarray(viewer.lab(read)[:, :, 0])

    def walked(changed: Scene) -> Array:
        other = NailReflectance(changed, backend=nail.backend, stores=nail.stores)
        patches = [rays.patches[site] for site in sites]
        light = walk_colour(other, patches, photons=OWN_PHOTONS, seed=seed_of(seed, _SPREAD))
        return lab(light, changed, (0, 1))

    answers = over_priors(scene, priors, lambda changed: lab(rays, changed, sites), walked)
    data = answers.variables("lab", ("site", "band"), "L*a*b* at the first force")
    ends, fields = [[p.low, p.high] for p in priors], [p.field for p in priors]
    data |= described(__package__, prior_lab=answers.nodes[:, :, 0], prior_range=ends, prior_field=fields)
    names = {"prior": [p.name for p in priors], "site": ["nail", "skin"], "node": ["low", "middle", "high"]}
    return xr.Dataset(data, names)


def photographs(scene: Scene, result: xr.Dataset, *, states: Sequence[int], backend: str) -> list[NDArray[np.uint8]]:
    """The finger in some states, (height, width, 3) each.

    result : what `colour` returned for the scene.
    """
    tiles, colours = result.tile_mm.values, linear(result.tile_srgb.values)
    hit = colours[:, 0].mean(-1) > MISSED
    # A tile across the nail's edge is neither.
    finger, half_mm = scene.fingertip, 0.5 * result.attrs["tile_size_mm"]
    radius_mm, half_v_mm = finger.nail_radius_mm, finger.nail_length_mm / 2
    edge_mm = [radius_mm * np.sin(0.5 * finger.nail_width_mm / radius_mm), half_v_mm]
    on_nail = (np.abs(tiles) + half_mm <= edge_mm).all(1)
    off_nail = (np.abs(tiles) - half_mm >= edge_mm).any(1)
    drawn = hit & (on_nail | off_nail)
    shown = colours[drawn][:, list(states)].swapaxes(0, 1)
    return photograph(scene, tiles[drawn], on_nail[drawn], shown, size=scene.colour.photograph_px, backend=backend)
