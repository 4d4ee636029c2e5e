"""From a force on the fingertip to the pressures on both sides of the finger, over time: contact, shear and creep."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, fraction, not_negative, positive
from ..errors import InputError
from ..scene import Scene, Touch
from ..scene.base import USUAL_CONTACT_AREA_MM2
from ..scene.touch import BESIDE_FORCE
from .drive import Waveform
from .parameters import Parameters
from .zones import Zones

# A relaxation goes through so many knots in its time constant: between them it is off by 5e-4 of what is left.
KNOTS_PER_RELAXATION = 16
# A pressure that grows otherwise than its force goes through so many knots up to the largest force: between them it is
# off by 0.6 % of the largest pressure at most.
KNOTS_OF_CONTACT = 64
# Half of the step over which pressures are compared for their slope. [N]
CONTACT_STEP_N = 1e-3


@dataclass(frozen=True)
class Contact:
    """Where a force presses on the fingertip; numbers, or arrays over time.

    contact_area_mm2 : Area of the whole touch. [mm^2]
    proximal_share : Fraction of the force that the proximal side carries, 0 to 1. [1]
    proximal_area_mm2, distal_area_mm2 : Area of a side. None: the part of the contact that goes with the side's share
        of the force, but no less than half. [mm^2]
    contact_force_n : Force at which all areas are as stated. They grow with force^(2/3), as the contact of a sphere
        (Hertz 1882) does. None: they do not grow. [N]
    distal_onset_n : Force from which the contact reaches the distal side: of what exceeds it the distal side carries
        its share, the proximal side carries all else. [N]

    Raises: InputError if an area or contact_force_n is not positive, or the share is not in 0..1.
    """

    contact_area_mm2: ArrayLike = USUAL_CONTACT_AREA_MM2
    proximal_share: ArrayLike = 0.5
    proximal_area_mm2: ArrayLike | None = None
    distal_area_mm2: ArrayLike | None = None
    contact_force_n: float | None = None
    distal_onset_n: float = 0.0

    def __post_init__(self) -> None:
        fraction("proximal_share", self.proximal_share)
        for name in ("contact_area_mm2", "proximal_area_mm2", "distal_area_mm2", "contact_force_n"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name))

    @staticmethod
    def of(touch: Touch) -> "Contact":
        """Where a scene's touch presses, as stated."""
        stated = {field.name: getattr(touch, field.name) for field in fields(Contact)}
        return Contact(**stated | {"distal_onset_n": touch.distal_onset_n or 0.0})

    def side_areas_mm2(self, proximal_share: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Areas on which the touch presses the proximal and the distal pulp, by another share if given. [mm^2]"""
        share = np.asarray(self.proximal_share if proximal_share is None else proximal_share, float)
        halves = [np.asarray(self.contact_area_mm2) * np.maximum(part, 0.5) for part in (share, 1.0 - share)]
        stated = (self.proximal_area_mm2, self.distal_area_mm2)
        proximal, distal = (np.asarray(half if own is None else own) for half, own in zip(halves, stated, strict=True))
        return proximal, distal

    def pressures(self, force_n: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The proximal and the distal pressure, P_F1 and P_F2, that a force gives, of any shape. [Pa]

        Each side carries its share of the force on its own area. By default 1 N on one side is 1 N/cm^2 there, and an
        even touch of 1 N is 1 N/cm^2 on both: the paper's model and its experiments on one axis.

        Raises: InputError if the force is negative or not finite.
        """
        force, share, onset_n = not_negative("force_n", force_n), np.asarray(self.proximal_share), self.distal_onset_n
        if onset_n > 0.0:
            share = 1.0 - (1.0 - share) * np.maximum(1.0 - onset_n / np.maximum(force, onset_n), 0.0)
        proximal_mm2, distal_mm2 = self.side_areas_mm2(share)
        if self.contact_force_n is not None:
            force = np.cbrt(force) * self.contact_force_n ** (2.0 / 3.0)
        return share * force / (proximal_mm2 * 1e-6), (1.0 - share) * force / (distal_mm2 * 1e-6)

    def shear_pressure(self, shear_n: ArrayLike) -> np.ndarray:
        """The pressure of a longitudinal force of either sign, on the distal half of the contact or the stated distal
        area: so it whitens the tip twice as much as normal force, of which the paper says "more". [Pa]"""
        return np.asarray(np.abs(finite("shear_n", shear_n)) / (1e-6 * self.side_areas_mm2(0.5)[1]))


def relaxing_pressure(time_s: ArrayLike, pressure_pa: ArrayLike, *, relaxation_s: ArrayLike) -> np.ndarray:
    """The pressure that a touch leaves in the pulp, which yields at once and recovers slowly, (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch, linear between the times. [Pa]
    relaxation_s : (...) float. Time constant of the recovery; 0 is none. [s]

    Where the touch presses less than what is left, the difference dies away as exp(-t / relaxation_s).

    Raises: InputError if a value is not finite, or the time constant is negative.
    """
    time, touch = finite("time_s", time_s), finite("pressure_pa", pressure_pa)
    relaxation = not_negative("relaxation_s", relaxation_s)
    left = touch.copy()
    if relaxation.any():
        # Of several, those that are 0 die away within any step.
        relaxation = np.maximum(relaxation, 1e-9 * relaxation.max())
        left[..., 1:] = _lagging(time, touch, relaxation, start=touch[..., :1], least=touch[..., 1:])
    return left


def spreading_pressure(
    time_s: ArrayLike, pressure_pa: ArrayLike, *, part: ArrayLike, time_constant_s: float
) -> np.ndarray:
    """The pressure of a touch under which the pulp creeps (spreads), (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch on a pulp that does not spread, linear between the times. [Pa]
    part : (...) float. Fraction of the pressure that is lost in the end, 0 to 1. [1]
    time_constant_s : of its loss, and of the pulp's return once the touch is over. [s]

    What is lost follows the pressure with that delay, and never exceeds it.

    Raises: InputError if a value is not finite, the part is not in 0..1, or the time constant is not positive.
    """
    touch, lost = finite("pressure_pa", pressure_pa), fraction("part", part)
    delay_s = positive("time_constant_s", time_constant_s)
    least, delayed = min(0.0, touch.min(initial=0.0)), np.zeros_like(touch)
    delayed[..., 1:] = _lagging(finite("time_s", time_s), touch, delay_s, start=0.0, least=least)
    return np.maximum(touch - lost[..., None] * delayed, 0.0)


def _lagging(time_s: np.ndarray, touch: np.ndarray, delay_s: Any, *, start: Any, least: Any) -> np.ndarray:
    """A first-order lag behind an input (..., T) that goes evenly from time to time, no less than `least` after each
    step; in no time nothing happens: (..., T - 1) float. A step makes max(least, factor x + added) of x, and so do two:
    all follow by doubling (Hillis and Steele 1986, Commun. ACM 29:1170)."""
    step_s, delay_s = np.diff(time_s), np.asarray(delay_s)[..., None]
    factor, lag = np.exp(-step_s / delay_s), np.diff(touch) * (delay_s / np.where(step_s > 0.0, step_s, 1.0))
    added = np.where(step_s > 0.0, touch[..., 1:] - lag - (touch[..., :-1] - lag) * factor, 0.0)
    least = np.broadcast_to(least, added.shape).copy()
    shift = 1
    while shift < step_s.size:
        later = factor[..., shift:]
        least[..., shift:] = np.maximum(least[..., shift:], later * least[..., :-shift] + added[..., shift:])
        added[..., shift:] += later * added[..., :-shift]
        factor[..., shift:] *= factor[..., :-shift]
        shift *= 2
    return np.asarray(np.maximum(least, factor * start + added))


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
        raise TypeError(f"{min(unknown)} is not a pressure; give {', '.join(Pressures.__annotations__)}")
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


@dataclass(frozen=True)
class TouchCourse:
    """A touch over time, linear between corners; a time comes twice where it jumps.

    touch, contact : the scene's, and where it presses as stated.
    samples_s : (t,) float. At which results are given.
    time_s, force_n : (k,) float. Where pressures alone were recorded the force is theirs, each on the area of its side.
    shear_n : (k,) float. The longitudinal force, positive towards the tip; None of a touch without.
    pressure_pa : (M, k) float. The proximal and the distal pressure and, with shear, that of the shear, before the pulp
        creeps.
    per_n_pa : (2,) float. Recorded pressures over the force, where that is largest; None of a touch given by its force.
    """

    touch: Touch
    contact: Contact
    samples_s: np.ndarray
    time_s: np.ndarray
    force_n: np.ndarray
    shear_n: np.ndarray | None
    pressure_pa: np.ndarray
    per_n_pa: np.ndarray | None

    def sides_pa(self, force_n: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Proximal and distal pressure of a force that presses as the touch does, recorded ones in the ratio that they
        have where the force is largest. [Pa]"""
        if self.per_n_pa is None:
            return self.contact.pressures(force_n)
        return self.per_n_pa[0] * np.asarray(force_n, float), self.per_n_pa[1] * np.asarray(force_n, float)

    def contact_at(self, force_n: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the touch presses at a force: both pressures [Pa], their change by newton, and the change of the force
        on either side by pascal [N/Pa], (2,) each."""
        low_n, high_n = max(force_n - CONTACT_STEP_N, 0.0), force_n + CONTACT_STEP_N
        before, here, after = np.transpose(self.sides_pa([low_n, force_n, high_n]))
        per_n, areas_m2 = (after - before) / (high_n - low_n), 1e-6 * np.array(self.contact.side_areas_mm2())
        # Both areas are larger by as much where they grow with the force, or one side alone carries it.
        change = areas_m2 @ per_n
        return here, per_n, areas_m2 / change if change > 0.0 else areas_m2

    def held_pa(self, force_n: ArrayLike) -> np.ndarray:
        """All pressures once each of the forces has been held for long, (M, n) float. [Pa]"""
        rows, most = list(self.sides_pa(force_n)), int(np.argmax(self.force_n))
        if self.shear_n is not None:
            shear_per_n = self.pressure_pa[2, most] / self.force_n[most] if self.force_n[most] > 0 else 0.0
            rows.append(shear_per_n * np.asarray(force_n, float))
        return (1.0 - (self.touch.creep or 0.0)) * np.array(np.broadcast_arrays(*rows))

    def waveforms(self) -> list[Waveform]:
        """The pressures over time under a pulp that spreads and, on the distal side, recovers slowly."""
        touch, time_s, rows = self.touch, self.time_s, self.pressure_pa
        if touch.creep:
            time_s, rows = _with_knots(time_s, rows, _relaxation_times_s(time_s, touch.creep_s))
            rows = spreading_pressure(time_s, rows, part=touch.creep, time_constant_s=touch.creep_s)
        if touch.distal_relaxation_s is not None:
            time_s, rows = _with_knots(time_s, rows, _relaxation_times_s(time_s, touch.distal_relaxation_s))
            rows[1] = relaxing_pressure(time_s, rows[1], relaxation_s=touch.distal_relaxation_s)
        return [Waveform(time_s=time_s, pressure_pa=row) for row in rows]


def touch_course(touch: Touch) -> TouchCourse:
    """A scene's touch over time."""
    samples_s, (time_s, force_n) = touch.times_s(), touch.corners()
    columns = {name: getattr(touch, f"recorded_{name}") for name in BESIDE_FORCE}
    beside: dict[str, Any] = {name: np.array(column) for name, column in columns.items() if column is not None}
    contact, recorded_pa = Contact.of(touch), (touch.recorded_proximal_pressure_pa, touch.recorded_distal_pressure_pa)
    if recorded_pa[0] is None:
        courses = [force_n, *beside.values()]
        # When the force passes what its pressures bend at between corners.
        levels_n = force_n.max() * (np.arange(1, KNOTS_OF_CONTACT) / KNOTS_OF_CONTACT) ** 3
        levels_n = np.append([] if contact.contact_force_n is None else levels_n, contact.distal_onset_n)[:, None]
        level, before = np.nonzero(((force_n[:-1] < levels_n) != (force_n[1:] < levels_n)) & (np.diff(time_s) > 0.0))
        part = (levels_n[level, 0] - force_n[before]) / np.diff(force_n)[before]
        bends_s = time_s[before] + part * np.diff(time_s)[before]
        time_s, (force_n, *finer) = _with_knots(time_s, courses, bends_s)
        beside = dict(zip(beside, finer, strict=True))
        moving = replace(contact, **{name: beside[name] for name in beside.keys() - {"shear_n"}})
        rows = np.array(moving.pressures(force_n))
    else:
        rows = np.array(recorded_pa)
        force_n = 1e-6 * np.array(contact.side_areas_mm2()) @ rows if np.isnan(force_n).any() else force_n
    most, shear_n, per_n_pa = int(np.argmax(force_n)), beside.get("shear_n"), None
    if recorded_pa[0] is not None or beside.keys() - {"shear_n"}:
        per_n_pa = rows[:, most] / force_n[most] if force_n[most] > 0 else np.zeros(2)
    if shear_n is None and touch.shear_n is not None:
        shear_n = touch.shear_n * force_n / max(float(force_n[most]), np.finfo(float).tiny)
    if shear_n is not None:
        rows = np.vstack([rows, contact.shear_pressure(shear_n)])
    return TouchCourse(touch, contact, samples_s, time_s, force_n, shear_n, rows, per_n_pa)


def _relaxation_times_s(time_s: np.ndarray, relaxation_s: float) -> np.ndarray:
    """As many times as it takes to follow what dies away after each corner."""
    after_s = relaxation_s * np.arange(1, 10 * KNOTS_PER_RELAXATION) / KNOTS_PER_RELAXATION
    gaps_s = np.append(np.diff(time_s), np.inf)
    return np.concatenate([t + after_s[after_s < gap] for t, gap in zip(time_s, gaps_s, strict=True)])


def _with_knots(time_s: np.ndarray, rows: Any, more_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Courses (k,) at more times, linear between their own."""
    more = [Waveform(time_s=time_s, pressure_pa=row).at(more_s) for row in rows]
    order = np.argsort(np.concatenate([time_s, more_s]), kind="stable")
    return np.concatenate([time_s, more_s])[order], np.hstack([rows, more])[:, order]


def largest_force_n(scene: Scene) -> float:
    """The largest force of the scene's touch. [N]"""
    return float(touch_course(scene.touch).force_n.max())
