"""Traces the light of an oximeter until the ratio of ratios is as sharp as was requested."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import NotReachedError
from ...light import ProgressCallback, Transfer, trace
from ...light.tracing import Ending, Trigger, accuracy, run_until
from ...options import TraceOptions
from ...scene import Scene
from ...statistics import seed_of

Array = NDArray[np.float64]

# The first round, whose error tells how many more photons are needed.
FIRST_PHOTONS = 1 << 19
# Rounds have seeds of their own.
_ROUND, MOST_ROUNDS = 41, 40


def trace_for_ratio(
    scene: Scene,
    error_of: Callable[[Transfer], float],
    options: TraceOptions,
    *,
    max_seconds: float | None,
    progress: ProgressCallback | None = None,
) -> Transfer:
    """Light of every LED until an answer's relative error is that of the scene, or of the options.

    error_of : relative standard error of the answer from what was traced; inf where it is not known.
    max_seconds : wall time, in place of that of the scene and the options. [s]

    Raises: NotReachedError with the Transfer so far.
    """
    required = accuracy(scene, options)
    plain = scene.model_copy(update={"accuracy": type(scene.accuracy)()})
    if required.relative_error is None:
        asked = replace(options, relative_error=None, max_seconds=max_seconds, photons=required.photons)
        return replace(trace(plain, progress=progress, **asked.fields), scene=scene)
    begin, cut, rounds = time.perf_counter(), False, list[Transfer]()
    trigger = Trigger(
        target=required.relative_error, first=FIRST_PHOTONS, least=FIRST_PHOTONS // 4, margin=1.15, growth=16
    )

    def left_s() -> float | None:
        return None if max_seconds is None else max_seconds - (time.perf_counter() - begin)

    def needed() -> Iterator[int]:
        yield trigger.first
        while photons := trigger.needed(rounds[-1].photons // len(scene.leds), error_of(rounds[-1])):
            yield photons

    def sample(photons: int) -> None:
        nonlocal cut
        seed = seed_of(options.seed, _ROUND, len(rounds)) >> 1 if rounds else options.seed
        asked = replace(options, seed=seed, relative_error=None, max_seconds=left_s(), photons=photons)
        more, cut = _as_far(plain, asked, progress)
        more = replace(more, scene=scene)
        rounds.append(rounds[-1].merge(more) if rounds else more)

    def is_late(photons: int) -> bool:
        left = left_s()
        return bool(rounds) and (cut or len(rounds) > MOST_ROUNDS or (left is not None and left <= 0))

    ending = run_until(needed(), sample, is_late=is_late)
    found = rounds[-1]
    if ending is not Ending.MET:
        why = _why(found, error_of(found), trigger.target)
        raise NotReachedError(why, result=found, interrupted=ending is Ending.INTERRUPTED)
    return found


def _as_far(scene: Scene, options: TraceOptions, progress: ProgressCallback | None) -> tuple[Transfer, bool]:
    """A trace, or what there is of it, and whether it was cut off."""
    try:
        return trace(scene, progress=progress, **options.fields), False
    except NotReachedError as error:
        if not isinstance(error.result, Transfer):
            raise
        return error.result, True


def _why(found: Transfer, error: float, target: float) -> str:
    photons = found.photons // len(found.leds)
    return (
        f"the trace ended at {photons} photons for each LED with a relative error of {error:.3g} of the best "
        f"photodiode's ratio of ratios, {target:g} requested; allow more time or require less."
    )
