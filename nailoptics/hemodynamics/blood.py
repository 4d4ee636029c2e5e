"""Eq. (7): blood fraction of the nail bed from capillary diameters, its saturation, and the blood of arterioles."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Array, fraction, positive
from ..scene import Blood
from ..scene.base import USUAL_BLOOD_FRACTION
from .parameters import Parameters
from .steady import steady_state
from .zones import PAPER_ZONES, Zones

# Width of the logistic curve, fitted to the pulse of 136 to 140 people that falls to 0.7-0.8 of its maximum where the
# contact pressure is 30 mmHg above that of the maximum. [Pa]
WIDTH_PA = 2600.0


def blood_fraction(
    parameters: Parameters,
    capillary_diameter_m: ArrayLike,
    *,
    rest_blood_fraction: float = USUAL_BLOOD_FRACTION,
    touch_pa: ArrayLike = 0.0,
    zones: Zones = PAPER_ZONES,
    unit: int | None = None,
) -> np.ndarray:
    """The fraction of the nail bed that is blood, from the diameter of its capillaries: it goes with their square. [1]

    capillary_diameter_m : float. D_C + x_C: (N, ...) of the zones' units, (...) of one unit; any shape where both beds
        have the same constants. [m]
    rest_blood_fraction : Fraction without touch, P_H and P_L as in the parameters; 0.01-0.05 in a nail bed. [1]
    touch_pa : That broadcasts. Touch pressure on the capillaries, which closes venules where the parameters have some
        (beyond the paper): a share of the blood, in proportion to the pressure. [Pa]
    unit : The zone whose diameters are given; None for all.

    Raises: InputError if the rest fraction is not in 0..1, a diameter is not positive, or the result is more than 1.

    References: Mascaro and Asada 2001, eq. (7).
    """
    diameter = positive("capillary_diameter_m", capillary_diameter_m)
    rest_m, share, closing_pa = constants = _of_units(parameters, zones)
    if unit is not None:
        rest_m, share, closing_pa = (constant[unit] for constant in constants)
    elif np.ptp(rest_m) == np.ptp(share) == np.ptp(closing_pa) == 0.0:
        rest_m, share, closing_pa = (constant[0] for constant in constants)
    else:
        rest_m, share, closing_pa = (constant.reshape(-1, *(1,) * (diameter.ndim - 1)) for constant in constants)
    rest_fraction = fraction("rest_blood_fraction", rest_blood_fraction)
    result = rest_fraction * relative_blood(diameter / rest_m, share, touch_pa=touch_pa, closing_pa=closing_pa)
    return fraction("blood_fraction", result, f"lower blood.rest_blood_fraction = {rest_fraction:g} or the suction")


def relative_blood(
    width: ArrayLike, venular_share: ArrayLike, *, touch_pa: ArrayLike, closing_pa: ArrayLike
) -> np.ndarray:
    """Blood of a capillary bed over that at rest, of the arguments' broadcast shape. [1]

    width : diameter of the capillaries over that at rest. venular_share : of the blood at rest, 0-1. [1]
    touch_pa : touch pressure on the bed. closing_pa : touch pressure that closes its venules. [Pa]
    """
    venules = np.clip(1.0 - np.asarray(touch_pa) / closing_pa, 0.0, 1.0)
    share = np.asarray(venular_share)
    return np.asarray((1.0 - share) * np.square(width) + share * venules)


def saturation(blood: Blood, blood_fraction: ArrayLike) -> np.ndarray:
    """The oxygen saturation of the blood in a zone of the bed, from how much blood flowed in that did not flow out.

    blood : of a scene: saturation of the blood that flows in and, if given, out. In a finger at rest they are some 0.08
        apart (Nitzan 2000, J. Biomed. Opt. 5:155).
    blood_fraction : any shape, float. Blood in the zone. [1]

    At rest the zone has the mean of both. A touch that shuts the veins lets the arteries pool fresh blood in it (the
    paper's section II): what is there beyond rest is arterial. What is squeezed out is blood as it was.
    """
    fraction = np.asarray(blood_fraction, dtype=float)
    at_rest = blood.rest_so2
    pooled = np.maximum(fraction - blood.rest_blood_fraction, 0.0)
    part = np.divide(pooled, fraction, out=np.zeros_like(fraction), where=fraction > 0.0)
    return at_rest + (blood.so2 - at_rest) * part


def added_saturation(blood: Blood, blood_fraction: ArrayLike) -> np.ndarray:
    """The saturation of the blood by which that of a zone grows or shrinks, of its shape [1]: as for `saturation`,
    arterial beyond what is there at rest, else as at rest."""
    return np.where(np.asarray(blood_fraction) > blood.rest_blood_fraction, blood.so2, blood.rest_so2)


def saturation_over_time(
    blood: Blood, time_s: ArrayLike, blood_fraction: ArrayLike, flow: ArrayLike, *, flow_before: ArrayLike = 1.0
) -> np.ndarray:
    """The oxygen saturation of the blood in each zone by the balance of inflow and consumption, (zones, t) float.

    blood : of a scene, with venous_so2.
    time_s : (t,) float. [s]
    blood_fraction : (zones, t) float. Blood in capillaries, without the pulse. [1]
    flow : (zones, t) float. What flows through them over that at rest. [1]
    flow_before : (zones,) float. The same before the first sample, with which the saturation begins in balance. [1]

    Blood f of saturation S loses oxygen evenly from inflow (S_a) to outflow (2 S - S_a), fills with arterial blood and
    is squeezed out as it is: f dS/dt = (2 q + max(df/dt, 0)) (S_a - S) - q_0 (S_a - S_v), with the flow q, which at
    rest is q_0 = f_0 / exchange_s, and consumption as at rest as long as there is oxygen.

    References: M. Nitzan et al., J. Biomed. Opt. 5, 155 (2000), inflow x (S_a - S_v) = consumption; G. N. Stamatas, N.
    Kollias, J. Biomed. Opt. 9, 315 (2004), stasis in skin.
    """
    assert blood.venous_so2 is not None
    fraction, through = np.asarray(blood_fraction, float), np.asarray(flow, float)
    rest_flow = blood.rest_blood_fraction / blood.exchange_s
    used = rest_flow * (blood.so2 - blood.venous_so2)
    step_s, tiny = np.diff(time_s), np.finfo(float).tiny
    filled = np.maximum(np.diff(fraction), 0.0)
    # Within a step the rates are constant: exact for any length of it.
    mean = np.maximum(0.5 * (fraction[:, 1:] + fraction[:, :-1]), tiny)
    exchanged = (rest_flow * (through[:, 1:] + through[:, :-1]) * step_s + filled) / mean
    part = -np.expm1(-exchanged)
    lost = used * step_s / mean * np.divide(part, exchanged, out=np.ones_like(part), where=exchanged > 1e-12)
    below = np.empty_like(fraction)
    below[:, 0] = np.minimum(used / np.maximum(2.0 * rest_flow * np.asarray(flow_before, float), tiny), blood.so2)
    for k in range(len(step_s)):
        below[:, k + 1] = np.minimum(below[:, k] * (1.0 - part[:, k]) + lost[:, k], blood.so2)
    return np.asarray(blood.so2 - below)


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


@functools.lru_cache(64)
def _of_units(parameters: Parameters, zones: Zones) -> tuple[np.ndarray, ...]:
    """Diameter at rest [m], venular share and closing pressure [Pa] of each unit."""
    p = parameters
    venules = [np.array(zones.of_beds(value)) for value in (p.venular_share, p.venular_closing_pressure_pa)]
    if any(isinstance(value, tuple) for value in vars(p).values()):
        return steady_state(p, zones=zones, pressure_pa=np.zeros(zones.inputs)).capillary_diameter_m, *venules
    # All units rest at one diameter: that of the paper's two, to the last bit.
    return np.resize(steady_state(p).capillary_diameter_m[:1], zones.count), *venules


@dataclass(frozen=True)
class Arterioles:
    """Small arteries and arterioles of the bed, beside the capillaries of the paper's network.

    blood_fraction : Volume fraction of their blood at the mean pressure without touch. [1]
    peak_pa, mean_pa : Transmural pressure at which they are most compliant, and mean arterial pressure. [Pa]
    pulse_ratio : Their pulse pressure over that of P_H, which acts behind them. [1]

    V(P) = V_max / (1 + exp(-(P - peak_pa) / width)), as in models of oscillometry. They follow the pressure at once.

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


def _sigmoid(transmural_pa: ArrayLike, peak_pa: float) -> Array:
    # By the hyperbolic tangent, which overflows for no pressure.
    return 0.5 + 0.5 * np.tanh((np.asarray(transmural_pa, float) - peak_pa) / (2.0 * WIDTH_PA))
