"""The page and the picture of a tradeoff: error of each level of model against what it costs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..io import write_text
from ..statistics import Z95
from ..studies.model_error.levels import REFERENCE, STATES, TARGETS, Bias, Level
from ..studies.model_error.tradeoff import Tradeoff
from . import style
from .html import document, escaped, figure, section, small, table
from .numbers import significant, with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR_PERCENT = 0.01
# Marks that lie closer than so many decades have one label.
NEAR = 0.05


def write_tradeoff(found: Tradeoff, path: Path) -> None:
    """Write the page, whole or not at all; raises WriteError."""
    choice = found.choice
    reference = next(one for one in found.levels if one.name == REFERENCE)
    gain = reference.cpu_seconds[0] / choice.cpu_seconds[0]
    lines = "<br>".join(escaped(line) for line in choice.lines) or "none: the scene is so already"
    cards = [
        (choice.name, f"the cheapest level that provably keeps every reading within {100 * found.tolerance:g} %"),
        (f"{significant(choice.cpu_seconds[0], 2)} s", "of processor time to 1 % on the worst photodiode"),
        (f"{significant(gain, 2)} ×", "as fast as the full model"),
    ]
    body = section(
        "Error against cost",
        figure(
            draw(found),
            "pareto",
            "Each level of model: error against the full model, and processor time to 1 % on the worst photodiode; "
            "left of the reading at rest, right of its change by touch, as a part of the largest change. Marks are "
            "means over the photodiodes with 95 % intervals; the thin line goes up to what no photodiode exceeds. "
            "Filled: provably within the tolerance. Dashed: the Pareto front. "
            f"Errors below {FLOOR_PERCENT:g} % are drawn there.",
        ),
        _table(found),
        f"<p>Scene lines that select it: <code>{lines}</code></p>",
        small(
            "(9) and (8) take their constants from the full trace: at rest they are right by construction, and they "
            "cost what it costs. Memory is that of the photons kept for 1 %. A level counts as cheaper than the full "
            "model only beyond the noise of its cost."
        ),
        "<h3>Number of batches</h3>",
        table(
            ["Photons in a batch", "Processor time per million photons [s]"],
            [[f"{photons:,}", significant(seconds, 3)] for photons, seconds in found.batches.items()],
        ),
    )
    text = document(
        kicker="speed against accuracy",
        title=f"Within {100 * found.tolerance:g} %: {choice.name}",
        lead=f"Every level of model on this scene, against the full one, in {found.wall_seconds:.0f} s.",
        cards=cards,
        body=[body],
        attributes=found.attributes,
    )
    write_text(path, text)


@style.drawing()
def draw(found: Tradeoff) -> "Figure":
    """Error of every level against processor time to 1 %, of the reading with the Pareto front, and of the signal."""
    from matplotlib.ticker import LogLocator

    drawing, (left, right) = style.panels(11.0, 4.6, 1, 2, sharey=True, width_ratios=[1.3, 1])
    seconds, errors = zip(*((one.cpu_seconds[0], _height(one.reading)) for one in found.front), strict=True)
    left.step(seconds, errors, where="post", color=style.MUTED, lw=1.2, ls=(0, (4, 2)), zorder=1)
    left.set(yscale="log", ylim=(0.6 * FLOOR_PERCENT, 200), ylabel="error [%]")
    left.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    for axes, which, title in ((left, "reading", "Reading at rest"), (right, "signal", "Signal by touch")):
        known = _known(found, which)
        low, high = min(one.cpu_seconds[0] for one, _ in known) / 2, max(one.cpu_seconds[0] for one, _ in known) * 2
        # The names want room at the right.
        axes.set(title=title, xscale="log", xlim=(low, high * (high / low) ** 0.45))
        axes.axhline(100 * found.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)), zorder=1)
        axes.set_xlabel("processor time to 1 % on the worst photodiode [s]")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}" if value >= 1 else f"{value:g}")
        narrow = np.ptp(np.log10(axes.get_xlim())) < 2
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,)))
        axes.xaxis.set_minor_formatter("")
        _marks(axes, known, found.chosen)
        _labels(axes, known, found.chosen)
    percent = f"{100 * found.tolerance:g} %"
    where = {"transform": right.get_yaxis_transform(), "ha": "right"}
    right.text(0.995, 112 * found.tolerance, f"tolerance {percent}", fontsize=8.5, **where)
    words = f"Cheapest that provably keeps every reading within {percent}: {style.plain(found.chosen)}"
    drawing.suptitle(words, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
    return drawing


def _known(found: Tradeoff, which: str) -> list[tuple[Level, Bias]]:
    """Levels with their bias of the reading or the signal, where that and their cost are known."""
    pairs = [(one, one.reading if which == "reading" else one.signal) for one in found.levels]
    return [(one, b) for one, b in pairs if b and np.isfinite(b.value) and np.isfinite(one.cpu_seconds[0])]


def _marks(axes: Any, known: list[tuple[Level, Bias]], chosen: str) -> None:
    # What is proven lies on top of what is not.
    for one, bias in sorted(known, key=lambda pair: (pair[0].proven, pair[0].name == chosen)):
        height, spread, x = _height(bias), 100 * Z95 * bias.stderr, one.cpu_seconds[0]
        colour = style.ZONES[1] if one.proven else style.ZONES[0]
        axes.plot([x, x], [height, max(100 * bias.bound, height)], color=colour, lw=0.7, alpha=0.6)
        axes.plot([x, x], [max(height - spread, FLOOR_PERCENT), height + spread], color=colour, lw=2.2, alpha=0.5)
        face, size = colour if one.proven else style.PAPER, 11 if one.name == chosen else 7
        axes.plot(x, height, "o", ms=size, color=colour, markerfacecolor=face, zorder=3)


def _labels(axes: Any, known: list[tuple[Level, Bias]], chosen: str) -> None:
    """Names beside the marks; those of one mark together, those of near ones one below the other."""
    names: dict[tuple[float, float], list[str]] = {}
    for one, bias in sorted(known, key=lambda pair: pair[0].name != chosen):
        x, y = one.cpu_seconds[0], _height(bias)
        near = (mark for mark in names if abs(np.log10(mark[0] / x)) < NEAR and abs(np.log10(mark[1] / y)) < NEAR)
        names.setdefault(next(near, (x, y)), []).append(one.name)
    order = sorted(names.items(), key=lambda item: item[0][1])
    places = style.spread([float(np.log10(height)) for (_, height), _ in order], 0.22)
    low, high = axes.get_xlim()
    for ((seconds, height), words), place in zip(order, places, strict=True):
        arrow = {"arrowstyle": "-", "color": style.MUTED, "lw": 0.6}
        axes.annotate(
            style.plain("\n".join(", ".join(words[k : k + 2]) for k in range(0, len(words), 2))),
            (seconds, height),
            xytext=(seconds * (high / low) ** 0.025, 10**place),
            va="center",
            fontsize=8,
            fontweight="bold" if chosen in words else "normal",
            arrowprops=arrow if abs(place - np.log10(height)) > 0.1 else None,
            bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.75, "pad": 0.6},
        )


def _height(bias: Bias) -> float:
    return max(100 * abs(bias.value), FLOOR_PERCENT)


def _cells(bias: Bias | None) -> list[str]:
    """Bias with its error, and its bound; dashes where there is none. [%]"""
    if bias is None:
        return ["–", "–"]
    return [with_error(100 * bias.value, 100 * bias.stderr, sign=True), significant(100 * bias.bound, 2)]


def _table(found: Tradeoff) -> str:
    head = ["Level", "Reading off by<br>[%]", "at most<br>[%]", "Signal off by<br>[%]", "at most<br>[%]"]
    head += [f"CPU to {100 * target:g} %<br>[s]" for target in TARGETS]
    head += [f"{STATES} more<br>states [s]", "Memory<br>[MB]", "Setup<br>[s]", "Front", "Scene lines"]
    rows = []
    for one in found.levels:
        name = escaped(one.name) + (" <b>✓</b>" if one.name == found.chosen else "")
        costs = [*one.cpu_seconds, one.reweight_seconds, one.memory_mb, one.setup_seconds]
        shown = ["–" if cost is None else significant(cost, 2) for cost in costs]
        lines = "<br>".join(f"<code>{escaped(line)}</code>" for line in one.lines)
        rows.append([name, *_cells(one.reading), *_cells(one.signal), *shown, "●" if one in found.front else "", lines])
    return table(head, rows)
