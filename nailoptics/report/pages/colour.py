"""The page of a nail's colour under force, and its figures."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
import xarray as xr

from ...scene import parse_scene
from ...statistics import Z95
from .. import style
from ..files import Report, run_summary
from ..html import document, figure, image, section, small, table, texts
from ..numbers import ASCII, aligned, estimated, plain, range_of, significant

TEXTS = texts("colour")


def page(result: xr.Dataset, photographs: Sequence[bytes] = ()) -> str:
    """The page of a nail's colours.

    photographs : the finger at rest and pressed, as PNG.
    """
    last = result.isel(state=-1)
    words = f"at {float(last.force_n):g} N"
    cards = [
        (significant(float(result.colour_stderr.max()), 2), "largest standard error of a place's colour, CIEDE2000"),
        (significant(float(last.delta_e_2000.max())), f"largest difference to rest {words}, CIEDE2000"),
        (f"{estimated(last, 'white_band_mm')} mm", f"white band {words}"),
    ]
    photos = [image(data, text) for data, text in zip(photographs, ("At rest.", f"A{words[1:]}."), strict=False)]
    strip = figure(strip_figure(result), TEXTS["strip"])
    body = [
        section("The nail under force", strip, table(_by_force(result)), small(TEXTS["middle"])),
        section("As a photograph", *photos, small(TEXTS["photograph"])) if photos else "",
        section("Along the nail", figure(_along_figure(result), "Colour along the nail; bands: 95 %.")),
        section("Over force", figure(_over_force_figure(result), "What an eye sees; bars: 95 %.")),
        _unknowns(result),
    ]
    lead = f"Seen by {seen_by(result)}; the nail is bare, without its board."
    return document(**TEXTS["page"], lead=lead, cards=cards, body=body, attributes=result.attrs)


def _by_force(result: xr.Dataset) -> list[dict[str, str]]:
    """The middle of the nail under each force, on the page and in the terminal."""
    middle, rows = result.isel(place=result.sizes["place"] // 2), []
    for s, force_n in enumerate(result.force_n.values):
        largest = result.isel(state=s, place=int(np.argmax(result.delta_e_2000.values[:, s])))
        row = {"Force [N]": f"{force_n:g}"} | _lab(middle.isel(state=s), "lab")
        row["Largest difference to rest [CIEDE2000]"] = estimated(largest, "delta_e_2000") if s else "0"
        rows.append(row | {"White band [mm]": estimated(result.isel(state=s), "white_band_mm")})
    return rows


def _lab(colour: xr.Dataset, name: str) -> dict[str, str]:
    """L*, a* and b* with their standard errors."""
    return {str(band): estimated(colour.sel(band=band), name) for band in colour.band.values}


def _unknowns(result: xr.Dataset) -> str:
    """Uncertainty over the priors: of all together, and by each of them."""
    if "lab_spread" not in result:
        return ""
    sites = ((str(site), _lab(result.sel(site=site), "lab_spread")) for site in result.site.values)
    rows = [{"Prior": f"all together, {site}", "Range": ""} | lab for site, lab in sites]
    nail = result.sel(site="nail")
    for i in np.argsort(-nail.prior_lab_spread.values.max(1)):
        prior = nail.isel(prior=int(i))
        shown = range_of(str(prior.prior_field.item()), *prior.prior_range.values.tolist())
        rows.append({"Prior": str(prior.prior.item()), "Range": shown} | _lab(prior, "prior_lab_spread"))
    return section("Uncertainty over the priors", table(rows), small(TEXTS["priors"]))


# The places on the nail: all but the first and the last, which are skin.
NAIL = slice(1, -1)


def _nail_shape(panel: Any, colours: np.ndarray, v_mm: np.ndarray, *, width_mm: float, skin: np.ndarray) -> None:
    """A nail in its colours along its length, the tip upwards, on the skin around it.

    skin : (2, 3) float. Its colour behind the nail and before it.
    """
    from matplotlib.patches import FancyBboxPatch

    pitch, margin = v_mm[1] - v_mm[0], 0.2 * width_mm
    low, high = v_mm[0] - pitch / 2, v_mm[-1] + pitch / 2
    # Skin changes along the nail, and is the same beyond it.
    finger = width_mm + 2 * margin, low - 5 * margin, high + 1.3 * margin, skin, np.array([low, high])
    for wide, from_mm, to_mm, shades, at_mm in (finger, (width_mm, low, high, colours, v_mm)):
        along_mm = np.linspace(from_mm, to_mm, 200)
        fine = np.stack([np.interp(along_mm, at_mm, shades[:, k]) for k in range(3)], -1)
        extent, look = (-wide / 2, wide / 2, from_mm, to_mm), {"origin": "lower", "interpolation": "bilinear"}
        image = panel.imshow(fine[:, None], extent=extent, aspect="equal", **look)
        rounded = f"round,pad=0,rounding_size={0.3 * wide}"
        size = (-wide / 2, from_mm), wide, to_mm - from_mm
        image.set_clip_path(FancyBboxPatch(*size, boxstyle=rounded, transform=panel.transData))
    panel.set_xlim(-width_mm / 2 - 1.3 * margin, width_mm / 2 + 1.3 * margin)
    panel.set_ylim(low - 1.2 * margin, high + 2.2 * margin)
    panel.set_axis_off()


def seen_by(result: xr.Dataset) -> str:
    """By which light and observer the colours are shown, in words."""
    lamp, lit = (TEXTS[name][result.attrs[name]] for name in ("illuminant", "lit_by"))
    gloss = "included" if result.attrs["gloss"] else "excluded"
    return f"{lamp} {lit}, {result.attrs['observer']}° observer at 0°, gloss {gloss}; shown as sRGB"


def draw_strip(panels: Any, result: xr.Dataset) -> None:
    """Draw the nail under each force into as many panels, all to one scale."""
    width_mm = parse_scene(result.attrs["scene"], name="the stored scene").fingertip.nail_width_mm
    for s, panel in enumerate(panels):
        colours, skin = result.srgb.values[NAIL, s], result.srgb.values[[0, -1], s]
        _nail_shape(panel, colours, result.v_mm.values[NAIL], width_mm=width_mm, skin=skin)
        panel.set_title(f"{float(result.force_n[s]):g} N", loc="center", fontsize=8.5)
        if (band := float(result.white_band_mm[s])) > 0:
            panel.text(0.5, 1.0, f"band {band:.1f} mm", transform=panel.transAxes, ha="center", va="top", fontsize=7)
    first = panels[0]
    bottom = first.get_ylim()[0] + 0.6
    first.plot([-2.5, 2.5], [bottom, bottom], color="white", linewidth=2, zorder=3, solid_capstyle="butt")
    first.text(0.0, bottom + 0.3, "5 mm", color="white", ha="center", va="bottom", fontsize=7, zorder=3)


@style.drawing()
def strip_figure(result: xr.Dataset) -> "style.Figure":
    """The nail under each force, in its colours, to scale."""
    count = result.sizes["state"]
    figure, axes = style.panels(max(1.35 * count, 5.6), 2.1, 1, count, squeeze=False)
    draw_strip(axes[0], result)
    figure.supxlabel(f"Traced; {seen_by(result)}", fontsize=7, color=style.MUTED)
    return figure


@style.drawing()
def _along_figure(result: xr.Dataset) -> "style.Figure":
    """L*, a* and b* along the nail, for each force, with 95 % intervals."""
    from matplotlib import colormaps

    figure, axes = style.panels(7.2, 5.6, 3, sharex=True)
    forces = result.force_n.values
    for k, (panel, words) in enumerate(zip(axes, ("lightness L*", "redness a*", "yellowness b*"), strict=True)):
        for s, force in enumerate(forces):
            colour, at = colormaps["viridis"](0.9 * s / max(len(forces) - 1, 1)), result.isel(state=s, band=k)
            style.estimate(panel, at.v_mm, at.lab, at.lab_stderr, color=colour, label=f"{force:g} N", alpha=0.15)
        panel.plot(result.v_mm, result.lab_without_blood.values[:, k], ":", color=style.MUTED, label="no blood")
        panel.set_title(f"{words} [1]")
    axes[-1].set_xlabel("place along the nail, towards the tip [mm]; the outermost two are skin")
    style.legend_above(figure, axes[0], ncols=len(forces) + 1)
    return figure


@style.drawing()
def _over_force_figure(result: xr.Dataset) -> "style.Figure":
    """Difference to rest and the white band, over force."""
    figure, (change, band) = style.panels(7.2, 2.8, 1, 2)
    nail = result.isel(place=NAIL)
    for p, colour in enumerate(style.place_colours(nail.sizes["place"])):
        error = Z95 * nail.delta_e_2000_stderr[p]
        change.errorbar(nail.force_n, nail.delta_e_2000[p], error, color=colour, linewidth=1.0)
    error = Z95 * result.white_band_mm_stderr
    band.errorbar(result.force_n, result.white_band_mm, error, color=style.INK, marker="o", markersize=3)
    change.set(title="Difference to rest, CIEDE2000", xlabel="force [N]; warm: proximal, cool: distal")
    band.set(title="White band [mm]", xlabel="force [N]")
    return figure


def summary(result: xr.Dataset) -> dict[str, Any]:
    """Colours by force and place, with the largest standard errors and spread over priors."""
    names, states = ("v_mm", "lab", "lab_stderr", "srgb", "delta_e_2000", "delta_e_2000_stderr"), []
    for s in range(result.sizes["state"]):
        state = result.isel(state=s)
        places = [plain(state.isel(place=p), *names) for p in range(result.sizes["place"])]
        band = plain(state, "white_band_mm", white_band_stderr_mm="white_band_mm_stderr")
        states.append(plain(state, "force_n") | {"places": places} | band)
    summed: dict[str, Any] = {
        **{name: result.attrs[name] for name in ("illuminant", "observer")},
        "states": states,
        "lab_stderr": result.lab_stderr.max(("place", "state")).values.tolist(),
        "colour_stderr": float(result.colour_stderr.max()),
        "change_stderr": float(result.delta_e_2000_stderr.max()),
    }
    if "lab_spread" in result:
        spread = result.lab_spread.transpose("site", "band").values.tolist()
        summed["lab_spread"] = dict(zip(result.site.values.tolist(), spread, strict=True))
    return summed | run_summary(result.attrs)


def lines(result: xr.Dataset, summary: dict[str, Any]) -> list[str]:
    """The same in a few lines for a terminal."""
    lines, errors = aligned(_by_force(result)), (summary["colour_stderr"], summary["change_stderr"])
    lines += [TEXTS["middle"].translate(ASCII), f"seen by {seen_by(result)}"]
    lines.append("standard error of a place's colour at most {:.2g}, of a change {:.2g} (CIEDE2000)".format(*errors))
    if "lab_spread" in summary:
        nail = zip(result.band.values, summary["lab_spread"]["nail"], strict=True)
        stds = ", ".join(f"{band} {value:.1f}" for band, value in nail)
        lines.append(f"standard deviation of the nail's colour over the priors of the finger: {stds}")
    return lines


def _png(picture: np.ndarray) -> bytes:
    """A picture (height, width, 3) uint8 as a PNG file."""
    from PIL import Image

    data = BytesIO()
    Image.fromarray(picture).save(data, format="PNG")
    return data.getvalue()


def _files(result: xr.Dataset, *, photographs: Sequence[np.ndarray] = ()) -> dict[str, Any]:
    """Contents of the files; photographs : at rest and pressed, (height, width, 3) uint8 each."""
    pictures = [_png(photograph) for photograph in photographs]
    named = dict(zip(("rest.png", "pressed.png"), [*pictures, None, None], strict=False))
    return named | {"colour.html": lambda _: page(result, pictures)}


COLOUR = Report(
    ("colour.nc", "colour.html", "strip.png", "rest.png", "pressed.png"),
    page,
    summary,
    lines,
    {"strip": strip_figure, "along": _along_figure, "force": _over_force_figure},
    _files,
)
