"""What a placement leaves: its page with the ranking of layouts and maps of the best, and files for other programs."""

import csv
import logging
import math
from functools import partial
from io import StringIO
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...io import plain_cell
from ...scene import Placement, parse_scene
from ...sensor.ambient import sources_of
from ...statistics import quotient
from ...studies.placement import boards
from ...studies.placement.objective import ALIKE
from ...studies.placement.result import ROUGH, budgets as budgets_of, chosen, gains, kicad_parts, outline, rows
from ...studies.placement.robustness import KINDS, MOVED, POWER, POWERED, STEP_MM, TURN_DEG, TURNED
from .. import maps, numbers, style
from ..files import Report, run_summary, scene_text
from ..html import document, figure, section, small, subheading, table, texts
from ..numbers import ROUNDING, aligned, cells, plain, quantity, significant, with_error, with_stderr
from ..scene_description import CAUSES, body_words
from ..uncertainty_section import spread_section, spread_summary
from .placement_figures import SHOWN, budget_figure, front_figure, map_figure, ranking_figure

log = logging.getLogger(__name__)
TEXTS = texts("placement")
# A resolution beyond this is that of the prior alone.
NOTHING_MN = 1e3
# A change beyond this is that to a saturated photodiode. [%]
MOST_PERCENT = 900.0
# What changes are rounded beside, so that less than a thousandth of a percent is 0. [%]
CHANGE_SCALE = 1e-3 / ROUNDING
TOLERATED = TEXTS["tolerated"].format(STEP_MM, TURN_DEG, 100 * POWER)
# Columns of the ranking; those of which nothing is known are left out, as are the last three in a terminal.
RANKING: dict[str, tuple[str, float, int]] = {head: tuple(column) for head, column in TEXTS["columns"].items()}
PAGE_ALONE = tuple(RANKING)[-3:]
estimated = partial(numbers.estimated, negligible=1e-3)  # without errors below a thousandth


def page(result: xr.Dataset) -> str:
    """The page of what `place` returns."""
    best, ranking, front = chosen(result), rows(result), _front(result)
    groups = [f"LED {led}" for led in result.led.values for _ in range(result.sizes["best_photodiode"])]
    board = maps.top_view(best)
    for area in boards.rules(parse_scene(result.attrs["scene"], name="the scene")).keep_out_mm:
        maps.draw_area(board.axes[0], area, zorder=2.5, fc="none", ec=style.MUTED, lw=0.6, hatch="////")
    layout = [figure(board, TEXTS["board"], narrow=True)]
    layout += [table(_photodiodes(result), groups=groups), small(TEXTS["readings"])]
    drawn = figure(front_figure(result, *_ranked_in(result)), TEXTS["costs"], narrow=True) if front["table"] else ""
    checked = "No time was left to verify the best layout by its own trace."
    if "checked_fraction" in result:
        layout += [subheading("Ambient light"), table(_ambient(result)), small(TEXTS["ambient"])]
        by_map = estimated(result.isel(layout=0, finger=0), "finger_resolution_n", 1e3)
        checked = TEXTS["check"].format(estimated(result.attrs, "checked_resolution_n", 1e3), by_map)
        checked += f" {_mitsuba_words(result)}"
    return document(
        kicker="layout optimisation",
        title=f"{(count := result.sizes['best_photodiode'])} photodiode{'s' * (count > 1)} on the nail",
        lead=_lead(result, ranking),
        warnings=_warnings(result),
        cards=_cards(result, ranking),
        body=[
            section(
                "The ranking",
                figure(ranking_figure(result), f"{TEXTS['ranking']} {rough_words(ranking)}".strip(), narrow=True),
                table(_ranking_rows(ranking[:SHOWN]), kind="dense"),
                *map(small, [TEXTS["columns_explained"], TEXTS["notes"], *_people(ranking)]),
                small(checked),
                small(_bound(result)),
            ),
            _limits(result),
            *([section("What it costs", small(front["words"]), table(front["table"]), drawn)] if drawn else []),
            section("The best layout", *layout),
            *(
                section(f"Maps of {name}", figure(map_figure(best, result, led=led), TEXTS["maps"]))
                for led, name in enumerate(f"LED {led.name}, {led.wavelength_nm:.0f} nm" for led in best.leds)
            ),
            spread_section(result),
        ],
        attributes=result.attrs,
    )


def _lead(result: xr.Dataset, ranking: list[dict[str, Any]]) -> str:
    """What the best layout resolves, on which fingers and beside what, and how many others are as good."""
    best, first, rules = chosen(result), ranking[0], boards.rules(parse_scene(result.attrs["scene"], name="the scene"))
    name = f"Layout {first['layout']}"
    if first["origin"] == "searched":
        places = ("{} at ({:.3g}, {:.3g})".format(led.name, *led.center_mm) for led in best.layout.leds)
        name = f"The layout with {', '.join(places)} mm"
    force, low, high = (quantity(first[f"force_resolution_{end}n"], "N") for end in ("", "low_", "high_"))
    few = first["roughly_known"] or bool(np.isnan(result.predicted_volts_stderr).any())
    high += ", too narrow: too few photons" if few else ""
    fingers = result.sizes["finger"]
    over = "" if fingers == 1 else f", {rules.over_fingers} of {fingers} fingers"
    if rules.people:
        over = f", or less for {100 * rules.quantile:g} % of {rules.people} people"
    noise = f", with {body_words(best)}" if "electronics_resolution_n" in result else ""
    return (
        f"{name} resolves {force} of force in one sample (rms{over}, 95 % interval {low} to {high}), for any split "
        f"between the proximal and the distal side{noise}. {_ranked_by(rules, first)}{result.sizes['layout']} of "
        f"{result.attrs['layouts_given']} layouts were traced. {_tied(ranking)}"
    )


def _warnings(result: xr.Dataset) -> list[str]:
    """Readings of the best layout with too few photons to rely on, and layouts of which one may be saturated."""
    unknown = int(np.isnan(result.predicted_volts_stderr).sum())
    lines = [TEXTS["few_photons"].format(unknown, result.predicted_volts.size)] if unknown else []
    names = result.layout.values[result.may_saturate.values]
    lines += [TEXTS["saturated"].format(", ".join(map(str, names)))] if names.size else []
    lights = _ambient(result) if "ambient_volts" in result else []
    bright = ", ".join(row["Light"] for row in lights if "with the cover" in row["Light"] and "saturated" in str(row))
    return lines + ([TEXTS["outshone"].format(bright)] if bright else [])


def _tied(ranking: list[dict[str, Any]]) -> str:
    """How many layouts tie with the best, and what of it another seed may propose."""
    first, *others = [row["layout"] for row in ranking if row["rank"] == 1]
    return TEXTS["tied"].format(first, 1 + len(others), 100 * ALIKE) if others else "No other ties with the first."


def _named(ranking: list[dict[str, Any]]) -> dict[str, str]:
    """Layouts by name, with number and power of their parts, in which those that are compared may differ."""
    return {r["layout"]: "{layout} ({photodiodes} photodiodes, {led_power_mw:.3g} mW)".format(**r) for r in ranking}


def _ranked_by(rules: Placement, first: dict[str, Any]) -> str:
    """What layouts are ranked by, where that is not the force alone, and the best one's figures for it."""
    weights, others = rules.weights, []
    if "force" in weights:
        others.append(f"force over touches to {estimated(first, 'force_error_n', 1e3)} mN by the filter of predict")
    if "share" in weights:
        others.append(f"that part to {estimated(first, 'share_resolution', 100)} % of the force")
    if "oxygen" in weights:
        others.append(f"SpO2 to {estimated(first, 'spo2_error_percent')} % over 8 s by the noise of lit readings alone")
    if not others:
        return ""
    beside = ", beside the force" if {"worst", "mean"} & weights.keys() else ""
    return f"It resolves {' and '.join(others)}; layouts are ranked by this{beside}. "


def _cards(result: xr.Dataset, ranking: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Force resolution, with the electronics' noise alone, and beside the user's layout or the paper's."""
    first = ranking[0]
    cards = [(quantity(first["force_resolution_n"], "N"), "force resolution of one sample, rms (Cramér-Rao bound)")]
    if "force_error_n" in first:
        cards.insert(0, (quantity(first["force_error_n"], "N"), "error of the force over touches by a filter, rms"))
    if "electronics_resolution_n" in first:
        cards.append((quantity(first["electronics_resolution_n"], "N"), "limited by the electronics' noise alone"))
    for name, better in [*gains(result).items()][:1]:
        cards.append((f"{with_error(*better, negligible=1e-3)} ×", f"as fine a resolution as {_named(ranking)[name]}"))
    return cards


def _ranking_rows(ranking: list[dict[str, Any]]) -> list[dict[str, str]]:
    """The ranking in words, on the page and in the terminal."""
    finite = {name for row in ranking for name, x in row.items() if isinstance(x, float) and math.isfinite(x)}
    known = {head: column for head, column in RANKING.items() if column[0] in finite}
    return [
        {"Layout": row["layout"], "Rank": f"{row['rank']}{' (tied)' if row['tied'] else ''}"}
        | {"Photodiodes": str(row["photodiodes"])}
        | cells(row, known, estimated)
        for row in ranking
    ]


def _people(ranking: list[dict[str, Any]]) -> list[str]:
    """Which person has the coarsest resolution with the best layout and those that the search did not make, and why."""
    lines, shown = [], [row for i, row in enumerate(ranking) if i == 0 or row["origin"] != "searched"]
    for row in (row for row in shown if "people_off" in row):
        reason = f", by {row['worst_reason']}" if row["worst_reason"] else ""
        off = f"; parts lie off the nails of {row['people_off']} people" if row["people_off"] else ""
        worst = f"{row['worst_person']} ({quantity(row['worst_resolution_n'], 'N')})"
        lines.append(f"Coarsest in one sample with {row['layout']}: {worst}{reason}{off}.")
    return lines


def rough_words(ranking: list[dict[str, Any]]) -> str:
    """A warning with the layouts that were evaluated with too few photons; empty if there is none."""
    what = "Resolution by electronics alone" if "electronics_rank" in ranking[0] else "Resolution"
    rough = ", ".join(row["layout"] for row in ranking if row["roughly_known"])
    return TEXTS["rough"].format(what, 100 * ROUGH, rough) if rough else ""


def _bound(result: xr.Dataset) -> str:
    """How near the best searched layout comes to what none on the search's grid reaches; empty without a search."""
    if "bound" not in result:
        return "" if not result.sizes.get("led_site") else TEXTS["no_bound"]
    if result.above_bound_stderr > max(float(result.above_bound), ROUGH):
        return TEXTS["unsure_bound"].format(100 * float(result.above_bound_stderr))
    rules, sites = boards.rules(parse_scene(result.attrs["scene"], name="the scene")), int(result.bounded_sites)
    _, factor, unit = _ranked_in(result)
    percent, where = estimated(result, "above_bound", 100), f"{sites} places"
    grid = "" if rules.wire else f"on the {rules.photodiode_step_mm:g} mm grid"
    photodiodes = f"{rules.photodiodes} photodiodes {grid}"
    return TEXTS["bound"].format(percent, photodiodes, where, estimated(result, "bound", factor) + unit)


def _ranked_in(result: xr.Dataset) -> tuple[str, float, str]:
    """What layouts are ranked by, and factor and unit by which it is shown."""
    weights = boards.rules(parse_scene(result.attrs["scene"], name="the scene")).weights
    words = TEXTS["ranked"].get("".join(weights), f"weighted mean ({result.attrs['rank_by']})")
    return words, *((1e3, " mN") if set(weights) <= {"worst", "mean", "force"} else (1.0, ""))


def _front(result: xr.Dataset) -> dict[str, Any]:
    """Every number of photodiodes with every power of the LEDs and what layouts are ranked by there, the same as a
    table of a line for each number, and what that is."""
    if "on_front" not in result:
        return {"points": [], "words": "", "table": []}
    (words, factor, unit), points, lines = _ranked_in(result), list[dict[str, Any]](), dict[int, dict[str, str]]()
    for n, power_mw in product(result.front_photodiodes.values, result.led_power_mw.values):
        at = result.sel(front_photodiodes=n, led_power_mw=power_mw)
        points.append({"photodiodes": int(n), "led_power_mw": float(power_mw), "on_front": bool(at.on_front)})
        points[-1] |= plain(at, price="front_price") | with_stderr(at, "front_error")
        line = lines.setdefault(n, {"Photodiodes": f"{n}"})
        line |= {} if np.isnan(at.front_price) else {"Price": f"{at.front_price:g}"}
        line[quantity(1e-3 * power_mw, "W")] = estimated(at, "front_error", factor) + " *" * bool(at.on_front)
    words = TEXTS["front"].format(words[0].upper() + words[1:], unit and f" [{unit.strip()}]", 100 * ALIKE)
    return {"points": points, "words": words, "table": [*lines.values()]}


def _limits(result: xr.Dataset) -> str:
    """What the resolution consists of, and how it changes with the tolerances of the best layout."""
    budgets, names = budgets_of(result), {"floor": "the same for all layouts"} | CAUSES
    causes = {f"{names.get(cause, cause)} [mN]": (cause, 1e3, 3) for cause in list(budgets[0])[1:]}
    body = ""
    if "electronics_resolution_n" in result:
        bandwidth_hz = result.attrs["bandwidth_hz"]
        sample = f"a mean over {significant(500 / bandwidth_hz)} ms (a bandwidth of {bandwidth_hz:g} Hz)"
        body = TEXTS["physiological"].format(sample, body_words(chosen(result)))
    return section(
        "What limits it",
        _over_touches(result),
        " ".join(map(why, budgets)),
        figure(budget_figure(budgets), TEXTS["budget"], narrow=True),
        table([{"Layout": row["layout"]} | cells(row, causes) for row in budgets], kind="dense"),
        small(body),
        subheading("Tolerances"),
        table(_tolerance_rows(_tolerances(result))),
        small(f"{TOLERATED} {TEXTS['tolerances']}"),
    )


def _over_touches(result: xr.Dataset) -> str:
    """What of the filter's error over touches another layout could change, of the best layout and those that the search
    did not make; empty where it does not rank."""
    if "force_error_n" not in result:
        return ""
    lines, shown = [], (result.origin != "searched").values | (np.arange(result.sizes["layout"]) == 0)
    for i in np.flatnonzero(shown):
        layout = result.isel(layout=i)
        layout = layout.isel(finger=int(abs(layout.finger_force_error_n - layout.force_error_n).argmin("finger")))
        total_n, floor_n = float(layout.finger_force_error_n), float(layout.force_error_floor_n)
        above_n, share = math.sqrt(max(total_n**2 - floor_n**2, 0.0)), 100 * (1 - (floor_n / total_n) ** 2)
        lines.append(
            TEXTS["of_touches"].format(quantity(total_n, "N"), layout.layout.item(), quantity(above_n, "N"), share)
        )
    return " ".join([*lines, TEXTS["over_touches"].format(quantity(floor_n, "N"))])


def _tolerances(result: xr.Dataset) -> list[dict[str, Any]]:
    """For board, photodiodes and LEDs of the best layout the change with each of their tolerances, or why none."""
    parts = []
    for name in result.toleranced_part.values:
        row: dict[str, Any] = {"part": str(name)}
        for kind in (*MOVED, *(TURNED if name == "board" else POWERED if name in result.led.values else ())):
            at = result.sel(toleranced_part=name, deviation=kind)
            row[kind] = at.tolerance_missing.item() or with_stderr(at, "tolerance_ranking")
        parts.append(row)
    return parts


def _tolerance_rows(parts: list[dict[str, Any]]) -> list[dict[str, str]]:
    """Rows of the table of tolerances, in words."""
    return [{"Part": p["part"]} | {kind: _change(p[kind]) if kind in p else "–" for kind in KINDS} for p in parts]


def _change(change: dict[str, float] | str) -> str:
    """A change with its standard error; of what has no room or time, or saturates, in words."""
    if isinstance(change, str):
        return change
    percent, stderr = 100 * change["value"], 100 * change["stderr"]
    return "over ten times" if percent > MOST_PERCENT else with_error(percent, stderr, sign=True, scale=CHANGE_SCALE)


def why(row: dict[str, Any]) -> str:
    """What of a layout's force resolution another layout could change, in a sentence."""
    total, floor, most = row["total"], row["floor"], max(list(row)[3:], key=row.__getitem__)
    above, share = math.sqrt(total**2 - floor**2), 100 * (1 - (floor / total) ** 2)
    forces = (quantity(force_n, "N") for force_n in (total, floor, above, row[most]))
    return TEXTS["why" if floor else "why_all"].format(row["layout"], *forces, share, CAUSES.get(most, most))


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
    for led, (i, name) in product(result.led.values, enumerate(chosen(result).layout.photodiode_names)):
        reading = result.sel(led=led).isel(best_photodiode=i)
        volts, noise_v = float(reading.predicted_volts), float(reading.predicted_noise_v)
        line = {"Photodiode": name, "Output [V]": estimated(reading, "predicted_volts")}
        line["Full scale / reading"] = significant(float(quotient(result.attrs["adc_range_v"], volts)))
        ratio = float(quotient(volts, noise_v))
        line |= {"Noise [µV]": significant(1e6 * noise_v), "Output / noise": significant(ratio)}
        line["Shunted [%]"] = estimated(reading, "predicted_shunted_fraction", 100)
        # A hundredth of the bed's volume, in millivolts.
        for k, zone in enumerate(("Proximal", "Distal")):
            line[f"{zone} blood [mV / %]"] = estimated(reading.isel(blood_zone=k), "predicted_zone_v", 10)
        if "mitsuba_ratio" in reading:
            line["Mitsuba / trace (z)"] = _by_mitsuba(reading, "mitsuba")
        if np.isnan(reading.predicted_volts_stderr):
            line = dict.fromkeys(line, "–") | {"Photodiode": name, "Output [V]": "too few photons"}
        lines.append(line)
    return lines


def _ambient(result: xr.Dataset) -> list[dict[str, str]]:
    """Sun and lamp, with and without the cover, beside no light at all."""
    # By the trace to which light from outside is added.
    unlit = (result.attrs[f"checked_{name}"] for name in ("most_volts", "most_noise_v", "resolution_n"))
    lights: dict[str, tuple[Any, ...]] = {"none": (0.0, *unlit)}
    for cover, source in product(result.cover.values, sources_of(chosen(result))):
        at = result.sel(cover=cover, ambient=source.kind)
        most = (at.ambient_high_a.max(), at.ambient_volts.max(), at.ambient_noise_v.max(), at.ambient_resolution_n)
        lights[f"{source.words}, {'with the cover' if cover == 'covered' else 'without it'}"] = most
    rows = []
    for name, (current_a, volts, noise_v, resolution_n) in lights.items():
        saturated = " (saturated)" if volts >= result.attrs["adc_range_v"] else ""
        row = {"Light": name, "Photocurrent at most [µA]": significant(1e6 * float(current_a))}
        row["Output at most [V]"] = significant(float(volts)) + saturated
        row["Noise at most [µV]"] = significant(1e6 * float(noise_v))
        known = 1e3 * float(resolution_n) < NOTHING_MN
        rows.append(row | {"Resolution [mN]": significant(1e3 * float(resolution_n)) if known else "nothing"})
    return rows


def _files(result: xr.Dataset, *, scene_folder: Path = Path()) -> dict[str, Any]:
    """Contents of the files.

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
    return {
        "ranking.csv": text.getvalue(),
        "best.toml": scene_text(best, result.attrs),
        "best.csv": lambda path: write_positions(path, kicad_parts(best)),
        "outline.dxf": lambda path: write_outline(path, edges),
        "best.kicad_pcb": board,
        "best.glb": lambda path: write_mesh(best, path),
    }


def summary(result: xr.Dataset) -> dict[str, Any]:
    """The ranking of layouts, and the gain in force resolution over those that the search did not make."""
    return {
        "warnings": _warnings(result),
        "ranking": rows(result),
        "tied": _tied(rows(result)),
        "rank_by": result.attrs["rank_by"],
        "layouts_given": int(result.attrs["layouts_given"]),
        "limits": [*filter(None, [_over_touches(result)]), *(why(row) for row in budgets_of(result))],
        "best_possible": {"words": _bound(result)}
        | {name: with_stderr(result, name) for name in ("bound", "above_bound") if name in result},
        "gains": {name: {"value": value, "stderr": stderr} for name, (value, stderr) in gains(result).items()},
        "checked_resolution_n": result.attrs.get("checked_resolution_n"),
        "verified_by_mitsuba": _mitsuba_words(result),
        "tolerances": _tolerances(result),
        "front": _front(result),
        **spread_summary(result),
    } | run_summary(result.attrs)


def lines(summary: dict[str, Any]) -> list[str]:
    """The ranking as a table, best first."""
    ranking = summary["ranking"]
    left_out = PAGE_ALONE if "share" in summary["rank_by"] else (*PAGE_ALONE, "Share [%]")
    shown = [{head: cell for head, cell in row.items() if head not in left_out} for row in _ranking_rows(ranking)]
    out = [*aligned(shown), f"{len(ranking)} of {summary['layouts_given']} layouts traced", summary["tied"]]
    out += [line.replace("\u00a0", " ") for line in (TEXTS["notes"], *_people(ranking), *summary["limits"])]
    named = _named(ranking)
    for name, better in summary["gains"].items():
        times = with_error(better["value"], better["stderr"], negligible=1e-3)
        out.append(f"{named[ranking[0]['layout']]} resolves force {times} times as finely as {named[name]}.")
    out += [TOLERATED, *aligned(_tolerance_rows(summary["tolerances"]))]
    if summary["front"]["table"]:
        out += [summary["front"]["words"], *aligned(summary["front"]["table"])]
    words = [rough_words(ranking), summary["best_possible"]["words"], summary["verified_by_mitsuba"]]
    return [*out, *filter(None, words), *summary.get("conclusions", [])]


PLACEMENT = Report(
    ("place.nc", "ranking.csv", "best.toml", "best.csv", "outline.dxf", "best.kicad_pcb", "best.glb", "place.html"),
    page,
    summary,
    lambda result, summary: lines(summary),
    {
        "best": lambda result: maps.top_view(chosen(result)),
        "ranking": ranking_figure,
        "maps": lambda result, led=0: map_figure(chosen(result), result, led=led),
    },
    _files,
    chosen,
)
