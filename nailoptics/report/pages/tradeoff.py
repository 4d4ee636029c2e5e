"""The page and the picture of a tradeoff: error of every level of model against the time that its answers take."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np

from ...io import write_text
from ...studies.model_error.answers import MORE, Answer, Bias, Effort, Judge, Level, in_words
from ...studies.model_error.tradeoff import ERRORS, SECONDS, WORDS, Tradeoff
from .. import style
from ..html import document, escaped, figure, section, small, table
from ..numbers import significant, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# What the axes show of the errors, and the errors at which a level's curve is computed.
LEAST, MOST = 5e-4, 10.0
GRID = np.geomspace(LEAST, MOST, 200)
# Limits of the axis where no time is known. [s]
NO_TIMES = 0.01, 1000.0
# Names lie so many decades apart.
APART = 0.17


def write_tradeoff(found: Tradeoff, drawing: "Figure", path: Path) -> None:
    """Write the page around what `draw` drew, whole or not at all; raises WriteError."""
    choice, what = found.chosen, WORDS[found.judge]
    percent = f"{100 * found.tolerance:g} %"
    kept = choice.error <= found.tolerance * (1 + 1e-9)
    why = f"the fastest within {percent} on {what}" if kept else f"the best in that time; {percent} takes longer"
    lines = "<br>".join(escaped(line) for line in found.lines) or escaped(choice.level.call) or "none is needed"
    cards = [
        (choice.level.name, why),
        (in_words(choice.seconds()), "of processor time to the first answer"),
        (in_words(choice.seconds("states")), f"for {MORE} more blood states"),
        (in_words(choice.seconds("layouts")), f"for {MORE} more layouts"),
    ]
    body = section(
        "Error against time",
        figure(
            drawing,
            "time",
            f"Error of the worst photodiode, of {what}, against processor time: left to the first answer, right for "
            f"{MORE} more states of the blood or layouts. Every level's error falls with its photons to its own bias; "
            "dots are levels without photons. Strong lines: the least error that any level has in a time. "
            "Left they leave out what reads a stored trace.",
        ),
        _levels(found),
        small(
            "Bias: mean over the photodiodes, weighted by the reference's errors, ± its standard error; upper bound: "
            "not exceeded by any photodiode's, with 95 % confidence each. The error of an answer is that bound and "
            f"the standard error of its worst photodiode together. Times are for {percent}, or for a tenth more than "
            "a level's own bias where that is larger. The signal is the change by touch, as a part of the largest "
            "change."
        ),
        small(" ".join(f"{escaped(one.name)}: {escaped(one.remark)}." for one in found.levels if one.remark)),
        f"<p>What selects the chosen level: <code>{lines}</code></p>",
        "<h3>What each level needs</h3>",
        _needs(found),
        "<h3>The fastest answer within an error</h3>",
        _within(found),
        "<h3>The best answer within a time</h3>",
        table(
            ["Processor time", "Level", "Error [%]"],
            [_best_row(seconds, found.best(seconds)) for seconds in SECONDS],
        ),
        "<h3>The full model by its photons</h3>",
        _efforts(found),
        _batches(found),
    )
    text = document(
        kicker="speed against accuracy",
        title=f"Within {percent}: {choice.level.name}" if kept else f"Within {in_words(found.max_seconds or 0.0)}",
        lead=f"{found.sentence} Every level of model on this scene, against the full one, measured in "
        f"{found.wall_seconds:.0f} s.",
        cards=cards,
        body=[body],
        attributes=found.attributes,
    )
    write_text(path, text)


@style.drawing()
def draw(found: Tradeoff) -> "Figure":
    """Error of every level against time to the first answer, and against time for a thousand more."""
    drawing, (left, right) = style.panels(11.0, 5.0, 1, 2, sharey=True, width_ratios=[1.25, 1])
    left.set(yscale="log", ylim=(100 * LEAST, 100 * MOST), ylabel=f"error on {WORDS[found.judge]} [%]")
    style.plain_log(left.yaxis)
    offered = [one for one in found.levels if not one.stored]
    _panel(left, found, "first", offered, [("first", style.INK, "-")])
    more: list[tuple[Effort, str, str]] = [("states", style.ZONES[0], "-"), ("layouts", style.ZONES[1], "--")]
    _panel(right, found, "states", found.levels, more)
    left.set(title="First answer", xlabel="processor time to the first answer [s]")
    right.set(title=f"{MORE} more states or layouts", xlabel=f"processor time for {MORE} more [s]")
    seconds = found.chosen.seconds()
    left.plot(seconds, 100 * found.chosen.error, "*", ms=13, color=style.ZONES[0], zorder=5, label="chosen")
    left.legend(loc="lower left", frameon=True, facecolor=style.PAPER, edgecolor="none", framealpha=0.9)
    # No corner of the right panel is free on every scene.
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, columnspacing=1.2, handlelength=1.6)
    drawing.suptitle(style.plain(found.sentence), x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawing


def _panel(
    axes: "Axes", found: Tradeoff, shown: Effort, levels: Sequence[Level], fronts: Sequence[tuple[Effort, str, str]]
) -> None:
    """Every level's error against what one effort costs, and the fronts of this and others."""
    ends, marks = [], []
    for level in levels:
        curve = _curve(level, found.judge, shown)
        if len(curve) and level.first.per_second:
            axes.plot(*curve.T, color=style.MUTED, lw=0.8, alpha=0.6, zorder=1)
            ends.append((level.name, curve[-1]))
        elif len(curve):
            axes.plot(*curve[-1], "o", ms=5, color=style.MUTED, markerfacecolor=style.PAPER, zorder=3)
            marks.append((level.name, curve[-1]))
    for effort, colour, line in fronts:
        answers = [found.fastest(error, effort) for error in GRID]
        points = [(a.seconds(effort), 100 * error) for a, error in zip(answers, GRID, strict=True) if a]
        label = "the best of all" if effort == "first" else f"the best of all, {effort}"
        axes.plot(*np.array(points).reshape(-1, 2).T, color=colour, lw=2.2, ls=line, zorder=2, label=label)
    axes.axhline(100 * found.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)), zorder=1, label="tolerance")
    axes.set_xscale("log")
    # Where no level could be judged there is nothing to fit them to.
    low, high = axes.get_xlim() if marks or ends else axes.set_xlim(*NO_TIMES)
    _names(axes, marks, x=None, room=(high / low) ** 0.02)
    # Where the names stand there is no time.
    axes.set_xticks([tick for tick in axes.get_xticks() if low <= tick <= high])
    axes.set_xlim(low, high * (high / low) ** 0.4)
    _names(axes, ends, x=high, room=(high / low) ** 0.02)


def _curve(level: Level, judge: Judge, effort: Effort) -> np.ndarray:
    """Seconds and error [%] of a level from few photons to many, (n, 2) float; without photons its one answer."""
    bias = level.bias(judge)
    if not np.isfinite(bias):
        return np.empty((0, 2))
    if not level.first.per_second:
        return np.array([[level.cost(effort).at(0.0), 100 * np.clip(bias, LEAST, MOST)]])
    # Down to where photons no longer help.
    errors = GRID[::-1][GRID[::-1] > 1.02 * bias]
    seconds = [level.cost(effort).at(level.photon_seconds(judge, error)) for error in errors]
    return np.array([(s, 100 * e) for s, e in zip(seconds, errors, strict=True) if np.isfinite(s)]).reshape(-1, 2)


def _names(axes: "Axes", places: Sequence[tuple[str, np.ndarray]], *, x: float | None, room: float) -> None:
    """Names beside their places, or in a column at x, at least so far apart that each is read."""
    heights = np.array(style.spread([float(np.log10(place[1])) for _, place in places], APART))
    heights = np.maximum(heights, np.log10(100 * LEAST) + APART / 2)
    # Beside its place a name would lie on the line that goes on from there.
    for (name, place), height in zip(places, heights + (APART / 2 if x is None else 0.0), strict=True):
        axes.annotate(
            style.plain(name),
            tuple(place),
            xytext=((place[0] if x is None else x) * room, 10**height),
            va="center",
            fontsize=8,
            color=style.INK,
            arrowprops={"arrowstyle": "-", "color": style.MUTED, "lw": 0.5, "alpha": 0.6},
            bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.95, "pad": 0.4},
        )


def _cells(bias: Bias | None) -> list[str]:
    """Bias with its error, and its bound. [%]"""
    if bias is None:
        return ["not measured", "–"]
    return [with_error(100 * bias.value, 100 * bias.stderr, sign=True), significant(100 * bias.bound, 2)]


def _batches(found: Tradeoff) -> str:
    """What batches of several sizes cost, if that was measured."""
    head = ["Photons in a batch", "Processor time per million photons [s]"]
    rows = [[f"{photons:,}", significant(seconds, 3)] for photons, seconds in found.batches.items()]
    return "<h3>Number of batches</h3>" + table(head, rows) if rows else ""


def _levels(found: Tradeoff) -> str:
    head = ["Level", "Bias of reading<br>[%]", "upper bound<br>[%]", "Bias of signal<br>[%]", "upper bound<br>[%]"]
    head += ["First<br>answer", f"{MORE} more<br>states", f"{MORE} more<br>layouts", "Memory<br>[MB]"]
    rows = []
    for one in found.levels:
        name = escaped(one.name) + (" <b>✓</b>" if one.name == found.chosen.level.name else "")
        photons = one.usual_photon_seconds(found.judge, found.tolerance)
        costs = [one.cost(effort).at(photons) for effort in get_args(Effort)]
        shown = [in_words(cost) if np.isfinite(cost) else "–" for cost in costs]
        memory = "–" if one.memory_mb is None or not np.isfinite(one.memory_mb) else significant(one.memory_mb, 2)
        rows.append([name, *_cells(one.reading), *_cells(one.signal), *shown, memory])
    return table(head, rows)


def _needs(found: Tradeoff) -> str:
    """What each level requires, and what selects it."""
    rows = []
    for one in found.levels:
        how = "<br>".join(f"<code>{escaped(line)}</code>" for line in one.lines or ([one.call] if one.call else []))
        rows.append([escaped(one.name), escaped(one.beforehand) or "–", how or "the scene as it is"])
    head = ["Level", "Must be known beside the scene", "Scene lines, or the call that gives it"]
    return table(head, rows, kind="words")


def _within(found: Tradeoff) -> str:
    """The fastest answers, one row per error."""
    rows = []
    for error in ERRORS:
        row = [f"{100 * error:g}"]
        for effort in get_args(Effort):
            answer = found.fastest(error, effort)
            row += [escaped(answer.level.name), in_words(answer.seconds(effort))] if answer else ["–", "–"]
        rows.append(row)
    head = ["Error<br>[%]", "First answer", "", f"{MORE} more states", "", f"{MORE} more layouts", ""]
    return table(head, rows)


def _best_row(seconds: float, answer: Answer | None) -> list[str]:
    cells = [escaped(answer.level.name), significant(100 * answer.error, 2)] if answer else ["–", "–"]
    return [in_words(seconds), *cells]


def _efforts(found: Tradeoff) -> str:
    rows = []
    for one in found.efforts:
        errors = [one.level.error(judge, one.photon_seconds) for judge in ("reading", "signal")]
        shown = [significant(100 * error, 2) for error in errors]
        rows.append([in_words(one.photon_seconds), in_words(one.seconds()), *shown, in_words(one.seconds("states"))])
    head = ["Photons for", "First answer", "Standard error of the<br>worst reading [%]"]
    return table([*head, "of the worst<br>signal [%]", f"{MORE} more<br>states"], rows)
