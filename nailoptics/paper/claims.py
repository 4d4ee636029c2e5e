"""What the paper says its figures show, as rules that the responses of one parameter set or of thousands are held to.

Every rule stands for a sentence of the paper, in our words, and is evaluated under that figure's own touch. Where the
paper gives a number it is used; where it gives a word ("much more slowly", "nearly linear") the bound is a choice,
spelled out with the rule (assets/paper_claims.toml). Readings follow Taylor (9): they fall with (D+x)^2, the blood
under the photodiode.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..assets import read_toml
from ..hemodynamics.blood import white_band_mm
from ..hemodynamics.parameters import PA_PER_N_PER_CM2
from ..statistics import jackknife, t95
from .responses import CURVE_PA, EVEN_N, FINGER_ZONES, PHASE_S, SHEARED, PeopleReadings, Responses

# What divides is kept from 0 by this, far below any change that a figure shows. [m, 1]
_TINY = 1e-30
SIMULATION, SUBJECT = "simulation", "subject"
# A reading rises visibly by this fraction of its change. [1]
_SLIGHT_RISE = 1e-3
# A time constant is the time to this fraction of a change, a level is reached at that fraction. [1]
_TIME_CONSTANT_PART, _LEVEL_PART = 1.0 - math.exp(-1.0), 0.95


@dataclasses.dataclass(frozen=True)
class Rule:
    """One measure of what a sentence says of a figure, and the bounds within which it must lie.

    sentence : of the paper, in our words. text : what is measured.
    measure : from responses of batch shape B to B floats, in the unit; or from `PeopleReadings`, of each or of all.
    given : the number that the sentence gives; empty where every number is our choice. Tolerances always are.
    """

    figure: str
    sentence: str
    text: str
    measure: Callable[[Any], np.ndarray]
    unit: str = "1"
    low: float = -math.inf
    high: float = math.inf
    given: str = ""

    @property
    def applies_to(self) -> str:
        """The set that the sentence speaks of: Figs. 10-12 show the paper's simulation, all else its subjects."""
        return SIMULATION if is_shown_by(SIMULATION, self.figure) else SUBJECT


def is_shown_by(name: str, figure: str) -> bool:
    """Whether a set shows a figure of the paper: of the simulation and its subject only one does, any other set all."""
    return name not in (SIMULATION, SUBJECT) or (name == SIMULATION) == (figure in ("8", "10", "11", "12"))


def _at(pressure_n_per_cm2: float) -> int:
    """Where a pressure lies on the static curves."""
    return int(np.argmin(np.abs(CURVE_PA - pressure_n_per_cm2 * PA_PER_N_PER_CM2)))


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
    return _crossing(done, _LEVEL_PART, np.minimum(last_below + 1, samples - 1), CURVE_PA) / PA_PER_N_PER_CM2


def _time_constant(path: np.ndarray, *, end: np.ndarray | None = None) -> np.ndarray:
    """Time to 63 % of the way to the end, by default the last of the phase; the whole phase if it stays short. [s]"""
    whole = (path[..., -1:] if end is None else end) - path[..., :1]
    done = (path - path[..., :1]) / np.where(whole == 0.0, 1.0, whole)
    reached = np.argmax(done >= _TIME_CONSTANT_PART, axis=-1)
    return np.where(reached > 0, _crossing(done, _TIME_CONSTANT_PART, np.maximum(reached, 1), PHASE_S), PHASE_S[-1])


def _release_time(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Time constant of the way back to where the touch had begun. [s]"""
    return _time_constant(off, end=on[..., :1])


def _overshoot(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How far paths (..., steps, 81) pass their ends on either phase, of the largest step's change. [1]"""
    past = [np.sign(phase[..., -1:] - phase[..., :1]) * (phase - phase[..., -1:]) for phase in (on, off)]
    return np.max(past, axis=(0, -2, -1)) / np.maximum(np.abs(off[..., -1] - off[..., 0]).max(axis=-1), _TINY)


def _release_over_loading(on: np.ndarray, off: np.ndarray) -> np.ndarray:
    """Geometric mean over the larger steps of the time constant on release over that on loading. [1]"""
    large = slice(4, None)
    ratio = _release_time(on[..., large, :], off[..., large, :]) / _time_constant(on[..., large, :])
    return np.exp(np.log(ratio).mean(axis=-1))


def _change_over(curve: np.ndarray, between: tuple[float, float], other: tuple[float, float]) -> np.ndarray:
    """Change of a curve between two pressures in N/cm^2 over the size of that between two others. [1]"""
    change, size = (curve[..., _at(end)] - curve[..., _at(start)] for start, end in (between, other))
    return np.asarray(change / np.maximum(np.abs(size), _TINY))


def _past_the_knee(curve: np.ndarray) -> np.ndarray:
    """Change from 1.2 to 2 N over that from 0 to 1.2 N. [1]"""
    return _change_over(curve, (1.2, 2.0), (0.0, 1.2))


def _magnification(r: Responses) -> np.ndarray:
    """Rise of the proximal bed's pressure with the vein's to 0.1 N/cm^2 over that with an arteriole that stays. [1]

    It is 1 / (1 - G) of the loop gain G, and 1 once the vein is blocked: then nothing flows.
    """
    first, last = (r.pressure[..., i] for i in (0, _at(0.1)))
    bed, vein = (last - first)[0], (last - first)[2]
    return bed / np.maximum(vein * (1.0 - (first[0] - first[2]) / (1.0 - first[2])), _TINY)


def _outflow(r: Responses) -> np.ndarray:
    """What flows out through the vein at 1 N/cm^2 over that at rest, from the proximal bed's part of it. [1]"""
    flow = r.proximal[0] ** 4 * (1.0 - r.pressure[0])
    return np.asarray(flow[..., _at(1.0)] / flow[..., 0])


def _change_by(r: Responses, force_n: float) -> np.ndarray:
    """Mean change of the blood of the bed's rear half under an even touch, relative to rest. [1]"""
    return np.asarray(r.even[:4, ..., _touch(force_n)].mean(axis=0) - 1.0)


def _touch(force_n: float) -> int:
    return int(np.argmin(np.abs(EVEN_N - force_n)))


def _band(r: Responses, *forces_n: float) -> np.ndarray:
    """Width of the white band under even touches, over the bed's length, (*B, forces). [1]"""
    blood = np.moveaxis(r.even[..., [_touch(force) for force in forces_n]], 0, -2)
    return white_band_mm(FINGER_ZONES.position, blood, ends_mm=(0.0, 1.0))


def _varies_more(change: np.ndarray) -> np.ndarray:
    """Relative range over people of the proximal change to 2 N (P, 2, ...) over that of the distal one. [1]"""
    size = np.abs(change)
    spread = np.ptp(size, axis=0) / np.maximum(size.mean(axis=0), _TINY)
    return np.asarray(spread[0] / np.maximum(spread[1], 1e-6))


# What is measured, by its name in assets/paper_claims.toml, which has the sentences and the bounds.
MEASURES: dict[str, Callable[[Responses], np.ndarray]] = {
    "vein_node_pressure": lambda r: r.pressure[2, ..., 0],
    "pressure_magnification": _magnification,
    "vein_outflow": _outflow,
    "capillary_step": lambda r: _smallest_step(r.proximal[0]),
    "vein_step": lambda r: _smallest_step(-r.proximal[2]),
    "proximal_growth": lambda r: r.alone[0][..., _at(1.0)] - 1.0,
    "capillary_off_chord": lambda r: _off_chord(r.proximal[0]),
    "capillary_slower_at_low_pressure": lambda r: (
        _time_constant(r.proximal_on[0][..., 0, :]) / _time_constant(r.proximal_on[0][..., -1, :])
    ),
    "capillary_release_over_loading": lambda r: _release_over_loading(r.proximal_on[0], r.proximal_off[0]),
    "vein_time_difference": lambda r: np.abs(
        _release_time(r.proximal_on[2], r.proximal_off[2]) - _time_constant(r.proximal_on[2])
    ).max(axis=-1),
    "vein_overshoot": lambda r: _overshoot(r.proximal_on[2], r.proximal_off[2]),
    "proximal_step": lambda r: _smallest_step(r.both[0]),
    "distal_step": lambda r: _smallest_step(-r.both[1]),
    "proximal_overshoot": lambda r: _overshoot(r.both_on[0], r.both_off[0]),
    "distal_overshoot": lambda r: _overshoot(r.both_on[1], r.both_off[1]),
    "proximal_off_chord": lambda r: _off_chord(r.both[0]),
    "distal_off_chord": lambda r: _off_chord(r.both[1]),
    "distal_release_over_loading": lambda r: _release_over_loading(r.both_on[1], r.both_off[1]),
    "v_p1_off_chord": lambda r: _off_chord(r.alone[0], end=0.9),
    "v_p1_level": lambda r: _level_from(r.alone[0]),
    "v_p2_steeper_at_first": lambda r: 9.0 * _change_over(-r.alone[1], (0.0, 0.1), (0.1, 1.0)),
    "v_p2_off_chord": lambda r: _off_chord(r.alone[1], start=0.1),
    "v_p2_level": lambda r: _level_from(r.alone[1]),
    "proximal_cycle_off_chord": lambda r: _off_chord(r.cycle[0].mean(axis=-2)),
    "proximal_past_the_knee": lambda r: _past_the_knee(r.cycle[0].mean(axis=-2)),
    "proximal_loading_time": lambda r: _time_constant(r.press_on[0]),
    "proximal_unloading_time": lambda r: _release_time(r.press_on[0], r.press_off[0]),
    "distal_cycle_off_chord": lambda r: _off_chord(r.cycle[1].mean(axis=-2)),
    "distal_late_slope": lambda r: _change_over(r.cycle[1].mean(axis=-2), (1.2, 2.0), (0.0, 1.0)) / 0.8,
    "distal_loading_time": lambda r: _time_constant(r.press_on[1]),
    "distal_unloading_time": lambda r: _release_time(r.press_on[1], r.press_off[1]),
    "spread_over_stiffness": lambda r: _varies_more(r.people - 1.0),
    "threshold": lambda r: _change_by(r, 0.3) / np.maximum(_change_by(r, 1.0), _TINY),
    "least_change": lambda r: r.even[..., _touch(1.0)].min(axis=0) - 1.0,
    "band_at_1_n": lambda r: _band(r, 1.0)[..., 0],
    "band_growth": lambda r: np.ptp(_band(r, 1.0, 4.0), axis=-1),
    "band_smallest_growth": lambda r: np.diff(_band(r, 1.0, 2.0, 3.0, 4.0), axis=-1).min(axis=-1),
    "band_growth_past_4_n": lambda r: np.diff(_band(r, 4.0, 16.0), axis=-1)[..., 0],
    "rear_change": lambda r: (r.even[:4, ..., _touch(1.0) : -1] - r.even[:4, ..., [_touch(1.0)]]).min(axis=(0, -1)),
    "shear_over_normal": lambda r: (
        (r.even[-1][..., SHEARED] - r.even[-1][..., -1])
        / np.maximum(r.even[-1][..., SHEARED] - r.even[-1][..., SHEARED + 1], _TINY)
    ),
}
PEOPLE_MEASURES: dict[str, Callable[[PeopleReadings], np.ndarray]] = {
    "people_who_rise": lambda r: _past_the_knee(r.cycle[0].mean(axis=-2)) >= _SLIGHT_RISE,
    "spread_over_people": lambda r: _varies_more(r.cycle[..., 0, -1].T),
    "skin_effect": lambda r: np.abs(r.skin_effect).max(axis=(0, 2)),
}


def _rules(measures: Mapping[str, Callable[[Any], np.ndarray]]) -> tuple[Rule, ...]:
    """The rules of some measures, in the order of the file."""
    return tuple(
        Rule(statement["figure"], statement["sentence"], measure=measures[name], **bounds)
        for statement in read_toml("paper_claims.toml")["statements"]
        for name, bounds in statement["measures"].items()
        if name in measures
    )


RULES = _rules(MEASURES)
# Those of people, evaluated by their mean; how the paper's subjects vary is measured on them.
_OF_SETS_ALONE = MEASURES["spread_over_stiffness"]
_READINGS = tuple(rule for rule in RULES if rule.figure in ("15", "16", "17", "18") and rule.measure != _OF_SETS_ALONE)
PEOPLE_RULES = _READINGS + _rules(PEOPLE_MEASURES)


@dataclasses.dataclass(frozen=True)
class Claim:
    """One rule, evaluated on one set or on people.

    value : measured, in the rule's unit. half_95 : half of its 95 % interval over people.
    """

    rule: Rule
    value: float
    half_95: float | None = None

    @property
    def met(self) -> bool:
        """Whether the value lies within the bounds."""
        return self.rule.low <= self.value <= self.rule.high


def evaluate(responses: Responses, name: str = "") -> list[Claim]:
    """The rules, measured on the responses of one set: all, or of a set that only some apply to, those."""
    return [Claim(rule, float(rule.measure(responses))) for rule in RULES if is_shown_by(name, rule.figure)]


def evaluate_people(readings: PeopleReadings) -> list[Claim]:
    """The rules for people, each with its mean over them, whose interval is that of the jackknife."""
    count, claims = readings.cycle.shape[1], []
    for rule in PEOPLE_RULES:
        groups = (readings, *(readings.without(person) for person in range(count)))
        values = np.array([np.mean(rule.measure(group)) for group in groups])
        claims.append(Claim(rule, float(values[0]), t95(count) * float(jackknife(values))))
    return claims


def as_rows(claims_by_set: Mapping[str, list[Claim]]) -> list[dict[str, Any]]:
    """Claims as plain rows: one for each rule, with value and verdict of each set that it applies to."""
    claims = {(name, claim.rule): claim for name, claims in claims_by_set.items() for claim in claims}
    rows = []
    for rule in dict.fromkeys((*RULES, *PEOPLE_RULES)):
        row = {"figure": rule.figure, "sentence": rule.sentence, "measure": rule.text, "unit": rule.unit}
        number = f"the sentence gives {rule.given}, the tolerance is our choice" if rule.given else "our choice"
        bounds = f"<= {rule.high:.3g}" if math.isinf(rule.low) else f"{rule.low:.3g} to {rule.high:.3g}"
        bounds = f">= {rule.low:.3g}" if math.isinf(rule.high) else bounds
        row |= {"rule": bounds, "number": number, "applies_to": rule.applies_to}
        of_rule = {name: claims[name, rule] for name in claims_by_set if (name, rule) in claims}
        sets = {name: {"value": one.value, "half_95": one.half_95, "met": one.met} for name, one in of_rule.items()}
        rows.append(row | {"sets": sets})
    return [row for row in rows if row["sets"]]
