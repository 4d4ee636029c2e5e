"""The page and the picture of a tradeoff: error of every level of model against the time that its answer takes."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ...io import to_json
from ...studies.model_error.tradeoff import OWN, REFERENCE, Level, Tradeoff, fastest
from .. import style
from ..files import Report, scene_text
from ..html import document, figure, section, small, table, texts
from ..numbers import aligned, duration, significant, with_error

TEXTS = texts("tradeoff")
# What the axis shows of the errors, and the errors at which a level's curve is computed.
LEAST, MOST = 5e-4, 10.0
GRID = np.geomspace(LEAST, MOST, 200)
# Limits of the axis where no time is known. [s]
NO_TIMES = 0.01, 1000.0
# Names lie so far beside the axes and apart, in parts of their width and height.
BESIDE, APART = 1.03, 0.04
# Errors for which the fastest answer is reported, and those that the sentence for a designer names.
ERRORS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
SENTENCE_ERRORS = (0.2, 0.05, 0.01, 0.001)


def page(result: Tradeoff, drawing: "style.Figure | None" = None) -> str:
    """The page around what `draw` drew."""
    rows = _rows(result)
    for row, level in zip(rows, result.levels, strict=True):
        row["Scene lines, or the call that gives it"] = _selected(level.lines, level.call) or "the scene as it is"
    selected = _selected(result.lines, result.chosen.call) or "none is needed"
    said = TEXTS["measured"].format(sentence(result), result.wall_seconds)
    drawn, note = figure(drawing or draw(result), TEXTS["caption"]), small(TEXTS["note"].format(meaning(result)))
    return document(
        kicker="speed against accuracy",
        title=f"Within {100 * result.tolerance:g} %: {result.chosen.name}",
        lead=f"{chosen_line(result)} What selects it: {selected}",
        body=[section("Error against time", drawn, said, table(rows, kind="effects dense"), note)],
        attributes=result.attributes,
    )


@style.drawing()
def draw(result: Tradeoff) -> "style.Figure":
    """Error of every level against the time to its answer."""
    drawing, axes = style.panels(8.0, 5.0)
    axes.set(yscale="log", ylim=(100 * LEAST, 100 * MOST), ylabel="error of the worst photodiode [%]")
    axes.set(xscale="log", xlabel="processor time to the answer [s]")
    style.plain_log(axes.yaxis)
    ends = []
    for level in result.levels:
        # From few photons to where more no longer help.
        errors = [error for error in GRID[::-1] if error > 1.02 * level.bound]
        points = [(level.seconds(error), 100 * error) for error in errors]
        if curve := [point for point in points if math.isfinite(point[0])]:
            axes.plot(*np.transpose(curve), color=style.MUTED, lw=0.8, alpha=0.6, zorder=1)
            ends.append((level.name, np.array(curve[-1])))
    bests = [(fastest(result.levels, error), error) for error in GRID]
    best = [(level.seconds(error), 100 * error) for level, error in bests if level]
    axes.plot(*np.reshape(best, (-1, 2)).T, color=style.INK, lw=2.2, zorder=2, label="the best of all")
    axes.axhline(100 * result.tolerance, color=style.INK, lw=1, ls=(0, (1, 1.5)), zorder=1, label="tolerance")
    # Where no level could be evaluated there is nothing to fit them to.
    axes.set_xlim(axes.get_xlim() if ends else NO_TIMES)
    _names(axes, ends)
    if math.isfinite(seconds := result.chosen.seconds(result.tolerance)):
        error = 100 * result.tolerance
        axes.plot(seconds, error, "*", ms=13, color=style.ZONES[0], zorder=5, label="chosen")
    axes.legend(loc="lower left", frameon=True, facecolor=style.PAPER, edgecolor="none", framealpha=0.9)
    return drawing


def _names(axes: "style.Axes", places: Sequence[tuple[str, np.ndarray]]) -> None:
    """Names in a column beside the axes, apart, with lines to their places, the shortest together: none cross."""
    from scipy.optimize import linear_sum_assignment

    ends = axes.transLimits.transform(np.log10(np.reshape([place for _, place in places], (-1, 2))))
    heights = style.spread(ends[:, 1].tolist(), APART)
    heights = np.maximum(heights, APART * (0.5 + np.argsort(np.argsort(heights))))
    long = np.hypot(1.6 * (BESIDE - ends[:, :1]), ends[:, 1:] - heights)
    for (name, place), slot in zip(places, linear_sum_assignment(long)[1], strict=True):
        axes.annotate(
            style.plain(name),
            tuple(place),
            xytext=(BESIDE, heights[slot]),
            textcoords="axes fraction",
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
        row = {"Level": f"{level.name}{' (chosen)' if level.name == result.chosen.name else ''}"}
        for name, bias in (("reading", level.reading), ("signal", level.signal)):
            row[f"Bias of {name} [%]"] = with_error(100 * bias.value, 100 * bias.stderr, sign=True)
            row[f"upper bound of {name} [%]"] = significant(100 * bias.bound, 2)
        seconds = level.seconds(result.tolerance)
        rows.append(row | {"Processor time within the tolerance": duration(seconds) if math.isfinite(seconds) else "–"})
    return rows


def _selected(lines: list[str], call: str) -> str:
    return "; ".join([*lines, call] if call else lines)


def meaning(result: Tradeoff) -> str:
    """What the tolerance is the error of, in words."""
    return TEXTS["tolerance"].format(100 * result.tolerance)


def sentence(result: Tradeoff) -> str:
    """What a designer needs: how long each error takes."""
    levels = [fastest(result.levels, error) for error in SENTENCE_ERRORS]
    full = all(level and level.name in (OWN, REFERENCE) for level in levels)
    parts = []
    for error, level in zip(SENTENCE_ERRORS, levels, strict=True):
        how = "no level" if not level else duration(level.seconds(error)) + ("" if full else f" ({level.name})")
        parts.append(f"for {100 * error:g} % {how}")
    start = "Time is photons: no simpler level is faster at any of these errors. " if full else ""
    return f"{start}F{', '.join(parts)[1:]}."


def chosen_line(result: Tradeoff) -> str:
    """The level to take."""
    seconds = result.chosen.seconds(result.tolerance)
    if math.isinf(seconds):
        return f"Too few photons to evaluate any level: take {result.chosen.name}."
    return f"Fastest within the tolerance: {result.chosen.name}, {duration(seconds)} of processor time."


def summary(result: Tradeoff) -> dict[str, Any]:
    """Everything, ready for JSON."""
    made = {name: getattr(result, name) for name in ("tolerance", "wall_seconds", "lines")}
    made |= {name: result.attributes.get(name) for name in ("digest", "photons", "cut_off")}
    made |= {"chosen": result.chosen.name, "answer": _answer(result.chosen, result.tolerance)}
    made |= {"sentence": sentence(result), "levels": []}
    for level in result.levels:
        row = asdict(level) | {"lines": level.lines, "within_tolerance": _answer(level, result.tolerance)}
        made["levels"].append(row | {"first": {"fixed": row.pop("setup_seconds"), "per_second": 1.0}})
    return made | {"fastest_within": {str(error): _answer(fastest(result.levels, error), error) for error in ERRORS}}


def _answer(level: Level | None, error: float) -> dict[str, Any] | None:
    """The answer of a level within an error; None where it has none."""
    if level is None or math.isinf(level.seconds(error)):
        return None
    times = {"photon_seconds": level.photon_seconds(error), "first_seconds": level.seconds(error)}
    return {"level": level.name, "error": error, "relative_error": level.relative_error(error)} | times


def lines(result: Tradeoff) -> list[str]:
    """The table of levels and the one to take, for the terminal."""
    out = [*aligned(_rows(result)), f"Tolerance: {meaning(result)}.", chosen_line(result), sentence(result)]
    if result.lines:
        out += ["Scene lines that select it:", *(f"  {line}" for line in result.lines)]
    if call := result.chosen.call:
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
