"""Views of a traced nail: a press and the capillary refill after it, a heartbeat, and photographs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...hemodynamics.for_scene import beat_at, blood_over_touch
from ...light.photograph import photograph
from ...scene import Scene, Touch, Viewing
from ...variables import estimated, variable
from .adaptive_sampling import Places
from .colorimetry import Viewer, delta_e_2000, linear
from .reflectance import ColourRays

Array = NDArray[np.float64]

# Force on, off, end, and how many pictures of it there are. [s]
ON_S, OFF_S, END_S, STEPS = 0.5, 3.5, 8.0, 31
# The touch is followed at so many times as many moments.
FINER = 8
# The smallest difference that an eye sees side by side. [CIEDE2000]
JUST_NOTICEABLE = 1.0
# One in so many rays is read over time: a change of colour needs fewer than a colour.
ONE_IN = 4
# Of a beat so many moments are read.
BEAT_STEPS = 16
# Of the linear colour; what is darker has missed the finger: no tissue is.
MISSED = 0.02
_CONTACT = ("contact_area_mm2", "site", "proximal_share", "proximal_area_mm2", "distal_area_mm2", "distal_relaxation_s")


def press_and_release(scene: Scene, rays: ColourRays, places: Places, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """The largest of the forces pressed and released: colours over time, and the capillary refill time."""
    most = max(viewing.forces_n)
    if most == 0:
        return xr.Dataset()
    step: dict[str, Any] = {"profile": "step", "force_n": most, "start_s": ON_S, "release_s": OFF_S}
    step |= {"duration_s": END_S, "sample_rate_hz": (STEPS - 1) / END_S * FINER}
    step |= {name: getattr(scene.touch, name) for name in _CONTACT}
    touched = blood_over_touch(scene.model_copy(update={"touch": Touch(**step)}))
    moments = touched.isel(time=slice(None, None, FINER))
    few = rays.one_in(ONE_IN)
    read = few.reflectance(moments.blood_fraction.values.T, viewing, patches=range(places.along))
    lab, time_s = viewer.lab(read), moments.time.values
    over = ("place", "time")
    text = "L*a*b* over a press"
    data = estimated("press_lab", (*over, "band"), lab, text)
    data |= variable("press_srgb", (*over, "channel"), viewer.srgb(read[0]), "colour on a screen, over a press")
    data |= variable("press_force_n", "time", moments.force_n.values, "force of the press", units="N")
    text = "capillary refill time: from release until the colour differs less from rest than an eye sees"
    refill = np.array([capillary_refill_s(time_s, one) for one in lab])
    with np.errstate(invalid="ignore"):  # a place that never returns, or whose change no eye sees
        data |= estimated("refill_s", "place", refill, text, units="s")
    return xr.Dataset(data, variable("time", "time", time_s, "time", units="s"))


def capillary_refill_s(time_s: Array, lab: Array) -> Array:
    """Time after release from which on each place differs less from its rest than an eye sees, (places,) float. [s]

    lab : (places, times, 3) float. The first is at rest. Linear between samples; NaN where no eye sees the press at
    all, infinite where the colour has not returned in the end.
    """
    difference = delta_e_2000(lab, lab[:, :1])
    out = np.full(len(lab), np.nan)
    for k, row in enumerate(difference):
        visible = np.flatnonzero(row > JUST_NOTICEABLE)
        if len(visible) and visible[-1] == len(row) - 1:
            out[k] = np.inf
        elif len(visible):
            i = visible[-1]
            step = (row[i] - JUST_NOTICEABLE) / (row[i] - row[i + 1]) * (time_s[i + 1] - time_s[i])
            out[k] = max(time_s[i] + step - OFF_S, 0.0)
    return out


def beat(scene: Scene, rays: ColourRays, places: Places, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """One heartbeat at the first force: the change of each place's colour; nothing without a heart."""
    heart = scene.body.heartbeat if scene.body else None
    if heart is None or heart.pulse_pressure_pa == 0:
        return xr.Dataset()
    blood = beat_at(scene, viewing.forces_n[0])
    which = np.linspace(0, len(blood.time_s) - 1, BEAT_STEPS).round().astype(int)
    few = rays.one_in(ONE_IN)
    read = few.reflectance(blood.blood_fraction.T[which], viewing, patches=range(places.along))
    lab = viewer.lab(read)
    # From the palest moment, so that noise, which all moments share, makes no beat of its own.
    palest = lab[0, ..., 1].mean(0).argmin()
    moved = delta_e_2000(lab, lab[:, :, palest, None])
    text = "colour over a beat, L*a*b*"
    data = estimated("beat_lab", ("place", "beat_time", "band"), lab, text)
    text = "largest colour difference over a beat, CIEDE2000"
    most = moved[0].argmax(1)
    largest = np.take_along_axis(moved, most[None, :, None], 2)[..., 0]
    data |= estimated("beat_delta_e_2000", "place", largest, text)
    return xr.Dataset(data, variable("beat_time", "beat_time", blood.time_s[which], "time", units="s"))


def photographs(
    scene: Scene,
    result: xr.Dataset,
    *,
    states: Sequence[int] = (0, -1),
    backend: str = "auto",
) -> list[NDArray[np.uint8]]:
    """The finger in some states, (height, width, 3) each; in the first and the last if not given, once if they are one.

    result : what `colour` returned for the scene.
    """
    assert scene.finger is not None
    tiles, colours = result.tile_mm.values, linear(result.tile_srgb.values)
    hit = colours[:, 0].mean(-1) > MISSED
    # A tile across the nail's edge is neither.
    reach = np.abs(tiles) + 0.5 * result.attrs["tile_size_mm"]
    edge = scene.finger.nail_radius_mm * np.sin(0.5 * scene.finger.nail_width_mm / scene.finger.nail_radius_mm)
    on_nail = (reach[:, 0] <= edge) & (reach[:, 1] <= scene.finger.nail_length_mm / 2)
    inner = np.abs(tiles) - 0.5 * result.attrs["tile_size_mm"]
    off_nail = (inner[:, 0] >= edge) | (inner[:, 1] >= scene.finger.nail_length_mm / 2)
    drawn = hit & (on_nail | off_nail)
    chosen = list(dict.fromkeys(state % result.sizes["state"] for state in states))
    shown = colours[drawn][:, chosen].swapaxes(0, 1)
    return photograph(scene, tiles[drawn], on_nail[drawn], shown, size=scene.colour.photograph_px, backend=backend)
