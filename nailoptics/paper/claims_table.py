"""The table of the paper's claims: each measured on each parameter set, met or not met.

With two zones a set whose vein closes near 1 N cannot show a proximal reading that rises late: once the vein is closed
nothing that the distal half does reaches it. Nor can its distal reading go on rising once that zone is closed. Eight
zones (``zones`` with a decay length) show both.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping

import numpy as np

from ..hemodynamics.parameters import NAMES, Parameters, parameters
from ..hemodynamics.zones import PAPER_ZONES, Zones, zones
from .claims import RULES
from .protocols import static_readings
from .responses import N_PER_CM2, observe

REACH = 0.15
"""Decay length of the distal pressure with eight zones: the white band takes a part of the bed at 4 N, not all. [1]"""


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
    """Return every claim, measured on one set."""
    seen = observe(set_of_parameters)
    claims = [
        Claim(rule.figure, rule.text, rule.unit, float(rule.measure(seen)), rule.low, rule.high) for rule in RULES
    ]
    return claims + _band(set_of_parameters)


def table(sets: Mapping[str, Parameters] | Iterable[str] = NAMES) -> dict[str, list[Claim]]:
    """Return the judged claims of several sets, by name: named ones, or any given with their names."""
    if isinstance(sets, Mapping):
        return {name: judge(values) for name, values in sets.items()}
    return {name: judge(parameters(name)) for name in sets}


def as_rows(judged: Mapping[str, list[Claim]]) -> list[dict[str, object]]:
    """Return the table as plain rows: one for each claim, with value and verdict of each set."""
    rows: list[dict[str, object]] = []
    for same in zip(*judged.values(), strict=True):
        first = same[0]
        rows.append(
            {
                "figure": first.figure,
                "claim": first.text,
                "rule": first.rule,
                "unit": first.unit,
                "sets": {
                    name: {"value": claim.value, "met": claim.met} for name, claim in zip(judged, same, strict=True)
                },
            }
        )
    return rows


def as_text(judged: Mapping[str, list[Claim]]) -> str:
    """Return the table as text: the measured value for each set, and whether it meets the claim."""
    rows = as_rows(judged)
    claim_width = max(len(str(row["claim"])) for row in rows)
    rule_width = max(len(str(row["rule"])) for row in rows)
    width = max(18, *(len(name) + 1 for name in judged))
    lines = [f"{'fig.':<6} {'claim':<{claim_width}} {'rule':<{rule_width}} " + "".join(f"{n:>{width}}" for n in judged)]
    for row in rows:
        cells = ""
        for verdict in row["sets"].values():  # type: ignore[attr-defined]
            told = "met    " if verdict["met"] else "not met"
            cells += f"{format(verdict['value'] or 0.0, '.3g') + ' ' + told:>{width}}"
        lines.append(f"{row['figure']:<6} {row['claim']:<{claim_width}} {row['rule']:<{rule_width}} {cells}")
    met = "".join(f"{sum(claim.met for claim in claims):>{width}}" for claims in judged.values())
    lines.append(f"{'':<6} {'claims met of ' + str(len(rows)):<{claim_width}} {'':<{rule_width}} {met}")
    return "\n".join(lines)


def band_width(set_of_parameters: Parameters, force_n: np.ndarray, *, cut: Zones) -> np.ndarray:
    """Return the part of the bed, (S,) float, that holds less than half of its blood at rest. [1]"""
    from ..hemodynamics.steady import steady_state

    touch = force_n * N_PER_CM2
    state = steady_state(set_of_parameters, proximal_pressure_pa=touch, distal_pressure_pa=touch, zones=cut)
    rest = steady_state(set_of_parameters, zones=cut).capillary_diameter_m
    white = (state.capillary_diameter_m / rest[:, None]) ** 2 < 0.5
    return np.asarray(cut.share) @ white / sum(cut.share)


def _band(p: Parameters) -> list[Claim]:
    """Claims about force past 1 N, with two zones and with eight that the distal pressure reaches in part."""
    claims = []
    force = np.linspace(0.0, 4.0, 81)
    inf = math.inf
    for label, cut in (("two zones", PAPER_ZONES), ("eight zones", zones(8, decay_length=REACH))):
        proximal, distal = static_readings(p, force * N_PER_CM2, zones=cut)
        one, knee, two = (int(np.searchsorted(force, f - 1e-9)) for f in (1.0, 1.2, 2.0))
        slope = (distal[-1] - distal[two]) / 2.0 / ((distal[one] - distal[0]) / 1.0)
        white = band_width(p, np.array([1.0, 4.0]), cut=cut)
        late = (proximal[-1] - proximal[knee]) / abs(proximal[knee])
        claims += [
            Claim("15-18", f"{label}: distal slope past 1 N is small and positive (2 to 4 N over 0 to 1 N)", "1",
                  float(slope), 0.005, 0.3),
            Claim("15-18", f"{label}: the white band widens from 1 to 4 N (growth, of the bed)", "1",
                  float(white[1] - white[0]), 0.1, inf),
            Claim("15-18", f"{label}: the proximal reading rises late (1.2 to 4 N, of its fall)", "1",
                  float(late), 0.01, inf),
        ]  # fmt: skip
    return claims
