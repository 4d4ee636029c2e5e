"""The photon walk through a finger: scattering between interfaces, and rays only where one may be met."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ... import geometry as finger_geometry
from ...geometry import Face, Geometry
from ...scene import Scene
from .. import optics
from ..transfer.records import LedTrace
from . import sampling
from .interfaces import DETECTED, ON_BOARD, Emitter, FingerPhoton, Interfaces, Medium, Regions, ZoneEdges, off_surface
from .sampling import PhotonEnds, WalkedPhotons, rotate_direction, survival
from .splitting import Reach, Splitting, copies_of
from .tallies import BoardTally, FluenceTally, Section

PLATE, BED, EPOXY = (optics.TISSUES.index(name) for name in ("plate", "bed", "epoxy"))


@lru_cache(maxsize=4)
def built(scene: Scene, variant: str, board: bool = True) -> tuple[Geometry, Interfaces]:
    """A scene's geometry and what light meets there in a variant of Mitsuba for all scenes of one shape; 5 to 16 MB."""
    geometry = finger_geometry.build(scene, board=board)
    return geometry, Interfaces(geometry, finger_geometry.distance_grid(geometry))


class FingerTracer:
    """The photons engine for a finger scene: walks the photons of its LEDs until each has ended."""

    def __init__(self, scene: Scene, *, with_faces: Collection[str] = (), one_by_one: bool = False) -> None:
        """with_faces : As for `trace`. one_by_one : As for `BoardTracer`."""
        self.scene = scene
        shape = finger_geometry.shaping(scene, with_faces=with_faces)
        self.geometry, self.interfaces = built(shape, str(mi.variant()))
        self.photodiodes = tuple(face.name for face in self.geometry.photodiodes)
        self.regions = []
        for led, die in zip(scene.leds, self.geometry.leds, strict=True):
            off = {face.region for face in self.geometry.leds if one_by_one and face is not die}
            names = tuple("kapton" if i in off else name for i, name in enumerate(self.geometry.regions))
            media = optics.finger_media(scene, names, led.wavelength_nm)
            self.regions.append(Regions(replace(self.geometry, regions=names), media))
        self.reach: dict[int, Reach] = {}
        self.zones = optics.zones(scene)
        # The bed's path counts whole, and what of it lies beyond each edge of the zones.
        self.paths = len(optics.TISSUES) + len(self.zones.edges_mm)

    def batch(self, led: int, *, photons: int, seed: int) -> LedTrace:
        """Trace some photons of one LED."""
        if led not in self.reach:
            self.reach[led] = Reach(self.geometry, self.geometry.leds[led])
        reach, acceptance = self.reach[led], sampling.acceptance_of(self.scene.photodiodes)
        while True:
            splitting = Splitting(reach, photons, paths=self.paths)
            walked = self.walk(led, photons=photons, seed=seed, splitting=splitting, acceptance=acceptance)
            if splitting.fits():
                break
        energy, absorbed = walked.energy(self.regions[led].absorbing, self.regions[led].swallows)
        photon, photodiode, weight, paths = splitting.records(seed)
        return LedTrace(
            photons=photons,
            mu_a=optics.absorption(self.scene, self.scene.leds[led].wavelength_nm)[0],
            seeds=(seed,),
            photon=photon,
            photodiode=photodiode.astype(np.uint16),
            weight=weight,
            path_mm=self.by_zone(paths),
            energy=energy,
            absorbed=absorbed,
            events=walked.events,
        )

    def walk(self, led: int, *, photons: int, seed: int, face: Face | None = None, **to: Any) -> WalkedPhotons:
        """Trace some photons of one LED, each counting for itself; their paths are in the order of `by_zone`.

        face : What shines, at the LED's wavelength and Lambertian, in the LED's place.
        to : section, board, splitting: what tallies the photons on their way; only_arrivals, acceptance.
        """
        emission = sampling.LAMBERTIAN if face else sampling.emission_table(self.scene.leds[led])
        emitter = Emitter(face or self.geometry.leds[led], emission, self.regions[led].epoxy)
        ends = PhotonEnds(photons, paths=self.paths, media=len(self.regions[led].absorbing))
        walk = FingerWalk(self.interfaces, self.regions[led], ZoneEdges(self.zones), emitter, ends, **to)
        return ends.evaluated(walk.run(sampling.PhotonQueue(photons, seed)))

    def starts(self, face: Face, *, photons: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Where on the flat board the photons start that `walk` sends from a face of it, (photons, 2) float [mm], and
        the cosines of their angles to it, (photons,) float."""
        index = dr.arange(mi.UInt32, photons)
        rng = sampling.PhotonQueue(photons, seed).random_numbers(index)
        p, _, cos = Emitter(face, sampling.LAMBERTIAN, mi.UInt32(0)).emit(rng, index)
        return self.geometry.on_board(np.array(p).T), np.array(cos).astype(float)

    @staticmethod
    def by_zone(paths: np.ndarray) -> np.ndarray:
        """Paths (t, n) in the order of the absorbers, (n, r): the bed's divided among its zones."""
        count = len(optics.TISSUES)
        beyond = [paths[BED], *paths[count:], np.zeros_like(paths[BED])]
        zones = [a - b for a, b in zip(beyond, beyond[1:], strict=False)]
        return np.stack([paths[PLATE], *zones, *paths[BED + 1 : count]], -1).astype(np.float32)


@dataclass
class _Segment:
    """A photon's way through one region, up to an interface or to where it casts a ray for one.

    step : The next step to come. [mm]
    length : Length so far. [mm]
    beyond : Part of it in the bed beyond each edge of the blood zones. [mm]
    scatterings : Number of scatterings on it.
    """

    step: Any
    length: Any
    beyond: list[Any]
    scatterings: Any


@dataclass(eq=False)
class FingerWalk:
    """The walk of one source's light: what it reads, what tallies it, and what happens to a photon, step by step.

    emitter : What `emit(rng, index)` gives each photon, place, direction and cosine, and the `region` it starts in.
    section, board : Tally all photons on their way.
    only_arrivals : Whether the board's tally alone counts, so that roulette may end light far below.
    splitting : Splits photons near the photodiodes, and takes their scores; without it each counts for itself.
    acceptance : How photodiodes weigh light by its angle.
    """

    interfaces: Interfaces
    regions: Regions
    zones: ZoneEdges
    emitter: Any
    ends: PhotonEnds
    section: Section | FluenceTally | None = None
    board: BoardTally | None = None
    only_arrivals: bool = False
    splitting: Splitting | None = None
    acceptance: sampling.Acceptance | None = None

    @dr.syntax
    def run(self, queue: sampling.PhotonQueue) -> Any:
        """Walk all photons to their ends; returns scatterings per lane."""
        photon = self.launch(queue, queue.first)
        forks = self.splitting.forks() if self.splitting is not None else []
        events = dr.zeros(mi.UInt32, dr.width(queue.first))
        active = photon.index < queue.photons
        while dr.hint(active, label="finger walk"):
            medium = self.regions.medium(photon.region, active)
            segment = self.scatter_freely(photon, medium, active)
            casts = active & (segment.scatterings < photon.free_events)
            hit, triangle = self.step_to_interface(photon, segment, medium, casts)
            events += segment.scatterings
            u, phi = photon.rng.next_float32(), 2 * dr.pi * photon.rng.next_float32()
            scattered = rotate_direction(photon.w, sampling.henyey_greenstein(medium.g, u), phi)
            # A photon that left keeps the way in which it did.
            scatters = casts & ~hit & (photon.outcome == 0)
            photon.w = mi.Vector3f(dr.select(scatters, scattered, photon.w))
            accepted = self.meet_interface(photon, medium, hit, triangle, u, phi)
            absorbed = photon.tau > photon.absorption_optical_depth
            photon.outcome = dr.select(absorbed, mi.UInt32(sampling.ABSORBED), photon.outcome)
            # Copies that are still to come start with the weight that this one had there.
            copies = dr.select(photon.has_no_copies_left(), copies_of(photon), 0)
            deeper = (photon.p.z < photon.roulette_z) & self.only_arrivals
            photon.roulette_z *= dr.select(deeper, mi.Float(2), 1)
            sampling.roulette(photon, segment.scatterings + 1, copies, deeper)
            if self.splitting is None and self.acceptance is not None:
                photon.weight = dr.select(photon.outcome >= DETECTED, photon.weight * accepted, photon.weight)
            if self.splitting is not None:
                self.splitting.add(photon, accepted)
                self.splitting.split(photon, forks, self.regions, active)
            if photon.outcome > 0:
                self.ends.record(photon, medium.tally, medium.tallied)
                if self.splitting is None:
                    self.ends.record_path(photon)
                    dr.scatter(self.ends.cosine, photon.w.z, photon.index)
                photon = self.launch(queue, queue.next())
            # A photon that ended has begun anew; so no loop carries this along.
            photon.outcome = mi.UInt32(0)
            active &= photon.index < queue.photons
        return events

    def launch(self, queue: sampling.PhotonQueue, index: Any) -> FingerPhoton:
        """A new photon on the emitter."""
        rng = queue.random_numbers(index)
        p, w, _ = self.emitter.emit(rng, index)
        return FingerPhoton(
            index=index,
            rng=rng,
            p=p,
            w=w,
            region=mi.UInt32(self.emitter.region),
            absorption_optical_depth=sampling.absorption_depth(rng.next_float32()),
            path=[mi.Float(0) for _ in self.ends.path],
        )

    @dr.syntax
    def scatter_freely(self, photon: FingerPhoton, medium: Medium, active: Any) -> _Segment:
        """Scatter while no interface can be on the next step: what is free around its two ends is longer together."""
        step = medium.free_path(photon.rng)
        segment = _Segment(step, mi.Float(0), [mi.Float(0) for _ in self.zones.edges], mi.UInt32(0))
        here = self.interfaces.clearance(photon.p, active)
        layer = self.interfaces.layer(here.height, photon.side)
        ahead, most = self.interfaces.clearance(photon.p + photon.w * step, active), photon.free_events
        here.height = dr.select(photon.side == 0, here.height, ahead.height)
        photon.side = mi.Float(0)
        while active & self.interfaces.is_free(segment.step, here, ahead, layer) & (segment.scatterings < most):
            self.advance(photon, segment, medium, True)
            cos = sampling.henyey_greenstein(medium.g, photon.rng.next_float32())
            photon.w = mi.Vector3f(rotate_direction(photon.w, cos, 2 * dr.pi * photon.rng.next_float32()))
            segment.step = medium.free_path(photon.rng)
            here = dr.copy(ahead)
            ahead = self.interfaces.clearance(photon.p + photon.w * segment.step, True)
            segment.scatterings += 1
        return segment

    def advance(self, photon: FingerPhoton, segment: _Segment, medium: Medium, active: Any) -> None:
        """Move a photon by its next step, all inside one region."""
        step = segment.step
        beyond = self.zones.beyond(dr.fma(0.5 * step, photon.w.y, photon.p.y), step)
        in_bed = medium.tissue == BED
        segment.beyond = [a + dr.select(in_bed, b, 0) for a, b in zip(segment.beyond, beyond, strict=True)]
        if self.section is not None:
            weight = photon.weight * survival(dr.fma(segment.length, medium.mu_a, photon.tau))
            self.section.add(photon, photon.p + photon.w * (0.5 * step), step, weight, active)
        segment.length = segment.length + step
        photon.p = mi.Point3f(photon.p + photon.w * step)

    def step_to_interface(self, photon: FingerPhoton, segment: _Segment, medium: Medium, casts: Any) -> tuple[Any, Any]:
        """Take the next step of photons that cast a ray, up to the first interface on it, and close the segment;
        returns whether there was one, and which triangle."""
        ray: Any = mi.Ray3f(photon.p, photon.w, segment.step, 0, [])  # type: ignore[call-overload]
        intersection = self.interfaces.scene.ray_intersect_preliminary(ray, coherent=False, active=casts)
        hit = casts & intersection.is_valid()
        gone = casts & ~hit & ~medium.scatters
        segment.step = dr.select(casts & ~gone, dr.select(hit, intersection.t, segment.step), 0)
        self.advance(photon, segment, medium, casts)
        segment.scatterings = segment.scatterings + dr.select(casts & ~hit & ~gone, mi.UInt32(1), mi.UInt32(0))
        photon.tau = dr.fma(segment.length, medium.mu_a, photon.tau)
        inside = [dr.select(medium.tissue == k, segment.length, 0) for k in range(len(optics.TISSUES))]
        photon.path = [path + more for path, more in zip(photon.path, [*inside, *segment.beyond], strict=True)]
        # Photons that leave for ever leave from the air.
        left = dr.select(photon.region == self.regions.air, mi.UInt32(sampling.TOP), mi.UInt32(sampling.LOST))
        photon.outcome = dr.select(gone, left, photon.outcome)
        return hit, intersection.prim_index

    @dr.syntax
    def meet_interface(self, photon: FingerPhoton, medium: Medium, hit: Any, triangle: Any, u: Any, phi: Any) -> Any:
        """Reflect or refract photons at the interface that they hit, or end them in what is opaque.

        u, phi : Uniform numbers in 0-1 and 0-2 pi. [-, rad]

        Returns: what a photodiode makes of light that comes so steeply, of what it makes of light from straight ahead.
        """
        regions, accepted = self.regions, mi.Float(1)
        if hit:
            normal, below, above, in_shell = self.interfaces.sides(triangle)
            up = dr.dot(photon.w, normal) > 0
            here, there = dr.select(up, below, above), dr.select(up, above, below)
            normal = dr.select(up, -normal, normal)
            cos_in = -dr.dot(photon.w, normal)
            *_, n_out = dr.gather(mi.Vector4f, regions.optics, there)
            refraction, cos_out, eta = sampling.fresnel(cos_in, n_in=medium.n, n_out=n_out)
            if self.board is not None:
                arrives = (photon.region == regions.epoxy) & regions.is_a(ON_BOARD, there)
                self.board.add(photon, cos_in, arrives)
                photon.arrivals += dr.select(arrives, mi.UInt32(1), mi.UInt32(0))
            opaque, reflectance, end = regions.opaque(there)
            reflected = u < dr.select(opaque, reflectance, refraction)
            diffuse = rotate_direction(mi.Vector3f(normal), dr.sqrt(photon.rng.next_float32()), phi)
            mirrored = dr.select(opaque, diffuse, photon.w + 2 * cos_in * normal)
            refracted = dr.normalize(eta * photon.w + (eta * cos_in - cos_out) * normal)
            photon.w = mi.Vector3f(dr.select(reflected, mirrored, refracted))
            # Of a photon's copies the last one counts for all.
            tallied = medium.tallied & photon.has_no_copies_left()
            left = photon.weight * copies_of(photon) * survival(photon.tau)
            self.ends.absorb(photon, medium.tally, left, ~reflected, tallied)
            photon.outcome = dr.select(opaque & ~reflected, end, photon.outcome)
            # A photon that meets a face from a region that does not touch it has slipped through an edge.
            photon.outcome = dr.select(here == photon.region, photon.outcome, mi.UInt32(sampling.LOST))
            away = mi.Vector3f(dr.select(reflected, normal, -normal))
            photon.p = mi.Point3f(off_surface(photon.p, away))
            outwards = dr.fma(away.x, photon.p.x, away.z * (photon.p.z + self.interfaces.radius))
            photon.side = dr.select(in_shell, dr.sign(outwards), 0)
            photon.region = dr.select(reflected, photon.region, there)
            if self.acceptance is not None:
                accepted = self.acceptance.at_angle(photon.outcome - DETECTED, cos_in, photon.outcome >= DETECTED)
        return accepted
