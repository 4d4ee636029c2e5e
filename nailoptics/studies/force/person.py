"""A person's vessels, pulp and touch, as a few factors on a scene's constants, each with its prior.

The vessels are the paper's network of two zones, in steps of 10 ms from sample to sample. The pulp lies between touch
and vessels: it creeps under a held touch, and its distal part recovers slowly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated, Any, cast

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, PlainSerializer, PlainValidator
from pydantic.dataclasses import dataclass as checked_dataclass

from ...checks import Array, finite
from ...errors import InputError
from ...hemodynamics import Contact, relaxing_pressure, spreading_pressure
from ...hemodynamics.parameters import PA_PER_N_PER_CM2, Parameters, beds, each_bed, parameters, vessels
from ...hemodynamics.rosenbrock import step
from ...hemodynamics.steady import solve_walls
from ...hemodynamics.walls import Walls, build_walls
from ...hemodynamics.zones import PAPER_ZONES
from ...scene import Scene
from ...scene.base import Fraction
from ...scene.priors import factor_priors

# Samples further apart are walked in as many steps of at most this length; filter and memory restart after gaps longer
# than the second. [s]
LONGEST_STEP_S, LONGEST_GAP_S = 0.05, 5.0
# A finger's vessels are walked through pieces of time of about this length side by side, until diameters differ by less
# than this part from piece to piece. [s, 1]
PIECE_S, CONVERGED = 4.0, 1e-6
# A touch past which less than this fraction of the change by pressure is left is indistinguishable from a harder one.
LEFT_AT_CLOSURE = 0.05
# Pressures among which closure is searched. [N/cm^2]
SEARCHED_N_PER_CM2 = np.linspace(0.0, 4.0, 401)
# Nodes of either side's pressure in `PulsatileGain`, and the change of arterial pressure in its differences. [1, Pa]
GRID_NODES, ARTERIAL_STEP_PA = 9, 200.0
# No calibration gives more: gains of readings, and constants of the vessels over those listed, either way.
MOST_GAIN = 1e4
# Cubes of a subject file's numbers, times others, are far from what numbers can hold.
MOST = 1e30
SIDES = ("proximal", "distal")
MM2_PER_CM2 = 100.0

# Tables of a subject file; it also holds what is for its reader alone.
TABLE = ConfigDict(extra="ignore", allow_inf_nan=False, arbitrary_types_allowed=True)


def _numbers(values: Any) -> Array:
    try:
        return finite("the list", values)
    except InputError as error:
        raise ValueError(str(error).rstrip(".")) from None


def within(least: float, most: float, size: Callable[[Array], Array] = np.abs) -> AfterValidator:
    """The rule that the absolute values of an array, or what else is their size, lie within bounds."""

    def check(values: Array) -> Array:
        wrong = ~((size(values) >= least) & (size(values) <= most))
        if wrong.any():
            raise ValueError(f"{size(values)[wrong].flat[0]:g} must lie within {least:g} to {most:g}")
        return values

    return AfterValidator(check)


Numbers = Annotated[Array, PlainValidator(_numbers), within(0, MOST), PlainSerializer(np.ndarray.tolist)]
"""An array of finite numbers, of a subject file's lists."""


def require_shapes(table: Any, **shapes: tuple[int, ...]) -> None:
    """Raise ValueError where an array of a table has another shape."""
    for name, shape in shapes.items():
        if (own := getattr(table, name).shape) != shape:
            raise ValueError(f"{name} has shape {own}, not {shape}")


def _plausible(vessels: Parameters) -> Parameters:
    for name, listed in parameters("listed").as_dict().items():
        # A mass is not used, and a gauge pressure may be 0, or below.
        least = 0.0 if "mass" in name else abs(listed) / MOST_GAIN
        most = MOST_GAIN * (max(abs(listed), 1.0) if name in ("venous_pressure_pa", "venular_share") else abs(listed))
        for value in np.abs(beds(getattr(vessels, name))):
            if not least <= value <= most:
                raise ValueError(f"{name} = {value:g} must lie within {least:g} to {most:g}")
    return vessels


@checked_dataclass(frozen=True, config=TABLE)
class Pulp:
    """What lies between a touch and the vessels.

    creep : fraction of its pressure that a held touch loses in the end. [1]
    creep_s : time constant of that loss. [s]
    recovery_s : time constant with which the distal pulp recovers where a touch presses less. [s]
    """

    creep: Fraction
    creep_s: Annotated[float, Field(ge=1e-3, le=MOST_GAIN)]
    recovery_s: Annotated[float, Field(ge=0, le=MOST_GAIN)]


# The pressure in the pulp is assumed to fall off from the tip by a factor e in a third to a half of the nail bed: of
# a distal pressure on half of the bed this fraction acts on the other half.
USUAL_DISTAL_REACH = 0.25
# A fingerpad that is held down pushes back less and less, by a tenth within some 2 s (Pawluk and Howe 1999, J. Biomech.
# Eng. 121:605), and the distal reading returns more slowly than the touch is released (the paper's Fig. 12).
USUAL_PULP = Pulp(creep=0.1, creep_s=2.0, recovery_s=0.15)
# No held touch loses more of its pressure than this.
MOST_CREEP = 0.9

PRIORS = factor_priors()
NAMES = tuple(PRIORS)
NOMINAL_LN = np.zeros(len(NAMES))
SPREAD_LN = np.log([prior.spread for prior in PRIORS.values()])


@dataclass(frozen=True)
class Person:
    """The network, contact, pulp and blood of one person, or of many side by side (arrays of shape S for numbers).

    walls : constants of the two zones' network.
    rest_m : (3, *S) float. Diameters of the untouched finger. [m]
    rest_blood : S float. Blood fraction of the bed at rest.
    area_cm2 : S float. Area over which a distal touch presses. [cm^2]
    proximal_area : S float. That of a proximal touch over it.
    distal_reach : S float. Fraction of P_F2 that acts on the proximal capillaries, too.
    share : S float. Fraction of an even touch's force that presses proximally.
    arterial_pa, venous_pa : P_H and P_L at rest. [Pa]
    creep, creep_s, recovery_s : of the `Pulp`, S float, float and S float.
    """

    walls: Walls
    rest_m: Array
    rest_blood: Array
    area_cm2: Array
    proximal_area: Array
    distal_reach: Array
    share: Array
    arterial_pa: float
    venous_pa: float
    creep: Array
    creep_s: float
    recovery_s: Array

    @property
    def side_areas_cm2(self) -> Array:
        """Areas over which a proximal and a distal touch press, (2,) float, of one person."""
        return np.array([self.area_cm2 * self.proximal_area, self.area_cm2])

    def blood(self, diameter: Array) -> Array:
        """Blood fraction of both zones, (2, *S), from diameters over those at rest."""
        return np.asarray(self.rest_blood * diameter[:2] ** 2)

    def pressures_n_per_cm2(self, force_n: Array, site: Array) -> Array:
        """Touch pressures P_F1 and P_F2, (2, *S, T) float, of a force at a site over time (T,). [N/cm^2]

        site : (T,) float. 1 where the touch is proximal, 0 where it is distal, NaN where it is even.
        """
        share = np.where(np.isnan(site), np.asarray(self.share)[..., None], site)
        contact = Contact(MM2_PER_CM2 * np.asarray(self.area_cm2)[..., None], share)
        proximal_pa, distal_pa = contact.pressures(np.maximum(force_n, 0.0))
        return np.stack([proximal_pa / np.asarray(self.proximal_area)[..., None], distal_pa]) / PA_PER_N_PER_CM2

    def force(self, pressure_n_per_cm2: Array) -> tuple[Array, Array]:
        """Force [N] and its proximal share from both pressures (2, ...): the inverse of `pressures_n_per_cm2`."""
        proximal, distal = pressure_n_per_cm2[0] * self.proximal_area, pressure_n_per_cm2[1]
        larger = np.maximum(proximal, distal)
        ratio = np.nan_to_num(np.minimum(proximal, distal) / np.where(larger > 0, larger, np.nan), nan=1.0)
        return self.area_cm2 * larger, np.where(proximal >= distal, 1.0 - ratio / 2.0, ratio / 2.0)

    def steady_diameters(self, pressure_n_per_cm2: Array, higher_pa: Array | float = 0.0) -> Array:
        """Diameters over those at rest, (3, n), under held pressures (2, n) [N/cm^2], of one person or of n.

        higher_pa : n float. By how much P_H lies above the person's. [Pa]
        """
        rest_m = self.rest_m.reshape(3, -1)
        pressure_n_per_cm2 = np.broadcast_to(pressure_n_per_cm2, (2, max(pressure_n_per_cm2.shape[1], rest_m.shape[1])))
        outside = touch_on_walls(pressure_n_per_cm2, self.distal_reach)
        high = np.full(outside.shape[1], self.arterial_pa) + higher_pa
        return solve_walls(self.walls, outside, high, np.full(high.shape, self.venous_pa))[0] / rest_m

    def closure_n_per_cm2(self) -> Array:
        """Proximal and distal pressure (2,) past which one person's readings stay as they are. [N/cm^2]"""
        touches = SEARCHED_N_PER_CM2 * np.eye(2)[..., None]
        blood = np.stack([self.steady_diameters(touch)[side] ** 2 for side, touch in enumerate(touches)])
        change = np.abs(blood - blood[:, :1])
        left = change < (1 - LEFT_AT_CLOSURE) * change.max(1, keepdims=True)
        last = np.where(left, np.arange(SEARCHED_N_PER_CM2.size), 0).max(1)
        return SEARCHED_N_PER_CM2[np.minimum(last + 1, SEARCHED_N_PER_CM2.size - 1)]

    def diameters_over(self, time_s: Array, pressure_n_per_cm2: Array, *, arterial_pa: Array | None = None) -> Array:
        """Diameters over those at rest, (3, *S, T) float, of a finger that rests before the first sample.

        pressure_n_per_cm2 : (2, *S, T) float. P_F1 and P_F2, linear between samples. [N/cm^2]
        arterial_pa : (*S, T) float, or (*S, 1) where it stays. P_H in place of the person's. [Pa]
        """
        spread = spreading_pressure(time_s, pressure_n_per_cm2, part=self.creep, time_constant_s=self.creep_s)
        spread = np.stack([spread[0], relaxing_pressure(time_s, spread[1], relaxation_s=self.recovery_s)])
        outside = touch_on_walls(spread, np.asarray(self.distal_reach)[..., None])
        high = self.arterial_pa if arterial_pa is None else arterial_pa
        high = np.broadcast_to(high, self.rest_m.shape[1:] + time_s.shape)
        sample_s = np.diff(time_s)
        counts = np.maximum(1, np.ceil(sample_s / LONGEST_STEP_S - 1e-9).astype(int))
        ends, sample = np.cumsum(counts), np.repeat(np.arange(counts.size), counts)
        # Pieces of time are walked side by side, the last filled up with its last step: from rest at first, then each
        # from where the one before ended, until all have met what was walked: vessels soon forget.
        pieces = max(1, round(sample_s.sum() / PIECE_S))
        length = -(-sample.size // pieces)
        steps = np.minimum(np.arange(pieces * length).reshape(pieces, length).T, sample.size - 1)
        of, change = sample[steps], np.diff(outside) / counts
        start = outside[..., of] + (steps - (ends - counts)[of]) * change[..., of]
        start, change = (np.moveaxis(drive, (-2, -1), (0, 2)) for drive in (start, change[..., of]))
        high = np.moveaxis(high[..., of], (-2, -1), (0, 1))
        step_s = (sample_s / counts)[of].reshape(steps.shape + (1,) * (self.rest_m.ndim - 1))
        diameter, out = np.repeat(self.rest_m[:, None], pieces, axis=1), np.empty_like(start)
        for walked in range(steps.size):
            k = walked % length
            if walked and k == 0:
                diameter = np.concatenate([self.rest_m[:, None], diameter[:, :-1]], axis=1)
            ends_pa = high[k], self.venous_pa
            diameter = step(self.walls, diameter, start[k], *ends_pa, step_s=step_s[k], outside_change=change[k])
            if walked >= length and (np.abs(diameter - out[k]) <= CONVERGED * diameter).all():
                break
            out[k] = diameter
        after = np.moveaxis(out, (2, 0), (-2, -1)).reshape(*self.rest_m.shape, -1)[..., ends - 1]
        return np.asarray(np.concatenate([self.rest_m[..., None], after], axis=-1) / self.rest_m[..., None])


@checked_dataclass(frozen=True, config=TABLE)
class NominalFinger:
    """The vessels, contact, pulp and blood of a scene, which a person's factors multiply."""

    rest_blood_fraction: Annotated[float, Field(ge=1e-6, le=1)]
    contact_area_cm2: Annotated[float, Field(ge=1e-3, le=1e3)]
    proximal_share: Fraction
    distal_reach: Fraction
    """Fraction of a distal pressure on the proximal capillaries; 0 in the paper's two zones."""
    pulp: Pulp
    vessels: Annotated[Parameters, AfterValidator(_plausible)]
    proximal_area: Annotated[float, Field(ge=1e-3, le=1e3)] = 1.0
    """Area of a proximal touch over contact_area_cm2, that of a distal one."""

    def vessels_of(self, factors_ln: Array) -> dict[str, Array]:
        """The constants of the network by name, each S float, of factors whose logarithms (P, *S) are given."""
        scaled = {name: each_bed(np.asarray, value) for name, value in self.vessels.as_dict().items()}
        for factor, prior in zip(np.exp(factors_ln), PRIORS.values(), strict=True):
            scaled |= {field: each_bed(np.multiply, scaled[field], factor) for field in prior.fields}
        return scaled

    def person(self, factors_ln: Array = NOMINAL_LN) -> Person:
        """The person of factors whose logarithms (P, *S) are given, by NAMES; many side by side with arrays."""
        factor = dict(zip(NAMES, np.exp(factors_ln), strict=True))
        walls = build_walls(cast(Parameters, SimpleNamespace(**self.vessels_of(factors_ln))), PAPER_ZONES)
        arterial_pa, venous_pa = self.vessels.arterial_pressure_pa, self.vessels.venous_pressure_pa
        shape = np.shape(factors_ln)[1:]
        ends = np.full(shape, arterial_pa), np.full(shape, venous_pa)
        proximal = self.proximal_share * factor["proximal_share"]
        return Person(
            walls=walls,
            rest_m=solve_walls(walls, np.zeros((3, *shape)), *ends, tolerance=1e-12)[0],
            rest_blood=np.asarray(self.rest_blood_fraction * factor["rest_blood"]),
            area_cm2=np.asarray(self.contact_area_cm2 * factor["contact_area"]),
            proximal_area=np.asarray(self.proximal_area * factor["proximal_area"]),
            distal_reach=np.asarray(self.distal_reach * factor["distal_reach"]),
            share=np.asarray(proximal / (proximal + 1.0 - self.proximal_share)),
            arterial_pa=arterial_pa,
            venous_pa=venous_pa,
            creep=np.minimum(self.pulp.creep * factor["creep"], MOST_CREEP),
            creep_s=self.pulp.creep_s,
            recovery_s=np.asarray(self.pulp.recovery_s * factor["distal_recovery"]),
        )


def nominal_finger(scene: Scene) -> NominalFinger:
    """The scene's finger, with the usual pulp where it states none; areas as stated, also of contacts that grow."""
    touch, pulp = scene.touch, USUAL_PULP
    (proximal_mm2, _), (_, distal_mm2) = map(Contact.of(touch).side_areas_mm2, (1.0, 0.0))
    creep = pulp.creep if touch.creep is None else touch.creep
    recovery_s = pulp.recovery_s if touch.distal_relaxation_s is None else touch.distal_relaxation_s
    return NominalFinger(
        rest_blood_fraction=scene.blood.rest_blood_fraction,
        contact_area_cm2=float(distal_mm2) / MM2_PER_CM2,
        proximal_share=touch.proximal_share,
        distal_reach=scene.blood.distal_reach or USUAL_DISTAL_REACH,
        pulp=Pulp(creep=creep, creep_s=touch.creep_s, recovery_s=recovery_s),
        vessels=vessels(scene),
        proximal_area=float(proximal_mm2 / distal_mm2),
    )


def touch_on_walls(pressure_n_per_cm2: Array, distal_reach: Array | float) -> Array:
    """Touch pressure on each wall (3, *S) [Pa], from P_F1 and P_F2 (2, *S) [N/cm^2].

    distal_reach : fraction of P_F2 that acts on the proximal capillaries.
    """
    proximal, distal = PA_PER_N_PER_CM2 * pressure_n_per_cm2
    return np.array([distal_reach * distal, distal, proximal])


class PulsatileGain:
    """By how much a beat of the arterial pressure moves the blood of both zones, under any touch.

    It is taken to reach the blood at once, as a slow change of the pressure does in the end: the beat that readings
    show at rest says how strong it is, whether vessels follow within one or not.

    highest_n_per_cm2 : (2,) float. Touch pressures up to which it is computed; it stays beyond. [N/cm^2]
    """

    def __init__(self, person: Person, highest_n_per_cm2: Array) -> None:
        self._steps_n_per_cm2 = highest_n_per_cm2 / (GRID_NODES - 1)
        touch = np.stack(np.meshgrid(*np.linspace(0.0, highest_n_per_cm2, GRID_NODES).T, indexing="ij")).reshape(2, -1)
        higher_pa = ARTERIAL_STEP_PA * np.tile([1.0, -1.0], touch.shape[1])
        blood = person.blood(person.steady_diameters(np.repeat(touch, 2, axis=1), higher_pa))
        higher, lower = np.moveaxis(blood.reshape(2, GRID_NODES, GRID_NODES, 2), -1, 0)
        self._part = (higher - lower) / ARTERIAL_STEP_PA / (higher + lower)

    def at(self, touch: Array) -> tuple[Array, Array]:
        """Part (2,) by which the blood grows under a touch (2,) in N/cm^2, [1/Pa], and its slopes (2, 2) by that."""
        place = np.minimum(np.maximum(touch / self._steps_n_per_cm2, 0.0), GRID_NODES - 1.001)
        (i, j), (x, y) = place.astype(int).tolist(), (place % 1.0).tolist()
        here = self._part[:, i : i + 2, j : j + 2]
        across, along = np.array([1.0 - x, x]), np.array([1.0 - y, y])
        grown, by_touch, rise = (here @ along).T, np.empty((2, 2)), np.array([-1.0, 1.0])
        by_touch[:, 0], by_touch[:, 1] = rise @ grown, across @ (here @ rise).T
        return across @ grown, by_touch / self._steps_n_per_cm2
