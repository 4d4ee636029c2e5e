"""Error against processor time for every level of model, from a formula to an hour of photons, on the user's scene."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack, get_args

import numpy as np

from ...errors import InputError, NotReachedError
from ...light import ProgressCallback
from ...options import Requested, TraceOptions
from ...scene import Scene
from ...variables import Variables, variable
from .answers import COST_NOISE, MORE, Answer, Effort, Judge, Level, best, fastest, in_words, percent
from .levels import OWN, REFERENCE, Bench
from .paired import check_study
from .variants import changes_between, revised

if TYPE_CHECKING:
    import xarray as xr

DEFAULT_TOLERANCE = 0.02
# Errors and processor seconds for which the best answer is told.
ERRORS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
SECONDS = (0.001, 0.1, 1.0, 10.0, 100.0, 1000.0)
# The full model after so many seconds of photons, and until its worst standard error is so small.
FULL_SECONDS, FULL_ERRORS = (0.3, 1.0, 3.0), (0.02, 0.005, 0.001)
# Errors that the sentence for a designer names.
SPOKEN = (0.2, 0.05, 0.01, 0.001)
WORDS = {"reading": "the reading", "signal": "the signal", "both": "reading and signal"}


@dataclass(frozen=True)
class Tradeoff:
    """All levels of model, the one to take, as a scene, and what others would answer in other times.

    levels : the cheapest for the tolerance first, then those that never keep it.
    judge : what counts: the reading at rest, its change by touch, or the worse of the two.
    max_seconds : processor time that an answer may take; None without a limit.
    chosen : the fastest within the tolerance, or the best within the time where that would take longer.
    seconds_to_prove : about how long would tell whether a cheaper level meets the tolerance; None where none could.
    batches : what a batch of so many photons costs per million of them.
    """

    levels: tuple[Level, ...]
    tolerance: float
    judge: Judge
    max_seconds: float | None
    chosen: Answer
    scene: Scene
    seconds_to_prove: float | None
    batches: dict[int, float]
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

    def fastest(self, error: float, effort: Effort = "first", judge: Judge | None = None) -> Answer | None:
        """The cheapest answer within an error; a level that reads another trace is nobody's first answer."""
        levels = [one for one in self.levels if effort != "first" or not one.stored]
        return fastest(levels, error, judge or self.judge, effort=effort, usual=(OWN, REFERENCE))

    def best(self, seconds: float) -> Answer | None:
        """The best first answer within so many processor seconds."""
        return best([one for one in self.levels if not one.stored], seconds, self.judge)

    @property
    def efforts(self) -> list[Answer]:
        """The full model with some photons, few to many."""
        noise = self.reference.reading_noise
        seconds = (*FULL_SECONDS, *((noise / error) ** 2 for error in FULL_ERRORS))
        return [Answer(self.reference, one, self.reference.error(self.judge, one)) for one in sorted(seconds)]

    @property
    def sentence(self) -> str:
        """What a designer needs: how long each error takes."""
        parts: list[str] = []
        for error in SPOKEN:
            found = self.fastest(error)
            how = f"{in_words(found.seconds())} ({found.level.name})" if found else "no level"
            start = "for" if parts else "For"
            parts.append(f"{start} {100 * error:g} %{'' if parts else f' on {WORDS[self.judge]}'}, {how}")
        return f"{'; '.join(parts)}."

    @property
    def lines(self) -> list[str]:
        """The scene lines that select the chosen level and its effort."""
        error = self.chosen.relative_error
        return self.chosen.level.lines + ([f"[accuracy] relative_error = {error:.2g}"] if error else [])

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        kept = ("tolerance", "judge", "max_seconds", "seconds_to_prove", "wall_seconds", "cut_off", "sentence", "lines")
        efforts: tuple[Effort, ...] = get_args(Effort)
        within = {
            str(error): {effort: self._told(self.fastest(error, effort)) for effort in efforts} for error in ERRORS
        }
        return (
            {name: getattr(self, name) for name in kept}
            | {name: self.attributes[name] for name in ("digest", "photons")}
            | {"chosen": self.chosen.level.name, "answer": self._told(self.chosen)}
            | {"levels": [self._row(one) for one in self.levels]}
            | {"full": [self._told(one) for one in self.efforts]}
            | {"fastest_within": within, "best_within": {f"{s:g}": self._told(self.best(s)) for s in SECONDS}}
            | {"batches": {str(photons): seconds for photons, seconds in self.batches.items()}}
        )

    def _row(self, level: Level) -> dict[str, Any]:
        photons = level.photon_seconds(self.judge, self.tolerance)
        row = {name: value for name, value in asdict(level).items() if name != "changes"}
        told = self._told(Answer(level, photons, level.error(self.judge, photons))) if np.isfinite(photons) else None
        return row | {"lines": level.lines, "changes": level.changes or {}, "within_tolerance": told}

    def _told(self, answer: Answer | None) -> dict[str, Any] | None:
        if answer is None:
            return None
        level, photons = answer.level, answer.photon_seconds
        errors = {f"{judge}_error": level.error(judge, photons) for judge in ("reading", "signal")}
        costs = {f"{effort}_seconds": answer.seconds(effort) for effort in get_args(Effort)}
        return {"level": level.name, "photon_seconds": photons, "error": answer.error} | errors | costs

    def dataset(self) -> "xr.Dataset":
        """Everything of the levels over level, and the full model's efforts over effort, as a Dataset."""
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
        for effort, text in (
            ("first", "the first answer"),
            ("states", f"{MORE} more blood states"),
            ("layouts", f"{MORE} more layouts"),
        ):
            costs = [one.cost(effort) for one in self.levels]  # type: ignore[arg-type]
            fixed, each = [c.fixed for c in costs], [c.per_second for c in costs]
            data |= variable(f"{effort}_fixed", "level", fixed, f"processor time of {text} without photons", units="s")
            data |= variable(f"{effort}_per_second", "level", each, f"processor time of {text} per second of photons")
        told = [self._told(one) for one in self.efforts]
        for name, units, text in (
            ("photon_seconds", "s", "processor time of the photons"),
            ("reading_error", "1", "error of the reading at rest, relative"),
            ("signal_error", "1", "error of the change by touch, as a part of the largest change"),
        ):
            values = [one[name] for one in told if one]
            data |= variable(f"full_{name}", "effort", values, f"full model: {text}", units=units)
        names = {"level": [one.name for one in self.levels]}
        return xr.Dataset(data, names, self.attributes | {"judge": self.judge, "sentence": self.sentence})

    def __str__(self) -> str:
        head = f"{'level':<26} {'reading off by':>18} {'at most':>8} {'signal off by':>18} {'at most':>8} "
        lines = [f"Cut off: {self.cut_off}"] if self.cut_off else []
        head += f"{'first answer':>13} {f'{MORE} states':>12} {f'{MORE} layouts':>13}"
        lines.append(head)
        for one in self.levels:
            photons = one.usual_photon_seconds(self.judge, self.tolerance)
            costs = [one.cost(effort).at(photons) for effort in get_args(Effort)]
            shown = [in_words(c) if np.isfinite(c) else "-" for c in costs]
            lines.append(
                f"{one.name:<26} {_percents(one.reading)} {_percents(one.signal)} "
                f"{shown[0]:>13} {shown[1]:>12} {shown[2]:>13}  {one.beforehand or one.remark}"
            )
        percent, what = f"{self.tolerance:.2%}", WORDS[self.judge]
        answer = f"{self.chosen.level.name}, {in_words(self.chosen.seconds())} of processor time"
        if self.chosen.error <= self.tolerance * (1 + 1e-9):
            lines.append(f"Fastest within {percent} on {what} of every photodiode: {answer}.")
        else:
            time_ = in_words(self.max_seconds or 0.0)
            lines.append(f"Best within {time_}: {answer}, to {self.chosen.error:.2%}; {percent} takes longer.")
        lines.append(self.sentence)
        if self.chosen.level.call:
            lines.append(f"No line of a scene selects it: {self.chosen.level.call} gives it.")
        elif self.lines:
            lines += ["Scene lines that select it:", *(f"  {line}" for line in self.lines)]
        else:
            lines.append("The scene is that already: no line needs to change.")
        if self.seconds_to_prove is not None:
            lines.append(f"A cheaper one could be proven with about --max-seconds {self.seconds_to_prove:.0f}.")
        return "\n".join(lines)


def _percents(bias: Any) -> str:
    if bias is None:
        return f"{'not measured':>18} {'':>8}"
    text = percent(bias.value, bias.stderr) if np.isfinite(bias.value) else "not known"
    return f"{text:>18} {bias.bound:>8.1%}"


def tradeoff(
    scene: Scene,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    judge: Judge = "both",
    answer_seconds: float | None = None,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Tradeoff:
    """Measure bias and cost of every level of model on a finger scene, against its full model.

    All levels that the photon walk gives are traced with the same random numbers, so that photons which never meet
    what a level leaves out are no part of its error.

    tolerance : error of the worst photodiode, bias and standard error together, that an answer may have.
    judge : whether that is an error of the reading at rest, of the signal (its change by touch, as a part of the
        largest change), or of both.
    photons : of each LED in each trace; or
    relative_error : of the full model's trace, all others having as many photons; or
    max_seconds : for all levels together, about; 120 if nothing else is requested.
    answer_seconds : processor time that the answer which is chosen may cost; max_seconds if not given. Where none keeps
        the tolerance in that time it is the best one within it.

    Raises: InputError; NotReachedError, whose result is the Tradeoff as far as it was made, if interrupted.
    """
    check_study(scene, tolerance, "tradeoff", "has one level, itself")
    if judge not in get_args(Judge):
        raise InputError(f'judge = "{judge}" is none; choose from {", ".join(get_args(Judge))}.')
    options, start = TraceOptions(**requested), time.perf_counter()
    bench = Bench.of(scene, options, progress=progress)
    measured: list[Level] = []
    batches, unmet = {}, None
    try:
        for level in bench.levels():
            measured.append(level)
        batches = bench.batches()
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error).rstrip('.') or 'interrupted'}; {len(measured)} levels were measured before."
    result = _chosen(
        scene, bench, measured, tolerance, judge, answer_seconds or options.max_seconds, time.perf_counter() - start
    )
    result = replace(result, batches=batches)
    if unmet:
        result = replace(result, attributes=result.attributes | {"cut_off": unmet})
        raise NotReachedError(unmet, result=result)
    return result


def _chosen(
    scene: Scene,
    bench: Bench,
    measured: Sequence[Level],
    tolerance: float,
    judge: Judge,
    max_seconds: float | None,
    spent: float,
) -> Tradeoff:
    """What the measured levels come to: the one to take, and what could still be proven."""
    offered = [level for level in measured if not level.stored]
    found = fastest(offered, tolerance, judge, usual=(OWN, REFERENCE))
    if found is None or (max_seconds is not None and found.seconds() > max_seconds):
        found = best(offered, max_seconds or np.inf, judge) or found
    if found is None:
        # Too few photons were seen for any standard error; nothing is known to be better than the full model.
        found = Answer(measured[0], bench.base.transfer.cpu_seconds, np.inf)
    chosen = revised(bench.full, found.level.changes or {})
    if found.relative_error:
        accuracy = type(chosen.accuracy)(relative_error=min(found.relative_error, 1.0))
        chosen = chosen.model_copy(update={"accuracy": accuracy})

    def lines_for(level: Level) -> Level:
        if level.changes is None:
            return level
        return replace(level, changes=changes_between(scene, revised(bench.full, level.changes)))

    # The full model first among those that cost the same.
    def place(level: Level) -> tuple[float, float, bool]:
        return level.seconds_within(judge, tolerance), level.first.fixed, level.name != REFERENCE

    order = sorted(measured, key=place)
    levels = {level.name: lines_for(level) for level in order}
    return Tradeoff(
        levels=tuple(levels.values()),
        tolerance=tolerance,
        judge=judge,
        max_seconds=max_seconds,
        chosen=replace(found, level=levels[found.level.name]),
        scene=chosen,
        seconds_to_prove=_to_prove(offered, found, tolerance, judge, spent),
        batches={},
        wall_seconds=spent,
        attributes=bench.base.transfer.attributes(),
    )


def _to_prove(levels: Sequence[Level], chosen: Answer, tolerance: float, judge: Judge, spent: float) -> float | None:
    """Seconds after which a level that would then be chosen would be proven, if it keeps the tolerance; None if none.

    Its bias may come out as it was measured; the bound on it, that far above, shrinks with the root of the time.
    """
    needed = []
    for level in levels:
        if level.bias(judge) <= tolerance or not np.isfinite(level.bias(judge)):
            continue
        counted = [bias for bias, _ in level.judged(judge) if bias is not None]
        likely = max(abs(bias.value) + bias.stderr for bias in counted)
        reading, signal = (bias and replace(bias, bound=abs(bias.value)) for bias in (level.reading, level.signal))
        answer = fastest([replace(level, reading=reading, signal=signal)], tolerance, judge)
        if likely < tolerance and answer and answer.seconds() < (1 - COST_NOISE) * chosen.seconds():
            shrink = ((b.bound - abs(b.value)) / (tolerance - abs(b.value)) for b in counted if b.bound > tolerance)
            needed.append(spent * max(shrink) ** 2)
    return min(needed, default=None)
