"""Traces a scene: batches of each LED until its stopping criterion is met, from what is already stored."""

import os
import time
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from ...errors import NotReachedError
from ...options import Requested, TraceOptions
from ...scene import Accuracy, Scene, SceneIn, as_scene
from ...statistics import seed_of
from .. import backend as backends, optics
from ..identity import light_scene
from ..transfer import Transfer, photodiode_names
from ..transfer.records import COLUMNS, FINGER_BATCH_PHOTONS, PHANTOM_BATCH_PHOTONS, SUMS, LedTrace, read_escaping
from .stopping import Ending, LedStoppingCriterion, ProgressCallback, run_until, share_of_time
from .store import LightStore, led_cache_key, load_or_compute

DEFAULT_PHOTONS = 1_000_000


def trace(
    scene: SceneIn,
    *,
    with_faces: Collection[str] = (),
    traced: Scene | None = None,
    stores: Sequence[LightStore] | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Transfer:
    """Trace the light of every LED once; the result can be read at any blood state.

    with_faces : parts whose faces are there even where the scene leaves them out. So photons that never meet them go
        the same way, number by number, as in a scene that has them, which walks on other faces would not.
    traced : a phantom that absorbs less and is else the same: it is traced, and read as the scene; where in the
        phantom light is absorbed is then not known.
    stores : where batches are looked for and, in the first, stored; that of the user if not given.
    requested : fields of `TraceOptions`; a million photons where neither they nor the scene say how far.
    progress : called after every batch.

    Raises: InputError; NotReachedError with `.result`, the Transfer as far as it got, when the tolerance was not met
    within max_seconds or the trace was interrupted.
    """
    scene = as_scene(scene)
    begin, options = time.process_time(), TraceOptions(**requested)
    chosen = backends.choose_jit(options.backend, "the photons engine")
    required = accuracy(scene, options)
    escaping = traced is not None
    engine = LightEngine(traced or scene, chosen, with_faces=with_faces, escaping=escaping)
    stores = LightStore.of_command(options) if stores is None else stores
    start, cpu = time.perf_counter(), time.process_time()
    traces, reused, complaint, interrupted = [], 0, None, False
    for led in range(len(scene.leds)):
        source = LedSource(scene, led, engine, stores, seed=options.seed)
        seconds = share_of_time(required.max_seconds, start + engine.wall_seconds, len(scene.leds) - led)
        criterion = LedStoppingCriterion(scene, led, required, full=engine.full, seconds=seconds)
        ending = take_batches(source, criterion, progress)
        complaint = complaint or criterion.unmet_reason(ending)
        if ending is Ending.INTERRUPTED:
            # What is there is of use only with something from every LED: one batch each, then the end.
            interrupted, required = True, Accuracy(photons=min(engine.full, required.photons or engine.full))
        reused += source.reused
        traces.append(criterion.trace())
    result = Transfer(
        scene,
        tuple(traces),
        chosen.name,
        cpu_seconds=time.process_time() - cpu - engine.cpu_seconds,
        wall_seconds=time.perf_counter() - start - engine.wall_seconds,
        events=sum(trace.events for trace in traces),
        setup_seconds=cpu - begin + engine.cpu_seconds,
        reused_photons=reused,
    )
    if complaint:
        raise NotReachedError(complaint, result=result, interrupted=interrupted)
    return result


class LightEngine:
    """The engine of a scene's light, opened when the first photon is to be walked; scenes of one light share it.

    Until then Mitsuba is not even imported: light that is stored needs none.

    with_faces : as for `trace`. escaping : whether all light that leaves a phantom is recorded.
    full : photons of a full batch. cpu_seconds, wall_seconds : what opening it took. [s]
    """

    def __init__(
        self, scene: Scene, backend: backends.Backend, *, with_faces: Collection[str] = (), escaping: bool = False
    ) -> None:
        self.scene, self.backend, self.escaping = light_scene(scene), backend, escaping
        more = {"escaping": escaping, "with_faces": sorted({*with_faces} & {*scene.light.left_out})}
        self.more: dict[str, Any] = {name: value for name, value in more.items() if value}
        small = scene.phantom is None and backend.name == "llvm"
        self.full = FINGER_BATCH_PHOTONS if small else PHANTOM_BATCH_PHOTONS
        self.cpu_seconds = self.wall_seconds = 0.0
        self._opened: Any = None

    def __call__(self) -> Any:
        """The engine itself."""
        if self._opened is None:
            begin, cpu = time.perf_counter(), time.process_time()
            backends.activate(self.backend)
            if self.scene.phantom is not None:
                from ..walk.layered import LayeredTracer

                self._opened = LayeredTracer(self.scene, **self.more)
            else:
                from ..walk.finger import FingerTracer

                self._opened = FingerTracer(self.scene, **self.more)
            self.wall_seconds, self.cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu
        return self._opened


class LedSource:
    """The batches of one LED by number and photons: those that are stored, and new ones, which go to the first store.

    mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]
    reused : photons that were taken from a store.
    """

    def __init__(
        self, scene: Scene, led: int, engine: LightEngine, stores: Sequence[LightStore] = (), *, seed: int
    ) -> None:
        self.scene, self.led, self.engine, self.seed, self.reused = scene, led, engine, seed, 0
        self.mu_a = optics.absorption(engine.scene, scene.leds[led].wavelength_nm)[0]
        key = led_cache_key(engine.scene, led, seed=seed, backend=engine.backend.name) | engine.more if stores else {}
        self.stored = [store.entry(key) for store in stores]

    def has(self, number: int, photons: int) -> bool:
        """Whether a batch is stored."""
        return any(os.path.exists(light.path(f"{number}-{photons}")) for light in self.stored)

    def batch(self, number: int, photons: int) -> LedTrace:
        """The batch of a number and its photons; both, with the light and the seed, determine its bits."""
        seed, count = seed_of(self.seed, self.led, number), len(photodiode_names(self.scene))
        ends = 2 if self.engine.escaping else 0

        def make() -> tuple[dict[str, Any], dict[str, np.ndarray]]:
            batch = self.engine().batch(self.led, photons=photons, seed=seed)
            about = {"events": batch.events} | {name: getattr(batch, name) for name in SUMS}
            return about, {column: getattr(batch, column) for column in COLUMNS}

        def build(about: dict[str, Any], arrays: dict[str, np.ndarray]) -> LedTrace:
            columns = {column: arrays[column] for column in COLUMNS} | LedTrace.stored_sums(about)
            batch = LedTrace(photons=photons, mu_a=self.mu_a, seeds=(seed,), events=int(about["events"]), **columns)
            batch.check(photodiodes=count + ends, absorbers=len(self.mu_a))
            return batch

        batch, stored = load_or_compute(self.stored, f"{number}-{photons}", make, build)
        self.reused += photons * stored
        if ends:
            read_mu_a = optics.absorption(self.scene, self.scene.leds[self.led].wavelength_nm)[0]
            return read_escaping(batch, count, read_mu_a - self.mu_a)
        # The light does not know the names of a phantom's layers.
        called, named = (one.phantom.layers if one.phantom else () for one in (self.engine.scene, self.scene))
        names = {layer.name: known.name for layer, known in zip(called, named, strict=True)}
        return replace(batch, absorbed={names.get(place, place): sums for place, sums in batch.absorbed.items()})


def accuracy(scene: Scene, options: TraceOptions) -> Accuracy:
    """What to reach: as requested, else as the scene says, else a million photons."""
    given = {name: getattr(options, name) for name in Accuracy.model_fields}
    given = {name: value for name, value in given.items() if value is not None}
    # Requesting photons alone sets the scene's tolerance aside; a time limit alone keeps it.
    if not {"photons", "relative_error"} & given.keys():
        given = scene.accuracy.model_dump(exclude_none=True) | given
    return Accuracy(**(given or {"photons": DEFAULT_PHOTONS}))


def take_batches(source: LedSource, stop: LedStoppingCriterion, progress: ProgressCallback | None = None) -> Ending:
    """Take batches of one LED, stored and new ones, until its stopping criterion is met or time is over.

    What is stored is taken even when time is over; opening the engine does not count.
    """
    begin = time.perf_counter() - source.engine.wall_seconds

    def seconds() -> float:
        return time.perf_counter() - source.engine.wall_seconds - begin

    def is_late(batch: tuple[int, int]) -> bool:
        return not source.has(*batch) and batch[0] > 0 and seconds() >= stop.seconds

    def sample(numbered: tuple[int, int]) -> None:
        stop.add(source.batch(*numbered))

    def report() -> None:
        if progress:
            progress(stop.progress(seconds()))

    needed = enumerate(iter(stop.next_batch, 0))
    return run_until(needed, sample, is_late=is_late, report=report)
