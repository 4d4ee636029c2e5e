"""One trace for many scenes: what decides the light, and traces that grow batch by batch."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from ..scene import Accuracy, Scene, digest
from . import backend as backends
from . import optics
from .course import course
from .engines import DetectedLight
from .moments import RestState
from .records import Batch, LedTrace, joined, of_batch
from .reweight import transmission
from .tracing import UNSEEN_PHOTONS, _largest_error, _seeds, unseen
from .transfer import Transfer, rest_state, versions

# Errors are looked at after so many batches, each time a quarter more: seldom enough that stopping hardly favours luck.
# The numbers are fixed, so that a trace that is continued stops where one that was never interrupted stops.
_GROWTH = 1.25
# What a killed process can lose of a long trace. [s]
SAVE_EVERY_S = 20.0


def reference(scene: Scene) -> Scene:
    """The scene with the same light paths and everything else at its default; equal for all that can share a trace.

    Blood, saturation and melanin only dim the light; touch, electronics, flux and line width come after it; and the
    fingers and boards of a search for a layout are not those of its scene.
    """
    none: dict[str, Any] = {}
    blood = type(scene.blood)(zone_edges_mm=scene.blood.zone_edges_mm, zone_width_mm=scene.blood.zone_width_mm)
    leds = tuple(
        led.model_copy(update={"name": f"led{i}", "part": None, "flux_mw": 1.0, "fwhm_nm": 0.0})
        for i, led in enumerate(scene.leds)
    )
    photodiodes = tuple(
        p.model_copy(
            update={"name": f"photodiode{i}", "array": None}
            | {n: type(p).model_fields[n].default for n in ("quantum_efficiency", "dark_current_na", "shunt_mohm")}
        )
        for i, p in enumerate(scene.photodiodes)
    )
    update = {
        "blood": blood,
        "touch": type(scene.touch)(**none),
        "electronics": type(scene.electronics)(**none),
        "accuracy": Accuracy(),
        "light": scene.light.model_copy(update={"engine": "auto"}),
        "leds": leds,
        "photodiodes": photodiodes,
        "placement": None,
    }
    if scene.finger is not None:
        melanin = type(scene.finger).model_fields["melanin_fraction"].default
        update["finger"] = scene.finger.model_copy(update={"digit": "index", "melanin_fraction": melanin})
    if scene.phantom is not None:
        layers = tuple(layer.model_copy(update={"name": f"layer{i}"}) for i, layer in enumerate(scene.phantom.layers))
        update["phantom"] = scene.phantom.model_copy(update={"layers": layers})
    return scene.model_copy(update=update)


def light_digest(scene: Scene) -> str:
    """Digest of what decides where light goes, (64) hexadecimal characters; scenes with the same one share a trace."""
    return digest(reference(scene))


def is_look(batches: int) -> bool:
    """Whether errors are looked at after so many batches."""
    look = 1
    while look < batches:
        look = max(look + 1, math.floor(look * _GROWTH))
    return look == batches


@dataclass(frozen=True)
class LedBatches:
    """The traced batches of one LED, each kept apart, so that a scene can be read from those that it needs alone.

    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    pieces : batch by its number and its photons; both, with the seed, determine its bits.
    """

    mu_a: np.ndarray
    pieces: Mapping[tuple[int, int], Batch]

    def trace(self, sizes: Sequence[int], *, seed: int, led: int, rest: RestState) -> LedTrace:
        """The batches of these sizes as one trace, exact at rest however many records it keeps."""
        seeds = _first_seeds(seed, led, len(sizes))
        pieces = (self.pieces[piece] for piece in enumerate(sizes))
        return joined([of_batch(piece, self.mu_a, s, rest) for piece, s in zip(pieces, seeds, strict=True)])


def _first_seeds(seed: int, led: int, count: int) -> tuple[int, ...]:
    return tuple(islice(_seeds(seed, led), count))


class Need:
    """How many batches of one LED a scene asks for, followed as the batches come."""

    def __init__(self, scene: Scene, led: int, asked: Accuracy, mu_a: np.ndarray) -> None:
        self.scene, self.led, self.asked = scene, led, asked
        self.seconds = asked.max_seconds / len(scene.leds) if asked.max_seconds else math.inf
        count = len(photodiode_names(scene))
        self.rest, self.traced = rest_state(scene, led, count), mu_a
        self.weight, self.square, self.photons = np.zeros(count), np.zeros(count), 0
        self.errors: list[float] = []
        # Why no number of photons will do: a photodiode has seen none of very many.
        self.dark = ""

    def add(self, batch: Batch) -> None:
        """Take in the next full batch."""
        weight = batch.weight * transmission(batch.path_mm, self.rest.mu_a - self.traced, self.rest.share)
        self.weight += np.bincount(batch.photodiode, weight, minlength=len(self.weight))
        self.square += np.bincount(batch.photodiode, weight**2, minlength=len(self.weight))
        self.photons += batch.photons
        self.errors.append(_largest_error(self.weight, self.square, self.photons))
        endless = self.asked.photons is None and math.isinf(self.seconds)
        if endless and not self.dark and self.photons >= UNSEEN_PHOTONS and not self.weight.all():
            photodiode = photodiode_names(self.scene)[int(np.argmin(self.weight))]
            self.dark = unseen(self.scene.leds[self.led].name, photodiode, self.photons)

    def sizes(self, full: int) -> list[int] | None:
        """Sizes of the batches that meet the need; None while that is not known.

        full : photons of a full batch.
        """
        if self.asked.photons is not None:
            whole, rest = divmod(self.asked.photons, full)
            return [full] * whole + ([rest] if rest else [])
        for i, error in enumerate(self.errors):
            if self.asked.relative_error is not None and error <= self.asked.relative_error and is_look(i + 1):
                return [full] * (i + 1)
        return None

    def wants(self, number: int, full: int) -> bool:
        """Whether the full batch of this number is needed."""
        sizes = self.sizes(full)
        return (sizes is None and not self.dark) or (sizes or [])[number : number + 1] == [full]

    def settled(self, traced: LedBatches, full: int) -> tuple[list[int], bool]:
        """Sizes of the batches to read, and whether they meet the need; as many as there are if they do not."""
        sizes = self.sizes(full)
        if sizes is not None and all(piece in traced.pieces for piece in enumerate(sizes)):
            return sizes, True
        timed = self.asked.photons is None and self.asked.relative_error is None
        return [full] * len(self.errors), timed


def photodiode_names(scene: Scene) -> tuple[str, ...]:
    """Names of the photodiodes in the order in which a trace counts them."""
    if scene.phantom is not None:
        return tuple(p.name for p in scene.photodiodes)
    return scene.layout.photodiode_names


def tracer(scene: Scene, backend: str) -> Any:
    """The class of the photons engine for a scene, with its backend active."""
    chosen = backends.choose(backend)
    if not chosen.jit:
        raise InputError(f"the photons engine needs a JIT backend, and {chosen.name} is none: {chosen.advice}")
    backends.activate(chosen)
    if scene.phantom is not None:
        from .layered_walk import LayeredTracer

        return LayeredTracer
    from .finger_walk import FingerTracer

    return FingerTracer


def grow(
    engine: Callable[[], Any],
    led: int,
    have: LedBatches | None,
    needs: Sequence[Need],
    *,
    seed: int,
    full: int,
    stop: Callable[[], bool],
    save: Callable[[LedBatches], None],
) -> LedBatches:
    """Trace what is missing of one LED until every need is met or out of time, or `stop` says so.

    engine : makes the engine; called only if something has to be traced.
    needs : of all scenes that will be read; they must not have taken in any batch yet.
    save : called every now and then, and at the end, if there is anything new.
    """
    pieces = dict(have.pieces) if have else {}
    mu_a = have.mu_a if have else engine().mu_a(led)
    begin = saved = time.perf_counter()
    unsaved = False

    def traced(number: int, size: int) -> Batch:
        nonlocal saved, unsaved
        if (number, size) not in pieces:
            seeds = _first_seeds(seed, led, number + 1)
            pieces[number, size] = engine().batch(led, photons=size, seed=seeds[number])
            unsaved = True
            if time.perf_counter() - saved > SAVE_EVERY_S:
                save(LedBatches(mu_a, dict(pieces)))
                saved, unsaved = time.perf_counter(), False
        return pieces[number, size]

    number = 0
    while waiting := [need for need in needs if need.wants(number, full)]:
        late = number > 0 and time.perf_counter() - begin > max(need.seconds for need in waiting)
        if (number, full) not in pieces and (late or stop()):
            break
        batch = traced(number, full)
        for need in needs:
            need.add(batch)
        number += 1
    else:
        for sizes in [need.sizes(full) for need in needs]:
            if sizes and sizes[-1] != full and not stop():
                traced(len(sizes) - 1, sizes[-1])
    result = LedBatches(mu_a, pieces)
    if unsaved:
        save(result)
    return result


def transfer_of(scene: Scene, traces: Sequence[LedTrace], *, backend: str) -> Transfer:
    """Light that was traced for many scenes as the Transfer of one of them; its time is nobody's share."""
    return Transfer(
        scene=scene,
        photodiodes=photodiode_names(scene),
        absorbers=optics.absorbers(scene),
        traces=tuple(traces),
        engine="photons",
        backend=backend,
        versions=versions(),
        cpu_seconds=0.0,
        wall_seconds=0.0,
        events=0,
    )


def light_of(transfer: Transfer) -> DetectedLight:
    """A Transfer as the light of a finger scene, without the map of its section."""
    rest = transfer.at()
    worst = float((rest.detected_fraction_stderr / rest.detected_fraction).max())
    return DetectedLight(
        over=lambda states: course(transfer, states, electrons=True),
        absorbers=transfer.absorbers,
        mean_path=rest.mean_path_mm.values,
        mean_path_stderr=rest.mean_path_mm_stderr.values,
        section=xr.Dataset(),
        attributes=transfer.attributes()
        | {"accuracy_reached": f"relative standard error of every reading at rest at most {worst:.2g}"},
    )


def set_threads(count: int) -> None:
    """Let Dr.Jit use so many threads in this process."""
    import drjit as dr

    if dr.thread_count() != count:
        dr.set_thread_count(count)
