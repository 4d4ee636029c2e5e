"""The touches of the paper's figures, and what vessels do under them, for a set of parameters, steady and over time.

Figs. 10 and 15, 16 press on the proximal pulp alone, Figs. 17 and 18 on the distal pulp alone, Fig. 11 on both at once,
and Fig. 12 on the side whose reading it shows. Figs. 10-12 are the paper's model and state pressures; Figs. 15-18 are
its experiments and state forces, of which 1 N on one side is 1 N/cm^2.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..hemodynamics.blood import relative_blood
from ..hemodynamics.parameters import PA_PER_N_PER_CM2, Parameters, PerBed, each_bed
from ..hemodynamics.respond import respond
from ..hemodynamics.steady import steady_state
from ..hemodynamics.touch import Contact, relaxing_pressure
from ..hemodynamics.zones import PAPER_ZONES, Zones, zones_between
from ..scene.base import USUAL_BONE_EDGE_MM
from ..scene.finger import Finger

# Pressures of the static curves: 0 to 2 N/cm^2. (41,) [Pa]
CURVE_PA = np.linspace(0.0, 2e4, 41)
# The paper's steps: 0.1 to 1 N/cm^2. (10,) [Pa]
STEPS_PA = 1e3 * np.arange(1, 11)
# Each step is on from 0 to this instant and then off for as long. [s]
ON_S = 2.0
# Instants within each phase, dense after the step. (81,) [s]
PHASE_S = ON_S * np.linspace(0.0, 1.0, 81) ** 2
# Time constants of the subjects' force in the paper's Figs. 16 and 18. [s]
LOADING_S, UNLOADING_S = 0.16, 0.12
# The static experiments: a force to and fro between 0 and 2 N, as a sine.
CYCLE_HZ, CYCLES = 0.05, 3
# The finger of the experiments has what the paper names as missing from its model: the white zone spreads from the tip
# to the end of the bone, and the distal pulp recovers with one relaxation time.
FINGER = Finger()
FINGER_ZONES = zones_between(
    np.arange(1, 8) / 8,
    shield=(0.5 + FINGER.bone_end_mm / FINGER.nail_length_mm, USUAL_BONE_EDGE_MM / FINGER.nail_length_mm),
)
RELAXATION_S = 0.2
# Touches of the whole fingertip (section II and Fig. 2), and the one among them to which a shear is added.
EVEN_N = np.array([0.0, 0.3, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 16.0])
ONSET_N, SHEARED, SHEAR_N = 1.0, 4, 0.5
# Contact of its distal half, on which half of what exceeds ONSET_N presses: 1.4 N/cm^2 per newton. A choice, as the
# paper gives none: less than the 50 mm^2 of a touch on one side, as the tip is narrower.
DISTAL_AREA_MM2 = 36.0
# The release is a ramp this short, so that the touch is a step for every model here. [s]
_RELEASE_S = 1e-6


@dataclasses.dataclass(frozen=True)
class TouchProtocol:
    """Pressures over time, each from rest: one that is there at the first instant is a step at that instant.

    time_s : (T,) float. Instants between which the pressures are linear. [s]
    touch_pa : (2, S, T) float. Proximal and distal pressures of S touches. [Pa]
    """

    time_s: np.ndarray
    touch_pa: np.ndarray


def steps(*, distal_part: float) -> TouchProtocol:
    """The paper's steps of pressure, on at 0 and off at 2 s: Fig. 10 (distal_part 0) and Fig. 11 (1); their phases are
    samples 0 to 80 and, from just after the release, 81 to 161."""
    time = np.concatenate([PHASE_S, [ON_S + _RELEASE_S], ON_S + PHASE_S[1:]])
    touch = STEPS_PA[:, None] * (time <= ON_S)
    return TouchProtocol(time, np.stack([touch, distal_part * touch]))


def one_sided(time_s: ArrayLike, force_n: ArrayLike) -> TouchProtocol:
    """A force over time on the proximal pulp, and the same on the distal pulp: two touches (Figs. 15-18)."""
    time = np.asarray(time_s, dtype=float)
    proximal, none = Contact(proximal_share=1.0).pressures(force_n)
    distal = relaxing_pressure(time, Contact(proximal_share=0.0).pressures(force_n)[1], relaxation_s=RELAXATION_S)
    return TouchProtocol(time, np.array([[proximal, none], [none, distal]]))


def cycle() -> TouchProtocol:
    """The static experiments: 0 to 2 N and back at 0.05 Hz, thrice (Figs. 15 and 17), where it passes CURVE_PA."""
    force = np.concatenate([CURVE_PA, CURVE_PA[-2::-1]]) / PA_PER_N_PER_CM2
    rising = np.arccos(1.0 - 2.0 * CURVE_PA / CURVE_PA[-1]) / (2.0 * np.pi)
    turn = np.concatenate([rising, 1.0 - rising[-2::-1]])[1:]
    time = np.concatenate([[0.0], *(turns + turn for turns in range(CYCLES))]) / CYCLE_HZ
    return one_sided(time, np.append(0.0, np.tile(force[1:], CYCLES)))


def press() -> TouchProtocol:
    """A force of 1 N like the subjects', on at 0 and off at 2 s (Figs. 16 and 18): phases 0 to 80 and 80 to 160."""
    time = np.concatenate([PHASE_S, ON_S + PHASE_S[1:]])
    return one_sided(time, subject_force(time))


def even() -> np.ndarray:
    """Pressures of even touches, (2, F): of EVEN_N, and then of EVEN_N[SHEARED] with SHEAR_N of shear; the tip meets
    what the pulp presses only from ONSET_N on. [Pa]"""
    touch = np.array(Contact(distal_onset_n=ONSET_N, distal_area_mm2=DISTAL_AREA_MM2).pressures(EVEN_N))
    sheared = touch[:, SHEARED] + [0.0, Contact(distal_area_mm2=DISTAL_AREA_MM2).shear_pressure(SHEAR_N)]
    return np.column_stack([touch, sheared])


def subject_force(time_s: ArrayLike) -> np.ndarray:
    """The force of the paper's subjects over time, 1 N from 0 s on: exponential (Figs. 16 and 18). [N]"""
    time = np.asarray(time_s, dtype=float)
    top = 1.0 - np.exp(-ON_S / LOADING_S)
    loading = 1.0 - np.exp(-np.maximum(time, 0.0) / LOADING_S)
    return np.where(time < ON_S, loading, top * np.exp(-np.maximum(time - ON_S, 0.0) / UNLOADING_S))


# Steady widths [m] and blood pressures over P_H from (2, S) proximal and distal pressures, with k_C and k_V times two
# factors, and widths over time from a touch: (N+1, *B, S) or (N+1, *B, S, T) float, capillary units and then the vein.
Steady = Callable[[np.ndarray, Zones, tuple[float, float]], tuple[np.ndarray, np.ndarray]]
Follow = Callable[[TouchProtocol, Zones], np.ndarray]
# People differ in their walls: k_C and k_V of a set times these. The paper tunes both for each subject.
PEOPLE = ((0.7, 0.7), (0.7, 1.4), (1.4, 0.7), (1.4, 1.4))


@dataclasses.dataclass(frozen=True)
class Responses:
    """What every figure shows; B is a batch shape, () for one set.

    Diameters of [proximal capillary, distal capillary, vein] in the paper's network: [m]
    proximal : (3, *B, 41) float. Steady, with P_F1 alone on CURVE_PA.
    proximal_on, proximal_off : (3, *B, 10, 81) float. Over PHASE_S after each step of P_F1 alone on and off.
    Blood pressures there over P_H: [1]
    pressure : (3, *B, 41) float. Steady, with P_F1 alone on CURVE_PA.

    Blood over that at rest, [proximal bed, distal bed] in the paper's network: [1]
    alone : (2, *B, 41) float. Steady, each bed with the pressure on its own side alone, on CURVE_PA.
    both : (2, *B, 41) float. Steady, with P_F1 = P_F2 on CURVE_PA.
    both_on, both_off : (2, *B, 10, 81) float. Over PHASE_S after each step of both on and off.
    people : (4, 2, *B) float. `alone` at 2 N/cm^2 of PEOPLE.

    The finger of the experiments, [proximal reading with force there alone, distal reading with force there alone]: [1]
    cycle : (2, *B, 2, 41) float. On loading and on unloading between 0 and 2 N, the mean of three cycles.
    press_on, press_off : (2, *B, 81) float. Over PHASE_S after the subjects' force of 1 N comes and goes.
    even : (8, *B, F) float. Blood over that at rest of the zones, under the even touches of `even`.
    """

    proximal: np.ndarray
    proximal_on: np.ndarray
    proximal_off: np.ndarray
    pressure: np.ndarray
    alone: np.ndarray
    both: np.ndarray
    both_on: np.ndarray
    both_off: np.ndarray
    people: np.ndarray
    cycle: np.ndarray
    press_on: np.ndarray
    press_off: np.ndarray
    even: np.ndarray


@dataclasses.dataclass(frozen=True)
class PeopleReadings:
    """What the sensors of P people read in Figs. 15 to 18, [proximal side, distal side], each with the force there.

    cycle, press_on, press_off : (2, P, ...) float. As of `Responses`, changes relative to rest. [1]
    cycle_fit, press_fit : (2, P, 2, 41) and (2, P, 161) float. The same, fitted by Taylor (9). [1]
    skin_effect : (2, P, 2) float. Part by which the darkest skin in place of the lightest changes the reading at rest
        and its change by 2 N. [1]
    """

    cycle: np.ndarray
    press_on: np.ndarray
    press_off: np.ndarray
    cycle_fit: np.ndarray
    press_fit: np.ndarray
    skin_effect: np.ndarray

    def without(self, person: int) -> "PeopleReadings":
        """The readings of all other people, as by a jackknife."""
        return PeopleReadings(**{name: np.delete(values, person, axis=1) for name, values in vars(self).items()})


def simulate_responses(parameters: Parameters) -> Responses:
    """The responses of one set, by `steady_state` and `respond`."""
    p = parameters

    def steady(touch: np.ndarray, zones: Zones, stiffness: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        person = p.replace(
            capillary_stiffness_n_per_m=each_bed(lambda k: k * stiffness[0], p.capillary_stiffness_n_per_m),
            vein_stiffness_n_per_m=p.vein_stiffness_n_per_m * stiffness[1],
        )
        state = steady_state(person, pressure_pa=touch, zones=zones)
        pressure = np.vstack([state.capillary_pressure_pa, state.vein_pressure_pa[None]])
        return np.vstack([state.capillary_diameter_m, state.vein_diameter_m[None]]), pressure / p.arterial_pressure_pa

    def follow(touch: TouchProtocol, zones: Zones) -> np.ndarray:
        widths = []
        for pressure_pa in np.moveaxis(touch.touch_pa, 1, 0):
            # A part in ten thousand of a diameter: no rule is that fine, and long cycles take a tenth of the time.
            run = respond(p, touch.time_s, rtol=1e-4, pressure_pa=pressure_pa, zones=zones)
            widths.append(np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values]))
        return np.stack(widths, axis=1)

    return responses_of(steady, follow, (p.venular_share, p.venular_closing_pressure_pa))


def _blood(width: np.ndarray, touch: np.ndarray, zones: Zones, venules: tuple[PerBed, PerBed]) -> np.ndarray:
    """Blood of units over that at their first sample, (N, *B, ...), from widths of (N+1, *B, ...) and a touch of
    (2, ...) float, proximal and distal pressure. [Pa]"""
    axes = (zones.count,) + (1,) * (width.ndim - touch.ndim)
    outside = zones.on_walls(touch)[:-1].reshape(*axes, *touch.shape[1:])
    units = [np.array(zones.of_beds(venule)) for venule in venules]
    share, closing_pa = (unit.reshape(unit.shape + (1,) * (width.ndim - unit.ndim)) for unit in units)
    return relative_blood(width[:-1] / width[:-1, ..., :1], share, touch_pa=outside, closing_pa=closing_pa)


def _own_readings(width: np.ndarray, touch: TouchProtocol, venules: tuple[PerBed, PerBed]) -> np.ndarray:
    """The proximal reading of the first touch and the distal one of the second, (2, *B, T), from (N+1, *B, 2, T). [1]

    Those of Taylor (9) with unit gain, counted from rest: minus the change of blood, relative to rest. Each photodiode
    sees its half of the bed: the mean over its units, weighted by their shares.
    """
    zones, blood = FINGER_ZONES, _blood(width, touch.touch_pa, FINGER_ZONES, venules)
    share, proximal = np.asarray(zones.share), zones.position < 0.5
    halves = [np.tensordot(share[half], blood[half], axes=1) / share[half].sum() for half in (proximal, ~proximal)]
    return 1.0 - np.stack([halves[0][..., 0, :], halves[1][..., 1, :]])


def responses_of(steady: Steady, follow: Follow, venules: tuple[PerBed, PerBed]) -> Responses:
    """What every figure shows, by a solver of steady states, one over time, and venular share and closing pressure."""
    fields: dict[str, np.ndarray] = {}
    size, usual, none = PHASE_S.size, (1.0, 1.0), np.zeros_like(CURVE_PA)
    sides = np.stack([CURVE_PA, none]), np.stack([none, CURVE_PA])
    fields["proximal"], fields["pressure"] = steady(sides[0], PAPER_ZONES, usual)

    def held(touch: np.ndarray, zones: Zones, stiffness: tuple[float, float] = usual) -> np.ndarray:
        return _blood(steady(touch, zones, stiffness)[0], touch, zones, venules)

    ends = np.array([[0.0, CURVE_PA[-1], 0.0], [0.0, 0.0, CURVE_PA[-1]]])
    fields["alone"] = np.stack([held(touch, PAPER_ZONES)[side] for side, touch in enumerate(sides)])
    fields["both"] = held(np.stack([CURVE_PA, CURVE_PA]), PAPER_ZONES)
    people = [held(ends, PAPER_ZONES, stiffness) for stiffness in PEOPLE]
    fields["people"] = np.array([[blood[0, ..., 1], blood[1, ..., 2]] for blood in people])
    width = follow(steps(distal_part=0.0), PAPER_ZONES)
    fields["proximal_on"], fields["proximal_off"] = width[..., :size], width[..., size:]
    touch = steps(distal_part=1.0)
    blood = _blood(follow(touch, PAPER_ZONES), touch.touch_pa, PAPER_ZONES, venules)
    fields["both_on"], fields["both_off"] = blood[..., :size], blood[..., size:]
    pressed = _own_readings(follow(press(), FINGER_ZONES), press(), venules)
    fields["press_on"], fields["press_off"] = pressed[..., :size], pressed[..., size - 1 :]
    fields["cycle"] = branches(_own_readings(follow(cycle(), FINGER_ZONES), cycle(), venules))
    fields["even"] = held(even(), FINGER_ZONES)
    return Responses(**fields)


def branches(course: np.ndarray) -> np.ndarray:
    """The mean loading and unloading, (..., 2, 41) on CURVE_PA, of a course over whole cycles, (..., T)."""
    branch = CURVE_PA.size - 1
    turns = range(0, course.shape[-1] - 1, 2 * branch)
    loading = np.mean([course[..., i : i + branch + 1] for i in turns], axis=0)
    unloading = np.mean([course[..., i + branch : i + 2 * branch + 1] for i in turns], axis=0)
    return np.stack([loading, unloading[..., ::-1]], axis=-2)
