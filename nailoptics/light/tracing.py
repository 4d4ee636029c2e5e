"""The driver of every trace: batches of each LED until a stopping rule is met, from what is already there."""

import math
import time
from collections.abc import Callable, Collection, Container, Sequence
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
from . import optics
from .identity import light_scene
from .records import FINGER_BATCH_PHOTONS, PHANTOM_BATCH_PHOTONS, Batch, LedBatches, LedRecords
from .reweight import transmission
from .store import LedSource, LightStore, made_of
from .transfer import MIN_EFFECTIVE_PHOTONS, Transfer, photodiode_names, rest_state
from .unbiased_stop import batch_factors

DEFAULT_PHOTONS = 1_000_000
# A photodiode that none of so many photons reached is taken for unseen, unless a time limit says otherwise.
UNSEEN_PHOTONS = 100_000_000
INTERRUPTED = "interrupted"
PHOTONS_ENGINE = "the photons engine"
# Errors are checked after so many batches, each time a quarter more: seldom enough that stopping hardly favours luck.
# The numbers are fixed, so that a trace that is continued stops where one that was never interrupted stops.
CHECK_GROWTH = 1.25
# Below this relative error luck moves a trace that stops by it by a hundredth of its error or so.
LUCKY_ABOVE = 0.02


@dataclass(frozen=True)
class TraceProgress:
    """How far a trace is.

    relative_error is the largest over the LED's photodiodes, inf while one of them has seen nothing; with a unit, it is
    an error in that unit. Of studies `led` may name a stage, which may have no error.
    """

    led: str
    photons: int
    relative_error: float
    target: float | None
    fraction_done: float
    seconds: float
    unit: str = ""
    is_stage: bool = False

    @property
    def seconds_left(self) -> float:
        """Time left at the present pace. [s]"""
        return self.seconds * (1 / self.fraction_done - 1) if self.fraction_done > 0 else math.inf


ProgressCallback = Callable[[TraceProgress], None]


def trace(
    scene: Scene,
    *,
    kept: Collection[str] = (),
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Transfer:
    """Trace the light of every LED once; the result can be read at any blood state.

    kept : parts whose faces are there even where the scene leaves them out. So photons that never meet them go the same
        way, number by number, as in a scene that has them, which walks on other faces would not.
    requested : fields of `TraceOptions`; a million photons where neither they nor the scene say how far.
    progress : called after every batch.

    Raises: InputError; NotReachedError with `.result`, the Transfer as far as it got, when the tolerance was not met
    within max_seconds or the trace was interrupted.
    """
    begin, options = time.process_time(), TraceOptions(**requested)
    chosen = backends.choose_jit(options.backend, PHOTONS_ENGINE)
    required = accuracy(scene, options)
    engine, store = LightEngine(scene, chosen, kept=kept), LightStore.of_user() if options.store else None
    sources = led_sources(scene, engine, [store], seed=options.seed, backend=chosen.name)
    start, cpu = time.perf_counter(), time.process_time()
    traces, events, complaint = [], 0, None
    for led, source in enumerate(sources):
        rule = StoppingRule(scene, led, required, source.mu_a, full=engine.full)
        rule.seconds = share_of_time(required.max_seconds, start + engine.wall_seconds, len(scene.leds) - led)
        found = LedRecords(source.mu_a, rule.rest, seed=options.seed, led=led)
        why = _trace_led(source, rule, found, progress, lambda: engine.wall_seconds)
        complaint = complaint or why
        if why and why.startswith(INTERRUPTED):
            # What is there is of use only with something from every LED: one batch each, then the end.
            required = Accuracy(photons=engine.full)
        events += found.events
        traces.append(found.trace(rule.factors))
    if store is not None:
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
        raise NotReachedError(complaint, result=result)
    return result


def photons_engine(scene: Scene, backend: str) -> Any:
    """The class of the photons engine for a scene, whose backend is active from then on.

    Raises: InputError where the backend compiles no kernels.
    """
    backends.activate_jit(backend, PHOTONS_ENGINE)
    if scene.phantom is not None:
        from .layered_walk import LayeredTracer

        return LayeredTracer
    from .finger_walk import FingerTracer

    return FingerTracer


def batch_photons(scene: Scene) -> int:
    """Photons of a full batch of a scene's light."""
    return FINGER_BATCH_PHOTONS if scene.phantom is None else PHANTOM_BATCH_PHOTONS


class LightEngine:
    """The engine of a scene's light, opened when the first photon is to be walked; scenes of one light share it.

    Until then Mitsuba is not even imported: light that is stored needs none.

    kept : the parts that it has although the scene leaves them out.
    full : photons of a full batch.
    cpu_seconds, wall_seconds : what opening it took. [s]
    """

    def __init__(self, scene: Scene, backend: backends.Backend, *, kept: Collection[str] = ()) -> None:
        self.scene, self.backend = light_scene(scene), backend
        self.kept = sorted({*kept} & {*scene.light.left_out})
        self.full = batch_photons(scene)
        self.cpu_seconds = self.wall_seconds = 0.0
        self._opened: Any = None

    def __call__(self) -> Any:
        """The engine itself."""
        if self._opened is None:
            begin, cpu = time.perf_counter(), time.process_time()
            engine_class = photons_engine(self.scene, self.backend.name)
            self._opened = engine_class(self.scene, **({"kept": self.kept} if self.kept else {}))
            self.wall_seconds, self.cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu
        return self._opened


def led_sources(
    scene: Scene, engine: LightEngine, stores: Sequence[LightStore | None], *, seed: int, backend: str
) -> list[LedSource]:
    """Where the batches of each LED of a scene come from; new ones go to the first store."""
    found, layers = [], [layer.name for layer in scene.phantom.layers] if scene.phantom else []
    for led, source in enumerate(scene.leds):
        mu_a = optics.absorption(engine.scene, source.wavelength_nm)[0]
        made = made_of(scene, led, seed=seed, backend=backend) | ({"kept": engine.kept} if engine.kept else {})
        stored = [store.light(made) for store in stores if store is not None]
        photodiodes = len(photodiode_names(scene))
        found.append(LedSource(engine, led, mu_a, photodiodes=photodiodes, seed=seed, stored=stored, layers=layers))
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


def share_of_time(max_seconds: float | None, begin: float, leds: int) -> float:
    """A fair share, for each of the LEDs that are left, of the time since `begin` of the performance counter. [s]"""
    return math.inf if max_seconds is None else (max_seconds - (time.perf_counter() - begin)) / leds


def check_schedule(batches: int) -> bool:
    """Whether errors are checked after so many batches."""
    check = 1
    while check < batches:
        check = max(check + 1, math.floor(check * CHECK_GROWTH))
    return check == batches


class StoppingRule:
    """When the trace of one LED may end: what a scene requires of it, held against the batches as they come.

    photons, or the relative standard error of every photodiode at rest, checked by `check_schedule`; or the time; or
    very many photons of which some photodiode has seen none, which no number of photons will mend.
    """

    def __init__(self, scene: Scene, led: int, required: Accuracy, mu_a: np.ndarray, *, full: int) -> None:
        """mu_a : (r,) float. Absorption for which the weights hold. [mm^-1]

        full : photons of a full batch.
        """
        self.led, self.required, self.full = led, required, full
        self.name, self.photodiodes = scene.leds[led].name, photodiode_names(scene)
        # For this LED. [s]
        self.seconds = required.max_seconds / len(scene.leds) if required.max_seconds else math.inf
        self.rest, self._mu_a = rest_state(scene, led), mu_a
        # Of each batch, and of all: weights and their squares by photodiode.
        self._sums: list[np.ndarray] = []
        self._total = np.zeros((2, len(self.photodiodes)))
        self.photons = 0
        self.errors: list[float] = []
        # Why no number of photons will do.
        self.unseen = ""
        self._batches: int | None = None
        # What the weights in each batch are multiplied by, (batches,) float, if it stopped at the tolerance.
        self.factors: np.ndarray | None = None

    @property
    def error(self) -> float:
        """The largest relative standard error so far."""
        return self.errors[-1] if self.errors else math.inf

    def add(self, batch: Batch) -> None:
        """Take in the next batch."""
        weight = batch.weight * transmission(batch.path_mm, self.rest.mu_a - self._mu_a, self.rest.share)
        count = len(self.photodiodes)
        self._sums.append(np.stack([np.bincount(batch.photodiode, weight**k, minlength=count) for k in (1, 2)]))
        self._total += self._sums[-1]
        self.photons += batch.photons
        self.errors.append(float(_largest_error(self._total, self.photons)))
        target = None if self.required.photons is not None else self.required.relative_error
        due = self._batches is None and check_schedule(len(self.errors))
        if due and target is not None and self.error <= target:
            # The error that stays is that of what will be read; it may be a little above what the rule asks for.
            self._batches, (self.factors, self.errors[-1]) = len(self.errors), self._weighed_batches()
        endless = self.required.photons is None and math.isinf(self.seconds)
        if endless and not self.unseen and self.photons >= UNSEEN_PHOTONS and not self._total[0].all():
            self.unseen = unseen(self.name, self.photodiodes[int(np.argmin(self._total[0]))], self.photons)

    def _weighed_batches(self) -> tuple[np.ndarray, float]:
        """What each batch counts for now that the trace stops, (batches,) float, and the largest error that is left."""
        count, target = len(self.errors), self.required.relative_error or 0.0
        if self.error <= LUCKY_ABOVE:
            return np.ones(count), self.error
        sums, checks = np.stack(self._sums), [number for number in range(1, count) if check_schedule(number)]
        factors = batch_factors(sums, lambda total, n: _largest_error(total, n * self.full) <= target, checks)
        weighed = np.stack([factors @ sums[:, 0], factors**2 @ sums[:, 1]])
        return factors, float(_largest_error(weighed, self.photons, least=0.0))

    def sizes(self) -> list[int] | None:
        """Photons of the batches that meet the rule; None while that is not known."""
        if self.required.photons is not None:
            whole, rest = divmod(self.required.photons, self.full)
            return [self.full] * whole + ([rest] if rest else [])
        return None if self._batches is None else [self.full] * self._batches

    def wants(self, number: int) -> bool:
        """Whether the full batch of this number is needed."""
        sizes = self.sizes()
        return (sizes is None and not self.unseen) or (sizes or [])[number : number + 1] == [self.full]

    def settled(self, pieces: Container[tuple[int, int]]) -> tuple[list[int], bool]:
        """Photons of the batches to read, and whether they meet the rule; of as many as there are if they do not."""
        sizes = self.sizes()
        if sizes is not None and all(piece in pieces for piece in enumerate(sizes)):
            return sizes, True
        timed = self.required.photons is None and self.required.relative_error is None
        return [self.full] * len(self.errors), timed

    def shortfall(self) -> str | None:
        """Why what was traced falls short of what is required, if it does."""
        target, photons = self.required.relative_error, self.required.photons
        if self.unseen:
            return self.unseen
        if photons is None and target is None or self._batches or (target and self.error <= target):
            return None
        if photons is not None and self.photons >= photons:
            return None
        known = f"relative error {self.error:.3g}, {target:g} requested" if target else f"{self.photons} photons"
        return out_of_time(self.name, known)

    def progress(self, seconds: float) -> TraceProgress:
        """How far the trace is after some time."""
        target, share = self.required.relative_error, seconds / max(self.seconds, 1e-9)
        if self.required.photons is not None:
            share = self.photons / self.required.photons
        elif target is not None:
            # While nothing is known of the error, the end is as far as that of a photodiode that sees nothing.
            known = self.photons / UNSEEN_PHOTONS if math.isinf(self.error) else (target / max(self.error, 1e-99)) ** 2
            share = max(share, known)
        return TraceProgress(self.name, self.photons, self.error, target, min(share, 1.0), seconds)


def _take_batches(
    rules: Sequence[StoppingRule],
    batch_of: Callable[[int, int], Batch],
    *,
    has: Callable[[int, int], bool] = lambda number, photons: False,
    stop: Callable[[], bool] = lambda: False,
    report: Callable[[float], None] = lambda seconds: None,
    opening: Callable[[], float] = lambda: 0.0,
) -> None:
    """Take the batches of one LED, those that are there and new ones, until every rule is met or out of time.

    rules : of all scenes that will be read; they must not have taken in any batch yet.
    batch_of : the batch of a number and its photons, stored or traced now.
    has : whether it is stored; what is stored is taken even when time is over.
    stop : whether nothing more is to be traced.
    report : called after every batch with the seconds spent.
    opening : what opening the engine has taken so far, which is no part of the time for tracing. [s]
    """
    begin, number = time.perf_counter() - opening(), 0

    def seconds() -> float:
        return time.perf_counter() - opening() - begin

    while waiting := [rule for rule in rules if rule.wants(number)]:
        full = waiting[0].full
        late = number > 0 and seconds() >= max(rule.seconds for rule in waiting)
        if not has(number, full) and (late or stop()):
            return
        batch = batch_of(number, full)
        for rule in rules:
            rule.add(batch)
        number += 1
        report(seconds())
    for rule in rules:
        sizes = rule.sizes()
        if sizes and sizes[-1] != rule.full and not stop():
            late = number > 0 and seconds() >= rule.seconds
            if not late or has(len(sizes) - 1, sizes[-1]):
                batch = batch_of(len(sizes) - 1, sizes[-1])
                if len(rules) == 1:
                    rule.add(batch)
                    report(seconds())


def extend(source: LedSource, rules: Sequence[StoppingRule], *, stop: Callable[[], bool]) -> LedBatches:
    """The batches of one LED, stored and new ones, until every rule is met or out of time, or `stop` says so.

    rules : as for `_take_batches`.
    """
    pieces: dict[tuple[int, int], Batch] = {}

    def batch_of(number: int, photons: int) -> Batch:
        if (number, photons) not in pieces:
            pieces[number, photons] = source.batch(number, photons)
        return pieces[number, photons]

    _take_batches(rules, batch_of, has=source.has, stop=stop)
    return LedBatches(source.mu_a, pieces)


def _trace_led(
    source: LedSource,
    rule: StoppingRule,
    found: LedRecords,
    progress: ProgressCallback | None,
    opening: Callable[[], float],
) -> str | None:
    """Take one LED's light into its records; says why they fall short of what is required, if they do."""

    def taken(number: int, photons: int) -> Batch:
        batch = source.batch(number, photons)
        found.add(number, batch)
        return batch

    def report(seconds: float) -> None:
        if progress:
            progress(rule.progress(seconds))

    try:
        _take_batches([rule], taken, has=source.has, report=report, opening=opening)
    except KeyboardInterrupt:
        if not rule.photons:
            raise
        return f'{INTERRUPTED}: LED "{rule.name}" has {rule.photons} photons, relative error {rule.error:.3g}.'
    return rule.shortfall()


def out_of_time(led: str, reached: str) -> str:
    """Why a trace ends with what it has reached."""
    return f'max_seconds ended the trace of LED "{led}" at {reached}; allow more time or require less.'


def unseen(led: str, photodiode: str, photons: int) -> str:
    """Why a trace ends without an error for one of its photodiodes."""
    return (
        f'of {photons} photons of LED "{led}" none reached photodiode "{photodiode}", so no error is '
        "known there; move it nearer, leave it out, or set max_seconds or photons."
    )


def _largest_error(sums: np.ndarray, photons: int, *, least: float = MIN_EFFECTIVE_PHOTONS) -> np.ndarray:
    """Largest relative standard error, (...) float; inf as long as a photodiode has too few photons for one.

    sums : (..., 2, photodiodes) float. Of weights and of their squares.
    least : effective photons that are enough.
    """
    weight, square = sums[..., 0, :], sums[..., 1, :]
    few = (weight**2 < least * square) | (square == 0)
    mean = np.divide(weight, photons, out=np.ones_like(weight), where=~few)
    error = np.where(few, math.inf, stderr_of_mean(weight, square, photons) / mean)
    return error.max(-1, initial=0.0)
