"""What a command prints of a result: one object for JSON, or lines of text."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

    from ..light import RestReadings


def simulation_summary(result: "xr.Dataset") -> dict[str, Any]:
    """Volts at the start, where they change most, and their noise there, for each LED and photodiode."""
    rows = []
    for led in result.led.values:
        for photodiode in result.photodiode.values:
            one = result.sel(led=led, photodiode=photodiode)
            peak = one.isel(time=int(np.abs(one.volts_change.values).argmax()))
            at = {"volts_start": one.volts[0], "volts_start_stderr": one.volts_stderr[0]}
            at |= {name: peak[name] for name in ("volts_change", "volts_change_stderr", "volts_noise_rms")}
            at |= {"time_of_change_s": peak.time}
            at |= {name: one[name] for name in ("beer_lambert_residual_rms_v", "taylor_residual_rms_v")}
            names = {"led": str(led), "photodiode": str(photodiode)}
            rows.append(names | {name: float(value) for name, value in at.items()})
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest", "accuracy_reached")
    return {"readings": rows} | {name: result.attrs[name] for name in kept}


def simulation_lines(summary: dict[str, Any]) -> list[str]:
    """The readings of a `simulation_summary` as a table."""
    lines = [f"{'LED':>10} {'photodiode':<14} {'start V':>9} {'+-':>8} {'change mV':>10} {'+-':>7} {'noise mV':>9}"]
    for row in summary["readings"]:
        lines.append(
            f"{row['led']:>10} {row['photodiode']:<14} {row['volts_start']:9.4f} {row['volts_start_stderr']:8.4f} "
            f"{1e3 * row['volts_change']:10.3f} {1e3 * row['volts_change_stderr']:7.3f} "
            f"{1e3 * row['volts_noise_rms']:9.4f}"
        )
    return lines


def rest_lines(rest: "RestReadings") -> list[str]:
    """The readings of a trace, and where its light went."""
    lines = []
    for row in rest.readings:
        error = _plus_minus(row["stderr"], ".1e")
        if "upper_limit_95" in row:
            error = f"below {row['upper_limit_95']:.1e} (95 %)"
        lines.append(f"{row['led']:>10} {row['photodiode']:<16} {row['detected_fraction']:.4e} {error}")
    for part, share in (rest.energy or {}).items():
        lines.append(f"{part:>11} {share['value']:.5f} {_plus_minus(share['stderr'], '.5f')}")
    return lines


def _plus_minus(stderr: float, form: str) -> str:
    return "+- unknown" if math.isnan(stderr) else f"+- {stderr:{form}}"


def placement_summary(result: "xr.Dataset") -> dict[str, Any]:
    """The ranking of layouts, and how much finer than the paper's the best resolves force."""
    from ..studies.placement.result import gain, rows

    better = gain(result)
    kept = ("checked_resolution_n", "photons", "cpu_seconds", "wall_seconds", "digest", "rank_by")
    return {
        "ranking": rows(result),
        "gain_over_paper": {"value": better[0], "stderr": better[1]} if better else None,
    } | {name: result.attrs[name] for name in kept}


def placement_lines(summary: dict[str, Any]) -> list[str]:
    """The ranking of a `placement_summary` as a table, best first."""
    lines = [
        f"{row['rank']:>3} {row['layout']:<28} {1e3 * row['force_resolution_n']:9.3f} mN "
        f"+- {1e3 * row['force_resolution_n_stderr']:.3f}{'  tied' if row['tied'] else ''}"
        for row in summary["ranking"]
    ]
    if better := summary["gain_over_paper"]:
        times = f"{better['value']:.2f} +- {better['stderr']:.2f} times"
        lines.append(f"the best resolves force {times} as finely as the paper's layout")
    return lines
