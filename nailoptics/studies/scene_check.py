"""What a scene asks for, in numbers, and everything in it that a command would refuse, by a short trace."""

import math
from functools import partial
from typing import Any

import numpy as np

from ..display import Displayed
from ..errors import InputError
from ..hemodynamics.for_scene import BloodModel, blood_model
from ..hemodynamics.parameters import implausible_constants
from ..light import backend, optics
from ..light.detect import rough_readings, unseen_leds
from ..scene import Scene, SceneIn, as_scene
from ..sensor import electronics
from ..sensor.ambient import ambient_bound_a
from ..sensor.electronics import NoiseBudget
from ..sensor.exposure import SKIN_W_PER_M2, exposures
from ..sensor.information import noise_by_cause, operating_point, scene_responses
from ..sensor.volts import with_fitted_resistors
from .placement import boards, candidates

# Over the priors of its finger a reading of the shipped prototype varies by up to 17 % (standard deviation), and the
# short trace by 5 %: from this fraction of the range on, three of both below its end, a reading may be full.
MAY_BE_FULL = 0.6
# Causes of noise in stage and converter; relative steps of either zone's blood; what "auto" must gain to be named.
ELECTRONIC = tuple(name.removesuffix("_v2") for name in NoiseBudget._fields)
BLOOD_STEP, WORTH_SAYING = 0.5, 1.2
# What lies on a board and below it, which no file of a layout program says.
BUILD = ("kapton_um", "clear_epoxy_um", "adhesive_um", "barrier", "cover_um")
# Forces beside which a change of posture is shown as a false one. [N]
POSTURE_FORCES_N = (0.1, 0.5)


class SceneCheck(Displayed, dict[str, Any]):
    """Results of a check of a scene, by name."""

    def __init__(self, scene: Scene, report: dict[str, Any]) -> None:
        super().__init__(report)
        self.scene = scene


def check(scene: SceneIn) -> SceneCheck:
    """What a scene reads, lights and ignores, and what may not be as its author wants it.

    Returns: leds, photodiodes, pairs (distances between them, readings by a short trace, their noise by cause; none
        without a backend that compiles kernels), candidates, ignored references of files, and warnings in words.

    Raises: InputError for what simulate, trace, compare or place would refuse, with the field of the scene.
    """
    scene = as_scene(scene)
    for led in range(len(scene.leds)):
        optics.check_line(scene, led)
    shown = {"name", "part", "wavelength_nm", "fwhm_nm", "flux_mw", "size_mm", "position_mm", "rotation_deg"}
    leds = [led.model_dump(mode="json", exclude_none=True, include=shown) for led in scene.leds]
    report = SceneCheck(scene, {"leds": leds, "warnings": _beyond_current(scene)})
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
    report["warnings"] += boards.misfits(scene) + boards.courtyard_overlaps(scene) + _beyond_the_nail(scene)
    report["warnings"] += unseen_leds(scene) + implausible_constants(scene) + _posture(model := blood_model(scene))
    blood, pairs = np.maximum(model.over_touch().blood_fraction.values.T, 0.0), list[dict[str, Any]]()
    if backend.choose("auto").jit:
        pairs = _pairs(with_fitted_resistors(scene), blood)
    else:
        report["warnings"].append("readings need a backend that compiles kernels (nailoptics doctor), and are left out")
    report |= {"pairs": pairs, "noise": _limits(pairs), "exposure": exposures(scene)}
    report["warnings"] += _saturation(scene, pairs)
    over = [one["led"] for one in report["exposure"] if one["nail_w_per_m2"] > SKIN_W_PER_M2]
    text = f"exposure: more than skin's {SKIN_W_PER_M2:.3g} W/m^2 over 10 s below"
    report["warnings"] += [f"{text} {led}" for led in over]
    two = model.bistable_forces_n()
    report["two_balances_n"] = [float(two.min()), float(two.max())] if two.size else None
    if scene.placement is not None:
        report["candidates"] = _candidates(scene)
        ignored = {c.positions or c.kicad: list(c.unmapped) for c in scene.placement.candidates if c.unmapped}
        report["ignored"] = report.get("ignored", {}) | ignored
    return report


def _posture(model: BloodModel) -> list[str]:
    """The false force that the hand's height and venous pressure make, beside some forces."""
    if model.body is None or not (model.body.hand_height_m or model.body.venous_pressure_pa is not None):
        return []
    false_n = [model.posture_force_n(force_n) for force_n in POSTURE_FORCES_N]
    shown = " and ".join(f"{n:+.2g} N at {at:g} N" for n, at in zip(false_n, POSTURE_FORCES_N, strict=True))
    return [f"body: hand_height_m and venous_pressure_pa are a false force of {shown}, if rest was read without them"]


def _beyond_current(scene: Scene) -> list[str]:
    """LEDs that are driven beyond what their parts bear."""
    lines = []
    for led in scene.leds:
        if (now_ma := led.current_ma or 0.0) > (most_ma := led.max_current_ma or math.inf):
            text = f"{led.name} needs {now_ma:.3g} mA for {led.flux_mw:.3g} mW, beyond the {most_ma:.3g} mA of its part"
            lines.append(f"leds: {text}; set flux_mw to {math.floor(100 * led.flux_mw * most_ma / now_ma) / 100:g}")
    return lines


def _beyond_the_nail(scene: Scene) -> list[str]:
    """What of a board file's outline the model leaves out."""
    if scene.board.outline_mm is None:
        return []
    ends, corners = scene.layout.outline.corners_mm[::2], np.add(scene.board.outline_mm, scene.board.center_mm)
    reach_mm = float(np.max([ends[0] - corners.min(axis=0), corners.max(axis=0) - ends[1]]))
    text = f"board: its outline reaches {reach_mm:.2g} mm beyond the nail, where the model of the light ends it"
    return [text] if reach_mm > 1e-6 else []


def _pairs(scene: Scene, blood_fraction: np.ndarray) -> list[dict[str, Any]]:
    """Every LED with every photodiode: their distance, the reading at rest and at most over the touch by a short trace,
    the resistor and one that fits, with how many times less noise it leaves beside the light, and the noise of one
    sample by cause, in the upper end of the 95 % interval of the scene's ambient light.

    blood_fraction : (t, zones) float. Over the touch, from rest on.
    """
    layout, stage, rules, pairs = scene.layout, scene.electronics, boards.rules(scene), list[dict[str, Any]]()
    at, near, ambient_a = None, blood_fraction[:0], ambient_bound_a(scene)
    if scene.zone_count == 2:
        at = operating_point(scene, rules.force_n, since_rest_s=rules.since_rest_s)
        near = at.blood_fraction * (1 + BLOOD_STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]))
    read = rough_readings(scene, np.concatenate([blood_fraction, near]))
    over_touch, nearby = np.split(read.fraction, [len(blood_fraction)], axis=-1)
    noise: list[dict[str, np.ndarray]] = [{}] * len(scene.leds)
    if at is not None:
        steps = np.maximum(2 * BLOOD_STEP * at.blood_fraction, np.finfo(float).tiny)  # 0 without blood
        slopes = (nearby[..., 1::2] - nearby[..., 2::2]) / steps
        # The shunted part makes no noise of its own.
        values = np.concatenate([nearby[..., :1], np.zeros_like(nearby[..., :1]), slopes], -1)
        noise = [noise_by_cause(one, at.body) for one in scene_responses(scene, values, at, ambient_a=ambient_a)]
    auto: dict[str, Any] = {"electronics": stage.model_copy(update={"feedback_ohm": "auto"})}
    auto |= {"photodiodes": tuple(p.model_copy(update=boards.UNFITTED) for p in scene.photodiodes)}
    fitted_layout = with_fitted_resistors(scene.model_copy(update=auto)).layout
    photodiodes, fitted = ([e.photodiode for e in one.photodiodes] for one in (layout, fitted_layout))
    ohm, fitted_ohm = (electronics.stage_ohm(one, stage) for one in (photodiodes, fitted))
    for i, (led, die) in enumerate(zip(scene.leds, layout.leds, strict=True)):
        read_as = partial(electronics.read, over_touch[i].T, led, amplifier=stage, ambient_a=ambient_a)
        now, then = read_as(photodiodes), read_as(fitted)
        most_v = now.amplified_v.max(0)
        columns = {"volts": now.volts[0], "most_volts": most_v, "feedback_ohm": ohm, "fitted_ohm": fitted_ohm}
        columns["volts_stderr"] = electronics.volts_per_fraction(led, photodiodes, stage) * read.stderr[i, :, 0]
        columns["fitted_noise_gain"] = now.volts_noise_rms[0] / ohm * fitted_ohm / then.volts_noise_rms[0]
        columns["may_be_saturated"] = most_v > MAY_BE_FULL * stage.adc_range_v
        for j, element in enumerate(layout.photodiodes):
            pair: dict[str, Any] = {"led": led.name, "photodiode": element.name}
            pair |= {"distance_mm": math.dist(die.center_mm, element.area.center_mm)}
            pair |= {name: column[j].item() for name, column in columns.items()}
            pairs.append(pair | {"noise_v": {cause: rms_v[j].item() for cause, rms_v in noise[i].items()}})
    return pairs


def _saturation(scene: Scene, pairs: list[dict[str, Any]]) -> list[str]:
    """A warning of readings that may be saturated."""
    names = [f"{p['photodiode']} under {p['led']} ({p['most_volts']:.2g} V)" for p in pairs if p["may_be_saturated"]]
    if not names:
        return []
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    less = "" if scene.ambient is None else ", or the light of [ambient]"
    return [
        f"may be saturated, above {MAY_BE_FULL:.0%} of the converter's range of {scene.electronics.adc_range_v:g} V, "
        f'the margin for other fingers: {shown}; lower leds.flux_mw or electronics.feedback_ohm ("auto" fits it){less}'
    ]


def _limits(pairs: list[dict[str, Any]]) -> str:
    """How many readings the converter limits, and what a resistor that fits gains; empty where it limits none."""
    limited = [p for p in pairs if p["noise_v"] and p["noise_v"]["adc"] == max(p["noise_v"][k] for k in ELECTRONIC)]
    if not limited:
        return ""
    best = max(limited, key=lambda pair: pair["fitted_noise_gain"])
    text = f"of the electronics' noise the converter makes most in {len(limited)} of {len(pairs)} readings"
    mohm, gain = 1e-6 * best["fitted_ohm"], best["fitted_noise_gain"]
    if gain < WORTH_SAYING:
        return text
    return f'{text}; {mohm:.2g} Mohm on {best["photodiode"]} gives {gain:.2g} times less noise (feedback_ohm = "auto")'


def _candidates(scene: Scene) -> list[dict[str, Any]]:
    """The layouts that a search would rank; raises InputError for what it would refuse."""
    base, rules, described = boards.base_board(scene), boards.rules(scene), []
    boards.check_search(base, rules)
    for i, candidate in enumerate(rules.candidates):
        try:
            laid_out = candidates.candidate_scene(base, candidate)
            layout = candidates.candidate(candidate.name, laid_out, "given").scene.layout
        except InputError as error:
            raise InputError(f"placement.candidates[{i}]: {error}") from None
        described.append({"name": candidate.name, "leds": len(layout.leds), "photodiodes": len(layout.photodiodes)})
    return described
