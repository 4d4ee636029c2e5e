"""The page of a sweep: what is done, plots over its axes, its failures, and photographs on a contact sheet."""

import textwrap
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr

from ...batch import write_table
from ...errors import InputError
from ...io import write_text
from ...variables import unit_of
from .. import style
from ..files import Report, run_summary
from ..html import document, figure, section, small, table, texts
from ..numbers import aligned, prefix, significant

# Axes after which no more figures are drawn, and lines in one of them.
FIGURES, LINES = 6, 12
_QUANTITIES = ("volts_change_peak", "volts_start", "detected_fraction_rest", "ratio_at_rest")


def write_sweep(results: xr.Dataset, folder: Path, *, failures: Mapping[str, str]) -> dict[str, Path]:
    """Write the table and the page of what `batch.open_results` returns, and its photographs; raises WriteError."""
    paths = {"report": folder / "report.html", "table": folder / "table.csv"}
    write_table(results, paths["table"])
    write_text(paths["report"], page(results, failures=failures))
    if "photograph" in results:
        paths["contact_sheet"] = folder / "contact_sheet.png"
        style.write_figure(contact_sheet(results), paths["contact_sheet"], dpi=200)
    return paths


def page(results: xr.Dataset, *, failures: Mapping[str, str] = MappingProxyType({})) -> str:
    """The page of what `batch.open_results` returns.

    failures : why scenes failed, by digest.
    """
    count, states = results.state.size, _states(results).items()
    rows, sheet = [{"Scene": digest[:12], "Why": why} for digest, why in failures.items()], ""
    if "photograph" in results:
        caption = f"The first {min(count, MOST_SCENES)} of {count} scenes. {texts('colour')['photograph']}"
        sheet = section("Photographs", figure(contact_sheet(results), caption))
    failed = section(f"{len(failures)} failed", table(rows)) if rows else ""
    return document(
        kicker="sweep",
        title=str(results.attrs["title"]).removeprefix("nailoptics: "),
        lead=f"{count} scenes: {', '.join(f'{number} {state}' for state, number in states)}.",
        body=[section("The axes", table(_axes(results))), sheet, _figures(results), failed],
        attributes=results.attrs,
    )


def axes_of(results: xr.Dataset) -> list[str]:
    """Names of the sweep's axes: the coordinates along the dimensions of its scenes."""
    return [str(n) for n, c in results.coords.items() if c.dims and set(c.dims) <= set(results.state.dims)]


def _axes(results: xr.Dataset) -> list[dict[str, str]]:
    rows = []
    for name in axes_of(results):
        values = list(dict.fromkeys(results[name].values.tolist()))
        if results[name].dtype.kind in "iuf":
            shown = f"{significant(min(values), 4)} to {significant(max(values), 4)}"
        else:
            shown = ", ".join(str(v) for v in values[:8]) + (", …" if len(values) > 8 else "")
        place = results[name].attrs.get("long_name", "")
        rows.append({"Axis": name, "Place in the scene": place, "Values": str(len(values)), "From, to": shown})
    return rows


def _figures(results: xr.Dataset) -> str:
    quantity = _quantity(results)
    if quantity is None:
        return ""
    text, lines = str(results[quantity].attrs["long_name"]), [small(texts("sweep")["note"])]
    if "feedback_ohm" in results and "feedback_ohm" not in str(_axes(results)):
        ohm, dims = results.feedback_ohm, results.state.dims
        lines += [small(texts("sweep")["fitted"])] if (ohm.max(dims) > ohm.min(dims)).any() else []
    for name in _varied(results)[:FIGURES]:
        lines.append(figure(_along(results, name), f"Over {results[name].attrs.get('long_name', name)}.", narrow=True))
    return section(text[0].upper() + text[1:], *lines)


def _quantity(results: xr.Dataset) -> str | None:
    """What is plotted over the axes."""
    return next((q for q in _QUANTITIES if q in results), None)


def _varied(results: xr.Dataset) -> list[str]:
    return [n for n in axes_of(results) if len(np.unique(results[n])) > 1]


def _held(results: xr.Dataset, others: dict[Any, int]) -> str:
    """Where other axes are held, in words: so2 = 0.85, force_n = 1 N."""
    held = {d: results[d][i] for d, i in others.items() if d in results.coords}
    shown = {d: f"{at.item():.4g}" if at.dtype.kind == "f" else str(at.item()) for d, at in held.items()}
    return ", ".join(f"{d} = {shown[d]} {at.attrs.get('units', '1')}".removesuffix(" 1") for d, at in held.items())


@style.drawing()
def _along(results: xr.Dataset, axis: str = "") -> "style.Figure":
    """Readings over one axis, the first if none is named; raises InputError where there is nothing to plot."""
    if not (quantity := _quantity(results)):
        raise InputError('figure = "along" needs readings: no scene is done, or the study is "colour".')
    name = axis or (_varied(results) or axes_of(results))[0]
    (dim,) = results[name].dims
    others: dict[Any, int] = {d: results.sizes[d] // 2 for d in results.state.dims if d != dim}
    values, errors = results[quantity].isel(others), results[f"{quantity}_stderr"].isel(others)
    coordinate = results[name].values
    numeric = coordinate.dtype.kind in "iuf"
    x = coordinate.astype(float) if numeric else np.arange(len(coordinate))
    unit, most = str(results[quantity].attrs["units"]), float(np.nanmax(np.abs(values.values), initial=0.0))
    scale, letter = prefix(most) if unit != "1" or most < 0.1 else (1.0, "")
    of_one = [d for d in values.dims if d != dim]
    lines = [dict(zip(of_one, at, strict=True)) for at in np.ndindex(*(values.sizes[d] for d in of_one))]
    lines = [at for at in lines if values.isel(at).notnull().any()]  # LEDs and photodiodes of other scenes alone
    drawing, axes = style.panels(6.4, 2.9)
    look: Any = {"marker": "o", "markersize": 3, "linewidth": 1.2}
    look["linestyle"] = "-" if numeric and name in results.state.dims else "none"
    for at, colour in zip(lines[:LINES], style.place_colours(min(len(lines), LINES)), strict=True):
        y, error = (v.isel(at).values / scale for v in (values, errors))
        label = style.plain(" → ".join(str(values[d].values[i]) for d, i in at.items()))
        axes.errorbar(x, y, error, color=colour, label=label, **look)
    of = f"{letter}{unit}" if unit != "1" else significant(scale, 1)
    axes.set_ylabel(style.plain(textwrap.fill(f"{results[quantity].attrs['long_name']} [{of}]", 34)))
    # Of texts, such as places, the unit is that of their field.
    place = str(results[name].attrs.get("long_name", name))
    unit = str(results[name].attrs.get("units", unit_of(place)))
    axes.set_xlabel(style.plain(f"{place} [{unit}]" if numeric or unit != "1" else place))
    axes.set_title(style.plain(textwrap.fill(_held(results, others), 70)))
    axes.locator_params(axis="x", nbins=7)
    if not numeric:
        axes.set_xticks(x, [style.plain(str(v)[:24]) for v in coordinate])
    if lines:
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawing


# More scenes would be too small to see, or too large a picture.
MOST_SCENES = 48
# Of one photograph, and of the words beside a row. [inch]
WIDTH, WORDS = 1.5, 1.9


@style.drawing()
def contact_sheet(results: xr.Dataset) -> "style.Figure":
    """Photographs of up to 48 scenes of a sweep of colours, in its order; what is not done is black."""
    if "photograph" not in results:
        raise InputError('figure = "photographs" needs a sweep of study = "colour".')
    places = list(np.ndindex(*results.state.shape))[:MOST_SCENES]
    scenes = [results.isel(dict(zip(results.state.dims, place, strict=True))) for place in places]
    count, high, wide = (results.sizes[name] for name in ("force", "row", "column"))
    figure, axes = style.panels(WORDS + WIDTH * count, 0.35 + WIDTH * high / wide * len(scenes))
    sheet = np.concatenate([np.concatenate(list(scene.photograph.values), axis=1) for scene in scenes])
    axes.imshow(sheet, extent=(0, count, len(scenes), 0), aspect="auto")
    axes.hlines(range(1, len(scenes)), 0, count, color="white")
    axes.vlines(range(1, count), 0, len(scenes), color="white")
    forces_n = [np.unique(force_n[np.isfinite(force_n)]) for force_n in results.force_n.values.reshape(-1, count).T]
    axes.set_xticks(np.arange(count) + 0.5, [" or ".join(f"{x:g}" for x in force_n) + " N" for force_n in forces_n])
    axes.set_yticks(np.arange(len(scenes)) + 0.5, [style.plain(_words(scene, results)) for scene in scenes])
    axes.tick_params(length=0, labelsize=7, labeltop=True, labelbottom=False)
    axes.grid(False)
    return figure


def _words(scene: xr.Dataset, results: xr.Dataset) -> str:
    """What of a scene differs from others, and its state where it is not done."""
    values = {name: scene[name].item() for name in axes_of(results) if np.unique(results[name]).size > 1}
    words = [f"{name} = {f'{x:.4g}' if isinstance(x, float) else str(x)[:28]}" for name, x in values.items()]
    return "\n".join(words + ([] if scene.state.item() == "done" else [scene.state.item()]))


def _states(results: xr.Dataset) -> dict[str, int]:
    """How many scenes are in each state."""
    return dict(sorted(Counter(results.state.values.ravel().tolist()).items()))


SWEEP = Report(
    ("sweep.nc", "sweep.html"),
    page,
    lambda results: {"scenes": _states(results)} | run_summary(results.attrs),
    lambda results, _: aligned(_axes(results)),
    {"photographs": contact_sheet, "along": _along},
)
