"""The blood states over which reduced optics and traced light are compared: a force, blood or saturation sweep."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...errors import InputError
from ...light import optics
from ...scene import Scene
from ..blood_states import largest_force_n, steady_blood

Over = Literal["force", "blood", "saturation"]
OVER: tuple[Over, ...] = ("force", "blood", "saturation")
POINTS = 41
LARGEST_BLOOD_FRACTION, LEAST_SO2 = 0.1, 0.5


@dataclass(frozen=True)
class StateSweep:
    """States over which the models are judged; the first is where the predicted ones start from.

    setting : (t,) float. Force [N], blood fraction or saturation.
    blood : (t, zones) float. so2 : (t,) float.
    """

    over: Over
    setting: np.ndarray
    blood: np.ndarray
    so2: np.ndarray


def state_sweep(scene: Scene, over: Over) -> StateSweep:
    """The steady force from 0 to the touch's largest, the blood fraction of all zones, or the saturation."""
    so2, zones = scene.blood.rest_so2, optics.zones(scene).count
    along, same_so2 = np.linspace(0, 1, POINTS), np.full(POINTS, so2)
    if over == "blood":
        blood = along * LARGEST_BLOOD_FRACTION
        return StateSweep(over, blood, np.repeat(blood[:, None], zones, 1), same_so2)
    if over == "saturation":
        saturation = 1 - along * (1 - LEAST_SO2)
        return StateSweep(over, saturation, np.full((POINTS, zones), scene.blood.rest_blood_fraction), saturation)
    if over != "force":
        raise InputError(f'over = "{over}" is not known; choose from {", ".join(OVER)}.')
    largest = largest_force_n(scene)
    if largest <= 0:
        raise InputError("touch: the force never leaves 0, so there is no range to compare over; give a force.")
    force = along * largest
    return StateSweep(over, force, steady_blood(scene, force), same_so2)
