"""The page of a comparison: how far Beer-Lambert (8) and Taylor (9) hold on a scene, and why not further."""

from itertools import product
from typing import Any

import numpy as np
import xarray as xr

from ...scene import parse_scene
from ...statistics import Z95
from ...studies.compare import Verdict, verdict
from .. import style
from ..files import Report, run_summary
from ..html import Html, document, figure, section, small, subheading, table, texts
from ..maps import coloured_along_nail, led_name
from ..numbers import estimated, plain, significant, with_stderr

TEXTS = texts("compare")
X_LABELS, WAYS, FORMULAS = (TEXTS[name] for name in ("axes", "ways", "formulas"))
# What a sweep's settings are multiplied by to be shown.
SHOWN_BY = {"force": 1.0, "blood": 100.0, "saturation": 100.0}
# Label, colour and marker of each part of the error of Taylor (9).
PARTS = TEXTS["parts"]


def page(result: xr.Dataset) -> str:
    """The page of a comparison."""
    decision = verdict(result, 0.05)
    over = "range of saturation" if decision.sweep == "saturation" else f"{decision.sweep} range"
    return document(
        kicker="reduced optics against traced light",
        title=TEXTS["title"].format(_counted(decision), over),
        lead=verdict_line(decision),
        cards=_cards(result),
        body=[_led_section(result, led) for led in range(result.sizes["led"])],
        attributes=result.attrs,
    )


def _led_section(result: xr.Dataset, led: int) -> Html:
    """How far the models hold under one LED, and why not further."""
    rows, groups = _limits(result, led)
    parts = [figure(_range_errors_figure(result, led=led), TEXTS["holds"]), table(rows, groups=groups, kind="dense")]
    parts.append(small(TEXTS["limits"]))
    for sweep in map(str, result.sweep.values):
        parts.append(subheading(f"What Taylor (9) leaves out, over {sweep}"))
        for draw, caption in ((_error_parts_figure, TEXTS["split"]), (_changes_figure, TEXTS["readings"])):
            parts.append(figure(draw(result, led=led, sweep=sweep), caption))
    return section(f"How far the models hold: {led_name(result, led)}", *parts)


def _cards(result: xr.Dataset) -> list[tuple[str, str]]:
    """How many readings each fitted model meets, and what Taylor (9) leaves out first."""
    cards = []
    for within in (0.01, 0.05):
        taylor, exact = (verdict(result, within, model=model) for model in FORMULAS)
        words = TEXTS["meet"].format(100 * within, taylor.sweep)
        cards.append((f"{_counted(taylor)}; {_counted(exact)}", words))
    parts = np.abs(result.isel(sweep=0, point=-1).sel(way="fitted").part_error).median(("led", "photodiode"))
    # A part that no time was left to trace is not known.
    if (known := parts.dropna("part")).size:
        words = TEXTS["largest"].format(PARTS[str(known.part.values[int(known.values.argmax())])]["label"])
        cards.append((f"{significant(100 * float(known.max()), 2)} %", words))
    return cards


def _counted(decision: Verdict) -> str:
    """How many readings a model meets; those of which the traces do not decide it are named apart."""
    undecided = f" ({decision.undecided} undecided)" if decision.undecided else ""
    return f"{decision.surely_within} of {decision.readings}{undecided}"


def _limits(result: xr.Dataset, led: int) -> tuple[list[dict[str, str]], list[str]]:
    """Up to what setting, and what alpha D^2, each fitted model stays within 1 % and 5 %; and the sweep of each row."""
    rows, groups = [], []
    for sweep, j in product(map(str, result.sweep.values), range(result.sizes["photodiode"])):
        pair = result.sel(sweep=sweep).isel(led=led, photodiode=j)
        row = {"Photodiode": str(pair.photodiode.values), "Swing [%]": estimated(pair, "relative_swing", 100)}
        row["Mean path [mm]"] = estimated(pair, "path_mm")
        for model, within in product(FORMULAS, pair.within.values):
            at = pair.sel(way="fitted", model=model, within=within)
            row[f"{FORMULAS[model]} to {100 * within:g} %"] = _interval(at, "limit", SHOWN_BY[sweep])
        row["αD² [1]"] = " – ".join(significant(float(f(pair.bed_alpha_d2)), 2) for f in (np.min, np.max))
        for within in pair.within.values:
            at = pair.sel(way="fitted", model="taylor", within=within)
            row[f"αD² for {100 * within:g} % of Taylor (9)"] = _interval(at, "limit_bed_alpha_d2", 1.0)
        rows.append(row)
        groups.append(f"Over {sweep}: limits of the {X_LABELS[sweep]}")
    return rows, groups


def _interval(limits: xr.Dataset, name: str, by: float) -> str:
    value, low, high = (by * float(limits[f"{name}{suffix}"]) for suffix in ("", "_low", "_high"))
    if not bool(limits.limit_ends):
        return "all" if name == "limit" else f"> {significant(value, 2)}"
    low, high = max(min(low, high), 0.0), max(low, high)
    shown, ends = significant(value, 2), f"({significant(low, 2)}–{significant(high, 2)})"
    return Html(f"{shown}<br><span class='small'>{ends}</span>")


# Errors that the axes show, and those that are marked. [% of swing]
SHOWN, MARKED = (0.01, 500.0), (1, 5)


def _photodiodes(result: xr.Dataset) -> list[tuple[str, int]]:
    """Colour and index of each photodiode, from the most proximal to the most distal."""
    return coloured_along_nail(parse_scene(str(result.attrs["scene"]), name="the result's scene"))


@style.drawing()
def _range_errors_figure(result: xr.Dataset, *, led: int = 0) -> "style.Figure":
    """The error of both models, fitted over each range from the sweep's start, with 95 % intervals."""
    photodiodes, sweeps = _photodiodes(result), [str(s) for s in result.sweep.values]
    room, how = style.Room(left=0.65, top=0.6, across=0.35, down=0.65), {"sharey": True, "sharex": "row"}
    figure, grid = style.panels(9.6, 0.9 + 3.0 * len(sweeps), len(sweeps), 2, room_in=room, squeeze=False, **how)
    for row, sweep in zip(grid, sweeps, strict=True):
        for axes, (model, formula) in zip(row, FORMULAS.items(), strict=True):
            axes.set(yscale="log", ylim=SHOWN)
            fitted = result.sel(sweep=sweep, way="fitted", model=model).isel(led=led)
            x = fitted.setting.values * SHOWN_BY[sweep]
            for colour, j in photodiodes:
                # Of as many settings as constants there is no error.
                error = 100 * fitted.range_error[j].where(fitted.range_error[j] > 0)
                stderr = 100 * fitted.range_error_stderr[j]
                style.estimate(axes, x, error, stderr, color=colour, label=style.plain(fitted.photodiode.values[j]))
            for tolerance in MARKED:
                axes.axhline(tolerance, color=style.INK, lw=0.9, ls=(0, (4, 2)))
            axes.set_title(f"{formula}, fitted, over {sweep}")
            axes.xaxis.set_major_formatter("{x:g}")
            axes.set(xlim=(x[0], x[-1]), xlabel=f"range from {x[0]:g} to this {X_LABELS[sweep]}")
        row[0].set_ylabel("largest error [% of swing]")
    style.plain_log(grid[0, 0].yaxis)
    style.legend_above(figure, grid[0, 0], ncols=min(len(photodiodes), 8), columnspacing=1.2, handlelength=1.4)
    return figure


@style.drawing()
def _error_parts_figure(result: xr.Dataset, *, led: int = 0, sweep: str = "blood") -> "style.Figure":
    """What the error of Taylor (9) is made of, photodiode by photodiode, where it is largest."""
    order = [j for _, j in _photodiodes(result)]
    rows, height_in = np.arange(len(order)), 1.3 + 0.42 * len(order)
    figure, panels = style.panels(9.6, height_in, 1, result.sizes["way"], sharey=True, sharex=True, squeeze=False)
    for axes, way in zip(panels[0], result.way.values, strict=True):
        parts = result.sel(sweep=sweep, way=way).isel(led=led, photodiode=order)
        error = parts.error.sel(model="taylor", drop=True)
        worst = parts[["part_error", "part_error_stderr"]].isel(point=abs(error).fillna(0.0).argmax("point"))
        for row in rows[1::2]:
            axes.axhspan(row - 0.5, row + 0.5, color=style.GRID, alpha=0.5, lw=0)
        for k, part in enumerate(map(str, result.part.values)):
            at, y, colour = worst.sel(part=part), rows + 0.17 * (k - 1.5), PARTS[part]["edgecolors"]
            size, spread = 100 * abs(at.part_error.values), 100 * Z95 * at.part_error_stderr.values
            axes.hlines(y, np.maximum(size - spread, 1e-3), size + spread, color=colour, lw=1.2)
            axes.scatter(size, y, 30, np.where(size > spread, colour, style.PAPER), zorder=3, lw=1.0, **PARTS[part])
        axes.set(title=WAYS[str(way)], xscale="log", xlabel="absolute error of Taylor (9)\n[% of swing]")
        for tolerance in MARKED:
            axes.axvline(tolerance, color=style.INK, lw=0.8, ls=(0, (4, 2)))
    first = panels[0, 0]
    first.set_xlim(SHOWN)
    style.plain_log(first.xaxis)
    style.named_rows(first, result.photodiode.values[order])
    style.legend_above(figure, first, ncols=4)
    return figure


def _changes_figure(result: xr.Dataset, *, led: int = 0, sweep: str = "blood") -> "style.Figure":
    """Every photodiode's traced change over a sweep beside the models, in percent of its reading at the start."""
    colours, order = zip(*_photodiodes(result), strict=True)
    changes = result.sel(sweep=sweep).isel(led=led, photodiode=list(order))
    start = changes.reading.isel(point=0)
    models = {}
    for (way, shown), ink in zip(TEXTS["shown"].items(), (style.MUTED, style.VEIN, style.INK), strict=True):
        change = changes.model_reading.sel(way=way, model=shown["model"]) / start - 1
        models[shown["label"]] = 100 * change.values, {"color": ink, "ls": (0, shown["dashes"])}
    x, traced = changes.setting.values * SHOWN_BY[sweep], 100 * (changes.reading / start - 1).values
    named = dict(zip(changes.photodiode.values, colours, strict=True))
    labels = {"xlabel": X_LABELS[sweep], "ylabel": "change [%]"}
    return style.beside_models(x, traced, np.zeros_like(traced), models, named=named, **labels)


_DIMS = ("sweep", "led", "photodiode")
_ALPHA_D2 = ("alpha_d2", "bed_alpha_d2")


def summary(result: xr.Dataset) -> dict[str, Any]:
    """A comparison: readings by sweep, LED and photodiode, and the paper's claim."""
    places = np.ndindex(*(result.sizes[name] for name in _DIMS))
    rows = [_row(result.isel(dict(zip(_DIMS, at, strict=True)))) for at in places]
    first = result.isel(sweep=0)
    # How large alpha D^2 is over the first sweep, beside the paper's 1e-2.
    claim: dict[str, Any] = {"paper": 0.01, "sweep": str(first.sweep.values)}
    for name in _ALPHA_D2:
        ends = {}
        for key, values in (("at_start", first[name].isel(point=0)), ("over_sweep", first[name])):
            ends[key] = {"least": float(values.min()), "largest": float(values.max())}
        ends["at_start"]["stderr"] = float(first[f"{name}_stderr"].isel(point=0).max())
        claim[name] = ends
    return {"comparisons": rows, "claim": claim} | run_summary(result.attrs)


def _row(pair: xr.Dataset) -> dict[str, Any]:
    """One photodiode under one LED over one sweep."""
    row = plain(pair, *_DIMS)
    row |= {"swing_of_reading": float(pair.swing / pair.reading[0]), "path_mm": with_stderr(pair, "path_mm")}
    for name, (end, at) in product(_ALPHA_D2, (("start", 0), ("end", -1))):
        row[f"{name}_{end}"] = with_stderr(pair.isel(point=at), name)
    for way, model in product(pair.way.values, pair.model.values):
        here = pair.sel(way=way, model=model)
        limits = {f"{within:g}": _limit(here.sel(within=within)) for within in pair.within.values}
        row[f"{model}_{way}"] = {"error_of_swing": with_stderr(here.isel(point=-1), "range_error"), "holds_to": limits}
    for way in pair.way.values:
        worst = int(np.abs(pair.error.sel(way=way, model="taylor").values).argmax())
        parts = pair.sel(way=way).isel(point=worst)
        row[f"parts_{way}"] = {str(p): with_stderr(parts.sel(part=p), "part_error") for p in pair.part.values}
    return row


def _limit(here: xr.Dataset) -> dict[str, Any]:
    """Up to where a model holds, in every measure."""
    names = {"setting": "limit"} | {name: f"limit_{name}" for name in ("blood_fraction", *_ALPHA_D2)}
    limits = {key: plain(here, value=name, low=f"{name}_low", high=f"{name}_high") for key, name in names.items()}
    return {"ends_within_sweep": bool(here.limit_ends)} | limits


def verdict_line(decision: Verdict) -> str:
    """Whether a model holds over a sweep, how sure that is, and its largest error."""
    errors = (f"{100 * x:.3g}" for x in (decision.worst_error, decision.worst_low, decision.worst_high))
    of = f"{100 * decision.tolerance:g} % of the swing of all {decision.readings} readings over the {decision.sweep}"
    confidence = "over 99.9" if decision.sure > 0.999 else f"{100 * decision.sure:.3g}"
    words = TEXTS["verdict"][decision.outcome].format(FORMULAS[decision.model].replace("–", "-"), of, confidence)
    return TEXTS["largest_error"].format(words, *errors, decision.led, decision.photodiode)


def lines(result: xr.Dataset, tolerance: float = 0.05) -> list[str]:
    """Whether each fitted model holds within a tolerance, and what that is, for the terminal."""
    return [*(verdict_line(verdict(result, tolerance, model=model)) for model in FORMULAS), TEXTS["tolerance"]]


COMPARISON = Report(
    ("compare.nc", "compare.html"),
    page,
    summary,
    lambda result, _: lines(result),
    {"range": _range_errors_figure, "errors": _error_parts_figure, "changes": _changes_figure},
)
