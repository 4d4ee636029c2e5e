"""Drawings of the paper's Figs. 10, 11, 12 and of the simulated side of 15-18, from any set of parameters."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..hemodynamics.parameters import Parameters
from ..hemodynamics.zones import PAPER_ZONES, zones
from ..io import make_folder
from ..paper import protocols
from ..paper.claims_table import DECAY_LENGTH
from ..paper.responses import N_PER_CM2, ON_S, STEPS_PA, subject_force
from . import style

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_WIDTH_IN = 9.5
_PROXIMAL, _DISTAL = style.ZONES
# The line at 1 N or 1 N/cm^2, where the paper's veins are shut.
_VEINS_SHUT: Any = {"color": style.MUTED, "lw": 0.9, "ls": (0, (4, 3))}
_READING = "change, eq. (9) [rest blood]"


@style.drawing()
def draw(
    directory: Path,
    parameters: Parameters,
    *,
    name: str,
    time_s: np.ndarray | None = None,
    force_n: np.ndarray | None = None,
) -> list[Path]:
    """Draw four figures for one set and return their paths: hemodynamics_<name>_fig10.png, 11, 12 and 15to18.

    directory : Where they go; made if it is not there.
    name : Of the set, for titles and file names.
    time_s, force_n : (T,) float. A recorded force for Figs. 17-18; without, the paper's subjects' exponential. [s, N]
    """
    make_folder(Path(directory))
    if time_s is None or force_n is None:
        time_s = np.arange(0.0, 5.0, 1e-3)
        force_n = subject_force(time_s, on_s=0.5, off_s=3.0)
    figures = {
        "Fig. 10: vessels under steps of proximal pressure": _figure_10(parameters),
        "Fig. 11: readings under steps of both pressures": _figure_11(parameters),
        "Fig. 12: steady readings against pressure": _figure_12(parameters),
        "Figs. 15–18: readings under a touch, simulated": _figures_15_to_18(parameters, time_s, force_n),
    }
    paths = [Path(directory, f"hemodynamics_{name}_fig{number}.png") for number in ("10", "11", "12", "15to18")]
    for path, (title, figure) in zip(paths, figures.items(), strict=True):
        figure.suptitle(f"{title} (set “{name}”)", x=0.02, ha="left", fontsize=11, fontweight="bold")
        style.write_figure(figure, path, dpi=140, facecolor=style.PAPER)
    return paths


def _steps_over_time(run: "xarray.Dataset", panels: list[tuple[str, str, np.ndarray]]) -> "Figure":
    """One curve for each step of pressure, in panels of title, label and (pressure, time) values."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap

    figure, axes = style.panels(_WIDTH_IN, 3.7, 1, 2)
    time = run["time"].values
    colours: Any = colormaps["viridis_r"](np.linspace(0.12, 1.0, STEPS_PA.size))
    for axis, (title, label, paths) in zip(axes, panels, strict=True):
        axis.axvspan(0.0, ON_S, color="#f4f4f4", lw=0)
        for path, colour in zip(paths, colours, strict=True):
            axis.plot(time, path, color=colour)
        axis.set(title=title, ylabel=label, xlabel="time [s]", xlim=(time[0], time[-1]))
        axis.margins(y=0.1)
        here = axis.get_xaxis_transform()
        axis.text(0.5 * ON_S, 0.985, "touch on", transform=here, ha="center", va="top", color=style.MUTED)
    steps = STEPS_PA / N_PER_CM2
    half = 0.5 * (steps[1] - steps[0])
    norm = BoundaryNorm(np.append(steps - half, steps[-1] + half), STEPS_PA.size)
    bar = figure.colorbar(ScalarMappable(norm, ListedColormap(colours)), ax=axes, ticks=steps[::3], pad=0.02)
    bar.set_label("pressure of the step [N/cm²]")
    bar.outline.set_visible(False)
    return figure


def _figure_10(parameters: Parameters) -> "Figure":
    run = protocols.steps(parameters, distal_part=0.0)
    capillary = run["capillary_diameter_m"].sel(zone="proximal").transpose("pressure", "time").values * 1e6
    vein = run["vein_diameter_m"].transpose("pressure", "time").values * 1e6
    panels = [("Proximal capillaries", "$D_C + x_{C1}$ [µm]", capillary), ("Vein", "$D_V + x_V$ [µm]", vein)]
    return _steps_over_time(run, panels)


def _figure_11(parameters: Parameters) -> "Figure":
    run = protocols.steps(parameters, distal_part=1.0)
    diameter = run["capillary_diameter_m"].transpose("zone", "pressure", "time").values
    proximal, distal = protocols.readings(diameter, diameter[:, 0, 0])
    panels = [
        ("Proximal reading", "change of $V_{P1}$, eq. (9) [rest blood]", proximal),
        ("Distal reading", "change of $V_{P2}$, eq. (9) [rest blood]", distal),
    ]
    return _steps_over_time(run, panels)


def _figure_12(parameters: Parameters) -> "Figure":
    touch = np.linspace(0.0, 1.6e4, 321)
    proximal, distal = protocols.static_readings(parameters, touch)
    figure, axes = style.panels(_WIDTH_IN, 3.5, 1, 2)
    panels = (("$V_{P1}$, proximal", proximal, _PROXIMAL), ("$V_{P2}$, distal", distal, _DISTAL))
    for axis, (title, curve, colour) in zip(axes, panels, strict=True):
        axis.axvline(1.0, **_VEINS_SHUT)
        axis.plot(touch / N_PER_CM2, curve, color=colour, lw=1.8)
        axis.set(title=title, xlabel="pressure, proximal = distal [N/cm²]", ylabel=_READING, xlim=(0.0, 1.6))
    return figure


def _figures_15_to_18(parameters: Parameters, time_s: np.ndarray, force_n: np.ndarray) -> "Figure":
    figure, (steady, moving) = style.panels(_WIDTH_IN, 4.3, 1, 2)
    force = np.linspace(0.0, 4.0, 321)
    many = zones(8, decay_length=DECAY_LENGTH)
    for cut, line, label in ((PAPER_ZONES, "-", "two zones"), (many, "--", "eight zones, reach falls off")):
        proximal, distal = protocols.static_readings(parameters, force * N_PER_CM2, zones=cut)
        steady.plot(force, proximal, color=_PROXIMAL, ls=line, label=f"proximal, {label}")
        steady.plot(force, distal, color=_DISTAL, ls=line, label=f"distal, {label}")
    steady.axvline(1.0, **_VEINS_SHUT)
    steady.set(title="Steady, against force", xlabel="force on 1 cm² [N]", ylabel=_READING, xlim=(0.0, 4.0))
    proximal, distal = protocols.press(parameters, time_s, force_n)
    moving.plot(time_s, proximal, color=_PROXIMAL, label="proximal")
    moving.plot(time_s, distal, color=_DISTAL, label="distal")
    moving.plot([], [], color=style.INK, lw=1.0, ls=":", label="force")
    moving.set(title="Over time, two zones", xlabel="time [s]", ylabel=_READING, xlim=(time_s[0], time_s[-1]))
    side = moving.twinx()
    side.plot(time_s, force_n, color=style.INK, lw=1.0, ls=":")
    side.set(ylabel="force [N]", ylim=(0.0, max(1.25 * float(np.max(force_n)), 1e-9)))
    side.grid(False)
    side.spines["right"].set_visible(True)
    for axis, columns in ((steady, 2), (moving, 3)):
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=columns)
    return figure
