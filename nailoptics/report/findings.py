"""What a result says in words: what was simulated, what came out, what was reached."""

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..scene import Scene
from .numbers import quantity, significant
from .readings import Reading, hold_end
from .scene_words import blood_words, body_words


def title(scene: Scene | None) -> str:
    """What was simulated, in a few words."""
    if scene is None or scene.finger is None:
        return "Fingernail sensor"
    touch, digit = scene.touch, scene.finger.digit
    several = {"recorded": "A recorded touch", "steps": "Steps of force", "cycle": "Cycles of force"}
    kind = several.get(touch.profile, f"A {touch.profile} of {touch.force_n:g} N")
    return f"{kind} on {'an' if digit == 'index' else 'a'} {digit}{'' if digit == 'thumb' else ' finger'}"


def sentence(scene: Scene | None, result: xr.Dataset) -> str:
    """What was simulated, in one sentence."""
    leds, photodiodes = result.sizes["led"], result.sizes["photodiode"]
    waves = _list([f"{float(w):g}" for w in result.wavelength_nm]) + " nm"
    text = f"{leds} LED{'s' * (leds != 1)} ({waves}) and {photodiodes} photodiode{'s' * (photodiodes != 1)} on the nail"
    text += f"; force up to {float(result.force_n.max()):.3g} N"
    if duration := float(result.time[-1] - result.time[0]):
        text += f" within {duration:.3g} s"
    if scene is not None and scene.finger is not None:
        blood = scene.blood
        text += f"; blood {100 * blood.rest_blood_fraction:g}\u00a0% of the bed at rest, "
        text += blood_words(scene)
        if body := body_words(scene):
            text += f"; {body}"
    return text + "."


def findings(found: Sequence[Reading], result: xr.Dataset) -> list[tuple[str, str]]:
    """Key findings as (figure, words), the most wanted first."""
    lines: list[tuple[str, str]] = []
    several = result.sizes["led"] > 1
    found = [r for r in found if not r.saturated]

    def name(r: Reading) -> str:
        return f"{r.photodiode} under {r.led}" if several else r.photodiode

    for sign, word in ((-1, "fall"), (1, "rise")):
        moved = [r for r in found if sign * r.change_v > 0]
        if moved:
            r = max(moved, key=lambda r: abs(r.change_v))
            ratio = f"{significant(r.signal_to_noise)} times the noise of one sample"
            words = f"largest {word}: {name(r)}, {significant(r.change_percent, sign=True)} %, {ratio}"
            lines.append((quantity(r.change_v, "V", sign=True), words))
    resolved = [r for r in found if math.isfinite(r.resolution_n) and r.resolution_n > 0]
    if resolved:
        r = min(resolved, key=lambda r: r.resolution_n)
        words = f"force that one sample resolves at best (noise / slope): {name(r)}"
        lines.append((quantity(r.resolution_n, "N"), words))
    if any(r.change_v for r in found):
        lines.append(_signs(found, result))
    if "white_band_mm" in result:
        words = "wide is the white band at the tip at the end of the hold, where the bed holds less than half its blood"
        lines.append((f"{float(result.white_band_mm[hold_end(result)]):.1f}\u00a0mm", words))
    lines.append(_models(found, result))
    return lines


def warnings(found: Sequence[Reading], result: xr.Dataset) -> list[str]:
    """What the reader must know before trusting the numbers."""
    lines = []
    full = [f"{r.photodiode} under {r.led}" for r in found if r.saturated]
    if full:
        lines.append(
            f"The converter is at its limit: {_list(full)}. These volts do not tell the light; lower "
            "electronics.feedback_ohm or the LED's flux_mw, or raise electronics.adc_range_v."
        )
    if len(full) < len(found) and not any(r.change_v for r in found if not r.saturated):
        lines.append("No reading changes: the force does not change within the simulated time, or no blood moves.")
    return lines


def reached(result: xr.Dataset) -> list[tuple[str, str]]:
    """What was reached and what it took, as (name, value)."""
    attrs = result.attrs
    rows = {"Accuracy reached": str(attrs.get("accuracy_reached", ""))}
    if "photons" in attrs:
        rows["Photons"] = f"{int(attrs['photons']):,}".replace(",", "\u202f")
    rows["Engine"] = " on ".join(str(attrs[key]) for key in ("engine", "backend") if key in attrs)
    for key, label in (("wall_seconds", "Time taken"), ("cpu_seconds", "Processor time")):
        if key in attrs:
            rows[label] = f"{float(attrs[key]):.3g} s"
    return [(label, value) for label, value in rows.items() if value]


def _signs(found: Sequence[Reading], result: xr.Dataset) -> tuple[str, str]:
    """Whether the readings move the way that the paper saw: over the proximal half of the zones down, distally up."""
    zones = [str(name) for name in result.zone.values]
    right = [r for r in found if np.sign(r.change_v) == (1 if 2 * zones.index(r.zone) >= len(zones) else -1)]
    words = "readings move as in the paper, proximal ones down and distal ones up"
    least = min((r.sigmas for r in right), default=math.nan)
    if math.isfinite(least):
        words += f", by {significant(least, 2)} σ of the trace or more"
    wrong = [r.photodiode for r in found if r not in right]
    if right and 0 < len(wrong) < 4:
        words += f"; not {_list(wrong)}"
    return f"{len(right)} of {len(found)}", words


def _models(found: Sequence[Reading], result: xr.Dataset) -> tuple[str, str]:
    """How far Beer-Lambert (8) and Taylor (9) are from the traced light at worst, beside the noise."""
    told = ~result.saturated.any("time")
    worst = [float(result[f"{model}_residual_rms_v"].where(told).max()) for model in ("beer_lambert", "taylor")]
    noise = max((r.noise_rms_v for r in found), default=0.0)
    one, other, limit = (quantity(value, "V", digits=2) for value in (*worst, noise))
    return one, f"rms that Beer–Lambert (8) misses at worst; Taylor (9): {other}; noise of one sample: {limit}"


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
