"""What the paper says its figures show, as rules that the responses of one parameter set or of thousands are held to.

Where the paper gives a number it is used; where it gives a word ("much more slowly", "nearly linear") the bound is a
choice, spelled out with the claim. Readings follow eq. (9): they fall with (D+x)^2, the blood under the photodiode.
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from .responses import CURVE_PA, N_PER_CM2, PHASE_S, Responses

# What divides is kept from 0 by this, far below any change that a figure shows. [m, 1]
_TINY = 1e-30
# A time constant is the time to this part of a change, a level is reached at that part. [1]
_TIME_CONSTANT_PART, _LEVEL_PART = 1.0 - math.exp(-1.0), 0.95


@dataclasses.dataclass(frozen=True)
class Rule:
    """One claim of a figure: what it says, and the bounds within which its measure must lie.

    measure : from responses of batch shape B to B floats, in the unit.
    """

    figure: str
    text: str
    measure: Callable[[Responses], np.ndarray]
    unit: str = "1"
    low: float = -math.inf
    high: float = math.inf


def _at(pressure_n_per_cm2: float) -> int:
    """Where a pressure lies on the static curves."""
    return int(np.argmin(np.abs(CURVE_PA - pressure_n_per_cm2 * N_PER_CM2)))


def _crossing(done: np.ndarray, target: float, after: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Where a curve over an axis passes a target between the sample `after` and the one before it."""
    above = np.take_along_axis(done, after[..., None], axis=-1)[..., 0]
    below = np.take_along_axis(done, after[..., None] - 1, axis=-1)[..., 0]
    part = np.clip((target - below) / np.where(above == below, 1.0, above - below), 0.0, 1.0)
    return axis[after - 1] + part * (axis[after] - axis[after - 1])


def _smallest_step(curve: np.ndarray) -> np.ndarray:
    """Smallest rise between neighbours over the whole range of the curve, up to 1 N/cm^2. [1]"""
    part = curve[..., : _at(1.0) + 1]
    return np.diff(part, axis=-1).min(axis=-1) / np.maximum(np.ptp(part, axis=-1), _TINY)


def _off_chord(curve: np.ndarray, *, start: float = 0.0, end: float = 1.0) -> np.ndarray:
    """Largest distance of the curve from its chord over its change, between two pressures in N/cm^2. [1]"""
    inside = slice(_at(start), _at(end) + 1)
    part, x = curve[..., inside], CURVE_PA[inside]
    along = (x - x[0]) / (x[-1] - x[0])
    chord = part[..., :1] + (part[..., -1:] - part[..., :1]) * along
    return np.abs(part - chord).max(axis=-1) / np.maximum(np.abs(part[..., -1] - part[..., 0]), _TINY)


def _level_from(curve: np.ndarray) -> np.ndarray:
    """Pressure at which 95 % of the change up to 2 N/cm^2 has come about for good. [N/cm^2]"""
    done = np.abs(curve - curve[..., :1]) / np.maximum(np.abs(curve[..., -1:] - curve[..., :1]), _TINY)
    samples = done.shape[-1]
    last_below = samples - 1 - np.argmax((done < _LEVEL_PART)[..., ::-1], axis=-1)
    return _crossing(done, _LEVEL_PART, np.minimum(last_below + 1, samples - 1), CURVE_PA) / N_PER_CM2


def _time_constant(path: np.ndarray) -> np.ndarray:
    """Time to 63 % of the change over a phase. [s]"""
    whole = path[..., -1:] - path[..., :1]
    done = (path - path[..., :1]) / np.where(whole == 0.0, 1.0, whole)
    reached = np.argmax(done >= _TIME_CONSTANT_PART, axis=-1)
    time = _crossing(done, _TIME_CONSTANT_PART, np.maximum(reached, 1), PHASE_S)
    return np.where(reached > 0, time, PHASE_S[-1])


def _blood(width: np.ndarray) -> np.ndarray:
    """Blood of a static curve over that at rest. [1]"""
    return (width / width[..., :1]) ** 2


def _proximal(r: Responses) -> np.ndarray:
    """Blood under the proximal photodiode, whose reading falls as it rises."""
    return _blood(r.both[0])


def _distal(r: Responses) -> np.ndarray:
    """Less the blood under the distal photodiode: its reading, but for scale and offset."""
    return -_blood(r.both[1])


def _ratio(slow: np.ndarray, fast: np.ndarray) -> np.ndarray:
    """Geometric mean over the steps of one time constant over another. [1]"""
    return np.exp(np.mean(np.log(_time_constant(slow) / _time_constant(fast)), axis=-1))


def _steeper_at_first(curve: np.ndarray) -> np.ndarray:
    """Slope up to 0.1 N/cm^2 over that from 0.1 to 1. [1]"""
    first = (curve[..., _at(0.1)] - curve[..., 0]) / 0.1
    later = (curve[..., _at(1.0)] - curve[..., _at(0.1)]) / 0.9
    return first / np.maximum(np.abs(later), _TINY)


def _still_changing(curve: np.ndarray) -> np.ndarray:
    """Change from 1.2 to 2 N/cm^2 over that from 0 to 1.2. [1]"""
    knee = curve[..., _at(1.2)]
    return (curve[..., -1] - knee) / np.maximum(np.abs(knee - curve[..., 0]), _TINY)


# Steps of 0.5 N/cm^2 and more.
_LARGE = slice(4, None)

# fmt: off
RULES = (
    Rule("10", "capillaries widen with every step of proximal pressure (smallest step over range)",
         lambda r: _smallest_step(r.proximal[0]), low=0.0),
    Rule("10", "the vein narrows with every step (smallest step over range)",
         lambda r: _smallest_step(-r.proximal[2]), low=0.0),
    Rule("10", "the reddening is visible: proximal blood grows by a tenth or more to 1 N/cm^2",
         lambda r: _blood(r.proximal[0])[..., _at(1.0)] - 1.0, low=0.1),
    Rule("10", "steady capillary diameters are not linear in pressure (off the chord by)",
         lambda r: _off_chord(r.proximal[0]), low=0.05),
    Rule("10", "capillaries are sluggish at low pressure (time at 0.1 over time at 1 N/cm^2)",
         lambda r: _time_constant(r.proximal_on[0][..., 0, :]) / _time_constant(r.proximal_on[0][..., -1, :]), low=1.5),
    Rule("10", "capillaries are much slower on release (release over loading time, 0.5 to 1)",
         lambda r: _ratio(r.proximal_off[0][..., _LARGE, :], r.proximal_on[0][..., _LARGE, :]), low=1.75),
    Rule("10", "the vein is equally fast both ways (difference of times)",
         lambda r: np.abs(_time_constant(r.proximal_off[2]) - _time_constant(r.proximal_on[2])).max(axis=-1), "s",
         high=0.05),
    Rule("11", "the proximal reading falls with every step of both pressures",
         lambda r: _smallest_step(_proximal(r)), low=0.0),
    Rule("11", "the distal reading rises with every step", lambda r: _smallest_step(_distal(r)), low=0.0),
    Rule("11", "the distal reading is nearly linear to 1 N/cm^2 (off the chord by)",
         lambda r: _off_chord(_distal(r)), high=0.1),
    Rule("11", "distal loading and unloading take equal times (unloading over loading)",
         lambda r: _ratio(r.both_off[1] ** 2, r.both_on[1] ** 2), low=0.8, high=1.25),
    Rule("12", "V_P1 falls roughly linearly to 0.9 N/cm^2 (off the chord by)",
         lambda r: _off_chord(_proximal(r), end=0.9), high=0.15),
    Rule("12", "V_P1 levels off near 1 N/cm^2", lambda r: _level_from(_proximal(r)), "N/cm2", low=0.85, high=1.15),
    Rule("12", "V_P2 rises steeply to 0.1 N/cm^2 (slope over that from 0.1 to 1)",
         lambda r: _steeper_at_first(_distal(r)), low=1.5),
    Rule("12", "V_P2 is linear from 0.1 to 1 N/cm^2 (off the chord by)",
         lambda r: _off_chord(_distal(r), start=0.1), high=0.1),
    Rule("12", "V_P2 levels off just past 1 N/cm^2", lambda r: _level_from(_distal(r)), "N/cm2", low=1.0, high=1.3),
    Rule("15-18", "the proximal reading is level past 1 N (change from 1.2 to 2 over that before)",
         lambda r: _still_changing(_proximal(r)), low=-0.03, high=0.03),
    Rule("17-18", "readings follow a force of 1 N like the subjects' in 0.1 to 0.4 s: proximal loading",
         lambda r: _time_constant(r.force_on[0] ** 2)[..., 0], "s", low=0.1, high=0.4),
    Rule("17-18", "the same, proximal unloading",
         lambda r: _time_constant(r.force_off[0] ** 2)[..., 0], "s", low=0.1, high=0.4),
    Rule("17-18", "the distal reading takes 0.18 s on loading (within a quarter)",
         lambda r: _time_constant(r.force_on[1] ** 2)[..., 0], "s", low=0.135, high=0.225),
    Rule("17-18", "the distal reading takes 0.36 s on unloading (within a quarter)",
         lambda r: _time_constant(r.force_off[1] ** 2)[..., 0], "s", low=0.27, high=0.45),
)
# fmt: on
