"""The page of a comparison: how far Beer-Lambert (8) and Taylor (9) hold on a scene, and why not further."""

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...statistics import Z95
from ...studies.comparison.compare import Verdict, verdict
from .. import style
from ..files import Report
from ..html import document, escaped, figure, section, small, table
from ..maps import led_name
from ..numbers import significant, with_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HOLDS = (
    "Each model is fitted anew to every range from the start; its largest distance from the trace is given as a part "
    "of the reading's swing over that range. Warm colours are proximal, cool ones distal; bands are 95 % intervals of "
    "the light tracing."
)
SPLIT = (
    "The error of Taylor (9), split where it is largest. Hollow marks are compatible with 0. The first three add up to "
    "the error against the trace; that blood scatters too is in neither, and comes on top. What changes the mean path "
    "with the blood is the spread of paths: one path for all light."
)
READINGS = "Traced readings and models, as change from the start of the sweep."
ALPHA = (
    "αD² is the mean path in the bed times the absorption of its blood: the exponent of Beer–Lambert (8). Below each "
    "bar, with 95 % intervals, where the error of Taylor (9) reaches 1 % (circle) and 5 % (square) of the swing over "
    "{}. An open arrow: it stays below that over the whole sweep, and lies at its end."
)


def page(result: xr.Dataset) -> str:
    """The page of a comparison."""
    judged = verdict(result, 0.05)
    met, total, sweep = judged.surely_within, judged.readings, judged.sweep
    over = "range of saturation" if sweep == "saturation" else f"{sweep} range"
    return document(
        kicker="reduced optics against traced light",
        title=f"Taylor (9) holds to 5 % for {met} of {total} readings over the whole {over}",
        lead=verdict_line(judged),
        cards=_cards(result),
        body=[_led_section(result, led) for led in range(result.sizes["led"])],
        attributes=result.attrs,
    )


def _led_section(result: xr.Dataset, led: int) -> str:
    """How far the models hold under one LED, and why not further."""
    alpha = ALPHA.format(result.sweep.values[-1])
    lines = [figure(_range_errors_figure(result, led=led), f"holds{led}", HOLDS), _limits(result, led)]
    for sweep in (str(s) for s in result.sweep.values):
        lines += [
            f"<h3>What Taylor (9) leaves out, over {escaped(sweep)}</h3>",
            figure(_error_parts_figure(result, led=led, sweep=sweep), f"split{led}{sweep}", SPLIT),
            figure(_changes_figure(result, led=led, sweep=sweep), f"readings{led}{sweep}", READINGS),
        ]
    lines += ["<h3>How large αD² is</h3>", figure(_alpha_d2_figure(result, led=led), f"alpha{led}", alpha)]
    return section(f"How far the models hold: {escaped(led_name(result, led))}", *lines)


def _cards(result: xr.Dataset) -> list[tuple[str, str]]:
    claim = paper_claim(result)["bed_alpha_d2"]["at_start"]
    sweep = str(result.sweep.values[0])
    words = f"αD² where the {sweep} starts, over all photodiodes; the paper says about 0.01"
    cards = [(f"{significant(claim['least'], 2)} – {significant(claim['largest'], 2)}", words)]
    for within in (0.01, 0.05):
        taylor, exact = (verdict(result, within, model=model) for model in ("taylor", "beer_lambert"))
        words = f"readings that fitted Taylor (9), and Beer–Lambert (8), meet within {100 * within:g} % of their swing "
        words += f"over the {taylor.sweep}"
        cards.append((f"{taylor.surely_within} and {exact.surely_within} of {taylor.readings}", words))
    if "blood" in result.sweep.values:
        one = result.sel(sweep="blood", way="fitted", model="taylor", within=0.01)
        low, high = (significant(100 * float(f(one.limit)), 2) for f in (np.min, np.max))
        cards.append((f"{low} – {high} %", "blood fraction up to which Taylor (9) errs by less than 1 %"))
    parts = np.abs(result.isel(sweep=0, point=-1).sel(way="fitted").part_error).median(("led", "photodiode"))
    # A part that no time was left to trace is not known.
    if not (known := parts.dropna("part")).size:
        return cards
    worst, *_ = PARTS[str(known.part.values[int(known.values.argmax())])]
    words = f"of the swing: the largest part of the error of Taylor (9), by the median of all readings: “{worst}”"
    return [*cards, (f"{significant(100 * float(known.max()), 2)} %", words)]


def _limits(result: xr.Dataset, led: int) -> str:
    """Up to what force, blood and alpha D^2 each fitted model stays within 1 % and 5 %."""
    head, rows = ["Photodiode", "Swing<br>[% of reading]", "Mean path<br>in own<br>zone [mm]"], []
    columns = list(product(map(str, result.sweep.values), FORMULAS, result.within.values))
    for sweep, model, within in columns:
        formula, unit = FORMULAS[model].replace("–", "–<br>"), "N" if sweep == "force" else "%"
        head.append(f"{formula}<br>to {100 * within:g} %<br>{escaped(sweep)} [{unit}]")
    head += ["αD² at which<br>Taylor (9)<br>errs by 1 %", "at which<br>Taylor (9)<br>errs by 5 %"]
    for j in _photodiode_order(result):
        one = result.isel(led=led, photodiode=j)
        first = one.isel(sweep=0)
        swing = with_error(*(100 * float(first[f"relative_swing{end}"]) for end in ("", "_stderr")))
        path_mm = with_error(float(first.path_mm), float(first.path_mm_stderr))
        cells = [escaped(one.photodiode.values), swing, path_mm]
        for sweep, model, within in columns:
            at = one.sel(sweep=sweep, way="fitted", model=model, within=within)
            cells.append(_interval(at, "limit", _display_scale(sweep)))
        for within in result.within.values:
            at = one.isel(sweep=-1).sel(way="fitted", model="taylor", within=within)
            cells.append(_interval(at, "limit_bed_alpha_d2", 1.0))
        rows.append(cells)
    note = (
        "Numbers in brackets are 95 % intervals; “all” means the whole sweep. αD² is that of all the blood in the bed, "
        f"over {escaped(result.sweep.values[-1])}."
    )
    return table(head, rows, kind="dense") + small(note)


def _interval(one: xr.Dataset, name: str, by: float) -> str:
    value, low, high = (by * float(one[f"{name}{suffix}"]) for suffix in ("", "_low", "_high"))
    if not bool(one.limit_ends):
        return "all" if name == "limit" else f"&gt; {significant(value, 2)}"
    low, high = max(min(low, high), 0.0), max(low, high)
    return f"{significant(value, 2)}<br><span class='small'>({significant(low, 2)}–{significant(high, 2)})</span>"


X_LABELS = {"force": "force [N]", "blood": "blood fraction of both zones [%]", "saturation": "oxygen saturation [%]"}
# Name, colour and mark of each part of the error of Taylor (9).
PARTS = {
    "truncation": ("truncation to first order", "#e08a3c", "s"),
    "one_path": ("single path length", "#7a5aa6", "D"),
    "both_zones": ("both zones contribute", "#2f7fc9", "o"),
    "blood_scattering": ("scattering by blood", "#4b8b5a", "^"),
}
WAY_TITLES = {
    "fitted": "constants fitted to the readings",
    "predicted": "no fit: own zone's mean path",
    "predicted_both": "no fit: both zones' mean paths",
}
FORMULAS = {"taylor": "Taylor (9)", "beer_lambert": "Beer–Lambert (8)"}
_FLOOR, _CEILING = 0.01, 150.0
# Panels side by side.
COLUMNS = 4


def _display_scale(sweep: str) -> float:
    """What a sweep's settings are multiplied by to be shown."""
    return 1.0 if sweep == "force" else 100.0


def _photodiode_order(result: xr.Dataset) -> list[int]:
    """Photodiodes as the figures list them: proximal ones first, in the scene's order."""
    return [int(i) for i in np.argsort(result.zone_of_photodiode.values, kind="stable")]


@style.drawing()
def _range_errors_figure(result: xr.Dataset, *, led: int) -> "Figure":
    """The error of fitted (9) and (8) over each range from the sweep's start with 95 % intervals, beside 1 and 5 %."""
    places, sweeps = _photodiode_order(result), [str(s) for s in result.sweep.values]
    height_in = 0.9 + 3.0 * len(sweeps)
    room, how = style.Room(left=0.65, top=0.6, across=0.35, down=0.65), {"sharey": True, "sharex": "row"}
    figure, grid = style.panels(9.6, height_in, len(sweeps), 2, room_in=room, squeeze=False, **how)
    for row, sweep in zip(grid, sweeps, strict=True):
        for axes, (model, formula) in zip(row, FORMULAS.items(), strict=True):
            one = result.sel(sweep=sweep, way="fitted", model=model).isel(led=led)
            x = one.setting.values * _display_scale(sweep)
            for colour, j in zip(style.place_colours(len(places)), places, strict=True):
                error, stderr = 100 * one.range_error.values[j], 100 * one.range_error_stderr.values[j]
                low, high = (np.clip(error + k * Z95 * stderr, _FLOOR, _CEILING) for k in (-1, 1))
                axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0)
                axes.plot(x, np.clip(error, _FLOOR, None), color=colour, label=style.plain(one.photodiode.values[j]))
            left = axes.get_yaxis_transform()
            for tolerance in (1, 5):
                axes.axhline(tolerance, color=style.INK, lw=0.9, ls=(0, (4, 2)))
                axes.text(0.005, tolerance * 1.08, f"{tolerance} %", transform=left, ha="left", fontsize=8)
            axes.set(yscale="log", ylim=(_FLOOR, _CEILING), xlim=(x[0], x[-1]))
            axes.set_yticks([0.01, 0.1, 1, 10, 100], ["0.01", "0.1", "1", "10", "100"])
            axes.minorticks_off()
            axes.set_xlabel(f"range from {x[0]:g} to this {X_LABELS[sweep]}")
            axes.set_title(f"{formula}, fitted, over {sweep}")
        row[0].set_ylabel("largest error [% of swing]")
    style.legend_above(figure, grid[0, 0], ncols=min(len(places), 8), columnspacing=1.2, handlelength=1.4)
    return figure


@style.drawing()
def _error_parts_figure(result: xr.Dataset, *, led: int, sweep: str) -> "Figure":
    """What the error of (9) is made of, photodiode by photodiode, where it is largest."""
    places = _photodiode_order(result)
    height_in, count = 1.3 + 0.42 * len(places), result.sizes["way"]
    figure, panels = style.panels(9.6, height_in, 1, count, sharey=True, sharex=True, squeeze=False)
    for axes, way in zip(panels[0], result.way.values, strict=True):
        one = result.sel(sweep=sweep, way=way).isel(led=led)
        for row, j in enumerate(places):
            at = int(np.abs(one.error.sel(model="taylor").values[j]).argmax())
            axes.axhspan(row - 0.5, row + 0.5, color=style.GRID, alpha=0.5 * (row % 2), lw=0)
            for k, part in enumerate(result.part.values):
                here = one.sel(part=part).isel(photodiode=j, point=at)
                _dot(axes, here, row + 0.17 * (k - 1.5), labelled=row == 0)
        axes.set(title=WAY_TITLES[str(way)], xscale="log", xlabel="absolute error of Taylor (9)\n[% of swing]")
        axes.minorticks_off()
        for tolerance in (1, 5):
            axes.axvline(tolerance, color=style.INK, lw=0.8, ls=(0, (4, 2)))
    first = panels[0, 0]
    low, high = first.get_xlim()
    first.set_xlim(max(low, 0.01), min(high, 2000))
    ticks = [t for t in (0.01, 0.1, 1, 10, 100, 1000) if max(low, 0.01) <= t <= high]
    first.set_xticks(ticks, [f"{t:g}" for t in ticks])
    _name_rows(first, result, places)
    first.set_ylim(len(places) - 0.5, -0.5)
    style.legend_above(figure, first, ncols=4)
    return figure


def _name_rows(axes: "Axes", result: xr.Dataset, places: list[int]) -> None:
    axes.set_yticks(range(len(places)), [style.plain(result.photodiode.values[j]) for j in places])


def _dot(axes: "Axes", part: xr.Dataset, y: float, *, labelled: bool) -> None:
    """One part of an error with its 95 % interval; hollow where that holds 0."""
    size, spread = 100 * abs(float(part.part_error)), 100 * Z95 * float(part.part_error_stderr)
    name, colour, mark = PARTS[str(part.part.values)]
    look: Any = {"color": colour, "ls": "none", "marker": mark, "label": name if labelled else None}
    if np.isfinite(size) and size > 0:
        axes.plot([max(size - spread, 1e-3), size + spread], [y, y], color=colour, lw=1.2)
        axes.plot([size], [y], markerfacecolor=colour if size > spread else style.PAPER, markersize=5.5, **look)
    elif labelled:
        axes.plot([], [], **look)


@style.drawing()
def _alpha_d2_figure(result: xr.Dataset, *, led: int) -> "Figure":
    """How large alpha D^2 is over the first sweep and up to which (9) holds over the last, beside the paper's 1e-2."""
    from matplotlib.ticker import LogLocator

    places = _photodiode_order(result)
    first = result.isel(led=led, sweep=0)
    fails = result.isel(led=led, sweep=-1).sel(way="fitted", model="taylor")
    figure, axes = style.panels(9.6, 1.3 + 0.4 * len(places))
    for row, (j, colour) in enumerate(zip(places, style.place_colours(len(places)), strict=True)):
        values = first.bed_alpha_d2.values[j]
        ends = [max(values.min(), 1e-4), values.max()]
        axes.plot(ends, [row, row], color=colour, lw=7, solid_capstyle="butt", alpha=0.75)
        axes.plot(values[0], row, "|", color=style.INK, ms=13, mew=2, label="at the start" if row == 0 else None)
        _limits_of_taylor(axes, fails.isel(photodiode=j), row + 0.27, labelled=row == 0)
    axes.axvline(0.01, color=style.ZONES[0], lw=1.4, ls=(0, (5, 2)))
    axes.text(0.0103, -0.62, "the paper: about 10$^{-2}$", color=style.ZONES[0], fontsize=8.5, va="bottom")
    axes.set_xscale("log")
    _name_rows(axes, result, places)
    axes.set_ylim(len(places) - 0.4, -0.7)
    axes.set_xlabel(f"αD² of all the blood in the bed: bars, its range over {first.sweep.values} [1]")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3)
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 4)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter("{x:g}")
    return figure


def _limits_of_taylor(axes: "Axes", fails: xr.Dataset, y: float, *, labelled: bool) -> None:
    """Alpha D^2 at which (9) errs by 1 % and 5 %, with 95 % intervals; an arrow where it does not within the sweep."""
    for mark, within in (("o", 0.01), ("s", 0.05)):
        here = fails.sel(within=within)
        value, low, high = (float(here[f"limit_bed_alpha_d2{s}"]) for s in ("", "_low", "_high"))
        axes.plot([low, high], [y, y], color=style.INK, lw=1)
        if not here.limit_ends:
            axes.plot(value, y, ">", ms=5, color=style.INK, markerfacecolor=style.PAPER)
            break
        label = f"error of Taylor (9): {100 * within:g} % of swing, over {fails.sweep.values}" if labelled else None
        axes.plot(value, y, mark, ms=5, color=style.INK, label=label)


@style.drawing()
def _changes_figure(result: xr.Dataset, *, led: int, sweep: str) -> "Figure":
    """Every photodiode's traced change over a sweep beside the models, in percent of its reading at the start."""
    places, one = _photodiode_order(result), result.sel(sweep=sweep).isel(led=led)
    x = one.setting.values * _display_scale(sweep)
    models = (
        ("predicted", "beer_lambert", style.MUTED, (0, (1, 1.5)), "Beer–Lambert (8), no fit, own zone"),
        ("predicted_both", "beer_lambert", style.VEIN, (0, (6, 2)), "Beer–Lambert (8), no fit, both zones"),
        ("fitted", "taylor", style.INK, (0, (4, 2)), "Taylor (9), fitted"),
    )
    room = style.Room(left=0.65, top=0.6, across=0.45, down=0.3)
    figure, panels = style.tiles(len(places), COLUMNS, 9.6, 2.0, extra_in=0.6, room_in=room, sharex=True)
    for k, (axes, j, colour) in enumerate(zip(panels, places, style.place_colours(len(places)), strict=True)):
        traced = one.reading.values[j]
        axes.plot(x, 100 * (traced / traced[0] - 1), color=colour, lw=3, alpha=0.8, label="traced")
        for way, model, ink, dashes, label in models:
            values = one.sel(way=way, model=model).model_reading.values[j]
            axes.plot(x, 100 * (values / traced[0] - 1), color=ink, ls=dashes, lw=1.2, label=label)
        axes.set(title=style.plain(result.photodiode.values[j]), xlim=(x[0], x[-1]))
        axes.set(
            xlabel=X_LABELS[sweep] if k + COLUMNS >= len(places) else "", ylabel="" if k % COLUMNS else "change [%]"
        )
        style.remark(axes, f"swing {significant(100 * float(one.swing[j] / traced[0]), 2)} %")
    style.legend_above(figure, panels[0], ncols=4)
    return figure


_DIMS = ("sweep", "led", "photodiode")
_ALPHA_D2 = ("alpha_d2", "bed_alpha_d2")


def summary(result: xr.Dataset) -> dict[str, Any]:
    """A comparison: readings by sweep, LED and photodiode, and the paper's claim."""
    places = np.ndindex(*(result.sizes[name] for name in _DIMS))
    rows = [_row(result.isel(dict(zip(_DIMS, at, strict=True)))) for at in places]
    names = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest")
    whole = {"comparisons": rows, "claim": paper_claim(result), "cut_off": result.attrs.get("cut_off")}
    whole |= {"reused": bool(result.attrs.get("reused", 0))}
    return whole | {name: result.attrs[name] for name in names}


def _row(one: xr.Dataset) -> dict[str, Any]:
    """One photodiode under one LED over one sweep."""
    row: dict[str, Any] = {name: str(one[name].values) for name in _DIMS}
    row |= {"swing_of_reading": float(one.swing / one.reading[0]), "path_mm": _with_stderr(one, "path_mm")}
    for name in _ALPHA_D2:
        row |= {f"{name}_{end}": _with_stderr(one.isel(point=at), name) for end, at in (("start", 0), ("end", -1))}
    for way, model in product(map(str, one.way.values), map(str, one.model.values)):
        here = one.sel(way=way, model=model)
        limits = {f"{within:g}": _limit(here.sel(within=within)) for within in one.within.values}
        row[f"{model}_{way}"] = {"error_of_swing": _with_stderr(here.isel(point=-1), "range_error"), "holds_to": limits}
    for way in map(str, one.way.values):
        worst = int(np.abs(one.error.sel(way=way, model="taylor").values).argmax())
        parts = one.sel(way=way).isel(point=worst)
        row[f"parts_{way}"] = {str(p): _with_stderr(parts.sel(part=p), "part_error") for p in one.part.values}
    return row


def _limit(here: xr.Dataset) -> dict[str, Any]:
    """Up to where a model holds, in every measure."""
    limits: dict[str, Any] = {"ends_within_sweep": bool(here.limit_ends)}
    for name in ("setting", "blood_fraction", *_ALPHA_D2):
        limit = "limit" if name == "setting" else f"limit_{name}"
        limits[name] = {"value": float(here[limit])} | {end: float(here[f"{limit}_{end}"]) for end in ("low", "high")}
    return limits


def paper_claim(result: xr.Dataset) -> dict[str, Any]:
    """How large alpha D^2 is over the first sweep, beside the paper's 1e-2."""
    first = result.isel(sweep=0)
    claim: dict[str, Any] = {"paper": 0.01, "sweep": str(result.sweep.values[0])}
    for name in _ALPHA_D2:
        ends = {}
        for key, values in (("at_start", first[name].isel(point=0)), ("over_sweep", first[name])):
            ends[key] = {"least": float(values.min()), "largest": float(values.max())}
        ends["at_start"]["stderr"] = float(first[f"{name}_stderr"].isel(point=0).max())
        claim[name] = ends
    return claim


def _with_stderr(one: xr.Dataset, name: str) -> dict[str, float]:
    return {"value": float(one[name]), "stderr": float(one[f"{name}_stderr"])}


def verdict_line(judged: Verdict) -> str:
    """Whether a model holds over a sweep, how sure that is, and its largest error."""
    largest, low, high = (f"{100 * x:.3g}" for x in (judged.worst_error, judged.worst_low, judged.worst_high))
    name = {"taylor": "Taylor (9)", "beer_lambert": "Beer-Lambert (8)"}[judged.model]
    of = f"{100 * judged.tolerance:g} % of the swing of all {judged.readings} readings over the {judged.sweep}"
    confidence = "over 99.9" if judged.sure > 0.999 else f"{100 * judged.sure:.3g}"
    words = {
        "met": f"{name} stays within {of} ({confidence} % confidence)",
        "missed": f"{name} does not stay within {of} ({confidence} % confidence)",
        "undecided": f"Whether {name} stays within {of} is undecided; trace more photons",
    }
    where = f"LED {judged.led}, photodiode {judged.photodiode}"
    return f"{words[judged.outcome]}. Largest error: {largest} % (95 % interval {low} to {high} %), {where}."


COMPARISON = Report(
    ("compare.nc", "compare.html"),
    lambda result: (result, lambda _: page(result)),
    summary,
    lambda result, summary: [],
)
