"""A parametric sweep from Python: a scene over values of its fields, as one dataset."""

import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, Unpack

import xarray as xr

from ..errors import as_far_as_reached, unless_cut_off
from ..options import Requested
from ..scene import SceneIn
from ..scene.sweep import StudyName, sweep_over
from .folder import open_results
from .run import BatchProgress, run_batch


def sweep(
    scene: SceneIn,
    over: Mapping[str, Any],
    *,
    study: StudyName = "simulate",
    combine: Literal["product", "zip"] = "product",
    folder: str | Path | None = None,
    course: bool = False,
    workers: int | None = None,
    progress: Callable[[BatchProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> xr.Dataset:
    """Run a study of a scene over values of its fields, in several processes, as one dataset.

    Each field is a dimension, called as its last part, such as so2; its values, with their unit, are the coordinate.
    Scenes that differ in absorption only share one trace.

    scene : a scene, a scene file, or the name of a shipped scene.
    over : values by field, such as {"blood.so2": [0.9, 0.97], "leds.ir.flux_mw": [1.0, 2.0]}.
    study : simulate, trace, oximeter or colour.
    combine : product, every combination of values; or zip, the first values of all fields, the second, and so on, along
        the dimension sample.
    folder : where results stay, and a sweep that was ended goes on; a temporary folder if not given.
    course : also what runs over time (volts, blood, force), for which the scenes must share their times.
    workers : processes; one per core, and no more than scenes, if not given.
    progress : called with a `BatchProgress` several times a second.
    requested : seed, backend, relative_error, max_seconds, photons, store; the scheduler of `run_batch`, too.

    Raises: InputError; NotReachedError, whose result is the dataset, where scenes failed, missed their tolerance or
        were not reached.
    """
    planned = sweep_over(scene, over, study=study, combine=combine)
    with ExitStack() as stack:
        place = folder or stack.enter_context(tempfile.TemporaryDirectory(prefix="nailoptics_"))
        how = {"workers": workers, "retry_failed": True, "progress": progress}
        _, unmet = as_far_as_reached(run_batch, planned, place, **how, **requested)
        results = open_results(place, course=course)
    return unless_cut_off(results, unmet)
