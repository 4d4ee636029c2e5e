"""A photon in a finger, and what it meets there as arrays that its walk reads: emitter, interfaces, regions, zones.

What it meets are plain classes, because Dr.Jit's loops carry the fields of a dataclass along as each photon's own.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ...geometry import DistanceGrid, Face, Geometry
from ...geometry.distance import NORMAL_STEPS, PLANE_REACH_MM, PLANE_STEP_MM
from ...tissue import BloodZones
from .. import optics
from . import sampling
from .sampling import Photon, clip, maximum, minimum, rotate_direction, safe_sqrt, starts

# Through these light comes back from the bed to the photodiodes.
OVER_BED = ("plate", "epoxy")
# The number of a triangle's region below and that above share the 24 bits that a float32 holds exactly.
REGION_BITS = 11
# Distances take a signed byte: so many steps are the largest distance.
MOST_STEPS = 127
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
    copies : (levels) list. How many it stands for, walked one after the other, where it has been split; else 1.
    copies_left : (levels) list. Of these still to be walked after the present one.
    """

    p: Any
    region: Any
    arrivals: Any = starts(0)
    copies: list[Any]
    copies_left: list[Any]

    def is_unsplit(self, level: int) -> Any:
        """Whether it is not split from a level on."""
        unsplit = mi.Bool(True)
        for copies in self.copies[level:]:
            unsplit &= copies == 1
        return unsplit

    def has_no_copies_left(self) -> Any:
        """Whether no copy of it is still to be walked."""
        last = mi.Bool(True)
        for left in self.copies_left:
            last &= left == 0
        return last

    def statistical_weight(self) -> Any:
        """How many copies of its weight it was split into."""
        number = mi.Float(1)
        for copies in self.copies:
            number = number * mi.Float(copies)
        return number


class Medium(NamedTuple):
    """Optics of the region where a photon is.

    mean_path_mm : Between two scatterings, where the medium `scatters`. [mm]
    mu_a : [mm^-1]
    """

    scatters: Any
    mean_path_mm: Any
    g: Any
    mu_a: Any
    in_bed: Any

    def free_path(self, rng: Any) -> Any:
        """A random path to the next scattering. [mm]"""
        return dr.select(self.scatters, -self.mean_path_mm * dr.log(1 - rng.next_float32()), sampling.FAR)


class Regions:
    """Optics of each region of a geometry, and what becomes of a photon that enters it."""

    def __init__(self, geometry: Geometry, media: optics.Media) -> None:
        names = geometry.regions
        self.mu_a, self.mu_s, self.g, self.n = (mi.Float(a) for a in (media.mu_a, media.mu_s, media.g, media.n))
        self.opaque, self.reflectance = mi.Bool(media.opaque), mi.Float(media.reflectance)
        detectors = {face.region: DETECTED + i for i, face in enumerate(geometry.photodiodes)}
        ends = [detectors.get(i, sampling.OPAQUE + i) for i in range(len(names))]
        ends[names.index("cut")] = sampling.BOTTOM
        self.end = mi.UInt32(ends)
        dies, there = {face.region for face in geometry.leds}, {*geometry.below.tolist(), *geometry.above.tolist()}
        # What absorbs light as it passes, of which a tally is kept, and what swallows it, by outcome;
        # dies and photodiodes count together.
        absorbs = [i in there and not media.opaque[i] and media.mu_a[i] > 0 for i in range(len(names))]
        self.absorbing = tuple(name for name, absorbed in zip(names, absorbs, strict=True) if absorbed)
        self.tally = mi.UInt32(np.where(absorbs, np.cumsum(absorbs) - 1, len(names)))
        self.swallows = {
            end: "photodiodes" if i in detectors else "leds" if i in dies else names[i]
            for i, end in enumerate(ends)
            if media.opaque[i] and i in there and end != sampling.BOTTOM
        }
        parts = {face.region for face in (*geometry.leds, *geometry.photodiodes)}
        self.on_board = mi.Bool([name in ("kapton", "silicon") or i in parts for i, name in enumerate(names)])
        self.over_bed = mi.Bool([name in OVER_BED for name in names])
        no_tissue = len(optics.TISSUES)
        self.tissue = mi.UInt32([optics.TISSUES.index(n) if n in optics.TISSUES else no_tissue for n in names])
        self.bed, self.epoxy, self.air = (dr.opaque(mi.UInt32, names.index(name)) for name in ("bed", "epoxy", "air"))

    def medium(self, region: Any, active: Any) -> Medium:
        """Optics of one region for each photon."""
        mu_s = dr.gather(mi.Float, self.mu_s, region, active)
        return Medium(
            scatters=mu_s > 0,
            mean_path_mm=dr.rcp(mu_s),
            g=dr.gather(mi.Float, self.g, region, active),
            mu_a=dr.gather(mi.Float, self.mu_a, region, active),
            in_bed=region == self.bed,
        )


class Interfaces:
    """All faces between regions: which one a ray meets, what lies on its sides, and how far the nearest one is."""

    def __init__(self, geometry: Geometry, distances: DistanceGrid) -> None:
        mesh = mi.Mesh("interfaces", len(geometry.vertices), len(geometry.triangles))
        params = mi.traverse(mesh)
        params["vertex_positions"] = mi.Float(geometry.vertices.astype(np.float32).ravel())
        params["faces"] = mi.UInt32(geometry.triangles.astype(np.uint32).ravel())
        params.update()
        self.scene = mi.load_dict({"type": "scene", "interfaces": mesh}, optimize=False)
        # Per triangle: normal (3) and, packed into the bits of the fourth number, the regions below and above.
        a, b, c = (geometry.vertices[geometry.triangles[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        pair = geometry.below + (geometry.above << REGION_BITS)
        self.triangles = table_of_rows(np.column_stack([normal, pair]).astype(np.float32))
        # Per cell, in the bytes of one number: offset to its plane, normal, slack; or distance, 0.
        steps = np.minimum(distances.distance_mm / PLANE_STEP_MM, MOST_STEPS).astype(np.int8)
        steps = np.where(distances.slack_steps > 0, distances.offset_steps, steps)
        columns = [distances.slack_steps, distances.normal_steps[..., 1], distances.normal_steps[..., 0], steps]
        packed = np.stack([column.astype(np.uint8).T.ravel() for column in columns], -1).view("<u4").ravel()
        self.cells = mi.UInt32(packed.astype(np.uint32))
        self.count = [dr.opaque(mi.UInt32, int(n)) for n in distances.distance_mm.shape]
        self.origin = [dr.opaque(mi.Float, float(x)) for x in distances.origin_mm]
        self.spacing = dr.opaque(mi.Float, float(distances.spacing_mm))

    def free(self, p: Any, active: Any) -> Any:
        """A distance at p within which no interface lies; 0 where nothing is known. [mm]"""
        cell, off = [], []
        inside = mi.Bool(active)
        for value, low, n in zip(p, self.origin, self.count, strict=True):
            place = (value - low) * dr.rcp(self.spacing)
            index = mi.Int32(dr.floor(place))
            inside &= (index >= 0) & (mi.UInt32(index) < n)
            cell.append(mi.UInt32(index))
            off.append((place - mi.Float(index) - 0.5) * self.spacing)
        at = cell[0] + self.count[0] * (cell[1] + self.count[1] * cell[2])
        word = dr.gather(mi.UInt32, self.cells, at, inside)
        slack, steps = mi.Float(mi.Int32(word & 255)), mi.Float(mi.Int32(word) >> 24)
        # Shifted up and down again, a byte has its sign.
        x, y = (mi.Float((mi.Int32(word) << bits) >> 24) * (1 / NORMAL_STEPS) for bits in (8, 16))
        normal = mi.Vector3f(x, y, safe_sqrt(1 - x * x - y * y))
        from_center = mi.Vector3f(off)
        plane = dr.abs(dr.fma(PLANE_STEP_MM, steps, dr.dot(normal, from_center))) - slack * PLANE_STEP_MM
        center = steps * PLANE_STEP_MM - dr.norm(from_center)
        return maximum(dr.select(slack > 0, minimum(plane, PLANE_REACH_MM), center), 0)

    def sides(self, triangle: Any) -> tuple[Any, Any, Any]:
        """A triangle's normal, the region below it, and the one above, to which the normal points."""
        row = dr.gather(mi.Vector4f, self.triangles, triangle)
        pair = mi.UInt32(row.w)
        return mi.Vector3f(row.x, row.y, row.z), pair & ((1 << REGION_BITS) - 1), pair >> REGION_BITS


class Emitter:
    """The facets of a die or of a photodiode that shines into a region, and its `emission_table`."""

    def __init__(self, face: Face, emission: np.ndarray, region: Any) -> None:
        self.region = region
        quads = np.asarray(face.quads)
        share = face.areas_mm2
        self.cumulative_share = mi.Float(np.cumsum(share) / share.sum())
        self.corners = mi.Float(quads.astype(np.float32).ravel())
        self.normal = mi.Float(np.asarray(face.normal, np.float32).ravel())
        self.emission = mi.Float(emission)

    def emit(self, rng: Any, index: Any) -> tuple[Any, Any, Any]:
        """Place and direction of a new photon, whichever of the batch, and the cosine of its angle to the face."""
        pick, facet = rng.next_float32(), mi.UInt32(0)
        for i in range(dr.width(self.cumulative_share) - 1):
            facet += dr.select(pick >= dr.gather(mi.Float, self.cumulative_share, i), mi.UInt32(1), mi.UInt32(0))
        a, b, c, d = (dr.gather(mi.Point3f, self.corners, 4 * facet + i) for i in range(4))
        u, v = rng.next_float32(), rng.next_float32()
        normal = dr.gather(mi.Vector3f, self.normal, facet)
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
    """A table (n, 4) of floats whose rows kernels read with `dr.gather(mi.Vector4f, ...)`.

    A list is copied. NumPy's memory would be used where it lies, and by its alignment bring one of two kernels.
    """
    return mi.Float(table.ravel().tolist())
