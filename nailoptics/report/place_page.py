"""The page of a placement: which layout tells force best, how sure that is, and where on the board the light tells."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..io import write_text
from ..studies.ambient import SOURCES
from ..studies.comparison.fits import Z95
from ..studies.placement.result import chosen, gain, rows
from . import place_figures as figures
from .html import document, table
from .html import figure as drawing
from .numbers import quantity, significant, with_error

# Beyond this nothing but what was known before is told.
NOTHING_MN = 1e3


def write_placement(result: xr.Dataset, path: Path) -> None:
    """Write the page of what `studies.place.place` returns, whole or not at all."""
    write_text(Path(path), page(result))


def page(result: xr.Dataset) -> str:
    """The page as text."""
    best, ranking = chosen(result), rows(result)
    first = ranking[0]
    tied = sum(row["rank"] == 1 for row in ranking)
    fingers = [str(name) for name in result.finger.values]
    over = "" if len(fingers) == 1 else f", {result.attrs['rank_by']} of {len(fingers)} fingers"
    lead = (
        f"Layout {first['layout']} resolves {quantity(first['force_resolution_n'], 'N')} of force in one sample "
        f"(rms{over}, 95 % interval {quantity(first['force_resolution_low_n'], 'N')} to "
        f"{quantity(first['force_resolution_high_n'], 'N')}), whatever part of it presses proximally. "
    )
    lead += "No other layout comes near." if tied == 1 else f"{tied - 1} more cannot be told from it."
    if tied > 1:
        lead = lead.replace("1 more cannot", "One more cannot")
    cards = [(quantity(first["force_resolution_n"], "N"), "force resolved in one sample, rms")]
    better = gain(result)
    if better and first["layout"] != "paper":
        cards.append((f"{with_error(*better)} ×", "as fine as the paper's layout"))
    cards.append((f"{significant(first['condition_number'])}", "condition number of readings by blood zones"))
    cards.append((f"{100 * first['shunted_fraction']:.0f} %", "of a photodiode's light at most was never in the bed"))
    body = [
        "<section><h2>The ranking</h2>",
        drawing(
            figures.ranking_figure(result),
            "ranking",
            "Force resolution of each layout, smaller is finer, with its 95 % interval; those whose intervals overlap "
            "that of the best are tied with it (filled). Small ticks are the single fingers.",
        ),
        _table(ranking),
        _check(result),
        "</section><section><h2>The best layout</h2>",
        drawing(
            figures.board_figure(best, result),
            "board",
            "The board from above, rolled flat: LED, barrier and photodiodes on the nail, whose tint shows the blood "
            "below.",
        ),
        _photodiodes(result),
        "<h3>Where each photodiode looks</h3>",
        drawing(
            figures.banana_figure(best, result),
            "bananas",
            "Where under the nail each photodiode looks: how much its reading falls by absorption there (shaded: all "
            "of them, each by its share, over three decades). Outlined are the densest places that hold half of "
            "it, one colour for each photodiode from proximal (warm) to distal (cool).",
        ),
        "<h3>Light from outside</h3>",
        _ambient(result),
        "</section><section><h2>Where on this board the light tells</h2>",
        drawing(
            figures.map_figure(best, result),
            "maps",
            "On the flat board with this LED and wall, first finger, logarithmic scales with contours: light per area; "
            "its part that was never in the bed; the noise of one more photodiode centred there, rms in one sample "
            "(even scale); and what it would resolve by itself, were the split of the force known. Bright is fine; "
            "blank where too few photons came and, round the LED, where it would be saturated.",
        ),
        drawing(
            figures.sensitivity_figure(best, result),
            "sensitivity",
            "How much the light at each place falls with blood in the proximal (left) and in the distal zone (right), "
            "relative to the light there: percent for each percent of the bed that is blood. Blank where too few "
            "photons came.",
        ),
    ]
    if "led_place_fraction" in result:
        body += [
            drawing(
                figures.led_figure(best, result),
                "led",
                "The LED elsewhere, photodiodes and wall as they are: the light that it would bring to all of them, "
                "and the force that they would resolve. One trace from each photodiode gives its reading of an LED at "
                "every place (reciprocity); blank where too few photons came or little would be told.",
            ),
            _reciprocity(result),
        ]
    if result.sizes["led_site"]:
        text = "Places of the LED that were tried: the force that the best photodiodes for each would resolve."
        body.append(
            drawing(figures.tried_figure(result), "tried", text + " Triangles point from the LED to its photodiodes.")
        )
    return document(
        kicker="where to put them",
        title=f"{result.sizes['best_photodiode']} photodiodes on the nail",
        lead=lead,
        cards=cards,
        body=[*body, "</section>"],
        attributes=result.attrs,
    )


def _table(ranking: list[dict[str, Any]]) -> str:
    head = ["Layout", "Rank", "Resolves<br>[mN]", "Split known<br>[mN]", "Proximal, distal<br>pressure [Pa]"]
    head += ["Condition", "Least<br>signal / noise"]
    head += ["Full scale /<br>reading", "Never in<br>bed [%]"]
    lines = []
    for row in ranking[: figures.SHOWN]:
        force = with_error(1e3 * row["force_resolution_n"], 1e3 * row["force_resolution_n_stderr"])
        cells = [row["layout"].replace("_", " "), f"{row['rank']}{' (tied)' if row['tied'] else ''}", force]
        cells += [significant(1e3 * row["fixed_ratio_resolution_n"])]
        cells += [", ".join(significant(row[f"{name}_pressure_pa"]) for name in ("proximal", "distal"))]
        cells += [significant(row["condition_number"])]
        cells += [
            significant(row["least_snr"]),
            significant(row["adc_headroom"]),
            f"{100 * row['shunted_fraction']:.0f}",
        ]
        lines.append(cells)
    return table(head, lines)


def _check(result: xr.Dataset) -> str:
    attrs = result.attrs
    fresh = with_error(1e3 * attrs["checked_resolution_n"], 1e3 * attrs["checked_resolution_n_stderr"])
    foretold = with_error(
        1e3 * float(result.finger_resolution_n[0, 0]), 1e3 * float(result.finger_resolution_n_stderr[0, 0])
    )
    return (
        f"<p class='small'>Layouts are read from maps of the bare board. The best was traced once more with its "
        f"photodiodes on it: on the first finger it resolves {fresh} mN, {foretold} mN by the map.</p>"
    )


def _photodiodes(result: xr.Dataset) -> str:
    """What each photodiode of the best layout reads, first finger and LED."""
    head = ["Photodiode", "Reads<br>[V]", "Full scale /<br>reading", "Noise<br>[µV]", "Signal /<br>noise"]
    head += ["Never in<br>bed [%]", "Proximal blood<br>[mV / %]", "Distal blood<br>[mV / %]", "Looks at depth<br>[mm]"]
    best = result.isel(led=0)
    seen = best.depth_sensitivity * best.cell_volume_mm3
    with np.errstate(invalid="ignore"):
        looks = (
            (seen * best.depth).sum(("under_u", "under_v", "depth")) / seen.sum(("under_u", "under_v", "depth"))
        ).values
    lines = []
    for j, name in enumerate(result.best_photodiode.values):
        volts, noise = float(best.predicted_volts[j]), float(best.predicted_noise_v[j])
        line = [str(name), with_error(volts, float(best.predicted_volts_stderr[j]))]
        line += [significant(result.attrs["adc_range_v"] / volts), significant(1e6 * noise), significant(volts / noise)]
        crosstalk = (100 * float(best[f"predicted_shunted_fraction{end}"][j]) for end in ("", "_stderr"))
        line.append(with_error(*crosstalk))
        # A hundredth of the bed's volume, in millivolts.
        line += [
            with_error(*(10 * float(best[f"predicted_zone_v{end}"][j, k]) for end in ("", "_stderr"))) for k in range(2)
        ]
        lines.append([*line, significant(float(looks[j]))])
    return table(head, lines)


def _ambient(result: xr.Dataset) -> str:
    """Sun and lamp, with and without the cover."""
    head = ["", "Photocurrent<br>at most [µA]", "Output<br>at most [V]", "Noise<br>at most [µV]", "Resolves<br>[mN]"]
    noise = 1e6 * float(result.predicted_noise_v.max())
    own = float(result.predicted_volts.max())
    lines = [
        ["none", "0", significant(own), significant(noise), significant(1e3 * float(result.finger_resolution_n[0, 0]))]
    ]
    for cover in result.cover.values:
        for source in SOURCES:
            at = result.sel(cover=cover, ambient=source.name)
            current = 1e6 * float((at.ambient_a + Z95 * at.ambient_a_stderr).max())
            lux = f"{source.lux:,.0f}".replace(",", "\u202f")
            name = f"{source.name}, {lux} lux, " + ("with the cover" if cover == "covered" else "without it")
            tells, volts = 1e3 * float(at.ambient_resolution_n), float(at.ambient_volts.max())
            end = " (saturated)" if bool((at.ambient_volts >= result.attrs["adc_range_v"]).any()) else ""
            told = significant(tells) if tells < NOTHING_MN else "nothing"
            noise = 1e6 * float(at.ambient_noise_v.max())
            lines.append([name, significant(current), significant(volts) + end, significant(noise), told])
    note = (
        "<p class='small'>The largest of all photodiodes, upper end of the 95 % interval, for light from all sides "
        "with the spectrum of a black body. A steady part can be subtracted; its noise and a saturated converter "
        "cannot.</p>"
    )
    return table(head, lines) + note


def _reciprocity(result: xr.Dataset) -> str:
    """How far the two directions of light agree."""
    sums, errors = [], []
    for name in ("reciprocal_fraction", "checked_fraction"):
        sums.append(float(result[name].isel(led=0).sum()))
        errors.append(float(np.linalg.norm(result[f"{name}_stderr"].isel(led=0))) / sums[-1])
    ratio = sums[0] / sums[1]
    told = with_error(ratio, ratio * float(np.linalg.norm(errors)))
    return (
        f"<p class='small'>For the LED where it is, light back from all photodiodes foretells {told} times what they "
        "read of it in a fresh trace.</p>"
    )
