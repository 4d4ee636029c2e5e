"""The colour of a nail and the skin around it while a touch presses the finger: the paper's Fig. 2, traced.

Rays go to each place of a bare nail until its colour and its changes reach their tolerance.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import InputError, unless_cut_off
from ...hemodynamics import white_band_mm
from ...hemodynamics.for_scene import steady_blood
from ...light import ProgressCallback, backend
from ...light.photograph import photograph
from ...light.tracing import Ending, StageProgress, run_until
from ...light.tracing.store import LightStore
from ...light.transfer import provenance
from ...light.walk.nail_reflectance import NailReflectance, Patch
from ...options import Illuminant, LightFrom, Observer, Requested, TraceOptions
from ...scene import Scene, SceneIn, Viewing, as_scene
from ...statistics import Array, jackknife, quotient, seed_of
from ...variables import described, jackknifed, stopwatch
from ..prior_uncertainty import only_absorbs, over_priors, prior_variables
from .reflectance import WAVELENGTHS_NM, ColourRays, Viewer, delta_e_2000, linear, walk_colour

# Rays of all nodes of the first round, from whose errors the allocation follows, and the most of one part.
PILOT, MOST_AT_ONCE = 120_000, 1_200_000
# A tenth more rays than follow from the errors so far, so that few places need a third round.
MORE = 1.1
# Parts of the rays that the nodes get: of the variance of changes the one at 559 nm makes 95 %, of that of colours the
# first makes a third.
SHARES = (0.3, 0.55, 0.15)
# Rays are allocated in this many parts at most.
PARTS = 250
# Colours are given at so many places along the middle of the nail, each so far across and at most so far along, and on
# skin behind and before it. [1, mm]
PLACES, ACROSS_MM, SKIN_MM = 12, 2.0, 1.0
# These, and those on skin, are the first of the patches.
ALONG = PLACES + 2
# The photograph is coloured by tiles of this size over one half of the finger, each with fewer rays than a place. [mm]
TILE_MM, PLACE_SHARE = 1.5, 24


def patches_of(scene: Scene) -> tuple[Patch, ...]:
    """Places along the middle of a scene's finger, the first and the last on skin, and tiles over its half."""
    half = scene.fingertip.nail_length_mm / 2
    pitch = 2 * half / PLACES
    v_mm = [-half - 1.5 * SKIN_MM, *(-half + pitch * (np.arange(PLACES) + 0.5)), half + 1.2 * SKIN_MM]
    along = [Patch((0.0, float(v)), (ACROSS_MM, min(pitch, SKIN_MM)), PLACE_SHARE) for v in v_mm]
    tile_v_mm = np.arange(-half - 2.5 * TILE_MM, half + 3 * TILE_MM, TILE_MM)
    tile_u_mm = np.arange(TILE_MM / 2, scene.fingertip.width_mm / 2 - TILE_MM / 2, TILE_MM)
    tiles = [Patch((u, v), (TILE_MM, TILE_MM)) for v, u in product(tile_v_mm.tolist(), tile_u_mm.tolist())]
    return (*along, *tiles)


def sample_until_tolerance(
    nail: NailReflectance, states: Array, viewer: Viewer, viewing: Viewing, options: TraceOptions, stage: StageProgress
) -> tuple[ColourRays, str]:
    """Rays until colours and their changes reach their tolerances, and why they do not, if so.

    states : (s, zones) float. Blood under each force, and none at last; changes are from the first.

    With photons requested, so many go to the places, each alike; else each place gets what it needs.
    """
    rays: ColourRays | None = None
    patches, goal, parts = patches_of(nail.scene), options.photons or PILOT, 0
    error, pace_s = math.inf, math.inf

    def report(photons: int) -> None:
        done = photons + (rays.photons if rays else 0)
        stage("colour", done / goal, error, viewing.tolerance if math.isfinite(error) else None)
        if stage.interrupted and rays:  # the part at work is discarded
            raise KeyboardInterrupt

    def needed() -> Iterator[int]:
        nonlocal patches, goal, error
        while True:
            while not rays or rays.photons < goal:
                yield goal - (rays.photons if rays else 0)
            errors, changes = errors_of(rays, viewer)
            error = float(errors.max())
            more = np.maximum((errors / viewing.tolerance) ** 2, (changes / viewing.change_tolerance) ** 2)
            if options.photons is not None or more.max() <= 1:
                return
            patches, count = _allocated(rays, more)
            goal += count

    def sample(left: int) -> None:
        nonlocal rays, parts, pace_s
        # No part is larger than what is left of the time is enough for.
        affordable = max(stage.seconds_left, 0.0) / pace_s if math.isfinite(stage.limit_s) else math.inf
        photons, begin_s = int(min(left, MOST_AT_ONCE, max(PILOT, affordable))), stage.seconds
        how: dict[str, Any] = {"seed": seed_of(options.seed, parts), "shares": SHARES, "progress": report}
        walked = walk_colour(nail, patches, photons=photons, **how).read(states, viewing)
        pace_s = (stage.seconds - begin_s) / walked.photons  # of the first part with compilation
        rays, parts = rays.with_more(walked) if rays else walked, parts + 1

    ending = run_until(needed(), sample, is_late=lambda _: rays is not None and stage.is_over(1.0))
    assert rays is not None
    if ending is Ending.MET and not stage.interrupted:
        return rays, ""
    error = float(errors_of(rays, viewer)[0].max())
    interrupted = stage.interrupted or ending is Ending.INTERRUPTED
    why = "interrupted" if interrupted else "max_seconds ended the rays"
    return rays, f"{why} at a standard error of {error:.2g} (CIEDE2000), {viewing.tolerance:g} requested."


def errors_of(rays: ColourRays, viewer: Viewer) -> tuple[Array, Array]:
    """Largest standard errors over all forces of each place's colour and of its change, (along,) each. [CIEDE2000]"""
    lab = viewer.lab(rays.reflectance[:, :ALONG, :-1])
    change = delta_e_2000(lab, lab[:, :, :1])
    return stderr_of_colour(lab).max(1), jackknife(change).max(1)


def stderr_of_colour(lab: Array) -> Array:
    """Standard error of colours as a difference of colour, from them and from each without one group, (...) float.

    lab : (1 + groups, ..., 3) float.
    """
    away = delta_e_2000(lab[1:], lab[:1])
    return np.asarray(np.sqrt((len(away) - 1) / len(away) * (away**2).sum(0)))


def _allocated(rays: ColourRays, needed: Array) -> tuple[tuple[Patch, ...], int]:
    """The patches with their shares of the next rays, and how many rays of all nodes there are.

    needed : (along,) float. How many times as many rays as now each place needs.
    """
    now = np.sum([cell.rays for cell in rays.light], axis=0)
    more = np.maximum(MORE * needed - 1, 0) * now[:ALONG]
    tiles = np.full(len(now) - ALONG, np.median(more) / PLACE_SHARE)
    both = np.concatenate([more, tiles])
    shares = np.ceil(both / both.sum() * PARTS).astype(int)
    patches = tuple(replace(patch, share=int(n)) for patch, n in zip(rays.patches, shares, strict=True))
    return patches, int(both.sum())


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
    given = {name: requested.pop(name, None) for name in Viewing.model_fields}  # type: ignore[misc]
    options = TraceOptions(**requested)  # type: ignore[misc]
    if options.photons is None and options.max_seconds is None:
        options = replace(options, photons=scene.accuracy.photons, max_seconds=scene.accuracy.max_seconds)
    if scene.finger is None:
        raise InputError("colour needs a [finger] scene; a [phantom] has no nail.")
    if options.relative_error is not None:
        raise InputError("colour has no relative_error; give tolerance, a difference of colour (CIEDE2000).")
    viewing = Viewing(**dict(scene.colour) | {name: value for name, value in given.items() if value is not None})
    viewer = Viewer(viewing.illuminant, viewing.observer)
    run_time, chosen = stopwatch(), backend.activate_jit(options.backend, "colour")
    stage = StageProgress(progress, options.max_seconds or math.inf, unit="CIEDE2000")
    stores = LightStore.of_command(options) if stores is None else stores
    states = steady_blood(scene, viewing.forces_n)
    nail = NailReflectance(scene, backend=chosen.name, stores=stores)
    rays, unmet = sample_until_tolerance(nail, np.vstack([states, 0 * states[:1]]), viewer, viewing, options, stage)
    result = _dataset(scene, rays, states, viewer, viewing)
    if scene.priors.spread and not unmet:
        if stage.is_over(SPREAD_BEGINS):
            unmet = f"{stage.why} before the spread of colours over unknown fingers."
        else:
            result = result.merge(spread_of_colours(nail, rays, viewer, viewing, seed=options.seed))
    made: dict[str, Any] = {"engine": "photons", "backend": chosen.name, "seeds": str(options.seed)}
    shown = viewing.model_dump(include={"illuminant", "observer", "lit_by", "tolerance", "change_tolerance"})
    result.attrs = provenance(scene, photons=rays.photons, **made) | {
        "title": "nailoptics: colour of the nail under force",
        "seed": options.seed,
        **shown,
        "gloss": int(viewing.gloss),
        "tile_size_mm": TILE_MM,
        "references": "CIE 015:2018; S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
        **run_time(),
    }
    return unless_cut_off(result, unmet)


def _redness_left(redness: Array, pale: Array) -> Array:
    """Fraction of its blood's redness that each place has in each state, (..., p, s) float; 1 where it never had any.

    redness : (..., p, s) float. a* of each state; the first is at rest. pale : (..., p) float. a* without blood.
    """
    by_blood = redness - pale[..., None]
    part = quotient(by_blood, by_blood[..., :1])
    return np.where(np.isfinite(part), part, 1.0)


def _dataset(scene: Scene, rays: ColourRays, states: Array, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """Colours in every state, with standard errors."""
    read = rays.reflectance
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
    scene, sites = nail.scene, [ALONG // 2, 0]
    rays = replace(
        rays, patches=tuple(rays.patches[k] for k in sites), light=tuple(c.select(sites) for c in rays.light)
    )
    priors = sorted(scene.finger_priors, key=lambda prior: not only_absorbs(scene, prior))

    def lab(light: ColourRays, changed: Scene) -> Array:
        states = steady_blood(changed, viewing.forces_n[:1])
        return np.asarray(viewer.lab(light.read(states, viewing, scene=changed).reflectance)[:, :, 0])

    def walked(changed: Scene) -> Array:
        other = NailReflectance(changed, backend=nail.backend, stores=nail.stores)
        light = walk_colour(other, rays.patches, photons=OWN_PHOTONS, seed=seed_of(seed, _SPREAD), shares=SHARES)
        return lab(light, changed)

    answers = over_priors(scene, priors, lambda changed: lab(rays, changed), walked)
    data = answers.variables("lab", ("site", "band"), "L*a*b* at the first force")
    data |= described(__package__, prior_lab=answers.nodes[:, :, 0])
    names = {"site": ["nail", "skin"], "node": ["low", "middle", "high"]}
    return xr.Dataset(data, names).merge(prior_variables(priors, [], scene))


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
    return photograph(scene, tiles[drawn], on_nail[drawn], shown, backend=backend)
