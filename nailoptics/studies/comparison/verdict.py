"""What a comparison comes to: does a model hold, how far, and how large alpha D^2 really is."""

from dataclasses import dataclass
from typing import Literal

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
