"""The network of vessels behind moving walls: pressures and wall speeds from diameters, for any number of units.

Every function takes, for each wall, one Python float or one numpy array: the time stepper (floats, quick) and the
tables of results (arrays over time) share the same formulas. Walls are ordered: capillary units, then the vein.
Constants as arrays (`Walls.stacked`) let each formula take all units at once, with the same bits.
"""

import dataclasses
import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from .parameters import Parameters
from .zones import Zones

PerWall = Any
"""A sequence with one float or one array for each wall, or an array with walls along its first axis."""

CLOSED_FRACTION = 1e-3
"""Diameter of a closed vessel over its listed one: its resistance is then 1e12 times as large, yet finite. [1]"""


@dataclasses.dataclass(frozen=True)
class Walls:
    """Constants of N capillary units and the vein (last), with each unit's share of the bed, in SI units.

    Each constant is one float or array per wall, or, of `stacked` walls, an array with walls along its first axis.

    area, damping, stiffness, mass, diameter, closed : (N+1,) floats. `closed` is the diameter at contact.
    flow_factor : (N+1,) floats. Times (D+x)^4 it is 1/R of eq. (3). [m^-1 Pa^-1 s^-1]
    venule : (N,) floats. 1/R_Vi. [m^3 Pa^-1 s^-1]
    mobile : (N+1,) floats. A/b: speed that a pressure gives to a free wall. [m Pa^-1 s^-1]
    """

    area: PerWall
    damping: PerWall
    stiffness: PerWall
    mass: PerWall
    diameter: PerWall
    closed: PerWall
    flow_factor: PerWall
    venule: PerWall
    mobile: PerWall

    def stacked(self, axes: int) -> "Walls":
        """The same walls, each constant one array with so many axes: walls, then those along which it varies."""
        if axes not in self._stacked:
            constants = {}
            for one in dataclasses.fields(self):
                array = np.stack([np.asarray(value, dtype=float) for value in getattr(self, one.name)])
                constants[one.name] = array.reshape(array.shape + (1,) * (axes - array.ndim))
            self._stacked[axes] = Walls(**constants)
        return self._stacked[axes]

    @functools.cached_property
    def units(self) -> list[tuple[Any, ...]]:
        """Index and area, damping, stiffness, flow_factor, venule, mobile of each unit; stacked ones are one."""
        constants = self.area, self.damping, self.stiffness, self.flow_factor, self.venule, self.mobile
        return [(i, *(one[i] for one in constants)) for i in _units(self)]

    @functools.cached_property
    def _stacked(self) -> dict[int, "Walls"]:
        return {}


def build_walls(parameters: Parameters, zones: Zones) -> Walls:
    """The constants of every wall, from a set of parameters and the cut of the bed."""
    p = parameters
    share = zones.share
    area = (*(s * p.capillary_area_m2 for s in share), p.vein_area_m2)
    damping = (*(s * p.capillary_damping_n_s_per_m for s in share), p.vein_damping_n_s_per_m)
    diameter = (*(p.capillary_diameter_m for _ in share), p.vein_diameter_m)
    capillary_flow = p.capillary_count * math.pi / (128.0 * p.capillary_length_m * p.viscosity_pa_s)
    vein_flow = p.vein_count * math.pi / (128.0 * p.vein_length_m * p.viscosity_pa_s)
    return Walls(
        area=area,
        damping=damping,
        stiffness=(*(s * p.capillary_stiffness_n_per_m for s in share), p.vein_stiffness_n_per_m),
        mass=(*(s * p.capillary_mass_kg for s in share), p.vein_mass_kg),
        diameter=diameter,
        closed=tuple(CLOSED_FRACTION * d for d in diameter),
        flow_factor=(*(s * capillary_flow for s in share), vein_flow),
        venule=tuple(s / p.venule_resistance_pa_s_per_m3 for s in share),
        mobile=tuple(a / b for a, b in zip(area, damping, strict=True)),
    )


def massless_rates(
    walls: Walls, width: PerWall, load: PerWall, free: PerWall, high: Any, low: Any
) -> tuple[PerWall, PerWall]:
    """Pressures [Pa] and wall speeds [m/s], N+1 each, of the network whose walls have no mass.

    width : N+1 values. D + x, no less than `walls.closed`. [m]
    load : N+1 values. Force that presses the wall inward against the blood: A P_F + k x. [N]
    free : N+1 values. 1 where the wall may move, 0 where it is held in contact.
    high, low : P_H and P_L. [Pa]
    """
    return MasslessNetwork(walls, width, free).rates(load, high, low)


class MasslessNetwork:
    """The network whose walls have no mass, at some widths, with all that does not hang on what presses on it.

    With A P - load = b dx/dt at each free wall, each unit's pressure follows from the vein node's, and the vein node's
    from one sum: exact elimination, no matrix. width, free : as in `massless_rates`.
    """

    def __init__(self, walls: Walls, width: PerWall, free: PerWall) -> None:
        self.walls, n, owns = walls, len(walls.venule), []
        self.units: list[tuple[Any, ...]] = []
        for i, area, damping, _, flow_factor, venule, mobile in walls.units:
            w2 = width[i] * width[i]
            arteriole = flow_factor * (w2 * w2)
            loose = free[i]
            m = mobile * loose
            own = arteriole + m * area
            total = own + venule
            ratio = venule / total
            owns.append(ratio * own)
            self.units.append((i, area, venule, loose, m, arteriole, total, ratio, total * damping))
        conductance = _sum(0.0, _each(walls, owns))
        w2 = width[n] * width[n]
        vein = walls.flow_factor[n] * (w2 * w2)
        m = walls.mobile[n] * free[n]
        total = conductance + m * walls.area[n] + vein
        self.vein = n, walls.area[n], free[n], m, vein, conductance + vein, total, total * walls.damping[n]

    def rates(self, load: PerWall, high: Any, low: Any) -> tuple[PerWall, PerWall]:
        """Pressures and wall speeds under some load: as `massless_rates`."""
        flow_in, node, parts = self._node(load, high, low)
        pressures = [part + unit[7] * node for part, unit in zip(parts, self.units, strict=True)]
        return _walls(self.walls, pressures, node), self._speeds(load, high, low, flow_in, node)

    def speeds(self, load: PerWall, high: Any, low: Any) -> PerWall:
        """Wall speeds alone. [m/s]"""
        flow_in, node, _ = self._node(load, high, low)
        return self._speeds(load, high, low, flow_in, node)

    def _node(self, load: PerWall, high: Any, low: Any) -> tuple[Any, Any, list[Any]]:
        """What flows in, the vein node's pressure, and the part of each unit's that does not hang on it."""
        parts, inflows = [], []
        for i, _, _, _, m, arteriole, total, ratio, _ in self.units:
            numerator = arteriole * high + m * load[i]
            inflows.append(ratio * numerator)
            parts.append(numerator / total)
        flow_in = _sum(0.0, _each(self.walls, inflows))
        n, _, _, m, vein, _, total, _ = self.vein
        return flow_in, (flow_in + m * load[n] + vein * low) / total, parts

    def _speeds(self, load: PerWall, high: Any, low: Any, flow_in: Any, node: Any) -> PerWall:
        # The wall's own part of A P - load is taken out beforehand: with hardly any damper it would drown the rest.
        speeds = [
            loose * (arteriole * (area * high - load[i]) + venule * (area * node - load[i])) / damped
            for i, area, venule, loose, _, arteriole, _, _, damped in self.units
        ]
        n, area, loose, _, vein, passing, _, damped = self.vein
        net = area * (flow_in + vein * low) - load[n] * passing
        return _walls(self.walls, speeds, loose * net / damped)


def massless_jacobian(
    walls: Walls, width: PerWall, free: PerWall, pressures: PerWall, high: Any, low: Any
) -> tuple[PerWall, PerWall, PerWall]:
    """How the speeds of `massless_rates` change with the widths: d, p, q of diag(d) + outer(p, q), N+1 floats each.

    The units meet in the vein node only, hence the rank of one.
    """
    n = len(walls.venule)
    node = pressures[n]
    w = width[n]
    vein_slope = 4.0 * walls.flow_factor[n] * w * w * w
    vein = 0.25 * vein_slope * w
    m = walls.mobile[n] * free[n]
    diagonal, left, own_slopes, owns = [], [], [], []
    for i, area, damping, stiffness, flow_factor, venule, mobile in walls.units:
        w, loose = width[i], free[i]
        slope = 4.0 * flow_factor * w * w * w
        arteriole = 0.25 * slope * w
        m_i = mobile * loose
        own = arteriole + m_i * area
        total = own + venule
        ratio = venule / total
        rise = slope * (high - pressures[i])
        give = loose * stiffness / damping
        owns.append(ratio * own)
        own_slopes.append(ratio * (rise + m_i * stiffness))
        diagonal.append((m_i * rise - give * (arteriole + venule)) / total)
        left.append(m_i * ratio)
    below = _sum(m * walls.area[n] + vein, _each(walls, owns))
    right = [s / below for s in own_slopes]
    return (
        _walls(walls, diagonal, -free[n] * walls.stiffness[n] / walls.damping[n]),
        _walls(walls, left, m),
        _walls(walls, right, (m * walls.stiffness[n] - vein_slope * (node - low)) / below),
    )


def _units(walls: Walls) -> Iterable[Any]:
    """The indices of the units: one by one, or, of stacked walls, all in one."""
    n = len(walls.venule)
    return (slice(n),) if isinstance(walls.area, np.ndarray) else range(n)


def _each(walls: Walls, units: Sequence[Any]) -> Iterable[Any]:
    """The values of the units one by one, from those by their indices."""
    return units[0] if isinstance(walls.area, np.ndarray) else units


def _walls(walls: Walls, units: list[Any], vein: Any) -> PerWall:
    """The values of all walls, from those of the units by their indices and the vein's."""
    return np.concatenate([units[0], vein[None]]) if isinstance(walls.area, np.ndarray) else [*units, vein]


def _sum(first: Any, more: Iterable[Any]) -> Any:
    """A sum in the order of its terms, so that stacked walls have the bits of others."""
    for one in more:
        first = first + one
    return first


def inertial_pressures(walls: Walls, width: PerWall, speed: PerWall, high: Any, low: Any) -> list[Any]:
    """The N+1 pressures [Pa] of the network whose walls move at given speeds [m/s], as walls with mass do."""
    *arterioles, vein = [f * (w * w * (w * w)) for f, w in zip(walls.flow_factor, width, strict=True)]
    *displaced, by_vein = [a * s for a, s in zip(walls.area, speed, strict=True)]
    totals = [a + v for a, v in zip(arterioles, walls.venule, strict=True)]
    ratios = [v / t for v, t in zip(walls.venule, totals, strict=True)]
    inflows = [a * high - d for a, d in zip(arterioles, displaced, strict=True)]
    flow_in = sum(r * i for r, i in zip(ratios, inflows, strict=True))
    conductance = sum(r * a for r, a in zip(ratios, arterioles, strict=True))
    node = (flow_in - by_vein + vein * low) / (conductance + vein)
    return [i / t + r * node for i, t, r in zip(inflows, totals, ratios, strict=True)] + [node]
