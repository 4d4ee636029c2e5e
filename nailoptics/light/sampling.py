"""What both photon walks are made of, as Dr.Jit arithmetic: scattering, refraction, emission, long lives."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene import Led
from .arithmetic import clip, minimum, safe_sqrt

# Absorption ends a photon at half its rate; the other half only dims it. Ending it all the way makes long paths
# rare that a reading with less absorption needs, not at all wastes events on photons that no longer count.
KILLED_SHARE = 0.5
# From here on a photon survives each doubling of its events with probability 1/2 and counts twice.
LONG_LIFE = 1 << 16
TOP, BOTTOM, ABSORBED, LOST = 1, 2, 3, 4
# Squared cosines of emission at equal steps of probability: linear, because a Lambertian emitter's are.
LAMBERTIAN = np.linspace(1, 0, 257)
FAR = 1e9  # mm; stands for infinity where infinity would make NaN of zero


def lanes(photons: int, seed: int) -> tuple[Any, Any]:
    """A random generator and a number of photons for each lane.

    A lane walks one photon after the other, so that none waits for one long life. Photon i is the work of lane
    i modulo the lanes, whatever the machine: same seed, same bits.
    """
    width = min(photons, 8192 if dr.backend_v(mi.Float) == dr.JitBackend.LLVM else 1 << 18)
    one_more = dr.arange(mi.UInt32, width) < photons % width
    count = dr.full(mi.UInt32, photons // width, width) + dr.select(one_more, mi.UInt32(1), mi.UInt32(0))
    rng: Any = mi.PCG32(size=width, initstate=dr.opaque(mi.UInt64, seed))  # type: ignore[operator]
    return rng, count


def state_of(first: Any, photon: Any) -> Any:
    """Where a lane's generator stands when one of its photons starts, whatever those before it drew.

    So two walks of one seed, in scenes that differ in one part, have all photons in common that never meet it.
    """
    return first + mi.sample_tea_64(mi.UInt32(first), photon)  # type: ignore[call-overload]


def lifetime(u: Any) -> Any:
    """Optical depth of absorption at which a photon ends, for a uniform number u."""
    return -dr.log(1 - u) / KILLED_SHARE


def henyey_greenstein(g: Any, u: Any) -> Any:
    """Cosine of the scattering angle for anisotropy g and a uniform number u (Henyey, Greenstein 1941)."""
    isotropic = dr.abs(g) < 1e-3  # below, the formula loses its digits, and cos = 2u - 1 + O(g) is exact to 1e-3 in g
    s = (1 - g * g) / (1 - g + 2 * g * u)
    cos = (1 + g * g - s * s) / (2 * dr.select(isotropic, 1, g))
    first_order = 2 * u - 1 + 6 * g * u * (1 - u)
    return dr.select(isotropic, clip(first_order, -1, 1), clip(cos, -1, 1))


def turn(w: Any, cos: Any, phi: Any) -> Any:
    """Direction w turned by an angle of the given cosine about a random azimuth phi (Duff et al., JCGT 6(1), 2017)."""
    sin_phi, cos_phi = dr.sincos(phi)
    sin = safe_sqrt(1 - cos * cos)
    sign = dr.copysign(mi.Float(1), w.z)
    a = -dr.rcp(sign + w.z)
    b = w.x * w.y * a
    x, y = sin * cos_phi, sin * sin_phi
    turned = mi.Vector3f(
        x * (1 + sign * w.x * w.x * a) + y * b + cos * w.x,
        x * sign * b + y * (sign + w.y * w.y * a) + cos * w.y,
        -x * sign * w.x - y * w.y + cos * w.z,
    )
    # One Newton step: hundreds of turns would otherwise let the length drift.
    return turned * (1.5 - 0.5 * dr.squared_norm(turned))


def fresnel(cos_in: Any, *, n_in: Any, n_out: Any) -> tuple[Any, Any, Any]:
    """Unpolarised Fresnel reflectance of an interface.

    Returns: reflectance (1 beyond the critical angle), cosine of the refracted angle, n_in / n_out.
    """
    eta = n_in / n_out
    cos_out = safe_sqrt(1 - eta * eta * (1 - cos_in * cos_in))
    s = (n_in * cos_in - n_out * cos_out) * dr.rcp(n_in * cos_in + n_out * cos_out)
    p = (n_in * cos_out - n_out * cos_in) * dr.rcp(n_in * cos_out + n_out * cos_in)
    return dr.select(cos_out > 0, 0.5 * (s * s + p * p), 1), cos_out, eta


def emission_table(led: Led) -> np.ndarray:
    """Squared cosines of emission at equal steps of probability, (257,) float.

    Squares, because those of a Lambertian emitter are linear, so that interpolation is exact. A measured
    radiant intensity I(theta) emits I sin(theta) per angle.
    """
    if led.pattern == "pencil":
        return np.ones_like(LAMBERTIAN)
    if led.pattern == "lambertian":
        return LAMBERTIAN
    assert led.pattern_deg is not None and led.pattern_relative is not None
    theta = np.linspace(0, np.radians(led.pattern_deg[-1]), 4001)
    density = np.interp(theta, np.radians(led.pattern_deg), led.pattern_relative) * np.sin(theta)
    cumulative = np.concatenate([[0], np.cumsum(density[1:] + density[:-1])])
    u = np.linspace(0, 1, len(LAMBERTIAN))
    return np.cos(np.interp(u, cumulative / cumulative[-1], theta)) ** 2


def emission_cosine(table: Any, u: Any) -> Any:
    """Cosine of emission for a uniform number u, from an `emission_table`."""
    place = u * (dr.width(table) - 1)
    cell = minimum(mi.UInt32(place), dr.width(table) - 2)
    low, high = dr.gather(mi.Float, table, cell), dr.gather(mi.Float, table, cell + 1)
    return safe_sqrt(dr.lerp(low, high, place - mi.Float(cell)))


def energy_sums(outcome: np.ndarray, weight: np.ndarray, roulette: np.ndarray) -> dict[str, tuple[float, float]]:
    """Sums over photons of their parts reflected, transmitted, absorbed and lost, and of the squares of those.

    Parameters
    ----------
    weight : (n,) float. Weight at the end, 0 for those that absorption ended.
    roulette : (n,) float. What roulette took from a photon less what it gave; even on average, it counts as lost.
    """
    reflected = np.where(outcome == TOP, weight, 0.0)
    transmitted = np.where(outcome == BOTTOM, weight, 0.0)
    lost = np.where(outcome == LOST, weight, 0.0) + roulette
    parts = {
        "reflected": reflected,
        "transmitted": transmitted,
        "absorbed": 1 - reflected - transmitted - lost,
        "lost": lost,
    }
    return {name: (float(part.sum()), float((part**2).sum())) for name, part in parts.items()}
