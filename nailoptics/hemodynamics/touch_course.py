"""A scene's touch over time: its force, where that presses, and the pressures on both sides of the finger."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..scene import Scene, Touch
from ..scene.touch import BESIDE_FORCE, CONTACT
from .drive import Waveform
from .touch import creeping_pressure, pressures, shear_pressure, side_areas_mm2, spreading_pressure

# A relaxation goes through so many knots in its time constant: between them it is off by 5e-4 of what is left.
KNOTS_PER_RELAXATION = 16
# A pressure that grows otherwise than its force goes through so many knots up to the largest force: between them it is
# off by 0.6 % of the largest pressure at most.
KNOTS_OF_CONTACT = 64
# Half of the step over which pressures are compared for their slope. [N]
CONTACT_STEP_N = 1e-3


@dataclass(frozen=True)
class TouchCourse:
    """A touch over time, linear between corners; a time comes twice where it jumps.

    samples_s : (t,) float. At which results are given.
    time_s, force_n : (k,) float. Where pressures alone were recorded the force is theirs, each on the area of its side.
    shear_n : (k,) float. The longitudinal force, positive towards the tip; None of a touch without.
    pressure_pa : (M, k) float. The proximal and the distal pressure and, with shear, that of the shear, before the pulp
        creeps.
    per_n_pa : (2,) float. Recorded pressures over the force, where that is largest; None of a touch given by its force.
    """

    touch: Touch
    samples_s: np.ndarray
    time_s: np.ndarray
    force_n: np.ndarray
    shear_n: np.ndarray | None
    pressure_pa: np.ndarray
    per_n_pa: np.ndarray | None

    def sides_pa(self, force_n: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Proximal and distal pressure of a force that presses as the touch does. [Pa]

        Recorded pressures have the ratio that they have where the force is largest.
        """
        if self.per_n_pa is None:
            return pressures(force_n, **contact(self.touch))
        return self.per_n_pa[0] * np.asarray(force_n, float), self.per_n_pa[1] * np.asarray(force_n, float)

    def held_pa(self, force_n: ArrayLike) -> np.ndarray:
        """All pressures once each of the forces has been held for long, (M, n) float. [Pa]"""
        rows, most = list(self.sides_pa(force_n)), int(np.argmax(self.force_n))
        if self.shear_n is not None:
            rows.append(self.pressure_pa[2, most] / self.force_n[most] * np.asarray(force_n, float))
        return (1.0 - (self.touch.creep or 0.0)) * np.array(np.broadcast_arrays(*rows))

    def waveforms(self) -> list[Waveform]:
        """The pressures over time under a pulp that spreads and, on the distal side, recovers slowly."""
        touch, time_s, rows = self.touch, self.time_s, self.pressure_pa
        if touch.creep:
            time_s, rows = _with_knots_after(time_s, rows, touch.creep_s)
            rows = spreading_pressure(time_s, rows, part=touch.creep, time_constant_s=touch.creep_s)
        if touch.distal_relaxation_s is not None:
            time_s, rows = _with_knots_after(time_s, rows, touch.distal_relaxation_s)
            rows[1] = creeping_pressure(time_s, rows[1], relaxation_s=touch.distal_relaxation_s)
        return [Waveform(time_s=time_s, pressure_pa=row) for row in rows]


def touch_course(touch: Touch) -> TouchCourse:
    """A scene's touch over time."""
    samples_s, (time_s, force_n) = touch.times_s(), touch.corners()
    given, per_n_pa = contact(touch), None
    columns = {name: getattr(touch, f"recorded_{name}") for name in BESIDE_FORCE}
    beside = {name: np.array(column) for name, column in columns.items() if column is not None}
    if touch.recorded_proximal_pressure_pa is None:
        if touch.contact_force_n is not None or touch.distal_onset_n:
            finer_s, force_n = _with_knots_of_contact(touch, time_s, force_n)
            beside = {name: np.interp(finer_s, time_s, column) for name, column in beside.items()}
            time_s = finer_s
        beside_force = {name: beside[name] for name in BESIDE_FORCE[1:] if name in beside}
        rows = np.array(pressures(force_n, **given | beside_force))
    else:
        rows = np.array([touch.recorded_proximal_pressure_pa, touch.recorded_distal_pressure_pa])
        areas_mm2 = np.array(side_areas_mm2(**_stated(touch)))
        force_n = 1e-6 * areas_mm2 @ rows if np.isnan(force_n).any() else force_n
    most = int(np.argmax(force_n))
    if touch.recorded_proximal_pressure_pa is not None or len(beside.keys() - {"shear_n"}):
        per_n_pa = rows[:, most] / force_n[most] if force_n[most] > 0 else np.zeros(2)
    shear_n = beside.get("shear_n")
    if shear_n is None and touch.shear_n is not None:
        shear_n = touch.shear_n * force_n / max(float(force_n.max()), np.finfo(float).tiny)
    if shear_n is not None:
        area_mm2, distal_mm2 = touch.contact_area_mm2, touch.distal_area_mm2
        rows = np.vstack([rows, shear_pressure(shear_n, area_mm2, distal_area_mm2=distal_mm2)])
    return TouchCourse(touch, samples_s, time_s, force_n, shear_n, rows, per_n_pa)


def contact(touch: Touch) -> dict[str, Any]:
    """Where a force presses, as `hemodynamics.pressures` takes it."""
    return {name: getattr(touch, name) for name in CONTACT} | {"distal_onset_n": touch.distal_onset_n or 0.0}


def _stated(touch: Touch) -> dict[str, Any]:
    """The areas and the share as stated, whatever the force."""
    return {name: value for name, value in contact(touch).items() if name not in ("contact_force_n", "distal_onset_n")}


def _with_knots_of_contact(touch: Touch, time_s: np.ndarray, force_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A course at more times, where its force passes what the pressures between corners bend at."""
    levels_n = force_n.max() * (np.arange(1, KNOTS_OF_CONTACT) / KNOTS_OF_CONTACT) ** 3
    levels_n = levels_n if touch.contact_force_n is not None else levels_n[:0]
    more_s, more_n = [time_s], [force_n]
    for level_n in [*levels_n, touch.distal_onset_n or 0.0]:
        passes = np.flatnonzero(((force_n[:-1] < level_n) != (force_n[1:] < level_n)) & (np.diff(time_s) > 0.0))
        part = (level_n - force_n[passes]) / (force_n[passes + 1] - force_n[passes])
        more_s.append(time_s[passes] + part * (time_s[passes + 1] - time_s[passes]))
        more_n.append(np.full(passes.size, level_n))
    order = np.argsort(np.concatenate(more_s), kind="stable")
    return np.concatenate(more_s)[order], np.concatenate(more_n)[order]


def _with_knots_after(time_s: np.ndarray, rows: np.ndarray, relaxation_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A course at as many more times as it takes to follow what dies away after each of its corners."""
    after_s = relaxation_s * np.arange(1, 10 * KNOTS_PER_RELAXATION) / KNOTS_PER_RELAXATION
    gaps_s = np.append(np.diff(time_s), np.inf)
    more_s = np.concatenate([t + after_s[after_s < gap] for t, gap in zip(time_s, gaps_s, strict=True)])
    more = [Waveform(time_s=time_s, pressure_pa=row).at(more_s) for row in rows]
    order = np.argsort(np.concatenate([time_s, more_s]), kind="stable")
    return np.concatenate([time_s, more_s])[order], np.hstack([rows, more])[:, order]


def largest_force_n(scene: Scene) -> float:
    """The largest force of the scene's touch. [N]"""
    return float(touch_course(scene.touch).force_n.max())


def contact_at(scene: Scene, force_n: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the scene's touch presses at a force: both pressures [Pa], their change by newton, and the change of the
    force on either side by pascal [N/Pa], (2,) each.
    """
    touch, sides_pa = scene.touch, touch_course(scene.touch).sides_pa
    areas_m2 = 1e-6 * np.array(side_areas_mm2(**_stated(touch)))
    if touch.contact_force_n is None and not touch.distal_onset_n:
        per_n = np.array(sides_pa(1.0))
        return force_n * per_n, per_n, areas_m2
    low_n, high_n = max(force_n - CONTACT_STEP_N, 0.0), force_n + CONTACT_STEP_N
    before, here, after = np.transpose(sides_pa([low_n, force_n, high_n]))
    # A pressure that grows with force^(1/3) on an area that grows with force^(2/3).
    growth = 1.0 if touch.contact_force_n is None else 3.0 * (high_n / touch.contact_force_n) ** (2.0 / 3.0)
    return here, (after - before) / (high_n - low_n), growth * areas_m2
