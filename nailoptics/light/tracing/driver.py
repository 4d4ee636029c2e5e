"""The loop of all sampling: until enough is known, time is over or the user interrupts; and what it reports."""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

T = TypeVar("T")


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

    needed : what to sample next, worked out one by one from what is there, such as by a `Trigger`.
    is_late : whether a sample is not to begin any more.
    report : called after every sample; may raise KeyboardInterrupt.

    Raises: KeyboardInterrupt where nothing was sampled before it.
    """
    sampled = False
    try:
        for one in needed:
            if is_late(one):
                return Ending.OUT_OF_TIME
            sample(one)
            sampled = True
            report()
    except KeyboardInterrupt:
        if not sampled:
            raise
        return Ending.INTERRUPTED
    return Ending.MET


def seconds_per_sample(sample: Callable[[int], object], first: int, count: Callable[[float], int]) -> float:
    """The pace of sampling, from a second call, since the first compiles what it runs. [s]

    sample : takes so many samples. count : samples of the second call, from what the first took. [s]
    """
    begin = time.perf_counter()
    sample(first)
    then, begin = count(time.perf_counter() - begin), time.perf_counter()
    sample(then)
    return (time.perf_counter() - begin) / then


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
            try:
                self.callback(
                    TraceProgress(stage, 0, error, target, min(1.0, done), self.seconds, self.unit, is_stage=True)
                )
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

    def is_late(self, share: float) -> bool:
        """Whether this share of the time is spent."""
        return self.seconds > share * self.limit_s

    def is_over(self, share: float) -> bool:
        """Whether nothing more is to begin: this share of the time is spent, or the user has interrupted by now."""
        self.repeat()
        return self.interrupted or self.is_late(share)

    @property
    def why(self) -> str:
        """What ended a stage."""
        return (Ending.INTERRUPTED if self.interrupted else Ending.OUT_OF_TIME).value
