"""One effect on the readings: how it was measured, how far it moves them, and whether that matters."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..comparison.fits import Z95
from .paired import Difference, Look, pooled
from .variants import Changes, lines_of

# An effect matters for sure at this many standard errors: of a hundred changes looked at, one in twenty times one errs.
SURE = 3.5


@dataclass(frozen=True)
class Effect:
    """One part or effect: whether the scene models it, and by how much readings move when that is changed.

    change, stderr : relative change of the reading at rest, of the photodiode that it surely moves most.
    bound : what no photodiode's change exceeds, with 95 % confidence each; the one named reaches it.
    typical, typical_stderr : change over all photodiodes, weighed by the errors of the scene's readings.
    modulation_bound : the same bound on the modulation by touch, as a part of the largest modulation.
    changes : what of the scene changes it; nothing where no line can.
    """

    name: str
    modelled: bool
    changed_to: str
    how: Literal["reread", "retraced", "derived"]
    change: float
    stderr: float
    bound: float
    photodiode: str
    typical: float
    typical_stderr: float
    modulation_bound: float | None
    changes: Changes
    tolerance: float

    @property
    def matters(self) -> Literal["yes", "no", "cannot tell"]:
        """Whether it moves a reading by more than the tolerance, as far as the traces can tell."""
        if self.bound <= self.tolerance:
            return "no"
        return "yes" if abs(self.change) - SURE * self.stderr > self.tolerance else "cannot tell"

    @property
    def lines(self) -> list[str]:
        """The scene lines that change it."""
        return lines_of(self.changes)


def effect_of(
    name: str,
    modelled: bool,
    changed_to: str,
    found: Difference,
    changes: Changes,
    tolerance: float,
    how: Literal["reread", "retraced", "derived"],
    base: Look,
) -> Effect:
    """An effect from the differences that it makes; without a swing where its difference has none."""
    ratio, error = found.ratio, found.ratio_stderr
    known = np.isfinite(ratio) & np.isfinite(error)
    # Where nothing was seen, anything may be.
    ratio, error = np.where(known, ratio, np.nan), np.where(known, error, np.nan)
    bounds = np.where(known, np.abs(ratio) + Z95 * error, np.inf)
    i, j = np.unravel_index(int(np.argmax(bounds)), bounds.shape)
    # What is told best, not what is noisiest, says by how much readings move at least.
    sure = np.where(known, np.abs(ratio) - SURE * error, -np.inf)
    best = np.unravel_index(int(np.argmax(sure)), sure.shape)
    mean, spread = pooled(ratio, error, base)
    swing = np.abs(found.swing) + Z95 * found.swing_stderr
    return Effect(
        name=name,
        modelled=modelled,
        changed_to=changed_to,
        how=how,
        change=float(ratio[best]),
        stderr=float(error[best]),
        bound=float(bounds[i, j]),
        photodiode=f"{base.transfer.leds[i]} {base.transfer.photodiodes[j]}",
        typical=mean,
        typical_stderr=spread,
        modulation_bound=float(np.max(swing)) if np.isfinite(swing).all() else None,
        changes=changes,
        tolerance=tolerance,
    )
