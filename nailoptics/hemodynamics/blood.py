"""Eq. (7): blood fraction of the nail bed from capillary diameters, and the tissue volume that it implies."""

import functools
import math

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError
from ..scene import Blood
from ..scene.base import USUAL_BLOOD_FRACTION
from .parameters import Parameters
from .steady import steady_state


def blood_fraction(
    parameters: Parameters, capillary_diameter_m: ArrayLike, *, rest_blood_fraction: float = USUAL_BLOOD_FRACTION
) -> np.ndarray:
    """The part of the nail bed that is blood, from the diameter of its capillaries: it goes with their square. [1]

    capillary_diameter_m : any shape, float. D_C + x_C. [m]
    rest_blood_fraction : Fraction without touch, P_H and P_L as in the parameters; 0.01-0.05 in a nail bed. [1]

    The paper's areas and diameters disagree on volume: eq. (3)-(4) displace A dx/dt. The motion follows (3)-(4), the
    blood follows (7), as in the paper.

    Raises: InputError if the rest fraction is not between 0 and 1, a diameter is not positive, or the result would
    be more than 1.

    References: Mascaro and Asada 2001, eq. (7).
    """
    fraction = _rest_fraction(rest_blood_fraction)
    diameter = finite("capillary_diameter_m", capillary_diameter_m)
    if np.any(diameter <= 0.0):
        raise InputError(f"capillary_diameter_m must be positive, got {diameter.min():g} m.")
    result = fraction * (diameter / _rest_diameter(parameters)) ** 2
    if np.any(result > 1.0):
        raise InputError(
            f"rest_blood_fraction {fraction:g} makes a blood fraction of {result.max():.3g}, more than 1; "
            "lower it or the suction."
        )
    return result


def saturation(blood: Blood, blood_fraction: ArrayLike) -> np.ndarray:
    """The oxygen saturation of the blood in a zone of the bed, from how much blood flowed in that did not flow out.

    blood : of a scene: saturation of the blood that flows in and, if given, out. In a finger at rest they are some 0.08
        apart (Nitzan 2000, J. Biomed. Opt. 5:155).
    blood_fraction : any shape, float. Blood in the zone. [1]

    At rest blood gives off its oxygen evenly along a capillary: the zone has the mean of both. A touch that shuts the
    veins lets the arteries pool fresh blood in it (the paper's section II): what is there beyond rest is arterial. What
    is squeezed out is blood as it was. Tissue needs minutes to use up what pooled; that is left out.
    """
    fraction = np.asarray(blood_fraction, dtype=float)
    at_rest = blood.rest_so2
    pooled = np.maximum(fraction - blood.rest_blood_fraction, 0.0)
    part = np.divide(pooled, fraction, out=np.zeros_like(fraction), where=fraction > 0.0)
    return at_rest + (blood.so2 - at_rest) * part


def white_band_mm(v_mm: np.ndarray, part: np.ndarray, *, ends_mm: tuple[float, float]) -> np.ndarray:
    """Width of the white band at the tip, where less than half of the value at rest is left, (..., s) float. [mm]

    v_mm : (p,) float. Places along the nail, from the most proximal on. [mm]
    part : (..., p, s) float. Blood, or the redness that it gives, at each place in each state, over that at rest;
        linear between places.
    ends_mm : where the nail begins and ends. [mm]
    """
    white = part[..., -1, :] < 0.5
    width = np.where(white, ends_mm[1] - ends_mm[0], 0.0)
    for k in range(len(v_mm) - 2, -1, -1):
        ends_here = white & (part[..., k, :] >= 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (part[..., k, :] - 0.5) / (part[..., k, :] - part[..., k + 1, :]) * (v_mm[k + 1] - v_mm[k])
        width = np.where(ends_here, ends_mm[1] - v_mm[k] - step, width)
        white &= ~ends_here
    return width


def tissue_volume_m3(parameters: Parameters, *, rest_blood_fraction: float = USUAL_BLOOD_FRACTION) -> float:
    """The volume of one half of the nail bed, V_tissue of eq. (7), from its blood fraction at rest. [m^3]

    Raises: InputError if the fraction is not between 0 and 1.
    """
    p = parameters
    blood = p.capillary_count * p.capillary_length_m * math.pi * _rest_diameter(p) ** 2 / 4.0
    return blood / _rest_fraction(rest_blood_fraction)


@functools.lru_cache(64)
def _rest_diameter(parameters: Parameters) -> float:
    return float(steady_state(parameters).capillary_diameter_m[0])


def _rest_fraction(value: float) -> float:
    fraction = number("rest_blood_fraction", value)
    if not 0.0 < fraction < 1.0:
        raise InputError(
            f"rest_blood_fraction must lie between 0 and 1, got {fraction:g}; {USUAL_BLOOD_FRACTION:g} is usual."
        )
    return fraction
