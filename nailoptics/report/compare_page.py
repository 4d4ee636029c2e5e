"""The page of a comparison: how far Beer-Lambert (8) and Taylor (9) hold on a scene, and why not further."""

from itertools import product
from pathlib import Path

import numpy as np
import xarray as xr

from ..io import write_text
from ..studies.comparison.verdict import claim, verdict
from . import compare_figures
from .html import document, escaped, figure, section, small, table
from .numbers import significant, with_error
from .readings import led_name

HOLDS = (
    "Each model is fitted anew to every range from the start; its largest distance from the trace is given as a part "
    "of the reading's swing over that range. Warm colours are proximal, cool ones distal; bands are 95 % intervals of "
    "the light tracing."
)
SPLIT = (
    "The error of Taylor (9), split where it is largest. Hollow marks cannot be told from 0. The first three add up to "
    "the error against the trace; that blood scatters too is in neither, and comes on top. What changes the mean path "
    "with the blood is the spread of paths: one path for all light."
)
READINGS = "Traced readings and models, as change from the start of the sweep."
ALPHA = (
    "αD² is the mean path in the bed times the absorption of its blood: the exponent of Beer–Lambert (8). Below each "
    "bar, with 95 % intervals, where the error of Taylor (9) reaches 1 % (circle) and 5 % (square) of the swing over "
    "{}. An open arrow: it stays below that over the whole sweep, and lies at its end."
)


def write_comparison(result: xr.Dataset, path: Path) -> None:
    """Write the page, whole or not at all; raises WriteError."""
    judged = verdict(result, 0.05)
    met, total, sweep = judged.surely_within, judged.readings, judged.sweep
    over = "range of saturation" if sweep == "saturation" else f"{sweep} range"
    text = document(
        kicker="reduced optics against traced light",
        title=f"Taylor (9) holds to 5 % for {met} of {total} readings over the whole {over}",
        lead=str(judged),
        cards=_cards(result),
        body=[_led_section(result, led) for led in range(result.sizes["led"])],
        attributes=result.attrs,
    )
    write_text(path, text)


def _led_section(result: xr.Dataset, led: int) -> str:
    """How far the models hold under one LED, and why not further."""
    alpha = ALPHA.format(result.sweep.values[-1])
    lines = [figure(compare_figures.range_errors(result, led=led), f"holds{led}", HOLDS), _limits(result, led)]
    for sweep in (str(s) for s in result.sweep.values):
        lines += [
            f"<h3>What Taylor (9) leaves out, over {escaped(sweep)}</h3>",
            figure(compare_figures.error_parts(result, led=led, sweep=sweep), f"split{led}{sweep}", SPLIT),
            figure(compare_figures.changes(result, led=led, sweep=sweep), f"readings{led}{sweep}", READINGS),
        ]
    lines += ["<h3>How large αD² is</h3>", figure(compare_figures.alpha_d2(result, led=led), f"alpha{led}", alpha)]
    return section(f"How far the models hold: {escaped(led_name(result, led))}", *lines)


def _cards(result: xr.Dataset) -> list[tuple[str, str]]:
    found = claim(result)["bed_alpha_d2"]["at_start"]
    sweep = str(result.sweep.values[0])
    words = f"αD² where the {sweep} starts, over all photodiodes; the paper says about 0.01"
    cards = [(f"{significant(found['least'], 2)} – {significant(found['largest'], 2)}", words)]
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
    worst, *_ = compare_figures.PARTS[str(known.part.values[int(known.values.argmax())])]
    words = f"of the swing: the largest part of the error of Taylor (9), by the median of all readings: “{worst}”"
    return [*cards, (f"{significant(100 * float(known.max()), 2)} %", words)]


def _limits(result: xr.Dataset, led: int) -> str:
    """Up to what force, blood and alpha D^2 each fitted model stays within 1 % and 5 %."""
    head, rows = ["Photodiode", "Swing<br>[% of reading]", "Mean path<br>in own<br>zone [mm]"], []
    columns = list(product(map(str, result.sweep.values), compare_figures.FORMULAS, result.within.values))
    for sweep, model, within in columns:
        formula, unit = compare_figures.FORMULAS[model].replace("–", "–<br>"), "N" if sweep == "force" else "%"
        head.append(f"{formula}<br>to {100 * within:g} %<br>{escaped(sweep)} [{unit}]")
    head += ["αD² at which<br>Taylor (9)<br>errs by 1 %", "at which<br>Taylor (9)<br>errs by 5 %"]
    for j in compare_figures.order(result):
        one = result.isel(led=led, photodiode=j)
        first = one.isel(sweep=0)
        swing = with_error(*(100 * float(first[f"relative_swing{end}"]) for end in ("", "_stderr")))
        path_mm = with_error(float(first.path_mm), float(first.path_mm_stderr))
        cells = [escaped(one.photodiode.values), swing, path_mm]
        for sweep, model, within in columns:
            at = one.sel(sweep=sweep, way="fitted", model=model, within=within)
            cells.append(_interval(at, "limit", compare_figures.scale(sweep)))
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
