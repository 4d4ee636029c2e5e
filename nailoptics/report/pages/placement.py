"""What a placement leaves: the files with the best layout for other programs, the ranking, and its summary."""

import csv
import math
from io import StringIO
from typing import Any

import xarray as xr

from ...io import plain_cell
from ...studies.placement.result import chosen, gain, kicad_parts, outline, rough_words, rows
from ..files import Report, scene_text
from ..numbers import aligned
from ..uncertainty_section import spread_summary


def _files(result: xr.Dataset, *, negate_x_on_bottom: bool = False) -> tuple[Any, ...]:
    """Contents of the files; negate_x_on_bottom : whether X is, in the position file, for parts on the bottom side."""
    from ...exports.mesh_files import export_mesh
    from ...geometry import build
    from ...scene.importers.kicad import write_board
    from ...scene.importers.outlines import write_outline
    from ...scene.importers.positions import write_positions
    from .place.page import write_placement

    best, ranking, edges, table = chosen(result), rows(result), outline(result), StringIO(newline="")
    placed = kicad_parts(best)
    sizes = [*(led.size_mm for led in best.leds), *(e.photodiode.size_mm for e in best.layout.photodiodes)]
    writer = csv.DictWriter(table, list(ranking[0]))
    writer.writeheader()
    writer.writerows({name: plain_cell(cell) for name, cell in row.items()} for row in ranking)
    return (
        result,
        table.getvalue(),
        scene_text(best, result.attrs),
        lambda path: write_positions(path, placed, negate_x_on_bottom=negate_x_on_bottom),
        lambda path: write_outline(path, edges),
        lambda path: write_board(path, placed, sizes, edges),
        lambda path: export_mesh(build(best), path),
        lambda path: write_placement(result, path),
    )


def summary(result: xr.Dataset) -> dict[str, Any]:
    """The ranking of layouts, and the gain in force resolution over the paper's layout."""
    better = gain(result)
    names = ("photons", "cpu_seconds", "wall_seconds", "digest", "rank_by")
    return {
        "ranking": rows(result),
        "gain_over_paper": {"value": better[0], "stderr": better[1]} if better else None,
        "checked_resolution_n": result.attrs.get("checked_resolution_n"),
        "cut_off": result.attrs.get("cut_off"),
        **spread_summary(result),
    } | {name: result.attrs[name] for name in names}


def lines(summary: dict[str, Any]) -> list[str]:
    """The ranking as a table, best first."""
    columns: dict[str, tuple[str, float]] = {
        "resolution [mN]": ("force_resolution_n", 1e3),
        "electronics alone [mN]": ("electronics_resolution_n", 1e3),
        "prior spread [mN]": ("force_resolution_spread_n", 1e3),
        "SpO2 [%]": ("spo2_error_percent", 1.0),
        "share [%]": ("share_resolution", 100.0),
    }
    ranking = summary["ranking"]
    if "share" not in summary["rank_by"]:
        del columns["share [%]"]
    shown = {head: one for head, one in columns.items() if any(_known(row, one[0]) for row in ranking)}
    by = ["electronics_rank"] if "electronics_rank" in ranking[0] else []
    table = [["rank", "layout", *shown, *("rank by electronics" for _ in by), ""]]
    for row in ranking:
        pairs = [(_known(row, n), s * row.get(n, 0), s * row.get(f"{n}_stderr", 0)) for n, s in shown.values()]
        cells = [f"{value:.3f} +- {error:.3f}" if known else "-" for known, value, error in pairs]
        tied = "tied" if row["tied"] else ""
        table.append([str(row["rank"]), row["layout"], *cells, *(str(row[name]) for name in by), tied])
    out = aligned(table, left=(1,))
    if better := summary["gain_over_paper"]:
        tied = sum(row["tied"] for row in ranking)
        times = f"{better['value']:.2f} +- {better['stderr']:.2f} times"
        beside = f"; {tied} layouts are tied with each other" if tied else ""
        out.append(f"force resolution better than the paper's layout: {times}{beside}")
    out += filter(None, [rough_words(ranking)])
    return [*out, *summary.get("conclusions", [])]


def _known(row: dict[str, Any], name: str) -> bool:
    return math.isfinite(row.get(name, math.nan))


PLACEMENT = Report(
    (
        "place.nc",
        "ranking.csv",
        "best.toml",
        "best.csv",
        "outline.dxf",
        "best.kicad_pcb",
        "best.glb",
        "place.html",
    ),
    _files,
    summary,
    lambda result, summary: lines(summary),
)
