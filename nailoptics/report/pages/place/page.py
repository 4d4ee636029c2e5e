"""The page of a placement: the ranking of layouts with its uncertainty, and maps of light, noise and resolution."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ....io import write_text
from ....scene import Placement, Scene, parse_scene
from ....sensor.ambient import SOURCES
from ....sensor.physiological_noise import LIFT_PER_UM
from ....studies.placement import boards
from ....studies.placement.result import chosen, gain, rough_words, rows
from ...html import document, escaped, figure, section, small, table
from ...numbers import quantity, significant, with_error
from ...scene_description import body_words
from ...uncertainty_section import spread_section
from . import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Within this part of the best resolution more photodiodes are hardly worth their wires.
NEARLY = 0.1
# A resolution beyond this is that of the prior alone.
NOTHING_MN = 1e3
CAPTIONS = {
    "ranking": "Force resolution of each layout (smaller is better) with its 95 % interval; layouts whose intervals "
    "overlap that of the best are tied with it (filled). Small ticks are the individual fingers; diamonds, where the "
    "scene has a body, the resolution limited by the electronics alone. Layouts from the search are named after the "
    "position of their LEDs, in the scene's order: led m1.25 p0 left lies at u = −1.25 mm, v = +0 mm, left of its "
    "photodiodes.",
    "board": "The board from above, rolled flat: LED, barrier and photodiodes on the nail, whose tint shows the blood "
    "below.",
    "bananas": "Sensitivity of each photodiode's reading to absorption below the nail (shaded: the mean of all "
    "photodiodes, each normalised, over three decades). Outlined is the densest region that holds half of it, one "
    "colour for each photodiode from proximal (warm) to distal (cool).",
    "maps": "On the flat board with this LED and wall, first finger, logarithmic scales with contours: light per "
    "area; its shunted part, which bypassed the bed; the noise of one more photodiode centred there, rms in one "
    "sample (linear scale); and its own force resolution if the split of the force is known. Bright is good; blank "
    "where too few photons arrived and, around the LED, where it would saturate.",
    "count": "Left: force resolution of the best subset of so many photodiodes on this board, where the scene has a "
    "body with its physiological noise, and limited by the electronics alone, with 95 % intervals; half of the photons "
    "selected the subset, the other half evaluated it. Right: their positions.",
    "sensitivity": "Relative sensitivity of the light at each place to blood in the proximal (left) and in the distal "
    "zone (right): percent of the light for each percent of the bed that is blood. Blank where too few photons "
    "arrived.",
    "led": "The LED moved, photodiodes and wall as they are: the light on all photodiodes, and their force "
    "resolution. One trace from each photodiode gives its reading of an LED at every place (reciprocity); blank where "
    "too few photons arrived or the resolution is close to the prior.",
    "tried": "Candidate positions of the LED: force resolution with the best photodiodes for each, of several LEDs "
    "with the best positions of the others. Triangles point from the LED to its photodiodes.",
}


def write_placement(result: xr.Dataset, path: Path) -> None:
    """Write the page of what `place` returns, whole or not at all; raises WriteError."""
    best, ranking = chosen(result), rows(result)
    layout = [_figure("board", figures.board_figure(best)), _photodiodes(result)]
    inspected = "checked_fraction" in result
    if inspected:
        layout.append("<h3>Sensitivity of each photodiode</h3>")
        layout += [_of_led("bananas", figures.banana_figure(best, one), one, best) for one in _each_led(result)]
        layout += ["<h3>Ambient light</h3>" + _ambient(result)]
    checked = _check(result) if inspected else small("No time was left to verify the best layout by its own trace.")
    text = document(
        kicker="layout optimisation",
        title=f"{result.sizes['best_photodiode']} photodiodes on the nail",
        lead=_lead(result, ranking),
        cards=_cards(result, ranking),
        body=[
            section(
                "The ranking",
                _figure("ranking", figures.ranking_figure(result)),
                _table(ranking),
                _rough(ranking),
                checked,
            ),
            _through_the_body(best, result),
            _how_many(best, result),
            section("The best layout", *layout),
            section("Maps of this board", *(_maps(best, one) for one in _each_led(result))),
            spread_section(result),
        ],
        attributes=result.attrs,
    )
    write_text(Path(path), text)


def _each_led(result: xr.Dataset) -> list[xr.Dataset]:
    """The result with one LED alone, for each of them."""
    return [result.isel(led=[i]) for i in range(result.sizes["led"])]


def _led_words(scene: Scene, one: xr.Dataset) -> str:
    """Which LED a result of one LED is about."""
    led = next(led for led in scene.leds if led.name == str(one.led.values[0]))
    return f"LED {led.name}, {led.wavelength_nm:.0f} nm"


def _of_led(name: str, drawing: "Figure", one: xr.Dataset, scene: Scene, *, narrow: bool = False) -> str:
    """A figure of one LED; of several LEDs each is named."""
    if len(scene.leds) == 1:
        return _figure(name, drawing, narrow=narrow)
    led = str(one.led.values[0])
    return figure(drawing, f"{name}-{led}", f"{_led_words(scene, one)}. {CAPTIONS[name]}", narrow=narrow)


def _maps(best: Scene, one: xr.Dataset) -> str:
    """All maps of one LED."""
    narrow = figures.slender(one)
    maps = "" if len(best.leds) == 1 else f"<h3>{escaped(_led_words(best, one))}</h3>"
    maps += _of_led("maps", figures.map_figure(best, one), one, best)
    maps += _of_led("sensitivity", figures.sensitivity_figure(best, one), one, best, narrow=narrow)
    if "led_place_fraction" in one:
        maps += _of_led("led", figures.led_figure(best, one), one, best, narrow=narrow)
        maps += _reciprocity(one) if str(one.led.values[0]) == best.leds[0].name else ""
    if one.sizes["led_site"]:
        maps += _of_led("tried", figures.sites_figure(one), one, best, narrow=True)
    return maps


def _figure(name: str, drawing: "Figure", *, narrow: bool = False) -> str:
    return figure(drawing, name, CAPTIONS[name], narrow=narrow)


def _lead(result: xr.Dataset, ranking: list[dict[str, Any]]) -> str:
    first, tied = ranking[0], sum(row["rank"] == 1 for row in ranking)
    force, low, high = (quantity(first[f"force_resolution_{end}n"], "N") for end in ("", "low_", "high_"))
    fingers = result.sizes["finger"]
    over = "" if fingers == 1 else f", {_rules(result).over_fingers} of {fingers} fingers"
    others = f"{'One' if tied == 2 else tied - 1} more {'is' if tied == 2 else 'are'} tied with it."
    if tied == 1:
        others = "No other layout is tied with it." if len(ranking) > 1 else "It is the only one evaluated."
    noise = body_words(chosen(result)) if "electronics_resolution_n" in result else ""
    return (
        f"Layout {first['layout']} resolves {force} of force in one sample (rms{over}, 95 % interval {low} to {high}), "
        f"for any split between the proximal and the distal side{f', with {noise}' if noise else ''}. "
        f"{_ranked_by(result, first)}{others}"
    )


def _rules(result: xr.Dataset) -> Placement:
    """The rules of the search."""
    return boards.rules(parse_scene(str(result.attrs["scene"]), name="the scene"))


def _ranked_by(result: xr.Dataset, first: dict[str, Any]) -> str:
    """What layouts are ranked by, where that is not the force alone, and the best one's figures for it."""
    weights, others = _rules(result).weights, []
    if "share" in weights:
        percent = with_error(100 * first["share_resolution"], 100 * first["share_resolution_stderr"])
        others.append(f"that part to {percent} % of the force")
    if "oxygen" in weights:
        error = with_error(first["spo2_error_percent"], first["spo2_error_percent_stderr"])
        others.append(f"SpO2 to {error} % over 8 s with the electronics' noise")
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
        tied = sum(row["tied"] for row in ranking)
        beside = f"; {tied} layouts are tied with each other" if tied else ""
        cards.append((f"{with_error(*better)} ×", f"better force resolution than the paper's layout{beside}"))
    cards.append((significant(first["condition_number"]), "condition number of readings by blood zones"))
    shunted = f"{100 * first['shunted_fraction']:.0f} %"
    return [*cards, (shunted, "shunted: the largest part of a photodiode's light that bypassed the bed")]


def _table(ranking: list[dict[str, Any]]) -> str:
    head = ["Layout", "Rank", "Resolution<br>[mN]", "Split known<br>[mN]", "Share<br>[%]"]
    head += ["Proximal, distal<br>pressure [Pa]"]
    head += ["Condition", "Lowest<br>SNR", "Full scale /<br>reading", "Shunted<br>[%]"]
    if "electronics_rank" in ranking[0]:
        head[3:3] = ["Electronics<br>alone [mN]", "Rank<br>by it"]
    lines = [
        [
            escaped(row["layout"].replace("_", " ")),
            f"{row['rank']}{' (tied)' if row['tied'] else ''}",
            with_error(1e3 * row["force_resolution_n"], 1e3 * row["force_resolution_n_stderr"]),
            *_electronics_alone(row),
            significant(1e3 * row["fixed_ratio_resolution_n"]),
            with_error(100 * row["share_resolution"], 100 * row["share_resolution_stderr"]),
            ", ".join(significant(row[f"{name}_pressure_pa"]) for name in ("proximal", "distal")),
            *(significant(row[name]) for name in ("condition_number", "least_snr", "adc_headroom")),
            f"{100 * row['shunted_fraction']:.0f}",
        ]
        for row in ranking[: figures.SHOWN]
    ]
    return table(head, lines)


def _rough(ranking: list[dict[str, Any]]) -> str:
    """Which layouts the photons were too few for; empty if for none."""
    return small(escaped(words)) if (words := rough_words(ranking)) else ""


def _electronics_alone(row: dict[str, Any]) -> list[str]:
    """Two cells of the table: the resolution limited by the electronics alone, and the rank by it."""
    if "electronics_rank" not in row:
        return []
    each = (1e3 * row[f"electronics_resolution_n{end}"] for end in ("", "_stderr"))
    return [with_error(*each), str(row["electronics_rank"])]


def _through_the_body(best: Scene, result: xr.Dataset) -> str:
    """The effect of physiological noise on the resolution; empty without a body."""
    if "electronics_resolution_n" not in result:
        return ""
    bandwidth_hz, requested = result.attrs["bandwidth_hz"], parse_scene(str(result.attrs["scene"]), name="the scene")
    sample = f"a mean over {significant(500 / bandwidth_hz)} ms (a bandwidth of {bandwidth_hz:g} Hz)"
    false_force = ", ".join(dict.fromkeys(significant(1e3 * float(one)) for one in result.physiological_noise_force_n))
    text = (
        f"<p>One sample is {sample}. It is evaluated without the samples before it, from which "
        f"{escaped(body_words(best))} could be estimated, so that waves slower than its bandwidth count in full. Such "
        "waves change the blood of both zones, each with the gain of the vessels at its frequency. A sensor of the "
        "blood in two zones cannot distinguish them from two pressures with the same effect: with every layout they "
        f"produce a false force of {false_force} mN rms, a physiological noise floor. The contribution of drift and "
        "lift depends on the layout; if the split of the touch is known, most of the waves can be separated from it, "
        f"too. {_worn(requested)}</p>"
    )
    text += small(
        "nailoptics predict uses the samples before. Where its model fits and the electronics are the only noise, the "
        "error of its force estimate lies within 1.3 times the bound for electronics alone; its error with a person's "
        "body is given on the page of the calibration."
    )
    return section("Physiological noise", text)


def _how_many(best: Scene, result: xr.Dataset) -> str:
    """Force resolution against the number of photodiodes; empty where no time was left for it."""
    if "count_electronics_resolution_n" not in result:
        return ""
    drawn = _figure("count", figures.count_figure(best, result))
    return section("Number of photodiodes", _enough(result), drawn, _counts(result))


def _enough(result: xr.Dataset) -> str:
    """The fewest photodiodes that resolve force nearly as well as the most."""
    has_body = "count_resolution_n" in result
    name, purpose = ("count_resolution_n", "body") if has_body else ("count_electronics_resolution_n", "electronics")
    at = result.sel(chosen_for=purpose).dropna("photodiode_count", subset=[name])
    if at.sizes["photodiode_count"] < 2:
        return ""
    counts, finest = at.photodiode_count.to_numpy(), float(at[name].min())
    few = int(counts[np.flatnonzero(at[name].to_numpy() <= (1 + NEARLY) * finest)[0]])
    return (
        f"<p>{few} photodiode{'s' if few > 1 else ''} resolve{'' if few > 1 else 's'} force within "
        f"{100 * NEARLY:.0f} % of what {int(counts[-1])} resolve on the best layout's board with its LEDs, each "
        "number at its best positions. Other positions of the LEDs may suit that number better: search with "
        f"placement.photodiodes = {few}.</p>"
    )


def _worn(scene: Scene) -> str:
    """The assumed effect of the sensor's drift and motion; empty without either."""
    body, parts = scene.body, []
    if body is not None and body.drift is not None:
        since_s = boards.rules(scene).since_rest_s
        each = (
            100 * gain * math.sqrt(since_s / 60) for gain in (body.drift.led_per_rt_min, body.drift.reading_per_rt_min)
        )
        led, reading = map(significant, each)
        parts.append(
            f"{significant(since_s)} s after the last reading of the untouched finger, all readings of an LED have "
            f"drifted by {led} % together and each independently by {reading} %; more photodiodes average the latter."
        )
    if body is not None and body.motion is not None:
        percent = significant(100 * LIFT_PER_UM * body.motion.lift_um)
        parts.append(
            f"A lift of {body.motion.lift_um:g} µm is assumed to change all readings by {percent} % together, at any "
            "distance from the LED; sliding along the nail is not included."
        )
    return " ".join(parts)


def _counts(result: xr.Dataset) -> str:
    """Resolution against the number of photodiodes, selected with physiological noise, if there is any, and without."""
    kinds = [("Electronics<br>alone [mN]", "count_electronics_resolution_n", "electronics")]
    if "count_resolution_n" in result:
        kinds.insert(0, ("With physiological<br>noise [mN]", "count_resolution_n", "body"))
        text = "Selected for the<br>electronics, with physio-<br>logical noise [mN]"
        kinds.append((text, "count_resolution_n", "electronics"))
    head = ["Photodiodes", *(title for title, _, _ in kinds)]
    lines = []
    for count in result.photodiode_count.values:
        at = [
            result[f"{name}{end}"].sel(chosen_for=purpose, photodiode_count=count)
            for _, name, purpose in kinds
            for end in ("", "_stderr")
        ]
        values = [1e3 * float(one) for one in at]
        if all(map(math.isfinite, values)):
            lines.append([str(count), *(with_error(*values[i : i + 2]) for i in range(0, len(values), 2))])
    return table(head, lines)


def _check(result: xr.Dataset) -> str:
    fresh = with_error(*(1e3 * result.attrs[f"checked_resolution_n{end}"] for end in ("", "_stderr")))
    by_map = with_error(*(1e3 * float(result[f"finger_resolution_n{end}"][0, 0]) for end in ("", "_stderr")))
    return small(
        "Layouts are evaluated on photon maps of the bare board. The best was verified by a trace with its photodiodes "
        f"in place: on the first finger it resolves {fresh} mN, {by_map} mN by the map."
    )


def _photodiodes(result: xr.Dataset) -> str:
    """The readings of the best layout on the first finger: each photodiode under each LED."""
    head = ["Photodiode", "Reading<br>[V]", "Full scale /<br>reading", "Noise<br>[µV]", "SNR"]
    head += ["Shunted<br>[%]", "Proximal blood<br>[mV / %]", "Distal blood<br>[mV / %]", "Mean depth<br>[mm]"]
    lines: list[list[str]] = []
    names = chosen(result).layout.photodiode_names
    pairs = [(str(led), i) for led in result.led.values for i in range(len(names))]
    for led, i in pairs:
        one = result.sel(led=led).isel(best_photodiode=i)

        def known(name: str, scale: float = 1.0, one: xr.Dataset = one, **at: int) -> str:
            return with_error(*(scale * float(one[f"{name}{end}"].isel(at)) for end in ("", "_stderr")))

        volts, noise_v = float(one.predicted_volts), float(one.predicted_noise_v)
        line = [escaped(names[i]), known("predicted_volts"), significant(result.attrs["adc_range_v"] / volts)]
        line += [significant(1e6 * noise_v), significant(volts / noise_v), known("predicted_shunted_fraction", 100)]
        # A hundredth of the bed's volume, in millivolts.
        line += [known("predicted_zone_v", 10, blood_zone=zone) for zone in range(2)]
        lines.append([*line, known("mean_depth_mm") if "mean_depth_mm" in one else "–"])
    groups = [f"LED {led}" for led, _ in pairs] if result.sizes["led"] > 1 else None
    return table(head, lines, groups=groups)


def _ambient(result: xr.Dataset) -> str:
    """Sun and lamp, with and without the cover."""
    head = ["", "Photocurrent<br>at most [µA]", "Output<br>at most [V]", "Noise<br>at most [µV]", "Resolution<br>[mN]"]
    alone = [result.predicted_volts.max(), 1e6 * result.predicted_noise_v.max(), 1e3 * result.finger_resolution_n[0, 0]]
    lines = [["none", "0", *(significant(float(value)) for value in alone)]]
    for cover in result.cover.values:
        for source in SOURCES:
            at = result.sel(cover=cover, ambient=source.name)
            lux = f"{source.lux:,.0f}".replace(",", "\u202f")
            name = f"{source.name}, {lux} lux, {'with the cover' if cover == 'covered' else 'without it'}"
            most = [1e6 * at.ambient_high_a.max(), at.ambient_volts.max(), 1e6 * at.ambient_noise_v.max()]
            current, output, noise = (significant(float(value)) for value in most)
            if bool((at.ambient_volts >= result.attrs["adc_range_v"]).any()):
                output += " (saturated)"
            resolution_mn = 1e3 * float(at.ambient_resolution_n)
            resolves = significant(resolution_mn) if resolution_mn < NOTHING_MN else "nothing"
            lines.append([name, current, output, noise, resolves])
    return table(head, lines) + small(
        "The largest of all photodiodes, upper end of the 95 % interval, for ambient light from all sides with the "
        "spectrum of a black body. A steady part can be subtracted; its noise and a saturated converter cannot."
    )


def _reciprocity(result: xr.Dataset) -> str:
    """Agreement of the two directions of tracing."""
    ratio = with_error(*(result.attrs[f"reciprocity_ratio{end}"] for end in ("", "_stderr")))
    return small(
        f"For the LED at its position, light traced back from all photodiodes predicts {ratio} times their reading in "
        "an independent trace."
    )
