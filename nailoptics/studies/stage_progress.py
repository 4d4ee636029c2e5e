"""How far a study is: reported to one callback, which may also bring the user's wish to end."""

import math
import time

from ..light import ProgressCallback, TraceProgress


class StageProgress:
    """Reports the stages of a study to a callback; knows whether time ran out or the user interrupted."""

    def __init__(self, callback: ProgressCallback | None, limit_s: float = math.inf, *, unit: str = "") -> None:
        """unit : of the errors; relative ones have none."""
        self.callback, self.limit_s, self.unit, self.begin = callback, limit_s, unit, time.perf_counter()
        self.interrupted = False
        self._last: tuple[str, float, float, float | None] | None = None

    def __call__(self, stage: str, done: float, error: float = math.inf, target: float | None = None) -> None:
        """Report a stage, the part of it that is done, and the relative error reached and wanted."""
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
        return "interrupted" if self.interrupted else "max_seconds ended"
