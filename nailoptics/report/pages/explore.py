"""The page on which LEDs and photodiodes are dragged: tables, style, libraries and code in one file."""

import base64
import json
from typing import Any

import numpy as np

from ...io import FORMULA
from ...light.optics import line_response
from ...scene import Led, Photodiode, Scene
from ...scene.base import MOST_PHOTODIODES
from ...sensor import electronics
from ...sensor.ambient import LAMP, SOURCES, SUN, photocurrent_a_per_mm2
from ...statistics import MIN_EFFECTIVE_TERMS
from ...studies.exploration import explore
from ...studies.exploration.drawn_people import DRAWN, QUANTILES, RANKED_N, DrawnPerson
from ...studies.exploration.pair_table import NEAREST_MM
from .. import maps
from ..files import Report, run_summary
from ..html import Html, Script, details, document, file_text, preformatted, section, small, subheading, texts

# What of a part is its place in a layout, and not the part.
PLACED = ["name", "reference", "position_mm", "rotation_deg", "wired", "feedback_ohm"]
# Rules of Gauss quadrature up to so many points.
MOST_POINTS = 6
# More pairs of an LED and a photodiode than this, or a longer scene, would hold up a browser.
MOST_PAIRS, MOST_SCENE_BYTES = 4000, 1_000_000
# At which the parts of the noise that grow with the resistance are much larger than the one that does not.
LARGE_OHM = 1e9
TEXTS = texts("explore")


def page(exploration: explore.Exploration) -> str:
    """The page as text."""
    text = json.dumps(_tables(exploration), separators=(",", ":"), allow_nan=False, default=np.ndarray.tolist)
    tables = text.replace("<", "\\u003c")
    style = f"<style>{file_text('pages/explore/vendor/uPlot.min.css')}{file_text('pages/explore/explore.css')}</style>"
    data = f'<script type="application/json" id="tables">{tables}</script>'
    code = "\n".join(file_text(f"pages/explore/{name}.js") for name in ("explore", "rules", "workbench"))
    scripts, licences = [], list[Html]()
    for one in TEXTS["libraries"]:
        scripts.append(Script(one.get("opening", "") + file_text(one["file"]) + one.get("closing", "")))
        licences += [subheading(one["name"]), small(one["address"]), preformatted(file_text(one["licence"]))]
    made_with = section("Made with", TEXTS["made_with"], details("Licences of the libraries in this page", *licences))
    body = [Html(style + file_text("pages/explore/workbench.html")), made_with, Html(data), *scripts, Script(code)]
    return document(**TEXTS["page"], body=body, attributes=exploration.attributes)


def _tables(exploration: explore.Exploration) -> dict[str, Any]:
    scene, basis, polynomial = exploration.scene, exploration.basis, exploration.polynomial
    leds, fields = _led_kinds(exploration), [_fields(photodiode) for photodiode in scene.photodiodes]
    # Without those that differ in their places alone.
    diodes = [photodiode for i, photodiode in enumerate(scene.photodiodes) if fields[i] not in fields[:i]]
    (nodes_u, nodes_v), fluence = exploration.ambient_nodes, exploration.wavelengths[0].fluence
    ambient: dict[str, Any] = {"nodesU": nodes_u, "nodesV": nodes_v, "aPerMm2": exploration.ambient_a_per_mm2}
    photon_mm2 = scene.layout.outline.area_mm2 / exploration.wavelengths[0].photons
    ambient |= {"photonA": [photocurrent_a_per_mm2(one, diodes[0]).sum() * photon_mm2 for one in SOURCES]}
    ambient |= {"names": [source.words for source in SOURCES], "usual": SOURCES.index(LAMP), "sun": SOURCES.index(SUN)}
    radial = {"radial": exploration.radial.log_coefficients, "nearestMm": NEAREST_MM}
    pairs = len(scene.leds) * sum(photodiode.elements for photodiode in scene.photodiodes)
    return {
        "scene": scene.model_dump(mode="json", exclude_none=True, exclude={"placement"}),
        "basis": {"across": basis.across, "walled": basis.wall_mm is not None, "axes": basis.axes} | radial,
        # Nodes and weights by the number of points, from 0.
        "gauss": [[], *(np.stack(np.polynomial.legendre.leggauss(n), -1) for n in range(1, MOST_POINTS + 1))],
        "polynomial": {"exponents": polynomial.exponents, "so2": polynomial.so2}
        | {"bloodFraction": polynomial.blood_fraction},
        "blocks": explore.BLOCKS,
        "kernelError": explore.KERNEL_ERROR,
        "kernelChangeError": explore.KERNEL_CHANGE_ERROR,
        "fewRelative": MIN_EFFECTIVE_TERMS**-0.5,
        "sameNm": explore.SAME_NM,
        "bloodRange": explore.BLOOD_RANGE,
        "colours": list(map(_wavelength, exploration.wavelengths)),
        "ledKinds": leds,
        "photodiodeKinds": [_readout(diode, leds, scene) for diode in diodes],
        "stage": _stage(scene),
        "touch": exploration.touch,
        "people": list(map(_person, exploration.people, QUANTILES)),
        "peopleDrawn": {"count": DRAWN, "forceN": RANKED_N},
        "board": _board(scene) | {"ownMm": exploration.attributes.get("size_mm", scene.layout.outline.size_mm)},
        "placed": PLACED,
        # What a scene that is dropped on the page must keep, and a layout's parts.
        "rules": {
            "scene": Scene.model_json_schema(),
            "mostElements": MOST_PHOTODIODES,
            "mostPairs": max(MOST_PAIRS, pairs),
            "mostBytes": MOST_SCENE_BYTES,
        },
        "formula": FORMULA,
        "ambient": ambient,
        "fluence": {"radiusMm": fluence.radius_mm.values, "depthMm": fluence.depth_mm.values},
    }


def _person(person: DrawnPerson, quantile: float) -> dict[str, Any]:
    blood, polynomial = person.scene.blood, explore.blood_polynomial(person.scene, chosen=False)
    over = {"bloodFraction": polynomial.blood_fraction, "so2": polynomial.so2, "exponents": polynomial.exponents}
    known = {"quantile": quantile, "resolutionN": person.resolution_n, "rest": blood.rest_blood_fraction}
    return known | {"so2": blood.so2, "touch": explore.touch_table(person.scene), "polynomial": over}


def _wavelength(table: explore.WavelengthTable) -> dict[str, Any]:
    fluence = table.fluence.values
    kernels = {"coefficients": table.coefficients, "direct": table.direct, "blocks": table.blocks.transpose(1, 0, 2)}
    kernels |= {"logFluence": np.log(np.maximum(fluence, fluence[fluence > 0].min())), "people": table.people}
    halves = {name: np.ascontiguousarray(values, "<f2").tobytes() for name, values in kernels.items()}
    encoded = {name: base64.b64encode(half).decode() for name, half in halves.items()}
    return {"nm": table.led.wavelength_nm, "photons": table.photons} | encoded


def _fields(part: Led | Photodiode) -> dict[str, Any]:
    """What of a part is not its place in a layout."""
    return part.model_dump(mode="json", exclude_none=True, exclude={*PLACED})


def _led_kinds(exploration: explore.Exploration) -> list[dict[str, Any]]:
    """Every LED that can be chosen: the scene's own, by all but their places, then the further wavelengths."""
    number = {(one.led.wavelength_nm, one.led.fwhm_nm): i for i, one in enumerate(exploration.wavelengths)}
    kinds: list[dict[str, Any]] = []
    for led in (*exploration.scene.leds, *(one.led for one in exploration.wavelengths)):
        wavelength, fields = number[led.wavelength_nm, led.fwhm_nm], _fields(led)
        if all(kind["fields"] != fields for kind in kinds):
            title = f"{led.wavelength_nm:g} nm" + (f", {led.part}" if led.part else "")
            kinds.append({"title": title, "colour": wavelength, "fields": fields})
    return kinds


def _stage(scene: Scene) -> dict[str, Any]:
    """Gain and converter; photodiodes that move need other resistors than those that fit them where they lay."""
    stage, fixed = scene.electronics, all(p.feedback_ohm is None for p in scene.photodiodes)
    return {
        "feedbackOhm": stage.feedback_ohm if fixed and stage.feedback_ohm != "auto" else None,
        "headroom": stage.headroom,
        "mostOhm": electronics.MOST_OHM,
        "e24": electronics.E24,
        "rangeV": stage.adc_range_v,
        "limitV": electronics.limit_v(stage),
        "rejects": stage.ambient_rejection is not None,
    }


def _readout(photodiode: Photodiode, leds: list[dict[str, Any]], scene: Scene) -> dict[str, Any]:
    """Volts and noise by a photodiode's light: the variance is linear in current, quadratic in feedback resistance."""
    stage, dark_a = scene.electronics, photodiode.dark_current_a(scene.electronics.temperature_k)
    lines = [Led(name="led", position_mm=(0.0, 0.0), **kind["fields"]) for kind in leds]
    # By 1 A from outside, of which rejection subtracts as much again with noise of its own.
    fixed, noise = (
        electronics.read(0.0, scene.leds[0], photodiode, stage, ambient_a=1.0, feedback_ohm=ohm).noise
        for ohm in (0.0, LARGE_OHM)
    )
    return {
        "title": photodiode.part or photodiode.name,
        "fields": _fields(photodiode),
        "responsivity": [float(line_response(led, photodiode).sum()) for led in lines],
        "darkA": dark_a,
        "noise": {
            "converterV2": float(fixed.adc_v2),
            "amplifierV2": float(fixed.amplifier_v2),
            "amplifierPerOhm2": float(noise.amplifier_v2 - fixed.amplifier_v2) / LARGE_OHM**2,
            "feedbackPerOhm": float(noise.feedback_v2) / LARGE_OHM,
            "shuntPerOhm2": float(noise.shunt_v2) / LARGE_OHM**2,
            "darkPerOhm2": float(noise.shot_v2) / LARGE_OHM**2,
            "shotPerOhm2A": float(noise.ambient_v2) / (2 if stage.ambient_rejection else 1) / LARGE_OHM**2,
        },
    }


def _board(scene: Scene) -> dict[str, Any]:
    r, walls, border = scene.layout.outline, scene.layout.barriers, scene.layout.border_mm
    sides = [{"side": w.name, "uMin": w.u_min, "uMax": w.u_max, "vMin": w.v_min, "vMax": w.v_max} for w in walls]
    board: dict[str, Any] = {"outline": [r.u_min, r.u_max, r.v_min, r.v_max], "wall": sides[0] if sides else None}
    return board | {"border": border, "zoneEdgeMm": scene.zone_edges_mm[0], "epoxyMm": scene.board.height_mm}


EXPLORATION = Report(
    ("explore.html",),
    page,
    lambda exploration: run_summary(exploration.attributes),
    lambda exploration, summary: [
        f"{summary['photons']} photons at {len(exploration.wavelengths)} wavelengths, "
        f"at least {explore.BLOCKS * explore.LEAST_BATCH} at each"
    ],
    {"board": lambda exploration: maps.top_view(exploration.scene)},
)
