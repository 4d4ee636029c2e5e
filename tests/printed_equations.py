"""The paper's eq. (1)-(4) for its two beds in closed form, R_Total, R_ij, B_ij and the matrices A and B: the reference
to which the network of `hemodynamics.walls` is held, which is solved for any number of beds.
"""

import dataclasses
import math

import numpy as np

from nailoptics.hemodynamics import Parameters


@dataclasses.dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Constants of eq. (1)-(2) at one set of diameters.

    total : R_Total = R_1 R_2 + R_V (R_1 + R_2), with R_i = R_Ai + R_Vi. [Pa^2 s^2/m^6]
    damping : (3, 3) float. R_ij, symmetric positive definite: m x'' + R x' + k x = drive. [N s/m]
    drive : (3, 4) float. B_ij: wall forces from P_H, P_L, P_F1, P_F2. [m^2]
    """

    total: float
    damping: np.ndarray
    drive: np.ndarray


def coefficients(
    *,
    arteriole_resistance: tuple[float, float],
    venule_resistance: tuple[float, float],
    vein_resistance: float,
    area: tuple[float, float, float],
    damping: tuple[float, float, float],
) -> Coefficients:
    """R_Total, R_ij and B_ij of the paper's network.

    Resistances [Pa s/m^3]: R_A1 and R_A2, R_V1 and R_V2, R_V. Areas [m^2] and dampers [N s/m]: of the walls of
    capillary 1, capillary 2 and the vein. Every wall displaces A dx/dt out of its node.

    References: Mascaro and Asada 2001, eq. (1)-(4).
    """
    a1, a2 = arteriole_resistance
    v1, v2 = venule_resistance
    rv = vein_resistance
    r1, r2 = a1 + v1, a2 + v2
    total = r1 * r2 + rv * (r1 + r2)
    # Pressure at a node for unit flow into a node, with P_H = P_L = 0.
    z = np.array(
        [
            [a1 * (v1 * r2 + rv * (v1 + r2)), a1 * a2 * rv, a1 * rv * r2],
            [a1 * a2 * rv, a2 * (v2 * r1 + rv * (v2 + r1)), a2 * rv * r1],
            [a1 * rv * r2, a2 * rv * r1, rv * r1 * r2],
        ]
    )
    z /= total
    # The part of P_L at each node; the rest is that of P_H.
    low = np.array([a1 * r2, a2 * r1, r1 * r2]) / total
    high = np.array([v1 * r2 + rv * (r1 + r2), v2 * r1 + rv * (r1 + r2), rv * (r1 + r2)]) / total
    surface = np.asarray(area)
    drive = np.column_stack([surface * high, surface * low, np.zeros((3, 2))])
    drive[2, 2], drive[1, 3] = -surface[2], -surface[1]
    return Coefficients(total=total, damping=np.diag(damping) + np.outer(surface, surface) * z, drive=drive)


def resistances(parameters: Parameters, width_m: np.ndarray) -> tuple[tuple[float, float], float]:
    """(R_A1, R_A2) and R_V of eq. (3) from (3,) diameters D + x of capillaries and vein. [Pa s/m^3]"""
    p = parameters
    *capillaries, v = (float(w) for w in width_m)
    vein = 128.0 * p.vein_length_m * p.viscosity_pa_s / (p.vein_count * math.pi)
    beds = zip(pair(p.capillary_length_m), pair(p.capillary_count), capillaries, strict=True)
    first, second = (128.0 * length * p.viscosity_pa_s / (count * math.pi) / c**4 for length, count, c in beds)
    return (first, second), vein / v**4


def pair(value: float | tuple[float, float]) -> tuple[float, float]:
    """A constant of the proximal and of the distal bed."""
    return value if isinstance(value, tuple) else (value, value)


def state_matrices(parameters: Parameters, width_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The matrices A (6, 6) and B (6, 4) of eq. (1) at (3,) diameters D + x, SI units.

    State [x_C1 x_C2 x_V and their rates], input [P_H P_L P_F1 P_F2]:
    A = [[0, I], [-diag(k/m), -diag(1/m) R]]. Most copies of the paper lack A; this is its derivation.
    """
    p = parameters
    arteriole, vein = resistances(p, width_m)
    c = coefficients(
        arteriole_resistance=arteriole,
        venule_resistance=pair(p.venule_resistance_pa_s_per_m3),
        vein_resistance=vein,
        area=(*pair(p.capillary_area_m2), p.vein_area_m2),
        damping=(*pair(p.capillary_damping_n_s_per_m), p.vein_damping_n_s_per_m),
    )
    mass = np.array([*pair(p.capillary_mass_kg), p.vein_mass_kg])[:, None]
    stiffness = np.diag([*pair(p.capillary_stiffness_n_per_m), p.vein_stiffness_n_per_m])
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-stiffness / mass, -c.damping / mass]])
    return a, np.vstack([np.zeros((3, 4)), c.drive / mass])
