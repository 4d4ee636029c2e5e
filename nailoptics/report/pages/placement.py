"""What a placement leaves: its page with the ranking of layouts and maps of the best, and files for other programs."""

import csv
import logging
import math
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from ...errors import InputError
from ...io import plain_cell, write_text
from ...scene import Placement, Scene, parse_scene
from ...sensor.ambient import sources_of
from ...studies.placement import boards
from ...studies.placement.result import budgets as budgets_of
from ...studies.placement.result import chosen, gain, kicad_parts, outline, rough_words, rows
from .. import maps
from ..files import Report, run_summary, scene_text
from ..html import Html, document, figure, section, small, subheading, table, texts
from ..numbers import aligned, estimated, quantity, significant, with_error
from ..scene_description import CAUSES, body_words
from ..uncertainty_section import spread_section, spread_summary
from . import placement_figures as figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger(__name__)

TEXTS = texts("placement")
# A resolution beyond this is that of the prior alone.
NOTHING_MN = 1e3
# A change beyond this is that to a saturated photodiode. [%]
MOST_PERCENT = 900.0
WAYS = tuple(f"0.5 mm {way} [%]" for way in ("left", "right", "proximal", "distal"))
# What of the ranking has no room in a terminal.
PAGE_ALONE = ("Split known [mN]", "Proximal, distal pressure [Pa]", "Condition", "Lowest SNR", "Full scale / reading")


def write_placement(result: xr.Dataset, path: Path) -> None:
    """Write the page of what `place` returns, whole or not at all; raises WriteError."""
    best, ranking = chosen(result), rows(result)
    by_led = [result.isel(led=[i]) for i in range(result.sizes["led"])]
    groups = [f"LED {led}" for led in result.led.values for _ in range(result.sizes["best_photodiode"])]
    layout = [figure(maps.top_view(best), TEXTS["board"], narrow=True), table(_photodiodes(result), groups=groups)]
    checked = "No time was left to verify the best layout by its own trace."
    if "checked_fraction" in result:
        layout += [subheading("Ambient light"), table(_ambient(result)), small(TEXTS["ambient"])]
        checked = _check(result)
    text = document(
        kicker="layout optimisation",
        title=f"{result.sizes['best_photodiode']} photodiodes on the nail",
        lead=_lead(result, ranking),
        cards=_cards(result, ranking),
        body=[
            section(
                "The ranking",
                figure(figures.ranking_figure(result), TEXTS["ranking"]),
                table(_ranking_rows(ranking[: figures.SHOWN]), kind="dense"),
                small(rough_words(ranking)),
                small(checked),
            ),
            _limits(result),
            _physiological_noise(best, result),
            section("The best layout", *layout),
            section("Maps of this board", *(part for of_led in by_led for part in _maps(best, of_led))),
            spread_section(result),
        ],
        attributes=result.attrs,
    )
    write_text(Path(path), text)


def _led_words(scene: Scene, of_led: xr.Dataset) -> str:
    """Which LED a result of one LED is about."""
    led = next(led for led in scene.leds if led.name == str(of_led.led.values[0]))
    return f"LED {led.name}, {led.wavelength_nm:.0f} nm"


def _of_led(drawing: "Figure", caption: str, of_led: xr.Dataset, scene: Scene, *, narrow: bool = False) -> Html:
    """A figure of one LED; of several LEDs each is named."""
    named = f"{_led_words(scene, of_led)}. {caption}" if len(scene.leds) > 1 else caption
    return figure(drawing, named, narrow=narrow)


def _maps(best: Scene, of_led: xr.Dataset) -> list[Html]:
    """All maps of one LED."""
    narrow = figures.slender(of_led)
    maps = [subheading(_led_words(best, of_led))] if len(best.leds) > 1 else []
    maps.append(_of_led(figures.map_figure(best, of_led), TEXTS["maps"], of_led, best))
    maps.append(_of_led(figures.sensitivity_figure(best, of_led), TEXTS["sensitivity"], of_led, best, narrow=narrow))
    if of_led.sizes["led_site"]:
        maps.append(_of_led(figures.sites_figure(of_led), TEXTS["tried"], of_led, best, narrow=True))
    return maps


def _lead(result: xr.Dataset, ranking: list[dict[str, Any]]) -> str:
    first, tied = ranking[0], sum(row["rank"] == 1 for row in ranking)
    force, low, high = (quantity(first[f"force_resolution_{end}n"], "N") for end in ("", "low_", "high_"))
    fingers = result.sizes["finger"]
    over = "" if fingers == 1 else f", {_rules(result).over_fingers} of {fingers} fingers"
    traced = f"{result.sizes['layout']} of {result.attrs['layouts_given']} layouts were traced. "
    others = f"{'One' if tied == 2 else tied - 1} more {'is' if tied == 2 else 'are'} tied with it."
    if tied == 1:
        others = "No other layout is tied with it." if len(ranking) > 1 else "It is the only one evaluated."
    noise = body_words(chosen(result)) if "electronics_resolution_n" in result else ""
    name = f"Layout {first['layout']}"
    if first["origin"] == "searched":
        places = (
            f"{led.name} at ({led.center_mm[0]:.3g}, {led.center_mm[1]:.3g})" for led in chosen(result).layout.leds
        )
        name = f"The layout with {', '.join(places)} mm"
    return (
        f"{name} resolves {force} of force in one sample (rms{over}, 95 % interval {low} to {high}), "
        f"for any split between the proximal and the distal side{f', with {noise}' if noise else ''}. "
        f"{_ranked_by(result, first)}{traced}{others}"
    )


def _rules(result: xr.Dataset) -> Placement:
    """The rules of the search."""
    return boards.rules(parse_scene(str(result.attrs["scene"]), name="the scene"))


def _ranked_by(result: xr.Dataset, first: dict[str, Any]) -> str:
    """What layouts are ranked by, where that is not the force alone, and the best one's figures for it."""
    weights, others = _rules(result).weights, []
    if "share" in weights:
        others.append(f"that part to {estimated(first, 'share_resolution', 100)} % of the force")
    if "oxygen" in weights:
        others.append(f"SpO2 to {estimated(first, 'spo2_error_percent')} % over 8 s with the electronics' noise")
    if not others:
        return ""
    beside = ", beside the force" if {"worst", "mean"} & weights.keys() else ""
    return f"It resolves {' and '.join(others)}; layouts are ranked by this{beside}. "


def _cards(result: xr.Dataset, ranking: list[dict[str, Any]]) -> list[tuple[str, str]]:
    first = ranking[0]
    cards = [(quantity(first["force_resolution_n"], "N"), "force resolution of one sample, rms")]
    if "electronics_resolution_n" in first:
        cards.append((quantity(first["electronics_resolution_n"], "N"), "limited by the electronics' noise alone"))
    better = gain(result)
    if better and first["layout"] != "paper":
        cards.append((f"{with_error(*better)} ×", f"better force resolution than the paper's layout{_tied(ranking)}"))
    cards.append((significant(first["condition_number"]), "condition number of readings by blood zones"))
    shunted = f"{100 * first['shunted_fraction']:.0f} %"
    return [*cards, (shunted, "shunted: the largest part of a photodiode's light that bypassed the bed")]


def _tied(ranking: list[dict[str, Any]]) -> str:
    tied = sum(row["tied"] for row in ranking)
    return f"; {tied} layouts are tied with each other" if tied else ""


def _ranking_rows(ranking: list[dict[str, Any]]) -> list[dict[str, str]]:
    """The ranking in words, on the page and in the terminal; what is known of no layout is left out."""
    optional = {
        "Electronics alone [mN]": ("electronics_resolution_n", 1e3),
        "Prior std [mN]": ("force_resolution_spread_n", 1e3),
        "SpO2 [%]": ("spo2_error_percent", 1.0),
    }
    known = {
        head: key for head, key in optional.items() if any(math.isfinite(r.get(key[0], math.nan)) for r in ranking)
    }
    lines = []
    for row in ranking:
        rank = f"{row['rank']}{' (tied)' if row['tied'] else ''}"
        line = {"Layout": row["layout"], "Rank": rank}
        line["Resolution [mN]"] = estimated(row, "force_resolution_n", 1e3)
        line |= {head: estimated(row, *key) for head, key in known.items()}
        if "electronics_rank" in row:
            line["Rank by electronics"] = str(row["electronics_rank"])
        line["Split known [mN]"] = significant(1e3 * row["fixed_ratio_resolution_n"])
        line["Share [%]"] = estimated(row, "share_resolution", 100)
        pressures = (significant(row[f"{name}_pressure_pa"]) for name in ("proximal", "distal"))
        line["Proximal, distal pressure [Pa]"] = ", ".join(pressures)
        line["Condition"] = significant(row["condition_number"])
        line["Lowest SNR"] = significant(row["least_snr"])
        line["Full scale / reading"] = significant(row["adc_headroom"])
        line["Shunted [%]"] = f"{100 * row['shunted_fraction']:.0f}"
        lines.append(line)
    return lines


def _limits(result: xr.Dataset) -> str:
    """What the resolution consists of, and how it changes where one photodiode of the best layout is moved."""
    budgets = budgets_of(result)
    parts = [figure(figures.budget_figure(budgets), TEXTS["budget"])]
    causes = {name: CAUSES.get(name, name) for name in list(budgets[0])[1:]} | {"floor": "no layout changes"}
    cells = [
        {f"{words} [mN]": significant(1e3 * row[name]) for name, words in causes.items() if name in row}
        for row in budgets
    ]
    parts.append(
        table([{"Layout": row["layout"]} | line for row, line in zip(budgets, cells, strict=True)], kind="dense")
    )
    moved = []
    for name in result.moved_photodiode.values:
        of = result.sel(moved_photodiode=name)
        steps = (of.isel(step=k) for k in range(of.sizes["step"]))
        changes = [(100 * float(step.moved_ranking), 100 * float(step.moved_ranking_stderr)) for step in steps]
        moved.append({"Photodiode": str(name)} | dict(zip(WAYS, map(_change, changes), strict=True)))
    parts += [subheading("One photodiode moved"), table(moved), small(TEXTS["moved"])]
    return section("What limits it", " ".join(map(why, budgets)), *parts)


def _change(percent: tuple[float, float]) -> str:
    """A change with its standard error; of a photodiode that has no room or saturates, in words."""
    if math.isnan(percent[0]):
        return "no room"
    return "more than ten times" if percent[0] > MOST_PERCENT else with_error(*percent, sign=True)


def why(row: dict[str, Any]) -> str:
    """What of a layout's force resolution another layout could change, in a sentence."""
    total, floor, most = row["total"], row["floor"], max(list(row)[3:], key=row.__getitem__)
    rest = f"most of it by {CAUSES.get(most, most)} ({quantity(row[most], 'N')})"
    if not floor:
        return f"Of {row['layout']}, {quantity(total, 'N')} depend on the layout, {rest}."
    above, share = math.sqrt(total**2 - floor**2), 100 * (1 - (floor / total) ** 2)
    return (
        f"Of the {quantity(total, 'N')} of {row['layout']}, {quantity(floor, 'N')} are waves of the body that no "
        f"layout changes; another layout could change {quantity(above, 'N')} ({share:.2g} % of the variance), {rest}."
    )


def _physiological_noise(best: Scene, result: xr.Dataset) -> str:
    """The effect of physiological noise on the resolution; empty without a body."""
    if "electronics_resolution_n" not in result:
        return ""
    bandwidth_hz = result.attrs["bandwidth_hz"]
    sample = f"a mean over {significant(500 / bandwidth_hz)} ms (a bandwidth of {bandwidth_hz:g} Hz)"
    false_force = ", ".join(dict.fromkeys(significant(1e3 * float(x)) for x in result.physiological_noise_force_n))
    return section("Physiological noise", TEXTS["physiological"].format(sample, body_words(best), false_force))


def _check(result: xr.Dataset) -> str:
    fresh = estimated(result.attrs, "checked_resolution_n", 1e3)
    by_map = estimated(result.isel(layout=0, finger=0), "finger_resolution_n", 1e3)
    return TEXTS["check"].format(fresh, by_map) + " " + _mitsuba_words(result)


def _mitsuba_words(result: xr.Dataset) -> str:
    """How stock Mitsuba's readings of the best layout compare with those of its trace; empty where there are none."""
    if "mitsuba_ratio" not in result:
        return ""
    of_leds = (f"{_by_mitsuba(result.sel(led=led), 'mitsuba_led')} for LED {led}" for led in result.led.values)
    return TEXTS["mitsuba"].format(", ".join(of_leds), float(abs(result.mitsuba_z).max()))


def _by_mitsuba(result: xr.Dataset, name: str) -> str:
    """A ratio of readings with its standard error and z."""
    return f"{estimated(result, f'{name}_ratio')} ({float(result[f'{name}_z']):+.1f})"


def _photodiodes(result: xr.Dataset) -> list[dict[str, str]]:
    """The readings of the best layout on the first finger: each photodiode under each LED."""
    lines = []
    for led in result.led.values:
        for i, name in enumerate(chosen(result).layout.photodiode_names):
            reading = result.sel(led=led).isel(best_photodiode=i)
            volts, noise_v = float(reading.predicted_volts), float(reading.predicted_noise_v)
            line = {"Photodiode": name, "Reading [V]": estimated(reading, "predicted_volts")}
            line["Full scale / reading"] = significant(result.attrs["adc_range_v"] / volts)
            line |= {"Noise [µV]": significant(1e6 * noise_v), "SNR": significant(volts / noise_v)}
            line["Shunted [%]"] = estimated(reading, "predicted_shunted_fraction", 100)
            # A hundredth of the bed's volume, in millivolts.
            for k, zone in enumerate(("Proximal", "Distal")):
                line[f"{zone} blood [mV / %]"] = estimated(reading.isel(blood_zone=k), "predicted_zone_v", 10)
            if "mitsuba_ratio" in reading:
                line["Mitsuba / trace (z)"] = _by_mitsuba(reading, "mitsuba")
            lines.append(line)
    return lines


def _ambient(result: xr.Dataset) -> list[dict[str, str]]:
    """Sun and lamp, with and without the cover."""
    heads = ("Light", "Photocurrent at most [µA]", "Output at most [V]", "Noise at most [µV]", "Resolution [mN]")
    alone = [result.predicted_volts.max(), 1e6 * result.predicted_noise_v.max(), 1e3 * result.finger_resolution_n[0, 0]]
    lines = [["none", "0", *(significant(float(value)) for value in alone)]]
    for cover in result.cover.values:
        for source in sources_of(chosen(result)):
            at = result.sel(cover=cover, ambient=source.kind)
            name = f"{source.words}, {'with the cover' if cover == 'covered' else 'without it'}"
            most = [1e6 * at.ambient_high_a.max(), at.ambient_volts.max(), 1e6 * at.ambient_noise_v.max()]
            current, output, noise = (significant(float(value)) for value in most)
            if bool((at.ambient_volts >= result.attrs["adc_range_v"]).any()):
                output += " (saturated)"
            resolution_mn = 1e3 * float(at.ambient_resolution_n)
            resolves = significant(resolution_mn) if resolution_mn < NOTHING_MN else "nothing"
            lines.append([name, current, output, noise, resolves])
    return [dict(zip(heads, line, strict=True)) for line in lines]


def _files(result: xr.Dataset, *, negate_x_on_bottom: bool = False, scene_folder: Path = Path()) -> tuple[Any, ...]:
    """Contents of the files.

    negate_x_on_bottom : whether X is, in the position file, for parts on the bottom side.
    scene_folder : where the board lies from which the scene's layout came, if it did.
    """
    from ...exports.kicad_board import is_own, own_board, write_new_board
    from ...exports.mesh_files import write_mesh
    from ...scene.importers.outlines import write_outline
    from ...scene.importers.positions import write_positions

    best, ranking, text = chosen(result), rows(result), StringIO(newline="")
    edges = outline(parse_scene(str(result.attrs["scene"]), name="the scene"), best)
    board: Any = partial(write_new_board, best, edges=edges)
    if is_own(best):
        try:
            best, board = own_board(best, scene_folder)
            best = best.model_copy(update={"board": best.board.model_copy(update={"kicad": "best.kicad_pcb"})})
        except InputError as error:
            log.warning("%s best.kicad_pcb is a new board.", error)
    writer = csv.DictWriter(text, list(ranking[0]))
    writer.writeheader()
    writer.writerows({name: plain_cell(cell) for name, cell in row.items()} for row in ranking)
    return (
        result,
        text.getvalue(),
        scene_text(best, result.attrs),
        lambda path: write_positions(path, kicad_parts(best), negate_x_on_bottom=negate_x_on_bottom),
        lambda path: write_outline(path, edges),
        board,
        lambda path: write_mesh(best, path),
        lambda path: write_placement(result, path),
    )


def summary(result: xr.Dataset) -> dict[str, Any]:
    """The ranking of layouts, and the gain in force resolution over the paper's layout."""
    better = gain(result)
    return {
        "ranking": rows(result),
        "rank_by": result.attrs["rank_by"],
        "layouts_given": int(result.attrs["layouts_given"]),
        "limits": [why(row) for row in budgets_of(result)],
        "gain_over_paper": {"value": better[0], "stderr": better[1]} if better else None,
        "checked_resolution_n": result.attrs.get("checked_resolution_n"),
        "verified_by_mitsuba": _mitsuba_words(result),
        **spread_summary(result),
    } | run_summary(result.attrs)


def lines(summary: dict[str, Any]) -> list[str]:
    """The ranking as a table, best first."""
    ranking = summary["ranking"]
    left_out = PAGE_ALONE if "share" in summary["rank_by"] else (*PAGE_ALONE, "Share [%]")
    shown = [{head: cell for head, cell in row.items() if head not in left_out} for row in _ranking_rows(ranking)]
    out = [*aligned(shown), f"{len(ranking)} of {summary['layouts_given']} layouts traced"]
    out += [line.replace("\u00a0", " ") for line in summary["limits"]]
    if (better := summary["gain_over_paper"]) and ranking[0]["layout"] != "paper":
        times = f"{better['value']:.2f} +- {better['stderr']:.2f} times"
        out.append(f"force resolution better than the paper's layout: {times}{_tied(ranking)}")
    words = [rough_words(ranking), summary["verified_by_mitsuba"]]
    return [*out, *filter(None, words), *summary.get("conclusions", [])]


PLACEMENT = Report(
    ("place.nc", "ranking.csv", "best.toml", "best.csv", "outline.dxf", "best.kicad_pcb", "best.glb", "place.html"),
    _files,
    summary,
    lambda result, summary: lines(summary),
)
