"""The best layout at close range: a fresh trace of its own board, where each photodiode looks, what other places of the
LED would read, and what light from outside does."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from ...light.board_map import Arrivals, BloodPoint, BoardTracer, PhotonMap, blood_point, readings
from ...scene import Photodiode, Scene
from ...scene.layout import Layout
from ...statistics import stderr_of_mean
from ..ambient import SOURCES, photocurrents_a
from ..comparison.fits import Z95
from . import boards
from . import fisher as merit
from .photon_maps import View, jackknife, left_out

LEAST_BATCHES = 8
# Photons from each photodiode in one round of traces the other way, and how many batches of the fresh trace go with it.
BACK_PHOTONS = 1 << 16
BATCHES_PER_ROUND = 2
LED_SPACING_MM = 0.4
BLOCKS = 16
COVERS = ("covered", "uncovered")

Variables = dict[str, Any]


@dataclass(frozen=True)
class _Bench:
    """One layout on one finger with what traces and reads it."""

    scene: Scene
    view: View
    layout: Layout
    photodiode: Photodiode
    tracer: BoardTracer
    points: tuple[BloodPoint, ...]
    seed: int

    @property
    def areas_mm2(self) -> np.ndarray:
        """Areas of the photodiodes. [mm^2]"""
        return np.array([e.area.area_mm2 for e in self.layout.photodiodes])

    def state(self, *keys: int) -> int:
        """An independent seed for each use."""
        return int(np.random.SeedSequence(self.seed, spawn_key=keys).generate_state(1, np.uint64)[0])

    def read(self, led: int, values: np.ndarray, ambient_a: Any = 0.0) -> merit.Volts:
        """Volts of what the photodiodes get of one LED, (..., photodiodes, 4) float."""
        amplifier = self.scene.electronics
        return merit.volts(values, self.scene.leds[led], self.photodiode, amplifier, self.view.at, ambient_a=ambient_a)

    def resolution_n(self, values: Sequence[np.ndarray], ambient_a: Any = 0.0) -> np.ndarray:
        """Force resolution from all LEDs' values. [N]"""
        told = [merit.information(self.read(i, v, ambient_a)).sum(-2) for i, v in enumerate(values)]
        return merit.resolution_n(np.sum(told, axis=0), self.view.at)


def look(best: Scene, view: View, *, photons: int, seed: int, backend: str, deadline: float) -> xr.Dataset:
    """Everything about a layout on one finger that the map of its bare board does not tell.

    photons : from each LED in the fresh trace, unless the deadline comes first; some are traced in any case.
    """
    scene = boards.on_finger(best, view.case)
    layout, tracer = scene.layout, BoardTracer(scene, backend=backend)
    points = tuple(
        blood_point(scene, led, blood_fraction=view.at.blood_fraction, dermis=view.case.dermis)
        for led in range(len(scene.leds))
    )
    bench = _Bench(scene, view, layout, layout.photodiodes[0].photodiode, tracer, points, seed)
    batches = max(LEAST_BATCHES, photons // tracer.batch_photons)
    half = time.perf_counter() + (deadline - time.perf_counter()) / 2
    values, found = _forward(bench, batches, half)
    open_board = scene.model_copy(update={"board": scene.board.model_copy(update={"cover_um": 0.0})})
    bare = BoardTracer(open_board, backend=backend, spacing_mm=0.2)
    found |= _back(bench, bare, [each[0] for each in values], max(1, batches // BATCHES_PER_ROUND), deadline)
    resolution = bench.resolution_n(values)
    return xr.Dataset(
        found,
        coords={"led": [led.name for led in scene.leds], "best_photodiode": list(layout.photodiode_names)},
        attrs={
            "checked_resolution_n": float(resolution[0]),
            "checked_resolution_n_stderr": float(resolution[0] * jackknife(np.log(resolution))),
        },
    )


def _with_error(name: str, dims: tuple[str, ...], value: Any, error: Any, units: str, text: str) -> Variables:
    about = {"units": units, "long_name": text, "ancillary_variables": f"{name}_stderr"}
    return {
        name: (dims, np.asarray(value), about),
        f"{name}_stderr": (dims, np.asarray(error), {"units": units, "long_name": f"standard error: {text}"}),
    }


def _axis(name: str, edges: np.ndarray, text: str) -> Variables:
    return {name: (name, (edges[1:] + edges[:-1]) / 2, {"units": "mm", "long_name": text})}


def _forward(bench: _Bench, batches: int, deadline: float) -> tuple[list[np.ndarray], Variables]:
    """Values of each LED, (1 + batches, photodiodes, 4) float, by all batches and without each; and what to keep."""
    cells, count = bench.tracer.cells(), 0
    blocks: list[list[np.ndarray]] = [[] for _ in bench.points]
    depth, square = (np.zeros((len(bench.points), len(bench.areas_mm2), *cells.shape)) for _ in range(2))
    while count < LEAST_BATCHES or (count < batches and time.perf_counter() < deadline):
        for i, point in enumerate(bench.points):
            means, seen = bench.tracer.detected(
                i, point, photons=bench.tracer.batch_photons, seed=bench.state(2, i, count), cells=cells
            )
            assert seen is not None
            blocks[i].append(means)
            depth[i] += seen
            square[i] += seen**2
        count += 1
    values = [left_out(np.stack(each)) for each in blocks]
    pair, cell = ("led", "best_photodiode"), ("under_u", "under_v", "depth")
    text = "part of an LED's light on each photodiode, by a fresh trace of the best layout"
    found = _with_error(
        "checked_fraction",
        pair,
        np.stack([v[0, :, 0] for v in values]),
        np.stack([jackknife(v[..., 0]) for v in values]),
        "1",
        text,
    )
    text = "fall of a photodiode's reading by absorption at a place under the nail, per volume there"
    error = stderr_of_mean(depth, square, count).astype(np.float32)
    found |= _with_error("depth_sensitivity", (*pair, *cell), (depth / count).astype(np.float32), error, "mm-2", text)
    found |= _axis("under_u", cells.u_mm, "across the nail, as on the board")
    found |= _axis("under_v", cells.v_mm, "along the nail, towards the tip")
    found |= _axis("depth", cells.depth_mm, "below the nail plate's outer face")
    text = "volume of a cell under the nail at its depth"
    return values, found | {"cell_volume_mm3": ("depth", cells.volume_mm3[0, 0], {"units": "mm3", "long_name": text})}


def _back(bench: _Bench, bare: BoardTracer, values: list[np.ndarray], rounds: int, deadline: float) -> Variables:
    """Light from each photodiode: what an LED at each place would bring it, and what comes from outside."""
    count, leds = len(bench.areas_mm2), len(bench.points)
    maps = [
        [PhotonMap(bench.layout.outline, values=4, spacing_mm=LED_SPACING_MM, blocks=BLOCKS) for _ in range(count)]
        for _ in range(leds)
    ]
    on_die, outside = np.zeros((2, leds, count)), np.zeros((2, len(COVERS), len(SOURCES), count))
    for j in range(count):
        # So much light comes through an open board that one round tells it.
        _, left = bare.back(j, 0, photons=BACK_PHOTONS, seed=bench.state(4, j))
        outside[:, 1, :, j] = _outside(bench, left, j)
    done = 0
    while done == 0 or (done < rounds and time.perf_counter() < deadline):
        for j in range(count):
            for i, point in enumerate(bench.points):
                arrived, left = bench.tracer.back(j, i, photons=BACK_PHOTONS, seed=bench.state(3, i, j, done))
                seen = point.values(arrived)
                maps[i][j].add(arrived, seen)
                mean, error = readings(arrived, seen[:, :1], [bench.layout.leds[i]])
                on_die[:, i, j] += mean[0, 0], error[0, 0] ** 2
                if i == 0:
                    outside[:, 0, :, j] += _outside(bench, left, j)
        done += 1
    for one in (on_die, outside[:, 0]):
        one[0] /= done
        one[1] = np.sqrt(one[1]) / done
    found = _ambient(bench, values, *outside)
    # Where an LED shines otherwise than a photodiode sees, the way back is another.
    if all(led.pattern == "lambertian" for led in bench.scene.leds):
        found |= _led_places(bench, maps, *on_die)
    return found


def _outside(bench: _Bench, left: Arrivals, photodiode: int) -> np.ndarray:
    """Photocurrent by light from outside and its variance, (2, sources) float. [A], [A^2]"""
    sums = []
    for source in SOURCES:
        each = photocurrents_a(
            left,
            bench.scene,
            source,
            traced_nm=bench.scene.leds[0].wavelength_nm,
            quantum_efficiency=bench.photodiode.quantum_efficiency,
            area_mm2=float(bench.areas_mm2[photodiode]),
        )
        # Most photons did not leave: each of them counts 0.
        sums.append((each.sum(), (each**2).sum() - each.sum() ** 2 / left.photons))
    return np.array(sums).T


def _ambient(bench: _Bench, values: list[np.ndarray], current: np.ndarray, error: np.ndarray) -> Variables:
    """What light from outside adds to each photodiode, and what it leaves of the force resolution."""
    dims = ("cover", "ambient", "best_photodiode")
    found = _with_error("ambient_a", dims, current, error, "A", "photocurrent by light from outside, from all sides")
    at_most = current + Z95 * error
    read = [bench.read(i, each, at_most) for i, each in enumerate(values)]
    limit = f"{bench.scene.electronics.adc_range_v:g} V"
    text = f"largest output with light from outside at its bound; the converter ends at {limit}"
    found["ambient_volts"] = (dims, np.max([r.volts for r in read], axis=0), {"units": "V", "long_name": text})
    noise = np.max([np.sqrt(r.noise_v2) for r in read], axis=0)
    text = "noise of one sample with light from outside at its bound, rms"
    found["ambient_noise_v"] = (dims, noise, {"units": "V", "long_name": text})
    tells = bench.resolution_n(values, at_most)
    text = "force resolution of the best layout with light from outside at its bound: its noise and saturation"
    found["ambient_resolution_n"] = (dims[:2], tells, {"units": "N", "long_name": text})
    names: Variables = {"cover": list(COVERS), "ambient": [source.name for source in SOURCES]}
    return found | {name: (name, column) for name, column in names.items()}


def _led_places(bench: _Bench, maps: list[list[PhotonMap]], mean: np.ndarray, error: np.ndarray) -> Variables:
    """What each photodiode would read of an LED at each place of the board, and the force that this resolves."""
    area, dies = bench.areas_mm2, np.array([r.area_mm2 for r in bench.layout.leds])[:, None]
    pair, places = ("led", "best_photodiode"), ("led_u", "led_v")
    text = "part of an LED's light on each photodiode, by light from the photodiode to the LED"
    found = _with_error("reciprocal_fraction", pair, mean * area / dies, error * area / dies, "1", text)
    fraction, tells = [], []
    for i, by_photodiode in enumerate(maps):
        each = np.stack([a * one.blocks_per_mm2() for a, one in zip(area, by_photodiode, strict=True)])
        # From (photodiodes, values, blocks, u, v) to (blocks, u, v, photodiodes, values).
        each = left_out(np.moveaxis(each, (2, 0, 1), (0, -2, -1)))
        fraction.append(np.moveaxis(each[..., 0], -1, 1))
        tells.append(merit.resolution_n(merit.information(bench.read(i, each)).sum(-2), bench.view.at))
    text = "part of the light of an LED at this place on each photodiode, by reciprocity"
    errors = np.stack([jackknife(f) for f in fraction])
    found |= _with_error("led_place_fraction", (*pair, *places), np.stack([f[0] for f in fraction]), errors, "1", text)
    text = "force resolution with this LED alone at this place and the photodiodes where they are"
    errors = np.stack([t[0] * jackknife(np.log(t)) for t in tells])
    value = np.stack([t[0] for t in tells])
    found |= _with_error("led_place_resolution_n", ("led", *places), value, errors, "N", text)
    one = maps[0][0]
    return found | _axis("led_u", one.u_mm, "place of the LED") | _axis("led_v", one.v_mm, "place of the LED")
