"""What both photon walks are made of, as Dr.Jit arithmetic: scattering, refraction, emission, roulette, records.

Kernels call the functions `maximum` to `atan2` here instead of Dr.Jit's own of these names, which for floats become
the instructions fmaximum and fminimum: libLLVM 15 and 16 know no machine code for those and abort the process. Made of
comparisons, the walks take the same ways, bit for bit, in the same time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...scene import Led, Photodiode

# Partial implicit capture: this fraction of absorption is analog, it ends photons; the rest reduces weights. More makes
# long paths rare that a reading with less absorption needs, less wastes scatterings on photons that no longer count.
ANALOG_FRACTION = 0.5
# From so many steps on a photon survives each doubling of them with probability 1/2 and counts twice.
LONG_WALK = 1 << 16
# Photons walked side by side: enough to fill the vectors of 64 cores or a graphics card. Each given an equal share of a
# batch in place of the next photon, lanes waited for each other: 1.1 (2^18 photons) to 1.3 times (2^13) the time.
CPU_LANES, GPU_LANES = 1024, 1 << 16
# How a photon ends; 0 while it walks.
TOP, BOTTOM, ABSORBED, LOST = 1, 2, 3, 4
# Outcomes from here on name the opaque region that a photon met.
OPAQUE = 16
# Squared cosines of emission at equal steps of probability: linear, because a Lambertian emitter's are.
LAMBERTIAN = np.linspace(1, 0, 257)
# Steps of one that was measured, whose last one reaches out to the last angle.
MEASURED = 1 << 14
# How photodiodes weigh light by its angle: steps of a table over the squared cosine, in which a Lambertian one's light
# is spread evenly.
STEPS = 1024
# Sums of weights and of their squares, by name.
Sums = dict[str, tuple[float, float]]
FAR = 1e9  # mm; stands for infinity where infinity would make NaN of zero


def maximum(a: Any, b: Any) -> Any:
    """The larger of two numbers; a NaN in the first stays."""
    return dr.select(a < b, b, a)


def minimum(a: Any, b: Any) -> Any:
    """The smaller of two numbers; a NaN in the first stays."""
    return dr.select(a > b, b, a)


def clip(x: Any, low: Any, high: Any) -> Any:
    """A number, or the end of the range beyond which it lies."""
    return minimum(maximum(x, low), high)


def safe_sqrt(x: Any) -> Any:
    """The square root of a number, and 0 for one that rounding left below 0."""
    return dr.sqrt(maximum(x, 0))


def atan2(y: Any, x: Any) -> Any:
    """The angle of a point (x, y) from the x axis, in -pi to pi, to a few parts in ten million; 0 at the origin."""
    across, along = dr.abs(y), dr.abs(x)
    radius = dr.sqrt(x * x + y * y)
    # The arc sine of the smaller side, because that of the larger one loses digits near 1.
    angle = dr.asin(dr.select(radius > 0, minimum(across, along) / radius, 0))
    angle = dr.select(across > along, dr.pi / 2 - angle, angle)
    return dr.copysign(dr.select(x < 0, dr.pi - angle, angle), y)


def starts(value: float) -> Any:
    """A field of every new photon: whole numbers count something, others measure it."""
    return field(default_factory=lambda: mi.UInt32(value) if isinstance(value, int) else mi.Float(value))


@dataclass(kw_only=True)
class Photon:
    """What both walks carry of a photon from step to step; each lane holds one.

    index : Which photon of the batch it is.
    rng : The lane's random generator.
    w : Direction.
    weight : What it counts for, before absorption dims it.
    tau : Optical depth of absorption so far; at `absorption_optical_depth` it ends.
    path : (t) list. Path in each medium. [mm]
    entered : What it counted for, dimmed, when it came into the medium where it is.
    steps : Scatterings and interfaces so far.
    outcome : How it ended; 0 while it walks.
    """

    index: Any
    rng: Any
    w: Any
    weight: Any = starts(1.0)
    tau: Any = starts(0.0)
    absorption_optical_depth: Any
    path: list[Any]
    entered: Any = starts(1.0)
    steps: Any = starts(0)
    outcome: Any = starts(0)


@dataclass(frozen=True)
class WalkedPhotons:
    """What became of each photon of a batch.

    outcome : (n,) int. TOP, BOTTOM, ABSORBED in a medium, LOST, or in a finger OPAQUE + i by region i, DETECTED + i by
        photodiode i.
    weight : (n,) float. Weight at the end, at the traced absorption; 0 for those that were absorbed in a medium.
    absorbed : (media, n) float. What absorption in each medium took of it.
    path_mm : (t, n) float32. Path in each medium. [mm]
    cosine : (n,) float32. Cosine of its last direction to z; 0 where the walk does not write it.
    events : Scatterings in all.
    """

    outcome: np.ndarray
    weight: np.ndarray
    absorbed: np.ndarray
    path_mm: np.ndarray
    cosine: np.ndarray
    events: int

    def energy(self, media: Sequence[str], opaque: Mapping[int, str] = MappingProxyType({})) -> tuple[Sums, Sums]:
        """Where the photons went, as sums over them of their parts and of the squares of those.

        media, opaque : names of the media, and of the opaque regions by outcome; what has one name counts together.

        Returns: reflected, transmitted, absorbed and lost; and of what was absorbed, how much where. Each part is
        tallied by itself, and what all of them leave of the photons is lost.
        """
        reflected, transmitted = (np.where(self.outcome == end, self.weight, 0.0) for end in (TOP, BOTTOM))
        names = list(dict.fromkeys(opaque.values()))
        place = np.zeros(max([int(self.outcome.max()), *opaque]) + 1, int)
        place[list(opaque)] = [1 + names.index(name) for name in opaque.values()]
        met = place[self.outcome]
        absorbed = self.absorbed.sum(0) + np.where(met > 0, self.weight, 0.0)
        lost = 1 - reflected - transmitted - absorbed
        parts = {"reflected": reflected, "transmitted": transmitted, "absorbed": absorbed, "lost": lost}
        each = zip(media, self.absorbed, strict=True)
        places = {name: (float(part.sum()), float((part**2).sum())) for name, part in each}
        ends = [np.bincount(met, self.weight**power, minlength=len(names) + 1)[1:] for power in (1, 2)]
        places |= {name: (float(a), float(b)) for name, a, b in zip(names, *ends, strict=True)}
        return {name: (float(part.sum()), float((part**2).sum())) for name, part in parts.items()}, places


class PhotonEnds:
    """Where a kernel writes what became of each photon: `WalkedPhotons` as Dr.Jit arrays."""

    def __init__(self, photons: int, *, paths: int, media: int) -> None:
        self.photons, self.absorbed = dr.opaque(mi.UInt32, photons), dr.zeros(mi.Float64, media * photons)
        self.outcome, self.weight = dr.zeros(mi.UInt32, photons), dr.zeros(mi.Float, photons)
        self.cosine, *self.path = (dr.zeros(mi.Float, photons) for _ in range(1 + paths))

    def record(self, photon: Photon, medium: Any, tallied: Any) -> None:
        """Write how a photon ended, and with what weight; tally, if its medium is, what absorption took there."""
        weight = dr.select(photon.outcome == ABSORBED, 0, photon.weight * survival(photon.tau))
        self.absorb(photon, medium, weight, True, tallied)
        dr.scatter(self.outcome, photon.outcome, photon.index)
        dr.scatter(self.weight, weight, photon.index)

    def absorb(self, photon: Photon, medium: Any, left: Any, leaves: Any, tallied: Any = True) -> None:
        """Tally what absorption in a medium took of a photon that leaves it with what is left, or ends there; one that
        is found absorbed leaves no medium."""
        leaves = leaves & ((photon.outcome > 0) | (photon.tau <= photon.absorption_optical_depth))
        # In float64, so that the parts of a photon add up to all of it.
        taken, slot = mi.Float64(photon.entered) - mi.Float64(left), medium * self.photons + photon.index
        alone = dr.ReduceMode.NoConflicts  # no two lanes walk one photon
        dr.scatter_reduce(dr.ReduceOp.Add, self.absorbed, taken, slot, leaves & tallied, mode=alone)
        photon.entered = dr.select(leaves, left, photon.entered)

    def record_path(self, photon: Photon, *more: Any) -> None:
        """Write which way a photon came, and what else its walk adds to its paths."""
        for target, value in zip(self.path, [*photon.path, *more], strict=True):
            dr.scatter(target, value, photon.index)

    def evaluated(self, events: Any) -> WalkedPhotons:
        """What was written, once the kernel has run; events : scatterings of each lane."""
        dr.eval(events, self.outcome, self.weight, self.absorbed, self.path, self.cosine)
        outcome = np.array(self.outcome)
        return WalkedPhotons(
            outcome=outcome,
            weight=np.array(self.weight).astype(float),
            absorbed=np.array(self.absorbed).reshape(-1, len(outcome)),
            path_mm=np.stack([np.array(path) for path in self.path]),
            cosine=np.array(self.cosine),
            events=int(np.array(events).sum(dtype=np.int64)),
        )


class PhotonQueue:
    """The photons of a batch: each lane walks one, then the next that no lane has begun, so that none is idle before
    the last photons are under way. A photon's random numbers are its own, whichever lane walks it: same seed, same
    bits; and two walks of one seed, in scenes that differ in one part, have all photons in common that never meet it.
    """

    def __init__(self, photons: int, seed: int) -> None:
        width = min(photons, CPU_LANES if dr.backend_v(mi.Float) == dr.JitBackend.LLVM else GPU_LANES)
        self.first = dr.arange(mi.UInt32, width)
        # Opaque, or each number of photons would have a kernel of its own.
        self.photons, self.begun = dr.opaque(mi.UInt32, photons), dr.opaque(mi.UInt32, width)
        self.seed = [dr.opaque(mi.UInt32, part) for part in divmod(seed, 1 << 32)]

    def next(self) -> Any:
        """The next photon, whose index is not below `photons` where all have begun."""
        return dr.scatter_inc(self.begun, mi.UInt32(0))

    def random_numbers(self, index: Any) -> Any:
        """The random generator of a photon."""
        rng: Any = mi.PCG32()  # type: ignore[operator]
        stream, state = (mi.sample_tea_64(part, index) for part in self.seed)  # type: ignore[call-overload]
        rng.inc = stream | 1
        rng.state = state + stream
        return rng


def absorption_depth(u: Any) -> Any:
    """The optical depth of absorption at which a photon ends, for a uniform number u."""
    return -dr.log(1 - u) / ANALOG_FRACTION


def survival(tau: Any) -> Any:
    """Fraction of its weight that a photon keeps over an optical depth of absorption; the rest ends photons."""
    return dr.exp(-(1 - ANALOG_FRACTION) * tau)


@dr.syntax
def roulette(photon: Photon, steps: Any, copies: Any, deeper: Any = False) -> None:
    """Add to a photon's steps; where that doubles a long walk, or it is `deeper` than before, end half of the photons,
    and let the others count twice; copies : how many of its weight go on as one, 0 for one that is walked once more."""
    before = mi.UInt32(photon.steps)
    photon.steps = before + steps
    # Their highest bits differ.
    doubled = (photon.steps >= LONG_WALK) & ((photon.steps ^ before) > before)
    if (photon.outcome == 0) & (doubled | deeper):
        ended = photon.rng.next_float32() < 0.5
        # What roulette gives is no absorption.
        gain = photon.weight * copies * survival(photon.tau)
        photon.entered = dr.select(ended, photon.entered, photon.entered + gain)
        photon.weight = dr.select(ended, photon.weight, 2 * photon.weight)
        photon.outcome = dr.select(ended, mi.UInt32(LOST), 0)


def henyey_greenstein(g: Any, u: Any) -> Any:
    """Cosine of a scattering angle, sampled from the Henyey-Greenstein phase function; uniform number u, anisotropy g.

    References: Henyey, Greenstein 1941, Astrophys. J. 93, 70.
    """
    isotropic = dr.abs(g) < 1e-3  # below, the formula loses its digits, and cos = 2u - 1 + O(g) is exact to 1e-3 in g
    s = (1 - g * g) / (1 - g + 2 * g * u)
    cos = (1 + g * g - s * s) / (2 * dr.select(isotropic, 1, g))
    first_order = 2 * u - 1 + 6 * g * u * (1 - u)
    return dr.select(isotropic, clip(first_order, -1, 1), clip(cos, -1, 1))


def rotate_direction(w: Any, cos: Any, phi: Any) -> Any:
    """A direction at an angle of the given cosine to the direction w, at the azimuth phi around it. [rad]

    References: Duff et al. 2017, J. Computer Graphics Techniques 6(1), 1.
    """
    sin_phi, cos_phi = dr.sincos(phi)
    sin = safe_sqrt(1 - cos * cos)
    sign = dr.copysign(mi.Float(1), w.z)
    a = -dr.rcp(sign + w.z)
    b = w.x * w.y * a
    x, y = sin * cos_phi, sin * sin_phi
    rotated = mi.Vector3f(
        x * (1 + sign * w.x * w.x * a) + y * b + cos * w.x,
        x * sign * b + y * (sign + w.y * w.y * a) + cos * w.y,
        -x * sign * w.x - y * w.y + cos * w.z,
    )
    # One Newton step: hundreds of rotations would otherwise let the length drift.
    return rotated * (1.5 - 0.5 * dr.squared_norm(rotated))


def fresnel(cos_in: Any, *, n_in: Any, n_out: Any) -> tuple[Any, Any, Any]:
    """The unpolarised Fresnel reflectance of an interface.

    Returns: reflectance (1 beyond the critical angle), cosine of the refracted angle, n_in / n_out.
    """
    eta = n_in / n_out
    cos_out = safe_sqrt(1 - eta * eta * (1 - cos_in * cos_in))
    s = (n_in * cos_in - n_out * cos_out) * dr.rcp(n_in * cos_in + n_out * cos_out)
    p = (n_in * cos_out - n_out * cos_in) * dr.rcp(n_in * cos_out + n_out * cos_in)
    return dr.select(cos_out > 0, 0.5 * (s * s + p * p), 1), cos_out, eta


def emission_table(led: Led) -> np.ndarray:
    """The squared cosines of an LED's emission at equal steps of probability, (n,) float; those of a Lambertian emitter
    are linear. A measured radiant intensity I(theta) emits I sin(theta) per angle."""
    if led.pattern == "pencil":
        return np.ones_like(LAMBERTIAN)
    if led.pattern == "lambertian":
        return LAMBERTIAN
    assert led.pattern_deg is not None and led.pattern_relative is not None
    theta = np.linspace(0, np.radians(led.pattern_deg[-1]), 4001)
    density = np.interp(theta, np.radians(led.pattern_deg), led.pattern_relative) * np.sin(theta)
    cumulative = np.concatenate([[0], np.cumsum(density[1:] + density[:-1])])
    return np.cos(np.interp(np.linspace(0, 1, MEASURED), cumulative / cumulative[-1], theta)) ** 2


def emission_cosine(table: Any, u: Any) -> Any:
    """The cosine of emission for a uniform number u, from an `emission_table`."""
    place = u * (dr.width(table) - 1)
    cell = minimum(mi.UInt32(place), dr.width(table) - 2)
    low, high = dr.gather(mi.Float, table, cell), dr.gather(mi.Float, table, cell + 1)
    return safe_sqrt(dr.lerp(low, high, place - mi.Float(cell)))


def acceptance_table(photodiode: Photodiode) -> np.ndarray:
    """What a photodiode makes of a photon at equal steps of the squared cosine, 0 to 1, (STEPS + 1,) float.

    A beam of one irradiance across itself sends its cosine's part through a flat face, so that a photon counts as the
    angular response over the cosine, linear in the angle between the rows, nothing beyond the last one.
    """
    if photodiode.angular_response is None:
        return np.ones(STEPS + 1)
    angle, relative = np.array([row for row in photodiode.angular_response if row[0] < 90]).T
    counts = relative / np.cos(np.radians(angle))
    # Rows down to 90 degrees keep the last ratio: there both the response and the cosine are none.
    beyond = counts[-1] if photodiode.angular_response[-1][0] == 90 else 0.0
    at = np.degrees(np.arccos(np.sqrt(np.linspace(0, 1, STEPS + 1))))
    return np.interp(at, angle, counts, right=beyond)


def accepted(photodiode: Photodiode, cos: np.ndarray) -> np.ndarray:
    """What a photodiode makes of photons that meet it, or leave it as they would meet it, at angles, (n,) float."""
    return np.interp(cos**2, np.linspace(0, 1, STEPS + 1), acceptance_table(photodiode).astype(np.float32))


class Acceptance:
    """Tables of several photodiodes, one after the other, as a walk reads them; (photodiodes, STEPS + 1) float."""

    def __init__(self, tables: np.ndarray) -> None:
        self.tables = mi.Float(tables.ravel().astype(np.float32))
        dr.make_opaque(self.tables)

    def at_angle(self, photodiode: Any, cos: Any, active: Any) -> Any:
        """Relative response of a photodiode to light at an angle of that cosine."""
        place = clip(cos * cos, 0, 1) * STEPS
        cell = minimum(mi.UInt32(place), STEPS - 1)
        at = photodiode * (STEPS + 1) + cell
        low, high = dr.gather(mi.Float, self.tables, at, active), dr.gather(mi.Float, self.tables, at + 1, active)
        return dr.lerp(low, high, place - mi.Float(cell))


def acceptance_of(photodiodes: Sequence[Photodiode]) -> Acceptance | None:
    """The acceptance of every element of a scene's photodiodes, as its geometry orders them; None if all are flat."""
    if all(photodiode.angular_response is None for photodiode in photodiodes):
        return None
    tables = [acceptance_table(photodiode) for photodiode in photodiodes]
    return Acceptance(np.repeat(tables, [len(photodiode.wired_elements) for photodiode in photodiodes], axis=0))
