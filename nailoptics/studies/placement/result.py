"""What a placement found, as a Dataset, as rows of a table, and the best layout as a scene and as KiCad parts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from ...light.board_map import PhotonMap, map_dataset
from ...light.transfer import provenance
from ...scene import Scene, parse_scene, to_toml
from ...scene.kicad import PlacedPart
from . import fisher as merit
from .photon_maps import View, jackknife, left_out

if TYPE_CHECKING:
    from .exchange import Spot
    from .place import Judged, Layout

# Spacing of the places at which one more photodiode is looked at.
PLACES_MM = 0.2


def as_dataset(
    scene: Scene,
    layouts: "Sequence[Layout]",
    judged: "Sequence[Judged]",
    *,
    views: Sequence[View],
    maps: Sequence[PhotonMap],
    tried: "Sequence[tuple[Spot, float]]",
    closer: xr.Dataset,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Everything of a placement; layouts come best first.

    maps : of the best layout's bare board on the first finger, one per LED.
    tried : places of the LED and what the search found there.
    closer : what is known of the best layout on the first finger, from `place_best.look`.
    """
    data: dict[str, Any] = {}

    def add(name: str, dims: tuple[str, ...], values: Any, units: str, text: str, error: Any = None) -> None:
        data[name] = (dims, np.asarray(values), {"units": units, "long_name": text})
        if error is not None:
            data[name][2]["ancillary_variables"] = f"{name}_stderr"
            data[f"{name}_stderr"] = (dims, np.asarray(error), {"units": units, "long_name": f"standard error: {text}"})

    one, both = ("layout",), ("layout", "finger")
    intervals = np.array([j.interval_n for j in judged])
    add(
        "force_resolution_n",
        one,
        [j.score_n[0] for j in judged],
        "N",
        "force resolution of one sample, rms, whatever the split of the force, over the fingers",
        [j.score_n[0] * j.relative_error for j in judged],
    )
    add("force_resolution_low_n", one, intervals[:, 0], "N", "lower end of its 95 % interval")
    add("force_resolution_high_n", one, intervals[:, 1], "N", "upper end of its 95 % interval")
    add("tied", one, intervals[:, 0] <= intervals[0, 1], "1", "whether its interval overlaps that of the best")
    data["origin"] = (one, [layout.origin for layout in layouts], {"long_name": "given, searched or the paper's"})
    data["scene"] = (one, [to_toml(layout.scene) for layout in layouts], {"long_name": "the layout as a scene"})
    add(
        "finger_resolution_n",
        both,
        [j.resolution_n[0] for j in judged],
        "N",
        "force resolution on each finger",
        [jackknife(j.resolution_n) for j in judged],
    )
    add("known_split_n", both, [j.known_split_n[0] for j in judged], "N", "force resolution if the split is known")
    pressures = (*both, "pressure")
    add("pressure_resolution_pa", pressures, [j.pressures_pa[0] for j in judged], "Pa", "resolution of each pressure")
    information = [[_matrix(by_led) for by_led in j.volts] for j in judged]
    add("fisher_information_per_pa2", (*pressures, "pressure_too"), information, "Pa-2",
        "Fisher information of the two pressures in one sample of all readings")  # fmt: skip
    conditions = [[max(merit.condition(_first(r)) for r in by_led) for by_led in j.volts] for j in judged]
    add("condition_number", both, conditions, "1", "condition number of the matrix of readings by blood zones")
    _readings(add, layouts, judged)
    add("led_tried_mm", ("spot", "axis"), [s.place_mm for s, _ in tried] or np.zeros((0, 2)), "mm", "LED place tried")
    data["led_tried_side"] = (
        ("spot",),
        np.array([s.side or "" for s, _ in tried], str),
        {"long_name": "LED lies there"},
    )
    add("led_tried_n", ("spot",), [found for _, found in tried], "N", "force resolution that the search found there")
    _of_the_best(add, judged[0].volts[0])
    result = xr.Dataset(
        data,
        coords={
            "layout": [layout.name for layout in layouts],
            "finger": [view.case.name for view in views],
            "pressure": ["proximal", "distal"],
            "pressure_too": ["proximal", "distal"],
            "axis": ["u", "v"],
        },
    )
    plane = map_dataset([led.name for led in layouts[0].scene.leds], maps)
    result = result.merge(plane).merge(closer)
    result = result.merge(_photodiode_anywhere(layouts[0].scene, maps, views[0].at))
    result.attrs = (
        provenance(
            scene,
            engine="photons",
            backend=attributes.pop("backend"),
            photons=attributes.pop("photons"),
            seeds=str(attributes["seed"]),
        )
        | {"title": "nailoptics: layouts ranked by force resolution"}
        | attributes
        | closer.attrs
        | {"adc_range_v": layouts[0].scene.electronics.adc_range_v}
    )
    return result


def _photodiode_anywhere(scene: Scene, maps: Sequence[PhotonMap], at: merit.Operating) -> xr.Dataset:
    """What one more photodiode would read by itself, wherever it lies on the board."""
    entry, outline = scene.photodiodes[0], maps[0].outline
    half_u, half_v = (size / 2 for size in entry.size_mm)
    axes = [
        np.arange(low + half, high - half + 1e-9, PLACES_MM)
        for low, high, half in (
            (outline.u_min, outline.u_max, half_u),
            (outline.v_min, outline.v_max, half_v),
        )
    ]
    u, v = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    areas, shape = np.column_stack([u - half_u, u + half_u, v - half_v, v + half_v]), [len(axis) for axis in axes]
    columns: dict[str, list[np.ndarray]] = {"noise_v": [], "resolution_n": [], "resolution_n_stderr": []}
    for led, one in zip(scene.leds, maps, strict=True):
        read = merit.volts(left_out(one.over(areas)), led, entry, scene.electronics, at)
        with np.errstate(divide="ignore", invalid="ignore"):
            tells = merit.known_split_n(merit.information(read), at)
            error = tells[0] * jackknife(np.log(tells))
        for name, column in zip(columns, (np.sqrt(read.noise_v2[0]), tells[0], error), strict=True):
            columns[name].append(column.reshape(shape))
    text = "force resolution of one photodiode centred there by itself, split known"
    texts = {
        "noise_v": ("V", "noise of one photodiode centred there in one sample, rms"),
        "resolution_n": ("N", text),
        "resolution_n_stderr": ("N", f"standard error: {text}"),
    }
    data: dict[str, Any] = {
        f"place_{name}": (("led", "place_u", "place_v"), column, {"units": texts[name][0], "long_name": texts[name][1]})
        for name, column in columns.items()
    }
    data["place_resolution_n"][2]["ancillary_variables"] = "place_resolution_n_stderr"
    about = {"units": "mm", "long_name": "centre of the photodiode"}
    return xr.Dataset(data, coords={"place_u": ("place_u", axes[0], about), "place_v": ("place_v", axes[1], about)})


def _first(read: merit.Volts) -> merit.Volts:
    """Readings by all photons."""
    return merit.Volts(*(part[0] for part in vars(read).values()))


def _matrix(by_led: "Sequence[merit.Volts]") -> np.ndarray:
    """Information of all readings as a matrix, (2, 2) float. [Pa^-2]"""
    one, both, two = np.sum([merit.information(_first(read)).sum(0) for read in by_led], axis=0)
    return np.array([[one, both], [both, two]])


def _of_the_best(add: Any, by_led: "Sequence[merit.Volts]") -> None:
    """What each photodiode of the best layout reads, by the map."""
    dims = ("led", "best_photodiode")
    first = [_first(read) for read in by_led]
    add("foretold_volts", dims, [r.volts for r in first], "V", "volts by the map",
        [jackknife(r.volts) for r in by_led])  # fmt: skip
    add("foretold_noise_v", dims, [np.sqrt(r.noise_v2) for r in first], "V", "noise of one sample by the map, rms")
    add("foretold_crosstalk", dims, [r.crosstalk for r in first], "1", "part of the light that was never in the bed",
        [jackknife(r.crosstalk) for r in by_led])  # fmt: skip
    add("foretold_zone_v", (*dims, "blood_zone"), [r.zone_v for r in first], "V",
        "change of the reading with the blood fraction of a zone by the map",
        [jackknife(r.zone_v) for r in by_led])  # fmt: skip


def _readings(add: Any, layouts: "Sequence[Layout]", judged: "Sequence[Judged]") -> None:
    """Volts, noise, crosstalk and headroom, over the fingers' extremes."""
    for name, units, text, pick in (
        ("least_volts", "V", "least reading of a photodiode over fingers", lambda r, a: r.volts.min()),
        ("most_volts", "V", "largest reading of a photodiode over fingers", lambda r, a: -r.volts.max()),
        ("adc_headroom", "1", "full scale over the largest reading; 1 is saturated",
         lambda r, a: a.adc_range_v / r.volts.max()),
        ("least_snr", "1", "least reading over its noise in one sample", lambda r, a: (
            r.volts / np.sqrt(r.noise_v2)).min()),
        ("crosstalk", "1", "largest part of a photodiode's light that was never in the bed",
         lambda r, a: -r.crosstalk.max()),
    ):  # fmt: skip
        values = []
        for layout, one in zip(layouts, judged, strict=True):
            each = [pick(_first(r), layout.scene.electronics) for by_led in one.volts for r in by_led]
            values.append(abs(min(each)))
        add(name, ("layout",), values, units, text)


def chosen(result: xr.Dataset) -> Scene:
    """The best layout as a scene."""
    return parse_scene(str(result.scene.values[0]), name="the best layout")


def outline(result: xr.Dataset) -> list[tuple[float, float]]:
    """Corners of the board's outline, as asked for or as the best layout has it. [mm]"""
    asked = parse_scene(str(result.attrs["scene"]), name="the scene").placement
    if asked is not None and asked.outline_mm is not None:
        return list(asked.outline_mm)
    r = chosen(result).layout.outline
    return [(r.u_min, r.v_min), (r.u_max, r.v_min), (r.u_max, r.v_max), (r.u_min, r.v_max)]


def rows(result: xr.Dataset) -> list[dict[str, Any]]:
    """The ranking, best first; layouts whose intervals overlap that of the best share its rank."""
    named: tuple[str, ...] = (
        "force_resolution_n",
        "force_resolution_n_stderr",
        "force_resolution_low_n",
        "force_resolution_high_n",
    )
    named += ("least_volts", "most_volts", "adc_headroom", "least_snr", "crosstalk")
    out = []
    for i, layout in enumerate(result.layout.values):
        tied = bool(result.tied[i])
        row: dict[str, Any] = {
            "rank": 1 if tied else i + 1,
            "layout": str(layout),
            "origin": str(result.origin[i].item()),
        }
        row |= {"tied": tied and int(result.tied.sum()) > 1} | {name: float(result[name][i]) for name in named}
        row["condition_number"] = float(result.condition_number[i].max())
        row["known_split_n"] = float(result.known_split_n[i].max())
        for name in result.pressure.values:
            row[f"{name}_pressure_pa"] = float(result.pressure_resolution_pa[i].sel(pressure=name).max())
        out.append(row)
    return out


def gain(result: xr.Dataset) -> tuple[float, float] | None:
    """How many times finer the best resolves force than the paper's layout, and its standard error; None without it."""
    names = [str(name) for name in result.layout.values]
    if "paper" not in names:
        return None
    i = names.index("paper")
    score, error = result.force_resolution_n.values, result.force_resolution_n_stderr.values
    ratio = score[i] / score[0]
    spread = ratio * np.hypot(error[i] / score[i], error[0] / score[0]) if i else 0.0
    return float(ratio), float(spread)


def kicad_parts(scene: Scene, like: Scene) -> list[PlacedPart]:
    """A layout's LEDs and photodiodes as lines of a KiCad position file, all on the bottom, which faces the nail.

    like : the scene that was asked, whose parts lie as at a rotation of 0.
    """
    layout, parts = scene.layout, []

    def rotation(size: tuple[float, float], usual: tuple[float, float]) -> float:
        return 90.0 if size != usual and size == usual[::-1] else 0.0

    for i, (led, usual, area) in enumerate(zip(scene.leds, like.leds, layout.leds, strict=False), start=1):
        turn = rotation(led.size_mm, usual.size_mm)
        parts.append(PlacedPart(f"D{i}", led.part or led.name, "LED_die", area.center_mm, turn, "bottom"))
    for i, element in enumerate(layout.photodiodes, start=1):
        size = element.photodiode.size_mm
        turn = rotation(size, like.photodiodes[0].size_mm)
        width, length = size[::-1] if turn else size
        package = f"PD_{width:g}x{length:g}mm"
        parts.append(PlacedPart(f"PD{i}", element.name, package, element.area.center_mm, turn, "bottom"))
    return parts
