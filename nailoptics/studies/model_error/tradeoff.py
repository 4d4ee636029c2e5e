"""Error against processor time for every level of model, from a formula to many photons: the fastest in a tolerance."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ...errors import NotReachedError
from ...light import ProgressCallback
from ...options import Requested, TraceOptions
from ...scene import Scene
from ...variables import Variables, variable
from .changes import changes_between, revised
from .levels import OWN, REFERENCE, Level, ModelStudy
from .paired import check_study

if TYPE_CHECKING:
    import xarray as xr

DEFAULT_TOLERANCE = 0.02
# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1


@dataclass(frozen=True)
class Answer:
    """A level with so many seconds of photons, and its error on the worst photodiode."""

    level: Level
    photon_seconds: float
    error: float

    @property
    def seconds(self) -> float:
        """Processor time of the first answer. [s]"""
        return self.level.setup_seconds + self.photon_seconds

    @property
    def relative_error(self) -> float:
        """Standard error of its worst reading; 0 where no photons are traced."""
        noise = self.level.reading_noise
        return noise / float(np.sqrt(self.photon_seconds)) if noise and self.photon_seconds else 0.0


@dataclass(frozen=True)
class Tradeoff:
    """All levels of model, and the one to take, as a scene.

    An error is that of the worst photodiode: of its reading at rest, relative, or of its change by touch, as a part of
    the largest change of any photodiode, whichever is larger; the bound on the level's bias and one standard error, in
    squares. With `simultaneous` it is what all readings and all changes stay within with 95 % probability.

    levels : the cheapest for the tolerance first, then those that never keep it.
    max_seconds : processor time that an answer may take; None without a limit.
    chosen : the fastest within the tolerance, or the best within the time where that would take longer.
    """

    levels: tuple[Level, ...]
    tolerance: float
    simultaneous: bool
    max_seconds: float | None
    chosen: Answer
    scene: Scene
    wall_seconds: float
    attributes: dict[str, Any]

    @property
    def cut_off(self) -> str | None:
        """Why it ended before all was measured, if it did."""
        return self.attributes.get("cut_off")

    @property
    def reference(self) -> Level:
        """The full model."""
        return next(level for level in self.levels if level.name == REFERENCE)

    @property
    def coverage_factor(self) -> float:
        """Standard errors within which all readings and changes lie at once with 95 % probability (Bonferroni)."""
        from scipy.special import ndtri

        return float(ndtri(1 - 0.025 / (2 * len(self.scene.leds) * len(self.scene.layout.photodiode_names))))

    def fastest(self, error: float, *, simultaneous: bool | None = None) -> Answer | None:
        """The cheapest answer within an error, in the sense of the tolerance if not said otherwise."""
        every = self.simultaneous if simultaneous is None else simultaneous
        return fastest(self.levels, error, self.coverage_factor if every else None)

    @property
    def lines(self) -> list[str]:
        """The scene lines that select the chosen level and its accuracy."""
        error = self.chosen.relative_error
        return self.chosen.level.lines + ([f"[accuracy] relative_error = {error:.2g}"] if error else [])

    def dataset(self) -> "xr.Dataset":
        """Everything of the levels over level, as a Dataset."""
        import xarray as xr

        data: Variables = {}
        nothing = (np.nan, np.nan, np.nan)
        for which, text in (("reading", "reading at rest"), ("signal", "change by touch, of the largest change")):
            biases = [getattr(one, which) for one in self.levels]
            rows = np.array([nothing if b is None else (b.value, b.stderr, b.bound) for b in biases])
            data |= variable(f"{which}_bias", "level", rows[:, 0], f"bias of the {text}", stderr=rows[:, 1])
            data |= variable(f"{which}_bound", "level", rows[:, 2], f"what no photodiode's bias exceeds, of the {text}")
            noise = [getattr(one, f"{which}_noise") for one in self.levels]
            text = f"standard error after one second of photons, of the {text}"
            data |= variable(f"{which}_noise", "level", noise, text)
        seconds = [one.setup_seconds for one in self.levels]
        data |= variable("first_fixed", "level", seconds, "processor time of an answer without photons", units="s")
        return xr.Dataset(data, {"level": [one.name for one in self.levels]}, self.attributes)


def fastest(levels: Iterable[Level], error: float, coverage: float | None = None) -> Answer | None:
    """The answer of no more than an error that costs least; None where no level gives one.

    The scene itself, or else the full model, stays where none is cheaper beyond the noise of costs.

    coverage : as in `Level.error`.
    """
    needed = [(one, one.photon_seconds(error, coverage)) for one in levels]
    found = [Answer(one, seconds, one.error(seconds, coverage)) for one, seconds in needed if np.isfinite(seconds)]
    least = min(found, key=lambda answer: answer.seconds, default=None)
    for name in (OWN, REFERENCE):
        for answer in found:
            if least and answer.level.name == name and (1 - COST_NOISE) * answer.seconds <= least.seconds:
                return answer
    return least


def best(levels: Iterable[Level], seconds: float, coverage: float | None = None) -> Answer | None:
    """The answer with the least error that costs no more than so many processor seconds; None where none does."""
    found = []
    for one in levels:
        photons = seconds - one.setup_seconds if one.traces else 0.0
        error = one.error(photons, coverage)
        if one.setup_seconds <= seconds and np.isfinite(error):
            found.append(Answer(one, photons, error))
    return min(found, key=lambda answer: answer.error, default=None)


def tradeoff(
    scene: Scene,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    simultaneous: bool = False,
    answer_seconds: float | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Tradeoff:
    """Measure bias and cost of every level of model on a finger scene, against its full model.

    All levels that the photon walk gives are traced with the same random numbers, so that photons which never meet
    what a level leaves out are no part of its error.

    tolerance : error of an answer, as `Tradeoff` has it.
    simultaneous : whether all readings and changes shall stay within it with 95 % probability.
    photons : of each LED in each trace; or
    relative_error : of the full model's trace, all others having as many photons; or
    max_seconds : for all levels together, about; 120 if nothing else is requested.
    answer_seconds : processor time that the answer which is chosen may cost; max_seconds if not given. Where none keeps
        the tolerance in that time it is the best one within it.

    Raises: InputError; NotReachedError, whose result is the Tradeoff as far as it was made, if interrupted.
    """
    check_study(scene, tolerance, "tradeoff", "has one level, itself")
    options, start = TraceOptions(**requested), time.perf_counter()
    study = ModelStudy.of(scene, options, progress=progress)
    measured: list[Level] = []
    unmet = None
    try:
        for level in study.levels():
            measured.append(level)
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error).rstrip('.') or 'interrupted'}; {len(measured)} levels were measured before."
    result = _chosen(study, measured, tolerance, simultaneous, answer_seconds or options.max_seconds)
    result = replace(result, wall_seconds=time.perf_counter() - start)
    if unmet:
        result = replace(result, attributes=result.attributes | {"cut_off": unmet})
        raise NotReachedError(unmet, result=result)
    return result


def _chosen(
    study: ModelStudy, measured: Sequence[Level], tolerance: float, simultaneous: bool, max_seconds: float | None
) -> Tradeoff:
    """What the measured levels come to, with the one to take."""
    # Too few photons may have come for any standard error: then nothing is known to be better than the full model.
    full = Answer(measured[0], study.base.transfer.cpu_seconds, np.inf)
    result = Tradeoff(
        levels=tuple(measured),
        tolerance=tolerance,
        simultaneous=simultaneous,
        max_seconds=max_seconds,
        chosen=full,
        scene=study.full,
        wall_seconds=0.0,
        attributes=study.base.transfer.attributes(),
    )
    coverage = result.coverage_factor if simultaneous else None
    found = result.fastest(tolerance)
    if found is None or (max_seconds is not None and found.seconds > max_seconds):
        found = best(measured, max_seconds or np.inf, coverage) or found or full
    chosen = revised(study.full, found.level.changes or {})
    if found.relative_error:
        accuracy = type(chosen.accuracy)(relative_error=min(found.relative_error, 1.0))
        chosen = chosen.model_copy(update={"accuracy": accuracy})

    def place(level: Level) -> tuple[float, float, bool]:
        # The full model first among those that cost the same.
        seconds = level.setup_seconds + level.photon_seconds(tolerance, coverage)
        return seconds, level.setup_seconds, level.name != REFERENCE

    def from_scene(level: Level) -> Level:
        if level.changes is None:
            return level
        return replace(level, changes=changes_between(study.scene, revised(study.full, level.changes)))

    levels = tuple(from_scene(level) for level in sorted(measured, key=place))
    own = next(level for level in levels if level.name == found.level.name)
    return replace(result, levels=levels, chosen=replace(found, level=own), scene=chosen)
