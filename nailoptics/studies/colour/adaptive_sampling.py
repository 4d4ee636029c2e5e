"""Adaptive sampling: rays go to each place of a bare nail until its colour and its changes reach their tolerance."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...light.tracing import Ending, StageProgress, run_until
from ...light.walk.nail_reflectance import NailReflectance, Patch
from ...options import TraceOptions
from ...scene import Scene, Viewing
from ...statistics import Array, jackknife, seed_of
from .colorimetry import Viewer, delta_e_2000
from .reflectance import ColourRays, walk_colour

# Rays of all nodes of the first round, from whose errors the allocation follows, and the most of one part.
PILOT, MOST_AT_ONCE = 120_000, 1_200_000
# A tenth more rays than follow from the errors so far, so that few places need a third round.
MORE = 1.1
# Rays are allocated in this many parts at most.
PARTS = 1000
# Colours are given at so many places along the middle of the nail, each so far across and at most so far along, and on
# skin behind and before it. [1, mm]
PLACES, ACROSS_MM, SKIN_MM = 12, 2.0, 1.0
# These, and those on skin, are the first of the patches.
ALONG = PLACES + 2
# The photograph is coloured by tiles of this size over one half of the finger, each with fewer rays than a place. [mm]
TILE_MM, PLACE_SHARE = 1.5, 12


def patches_of(scene: Scene) -> tuple[Patch, ...]:
    """Places along the middle of a scene's finger, the first and the last on skin, and tiles over its half."""
    half = scene.fingertip.nail_length_mm / 2
    pitch = 2 * half / PLACES
    v_mm = [-half - 1.5 * SKIN_MM, *(-half + pitch * (np.arange(PLACES) + 0.5)), half + 1.2 * SKIN_MM]
    along = [Patch((0.0, float(v)), (ACROSS_MM, min(pitch, SKIN_MM)), PLACE_SHARE) for v in v_mm]
    tiles = []
    for v in np.arange(-half - 2.5 * TILE_MM, half + 3 * TILE_MM, TILE_MM):
        for u in np.arange(TILE_MM / 2, scene.fingertip.width_mm / 2 - TILE_MM / 2, TILE_MM):
            tiles.append(Patch((float(u), float(v)), (TILE_MM, TILE_MM)))
    return (*along, *tiles)


def sample_until_tolerance(
    nail: NailReflectance,
    states: Array,
    viewer: Viewer,
    viewing: Viewing,
    options: TraceOptions,
    stage: StageProgress,
) -> tuple[ColourRays, str]:
    """Rays until colours and their changes reach their tolerances, and why they do not, if so.

    states : (s, zones) float. Blood under each force; changes are from the first.

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
            errors, changes = errors_of(rays, states, viewer, viewing)
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
        walked = walk_colour(nail, patches, photons=photons, seed=seed_of(options.seed, parts), progress=report)
        pace_s = (stage.seconds - begin_s) / walked.photons  # of the first part with compilation
        rays, parts = rays.with_more(walked) if rays else walked, parts + 1

    ending = run_until(needed(), sample, is_late=lambda _: rays is not None and stage.is_over(1.0))
    assert rays is not None
    if ending is Ending.MET and not stage.interrupted:
        return rays, ""
    error = float(errors_of(rays, states, viewer, viewing)[0].max())
    interrupted = stage.interrupted or ending is Ending.INTERRUPTED
    why = "interrupted" if interrupted else "max_seconds ended the rays"
    return rays, f"{why} at a standard error of {error:.2g} (CIEDE2000), {viewing.tolerance:g} requested."


def errors_of(rays: ColourRays, states: Array, viewer: Viewer, viewing: Viewing) -> tuple[Array, Array]:
    """Largest standard errors over all states of each place's colour and of its change, (along,) each. [CIEDE2000]"""
    lab = viewer.lab(rays.reflectance(states, viewing, patches=range(ALONG)))
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
    nodes = len(rays.light)
    now = nodes * rays.light[0].rays
    more = np.maximum(MORE * needed - 1, 0) * now[:ALONG]
    tiles = np.full(len(now) - ALONG, np.median(more) / PLACE_SHARE)
    both = np.concatenate([more, tiles])
    shares = np.ceil(both / both.sum() * PARTS).astype(int)
    patches = tuple(replace(patch, share=int(n)) for patch, n in zip(rays.patches, shares, strict=True))
    return patches, int(both.sum())
