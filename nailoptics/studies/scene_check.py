"""What a scene asks for, in numbers, and everything in it that a command would refuse; only ambient light is traced."""

import math
from typing import Any

import numpy as np

from ..errors import InputError
from ..hemodynamics.for_scene import blood_over_touch, forces_with_two_balances_n, vessels
from ..hemodynamics.parameters import beds, bounds
from ..light import backend, optics
from ..light.diffusion import DiffusionModel
from ..options import TraceOptions
from ..scene import Scene
from ..sensor import electronics
from ..sensor.ambient import trace_ambient
from ..sensor.information import posture_force_n
from ..statistics import Z95
from .placement import boards, candidates

# Layered diffusion predicts a reading within about 40 %: from this part of the range on it may be full.
MAY_BE_FULL = 0.6
# The paper's constants are orders of magnitude: a hundredfold beyond them a value is probably mistyped.
FAR_FROM_LIST = 100.0
# What lies on a board and below it, which no file of a layout program says.
BUILD = ("kapton_um", "clear_epoxy_um", "adhesive_um", "barrier", "cover_um")
# Forces beside which a change of posture is shown as a false one. [N]
POSTURE_FORCES_N = (0.1, 0.5)


def check_scene(scene: Scene) -> dict[str, Any]:
    """What a scene reads, lights and ignores, and what may not be as its author wants it.

    Returns: leds, photodiodes, pairs (distances between them and readings as layered diffusion predicts them),
        candidates, ignored references of files, and warnings in words.

    Raises: InputError for what simulate, trace, compare or place would refuse, with the field of the scene.
    """
    for led in range(len(scene.leds)):
        optics.check_line(scene, led)
    report: dict[str, Any] = {"leds": [_led(led) for led in scene.leds], "warnings": []}
    if scene.finger is None:
        return report
    layout = scene.layout
    for led, die in zip(report["leds"], layout.leds, strict=True):
        led["position_mm"] = list(die.center_mm)  # from the nail's centre, as the photodiodes'
    report["photodiodes"] = [
        {"name": e.name, "position_mm": list(e.area.center_mm), "size_mm": list(e.area.size_mm)}
        | {"rotation_deg": e.photodiode.rotation_deg}
        | ({"part": e.photodiode.part} if e.photodiode.part else {})
        for e in layout.photodiodes
    ]
    report["not_wired"] = len(layout.unwired)
    report["board_mm"] = list(layout.outline.size_mm)
    if scene.board.unmapped is not None:
        file = scene.board.kicad or scene.board.positions
        report["ignored"] = {str(file): list(scene.board.unmapped)}
        # No board file says them: what the scene does not say either is assumed.
        report["assumed"] = {
            name: getattr(scene.board, name) for name in BUILD if name not in scene.board.model_fields_set
        }
    report["warnings"] += _beyond_the_nail(scene) + _beyond_the_list(scene) + _posture(scene)
    if scene.ambient is not None and not backend.choose("auto").jit:
        report["warnings"].append("[ambient] is left out: it needs a backend that compiles kernels (nailoptics doctor)")
    course = blood_over_touch(scene)
    report["pairs"], full = _pairs(scene, course.blood_fraction.values.T)
    report["warnings"] += full
    two = forces_with_two_balances_n(scene)
    report["two_balances_n"] = [float(two.min()), float(two.max())] if two.size else None
    if scene.placement is not None:
        report["candidates"] = _candidates(scene)
        ignored = {c.positions or c.kicad: list(c.unmapped) for c in scene.placement.candidates if c.unmapped}
        report["ignored"] = report.get("ignored", {}) | ignored
    return report


def _posture(scene: Scene) -> list[str]:
    """The false force that the hand's height and venous pressure make, beside some forces."""
    if scene.body is None or not (scene.body.hand_height_m or scene.body.venous_pressure_pa is not None):
        return []
    false_n = [posture_force_n(scene, force_n) for force_n in POSTURE_FORCES_N]
    shown = " and ".join(f"{n:+.2g} N at {at:g} N" for n, at in zip(false_n, POSTURE_FORCES_N, strict=True))
    return [f"body: hand_height_m and venous_pressure_pa are a false force of {shown}, if rest was read without them"]


def _led(led: Any) -> dict[str, Any]:
    shown = ("name", "part", "wavelength_nm", "fwhm_nm", "flux_mw", "size_mm", "position_mm", "rotation_deg")
    return {name: value for name, value in led.model_dump(mode="json", exclude_none=True).items() if name in shown}


def _beyond_the_list(scene: Scene) -> list[str]:
    """Constants of the vessels farther from those that the paper lists than a factor of `FAR_FROM_LIST`."""
    far = []
    for name, (low, high) in bounds(factor=FAR_FROM_LIST).items():
        for value in beds(getattr(vessels(scene), name)):
            if not low <= value <= high:
                far.append(f"{name} = {value:g} (listed {math.sqrt(low * high):g})")
    if not far:
        return []
    return [
        f"blood.tuning: more than {FAR_FROM_LIST:g} times off the paper's list, whose orders of magnitude are right: "
        + ", ".join(dict.fromkeys(far))
    ]


def _beyond_the_nail(scene: Scene) -> list[str]:
    """What of a board file's outline the model leaves out."""
    corners = scene.board.outline_mm
    if corners is None or scene.board.size_mm is not None:
        return []
    outline, center = scene.layout.outline, scene.board.center_mm
    low = np.min(corners, axis=0) + center - (outline.u_min, outline.v_min)
    high = np.max(corners, axis=0) + center - (outline.u_max, outline.v_max)
    reach_mm = float(max(*-low, *high))
    if reach_mm < 1e-6:
        return []
    return [f"board: its outline reaches {reach_mm:.2g} mm beyond the nail, where the model of the light ends it"]


def _pairs(scene: Scene, blood_fraction: np.ndarray) -> tuple[list[dict[str, Any]], list[str]]:
    """Every LED with every photodiode: their distance, and the reading at rest and at most as diffusion tells it, in
    the upper end of the 95 % interval of the scene's ambient light."""
    layout, pairs, full = scene.layout, [], []
    ambient_a = np.zeros(len(layout.photodiodes))
    if scene.ambient is not None and backend.choose("auto").jit:
        ambient_a = np.array([1, Z95]) @ trace_ambient(scene, [scene.ambient], TraceOptions(), seed=0)[:2, 0]
    fractions = DiffusionModel(scene).readings(np.maximum(blood_fraction, 0.0))
    for led, die, rows in zip(scene.leds, layout.leds, fractions, strict=True):
        for element, row, current_a in zip(layout.photodiodes, rows, ambient_a, strict=True):
            read = electronics.read(row, led, element.photodiode, scene.electronics, ambient_a=current_a)
            most_v = float(read.amplified_v.max())
            pair: dict[str, Any] = {"led": led.name, "photodiode": element.name}
            pair |= {"distance_mm": math.dist(die.center_mm, element.area.center_mm), "volts": float(read.volts[0])}
            pairs.append(pair | {"may_be_saturated": most_v > MAY_BE_FULL * scene.electronics.adc_range_v})
            if pairs[-1]["may_be_saturated"]:
                full.append(f"{element.name} under {led.name} ({most_v:.2g} V)")
    if not full:
        return pairs, []
    shown = ", ".join(full[:4]) + (f" and {len(full) - 4} more" if len(full) > 4 else "")
    less = "" if scene.ambient is None else ", or the light of [ambient]"
    return pairs, [
        f"may be saturated, of {scene.electronics.adc_range_v:g} V: {shown}; lower leds.flux_mw or "
        f"electronics.feedback_ohm{less}"
    ]


def _candidates(scene: Scene) -> list[dict[str, Any]]:
    """The layouts that a search would rank; raises InputError for what it would refuse."""
    base, rules, described = boards.base_board(scene), boards.rules(scene), []
    boards.check_search(base, rules)
    for i, candidate in enumerate(rules.candidates):
        try:
            layout = candidates.candidate(
                candidate.name, candidates.candidate_scene(base, candidate), "given"
            ).scene.layout
        except InputError as error:
            raise InputError(f"placement.candidates[{i}]: {error}") from None
        described.append({"name": candidate.name, "leds": len(layout.leds), "photodiodes": len(layout.photodiodes)})
    return described
