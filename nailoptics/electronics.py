"""Detected light to volts: responsivity, photocurrent, transimpedance gain, noise and the converter's range."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .scene.models import Electronics

ELEMENTARY_CHARGE_C = 1.602176634e-19
BOLTZMANN_J_PER_K = 1.380649e-23
# Planck's constant times the speed of light over the elementary charge: a photon of 1240 nm carries 1 eV.
PHOTON_NM_PER_V = 1239.841984

Array = NDArray[np.float64]


class NoiseBudget(NamedTuple):
    """Variances of the output by their cause; they add. [V^2]"""

    shot_v2: Array
    feedback_v2: Array
    shunt_v2: Array
    amplifier_v2: Array
    adc_v2: Array


class Voltage(NamedTuple):
    """What the converter reads; unpacks as volts, volts_noise_rms, saturated."""

    volts: Array
    volts_noise_rms: Array
    saturated: NDArray[np.bool_]


def responsivity_a_per_w(wavelength_nm: ArrayLike, quantum_efficiency: ArrayLike) -> Array:
    """Return the photocurrent per watt: quantum efficiency times wavelength / 1240 nm.

    For a line of some width take the mean of this with the line's weights.

    Parameters
    ----------
    wavelength_nm : array. [nm]
    quantum_efficiency : array that broadcasts with it, 0-1.

    Returns
    -------
    responsivity : float, of the broadcast shape. [A/W]
    """
    wavelength = _checked("wavelength_nm", wavelength_nm)
    efficiency = _checked("quantum_efficiency", quantum_efficiency)
    if (efficiency > 1).any():
        raise InputError(f"quantum_efficiency = {efficiency.max():g} is above 1; choose from 0 to 1")
    return np.asarray(efficiency * wavelength / PHOTON_NM_PER_V)


def lsb_v(amplifier: Electronics) -> float:
    """Return the converter's step. [V]"""
    return amplifier.adc_range_v / 2.0**amplifier.adc_bits


def noise_budget(
    current_a: ArrayLike, amplifier: Electronics, *, dark_current_na: float = 0.1, shunt_ohm: float = 1e9
) -> NoiseBudget:
    """Return the output's noise variances at a photocurrent.

    Current noise density 2q(I + I_d) + 4kT/R_f + 4kT/R_sh + (2 pi f C e_n)^2, integrated from 0 to the bandwidth
    (the last term grows with f^2, so that its integral is (2 pi C e_n)^2 B^3 / 3) and multiplied by R_f^2; the
    converter adds LSB^2/12.

    Parameters
    ----------
    current_a : array. Photocurrent without the dark current. [A]
    """
    current = _checked("current_a", current_a)
    dark = _checked("dark_current_na", dark_current_na) * 1e-9
    if not shunt_ohm > 0:
        raise InputError(f"shunt_ohm = {shunt_ohm:g} must be above 0; correct it")
    bandwidth, gain2 = amplifier.bandwidth_hz, amplifier.feedback_ohm**2
    thermal_j = 4 * BOLTZMANN_J_PER_K * amplifier.temperature_k
    charge_noise = 2 * np.pi * amplifier.capacitance_pf * 1e-12 * amplifier.noise_nv_per_rt_hz * 1e-9
    same = np.ones_like(current)
    return NoiseBudget(
        shot_v2=2 * ELEMENTARY_CHARGE_C * (current + dark) * bandwidth * gain2,
        feedback_v2=same * thermal_j * bandwidth * amplifier.feedback_ohm,
        shunt_v2=same * thermal_j / shunt_ohm * bandwidth * gain2,
        amplifier_v2=same * charge_noise**2 * bandwidth**3 / 3 * gain2,
        adc_v2=same * lsb_v(amplifier) ** 2 / 12,
    )


def read(
    power_w: ArrayLike,
    *,
    responsivity: ArrayLike,
    amplifier: Electronics,
    dark_current_na: float = 0.1,
    shunt_ohm: float = 1e9,
) -> Voltage:
    """Return what the converter reads for detected power: the mean, its noise, and whether it is at its limit.

    Parameters
    ----------
    power_w : array. Power on the photodiode. [W]
    responsivity : array that broadcasts with it, from `responsivity_a_per_w`. [A/W]
    amplifier : the stage and its converter, a scene's `[electronics]`.
    dark_current_na, shunt_ohm : of the photodiode element. [nA], [ohm]

    Returns
    -------
    Voltage : volts, the mean reading, dark current included, held at `adc_range_v` where it would exceed it [V];
        volts_noise_rms, what the stage and the converter add to one reading [V]; saturated, bool. Where saturated is
        true the noise is that of the stage ahead of the converter, and neither number tells the light.

    Raises InputError for power, responsivity or dark current that is negative or not finite.
    """
    current = _checked("power_w", power_w) * _checked("responsivity", responsivity)
    budget = noise_budget(current, amplifier, dark_current_na=dark_current_na, shunt_ohm=shunt_ohm)
    volts = (current + dark_current_na * 1e-9) * amplifier.feedback_ohm
    # The last code begins one step below the range: from there on the converter cannot tell more light.
    saturated = volts >= amplifier.adc_range_v - lsb_v(amplifier)
    return Voltage(
        volts=np.asarray(np.minimum(volts, amplifier.adc_range_v)),
        volts_noise_rms=np.asarray(np.sqrt(np.sum(np.stack(budget), axis=0))),
        saturated=np.asarray(saturated),
    )


def _checked(name: str, value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=float)
    wrong = ~(np.isfinite(array) & (array >= 0))
    if wrong.any():
        raise InputError(f"{name} = {array[wrong].flat[0]:g} must be finite and not negative; correct it")
    return array
