"""The loop of all sampling and its stopping criteria: a tolerance on an error, a number, or the time.

A run that stops when its own error is small enough is biased: where rare heavy photons are missing, reading and error
come out too small. Checks are seldom and begin at 400 effective photons, which leaves a few hundredths of a standard
error, but half of one at a tolerance of 2 % where 0.1 % of the detected photons carry 10 %; nothing is corrected.

References: Romano et al. 2015, Ann. Nucl. Energy 82, 90 (OpenMC's tally triggers).
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np

from ...scene import Accuracy, Scene
from ...statistics import stderr_of_mean
from ..transfer import photodiode_names
from ..transfer.records import COLUMNS, LedTrace, joined
from ..transfer.transfer import MIN_EFFECTIVE_PHOTONS, rest_state

T = TypeVar("T")

# A photodiode that none of so many photons reached is taken for unlit, unless a time limit says otherwise.
UNLIT_PHOTONS = 100_000_000
# Memory for the records of an LED; a trace that fills it ends. [bytes]
MAX_BYTES = 2e9
# Errors are checked after so many batches, each time a quarter more: seldom enough that stopping hardly favours luck.
# The numbers are fixed, so that a trace that is continued stops where one that was never interrupted stops.
CHECK_GROWTH = 1.25


class Ending(Enum):
    """Why sampling ended."""

    MET = "met"
    OUT_OF_TIME = "max_seconds ended"
    INTERRUPTED = "interrupted"


def run_until(
    needed: Iterable[T],
    sample: Callable[[T], object],
    *,
    is_late: Callable[[T], bool] = lambda sample: False,
    report: Callable[[], object] = lambda: None,
) -> Ending:
    """Take sample after sample until no more is needed, one would begin too late, or the user interrupts.

    needed : what to sample next, worked out one by one from what is there, such as by a `StoppingCriterion`.
    is_late : whether a sample is not to begin any more.
    report : called after every sample; may raise KeyboardInterrupt.

    Raises: KeyboardInterrupt where nothing was sampled before it.
    """
    sampled = False
    try:
        for item in needed:
            if is_late(item):
                return Ending.OUT_OF_TIME
            sample(item)
            sampled = True
            report()
    except KeyboardInterrupt:
        if not sampled:
            raise
        return Ending.INTERRUPTED
    return Ending.MET


@dataclass(frozen=True)
class TraceProgress:
    """How far a trace is.

    relative_error is the largest over the LED's photodiodes, inf while one has detected nothing; with a unit, it is
    an error in that unit. Of studies `led` may name a stage, which may have no error.

    limit_s : after which it ends at the latest, as `seconds` counts. [s]
    """

    led: str
    photons: int
    relative_error: float
    target: float | None
    fraction_done: float
    seconds: float
    unit: str = ""
    is_stage: bool = False
    limit_s: float = math.inf

    @property
    def seconds_left(self) -> float:
        """Time left at the present pace, and within the limit. [s]"""
        all_s = self.seconds / self.fraction_done if self.fraction_done > 0 else math.inf
        return max(min(all_s, self.limit_s) - self.seconds, 0.0)


ProgressCallback = Callable[[TraceProgress], None]


class StageProgress:
    """Reports the stages of a study to a callback; knows whether time ran out or the user interrupted."""

    def __init__(self, callback: ProgressCallback | None, limit_s: float = math.inf, *, unit: str = "") -> None:
        """unit : of the errors; relative ones have none."""
        self.callback, self.limit_s, self.unit, self.begin = callback, limit_s, unit, time.perf_counter()
        self.interrupted = False
        self._last: tuple[str, float, float, float | None] | None = None

    def __call__(self, stage: str, done: float, error: float = math.inf, target: float | None = None) -> None:
        """Report a stage, the part of it that is done, and the relative error reached and requested."""
        self._last = (stage, done, error, target)
        if self.callback and not self.interrupted:
            so_far = (0, error, target, min(1.0, done), self.seconds, self.unit)
            progress = TraceProgress(stage, *so_far, is_stage=True, limit_s=self.limit_s)
            try:
                self.callback(progress)
            except KeyboardInterrupt:
                self.interrupted = True

    def repeat(self) -> None:
        """Report the same once more, because time has passed and the user may want to end."""
        if self._last:
            self(*self._last)

    @property
    def seconds(self) -> float:
        """Time since the beginning. [s]"""
        return time.perf_counter() - self.begin

    @property
    def seconds_left(self) -> float:
        """Time left for what may still begin; none after an interrupt. [s]"""
        return 0.0 if self.interrupted else self.limit_s - self.seconds

    def is_over(self, share: float) -> bool:
        """Whether nothing more is to begin: this share of the time is spent, or the user has interrupted by now."""
        self.repeat()
        return self.interrupted or self.seconds > share * self.limit_s

    @property
    def why(self) -> str:
        """What ended a stage."""
        return (Ending.INTERRUPTED if self.interrupted else Ending.OUT_OF_TIME).value


@dataclass(frozen=True, kw_only=True)
class StoppingCriterion:
    """A tolerance on an error that falls with the root of the number of samples.

    target : the error to reach; 0 is never reached, so that only the time ends it.
    first, least : samples of the first round, and at least of every other.
    margin : more samples than follow from the error so far, which is itself uncertain.
    growth : samples of a round, at most, as a multiple of those before it.
    """

    target: float
    first: int
    least: int = 1
    margin: float = 1.0
    growth: float = math.inf

    def needed(self, samples: int, error: float) -> int:
        """Samples of the next round; 0 where the error of those so far is small enough."""
        if not samples:
            return self.first
        if error <= self.target:
            return 0
        known = self.target > 0 and math.isfinite(error)
        more = samples * (self.margin * (error / self.target) ** 2 - 1) if known else samples
        return math.ceil(max(min(more, self.growth * samples), self.least))

    def share_done(self, error: float) -> float:
        """Fraction of the required samples taken, 0 to 1."""
        return min(1.0, (self.target / error) ** 2) if error > 0 else 1.0


class LedStoppingCriterion:
    """The stopping criterion of one LED's trace, with its batches as they come: what a scene requires of it.

    photons, or the relative standard error of every photodiode at rest, checked by `check_schedule`; or the time; or
    very many photons of which some photodiode has detected none, which no number of photons will mend; or the memory.

    full : photons of a full batch. seconds : for this LED. [s]
    """

    def __init__(self, scene: Scene, led: int, required: Accuracy, *, full: int, seconds: float = math.inf) -> None:
        self.required, self.full, self.seconds = required, full, seconds
        self.name, self.photodiodes = scene.leds[led].name, photodiode_names(scene)
        self._at_rest = rest_state(scene, led)
        self._traces: list[LedTrace] = []
        # Weights of all batches and their squares by photodiode.
        self._total = np.zeros((2, len(self.photodiodes)))
        self.photons = self.batches = self._bytes = 0
        # The largest relative standard error so far, and whether that is small enough.
        self.error, self.met = math.inf, False
        # Why no more photons can be taken, or will help.
        self.futile = ""

    def add(self, batch: LedTrace) -> None:
        """Take in the next batch."""
        self._traces.append(batch)
        self._bytes += sum(getattr(batch, column).nbytes for column in COLUMNS)
        weight = batch.weight_at(*self._at_rest)
        count = len(self.photodiodes)
        self._total += [np.bincount(batch.photodiode, weight**k, minlength=count) for k in (1, 2)]
        self.photons, self.batches = self.photons + batch.photons, self.batches + 1
        total, square = self._total
        # An error is known of a photodiode once it has enough effective photons.
        few = (total**2 < MIN_EFFECTIVE_PHOTONS * square) | (square == 0)
        mean = np.divide(total, self.photons, out=np.ones_like(total), where=~few)
        error = np.where(few, math.inf, stderr_of_mean(total, square, self.photons) / mean)
        self.error = float(error.max(initial=0.0))
        if self._bytes > MAX_BYTES:
            why = f"after {self.photons} photons, at a relative error of {self.error:.3g}; require less."
            self.futile = f'the detected photons of LED "{self.name}" fill {MAX_BYTES / 1e9:g} GB of memory {why}'
        if self.required.photons is not None:
            return
        target = self.required.relative_error
        self.met = target is not None and self.error <= target and check_schedule(self.batches)
        if math.isinf(self.seconds) and self.photons >= UNLIT_PHOTONS and not self._total[0].all():
            self.futile = unlit(self.name, self.photodiodes[int(np.argmin(self._total[0]))], self.photons)

    def trace(self) -> LedTrace:
        """All batches so far as one."""
        return joined(self._traces)

    def next_batch(self) -> int:
        """Photons of the next batch; 0 where no more are needed."""
        if self.met or self.futile:
            return 0
        return self.full if self.required.photons is None else min(self.full, self.required.photons - self.photons)

    def unmet_reason(self, ending: Ending = Ending.MET) -> str | None:
        """Why what was traced falls short of what is required, if it does, or ended by the user."""
        if ending is Ending.INTERRUPTED:
            return f'interrupted: LED "{self.name}" has {self.photons} photons, relative error {self.error:.3g}.'
        target, photons = self.required.relative_error, self.required.photons
        if (target and self.error <= target) or (photons is not None and self.photons >= photons):
            return None
        if self.futile or (photons is None and target is None):
            return self.futile or None
        known = f"relative error {self.error:.3g}, {target:g} requested" if target else f"{self.photons} photons"
        return out_of_time(self.name, known)

    def progress(self, seconds: float) -> TraceProgress:
        """How far the trace is after some time."""
        target, share = self.required.relative_error, seconds / max(self.seconds, 1e-9)
        if self.required.photons is not None:
            share = self.photons / self.required.photons
        elif target is not None:
            # While nothing is known of the error, the end is as far as that of a photodiode that no light reaches.
            known = self.photons / UNLIT_PHOTONS if math.isinf(self.error) else (target / max(self.error, 1e-99)) ** 2
            share = max(share, known)
        so_far = (self.error, target, min(share, 1.0), seconds)
        return TraceProgress(self.name, self.photons, *so_far, limit_s=self.seconds)


def check_schedule(batches: int) -> bool:
    """Whether errors are checked after so many batches."""
    check = 1
    while check < batches:
        check = max(check + 1, math.floor(check * CHECK_GROWTH))
    return check == batches


def share_of_time(max_seconds: float | None, begin: float, leds: int) -> float:
    """A fair share, for each of the LEDs that are left, of the time since `begin` of the performance counter. [s]"""
    return math.inf if max_seconds is None else (max_seconds - (time.perf_counter() - begin)) / leds


def out_of_time(led: str, reached: str) -> str:
    """Why a trace ends with what it has reached."""
    return f'max_seconds ended the trace of LED "{led}" at {reached}; allow more time or require less.'


def unlit(led: str, photodiode: str, photons: int) -> str:
    """Why a trace ends without an error for one of its photodiodes."""
    why = "so no error is known there; move it nearer, leave it out, or set max_seconds or photons."
    return f'of {photons} photons of LED "{led}" none reached photodiode "{photodiode}", {why}'
