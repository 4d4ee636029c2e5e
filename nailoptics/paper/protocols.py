"""The touches of the paper's figures: which pressures press where, over time and held.

Figs. 10 and 15, 16 press on the proximal pulp alone, Figs. 17 and 18 on the distal pulp alone, Fig. 11 on both at once,
and Fig. 12 on the side whose reading it shows. Figs. 10-12 are the paper's model and state pressures; Figs. 15-18 are
its experiments and state forces, of which 1 N on one side is 1 N/cm^2.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from ..hemodynamics.touch import Contact, creeping_pressure
from ..hemodynamics.zones import zones_between
from ..scene.base import USUAL_BONE_EDGE_MM
from ..scene.finger import Finger

# 1 N/cm^2, the paper's unit of pressure. [Pa]
N_PER_CM2 = 1e4
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
class Protocol:
    """Pressures over time, each from rest: one that is there at the first instant is a step at that instant.

    time_s : (T,) float. Instants between which the pressures are linear. [s]
    proximal_pa, distal_pa : (S, T) float. Of S touches. [Pa]
    """

    time_s: np.ndarray
    proximal_pa: np.ndarray
    distal_pa: np.ndarray


def steps(*, distal_part: float) -> Protocol:
    """The paper's steps of pressure, on at 0 and off at 2 s: Fig. 10 (distal_part 0) and Fig. 11 (1).

    Their phases are samples 0 to 80 and, from just after the release, 81 to 161.
    """
    time = np.concatenate([PHASE_S, [ON_S + _RELEASE_S], ON_S + PHASE_S[1:]])
    touch = STEPS_PA[:, None] * (time <= ON_S)
    return Protocol(time, touch, distal_part * touch)


def one_sided(time_s: ArrayLike, force_n: ArrayLike) -> Protocol:
    """A force over time on the proximal pulp, and the same on the distal pulp: two touches (Figs. 15-18)."""
    time = np.asarray(time_s, dtype=float)
    proximal, none = Contact(proximal_share=1.0).pressures(force_n)
    distal = creeping_pressure(time, Contact(proximal_share=0.0).pressures(force_n)[1], relaxation_s=RELAXATION_S)
    return Protocol(time, np.stack([proximal, none]), np.stack([none, distal]))


def cycle() -> Protocol:
    """The static experiments: 0 to 2 N and back at 0.05 Hz, thrice (Figs. 15 and 17), where it passes CURVE_PA."""
    force = np.concatenate([CURVE_PA, CURVE_PA[-2::-1]]) / N_PER_CM2
    rising = np.arccos(1.0 - 2.0 * CURVE_PA / CURVE_PA[-1]) / (2.0 * np.pi)
    turn = np.concatenate([rising, 1.0 - rising[-2::-1]])[1:]
    time = np.concatenate([[0.0], *(turns + turn for turns in range(CYCLES))]) / CYCLE_HZ
    return one_sided(time, np.append(0.0, np.tile(force[1:], CYCLES)))


def press() -> Protocol:
    """A force of 1 N like the subjects', on at 0 and off at 2 s (Figs. 16 and 18): phases 0 to 80 and 80 to 160."""
    time = np.concatenate([PHASE_S, ON_S + PHASE_S[1:]])
    return one_sided(time, subject_force(time))


def even() -> np.ndarray:
    """Pressures of even touches, (2, F): of EVEN_N, and then of EVEN_N[SHEARED] with SHEAR_N of shear. [Pa]

    The pulp meets what it presses first: only from ONSET_N on its tip does, too.
    """
    touch = np.array(Contact(distal_onset_n=ONSET_N, distal_area_mm2=DISTAL_AREA_MM2).pressures(EVEN_N))
    sheared = touch[:, SHEARED] + [0.0, Contact(distal_area_mm2=DISTAL_AREA_MM2).shear_pressure(SHEAR_N)]
    return np.column_stack([touch, sheared])


def subject_force(time_s: ArrayLike) -> np.ndarray:
    """The force of the paper's subjects over time, 1 N from 0 s on: exponential, with 0.16 s on loading and 0.12 s on
    unloading. [N]

    References: Mascaro and Asada 2001, Figs. 16 and 18.
    """
    time = np.asarray(time_s, dtype=float)
    top = 1.0 - np.exp(-ON_S / LOADING_S)
    loading = 1.0 - np.exp(-np.maximum(time, 0.0) / LOADING_S)
    return np.where(time < ON_S, loading, top * np.exp(-np.maximum(time - ON_S, 0.0) / UNLOADING_S))
