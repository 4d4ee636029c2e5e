"""What a comparison comes to: does a model hold, how far, and how large alpha D^2 really is."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr

from ...statistics import Z95

# A verdict is given with this probability.
SURE = 0.95


@dataclass(frozen=True)
class Verdict:
    """Whether a fitted model stays within a tolerance for every LED and photodiode over a whole sweep.

    sure : probability with which it does so, or does not, by the traces' noise; readings : how many were judged.
    surely_within : how many of these stay within it, each with a probability of 95 %.
    worst_error, worst_stderr : of the reading that is furthest off, in parts of its swing.
    worst_low, worst_high : what the largest error of all readings lies between, 95 % sure.
    """

    outcome: Literal["met", "missed", "undecided"]
    model: str
    tolerance: float
    worst_error: float
    worst_stderr: float
    worst_low: float
    worst_high: float
    led: str
    photodiode: str
    sweep: str
    sure: float
    readings: int
    surely_within: int

    def __str__(self) -> str:
        largest, low, high = (f"{100 * x:.3g}" for x in (self.worst_error, self.worst_low, self.worst_high))
        name = {"taylor": "Taylor (9)", "beer_lambert": "Beer-Lambert (8)"}[self.model]
        of = f"{100 * self.tolerance:g} % of the swing of all {self.readings} readings over the {self.sweep}"
        percent = "over 99.9" if self.sure > 0.999 else f"{100 * self.sure:.3g}"
        words = {
            "met": f"{name} stays within {of} ({percent} % confidence)",
            "missed": f"{name} does not stay within {of} ({percent} % confidence)",
            "undecided": f"Whether {name} stays within {of} is undecided; trace more photons",
        }
        where = f"LED {self.led}, photodiode {self.photodiode}"
        return f"{words[self.outcome]}. Largest error: {largest} % (95 % interval {low} to {high} %), {where}."


def verdict(result: xr.Dataset, tolerance: float, *, model: str = "taylor") -> Verdict:
    """Judge a fitted model over the force, or over the first sweep where the force was not swept.

    Met if even the error that is nearest to the tolerance lies below it, with a probability of 95 %; missed if one lies
    above it, with that probability after Bonferroni's correction: of many readings some lie above it by chance.
    """
    from scipy.special import ndtr

    sweep = "force" if "force" in result.sweep.values else str(result.sweep.values[0])
    end = result.sel(sweep=sweep, way="fitted", model=model).isel(point=-1)
    error, stderr = end.range_error.values, end.range_error_stderr.values
    with np.errstate(divide="ignore", invalid="ignore"):
        # Of a photodiode that saw nothing nothing is known.
        below = np.where(np.isfinite(error), ndtr((tolerance - error) / stderr), 0.5)
    met, missed = float(below.min()), max(0.0, 1 - float(error.size * below.min()))
    outcome: Literal["met", "missed", "undecided"] = "met" if met >= SURE else "undecided"
    if missed >= SURE:
        outcome = "missed"
    i, j = np.unravel_index(int(np.where(np.isfinite(error), error, -np.inf).argmax()), error.shape)
    low, high = _worst(error, stderr)
    return Verdict(
        outcome=outcome,
        model=model,
        tolerance=tolerance,
        worst_error=float(error[i, j]),
        worst_stderr=float(stderr[i, j]),
        worst_low=low,
        worst_high=high,
        led=str(result.led.values[i]),
        photodiode=str(result.photodiode.values[j]),
        sweep=sweep,
        sure=max(met, missed),
        readings=error.size,
        surely_within=int(np.sum(below >= SURE)),
    )


def _worst(error: np.ndarray, stderr: np.ndarray) -> tuple[float, float]:
    """Between what the largest of some errors lies, which are 0 or more; nothing is known where one is not.

    Of many readings one lies above the largest error by chance, so that the lower end has Bonferroni's correction.
    """
    from scipy.special import ndtri

    low, high = error - float(ndtri(1 - (1 - SURE) / 2 / error.size)) * stderr, error + Z95 * stderr
    known = np.isfinite(low)
    return float(np.max(low, where=known, initial=0.0)), float(np.max(high)) if known.all() else float("inf")


def summary(result: xr.Dataset) -> dict[str, Any]:
    """The comparison in plain numbers, ready for JSON: readings by sweep, LED and photodiode, and the paper's claim."""
    places = np.ndindex(*(result.sizes[name] for name in _PAIRS))
    rows = [_row(result.isel(dict(zip(_PAIRS, at, strict=True)))) for at in places]
    kept = ("engine", "backend", "photons", "cpu_seconds", "wall_seconds", "digest")
    found = {"comparisons": rows, "claim": claim(result), "cut_off": result.attrs.get("cut_off")}
    found |= {"reused": bool(result.attrs.get("reused", 0))}
    return found | {name: result.attrs[name] for name in kept}


_PAIRS = ("sweep", "led", "photodiode")
_ALPHA_D2 = ("alpha_d2", "bed_alpha_d2")


def _row(one: xr.Dataset) -> dict[str, Any]:
    """One photodiode under one LED over one sweep."""
    row: dict[str, Any] = {name: str(one[name].values) for name in _PAIRS}
    row |= {"swing_of_reading": float(one.swing / one.reading[0]), "path_mm": _pair(one, "path_mm")}
    for name in _ALPHA_D2:
        row |= {f"{name}_{end}": _pair(one.isel(point=at), name) for end, at in (("start", 0), ("end", -1))}
    for way in (str(w) for w in one.way.values):
        for model in (str(m) for m in one.model.values):
            here = one.sel(way=way, model=model)
            error = _pair(here.isel(point=-1), "range_error")
            limits = {f"{within:g}": _limit(here.sel(within=within)) for within in one.within.values}
            row[f"{model}_{way}"] = {"error_of_swing": error, "holds_to": limits}
        worst = int(np.abs(one.error.sel(way=way, model="taylor").values).argmax())
        parts = one.sel(way=way).isel(point=worst)
        row[f"parts_{way}"] = {str(p): _pair(parts.sel(part=p), "part_error") for p in one.part.values}
    return row


def _limit(here: xr.Dataset) -> dict[str, Any]:
    """Up to where a model holds, in every measure."""
    limits: dict[str, Any] = {"ends_within_sweep": bool(here.limit_ends)}
    for name in ("setting", "blood_fraction", *_ALPHA_D2):
        limit = "limit" if name == "setting" else f"limit_{name}"
        limits[name] = {"value": float(here[limit])} | {end: float(here[f"{limit}_{end}"]) for end in ("low", "high")}
    return limits


def claim(result: xr.Dataset) -> dict[str, Any]:
    """How large alpha D^2 is over the first sweep, beside the paper's 1e-2."""
    first = result.isel(sweep=0)
    found: dict[str, Any] = {"paper": 0.01, "sweep": str(result.sweep.values[0])}
    for name in _ALPHA_D2:
        start, error = first[name].isel(point=0), first[f"{name}_stderr"].isel(point=0)
        found[name] = {
            "at_start": {"least": float(start.min()), "largest": float(start.max()), "stderr": float(error.max())},
            "over_sweep": {"least": float(first[name].min()), "largest": float(first[name].max())},
        }
    return found


def _pair(one: xr.Dataset, name: str) -> dict[str, float]:
    """A value and its standard error."""
    return {"value": float(one[name]), "stderr": float(one[f"{name}_stderr"])}
