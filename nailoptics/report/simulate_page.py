"""One self-contained HTML page of a simulated touch: findings, figures, tables, and what reproduces it."""

import html
import logging
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr

from ..errors import InputError
from ..io import write_text
from ..scene import Scene, parse_scene
from . import findings, maps, simulate_figures, style, tables
from .numbers import significant
from .readings import Moments, change_v, readings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger(__name__)


def write_report(result: xr.Dataset, path: Path) -> None:
    """Write the page of a simulated touch, whole or not at all.

    result : what `studies.simulate` returns; path density, section and fit notes may be missing.
    path : the HTML file, replaced if it exists.

    Raises: WriteError where the file cannot be written.
    """
    write_text(Path(path), page(result))


def page(result: xr.Dataset) -> str:
    """The page as text."""
    scene = _scene(result)
    found = readings(result, scene)
    heading = findings.title(scene)
    css = resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")
    body = [
        f"<header><p class='kicker'>nailoptics · touch to volts</p><h1>{_(heading)}</h1>",
        f"<p class='lead'>{_(findings.sentence(scene, result))}</p>",
        *(f"<p class='warning'>{_(line)}</p>" for line in findings.warnings(found, result)),
        "<ul class='findings'>",
        *(f"<li><b>{_(figure)}</b><span>{_(words)}</span></li>" for figure, words in findings.findings(found, result)),
        "</ul>",
        "<dl class='reached'>",
        *(f"<div><dt>{_(name)}</dt><dd>{_(value)}</dd></div>" for name, value in findings.reached(result)),
        "</dl></header>",
        *_readings_section(result, scene, found),
        *_touch_section(result),
        *_space_section(result, scene),
        *_models_section(result, scene, found),
        *_provenance(result),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{_(heading)} – nailoptics</title><style>{css}</style></head>\n<body><main>\n"
        + "\n".join(body)
        + "\n</main></body></html>\n"
    )


def _readings_section(result: xr.Dataset, scene: Scene | None, found: list) -> list[str]:
    _, _, bound = change_v(result)
    hold_s = float(result.time[Moments.of(result).hold])
    many = "The dotted line marks the end of the hold, at which the table below is read."
    error = (
        "Errors of a change are upper bounds: those of its two readings, which share the trace's noise, added."
        if bound
        else "Both states of a change are read from one trace, so its error is far below that of a level."
    )
    return [
        "<section><h2>What the photodiodes read</h2>",
        _figure(
            simulate_figures.overview(result, scene),
            "overview",
            "Change of every photodiode from rest while the finger is pressed. Warm colours lie proximal, cool ones "
            f"distal. {many}",
        ),
        tables.readings_table(found, hold_s, bound=bound),
        f"<p class='small'>± is one standard error of the light tracing, and σ counts a change in them. {error} Noise "
        "is that of the electronics and the converter in one sample; a sample resolves the force that equals its "
        "noise, by the mean slope from rest to the end of the hold.</p></section>",
    ]


def _touch_section(result: xr.Dataset) -> list[str]:
    return [
        "<section><h2>The touch and the blood</h2>",
        _figure(
            simulate_figures.touch(result),
            "touch",
            "The force over time, and the pressures that it puts on the vessels.",
        ),
        _figure(
            simulate_figures.vessels(result),
            "vessels",
            "Pressure on the pulp's veins dams the blood up into the capillaries under the nail; pressure on the "
            "distal capillaries squeezes it out of them.",
        ),
        "</section>",
    ]


def _space_section(result: xr.Dataset, scene: Scene | None) -> list[str]:
    lines = ["<section><h2>The sensor on the finger</h2>"]
    if scene is not None and scene.finger is not None:
        text = (
            "The board on the nail, from above and rolled flat. The tint of the nail shows which blood lies below; "
            "between the dotted lines one passes into the other."
        )
        lines.append(_figure(maps.top_view(scene, result), "top", text, narrow=True))
    if "section_region" in result or "path_density" in result:
        text = "The section along the middle of the nail."
        if "path_density" in result:
            text += (
                " On it, the paths of all the light that the LED emits, summed over the finger's width, on a "
                "logarithmic scale: half of them lie within the solid line, 90 % within the dashed one. Above, the "
                "photodiodes in their colours and the LED (triangle) where they lie along the nail."
            )
        lines.append(_figure(maps.section(scene, result), "section", text))
    else:
        lines.append("<p class='small'>The section of the finger was not computed.</p>")
    return [*lines, "</section>"]


def _models_section(result: xr.Dataset, scene: Scene | None, found: list) -> list[str]:
    lines = [
        "<section><h2>Traced light beside the reduced optics</h2>",
        "<p>Each photodiode's traced volts with equations (8), V = V<sub>0</sub> + V<sub>1</sub> exp(−αD²), and (9), "
        "V = V′<sub>0</sub> − V′<sub>1</sub>D², fitted to them over the capillary diameter D of the photodiode's own "
        "zone. Below each, what they miss (model minus traced light), on one scale for all, with the noise of one "
        "sample in grey.</p>",
    ]
    for i, led in enumerate(result.led.values):
        heading = f"<h3>LED {_(str(led))}, {significant(float(result.wavelength_nm[i]))} nm</h3>"
        lines.append(heading if result.sizes["led"] > 1 else "")
        text = (
            "Volts over time: proximal photodiodes on the left, distal ones on the right. Where no band is seen it is "
            "thinner than the line."
        )
        if result.sizes["photodiode"] > simulate_figures.PANELS:
            text += f" {simulate_figures.PANELS} of {result.sizes['photodiode']} are shown, evenly spaced."
        lines.append(_figure(simulate_figures.volts(result, scene, led=i), f"volts{i}", text))
    lines += ["<h3>Constants of (8) and (9)</h3>", tables.fit_table(result, found)]
    paths = tables.path_table(result, found)
    if paths:
        lines += [
            "<h3>Where the detected light has been</h3>",
            "<p>Mean path, at rest, of the light that reaches each photodiode: this takes the place of the one path "
            "length L of the reduced optics. A reading falls by this fraction per mm⁻¹ of absorption.</p>",
            paths,
        ]
    return [*lines, "</section>"]


def _provenance(result: xr.Dataset) -> list[str]:
    rows = [("Digest of the scene", "digest"), ("Seeds", "seeds"), ("Versions", "versions"), ("Engine", "engine")]
    rows += [("Backend", "backend"), ("Photons", "photons"), ("After", "references")]
    shown = [(label, str(result.attrs[key])) for label, key in rows if key in result.attrs]
    return [
        "<section class='provenance'><h2>To make this again</h2><dl>",
        *(f"<div><dt>{_(label)}</dt><dd>{_(value)}</dd></div>" for label, value in shown),
        "</dl>",
        f"<details><summary>The scene, complete</summary><pre>{_(str(result.attrs.get('scene', '')))}</pre></details>",
        "</section>",
    ]


def _figure(figure: "Figure", name: str, caption: str, *, narrow: bool = False) -> str:
    drawing = style.to_svg(figure, name=name, description=caption)
    kind = ' class="narrow"' if narrow else ""
    return f'<figure{kind}><div class="scroll">{drawing}</div><figcaption>{_(caption)}</figcaption></figure>'


def _scene(result: xr.Dataset) -> Scene | None:
    """The scene that a result carries; None, and the page goes without the board's drawing, if it cannot be read."""
    try:
        return parse_scene(str(result.attrs["scene"]))
    except (InputError, KeyError) as error:
        log.warning("the result's scene cannot be read (%s); the report leaves out the drawing of the board", error)
        return None


def _(text: str) -> str:
    return html.escape(text)
