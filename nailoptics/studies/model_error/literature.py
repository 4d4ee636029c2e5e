"""The paper's formulas (8) and (9) with constants from literature alone: what its reader has without a simulation."""

import math
from collections.abc import Callable

import numpy as np

from ... import tissue
from ...hemodynamics.for_scene import zones_of_photodiodes
from ...scene import Scene

# Mean path of detected light over the distance from source to detector: adult forearm, 807 nm, distances of
# centimetres: 4.16 +- 0.78 (Duncan et al. 1995, Phys. Med. Biol. 40, 295). None was found for a finger or millimetres.
PATH_FACTOR = 4.16
# Relative change of a reading from the change of the optical depth along its path.
FORMULAS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Taylor (9)": np.negative,
    "Beer-Lambert (8)": lambda depth: np.expm1(-depth),
}


def changes(scene: Scene, name: str, blood_fraction: np.ndarray) -> np.ndarray:
    """Relative change of every reading from the first blood state on, (led, photodiode, states) float.

    Each photodiode sees the blood of the zone above which it lies, along a path of 4.16 times its distance from the
    LED, at the LED's peak wavelength. The reading at rest, V0 + V1 of the paper, no literature tells.

    name : of `FORMULAS`.
    blood_fraction : (states, zones) float in 0-1.
    """
    layout = scene.layout
    path_mm = PATH_FACTOR * np.array(
        [[math.dist(led.center_mm, area.center_mm) for area in layout.photodiode_areas] for led in layout.leds]
    )
    mu_a = np.array([tissue.blood_mu_a_per_mm(led.wavelength_nm, scene.blood.rest_so2) for led in scene.leds])
    more = (blood_fraction - blood_fraction[0])[:, zones_of_photodiodes(scene)]
    return FORMULAS[name]((path_mm * mu_a[:, None])[..., None] * more.T)
