"""Drawings of the paper's Figs. 10, 11, 12 and of the simulated side of 15-18, from any set of parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..hemodynamics.parameters import Parameters
from ..hemodynamics.zones import PAPER_ZONES, zones
from ..io import make_folder
from ..paper import protocols
from ..paper.claims_table import DECAY_LENGTH
from ..paper.responses import N_PER_CM2, STEPS_PA, subject_force
from . import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PROXIMAL, _DISTAL, _INK, _FAINT = "#b2182b", "#2166ac", "#222222", "#999999"
_STYLE: Any = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "figure.dpi": 140,
    "savefig.facecolor": "white",
}


def draw(
    directory: Path,
    parameters: Parameters,
    *,
    name: str,
    time_s: np.ndarray | None = None,
    force_n: np.ndarray | None = None,
) -> list[Path]:
    """Draw four figures for one set and return their paths: hemodynamics_<name>_fig10.png, 11, 12 and 15to18.

    directory : where they go; made if it is not there.
    name : of the set, for titles and file names.
    time_s, force_n : (T,) float. A recorded force for Figs. 17-18; without, the paper's subjects' exponential. [s, N]
    """
    import matplotlib

    directory = Path(directory)
    make_folder(directory)
    if time_s is None or force_n is None:
        time_s = np.arange(0.0, 5.0, 1e-3)
        force_n = subject_force(time_s, on_s=0.5, off_s=3.0)
    paths = []
    with matplotlib.rc_context(_STYLE):
        for label, figure in (
            ("fig10", _figure_10(parameters)),
            ("fig11", _figure_11(parameters)),
            ("fig12", _figure_12(parameters)),
            ("fig15to18", _figures_15_to_18(parameters, time_s, force_n)),
        ):
            title = f"{_TITLES[label]} (set “{name}”)"
            figure.suptitle(title, x=0.02, ha="left", fontsize=11, fontweight="bold")
            path = directory / f"hemodynamics_{name}_{label}.png"
            style.write_figure(figure, path)
            paths.append(path)
    return paths


_TITLES = {
    "fig10": "Fig. 10: vessels under steps of proximal pressure",
    "fig11": "Fig. 11: readings under steps of both pressures",
    "fig12": "Fig. 12: steady readings against pressure",
    "fig15to18": "Figs. 15–18: readings under a touch, simulated",
}


def _canvas(columns: int, *, width: float, height: float) -> tuple[Figure, list[Axes]]:
    # No pyplot: a drawing must neither need a display nor leave figures open.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    return figure, list(axes)


def _step_colours() -> Any:
    from matplotlib import colormaps

    return colormaps["viridis_r"](np.linspace(0.12, 1.0, STEPS_PA.size))


def _colour_scale(figure: Figure, axes: list[Axes]) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap

    steps = STEPS_PA / N_PER_CM2
    half = 0.5 * (steps[1] - steps[0])
    norm = BoundaryNorm(np.append(steps - half, steps[-1] + half), STEPS_PA.size)
    bar = figure.colorbar(ScalarMappable(norm, ListedColormap(_step_colours())), ax=axes, ticks=steps[::3], pad=0.02)
    bar.set_label("pressure of the step [N/cm²]")
    bar.outline.set_visible(False)


def _step_panels(figure: Figure, axes: list[Axes], time: np.ndarray, panels: list[tuple[str, str, np.ndarray]]) -> None:
    for axis, (title, label, paths) in zip(axes, panels, strict=True):
        axis.axvspan(0.0, 2.0, color="#f4f4f4", lw=0)
        for path, colour in zip(paths, _step_colours(), strict=True):
            axis.plot(time, path, color=colour)
        axis.set(title=title, ylabel=label, xlabel="time [s]", xlim=(time[0], time[-1]))
        axis.margins(y=0.1)
        axis.text(1.0, 0.985, "touch on", transform=axis.get_xaxis_transform(), ha="center", va="top", color=_FAINT)
    _colour_scale(figure, axes)


def _figure_10(parameters: Parameters) -> Figure:
    run = protocols.steps(parameters, distal_part=0.0)
    figure, axes = _canvas(2, width=9.5, height=3.7)
    capillary = run["capillary_diameter_m"].sel(zone="proximal").transpose("pressure", "time").values * 1e6
    vein = run["vein_diameter_m"].transpose("pressure", "time").values * 1e6
    _step_panels(
        figure,
        axes,
        run["time"].values,
        [
            ("Proximal capillaries", "$D_C + x_{C1}$ [µm]", capillary),
            ("Vein", "$D_V + x_V$ [µm]", vein),
        ],
    )
    return figure


def _figure_11(parameters: Parameters) -> Figure:
    run = protocols.steps(parameters, distal_part=1.0)
    diameter = run["capillary_diameter_m"].transpose("zone", "pressure", "time").values
    proximal, distal = protocols.readings(diameter, diameter[:, 0, 0])
    figure, axes = _canvas(2, width=9.5, height=3.7)
    _step_panels(
        figure,
        axes,
        run["time"].values,
        [
            ("Proximal reading", "change of $V_{P1}$, eq. (9) [rest blood]", proximal),
            ("Distal reading", "change of $V_{P2}$, eq. (9) [rest blood]", distal),
        ],
    )
    return figure


def _figure_12(parameters: Parameters) -> Figure:
    touch = np.linspace(0.0, 1.6e4, 321)
    proximal, distal = protocols.static_readings(parameters, touch)
    figure, axes = _canvas(2, width=9.5, height=3.5)
    panels = (("$V_{P1}$, proximal", proximal, _PROXIMAL), ("$V_{P2}$, distal", distal, _DISTAL))
    for axis, (title, curve, colour) in zip(axes, panels, strict=True):
        axis.axvline(1.0, color=_FAINT, lw=0.9, ls=(0, (4, 3)))
        axis.plot(touch / N_PER_CM2, curve, color=colour, lw=1.8)
        axis.set(title=title, xlabel="pressure, proximal = distal [N/cm²]", ylabel="change, eq. (9) [rest blood]")
        axis.set_xlim(0.0, 1.6)
    return figure


def _figures_15_to_18(parameters: Parameters, time_s: np.ndarray, force_n: np.ndarray) -> Figure:
    figure, axes = _canvas(2, width=9.5, height=4.3)
    force = np.linspace(0.0, 4.0, 321)
    many = zones(8, decay_length=DECAY_LENGTH)
    static, moving = axes
    for cut, line, label in ((PAPER_ZONES, "-", "two zones"), (many, "--", "eight zones, reach falls off")):
        proximal, distal = protocols.static_readings(parameters, force * N_PER_CM2, zones=cut)
        static.plot(force, proximal, color=_PROXIMAL, ls=line, label=f"proximal, {label}")
        static.plot(force, distal, color=_DISTAL, ls=line, label=f"distal, {label}")
    static.axvline(1.0, color=_FAINT, lw=0.9, ls=(0, (4, 3)))
    static.set(title="Steady, against force", xlabel="force on 1 cm² [N]", ylabel="change, eq. (9) [rest blood]")
    static.set_xlim(0.0, 4.0)
    static.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    proximal, distal = protocols.press(parameters, time_s, force_n)
    moving.plot(time_s, proximal, color=_PROXIMAL, label="proximal")
    moving.plot(time_s, distal, color=_DISTAL, label="distal")
    moving.plot([], [], color=_INK, lw=1.0, ls=":", label="force")
    moving.set(title="Over time, two zones", xlabel="time [s]", ylabel="change, eq. (9) [rest blood]")
    moving.set_xlim(time_s[0], time_s[-1])
    side = moving.twinx()
    side.plot(time_s, force_n, color=_INK, lw=1.0, ls=":")
    side.set_ylabel("force [N]")
    side.grid(False)
    side.spines["right"].set_visible(True)
    side.set_ylim(0.0, max(1.25 * float(np.max(force_n)), 1e-9))
    moving.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    return figure
