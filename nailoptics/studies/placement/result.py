"""What a placement resolves, as a Dataset, as rows of a table, and the best layout as a scene and as KiCad parts."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import PhotonMap, map_dataset
from ...light.transfer import provenance
from ...scene import Scene, parse_scene, to_toml
from ...scene.importers.outlines import Outline
from ...scene.importers.positions import PlacedPart
from ...scene.parts import ROOM
from ...scene.rectangles import Rectangle
from ...sensor import information
from ...sensor.information import OperatingPoint, Response
from ...statistics import MIN_EFFECTIVE_TERMS, jackknife, leave_one_out
from ...variables import Estimate, Variables, described, jackknifed
from .boards import UNFITTED, rules, straightened
from .candidates import CandidateLayout
from .objective import ForceResolution, LayoutScore, resolution_stderr_n, ties
from .photon_maps import FingerCondition, PhotonMapCache
from .row_design import SearchedSite

# Spacing of the places at which one more photodiode is tried.
PLACES_MM = 0.2
# An error that is less than this fraction of its value is none.
ROUNDING = 1e-9
PRESSURES = ("proximal", "distal")
# A reading that is below the converter's limit with less than this probability may be at it.
BELOW_LIMIT = 0.999
# The photons' noise adds to the information, so that a resolution comes out too fine: on the shipped oximeter by 2 %
# where its relative error is 0.22, by a fifth where it is 0.47. Beyond this that is said.
ROUGH = 0.25


def as_dataset(
    scene: Scene,
    layouts: Sequence[CandidateLayout],
    scores: Sequence[LayoutScore],
    cache: PhotonMapCache,
    searched: Sequence[SearchedSite],
    checked: xr.Dataset,
    attributes: dict[str, Any],
) -> xr.Dataset:
    """Everything of a placement; layouts come best first.

    cache : light by which the layouts were evaluated.
    checked : what else is known of the best layout, of which `verify_layout` has the attributes.
    """
    best, conditions, maps = layouts[0].scene, cache.conditions, cache.traced_board(layouts[0].board).maps[0]
    budgets = [
        [information.force_budget_n(of_leds, c.point) for of_leds, c in zip(by_finger, conditions, strict=True)]
        for by_finger in (score.responses for score in scores)
    ]
    data = (
        described(__package__, force_budget_n=[[[*budget.values()] for budget in fingers] for fingers in budgets])
        | _ranking(layouts, scores, conditions)
        | _extremes(layouts, scores)
        | _sites(searched)
    )
    coordinates = {
        "layout": [layout.name for layout in layouts],
        "finger": [condition.case.name for condition in conditions],
        "pressure": list(PRESSURES),
        "axis": ["u", "v"],
        "cause": [*budgets[0][0]],
        **({"searched_led": [led.name for led in scene.leds]} if searched else {}),
    }
    result = xr.Dataset(data | _predicted(scores[0].responses[0]), coords=coordinates)
    result = result.merge(map_dataset([led.name for led in best.leds], maps)).merge(checked)
    result = result.merge(_photodiode_anywhere(best, maps, conditions[0].point))
    traced = {name: attributes[name] for name in ("backend", "photons")}
    made = provenance(scene, engine="photons", seeds=str(attributes["seed"]), **traced)
    more = {"adc_range_v": best.electronics.adc_range_v, "title": "nailoptics: layouts ranked by force resolution"}
    rank_by = rules(scene).rank_by
    words = ", ".join(f"{aim} {part:g}" for aim, part in rank_by.items()) if isinstance(rank_by, dict) else rank_by
    more |= {"bandwidth_hz": best.electronics.bandwidth_hz, "rank_by": words}
    result.attrs = made | attributes | checked.attrs | more
    return result


def _ranking(
    layouts: Sequence[CandidateLayout], scores: Sequence[LayoutScore], conditions: Sequence[FingerCondition]
) -> Variables:
    """Each layout with what it resolves, over the fingers and on each; were the body still, too, if there is one."""
    points = [condition.point for condition in conditions]
    data = _resolution("force_resolution", "finger_resolution", [score.force for score in scores])
    if any(point.body is not None for point in points):
        data |= _resolution(
            "electronics_resolution", "finger_electronics_resolution", [score.electronics for score in scores]
        )
        data |= described(__package__, physiological_noise_force_n=scores[0].force.floors_n)
    if over_touches := [score.over_touches for score in scores if score.over_touches is not None]:
        data |= _resolution("force_error", "finger_force_error", over_touches)
        data |= described(__package__, force_error_floor_n=over_touches[0].floors_n)
    if spo2 := [score.spo2_percent for score in scores if score.spo2_percent is not None]:
        data |= described(__package__, spo2_error_percent=jackknifed(np.stack(spo2, 1)))
    per_pa2 = np.array([score.information_per_pa2[0] for score in scores])
    fixed = [information.fixed_ratio_resolution_n(per_pa2[:, k], point) for k, point in enumerate(points)]
    return data | described(
        __package__,
        tied=ties(scores),
        share_resolution=jackknifed(np.stack([score.share for score in scores], 1)),
        origin=[layout.origin for layout in layouts],
        scene=[to_toml(layout.scene) for layout in layouts],
        fixed_ratio_resolution_n=np.stack(fixed, 1),
        pressure_resolution_pa=information.pressure_resolution_pa(per_pa2),
        condition_number=[[max(map(information.condition_number, leds)) for leds in s.responses] for s in scores],
    )


def _resolution(name: str, on_finger: str, resolutions: Sequence[ForceResolution]) -> Variables:
    """Force resolutions of all layouts over the fingers, with their intervals, and on each finger."""
    low, high = np.array([r.interval_n for r in resolutions]).T
    errors = [resolution_stderr_n(r.all_n, r.floor_n) for r in resolutions]
    finger_errors = [resolution_stderr_n(r.fingers_n, r.floors_n) for r in resolutions]
    columns = {
        f"{name}_n": Estimate([r.all_n[0] for r in resolutions], errors),
        f"{name}_low_n": low,
        f"{name}_high_n": high,
        f"{on_finger}_n": Estimate([r.fingers_n[0] for r in resolutions], finger_errors),
    }
    return described(__package__, **columns)


def _extremes(layouts: Sequence[CandidateLayout], scores: Sequence[LayoutScore]) -> Variables:
    """Amplifier output, headroom, signal to noise and shunted light of the worst photodiode on any finger."""
    # The first of each is that by all photons.
    volts, light_v, noise_v, shunted = (
        [np.array([getattr(read, name)[0] for by_led in score.responses for read in by_led]) for score in scores]
        for name in ("amplified_v", "light_v", "noise_v", "shunted_fraction")
    )
    most = np.array([values.max() for values in volts])
    below = [min(np.min(read.unsaturated) for by_led in score.responses for read in by_led) for score in scores]
    return described(
        __package__,
        may_saturate=np.array(below) < BELOW_LIMIT,
        least_volts=[values.min() for values in volts],
        most_volts=most,
        adc_headroom=np.array([layout.scene.electronics.adc_range_v for layout in layouts]) / most,
        least_snr=[(v / n).min() for v, n in zip(light_v, noise_v, strict=True)],
        shunted_fraction=[values.max() for values in shunted],
    )


def _sites(searched: Sequence[SearchedSite]) -> Variables:
    """The sites of the LEDs that the search tried."""
    # The best layout may be a given one with fewer LEDs, such as the paper's.
    leds = len(searched[0].places_mm) if searched else 0
    return described(
        __package__,
        led_site_mm=np.array([site.places_mm for site in searched]).reshape(len(searched), leds, 2),
        led_site_resolution_n=np.array([site.resolution_n for site in searched], float),
        led_site_side=np.array([site.row.side or "" for site in searched], str),
    )


def _predicted(by_led: Sequence[Response]) -> Variables:
    """What each photodiode of the best layout reads, by the map of its bare board.

    Of fewer than 25 effective photons no standard error is known.
    """
    data: Variables = {}
    for name, field in {"volts": "amplified_v", "shunted_fraction": "shunted_fraction", "zone_v": "zone_v"}.items():
        values, errors = jackknifed(np.stack([getattr(read, field) for read in by_led], 1))
        # Where no photon came the dark current alone is read, the same by every group of them.
        known = (errors > ROUNDING * np.abs(values)) & (MIN_EFFECTIVE_TERMS * errors**2 <= values**2)
        data |= described(__package__, **{f"predicted_{name}": Estimate(values, np.where(known, errors, np.nan))})
    return data | described(__package__, predicted_noise_v=[read.noise_v[0] for read in by_led])


def _photodiode_anywhere(scene: Scene, maps: Sequence[PhotonMap], point: OperatingPoint) -> xr.Dataset:
    """What one more photodiode would read by itself, wherever it lies on the board."""
    photodiode, outline = straightened(scene.photodiodes[0]).model_copy(update=UNFITTED), maps[0].outline
    die = Rectangle.around("", (0.0, 0.0), photodiode.size_mm, photodiode.rotation_deg)
    half_u, half_v = die.u_max, die.v_max
    place_u = np.arange(outline.u_min + half_u, outline.u_max - half_u + 1e-9, PLACES_MM)
    place_v = np.arange(outline.v_min + half_v, outline.v_max - half_v + 1e-9, PLACES_MM)
    u, v = np.meshgrid(place_u, place_v, indexing="ij")
    areas = np.stack([u - half_u, u + half_u, v - half_v, v + half_v], -1).reshape(-1, 4)
    noise, resolution, error = [], [], []
    for led, light in enumerate(maps):
        read = information.response(leave_one_out(light.over(areas)), scene, led, photodiode, point, replicates=True)
        noise.append(read.noise_v[0].reshape(u.shape))
        with np.errstate(divide="ignore", invalid="ignore"):
            replicates = information.fixed_ratio_resolution_n(information.fisher_information(read), point)
            error.append((replicates[0] * jackknife(np.log(replicates))).reshape(u.shape))
        resolution.append(replicates[0].reshape(u.shape))
    places = Estimate(resolution, error)
    return xr.Dataset(
        described(__package__, place_noise_v=noise, place_resolution_n=places, place_u=place_u, place_v=place_v)
    )


def chosen(result: xr.Dataset) -> Scene:
    """The best layout as a scene, without the time that its search was given."""
    scene = parse_scene(str(result.scene.values[0]), name="the best layout")
    return scene.model_copy(update={"accuracy": scene.accuracy.model_copy(update={"max_seconds": None})})


def outline(requested: Scene, layout: Scene) -> Outline:
    """The board's outline, as a scene requests it or as a layout has it."""
    if (placement := rules(requested)).outline_mm is not None:
        return Outline(placement.outline_mm, placement.outline_holes_mm)
    return Outline(layout.layout.outline.corners_mm)


def rows(result: xr.Dataset) -> list[dict[str, Any]]:
    """The ranking, best first; layouts whose intervals overlap that of the best share its rank."""

    def of(*names: str) -> dict[str, np.ndarray]:
        """The worst of each on any finger."""
        return {name: result[name].max({"finger"} & {*result[name].dims}).values for name in names if name in result}

    tied, force_n, ends = result.tied.values, result.force_resolution_n, ("n", "n_stderr", "low_n", "high_n")
    table = {"rank": np.where(tied, 1, 1 + np.arange(len(tied))), "layout": result.layout.values}
    table |= {"origin": result.origin.values}
    scenes = [parse_scene(str(text), name="a layout") for text in result.scene.values]
    table["photodiodes"] = np.array([len(scene.layout.photodiodes) for scene in scenes])
    table["led_power_mw"] = np.array([sum(led.flux_mw for led in scene.leds) for scene in scenes])
    table |= of(*(f"{force}_{end}" for force in ("force_error", "force_resolution") for end in ends))
    table |= of("least_volts", "most_volts", "adc_headroom", "may_saturate", "least_snr", "shunted_fraction")
    # The body's own part is known and would hide the error of the photons.
    by_light = next(name for name in ("electronics_resolution_n", "force_resolution_n") if name in result)
    if by_light != "force_resolution_n":
        table["electronics_rank"] = 1 + (result[by_light].values < result[by_light].values[:, None]).sum(1)
        table |= of(*(f"electronics_resolution_{end}" for end in ends))
    table["roughly_known"] = (result[f"{by_light}_stderr"] > ROUGH * result[by_light]).values
    table |= of("share_resolution", "share_resolution_stderr", "spo2_error_percent", "spo2_error_percent_stderr")
    # The priors count around the fingers, not for each person.
    for end in ("", "_stderr") if "resolution_spread" in result and "people_off" not in result else ():
        table[f"force_resolution_spread_n{end}"] = (force_n * result[f"resolution_spread{end}"]).values
    table |= of("median_resolution_n", "median_resolution_n_stderr", "worst_resolution_n", "people_off")
    table |= {name: result[name].values for name in ("worst_person", "worst_reason") if name in result}
    table |= {"tied": tied & (tied.sum() > 1)} | of("condition_number", "fixed_ratio_resolution_n")
    pressures_pa = result.pressure_resolution_pa.max("finger")
    table |= {f"{name}_pressure_pa": pressures_pa.sel(pressure=name).values for name in PRESSURES}
    return [dict(zip(table, row, strict=True)) for row in zip(*(col.tolist() for col in table.values()), strict=True)]


def budgets(result: xr.Dataset) -> list[dict[str, Any]]:
    """The force resolution of the best layout and of those that the search did not make, on the finger where each is
    worst, or for the person by whom it is ranked: total, every layout's floor, causes, which add in squares. [N]"""
    by_layout, above_n = [], result.finger_resolution_n - result.force_resolution_n
    fingers = abs(above_n).argmin("finger") if "people_off" in result else above_n.argmax("finger")
    for i in [0, *(np.flatnonzero(result.origin.values[1:] != "searched") + 1)]:
        layout = result.isel(layout=i, finger=int(fingers[i]))
        parts = dict(zip(result.cause.values.tolist(), layout.force_budget_n.values.tolist(), strict=True))
        floor_n = float(np.nan_to_num(layout.get("physiological_noise_force_n", 0.0)))
        if "waves" in parts:
            # Waves are followed less than the floor where pressures are hardly distinguished: "split" has the rest.
            above_n2 = parts["waves"] ** 2 - floor_n**2
            parts["split"] = max(parts["split"] ** 2 + min(above_n2, 0.0), 0.0) ** 0.5
            parts["waves"] = max(above_n2, 0.0) ** 0.5
        total_n = float(np.hypot(floor_n, np.hypot.reduce([*parts.values()])))
        by_layout.append({"layout": str(layout.layout.values), "total": total_n, "floor": floor_n} | parts)
    return by_layout


def gains(result: xr.Dataset) -> dict[str, tuple[float, float]]:
    """How many times as finely the best resolves force, over touches where these rank, as each other layout that the
    search did not make, the user's first; with its standard error."""
    force = "force_error_n" if "force_error_n" in result else "force_resolution_n"
    score, error = result[force].values, result[f"{force}_stderr"].values
    ratio = score / score[0]
    spread = ratio * np.hypot(error / score, error[0] / score[0])
    users_first = np.argsort(result.origin.values != "given", kind="stable")
    others = [i for i in users_first if i and result.origin[i] != "searched"]
    return {str(result.layout.values[i]): (float(ratio[i]), float(spread[i])) for i in others}


def kicad_parts(scene: Scene) -> list[PlacedPart]:
    """A layout's LEDs and photodiodes as lines of a KiCad position file, all on the bottom, which faces the nail.

    References are those of the file that the parts came from; else D1, PD1 and so on, with the part's name as value.
    """
    layout, parts = scene.layout, []
    known = any(led.reference for led in scene.leds) or any(photodiode.reference for photodiode in scene.photodiodes)
    for i, (led, area) in enumerate(zip(scene.leds, layout.leds, strict=True), start=1):
        ref = led.reference or (led.name if known else f"D{i}")
        value = led.part if led.part and led.reference else led.name
        drawn = {room: getattr(led, room) for room in ROOM}
        parts.append(PlacedPart(ref, value, "LED_die", area.center_mm, led.rotation_deg % 360, "bottom", **drawn))
    for i, element in enumerate(layout.photodiodes, start=1):
        die = element.photodiode
        (width, length), turn = die.size_mm, die.rotation_deg % 360
        # An array is one part of the file; each of its elements is written by itself.
        own_reference = die.reference and die.reference + element.name.removeprefix(die.name)
        ref = own_reference or (element.name if known else f"PD{i}")
        package, drawn = f"PD_{width:g}x{length:g}mm", {room: getattr(die, room) for room in ROOM if die.elements == 1}
        parts.append(PlacedPart(ref, element.name, package, element.area.center_mm, turn, "bottom", **drawn))
    return parts
