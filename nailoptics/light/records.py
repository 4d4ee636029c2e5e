"""What a trace keeps of the light: records of detected photons, and where the energy went."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Batch:
    """What one batch left behind: detected photons, and energy sums (weight and its square) by where it went."""

    photons: int
    photodiode: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    energy: dict[str, tuple[float, float]]
    events: int
