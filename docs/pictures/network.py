"""Draw network.svg: the paper's network of two capillary beds, with what a touch presses on.

python docs/pictures/network.py docs/pictures/network.svg
"""

import sys
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nailoptics.report import style

ARTERY, VEIN, WALL, TOUCH = "#b3261e", "#4a6fa5", "#5f6368", "#1f7a4d"
# Heights of the two beds, and of the line that feeds and drains both.
PROXIMAL, DISTAL, MIDDLE = 2.2, -2.2, 0.0


def wire(axes: Axes, *points: tuple[float, float], colour: str) -> None:
    """A line through these points."""
    axes.plot(*zip(*points, strict=True), color=colour, lw=1.6, solid_capstyle="round", zorder=1)


def resistor(axes: Axes, x: float, y: float, name: str, *, colour: str) -> None:
    """A resistance that lies along a horizontal wire, with its name above."""
    half = 0.55
    axes.fill(
        [x - half, x + half, x + half, x - half],
        [y - 0.22, y - 0.22, y + 0.22, y + 0.22],
        fc="white",
        ec=colour,
        lw=1.6,
        zorder=2,
    )
    axes.text(x, y + 0.36, name, ha="center", va="bottom", fontsize=10)


def wall(axes: Axes, x: float, y: float, names: tuple[str, str, str], touch: str) -> None:
    """An elastic vessel below a wire: spring and damper, its diameter, and the pressure of the touch."""
    wire(axes, (x, y), (x, y - 0.35), colour=WALL)
    axes.plot([x - 0.45, x + 0.45], [y - 0.35, y - 0.35], color=WALL, lw=2.4)
    zigzag = [(x - 0.28 + 0.09 * (-1) ** k * (0 < k < 7), y - 0.35 - 0.11 * k) for k in range(8)]
    axes.plot(*zip(*zigzag, strict=True), color=WALL, lw=1.2)
    damper = x + 0.28
    axes.plot([damper, damper], [y - 0.35, y - 0.72], color=WALL, lw=1.2)
    axes.plot([damper - 0.1, damper + 0.1], [y - 0.72, y - 0.72], color=WALL, lw=1.6)
    cup = [(damper - 0.16, y - 0.58), (damper - 0.16, y - 0.88), (damper + 0.16, y - 0.88), (damper + 0.16, y - 0.58)]
    axes.plot(*zip(*cup, strict=True), color=WALL, lw=1.2)
    axes.plot([damper, damper], [y - 0.88, y - 1.12], color=WALL, lw=1.2)
    axes.plot([x - 0.45, x + 0.45], [y - 1.12, y - 1.12], color=WALL, lw=2.4)
    spring, damping, diameter = names
    axes.text(x - 0.5, y - 0.74, spring, ha="right", va="center", fontsize=9, color=WALL)
    axes.text(x + 0.52, y - 0.74, damping, ha="left", va="center", fontsize=9, color=WALL)
    axes.text(x, y + 0.14, diameter, ha="center", va="bottom", fontsize=9)
    if touch:
        arrow = {"arrowstyle": "-|>", "color": TOUCH, "lw": 2}
        axes.annotate("", (x, y - 1.16), (x, y - 1.75), arrowprops=arrow)
        axes.text(x + 0.15, y - 1.55, touch, ha="left", va="center", fontsize=10, color=TOUCH)
    else:
        axes.text(x, y - 1.3, "shielded by the bone", ha="center", va="top", fontsize=9, color=WALL)


def node(axes: Axes, x: float, y: float, name: str, *, colour: str) -> None:
    """A point of one pressure."""
    axes.plot(x, y, "o", ms=7, mfc="white", mec=colour, mew=1.8, zorder=3)
    axes.text(x, y + 0.22, name, ha="center", va="bottom", fontsize=10, color=colour)


def draw(path: Path) -> None:
    """Write the drawing."""
    # The same bytes from every run.
    with style.drawing(), matplotlib.rc_context({"svg.hashsalt": "network", "svg.fonttype": "none"}):
        figure = Figure(figsize=(9.6, 5.0), layout="constrained", facecolor="white")
        axes = figure.subplots()
        for y, name, number, touch in (
            (PROXIMAL, "proximal bed", "1", ""),
            (DISTAL, "distal bed", "2", "$P_{F2}$, touch on the distal pulp"),
        ):
            wire(axes, (1.0, MIDDLE), (1.0, y), (4.0, y), colour=ARTERY)
            wire(axes, (4.0, y), (7.4, y), (7.4, MIDDLE), colour=VEIN)
            resistor(axes, 2.4, y, f"$R_{{A{number}}}(D_C + x_{{C{number}}})$", colour=ARTERY)
            resistor(axes, 6.0, y, f"$R_{{V{number}}}$", colour=VEIN)
            names = ("$k_C$", "$b_C$", f"{name}\n$D_C + x_{{C{number}}}$")
            wall(axes, 4.2, y, names, touch)
        wire(axes, (0.0, MIDDLE), (1.0, MIDDLE), colour=ARTERY)
        wire(axes, (7.4, MIDDLE), (11.6, MIDDLE), colour=VEIN)
        resistor(axes, 10.2, MIDDLE, "$R_V(D_V + x_V)$", colour=VEIN)
        wall(axes, 8.4, MIDDLE, ("$k_V$", "$b_V$", "veins\n$D_V + x_V$"), "$P_{F1}$, touch on\nthe proximal pulp")
        node(axes, 0.0, MIDDLE, "$P_H$\nartery", colour=ARTERY)
        node(axes, 11.6, MIDDLE, "$P_L$\nhand's veins", colour=VEIN)
        axes.set(xlim=(-0.7, 12.5), ylim=(-4.2, 3.5), aspect="equal")
        axes.axis("off")
        figure.savefig(path, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
