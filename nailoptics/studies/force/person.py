"""A person's vessels, pulp and touch, as a few factors on a scene's constants, each with its prior.

The vessels are the paper's network of two zones, in steps of 10 ms from sample to sample. The pulp lies between touch
and vessels: it creeps under a held touch, and its distal part recovers slowly.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...hemodynamics import creeping_pressure, spreading_pressure
from ...hemodynamics.parameters import Parameters
from ...hemodynamics.rosenbrock import step
from ...hemodynamics.steady import solve_walls
from ...hemodynamics.touch import PAPER_ZONES
from ...hemodynamics.walls import Walls, build_walls

Array = NDArray[np.float64]

# A time constant of this or less is none. [s]
SHORTEST_S = 1e-9
# Samples further apart are walked in as many steps of at most this length. [s]
LONGEST_STEP_S = 0.05
# A touch past which less than this part of the change by pressure is left cannot be distinguished from a harder one.
LEFT_AT_CLOSURE = 0.05
# Pressures at which closure is looked for. [N/cm^2]
SEARCHED = np.linspace(0.0, 4.0, 401)
# Pressures of either side at which a beat's effect is computed, and the change of arterial pressure by which. [Pa]
PULSED, STEP_PA = 9, 200.0


@dataclass(frozen=True)
class Pulp:
    """What lies between a touch and the vessels, of one person or of many (arrays of shape S in place of numbers).

    creep : S float. Part of its pressure that a held touch loses in the end. [1]
    creep_s : float. Time constant of that loss. [s]
    recovery_s : S float. Time constant with which the distal pulp recovers where a touch presses less. [s]
    """

    creep: Array | float
    creep_s: float
    recovery_s: Array | float

    def response(self, time_s: Array, pressure: Array) -> Array:
        """What is left for the vessels of both touch pressures, (2, *S, T) float, linear between times (T,)."""
        spread = spreading_pressure(time_s, pressure, part=self.creep, time_constant_s=self.creep_s)
        return np.stack([spread[0], creeping_pressure(time_s, spread[1], relaxation_s=self.recovery_s)])

    def redistribute(self, pressure: Array, crept: Array) -> Array:
        """The pressures (2, *S) of a touch that the pulp has spread under.

        crept : (2,) float. What `creep_step` has made of the pressures so far.
        """
        lost = self.creep * crept
        return np.asarray(np.maximum(pressure - lost.reshape((2,) + (1,) * (pressure.ndim - 1)), 0.0))

    def creep_step(self, crept: Array, pressure: Array, step_s: float) -> Array:
        """The pressures as the pulp follows them, a step later."""
        return np.asarray(pressure + (crept - pressure) * np.exp(-step_s / self.creep_s))

    def recovery_step(self, left: Array, pressure: Array, step_s: float) -> Array:
        """The pressure that is left in the distal pulp a step later, of that before and that of the touch."""
        remaining = np.exp(-step_s / np.maximum(self.recovery_s, SHORTEST_S))
        return np.asarray(np.maximum(pressure, pressure + (left - pressure) * remaining))


# The pressure in the pulp falls off from the tip, by a factor e in a third to a half of the nail bed: of a distal
# pressure on half of the bed this part acts on the other half.
USUAL_DISTAL_REACH = 0.25
# A fingerpad that is held down pushes back less and less, by a tenth within some 2 s (Pawluk and Howe 1999, J. Biomech.
# Eng. 121:605), and the distal reading returns more slowly than the touch is released (the paper's Fig. 12).
USUAL_PULP = Pulp(creep=0.1, creep_s=2.0, recovery_s=0.15)
# No held touch loses more of its pressure than this.
MOST_CREEP = 0.9
RIGID_PULP = Pulp(creep=0.0, creep_s=2.0, recovery_s=0.0)
# 1 N/cm^2, the paper's unit of pressure. [Pa]
N_PER_CM2 = 1e4


class FactorPrior(NamedTuple):
    """What is known of a factor before any recording: two of three people lie within 1 / spread and spread.

    fields : the constants of the network that it multiplies; none where it is not the network's.
    """

    spread: float
    fields: tuple[str, ...]
    text: str


# Nobody has measured the spread of the network's constants among people; the paper tunes them by hand "within an order
# of magnitude", so that a factor 2 is taken. Blood at rest: 1-5 % of the bed.
# The contact of a fingertip at 1 N: 0.6-1.6 cm^2.
PRIORS: dict[str, FactorPrior] = {
    "vein_stiffness": FactorPrior(2.0, ("vein_stiffness_n_per_m",), "stiffness of the vein's wall"),
    "capillary_stiffness": FactorPrior(2.0, ("capillary_stiffness_n_per_m",), "stiffness of the capillaries' walls"),
    "vein_damping": FactorPrior(2.0, ("vein_damping_n_s_per_m",), "damping of the vein's wall"),
    "capillary_damping": FactorPrior(2.0, ("capillary_damping_n_s_per_m",), "damping of the capillaries' walls"),
    "feedback": FactorPrior(
        1.5, ("venule_resistance_pa_s_per_m3",), "resistance of the venules over that of the arterioles"
    ),
    "contact_area": FactorPrior(1.6, (), "area over which a force presses"),
    "proximal_area": FactorPrior(1.6, (), "area of a proximal touch over that of a distal one"),
    "distal_reach": FactorPrior(3.0, (), "part of a distal pressure that acts on the proximal capillaries"),
    "rest_blood": FactorPrior(1.7, (), "blood of the bed at rest"),
    "proximal_share": FactorPrior(1.5, (), "proximal over distal force of an even touch"),
    "creep": FactorPrior(2.0, (), "part of its pressure that a held touch loses"),
    "distal_recovery": FactorPrior(2.0, (), "time in which the distal pulp recovers"),
}
NAMES = tuple(PRIORS)
SPREAD_LN = np.log([prior.spread for prior in PRIORS.values()])


@dataclass(frozen=True)
class Person:
    """The network, contact and blood of one person, or of many side by side (arrays of shape S in place of numbers).

    walls : constants of the two zones' network.
    rest_m : (3, *S) float. Diameters of the untouched finger. [m]
    rest_blood : S float. Blood fraction of the bed at rest.
    area_cm2 : S float. Area over which a distal touch presses. [cm^2]
    proximal_area : S float. That of a proximal touch over it.
    distal_reach : S float. Part of P_F2 that acts on the proximal capillaries, too.
    share : S float. Part of an even touch's force that presses proximally.
    arterial_pa, venous_pa : P_H and P_L at rest. [Pa]
    pulp : what lies between the touch and the vessels.
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
    pulp: Pulp

    def blood(self, width: Array) -> Array:
        """Blood fraction of both zones, (2, *S), from diameters over those at rest."""
        return np.asarray(self.rest_blood * width[:2] ** 2)

    def pressures(self, force_n: Array, site: Array) -> Array:
        """Touch pressures P_F1 and P_F2, (2, *S, T) float, of a force at a site over time (T,). [N/cm^2]

        site : (T,) float. 1 where the touch is proximal, 0 where it is distal, NaN where it is even.
        """
        share = np.where(np.isnan(site), np.asarray(self.share)[..., None], site)
        even = force_n / np.asarray(self.area_cm2)[..., None]
        # A side that bears more than half of the force has as much more of the contact's area.
        proximal = even * share / np.maximum(share, 0.5) / np.asarray(self.proximal_area)[..., None]
        return np.stack([proximal, even * (1 - share) / np.maximum(1 - share, 0.5)])


def force_of(pressure: Array, area_cm2: Array | float, proximal_area: Array | float) -> tuple[Array, Array]:
    """Force [N] and proximal share from both pressures (2, *S) in N/cm^2, the inverse of `Person.pressures`."""
    pressure = np.stack([pressure[0] * proximal_area, pressure[1]])
    larger = pressure.max(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(larger > 0, pressure.min(0) / larger, 1.0)
    share = np.where(pressure[0] >= pressure[1], 1.0 - ratio / 2.0, ratio / 2.0)
    return area_cm2 * larger, share


def person(
    base: Parameters,
    factors: Mapping[str, Array | float],
    *,
    rest_blood: float,
    area_cm2: float,
    share: float,
    distal_reach: float = 0.0,
    pulp: Pulp = RIGID_PULP,
) -> Person:
    """A person whose constants are a scene's times factors; arrays of factors make many people.

    base : the scene's constants. rest_blood, area_cm2, share : of the scene.
    distal_reach : part of a distal pressure on the proximal capillaries; 0 in the paper's two zones.
    pulp : what lies between the touch and the vessels, which the factors change; nothing if not given.
    factors : by NAMES; 1 where one is missing.
    """
    scaled = {name: np.asarray(value, dtype=float) for name, value in base.as_dict().items()}
    for name, prior in PRIORS.items():
        for field in prior.fields:
            scaled[field] = scaled[field] * factors.get(name, 1.0)
    shape = np.broadcast_shapes(*(np.shape(value) for value in factors.values()))
    walls = build_walls(cast(Parameters, SimpleNamespace(**scaled)), PAPER_ZONES)
    high, low = np.full(shape, base.arterial_pressure_pa), np.full(shape, base.venous_pressure_pa)
    rest_m, _ = solve_walls(walls, np.zeros((3, *shape)), high, low, tolerance=1e-12)
    odds = (
        share / (1.0 - share) * np.asarray(factors.get("proximal_share", 1.0))
        if 0.0 < share < 1.0
        else math.inf * share
    )
    return Person(
        walls=walls,
        rest_m=rest_m,
        rest_blood=np.asarray(rest_blood * np.asarray(factors.get("rest_blood", 1.0))),
        area_cm2=np.asarray(area_cm2 * np.asarray(factors.get("contact_area", 1.0))),
        proximal_area=np.asarray(factors.get("proximal_area", 1.0), dtype=float),
        distal_reach=np.asarray(distal_reach * np.asarray(factors.get("distal_reach", 1.0))),
        share=np.asarray(odds / (1.0 + odds)) if share not in (0.0, 1.0) else np.asarray(share),
        arterial_pa=base.arterial_pressure_pa,
        venous_pa=base.venous_pressure_pa,
        pulp=replace(
            pulp,
            creep=np.minimum(pulp.creep * np.asarray(factors.get("creep", 1.0)), MOST_CREEP),
            recovery_s=pulp.recovery_s * np.asarray(factors.get("distal_recovery", 1.0)),
        ),
    )


@dataclass(frozen=True)
class VesselClosure:
    """Pressures past which readings stay as they are: proximal and distal. [N/cm^2]"""

    proximal: float
    distal: float


def touch_on_walls(pressure: Array, distal_reach: Array | float) -> Array:
    """Touch pressure on each wall (3, *S) [Pa], from P_F1 and P_F2 (2, *S) [N/cm^2].

    distal_reach : part of P_F2 that acts on the proximal capillaries.
    """
    return N_PER_CM2 * np.stack([distal_reach * pressure[1], pressure[1], pressure[0]])


def widths_over(
    person: Person,
    time_s: Array,
    pressure: Array,
    *,
    arterial_pa: Array | None = None,
    longest_step_s: float = LONGEST_STEP_S,
) -> Array:
    """Diameters over those at rest, (3, *S, T) float, of walls that are in balance with the first pressures' absence.

    pressure : (2, *S, T) float. P_F1 and P_F2, linear between samples. [N/cm^2]
    arterial_pa : (*S, T) float, or (*S, 1) where it stays. P_H in place of the person's. [Pa]
    longest_step_s : samples further apart are walked in several steps. [s]
    """
    outside = touch_on_walls(person.pulp.response(time_s, pressure), np.asarray(person.distal_reach)[..., None])
    mean_pa = np.full(person.rest_m.shape[1:] + (1,), person.arterial_pa)
    high = np.broadcast_to(mean_pa if arterial_pa is None else arterial_pa, mean_pa.shape[:-1] + time_s.shape)
    width, out = person.rest_m, np.empty(person.rest_m.shape + time_s.shape)
    out[..., 0] = width
    for k, sample_s in enumerate(np.diff(time_s)):
        count = max(1, int(np.ceil(sample_s / longest_step_s - 1e-9)))
        change = (outside[..., k + 1] - outside[..., k]) / count
        for i in range(count):
            width = step(
                person.walls,
                width,
                outside[..., k] + i * change,
                high[..., k],
                person.venous_pa,
                step_s=sample_s / count,
                outside_change=change,
            )
        out[..., k + 1] = width
    return out / person.rest_m[..., None]


def vessel_closure(person: Person) -> VesselClosure:
    """Where a proximal and a distal touch have done all but a part of what they can, held for long."""
    ends = []
    for side in range(2):
        pressure = np.zeros((2, SEARCHED.size))
        pressure[side] = SEARCHED
        full = np.full(SEARCHED.size, 1.0)
        outside = touch_on_walls(pressure, person.distal_reach)
        rest, _ = solve_walls(person.walls, outside, person.arterial_pa * full, person.venous_pa * full)
        blood = rest[side] ** 2
        change = np.abs(blood - blood[0])
        left = change < (1 - LEFT_AT_CLOSURE) * change.max()
        ends.append(float(SEARCHED[min(int(np.flatnonzero(left).max(initial=0)) + 1, SEARCHED.size - 1)]))
    return VesselClosure(*ends)


class PulsatileGain:
    """By how much a beat of the arterial pressure moves the blood of both zones, under any touch.

    It is taken to reach the blood at once, as a slow change of the pressure does in the end: what is seen of a beat at
    rest says how strong it is, whether vessels follow within one or not.

    highest : (2,) float. Touch pressures up to which it is found; it stays beyond. [N/cm^2]
    """

    def __init__(self, person: Person, highest: Array) -> None:
        self._bends = [np.linspace(0.0, end, PULSED) for end in highest]
        touch = np.stack(np.meshgrid(*self._bends, indexing="ij")).reshape(2, -1)
        outside = touch_on_walls(np.repeat(touch, 2, axis=1), person.distal_reach)
        high = person.arterial_pa + STEP_PA * np.tile([1.0, -1.0], touch.shape[1])
        held, _ = solve_walls(person.walls, outside, high, np.full(high.shape, person.venous_pa))
        blood = person.blood(held / person.rest_m[:, None]).reshape(2, PULSED, PULSED, 2)
        self._part = (blood[..., 0] - blood[..., 1]) / STEP_PA / (blood[..., 0] + blood[..., 1])

    def at(self, touch: Array) -> tuple[Array, Array]:
        """Part (2,) by which the blood grows under a touch (2,) in N/cm^2, [1/Pa], and its slopes (2, 2) by that."""
        steps = np.array([bends[1] for bends in self._bends])
        place = np.clip(touch / steps, 0.0, PULSED - 1.001)
        (i, j), (x, y) = place.astype(int), place % 1.0
        here = self._part[:, i : i + 2, j : j + 2]
        across, along = np.array([1.0 - x, x]), np.array([1.0 - y, y])
        rise = np.array([-1.0, 1.0])
        by_touch = np.column_stack([rise @ (here @ along).T, across @ (here @ rise).T]) / steps
        return across @ (here @ along).T, by_touch
