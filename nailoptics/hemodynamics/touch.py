"""From a force on the fingertip to the pressure on each vessel wall: contact, creep of the pulp, zones of the bed."""

import dataclasses
from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError
from ..scene.base import LEAST_AREA_MM2, USUAL_CONTACT_AREA_MM2
from .drive import Waveform
from .parameters import Parameters, beds


def pressures(
    force_n: ArrayLike,
    contact_area_mm2: ArrayLike = USUAL_CONTACT_AREA_MM2,
    proximal_share: ArrayLike = 0.5,
    *,
    proximal_area_mm2: float | None = None,
    distal_area_mm2: float | None = None,
    contact_force_n: float | None = None,
    distal_onset_n: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """The proximal and the distal pressure, P_F1 and P_F2, that a force on the fingertip gives. [Pa]

    force_n : any shape, float, 0 or more. Normal force. [N]
    contact_area_mm2, proximal_share : float that broadcasts. As for `side_areas_mm2`.
    proximal_area_mm2, distal_area_mm2 : As for `side_areas_mm2`.
    contact_force_n : Force at which all areas are as stated. They grow with force^(2/3), as the contact of a sphere
        (Hertz 1882) does, so that pressures grow with force^(1/3). None: they do not grow. [N]
    distal_onset_n : Force from which the contact reaches the distal side: of what exceeds it the distal side carries
        its share, the proximal side carries all else. [N]

    Each side carries its share of the force on its own area, so that both forces add up to the touch's. By default 1 N
    on one side is 1 N/cm^2 there, and an even touch of 1 N is 1 N/cm^2 on both, which puts the paper's model (level
    near 1 N/cm^2) and its experiments (level near 1 N) on one axis.

    Raises: InputError if the force is negative or not finite, an area is not positive, or the share is not in 0..1.
    """
    force, share = finite("force_n", force_n), finite("proximal_share", proximal_share)
    if np.any(force < 0.0):
        raise InputError(f"force_n must be 0 or more, got {force.min():g} N; a finger pushes, it does not pull.")
    if distal_onset_n > 0.0:
        share = 1.0 - (1.0 - share) * np.maximum(1.0 - distal_onset_n / np.maximum(force, distal_onset_n), 0.0)
    proximal_mm2, distal_mm2 = side_areas_mm2(
        contact_area_mm2, share, proximal_area_mm2=proximal_area_mm2, distal_area_mm2=distal_area_mm2
    )
    if contact_force_n is not None:
        force = np.cbrt(force) * contact_force_n ** (2.0 / 3.0)
    return share * force / (proximal_mm2 * 1e-6), (1.0 - share) * force / (distal_mm2 * 1e-6)


def shear_pressure(
    shear_n: ArrayLike,
    contact_area_mm2: ArrayLike = USUAL_CONTACT_AREA_MM2,
    *,
    distal_area_mm2: float | None = None,
) -> np.ndarray:
    """The pressure of a longitudinal force of either sign on the distal capillaries. [Pa]

    It bears on the distal half of the contact, or on the stated distal area: a newton of it whitens the tip twice as
    much as one of normal force. The paper says that shear is more effective, not by how much.
    """
    half = 0.5 * _area("contact_area_mm2", contact_area_mm2)
    area = half if distal_area_mm2 is None else _area("distal_area_mm2", distal_area_mm2)
    return np.abs(finite("shear_n", shear_n)) / (1e-6 * area)


def side_areas_mm2(
    contact_area_mm2: ArrayLike = USUAL_CONTACT_AREA_MM2,
    proximal_share: ArrayLike = 0.5,
    *,
    proximal_area_mm2: float | None = None,
    distal_area_mm2: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Areas on which a touch presses the proximal and the distal pulp, of the arguments' broadcast shape. [mm^2]

    contact_area_mm2 : Area of the whole touch. [mm^2]
    proximal_share : Part of the force that the proximal side carries, 0 to 1. [1]
    proximal_area_mm2, distal_area_mm2 : Area of a side. None: the part of the contact that goes with the side's share
        of the force, but no less than half: a touch on one side presses there with all of the contact, an even one
        with half of it on each side. [mm^2]

    Raises: InputError if an area is not positive, or the share is not in 0..1.
    """
    contact, share = _area("contact_area_mm2", contact_area_mm2), finite("proximal_share", proximal_share)
    if np.any((share < 0.0) | (share > 1.0)):
        wrong = share.ravel()[np.abs(share - 0.5).argmax()]
        raise InputError(f"proximal_share must lie in 0..1, got {wrong:g}; 0.5 is an even touch.")
    halves = [contact * np.maximum(part, 0.5) for part in (share, 1.0 - share)]
    proximal = halves[0] if proximal_area_mm2 is None else _area("proximal_area_mm2", proximal_area_mm2)
    distal = halves[1] if distal_area_mm2 is None else _area("distal_area_mm2", distal_area_mm2)
    return proximal, distal


def _area(name: str, value: ArrayLike) -> np.ndarray:
    area = finite(name, value)
    if np.any(area < LEAST_AREA_MM2):
        raise InputError(
            f"{name} must be {LEAST_AREA_MM2:g} or more, got {area.min():g}; {USUAL_CONTACT_AREA_MM2:g} is usual."
        )
    return area


def creeping_pressure(time_s: ArrayLike, pressure_pa: ArrayLike, *, relaxation_s: ArrayLike) -> np.ndarray:
    """The pressure that a touch leaves in the pulp, which yields at once and recovers slowly, (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch, linear between the times. [Pa]
    relaxation_s : (...) float. Time constant of the recovery; 0 is none. [s]

    Where the touch presses harder than what is left, the pulp follows; where it presses less, the difference dies away
    as exp(-t / relaxation_s).

    Raises: InputError if a value is not finite, or the time constant is negative.
    """
    time, touch = finite("time_s", time_s), finite("pressure_pa", pressure_pa)
    relaxation = finite("relaxation_s", relaxation_s)
    if (relaxation < 0.0).any():
        raise InputError(f"relaxation_s must be 0 or more, got {relaxation.min():g} s.")
    left = touch.copy()
    if relaxation.any():
        # Of several, those that are 0 die away within any step.
        relaxation = np.maximum(relaxation, 1e-9 * relaxation.max())
        for i, h in enumerate(np.diff(time)):
            relaxed = _lagging(left[..., i], touch[..., i], touch[..., i + 1], h, relaxation)
            left[..., i + 1] = np.maximum(touch[..., i + 1], relaxed)
    return left


def spreading_pressure(
    time_s: ArrayLike, pressure_pa: ArrayLike, *, part: ArrayLike, time_constant_s: float
) -> np.ndarray:
    """The pressure of a touch under which the pulp spreads by and by, (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch on a pulp that does not spread, linear between the times. [Pa]
    part : (...) float. Part of the pressure that is lost in the end, 0 to 1. [1]
    time_constant_s : of its loss, and of the pulp's return once the touch is over. [s]

    What is lost follows the pressure with that delay, and never exceeds it.

    Raises: InputError if a value is not finite, the part is not in 0..1, or the time constant is not positive.
    """
    time, touch = finite("time_s", time_s), finite("pressure_pa", pressure_pa)
    lost, delay = finite("part", part), number("time_constant_s", time_constant_s)
    if ((lost < 0.0) | (lost > 1.0)).any():
        raise InputError(f"part must lie in 0..1, got {lost.ravel()[np.abs(lost - 0.5).argmax()]:g}; 0.1 is usual.")
    if delay <= 0.0:
        raise InputError(f"time_constant_s must be greater than 0, got {delay:g} s.")
    delayed = np.zeros_like(touch)
    for i, h in enumerate(np.diff(time)):
        delayed[..., i + 1] = _lagging(delayed[..., i], touch[..., i], touch[..., i + 1], h, delay)
    return np.maximum(touch - lost[..., None] * delayed, 0.0)


def _lagging(value: Any, before: Any, after: Any, step_s: float, delay_s: Any) -> Any:
    """A first-order lag behind an input that goes evenly from `before` to `after`; in no time nothing happens."""
    if step_s <= 0.0:
        return value
    lag = (after - before) * (delay_s / step_s)
    return after - lag + (value - before + lag) * np.exp(-step_s / delay_s)


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


class Pressures(TypedDict, total=False):
    """The pressures on the network, numbers or arrays; over time also a `Waveform` each. [Pa]

    proximal_pressure_pa, distal_pressure_pa : P_F1 on the vein and P_F2 on the distal capillaries; 0 where not given.
    arterial_pressure_pa, venous_pressure_pa : P_H and P_L; the parameters' where not given.
    pressure_pa : all touch pressures, along the first axis, for zones with other than two inputs.
    """

    proximal_pressure_pa: ArrayLike | Waveform
    distal_pressure_pa: ArrayLike | Waveform
    arterial_pressure_pa: ArrayLike | Waveform | None
    venous_pressure_pa: ArrayLike | Waveform | None
    pressure_pa: ArrayLike | Sequence[ArrayLike | Waveform] | None


def named_pressures(parameters: Parameters, zones: Zones, pressures: Pressures) -> dict[str, Any]:
    """P_H, P_L and each touch pressure that the zones take, by the name of the argument that gives it.

    Raises: InputError if there are not as many as inputs; TypeError for a pressure that is none of `Pressures`.
    """
    if unknown := pressures.keys() - Pressures.__annotations__:
        raise TypeError(f"{min(unknown)} is no pressure; give {', '.join(Pressures.__annotations__)}")
    ends = {name: pressures.get(name) for name in ("arterial_pressure_pa", "venous_pressure_pa")}
    given = {name: getattr(parameters, name) if value is None else value for name, value in ends.items()}
    touch: Any = pressures.get("pressure_pa")
    if touch is None:
        if zones.inputs != 2:
            raise InputError(f"zones take {zones.inputs} pressures, not 2; give them all in pressure_pa.")
        sides = ("proximal_pressure_pa", "distal_pressure_pa")
        return given | {name: pressures.get(name, 0.0) for name in sides}
    rows = touch if isinstance(touch, list | tuple) else np.atleast_1d(touch)
    if len(rows) != zones.inputs:
        raise InputError(f"pressure_pa must hold {zones.inputs} inputs on its first axis, got {len(rows)}.")
    return given | {f"pressure_pa[{i}]": row for i, row in enumerate(rows)}


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
    return dataclasses.replace(zones, reach=reach, vein_reach=(*zones.vein_reach, 0.0))
