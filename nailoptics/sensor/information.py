"""How well readings resolve force: the Fisher information on the two pressures, and the force resolution.

What the body adds to all readings of a sample alike, waves of the arterial pressure and drift and motion of the
sensor, is of a known shape and an unknown height: one more unknown beside the pressures for each of its shapes, known
beforehand to its standard deviation. All unknowns are estimated together, and the body's are marginalised. For
Gaussians this is the same as adding the shapes' outer products to the covariance of the readings, but photodiodes
still add up one by one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.special import ndtr

from ..checks import Array
from ..hemodynamics.for_scene import SteadyTouch, blood_model
from ..scene import Body, Led, Photodiode, Scene
from ..scene.body import Drift
from ..statistics import covariance_root, jackknife, quotient
from . import electronics

# What is known of a pressure before any reading: that it is less than some ten N/cm^2. It keeps two unknowns
# solvable where a layout sees one, and is nothing beside any reading worth having. [Pa]
PRIOR_PA = 1e5
# By how much all readings of a board change with a micrometre more between it and the nail. On the prototype, traced,
# those 1.5 mm from the LED fall by 0.0014 (+- 0.0002), those beyond 2 mm by less than 0.0005; here all alike. [1/um]
LIFT_PER_UM = 0.001
# The same of a slide along the nail: on the prototype, traced, it moves no reading by more.
SLIDE_PER_UM = 1e-4


@dataclass(frozen=True)
class PhysiologicalNoise:
    """What the body adds to one sample of all readings at a steady touch.

    blood : (2, 2) float. Excursions of the proximal and distal zone's blood, in columns: two independent ones, whose
        outer products add up to the covariance of both zones' blood. [1]
    led_gain : (leds, leds) float. Relative changes of all readings of an LED, a row for each LED, in columns likewise.
    reading_gain : float. Relative change of each reading, independent of all others, rms: its drift.
    led_drift, lift : their parts in led_gain: of an LED by itself, and of all readings alike, rms.
    slide : relative change of a reading by a slide along the nail, rms, which is in neither gain.
    """

    blood: Array
    led_gain: Array
    reading_gain: float
    led_drift: float = 0.0
    lift: float = 0.0
    slide: float = 0.0

    def shapes_v(self, zone_v: Array, light_v: Array, led: int) -> Array:
        """What each of the body's shapes adds, rms, to readings of an LED, (..., k) float. [V]

        zone_v : (..., 2) float. Their change with the blood of either zone. light_v : (...) float. Their light. [V]
        """
        return np.concatenate([zone_v @ self.blood, light_v[..., None] * self.led_gain[led]], -1)


@dataclass(frozen=True)
class OperatingPoint(SteadyTouch):
    """The touch at which a layout is evaluated.

    body : what the body adds; None where the scene has no body, or one that is still.
    """

    body: PhysiologicalNoise | None = None


def sensor_changes(body: Body | None) -> tuple[Drift, float, float]:
    """A sensor's drift on a body, and by what part a lift and a slide of it change readings, rms; 0 where none is."""
    drift, motion = (body and body.drift) or Drift(led_per_rt_min=0.0, reading_per_rt_min=0.0), body and body.motion
    lift, slide = (LIFT_PER_UM * motion.lift_um, SLIDE_PER_UM * motion.slide_um) if motion else (0.0, 0.0)
    return drift, lift, slide


def operating_point(scene: Scene, force_n: float, *, since_rest_s: float = 60.0) -> OperatingPoint:
    """The blood at a steady force, its change with either pressure, and the body's noise while the force is held.

    since_rest_s : time since the untouched finger was read, in which readings of a scene with a body drift. [s]

    Drift and lift of the sensor move all readings of an LED alike, as fractions of themselves.
    """
    model, body, waves = blood_model(scene), scene.body, np.zeros((2, 2))
    touch = vars(model.at_force(force_n))
    if body is None or not (body.moves or body.drift or body.motion):
        return OperatingPoint(**touch)
    if body.moves:
        waves = model.covariance(body, force_n, bandwidth_hz=scene.electronics.bandwidth_hz)
    (drift, lift, slide), rt_min = sensor_changes(body), np.sqrt(since_rest_s / 60)
    led_drift, reading_drift = float(drift.led_per_rt_min * rt_min), float(drift.reading_per_rt_min * rt_min)
    noise = PhysiologicalNoise(
        blood=covariance_root(waves),
        led_gain=covariance_root(led_drift**2 * np.eye(len(scene.leds)) + lift**2),
        reading_gain=reading_drift,
        led_drift=led_drift,
        lift=lift,
        slide=slide,
    )
    return OperatingPoint(**touch, body=noise)


@dataclass(frozen=True)
class Response:
    """What photodiodes read and how it changes, any shape (...).

    amplified_v : output of the stage, dark and ambient current included, as if the converter had no limit. [V]
    noise_v2 : variance of one sample by the electronics. [V^2]
    slope_v_per_pa : (..., 2) float. Change with either pressure, times the root of `unsaturated`. [V/Pa]
    zone_v : (..., 2) float. Change with the blood of either zone. [V]
    shunted_fraction : (...) float. Fraction of the light that was never in the bed.
    body_v : (..., k) float. What each of the body's k shapes adds, rms, to all readings at once, times the root of
        `unsaturated`; None without a body. [V]
    independent_v2 : what the body adds to each reading by itself. [V^2]
    unsaturated : (...) float. Probability that the converter is below its limit, at which a reading has no information.
    light_v : (...) float. What the LED's light gives of it. [V]
    noise : the causes of noise_v2.
    """

    amplified_v: Array
    noise_v2: Array
    slope_v_per_pa: Array
    zone_v: Array
    shunted_fraction: Array
    body_v: Array | None = None
    independent_v2: Array | float = 0.0
    unsaturated: Array | float = 1.0
    light_v: Array | float = 0.0
    noise: electronics.NoiseBudget | None = None

    @property
    def noise_v(self) -> Array:
        """Noise of the electronics in one sample, rms. [V]"""
        return np.sqrt(self.noise_v2)


def brightest_current_a(
    values: Array, led: Led, photodiode: Photodiode | Sequence[Photodiode], point: OperatingPoint
) -> Array:
    """Photocurrent of an LED's light through a bed without blood, to first order, (...); values : of `response`. [A]"""
    bloodless = values[..., 0] - np.minimum(values[..., 2:] @ point.blood_fraction, 0.0)
    return electronics.photocurrent_a(np.maximum(bloodless, 0.0), led, photodiode)


def response(
    values: Array,
    scene: Scene,
    led: int,
    photodiode: Photodiode | Sequence[Photodiode],
    point: OperatingPoint,
    *,
    replicates: bool = False,
    **stage: Any,
) -> Response:
    """What photodiodes read of an LED, from a photon map's means per emitted photon.

    Ambient light has no information. A resistor that is "auto" and not given fits each place by itself.

    values : (..., 4) float. Reading, its part never in the bed, derivative by the blood of each zone.
    scene : with the electronics. led : number of its LED.
    photodiode : or several, (..., photodiodes, 4).
    replicates : whether the first axis is by all photons and without each block of them. Then a reading that may be at
        the converter's limit counts with the probability of being below it, so that information has no jumps.
    stage : ambient_a and feedback_ohm of `electronics.read`.
    """
    detected = np.maximum(values[..., 0], 0.0)
    source, amplifier = scene.leds[led], scene.electronics
    if (ohm := stage.get("feedback_ohm")) is None:
        brightest_a = brightest_current_a(values[0] if replicates else values, source, photodiode, point)
        ohm = stage["feedback_ohm"] = electronics.stage_ohm(photodiode, amplifier, largest_a=brightest_a)
    read = electronics.read(detected, source, photodiode, amplifier, **stage)
    per_fraction = electronics.photocurrent_a(1.0, source, photodiode) * ohm
    zone, light_v = values[..., 2:] * per_fraction[..., None], detected * per_fraction
    shunted = np.where(values[..., 0] > 0, quotient(values[..., 1], values[..., 0]), 0.0)
    unsaturated = np.where(read.saturated, 0.0, 1.0)
    if replicates:
        stderr_v, below_v = jackknife(read.amplified_v), electronics.limit_v(amplifier) - read.amplified_v
        unsaturated = np.where(stderr_v > 0, ndtr(quotient(below_v, stderr_v)), unsaturated)
    # Information is of second degree in these.
    weight = np.sqrt(unsaturated)[..., None]
    return Response(
        amplified_v=read.amplified_v,
        noise_v2=read.noise_v2,
        slope_v_per_pa=(zone @ point.blood_per_pa) * weight,
        zone_v=zone,
        shunted_fraction=shunted,
        body_v=None if point.body is None else point.body.shapes_v(zone, light_v, led) * weight,
        independent_v2=0.0 if point.body is None else (point.body.reading_gain * light_v) ** 2,
        unsaturated=unsaturated,
        light_v=light_v,
        noise=read.noise,
    )


def noise_by_cause(read: Response, body: PhysiologicalNoise | None) -> dict[str, Array]:
    """The noise budget of one sample of readings, rms, (...) float by cause: those of `NoiseBudget`, whose squares add
    up to a reading's electronic noise; drift, lift, slide and waves of a body, which readings share. [V]"""
    assert read.noise is not None
    causes = {name.removesuffix("_v2"): np.sqrt(v2) for name, v2 in read.noise._asdict().items()}
    if body is not None:
        drift, waves = math.hypot(body.led_drift, body.reading_gain), np.linalg.norm(read.zone_v @ body.blood, axis=-1)
        relative = {"drift": drift, "lift": body.lift, "slide": body.slide}
        causes |= {name: part * read.light_v for name, part in relative.items()} | {"waves": waves}
    return {name: np.broadcast_to(rms_v, read.amplified_v.shape) for name, rms_v in causes.items()}


def force_budget_n(by_led: Sequence[Response], point: OperatingPoint) -> dict[str, float]:
    """The error of the force estimated from one sample of all readings by its causes, rms, whatever its split. [N]

    With w the weights of the readings in that estimate (generalised least squares), a cause of covariance C adds the
    variance w^T C w, and "split" what readings that hardly tell the two pressures apart leave of their variance before
    any reading. The sum is the square of `force_resolution_n`.

    by_led : of the photodiodes under each LED, with replicates (1 + blocks, photodiodes).
    """
    # By all photons, the first of the replicates.
    body, causes = point.body, [noise_by_cause(read, None) for read in by_led]
    slope = np.concatenate([read.slope_v_per_pa[0] for read in by_led])
    noise_v2 = np.concatenate([(read.noise_v2 + read.independent_v2)[0] for read in by_led])
    shared_v = np.concatenate(
        [read.slope_v_per_pa[0, :, :0] if read.body_v is None else read.body_v[0] for read in by_led]
    )
    solved = np.linalg.solve(np.diag(noise_v2) + shared_v @ shared_v.T, slope)
    weights = solved @ np.linalg.solve(slope.T @ solved + np.eye(2) / PRIOR_PA**2, point.force_per_pa)
    parts_n = {name: weights * np.concatenate([cause[name][0] for cause in causes]) for name in causes[0]}
    parts_n["split"] = PRIOR_PA * (point.force_per_pa - weights @ slope)
    if body is not None:
        light_n = weights * np.concatenate([(np.sqrt(read.unsaturated) * read.light_v)[0] for read in by_led])
        by_led_n = light_n.reshape(len(by_led), -1).sum(1)
        own_n = weights * np.concatenate([np.multiply(body.reading_gain, read.light_v)[0] for read in by_led])
        parts_n["drift"] = np.concatenate([body.led_drift * by_led_n, own_n])
        parts_n |= {"lift": body.lift * by_led_n.sum(), "waves": weights @ shared_v[:, :2]}
    return {name: float(np.linalg.norm(part_n)) for name, part_n in parts_n.items()}


def scene_responses(scene: Scene, by_led: Iterable[Array], point: OperatingPoint, **how: Any) -> list[Response]:
    """The `response` of a scene's own photodiodes to each of its LEDs, (..., photodiodes, 4) float each."""
    return [response(values, scene, led, scene.elements, point, **how) for led, values in enumerate(by_led)]


def fisher_information(read: Response, *, electronics_alone: bool = False) -> Array:
    """Fisher information of each reading, (..., n (n + 1) / 2) float: the upper triangle of a symmetric matrix.

    electronics_alone : as if the body were still.

    Returns: entries 11, 12, 22 for the two pressures [Pa^-2]; of a body with k shapes n is 2 + k, row by row.
    """
    unknown, noise_v2 = [read.slope_v_per_pa[..., 0], read.slope_v_per_pa[..., 1]], read.noise_v2
    if read.body_v is not None and not electronics_alone:
        unknown += [read.body_v[..., k] for k in range(read.body_v.shape[-1])]
        noise_v2 = noise_v2 + read.independent_v2
    return np.stack([a * b for i, a in enumerate(unknown) for b in unknown[i:]], -1) / noise_v2[..., None]


def total_information(by_led: Iterable[Response], *, electronics_alone: bool = False) -> Array:
    """Sum of the `fisher_information` of all photodiodes, (..., photodiodes) each, under all LEDs."""
    informations = [fisher_information(read, electronics_alone=electronics_alone).sum(-2) for read in by_led]
    return np.sum(informations, axis=0)


def pressure_information(information: Array) -> Array:
    """Information on the two pressures with the body's unknowns marginalised, (..., 3) float: 11, 12, 22. [Pa^-2]

    One after the other the body's, each of variance 1 beforehand, are marginalised (Schur's complement).
    """
    if (count := math.isqrt(2 * information.shape[-1])) == 2:
        return information
    at = dict(zip(combinations_with_replacement(range(count), 2), information.T.copy(), strict=True))
    for last in range(count - 1, 1, -1):
        for i, j in combinations_with_replacement(range(last), 2):
            at[i, j] -= at[i, last] * at[j, last] / (1.0 + at[last, last])
    return np.stack([at[0, 0].T, at[0, 1].T, at[1, 1].T], -1)


def force_resolution_n(information: Array, point: OperatingPoint) -> Array:
    """Standard error of the force estimated from one sample of all readings, whatever its split. [N]

    With J the matrix of the two pressures that `information`, as of `fisher_information`, makes, the force w . P has
    the variance w^T J^-1 w (Cramer-Rao), with w the area of the side for each pressure.
    """
    return _stderr_of(information, point.force_per_pa)


def share_resolution(information: Array, point: OperatingPoint) -> Array:
    """Standard error of the proximal share of the force, estimated from one sample of all readings.

    That part is w_1 P_1 / (w . P), of which small errors are w_1 w_2 (P_2 dP_1 - P_1 dP_2) / (w . P)^2.
    """
    (w, v), (p, q) = point.force_per_pa, point.force_n * point.pressure_per_n
    return _stderr_of(information, w * v / (w * p + v * q) ** 2 * np.array([q, -p]))


def _stderr_of(information: Array, per_pa: Array) -> Array:
    """Standard deviation of what changes with both pressures as given, (2,) float, to first order; a prior is added to
    the information on each pressure."""
    (a, b), (proximal, both, distal) = per_pa, np.moveaxis(pressure_information(information), -1, 0)
    proximal, distal = proximal + PRIOR_PA**-2, distal + PRIOR_PA**-2
    return np.sqrt((a**2 * distal - 2 * a * b * both + b**2 * proximal) / (proximal * distal - both**2))


def fixed_ratio_resolution_n(information: Array, point: OperatingPoint) -> Array:
    """Force resolution if the touch always splits as the scene's does: one number is unknown, (...) float. [N]"""
    (a, b), proximal, both, distal = point.pressure_per_n, *np.moveaxis(pressure_information(information), -1, 0)
    return quotient(1.0, np.sqrt(a * a * proximal + 2 * a * b * both + b * b * distal))


def physiological_noise_force_n(point: OperatingPoint) -> float:
    """False force, rms, by waves of the arterial pressure where light resolves the blood of both zones exactly: light
    from two zones cannot distinguish waves from touch, whatever the layout. NaN as for `as_force_n`. [N]"""
    return 0.0 if point.body is None else float(np.linalg.norm(point.as_force_n(point.body.blood)))


def pressure_resolution_pa(information: Array) -> Array:
    """Standard deviation of the proximal and of the distal pressure, (..., 2) float. [Pa]"""
    return np.stack([_stderr_of(information, pressure) for pressure in np.eye(2)], -1)


def condition_number(read: Response) -> float:
    """Condition number of the matrix of readings, in units of their noise, by zones; read : with replicates."""
    matrix = read.zone_v[0] / read.noise_v[0][..., None]
    return float(np.linalg.cond(matrix)) if len(matrix) > 1 else float("inf")


def over_fingers(resolution: Array, over: str, people: int = 0, quantile: float = 1.0) -> Array:
    """One resolution for all fingers, along the first axis: the worst or the mean; or, where the last so many are
    people, the least that no less than this fraction of them reach."""
    if people:
        return np.quantile(resolution[-people:], quantile, axis=0, method="inverted_cdf")
    return resolution.mean(0) if over == "mean" else resolution.max(0)
