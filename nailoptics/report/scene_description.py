"""What a scene asks for, in words: its touch, its blood and its body."""

from typing import Any

from ..scene import Scene
from ..scene.vessels import FACTORS
from ..sensor.exposure import EYE_M, EYE_W_PER_M2, SKIN_M, SKIN_W_PER_M2
from .html import texts
from .numbers import aligned, estimated

TEXTS = texts("scene")
CAUSES = TEXTS["causes"]


def touch_words(scene: Scene) -> str:
    """The touch of a scene."""
    touch = scene.touch
    steps = [step.force_n for step in touch.steps or ()]
    words = TEXTS["touch"][touch.profile].format(touch=touch, steps=len(steps), most_n=max(steps, default=0))
    if touch.profile == "protocol":
        return words
    if touch.recorded_proximal_pressure_pa is None:
        share = f"{100 * touch.proximal_share:g}"
        words += f", {TEXTS['share'].get(share, f'{share} % of it on the proximal pulp')}"
    else:
        words += ", as pressures on both sides"
    if touch.recorded_shear_n is not None or touch.shear_n:
        words += ", with shear" if touch.shear_n is None else f", with {touch.shear_n:g} N of shear"
    return words


def blood_words(scene: Scene) -> str:
    """The vessels of a scene, its zones and its oxygen."""
    blood = scene.blood
    words = f'vessels "{blood.parameters}"'
    changes = [f"{name} times {getattr(blood, name):g}" for name in FACTORS if getattr(blood, name) != 1.0]
    if blood.tuning is not None:
        changes += [f"{name} = {_by_bed(value)}" for name, value in blood.tuning.values().items()]
        changes += [f"{name} times {_by_bed(factor)}" for name, factor in (blood.tuning.factors or {}).items()]
    words += f" with {', '.join(changes)}" if changes else ""
    if blood.distal_reach:
        words += f", {100 * blood.distal_reach:g} % of the distal pressure on the whole bed"
    if scene.zone_count > 2 or blood.decay_length is not None:
        words += f", {scene.zone_count} zones along the nail"
    if blood.venous_so2 is None:
        return words + f", {100 * blood.so2:g} % saturated"
    return words + f", {100 * blood.so2:g} % saturated in arteries and {100 * blood.venous_so2:g} % in veins"


def _by_bed(value: float | tuple[float, float]) -> str:
    return "{:g} (proximal) and {:g} (distal)".format(*value) if isinstance(value, tuple) else f"{value:g}"


def body_words(scene: Scene) -> str:
    """What moves readings of a scene beside the touch; empty where nothing does."""
    body = scene.body
    if body is None:
        return ""
    parts = [f"{' and '.join(body.recorded)} recorded in {body.file}"] if body.recorded else []
    for name, wave in body.waves.items():
        rate = getattr(wave, "rate_per_min", None)
        parts.append(CAUSES.get(name, name) + (f", {rate:g} a minute" if rate else ""))
    parts += [words for words, is_there in (("drift", body.drift), ("motion of the sensor", body.motion)) if is_there]
    return ", ".join(parts)


def _led_line(led: dict[str, Any]) -> str:
    part, width = f" ({led['part']})" if "part" in led else "", f", {led['fwhm_nm']:g} nm wide"
    at = "at ({:g}, {:g}) mm".format(*led["position_mm"])
    at += f", rotated by {led['rotation_deg']:g} deg" if led.get("rotation_deg") else ""
    light = f"{led['wavelength_nm']:g} nm{width if led['fwhm_nm'] else ''}, {led['flux_mw']:g} mW"
    return f"LED {led['name']}{part}: {light}, {at}"


def _board_lines(report: dict[str, Any]) -> list[str]:
    """The photodiodes, their readings and the noise of these."""
    u, v = report["board_mm"]
    of = f", and {report['not_wired']} that are not wired" if report["not_wired"] else ""
    places = {
        diode["name"]: {
            "part": diode.get("part", ""),
            "place (u, v) [mm]": "({:.3g}, {:.3g})".format(*diode["position_mm"]),
            "size [mm]": "{:.3g} x {:.3g}".format(*diode["size_mm"]),
            "rotation [deg]": f"{diode['rotation_deg']:g}",
        }
        for diode in report["photodiodes"]
    }
    readings, noise = [], []
    for pair in report["pairs"]:
        names = {"LED": pair["led"], "photodiode": pair["photodiode"]}
        row = names | places[pair["photodiode"]] | {"distance [mm]": f"{pair['distance_mm']:.2f}"}
        row["gain [Mohm]"] = f"{1e-6 * pair['feedback_ohm']:.3g}"
        readings.append(row | {"reading [V]": estimated(pair, "volts")})
        rms = {f"{CAUSES.get(cause, cause)} [uV]": f"{1e6 * rms_v:.2g}" for cause, rms_v in pair["noise_v"].items()}
        noise += [names | rms] if rms else []
    lines = [f"photodiodes: {len(places)}{of}, on a board of {u:.3g} x {v:.3g} mm"]
    if not readings:
        lines += [f"  {line}" for line in aligned([{"photodiode": name} | row for name, row in places.items()])]
    for title, rows in (("reading at rest:", readings), ("noise of one sample, rms:", noise)):
        lines += [title, *(f"  {line}" for line in aligned(rows))] if rows else []
    lines += [f"noise: {report['noise']}"] if report["noise"] else []
    # The LED that is brightest on the nail, beside the limits of IEC 62471, and what one of its readings takes.
    exposures, worst = report["exposure"], max(report["exposure"], key=lambda row: row["nail_w_per_m2"])
    skin, eye_w_per_m2 = worst["nail_w_per_m2"] / SKIN_W_PER_M2, sum(row["eye_w_per_m2"] for row in exposures)
    charge = "" if worst["charge_c"] is None else f" and {1e6 * worst['charge_c']:.2g} uC"
    numbers = {"skin_mm": 1e3 * SKIN_M, "skin": 100 * skin, "eye_w_per_m2": eye_w_per_m2, "charge": charge}
    numbers |= {"eye_m": EYE_M, "eye_limit": EYE_W_PER_M2, "light_uj": 1e6 * worst["light_j"]}
    return [*lines, TEXTS["exposure"].format(**worst | numbers)]


def check_lines(report: dict[str, Any]) -> list[str]:
    """The report of `check` on a scene."""
    lines = [f"{report.get('scene', 'scene')}: the scene is valid", *map(_led_line, report.get("leds", ()))]
    lines += _board_lines(report) if "photodiodes" in report else []
    if assumed := report.get("assumed"):
        words = ", ".join(f"{name} = {str(value).lower()}" for name, value in assumed.items())
        lines.append(TEXTS["assumed"].format(words))
    for layout in report.get("candidates", ()):
        lines.append(f"layout {layout['name']}: {layout['leds']} LEDs, {layout['photodiodes']} photodiodes")
    lines += [f"{name}: {report[name]}" for name in ("touch", "blood", "body") if report.get(name)]
    for file, refs in report.get("ignored", {}).items():
        parts = "part" if len(refs) == 1 else "parts"
        shown = ", ".join(refs[:8]) + (", ..." if len(refs) > 8 else "")
        lines.append(f"ignored: {len(refs)} {parts} of {file} ({shown})" if refs else f"ignored: nothing of {file}")
    if "triangles" in report:
        names = ", ".join(name for name in report["regions"] if name != "air")
        lines.append(f"geometry: {report['triangles']} triangles between the air and {names}")
    lines += [f"warning: {line}" for line in report.get("warnings", ())]
    if report.get("two_balances_n"):
        lines.append(TEXTS["two_balances"].format(*report["two_balances_n"]))
    return lines
