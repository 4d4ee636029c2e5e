"""Traces the light of an oximeter until the ratio of ratios is as sharp as was requested."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...errors import NotReachedError
from ...light import ProgressCallback, Transfer, trace
from ...light.tracing import accuracy
from ...options import TraceOptions
from ...scene import Scene
from ...statistics import seed_of

Array = NDArray[np.float64]

# The first round, whose error tells how many more photons are needed.
FIRST_PHOTONS = 1 << 19
# Rounds have seeds of their own; a round asks for a little more than the error so far says, which is itself uncertain.
_ROUND, MARGIN, MOST_GROWTH, MOST_ROUNDS = 41, 1.15, 16, 40


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
    begin, photons = time.perf_counter(), FIRST_PHOTONS
    found, cut = _as_far(
        plain, replace(options, relative_error=None, max_seconds=max_seconds, photons=photons), progress
    )
    number, found = 0, replace(found, scene=scene)
    while True:
        number, error = number + 1, error_of(found)
        if error <= required.relative_error:
            return found
        left_s = None if max_seconds is None else max_seconds - (time.perf_counter() - begin)
        if cut or number > MOST_ROUNDS or (left_s is not None and left_s <= 0):
            raise NotReachedError(_why(found, error, required.relative_error), result=found)
        have = found.photons // len(scene.leds)
        needed = have * (MARGIN * (error / required.relative_error) ** 2 - 1) if np.isfinite(error) else have
        photons = int(min(max(needed, FIRST_PHOTONS / 4), MOST_GROWTH * have))
        seed = seed_of(options.seed, _ROUND, number) >> 1
        asked = replace(options, seed=seed, relative_error=None, max_seconds=left_s, photons=photons)
        more, cut = _as_far(plain, asked, progress)
        found = found.merge(replace(more, scene=scene))


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
