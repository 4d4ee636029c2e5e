"""The table of the paper's claims: what each sentence says, how it is measured, and whether each set meets it."""

import dataclasses
import math
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from .claims import RULES, Rule
from .responses import Responses


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
