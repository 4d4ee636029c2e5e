"""The colour of a nail and the skin around it while a touch presses the finger: the paper's Fig. 2, traced."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...errors import InputError, NotReachedError
from ...light import ProgressCallback, backend
from ...light.bare_nail import BareNail, Patch
from ...light.transfer import provenance
from ...options import Requested, TraceOptions
from ...scene import Scene, Touch
from ...statistics import jackknife, seed_of
from ...variables import variable
from ..blood_states import blood_over_touch, steady_blood
from ..placement.progress import StageProgress
from .colorimetry import WAVELENGTHS_NM, Illuminant, Observer, Viewer, delta_e_2000
from .reflectance import ColourRays, LightFrom, walk_colour

Array = NDArray[np.float64]

FORCES_N = (0.0, 0.3, 1.0, 2.0, 4.0)
# Standard error of a place's colour. [CIEDE2000]
TOLERANCE = 0.3
# Rays of all nodes from which the number that is needed is learned.
PILOT = 120_000
# Colours are told along the middle of the nail, so far across, every millimetre, and on skin behind and before it. [mm]
ACROSS_MM, SPACING_MM, SKIN_MM = 2.0, 1.0, 1.0
# The photograph is coloured by tiles of this size over one half of the finger, each with fewer rays than a place. [mm]
TILE_MM, PLACE_SHARE = 1.5, 12
# The press that is followed over time: force on, held, off. [s]
ON_S, OFF_S, END_S, STEPS = 0.5, 3.5, 8.0, 31
# The smallest difference that an eye sees side by side. [CIEDE2000]
JUST_SEEN = 1.0


@dataclass(frozen=True)
class _Places:
    """Where colours are told: along the middle of the nail, and tiles for the photograph."""

    patches: tuple[Patch, ...]
    along: int

    @property
    def v_mm(self) -> Array:
        return np.array([patch.center_mm[1] for patch in self.patches[: self.along]])


def colour(
    scene: Scene,
    *,
    forces_n: Sequence[float] = FORCES_N,
    illuminant: Illuminant = "D65",
    observer: Observer = "2",
    lit_by: LightFrom = "sky",
    gloss: bool = False,
    tolerance: float = TOLERANCE,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """The colour of the bare nail and the skin around it, over place and force, by day or by a lamp.

    forces_n : forces, each held until nothing moves; the first is what others are compared with. [N]
    illuminant : D65 (daylight), A (incandescent) or LED-B3 (white LED); observer : 2 or 10 degrees.
    lit_by : sky, from all sides; or lamp, at 45 degrees all round. The eye looks down from above.
    gloss : whether what the surface mirrors is part of the colour.
    tolerance : standard error that every place's colour must reach. [CIEDE2000]
    requested : as for `trace`, but relative_error; photons are rays of all wavelengths together.

    Returns: Dataset over state (force), place, band (L*, a*, b*) and wavelength: reflectance, Lab, sRGB, difference to
    the first state, width of the white band, each with its standard error; the press over time with the time that the
    colour takes to return; tiles for the photograph.

    Raises: InputError; NotReachedError, whose result is the Dataset so far, when time ends first.
    """
    options, viewer = TraceOptions(**requested), Viewer(illuminant, observer)
    forces = _checked(scene, forces_n, tolerance, options)
    cpu, begin = time.process_time(), time.perf_counter()
    chosen = backend.activate_jit(options.backend, "colour")
    stage = StageProgress(progress, options.max_seconds or math.inf)
    nail, places = BareNail(scene), _places(scene)
    states = steady_blood(scene, forces)
    look: dict[str, Any] = {"lit_by": lit_by, "gloss": gloss}
    rays, unmet = _walk(nail, places, states[:1], viewer, look, tolerance, options, stage)
    result = _dataset(scene, rays, places, forces, states, viewer, look)
    result = result.merge(_press(scene, rays, places, forces, viewer, look))
    made: dict[str, Any] = {"engine": "photons", "backend": chosen.name, "seeds": str(options.seed)}
    result.attrs = provenance(scene, photons=rays.photons, **made) | {
        "title": "nailoptics: colour of the nail under force",
        "seed": options.seed,
        "illuminant": illuminant,
        "observer": observer,
        "lit_by": lit_by,
        "gloss": int(gloss),
        "tile_size_mm": TILE_MM,
        "cpu_seconds": time.process_time() - cpu,
        "wall_seconds": time.perf_counter() - begin,
        "references": "CIE 015:2018; S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
    }
    if unmet:
        result.attrs["cut_off"] = unmet
        raise NotReachedError(unmet, result=result)
    return result


def _checked(scene: Scene, forces_n: Sequence[float], tolerance: float, options: TraceOptions) -> Array:
    if scene.finger is None:
        raise InputError("colour needs a [finger] scene; a [phantom] has no nail.")
    forces = np.asarray(forces_n, float)
    if forces.ndim != 1 or not 1 <= len(forces) <= 20 or not ((forces >= 0) & (forces <= 100)).all():
        raise InputError(f"forces = {list(forces_n)}: give 1 to 20 forces between 0 and 100 N.")
    if not (math.isfinite(tolerance) and tolerance > 0):
        raise InputError(f"tolerance = {tolerance!r}; must be a difference of colour above 0, such as {TOLERANCE:g}.")
    if options.relative_error is not None:
        raise InputError("colour has no relative_error; give tolerance, a difference of colour (CIEDE2000).")
    return forces


def _places(scene: Scene) -> _Places:
    """Places along the middle of the finger, and tiles over its half."""
    assert scene.finger is not None
    half = scene.finger.nail_length_mm / 2
    count = max(round(2 * half / SPACING_MM), 2)
    pitch = 2 * half / count
    on_nail = -half + pitch * (np.arange(count) + 0.5)
    v_mm = [-half - 1.5 * SKIN_MM, *on_nail, half + 1.2 * SKIN_MM]
    along = [Patch((0.0, float(v)), (ACROSS_MM, min(pitch, SKIN_MM)), PLACE_SHARE) for v in v_mm]
    tiles = []
    for v in np.arange(-half - 2.5 * TILE_MM, half + 3 * TILE_MM, TILE_MM):
        for u in np.arange(TILE_MM / 2, scene.finger.width_mm / 2 - TILE_MM / 2, TILE_MM):
            tiles.append(Patch((float(u), float(v)), (TILE_MM, TILE_MM)))
    return _Places((*along, *tiles), len(along))


def _walk(
    nail: BareNail,
    places: _Places,
    states: Array,
    viewer: Viewer,
    look: dict[str, Any],
    tolerance: float,
    options: TraceOptions,
    stage: StageProgress,
) -> tuple[ColourRays, str]:
    """Rays until every place's colour is as sure as is asked, and why they fall short, if they do."""
    wanted = options.photons or PILOT
    done, number, rays, error = 0, 0, None, math.inf
    while True:
        count = min(wanted - done, 10 * PILOT)

        def report(photons: int, base: int = done, goal: int = wanted, known: float = error) -> None:
            stage("colour", (base + photons) / goal, known, tolerance)

        more = walk_colour(nail, places.patches, photons=count, seed=seed_of(options.seed, number), progress=report)
        rays = more if rays is None else rays.with_more(more)
        done, number = rays.photons, number + 1
        lab = viewer.lab(rays.reflectance(states, **look, patches=range(places.along)))
        error = float(stderr_of_colour(lab).max())
        if stage.interrupted:
            return rays, f"interrupted at a standard error of {error:.2g} (CIEDE2000), {tolerance:g} requested."
        if options.photons is not None and done >= options.photons or options.photons is None and error <= tolerance:
            return rays, ""
        if stage.is_late(1.0):
            return rays, f"max_seconds ended the rays at a standard error of {error:.2g}, {tolerance:g} requested."
        if options.photons is None:
            # A tenth more than follows from the error so far, so that few need a third round.
            wanted = done + max(PILOT // 4, int(done * (1.1 * (error / tolerance) ** 2 - 1)))


def stderr_of_colour(lab: Array) -> Array:
    """Standard error of colours as a difference of colour, from them and from each without one group, (...) float.

    lab : (1 + groups, ..., 3) float.
    """
    away = delta_e_2000(lab[1:], lab[:1])
    return np.asarray(np.sqrt((len(away) - 1) / len(away) * (away**2).sum(0)))


def white_band_mm(v_mm: Array, redness: Array, pale: Array, *, tip_mm: float) -> Array:
    """Width of the band before the free edge that has lost more than half of its blood's redness, (..., s) float.

    v_mm : (p,) float. Places on the nail, from the most proximal on. [mm]
    redness : (..., p, s) float. a* of each state; the first is at rest.
    pale : (..., p) float. a* of the nail without blood.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        part = (redness - pale[..., None]) / (redness[..., :1] - pale[..., None])
    part = np.where(np.isfinite(part), part, 1.0)
    white, width = part[..., -1, :] < 0.5, np.zeros(part[..., -1, :].shape)
    width = np.where(white, tip_mm - v_mm[0], width)
    for k in range(len(v_mm) - 2, -1, -1):
        ends = white & (part[..., k, :] >= 0.5)
        step = (part[..., k, :] - 0.5) / np.where(ends, part[..., k, :] - part[..., k + 1, :], 1.0)
        width = np.where(ends, tip_mm - (v_mm[k] + step * (v_mm[k + 1] - v_mm[k])), width)
        white &= ~ends
    return np.asarray(width)


def _dataset(
    scene: Scene,
    rays: ColourRays,
    places: _Places,
    forces: Array,
    states: Array,
    viewer: Viewer,
    look: dict[str, Any],
) -> xr.Dataset:
    """Colours in every state, with standard errors."""
    assert scene.finger is not None
    none = np.zeros((1, states.shape[1]))
    read = rays.reflectance(np.vstack([states, none]), **look)
    lab = viewer.lab(read)
    middle, pale, tiles = lab[:, : places.along, :-1], lab[:, : places.along, -1], read[0, places.along :, :-1]
    change = delta_e_2000(middle, middle[:, :, :1])
    on_nail = slice(1, places.along - 1)
    half = scene.finger.nail_length_mm / 2
    band = white_band_mm(places.v_mm[on_nail], middle[:, on_nail, :, 1], pale[:, on_nail, 1], tip_mm=half)
    each = ("place", "state")
    text = "reflectance factor, seen from above"
    reflected = read[:, : places.along, :-1]
    data = variable("reflectance", (*each, "wavelength"), reflected[0], text, stderr=jackknife(reflected))
    data |= variable("lab", (*each, "band"), middle[0], "CIE 1976 L*a*b*", stderr=jackknife(middle))
    data |= variable("lab_without_blood", ("place", "band"), pale[0], "L*a*b* of a bed without blood")
    data |= variable("colour_stderr", each, stderr_of_colour(middle), "standard error of the colour, as CIEDE2000")
    data |= variable("srgb", (*each, "channel"), viewer.srgb(reflected[0]), "colour on a screen")
    text = "colour difference to the first state, CIEDE2000"
    data |= variable("delta_e_2000", each, change[0], text, stderr=jackknife(change))
    text = "width of the band before the free edge that has lost more than half of its blood's redness"
    data |= variable("white_band_mm", "state", band[0], text, units="mm", stderr=jackknife(band))
    data |= variable("blood_fraction", ("zone", "state"), states.T, "blood fraction of the nail bed")
    data |= variable("tile_srgb", ("tile", "state", "channel"), viewer.srgb(tiles), "colour on a screen, of a tile")
    centers = np.array([patch.center_mm for patch in places.patches[places.along :]])
    data |= variable("tile_mm", ("tile", "axis"), centers, "middle of a tile, across and along", units="mm")
    coordinates = variable("force_n", "state", forces, "force, held", units="N")
    coordinates |= variable("v_mm", "place", places.v_mm, "place along the nail, towards the tip", units="mm")
    coordinates |= variable("wavelength", "wavelength", WAVELENGTHS_NM, "wavelength", units="nm")
    names = {"band": ["L*", "a*", "b*"], "channel": ["red", "green", "blue"], "axis": ["u", "v"]}
    return xr.Dataset(data, coordinates | names)


def _press(
    scene: Scene, rays: ColourRays, places: _Places, forces: Array, viewer: Viewer, look: dict[str, Any]
) -> xr.Dataset:
    """The largest of the forces pressed and released: colours over time, and how long they take to return."""
    most = float(forces.max())
    if most == 0:
        return xr.Dataset()
    usual: dict[str, Any] = {
        "profile": "step",
        "force_n": most,
        "start_s": ON_S,
        "release_s": OFF_S,
        "duration_s": END_S,
    }
    kept = ("contact_area_mm2", "site", "proximal_share", "proximal_area_mm2", "distal_area_mm2", "distal_relaxation_s")
    usual |= {name: getattr(scene.touch, name) for name in kept} | {"sample_rate_hz": (STEPS - 1) / END_S * 8}
    course = blood_over_touch(scene.model_copy(update={"touch": Touch(**usual)}))
    seen = course.isel(time=slice(None, None, 8))
    read = rays.reflectance(seen.blood_fraction.values.T, **look, patches=range(places.along))
    lab = viewer.lab(read[0])
    data = variable("press_lab", ("place", "time", "band"), lab, "L*a*b* over a press")
    data |= variable(
        "press_srgb", ("place", "time", "channel"), viewer.srgb(read[0]), "colour on a screen, over a press"
    )
    data |= variable("press_force_n", "time", seen.force_n.values, "force of the press", units="N")
    text = "time after release from which on the colour is that of the finger at rest, as far as an eye sees"
    data |= variable("refill_s", "place", refill_s(seen.time.values, lab), text, units="s")
    return xr.Dataset(data, variable("time", "time", seen.time.values, "time", units="s"))


def refill_s(time_s: Array, lab: Array) -> Array:
    """Time after release from which on each place differs less from its rest than an eye sees, (places,) float. [s]

    lab : (places, times, 3) float. The first is at rest. Linear between samples; NaN where a press is not seen at all,
    infinite where the colour has not returned in the end.
    """
    away = delta_e_2000(lab, lab[:, :1])
    found = np.full(len(lab), np.nan)
    for k, row in enumerate(away):
        seen = np.flatnonzero(row > JUST_SEEN)
        if len(seen) and seen[-1] == len(row) - 1:
            found[k] = np.inf
        elif len(seen):
            i = seen[-1]
            step = (row[i] - JUST_SEEN) / (row[i] - row[i + 1]) * (time_s[i + 1] - time_s[i])
            found[k] = max(time_s[i] + step - OFF_S, 0.0)
    return found


def colour_summary(result: xr.Dataset) -> dict[str, Any]:
    """What a colour's result says in few numbers, ready for JSON."""
    states = []
    for s, force_n in enumerate(result.force_n.values):
        one = result.isel(state=s)
        places = [
            {
                "v_mm": float(one.v_mm[p]),
                "lab": one.lab.values[p].tolist(),
                "lab_stderr": one.lab_stderr.values[p].tolist(),
                "srgb": one.srgb.values[p].tolist(),
                "delta_e_2000": float(one.delta_e_2000[p]),
                "delta_e_2000_stderr": float(one.delta_e_2000_stderr[p]),
            }
            for p in range(result.sizes["place"])
        ]
        band = {"white_band_mm": float(one.white_band_mm), "white_band_stderr_mm": float(one.white_band_mm_stderr)}
        states.append({"force_n": float(force_n), "places": places, **band})
    refill = result.refill_s.values if "refill_s" in result else np.array([np.nan])
    slowest = float(np.nanmax(refill)) if np.isfinite(refill).any() or np.isinf(refill).any() else None
    return {
        "illuminant": result.attrs["illuminant"],
        "observer": result.attrs["observer"],
        "states": states,
        "lab_stderr": result.lab_stderr.max(("place", "state")).values.tolist(),
        "colour_stderr": float(result.colour_stderr.max()),
        "refill_s": slowest,
        **{name: result.attrs[name] for name in ("photons", "backend", "cpu_seconds", "wall_seconds")},
    }


def colour_lines(summary: dict[str, Any]) -> list[str]:
    """The same in a few lines for a terminal: the middle of the nail under each force."""
    lines = ["force [N]  L*     a*     b*     difference to rest  white band [mm]"]
    for state in summary["states"]:
        middle = state["places"][len(state["places"]) // 2]
        lab = "  ".join(f"{value:5.1f}" for value in middle["lab"])
        most = max(place["delta_e_2000"] for place in state["places"])
        lines.append(f"{state['force_n']:<9g}  {lab}  {most:<18.1f}  {state['white_band_mm']:.1f}")
    lines.append(f"standard error of a place's colour at most {summary['colour_stderr']:.2g} (CIEDE2000)")
    return lines
