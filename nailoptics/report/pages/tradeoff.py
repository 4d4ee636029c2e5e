"""The page and the picture of a tradeoff: error of every level of model against the time that its answer takes."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ...io import to_json
from ...studies.model_error.tradeoff import OWN, REFERENCE, Answer, Level, Tradeoff
from .. import style
from ..files import Report, scene_text
from ..html import document, figure, section, small, subheading, table, texts
from ..numbers import aligned, duration, significant, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEXTS = texts("tradeoff")
# What the axis shows of the errors, and the errors at which a level's curve is computed.
LEAST, MOST = 5e-4, 10.0
GRID = np.geomspace(LEAST, MOST, 200)
# Limits of the axis where no time is known. [s]
NO_TIMES = 0.01, 1000.0
# Names lie so many decades apart.
APART = 0.17
# Errors for which the fastest answer is reported, and those that the sentence for a designer names.
ERRORS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
SENTENCE_ERRORS = (0.2, 0.05, 0.01, 0.001)


def page(result: Tradeoff, drawing: "Figure | None" = None) -> str:
    """The page around what `draw` drew."""
    choice = result.chosen
    selected = "; ".join(filter(None, (*result.lines, choice.level.call))) or "none is needed"
    body = section(
        "Error against time",
        figure(drawing or draw(result), TEXTS["caption"]),
        table(_rows(result)),
        small(TEXTS["note"].format(meaning(result))),
        f"{chosen_line(result)} What selects it: {selected}",
        subheading("What each level needs"),
        table(_needs(result), kind="words"),
    )
    return document(
        kicker="speed against accuracy",
        title=f"Within {100 * result.tolerance:g} %: {choice.level.name}",
        lead=f"{sentence(result)} Every level of model on this scene, against the full one, measured in "
        f"{result.wall_seconds:.0f} s.",
        cards=[(choice.level.name, meaning(result)), (duration(choice.seconds), "of processor time to the answer")],
        body=[body],
        attributes=result.attributes,
    )


@style.drawing()
def draw(result: Tradeoff) -> "Figure":
    """Error of every level against the time to its answer."""
    drawing, axes = style.panels(8.0, 5.0)
    axes.set(yscale="log", ylim=(100 * LEAST, 100 * MOST), ylabel="error of the worst photodiode [%]")
    axes.set(xscale="log", xlabel="processor time to the answer [s]")
    style.plain_log(axes.yaxis)
    ends, marks = [], []
    for level in result.levels:
        curve = _curve(level)
        if len(curve) and level.traces:
            axes.plot(*curve.T, color=style.MUTED, lw=0.8, alpha=0.6, zorder=1)
            ends.append((level.name, curve[-1]))
        elif len(curve):
            axes.plot(*curve[-1], "o", ms=5, color=style.MUTED, markerfacecolor=style.PAPER, zorder=3)
            marks.append((level.name, curve[-1]))
    answers = [result.fastest(error) for error in GRID]
    points = [(a.seconds, 100 * error) for a, error in zip(answers, GRID, strict=True) if a]
    best = np.array(points).reshape(-1, 2).T
    axes.plot(*best, color=style.INK, lw=2.2, zorder=2, label="the best of all")
    axes.axhline(100 * result.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)), zorder=1, label="tolerance")
    # Where no level could be evaluated there is nothing to fit them to.
    low, high = axes.get_xlim() if marks or ends else axes.set_xlim(*NO_TIMES)
    _names(axes, marks, x=None, room=(high / low) ** 0.02)
    # Where the names stand there is no time.
    axes.set_xticks([tick for tick in axes.get_xticks() if low <= tick <= high])
    axes.set_xlim(low, high * (high / low) ** 0.4)
    _names(axes, ends, x=high, room=(high / low) ** 0.02)
    seconds = result.chosen.seconds
    axes.plot(seconds, 100 * result.chosen.error, "*", ms=13, color=style.ZONES[0], zorder=5, label="chosen")
    axes.legend(loc="lower left", frameon=True, facecolor=style.PAPER, edgecolor="none", framealpha=0.9)
    return drawing


def _curve(level: Level) -> np.ndarray:
    """Seconds and error [%] of a level from few photons to many, (n, 2) float; without photons its one answer."""
    if not np.isfinite(level.bound):
        return np.empty((0, 2))
    if not level.traces:
        return np.array([[level.setup_seconds, 100 * np.clip(level.bound, LEAST, MOST)]])
    # Down to where photons no longer help.
    errors = GRID[::-1][GRID[::-1] > 1.02 * level.bound]
    seconds = [level.setup_seconds + level.photon_seconds(error) for error in errors]
    return np.array([(s, 100 * e) for s, e in zip(seconds, errors, strict=True) if np.isfinite(s)]).reshape(-1, 2)


def _names(axes: "Axes", places: Sequence[tuple[str, np.ndarray]], *, x: float | None, room: float) -> None:
    """Names beside their places, or in a column at x, at least so far apart that each is read."""
    heights = np.array(style.spread([float(np.log10(place[1])) for _, place in places], APART))
    heights = np.maximum(heights, np.log10(100 * LEAST) + APART * (0.5 + np.argsort(np.argsort(heights))))
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


def _rows(result: Tradeoff) -> list[dict[str, str]]:
    """Every level, on the page and in the terminal: its biases, and its answer's time."""
    rows = []
    for level in result.levels:
        answer = level.within(result.tolerance)
        row = {"Level": f"{level.name}{' (chosen)' if level.name == result.chosen.level.name else ''}"}
        for name, bias in (("reading", level.reading), ("signal", level.signal)):
            shown, bound = "not measured", "–"
            if bias is not None:
                shown = with_error(100 * bias.value, 100 * bias.stderr, sign=True)
                bound = significant(100 * bias.bound, 2)
            row |= {f"Bias of {name} [%]": shown, f"upper bound of {name} [%]": bound}
        rows.append(row | {"Answer within the tolerance": duration(answer.seconds) if answer else "–"})
    return rows


def _needs(result: Tradeoff) -> list[dict[str, str]]:
    """What must be known for each level, and what selects it."""
    rows = []
    for level in result.levels:
        row = {"Level": level.name, "Must be known beside the scene": level.beforehand or "–"}
        selected = "; ".join(filter(None, (*level.lines, level.call))) or "the scene as it is"
        rows.append(row | {"Scene lines, or the call that gives it": selected})
    return rows


def meaning(result: Tradeoff) -> str:
    """What the tolerance is the error of, in words."""
    part = f"{100 * result.tolerance:g} %"
    of = "of the reading at rest, or of the change by touch as a part of the largest change of any photodiode"
    return f"{part} as one standard error of the worst photodiode, {of}"


def sentence(result: Tradeoff) -> str:
    """What a designer needs: how long each error takes."""
    answers = [result.fastest(error) for error in SENTENCE_ERRORS]
    every = f"For {100 * SENTENCE_ERRORS[0]:g} %"
    full = all(answer and answer.level.name in (OWN, REFERENCE) for answer in answers)
    parts: list[str] = []
    for error, answer in zip(SENTENCE_ERRORS, answers, strict=True):
        how = "no level" if not answer else duration(answer.seconds) + ("" if full else f" ({answer.level.name})")
        parts.append(f"{every if not parts else f'for {100 * error:g} %'} {how}")
    start = "Time is photons: no simpler level is faster at any of these errors. " if full else ""
    return f"{start}{', '.join(parts)}."


def chosen_line(result: Tradeoff) -> str:
    """The level to take."""
    if math.isinf(result.chosen.error):
        return f"Too few photons to evaluate any level: take {result.chosen.level.name}."
    answer = f"{result.chosen.level.name}, {duration(result.chosen.seconds)} of processor time"
    return f"Fastest within the tolerance: {answer}."


def summary(result: Tradeoff) -> dict[str, Any]:
    """Everything, ready for JSON."""
    names = ("tolerance", "wall_seconds", "lines")
    return (
        {name: getattr(result, name) for name in names}
        | {name: result.attributes.get(name) for name in ("digest", "photons", "cut_off")}
        | {"chosen": result.chosen.level.name, "answer": _answer(result.chosen), "sentence": sentence(result)}
        | {"levels": [_level(result, level) for level in result.levels]}
        | {"fastest_within": {str(error): _answer(result.fastest(error)) for error in ERRORS}}
    )


def _answer(answer: Answer | None) -> dict[str, Any] | None:
    if answer is None:
        return None
    names = {"photon_seconds": answer.photon_seconds, "error": answer.error, "first_seconds": answer.seconds}
    return {"level": answer.level.name, **names, "relative_error": answer.relative_error}


def _level(result: Tradeoff, level: Level) -> dict[str, Any]:
    row = asdict(level) | {"lines": level.lines, "changes": level.changes or {}}
    row["first"] = {"fixed": row.pop("setup_seconds"), "per_second": float(level.traces)}
    return row | {"within_tolerance": _answer(level.within(result.tolerance))}


def lines(result: Tradeoff) -> list[str]:
    """The table of levels and the one to take, for the terminal."""
    known = ({"Must be known": level.beforehand} for level in result.levels)
    out = aligned([row | more for row, more in zip(_rows(result), known, strict=True)])
    out += [f"Tolerance: {meaning(result)}.", chosen_line(result), sentence(result)]
    if result.lines:
        out += ["Scene lines that select it:", *(f"  {line}" for line in result.lines)]
    if call := result.chosen.level.call:
        return [*out, f"No line of a scene selects {'the rest' if result.lines else 'it'}: {call} gives it."]
    return out if result.lines else [*out, "The scene is that already: no line needs to change."]


def _files(result: Tradeoff) -> dict[str, Any]:
    drawing = draw(result)
    files: dict[str, Any] = {"tradeoff.json": to_json(summary(result)) + "\n", "tradeoff.nc": result.dataset()}
    files |= {"tradeoff.html": page(result, drawing), "tradeoff.png": drawing}
    # Once is enough to find room for the labels.
    drawing.set_layout_engine("none")
    return files | {"scene.toml": scene_text(result.scene, result.attributes)}


TRADEOFF = Report(
    ("tradeoff.json", "tradeoff.nc", "tradeoff.html", "tradeoff.png", "scene.toml"),
    page,
    summary,
    lambda result, _: lines(result),
    {"error": draw},
    _files,
)
