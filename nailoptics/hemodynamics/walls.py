"""The network of vessels behind moving walls: pressures and wall speeds from diameters, for any number of units.

Arrays have the walls along their first axis, capillary units and then the vein, and broadcast along all others: the
same formulas serve one instant, a course over time, and many networks side by side.
"""

import dataclasses
import math
from typing import Any

import numpy as np

from .parameters import Parameters, beds, each_bed
from .zones import Zones

CLOSED_FRACTION = 1e-3
"""Diameter of a closed vessel over its listed one: its resistance is then 1e12 times as large, yet finite. [1]"""


@dataclasses.dataclass(frozen=True, eq=False)
class Walls:
    """Constants of N capillary units and the vein (last), with each unit's share of the bed, in SI units.

    area, damping, stiffness, mass, diameter, closed : (N+1, ...) float. `closed` is the diameter at contact.
    flow_factor : (N+1, ...) float. Times (D+x)^4 it is 1/R of eq. (3). [m^-1 Pa^-1 s^-1]
    venule : (N, ...) float. 1/R_Vi. [m^3 Pa^-1 s^-1]
    mobile : (N+1, ...) float. A/b: speed that a pressure gives to a free wall. [m Pa^-1 s^-1]
    """

    area: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    diameter: np.ndarray
    closed: np.ndarray
    flow_factor: np.ndarray
    venule: np.ndarray
    mobile: np.ndarray

    @property
    def constants(self) -> list[np.ndarray]:
        """All of them, in the order in which `Walls` takes them."""
        return [getattr(self, field.name) for field in dataclasses.fields(self)]

    def with_axes(self, count: int) -> "Walls":
        """The constants with so many axes: further ones of length 1 behind that of the walls."""
        if self.area.ndim == count:
            return self
        more = (1,) * (count - self.area.ndim)
        return Walls(*(constant.reshape(constant.shape[:1] + more + constant.shape[1:]) for constant in self.constants))


def build_walls(parameters: Parameters, zones: Zones) -> Walls:
    """The constants of every wall, from a set of parameters and the cut of the bed.

    Values of the parameters may be arrays that broadcast: further axes of the constants. A unit has the constants of
    the half in which it lies, one that lies in both their mean, weighted by its parts.
    """
    p = parameters
    shape = np.broadcast_shapes(*(np.shape(value) for pair in vars(p).values() for value in beds(pair)))

    def stack(capillary: Any, vein: Any, share: tuple[float, ...] = zones.share) -> np.ndarray:
        units = [part * factor for part, factor in zip(share, zones.of_beds(capillary), strict=True)]
        return np.stack([np.broadcast_to(value, shape) for value in (*units, vein)])

    area = stack(p.capillary_area_m2, p.vein_area_m2)
    damping = stack(p.capillary_damping_n_s_per_m, p.vein_damping_n_s_per_m)
    diameter = stack(p.capillary_diameter_m, p.vein_diameter_m, (1.0,) * zones.count)
    capillary_flow = each_bed(
        lambda count, length_m: count * math.pi / (128.0 * length_m * p.viscosity_pa_s),
        p.capillary_count,
        p.capillary_length_m,
    )
    vein_flow = p.vein_count * math.pi / (128.0 * p.vein_length_m * p.viscosity_pa_s)
    return Walls(
        area=area,
        damping=damping,
        stiffness=stack(p.capillary_stiffness_n_per_m, p.vein_stiffness_n_per_m),
        mass=stack(p.capillary_mass_kg, p.vein_mass_kg),
        diameter=diameter,
        closed=CLOSED_FRACTION * diameter,
        flow_factor=stack(capillary_flow, vein_flow),
        venule=stack(each_bed(lambda resistance: 1.0 / resistance, p.venule_resistance_pa_s_per_m3), 0.0)[:-1],
        mobile=area / damping,
    )


class MasslessNetwork:
    """The network whose walls have no mass: with A P - load = b dx/dt at each free wall, each unit's pressure follows
    from the vein node's, and the vein node's from one sum: exact elimination, no matrix.

    diameter : (N+1, ...) float. D + x, no less than `walls.closed`. [m]
    free : (N+1, ...) float. 1 where the wall may move, 0 where it is held in contact.
    """

    def __init__(self, walls: Walls, diameter: np.ndarray, free: np.ndarray) -> None:
        self.walls = walls = walls.with_axes(diameter.ndim)
        square = diameter * diameter
        self.diameter, self.free, self.mobile = diameter, free, walls.mobile * free
        self.conductance = walls.flow_factor * (square * square)
        self.arteriole, self.vein = self.conductance[:-1], self.conductance[-1:]
        outflow = self.arteriole + self.mobile[:-1] * walls.area[:-1]
        self.total = outflow + walls.venule
        self.ratio = walls.venule / self.total
        self.upstream = _sum(self.ratio * outflow)
        self.node_total = self.upstream + self.mobile[-1:] * walls.area[-1:] + self.vein

    def rates(self, load: np.ndarray, high: Any, low: Any) -> tuple[np.ndarray, np.ndarray]:
        """Pressures [Pa] and wall speeds [m/s], (N+1, ...) each.

        load : (N+1, ...) float. Force that presses the wall inward against the blood: A P_F + k x. [N]
        high, low : P_H and P_L. [Pa]
        """
        flow_in, node, parts = self._node(load, high, low)
        return np.concatenate([parts + self.ratio * node, node]), self._speeds(load, high, low, flow_in, node)

    def speeds(self, load: np.ndarray, high: Any, low: Any) -> np.ndarray:
        """Wall speeds alone, (N+1, ...) float; arguments as of `rates`. [m/s]"""
        return self._speeds(load, high, low, *self._node(load, high, low)[:2])

    def _node(self, load: np.ndarray, high: Any, low: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What flows in, the vein node's pressure, and the part of each unit's that does not depend on it."""
        numerator = self.arteriole * high + self.mobile[:-1] * load[:-1]
        flow_in = _sum(self.ratio * numerator)
        node = (flow_in + self.mobile[-1:] * load[-1:] + self.vein * low) / self.node_total
        return flow_in, node, numerator / self.total

    def _speeds(self, load: np.ndarray, high: Any, low: Any, flow_in: np.ndarray, node: np.ndarray) -> np.ndarray:
        # The wall's own part of A P - load is taken out beforehand: with hardly any damper it would drown the rest.
        area, damping, venule = self.walls.area, self.walls.damping, self.walls.venule
        drive = self.arteriole * (area[:-1] * high - load[:-1]) + venule * (area[:-1] * node - load[:-1])
        net = area[-1:] * (flow_in + self.vein * low) - load[-1:] * (self.upstream + self.vein)
        total = np.concatenate([self.total, self.node_total])
        return self.free * np.concatenate([drive, net]) / (total * damping)

    def jacobian(self, pressures: np.ndarray, high: Any, low: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Jacobian of the speeds by the diameters: d, p, q of diag(d) + outer(p, q), (N+1, ...) float each, as units
        meet in the vein node only. pressures : (N+1, ...) float. Of `rates`. [Pa]"""
        slope = 4.0 * self.conductance / self.diameter
        rise = slope[:-1] * (high - pressures[:-1])
        give = self.free * self.walls.stiffness / self.walls.damping
        pull = self.mobile * self.walls.stiffness
        diagonal = (self.mobile[:-1] * rise - give[:-1] * (self.arteriole + self.walls.venule)) / self.total
        right = [self.ratio * (rise + pull[:-1]), pull[-1:] - slope[-1:] * (pressures[-1:] - low)]
        left = [self.mobile[:-1] * self.ratio, self.mobile[-1:]]
        return np.concatenate([diagonal, -give[-1:]]), np.concatenate(left), np.concatenate(right) / self.node_total


def inertial_pressures(walls: Walls, diameter: np.ndarray, speed: np.ndarray, high: Any, low: Any) -> np.ndarray:
    """Pressures in the network at given diameters [m] and wall speeds [m/s], as of walls with mass, (N+1, ...) float
    each; high, low : P_H and P_L. [Pa]"""
    walls = walls.with_axes(diameter.ndim)
    conductance, displaced = walls.flow_factor * (diameter * diameter * (diameter * diameter)), walls.area * speed
    total = conductance[:-1] + walls.venule
    ratio, inflow = walls.venule / total, conductance[:-1] * high - displaced[:-1]
    below = _sum(ratio * conductance[:-1]) + conductance[-1:]
    node = (_sum(ratio * inflow) - displaced[-1:] + conductance[-1:] * low) / below
    return np.concatenate([inflow / total + ratio * node, node])


def _sum(units: np.ndarray) -> np.ndarray:
    return np.add.reduce(units, axis=0, keepdims=True)
