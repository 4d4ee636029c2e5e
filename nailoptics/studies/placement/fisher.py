"""How well readings tell force: the Fisher information of the two pressures, and the force that it resolves."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ... import electronics
from ...scene import Electronics, Led, Photodiode, Scene
from ..blood_states import steady_blood_at, touch_areas_mm2, touch_pressures_pa

Array = NDArray[np.float64]

# What is known of a pressure before any reading: that it is less than some ten N/cm^2. It keeps two unknowns
# solvable where a layout sees one, and is nothing beside any reading worth having. [Pa]
PRIOR_PA = 1e5
STEP_PA = 100.0


@dataclass(frozen=True)
class OperatingPoint:
    """The touch at which a layout is judged.

    blood_fraction : (2,) float. Blood of the proximal and distal zone there.
    blood_per_pa : (zone, pressure) float. How it changes with the proximal and distal pressure. [Pa^-1]
    force_per_pa : (2,) float. Force for each pressure: the area of either side. [N/Pa]
    pressure_per_n : (2,) float. Pressures for each newton of the scene's touch. [Pa/N]
    """

    blood_fraction: Array
    blood_per_pa: Array
    force_per_pa: Array
    pressure_per_n: Array


def operating_point(scene: Scene, force_n: float) -> OperatingPoint:
    """The blood at a steady force, and its change with either pressure, from the scene's hemodynamics."""
    per_n = np.array(touch_pressures_pa(scene, 1.0))
    # In columns: there, and half a step up and down in either pressure.
    step = 0.5 * STEP_PA * np.array([[0, 1, -1, 0, 0], [0, 0, 0, 1, -1]])
    pressure = np.maximum(force_n * per_n[:, None] + step, 0.0)
    blood = steady_blood_at(scene, proximal_pressure_pa=pressure[0], distal_pressure_pa=pressure[1])
    width = np.array([pressure[0, 1] - pressure[0, 2], pressure[1, 3] - pressure[1, 4]])
    return OperatingPoint(
        blood_fraction=blood[0],
        blood_per_pa=np.stack([blood[1] - blood[2], blood[3] - blood[4]], -1) / width,
        force_per_pa=np.array(touch_areas_mm2(scene)) * 1e-6,
        pressure_per_n=per_n,
    )


@dataclass(frozen=True)
class Response:
    """What photodiodes read and how it changes, any shape (...).

    volts, noise_v2 : reading and the variance of one sample. [V], [V^2]
    slope_v_per_pa : (..., 2) float. Change with either pressure; 0 where the converter is at its limit. [V/Pa]
    zone_v : (..., 2) float. Change with the blood of either zone. [V]
    shunted_fraction : (...) float. Part of the light that was never in the bed.
    """

    volts: Array
    noise_v2: Array
    slope_v_per_pa: Array
    zone_v: Array
    shunted_fraction: Array

    @property
    def noise_v(self) -> Array:
        """Noise of one sample, rms. [V]"""
        return np.sqrt(self.noise_v2)


def response(
    values: Array,
    led: Led,
    photodiode: Photodiode,
    amplifier: Electronics,
    point: OperatingPoint,
    *,
    ambient_a: float | Array = 0.0,
) -> Response:
    """What photodiodes read of an LED, from a photon map's means per emitted photon.

    values : (..., 4) float. Reading, its part never in the bed, derivative by the blood of each zone.
    ambient_a : photocurrent by light from outside, which tells nothing. [A]
    """
    detected = np.maximum(values[..., 0], 0.0)
    read = electronics.read(detected, led, photodiode, amplifier, ambient_a=ambient_a)
    zone = values[..., 2:] * electronics.volts_per_fraction(led, photodiode, amplifier)
    with np.errstate(invalid="ignore", divide="ignore"):
        shunted = np.where(values[..., 0] > 0, values[..., 1] / values[..., 0], 0.0)
    return Response(
        volts=read.amplified_v,
        noise_v2=read.noise_v2,
        slope_v_per_pa=(zone @ point.blood_per_pa) * ~read.saturated[..., None],
        zone_v=zone,
        shunted_fraction=shunted,
    )


def fisher_information(read: Response) -> Array:
    """What each reading tells of the two pressures, (..., 3) float: the entries 11, 12, 22 of the matrix. [Pa^-2]"""
    a, b = read.slope_v_per_pa[..., 0], read.slope_v_per_pa[..., 1]
    return np.stack([a * a, a * b, b * b], -1) / read.noise_v2[..., None]


def total_information(by_led: Iterable[Response]) -> Array:
    """What all photodiodes tell together under all LEDs, (..., 3) float of (..., photodiodes) each. [Pa^-2]"""
    return np.sum([fisher_information(read).sum(-2) for read in by_led], axis=0)


def force_resolution_n(information: Array, point: OperatingPoint) -> Array:
    """Standard deviation of the force told by one sample of all readings, whatever its split. [N]

    information : (..., 3) float. Of all readings. It is a matrix J; the force w . P has the variance w^T J^-1 w
        (Cramer-Rao), with w the area of the side for each pressure.
    """
    one, both, two = _with_prior(information)
    w = point.force_per_pa
    variance = (w[0] ** 2 * two - 2 * w[0] * w[1] * both + w[1] ** 2 * one) / (one * two - both**2)
    return np.sqrt(variance)


def fixed_ratio_resolution_n(information: Array, point: OperatingPoint) -> Array:
    """The same if the touch always splits as the scene's does, so that one number is unknown. [N]"""
    a, b = point.pressure_per_n
    return 1 / np.sqrt(a * a * information[..., 0] + 2 * a * b * information[..., 1] + b * b * information[..., 2])


def pressure_resolution_pa(information: Array) -> Array:
    """Standard deviation of the proximal and of the distal pressure, (..., 2) float. [Pa]"""
    one, both, two = _with_prior(information)
    return np.sqrt(np.stack([two, one], -1) / (one * two - both**2)[..., None])


def _with_prior(information: Array) -> tuple[Array, Array, Array]:
    """The entries 11, 12, 22 with what is known before any reading."""
    prior = PRIOR_PA**-2
    return information[..., 0] + prior, information[..., 1], information[..., 2] + prior


def condition_number(read: Response) -> float:
    """Condition number of the matrix of readings by zones, by all photons, each reading in units of its noise.

    read : (1 + blocks, n), of n photodiodes by all photons and without each block of them.
    """
    matrix = read.zone_v[0] / read.noise_v[0][..., None]
    return float(np.linalg.cond(matrix)) if len(matrix) > 1 else float("inf")


def over_fingers(resolution_n: Array, rank_by: str) -> Array:
    """One force resolution for all fingers, along the first axis: the worst or the mean. [N]"""
    return resolution_n.max(0) if rank_by == "worst" else resolution_n.mean(0)
