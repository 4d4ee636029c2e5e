"""Adaptive sampling: rays go to each place of a bare nail until its colour and its changes reach their tolerance."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...light.tracing import Ending, StageProgress, run_until
from ...light.walk.nail_reflectance import NailReflectance, Patch
from ...options import TraceOptions
from ...scene import Scene, Viewing
from ...statistics import jackknife, seed_of
from .colorimetry import Viewer, delta_e_2000
from .reflectance import ColourRays, walk_colour

Array = NDArray[np.float64]

# Rays of all nodes of the first round, from whose errors the allocation follows, and the most of one part.
PILOT, MOST_AT_ONCE = 120_000, 1_200_000
# A tenth more rays than follow from the errors so far, so that few places need a third round.
MORE = 1.1
# Rays are allocated in this many parts at most.
PARTS = 1000
# Colours are given at so many places along the middle of the nail, each so far across and at most so far along, and on
# skin behind and before it. [1, mm]
PLACES, ACROSS_MM, SKIN_MM = 12, 2.0, 1.0
# The photograph is coloured by tiles of this size over one half of the finger, each with fewer rays than a place. [mm]
TILE_MM, PLACE_SHARE = 1.5, 12


@dataclass(frozen=True)
class Places:
    """Where colours are given: so many along the middle of the finger, and tiles for the photograph."""

    patches: tuple[Patch, ...]
    along: int = PLACES + 2

    @property
    def v_mm(self) -> Array:
        """Along the nail, from its centre, towards the tip positive, (along,) float. [mm]"""
        return np.array([patch.center_mm[1] for patch in self.patches[: self.along]])


def places_of(scene: Scene) -> Places:
    """Places along the middle of a scene's finger, the first and the last on skin, and tiles over its half."""
    assert scene.finger is not None
    half = scene.finger.nail_length_mm / 2
    pitch = 2 * half / PLACES
    v_mm = [-half - 1.5 * SKIN_MM, *(-half + pitch * (np.arange(PLACES) + 0.5)), half + 1.2 * SKIN_MM]
    along = [Patch((0.0, float(v)), (ACROSS_MM, min(pitch, SKIN_MM)), PLACE_SHARE) for v in v_mm]
    tiles = []
    for v in np.arange(-half - 2.5 * TILE_MM, half + 3 * TILE_MM, TILE_MM):
        for u in np.arange(TILE_MM / 2, scene.finger.width_mm / 2 - TILE_MM / 2, TILE_MM):
            tiles.append(Patch((float(u), float(v)), (TILE_MM, TILE_MM)))
    return Places((*along, *tiles))


def sample_until_tolerance(
    nail: NailReflectance,
    places: Places,
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
    sampling = _Sampling(nail, options, stage)

    def needed() -> Iterator[tuple[Sequence[Patch], int]]:
        yield places.patches, options.photons or PILOT
        while True:
            assert sampling.rays is not None
            error, change = errors_of(sampling.rays, places, states, viewer, viewing)
            sampling.error = float(error.max())
            rounds = np.maximum((error / viewing.tolerance) ** 2, (change / viewing.change_tolerance) ** 2)
            if options.photons is not None or rounds.max() <= 1:
                return
            shares, rays = _allocated(sampling.rays, places, rounds)
            sampling.target = viewing.tolerance
            yield [replace(one, share=n) for one, n in zip(places.patches, shares, strict=True)], rays

    def is_late(round: tuple[Sequence[Patch], int]) -> bool:
        return sampling.rays is not None and (stage.interrupted or stage.is_late(1.0))

    ending = run_until(needed(), lambda round: sampling.add(*round), is_late=is_late)
    assert sampling.rays is not None
    short = f"{sampling.error:.2g} (CIEDE2000), {viewing.tolerance:g} requested"
    if stage.interrupted or ending is Ending.INTERRUPTED:
        return sampling.rays, f"interrupted at a standard error of {short}."
    return sampling.rays, "" if ending is Ending.MET else f"max_seconds ended the rays at a standard error of {short}."


@dataclass
class _Sampling:
    """Rays that grow, a part at a time."""

    nail: NailReflectance
    options: TraceOptions
    stage: StageProgress
    rays: ColourRays | None = None
    parts: int = 0
    error: float = math.inf
    target: float | None = None
    # Of each ray in the part before, the first with the compilation of its kernels. [s]
    pace_s: float = math.inf

    def add(self, patches: Sequence[Patch], rays_needed: int) -> None:
        """Trace so many more rays, fewer where time ends or the user interrupts: the part at work is discarded."""
        begun = done = self.rays.photons if self.rays else 0
        while done < begun + rays_needed and not (self.rays and self.stage.is_over(1.0)):

            def report(photons: int, base: int = done) -> None:
                self.stage("colour", (base + photons) / (begun + rays_needed), self.error, self.target)
                if self.stage.interrupted and self.rays:
                    raise KeyboardInterrupt

            seed, count = seed_of(self.options.seed, self.parts), min(begun + rays_needed - done, self._most())
            before_s = self.stage.seconds
            try:
                more = walk_colour(self.nail, patches, photons=count, seed=seed, progress=report)
            except KeyboardInterrupt:
                if not (self.stage.interrupted and self.rays):
                    raise
                return
            self.pace_s = (self.stage.seconds - before_s) / more.photons
            self.rays = more if self.rays is None else self.rays.with_more(more)
            done, self.parts = self.rays.photons, self.parts + 1

    def _most(self) -> int:
        """Most rays of the next part: no more than what is left of the time is enough for, but for the least."""
        if math.isinf(self.stage.limit_s):
            return MOST_AT_ONCE
        left = max(self.stage.seconds_left, 0.0) / self.pace_s
        return min(MOST_AT_ONCE, max(PILOT, int(left)))


def errors_of(rays: ColourRays, places: Places, states: Array, viewer: Viewer, viewing: Viewing) -> tuple[Array, Array]:
    """Largest standard errors over all states of each place's colour and of its change, (along,) each. [CIEDE2000]"""
    lab = viewer.lab(rays.reflectance(states, **view(viewing), patches=range(places.along)))
    change = delta_e_2000(lab, lab[:, :, :1])
    return stderr_of_colour(lab).max(1), jackknife(change).max(1)


def view(viewing: Viewing) -> dict[str, Any]:
    """Where light comes from and whether gloss counts, as `ColourRays.reflectance` takes it."""
    return {"lit_by": viewing.lit_by, "gloss": viewing.gloss}


def stderr_of_colour(lab: Array) -> Array:
    """Standard error of colours as a difference of colour, from them and from each without one group, (...) float.

    lab : (1 + groups, ..., 3) float.
    """
    away = delta_e_2000(lab[1:], lab[:1])
    return np.asarray(np.sqrt((len(away) - 1) / len(away) * (away**2).sum(0)))


def _allocated(rays: ColourRays, places: Places, needed: Array) -> tuple[list[int], int]:
    """How many shares of the next rays each patch has, and how many rays of all nodes there are.

    needed : (along,) float. How many times as many rays as now each place needs.
    """
    nodes = len(rays.light)
    now = nodes * rays.light[0].rays
    more = np.maximum(MORE * needed - 1, 0) * now[: places.along]
    tiles = np.full(len(now) - places.along, np.median(more) / PLACE_SHARE)
    both = np.concatenate([more, tiles])
    shares = np.ceil(both / both.sum() * PARTS).astype(int)
    return shares.tolist(), int(both.sum())
