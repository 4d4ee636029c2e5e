"""The page of a simulated touch: key figures, figures, tables, and what reproduces it."""

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...errors import InputError
from ...scene import Scene, parse_scene
from ...scene.touch import SHARES
from ...tissue import bed_zone_name
from .. import maps
from ..files import Report
from ..html import Html, document, escaped, figure, section, small, subheading, table, texts
from ..numbers import estimated, quantity, significant, with_error
from ..readings import (
    disturbance_lines,
    hold_end,
    photodiode_readings,
    reading_rows,
    simulation_lines,
    simulation_summary,
)
from ..scene_description import blood_words, body_words, touch_words
from ..uncertainty_section import spread_section
from . import simulate_figures as figures

if TYPE_CHECKING:
    import pandas as pd

TEXTS = texts("simulate")
NAMES = {
    "barrier": "barrier, opaque epoxy",
    "cover": "cover and rim, opaque epoxy",
    "photodiodes": "photodiodes that are read",
    "silicon": "photodiodes not wired",
    "leds": "LEDs, their own die too",
}
# Less of the light than this is not worth a row, at any LED.
LEAST = 1e-4
# Less alpha D^2 than this over the whole touch, Beer-Lambert (8) is as straight in D^2 as Taylor (9), and its
# constants are not identifiable.
STRAIGHT = 0.01
# A mean path below this is as good as none.
LEAST_PATH_MM = 1e-3
log = logging.getLogger(__name__)


def page(result: xr.Dataset) -> str:
    """The page of what `studies.simulate` returns; path density and section may be missing."""
    scene = _scene(result)
    readings = photodiode_readings(result, scene)
    return document(
        kicker="touch to volts",
        title=_title(scene),
        lead=_sentence(scene, result),
        warnings=_warnings(readings),
        cards=_cards(readings, result, scene),
        body=[
            section(
                "Readings of the photodiodes",
                figure(figures.overview(result, scene), TEXTS["overview"]),
                _pair_table(reading_rows(readings), readings, scene, kind="readings dense"),
                small(TEXTS["readings"]),
                *map(small, disturbance_lines(result)),
            ),
            section("The touch and the blood", figure(figures.courses(result), TEXTS["courses"]), _bed(result, scene)),
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
    return figure(figures.bed(result, scene), TEXTS["bed"])


def _space_section(result: xr.Dataset, scene: Scene | None) -> Html:
    board = "" if scene is None else figure(maps.top_view(scene), TEXTS["board"], narrow=True)
    cut, ends = small("The section of the finger was not computed."), ""
    if "section_region" in result:
        shown = ("section", "paths") if "path_density" in result else ("section",)
        cut = figure(maps.section(scene, result), " ".join(TEXTS[name] for name in shown))
    if "absorbed_fraction" in result:
        ends = table(_light_ends(result), kind="ends") + small(TEXTS["ends"])
    return section("The sensor on the finger", board, cut, Html(ends))


def _light_ends(result: xr.Dataset) -> list[dict[str, str]]:
    """Where the light of each LED ends, the ends that take most first."""
    leaves = {"leaves to the air": "reflected", "leaves up the finger": "transmitted"}
    ends: dict[str, tuple[str, dict[str, Any]]] = {
        text: ("energy_fraction", {"part": part}) for text, part in leaves.items()
    }
    ends |= {NAMES.get(r, r): ("absorbed_fraction", {"region": r}) for r in result.region.values.tolist()}
    most = {text: float(result[name].sel(at).max()) for text, (name, at) in ends.items()}
    rows = []
    for text in sorted(filter(lambda text: most[text] >= LEAST, ends), key=lambda text: -most[text]):
        (name, at), row = ends[text], {"The light ends in": text}
        end = result[[name, f"{name}_stderr"]].sel(at)
        for i in range(result.sizes["led"]):
            row[f"{maps.led_name(result, i)} [%]"] = estimated(end.isel(led=i), name, 100)
        rows.append(row)
    return rows


def _models_section(result: xr.Dataset, scene: Scene | None, readings: "pd.DataFrame") -> Html:
    lines: list[Html | str] = []
    text = TEXTS["models"]
    if result.sizes["photodiode"] > figures.PANELS:
        text += f" {figures.PANELS} of {result.sizes['photodiode']} are shown, evenly spaced."
    for i in range(result.sizes["led"]):
        if result.sizes["led"] > 1:
            lines.append(subheading(maps.led_name(result, i)))
        lines.append(figure(figures.volts(result, scene, led=i), text))
    rows, notes = _fits(result, readings)
    lines += [
        subheading("Constants of Beer–Lambert (8) and Taylor (9)"),
        _pair_table(rows, readings, scene, kind="fits"),
        *map(small, (TEXTS["fits"], *notes)),
    ]
    if paths := _paths(result, readings):
        lines += [subheading("Mean path of the detected light"), TEXTS["mean_path"]]
        lines.append(_pair_table(paths, readings, scene, kind="paths"))
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
    touch, digit = touch_words(scene), scene.finger.digit
    return f"{touch[0].upper()}{touch[1:]}; {digit}{'' if digit == 'thumb' else ' finger'}"


def _sentence(scene: Scene | None, result: xr.Dataset) -> str:
    """What was simulated, in one sentence."""
    leds, photodiodes = result.sizes["led"], result.sizes["photodiode"]
    waves = _list([f"{float(w):g}" for w in result.wavelength_nm]) + " nm"
    text = f"{leds} LED{'s' * (leds != 1)} ({waves}) and {photodiodes} photodiode{'s' * (photodiodes != 1)} on the nail"
    text += f"; force up to {float(result.force_n.max()):.3g} N"
    if duration := float(result.time[-1] - result.time[0]):
        text += f" within {duration:.3g} s"
    if scene is not None and scene.finger is not None:
        text += f"; blood {100 * scene.blood.rest_blood_fraction:g}\u00a0% of the bed at rest, {blood_words(scene)}"
        if body := body_words(scene):
            text += f"; {body}"
    accuracy = result.attrs.get("accuracy_reached")
    return f"{text}. Light traced to: {accuracy}." if accuracy else f"{text}."


def _cards(readings: "pd.DataFrame", result: xr.Dataset, scene: Scene | None) -> list[tuple[str, str]]:
    """Key figures as (number, words)."""
    lines: list[tuple[str, str]] = []
    usable = readings[~readings.saturated]
    name = usable.photodiode + (" under " + usable.led if result.sizes["led"] > 1 else "")
    change_v = usable.volts_change
    for word, moved in (("fall", change_v[change_v < 0]), ("rise", change_v[change_v > 0])):
        if len(moved):
            r = usable.loc[moved.abs().idxmax()]
            ratio = f"signal-to-noise ratio {significant(r.signal_to_noise)}"
            words = f"largest {word}: {name[r.name]}, {significant(r.change_percent, sign=True)} %, {ratio}"
            lines.append((quantity(r.volts_change, "V", sign=True), words))
    resolved = usable.resolution_n[(usable.resolution_n > 0) & np.isfinite(usable.resolution_n)]
    if len(resolved):
        words = f"best force resolution of one sample (noise / slope): {name[resolved.idxmin()]}"
        lines.append((quantity(resolved.min(), "N"), words))
    if change_v.any() and (scene is None or scene.touch is None or scene.touch.proximal_share == SHARES["even"]):
        lines += _signs(usable, result)
    if "white_band_mm" in result:
        words = "width of the white band at the tip at the end of the hold, with less than half its blood"
        lines.append((f"{float(result.white_band_mm[hold_end(result)]):.1f}\u00a0mm", words))
    # How far the models are from the traced light at worst, beside the noise.
    largest = usable[["beer_lambert_residual_rms_v", "taylor_residual_rms_v", "volts_noise_rms"]].max()
    exact, taylor, noise = (quantity(value, "V", digits=2) for value in largest)
    words = f"largest rms residual of Beer–Lambert (8); Taylor (9): {taylor}; noise of one sample: {noise}"
    return [*lines, (exact, words)]


def _warnings(readings: "pd.DataFrame") -> list[str]:
    """What the reader must know before trusting the numbers."""
    lines = []
    full, usable = readings[readings.saturated], readings[~readings.saturated]
    if len(full):
        lines.append(
            f"The converter is at its limit: {_list([*(full.photodiode + ' under ' + full.led)])}. These volts do not "
            "measure the light; lower electronics.feedback_ohm or the LED's flux_mw, or raise electronics.adc_range_v."
        )
    if len(usable) and not usable.volts_change.any():
        lines.append("No reading changes: the force does not change within the simulated time, or no blood moves.")
    return lines


def _signs(readings: "pd.DataFrame", result: xr.Dataset) -> list[tuple[str, str]]:
    """Whether readings change under an even touch as in the paper, down over the proximal half of the zones and up over
    the distal; nothing of a board that has photodiodes over one half alone, or where no reading does."""
    distal = readings.zone.isin(result.zone.values[result.sizes["zone"] // 2 + result.sizes["zone"] % 2 :])
    right = np.sign(readings.volts_change) == np.where(distal, 1, -1)
    if not right.any() or distal.nunique() == 1:
        return []
    words = "readings of this finger change as in the paper: proximal ones fall, distal ones rise"
    least = readings.z_score[right].min()
    if np.isfinite(least):
        words += f", by {significant(least, 2)} σ of the trace or more"
    wrong = [*readings.photodiode[~right]]
    if 0 < len(wrong) < 4:
        words += f"; not {_list(wrong)}"
    return [(f"{right.sum()} of {len(readings)}", words)]


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _paths(result: xr.Dataset, readings: "pd.DataFrame") -> list[dict[str, str]]:
    """Mean path of the detected light at rest in every absorber; empty where the engine records no paths."""
    paths = result[["mean_path_mm", "mean_path_mm_stderr"]]
    passed = (paths.mean_path_mm + 2 * paths.mean_path_mm_stderr.fillna(0) >= LEAST_PATH_MM).any(("led", "photodiode"))
    zones = {bed_zone_name(k): f"bed, {zone}" for k, zone in enumerate(result.zone.values)}
    heads = {str(name): f"{zones.get(str(name), name)} [mm]" for name in paths.absorber.values[passed.values]}
    rows = []
    for r in readings.itertuples() if heads else ():
        at = paths.sel(led=r.led, photodiode=r.photodiode)
        shown = {head: estimated(at.sel(absorber=name), "mean_path_mm") for name, head in heads.items()}
        rows.append({"Photodiode": r.photodiode} | shown)
    return rows


def _fits(result: xr.Dataset, readings: "pd.DataFrame") -> tuple[list[dict[str, str]], list[str]]:
    """Fitted constants of Beer-Lambert (8) and Taylor (9) with their residuals; and what is not determined, in words.

    Where the readings do not bend, V0, V1 and alpha of Beer-Lambert (8) are not identifiable; the fit is shown as
    straight.
    """
    largest_m2 = float(result.capillary_diameter_m.max()) ** 2
    fields = {
        "Beer–Lambert (8) V₀ [mV]": ("beer_lambert_v0_v", 1e-3),
        "V₁ [mV]": ("beer_lambert_v1_v", 1e-3),
        "α [10⁻³ µm⁻²]": ("beer_lambert_alpha_per_m2", 1e9),
        "Beer–Lambert (8) residual, rms [µV]": ("beer_lambert_residual_rms_v", 1e-6),
        "Taylor (9) V′₀ [mV]": ("taylor_v0_v", 1e-3),
        "V′₁ [µV µm⁻²]": ("taylor_v1_v_per_m2", 1e6),
        "Taylor (9) residual, rms [µV]": ("taylor_residual_rms_v", 1e-6),
    }
    rows, noted = [], dict[str, list[str]]()
    for r in readings.itertuples():
        fit = result.sel(led=r.led, photodiode=r.photodiode)
        if r.saturated:
            rows.append({"Photodiode": f"{r.photodiode} saturated"} | dict.fromkeys(fields, "–"))
            continue
        noted.setdefault(str(fit.fit_note.item()), []).append(r.photodiode)
        row, level_v = {"Photodiode": r.photodiode}, abs(float(fit.taylor_v0_v))
        straight = 0 < float(fit.beer_lambert_alpha_per_m2) * largest_m2 < STRAIGHT
        for head, (field, unit) in fields.items():
            level = level_v / (largest_m2 if field.endswith("_per_m2") else 1.0) / unit
            error = float(fit[f"{field}_stderr"]) / unit if f"{field}_stderr" in fit else 0.0
            row[head] = with_error(float(fit[field]) / unit, error, scale=level)
            if row[head].endswith("?") and field.startswith("beer_lambert"):
                row[head] = "straight" if straight else "not known"
        rows.append(row)
    return rows, [f"{', '.join(dict.fromkeys(names))}: {note}" for note, names in noted.items() if note]


def _pair_table(rows: Sequence[dict[str, str]], readings: "pd.DataFrame", scene: Scene | None, *, kind: str) -> Html:
    """A table of all readings, LED by LED, with the colour of each photodiode's place along the nail."""
    order = list(dict.fromkeys(readings.photodiode))
    along = maps.coloured_along_nail(scene, len(order))
    colours = {name: colour for name, (colour, _) in zip(order, along, strict=True)}
    shown = []
    for row, name in zip(rows, readings.photodiode, strict=True):
        swatch = f'<span class="swatch" style="background:{colours[name]}"></span>'
        shown.append(row | {"Photodiode": Html(swatch + escaped(row["Photodiode"]))})
    return table(shown, kind=kind, groups=[f"LED {led}" for led in readings.led])


SIMULATION = Report(
    ("result.nc", "report.html"),
    page,
    simulation_summary,
    simulation_lines,
    {
        "readings": lambda result: figures.overview(result, _scene(result)),
        "touch": figures.courses,
        "volts": lambda result, led=0: figures.volts(result, _scene(result), led=led),
        "section": lambda result: maps.section(_scene(result), result),
    },
)
