"""The page of a simulated touch: key figures, tables, and figures of force, vessels and volts beside the models."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from ...hemodynamics.for_scene import hold_end
from ...scene import Scene, parse_scene
from ...scene.touch import SHARES
from ...tissue import bed_zone_name
from .. import maps, style
from ..files import Report
from ..html import Html, document, escaped, figure, section, small, subheading, table, texts
from ..numbers import estimated, prefix, quantity, significant, with_error
from ..readings import disturbance_lines, photodiode_readings, reading_rows, simulation_lines, simulation_summary
from ..scene_description import blood_words, body_words, touch_words
from ..uncertainty_section import spread_section

TEXTS = texts("simulate")
# Less of the light than this is not worth a row, at any LED.
LEAST = 1e-4
# Less alpha D^2 than this over the whole touch, Beer-Lambert (8) is as straight in D^2 as Taylor (9), and its
# constants are not identifiable.
STRAIGHT = 0.01
# A mean path below this is as good as none.
LEAST_PATH_MM = 1e-3
# More samples than this add bytes to a page and nothing to a picture.
SAMPLES = 500
# Small multiples stay readable up to so many photodiodes; of more, evenly spaced ones are shown.
PANELS = 16
DASHED = (0, (4, 2.5))
# Colours of the lines of a touch; of any other, the veins'.
LINES = {"force_n": style.INK, "proximal_pressure_pa": style.ZONES[0], "distal_pressure_pa": style.ZONES[1]}
LINES |= {"arterial_pressure_pa": style.ZONES[0]}
# Without blood, at rest and beyond: a nail's colours.
BLOOD = ("#fbf6f2", "#e6a5a0", "#8e1022")
# Dashes of the reduced models.
MODELS = {"beer_lambert": ("Beer–Lambert (8)", (5, 2.5)), "taylor": ("Taylor (9)", (1, 1.6))}


def page(result: xr.Dataset) -> str:
    """The page of what `studies.simulate` returns; path density and section may be missing."""
    scene = _scene(result)
    touch, digit = touch_words(scene), scene.fingertip.digit
    readings, along = photodiode_readings(result, scene), ""
    # More zones than a figure over time can show.
    if "white_band_mm" in result and result.sizes["time"] > 1:
        along = figure(bed(result, scene), TEXTS["bed"])
    drawn, notes = figure(overview(result, scene), TEXTS["overview"]), (TEXTS["readings"], *disturbance_lines(result))
    shown = _pair_table(reading_rows(readings), readings, scene, kind="readings dense")
    return document(
        kicker="touch to volts",
        title=f"{touch[0].upper()}{touch[1:]}; {digit}{'' if digit == 'thumb' else ' finger'}",
        lead=_sentence(scene, result),
        warnings=_warnings(readings),
        cards=_cards(readings, result, scene),
        body=[
            section("Readings of the photodiodes", drawn, shown, *map(small, notes)),
            section("The touch and the blood", figure(courses(result), TEXTS["courses"]), along),
            _space_section(result, scene),
            _models_section(result, scene, readings),
            spread_section(result),
        ],
        attributes=result.attrs,
    )


def _space_section(result: xr.Dataset, scene: Scene) -> Html:
    parts = [figure(maps.top_view(scene), TEXTS["board"], narrow=True)]
    if "section_region" in result:
        shown = ("section", "paths") if "path_density" in result else ("section",)
        parts.append(figure(maps.section(scene, result), " ".join(TEXTS[name] for name in shown)))
    else:
        parts.append(small("The section of the finger was not computed."))
    if "absorbed_fraction" in result:
        parts += [table(_light_ends(result), kind="ends"), small(TEXTS["ends"])]
    return section("The sensor on the finger", *parts)


def _light_ends(result: xr.Dataset) -> list[dict[str, str]]:
    """Where the light of each LED ends, the ends that take most first."""
    names: dict[str, str] = TEXTS["regions"]
    ends = {names[part]: ("energy_fraction", {"part": part}) for part in ("reflected", "transmitted")}
    ends |= {names.get(r, r): ("absorbed_fraction", {"region": r}) for r in result.region.values.tolist()}
    most = {text: float(result[name].sel(at).max()) for text, (name, at) in ends.items()}
    rows = []
    for text in sorted(filter(lambda text: most[text] >= LEAST, ends), key=lambda text: -most[text]):
        (name, at), row = ends[text], {"The light ends in": text}
        end = result[[name, f"{name}_stderr"]].sel(at)
        for i in range(result.sizes["led"]):
            row[f"{maps.led_name(result, i)} [%]"] = estimated(end.isel(led=i), name, 100)
        rows.append(row)
    return rows


def _models_section(result: xr.Dataset, scene: Scene, readings: pd.DataFrame) -> Html:
    text, lines = TEXTS["models"], list[str]()
    if result.sizes["photodiode"] > PANELS:
        text += f" {PANELS} of {result.sizes['photodiode']} are shown, evenly spaced."
    for i in range(result.sizes["led"]):
        lines += [subheading(maps.led_name(result, i))] if result.sizes["led"] > 1 else []
        lines.append(figure(volts(result, scene, led=i), text))
    rows, notes = _fits(result, readings)
    fits = _pair_table(rows, readings, scene, kind="fits")
    lines += [subheading("Constants of Beer–Lambert (8) and Taylor (9)"), fits, *map(small, (TEXTS["fits"], *notes))]
    if paths := _paths(result, readings):
        lines += [subheading("Mean path of the detected light"), TEXTS["mean_path"]]
        lines.append(_pair_table(paths, readings, scene, kind="paths"))
    return section("Traced light beside the reduced optics", *lines)


def _scene(result: xr.Dataset) -> Scene:
    """The scene that a result carries; raises InputError if it cannot be read."""
    return parse_scene(str(result.attrs["scene"]), name="the result's scene")


def _sentence(scene: Scene, result: xr.Dataset) -> str:
    """What was simulated, in one sentence."""
    leds, photodiodes = result.sizes["led"], result.sizes["photodiode"]
    waves = _list([f"{float(w):g}" for w in result.wavelength_nm]) + " nm"
    text = f"{leds} LED{'s' * (leds != 1)} ({waves}) and {photodiodes} photodiode{'s' * (photodiodes != 1)} on the nail"
    text += f"; force up to {float(result.force_n.max()):.3g} N"
    if duration := float(result.time[-1] - result.time[0]):
        text += f" within {duration:.3g} s"
    text += f"; blood {100 * scene.blood.rest_blood_fraction:g}\u00a0% of the bed at rest, {blood_words(scene)}"
    if body := body_words(scene):
        text += f"; {body}"
    accuracy = result.attrs.get("accuracy_reached")
    return f"{text}. Light traced to: {accuracy}." if accuracy else f"{text}."


def _cards(readings: pd.DataFrame, result: xr.Dataset, scene: Scene) -> list[tuple[str, str]]:
    """Key figures as (number, words)."""
    lines: list[tuple[str, str]] = []
    usable = readings[~readings.saturated]
    change_v = usable.volts_change
    for word, moved in (("fall", change_v[change_v < 0]), ("rise", change_v[change_v > 0])):
        if len(moved):
            r = usable.loc[moved.abs().idxmax()]
            ratio = f"signal-to-noise ratio {significant(r.signal_to_noise)}"
            words = f"largest {word}: {r.reading}, {significant(r.change_percent, sign=True)} %, {ratio}"
            lines.append((quantity(r.volts_change, "V", sign=True), words))
    force_n = usable.noise_equivalent_force_n
    if len(known := force_n[(force_n > 0) & np.isfinite(force_n)]):
        words = f"lowest noise-equivalent force of one sample (noise / slope): {usable.reading[known.idxmin()]}"
        lines.append((quantity(known.min(), "N"), words))
    if change_v.any() and scene.touch.proximal_share == SHARES["even"]:
        lines += _signs(usable, result)
    if "white_band_mm" in result:
        lines.append((f"{float(result.white_band_mm[hold_end(result)]):.1f}\u00a0mm", TEXTS["white_band"]))
    # How far the models are from the traced light at worst, beside the noise.
    largest = usable[["beer_lambert_residual_rms_v", "taylor_residual_rms_v", "volts_noise_rms"]].max()
    exact, taylor, noise = (quantity(value, "V", digits=2) for value in largest)
    words = f"largest rms residual of Beer–Lambert (8); Taylor (9): {taylor}; noise of one sample: {noise}"
    return [*lines, (exact, words)]


def _warnings(readings: pd.DataFrame) -> list[str]:
    """What the reader must know before trusting the numbers."""
    full, usable = readings[readings.saturated], readings[~readings.saturated]
    lines = [TEXTS["saturated"].format(_list([*(full.photodiode + " under " + full.led)]))] if len(full) else []
    return [*lines, TEXTS["still"]] if len(usable) and not usable.volts_change.any() else lines


def _signs(readings: pd.DataFrame, result: xr.Dataset) -> list[tuple[str, str]]:
    """Whether readings change under an even touch as in the paper, down over the proximal half of the zones and up over
    the distal; nothing of a board that has photodiodes over one half alone, or where no reading does."""
    distal = readings.zone.isin(result.zone.values[result.sizes["zone"] // 2 + result.sizes["zone"] % 2 :])
    right = np.sign(readings.volts_change) == np.where(distal, 1, -1)
    if not right.any() or distal.nunique() == 1:
        return []
    words, least = TEXTS["as_in_the_paper"], readings.z_score[right].min()
    if np.isfinite(least):
        words += f", by {significant(least, 2)} σ of the trace or more"
    wrong = [*readings.reading[~right]]
    if 0 < len(wrong) < 4:
        words += f"; not {_list(wrong)}"
    if "keeps_sign" in result:
        holds = result.keeps_sign.where(~result.saturated.any("time"), False)
        words += TEXTS["signs_over_priors"].format(int(holds.sum()), len(readings))
    return [(f"{right.sum()} of {len(readings)}", words)]


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _paths(result: xr.Dataset, readings: pd.DataFrame) -> list[dict[str, str]]:
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


def _fits(result: xr.Dataset, readings: pd.DataFrame) -> tuple[list[dict[str, str]], list[str]]:
    """Fitted constants of Beer-Lambert (8) and Taylor (9) with their residuals; and what is not determined, in words.

    Where the readings do not bend, V0, V1 and alpha of Beer-Lambert (8) are not identifiable; the fit is shown as
    straight.
    """
    largest_m2 = float(result.capillary_diameter_m.max()) ** 2
    fields, rows, noted = TEXTS["constants"], [], dict[str, list[str]]()
    for r in readings.itertuples():
        fit = result.sel(led=r.led, photodiode=r.photodiode)
        if r.saturated:
            rows.append({"Photodiode": f"{r.photodiode} saturated"} | dict.fromkeys(fields, "–"))
            continue
        noted.setdefault(note := str(fit.fit_note.item()), []).append(r.reading)
        row, level_v = {"Photodiode": r.photodiode}, abs(float(fit.taylor_v0_v))
        straight = 0 < float(fit.beer_lambert_alpha_per_m2) * largest_m2 < STRAIGHT or "straight" in note
        for head, (field, unit) in fields.items():
            level = level_v / (largest_m2 if field.endswith("_per_m2") else 1.0) / unit
            error = float(fit[f"{field}_stderr"]) / unit if f"{field}_stderr" in fit else 0.0
            row[head] = with_error(float(fit[field]) / unit, error, scale=level)
            if row[head].endswith(("?", "–")) and field.startswith("beer_lambert"):
                row[head] = "straight" if straight else "not known"
        rows.append(row)
    return rows, [f"{', '.join(names)}: {note}" for note, names in noted.items() if note]


def _pair_table(rows: Sequence[dict[str, str]], readings: pd.DataFrame, scene: Scene, *, kind: str) -> Html:
    """A table of all readings, LED by LED, with the colour of each photodiode's place along the nail."""
    order = list(dict.fromkeys(readings.photodiode))
    colours = {name: colour for name, (colour, _) in zip(order, maps.coloured_along_nail(scene), strict=True)}
    shown = []
    for row, name in zip(rows, readings.photodiode, strict=True):
        swatch = f'<span class="swatch" style="background:{colours[name]}"></span>'
        shown.append(row | {"Photodiode": Html(swatch + escaped(row["Photodiode"]))})
    return table(shown, kind=kind, groups=[f"LED {led}" for led in readings.led])


@style.drawing()
def courses(result: xr.Dataset) -> "style.Figure":
    """The touch, and what it does to the vessels and to the blood of the nail bed and its oxygen, a panel for each."""
    thin, colours = _thin(result), style.place_colours(result.sizes["zone"])
    shown = [course for course in TEXTS["panels"] if course["of"][0] in result]
    room = style.Room(left=0.65, across=0.7, down=0.7)
    figure, panels = style.tiles(len(shown), 3, 9.2, 2.5, room_in=room, sharex=True)
    for axes, course in zip(panels, shown, strict=True):
        lines: list[tuple[str, str, xr.DataArray]] = []
        for name in filter(result.__contains__, course["of"]):
            if "zone" in result[name].dims:
                lines += zip(map(str, result.zone.values), colours, thin[name].transpose("zone", "time"), strict=True)
            else:
                lines.append((TEXTS["lines"].get(name, ""), LINES.get(name, style.VEIN), thin[name]))
        for k, (text, colour, values) in enumerate(lines):
            # Curves that lie on one another are all visible.
            look = {"color": colour, "linestyle": ("-", DASHED)[k % 2], "label": style.plain(text)}
            _line(axes, course["scale"] * values, **look)
        _over_time(axes, result, course["title"], course["label"])
        _not_too_close(axes)
        axes.tick_params(labelbottom=True)
        if len(lines) > 1:
            axes.set_ylim(top=axes.get_ylim()[1] + 0.16 * np.ceil(len(lines) / 3) * np.ptp(axes.get_ylim()))
            axes.legend(loc="upper left", ncols=3, fontsize=7, handlelength=1.8, columnspacing=1.0)  # room of its own
    return figure


@style.drawing()
def bed(result: xr.Dataset, scene: Scene) -> "style.Figure":
    """Blood of the nail bed along the nail over time, as a fraction of that at rest, and where the white band ends."""
    from matplotlib.colors import LinearSegmentedColormap

    half_mm, thin = scene.fingertip.nail_length_mm / 2, _thin(result)
    part = thin.blood_fraction.to_numpy() / scene.blood.rest_blood_fraction
    figure, axes = style.panels(9.2, 2.8)
    colours = LinearSegmentedColormap.from_list("blood", BLOOD)
    edges_mm, most = [-half_mm, *scene.zone_edges_mm, half_mm], max(2.0, float(part.max()))
    time_s = thin.time.to_numpy()
    borders = np.concatenate([time_s[:1], (time_s[1:] + time_s[:-1]) / 2, time_s[-1:]])
    image = axes.pcolormesh(borders, edges_mm, part, cmap=colours, vmin=0, vmax=most, rasterized=True)
    _line(axes, half_mm - thin.white_band_mm, color=style.DARK_INK, lw=1.2, linestyle=DASHED)
    _over_time(axes, result, "Blood along the nail", "towards the tip [mm]")
    axes.set_ylim(-half_mm, half_mm)
    axes.grid(False)
    figure.colorbar(image, ax=axes, label="blood, of that at rest [1]")
    return figure


@style.drawing()
def overview(result: xr.Dataset, scene: Scene) -> "style.Figure":
    """Change of every photodiode from rest, one panel per LED."""
    leds = result.sizes["led"]
    figure, panels = style.panels(9.2, 0.4 + 3.4 * leds, leds, sharex=True, sharey=True, squeeze=False)
    for i, axes in enumerate(panels[:, 0]):
        draw_change(axes, result, scene, led=i)
        axes.label_outer()
    return figure


def draw_change(axes: "style.Axes", result: xr.Dataset, scene: Scene, *, led: int) -> None:
    """Draw the change of every photodiode from rest under one LED into axes, with its value at the hold's end."""
    photodiodes = maps.coloured_along_nail(scene)
    change, hold = result.volts_change, hold_end(result)
    hold_s, thin = float(result.time[hold]), _thin(result)
    scale, letter = prefix(float(abs(thin.volts_change).max()))
    axes.axhline(0, color=style.MUTED, lw=0.8)
    for colour, j in photodiodes:
        moved = f"{significant(float(change[led, j, hold]) / scale, 3, sign=True)} {letter}V"
        moved = "saturated" if result.saturated[led, j].any() else moved
        moved = moved if result.detected_fraction[led, j].any() else "no light"
        label = f"{result.photodiode.values[j]}  {moved}"
        _line(axes, thin.volts_change[led, j] / scale, color=colour, label=style.plain(label))
    axes.axvline(hold_s, color=style.MUTED, lw=0.8, ls=(0, (2, 2)))
    _over_time(axes, result, style.plain(maps.led_name(result, led)), f"change from rest [{letter}V]")
    _not_too_close(axes)
    # From the tip down, as on the nail.
    look: dict[str, Any] = {"reverse": True, "loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    if len(photodiodes) <= 2 * PANELS:  # the names of more would leave no room for the curves
        axes.legend(title=f"at {hold_s:.3g} s", ncols=1 + (len(photodiodes) - 1) // 16, **look)


def volts(result: xr.Dataset, scene: Scene, *, led: int) -> "style.Figure":
    """One LED's readings, one panel per photodiode, the more proximal ones first: change from rest of traced light and
    of both reduced models, with the trace's error of the change."""
    order = maps.coloured_along_nail(scene)
    if len(order) > PANELS:
        order = [order[k] for k in np.linspace(0, len(order) - 1, PANELS).round().astype(int)]
    colours, places = zip(*order, strict=True)
    thin = _thin(result).isel(led=led, photodiode=list(places)).transpose("photodiode", "time", ...)
    rest = result.volts.isel(led=led, photodiode=list(places), time=0).where(thin.detected_fraction.any("time"))
    scale, letter = prefix(float(abs(thin.volts_change).max()))
    models = {}
    for name, (label, dashes) in MODELS.items():
        models[label] = (thin[f"volts_{name}"] - rest).values / scale, {"color": style.INK, "ls": (0, dashes)}
    traced, stderr = (thin[name].values / scale for name in ("volts_change", "volts_change_stderr"))
    named = dict(zip(thin.photodiode.values, colours, strict=True))
    labels = {"xlabel": "time [s]", "ylabel": f"change [{letter}V]"}
    return style.beside_models(thin.time.values, traced, stderr, models, named=named, **labels)


def _thin(result: xr.Dataset) -> xr.Dataset:
    """At most so many times, the first and the last among them; no change of what detected no light."""
    count = result.sizes["time"]
    thin = result if count <= SAMPLES else result.isel(time=np.linspace(0, count - 1, SAMPLES).round().astype(int))
    return thin.assign(volts_change=thin.volts_change.where(thin.detected_fraction.any("time")))


def _line(axes: "style.Axes", values: xr.DataArray, **look: Any) -> None:
    """A line over time; a dot where there is one time only."""
    if values.size == 1:
        look |= {"marker": "o", "linestyle": "none"}
    axes.plot(values.time.to_numpy(), values.to_numpy(), **look)


def _over_time(axes: "style.Axes", result: xr.Dataset, title: str, ylabel: str) -> None:
    axes.set(xlabel="time [s]", title=title, ylabel=ylabel)
    if result.sizes["time"] > 1:
        axes.set_xlim(float(result.time[0]), float(result.time[-1]))


def _not_too_close(axes: "style.Axes") -> None:
    """Keep rounding noise of a constant from filling the axes: show at least 1 per mille of the value."""
    low, high = axes.get_ylim()
    middle, least = (low + high) / 2, 1e-3 * max(abs(low), abs(high))
    if high - low < least:
        axes.set_ylim(middle - least, middle + least)
    axes.ticklabel_format(axis="y", useOffset=False)


SIMULATION = Report(
    ("result.nc", "report.html"),
    page,
    simulation_summary,
    simulation_lines,
    {
        "readings": lambda result: overview(result, _scene(result)),
        "touch": courses,
        "volts": lambda result, led=0: volts(result, _scene(result), led=led),
        "section": lambda result: maps.section(_scene(result), result),
    },
)
