"""The colour of a nail over time: a press and its release, the time in which colour returns, and a heart that beats."""

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from ...hemodynamics.for_scene import blood_over_touch
from ...scene import Scene, Touch, Viewing
from ...statistics import jackknife
from ...variables import variable
from ..pulsatile_blood import beat_at
from .colorimetry import Viewer, delta_e_2000
from .enough_rays import Places, look_of
from .reflectance import ColourRays

Array = NDArray[np.float64]

# Force on, off, end, and how many pictures of it there are. [s]
ON_S, OFF_S, END_S, STEPS = 0.5, 3.5, 8.0, 31
# The touch is followed at so many times as many moments.
FINER = 8
# The smallest difference that an eye sees side by side. [CIEDE2000]
JUST_SEEN = 1.0
# One in so many rays is read over time: a change of colour needs fewer than a colour.
ONE_IN = 4
# Of a beat so many moments are read.
BEAT_STEPS = 16
_KEPT = ("contact_area_mm2", "site", "proximal_share", "proximal_area_mm2", "distal_area_mm2", "distal_relaxation_s")


def press_and_release(scene: Scene, rays: ColourRays, places: Places, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """The largest of the forces pressed and released: colours over time, and how long they take to return."""
    most = max(viewing.forces_n)
    if most == 0:
        return xr.Dataset()
    usual: dict[str, Any] = {"profile": "step", "force_n": most, "start_s": ON_S, "release_s": OFF_S}
    usual |= {"duration_s": END_S, "sample_rate_hz": (STEPS - 1) / END_S * FINER}
    usual |= {name: getattr(scene.touch, name) for name in _KEPT}
    course = blood_over_touch(scene.model_copy(update={"touch": Touch(**usual)}))
    seen = course.isel(time=slice(None, None, FINER))
    few = rays.one_in(ONE_IN)
    read = few.reflectance(seen.blood_fraction.values.T, **look_of(viewing), patches=range(places.along))
    lab, time_s = viewer.lab(read), seen.time.values
    each = ("place", "time")
    text = "L*a*b* over a press"
    data = variable("press_lab", (*each, "band"), lab[0], text, stderr=jackknife(lab))
    data |= variable("press_srgb", (*each, "channel"), viewer.srgb(read[0]), "colour on a screen, over a press")
    data |= variable("press_force_n", "time", seen.force_n.values, "force of the press", units="N")
    text = "time after release from which on the colour is that of the finger at rest, as far as an eye sees"
    returned = np.array([refill_s(time_s, one) for one in lab])
    with np.errstate(invalid="ignore"):  # a place that never returns, or was never seen to change
        error = jackknife(returned)
    data |= variable("refill_s", "place", returned[0], text, units="s", stderr=error)
    return xr.Dataset(data, variable("time", "time", time_s, "time", units="s"))


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


def beat(scene: Scene, rays: ColourRays, places: Places, viewer: Viewer, viewing: Viewing) -> xr.Dataset:
    """One beat of the scene's heart at its first force: how far each place's colour moves; nothing without a heart."""
    heart = scene.body.heartbeat if scene.body else None
    if heart is None or heart.pulse_pressure_pa == 0:
        return xr.Dataset()
    blood = beat_at(scene, viewing.forces_n[0])
    which = np.linspace(0, len(blood.time_s) - 1, BEAT_STEPS).round().astype(int)
    few = rays.one_in(ONE_IN)
    read = few.reflectance(blood.blood_fraction.T[which], **look_of(viewing), patches=range(places.along))
    lab = viewer.lab(read)
    # From the palest moment, so that noise, which all moments share, makes no beat of its own.
    palest = lab[0, ..., 1].mean(0).argmin()
    moved = delta_e_2000(lab, lab[:, :, palest, None])
    text = "colour over a beat, L*a*b*"
    data = variable("beat_lab", ("place", "beat_time", "band"), lab[0], text, stderr=jackknife(lab))
    text = "largest colour difference over a beat, CIEDE2000"
    most = moved[0].argmax(1)
    each = np.take_along_axis(moved, most[None, :, None], 2)[..., 0]
    data |= variable("beat_delta_e_2000", "place", each[0], text, stderr=jackknife(each))
    return xr.Dataset(data, variable("beat_time", "beat_time", blood.time_s[which], "time", units="s"))
