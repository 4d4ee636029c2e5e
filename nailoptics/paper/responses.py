"""What vessels do under the touches of the paper's figures, for a set of parameters: steady states and over time."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..hemodynamics.parameters import Parameters
from ..hemodynamics.respond import respond
from ..hemodynamics.steady import steady_state
from ..hemodynamics.touch import PAPER_ZONES, Zones
from .protocols import CURVE_PA, FINGER_ZONES, N_PER_CM2, PHASE_S, Protocol, cycle, one_sided, press, steps

# Steady widths from the (S,) proximal and distal pressures, and widths over time from a touch: (N+1, *B, S) or
# (N+1, *B, S, T) float, capillary units and then the vein. [m]
Steady = Callable[[np.ndarray, np.ndarray, Zones], np.ndarray]
Follow = Callable[[Protocol, Zones], np.ndarray]


@dataclasses.dataclass(frozen=True)
class Responses:
    """What every figure shows; B is a batch shape, () for one set.

    Diameters of [proximal capillary, distal capillary, vein] in the paper's network: [m]
    proximal, distal, both : (3, *B, 41) float. Steady, with P_F1 alone, P_F2 alone or P_F1 = P_F2 on CURVE_PA.
    proximal_on, proximal_off, both_on, both_off : (3, *B, 10, 81) float. Over PHASE_S after each step on and off.

    The finger of the experiments, [proximal reading with force there alone, distal reading with force there alone]: [1]
    cycle : (2, *B, 2, 41) float. On loading and on unloading between 0 and 2 N, the mean of three cycles.
    press_on, press_off : (2, *B, 81) float. Over PHASE_S after the subjects' force of 1 N comes and goes.
    white : (*B, 2) float. Part of the bed with less than half of its blood, under even touches of 1 and 4 N.
    """

    proximal: np.ndarray
    distal: np.ndarray
    both: np.ndarray
    proximal_on: np.ndarray
    proximal_off: np.ndarray
    both_on: np.ndarray
    both_off: np.ndarray
    cycle: np.ndarray
    press_on: np.ndarray
    press_off: np.ndarray
    white: np.ndarray


def simulate_responses(parameters: Parameters) -> Responses:
    """The responses of one set, by `steady_state` and `respond`."""

    def steady(proximal: np.ndarray, distal: np.ndarray, zones: Zones) -> np.ndarray:
        state = steady_state(parameters, proximal_pressure_pa=proximal, distal_pressure_pa=distal, zones=zones)
        return np.vstack([state.capillary_diameter_m, state.vein_diameter_m[None]])

    return responses_of(steady, lambda touch, zones: _follow(parameters, touch, zones))


def _follow(parameters: Parameters, touch: Protocol, zones: Zones) -> np.ndarray:
    """Diameters under each touch, (N+1, S, T) float: capillary units and then the vein. [m]"""
    widths = []
    for proximal, distal in zip(touch.proximal_pa, touch.distal_pa, strict=True):
        given: dict[str, Any] = {"proximal_pressure_pa": proximal, "distal_pressure_pa": distal, "zones": zones}
        # A part in ten thousand of a diameter: no rule is that fine, and long cycles take a tenth of the time.
        run = respond(parameters, touch.time_s, rtol=1e-4, **given)
        widths.append(np.vstack([run["capillary_diameter_m"].values, run["vein_diameter_m"].values]))
    return np.stack(widths, axis=1)


def pressed(parameters: Parameters, time_s: ArrayLike, force_n: ArrayLike) -> np.ndarray:
    """The proximal reading with a force over time there alone, and the distal one with it there alone, (2, T). [1]"""
    return _own_readings(_follow(parameters, one_sided(time_s, force_n), FINGER_ZONES), FINGER_ZONES)


def _readings(width: np.ndarray, rest: np.ndarray, zones: Zones) -> np.ndarray:
    """The proximal and the distal reading, (2, ...) float, from (N+1, ...) diameters and those at rest. [1]

    Those of eq. (9) with unit gain, counted from rest: minus the change of blood, relative to rest. Each photodiode
    sees its half of the bed: the mean over its units, weighted by their shares.
    """
    blood = (width[: zones.count] / rest[: zones.count]) ** 2
    share, proximal = np.asarray(zones.share), zones.position < 0.5
    halves = [np.tensordot(share[half], blood[half], axes=1) / share[half].sum() for half in (proximal, ~proximal)]
    return 1.0 - np.array(halves)


def _own_readings(width: np.ndarray, zones: Zones) -> np.ndarray:
    """The proximal reading of the first touch and the distal one of the second, (2, ..., T), from (N+1, ..., 2, T)."""
    both = _readings(width, width[..., :1], zones)
    return np.stack([both[0, ..., 0, :], both[1, ..., 1, :]])


def responses_of(steady: Steady, follow: Follow) -> Responses:
    """What every figure shows, by a solver of steady states and one over time."""
    fields: dict[str, np.ndarray] = {}
    size = PHASE_S.size
    for name, proximal, distal in (("proximal", 1.0, 0.0), ("distal", 0.0, 1.0), ("both", 1.0, 1.0)):
        fields[name] = steady(proximal * CURVE_PA, distal * CURVE_PA, PAPER_ZONES)
    for name, distal_part in (("proximal", 0.0), ("both", 1.0)):
        width = follow(steps(distal_part=distal_part), PAPER_ZONES)
        fields[f"{name}_on"], fields[f"{name}_off"] = width[..., :size], width[..., size:]
    pressed = _own_readings(follow(press(), FINGER_ZONES), FINGER_ZONES)
    fields["press_on"], fields["press_off"] = pressed[..., :size], pressed[..., size - 1 :]
    fields["cycle"] = _branches(_own_readings(follow(cycle(), FINGER_ZONES), FINGER_ZONES))
    even = N_PER_CM2 * np.array([0.0, 1.0, 4.0])
    width = steady(even, even, FINGER_ZONES)[:-1]
    white = (width / width[..., :1]) ** 2 < 0.5
    fields["white"] = np.tensordot(FINGER_ZONES.share, white[..., 1:], axes=1) / sum(FINGER_ZONES.share)
    return Responses(**fields)


def _branches(course: np.ndarray) -> np.ndarray:
    """The mean loading and unloading, (..., 2, 41) on CURVE_PA, of a course over whole cycles, (..., T)."""
    branch = CURVE_PA.size - 1
    turns = range(0, course.shape[-1] - 1, 2 * branch)
    loading = np.mean([course[..., i : i + branch + 1] for i in turns], axis=0)
    unloading = np.mean([course[..., i + branch : i + 2 * branch + 1] for i in turns], axis=0)
    return np.stack([loading, unloading[..., ::-1]], axis=-2)
