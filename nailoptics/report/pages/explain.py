"""The page of an explanation: by how much every effect and every unknown changes the readings."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...io import write_text
from ...statistics import Z95
from ...studies.model_error.effect import Effect
from ...studies.model_error.explain import Explanation, name_of
from ...studies.model_error.variants import lines_of
from .. import style
from ..html import document, escaped, figure, section, small, table
from ..numbers import significant, with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# What the axis shows of changes, and the height of a row of the figure. [%, inch]
LEAST, MOST, ROW_IN = 1e-3, 1e3, 0.24
KINDS = {
    "unknown of the finger": style.VEIN,
    "in the scene": style.ZONES[0],
    "left out": style.ZONES[1],
}
CAPTION = (
    "How far each effect moves the reading of the photodiode that it surely moves most (dot, with its 95 % interval), "
    "and what it moves no reading more than (tick, 95 % sure). Dotted: the change that matters."
)
NOTE = (
    "Reading moves: the photodiode that is surely moved most, ± its standard error. At most: what no photodiode's "
    "reading exceeds, and signal, the same for its change by touch as a part of the largest change, with 95 % "
    "confidence each. (signal): it leaves the reading at rest as it is, and is judged by the signal. What is unknown "
    "of the finger stands at the farther end of its range."
)


def write_explanation_page(found: Explanation, path: Path) -> None:
    """Write the page, whole or not at all; raises WriteError."""
    known = [one for one in found.effects if math.isfinite(one.change)]
    text = document(
        kicker="what moves the readings",
        title=_title(known),
        lead=f"Each of {len(found.effects)} parts, effects and unknowns of the finger was changed by itself, with the "
        f"same random numbers. Changes of a reading by more than {100 * found.tolerance:g} % matter.",
        cards=_cards(found, known),
        body=[
            section("What moves the readings", figure(draw(found), "effects", CAPTION) if known else "", _table(found)),
            section("What the scene requires", *_requires(found)),
        ],
        attributes=found.attributes,
    )
    write_text(path, text)


def _title(known: list[Effect]) -> str:
    """The effect that moves a reading most; of what surely matters, where anything does."""
    if not known:
        return "Too few photons were seen to tell what moves the readings"
    largest = next((one for one in known if one.matters == "yes"), known[0])
    what = "the signal of " if largest.of == "signal" else ""
    return f"{largest.name} moves {what}{largest.photodiode} by {_moved(largest)}\u00a0%"


def _moved(one: Effect) -> str:
    return with_error(100 * one.change, 100 * one.stderr, sign=True)


def _cards(found: Explanation, known: list[Effect]) -> list[tuple[str, str]]:
    """The largest of each kind, and what leaving out all that is not needed does."""
    cards = []
    for kind in KINDS:
        if ofkind := [one for one in known if _kind(one) == kind]:
            one = ofkind[0]
            cards.append((f"{_moved(one)} %", f"{one.name}, the largest {kind}: on {one.photodiode}"))
    if found.together:
        words = "at most, on any reading, with all left out at once that is not needed"
        cards.append((f"{significant(100 * found.together.bound, 2)} %", words))
    return cards


def _kind(one: Effect) -> str:
    """What an effect is: unknown, modelled, or left out."""
    unknown, modelled, left_out = KINDS
    return unknown if one.unknown else modelled if one.modelled else left_out


@style.drawing()
def draw(found: Explanation) -> "Figure":
    """Every effect's change of a reading on a logarithmic axis, most moving first."""
    shown = [one for one in found.effects if math.isfinite(one.change) and one.bound > 0]
    drawing, axes = style.panels(9.0, 1.0 + ROW_IN * len(shown))
    for row, one in enumerate(shown):
        colour, change, spread = KINDS[_kind(one)], 100 * abs(one.change), 100 * Z95 * one.stderr
        ends = np.clip([change - spread, change + spread, 100 * one.bound], LEAST, MOST)
        axes.plot(ends[:2], [row, row], color=colour, lw=2.2, solid_capstyle="butt")
        axes.plot(ends[[1, 2]], [row, row], color=colour, lw=0.8, alpha=0.5)
        axes.plot(ends[2], row, "|", color=colour, ms=9, mew=1.6)
        if change > LEAST:
            axes.plot(change, row, "o", color=colour, ms=5)
    axes.axvline(100 * found.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)))
    axes.set(xscale="log", xlim=(LEAST, MOST), ylim=(len(shown) - 0.4, -0.6), xlabel="change of a reading [%]")
    style.plain_log(axes.xaxis)
    axes.set_yticks(range(len(shown)), [style.plain(one.name) for one in shown])
    axes.grid(axis="y", visible=False)
    for kind, colour in KINDS.items():
        axes.plot([], [], "o", color=colour, ms=5, label=kind)
    axes.legend(loc="lower right", frameon=True, facecolor=style.PAPER, edgecolor="none", framealpha=0.9)
    return drawing


def _table(found: Explanation) -> str:
    """All effects, most moving first."""
    head = ["Effect", "In scene", "Reading moves<br>[%]", "of", "At most<br>[%]", "Signal at most<br>[%]"]
    rows = [_row(one) for one in (*found.effects, *([found.together] if found.together else []))]
    return table([*head, "Matters", "Changed to"], rows, kind="effects dense") + small(NOTE)


def _row(one: Effect) -> list[str]:
    known = math.isfinite(one.change)
    signal = "–" if one.modulation_bound is None else significant(100 * one.modulation_bound, 2)
    of = escaped(one.photodiode) + (" (signal)" if one.of == "signal" else "")
    told = [_moved(one), of] if known else ["not known", "–"]
    modelled = "unknown" if one.unknown else "yes" if one.modelled else "no"
    most = significant(100 * one.bound, 2) if math.isfinite(one.bound) else "–"
    return [escaped(one.name), modelled, *told, most, signal, one.matters, escaped(one.changed_to)]


def _requires(found: Explanation) -> list[str]:
    """What can be left out, what is missing, and what more photons would tell."""
    out = ["<p>All that the scene models matters, or may matter.</p>"]
    if found.needless:
        lines = "\n".join(escaped(line) for line in lines_of(found.without_needless))
        out = [f"<p>Not needed, each by itself; these lines leave all of it out:</p><pre>{lines}</pre>"]
    if found.together:
        most = significant(100 * found.together.bound, 2)
        out.append(f"<p>Leaving all of it out at once moves no reading by more than {most} %, 95 % sure.</p>")
    if found.missing:
        names = escaped(", ".join(map(name_of, found.missing)))
        out.append(f"<p>Left out, though it matters: {names}.</p>")
    if unsure := [one.name for one in found.effects if one.matters == "cannot tell"]:
        out.append(f"<p>More photons are needed to tell whether these matter: {escaped(', '.join(unsure))}.</p>")
    return out
