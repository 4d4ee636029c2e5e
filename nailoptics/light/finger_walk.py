"""The photon walk through a finger: scattering between interfaces, and rays only where one may be met."""

from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import geometry
from ..geometry import DistanceGrid, Face, Geometry
from ..scene import Scene
from . import optics
from .arithmetic import clip, maximum
from .records import Batch
from .sampling import (
    ABSORBED,
    BOTTOM,
    FAR,
    KILLED_SHARE,
    LAMBERTIAN,
    LONG_LIFE,
    LOST,
    TOP,
    emission_cosine,
    emission_table,
    energy_sums,
    fresnel,
    henyey_greenstein,
    lanes,
    lifetime,
    state_of,
    turn,
)
from .splitting import COPIES, Splitting
from .tallies.board_tally import Recorder
from .tallies.sensitivity import Seen

# Outcomes from here on name the photodiode that a photon reached.
DETECTED = 16
# Scatterings without a ray before lanes wait for each other; more leave lanes idle, fewer cast rays for few lanes.
FREE_EVENTS = 6
# Through these light comes back from the bed to the photodiodes.
OVER_BED = ("plate", "epoxy")


# What of a scene does not shape it.
_SHAPELESS = {
    name: Scene.model_fields[name].default
    for name in ("blood", "touch", "electronics", "light", "accuracy", "placement")
}


@lru_cache(maxsize=2)
def _shaped(scene: Scene, spacing_mm: float) -> tuple[Geometry, DistanceGrid]:
    """A scene's shape and its distances, which take seconds; scenes that differ in optics have them in common."""
    shape = geometry.build(scene)
    return shape, _distances(shape, spacing_mm)


def _distances(shape: Geometry, spacing_mm: float) -> DistanceGrid:
    return geometry.distance_grid(shape, bounds_mm=_near_board(shape), spacing_mm=spacing_mm)


class MeshTracer:
    """Traces the LEDs of a finger scene."""

    batch_photons = 1 << 18

    def __init__(self, scene: Scene, shape: Geometry | None = None, *, spacing_mm: float = 0.1) -> None:
        """spacing_mm : cells of the distances; wider ones are made sooner and let light skip less. [mm]"""
        self.scene = scene
        if shape is None:
            self.shape, distances = _shaped(scene.model_copy(update=_SHAPELESS), spacing_mm)
        else:
            self.shape, distances = shape, _distances(shape, spacing_mm)
        self.photodiodes = tuple(face.name for face in self.shape.photodiodes)
        self.absorbers = optics.absorbers(scene)
        self.mesh_scene = _mesh_scene(self.shape)
        self.triangles = _triangle_table(self.shape)
        self.grid = _Grid(distances)
        self.regions = [_RegionTable(self, led.wavelength_nm) for led in scene.leds]

    def mu_a(self, led: int) -> np.ndarray:
        """Absorption for which the weights hold, (r,) float. [mm^-1]"""
        return optics.absorption(self.scene, self.scene.leds[led].wavelength_nm)[0]

    def batch(self, led: int, *, photons: int, seed: int) -> Batch:
        """Trace some photons of one LED."""
        splitting = Splitting(self.shape, photons)
        rng, count = lanes(photons, seed)
        outcome, weight, roulette, paths, events = self._run(led, rng, count, photons, splitting=splitting)
        photodiode, score = np.array(splitting.photodiode), np.array(splitting.score)
        seen = np.flatnonzero(score)
        # Light that ends in a photodiode is absorbed there, as far as the energy goes.
        whereabouts = np.where(outcome >= DETECTED, ABSORBED, outcome)
        return Batch(
            photons=photons,
            photodiode=photodiode[seen].astype(np.uint16),
            weight=score[seen].astype(float),
            path_mm=self.by_zone(paths[:, seen]),
            energy=energy_sums(whereabouts, weight.astype(float), roulette.astype(float)),
            events=events,
        )

    def walk(
        self,
        led: int,
        *,
        photons: int,
        seed: int,
        face: Face | None = None,
        section: "Section | None" = None,
        board: Recorder | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
        """Outcome, weight, roulette (n,) and paths (media + zones - 1, n) of each photon; scatterings in all.

        face : what shines, at the LED's wavelength and Lambertian, in the LED's place.
        """
        rng, count = lanes(photons, seed)
        return self._run(led, rng, count, photons, face=face, section=section, board=board)

    def replay(self, led: int, *, photons: int, seed: int, which: np.ndarray, seen: Seen) -> np.ndarray:
        """Walk some photons (n,) of a walk once more, to see where they were; returns their outcome (n,).

        It is the walk's, but for a photon in ten thousand or so whose rays round otherwise among other rays.
        """
        lane, _ = lanes(photons, seed)
        photon = mi.UInt32(which.astype(np.uint32))
        rng: Any = mi.PCG32(size=len(which))  # type: ignore[operator]
        rng.state, rng.inc = (dr.gather(mi.UInt64, a, photon % dr.width(a)) for a in (lane.state, mi.UInt64(lane.inc)))
        once = dr.full(mi.UInt32, 1, len(which))
        return self._run(led, rng, once, photons, first=photon, section=seen)[0][which]

    def _run(
        self,
        led: int,
        rng: Any,
        count: Any,
        photons: int,
        *,
        first: Any = None,
        face: Face | None = None,
        section: "Section | Seen | None" = None,
        board: Recorder | None = None,
        splitting: Splitting | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
        source, shines = face or self.shape.leds[led], self.scene.leds[led]
        emission = LAMBERTIAN if face else emission_table(shines)
        blood = optics.zones(self.scene)
        tallies = len(optics.TISSUES) + blood.count - 1
        results = [dr.zeros(mi.UInt32, photons)] + [dr.zeros(mi.Float, photons) for _ in range(2 + tallies)]
        events = _walk(
            rng,
            count,
            dr.arange(mi.UInt32, dr.width(count)) if first is None else first,
            self.mesh_scene,
            self.triangles,
            self.grid,
            self.regions[led],
            _emitter(source, emission),
            [dr.opaque(mi.Float, edge) for edge in blood.edges_mm],
            dr.opaque(mi.Float, blood.width_mm),
            results,
            section,
            board,
            splitting,
        )
        dr.eval(events, results)
        outcome, weight, roulette, *paths = (np.array(a) for a in results)
        return outcome, weight, roulette, np.stack(paths), int(np.array(events).sum(dtype=np.int64))

    def by_zone(self, paths: np.ndarray) -> np.ndarray:
        """Paths in the order of the absorbers, (n, r): the bed's divided among its zones."""
        bed = optics.TISSUES.index("bed")
        beyond = [paths[bed], *paths[len(optics.TISSUES) :], np.zeros_like(paths[bed])]
        zones = [a - b for a, b in zip(beyond, beyond[1:], strict=False)]
        return np.stack([paths[0], *zones, *paths[bed + 1 : len(optics.TISSUES)]], -1).astype(np.float32)


class Section:
    """The light's path density on the longitudinal section, summed over the finger's width."""

    def __init__(self, y_mm: np.ndarray, z_mm: np.ndarray) -> None:
        self.y_mm, self.z_mm, self.spacing_mm = y_mm, z_mm, float(y_mm[1] - y_mm[0])
        self.values = dr.zeros(mi.Float64, len(y_mm) * len(z_mm))
        self.low = [dr.opaque(mi.Float, float(axis[0] - self.spacing_mm / 2)) for axis in (y_mm, z_mm)]
        self.shape = [dr.opaque(mi.UInt32, len(axis)) for axis in (y_mm, z_mm)]

    def add(self, p: Any, path: Any, weight: Any, photon: Any, active: Any) -> None:
        """Add paths, weighted, at their middles. [mm]"""
        j = mi.Int32(dr.floor((p.y - self.low[0]) / self.spacing_mm))
        k = mi.Int32(dr.floor((p.z - self.low[1]) / self.spacing_mm))
        inside = active & (j >= 0) & (k >= 0) & (mi.UInt32(j) < self.shape[0]) & (mi.UInt32(k) < self.shape[1])
        dr.scatter_reduce(
            dr.ReduceOp.Add, self.values, mi.Float64(path * weight), mi.UInt32(j) * self.shape[1] + mi.UInt32(k), inside
        )

    def density(self, photons: int) -> np.ndarray:
        """Path per area of the section and emitted photon, (y, z) float. [mm^-1]"""
        return np.array(self.values).reshape(len(self.y_mm), len(self.z_mm)) / (photons * self.spacing_mm**2)


class _RegionTable:
    """Optics of each region as Dr.Jit arrays, at rest and at one wavelength."""

    def __init__(self, tracer: MeshTracer, wavelength_nm: float) -> None:
        names = tracer.shape.regions
        found = optics.finger_media(tracer.scene, names, wavelength_nm)
        first = {name: i for i, name in enumerate(names)}
        detectors = {face.region: DETECTED + i for i, face in enumerate(tracer.shape.photodiodes)}
        end = [BOTTOM if name == "cut" else detectors.get(i, ABSORBED) for i, name in enumerate(names)]
        self.mu_a = mi.Float(found.mu_a)
        self.mu_s = mi.Float(found.mu_s)
        self.g = mi.Float(found.g)
        self.n = mi.Float(found.n)
        self.opaque = mi.UInt32(found.opaque.astype(np.uint32))
        self.reflectance = mi.Float(found.reflectance)
        parts = {face.region for face in (*tracer.shape.leds, *tracer.shape.photodiodes)}
        on_board = [name in ("kapton", "silicon") or i in parts for i, name in enumerate(names)]
        self.on_board = mi.UInt32(np.array(on_board, np.uint32))
        self.end = mi.UInt32(np.array(end, np.uint32))
        self.medium = mi.UInt32(
            np.array([optics.TISSUES.index(n) if n in optics.TISSUES else 99 for n in names], np.uint32)
        )
        self.over_bed = mi.Bool(np.array([name in OVER_BED for name in names]))
        self.bed, self.epoxy, self.air = (dr.opaque(mi.UInt32, first[name]) for name in ("bed", "epoxy", "air"))


class _Grid:
    """Lower bounds of the distance to the nearest interface, at the centres of a regular grid."""

    def __init__(self, grid: Any) -> None:
        self.values = mi.Float(np.ascontiguousarray(grid.distance_mm.transpose(2, 1, 0), np.float32).ravel())
        self.shape = [dr.opaque(mi.UInt32, int(n)) for n in grid.distance_mm.shape]
        self.origin = [dr.opaque(mi.Float, float(x)) for x in grid.origin_mm]
        self.spacing = dr.opaque(mi.Float, float(grid.spacing_mm))

    def free(self, p: Any, active: Any) -> Any:
        """A distance at p within which no interface lies; 0 where nothing is known."""
        cell, off = [], mi.Float(0)
        inside = mi.Bool(active)
        for value, low, n in zip(p, self.origin, self.shape, strict=True):
            place = (value - low) * dr.rcp(self.spacing)
            index = mi.Int32(dr.floor(place))
            inside &= (index >= 0) & (mi.UInt32(index) < n)
            cell.append(mi.UInt32(index))
            off += dr.square(place - mi.Float(index) - 0.5)
        at = cell[0] + self.shape[0] * (cell[1] + self.shape[1] * cell[2])
        return maximum(dr.gather(mi.Float, self.values, at, inside) - dr.sqrt(off) * self.spacing, 0)


def _near_board(shape: Geometry) -> np.ndarray:
    """The box (2, 3) in which most scatterings happen; beyond it every step asks for a ray, which is only slower."""
    corners = np.concatenate([np.asarray(face.quads).reshape(-1, 3) for face in (*shape.leds, *shape.photodiodes)])
    low, high = corners.min(0) - [5, 5, 6.5], corners.max(0) + [5, 5, 0.1]
    bounds = np.asarray(shape.bounds_mm)
    return np.stack([np.maximum(low, bounds[0]), np.minimum(high, bounds[1])])


def _mesh_scene(shape: Geometry) -> Any:
    mesh = mi.Mesh("interfaces", len(shape.vertices), len(shape.triangles))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(shape.vertices.astype(np.float32).ravel())
    params["faces"] = mi.UInt32(shape.triangles.astype(np.uint32).ravel())
    params.update()
    return mi.load_dict({"type": "scene", "interfaces": mesh}, optimize=False)


def _triangle_table(shape: Geometry) -> Any:
    """Per triangle: normal (3) and, packed into the bits of the fourth number, the regions below and above."""
    a, b, c = (shape.vertices[shape.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    table = np.empty((len(normal), 4), np.float32)
    table[:, :3] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    table[:, 3] = (shape.below + 1 + (shape.above.astype(np.uint32) + 1) * 1024).astype(np.float32)
    return mi.Float(table.ravel())


def _emitter(face: Face, emission: np.ndarray) -> dict[str, Any]:
    """Corners of the die's facets and their shares of its area; and its `emission_table`."""
    quads = np.asarray(face.quads)
    area = np.linalg.norm(np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]), axis=1) / 2
    return {
        "upto": mi.Float(np.cumsum(area) / area.sum()),
        "corners": mi.Float(quads.astype(np.float32).ravel()),
        "normal": mi.Float(np.asarray(face.normal, np.float32).ravel()),
        "emission": mi.Float(emission),
    }


def _launch(rng: Any, emitter: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Place and direction of a new photon, and the optical depth of absorption at which it will end."""
    facets = dr.width(emitter["upto"])
    pick, facet = rng.next_float32(), mi.UInt32(0)
    for i in range(facets - 1):
        facet += dr.select(pick >= dr.gather(mi.Float, emitter["upto"], i), mi.UInt32(1), mi.UInt32(0))
    a, b, c, d = (dr.gather(mi.Point3f, emitter["corners"], 4 * facet + i) for i in range(4))
    u, v = rng.next_float32(), rng.next_float32()
    normal = dr.gather(mi.Vector3f, emitter["normal"], facet)
    p = dr.lerp(dr.lerp(a, b, u), dr.lerp(d, c, u), v)
    cos = emission_cosine(emitter["emission"], rng.next_float32())
    w = turn(normal, cos, 2 * dr.pi * rng.next_float32())
    return mi.Point3f(_off(p, normal)), mi.Vector3f(w), lifetime(rng.next_float32())


def _dimmed(tau: Any) -> Any:
    """Weight after an optical depth of absorption, of which a part ends photons instead."""
    return dr.exp(-(1 - KILLED_SHARE) * tau)


def _off(p: Any, normal: Any) -> Any:
    """A point moved off a face by a little more than float32 resolves there."""
    return p + normal * (2e-6 * (1 + maximum(maximum(dr.abs(p.x), dr.abs(p.y)), dr.abs(p.z))))


@dr.syntax
def _walk(
    rng: Any,
    count: Any,
    photon: Any,
    scene: Any,
    triangles: Any,
    grid: _Grid,
    region_of: _RegionTable,
    emitter: dict[str, Any],
    edges: list[Any],
    passage: Any,
    results: list[Any],
    section: Section | Seen | None,
    board: Recorder | None,
    splitting: Splitting | None,
) -> Any:
    """Scatterings per lane; a lane walks one photon after the other, so that none waits for one long life.

    With `splitting`, a photon over the bed and within reach of a photodiode is walked as `fan` copies, one after the
    other, each from where the first came within reach until it ends or goes away. All of them may be detected; it is
    the last that goes on, with the whole weight. `copies` of them are still to come.
    """
    F, U = mi.Float, mi.UInt32
    outcome_of, weight_of, roulette_of, *path_of = results
    width, kinds, inner = dr.width(count), len(optics.TISSUES), len(edges)
    lane = mi.UInt64(rng.state)
    rng.state = state_of(lane, photon)
    p, w, life = _launch(rng, emitter)
    tau, boost, given = dr.zeros(F, width), dr.full(F, 1, width), dr.zeros(F, width)
    region = dr.full(U, 0, width) + region_of.epoxy
    age, events = dr.zeros(U, width), dr.zeros(U, width)
    path = [dr.zeros(F, width) for _ in range(kinds + inner)]
    arrived = dr.zeros(U, width)
    fan, copies, score = dr.full(U, 1, width), dr.zeros(U, width), dr.zeros(F, width)
    plate, epoxy = (optics.TISSUES.index(name) for name in OVER_BED)
    p0, w0, tau0, boost0, region0 = mi.Point3f(p), mi.Vector3f(w), F(tau), F(boost), U(region)
    plate0, epoxy0 = dr.zeros(F, width), dr.zeros(F, width)
    active = count > 0
    while dr.hint(active, label="finger walk"):
        mu_s = dr.gather(F, region_of.mu_s, region, active)
        g = dr.gather(F, region_of.g, region, active)
        in_bed = region == region_of.bed
        scatters = mu_s > 0
        length = dr.select(scatters, -dr.rcp(mu_s), -FAR)
        step = length * dr.log(1 - rng.next_float32())
        step = dr.select(scatters, step, FAR)
        free = grid.free(p, active)
        along, spent = F(0), U(0)
        mu_a = dr.gather(F, region_of.mu_a, region, active)
        passed = [F(0) for _ in range(inner)]
        # Inside the free distance nothing can be met: scatter without asking where the interfaces are.
        while active & (step < free) & (spent < FREE_EVENTS):
            middle = dr.fma(0.5 * step, w.y, p.y)
            for k in range(inner):
                t = clip((middle - edges[k]) / passage + 0.5, 0, 1)
                passed[k] = passed[k] + dr.select(in_bed, step * t * t * (3 - 2 * t), 0)
            if section is not None:
                weight = boost * _dimmed(dr.fma(along, mu_a, tau))
                section.add(p + w * (0.5 * step), step, weight, photon, True)
            p = mi.Point3f(p + w * step)
            along += step
            w = mi.Vector3f(turn(w, henyey_greenstein(g, rng.next_float32()), 2 * dr.pi * rng.next_float32()))
            step = length * dr.log(1 - rng.next_float32())
            free = grid.free(p, True)
            spent += 1

        stuck = active & (spent < FREE_EVENTS)
        ray: Any = mi.Ray3f(p, w, step, 0, [])  # type: ignore[call-overload]
        pi = scene.ray_intersect_preliminary(ray, coherent=False, active=stuck)
        hit = stuck & pi.is_valid()
        gone = stuck & ~hit & ~scatters
        step = dr.select(stuck & ~gone, dr.select(hit, pi.t, step), 0)
        middle = dr.fma(0.5 * step, w.y, p.y)
        for k in range(inner):
            t = clip((middle - edges[k]) / passage + 0.5, 0, 1)
            passed[k] = passed[k] + dr.select(in_bed, step * t * t * (3 - 2 * t), 0)
            path[kinds + k] = path[kinds + k] + passed[k]
        if section is not None:
            section.add(p + w * (0.5 * step), step, boost * _dimmed(dr.fma(along, mu_a, tau)), photon, stuck)
        along += step
        kind = dr.gather(U, region_of.medium, region, active)
        for k in range(kinds):
            path[k] = path[k] + dr.select(kind == k, along, 0)
        tau = dr.fma(along, mu_a, tau)
        p = mi.Point3f(p + w * step)
        spent += dr.select(stuck & ~hit & ~gone, U(1), U(0))
        events += spent
        older = age + spent + 1

        absorbed = tau > life
        outcome = dr.select(gone, dr.select(region == region_of.air, U(TOP), U(LOST)), U(0))
        spin, phi = rng.next_float32(), 2 * dr.pi * rng.next_float32()
        turned = turn(w, henyey_greenstein(g, spin), phi)
        if hit:
            row = dr.gather(mi.Vector4f, triangles, pi.prim_index)
            normal = mi.Vector3f(row.x, row.y, row.z)
            pair = U(row.w)
            below, above = (pair & 1023) - 1, (pair >> 10) - 1
            up = dr.dot(w, normal) > 0
            there = dr.select(up, above, below)
            normal = dr.select(up, -normal, normal)
            mirrored, cos_out, eta = fresnel(
                -dr.dot(w, normal), n_in=dr.gather(F, region_of.n, region), n_out=dr.gather(F, region_of.n, there)
            )
            cos_in = -dr.dot(w, normal)
            if board is not None:
                arrives = (region == region_of.epoxy) & (dr.gather(U, region_of.on_board, there) == 1)
                board.add(p, boost * _dimmed(tau), path, photon, arrived, arrives & (tau <= life))
                arrived += dr.select(arrives, U(1), U(0))
            opaque = dr.gather(U, region_of.opaque, there) == 1
            reflected = spin < dr.select(opaque, dr.gather(F, region_of.reflectance, there), mirrored)
            diffuse = turn(mi.Vector3f(normal), dr.sqrt(rng.next_float32()), phi)
            turned = dr.select(
                reflected,
                dr.select(opaque, diffuse, w + 2 * cos_in * normal),
                dr.normalize(eta * w + (eta * cos_in - cos_out) * normal),
            )
            outcome = dr.select(opaque & ~reflected, dr.gather(U, region_of.end, there), outcome)
            # Whoever meets a face from a region that does not touch it has slipped through an edge.
            outcome = dr.select(dr.select(up, below, above) == region, outcome, U(LOST))
            p = mi.Point3f(_off(p, dr.select(reflected, normal, -normal)))
            region = dr.select(reflected, region, there)
        w = mi.Vector3f(dr.select(stuck, turned, w))
        outcome = dr.select(absorbed, U(ABSORBED), outcome)
        if (outcome == 0) & (older >= LONG_LIFE) & ((older ^ age) > age):
            ends = rng.next_float32() < 0.5
            given = dr.select(ends | (copies > 0), given, given + boost * F(fan) * _dimmed(tau))
            boost = dr.select(ends, boost, 2 * boost)
            outcome = dr.select(ends, U(LOST), 0)
        age = older
        if splitting is not None:
            if outcome >= DETECTED:
                worth = boost * _dimmed(tau)
                score += worth
                if rng.next_float32() * score < worth:
                    dr.scatter(splitting.photodiode, outcome - DETECTED, photon)
                    for target, value in zip(path_of, path, strict=True):
                        dr.scatter(target, value, photon)
            over_bed = dr.gather(mi.Bool, region_of.over_bed, region, active)
            near = splitting.within_reach(p, over_bed)
            if near & (fan == 1) & (outcome == 0):
                fan, copies, boost = U(COPIES), U(COPIES - 1), boost / COPIES
                p0, w0, tau0, boost0, region0 = mi.Point3f(p), mi.Vector3f(w), F(tau), F(boost), U(region)
                plate0, epoxy0 = F(path[plate]), F(path[epoxy])
            done = (fan > 1) & ((outcome > 0) | ~near)
            if done & (copies == 0):
                boost, fan = boost * F(fan), U(1)
            if done & (copies > 0):
                p, w, tau, boost, region = mi.Point3f(p0), mi.Vector3f(w0), F(tau0), F(boost0), U(region0)
                path = [*path[:plate], F(plate0), *path[plate + 1 : epoxy], F(epoxy0), *path[epoxy + 1 :]]
                # What absorption leaves a photon knows nothing of how far it came.
                life = tau + lifetime(rng.next_float32())
                copies -= 1
                outcome = U(0)
        if outcome > 0:
            dr.scatter(outcome_of, outcome, photon)
            dr.scatter(weight_of, dr.select(absorbed, 0, boost * _dimmed(tau)), photon)
            dr.scatter(roulette_of, -given, photon)
            if splitting is None:
                for target, value in zip(path_of, path, strict=True):
                    dr.scatter(target, value, photon)
            else:
                dr.scatter(splitting.score, score, photon)
            path = [F(0) for _ in path]
            photon += width
            count -= 1
            rng.state = state_of(lane, photon)
            p, w, life = _launch(rng, emitter)
            tau, boost, given = F(0), F(1), F(0)
            region, age, arrived = U(region_of.epoxy), U(0), U(0)
            fan, score = U(1), F(0)
        active &= count > 0
    return events
