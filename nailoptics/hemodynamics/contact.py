"""From a force on the fingertip to the pressures on the vessels."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError
from ..scene.base import USUAL_CONTACT_AREA_MM2


def pressures(
    force_n: ArrayLike, contact_area_mm2: float = USUAL_CONTACT_AREA_MM2, proximal_share: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    """The proximal and the distal pressure, P_F1 and P_F2, that a force on the fingertip gives. [Pa]

    force_n : any shape, float, 0 or more. Normal force. [N]
    contact_area_mm2 : Area of the whole touch, half of it proximal and half distal. [mm^2]
    proximal_share : Part of the force that the proximal half carries, 0 to 1. [1]

    Each half of the contact carries its share on half the area: P_F1 = share F / (area/2), P_F2 = (1-share) F /
    (area/2). The forces add up to F, and at an even share both pressures are F/area: 1 N on 1 cm^2 is 1 N/cm^2 on both,
    which puts the paper's model (level near 1 N/cm^2) and its experiments (level near 1 N) on one axis.

    Raises: InputError if the force is negative or not finite, the area is not positive, or the share is not in 0..1.
    """
    force = finite("force_n", force_n)
    if np.any(force < 0.0):
        raise InputError(f"force_n must be 0 or more, got {force.min():g} N; a finger pushes, it does not pull.")
    area = number("contact_area_mm2", contact_area_mm2)
    if area <= 0.0:
        raise InputError(f"contact_area_mm2 must be greater than 0, got {area:g}; {USUAL_CONTACT_AREA_MM2:g} is usual.")
    share = number("proximal_share", proximal_share)
    if not 0.0 <= share <= 1.0:
        raise InputError(f"proximal_share must lie in 0..1, got {share:g}; 0.5 is an even touch.")
    even = force / (area * 1e-6)
    return 2.0 * share * even, 2.0 * (1.0 - share) * even
