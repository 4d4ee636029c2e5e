"""What the paper claims about its Figs. 10-12, as rules on observations that one set or thousands can be held to.

Where the paper gives a number it is used; where it gives a word ("much more slowly", "nearly linear") the bound is a
choice, spelled out with the claim. Readings follow eq. (9): they fall with (D+x)^2, the blood under the photodiode.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from .responses import CURVE_PA, N_PER_CM2, PHASE_S, Observations


@dataclasses.dataclass(frozen=True)
class Rule:
    """One claim of a figure: what it says, and the bounds within which its measure must lie.

    measure : from observations of batch shape B to B floats, in the unit.
    """

    figure: str
    text: str
    unit: str
    low: float
    high: float
    measure: Callable[[Observations], np.ndarray]


def _between(curve_pa: np.ndarray, low: float, high: float) -> np.ndarray:
    return (curve_pa >= low * N_PER_CM2 - 1e-6) & (curve_pa <= high * N_PER_CM2 + 1e-6)


def _smallest_step(curve: np.ndarray, *, up_to: float = 1.0) -> np.ndarray:
    """Smallest rise between neighbours over the whole range of the curve up to a pressure. [1]"""
    part = curve[..., _between(CURVE_PA, 0.0, up_to)]
    span = np.maximum(np.ptp(part, axis=-1), 1e-30)
    return np.diff(part, axis=-1).min(axis=-1) / span


def _bend(curve: np.ndarray, *, start: float, end: float) -> np.ndarray:
    """Largest distance of the curve from its chord over its change, between two pressures. [1]"""
    inside = _between(CURVE_PA, start, end)
    part, x = curve[..., inside], CURVE_PA[inside]
    along = (x - x[0]) / (x[-1] - x[0])
    chord = part[..., :1] + (part[..., -1:] - part[..., :1]) * along
    return np.abs(part - chord).max(axis=-1) / np.maximum(np.abs(part[..., -1] - part[..., 0]), 1e-30)


def _level_off(curve: np.ndarray) -> np.ndarray:
    """Pressure at which 95 % of the change up to 2 N/cm^2 has come about for good. [N/cm^2]"""
    done = np.abs(curve - curve[..., :1]) / np.maximum(np.abs(curve[..., -1:] - curve[..., :1]), 1e-30)
    below = done < 0.95
    last = below.shape[-1] - 1 - np.argmax(below[..., ::-1], axis=-1)
    last = np.minimum(last, below.shape[-1] - 2)
    before = np.take_along_axis(done, last[..., None], axis=-1)[..., 0]
    after = np.take_along_axis(done, last[..., None] + 1, axis=-1)[..., 0]
    part = np.clip((0.95 - before) / np.where(after == before, 1.0, after - before), 0.0, 1.0)
    return (CURVE_PA[last] + part * (CURVE_PA[1] - CURVE_PA[0])) / N_PER_CM2


def _rise_time(path: np.ndarray) -> np.ndarray:
    """Time to 63 % of the change over a phase. [s]"""
    done = (path - path[..., :1]) / np.where(path[..., -1:] == path[..., :1], 1.0, path[..., -1:] - path[..., :1])
    target = 1.0 - math.exp(-1.0)
    reached = np.argmax(done >= target, axis=-1)
    index = np.maximum(reached, 1)
    after = np.take_along_axis(done, index[..., None], axis=-1)[..., 0]
    before = np.take_along_axis(done, index[..., None] - 1, axis=-1)[..., 0]
    part = np.clip((target - before) / np.where(after == before, 1.0, after - before), 0.0, 1.0)
    time = PHASE_S[index - 1] + part * (PHASE_S[index] - PHASE_S[index - 1])
    return np.where(reached > 0, time, PHASE_S[-1])


def _blood(width: np.ndarray, rest: np.ndarray) -> np.ndarray:
    return (width / rest) ** 2


def _proximal(o: Observations) -> np.ndarray:
    return _blood(o.both[0], o.both[0][..., :1])


def _distal(o: Observations) -> np.ndarray:
    return -_blood(o.both[1], o.both[1][..., :1])


def _ratio(slow: np.ndarray, fast: np.ndarray, steps: slice) -> np.ndarray:
    """Geometric mean over some steps of one time over another. [1]"""
    return np.exp(np.mean(np.log(_rise_time(slow)[..., steps] / _rise_time(fast)[..., steps]), axis=-1))


def _steep(o: Observations) -> np.ndarray:
    distal = _distal(o)
    tenth, one = int(np.searchsorted(CURVE_PA, 999.0)), int(np.searchsorted(CURVE_PA, 9999.0))
    first = (distal[..., tenth] - distal[..., 0]) / 0.1
    later = (distal[..., one] - distal[..., tenth]) / 0.9
    return first / np.maximum(np.abs(later), 1e-30)


def _after(curve: np.ndarray) -> np.ndarray:
    """Change from 1.2 to 2 N/cm^2 over that from 0 to 1.2. [1]"""
    knee = int(np.searchsorted(CURVE_PA, 1.2 * N_PER_CM2 - 1.0))
    return (curve[..., -1] - curve[..., knee]) / np.maximum(np.abs(curve[..., knee] - curve[..., 0]), 1e-30)


_UPPER = slice(4, None)  # steps of 0.5 N/cm^2 and more
_INF = math.inf


def _vein_gap(o: Observations) -> np.ndarray:
    """Largest difference between release and loading time of the vein. [s]"""
    return np.abs(_rise_time(o.proximal_off[2]) - _rise_time(o.proximal_on[2])).max(axis=-1)


def _slow_start(o: Observations) -> np.ndarray:
    times = _rise_time(o.proximal_on[0])
    return times[..., 0] / times[..., -1]


def _reddening(o: Observations) -> np.ndarray:
    return _blood(o.proximal[0][..., _ONE], o.proximal[0][..., 0]) - 1.0


_ONE = int(np.searchsorted(CURVE_PA, N_PER_CM2 - 1.0))

# figure, text, unit, low, high, measure
RULES = tuple(
    Rule(*row)
    for row in (
        (
            "10",
            "capillaries widen with every step of proximal pressure (smallest step over range)",
            "1",
            0.0,
            _INF,
            lambda o: _smallest_step(o.proximal[0]),
        ),
        (
            "10",
            "the vein narrows with every step (smallest step over range)",
            "1",
            0.0,
            _INF,
            lambda o: _smallest_step(-o.proximal[2]),
        ),
        (
            "10",
            "the reddening is visible: proximal blood grows by a tenth or more to 1 N/cm^2",
            "1",
            0.1,
            _INF,
            _reddening,
        ),
        (
            "10",
            "steady capillary diameters are not linear in pressure (off the chord by)",
            "1",
            0.05,
            _INF,
            lambda o: _bend(o.proximal[0], start=0.0, end=1.0),
        ),
        (
            "10",
            "capillaries are sluggish at low pressure (time at 0.1 over time at 1 N/cm^2)",
            "1",
            1.5,
            _INF,
            _slow_start,
        ),
        (
            "10",
            "capillaries are much slower on release (release over loading time, 0.5 to 1)",
            "1",
            1.75,
            _INF,
            lambda o: _ratio(o.proximal_off[0], o.proximal_on[0], _UPPER),
        ),
        ("10", "the vein is equally fast both ways (difference of times)", "s", -_INF, 0.05, _vein_gap),
        (
            "11",
            "the proximal reading falls with every step of both pressures",
            "1",
            0.0,
            _INF,
            lambda o: _smallest_step(_proximal(o)),
        ),
        ("11", "the distal reading rises with every step", "1", 0.0, _INF, lambda o: _smallest_step(_distal(o))),
        (
            "11",
            "the distal reading is nearly linear to 1 N/cm^2 (off the chord by)",
            "1",
            -_INF,
            0.1,
            lambda o: _bend(_distal(o), start=0.0, end=1.0),
        ),
        (
            "11",
            "distal loading and unloading take equal times (unloading over loading)",
            "1",
            0.8,
            1.25,
            lambda o: _ratio(o.both_off[1] ** 2, o.both_on[1] ** 2, slice(None)),
        ),
        (
            "12",
            "V_P1 falls roughly linearly to 0.9 N/cm^2 (off the chord by)",
            "1",
            -_INF,
            0.15,
            lambda o: _bend(_proximal(o), start=0.0, end=0.9),
        ),
        ("12", "V_P1 levels off near 1 N/cm^2", "N/cm2", 0.85, 1.15, lambda o: _level_off(_proximal(o))),
        ("12", "V_P2 rises steeply to 0.1 N/cm^2 (slope over that from 0.1 to 1)", "1", 1.5, _INF, _steep),
        (
            "12",
            "V_P2 is linear from 0.1 to 1 N/cm^2 (off the chord by)",
            "1",
            -_INF,
            0.1,
            lambda o: _bend(_distal(o), start=0.1, end=1.0),
        ),
        ("12", "V_P2 levels off just past 1 N/cm^2", "N/cm2", 1.0, 1.3, lambda o: _level_off(_distal(o))),
        (
            "15-18",
            "the proximal reading is level past 1 N (change from 1.2 to 2 over that before)",
            "1",
            -0.03,
            0.03,
            lambda o: _after(_proximal(o)),
        ),
        (
            "17-18",
            "readings follow a force of 1 N like the subjects' in 0.1 to 0.4 s: proximal loading",
            "s",
            0.1,
            0.4,
            lambda o: _rise_time(o.force_on[0] ** 2)[..., 0],
        ),
        ("17-18", "the same, proximal unloading", "s", 0.1, 0.4, lambda o: _rise_time(o.force_off[0] ** 2)[..., 0]),
        (
            "17-18",
            "the distal reading takes 0.18 s on loading (within a quarter)",
            "s",
            0.135,
            0.225,
            lambda o: _rise_time(o.force_on[1] ** 2)[..., 0],
        ),
        (
            "17-18",
            "the distal reading takes 0.36 s on unloading (within a quarter)",
            "s",
            0.27,
            0.45,
            lambda o: _rise_time(o.force_off[1] ** 2)[..., 0],
        ),
    )
)
