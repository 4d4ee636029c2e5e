"""The page of a placement: which layout tells force best, how sure that is, and where on the board the light tells."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ..scene import Scene
from ..scene.layout import lay_out
from ..studies.place_result import chosen, gain, rows
from . import maps, style
from .numbers import quantity, significant, with_error
from .study_page import document, drawing, provenance, table, write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHOWN = 20
SMOOTH_CELLS = 2.0


def write_placement(result: xr.Dataset, path: Path) -> None:
    """Write the page of what `studies.place.place` returns, whole or not at all."""
    write(page(result), Path(path))


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
    cards.append((f"{100 * first['crosstalk']:.0f} %", "of a photodiode's light at most was never in the bed"))
    body = [
        "<section><h2>The ranking</h2>",
        drawing(
            ranking_figure(result),
            "ranking",
            "Force resolution of each layout, smaller is finer, with its 95 % interval; those whose intervals overlap "
            "that of the best are tied with it (filled). Small ticks are the single fingers.",
        ),
        _table(ranking),
        _check(result),
        "</section><section><h2>The best layout</h2>",
        drawing(
            board_figure(best, result),
            "board",
            "The board from above, rolled flat: LED, barrier and photodiodes on the nail, whose tint shows the blood "
            "below.",
        ),
        "</section><section><h2>Where on this board the light tells</h2>",
        drawing(
            map_figure(best, result),
            "maps",
            "On the flat board with this LED and wall, first finger, logarithmic scales with contours: light per area; "
            "its part that was never in the bed; what one more photodiode there would resolve by itself, were the "
            "split of the force known (bright is fine; round the LED it would be saturated).",
        ),
        drawing(
            sensitivity_figure(best, result),
            "sensitivity",
            "How much the light at each place falls with blood in the proximal (left) and in the distal zone (right), "
            "relative to the light there: percent for each percent of the bed that is blood. Blank where too few "
            "photons came.",
        ),
    ]
    if result.sizes["spot"]:
        text = "Places of the LED that were tried: the force that the best photodiodes for each would resolve."
        body.append(drawing(tried_figure(result), "tried", text + " Triangles point from the LED to its photodiodes."))
    return document(
        kicker="where to put them",
        title=f"{result.sizes['best_photodiode']} photodiodes on the nail",
        lead=lead,
        cards=cards,
        body=[*body, "</section>"],
        provenance=provenance(result.attrs),
        scene=str(result.attrs["scene"]),
    )


def ranking_figure(result: xr.Dataset) -> "Figure":
    """Layouts with their intervals, best on top."""
    count = min(result.sizes["layout"], SHOWN)
    with style.drawing():
        figure = style.new_figure(7.2, 0.9 + 0.32 * count)
        axes = figure.subplots()
        for i in range(count):
            low, high = (1e3 * float(result[f"force_resolution_{end}_n"][i]) for end in ("low", "high"))
            colour = style.ZONES[0] if str(result.layout.values[i]) == "paper" else style.ZONES[1]
            axes.plot([low, high], [i, i], color=colour, lw=2.2, solid_capstyle="butt")
            fill = colour if bool(result.tied[i]) else "none"
            axes.plot([1e3 * float(result.force_resolution_n[i])], [i], "o", mfc=fill, mec=colour, ms=6)
            each = 1e3 * result.finger_resolution_n.values[i]
            axes.plot(each, [i] * len(each), "|", color=style.MUTED, ms=9, mew=1.0, zorder=1)
        names = [style.plain(name).replace("_", " ") for name in result.layout.values[:count]]
        axes.set_yticks(range(count), names)
        axes.set_ylim(count - 0.5, -0.5)
        if 1e3 * float(result.force_resolution_high_n[:count].max()) > 8e3 * float(result.force_resolution_n[0]):
            axes.set_xscale("log")
        else:
            axes.set_xlim(left=0)
        axes.set_xlabel("force resolution [mN]")
    return figure


def board_figure(scene: Scene, result: xr.Dataset) -> "Figure":
    """The best layout from above."""
    names = [e.area.name for e in lay_out(scene).photodiodes]
    shown = xr.Dataset(coords={"led": [led.name for led in scene.leds], "photodiode": names})
    with style.drawing():
        figure = style.new_figure(7.6, 5.8)
        axes = figure.subplots()
        maps.draw_top_view(axes, scene, shown)
        # Boards may be as wide as the nail, and their labels want room beside it.
        low, high = axes.get_xlim()
        axes.set_xlim(low - 2.6, high + 1.2)
    return figure


def map_figure(scene: Scene, result: xr.Dataset) -> "Figure":
    """Light, its direct part, and the resolution of one photodiode, over the board."""
    from matplotlib.colors import LogNorm

    panels = (
        ("irradiance", 1.0, "Light [1/mm²]", "viridis"),
        ("direct", 1.0, "Never in the bed [1/mm²]", "viridis"),
        ("place_resolution_n", 1e3, "Resolves [mN]", "viridis_r"),
    )
    with style.drawing():
        figure = style.new_figure(10.5, 4.6)
        for axes, (name, scale, title, colours) in zip(figure.subplots(1, 3), panels, strict=True):
            values = _smooth(scale * result[name].isel(led=0).to_numpy())
            good = values[np.isfinite(values) & (values > 0)]
            fine = name == "place_resolution_n"
            low, high = (good.min(), 300 * good.min()) if fine else (good.max() / 3e4, good.max())
            clipped = np.clip(np.nan_to_num(values, nan=high, posinf=high), low, high)
            image = axes.imshow(
                clipped.T, extent=_extent(result), origin="lower", cmap=colours, norm=LogNorm(low, high)
            )
            levels = np.geomspace(low, high, 9 if fine else 10)[1:-1]
            axes.contour(result.u, result.v, clipped.T, levels=levels, colors=["#ffffff"], linewidths=0.5, alpha=0.7)
            figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02)
            axes.set_title(title)
            _parts(axes, scene)
    return figure


def sensitivity_figure(scene: Scene, result: xr.Dataset) -> "Figure":
    """Fall of the light with the blood of either zone, relative to the light there."""
    with style.drawing():
        figure = style.new_figure(7.6, 4.6)
        light = _smooth(result.irradiance.isel(led=0).to_numpy())
        # Where few photons came, the ratio is noise and is left blank.
        light[_smooth(result.irradiance_stderr.isel(led=0).to_numpy()) > 0.7 * light] = np.nan
        each = [_smooth(-result.sensitivity.isel(led=0, blood_zone=k).to_numpy()) for k in range(2)]
        with np.errstate(invalid="ignore", divide="ignore"):
            fall = [np.where(light > 0, one / light, np.nan) for one in each]
        top = float(np.nanquantile(np.stack(fall), 0.99))
        for axes, values, title in zip(
            figure.subplots(1, 2), fall, ("Proximal blood [%/%]", "Distal blood [%/%]"), strict=True
        ):
            image = axes.imshow(
                np.clip(values, 0, top).T, extent=_extent(result), origin="lower", cmap="magma", vmin=0, vmax=top
            )
            axes.contour(
                result.u, result.v, values.T, levels=np.linspace(0, top, 7)[1:-1], colors=["#ffffff"], linewidths=0.5
            )
            figure.colorbar(image, ax=axes, shrink=0.85, pad=0.02)
            axes.set_title(title)
            _parts(axes, scene)
    return figure


def tried_figure(result: xr.Dataset) -> "Figure":
    """Places of the LED by what the search found there."""
    from matplotlib.colors import LogNorm

    with style.drawing():
        figure = style.new_figure(5.6, 4.8)
        axes = figure.subplots()
        place, found = result.led_tried_mm.to_numpy(), 1e3 * result.led_tried_n.to_numpy()
        norm = LogNorm(found.min(), max(found.max(), 1.001 * found.min()))
        marks = {"left": ">", "right": "<", "below": "^", "above": "v"}
        sides = [str(side) for side in result.led_tried_side.values]
        for side in dict.fromkeys(sides):
            at = np.array([s == side for s in sides])
            shift = {"left": (0.12, 0), "right": (-0.12, 0), "below": (0, 0.12), "above": (0, -0.12)}.get(side, (0, 0))
            image = axes.scatter(
                place[at, 0] + shift[0],
                place[at, 1] + shift[1],
                c=found[at],
                norm=norm,
                cmap="viridis_r",
                marker=marks.get(side, "o"),
                s=46,
                edgecolors=style.MUTED,
                linewidths=0.4,
            )
        figure.colorbar(image, ax=axes, label="force resolution [mN]")
        left, right, low, high = _extent(result)
        axes.set_xlim(left, right)
        axes.set_ylim(low, high)
        axes.set_aspect("equal")
        axes.set_xlabel("across the nail [mm]")
        axes.set_ylabel("along the nail, towards the tip [mm]")
    return figure


def _parts(axes: "Axes", scene: Scene) -> None:
    """Outline the layout's parts over a map."""
    from matplotlib.patches import Rectangle as Patch

    layout = lay_out(scene)
    for r in layout.barriers:
        axes.add_patch(Patch((r.u_min, r.v_min), r.u_max - r.u_min, r.v_max - r.v_min, fc=maps.BARRIER, lw=0))
    boxes: list[tuple[Any, str]] = [(e.area, "none") for e in layout.photodiodes]
    boxes += [(led, maps.LED) for led in layout.leds]
    for r, fill in boxes:
        for colour, width in (("#ffffff", 1.8), (style.DARK_INK, 0.8)):
            axes.add_patch(
                Patch((r.u_min, r.v_min), r.u_max - r.u_min, r.v_max - r.v_min, fc=fill, ec=colour, lw=width)
            )
    axes.grid(False)
    axes.set_xlabel("across [mm]")
    axes.set_ylabel("along, to the tip [mm]")


def _smooth(values: np.ndarray) -> np.ndarray:
    """A map without the grain of single photons; what is not finite counts as nothing known."""
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(values)
    weight = gaussian_filter(known.astype(float), SMOOTH_CELLS)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight > 0.05, gaussian_filter(np.where(known, values, 0.0), SMOOTH_CELLS) / weight, np.nan)


def _extent(result: xr.Dataset) -> tuple[float, float, float, float]:
    u, v = result.u.to_numpy(), result.v.to_numpy()
    du, dv = (u[1] - u[0]) / 2, (v[1] - v[0]) / 2
    return float(u[0] - du), float(u[-1] + du), float(v[0] - dv), float(v[-1] + dv)


def _table(ranking: list[dict[str, Any]]) -> str:
    head = ["Layout", "Rank", "Resolves<br>[mN]", "Split known<br>[mN]", "Condition", "Least<br>signal / noise"]
    head += ["Full scale /<br>reading", "Never in<br>bed [%]"]
    lines = []
    for row in ranking[:SHOWN]:
        force = with_error(1e3 * row["force_resolution_n"], 1e3 * row["force_resolution_n_stderr"])
        cells = [row["layout"].replace("_", " "), f"{row['rank']}{' (tied)' if row['tied'] else ''}", force]
        cells += [significant(1e3 * row["known_split_n"]), significant(row["condition_number"])]
        cells += [significant(row["least_snr"]), significant(row["adc_headroom"]), f"{100 * row['crosstalk']:.0f}"]
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
