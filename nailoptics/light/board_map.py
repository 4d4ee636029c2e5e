"""The photon map: every photon that arrives at the board's underside, read as any photodiode anywhere would read it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .. import tissue
from ..errors import InputError
from ..geometry import Face, underside
from ..hemodynamics.blood import added_saturation
from ..scene import Scene
from ..scene.parts import check_one_response
from ..scene.rectangles import Rectangle
from ..statistics import stderr_of_mean
from ..variables import Estimate, described
from . import backend as backends, optics
from .identity import light_scene
from .tracing.store import LightStore, led_cache_key, load_or_compute
from .transfer.records import attenuation

if TYPE_CHECKING:
    from .walk.finger import FingerTracer

# What is known of each photon that arrived, beside its number.
PHOTON_COLUMNS = ("place_mm", "weight", "path_mm")
# A photon that never entered the bed has no path there, but for rounding between the zones.
NO_PATH_MM = 1e-5
# Width of the rings of the fluence. [mm]
RING_MM = 0.3


@dataclass(frozen=True)
class Arrivals:
    """Photons of one LED that arrived at the board's underside.

    photons : How many were emitted.
    photon : (n,) int. Which of them; one that the bare board sent back may arrive again.
    place_mm : (n, 2) float. Where, on the flat board (u, v). [mm]
    weight : (n,) float. Weight at arrival of 1 at emission, at the traced absorption, as photodiodes count light that
        comes at its angle.
    path_mm : (n, r) float32. Path in each absorber. [mm]
    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    """

    photons: int
    photon: np.ndarray
    place_mm: np.ndarray
    weight: np.ndarray
    path_mm: np.ndarray
    mu_a: np.ndarray

    def stored(self) -> dict[str, np.ndarray]:
        """The arrivals as arrays of numbers in single precision, in which they were traced."""
        arrays = {"photon": self.photon.astype(np.uint32), "place_mm": self.place_mm.astype(np.float32)}
        return arrays | {"weight": self.weight.astype(np.float32), "path_mm": self.path_mm}

    def reweighted(self, by: np.ndarray) -> "Arrivals":
        """The arrivals with every weight times `by`, (n,) float. [1]"""
        return replace(self, weight=self.weight * by)

    def select(self, which: np.ndarray) -> "Arrivals":
        """Some of the arrivals of these photons, (n,) bool."""
        return replace(self, **{name: getattr(self, name)[which] for name in ("photon", *PHOTON_COLUMNS)})

    @staticmethod
    def joined(batches: "Sequence[Arrivals]") -> "Arrivals":
        """Batches of one LED as one, their photons counted on."""
        first = np.cumsum([0, *(batch.photons for batch in batches)])
        photon = np.concatenate([batch.photon + n for batch, n in zip(batches, first, strict=False)])
        columns = {name: np.concatenate([getattr(batch, name) for batch in batches]) for name in PHOTON_COLUMNS}
        return replace(batches[0], photons=int(first[-1]), photon=photon, **columns)

    def from_outside(self, per_mm2: np.ndarray, mu_a: np.ndarray, *, area_mm2: float, n: float) -> np.ndarray:
        """What each photon that left adds to what its photodiode collects of light from outside, (sources, n) float;
        the sum over the photons that were emitted is all of it.

        By reciprocity: of diffuse irradiance E on the finger, a photodiode of area A in a medium of index n collects
        n^2 A E times the fraction of the light that would leave the finger if the photodiode were a Lambertian LED. A
        sun in one place gives no more, but for the few percent by which steep light enters more easily. Scattering is
        that of the traced wavelength: at shorter ones light scatters more and less of it comes in.

        per_mm2 : (sources, q) float. What an area would collect without a finger, wavelength by wavelength. [mm^-2]
        mu_a : (q, r) float. Absorption at each wavelength. [mm^-1]
        area_mm2 : of the photodiode. n : index around it.
        """
        part = per_mm2 @ attenuation(self.path_mm.astype(float), mu_a - self.mu_a).T
        return n**2 * area_mm2 * self.weight * part / self.photons


class BoardTracer:
    """Traces a finger scene's LEDs onto its board, whatever its photodiodes: the light that all scenes share which
    differ in blood, touch or electronics."""

    # Of a full batch: its photons are not split, and reach any place.
    batch_photons = 1 << 18

    def __init__(
        self,
        scene: Scene,
        *,
        backend: str = "auto",
        stores: Sequence[LightStore] = (),
        seed: int = 0,
        one_by_one: bool = False,
    ) -> None:
        """stores, seed : where light is stored, and the command's seed, with which it is listed there.

        one_by_one : whether every LED shines on a board without the others, with film in their places: places of one
            LED that share a geometry. Their dies lie in the film.
        """
        if scene.finger is None:
            raise InputError("a photon map needs a [finger] scene; a phantom has no board, give it apertures.")
        self.backend = backends.choose_jit(backend, "a photon map")
        # Its light knows no names.
        self.photodiodes = scene.photodiodes
        self.scene, self.stores, self.seed, self.one_by_one = light_scene(scene), stores, seed, one_by_one
        self.mu_a = [optics.absorption(self.scene, led.wavelength_nm)[0] for led in self.scene.leds]

    @cached_property
    def tracer(self) -> "FingerTracer":
        """What walks the photons; it takes a second to make, and is not made where all light is stored."""
        backends.activate(self.backend)
        from .walk.finger import FingerTracer

        # Light arrives on the film between the parts, whatever becomes of it there.
        return FingerTracer(self.scene, with_faces=("kapton",), one_by_one=self.one_by_one)

    def _stored(self, led: int, name: str, trace: Callable[[], dict[str, np.ndarray]], **more: Any) -> Any:
        """Arrays of the store, or new ones.

        name : of what is traced, with its seed and photons. more : what decides its bits beside these and the light.
        """
        key = led_cache_key(self.scene, led, seed=self.seed, backend=self.backend.name, what="board") | more
        key |= {"traced_per_mm": self.mu_a[led].tolist(), "one_by_one": self.one_by_one}
        entries = [store.entry(key) for store in self.stores]
        return load_or_compute(entries, name, lambda: ({}, trace()), lambda _, arrays: arrays)[0]

    def _stored_arrivals(self, led: int, name: str, photons: int, seed: int, trace: Callable[[], Arrivals]) -> Arrivals:
        """Arrivals of the store, or new ones, with the same bits."""
        arrays = self._stored(led, f"{name}{seed}-{photons}", lambda: trace().stored())
        columns = arrays["photon"].astype(np.int64), arrays["place_mm"].astype(float), arrays["weight"].astype(float)
        return Arrivals(photons, *columns, arrays["path_mm"], self.mu_a[led])

    def arrivals(self, led: int, *, photons: int, seed: int) -> Arrivals:
        """Trace some photons of one LED, as photodiodes like the scene's would read them; same seed, same bits."""
        check_one_response(self.photodiodes)

        def trace() -> Arrivals:
            arrived, cos, _ = self._onto_board(led, None, photons, seed)
            return arrived.reweighted(self._accepted(0, cos))

        return self._stored_arrivals(led, "arrivals", photons, seed, trace)

    def leaving(self, photodiode: int, led: int, *, photons: int, seed: int) -> Arrivals:
        """Trace light that leaves into the air from a photodiode that shines as a Lambertian LED of the wavelength of
        one LED, each photon counting as the photodiode counts light of that angle; it has no place (nan).

        By reciprocity a photodiode of area A reads of diffuse light from outside n^2 A times its irradiance times the
        part that leaves.
        """

        def trace() -> Arrivals:
            face = self.tracer.geometry.photodiodes[photodiode]
            left = self._onto_board(led, face, photons, seed)[2]
            if self.scene.layout.photodiodes[photodiode].photodiode.angular_response is None:
                return left
            sent = self._accepted(photodiode, self.tracer.starts(face, photons=photons, seed=seed)[1])
            return left.reweighted(sent[left.photon])

        return self._stored_arrivals(led, f"leaving{photodiode}_", photons, seed, trace)

    def everywhere(self, *, photons: int, seed: int) -> tuple[np.ndarray, Arrivals, Arrivals, Arrivals]:
        """Trace light of the first LED's wavelength, Lambertian, from all over the bare underside.

        Returns: where each photon starts, (photons, 2) float [mm]; light that arrives on the board, as a photodiode
        like the scene's counts it there, and where it starts; and light that leaves into the air, as it counts there.
        """
        check_one_response(self.photodiodes)
        face = underside(self.tracer.geometry)
        starts, sent = self.tracer.starts(face, photons=photons, seed=seed)
        arrived, cos, left = self._onto_board(0, face, photons, seed)
        sent = self._accepted(0, sent)
        back, left = arrived.reweighted(sent[arrived.photon]), left.reweighted(sent[left.photon])
        return starts, arrived.reweighted(self._accepted(0, cos)), back, left

    def _onto_board(
        self, led: int, face: Face | None, photons: int, seed: int
    ) -> tuple[Arrivals, np.ndarray, Arrivals]:
        """Light that arrives, every angle counting alike; the cosines of its angles; and light that leaves."""
        from .walk.sampling import TOP
        from .walk.tallies import BoardTally

        backends.activate(self.backend)
        tally = BoardTally(self.tracer.geometry, photons=photons, paths=self.tracer.paths)
        walked = self.tracer.walk(led, photons=photons, seed=seed, face=face, board=tally, only_arrivals=face is None)
        photon, place, weight, paths, cos = tally.arrays()
        left = np.flatnonzero(walked.outcome == TOP)
        nowhere, mu_a = np.full((len(left), 2), np.nan), self.mu_a[led]
        return (
            Arrivals(photons, photon, place, weight, self.tracer.by_zone(paths), mu_a),
            cos,
            Arrivals(photons, left, nowhere, walked.weight[left], self.tracer.by_zone(walked.path_mm[:, left]), mu_a),
        )

    def _accepted(self, photodiode: int, cos: np.ndarray) -> np.ndarray:
        """What a photodiode makes of light at angles of these cosines, (n,) float."""
        from .walk.sampling import accepted

        return accepted(self.scene.layout.photodiodes[photodiode].photodiode, cos)

    def detected(self, led: int, point: "BloodPoint", *, photons: int, seed: int) -> np.ndarray:
        """What the scene's own photodiodes read: means of a BloodPoint's values, (photodiodes, 2 + K) float."""

        def trace() -> dict[str, np.ndarray]:
            from .walk.interfaces import DETECTED
            from .walk.sampling import acceptance_of

            tracer = self.tracer
            walked = tracer.walk(led, photons=photons, seed=seed, acceptance=acceptance_of(self.scene.photodiodes))
            ended, count = np.flatnonzero(walked.outcome >= DETECTED), len(tracer.photodiodes)
            paths, nowhere = tracer.by_zone(walked.path_mm[:, ended]), np.zeros((len(ended), 2))
            values = point.values(Arrivals(photons, ended, nowhere, walked.weight[ended], paths, self.mu_a[led]))
            by_column = [np.bincount(walked.outcome[ended] - DETECTED, column, minlength=count) for column in values.T]
            return {"means": np.stack(by_column, -1) / photons}

        blood = {name: np.asarray(value).tolist() for name, value in vars(point).items()}
        return np.asarray(self._stored(led, f"detected{seed}-{photons}", trace, blood=blood)["means"])

    def fluence(self, *, photons: int, seed: int) -> xr.DataArray:
        """Fluence rate of the first LED per emitted power, the mean of rings around it, by depth below the nail plate's
        outer face, (radius_mm, depth_mm) float. [mm^-2]"""
        backends.activate(self.backend)
        from .walk.tallies import FluenceTally

        tally = FluenceTally(self.scene, self.tracer.geometry)
        self.tracer.walk(0, photons=photons, seed=seed, section=tally)
        u, v, depth = ((edges[1:] + edges[:-1]) / 2 for edges in tally.edges_mm)
        at = self.scene.layout.leds[0].center_mm
        ring = (np.hypot(u[:, None] - at[0], v - at[1]) / RING_MM).astype(int).ravel()
        fluence = (tally.sums() / (photons * tally.volume_mm3)).reshape(len(ring), len(depth))
        mean = np.stack([np.bincount(ring, column) for column in fluence.T], -1) / np.bincount(ring)[:, None]
        return xr.DataArray(mean, {"radius_mm": RING_MM * (np.arange(len(mean)) + 0.5), "depth_mm": depth})


@dataclass(frozen=True)
class BloodPoint:
    """Absorption over an LED's line in one state, and how it changes with the blood of each zone.

    share : (q,) float. Part of each wavelength in the photocurrent.
    mu_a : (q, r) float. Absorption in this state. [mm^-1]
    slope : (q, K) float. Change of absorption with the blood of each zone. [mm^-1]
    beds : Columns of the bed's zones.
    """

    share: np.ndarray
    mu_a: np.ndarray
    slope: np.ndarray
    beds: tuple[int, ...]

    def values(self, arrivals: Arrivals) -> np.ndarray:
        """What each arrival adds, (n, 2 + K): to the reading, to its part never in the bed, to d reading / d blood."""
        path = arrivals.path_mm.astype(float)
        part = self.share * attenuation(path, self.mu_a - arrivals.mu_a)
        weight = arrivals.weight * part.sum(1)
        per_path = arrivals.weight[:, None] * (part @ self.slope)
        bed = path[:, self.beds]
        direct = np.where(bed.sum(1) <= NO_PATH_MM, weight, 0.0)
        return np.column_stack([weight, direct, -per_path * bed])


def blood_point(scene: Scene, led: int, *, blood_fraction: ArrayLike | None = None) -> BloodPoint:
    """The absorption of a scene's blood state over the line of one of its LEDs.

    blood_fraction : (K,) float in 0-1; at rest if not given.
    """
    optics.check_line(scene, led)
    wavelength, share = optics.detected_spectrum(scene.leds[led], scene.photodiodes[:1])
    blood = scene.blood.rest_blood_fraction if blood_fraction is None else blood_fraction
    so2 = np.broadcast_to(added_saturation(scene.blood, blood), len(optics.bed_columns(scene)))
    return BloodPoint(
        share=share[0],
        mu_a=optics.absorption(scene, wavelength, blood_fraction=blood_fraction),
        slope=tissue.blood_mu_a_per_mm(wavelength[:, None], so2),
        beds=optics.bed_columns(scene),
    )


def readings(
    arrivals: Arrivals, values: np.ndarray, rectangles: Sequence[Rectangle], *, blocks: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Means per emitted photon over each rectangle, in each of so many blocks of photons, (blocks, rectangles, values)
    float, and standard errors of all photons together, (rectangles, values) float.

    values : (n, q) float, such as those of a BloodPoint.
    """
    (u, v), total, square, block = arrivals.place_mm.T, [], [], arrivals.photon % blocks
    for r in rectangles:
        inside = np.flatnonzero(r.holds(u, v))
        # A photon that arrives twice is one photon: its first arrival would have ended it there.
        inside = inside[np.unique(arrivals.photon[inside], return_index=True)[1]]
        columns = values[inside].T
        total.append([np.bincount(block[inside], column, minlength=blocks) for column in columns])
        square.append((columns**2).sum(1))
    sums, photons = np.array(total), [len(range(k, arrivals.photons, blocks)) for k in range(blocks)]
    return (sums / photons).transpose(2, 0, 1), stderr_of_mean(sums.sum(2), np.array(square), arrivals.photons)


class PhotonMap:
    """Sums of arrivals on cells of the board, in blocks of photons: rectangles are read in milliseconds.

    Blocks are independent samples of equal size, for standard errors. Between cells' edges sums are interpolated.
    """

    def __init__(self, outline: Rectangle, *, values: int, spacing_mm: float = 0.1, blocks: int = 32) -> None:
        self.outline, self.blocks = outline, blocks
        self.shape = tuple(max(1, round(size / spacing_mm)) for size in outline.size_mm)
        self.u_mm = np.linspace(outline.u_min, outline.u_max, self.shape[0] + 1)
        self.v_mm = np.linspace(outline.v_min, outline.v_max, self.shape[1] + 1)
        self.sums = np.zeros((values, blocks, *self.shape))
        self.photons = 0

    def add(self, arrivals: Arrivals, values: np.ndarray) -> None:
        """Add arrivals; values (n, q) float is what each of them counts."""
        cell = []
        for place, edges, count in zip(arrivals.place_mm.T, (self.u_mm, self.v_mm), self.shape, strict=True):
            index = np.floor((place - edges[0]) * (count / (edges[-1] - edges[0])))
            cell.append(np.clip(index, 0, count - 1).astype(np.int64))
        flat = ((arrivals.photon % self.blocks) * self.shape[0] + cell[0]) * self.shape[1] + cell[1]
        for total, column in zip(self.sums, values.T, strict=True):
            total += np.bincount(flat, column, minlength=total.size).reshape(total.shape)
        self.photons += arrivals.photons

    def over(self, rectangles: Sequence[Rectangle] | np.ndarray) -> np.ndarray:
        """Means per emitted photon over rectangles in each block, (blocks, rectangles, values) float.

        rectangles : or (m, 4) float, u_min, u_max, v_min, v_max. [mm]
        """
        if not isinstance(rectangles, np.ndarray):
            strips = [r.strips() for r in rectangles]
            edges = [(s.u_min, s.u_max, s.v_min, s.v_max) for patch_strips in strips for s in patch_strips]
            per_strip = self.over(np.array(edges).reshape(-1, 4))
            return np.add.reduceat(per_strip, np.cumsum([0, *map(len, strips[:-1])]), axis=1) if strips else per_strip
        # Places on a grid share their columns of cells.
        columns, column = np.unique(rectangles[:, :2], axis=0, return_inverse=True)
        lines, along = self._share(columns, self.u_mm) @ self.sums, self._share(rectangles[:, 2:], self.v_mm)
        means = np.empty((self.blocks, len(rectangles), len(self.sums)))
        for i in range(len(columns)):
            mine = column.ravel() == i
            means[:, mine] = (lines[:, :, i] @ along[mine].T).transpose(1, 2, 0)
        return means * (self.blocks / self.photons)

    @staticmethod
    def _share(ends_mm: np.ndarray, edges_mm: np.ndarray) -> np.ndarray:
        """How much of each cell between edges lies between each pair of ends (m, 2), (m, cells) float. [1]"""
        cells = np.arange(len(edges_mm) - 1)
        low, high = (ends_mm - edges_mm[0]).T[:, :, None] * (len(cells) / (edges_mm[-1] - edges_mm[0]))
        return np.clip(high - cells, 0, 1) - np.clip(low - cells, 0, 1)

    def per_mm2(self) -> tuple[np.ndarray, np.ndarray]:
        """Means per emitted photon and area, and their standard errors over blocks, (values, u, v) float. [mm^-2]"""
        area = (self.u_mm[1] - self.u_mm[0]) * (self.v_mm[1] - self.v_mm[0])
        blocks = self.sums * (self.blocks / self.photons / area)
        return blocks.mean(1), blocks.std(1, ddof=1) / np.sqrt(self.blocks)


def map_dataset(leds: Sequence[str], maps: Sequence[PhotonMap]) -> xr.Dataset:
    """Maps of several LEDs on one board as a Dataset over led, zone, u and v."""
    mean, stderr = (np.stack(both) for both in zip(*(light_map.per_mm2() for light_map in maps), strict=True))
    columns: dict[str, Any] = {"irradiance": 0, "direct": 1, "sensitivity": np.s_[2:]}
    maps_mm2 = {name: Estimate(mean[:, column], stderr[:, column]) for name, column in columns.items()}
    u, v = ((edges[1:] + edges[:-1]) / 2 for edges in (maps[0].u_mm, maps[0].v_mm))
    data = described(__package__, **maps_mm2, u=u, v=v)
    return xr.Dataset(data, {"led": list(leds), "blood_zone": np.arange(mean.shape[1] - 2)})
