"""The photon walk through a finger: scattering between interfaces, and rays only where one may be met."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import geometry as finger_geometry
from ..geometry import DistanceGrid, Face, Geometry
from ..scene import Scene
from . import optics
from .records import Batch
from .sampling import (
    ABSORBED,
    LAMBERTIAN,
    LOST,
    TOP,
    PhotonEnds,
    WalkedPhotons,
    absorption_depth,
    emission_table,
    fresnel,
    henyey_greenstein,
    lanes,
    remaining,
    rotate_direction,
    roulette,
    state_of,
)
from .splitting import COPIES, Splitting
from .surroundings import DETECTED, Emitter, FingerPhoton, Interfaces, Medium, Regions, Surroundings, off_surface
from .tallies.board_tally import BoardTally
from .tallies.section import Section
from .tallies.sensitivity import SensitivityTally

# Scatterings without a ray before lanes wait for each other; more leave lanes idle, fewer cast rays for few lanes.
FREE_EVENTS = 6
# Most scatterings happen so near to the dies and photodiodes; beyond, every step asks for a ray, which is only slower.
ASIDE_MM, BELOW_MM, ABOVE_MM = 5.0, 6.5, 0.1
PLATE, BED, EPOXY = (optics.TISSUES.index(name) for name in ("plate", "bed", "epoxy"))


@lru_cache(maxsize=2)
def _built(scene: Scene, spacing_mm: float) -> tuple[Geometry, DistanceGrid]:
    """A scene's geometry and its distances, which take seconds; scenes that differ in optics have them in common."""
    geometry = finger_geometry.build(scene)
    return geometry, _distances(geometry, spacing_mm)


def _distances(geometry: Geometry, spacing_mm: float) -> DistanceGrid:
    """Distances to the interfaces near the board."""
    faces = (*geometry.leds, *geometry.photodiodes)
    corners = np.concatenate([np.asarray(face.quads).reshape(-1, 3) for face in faces])
    low = np.maximum(corners.min(0) - [ASIDE_MM, ASIDE_MM, BELOW_MM], geometry.bounds_mm[0])
    high = np.minimum(corners.max(0) + [ASIDE_MM, ASIDE_MM, ABOVE_MM], geometry.bounds_mm[1])
    return finger_geometry.distance_grid(geometry, bounds_mm=np.stack([low, high]), spacing_mm=spacing_mm)


class FingerTracer:
    """The photons engine for a finger scene: walks the photons of its LEDs until each has ended."""

    batch_photons = 1 << 18

    def __init__(self, scene: Scene, geometry: Geometry | None = None, *, spacing_mm: float = 0.1) -> None:
        """spacing_mm : Cells of the distances; wider ones are made sooner and let light skip less. [mm]"""
        self.scene = scene
        if geometry is None:
            self.geometry, distances = _built(finger_geometry.shaping(scene), spacing_mm)
        else:
            self.geometry, distances = geometry, _distances(geometry, spacing_mm)
        self.photodiodes = tuple(face.name for face in self.geometry.photodiodes)
        self.interfaces = Interfaces(self.geometry, distances)
        self.regions = [Regions(scene, self.geometry, led.wavelength_nm) for led in scene.leds]
        self.zones = optics.zones(scene)
        # The bed's path counts whole, and what of it lies beyond each edge of the zones.
        self.paths = len(optics.TISSUES) + len(self.zones.edges_mm)

    def mu_a(self, led: int) -> np.ndarray:
        """Absorption for which the weights hold, (r,) float. [mm^-1]"""
        return optics.absorption(self.scene, self.scene.leds[led].wavelength_nm)[0]

    def batch(self, led: int, *, photons: int, seed: int) -> Batch:
        """Trace some photons of one LED."""
        splitting = Splitting(self.geometry, photons)
        rng, count = lanes(photons, seed)
        walked = self._run(led, rng, count, photons, splitting=splitting)
        photodiode, score = np.array(splitting.photodiode), np.array(splitting.score)
        detected = np.flatnonzero(score)
        return Batch(
            photons=photons,
            photodiode=photodiode[detected].astype(np.uint16),
            weight=score[detected].astype(float),
            path_mm=self.by_zone(walked.path_mm[:, detected]),
            energy=walked.energy(),
            events=walked.events,
        )

    def walk(
        self,
        led: int,
        *,
        photons: int,
        seed: int,
        face: Face | None = None,
        section: Section | None = None,
        board: BoardTally | None = None,
    ) -> WalkedPhotons:
        """Trace some photons of one LED, each counting for itself; their paths are in the order of `by_zone`.

        face : What shines, at the LED's wavelength and Lambertian, in the LED's place.
        """
        rng, count = lanes(photons, seed)
        return self._run(led, rng, count, photons, face=face, section=section, board=board)

    def replay(self, led: int, *, photons: int, seed: int, which: np.ndarray, tally: SensitivityTally) -> np.ndarray:
        """Walk some photons (n,) of a walk once more, to tally where they were; returns their outcome (n,).

        It is the walk's, but for a photon in ten thousand or so whose rays round otherwise among other rays.
        """
        lane, _ = lanes(photons, seed)
        photon = mi.UInt32(which.astype(np.uint32))
        rng: Any = mi.PCG32(size=len(which))  # type: ignore[operator]
        rng.state, rng.inc = (dr.gather(mi.UInt64, a, photon % dr.width(a)) for a in (lane.state, mi.UInt64(lane.inc)))
        once = dr.full(mi.UInt32, 1, len(which))
        return self._run(led, rng, once, photons, first=photon, section=tally).outcome[which]

    def _run(
        self,
        led: int,
        rng: Any,
        count: Any,
        photons: int,
        *,
        first: Any = None,
        face: Face | None = None,
        section: Section | SensitivityTally | None = None,
        board: BoardTally | None = None,
        splitting: Splitting | None = None,
    ) -> WalkedPhotons:
        emission = LAMBERTIAN if face else emission_table(self.scene.leds[led])
        emitter = Emitter(face or self.geometry.leds[led], emission)
        around = Surroundings(self.interfaces, self.regions[led], emitter, self.zones)
        ends = PhotonEnds(photons, paths=self.paths)
        first = dr.arange(mi.UInt32, dr.width(count)) if first is None else first
        return ends.evaluated(_walk(around, rng, count, first, ends, section, board, splitting))

    def by_zone(self, paths: np.ndarray) -> np.ndarray:
        """Paths (t, n) in the order of the absorbers, (n, r): the bed's divided among its zones."""
        count = len(optics.TISSUES)
        beyond = [paths[BED], *paths[count:], np.zeros_like(paths[BED])]
        zones = [a - b for a, b in zip(beyond, beyond[1:], strict=False)]
        return np.stack([paths[PLATE], *zones, *paths[BED + 1 : count]], -1).astype(np.float32)


@dataclass
class _Fork:
    """Where a photon was split, and how it stood there: all that its copies change on their way."""

    p: Any
    w: Any
    region: Any
    weight: Any
    tau: Any
    plate_mm: Any
    epoxy_mm: Any


@dataclass
class _Leg:
    """A photon's way through one region, up to an interface or to where it was last asked for one.

    step : The next step to come. [mm]
    length : Length so far. [mm]
    beyond : Part of it in the bed beyond each edge of the blood zones. [mm]
    scatterings : Number of scatterings on it.
    """

    step: Any
    length: Any
    beyond: list[Any]
    scatterings: Any


def _launch(around: Surroundings, rng: Any, lane: Any, index: Any) -> FingerPhoton:
    """A new photon on the emitter."""
    F, U = mi.Float, mi.UInt32
    rng.state = state_of(lane, index)
    p, w = around.emitter.emit(rng)
    return FingerPhoton(
        index=index,
        rng=rng,
        p=p,
        w=w,
        region=U(around.regions.epoxy),
        weight=F(1),
        roulette_balance=F(0),
        tau=F(0),
        absorption_optical_depth=absorption_depth(rng.next_float32()),
        path=[F(0) for _ in range(len(optics.TISSUES) + len(around.zones.edges))],
        steps=U(0),
        outcome=U(0),
        arrivals=U(0),
        copies=U(1),
        copies_left=U(0),
        score=F(0),
    )


def _fork(photon: FingerPhoton) -> _Fork:
    return _Fork(
        p=mi.Point3f(photon.p),
        w=mi.Vector3f(photon.w),
        region=mi.UInt32(photon.region),
        weight=mi.Float(photon.weight),
        tau=mi.Float(photon.tau),
        plate_mm=mi.Float(photon.path[PLATE]),
        epoxy_mm=mi.Float(photon.path[EPOXY]),
    )


@dr.syntax
def _walk(
    around: Surroundings,
    rng: Any,
    count: Any,
    first: Any,
    ends: PhotonEnds,
    section: Section | SensitivityTally | None,
    board: BoardTally | None,
    splitting: Splitting | None,
) -> Any:
    """Walk all photons of a batch to their ends, in each lane one after the other; returns scatterings per lane.

    rng, count, first : Per lane: its generator, how many photons it walks, and the first one's index.
    """
    width, lane = dr.width(count), mi.UInt64(rng.state)
    photon = _launch(around, rng, lane, first)
    fork = _fork(photon)
    events = dr.zeros(mi.UInt32, width)
    active = count > 0
    while dr.hint(active, label="finger walk"):
        medium = around.regions.medium(photon.region, active)
        leg = _scatter_freely(photon, medium, around, section, active)
        asks = active & (leg.scatterings < FREE_EVENTS)
        hit, triangle = _step_to_interface(photon, leg, medium, around, section, asks)
        events += leg.scatterings
        u, phi = photon.rng.next_float32(), 2 * dr.pi * photon.rng.next_float32()
        scattered = rotate_direction(photon.w, henyey_greenstein(medium.g, u), phi)
        photon.w = mi.Vector3f(dr.select(asks & ~hit, scattered, photon.w))
        _meet_interface(photon, hit, triangle, u, phi, around, board)
        absorbed = photon.tau > photon.absorption_optical_depth
        photon.outcome = dr.select(absorbed, mi.UInt32(ABSORBED), photon.outcome)
        # Copies that are still to come start with the weight that this one had there.
        roulette(photon, leg.scatterings + 1, dr.select(photon.copies_left > 0, 0, mi.Float(photon.copies)))
        if splitting is not None:
            _detect(photon, ends, splitting)
            _split(photon, fork, around, splitting, active)
        if photon.outcome > 0:
            ends.record(photon)
            if splitting is None:
                ends.record_path(photon)
            else:
                dr.scatter(splitting.score, photon.score, photon.index)
            photon = _launch(around, photon.rng, lane, photon.index + width)
            count -= 1
        # Whoever ended has begun anew; so no loop carries this along.
        photon.outcome = mi.UInt32(0)
        active &= count > 0
    return events


@dr.syntax
def _scatter_freely(
    photon: FingerPhoton,
    medium: Medium,
    around: Surroundings,
    section: Section | SensitivityTally | None,
    active: Any,
) -> _Leg:
    """Scatter while the next step stays nearer than any interface, without asking where the interfaces are."""
    step = medium.free_path(photon.rng)
    leg = _Leg(step, mi.Float(0), [mi.Float(0) for _ in around.zones.edges], mi.UInt32(0))
    free = around.interfaces.free(photon.p, active)
    while active & (leg.step < free) & (leg.scatterings < FREE_EVENTS):
        _advance(photon, leg, medium, around, section, True)
        cos = henyey_greenstein(medium.g, photon.rng.next_float32())
        photon.w = mi.Vector3f(rotate_direction(photon.w, cos, 2 * dr.pi * photon.rng.next_float32()))
        leg.step = medium.free_path(photon.rng)
        free = around.interfaces.free(photon.p, True)
        leg.scatterings += 1
    return leg


def _advance(
    photon: FingerPhoton,
    leg: _Leg,
    medium: Medium,
    around: Surroundings,
    section: Section | SensitivityTally | None,
    active: Any,
) -> None:
    """Move a photon by its next step, all inside one region."""
    step = leg.step
    beyond = around.zones.beyond(dr.fma(0.5 * step, photon.w.y, photon.p.y), step)
    for k in range(len(beyond)):
        leg.beyond[k] = leg.beyond[k] + dr.select(medium.in_bed, beyond[k], 0)
    if section is not None:
        weight = photon.weight * remaining(dr.fma(leg.length, medium.mu_a, photon.tau))
        section.add(photon, photon.p + photon.w * (0.5 * step), step, weight, active)
    leg.length = leg.length + step
    photon.p = mi.Point3f(photon.p + photon.w * step)


def _step_to_interface(
    photon: FingerPhoton,
    leg: _Leg,
    medium: Medium,
    around: Surroundings,
    section: Section | SensitivityTally | None,
    asks: Any,
) -> tuple[Any, Any]:
    """Take the next step of photons that ask for a ray, up to the first interface on it, and close the leg.

    Returns: whether there was one, and which triangle.
    """
    found = around.interfaces.first_hit(photon.p, photon.w, leg.step, asks)
    hit = asks & found.is_valid()
    gone = asks & ~hit & ~medium.scatters
    leg.step = dr.select(asks & ~gone, dr.select(hit, found.t, leg.step), 0)
    _advance(photon, leg, medium, around, section, asks)
    leg.scatterings = leg.scatterings + dr.select(asks & ~hit & ~gone, mi.UInt32(1), mi.UInt32(0))
    photon.tau = dr.fma(leg.length, medium.mu_a, photon.tau)
    tissue, kinds = dr.gather(mi.UInt32, around.regions.tissue, photon.region), len(optics.TISSUES)
    inside = [dr.select(tissue == k, leg.length, 0) for k in range(kinds)]
    photon.path = [path + more for path, more in zip(photon.path, [*inside, *leg.beyond], strict=True)]
    # Whoever leaves for ever leaves from the air.
    left = dr.select(photon.region == around.regions.air, mi.UInt32(TOP), mi.UInt32(LOST))
    photon.outcome = dr.select(gone, left, photon.outcome)
    return hit, found.prim_index


@dr.syntax
def _meet_interface(
    photon: FingerPhoton, hit: Any, triangle: Any, u: Any, phi: Any, around: Surroundings, board: BoardTally | None
) -> None:
    """Reflect or refract photons at the interface that they hit, or end them in what is opaque.

    u, phi : Uniform numbers in 0-1 and 0-2 pi. [-, rad]
    """
    regions, F, U = around.regions, mi.Float, mi.UInt32
    if hit:
        normal, below, above = around.interfaces.sides(triangle)
        up = dr.dot(photon.w, normal) > 0
        here, there = dr.select(up, below, above), dr.select(up, above, below)
        normal = dr.select(up, -normal, normal)
        cos_in = -dr.dot(photon.w, normal)
        reflectance, cos_out, eta = fresnel(
            cos_in, n_in=dr.gather(F, regions.n, photon.region), n_out=dr.gather(F, regions.n, there)
        )
        if board is not None:
            arrives = (photon.region == regions.epoxy) & dr.gather(mi.Bool, regions.on_board, there)
            board.add(photon, arrives & (photon.tau <= photon.absorption_optical_depth))
            photon.arrivals += dr.select(arrives, U(1), U(0))
        opaque = dr.gather(mi.Bool, regions.opaque, there)
        reflected = u < dr.select(opaque, dr.gather(F, regions.reflectance, there), reflectance)
        diffuse = rotate_direction(mi.Vector3f(normal), dr.sqrt(photon.rng.next_float32()), phi)
        mirrored = dr.select(opaque, diffuse, photon.w + 2 * cos_in * normal)
        refracted = dr.normalize(eta * photon.w + (eta * cos_in - cos_out) * normal)
        photon.w = mi.Vector3f(dr.select(reflected, mirrored, refracted))
        photon.outcome = dr.select(opaque & ~reflected, dr.gather(U, regions.end, there), photon.outcome)
        # Whoever meets a face from a region that does not touch it has slipped through an edge.
        photon.outcome = dr.select(here == photon.region, photon.outcome, U(LOST))
        photon.p = mi.Point3f(off_surface(photon.p, dr.select(reflected, normal, -normal)))
        photon.region = dr.select(reflected, photon.region, there)


@dr.syntax
def _detect(photon: FingerPhoton, ends: PhotonEnds, splitting: Splitting) -> None:
    """Score a photon that reached a photodiode; of its copies one is kept, as likely as it weighs."""
    if photon.outcome >= DETECTED:
        weight = photon.weight * remaining(photon.tau)
        photon.score += weight
        if photon.rng.next_float32() * photon.score < weight:
            dr.scatter(splitting.photodiode, photon.outcome - DETECTED, photon.index)
            ends.record_path(photon)


@dr.syntax
def _split(photon: FingerPhoton, fork: _Fork, around: Surroundings, splitting: Splitting, active: Any) -> None:
    """Split a photon that comes over the bed within reach of a photodiode, and walk its copies one after the other.

    Each starts where the photon came within reach, and ends there or goes away. All of them may be detected; it is the
    last that goes on, with the whole weight.
    """
    F, U = mi.Float, mi.UInt32
    over_bed = dr.gather(mi.Bool, around.regions.over_bed, photon.region, active)
    near = splitting.within_reach(photon.p, over_bed)
    if near & (photon.copies == 1) & (photon.outcome == 0):
        photon.copies, photon.copies_left, photon.weight = U(COPIES), U(COPIES - 1), photon.weight / COPIES
        fork.p, fork.w, fork.region = mi.Point3f(photon.p), mi.Vector3f(photon.w), U(photon.region)
        fork.weight, fork.tau = F(photon.weight), F(photon.tau)
        fork.plate_mm, fork.epoxy_mm = F(photon.path[PLATE]), F(photon.path[EPOXY])
    done = (photon.copies > 1) & ((photon.outcome > 0) | ~near)
    if done & (photon.copies_left == 0):
        photon.weight, photon.copies = photon.weight * F(photon.copies), U(1)
    if done & (photon.copies_left > 0):
        photon.p, photon.w, photon.region = mi.Point3f(fork.p), mi.Vector3f(fork.w), U(fork.region)
        photon.weight, photon.tau = F(fork.weight), F(fork.tau)
        photon.path[PLATE], photon.path[EPOXY] = F(fork.plate_mm), F(fork.epoxy_mm)
        # What absorption leaves a photon knows nothing of how far it came.
        photon.absorption_optical_depth = photon.tau + absorption_depth(photon.rng.next_float32())
        photon.copies_left -= 1
        photon.outcome = U(0)
