"""The style of all figures: colours with one meaning each, fonts, and SVG that follows the page's light or dark."""

import html
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..io import write_bytes
from ..statistics import Z95

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# These four are replaced by the page's own colours, so that figures turn dark with it.
INK, MUTED, GRID, PAPER = "#1c2126", "#65707c", "#e3e7ea", "#fefefd"
_VARIABLES = {INK: "--ink", MUTED: "--muted", GRID: "--grid", PAPER: "--paper"}
# On coloured surfaces, which stay as they are in the dark.
DARK_INK = "#22262b"

# Warm is proximal, cool is distal; of middling lightness throughout, visible on white and on black, and distinguished
# by lightness too where red and green are not.
_PLACES = ("#a31f34", "#d0482f", "#e08a3c", "#5fa8dc", "#2f7fc9", "#3a55b0")
ZONES = (_PLACES[0], _PLACES[-1])
VEIN = "#7a5aa6"

_COLOURS: dict[str, Any] = {
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), MUTED),
    "grid.color": GRID,
}


@dataclass(frozen=True, kw_only=True)
class Room:
    """Room that a figure leaves for labels: around its panels, and between those side by side and one below another."""

    left: float
    right: float = 0.1
    bottom: float = 0.45
    top: float = 0.3
    across: float = 0.0
    down: float = 0.0


@contextmanager
def drawing() -> Iterator[None]:
    """The look of all figures, for as long as one is drawn."""
    from matplotlib import style

    with style.context(["default", Path(__file__).with_name("figures.mplstyle"), _COLOURS]):
        yield


def panels(
    width_in: float, height_in: float, rows: int = 1, columns: int = 1, *, room_in: Room | None = None, **how: Any
) -> "tuple[Figure, Any]":
    """An empty figure, which no global state knows of, and its axes: one alone, or an array of them.

    room_in : Room for labels; without it, it is found by drawing all of them twice more than they are shown. [inch]
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout=None if room_in else "constrained")
    if room_in:
        across, down = width_in - room_in.left - room_in.right, height_in - room_in.bottom - room_in.top
        # Gaps are counted in mean widths and heights of the panels.
        figure.subplots_adjust(
            left=room_in.left / width_in,
            right=1 - room_in.right / width_in,
            bottom=room_in.bottom / height_in,
            top=1 - room_in.top / height_in,
            wspace=columns * room_in.across / (across - (columns - 1) * room_in.across),
            hspace=rows * room_in.down / (down - (rows - 1) * room_in.down),
        )
    return figure, figure.subplots(rows, columns, **how)


def estimate(axes: "Axes", x: Any, value: Any, stderr: Any, *, color: Any, alpha: float = 0.2, **look: Any) -> None:
    """A line with the band of its 95 % interval."""
    value, half = np.asarray(value), Z95 * np.asarray(stderr)
    axes.fill_between(x, value - half, value + half, color=color, alpha=alpha, linewidth=0)
    axes.plot(x, value, color=color, **look)


def tiles(
    count: int, columns: int, width_in: float, row_in: float, *, extra_in: float = 0.0, **how: Any
) -> "tuple[Figure, list[Axes]]":
    """A figure of so many panels in rows, and the panels; places that are left over stay empty."""
    columns = min(count, columns)
    rows = -(-count // columns)
    figure, grid = panels(width_in, row_in * rows + extra_in, rows, columns, squeeze=False, **how)
    for axes in grid.flat[count:]:
        axes.set_axis_off()
    return figure, list(grid.flat[:count])


@drawing()
def beside_models(
    x: np.ndarray,
    traced: np.ndarray,
    stderr: np.ndarray,
    models: Mapping[str, tuple[np.ndarray, dict[str, Any]]],
    *,
    named: Mapping[str, str],
    xlabel: str,
    ylabel: str,
) -> "Figure":
    """A panel for each photodiode: its traced course, wide and with its 95 % interval, beside those of models.

    traced, stderr : (photodiodes, n) float.
    models : the same of each model and its look, by its label.
    named : name of each photodiode and its colour.
    """
    columns, marker = 4, "o" if len(x) == 1 else None
    room = Room(left=0.65, top=0.6, across=0.45, down=0.3)
    figure, panels = tiles(len(named), columns, 9.6, 2.0, extra_in=0.6, room_in=room, sharex=True)
    for k, (axes, (name, colour)) in enumerate(zip(panels, named.items(), strict=True)):
        estimate(axes, x, traced[k], stderr[k], color=colour, label="traced", alpha=0.3, lw=3, marker=marker)
        for label, (values, look) in models.items():
            axes.plot(x, values[k], label=label, lw=1.2, marker=marker, **look)
        axes.set_title(plain(name))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set_xlabel(xlabel if k + columns >= len(panels) else "")
        axes.set_ylabel("" if k % columns else ylabel)
        if len(x) > 1:
            axes.set_xlim(x[0], x[-1])
    legend_above(figure, panels[0], ncols=4)
    return figure


def legend_above(figure: "Figure", axes: "Axes", *, ncols: int, **look: Any) -> None:
    """One legend above all panels of a figure, for the lines in one of them."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=ncols, **look)


def named_rows(axes: "Axes", names: Sequence[object]) -> None:
    """Names of the rows 0, 1 and so on of a panel, the first on top."""
    axes.set_yticks(range(len(names)), [plain(name) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)


def plain_log(axis: "Axis") -> None:
    """Plain numbers at all ticks of a logarithmic axis that have one, whether they are powers of ten or between."""
    from matplotlib.ticker import LogFormatter

    class Plain(LogFormatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    axis.set_major_formatter(Plain())
    axis.set_minor_formatter(Plain())


def place_colours(count: int, distal: int | None = None) -> list[str]:
    """One colour per photodiode, from the most proximal to the most distal.

    distal : so many of them lie distal, and have the cool half of the colours; they are spread over all if not given.
    """
    from matplotlib.colors import LinearSegmentedColormap, to_hex

    places = np.linspace(0, 1, count) if count > 1 else np.zeros(count)
    if distal is not None:
        halves = np.linspace(0, 1, 2 * max(distal, count - distal, 1))
        places = np.concatenate([halves[: count - distal], halves[len(halves) - distal :]])
    scale = LinearSegmentedColormap.from_list("place", _PLACES)
    return [to_hex(scale(x)) for x in places]


def plain(text: object) -> str:
    """Text that a figure shows as it is, dollar signs included."""
    return str(text).replace("$", r"\$")


def spread(places: Sequence[float], gap: float) -> np.ndarray:
    """Places for labels, in the same order, at least a gap apart and as near as can be to where they belong."""
    result, order = np.array(places, float), np.argsort(places, kind="stable")
    if (np.diff(result[order]) >= gap).all():
        return result
    from scipy.optimize import isotonic_regression

    steps = gap * np.arange(len(result))
    result[order] = isotonic_regression(result[order] - steps).x + steps
    return result


def write_figure(figure: "Figure", path: Path, *, dpi: int = 140) -> None:
    """Write a figure on white as PNG, whole or not at all; savefig would draw it twice. Raises: WriteError."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    data = BytesIO()
    figure.set(dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure).print_png(data)
    write_bytes(path, data.getbuffer())


def to_svg(figure: "Figure", *, description: str) -> str:
    """The figure as an SVG element for a page: no ids that could clash, no references, colours of the page."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer, metadata = StringIO(), dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with drawing():
        # What savefig does, without drawing all of it once before for a size that the figure has.
        FigureCanvasSVG(figure).print_svg(buffer, metadata=metadata)
    text = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", buffer.getvalue(), flags=re.DOTALL)
    text = re.sub(r'<(g|text) id="[^"]*"', r"<\1", text[text.index("<svg") :])
    opening, rest = text.split(">", 1)
    (box,), label = re.findall(r'viewBox="[^"]*"', opening), html.escape(description)
    opening = f'<svg role="img" aria-label="{label}" style="--natural:{figure.get_figwidth() * 72:.0f}pt" {box}'
    text = f"{opening}>{rest}".replace("xlink:href", "href")
    text = re.sub(r"font: ([^;\"]*?)'DejaVu Sans'[^;\"]*", r"font: \1var(--type)", text)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    return text.strip()
