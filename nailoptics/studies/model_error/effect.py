"""One effect on the readings: how it was measured, how far it moves them, and whether that matters."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...statistics import Z95
from .paired import Difference, PairedReadings, weighted_mean
from .variants import Changes, lines_of

# An effect is sure to matter if its change exceeds the tolerance by so many standard errors: by chance alone that
# happens to one of 2000 changes, so that a study of a hundred is right about all of them in 19 of 20 cases.
SURE = 3.5


@dataclass(frozen=True)
class Change:
    """One part or effect of a scene, whether the scene models it, and what the scene would have in its place.

    changes : what of the scene makes it so; nothing where no line can.
    same_photons : whether it only dims light, so that photons traced without it read it too.
    unknown : whether it is no part but something unknown of the finger, at an end of its range, or of the sensor.
    """

    name: str
    modelled: bool
    changed_to: str
    changes: Changes = field(default_factory=dict)
    same_photons: bool = False
    unknown: bool = False


@dataclass(frozen=True, kw_only=True)
class Effect(Change):
    """A change that was measured: by how much readings move.

    of : "reading" where it moves the reading at rest, "signal" where it moves the change by touch alone.
    change, stderr : change of that, of the reading at rest relative and of the signal as a part of the largest, of the
        photodiode named, which it surely moves most; the error counts that it was picked: its 95 % interval holds with
        Bonferroni's correction for all photodiodes.
    bound : what no photodiode's change exceeds, with 95 % confidence each.
    typical, typical_stderr : change over all photodiodes, weighed by the errors of the scene's readings.
    modulation_bound : the same bound on the modulation by touch, as a part of the largest modulation.
    """

    how: Literal["reweighted", "retraced", "derived"]
    change: float
    stderr: float
    bound: float
    photodiode: str
    typical: float
    typical_stderr: float
    modulation_bound: float | None
    tolerance: float
    of: Literal["reading", "signal"] = "reading"

    @property
    def matters(self) -> Literal["yes", "no", "cannot tell"]:
        """Whether it moves a reading, or the signal, by more than the tolerance, as far as the traces can tell."""
        if self.bound <= self.tolerance:
            return "no"
        return "yes" if abs(self.change) - SURE * self.stderr > self.tolerance else "cannot tell"

    @property
    def lines(self) -> list[str]:
        """The scene lines that change it."""
        return lines_of(self.changes)


def effect_of(
    change: Change,
    found: Difference,
    base: PairedReadings,
    *,
    tolerance: float,
    how: Literal["reweighted", "retraced", "derived"] = "derived",
    of: Literal["reading", "signal"] = "reading",
) -> Effect:
    """An effect from the difference that its change makes; without a modulation where the difference has none.

    of : what it is judged by.
    """
    from scipy.special import ndtri

    ratio, error, most = found.ratio, found.ratio_stderr, found.ratio_bound
    if of == "signal":
        ratio, error, most = np.asarray(found.swing), np.asarray(found.swing_stderr), found.swing_bound
    known = np.isfinite(ratio) & np.isfinite(error)
    # Where nothing was seen, anything may be.
    ratio, error = np.where(known, ratio, np.nan), np.where(known, error, np.nan)
    bounds = np.where(known, most, np.inf)
    # What is known best, not what is noisiest, says by how much readings move at least.
    sure = np.where(known, np.abs(ratio) - SURE * error, -np.inf)
    best = i, j = np.unravel_index(int(np.argmax(sure)), sure.shape)
    picked = float(ndtri(1 - 0.025 / max(int(known.sum()), 1))) / Z95
    mean, spread = weighted_mean(ratio, error, base)
    swing = found.swing_bound
    return Effect(
        **vars(change),
        how=how,
        change=float(ratio[best]),
        stderr=picked * float(error[best]),
        bound=float(bounds.max()),
        photodiode=f"{base.transfer.leds[i]} {base.transfer.photodiodes[j]}",
        typical=mean,
        typical_stderr=spread,
        modulation_bound=float(np.max(swing)) if np.isfinite(swing).all() else None,
        tolerance=tolerance,
        of=of,
    )
