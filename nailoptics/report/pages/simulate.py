"""The page of a simulated touch: key figures, figures, tables, and what reproduces it."""

import logging
import math
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from ...errors import InputError
from ...scene import Scene, parse_scene
from ...tissue import bed_zone_name
from .. import maps, style
from ..files import Report
from ..html import document, escaped, figure, number, section, small, table
from ..numbers import prefix, quantity, significant, with_error
from ..readings import Reading, hold_end, photodiode_readings, simulation_lines, simulation_summary
from ..scene_description import blood_words, body_words
from ..uncertainty_section import spread_section
from . import simulate_figures as figures

TOUCH = "Force over time, and the pressures that it exerts on the vessels."
VESSELS = (
    "Pressure on the pulp's veins obstructs the return of blood, which pools in the capillaries under the nail; "
    "pressure on the distal capillaries expels it from them."
)
OVERVIEW = (
    "Change of every photodiode from rest while the finger is pressed. Warm colours lie proximal, cool ones distal. "
    "The dotted line marks the end of the hold, at which the table below is read."
)
READINGS = (
    "± is one standard error of the light tracing; the z score is the change in standard errors. Both states of a "
    "change are read from one trace, so its error is far below that of a level. Noise is that of the electronics and "
    "the converter in one sample; the resolution is the force that equals it, by the mean slope from rest to the end "
    "of the hold."
)
BOARD = (
    "The board on the nail, from above and rolled flat. The tint of the nail shows which blood lies below; between the "
    "dotted lines one passes into the other."
)
SECTION = "The section along the middle of the nail."
PATHS = (
    " On it, the paths of all the light that the LED emits, summed over the finger's width, on a logarithmic scale: "
    "half of them lie within the solid line, 90 % within the dashed one. Above, the photodiodes in their colours and "
    "the LED (triangle) where they lie along the nail."
)
ENDS = (
    "Where the light of each LED ends, in percent of what it emits, with its standard error: what absorbs it, and what "
    "leaves the finger. Regions that take less than 0.01 % of it are left out."
)
MODELS = (
    "<p>Each photodiode's traced volts with Beer–Lambert (8), V = V<sub>0</sub> + V<sub>1</sub> exp(−αD²), and Taylor "
    "(9), V = V′<sub>0</sub> − V′<sub>1</sub>D², fitted to them over the capillary diameter D of the photodiode's own "
    "zone. Below each, the residuals (model minus traced light), on one scale for all, with the noise of one sample in "
    "grey.</p>"
)
VOLTS = (
    "Volts over time: proximal photodiodes on the left, distal ones on the right. Where no band is seen it is thinner "
    "than the line."
)
MEAN_PATH = (
    "<p>Mean path, at rest, of the light that reaches each photodiode, in place of the single path length L of the "
    "reduced optics. A reading falls by this fraction per mm⁻¹ of absorption.</p>"
)
log = logging.getLogger(__name__)


def page(result: xr.Dataset) -> str:
    """The page of what `studies.simulate` returns; path density and section may be missing."""
    scene = _scene(result)
    readings = photodiode_readings(result, scene)
    touch = figure(figures.touch(result), "touch", TOUCH)
    vessels = figure(figures.vessels(result), "vessels", VESSELS)
    return document(
        kicker="touch to volts",
        title=_title(scene),
        lead=_sentence(scene, result),
        warnings=_warnings(readings, result),
        cards=_cards(readings, result),
        body=[
            _readings_section(result, scene, readings),
            section("The touch and the blood", touch, vessels, _bed(result, scene)),
            _space_section(result, scene),
            _models_section(result, scene, readings),
            spread_section(result),
        ],
        attributes=result.attrs,
    )


def _bed(result: xr.Dataset, scene: Scene | None) -> str:
    """The blood along the nail, where it has more zones than a figure over time can show."""
    if scene is None or scene.finger is None or "white_band_mm" not in result or result.sizes["time"] < 2:
        return ""
    text = "Zones of the nail bed over time. Above the dashed line: the white band, with less than half of its blood."
    return figure(figures.bed(result, scene), "bed", text)


def _readings_section(result: xr.Dataset, scene: Scene | None, readings: list[Reading]) -> str:
    return section(
        "Readings of the photodiodes",
        figure(figures.overview(result, scene), "overview", OVERVIEW),
        _readings_table(readings, float(result.time[hold_end(result)])),
        small(READINGS),
    )


def _space_section(result: xr.Dataset, scene: Scene | None) -> str:
    board = "" if scene is None else figure(maps.top_view(scene), "top", BOARD, narrow=True)
    cut, ends = small("The section of the finger was not computed."), ""
    if "section_region" in result:
        cut = figure(maps.section(scene, result), "section", SECTION + (PATHS if "path_density" in result else ""))
    if "absorbed_fraction" in result:
        ends = figure(figures.light_ends(result), "ends", ENDS)
    return section("The sensor on the finger", board, cut, ends)


def _models_section(result: xr.Dataset, scene: Scene | None, readings: list[Reading]) -> str:
    lines, text = [MODELS], VOLTS
    if result.sizes["photodiode"] > figures.PANELS:
        text += f" {figures.PANELS} of {result.sizes['photodiode']} are shown, evenly spaced."
    for i, led in enumerate(result.led.values):
        if result.sizes["led"] > 1:
            lines.append(f"<h3>LED {escaped(led)}, {significant(float(result.wavelength_nm[i]))} nm</h3>")
        lines.append(figure(figures.volts(result, scene, led=i), f"volts{i}", text))
    lines += ["<h3>Constants of Beer–Lambert (8) and Taylor (9)</h3>", _fit_table(result, readings)]
    if paths := _path_table(result, readings):
        lines += ["<h3>Mean path of the detected light</h3>", MEAN_PATH, paths]
    return section("Traced light beside the reduced optics", *lines)


def _scene(result: xr.Dataset) -> Scene | None:
    """The scene that a result carries; None, and the page goes without the board's drawing, if it cannot be read."""
    try:
        return parse_scene(str(result.attrs["scene"]))
    except (InputError, KeyError) as error:
        log.warning("the result's scene cannot be read (%s); the report leaves out the drawing of the board", error)
        return None


def _title(scene: Scene | None) -> str:
    """What was simulated, in a few words."""
    if scene is None or scene.finger is None:
        return "Fingernail sensor"
    touch, digit = scene.touch, scene.finger.digit
    several = {"recorded": "A recorded touch", "steps": "Steps of force", "cycle": "Cycles of force"}
    kind = several.get(touch.profile, f"A {touch.profile} of {touch.force_n:g} N")
    return f"{kind} on {'an' if digit == 'index' else 'a'} {digit}{'' if digit == 'thumb' else ' finger'}"


def _sentence(scene: Scene | None, result: xr.Dataset) -> str:
    """What was simulated, in one sentence."""
    leds, photodiodes = result.sizes["led"], result.sizes["photodiode"]
    waves = _list([f"{float(w):g}" for w in result.wavelength_nm]) + " nm"
    text = f"{leds} LED{'s' * (leds != 1)} ({waves}) and {photodiodes} photodiode{'s' * (photodiodes != 1)} on the nail"
    text += f"; force up to {float(result.force_n.max()):.3g} N"
    if duration := float(result.time[-1] - result.time[0]):
        text += f" within {duration:.3g} s"
    if scene is not None and scene.finger is not None:
        blood = scene.blood
        text += f"; blood {100 * blood.rest_blood_fraction:g}\u00a0% of the bed at rest, "
        text += blood_words(scene)
        if body := body_words(scene):
            text += f"; {body}"
    accuracy = result.attrs.get("accuracy_reached")
    return f"{text}. Light traced to: {accuracy}." if accuracy else f"{text}."


def _cards(readings: Sequence[Reading], result: xr.Dataset) -> list[tuple[str, str]]:
    """Key figures as (number, words)."""
    lines: list[tuple[str, str]] = []
    readings = [r for r in readings if not r.saturated]
    name = {id(r): f"{r.photodiode} under {r.led}" if result.sizes["led"] > 1 else r.photodiode for r in readings}
    for sign, word in ((-1, "fall"), (1, "rise")):
        if moved := [r for r in readings if sign * r.change_v > 0]:
            r = max(moved, key=lambda r: abs(r.change_v))
            ratio = f"signal-to-noise ratio {significant(r.signal_to_noise)}"
            words = f"largest {word}: {name[id(r)]}, {significant(r.change_percent, sign=True)} %, {ratio}"
            lines.append((quantity(r.change_v, "V", sign=True), words))
    if resolved := [r for r in readings if 0 < r.resolution_n < math.inf]:
        r = min(resolved, key=lambda r: r.resolution_n)
        words = f"best force resolution of one sample (noise / slope): {name[id(r)]}"
        lines.append((quantity(r.resolution_n, "N"), words))
    if any(r.change_v for r in readings):
        lines.append(_signs(readings, result))
    if "white_band_mm" in result:
        words = "width of the white band at the tip at the end of the hold, with less than half its blood"
        lines.append((f"{float(result.white_band_mm[hold_end(result)]):.1f}\u00a0mm", words))
    # How far the models are from the traced light at worst, beside the noise.
    usable = ~result.saturated.any("time")
    worst = [float(result[f"{model}_residual_rms_v"].where(usable).max()) for model in ("beer_lambert", "taylor")]
    noise_v = max((r.noise_rms_v for r in readings), default=0.0)
    exact, taylor, noise = (quantity(value, "V", digits=2) for value in (*worst, noise_v))
    words = f"largest rms residual of Beer–Lambert (8); Taylor (9): {taylor}; noise of one sample: {noise}"
    return [*lines, (exact, words)]


def _warnings(readings: Sequence[Reading], result: xr.Dataset) -> list[str]:
    """What the reader must know before trusting the numbers."""
    lines = []
    full = [f"{r.photodiode} under {r.led}" for r in readings if r.saturated]
    if full:
        lines.append(
            f"The converter is at its limit: {_list(full)}. These volts do not measure the light; lower "
            "electronics.feedback_ohm or the LED's flux_mw, or raise electronics.adc_range_v."
        )
    if len(full) < len(readings) and not any(r.change_v for r in readings if not r.saturated):
        lines.append("No reading changes: the force does not change within the simulated time, or no blood moves.")
    return lines


def _signs(readings: Sequence[Reading], result: xr.Dataset) -> tuple[str, str]:
    """Whether readings change as in the paper: down over the proximal half of the zones, up over the distal."""
    zones = [str(name) for name in result.zone.values]
    right = [r for r in readings if np.sign(r.change_v) == (1 if 2 * zones.index(r.zone) >= len(zones) else -1)]
    words = "readings change as in the paper: proximal ones fall, distal ones rise"
    least = min((r.sigmas for r in right), default=math.nan)
    if math.isfinite(least):
        words += f", by {significant(least, 2)} σ of the trace or more"
    wrong = [r.photodiode for r in readings if r not in right]
    if right and 0 < len(wrong) < 4:
        words += f"; not {_list(wrong)}"
    return f"{len(right)} of {len(readings)}", words


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


SATURATED = ' <span class="bad">saturated</span>'
# Less alpha D^2 than this over the whole touch: (8) is as straight in D^2 as (9), and its constants are not known.
STRAIGHT = 0.01

# A mean path below this is as good as none.
LEAST_PATH_MM = 1e-3


def _readings_table(readings: Sequence[Reading], hold_s: float) -> str:
    """The readings of every photodiode, LED by LED."""
    largest = (
        max((abs(getattr(r, name)) for r in readings), default=0.0) for name in ("rest_v", "peak_v", "noise_rms_v")
    )
    (volts, letter), (change, change_letter), (noise, noise_letter) = map(prefix, largest)
    columns: dict[str, Callable[[Reading], tuple[float, str]]] = {
        f"At rest<br>[{letter}V]": lambda r: (r.rest_v, with_error(r.rest_v / volts, r.rest_stderr_v / volts)),
        f"Change at<br>{significant(hold_s)} s [{change_letter}V]": lambda r: (
            r.change_v,
            with_error(r.change_v / change, r.change_stderr_v / change, sign=True),
        ),
        "Change<br>[%]": lambda r: (r.change_percent, significant(r.change_percent, 3, sign=True)),
        "z score<br>[σ]": lambda r: (r.sigmas, significant(r.sigmas, 2)),
        f"Largest<br>change [{change_letter}V]": lambda r: (r.peak_v, significant(r.peak_v / change, 3, sign=True)),
        "Prior spread<br>at rest [%]": lambda r: (r.rest_spread, significant(100 * r.rest_spread, 2)),
        "Prior spread<br>of change [%]": lambda r: (r.change_spread, significant(100 * r.change_spread, 2)),
        f"Noise,<br>rms [{noise_letter}V]": lambda r: (r.noise_rms_v, significant(r.noise_rms_v / noise)),
        "SNR<br>[1]": lambda r: (r.signal_to_noise, significant(r.signal_to_noise)),
        "Resolution<br>[mN]": lambda r: (r.resolution_n, significant(r.resolution_n * 1e3)),
    }
    if not any(math.isfinite(r.rest_spread) for r in readings):
        columns = {name: cell for name, cell in columns.items() if not name.startswith("Prior")}
    rows = []
    for r, name in zip(readings, _names(readings), strict=True):
        cells = [escaped(r.zone), number(r.distance_mm, significant(r.distance_mm))]
        if r.saturated:
            at_limit = number(r.rest_v, significant(r.rest_v / volts))
            rows.append([name + SATURATED, *cells, at_limit, *["–"] * (len(columns) - 1)])
        else:
            rows.append([name, *cells, *(number(*cell(r)) for cell in columns.values())])
    head = ["Photodiode", "Blood<br>zone", "Distance<br>to LED [mm]", *columns]
    return table(head, rows, kind="readings dense", groups=_groups(readings))


def _path_table(result: xr.Dataset, readings: Sequence[Reading]) -> str:
    """Mean path of the detected light at rest in every absorber; empty where the engine records no paths."""
    mean, stderr = result.mean_path_mm, result.mean_path_mm_stderr
    if not np.isfinite(mean).any():
        return ""
    passed = (mean + 2 * stderr.fillna(0) >= LEAST_PATH_MM).any(("led", "photodiode"))
    mean, stderr = mean.sel(absorber=passed), stderr.sel(absorber=passed)
    names = {bed_zone_name(k): f"bed, {escaped(zone)}" for k, zone in enumerate(result.zone.values)}
    head = ["Photodiode", *(f"{names.get(str(a), escaped(a))}<br>[mm]" for a in mean.absorber.values)]
    rows = []
    for r, name in zip(readings, _names(readings), strict=True):
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        cells = [name]
        for value, error in zip(mean.isel(here).values.tolist(), stderr.isel(here).values.tolist(), strict=True):
            # A path that is nothing beside a finger is not shown in powers of ten.
            cells.append(
                number(value, "< 0.001" if 0 <= value + 2 * error < LEAST_PATH_MM else with_error(value, error))
            )
        rows.append(cells)
    return table(head, rows, kind="paths", groups=_groups(readings))


def _fit_table(result: xr.Dataset, readings: Sequence[Reading]) -> str:
    """Constants of Beer-Lambert (8) and Taylor (9) as fitted, with their misfit; below, what they could not determine.

    Where the readings do not bend, V0, V1 and alpha of (8) are not known one by one: such a fit is shown as straight.
    """
    largest_m2 = float(result.capillary_diameter_m.max()) ** 2
    fields = [
        ("beer_lambert_v0_v", "Beer–Lambert (8)<br>V<sub>0</sub> [mV]", 1e-3),
        ("beer_lambert_v1_v", "V<sub>1</sub><br>[mV]", 1e-3),
        ("beer_lambert_alpha_per_m2", "α<br>[10⁻³ µm⁻²]", 1e9),
        ("beer_lambert_residual_rms_v", "misfit,<br>rms [µV]", 1e-6),
        ("taylor_v0_v", "Taylor (9)<br>V′<sub>0</sub> [mV]", 1e-3),
        ("taylor_v1_v_per_m2", "V′<sub>1</sub><br>[µV µm⁻²]", 1e6),
        ("taylor_residual_rms_v", "misfit,<br>rms [µV]", 1e-6),
    ]
    rows = []
    marks: dict[str, str] = {}
    for r, name in zip(readings, _names(readings), strict=True):
        if r.saturated:
            rows.append([name + SATURATED, *["–"] * len(fields)])
            continue
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        note = str(result.fit_note.isel(here).item())
        mark = marks.setdefault(note, chr(ord("a") + len(marks) % 26)) if note else ""
        cells = [name + (f" <sup>{mark}</sup>" if mark else "")]
        level_v = abs(float(result.taylor_v0_v.isel(here)))
        for field, _, unit in fields:
            value, text = float(result[field].isel(here)), ""
            if f"{field}_stderr" in result:
                level = level_v / (largest_m2 if field.endswith("_per_m2") else 1.0) / unit
                text = with_error(value / unit, float(result[f"{field}_stderr"].isel(here)) / unit, scale=level)
            if text.endswith("?") and field.startswith("beer_lambert"):
                alpha_d2 = float(result.beer_lambert_alpha_per_m2.isel(here)) * largest_m2
                text = "straight" if 0 < alpha_d2 < STRAIGHT else "not known"
            cells.append(number(value, text or with_error(value / unit, 0.0, scale=level_v / unit)))
        rows.append(cells)
    notes = small(
        "± is the trace's standard error, whose noise all samples of a reading share; the misfit is no part of it."
    )
    notes += "".join(small(f"<sup>{mark}</sup> {escaped(note)}") for note, mark in marks.items())
    head = ["Photodiode", *(title for _, title, _ in fields)]
    return table(head, rows, kind="fits", groups=_groups(readings)) + notes


def _groups(readings: Sequence[Reading]) -> list[str]:
    return [f"LED {r.led}" for r in readings]


def _names(readings: Sequence[Reading]) -> list[str]:
    """The photodiode of every reading, beside the colour of its place along the nail."""
    order = list(dict.fromkeys(r.photodiode_index for r in readings))
    colours = dict(zip(order, style.place_colours(len(order)), strict=True))
    swatch = '<span class="swatch" style="background:{}"></span>'
    return [swatch.format(colours[r.photodiode_index]) + escaped(r.photodiode) for r in readings]


SIMULATION = Report(
    ("result.nc", "report.html"),
    lambda result: (result, lambda _: page(result)),
    simulation_summary,
    lambda result, summary: simulation_lines(summary),
)
