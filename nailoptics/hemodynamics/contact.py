"""From a force on the fingertip to the pressures on the vessels."""

import numpy as np
from numpy.typing import ArrayLike

from ..checks import finite, number
from ..errors import InputError
from ..scene.base import USUAL_CONTACT_AREA_MM2


def pressures(
    force_n: ArrayLike,
    contact_area_mm2: float = USUAL_CONTACT_AREA_MM2,
    proximal_share: float = 0.5,
    *,
    proximal_area_mm2: float | None = None,
    distal_area_mm2: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The proximal and the distal pressure, P_F1 and P_F2, that a force on the fingertip gives. [Pa]

    force_n : any shape, float, 0 or more. Normal force. [N]
    contact_area_mm2, proximal_share, proximal_area_mm2, distal_area_mm2 : As for `side_areas_mm2`.

    Each side carries its share of the force on its own area, so that both forces add up to the touch's. By default 1 N
    on one side is 1 N/cm^2 there, and an even touch of 1 N is 1 N/cm^2 on both, which puts the paper's model (level
    near 1 N/cm^2) and its experiments (level near 1 N) on one axis.

    Raises: InputError if the force is negative or not finite, an area is not positive, or the share is not in 0..1.
    """
    force = finite("force_n", force_n)
    if np.any(force < 0.0):
        raise InputError(f"force_n must be 0 or more, got {force.min():g} N; a finger pushes, it does not pull.")
    proximal_mm2, distal_mm2 = side_areas_mm2(
        contact_area_mm2, proximal_share, proximal_area_mm2=proximal_area_mm2, distal_area_mm2=distal_area_mm2
    )
    return proximal_share * force / (proximal_mm2 * 1e-6), (1.0 - proximal_share) * force / (distal_mm2 * 1e-6)


def side_areas_mm2(
    contact_area_mm2: float = USUAL_CONTACT_AREA_MM2,
    proximal_share: float = 0.5,
    *,
    proximal_area_mm2: float | None = None,
    distal_area_mm2: float | None = None,
) -> tuple[float, float]:
    """The areas on which a touch presses the proximal and the distal pulp. [mm^2]

    contact_area_mm2 : Area of the whole touch. [mm^2]
    proximal_share : Part of the force that the proximal side carries, 0 to 1. [1]
    proximal_area_mm2, distal_area_mm2 : Area of a side. None: the part of the contact that goes with the side's share
        of the force, but no less than half: a touch on one side presses there with all of the contact, an even one
        with half of it on each side. [mm^2]

    Raises: InputError if an area is not positive, or the share is not in 0..1.
    """
    contact, share = _area("contact_area_mm2", contact_area_mm2), number("proximal_share", proximal_share)
    if not 0.0 <= share <= 1.0:
        raise InputError(f"proximal_share must lie in 0..1, got {share:g}; 0.5 is an even touch.")
    proximal = contact * max(share, 0.5) if proximal_area_mm2 is None else _area("proximal_area_mm2", proximal_area_mm2)
    distal = contact * max(1.0 - share, 0.5) if distal_area_mm2 is None else _area("distal_area_mm2", distal_area_mm2)
    return proximal, distal


def creeping_pressure(time_s: ArrayLike, pressure_pa: ArrayLike, *, relaxation_s: ArrayLike) -> np.ndarray:
    """The pressure that a touch leaves in the pulp, which yields at once and recovers slowly, (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch, linear between the times. [Pa]
    relaxation_s : (...) float. Time constant of the recovery; 0 is none. [s]

    Where the touch presses harder than what is left, the pulp follows; where it presses less, the difference dies away
    as exp(-t / relaxation_s).

    Raises: InputError if a value is not finite, or the time constant is negative.
    """
    time, touch = finite("time_s", time_s), finite("pressure_pa", pressure_pa)
    relaxation = finite("relaxation_s", relaxation_s)
    if (relaxation < 0.0).any():
        raise InputError(f"relaxation_s must be 0 or more, got {relaxation.min():g} s.")
    left = touch.copy()
    if relaxation.any():
        # Of several, those that are 0 die away within any step.
        relaxation = np.maximum(relaxation, 1e-9 * relaxation.max())
        for i, h in enumerate(np.diff(time)):
            lag = (touch[..., i + 1] - touch[..., i]) * (relaxation / h if h > 0.0 else 0.0)
            # What the touch has left behind; at a jump nothing has time to die away.
            relaxed = touch[..., i + 1] - lag + (left[..., i] - touch[..., i] + lag) * np.exp(-h / relaxation)
            relaxed = relaxed if h > 0.0 else left[..., i]
            left[..., i + 1] = np.maximum(touch[..., i + 1], relaxed)
    return left


def spreading_pressure(
    time_s: ArrayLike, pressure_pa: ArrayLike, *, part: ArrayLike, time_constant_s: float
) -> np.ndarray:
    """The pressure of a touch under which the pulp spreads by and by, (..., T) float. [Pa]

    time_s : (T,) float, not decreasing; a time that comes twice is a jump. [s]
    pressure_pa : (..., T) float. Of the touch on a pulp that does not spread, linear between the times. [Pa]
    part : (...) float. Part of the pressure that is lost in the end, 0 to 1. [1]
    time_constant_s : of its loss, and of the pulp's return once the touch is over. [s]

    What is lost follows the pressure with that delay, and never exceeds it.

    Raises: InputError if a value is not finite, the part is not in 0..1, or the time constant is not positive.
    """
    time, touch = finite("time_s", time_s), finite("pressure_pa", pressure_pa)
    lost, delay = finite("part", part), number("time_constant_s", time_constant_s)
    if ((lost < 0.0) | (lost > 1.0)).any():
        raise InputError(f"part must lie in 0..1, got {lost.ravel()[np.abs(lost - 0.5).argmax()]:g}; 0.1 is usual.")
    if delay <= 0.0:
        raise InputError(f"time_constant_s must be greater than 0, got {delay:g} s.")
    followed = np.zeros_like(touch)
    for i, h in enumerate(np.diff(time)):
        # Behind a line of slope s the delayed pressure lies by s times the delay; at a jump it stays.
        lag = (touch[..., i + 1] - touch[..., i]) * (delay / h if h > 0.0 else 0.0)
        behind = touch[..., i + 1] - lag + (followed[..., i] - touch[..., i] + lag) * np.exp(-h / delay)
        followed[..., i + 1] = behind if h > 0.0 else followed[..., i]
    return np.maximum(touch - lost[..., None] * followed, 0.0)


def _area(name: str, value: float) -> float:
    area = number(name, value)
    if area <= 0.0:
        raise InputError(f"{name} must be greater than 0, got {area:g}; {USUAL_CONTACT_AREA_MM2:g} is usual.")
    return area
