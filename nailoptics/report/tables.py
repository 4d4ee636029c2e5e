"""Tables of a result as HTML; each number carries its full value and is shown rounded to its error."""

import html
import math
from collections.abc import Iterable, Sequence

import numpy as np
import xarray as xr

from . import style
from .numbers import prefix, significant, with_error
from .readings import Reading

Cell = str


def number(value: float, text: str) -> Cell:
    """A number for people with its exact value for machines."""
    shown = html.escape(text)
    return f'<data value="{value!r}">{shown}</data>' if math.isfinite(value) else shown


def readings_table(found: Sequence[Reading], hold_s: float, *, bound: bool) -> str:
    """The readings of every photodiode, LED by LED."""
    volts, letter = prefix(max((abs(r.rest_v) for r in found), default=0.0))
    change, change_letter = prefix(max((abs(r.change_v) for r in found), default=0.0))
    noise, noise_letter = prefix(max((r.noise_rms_v for r in found), default=0.0))
    head = [
        "Photodiode",
        "Blood<br>zone",
        "LED at<br>[mm]",
        f"At rest<br>[{letter}V]",
        f"Change at<br>{significant(hold_s)} s [{change_letter}V]",
        "Change<br>[%]",
        "Sure by<br>[σ]",
        f"Noise,<br>rms [{noise_letter}V]",
        "Signal<br>to noise",
        "Resolves<br>[mN]",
    ]
    order = _ranks(found)
    rows = []
    for r in found:
        full = ' <span class="bad">saturated</span>' if r.saturated else ""
        rows.append(
            (
                r.led,
                [
                    _swatch(order[r.photodiode_index], len(order)) + html.escape(r.photodiode) + full,
                    html.escape(r.zone),
                    number(r.distance_mm, significant(r.distance_mm, 3)),
                    number(r.rest_v, with_error(r.rest_v / volts, r.rest_stderr_v / volts)),
                    number(r.change_v, with_error(r.change_v / change, r.change_stderr_v / change, sign=True)),
                    number(r.change_percent, significant(r.change_percent, 3, sign=True)),
                    number(r.sigmas, ("> " if bound else "") + significant(r.sigmas, 2)),
                    number(r.noise_rms_v, significant(r.noise_rms_v / noise)),
                    number(r.signal_to_noise, significant(r.signal_to_noise, 3)),
                    number(r.resolution_n, significant(r.resolution_n * 1e3, 3)),
                ],
            )
        )
    return _table("readings", head, rows)


def path_table(result: xr.Dataset, found: Sequence[Reading]) -> str:
    """Mean path of the detected light in every absorber at rest; empty where the engine cannot tell."""
    mean, stderr = result.mean_path_mm, result.mean_path_mm_stderr
    if not np.isfinite(mean).any():
        return ""
    order = _ranks(found)
    zones = [str(z) for z in result.zone.values]
    names = {f"bed_{k}": f"bed,<br>{html.escape(zone)}" for k, zone in enumerate(zones, start=1)}
    head = ["Photodiode", *(f"{names.get(str(a), html.escape(str(a)))} [mm]" for a in result.absorber.values)]
    rows = []
    for r in found:
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        pairs = zip(mean.isel(here).values.tolist(), stderr.isel(here).values.tolist(), strict=True)
        name = _swatch(order[r.photodiode_index], len(order)) + html.escape(r.photodiode)
        rows.append((r.led, [name, *(number(value, _path(value, error)) for value, error in pairs)]))
    return _table("paths", head, rows)


def _path(value: float, error: float) -> str:
    """A mean path in mm; one that is nothing beside a finger is not told in powers of ten."""
    return "< 0.001" if 0 <= value + 2 * error < 1e-3 else with_error(value, error)


def fit_table(result: xr.Dataset, found: Sequence[Reading]) -> str:
    """Constants of (8) and (9) as fitted, with what they miss; below, what they could not determine."""
    order = _ranks(found)
    fields = [
        ("beer_lambert_v0_v", "(8) V<sub>0</sub><br>[mV]", 1e-3),
        ("beer_lambert_v1_v", "(8) V<sub>1</sub><br>[mV]", 1e-3),
        ("beer_lambert_alpha_per_m2", "(8) α<br>[µm⁻²]", 1e12),
        ("beer_lambert_residual_rms_v", "(8) misses,<br>rms [µV]", 1e-6),
        ("taylor_v0_v", "(9) V′<sub>0</sub><br>[mV]", 1e-3),
        ("taylor_v1_v_per_m2", "(9) V′<sub>1</sub><br>[mV µm⁻²]", 1e9),
        ("taylor_residual_rms_v", "(9) misses,<br>rms [µV]", 1e-6),
    ]
    rows = []
    marks: dict[str, str] = {}
    for r in found:
        here = {"led": r.led_index, "photodiode": r.photodiode_index}
        note = str(result.fit_note.isel(here).item()) if "fit_note" in result else ""
        mark = marks.setdefault(note, chr(ord("a") + len(marks) % 26)) if note else ""
        name = _swatch(order[r.photodiode_index], len(order)) + html.escape(r.photodiode)
        cells = [name + (f" <sup>{mark}</sup>" if mark else "")]
        for field, _, unit in fields:
            value = float(result[field].isel(here))
            if f"{field}_stderr" in result:
                text = with_error(value / unit, float(result[f"{field}_stderr"].isel(here)) / unit)
            else:
                text = significant(value / unit, 3)
            cells.append(number(value, text))
        rows.append((r.led, cells))
    notes = "".join(f"<p class='small'><sup>{mark}</sup> {html.escape(note)}</p>" for note, mark in marks.items())
    return _table("fits", ["Photodiode", *(title for _, title, _ in fields)], rows) + notes


def _ranks(found: Iterable[Reading]) -> dict[int, int]:
    """Rank along the nail of each photodiode, by its index."""
    return {j: rank for rank, j in enumerate(dict.fromkeys(r.photodiode_index for r in found))}


def _swatch(rank: int, count: int) -> str:
    return f'<span class="swatch" style="background:{style.place_colours(count)[rank]}"></span>'


def _table(name: str, head: Sequence[str], rows: Sequence[tuple[str, Sequence[Cell]]]) -> str:
    """A table whose rows are headed by their LED where there is more than one."""
    several = len({led for led, _ in rows}) > 1
    lines = [f'<div class="scroll"><table class="{name}"><thead><tr>']
    lines += [f"<th>{title}</th>" for title in head]
    lines.append("</tr></thead><tbody>")
    current = None
    for led, cells in rows:
        if several and led != current:
            lines.append(f'<tr class="group"><th colspan="{len(head)}">LED {html.escape(led)}</th></tr>')
            current = led
        first, *rest = cells
        lines.append(f'<tr><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>")
    lines.append("</tbody></table></div>")
    return "\n".join(lines)
