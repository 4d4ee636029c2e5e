"""Zones of the nail bed: capillary units along the nail, and which touch pressure reaches the wall of each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..checks import finite, positive
from ..errors import InputError
from ..scene import Scene
from .parameters import beds


@dataclass(frozen=True, kw_only=True)
class Zones:
    """Capillary units along the nail, from the cuticle to the tip, and the reach of the pressure inputs.

    share : (N,) floats. Size of a unit over that of one of the paper's two; the sum is 2. [1]
    reach : (N, M) floats. Fraction of pressure input m that acts on the capillary wall of unit i. [1]
    vein_reach : (M,) floats. Fraction of pressure input m that acts on the vein wall. [1]

    A unit of share s has s N_C, s A_C, s k_C, s b_C, s m_C and R_V1/s: cutting a bed that feels one pressure changes
    nothing.
    """

    share: tuple[float, ...]
    reach: tuple[tuple[float, ...], ...]
    vein_reach: tuple[float, ...]

    def __post_init__(self) -> None:
        share, reach = positive("zones.share", self.share), finite("zones.reach", self.reach)
        shape = (share.size, finite("zones.vein_reach", self.vein_reach).size)
        if reach.shape != shape or not np.isclose(share.sum(), 2.0, rtol=1e-9):
            faults = f"reach has shape {reach.shape} and share sums to {share.sum():g}"
            raise InputError(f"zones: {faults}; give shape (units, inputs) = {shape} and a sum of 2.")

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
    def ends(self) -> np.ndarray:
        """(N+1,) float. Where units begin and end along the bed, 0 at the cuticle and 1 at the tip. [1]"""
        return np.concatenate(([0.0], np.cumsum(self.share))) / sum(self.share)

    @property
    def position(self) -> np.ndarray:
        """(N,) float. Centre of each unit on the same axis. [1]"""
        return 0.5 * (self.ends[:-1] + self.ends[1:])

    def of_beds(self, value: Any) -> list[Any]:
        """A constant of each unit, from one of both beds or a pair: its mean over the unit."""
        proximal, distal = beds(value)
        if proximal is distal:
            return [value] * self.count
        parts = np.round(np.clip((0.5 - self.ends[:-1]) / np.diff(self.ends), 0.0, 1.0), 12)
        return [part * proximal + (1.0 - part) * distal for part in parts.tolist()]

    def on_walls(self, touch_pa: np.ndarray) -> np.ndarray:
        """The (N+1, S) touch pressure on each wall from the (M, S) inputs. [Pa]"""
        rows = [*self.reach, self.vein_reach]
        return np.array([sum(part * p for part, p in zip(row, touch_pa, strict=True)) for row in rows])


PAPER_ZONES = Zones(share=(1.0, 1.0), reach=((0.0, 0.0), (0.0, 1.0)), vein_reach=(1.0, 0.0))


def zones_between(
    edges: Sequence[float] | np.ndarray, *, shield: tuple[float, float] = (0.5, 0.1), decay_length: float | None = None
) -> Zones:
    """Cut the nail bed at given places into units whose size is their part of it, with the paper's two inputs.

    edges : where units meet, rising between 0 (the cuticle) and 1 (the tip). [1]
    shield : Where on the same axis the bone ends, and the length over which its shield does. It keeps the distal
        pressure from the bed behind it, as the paper says: a unit feels the mean over it of
        (1 + tanh((x - end) / length)) / 2. [1]
    decay_length : Instead of the shield, exponential decay from the tip: a reach that falls off as exp(-d/decay_length)
        with the distance d from the last unit, where P_F2 is its mean over the distal half. [1]

    Raises: InputError if the edges do not rise from above 0 to below 1, or a length is not positive.
    """
    ends = np.concatenate(([0.0], np.asarray(edges, dtype=float), [1.0]))
    size = np.diff(ends)
    if not np.all(size > 0.0):
        raise InputError(f"zones.edges must rise between 0 and 1, got {list(edges)}; sort them and leave out the ends.")
    if decay_length is None:
        end, length = shield
        past = (ends - end) / positive("zones.shield", length)
        # The integral of tanh is log cosh.
        distal = 0.5 + 0.5 * length * np.diff(np.logaddexp(past, -past)) / size
    else:
        in_distal_half = np.diff(np.maximum(ends, 0.5))
        centre = 0.5 * (ends[:-1] + ends[1:])
        falling = np.exp((centre - centre[-1]) / positive("zones.decay_length", decay_length))
        distal = falling * in_distal_half.sum() / (falling @ in_distal_half)
    return Zones(
        share=tuple((2.0 * size).tolist()), reach=tuple((0.0, part) for part in distal.tolist()), vein_reach=(1.0, 0.0)
    )


def capillary_zones(scene: Scene) -> Zones:
    """How the scene cuts the nail bed into capillary units, and how far the touch's pressures reach."""
    blood, touch = scene.blood, scene.touch
    if scene.zone_count == 2 and blood.decay_length is None:
        cut = PAPER_ZONES
    else:
        length_mm = scene.fingertip.nail_length_mm
        edges = [0.5 + edge / length_mm for edge in scene.zone_edges_mm]
        shield = 0.5 + scene.fingertip.bone_end_mm / length_mm, blood.bone_edge_mm / length_mm
        cut = zones_between(edges, shield=shield, decay_length=blood.decay_length)
    if (everywhere := blood.distal_reach) > 0.0:
        reach = tuple((proximal, everywhere + (1.0 - everywhere) * distal) for proximal, distal in cut.reach)
        cut = replace(cut, reach=reach)
    if touch.shear_n is not None or touch.recorded_shear_n is not None:
        # A third input. The paper says of shear only that it widens the white band, and more than normal force does.
        # This is the simplest law that does: it presses on capillaries as the distal pressure does, and on no vein.
        by_shear = tuple((proximal, distal, distal) for proximal, distal in cut.reach)
        cut = replace(cut, reach=by_shear, vein_reach=(*cut.vein_reach, 0.0))
    return cut
