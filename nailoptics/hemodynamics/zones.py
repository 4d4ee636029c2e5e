"""How the nail bed is cut into capillary units, and which touch pressure reaches which wall."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import InputError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Zones:
    """Capillary units along the nail, from the cuticle to the tip, and the reach of the pressure inputs.

    share : (N,) floats. Size of a unit over that of one of the paper's two; the sum is 2. [1]
    reach : (N, M) floats. Part of pressure input m that acts on the capillary wall of unit i. [1]
    vein_reach : (M,) floats. Part of pressure input m that acts on the vein wall. [1]

    A unit of share s has s N_C capillaries, s A_C, s k_C, s b_C, s m_C and R_V1/s: cutting a bed into units
    that feel one pressure changes nothing.
    """

    share: tuple[float, ...]
    reach: tuple[tuple[float, ...], ...]
    vein_reach: tuple[float, ...]

    def __post_init__(self) -> None:
        share, reach, vein_reach = np.asarray(self.share), np.asarray(self.reach), np.asarray(self.vein_reach)
        if share.ndim != 1 or share.size < 1 or not np.all(np.isfinite(share)) or np.any(share <= 0.0):
            raise InputError(
                f"zones.share must hold positive finite numbers, got {self.share}; give one for each unit."
            )
        if not np.isclose(share.sum(), 2.0, rtol=1e-9):
            raise InputError(f"zones.share must sum to 2 (the paper's two beds), got {share.sum():g}; scale it.")
        if reach.shape != (share.size, vein_reach.size) or vein_reach.ndim != 1:
            raise InputError(
                f"zones.reach must have shape (units, inputs) = ({share.size}, {vein_reach.size}), got {reach.shape}; "
                "give one row for each unit and one column for each input."
            )
        if not (np.all(np.isfinite(reach)) and np.all(np.isfinite(vein_reach))):
            raise InputError("zones.reach and zones.vein_reach must be finite; replace NaN and inf.")

    @property
    def count(self) -> int:
        """Number of capillary units."""
        return len(self.share)

    @property
    def inputs(self) -> int:
        """Number of pressure inputs."""
        return len(self.vein_reach)

    @property
    def names(self) -> list[str]:
        """One name for each unit."""
        return ["proximal", "distal"] if self.count == 2 else [f"zone_{i + 1}" for i in range(self.count)]

    @property
    def position(self) -> np.ndarray:
        """(N,) float. Centre of each unit along the bed, 0 at the cuticle and 1 at the tip. [1]"""
        edges = np.concatenate(([0.0], np.cumsum(self.share))) / sum(self.share)
        return 0.5 * (edges[:-1] + edges[1:])


PAPER_ZONES = Zones(share=(1.0, 1.0), reach=((0.0, 0.0), (0.0, 1.0)), vein_reach=(1.0, 0.0))


def zones(count: int, *, decay_length: float | None = None) -> Zones:
    """Cut the nail bed into equal units with the paper's two inputs, proximal and distal.

    count : Number of units, 2 or more. Two units without decay are the paper's model.
    decay_length : Reach of the distal pressure. None: the distal half feels it in full, the proximal
        half nothing (the paper). Otherwise it falls off as exp(-d/decay_length) with the distance d from the last
        unit, and P_F2 is its mean over the distal half; both lengths in lengths of the bed. [1]

    The pressure that the pulp passes on to the bed falls off with the distance from the tip. An exponential is the
    simplest law with one constant: a unit closes once its part of P_F2 passes its closing pressure, so the white
    band's width grows as decay_length log(force).

    Raises: InputError if the count is under 2, is odd without decay, or the length is not positive.
    """
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 2:
        raise InputError(f"zones.count must be an integer of 2 or more, got {count!r}; use 2 for the paper's model.")
    if decay_length is None:
        if count % 2:
            raise InputError(f"zones.count must be even without decay_length, got {count}; the bed has two halves.")
        distal = np.repeat([0.0, 1.0], count // 2)
    else:
        if not (np.isfinite(decay_length) and decay_length > 0.0):
            raise InputError(f"zones.decay_length must be positive and finite, got {decay_length}; 0.3 is usual.")
        centre = (np.arange(count) + 0.5) / count
        # The half itself would be cut through a unit if the count is odd: weigh by what lies in it.
        distal = _falling_off(centre, np.clip((centre - 0.5) * count + 0.5, 0.0, 1.0), decay_length)
    return Zones(
        share=(2.0 / count,) * int(count),
        reach=tuple((0.0, float(part)) for part in distal),
        vein_reach=(1.0, 0.0),
    )


def zones_between(edges: Sequence[float], *, decay_length: float) -> Zones:
    """Cut the nail bed at given places into units whose size is their part of it; pressures reach as in `zones`.

    edges : where units meet, rising between 0 (the cuticle) and 1 (the tip). [1]

    Raises: InputError if the edges do not rise from above 0 to below 1, or the length is not positive.
    """
    ends = np.concatenate(([0.0], np.asarray(edges, dtype=float), [1.0]))
    size = np.diff(ends)
    if not (np.all(np.isfinite(ends)) and np.all(size > 0.0)):
        raise InputError(f"zones.edges must rise between 0 and 1, got {list(edges)}; sort them and leave out the ends.")
    if not (np.isfinite(decay_length) and decay_length > 0.0):
        raise InputError(f"zones.decay_length must be positive and finite, got {decay_length}; 0.15 is usual.")
    inside = np.clip(ends[1:], 0.5, None) - np.clip(ends[:-1], 0.5, None)
    distal = _falling_off(0.5 * (ends[:-1] + ends[1:]), inside, decay_length)
    return Zones(
        share=tuple((2.0 * size).tolist()),
        reach=tuple((0.0, float(part)) for part in distal),
        vein_reach=(1.0, 0.0),
    )


def with_shear(zones: Zones) -> Zones:
    """The same units with a third input, shear, which reaches each of them as the distal pressure does.

    The paper says of shear and longitudinal force only that they widen the white band. This is the simplest law that
    does: over the distal area they press on the capillaries as a normal force would, and on no vein.
    """
    reach = tuple((proximal, distal, distal) for proximal, distal in zones.reach)
    return dataclasses.replace(zones, reach=reach, vein_reach=(*zones.vein_reach, 0.0))


def _falling_off(centre: np.ndarray, inside: np.ndarray, decay_length: float) -> np.ndarray:
    """The part of P_F2 that each unit feels, so that P_F2 is its mean over the distal half.

    inside : how much of each unit lies in that half.
    """
    falling = np.exp((centre - centre[-1]) / decay_length)
    return np.asarray(falling * inside.sum() / (falling @ inside))
