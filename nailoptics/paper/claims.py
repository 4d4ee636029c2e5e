"""What the paper says its figures show, as rules that the responses of one parameter set or of thousands are held to.

Every rule stands for a sentence of the paper, in our words, and is judged under that figure's own touch. Where the
paper gives a number it is used; where it gives a word ("much more slowly", "nearly linear") the bound is a choice,
spelled out with the rule. Readings follow Taylor (9): they fall with (D+x)^2, the blood under the photodiode.
"""

import dataclasses
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from .protocols import CURVE_PA, LOADING_S, N_PER_CM2, PHASE_S, UNLOADING_S
from .responses import Responses

# What divides is kept from 0 by this, far below any change that a figure shows. [m, 1]
_TINY = 1e-30
# A time constant is the time to this part of a change, a level is reached at that part. [1]
_TIME_CONSTANT_PART, _LEVEL_PART = 1.0 - math.exp(-1.0), 0.95


@dataclasses.dataclass(frozen=True)
class Rule:
    """One measure of what a sentence says of a figure, and the bounds within which it must lie.

    sentence : of the paper, in our words. text : what is measured.
    measure : from responses of batch shape B to B floats, in the unit.
    """

    figure: str
    sentence: str
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


def _time_constant(path: np.ndarray, *, end: np.ndarray | None = None) -> np.ndarray:
    """Time to 63 % of the way to the end, by default the last of the phase; the whole phase if it stays short. [s]"""
    whole = (path[..., -1:] if end is None else end) - path[..., :1]
    done = (path - path[..., :1]) / np.where(whole == 0.0, 1.0, whole)
    reached = np.argmax(done >= _TIME_CONSTANT_PART, axis=-1)
    time = _crossing(done, _TIME_CONSTANT_PART, np.maximum(reached, 1), PHASE_S)
    return np.where(reached > 0, time, PHASE_S[-1])


def _release_time(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Time constant of the way back to where the touch had begun. [s]"""
    return _time_constant(off, end=on[..., :1])


def _blood(width: np.ndarray) -> np.ndarray:
    """Blood of a static curve over that at rest. [1]"""
    return (width / width[..., :1]) ** 2


def _overshoot(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How far paths (..., steps, 81) pass their ends on either phase, of the largest step's change. [1]"""
    change = off[..., -1] - off[..., 0]
    past = [np.sign(phase[..., -1:] - phase[..., :1]) * (phase - phase[..., -1:]) for phase in (on, off)]
    return np.max(past, axis=(0, -2, -1)) / np.maximum(np.abs(change).max(axis=-1), _TINY)


def _release_over_loading(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Geometric mean over the larger steps of the time constant on release over that on loading. [1]"""
    large = slice(4, None)
    ratio = _release_time(on[..., large, :], off[..., large, :]) / _time_constant(on[..., large, :])
    return np.exp(np.log(ratio).mean(axis=-1))


def _difference(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Largest difference over the steps between the time constants on release and on loading. [s]"""
    return np.abs(_release_time(on, off) - _time_constant(on)).max(axis=-1)


def _steeper_at_first(curve: np.ndarray) -> np.ndarray:
    """Slope up to 0.1 N/cm^2 over that from 0.1 to 1. [1]"""
    first = (curve[..., _at(0.1)] - curve[..., 0]) / 0.1
    later = (curve[..., _at(1.0)] - curve[..., _at(0.1)]) / 0.9
    return first / np.maximum(np.abs(later), _TINY)


def _past_the_knee(curve: np.ndarray) -> np.ndarray:
    """Change from 1.2 to 2 N over that from 0 to 1.2 N. [1]"""
    knee = curve[..., _at(1.2)]
    return (curve[..., -1] - knee) / np.maximum(np.abs(knee - curve[..., 0]), _TINY)


def _late_slope(curve: np.ndarray) -> np.ndarray:
    """Slope from 1.2 to 2 N over that from 0 to 1 N. [1]"""
    first = curve[..., _at(1.0)] - curve[..., 0]
    return (curve[..., -1] - curve[..., _at(1.2)]) / 0.8 / np.maximum(np.abs(first), _TINY)


_WIDEN = "Pressing the proximal pulp narrows the vein and widens the capillaries."
_REDDEN = "From some 0.3 N blood pools under the nail, which reddens, fully at about 1 N."
_FIG_11 = "With both pressures the proximal reading falls, the distal one rises."
_SMOOTH = "It goes from level to level; no overshoot is mentioned."
_DISTAL_BOTH_WAYS = "The distal reading is nearly linear, and loads and unloads in equal times."
_V_P1 = "V_P1 falls roughly linearly and levels off near 1 N/cm^2."
_V_P2 = "V_P2 rises steeply to 0.1 N/cm^2, then linearly, and levels off just past 1."
_FIG_15 = "Force on the proximal pulp: a linear fall to about 1 N, then level, in some a slight rise."
_FIG_16 = "The proximal reading is no slower than the force: 0.16 s on loading, 0.12 s on unloading."
_FIG_17 = "Force on the distal pulp: linear to about 1 N, then a small positive slope as the white band widens."
_FIG_18 = "The distal reading takes 0.18 s on loading and 0.36 s on unloading."
_BAND = "Past 1 N the tip whitens, in a band that widens until some 4 N."

# fmt: off
RULES = (
    Rule("10", _WIDEN, "smallest step of a capillary over its range",
         lambda r: _smallest_step(r.proximal[0]), low=0.0),
    Rule("10", _WIDEN, "smallest step of the vein over its range, inwards",
         lambda r: _smallest_step(-r.proximal[2]), low=0.0),
    Rule("10", _REDDEN, "growth of proximal blood to 1 N/cm^2",
         lambda r: _blood(r.proximal[0])[..., _at(1.0)] - 1.0, low=0.1),
    Rule("10", "Steady diameters are not linear in pressure.", "capillary off its chord to 1 N/cm^2, of the change",
         lambda r: _off_chord(r.proximal[0]), low=0.05),
    Rule("10", "Capillaries are slower at low pressure.", "time constant at 0.1 over that at 1 N/cm^2",
         lambda r: _time_constant(r.proximal_on[0][..., 0, :]) / _time_constant(r.proximal_on[0][..., -1, :]), low=1.5),
    Rule("10", "Capillaries are much slower on release than on loading.", "time constants, off over on, 0.5 to 1",
         lambda r: _release_over_loading(r.proximal_on[0], r.proximal_off[0]), low=1.75),
    Rule("10", "The vein is equally fast both ways.", "largest difference of its time constants",
         lambda r: _difference(r.proximal_on[2], r.proximal_off[2]),
         "s", high=0.05),
    Rule("10", _SMOOTH, "overshoot of the vein, of its largest change",
         lambda r: _overshoot(r.proximal_on[2], r.proximal_off[2]), high=0.05),
    Rule("11", _FIG_11, "smallest step of the proximal reading over its range, downwards",
         lambda r: _smallest_step(_blood(r.both[0])), low=0.0),
    Rule("11", _FIG_11, "smallest step of the distal reading over its range, upwards",
         lambda r: _smallest_step(-_blood(r.both[1])), low=0.0),
    Rule("11", _SMOOTH, "overshoot of the proximal reading, of its largest change",
         lambda r: _overshoot(r.both_on[0] ** 2, r.both_off[0] ** 2), high=0.05),
    Rule("11", _SMOOTH, "overshoot of the distal reading, of its largest change",
         lambda r: _overshoot(r.both_on[1] ** 2, r.both_off[1] ** 2), high=0.05),
    Rule("11", _DISTAL_BOTH_WAYS, "distal reading off its chord to 1 N/cm^2, of the change",
         lambda r: _off_chord(_blood(r.both[1])), high=0.1),
    Rule("11", _DISTAL_BOTH_WAYS, "distal time constants, unloading over loading, 0.5 to 1",
         lambda r: _release_over_loading(r.both_on[1] ** 2, r.both_off[1] ** 2), low=0.8, high=1.25),
    Rule("12", _V_P1, "V_P1 off its chord to 0.9 N/cm^2, of the change",
         lambda r: _off_chord(_blood(r.proximal[0]), end=0.9), high=0.15),
    Rule("12", _V_P1, "pressure at which 95 % of V_P1's change has come", lambda r: _level_from(_blood(r.proximal[0])),
         "N/cm2", low=0.85, high=1.15),
    Rule("12", _V_P2, "slope of V_P2 to 0.1 over that from 0.1 to 1 N/cm^2",
         lambda r: _steeper_at_first(-_blood(r.distal[1])), low=1.5),
    Rule("12", _V_P2, "V_P2 off its chord from 0.1 to 1 N/cm^2, of the change",
         lambda r: _off_chord(_blood(r.distal[1]), start=0.1), high=0.1),
    Rule("12", _V_P2, "pressure at which 95 % of V_P2's change has come", lambda r: _level_from(_blood(r.distal[1])),
         "N/cm2", low=1.0, high=1.3),
    Rule("15", _FIG_15, "proximal reading off its chord to 1 N, of the change",
         lambda r: _off_chord(r.cycle[0].mean(axis=-2)), high=0.15),
    Rule("15", _FIG_15, "change from 1.2 to 2 N over that to 1.2 N",
         lambda r: _past_the_knee(r.cycle[0].mean(axis=-2)), low=-0.03, high=0.1),
    Rule("16", _FIG_16, "proximal time constant on loading (a quarter more at most)",
         lambda r: _time_constant(r.press_on[0]), "s", high=1.25 * LOADING_S),
    Rule("16", _FIG_16, "proximal time constant on unloading (likewise)",
         lambda r: _release_time(r.press_on[0], r.press_off[0]), "s", high=1.25 * UNLOADING_S),
    Rule("17", _FIG_17, "distal reading off its chord to 1 N, of the change",
         lambda r: _off_chord(r.cycle[1].mean(axis=-2)), high=0.15),
    Rule("17", _FIG_17, "slope from 1.2 to 2 N over that to 1 N",
         lambda r: _late_slope(r.cycle[1].mean(axis=-2)), low=0.005, high=0.3),
    Rule("18", _FIG_18, "distal time constant on loading (within a quarter)",
         lambda r: _time_constant(r.press_on[1]), "s", low=0.135, high=0.225),
    Rule("18", _FIG_18, "distal time constant on unloading (within a quarter)",
         lambda r: _release_time(r.press_on[1], r.press_off[1]), "s", low=0.27, high=0.45),
    Rule("II", _BAND, "growth of the white part of the bed from 1 to 4 N on both sides",
         lambda r: r.white[..., 1] - r.white[..., 0], low=0.1),
)
# fmt: on


@dataclasses.dataclass(frozen=True)
class Claim:
    """One rule, judged on one set. value : measured, in the rule's unit."""

    rule: Rule
    value: float

    @property
    def met(self) -> bool:
        """Whether the value lies within the bounds."""
        return self.rule.low <= self.value <= self.rule.high


def judge(responses: Responses) -> list[Claim]:
    """Every rule, measured on the responses of one set."""
    return [Claim(rule, float(rule.measure(responses))) for rule in RULES]


def bounds_in_words(rule: Rule) -> str:
    """The bounds of a rule: from one to the other, or the only one."""
    if math.isinf(rule.high):
        return f">= {rule.low:.3g}"
    if math.isinf(rule.low):
        return f"<= {rule.high:.3g}"
    return f"{rule.low:.3g} to {rule.high:.3g}"


def as_rows(judged: Mapping[str, list[Claim]]) -> list[dict[str, Any]]:
    """The table as plain rows: one for each rule, with value and verdict of each set."""
    rows = []
    for same in zip(*judged.values(), strict=True):
        rule = same[0].rule
        row = {"figure": rule.figure, "sentence": rule.sentence, "measure": rule.text, "unit": rule.unit}
        sets = {name: {"value": claim.value, "met": claim.met} for name, claim in zip(judged, same, strict=True)}
        rows.append(row | {"rule": bounds_in_words(rule), "sets": sets})
    return rows


def as_text(judged: Mapping[str, list[Claim]]) -> str:
    """The table as text: below each sentence its rules, with the value of each set and whether it is met."""
    rows = as_rows(judged)
    measure_width = max(len(row["measure"]) for row in rows) + 2
    rule_width = max(len(f"{row['rule']} {row['unit']}") for row in rows)
    width = max(18, *(len(name) + 1 for name in judged))

    def line(measure: str, rule: str, cells: Iterable[object]) -> str:
        return f"  {measure:<{measure_width}}{rule:<{rule_width}}" + "".join(f"{cell!s:>{width}}" for cell in cells)

    lines, said = [line("measure", "rule", judged)], ""
    for row in rows:
        sentence = f"{'Sec.' if row['figure'] == 'II' else 'Fig.'} {row['figure']}: {row['sentence']}"
        if sentence != said:
            lines += textwrap.wrap(sentence, 118)
            said = sentence
        # A negative zero reads as 0.
        cells = [f"{s['value'] or 0.0:.3g} {'met    ' if s['met'] else 'not met'}" for s in row["sets"].values()]
        lines.append(line(row["measure"], row["rule"] + (f" {row['unit']}" if row["unit"] != "1" else ""), cells))
    met = [sum(claim.met for claim in claims) for claims in judged.values()]
    return "\n".join([*lines, line(f"rules met of {len(rows)}", "", met)])
