"""One self-contained HTML page of a simulated touch: findings, figures, tables, and what reproduces it."""

import logging
from pathlib import Path

import xarray as xr

from ..errors import InputError
from ..io import write_text
from ..scene import Scene, parse_scene
from . import findings, maps, simulate_figures, tables
from .html import document, escaped, figure, section, small
from .light_ends import light_ends
from .numbers import significant
from .readings import Reading, hold_end, photodiode_readings
from .spread_section import spread_section

TOUCH = "The force over time, and the pressures that it puts on the vessels."
VESSELS = (
    "Pressure on the pulp's veins dams the blood up into the capillaries under the nail; pressure on the distal "
    "capillaries squeezes it out of them."
)
log = logging.getLogger(__name__)


def write_report(result: xr.Dataset, path: Path) -> None:
    """Write the page of a simulated touch, whole or not at all.

    result : what `studies.simulate` returns; path density and section may be missing.
    path : the HTML file, replaced if it exists.

    Raises: WriteError where the file cannot be written.
    """
    write_text(Path(path), page(result))


def page(result: xr.Dataset) -> str:
    """The page as text."""
    scene = _scene(result)
    found = photodiode_readings(result, scene)
    touch = figure(simulate_figures.touch(result), "touch", TOUCH)
    vessels = figure(simulate_figures.vessels(result), "vessels", VESSELS)
    return document(
        kicker="touch to volts",
        title=findings.title(scene),
        lead=findings.sentence(scene, result),
        warnings=findings.warnings(found, result),
        cards=findings.findings(found, result),
        facts=findings.reached(result),
        body=[
            _readings_section(result, scene, found),
            section("The touch and the blood", touch, vessels, *_bed(result, scene)),
            _space_section(result, scene),
            _models_section(result, scene, found),
            spread_section(result),
        ],
        attributes=result.attrs,
    )


def _bed(result: xr.Dataset, scene: Scene | None) -> list[str]:
    """The blood along the nail, where it has more zones than a figure over time can show."""
    if scene is None or scene.finger is None or "white_band_mm" not in result or result.sizes["time"] < 2:
        return []
    text = "Zones of the nail bed over time. Above the dashed line lies the white band, which lost half of its blood."
    return [figure(simulate_figures.bed(result, scene), "bed", text)]


def _readings_section(result: xr.Dataset, scene: Scene | None, found: list[Reading]) -> str:
    return section(
        "What the photodiodes read",
        figure(
            simulate_figures.overview(result, scene),
            "overview",
            "Change of every photodiode from rest while the finger is pressed. Warm colours lie proximal, cool ones "
            "distal. The dotted line marks the end of the hold, at which the table below is read.",
        ),
        tables.readings_table(found, float(result.time[hold_end(result)])),
        small(
            "± is one standard error of the light tracing, and σ counts a change in them. Both states of a change are "
            "read from one trace, so its error is far below that of a level. Noise is that of the electronics and the "
            "converter in one sample; a sample resolves the force that equals its noise, by the mean slope from rest "
            "to the end of the hold."
        ),
    )


def _space_section(result: xr.Dataset, scene: Scene | None) -> str:
    board = ""
    if scene is not None:
        text = (
            "The board on the nail, from above and rolled flat. The tint of the nail shows which blood lies below; "
            "between the dotted lines one passes into the other."
        )
        board = figure(maps.top_view(scene), "top", text, narrow=True)
    cut = small("The section of the finger was not computed.")
    if "section_region" in result:
        text = "The section along the middle of the nail."
        if "path_density" in result:
            text += (
                " On it, the paths of all the light that the LED emits, summed over the finger's width, on a "
                "logarithmic scale: half of them lie within the solid line, 90 % within the dashed one. Above, the "
                "photodiodes in their colours and the LED (triangle) where they lie along the nail."
            )
        cut = figure(maps.section(scene, result), "section", text)
    return section("The sensor on the finger", board, cut, light_ends(result))


def _models_section(result: xr.Dataset, scene: Scene | None, found: list[Reading]) -> str:
    lines = [
        "<p>Each photodiode's traced volts with Beer–Lambert (8), V = V<sub>0</sub> + V<sub>1</sub> exp(−αD²), and "
        "Taylor (9), V = V′<sub>0</sub> − V′<sub>1</sub>D², fitted to them over the capillary diameter D of the "
        "photodiode's own zone. Below each, the residuals (model minus traced light), on one scale for all, with the "
        "noise of one sample in grey.</p>",
    ]
    text = (
        "Volts over time: proximal photodiodes on the left, distal ones on the right. Where no band is seen it is "
        "thinner than the line."
    )
    if result.sizes["photodiode"] > simulate_figures.PANELS:
        text += f" {simulate_figures.PANELS} of {result.sizes['photodiode']} are shown, evenly spaced."
    for i, led in enumerate(result.led.values):
        if result.sizes["led"] > 1:
            lines.append(f"<h3>LED {escaped(led)}, {significant(float(result.wavelength_nm[i]))} nm</h3>")
        lines.append(figure(simulate_figures.volts(result, scene, led=i), f"volts{i}", text))
    lines += ["<h3>Constants of Beer–Lambert (8) and Taylor (9)</h3>", tables.fit_table(result, found)]
    paths = tables.path_table(result, found)
    if paths:
        lines += [
            "<h3>Where the detected light has been</h3>",
            "<p>Mean path, at rest, of the light that reaches each photodiode: this takes the place of the one path "
            "length L of the reduced optics. A reading falls by this fraction per mm⁻¹ of absorption.</p>",
            paths,
        ]
    return section("Traced light beside the reduced optics", *lines)


def _scene(result: xr.Dataset) -> Scene | None:
    """The scene that a result carries; None, and the page goes without the board's drawing, if it cannot be read."""
    try:
        return parse_scene(str(result.attrs["scene"]))
    except (InputError, KeyError) as error:
        log.warning("the result's scene cannot be read (%s); the report leaves out the drawing of the board", error)
        return None
