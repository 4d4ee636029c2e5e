"""One trace per LED, in batches, until the asked error, the time or the number of photons is reached."""

import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
from pydantic import ValidationError

from .. import checks
from ..errors import InputError, NotReachedError
from ..options import Requested, TraceOptions
from ..scene import Accuracy, Scene
from ..statistics import stderr_of_mean
from . import backend as backends
from . import optics, records
from .moments import RestState
from .records import Batch, LedTrace, joined, of_batch
from .reweight import transmission
from .transfer import MIN_EFFECTIVE_PHOTONS, Transfer, rest_state, versions

log = logging.getLogger(__name__)

DEFAULT_PHOTONS = 1_000_000
# A photodiode that none of so many photons reached is taken for dark, unless a time limit says otherwise.
UNSEEN_PHOTONS = 100_000_000
INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class TraceProgress:
    """How far a trace is.

    relative_error is the largest over the LED's photodiodes, inf while one of them has seen nothing.
    """

    led: str
    photons: int
    relative_error: float
    target: float | None
    fraction_done: float
    seconds: float

    @property
    def seconds_left(self) -> float:
        """Time left at the present pace. [s]"""
        return self.seconds * (1 / self.fraction_done - 1) if self.fraction_done > 0 else math.inf


def trace(
    scene: Scene,
    *,
    progress: Callable[[TraceProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> Transfer:
    """Trace the light of every LED once; the result can be read at any blood state.

    Parameters
    ----------
    requested : fields of `TraceOptions`; a million photons where neither they nor the scene say how far.
    progress : called after every batch.

    Raises: InputError; NotReachedError with `.result`, the Transfer as far as it got, when the tolerance was not met
    within max_seconds or the trace was interrupted.
    """
    options = TraceOptions(**requested)
    chosen = backends.choose(options.backend)
    if not chosen.jit:
        raise InputError(
            f"the photons engine needs a JIT backend, and {chosen.name} is none: {chosen.advice or 'ask for auto'}"
        )
    asked = accuracy(scene, options)
    backends.activate(chosen)
    tracer: Any
    if scene.phantom is not None:
        from .layered_walk import LayeredTracer as tracer
    else:
        from .finger_walk import FingerTracer as tracer
    engine = tracer(scene)
    start, cpu = time.perf_counter(), time.process_time()
    traces, events, complaint = [], 0, None
    for i in range(len(scene.leds)):
        # A fair share of the time for each LED that is left.
        deadline = None
        if asked.max_seconds is not None:
            left = asked.max_seconds - (time.perf_counter() - start)
            deadline = time.perf_counter() + left / (len(scene.leds) - i)
        rest = rest_state(scene, i, len(engine.photodiodes))
        gathered, why = _trace_led(engine, i, asked, options.seed, deadline, progress, rest=rest)
        complaint = complaint or why
        if why and why.startswith(INTERRUPTED):
            # What is there is of use only with something from every LED: one batch each, then the end.
            asked = Accuracy(photons=engine.batch_photons)
        events += gathered.events
        traces.append(gathered.trace())
    result = Transfer(
        scene=scene,
        photodiodes=engine.photodiodes,
        absorbers=optics.absorbers(scene),
        traces=tuple(traces),
        engine="photons",
        backend=chosen.name,
        versions=versions(),
        cpu_seconds=time.process_time() - cpu,
        wall_seconds=time.perf_counter() - start,
        events=events,
    )
    if complaint:
        raise NotReachedError(complaint, result=result)
    return result


def accuracy(scene: Scene, options: TraceOptions) -> Accuracy:
    """What to reach: as asked, else as the scene says, else a million photons."""
    given = {name: getattr(options, name) for name in Accuracy.model_fields}
    given = {name: value for name, value in given.items() if value is not None}
    asked = scene.accuracy
    if given:
        # Asking for photons alone sets the scene's tolerance aside; a time limit alone keeps it.
        kept = {} if {"photons", "relative_error"} & given.keys() else scene.accuracy.model_dump(exclude_none=True)
        try:
            asked = Accuracy(**(kept | given))
        except ValidationError as error:
            raise InputError(checks.explain(error, Accuracy)) from None
    if asked.photons is None and asked.relative_error is None and asked.max_seconds is None:
        return Accuracy(photons=DEFAULT_PHOTONS)
    return asked


class _Gathered:
    """Batches of one LED as they come in; memory stays bounded however many there are."""

    def __init__(self, mu_a: np.ndarray, rest: RestState | None) -> None:
        self.mu_a, self.rest, self.events = mu_a, rest, 0
        self._whole: LedTrace | None = None
        self._loose: list[LedTrace] = []

    def add(self, seed: int, batch: Batch) -> None:
        """Add one batch and the seed that made it."""
        self.events += batch.events
        self._loose.append(of_batch(batch, self.mu_a, seed, self.rest))
        if sum(len(trace.weight) for trace in self._loose) > records.MAX_RECORDS:
            self.trace()

    def trace(self) -> LedTrace:
        """All batches so far as one."""
        traces = ([self._whole] if self._whole else []) + self._loose
        self._whole, self._loose = joined(traces), []
        return self._whole


def _trace_led(
    engine: Any,
    led: int,
    asked: Accuracy,
    seed: int,
    deadline: float | None,
    progress: Callable[[TraceProgress], None] | None,
    *,
    rest: RestState | None = None,
) -> tuple[_Gathered, str | None]:
    """Batches of one LED with their seeds, and why they fall short of what was asked, if they do.

    rest : state in which the error is looked at; the traced one if not given.
    """
    name, begin = engine.scene.leds[led].name, time.perf_counter()
    gathered = _Gathered(engine.mu_a(led), rest)
    count = len(engine.photodiodes)
    weight, square, done = np.zeros(count), np.zeros(count), 0
    planned = asked.photons or engine.batch_photons
    error = math.inf
    try:
        for batch_seed in _seeds(seed, led):
            size = min(engine.batch_photons, planned - done)
            batch = engine.batch(led, photons=size, seed=batch_seed)
            gathered.add(batch_seed, batch)
            done += size
            read = batch.weight
            if rest is not None:
                read = read * transmission(batch.path_mm, rest.mu_a - gathered.mu_a, rest.share)
            weight += np.bincount(batch.photodiode, read, minlength=count)
            square += np.bincount(batch.photodiode, read**2, minlength=count)
            error = _largest_error(weight, square, done)
            late = deadline is not None and time.perf_counter() >= deadline
            if asked.photons is None and done >= planned:
                planned = _plan(asked.relative_error, error, done, engine.batch_photons)
            if progress:
                if deadline is not None and (asked.relative_error is None or planned == math.inf):
                    share = min(1.0, (time.perf_counter() - begin) / max(deadline - begin, 1e-9))
                else:
                    share = min(1.0, done / planned)
                progress(TraceProgress(name, done, error, asked.relative_error, share, time.perf_counter() - begin))
            if done >= planned:
                return gathered, None
            if asked.photons is None and deadline is None and done >= UNSEEN_PHOTONS and not weight.all():
                return gathered, unseen(name, engine.photodiodes[int(np.argmin(weight))], done)
            if late:
                if asked.relative_error is None and asked.photons is None:
                    return gathered, None
                what = (
                    f"relative error {error:.3g}, {asked.relative_error:g} asked"
                    if asked.relative_error
                    else f"{done} photons"
                )
                return (
                    gathered,
                    f'max_seconds ended the trace of LED "{name}" at {what}; allow more time or ask for less.',
                )
    except KeyboardInterrupt:
        if not done:
            raise
        return gathered, f'{INTERRUPTED}: LED "{name}" has {done} photons, relative error {error:.3g}.'
    raise AssertionError("seeds never end")


def unseen(led: str, photodiode: str, photons: int) -> str:
    """Why a trace ends without an error for one of its photodiodes."""
    return (
        f'of {photons} photons of LED "{led}" none reached photodiode "{photodiode}", so no error can be '
        "told there; move it nearer, leave it out, or set max_seconds or photons."
    )


def _plan(target: float | None, error: float, done: int, batch: int) -> float:
    """Photons in all that should meet the target, decided in few rounds so that stopping hardly favours luck."""
    if target is None:
        return math.inf
    if error <= target:
        return done
    if math.isinf(error):
        return 4 * done
    needed = done * min((error / target) ** 2 * 1.02, 64.0)
    return math.ceil(max(needed - done, 1) / batch) * batch + done


def _largest_error(weight: np.ndarray, square: np.ndarray, photons: int) -> float:
    """Largest relative standard error; inf as long as a photodiode has too few photons for one."""
    if not len(weight):
        return 0.0
    if np.any(weight**2 < MIN_EFFECTIVE_PHOTONS * square) or np.any(square == 0):
        return math.inf
    return float(np.max(stderr_of_mean(weight, square, photons) / (weight / photons)))


def _seeds(seed: int, led: int) -> Iterator[int]:
    """Independent seeds for the batches of one LED."""
    batch = 0
    while True:
        sequence = np.random.SeedSequence(seed, spawn_key=(led, batch))
        yield int(sequence.generate_state(1, np.uint64)[0])
        batch += 1
