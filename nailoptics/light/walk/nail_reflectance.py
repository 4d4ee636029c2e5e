"""What places on a bare nail and the skin around it send back, by light that walks from the eye: reciprocity.

Where light from all the sky falls on a finger, the part of it that a place sends into the eye is the part of a ray from
the eye to that place that comes back anywhere: every photon counts (Helmholtz; CIE 15, geometries d:0 and 0:d).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ... import geometry as finger_geometry
from ...geometry import Geometry
from ...scene import Board, Led, Light, Scene, digest
from ...statistics import seed_of
from .. import optics
from ..identity import light_scene
from ..tracing.store import LightStore, cache_key, load_or_compute
from . import finger as finger_walk
from .finger import FingerTracer, FingerWalk
from .interfaces import Interfaces, Regions, ZoneEdges, table_of_rows
from .sampling import TOP, PhotonEnds, PhotonQueue

# Photons walked at once.
BATCH = 1 << 18
# Rays start so far above the highest place of the finger. [mm]
ABOVE_MM = 0.5
# So much finger is there behind the nail: with less, skin there would lose red light through the end. [mm]
BEHIND_MM = 10.0
# What is recorded of a ray that came back.
RECORDED = ("patch", "group", "weight", "path_mm", "cosine", "gloss")


@dataclass(frozen=True)
class Patch:
    """A rectangle of the finger, seen from above, and how many rays go to it for each that goes to others.

    center_mm, size_mm : across and along the nail, from its centre, towards the tip positive. [mm]
    port_mm : diameter of a spectrophotometer's port around the centre, on the pulp, seen from below: only light counts
        that leaves through it. None where light from all sides is seen from above. [mm]
    """

    center_mm: tuple[float, float]
    size_mm: tuple[float, float]
    share: int = 1
    port_mm: float | None = None


@dataclass(frozen=True)
class ReflectedLight:
    """The rays of one wavelength that came back, and where absorption has dimmed them.

    rays : (patches,) int. Rays that went to each patch.
    patch : (n,) int. Which patch each ray that came back had gone to.
    group : (n,) int in 0 to `GROUPS` - 1. To which group of independent rays it belongs.
    weight : (n,) float. What it counts for, of 1.
    path_mm : (n, r) float16. Its path in each absorber, rounded by less than 5e-4 of it. [mm]
    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    cosine : (n,) float32. Of the angle between the vertical and the way in which it left.
    gloss : (n,) bool. Whether it never entered the finger.
    """

    rays: np.ndarray
    patch: np.ndarray
    group: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    mu_a: np.ndarray
    cosine: np.ndarray
    gloss: np.ndarray

    def with_more(self, other: "ReflectedLight") -> "ReflectedLight":
        """These rays and others of the same wavelength, patches and absorption as one."""
        joined = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in RECORDED}
        return replace(self, rays=self.rays + other.rays, **joined)

    def select(self, patches: list[int]) -> "ReflectedLight":
        """The rays to some patches alone, which are numbered as they are given."""
        there, number = np.nonzero(self.patch[:, None] == np.array(patches))
        chosen: dict[str, Any] = {name: getattr(self, name)[there] for name in RECORDED} | {"patch": number}
        return replace(self, rays=self.rays[patches], **chosen)


@dataclass
class NailReflectance:
    """The finger of a scene without its board, and rays into it; neither is made before it is needed.

    backend : what walks the rays. stores : where rays may be stored; new ones go to the first.
    """

    scene: Scene
    backend: str = "auto"
    stores: Sequence[LightStore] = ()

    def __post_init__(self) -> None:
        self.scene, self.zones = as_seen(self.scene), optics.zones(self.scene)

    @cached_property
    def finger(self) -> tuple[Geometry, Interfaces]:
        """The finger's shape, and what the rays meet."""
        return finger_walk.built(finger_geometry.shaping(self.scene), str(mi.variant()), False)

    def reflect(
        self, wavelength_nm: float, patches: Sequence[Patch], *, mu_a: np.ndarray, photons: int, seed: int, groups: int
    ) -> ReflectedLight:
        """Rays of one wavelength to the patches: those that are stored, or new ones.

        mu_a : (r,) float. Absorption to trace; what has a quarter of it or less has no finite error. [mm^-1]
        photons : Rays in all; rounded up, so that each patch has its share in every group.
        """
        rows = [[*patch.center_mm, *patch.size_mm, patch.share, patch.port_mm] for patch in patches]
        parameters = {"patches": rows, "mu_a": mu_a.tolist()}
        # Neither blood nor melanin, board nor lamp decides the ways of rays into a bare nail.
        bare = {"leds": (Led(name="eye", wavelength_nm=550.0),), "photodiodes": (), "board": Board()}
        light = digest(light_scene(self.scene).model_copy(update=bare))
        key = cache_key("colour", light, wavelength_nm, seed=seed, backend=self.backend) | parameters
        entries = [store.entry(key) for store in self.stores]

        def make() -> tuple[dict[str, Any], dict[str, np.ndarray]]:
            table = np.repeat(np.arange(len(patches)), [patch.share for patch in patches])
            cycle = len(table) * groups
            geometry, absorbers = self.finger[0], [absorber.region for absorber in optics.absorbing(self.scene)]
            traced = dict(zip(absorbers, mu_a, strict=True))
            of_regions = np.array([traced.get(name, 0.0) for name in geometry.regions])
            media = replace(optics.finger_media(self.scene, geometry.regions, wavelength_nm), mu_a=of_regions)
            regions = Regions(geometry, media)
            beam = _Beam(patches, table, geometry.bounds_mm[:, 2] + [-ABOVE_MM, ABOVE_MM], regions.air)
            batch, total = max(BATCH // cycle, 1) * cycle, -(-photons // cycle) * cycle
            counts = (min(batch, total - start) for start in range(0, total, batch))
            parts = [self._batch(regions, beam, n, seed_of(seed, k)) for k, n in enumerate(counts)]
            index, weight, path, cosine = (np.concatenate(column) for column in zip(*parts, strict=True))
            return {}, {
                "rays": np.bincount(table, minlength=len(patches)) * (total // len(table)),
                "patch": table[index % len(table)].astype(np.uint16),
                "group": (index // len(table) % groups).astype(np.uint8),
                "weight": weight.astype(np.float32),
                "path_mm": path,
                "mu_a": mu_a,
                "cosine": cosine,
                "gloss": np.asarray(path.max(1) == 0),
            }

        return load_or_compute(entries, f"{groups}-{photons}", make, lambda _, arrays: ReflectedLight(**arrays))[0]

    def _batch(self, regions: Regions, beam: "_Beam", count: int, seed: int) -> tuple[np.ndarray, ...]:
        """Index, weight, paths and cosine of the rays that came back."""
        ends = _Ends(count, paths=len(optics.TISSUES) + len(self.zones.edges_mm), media=len(regions.absorbing))
        walk = FingerWalk(self.finger[1], regions, ZoneEdges(self.zones), beam, ends)
        walked = ends.evaluated(walk.run(PhotonQueue(count, seed)))
        place_mm, ray = np.stack([np.array(x) for x in ends.place], -1), np.arange(count) % len(beam.radius_mm)
        outside = np.linalg.norm(place_mm - beam.center_mm[ray], axis=1) > beam.radius_mm[ray]
        back = np.flatnonzero((walked.outcome == TOP) & ~outside)
        path = FingerTracer.by_zone(walked.path_mm[:, back]).astype(np.float16)
        return back, walked.weight[back], path, walked.cosine[back]


class _Ends(PhotonEnds):
    """With where each photon ended, across and along the nail. [mm]"""

    def __init__(self, photons: int, **sizes: int) -> None:
        super().__init__(photons, **sizes)
        self.place = [dr.zeros(mi.Float, photons) for _ in range(2)]

    def record_path(self, photon: Any, *more: Any) -> None:
        super().record_path(photon, *more)
        for target, value in zip(self.place, (photon.p.x, photon.p.y), strict=True):
            dr.scatter(target, value, photon.index)


class _Beam:
    """Parallel rays onto patches, stratified to each in its turn: from above, or through a port from below."""

    def __init__(self, patches: Sequence[Patch], table: np.ndarray, heights_mm: np.ndarray, air: Any) -> None:
        """heights_mm : below and above the finger. [mm]"""
        center = np.array([patch.center_mm for patch in patches])[table]
        size, port = np.array([p.size_mm for p in patches])[table], np.array([p.port_mm or np.nan for p in patches])
        self.center_mm, self.radius_mm = center, port[table] / 2
        self.rectangle = table_of_rows(np.hstack([center - size / 2, size]))
        self.height = mi.Float(np.where(np.isnan(self.radius_mm), heights_mm[1], heights_mm[0]).astype(np.float32))
        self.count, self.region = dr.opaque(mi.UInt32, len(table)), air

    def emit(self, rng: Any, index: Any) -> tuple[Any, Any, Any]:
        """Place and direction of a new photon, whichever of the batch it is, and the cosine of its angle."""
        box = dr.gather(mi.Vector4f, self.rectangle, index % self.count)
        z = dr.gather(mi.Float, self.height, index % self.count)
        x, y = dr.fma(rng.next_float32(), box.z, box.x), dr.fma(rng.next_float32(), box.w, box.y)
        return mi.Point3f(x, y, z), mi.Vector3f(0, 0, -dr.sign(z)), mi.Float(1)


def as_seen(scene: Scene) -> Scene:
    """A finger scene with what an eye sees: all of its skin, and enough of it behind the nail."""
    # Skin is seen through its epidermis, whatever an infrared reading may leave out.
    light = Light(index_steps=scene.light.index_steps)
    finger = scene.fingertip
    length_mm = max(finger.length_mm, finger.nail_length_mm + BEHIND_MM)
    return scene.model_copy(update={"light": light, "finger": finger.model_copy(update={"length_mm": length_mm})})
