"""The page of an explanation: by how much every effect and every unknown changes the readings."""

import math
from typing import Any

import numpy as np

from ...statistics import Z95
from ...studies.model_error.explain import Effect, Explanation, lines_of, merged
from .. import style
from ..files import Report, scene_text
from ..html import document, figure, preformatted, section, small, table, texts
from ..numbers import aligned, significant, with_error

TEXTS = texts("explain")
# What the axis shows of changes, and the height of a row of the figure. [%, inch]
LEAST, MOST, ROW_IN = 1e-3, 1e3, 0.24
KINDS = {"unknown of the finger": style.VEIN, "in the scene": style.ZONES[0], "left out": style.ZONES[1]}


def page(result: Explanation) -> str:
    """The page of an explanation."""
    known = [effect for effect in result.effects if math.isfinite(effect.change)]
    required = [part for text, lines in _requires(result) for part in (text, preformatted(lines) if lines else "")]
    drawing = figure(draw(result), TEXTS["caption"]) if known else ""
    effects = table(_rows(result), kind="effects dense")
    return document(
        kicker="effects on the readings",
        title=_title(known),
        lead=TEXTS["lead"].format(len(result.effects), 100 * result.tolerance),
        body=[
            section("Effects on the readings", drawing, effects, small(TEXTS["note"])),
            section("What the scene requires", *required),
        ],
        attributes=result.attributes,
    )


def _title(known: list[Effect]) -> str:
    """The largest effect on a reading; of those that certainly matter, where any does."""
    if not known:
        return "Too few photons to rank the effects on the readings"
    largest = next((effect for effect in known if effect.matters == "yes"), known[0])
    what, where = ("the signal" if largest.of == "signal" else "the reading"), largest.photodiode.split(" on ", 1)
    name, of = largest.name[:1].upper() + largest.name[1:], " on photodiode ".join(where)
    return f"{name} ({largest.changed_to}): {what} of LED {of} changes by {_change(largest)}\u00a0%"


def _change(effect: Effect) -> str:
    return with_error(100 * effect.change, 100 * effect.stderr, sign=True)


@style.drawing()
def draw(result: Explanation) -> "style.Figure":
    """Every effect's change of a reading on a logarithmic axis, the largest first."""
    shown = [effect for effect in result.effects if math.isfinite(effect.change) and effect.bound > 0]
    drawing, axes = style.panels(9.0, 1.0 + ROW_IN * len(shown))
    kinds = [0 if effect.unknown else 1 if effect.modelled else 2 for effect in shown]
    for number, (kind, colour) in enumerate(KINDS.items()):
        rows = [row for row, own in enumerate(kinds) if own == number]
        effects = [(abs(shown[row].change), shown[row].stderr, shown[row].bound) for row in rows]
        change, stderr, bound = 100 * np.array(effects).reshape(-1, 3).T
        low, high = np.maximum(change - Z95 * stderr, LEAST), change + Z95 * stderr
        axes.hlines(rows, low, high, colors=colour, lw=2.2)
        axes.hlines(rows, high, bound, colors=colour, lw=0.8, alpha=0.5)
        axes.plot(bound, rows, "|", color=colour, ms=9, mew=1.6)
        axes.plot(change, rows, "o", color=colour, ms=5, label=kind)
    axes.axvline(100 * result.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)))
    axes.set(xscale="log", xlim=(LEAST, MOST), xlabel="change of a reading [%]")
    style.plain_log(axes.xaxis)
    style.named_rows(axes, [effect.name for effect in shown])
    axes.grid(axis="y", visible=False)
    axes.legend(loc="lower right", frameon=True, facecolor=style.PAPER, edgecolor="none", framealpha=0.9)
    return drawing


def _rows(result: Explanation) -> list[dict[str, str]]:
    """All effects, the largest first, and that of leaving out all that is not needed, on the page and the terminal."""
    rows = []
    for effect in (*result.effects, *([result.together] if result.together else [])):
        known = math.isfinite(effect.change)
        of = effect.photodiode + (" (signal)" if effect.of == "signal" else "")
        signal = "–" if effect.modulation_bound is None else significant(100 * effect.modulation_bound, 2)
        row = {"Effect": effect.name, "Changed to": effect.changed_to}
        row |= {"In scene": "unknown" if effect.unknown else "yes" if effect.modelled else "no"}
        row |= {"Change of reading [%]": _change(effect) if known else "not known", "of": of if known else "–"}
        row["Upper bound [%]"] = significant(100 * effect.bound, 2) if math.isfinite(effect.bound) else "–"
        row |= {"Signal, upper bound [%]": signal, "Matters": effect.matters}
        rows.append(row)
    return rows


def _requires(result: Explanation) -> list[tuple[str, str]]:
    """What can be left out, what is missing, and what needs more photons: sentences, and lines of a scene with them."""
    out = [("All that the scene models matters, or may matter.", "")]
    if result.needless:
        lines = "\n".join(lines_of(merged(result.needless)))
        out = [("Not needed, each by itself; these lines leave all of it out:", lines)]
    if result.together:
        most = significant(100 * result.together.bound, 2)
        out.append((f"Leaving all of it out at once changes no reading by more than {most} % (95 % confidence).", ""))
    if result.missing:
        names = (effect.name + (" (of the signal)" if effect.of == "signal" else "") for effect in result.missing)
        out.append((f"Left out, though it matters: {', '.join(names)}.", ""))
    if unsure := [effect.name for effect in result.effects if effect.matters == "undecided"]:
        out.append((f"Undecided, more photons are needed: {', '.join(unsure)}.", ""))
    return out


def summary(result: Explanation) -> dict[str, Any]:
    """Everything, ready for JSON."""
    made = {name: getattr(result, name) for name in ("tolerance", "photons", "backend", "wall_seconds")}
    names = {"not_needed": result.needless, "missing": result.missing}
    made |= {key: [effect.name for effect in effects] for key, effects in names.items()}
    made |= {"together": result.together and _effect(result.together), "cut_off": result.attributes.get("cut_off")}
    return {"effects": [_effect(effect) for effect in result.effects]} | made


def _effect(effect: Effect) -> dict[str, Any]:
    return vars(effect) | {"matters": effect.matters, "lines": lines_of(effect.changes)}


def lines(result: Explanation) -> list[str]:
    """The table of effects and what the scene requires, for the terminal."""
    matter = f"Changes of a reading by more than {100 * result.tolerance:g} % matter."
    out = [matter, *aligned(_rows(result)), TEXTS["note"]]
    for text, scene_lines in _requires(result):
        out += [text, *(f"  {line}" for line in scene_lines.splitlines())]
    return out


EXPLANATION = Report(
    ("required.toml", "required.html"),
    page,
    summary,
    lambda result, _: lines(result),
    {"effects": draw},
    lambda result: {"required.toml": scene_text(result.required, result.attributes)},
    lambda result: result.required,
)
