"""The page and the picture of a tradeoff: error of each level of model against what it costs."""

import html
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..studies.fits import Z95
from ..studies.tradeoff import TARGETS, Level, Tradeoff
from . import study_page, style
from .numbers import significant, with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLOOR_PERCENT = 0.01


def write_tradeoff(found: Tradeoff, path: Path) -> None:
    """Write the page, whole or not at all; raises InputError if the place cannot be written."""
    choice = found.choice
    reference = next(one for one in found.levels if one.name == "reference")
    gain = reference.cpu_seconds[0] / choice.cpu_seconds[0]
    lines = choice.lines or "nothing: the scene as it is"
    cards = [
        (choice.name, f"the cheapest level that provably keeps every reading within {100 * found.tolerance:g} %"),
        (f"{significant(choice.cpu_seconds[0], 2)} s", "of processor time to 1 % on the worst photodiode"),
        (f"{significant(gain, 2)} ×", "as fast as the full model"),
    ]
    body = [
        "<section><h2>Error against cost</h2>",
        study_page.drawing(
            draw(found),
            "pareto",
            "Each level of model: error of the reading at rest against the full model, and processor time to 1 % on "
            "the worst photodiode. Bars are 95 % intervals; filled marks provably meet the tolerance everywhere. "
            f"Errors below {FLOOR_PERCENT:g} % are drawn there.",
        ),
        _table(found),
        f"<p class='small'>Scene lines that select it: <code>{html.escape(lines)}</code>. (9) and (8) take their "
        "constants from the full trace: at rest they are right by construction, and they cost what it costs. Memory is "
        "that of the photons kept for 1 %.</p>",
        "<h3>Number of batches</h3>",
        study_page.table(
            ["Photons in a batch", "Processor time per million photons [s]"],
            [[f"{photons:,}", significant(seconds, 3)] for photons, seconds in found.batches.items()],
        ),
        "</section>",
    ]
    study_page.write(
        study_page.document(
            kicker="speed against accuracy",
            title=f"Within {100 * found.tolerance:g} %: {choice.name}",
            lead=f"Every level of model on this scene, against the full one, in {found.wall_seconds:.0f} s.",
            cards=cards,
            body=body,
            provenance=study_page.provenance(found.attributes),
            scene=str(found.attributes["scene"]),
        ),
        path,
    )


def draw(found: Tradeoff) -> "Figure":
    """Error of every level against processor time to 1 %, with the front that nothing beats."""
    with style.drawing():
        figure = style.new_figure(9.2, 4.8)
        axes = figure.subplots()
        front = _front(found.levels)
        x = [one.cpu_seconds[0] for one in front]
        axes.step(x, [_height(one) for one in front], where="post", color=style.MUTED, lw=1.2, ls=(0, (4, 2)), zorder=1)
        names: dict[tuple[float, float], list[str]] = {}
        for one in found.levels:
            if not np.isfinite(one.bias) or not np.isfinite(one.cpu_seconds[0]):
                continue
            height, spread = _height(one), 100 * Z95 * one.bias_stderr
            low, high = max(height - spread, FLOOR_PERCENT), height + spread
            colour = style.ZONES[1] if one.proven else style.ZONES[0]
            axes.plot([one.cpu_seconds[0]] * 2, [low, high], color=colour, lw=1.3, alpha=0.7)
            face = colour if one.proven else style.PAPER
            chosen = one.name == found.chosen
            axes.plot(
                one.cpu_seconds[0], height, "o", ms=11 if chosen else 7, color=colour, markerfacecolor=face, zorder=3
            )
            names.setdefault((one.cpu_seconds[0], height), []).append(one.name)
        axes.axhline(100 * found.tolerance, color=style.INK, lw=1, ls=(0, (4, 2)))
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(0.6 * FLOOR_PERCENT, None)
        low_x, high_x = axes.get_xlim()
        axes.set_xlim(low_x, high_x * (high_x / low_x) ** 0.25)
        text = f"tolerance {100 * found.tolerance:g} %"
        axes.text(
            0.995, 100 * found.tolerance * 1.08, text, transform=axes.get_yaxis_transform(), ha="right", fontsize=8.5
        )
        order = sorted(names.items(), key=lambda item: item[0][1])
        places = style.spread([float(np.log10(height)) for (_, height), _ in order], 0.16)
        for ((seconds, height), words), place in zip(order, places, strict=True):
            label = style.plain(", ".join(words))
            arrow = {"arrowstyle": "-", "color": style.MUTED, "lw": 0.6}
            axes.annotate(
                label,
                (seconds, height),
                xytext=(seconds * (high_x / low_x) ** 0.02, 10**place),
                va="center",
                fontsize=8.5,
                fontweight="bold" if found.chosen in words else "normal",
                arrowprops=arrow if abs(place - np.log10(height)) > 0.08 else None,
            )
        axes.set_xlabel("processor time to 1 % on the worst photodiode [s]")
        axes.set_ylabel("error of the reading [%]")
        axes.yaxis.set_major_formatter(lambda y, _: f"{y:g}")
        axes.xaxis.set_major_formatter(lambda y, _: f"{y:g}")
        axes.set_title(f"Cheapest that provably meets {100 * found.tolerance:g} %: {style.plain(found.chosen)}")
    return figure


def _height(one: Level) -> float:
    return max(100 * abs(one.bias), FLOOR_PERCENT)


def _front(levels: tuple[Level, ...]) -> list[Level]:
    """Levels than which no other is both cheaper and nearer to the reference."""
    out: list[Level] = []
    for one in sorted(levels, key=lambda level: (level.cpu_seconds[0], abs(level.bias))):
        if np.isfinite(one.bias) and (not out or abs(one.bias) < abs(out[-1].bias)):
            out.append(one)
    return out


def _table(found: Tradeoff) -> str:
    head = ["Level", "Reading off by<br>[%]", "at most<br>[%]", "Signal off by<br>[%]"]
    head += [f"CPU to {100 * target:g} %<br>[s]" for target in TARGETS] + [
        "Memory<br>[MB]",
        "Setup<br>[s]",
        "Scene lines",
    ]
    rows = []
    for one in found.levels:
        signal = "–"
        if one.signal_bias is not None and one.signal_bias_stderr is not None:
            signal = with_error(100 * one.signal_bias, 100 * one.signal_bias_stderr, sign=True)
        name = html.escape(one.name) + (" <b>✓</b>" if one.name == found.chosen else "")
        rows.append(
            [
                name,
                with_error(100 * one.bias, 100 * one.bias_stderr, sign=True),
                significant(100 * one.bias_bound, 2),
                signal,
                *(significant(seconds, 2) for seconds in one.cpu_seconds),
                "–" if one.memory_mb is None else significant(one.memory_mb, 2),
                significant(one.setup_seconds, 2),
                f"<code>{html.escape(one.lines)}</code>",
            ]
        )
    return study_page.table(head, rows)
