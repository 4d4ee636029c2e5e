"""Error against processor time for every level of model, side by side on the user's scene."""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any, Unpack

import numpy as np

from ...errors import NotReachedError
from ...light import ProgressCallback
from ...light.tracing import INTERRUPTED
from ...options import Requested, TraceOptions
from ...scene import Scene
from .levels import OWN, REFERENCE, Bench, Level
from .paired import check_study
from .variants import changes_between, revised

DEFAULT_TOLERANCE = 0.02
# Costs of one level, measured twice, differ by about this part.
COST_NOISE = 0.1


@dataclass(frozen=True)
class Tradeoff:
    """All levels, the cheapest first; the one to take, as a scene; what a batch of so many photons costs per million.

    seconds_to_prove : about how long would tell whether a cheaper level meets the tolerance; None where none could.
    """

    levels: tuple[Level, ...]
    tolerance: float
    chosen: str
    scene: Scene
    seconds_to_prove: float | None
    batches: dict[int, float]
    wall_seconds: float
    attributes: dict[str, Any]

    @property
    def choice(self) -> Level:
        """The cheapest level that provably meets the tolerance."""
        return next(level for level in self.levels if level.name == self.chosen)

    @property
    def front(self) -> list[Level]:
        """The Pareto front: levels than which none is both cheaper and nearer to the reference, cheapest first."""
        out: list[Level] = []
        for one in sorted(self.levels, key=lambda level: (level.cpu_seconds[0], abs(level.reading.value))):
            if np.isfinite(one.reading.value) and (not out or abs(one.reading.value) < abs(out[-1].reading.value)):
                out.append(one)
        return out

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        kept = {name: getattr(self, name) for name in ("tolerance", "chosen", "seconds_to_prove", "wall_seconds")}
        batches = {str(photons): seconds for photons, seconds in self.batches.items()}
        made = {name: self.attributes[name] for name in ("digest", "photons")}
        rows = [asdict(level) | {"lines": level.lines, "front": level in self.front} for level in self.levels]
        return kept | {"lines": self.choice.lines, "batches": batches} | made | {"levels": rows}

    def __str__(self) -> str:
        lines = [
            f"{'level':<24} {'reading off by':>18} {'at most':>8} {'signal off by':>17} {'at most':>8} "
            f"{'CPU s to 1 %':>12} {'0.3 %':>8} {'0.1 %':>8} {'MB':>6}  front"
        ]
        for one in self.levels:
            signal = bound = ""
            if one.signal is not None:
                signal = f"{100 * one.signal.value:+7.2f} +- {100 * one.signal.stderr:4.2f} %"
                bound = f"{one.signal.bound:.1%}"
            memory = "" if one.memory_mb is None else f"{one.memory_mb:.0f}"
            off = f"{100 * one.reading.value:+8.2f} +- {100 * one.reading.stderr:4.2f} %"
            off = off if np.isfinite(one.reading.value) else "not known"
            first, second, third = one.cpu_seconds
            lines.append(
                f"{one.name:<24} {off:>18} {one.reading.bound:>8.1%} {signal:>17} {bound:>8} "
                f"{first:>12.3g} {second:>8.3g} {third:>8.3g} {memory:>6}  {'*' if one in self.front else ''}"
            )
        choice = self.choice
        lines.append(f"Cheapest that provably meets {self.tolerance:.2%} on every photodiode: {choice.name}.")
        if choice.lines:
            lines += ["Scene lines that select it:", *(f"  {line}" for line in choice.lines)]
        else:
            lines.append("The scene is that already: no line needs to change.")
        if self.seconds_to_prove is not None:
            lines.append(f"A cheaper one could be proven with about --max-seconds {self.seconds_to_prove:.0f}.")
        return "\n".join(lines)


def tradeoff(
    scene: Scene,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    progress: ProgressCallback | None = None,
    **requested: Unpack[Requested],
) -> Tradeoff:
    """Measure bias and cost of every level of model on a finger scene, against its full model.

    All levels that the photon walk gives are traced with the same random numbers, so that photons which never meet
    what a level leaves out are no part of its error.

    tolerance : relative error of a reading at rest that a level may have.
    photons : of each LED in each trace; or
    relative_error : of the full model's trace, all others having as many photons; or
    max_seconds : for all levels together, about; 120 if nothing else is requested.

    Raises: InputError; NotReachedError, whose result is the Tradeoff as far as it was made, if interrupted.
    """
    check_study(scene, tolerance, "tradeoff", "has one level, itself")
    options, start = TraceOptions(**requested), time.perf_counter()
    bench = Bench.of(scene, options, tolerance=tolerance, progress=progress)
    measured: list[Level] = []
    batches, unmet = {}, None
    try:
        for level in bench.levels():
            measured.append(level)
        batches = bench.batches()
    except (NotReachedError, KeyboardInterrupt) as error:
        unmet = f"{str(error) or INTERRUPTED} ({len(measured)} levels were measured before)"
    # The full model first among those that cost the same.
    measured.sort(key=lambda level: (level.cpu_seconds[0], level.name != REFERENCE))
    choice, spent = _cheapest(measured), time.perf_counter() - start
    result = Tradeoff(
        levels=tuple(
            replace(one, changes=changes_between(scene, revised(bench.full, one.changes))) for one in measured
        ),
        tolerance=tolerance,
        chosen=choice.name,
        scene=revised(bench.full, choice.changes),
        seconds_to_prove=_to_prove(measured, choice, tolerance, spent),
        batches=batches,
        wall_seconds=spent,
        attributes=bench.base.transfer.attributes(),
    )
    if unmet:
        raise NotReachedError(unmet, result=result)
    return result


def _cheapest(measured: list[Level]) -> Level:
    """The cheapest proven level; the scene itself, else the full model, where that costs as little within noise."""
    proven = {level.name: level for level in measured if level.proven}
    usual, first = proven.get(OWN, proven[REFERENCE]), next(iter(proven.values()))
    return first if first.cpu_seconds[0] < (1 - COST_NOISE) * usual.cpu_seconds[0] else usual


def _to_prove(levels: list[Level], choice: Level, tolerance: float, spent: float) -> float | None:
    """Seconds after which a cheaper level would be proven to meet the tolerance, if it does; None where none could."""
    cheaper = [one.reading for one in levels if not one.proven and one.cpu_seconds[0] < choice.cpu_seconds[0]]
    needed = [
        spent * ((bias.bound - abs(bias.value)) / (tolerance - abs(bias.value))) ** 2
        for bias in cheaper
        if abs(bias.value) + bias.stderr < tolerance < bias.bound < np.inf
    ]
    return min(needed, default=None)
