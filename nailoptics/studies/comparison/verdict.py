"""What a comparison comes to: does a model hold, how far, and how large alpha D^2 really is."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr

from ...statistics import Z95


@dataclass(frozen=True)
class Verdict:
    """Whether a fitted model stays within a tolerance for every LED and photodiode over a whole sweep.

    worst_error, worst_stderr : of the reading that is furthest off, in parts of its swing.
    """

    outcome: Literal["met", "missed", "undecided"]
    model: str
    tolerance: float
    worst_error: float
    worst_stderr: float
    led: str
    photodiode: str
    sweep: str

    def __str__(self) -> str:
        found = f"{self.worst_error:.2%} +- {self.worst_stderr:.2%} of the swing"
        where = f"LED {self.led}, photodiode {self.photodiode}, over {self.sweep}"
        name = {"taylor": "Taylor (9)", "beer_lambert": "Beer-Lambert (8)"}[self.model]
        words = {
            "met": "stays within",
            "missed": "misses",
            "undecided": "cannot be told to meet or to miss (trace more photons)",
        }
        return f"{name} {words[self.outcome]} {self.tolerance:.2%}: at worst {found}, {where}."


def verdict(result: xr.Dataset, tolerance: float, *, model: str = "taylor") -> Verdict:
    """Judge a fitted model over the force, or over the first sweep where the force was not swept.

    Met only if every error with its 95 % interval lies below the tolerance; missed if one interval lies above it.
    """
    sweep = "force" if "force" in result.sweep.values else str(result.sweep.values[0])
    end = result.sel(sweep=sweep, way="fitted", model=model).isel(point=-1)
    error, stderr = end.range_error.values / 100, end.range_error_stderr.values / 100
    if np.all(error + Z95 * stderr <= tolerance):
        outcome: Literal["met", "missed", "undecided"] = "met"
        at = np.argmax(error + Z95 * stderr)
    else:
        outcome = "missed" if np.any(error - Z95 * stderr > tolerance) else "undecided"
        at = np.nanargmax(error - Z95 * stderr if outcome == "missed" else error + Z95 * stderr)
    i, j = np.unravel_index(int(at), error.shape)
    return Verdict(
        outcome=outcome,
        model=model,
        tolerance=tolerance,
        worst_error=float(error[i, j]),
        worst_stderr=float(stderr[i, j]),
        led=str(result.led.values[i]),
        photodiode=str(result.photodiode.values[j]),
        sweep=sweep,
    )


def summary(result: xr.Dataset) -> dict[str, Any]:
    """The comparison in plain numbers, ready for JSON: readings by sweep, LED and photodiode, and the paper's claim."""
    rows = []
    for sweep, led, photodiode in np.ndindex(*(result.sizes[d] for d in ("sweep", "led", "photodiode"))):
        one = result.isel(sweep=sweep, led=led, photodiode=photodiode)
        last = one.isel(point=-1)
        row: dict[str, Any] = {
            "sweep": str(one.sweep.values),
            "led": str(one.led.values),
            "photodiode": str(one.photodiode.values),
            "swing_of_reading": float(one.swing / one.reading[0]),
            "path_mm": _pair(one.path_mm, one.path_mm_stderr),
            "alpha_d2_start": _pair(one.alpha_d2[0], one.alpha_d2_stderr[0]),
            "alpha_d2_end": _pair(one.alpha_d2[-1], one.alpha_d2_stderr[-1]),
            "bed_alpha_d2_start": _pair(one.bed_alpha_d2[0], one.bed_alpha_d2_stderr[0]),
            "bed_alpha_d2_end": _pair(one.bed_alpha_d2[-1], one.bed_alpha_d2_stderr[-1]),
        }
        for way in result.way.values:
            for model in result.model.values:
                at = {"way": way, "model": model}
                limits = {}
                for within in result.within.values:
                    here = one.sel(**at, within=within)
                    limits[f"{within:g}"] = {"ends_within_sweep": bool(here.limit_ends)} | {
                        name: {
                            "value": float(here[f"limit{suffix}"]),
                            "low": float(here[f"limit{suffix}_low"]),
                            "high": float(here[f"limit{suffix}_high"]),
                        }
                        for name, suffix in _LIMITS.items()
                    }
                error = last.sel(**at)
                row[f"{model}_{way}"] = {
                    "error_of_swing": _pair(error.range_error / 100, error.range_error_stderr / 100),
                    "holds_to": limits,
                }
            parts = one.sel(way=way).isel(point=int(np.abs(one.error.sel(way=way, model="taylor").values).argmax()))
            row[f"parts_{way}"] = {
                str(p): _pair(parts.part_error.sel(part=p) / 100, parts.part_error_stderr.sel(part=p) / 100)
                for p in result.part.values
            }
        rows.append(row)
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest")
    return {"comparisons": rows, "claim": claim(result)} | {name: result.attrs[name] for name in kept}


_LIMITS = {"setting": "", "blood_fraction": "_blood_fraction", "alpha_d2": "_alpha_d2", "bed_alpha_d2": "_bed_alpha_d2"}


def claim(result: xr.Dataset) -> dict[str, Any]:
    """How large alpha D^2 is over the first sweep, beside the paper's 1e-2."""
    first = result.isel(sweep=0)
    found: dict[str, Any] = {"paper": 0.01, "sweep": str(result.sweep.values[0])}
    for name in ("alpha_d2", "bed_alpha_d2"):
        start, error = first[name].isel(point=0), first[f"{name}_stderr"].isel(point=0)
        found[name] = {
            "at_start": {"least": float(start.min()), "largest": float(start.max()), "stderr": float(error.max())},
            "over_sweep": {"least": float(first[name].min()), "largest": float(first[name].max())},
        }
    return found


def _pair(value: Any, error: Any) -> dict[str, float]:
    return {"value": float(value), "stderr": float(error)}
