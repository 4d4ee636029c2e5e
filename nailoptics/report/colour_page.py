"""The page of a nail's colour under force."""

import base64
from pathlib import Path

import numpy as np
import xarray as xr

from ..io import write_text
from ..scene import parse_scene
from ..studies.colour.measured_colours import MEASURED
from . import colour_figures
from .html import document, escaped, figure, section, small, table
from .numbers import significant, with_error

A_PICTURE = (
    "A picture, not a measurement: the traced colours as a diffuse albedo on the finger's mesh, with gloss, window, "
    "desk and camera as of a finger on a desk; no hair, no texture, no cuticle."
)


def write_colour_page(result: xr.Dataset, photographs: list[bytes], press: bytes | None, path: Path) -> None:
    """Write the page of a colour's result, whole or not at all; raises WriteError.

    photographs : the finger at rest and pressed, as PNG; press : the animation, as GIF.
    """
    finger = parse_scene(result.attrs["scene"], name="the stored scene").finger
    assert finger is not None
    most = float(result.force_n.max())
    middle = result.sizes["place"] // 2
    lab = result.lab.values[middle, 0]
    band = result.white_band_mm.values[-1], result.white_band_mm_stderr.values[-1]
    cards = [
        (" / ".join(significant(value, 3) for value in lab), "L*, a*, b* in the middle of the nail at rest"),
        (significant(float(result.colour_stderr.max()), 2), "largest standard error of a place's colour, CIEDE2000"),
        (f"{with_error(*band)} mm", f"white band at {result.force_n.values[-1]:g} N"),
    ]
    if "refill_s" in result and np.isfinite(result.refill_s.values).any():
        refill = float(np.nanmax(result.refill_s.values))
        cards.append((f"{significant(refill, 2)} s", f"after {most:g} N until no eye sees a difference to rest"))
    rows = []
    for p, v_mm in enumerate(result.v_mm.values):
        place = "skin" if p in (0, result.sizes["place"] - 1) else "nail"
        cells = [with_error(float(result.lab[p, 0, k]), float(result.lab_stderr[p, 0, k])) for k in range(3)]
        change = with_error(float(result.delta_e_2000[p, -1]), float(result.delta_e_2000_stderr[p, -1]))
        rows.append([f"{v_mm:+.1f} mm, {place}", *cells, change])
    width = finger.nail_width_mm
    shown = figure(colour_figures.strip(result, width_mm=width), "strip", "The nail under each force, each held.")
    photos = "".join(
        _image(data, "png", words) for data, words in zip(photographs, ("At rest.", f"{most:g} N."), strict=False)
    )
    moving = _image(press, "gif", f"A press of {most:g} N and its release.") if press else ""
    body = [
        section("The nail under force", shown),
        section("As a photograph", f"<div class='scroll'>{photos}</div>", small(escaped(A_PICTURE))) if photos else "",
        section("Along the nail", figure(colour_figures.along(result), "along", "Colour along the nail; bands: 95 %.")),
        section("Over force", figure(colour_figures.over_force(result), "force", "What an eye sees; bars: 95 %.")),
        section(
            "A press",
            figure(colour_figures.press(result), "press", "Redness over a press; the touch acts at once."),
            moving,
        )
        if "press_lab" in result
        else "",
        _beat(result),
        _unknowns(result),
        section(
            "Colours at rest",
            table(["Place", "L*", "a*", "b*", f"Difference at {result.force_n.values[-1]:g} N, CIEDE2000"], rows),
        ),
    ]
    text = document(
        kicker="colour",
        title="The colour of the nail under force",
        lead=f"Seen by {colour_figures.seen_by(result)}; the nail is bare, without its board.",
        cards=cards,
        body=body,
        attributes=result.attrs,
    )
    write_text(path, text)


def _beat(result: xr.Dataset) -> str:
    """How far a heart that beats moves the colour."""
    if "beat_delta_e_2000" not in result:
        return ""
    most = result.isel(place=int(np.argmax(result.beat_delta_e_2000.values)))
    moved = with_error(float(most.beat_delta_e_2000), float(most.beat_delta_e_2000_stderr))
    text = (
        f"A beat of the scene's heart moves the colour by {moved} CIEDE2000 at most, {float(most.v_mm):+.1f} mm along."
    )
    return section("A beat", f"<p>{escaped(text)}</p>")


def _unknowns(result: xr.Dataset) -> str:
    """What is unknown of the finger, and what was measured on people."""
    if "lab_spread" not in result:
        return ""
    rows = []
    order = np.argsort(-result.prior_lab_spread.sel(site="nail").values.max(1))
    for i in order:
        one = result.isel(prior=int(i))
        low, high = one.prior_range.values
        values, errors = (one[f"prior_lab_spread{end}"].sel(site="nail").values for end in ("", "_stderr"))
        shown = [with_error(float(v), float(e)) for v, e in zip(values, errors, strict=True)]
        rows.append([escaped(str(one.prior.item())), f"{low:g} to {high:g}", *shown])
    sources = "; ".join(f"{one.name}: {one.source}" for one in MEASURED)
    text = f"Squares are skin of people: {sources}. Of nails no table of L*a*b* was found."
    drawn = figure(colour_figures.ranges(result), "ranges", "At rest; bars: 95 % of fingers, of people.")
    names = ["Prior", "Range", "L*", "a*", "b*"]
    return section("What is unknown of the finger", drawn, table(names, rows), small(escaped(text)))


def _image(data: bytes, kind: str, caption: str) -> str:
    """A picture inside the page."""
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    alt = escaped(caption)
    return f'<figure><img alt="{alt}" style="max-width:100%" src="{source}"><figcaption>{alt}</figcaption></figure>'
