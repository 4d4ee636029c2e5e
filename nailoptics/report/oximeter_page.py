"""Pages of an oximeter: forward from a scene, and back from a recording."""

from pathlib import Path
from typing import Any

import xarray as xr

from ..errors import InputError
from ..io import write_text
from ..scene import parse_scene
from . import maps, oximeter_figures
from .html import document, escaped, figure, section, small, table
from .numbers import polynomial, significant, with_error

PULSE = (
    "Each LED's reading over a beat, less its mean and less the dark slot, with the trace's 95 % interval. More blood, "
    "less light: the reading falls as the pulse arrives."
)
CURVE = (
    "R of every photodiode against the arteries' saturation, from one trace of each LED, with its 95 % interval, "
    "between the line of textbooks and one that was measured on fingers."
)
DISTURB = (
    "Bias of SpO2, displayed less true saturation, of an oximeter calibrated with the scene as it is, as one thing "
    "changes, with the 95 % interval of the trace."
)


def write_oximeter(result: xr.Dataset, path: Path) -> None:
    """Write the page of an oximeter, whole or not at all; raises WriteError."""
    write_text(path, page_of_oximeter(result))


def page_of_oximeter(result: xr.Dataset) -> str:
    """The page as text."""
    best = result.sel(photodiode=result.attrs["best"])
    a, b = best.linear.values
    cards = [
        (f"{significant(float(a), 4)} − {significant(-float(b), 3)} R", f"SpO2 in percent, {result.attrs['best']}"),
        (significant(float(best.ratio_at_rest), 3), f"R at a saturation of {100 * result.attrs['so2']:g} %"),
        (f"{significant(float(best.spo2_stderr), 2)} %", "standard error of SpO2 over 8 s"),
        (
            f"{significant(1e2 * float(best.perfusion_index[0]), 2)} % and "
            f"{significant(1e2 * float(best.perfusion_index[1]), 2)} %",
            "perfusion index, red and infrared",
        ),
    ]
    return document(
        kicker="pulse oximeter",
        title="Oxygen from volts",
        lead=f"{result.sizes['photodiode']} photodiodes, a heart that beats {result.attrs['rate_per_min']:g} times a "
        "minute, and every saturation from one trace of each LED.",
        warnings=result.attrs["warnings"],
        cards=cards,
        body=[
            section("The pulse in volts", figure(oximeter_figures.pulse(result), "pulse", PULSE), *_board(result)),
            section(
                "From R to saturation",
                figure(oximeter_figures.calibration(result), "calibration", CURVE),
                _calibrations(result),
            ),
            section("How well it knows", _errors(result), small(_ERRORS)),
            section(
                "What disturbs it",
                figure(oximeter_figures.disturbances(result), "disturbances", DISTURB),
                _melanin(result),
                small(
                    "The resting blood is as venous as the scene says, what pulsates is arterial. Where lines of LEDs "
                    "move, light scatters as at the traced wavelength. Sunlight is full at 100 klx, on all of the "
                    "finger; nails of other thickness have traces of their own."
                ),
            ),
        ],
        attributes=result.attrs,
    )


_ERRORS = (
    "Electronics: shot and thermal noise and that of the sample-and-hold. Ambient light: the shot noise that it adds. "
    "Trace: what more photons would take away."
)


def _board(result: xr.Dataset) -> list[str]:
    try:
        scene = parse_scene(str(result.attrs["scene"]))
    except (InputError, KeyError):
        return []
    text = "The board from above, rolled flat."
    return [figure(maps.top_view(scene), "top", text, narrow=True)]


def _calibrations(result: xr.Dataset) -> str:
    rows = []
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        pairs = zip(one.linear.values, one.linear_stderr.values, strict=True)
        rows.append(
            [
                escaped(name),
                *(with_error(float(value), float(error)) for value, error in pairs),
                significant(float(one.linear_miss), 2),
                polynomial(one.quadratic.values, "R"),
                significant(float(one.quadratic_miss), 2),
                with_error(float(one.ratio_at_rest), float(one.ratio_at_rest_stderr)),
                with_error(float(one.path_ratio), float(one.path_ratio_stderr)),
            ]
        )
    at = f"R({result.attrs['so2']:g})"
    head = ["Photodiode", "Intercept", "Slope", "Misses [%]", "Quadratic", "Misses [%]", at, "Path ratio"]
    return table(head, rows) + small(
        "Lines are fitted from 70 to 100 %. The path ratio is the red light's mean path in the pulsatile blood over "
        "the infrared's: R is in proportion to it."
    )


def _errors(result: xr.Dataset) -> str:
    head = ["Photodiode", *(escaped(cause) for cause in result.cause.values), "All, 8 s [%]", "All, one beat [%]"]
    rows = []
    for name in result.photodiode.values:
        one = result.sel(photodiode=name)
        each = [significant(float(x), 2) for x in one.spo2_stderr_by_cause.values]
        total = [significant(float(one[key]), 2) for key in ("spo2_stderr", "spo2_stderr_beat")]
        rows.append([escaped(name), *each, *total])
    return table(head, rows)


def _melanin(result: xr.Dataset) -> str:
    worst = float(result.melanin_bound.max())
    met = float(result.epidermis_part_bound.max())
    return (
        f"<p>Does light through the nail meet epidermis at all? At most {significant(100 * met, 2)} % of what a "
        f"photodiode detects (95 %), so that no melanin moves SpO2 by more than {significant(worst, 2)} %.</p>"
    )


def write_oxygen_recording(result: xr.Dataset, summary: dict[str, Any], path: Path) -> None:
    """Write the page of a recording that was read, whole or not at all; raises WriteError.

    summary : what `recording_summary` says of the result.
    """
    best = summary["readings"][summary["best"]]
    cards = [("unknown", "SpO2: in no window the finger was still")]
    if best["spo2"] is not None:
        cards = [
            (f"{significant(best['spo2'], 3)} %", "SpO2, the middle of all still windows"),
            (f"{significant(best['spo2_low'], 3)} to {significant(best['spo2_high'], 3)} %", "its 95 % interval"),
        ]
    if best["rate_per_min"] is not None:
        cards.append((significant(best["rate_per_min"], 3), "beats a minute"))
    rows = [
        [
            escaped(name),
            *(significant(one[key], 3) if one[key] is not None else "–" for key in ("spo2", "spo2_stderr", "ratio")),
            *(
                significant(100 * one["perfusion_index"][k], 2) if one["perfusion_index"][k] is not None else "–"
                for k in ("red", "infrared")
            ),
            f"{one['still']} of {one['windows']}",
        ]
        for name, one in summary["readings"].items()
    ]
    head = ["Photodiode", "SpO2 [%]", "±", "R", "Perfusion, red [%]", "infrared [%]", "Still windows"]
    moved = f"the finger moved in {100 * best['motion']:.0f} % of the time"
    text = document(
        kicker="pulse oximeter",
        title="Oxygen from a recording",
        lead=f"{result.sizes['time']} windows of {result.attrs['window_s']:g} s; {moved}.",
        cards=cards,
        body=[
            section(
                "Over time",
                figure(
                    oximeter_figures.over_time(result),
                    "time",
                    f"Photodiode {result.attrs['best']}. Windows in which the finger moved for more than half of the "
                    "time tell nothing.",
                ),
            ),
            section("Photodiodes", table(head, rows)),
        ],
        attributes=result.attrs,
    )
    write_text(path, text)
