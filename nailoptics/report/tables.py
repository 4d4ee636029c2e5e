"""Tables of a result as HTML; each number carries its full value and is shown rounded to its error."""

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from ..tissue import bed_zone_name
from . import style
from .html import escaped, small, table
from .numbers import prefix, significant, with_error
from .readings import Reading

SATURATED = ' <span class="bad">saturated</span>'
# Less alpha D^2 than this over the whole touch: (8) is as straight in D^2 as (9), and its constants are not known.
STRAIGHT = 0.01

# A mean path below this is as good as none.
LEAST_PATH_MM = 1e-3


def number(value: float, text: str) -> str:
    """A number for people with its exact value for machines."""
    shown = escaped(text)
    return f'<data value="{value!r}">{shown}</data>' if math.isfinite(value) else shown


def readings_table(found: Sequence[Reading], hold_s: float) -> str:
    """The readings of every photodiode, LED by LED."""
    volts, letter = prefix(max((abs(r.rest_v) for r in found), default=0.0))
    change, change_letter = prefix(max((abs(r.peak_v) for r in found), default=0.0))
    noise, noise_letter = prefix(max((r.noise_rms_v for r in found), default=0.0))
    head = ["Photodiode", "Blood<br>zone", "Away from<br>LED [mm]", f"At rest<br>[{letter}V]"]
    head += [f"Change at<br>{significant(hold_s)} s [{change_letter}V]", "Change<br>[%]", "Sure by<br>[σ]"]
    head += [f"Largest<br>change [{change_letter}V]"]
    spread = any(math.isfinite(r.rest_spread) for r in found)
    head += ["At rest<br>spreads [%]", "Change<br>spreads [%]"] if spread else []
    head += [f"Noise,<br>rms [{noise_letter}V]", "Signal<br>to noise", "Resolves<br>[mN]"]
    rows = []
    for r, name in zip(found, _names(found), strict=True):
        distance = number(r.distance_mm, significant(r.distance_mm, 3))
        if r.saturated:
            at_limit = number(r.rest_v, significant(r.rest_v / volts))
            rows.append([name + SATURATED, escaped(r.zone), distance, at_limit, *["–"] * (len(head) - 4)])
            continue
        cells = [
            distance,
            number(r.rest_v, with_error(r.rest_v / volts, r.rest_stderr_v / volts)),
            number(r.change_v, with_error(r.change_v / change, r.change_stderr_v / change, sign=True)),
            number(r.change_percent, significant(r.change_percent, 3, sign=True)),
            number(r.sigmas, significant(r.sigmas, 2)),
            number(r.peak_v, significant(r.peak_v / change, 3, sign=True)),
            *(number(x, significant(100 * x, 2)) for x in (r.rest_spread, r.change_spread) if spread),
            number(r.noise_rms_v, significant(r.noise_rms_v / noise)),
            number(r.signal_to_noise, significant(r.signal_to_noise, 3)),
            number(r.resolution_n, significant(r.resolution_n * 1e3, 3)),
        ]
        rows.append([name, escaped(r.zone), *cells])
    return table(head, rows, kind="readings dense", groups=_groups(found))


def path_table(result: xr.Dataset, found: Sequence[Reading]) -> str:
    """Mean path of the detected light at rest in every absorber that it passes; empty where the engine cannot tell."""
    mean, stderr = result.mean_path_mm, result.mean_path_mm_stderr
    if not np.isfinite(mean).any():
        return ""
    passed = (mean + 2 * stderr.fillna(0) >= LEAST_PATH_MM).any(("led", "photodiode"))
    mean, stderr = mean.sel(absorber=passed), stderr.sel(absorber=passed)
    names = {bed_zone_name(k): f"bed, {escaped(zone)}" for k, zone in enumerate(result.zone.values)}
    head = ["Photodiode", *(f"{names.get(str(a), escaped(a))}<br>[mm]" for a in mean.absorber.values)]
    rows = []
    for r, name in zip(found, _names(found), strict=True):
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        cells = [name]
        for value, error in zip(mean.isel(here).values.tolist(), stderr.isel(here).values.tolist(), strict=True):
            # A path that is nothing beside a finger is not shown in powers of ten.
            cells.append(
                number(value, "< 0.001" if 0 <= value + 2 * error < LEAST_PATH_MM else with_error(value, error))
            )
        rows.append(cells)
    return table(head, rows, kind="paths", groups=_groups(found))


def fit_table(result: xr.Dataset, found: Sequence[Reading]) -> str:
    """Constants of Beer-Lambert (8) and Taylor (9) as fitted, with their misfit; below, what they could not determine.

    Where the readings do not bend, V0, V1 and alpha of (8) are not known one by one: such a fit is shown as straight.
    """
    largest_m2 = float(result.capillary_diameter_m.max()) ** 2
    fields = [
        ("beer_lambert_v0_v", "Beer–Lambert (8)<br>V<sub>0</sub> [mV]", 1e-3),
        ("beer_lambert_v1_v", "V<sub>1</sub><br>[mV]", 1e-3),
        ("beer_lambert_alpha_per_m2", "α<br>[10⁻³ µm⁻²]", 1e9),
        ("beer_lambert_residual_rms_v", "misfit,<br>rms [µV]", 1e-6),
        ("taylor_v0_v", "Taylor (9)<br>V′<sub>0</sub> [mV]", 1e-3),
        ("taylor_v1_v_per_m2", "V′<sub>1</sub><br>[µV µm⁻²]", 1e6),
        ("taylor_residual_rms_v", "misfit,<br>rms [µV]", 1e-6),
    ]
    rows = []
    marks: dict[str, str] = {}
    for r, name in zip(found, _names(found), strict=True):
        if r.saturated:
            rows.append([name + SATURATED, *["–"] * len(fields)])
            continue
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        note = str(result.fit_note.isel(here).item())
        mark = marks.setdefault(note, chr(ord("a") + len(marks) % 26)) if note else ""
        cells = [name + (f" <sup>{mark}</sup>" if mark else "")]
        level_v = abs(float(result.taylor_v0_v.isel(here)))
        for field, _, unit in fields:
            value, text = float(result[field].isel(here)), ""
            if f"{field}_stderr" in result:
                level = level_v / (largest_m2 if field.endswith("_per_m2") else 1.0) / unit
                text = with_error(value / unit, float(result[f"{field}_stderr"].isel(here)) / unit, scale=level)
            if text.endswith("?") and field.startswith("beer_lambert"):
                alpha_d2 = float(result.beer_lambert_alpha_per_m2.isel(here)) * largest_m2
                text = "straight" if 0 < alpha_d2 < STRAIGHT else "not known"
            cells.append(number(value, text or with_error(value / unit, 0.0, scale=level_v / unit)))
        rows.append(cells)
    notes = small(
        "± is the trace's standard error, whose noise all samples of a reading share; the misfit is no part of it."
    )
    notes += "".join(small(f"<sup>{mark}</sup> {escaped(note)}") for note, mark in marks.items())
    head = ["Photodiode", *(title for _, title, _ in fields)]
    return table(head, rows, kind="fits", groups=_groups(found)) + notes


def _groups(found: Sequence[Reading]) -> list[str]:
    return [f"LED {r.led}" for r in found]


def _names(found: Sequence[Reading]) -> list[str]:
    """The photodiode of every reading, beside the colour of its place along the nail."""
    order = list(dict.fromkeys(r.photodiode_index for r in found))
    colours = dict(zip(order, style.place_colours(len(order)), strict=True))
    swatch = '<span class="swatch" style="background:{}"></span>'
    return [swatch.format(colours[r.photodiode_index]) + escaped(r.photodiode) for r in found]
