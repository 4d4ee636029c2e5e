"""Zones of the nail bed: capillary units along the nail, and which touch pressure reaches the wall of each."""

from collections.abc import Sequence
from dataclasses import dataclass
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
    reach : (N, M) floats. Part of pressure input m that acts on the capillary wall of unit i. [1]
    vein_reach : (M,) floats. Part of pressure input m that acts on the vein wall. [1]

    A unit of share s has s N_C capillaries, s A_C, s k_C, s b_C, s m_C and R_V1/s: cutting a bed into units
    that feel one pressure changes nothing.
    """

    share: tuple[float, ...]
    reach: tuple[tuple[float, ...], ...]
    vein_reach: tuple[float, ...]

    def __post_init__(self) -> None:
        share, reach = positive("zones.share", self.share), finite("zones.reach", self.reach)
        vein_reach = finite("zones.vein_reach", self.vein_reach)
        if share.ndim != 1 or not np.isclose(share.sum(), 2.0, rtol=1e-9):
            raise InputError(f"zones.share must sum to 2 (the paper's two beds), got {share.sum():g}; scale it.")
        if reach.shape != (share.size, vein_reach.size) or vein_reach.ndim != 1:
            raise InputError(
                f"zones.reach must have shape (units, inputs) = ({share.size}, {vein_reach.size}), got {reach.shape}; "
                "give one row for each unit and one column for each input."
            )

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

    def of_beds(self, value: Any) -> list[Any]:
        """A constant of each unit, from one of both beds or a pair: its mean over the unit."""
        proximal, distal = beds(value)
        if proximal is distal:
            return [value] * self.count
        ends = np.concatenate(([0.0], np.cumsum(self.share))) / sum(self.share)
        parts = np.round(np.clip((0.5 - ends[:-1]) / np.diff(ends), 0.0, 1.0), 12)
        return [part * proximal + (1.0 - part) * distal for part in parts.tolist()]

    def on_walls(self, touch_pa: np.ndarray) -> np.ndarray:
        """The (N+1, S) touch pressure on each wall from the (M, S) inputs. [Pa]"""
        rows = [*self.reach, self.vein_reach]
        return np.array([sum(part * p for part, p in zip(row, touch_pa, strict=True)) for row in rows])


PAPER_ZONES = Zones(share=(1.0, 1.0), reach=((0.0, 0.0), (0.0, 1.0)), vein_reach=(1.0, 0.0))


def zones_between(
    edges: Sequence[float] | np.ndarray,
    *,
    decay_length: float | None = None,
    shield: tuple[float, float] | None = None,
) -> Zones:
    """Cut the nail bed at given places into units whose size is their part of it, with the paper's two inputs.

    edges : where units meet, rising between 0 (the cuticle) and 1 (the tip). [1]
    shield : Where on the same axis the bone ends, and the length over which its shield does. It keeps the distal
        pressure from the bed behind it, as the paper says: a unit feels the mean over it of
        (1 + tanh((x - end) / length)) / 2. [1]
    decay_length : Instead of the shield, a reach that falls off as exp(-d/decay_length) with the distance d from the
        last unit, where P_F2 is its mean over the distal half; the law of versions before the shield. [1]

    Raises: InputError if the edges do not rise from above 0 to below 1, a length is not positive, or there is not one
    of the two laws.
    """
    ends = np.concatenate(([0.0], np.asarray(edges, dtype=float), [1.0]))
    size = np.diff(ends)
    if not (np.all(np.isfinite(ends)) and np.all(size > 0.0)):
        raise InputError(f"zones.edges must rise between 0 and 1, got {list(edges)}; sort them and leave out the ends.")
    if (shield is None) == (decay_length is None):
        raise InputError("zones take one law of the distal pressure's reach; give shield or decay_length.")
    name, (end, length) = ("decay_length", (0.0, decay_length)) if shield is None else ("shield", shield)
    if length is None or not (np.isfinite(length) and np.isfinite(end) and length > 0.0):
        raise InputError(f"zones.{name} must be positive and finite, got {length}; 0.15 is usual.")
    if shield is not None:
        past = (ends - end) / length
        # The integral of tanh is log cosh.
        distal = 0.5 + 0.5 * length * np.diff(np.logaddexp(past, -past)) / size
    else:
        in_distal_half = np.diff(np.maximum(ends, 0.5))
        centre = 0.5 * (ends[:-1] + ends[1:])
        falling = np.exp((centre - centre[-1]) / length)
        distal = falling * in_distal_half.sum() / (falling @ in_distal_half)
    return Zones(
        share=tuple((2.0 * size).tolist()),
        reach=tuple((0.0, part) for part in distal.tolist()),
        vein_reach=(1.0, 0.0),
    )


def with_shear(zones: Zones) -> Zones:
    """The same units with a third input, shear, which reaches each of them as the distal pressure does.

    The paper says of shear only that it widens the white band, and more than normal force does. This is the simplest
    law that does: it presses on the capillaries (`shear_pressure`), and on no vein.
    """
    reach = tuple((proximal, distal, distal) for proximal, distal in zones.reach)
    return Zones(share=zones.share, reach=reach, vein_reach=(*zones.vein_reach, 0.0))


def capillary_zones(scene: Scene) -> Zones:
    """How the scene cuts the nail bed into capillary units, and how far the touch's pressures reach."""
    blood, edges_mm, touch = scene.blood, scene.zone_edges_mm, scene.touch
    if len(edges_mm) == 1 and blood.decay_length is None:
        cut = PAPER_ZONES
    else:
        length_mm = scene.fingertip.nail_length_mm
        edges = [0.5 + edge / length_mm for edge in edges_mm]
        end, edge = 0.5 + scene.fingertip.bone_end_mm / length_mm, blood.bone_edge_mm / length_mm
        law: dict[str, Any] = {"shield": (end, edge)}
        if blood.decay_length is not None:
            law = {"decay_length": blood.decay_length}
        cut = zones_between(edges, **law)
    if (everywhere := blood.distal_reach) > 0.0:
        reach = tuple((proximal, everywhere + (1.0 - everywhere) * distal) for proximal, distal in cut.reach)
        cut = Zones(share=cut.share, reach=reach, vein_reach=cut.vein_reach)
    shears = touch.shear_n is not None or touch.recorded_shear_n is not None
    return with_shear(cut) if shears else cut
