"""A photon in a finger, and what it meets there as arrays that its walk reads: emitter, interfaces, regions, zones.

What it meets are plain classes, because Dr.Jit's loops carry the fields of a dataclass along as each photon's own.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import DistanceGrid, Face, Geometry
from ...geometry.distance import CAP_MM, OFF_FACE_MM, SHELLS
from ...tissue import BloodZones
from .. import optics
from . import sampling
from .sampling import Photon, clip, maximum, minimum, rotate_direction, starts

# The number of a triangle's region below and that above share the 24 bits that a float32 holds exactly.
REGION_BITS = 11
# Kinds of regions, bit by bit; through what is over the bed light comes back to the photodiodes.
OVER_BED, IN_TISSUE, ON_BOARD = 1, 2, 4
# Scatterings without a ray before lanes wait for each other; more leave lanes idle, fewer cast rays for few lanes.
FREE_EVENTS = 3
# Light of an LED that arrives on the board was seldom so far below the nail's ridge: with roulette there, and at each
# doubling of that, it takes 0.86 of the time to trace, and its variance is the same within 4 %.
DEEP_MM = 3.0
# Distances take two bytes.
DISTANCE_STEP_MM = CAP_MM / 0xFFFF
# Outcomes from here on name the photodiode that a photon reached; below, the opaque region.
DETECTED = sampling.OPAQUE + (1 << REGION_BITS)
# Of a coordinate and of 1 mm; about sixteen times what float32 resolves, enough for a few roundings.
SURFACE_OFFSET = 2e-6


@dataclass(kw_only=True)
class FingerPhoton(Photon):
    """A photon in a finger.

    p : Place. [mm]
    region : Index of the region it is in.
    arrivals : How often it has come to the board.
    strides : How often it has been split in two on its way to the photodiodes, and is not yet whole again.
    pending : Of these, a bit for each whose second copy is still to be walked.
    near_copies : Copies still to be walked of those into which it was split within reach of a photodiode, itself
        included; 0 where it is not split there.
    side : Where it is on a face of a shell that it has just met, 1 outside of it and -1 inside; else 0.
    free_events : How often it may scatter before it is asked whether it is to be split.
    roulette_z : Height below which roulette ends it with probability 1/2, where only arrivals count. [mm]
    """

    p: Any
    region: Any
    arrivals: Any = starts(0)
    strides: Any = starts(0)
    pending: Any = starts(0)
    near_copies: Any = starts(0)
    side: Any = starts(0.0)
    free_events: Any = starts(FREE_EVENTS)
    roulette_z: Any = starts(-DEEP_MM)

    def has_no_copies_left(self) -> Any:
        """Whether no copy of it is still to be walked."""
        return (self.pending == 0) & (self.near_copies <= 1)


class Medium(NamedTuple):
    """Optics of the region where a photon is.

    mean_path_mm : Between two scatterings, where the medium `scatters`. [mm]
    mu_a : [mm^-1]
    tissue : Index of the tissue, `optics.TISSUES`.
    tally : Where its absorption is tallied, if `tallied`.
    """

    scatters: Any
    mean_path_mm: Any
    g: Any
    mu_a: Any
    n: Any
    tissue: Any
    tally: Any
    tallied: Any

    def free_path(self, rng: Any) -> Any:
        """A random path to the next scattering. [mm]"""
        return dr.select(self.scatters, -self.mean_path_mm * dr.log(1 - rng.next_float32()), sampling.FAR)


class Regions:
    """Optics of each region of a geometry, and what becomes of a photon that enters it."""

    def __init__(self, geometry: Geometry, media: optics.Media) -> None:
        names = geometry.regions
        # Rows, mu in 1/mm; those of `ends` hold reflectance (-1 if not opaque), outcome, tissue and place of the tally.
        self.optics = table_of_rows(np.column_stack([media.mu_s, media.g, media.mu_a, media.n]))
        detectors = {face.region: DETECTED + i for i, face in enumerate(geometry.photodiodes)}
        ends = [detectors.get(i, sampling.OPAQUE + i) for i in range(len(names))]
        ends[names.index("cut")] = sampling.BOTTOM
        dies, there = {face.region for face in geometry.leds}, {*geometry.below.tolist(), *geometry.above.tolist()}
        # What absorbs light as it passes, of which a tally is kept, and what swallows it, by outcome;
        # dies and photodiodes count together.
        absorbs = [i in there and not media.opaque[i] and media.mu_a[i] > 0 for i in range(len(names))]
        self.absorbing = tuple(name for name, absorbed in zip(names, absorbs, strict=True) if absorbed)
        tally = np.where(absorbs, np.cumsum(absorbs) - 1, -1)
        self.swallows = {
            end: "photodiodes" if i in detectors else "leds" if i in dies else names[i]
            for i, end in enumerate(ends)
            if media.opaque[i] and i in there and end != sampling.BOTTOM
        }
        over_bed, on_board = (np.isin(names, kind) for kind in (("plate", "epoxy"), ("kapton", "silicon")))
        on_board[[face.region for face in (*geometry.leds, *geometry.photodiodes)]] = True
        self.kinds = mi.UInt32(OVER_BED * over_bed | IN_TISSUE * (media.mu_s > 0) | ON_BOARD * on_board)
        tissue = [optics.TISSUES.index(n) if n in optics.TISSUES else len(optics.TISSUES) for n in names]
        reflectance = np.where(media.opaque, media.reflectance, -1)
        self.ends = table_of_rows(np.column_stack([reflectance, ends, tissue, tally]))
        self.epoxy, self.air = (dr.opaque(mi.UInt32, names.index(name)) for name in ("epoxy", "air"))

    def medium(self, region: Any, active: Any) -> Medium:
        """Optics of one region for each photon."""
        mu_s, g, mu_a, n = dr.gather(mi.Vector4f, self.optics, region, active)
        *_, tissue, tally = dr.gather(mi.Vector4f, self.ends, region, active)
        return Medium(mu_s > 0, dr.rcp(mu_s), g, mu_a, n, mi.UInt32(tissue), mi.UInt32(tally), tally >= 0)

    def is_a(self, kind: int, region: Any, active: Any = True) -> Any:
        """Whether regions are of a kind."""
        return (dr.gather(mi.UInt32, self.kinds, region, active) & kind) > 0

    def opaque(self, region: Any) -> tuple[Any, Any, Any]:
        """Whether a region is opaque, what it then reflects, and how light ends that it does not reflect."""
        reflectance, end, *_ = dr.gather(mi.Vector4f, self.ends, region)
        return reflectance >= 0, reflectance, mi.UInt32(end)


@dataclass
class Clearance:
    """What is known at a place of the nearest interfaces that are no shells around the nail's axis.

    below, above : None lies nearer that reaches below the plate's outer face, or above it. [mm]
    height : Over the nail plate's outer face. [mm]
    """

    below: Any
    above: Any
    height: Any


class Interfaces:
    """All faces between regions: which one a ray meets, what lies on its sides, and how far the nearest one is."""

    def __init__(self, geometry: Geometry, distances: DistanceGrid) -> None:
        mesh = mi.Mesh("interfaces", len(geometry.vertices), len(geometry.triangles))
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(geometry.vertices.astype(np.float32).ravel())
        params["faces"] = mi.UInt32(geometry.triangles.astype(np.uint32).ravel())
        params.update()
        self.scene = mi.load_dict({"type": "scene", "interfaces": mesh}, optimize=False)
        # Per triangle: normal (3) and, packed into the bits of the fourth number, the regions below and above, and
        # whether it is part of a shell.
        normal = geometry.normals(geometry.triangles)
        parts = geometry.below | geometry.above << REGION_BITS | distances.in_shell.astype(int) << 2 * REGION_BITS
        self.triangles = table_of_rows(np.column_stack([normal, parts]).astype(np.float32))
        # Per cell, in the halves of one number, both in DISTANCE_STEP_MM.
        below, above = (np.floor(d.T.ravel() / DISTANCE_STEP_MM).astype(np.uint32) for d in distances.distance_mm)
        self.cells = mi.UInt32(below << 16 | above)
        shells = np.full((SHELLS, 2), sampling.FAR)
        shells[: len(distances.shells_mm)] = distances.shells_mm
        self.shells = [[dr.opaque(mi.Float, float(x)) for x in shell] for shell in shells]
        self.outer = dr.opaque(mi.Float, float(min(distances.outer_mm, sampling.FAR)))
        self.radius = dr.opaque(mi.Float, float(geometry.nail_radius_mm))
        # A chord lies so much lower than its ends, times the square of its length.
        least_mm = geometry.nail_radius_mm + min(0.0, *shells[:, 0])
        self.sagitta = dr.opaque(mi.Float, float(1 / (7.5 * least_mm)))
        self.count = [dr.opaque(mi.UInt32, int(n)) for n in distances.distance_mm.shape[1:]]
        self.origin = [dr.opaque(mi.Float, float(x)) for x in distances.origin_mm]
        self.spacing = dr.opaque(mi.Float, float(distances.spacing_mm))

    def layer(self, height: Any, side: Any) -> tuple[Any, Any]:
        """Between which heights a place lies that is in no shell, with no shell between; or light that leaves the one
        that it has just met, at a `side` of it. [mm]

        A shell is convex: what leaves a face of it outwards meets none of its faces, and what leaves it inwards none
        before it has been below all of them.
        """
        low, high = mi.Float(-sampling.FAR), mi.Float(sampling.FAR)
        for bottom, top in self.shells:
            on = (side != 0) & (height > bottom - OFF_FACE_MM) & (height < top + OFF_FACE_MM)
            over = dr.select(on, side > 0, bottom < height)
            low = dr.select(over, maximum(low, top), low)
            high = dr.select(over, high, minimum(high, bottom))
        return low, high

    def clearance(self, p: Any, active: Any) -> Clearance:
        """What is known at p of the nearest interfaces."""
        cell, off = [], []
        inside = mi.Bool(active)
        for value, low, n in zip(p, self.origin, self.count, strict=True):
            place = (value - low) * dr.rcp(self.spacing)
            index = mi.Int32(dr.floor(place))
            inside &= (index >= 0) & (mi.UInt32(index) < n)
            cell.append(mi.UInt32(index))
            off.append((place - mi.Float(index) - 0.5) * self.spacing)
        at = cell[0] + self.count[0] * (cell[1] + self.count[1] * cell[2])
        word, away = dr.gather(mi.UInt32, self.cells, at, inside), dr.norm(mi.Vector3f(off))
        below, above = mi.Float(word >> 16) * DISTANCE_STEP_MM, mi.Float(word & 0xFFFF) * DISTANCE_STEP_MM
        z = p.z + self.radius
        height = dr.sqrt(dr.fma(p.x, p.x, z * z)) - self.radius
        return Clearance(maximum(below - away, 0), maximum(above - away, 0), height)

    def is_free(self, step: Any, here: Clearance, there: Clearance, layer: tuple[Any, Any]) -> Any:
        """Whether no interface lies on a step between two places, the first of them in a layer between shells."""
        low, high = layer
        # Of all else only what reaches into the layer can lie there.
        clear = dr.select(high <= self.outer, here.below + there.below, here.above + there.above)
        low = dr.fma(self.sagitta, step * step, low)
        inside = (minimum(here.height, there.height) > low) & (maximum(here.height, there.height) < high)
        return inside & (step < clear)

    def sides(self, triangle: Any) -> tuple[Any, Any, Any, Any]:
        """A triangle's normal, the region below it, the one above, to which the normal points, and whether it is part
        of a shell."""
        row, most = dr.gather(mi.Vector4f, self.triangles, triangle), (1 << REGION_BITS) - 1
        parts = mi.UInt32(row.w)
        shell = parts >> 2 * REGION_BITS > 0
        return mi.Vector3f(row.x, row.y, row.z), parts & most, parts >> REGION_BITS & most, shell


class Emitter:
    """The facets of a die or of a photodiode that shines into a region, and its `emission_table`."""

    def __init__(self, face: Face, emission: np.ndarray, region: Any) -> None:
        self.region = region
        share = face.areas_mm2
        self.cumulative_share = mi.Float(np.cumsum(share) / share.sum())
        self.corners = table_of_rows(np.pad(np.reshape(face.quads, (-1, 3)), [(0, 0), (0, 1)]))
        self.normal = table_of_rows(np.pad(np.reshape(face.normal, (-1, 3)), [(0, 0), (0, 1)]))
        self.emission = mi.Float(emission)

    def emit(self, rng: Any, index: Any) -> tuple[Any, Any, Any]:
        """Place and direction of a new photon, whichever of the batch, and the cosine of its angle to the face."""
        pick, facet = rng.next_float32(), mi.UInt32(0)
        for i in range(dr.width(self.cumulative_share) - 1):
            facet += dr.select(pick >= dr.gather(mi.Float, self.cumulative_share, i), mi.UInt32(1), mi.UInt32(0))
        a, b, c, d = (mi.Point3f(*dr.gather(mi.Vector4f, self.corners, 4 * facet + i)[:3]) for i in range(4))
        u, v = rng.next_float32(), rng.next_float32()
        normal = mi.Vector3f(*dr.gather(mi.Vector4f, self.normal, facet)[:3])
        p = dr.lerp(dr.lerp(a, b, u), dr.lerp(d, c, u), v)
        cos = sampling.emission_cosine(self.emission, rng.next_float32())
        w = rotate_direction(normal, cos, 2 * dr.pi * rng.next_float32())
        return mi.Point3f(off_surface(p, normal)), mi.Vector3f(w), cos


class ZoneEdges:
    """The edges between the bed's blood zones, each a smooth step along the nail (`tissue.BloodZones`)."""

    def __init__(self, zones: BloodZones) -> None:
        self.edges = [dr.opaque(mi.Float, edge) for edge in zones.edges_mm]
        self.width = dr.opaque(mi.Float, zones.width_mm)

    def beyond(self, y: Any, path: Any) -> list[Any]:
        """The part of a path, of its middle at y, that counts as beyond each edge. [mm]"""
        steps = [clip((y - edge) / self.width + 0.5, 0, 1) for edge in self.edges]
        return [path * t * t * (3 - 2 * t) for t in steps]


def off_surface(p: Any, normal: Any) -> Any:
    """A point moved off a face by a little more than float32 resolves there."""
    return p + normal * (SURFACE_OFFSET * (1 + maximum(maximum(dr.abs(p.x), dr.abs(p.y)), dr.abs(p.z))))


def table_of_rows(table: np.ndarray) -> Any:
    """A table (n, 4) of floats whose rows kernels read, each at once, with `dr.gather(mi.Vector4f, ...)`.

    A list is copied. NumPy's memory would be used where it lies, and by its alignment bring one of two kernels.
    """
    return mi.Float(table.ravel().tolist())
