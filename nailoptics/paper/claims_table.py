"""The table of the paper's claims: each measured on each parameter set, met or not met.

With two zones a set whose vein closes near 1 N cannot show a proximal reading that rises late: once the vein is closed
nothing that the distal half does reaches it. Nor can its distal reading go on rising once that zone is closed. Eight
zones (`zones` with a decay length) show both.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..hemodynamics.parameters import NAMES, Parameters, parameters
from ..hemodynamics.steady import steady_state
from ..hemodynamics.zones import PAPER_ZONES, Zones, zones
from .claims import RULES
from .protocols import static_readings
from .responses import N_PER_CM2, simulate_responses

# Decay length of the distal pressure with eight zones, in lengths of the bed: the white band takes a part of the bed at
# 4 N, not all. [1]
DECAY_LENGTH = 0.15


@dataclasses.dataclass(frozen=True)
class Claim:
    """One claim of a figure, judged on one set.

    figure : of the paper. text : what it says. unit : of value. value : measured. low, high : bounds of the rule.
    """

    figure: str
    text: str
    unit: str
    value: float
    low: float
    high: float

    @property
    def met(self) -> bool:
        """Whether the value lies within the bounds."""
        return self.low <= self.value <= self.high

    @property
    def rule(self) -> str:
        """The bounds in words."""
        if math.isinf(self.high):
            return f">= {self.low:.3g}"
        if math.isinf(self.low):
            return f"<= {self.high:.3g}"
        return f"{self.low:.3g} to {self.high:.3g}"


def judge(set_of_parameters: Parameters) -> list[Claim]:
    """Every claim, measured on one set."""
    responses = simulate_responses(set_of_parameters)
    claims = [Claim(r.figure, r.text, r.unit, float(r.measure(responses)), r.low, r.high) for r in RULES]
    claims += _past_1_n("two zones", set_of_parameters, PAPER_ZONES)
    return claims + _past_1_n("eight zones", set_of_parameters, zones(8, decay_length=DECAY_LENGTH))


def table(sets: Mapping[str, Parameters] | Iterable[str] = NAMES) -> dict[str, list[Claim]]:
    """The judged claims of several sets, by name: named ones, or any given with their names."""
    if isinstance(sets, Mapping):
        return {name: judge(values) for name, values in sets.items()}
    return {name: judge(parameters(name)) for name in sets}


def as_rows(judged: Mapping[str, list[Claim]]) -> list[dict[str, Any]]:
    """The table as plain rows: one for each claim, with value and verdict of each set."""
    rows = []
    for same in zip(*judged.values(), strict=True):
        sets = {name: {"value": claim.value, "met": claim.met} for name, claim in zip(judged, same, strict=True)}
        first = same[0]
        rows.append({"figure": first.figure, "claim": first.text, "rule": first.rule, "unit": first.unit, "sets": sets})
    return rows


def as_text(judged: Mapping[str, list[Claim]]) -> str:
    """The table as text: the measured value for each set, and whether it meets the claim."""
    rows = as_rows(judged)
    claim_width, rule_width = (max(len(row[column]) for row in rows) for column in ("claim", "rule"))
    width = max(18, *(len(name) + 1 for name in judged))

    def line(figure: str, claim: str, rule: str, cells: Iterable[object]) -> str:
        start = f"{figure:<6} {claim:<{claim_width}} {rule:<{rule_width}} "
        return start + "".join(f"{cell!s:>{width}}" for cell in cells)

    lines = [line("fig.", "claim", "rule", judged)]
    for row in rows:
        # A negative zero reads as 0.
        cells = [f"{s['value'] or 0.0:.3g} {'met    ' if s['met'] else 'not met'}" for s in row["sets"].values()]
        lines.append(line(row["figure"], row["claim"], row["rule"], cells))
    met = [sum(claim.met for claim in claims) for claims in judged.values()]
    return "\n".join([*lines, line("", f"claims met of {len(rows)}", "", met)])


def white_band(set_of_parameters: Parameters, force_n: np.ndarray, *, cut: Zones) -> np.ndarray:
    """The part of the bed, (S,) float, that holds less than half of its blood at rest under an even touch. [1]"""
    touch = force_n * N_PER_CM2
    state = steady_state(set_of_parameters, proximal_pressure_pa=touch, distal_pressure_pa=touch, zones=cut)
    rest = steady_state(set_of_parameters, zones=cut).capillary_diameter_m
    white = (state.capillary_diameter_m / rest[:, None]) ** 2 < 0.5
    return np.asarray(cut.share) @ white / sum(cut.share)


def _past_1_n(label: str, p: Parameters, cut: Zones) -> list[Claim]:
    """Claims about an even touch of more than 1 N on 1 cm^2."""
    force = np.linspace(0.0, 4.0, 81)
    proximal, distal = static_readings(p, force * N_PER_CM2, zones=cut)
    one, knee, two = (int(np.searchsorted(force, f - 1e-9)) for f in (1.0, 1.2, 2.0))
    slope = (distal[-1] - distal[two]) / 2.0 / ((distal[one] - distal[0]) / 1.0)
    white = white_band(p, np.array([1.0, 4.0]), cut=cut)
    late = (proximal[-1] - proximal[knee]) / abs(proximal[knee])
    measured = (
        ("distal slope past 1 N is small and positive (2 to 4 N over 0 to 1 N)", slope, 0.005, 0.3),
        ("the white band widens from 1 to 4 N (growth, of the bed)", white[1] - white[0], 0.1, math.inf),
        ("the proximal reading rises late (1.2 to 4 N, of its fall)", late, 0.01, math.inf),
    )
    return [Claim("15-18", f"{label}: {text}", "1", float(value), *limits) for text, value, *limits in measured]
