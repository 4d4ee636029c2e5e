"""Traces a scene: batches of each LED until its trigger is met, from what is already stored."""

import time
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, Unpack

from pydantic import ValidationError

from ... import checks
from ...errors import InputError, NotReachedError
from ...options import Requested, TraceOptions
from ...scene import Accuracy, Scene
from .. import backend as backends
from .. import optics
from ..identity import light_scene
from ..transfer import Transfer, photodiode_names
from ..transfer.records import FINGER_BATCH_PHOTONS, PHANTOM_BATCH_PHOTONS, Batch, LedBatches, LedRecords
from .driver import Ending, ProgressCallback, run_until
from .store import LedSource, LightStore, made_of
from .trigger import LedTrigger, share_of_time

DEFAULT_PHOTONS = 1_000_000
PHOTONS_ENGINE = "the photons engine"


def trace(
    scene: Scene,
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
    begin, options = time.process_time(), TraceOptions(**requested)
    chosen = backends.choose_jit(options.backend, PHOTONS_ENGINE)
    required = accuracy(scene, options)
    engine = LightEngine(traced or scene, chosen, with_faces=with_faces, escaping=traced is not None)
    if stores is None:
        stores = [own] if options.store and (own := LightStore.of_user()) else []
    sources = led_sources(scene, engine, stores, seed=options.seed, backend=chosen.name)
    start, cpu = time.perf_counter(), time.process_time()
    traces, events, complaint, interrupted = [], 0, None, False
    for led, source in enumerate(sources):
        trigger = LedTrigger(scene, led, required, source.mu_a, full=engine.full)
        trigger.seconds = share_of_time(required.max_seconds, start + engine.wall_seconds, len(scene.leds) - led)
        records = LedRecords(source.mu_a, trigger.rest, seed=options.seed, led=led)
        ending = take_batches(source, [trigger], records.add, progress=progress, opening=lambda: engine.wall_seconds)
        reason = trigger.unmet_reason()
        if ending is Ending.INTERRUPTED:
            interrupted = True
            reason = (
                f'interrupted: LED "{trigger.name}" has {trigger.photons} photons, relative error {trigger.error:.3g}.'
            )
            # What is there is of use only with something from every LED: one batch each, then the end.
            required = Accuracy(photons=engine.full)
        complaint = complaint or reason
        events += records.events
        traces.append(records.trace())
    for store in stores:
        store.close()
    result = Transfer(
        scene,
        tuple(traces),
        chosen.name,
        cpu_seconds=time.process_time() - cpu - engine.cpu_seconds,
        wall_seconds=time.perf_counter() - start - engine.wall_seconds,
        events=events,
        setup_seconds=cpu - begin + engine.cpu_seconds,
        reused_photons=sum(source.reused for source in sources),
    )
    if complaint:
        raise NotReachedError(complaint, result=result, interrupted=interrupted)
    return result


def photons_engine(scene: Scene, backend: str) -> Any:
    """The class of the photons engine for a scene, whose backend is active from then on.

    Raises: InputError where the backend compiles no kernels.
    """
    backends.activate_jit(backend, PHOTONS_ENGINE)
    if scene.phantom is not None:
        from ..walk.layered import LayeredTracer

        return LayeredTracer
    from ..walk.finger import FingerTracer

    return FingerTracer


def batch_photons(scene: Scene) -> int:
    """Photons of a full batch of a scene's light."""
    return FINGER_BATCH_PHOTONS if scene.phantom is None else PHANTOM_BATCH_PHOTONS


class LightEngine:
    """The engine of a scene's light, opened when the first photon is to be walked; scenes of one light share it.

    Until then Mitsuba is not even imported: light that is stored needs none.

    with_faces : the parts that it has although the scene leaves them out.
    escaping : whether all light that leaves a phantom is recorded.
    full : photons of a full batch.
    cpu_seconds, wall_seconds : what opening it took. [s]
    """

    def __init__(
        self, scene: Scene, backend: backends.Backend, *, with_faces: Collection[str] = (), escaping: bool = False
    ) -> None:
        self.scene, self.backend = light_scene(scene), backend
        self.more: dict[str, Any] = {}
        if faces := sorted({*with_faces} & {*scene.light.left_out}):
            self.more["with_faces"] = faces
        if escaping:
            self.more["escaping"] = True
        self.full = batch_photons(scene)
        self.cpu_seconds = self.wall_seconds = 0.0
        self._opened: Any = None

    def __call__(self) -> Any:
        """The engine itself."""
        if self._opened is None:
            begin, cpu = time.perf_counter(), time.process_time()
            engine_class = photons_engine(self.scene, self.backend.name)
            self._opened = engine_class(self.scene, **self.more)
            self.wall_seconds, self.cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu
        return self._opened


def led_sources(
    scene: Scene, engine: LightEngine, stores: Sequence[LightStore | None], *, seed: int, backend: str
) -> list[LedSource]:
    """Where the batches of each LED of a scene come from; new ones go to the first store."""
    found, layers = [], [layer.name for layer in scene.phantom.layers] if scene.phantom else []
    for led, source in enumerate(scene.leds):
        mu_a = optics.absorption(engine.scene, source.wavelength_nm)[0]
        read_mu_a = optics.absorption(scene, source.wavelength_nm)[0] if "escaping" in engine.more else None
        made = made_of(engine.scene, led, seed=seed, backend=backend) | engine.more
        stored = [store.light(made) for store in stores if store is not None]
        photodiodes = len(photodiode_names(scene))
        more: dict[str, Any] = {"stored": stored, "layers": layers, "read_mu_a": read_mu_a}
        found.append(LedSource(engine, led, mu_a, photodiodes=photodiodes, seed=seed, **more))
    return found


def accuracy(scene: Scene, options: TraceOptions) -> Accuracy:
    """What to reach: as requested, else as the scene says, else a million photons."""
    given = {name: getattr(options, name) for name in Accuracy.model_fields}
    given = {name: value for name, value in given.items() if value is not None}
    required = scene.accuracy
    if given:
        # Requesting photons alone sets the scene's tolerance aside; a time limit alone keeps it.
        kept = {} if {"photons", "relative_error"} & given.keys() else scene.accuracy.model_dump(exclude_none=True)
        try:
            required = Accuracy(**(kept | given))
        except ValidationError as error:
            raise InputError(checks.explain(error, Accuracy)) from None
    if not required.model_dump(exclude_none=True):
        return Accuracy(photons=DEFAULT_PHOTONS)
    return required


def extend(source: LedSource, triggers: Sequence[LedTrigger], *, stop: Callable[[], bool]) -> LedBatches:
    """The batches of one LED, stored and new ones, until every trigger is met or out of time, or `stop` says so.

    triggers : of all scenes that will be read; they must not have taken in any batch yet.
    """
    pieces: dict[tuple[int, int], Batch] = {}

    def collect(number: int, batch: Batch) -> None:
        pieces[number, batch.photons] = batch

    if take_batches(source, triggers, collect, stop=stop) is Ending.INTERRUPTED:
        raise KeyboardInterrupt
    return LedBatches(source.mu_a, pieces)


def take_batches(
    source: LedSource,
    triggers: Sequence[LedTrigger],
    collect: Callable[[int, Batch], object],
    *,
    stop: Callable[[], bool] = lambda: False,
    progress: ProgressCallback | None = None,
    opening: Callable[[], float] = lambda: 0.0,
) -> Ending:
    """Take the batches of one LED, those that are stored and new ones, until every trigger is met or out of time.

    collect : called with each batch and its number.
    stop : whether nothing more is to be traced; what is stored is taken even then, and when time is over.
    progress : called after every batch with how far the first trigger is.
    opening : what opening the engine has taken so far, which is no part of the time for tracing. [s]
    """
    begin, full = time.perf_counter() - opening(), triggers[0].full

    def seconds() -> float:
        return time.perf_counter() - opening() - begin

    def needed() -> Iterator[tuple[int, int]]:
        number = 0
        while any(trigger.needs_batch(number) for trigger in triggers):
            yield number, full
            number += 1
        last = [(len(sizes) - 1, sizes[-1]) for trigger in triggers if (sizes := trigger.sizes())]
        yield from dict.fromkeys(piece for piece in last if piece[1] != full)

    def is_late(piece: tuple[int, int]) -> bool:
        if source.has(*piece):
            return False
        waiting = [trigger for trigger in triggers if trigger.needs_batch(piece[0])] or triggers
        return stop() or (piece[0] > 0 and seconds() >= max(trigger.seconds for trigger in waiting))

    def sample(piece: tuple[int, int]) -> None:
        batch = source.batch(*piece)
        collect(piece[0], batch)
        for trigger in triggers:
            # Of several triggers only one needs a last, smaller batch.
            if piece[1] == full or len(triggers) == 1:
                trigger.add(batch)

    def report() -> None:
        if progress:
            progress(triggers[0].progress(seconds()))

    return run_until(needed(), sample, is_late=is_late, report=report)
