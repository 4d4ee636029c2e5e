"""Arteriolar blood of the nail bed: its volume follows the transmural pressure by a sigmoid curve, with collapse."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array
from ..scene import Body

# Width of the logistic curve, fitted to the pulse of 136 to 140 people that falls to 0.7-0.8 of its maximum where the
# contact pressure is 30 mmHg above that of the maximum. [Pa]
WIDTH_PA = 2600.0


@dataclass(frozen=True)
class Arterioles:
    """Small arteries and arterioles of the bed, beside the capillaries of the paper's network.

    blood_fraction : Volume fraction of their blood at the mean pressure without touch. [1]
    peak_pa : Transmural pressure at which they are most compliant. [Pa]
    mean_pa : Mean arterial pressure. [Pa]
    pulse_ratio : Their pulse pressure over that of P_H, which acts behind them. [1]

    V(P) = V_max / (1 + exp(-(P - peak_pa) / width)): compliance falls off exponentially on both sides, as in models of
    oscillometry. They follow the pressure at once.

    References: G. Drzewiecki, R. Hood, H. Apple, Ann. Biomed. Eng. 22, 88 (1994); G. J. Langewouters et al., Clin.
    Phys. Physiol. Meas. 7, 43 (1986) for the fingers' arteries.
    """

    blood_fraction: float
    peak_pa: float
    mean_pa: float
    pulse_ratio: float

    def fraction(self, transmural_pa: ArrayLike) -> Array:
        """Volume fraction of their blood, any shape. [1]"""
        return self.blood_fraction * _sigmoid(transmural_pa, self.peak_pa) / _sigmoid(self.mean_pa, self.peak_pa)

    def compliance_per_pa(self, transmural_pa: ArrayLike) -> Array:
        """Change of that fraction with the pressure, any shape. [Pa^-1]"""
        return self.fraction(transmural_pa) * (1.0 - _sigmoid(transmural_pa, self.peak_pa)) / WIDTH_PA


def arterioles_of(body: Body | None, *, mean_pa: float) -> Arterioles | None:
    """The arterioles of a body; None where no heart beats, as in the paper's own network."""
    heart = body.heartbeat if body is not None else None
    if heart is None or heart.pulse_pressure_pa == 0 or heart.arteriolar_blood_fraction == 0:
        return None
    ratio = heart.arterial_pulse_pressure_pa / heart.pulse_pressure_pa
    return Arterioles(heart.arteriolar_blood_fraction, heart.arteriolar_peak_pa, mean_pa, ratio)


def _sigmoid(transmural_pa: ArrayLike, peak_pa: float) -> Array:
    # By the hyperbolic tangent, which overflows for no pressure.
    return 0.5 + 0.5 * np.tanh((np.asarray(transmural_pa, float) - peak_pa) / (2.0 * WIDTH_PA))
