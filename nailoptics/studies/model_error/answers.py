"""What a level of model answers: how far off it reads, and what an answer of some error costs."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from .variants import Changes, lines_of

# What counts: the reading at rest, its change by touch, or the worse of the two.
Judge = Literal["reading", "signal", "both"]
# After the first answer: so many more blood states, or so many more layouts.
MORE = 1000
Effort = Literal["first", "states", "layouts"]
# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1


@dataclass(frozen=True)
class Bias:
    """How far a level is from the reference, as a part of it.

    value, stderr : mean over all photodiodes, weighed by the reference's errors.
    bound : what no photodiode's exceeds, with 95 % confidence each.
    """

    value: float
    stderr: float
    bound: float


@dataclass(frozen=True)
class Cost:
    """Processor seconds: `fixed`, and `per_second` for each second in which photons are traced."""

    fixed: float
    per_second: float = 0.0

    def at(self, photon_seconds: float) -> float:
        """The cost with so many seconds of photons. [s]"""
        return self.fixed + self.per_second * photon_seconds

    def photon_seconds(self, seconds: float) -> float:
        """Seconds of photons that so many processor seconds leave; without end where they cost nothing here. [s]"""
        if seconds < self.fixed:
            return -math.inf
        return (seconds - self.fixed) / self.per_second if self.per_second else math.inf


@dataclass(frozen=True)
class Level:
    """One level of model, measured.

    reading : bias of the reading at rest; None where the level has none.
    signal : bias of the change by touch, as a part of the largest change; None where that is not traced.
    reading_noise, signal_noise : standard error of the worst reading, and of the worst change as a part of the largest,
        after one processor second of photons; 0 where none are traced. [s^0.5]
    first, states, layouts : what the first answer costs from the scene on, and 1000 more blood states or layouts.
    memory_mb : of the photons kept for a standard error of 1 %; None where none are.
    beforehand : what must be known beside the scene's media and shape; empty where nothing must.
    remark : what the numbers do not say; empty where they say all.
    stored : whether that is a trace, so that the level is nobody's first answer.
    changes : what of the scene selects it; nothing where the scene is so already.
    call : what gives it where no line of a scene does.
    """

    name: str
    backend: str
    reading: Bias | None
    signal: Bias | None
    first: Cost
    states: Cost
    layouts: Cost
    reading_noise: float = 0.0
    signal_noise: float = 0.0
    memory_mb: float | None = None
    beforehand: str = ""
    remark: str = ""
    stored: bool = False
    changes: Changes | None = None
    call: str = ""

    @property
    def lines(self) -> list[str]:
        """The scene lines that select it."""
        return lines_of(self.changes or {})

    def judged(self, judge: Judge) -> list[tuple[Bias | None, float]]:
        """Bias and noise of what counts."""
        both = {"reading": (self.reading, self.reading_noise), "signal": (self.signal, self.signal_noise)}
        return list(both.values()) if judge == "both" else [both[judge]]

    def bias(self, judge: Judge) -> float:
        """What the bias of no photodiode exceeds in what counts; inf where that is not known."""
        bounds = [math.inf if bias is None else bias.bound for bias, _ in self.judged(judge)]
        return math.inf if any(math.isnan(bound) for bound in bounds) else max(bounds)

    def error(self, judge: Judge, photon_seconds: float) -> float:
        """Error of the worst photodiode after so many seconds of photons: bias and standard error together."""
        if photon_seconds < 0 or math.isinf(self.bias(judge)):
            return math.inf
        errors = []
        for bias, noise in self.judged(judge):
            assert bias is not None
            variance = noise**2 / photon_seconds if photon_seconds else (math.inf if noise else 0.0)
            errors.append(math.sqrt(bias.bound**2 + variance))
        return max(errors)

    def photon_seconds(self, judge: Judge, error: float) -> float:
        """Seconds of photons until the error of the worst photodiode is no more than this; inf where it never is."""
        if math.isinf(self.bias(judge)) or self.bias(judge) > error:
            return math.inf
        needed = 0.0
        for bias, noise in self.judged(judge):
            assert bias is not None
            if noise:
                left = error**2 - bias.bound**2
                needed = max(needed, noise**2 / left if left > 0 else math.inf)
        return needed

    def seconds_within(self, judge: Judge, error: float) -> float:
        """What the first answer of no more than an error costs; inf where the level never gives one. [s]"""
        photons = self.photon_seconds(judge, error)
        return self.first.at(photons) if math.isfinite(photons) else math.inf

    def usual_photon_seconds(self, judge: Judge, tolerance: float) -> float:
        """Seconds of photons for a tolerance, or for a tenth more than its bias where that is larger."""
        if not self.first.per_second:
            return 0.0
        return self.photon_seconds(judge, max(tolerance, 1.1 * self.bias(judge)))

    def cost(self, effort: Effort) -> Cost:
        """What the first answer costs, or a thousand more."""
        return {"first": self.first, "states": self.states, "layouts": self.layouts}[effort]


@dataclass(frozen=True)
class Answer:
    """A level with so many seconds of photons.

    error : of the worst photodiode, in what counts.
    """

    level: Level
    photon_seconds: float
    error: float

    def seconds(self, effort: Effort = "first") -> float:
        """What it costs. [s]"""
        return self.level.cost(effort).at(self.photon_seconds)

    @property
    def relative_error(self) -> float:
        """Standard error of its worst reading; 0 where no photons are traced."""
        noise = self.level.reading_noise
        return noise / math.sqrt(self.photon_seconds) if noise and self.photon_seconds else 0.0


def fastest(
    levels: Iterable[Level], error: float, judge: Judge, *, effort: Effort = "first", usual: Iterable[str] = ()
) -> Answer | None:
    """The answer of no more than an error that costs least; None where no level gives one.

    usual : names of levels to stay with where none is cheaper beyond the noise of costs, the first that will do.
    """
    needed = [(one, one.photon_seconds(judge, error)) for one in levels]
    found = [Answer(one, seconds, one.error(judge, seconds)) for one, seconds in needed if math.isfinite(seconds)]
    if not found:
        return None
    least = min(found, key=lambda answer: answer.seconds(effort))
    for name in usual:
        for answer in found:
            if answer.level.name == name and (1 - COST_NOISE) * answer.seconds(effort) <= least.seconds(effort):
                return answer
    return least


def best(levels: Iterable[Level], seconds: float, judge: Judge) -> Answer | None:
    """The first answer with the least error that costs no more than so many processor seconds; None where none does."""
    found = []
    for one in levels:
        left = one.first.photon_seconds(seconds)
        photons = left if math.isfinite(left) else 0.0
        if left >= 0 and math.isfinite(error := one.error(judge, photons)):
            found.append(Answer(one, photons, error))
    return min(found, key=lambda answer: answer.error, default=None)


def in_words(seconds: float) -> str:
    """A time in the unit that suits it."""
    units = (("h", 3600.0, 5400.0), ("min", 60.0, 90.0), ("s", 1.0, 1.0), ("ms", 1e-3, 1e-3), ("us", 1e-6, 0.0))
    name, size = next((unit, size) for unit, size, least in units if seconds >= least)
    return f"{seconds / size:.{0 if seconds >= 100 * size else 2}{'f' if seconds >= 100 * size else 'g'}} {name}"


def percent(value: float, stderr: float) -> str:
    """A part and its standard error in percent, both to two digits of the error; what is 0 by construction has none."""
    if not stderr > 0:
        return f"{100 * value:+.2g}%" if value else "0%"
    decimals = min(max(1 - math.floor(math.log10(100 * stderr)), 0), 5) if math.isfinite(stderr) else 2
    return f"{100 * value:+.{decimals}f} +- {100 * stderr:.{decimals}f}%"
