"""The paper's figures, drawn from any set's responses and from people, and its claims evaluated on them."""

import logging
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, repeat
from pathlib import Path
from typing import Any

import numpy as np

from ... import hemodynamics, tissue
from ...display import Displayed
from ...hemodynamics.parameters import PA_PER_N_PER_CM2
from ...light import backend as backends
from ...paper import responses as paper
from ...paper.claims import Claim, as_rows, evaluate, evaluate_people, is_shown_by
from ...scene import Scene, load_scene
from ...scene.catalogue import LedPart, load_part
from ...studies import people as subjects
from ...studies.colour import nail_colour
from .. import style
from ..files import Report
from ..html import document, image, preformatted, section
from ..numbers import aligned
from .colour import strip_figure

log = logging.getLogger(__name__)

_WIDTH_IN = 9.5
# Rays of Fig. 2: enough for the eye.
FIG2_PHOTONS = 480_000
# The line at 1 N or 1 N/cm^2, where the paper's veins are shut.
_VEINS_SHUT: Any = {"color": style.MUTED, "lw": 0.9, "ls": (0, (4, 3))}
_READING = "change, Taylor (9) [rest blood]"
_SIDES = ("proximal", "distal")
# The phases of a step on and off, one after the other. [s]
_TIME_S = np.concatenate([paper.PHASE_S, paper.ON_S + paper.PHASE_S])


@dataclass(frozen=True, repr=False)
class PaperFigures(Displayed):
    """The paper's claims by set of parameters, evaluated, and its figures as files."""

    claims: dict[str, list[Claim]]
    pictures: list[Path]


def figures(folder: str | Path, sets: Sequence[str] = (), *, colour: bool = True, people: bool = False) -> PaperFigures:
    """Draw the paper's figures into a folder and evaluate its claims.

    sets : names of parameter sets; all if none is given.
    colour : whether Fig. 2 is traced.
    people : whether Figs. 15 to 18 are drawn of people, too, who are evaluated as one more set.

    Raises: InputError.
    """
    named = {name: hemodynamics.parameters(name) for name in sets or hemodynamics.NAMES}
    folder, claims_by_set, pictures = Path(folder), {}, []
    for name, parameters in named.items():
        responses = paper.simulate_responses(parameters)
        pictures += draw(folder, responses, name=name)
        claims_by_set[name] = evaluate(responses, name)
    pictures.append(draw_haemoglobins(folder))
    if people:
        readings = subjects.read_people(scenes := subjects.people())
        pictures.append(draw_people(folder, readings, scenes))
        claims_by_set["people"] = evaluate_people(readings)
    if colour and backends.choose("auto").jit:
        # All sets share their rays.
        nail = load_scene("nail_colour").with_({"blood.tuning": None, "priors.spread": False})
        for name in named:
            if is_shown_by(name, "2"):
                traced = nail_colour.colour(nail.with_({"blood.parameters": name}), photons=FIG2_PHOTONS)
                pictures.append(_written(strip_figure(traced), folder / f"hemodynamics_{name}_fig2.png"))
    elif colour:
        log.warning("Fig. 2 is left out: it needs a backend that compiles kernels (nailoptics doctor).")
    return PaperFigures(claims_by_set, pictures)


def lines(claims_by_set: Mapping[str, list[Claim]]) -> list[str]:
    """The claims for the terminal: below each sentence its rules, with the value of each set and whether it is met.

    A star marks a bound that is our choice alone. Of people, +- is half of the 95 % interval over them.
    """
    rows = as_rows(claims_by_set)
    met = {name: f"{sum(one.met for one in claims)} of {len(claims)}" for name, claims in claims_by_set.items()}
    cells = [*map(_cells, rows, repeat([*claims_by_set])), {"measure": "  rules met", "rule": ""} | met]
    head, *shown, last = aligned(cells)
    text = [head]
    for (figure, sentence), group in groupby(
        zip(rows, shown, strict=True), lambda r: (r[0]["figure"], r[0]["sentence"])
    ):
        where = f"{'Sec.' if figure == 'II' else 'Fig.'} {figure}"
        text += [*textwrap.wrap(f"{where}: {sentence}", 118), *(line for _, line in group)]
    star = "* the bound is our choice; of the others the sentence gives the number, and the tolerance is our choice"
    return [*text, last, star]


def _cells(row: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    """One rule: what is measured, its bounds, and the value and verdict of each set."""
    unit, star = "" if row["unit"] == "1" else f" {row['unit']}", "" if "gives" in row["number"] else " *"
    cells = {"measure": f"  {row['measure']}", "rule": f"{row['rule']}{unit}{star}"} | dict.fromkeys(names, "-")
    for name, one in row["sets"].items():
        half = "" if one["half_95"] is None else f" +- {one['half_95']:.1g}"
        # A negative zero reads as 0; words of one width keep the numbers below each other.
        cells[name] = f"{one['value'] or 0.0:.3g}{half} {'met' if one['met'] else 'not met':7}"
    return cells


@style.drawing()
def draw(directory: Path, responses: paper.Responses, *, name: str) -> list[Path]:
    """Draw the figures that a set of this name shows: hemodynamics_<name>_fig10.png, 11, 12, 15_to_18; their paths."""
    figures = {
        "10": ("Fig. 10: vessels under steps of proximal pressure", _figure_10),
        "11": ("Fig. 11: readings under steps of both pressures", _figure_11),
        "12": ("Fig. 12: steady readings, each against the pressure on its own side", _figure_12),
        "15_to_18": ("Figs. 15 to 18: reading under a force on its own side", _touches),
    }
    paths = []
    for number, (title, drawn) in figures.items():
        if is_shown_by(name, number[:2]):
            path = Path(directory, f"hemodynamics_{name}_fig{number}.png")
            paths.append(_written(drawn(responses), path, title=f"{title} (set “{name}”)"))
    return paths


def _written(figure: "style.Figure", path: Path, *, title: str = "") -> Path:
    """The path of a figure that was written, with its title."""
    if title:
        figure.suptitle(title, x=0.02, ha="left", fontsize=11, fontweight="bold")
    style.write_figure(figure, path)
    return path


def _steps_over_time(panels: list[tuple[str, str, np.ndarray]]) -> "style.Figure":
    """One curve for each step of pressure, in panels of title, label and (pressure, time) values."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import BoundaryNorm, ListedColormap

    figure, axes = style.panels(_WIDTH_IN, 3.7, 1, 2)
    colours: Any = colormaps["viridis_r"](np.linspace(0.12, 1.0, paper.STEPS_PA.size))
    for axis, (title, label, paths) in zip(axes, panels, strict=True):
        axis.axvspan(0.0, paper.ON_S, color="#f4f4f4", lw=0)
        for path, colour in zip(paths, colours, strict=True):
            axis.plot(_TIME_S, path, color=colour)
        axis.set(title=title, ylabel=label, xlabel="time [s]", xlim=(0.0, _TIME_S[-1]))
        axis.margins(y=0.1)
        here = axis.get_xaxis_transform()
        axis.text(0.5 * paper.ON_S, 0.985, "touch on", transform=here, ha="center", va="top", color=style.MUTED)
    steps = paper.STEPS_PA / PA_PER_N_PER_CM2
    half = 0.5 * (steps[1] - steps[0])
    norm = BoundaryNorm(np.append(steps - half, steps[-1] + half), paper.STEPS_PA.size)
    bar = figure.colorbar(ScalarMappable(norm, ListedColormap(colours)), ax=axes, ticks=steps[::3], pad=0.02)
    bar.set_label("pressure of the step [N/cm²]")
    bar.outline.set_visible(False)
    return figure


def _figure_10(r: paper.Responses) -> "style.Figure":
    width = 1e6 * np.concatenate([r.proximal_on, r.proximal_off], axis=-1)
    capillaries = "Proximal capillaries", "$D_C + x_{C1}$ [µm]", width[0]
    return _steps_over_time([capillaries, ("Vein", "$D_V + x_V$ [µm]", width[2])])


def _figure_11(r: paper.Responses) -> "style.Figure":
    blood = np.concatenate([r.both_on, r.both_off], axis=-1)
    change, label = 1.0 - blood / blood[:, :, :1], "change of $V_{{P{}}}$, Taylor (9) [rest blood]"
    readings = ("Proximal reading", "Distal reading")
    return _steps_over_time([(title, label.format(i + 1), change[i]) for i, title in enumerate(readings)])


def _figure_12(r: paper.Responses) -> "style.Figure":
    figure, axes = style.panels(_WIDTH_IN, 3.5, 1, 2)
    for i, (axis, blood, side) in enumerate(zip(axes, r.alone, _SIDES, strict=True)):
        axis.axvline(1.0, **_VEINS_SHUT)
        axis.plot(paper.CURVE_PA / PA_PER_N_PER_CM2, 1.0 - blood, color=style.ZONES[i], lw=1.8)
        label = f"$P_{{F{i + 1}}}$ alone [N/cm²]"
        axis.set(title=f"$V_{{P{i + 1}}}$, {side}", xlabel=label, ylabel=_READING, xlim=(0.0, 1.6))
    return figure


def _touches(r: paper.Responses) -> "style.Figure":
    """Both readings over a cycle of force, loading and unloading, and over the subjects' step of force."""
    figure, axes = _touch_panels()
    for (side, over_time), axis in np.ndenumerate(axes):
        colour = style.ZONES[side]
        if over_time:
            axis.plot(_TIME_S, np.concatenate([r.press_on[side], r.press_off[side]], axis=-1), color=colour)
        else:
            loading, unloading = r.cycle[side]
            axis.plot(paper.CURVE_PA / PA_PER_N_PER_CM2, loading, color=colour, label="loading")
            axis.plot(paper.CURVE_PA / PA_PER_N_PER_CM2, unloading, color=colour, ls="--", label="unloading")
            gap = np.abs(unloading - loading).max() / np.ptp(r.cycle[side])
            axis.legend(title=f"hysteresis {gap:.1%} of the range")
        axis.set_ylabel(_READING)
    return figure


def _touch_panels() -> "tuple[style.Figure, Any]":
    """Panels for Figs. 15 to 18: a side in each row, over force and over time."""
    figure, axes = style.panels(_WIDTH_IN, 7.4, 2, 2)
    for (side, over_time), axis in np.ndenumerate(axes):
        axis.axvline(paper.ON_S if over_time else 1.0, **_VEINS_SHUT)
        touch = f"1 N until {paper.ON_S:g} s" if over_time else "mean of 3 cycles"
        axis.set_title(f"Fig. {15 + 2 * side + over_time}: force on the {_SIDES[side]} pulp, {touch}")
        axis.set_xlabel("time [s]" if over_time else "force [N]")
    return figure, axes


@style.drawing()
def draw_people(directory: Path, readings: paper.PeopleReadings, scenes: Sequence[Scene]) -> Path:
    """Draw Figs. 15 to 18 of people, coloured by their melanin, into a folder and return their path."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm

    figure, axes = _touch_panels()
    melanin = [scene.finger.melanin_fraction for scene in scenes if scene.finger]
    norm, skins = LogNorm(min(melanin), max(melanin)), colormaps["copper_r"]
    static = paper.CURVE_PA / PA_PER_N_PER_CM2, readings.cycle.mean(axis=-2), readings.cycle_fit.mean(axis=-2)
    press = np.append(readings.press_on, readings.press_off[..., 1:], axis=-1)
    dynamic = paper.press().time_s, press, readings.press_fit
    for (side, column), axis in np.ndenumerate(axes):
        x, people, fits = dynamic if column else static
        changes, fit, colour = 100.0 * people[side], 100.0 * fits[side].mean(axis=0), style.ZONES[side]
        mean, spread = changes.mean(axis=0), changes.std(axis=0, ddof=1)
        for change, share in zip(changes, melanin, strict=True):
            axis.plot(x, change, color=skins(norm(share)), lw=0.9)
        axis.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.2, lw=0, label="± standard deviation")
        axis.plot(x, mean, color=colour, lw=2.4, label="mean")
        axis.plot(x, fit, color=style.INK, lw=1.2, ls="--", label="Taylor (9), fitted to each, mean")
        axis.set_ylabel(f"change of the {_SIDES[side]} reading [%]")
    axes[0, 0].legend(loc="upper right")
    figure.colorbar(ScalarMappable(norm, skins), ax=axes, pad=0.02, label="melanin of the epidermis [1]")
    return _written(figure, directory / "people_fig15_to_18.png")


# Where both curves cross, by source: 796.8 nm in the shipped table; 820 to 825 nm in that of N. Bosschaart et al.,
# Lasers Med. Sci. 29, 453 (2014).
CROSSES_BETWEEN_NM = (797.0, 825.0)


def crossing_nm() -> float:
    """Where blood absorbs alike with and without oxygen, near 800 nm, in the shipped table. [nm]"""
    nm = np.arange(780.0, 821.0)  # over which what oxygen adds to the absorption rises
    return float(np.interp(0.0, np.subtract(*tissue.blood_mu_a_per_mm(nm, [[1.0], [0.0]])), nm))


@style.drawing()
def draw_haemoglobins(directory: Path) -> Path:
    """Draw the absorption of blood and the lines of the shipped LEDs into a folder; returns the path of the figure."""
    figure, axes = style.panels(9.5, 4.4)
    wavelength = np.linspace(600.0, tissue.WAVELENGTH_RANGE_NM[1], 401)
    for so2, colour, label in ((1.0, "#c0303b", "oxygenated"), (0.0, "#3a55b0", "deoxygenated")):
        axes.semilogy(wavelength, tissue.blood_mu_a_per_mm(wavelength, so2), color=colour, label=label)
    low, high = axes.get_ylim()
    for name in ("led_660", "led_800", "led_940"):
        part = load_part(name, expect=LedPart)
        assert isinstance(part, LedPart)
        # On a logarithmic axis the line stands on its lower edge.
        line = np.exp(-4 * np.log(2) * ((wavelength - part.peak_nm) / part.fwhm_nm) ** 2)
        axes.fill_between(wavelength, low, low * (high / low) ** (0.2 * line), color=style.MUTED, alpha=0.25, lw=0)
        foot = low * (high / low) ** 0.02
        axes.text(part.peak_nm, foot, f"{part.peak_nm:g} nm", ha="center", va="bottom", color=style.INK)
    axes.axvspan(*CROSSES_BETWEEN_NM, color=style.VEIN, alpha=0.12, lw=0)
    at = crossing_nm()
    axes.plot(at, tissue.blood_mu_a_per_mm(at, 1.0), "o", color=style.INK, ms=4)
    text = "cross at {:.1f} nm here;\nby source at {:g} to {:g} nm".format(at, *CROSSES_BETWEEN_NM)
    axes.text(CROSSES_BETWEEN_NM[1] + 4.0, low * (high / low) ** 0.62, text, fontsize=8.5)
    axes.set(xlabel="wavelength [nm]", xlim=(600.0, wavelength[-1]), ylim=(low, high))
    axes.set_ylabel("absorption of whole blood [1/mm]")
    axes.legend(loc="upper right")
    title = "Fig. 4: absorption of both haemoglobins, 150 g/L, and the LEDs' lines"
    return _written(figure, directory / "haemoglobin_fig4.png", title=title)


@style.drawing()
def _picture(result: PaperFigures, name: str = "") -> "style.Figure":
    """The first picture whose file has these words in its name."""
    from matplotlib.image import imread

    drawing, axes = style.panels(9.6, 5.0)
    axes.imshow(imread([path for path in result.pictures if name in path.stem][0]))
    axes.set_axis_off()
    return drawing


def _page(result: PaperFigures) -> str:
    drawn = [image(path.read_bytes(), path.stem) for path in result.pictures]
    body = [section("Its claims", preformatted("\n".join(lines(result.claims)))), section("Its figures", *drawn)]
    return document(kicker="paper", title="The paper's figures and claims", lead="", body=body, attributes={})


PAPER = Report(
    ("claims.html",),
    _page,
    lambda result: {"claims": as_rows(result.claims), "pictures": [*map(str, result.pictures)]},
    lambda result, _: [*lines(result.claims), *result.pictures],
    {"picture": _picture},
)
