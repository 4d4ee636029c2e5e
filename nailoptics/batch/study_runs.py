"""What a sweep may ask of every scene, and how each of these studies is run on one scene of a batch."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import xarray as xr

from ..errors import as_far_as_reached
from ..light.tracing.store import LightStore
from ..options import TraceOptions
from ..scene import Scene
from ..variables import variable

Answer = tuple[xr.Dataset, int, bool]


@dataclass(frozen=True)
class Study:
    """A study that traces its own light.

    run : its answer for a scene as a dataset whose dimensions all scenes share, its photons, and whether it is as
        accurate as required; options and stores of light are given.
    rows : the dimensions over which the table of a sweep has rows.
    more : how many times as many photons a scene needs as its answer has.
    """

    run: Callable[[Scene, TraceOptions, Sequence[LightStore]], Answer]
    rows: tuple[str, ...]
    more: Callable[[xr.Dataset, Scene, TraceOptions], float]


def _colour(scene: Scene, options: TraceOptions, stores: Sequence[LightStore]) -> Answer:
    """Colours of the nail under each force, and a photograph of each."""
    from ..studies.colour.nail_colour import colour
    from ..studies.colour.pictures import photographs

    # What a scene's readings are to reach is not what its colours are.
    asked = replace(options, relative_error=None).fields
    result, unmet = as_far_as_reached(colour, scene, stores=stores, **asked)
    every = range(result.sizes["state"])
    pictures = photographs(scene, result, states=every, backend=options.backend)
    kept = [name for name, one in result.variables.items() if not {"time", "beat_time", "tile"} & set(one.dims)]
    # Forces and places are the scene's own, and "state" is what a batch calls its progress with a scene.
    found = result[kept].reset_coords(["force_n", "v_mm"]).rename_dims(state="force")
    dims = ("force", "row", "column", "channel")
    found = found.assign(variable("photograph", dims, pictures, "photograph of the finger, sRGB", units="1"))
    return found.assign_attrs(result.attrs), int(result.attrs["photons"]), not unmet


def _more_colour(found: xr.Dataset, scene: Scene, options: TraceOptions) -> float:
    if options.photons:
        return options.photons / found.attrs["photons"]
    parts = found.colour_stderr / scene.colour.tolerance, found.delta_e_2000_stderr / scene.colour.change_tolerance
    return float(max(1.0, *(part.max() ** 2 for part in parts)))


def _oximeter(scene: Scene, options: TraceOptions, stores: Sequence[LightStore]) -> Answer:
    """Calibration, perfusion and errors of an oximeter; what runs over time or saturation is left out."""
    from ..studies.oximetry.oxygen import oximeter

    result, unmet = as_far_as_reached(oximeter, scene, **options.fields)
    kept = [name for name, one in result.data_vars.items() if set(one.dims) <= {"photodiode", "led", "cause"}]
    at = result[["ratio", "ratio_stderr"]].interp(so2=scene.blood.so2).reset_coords(drop=True)
    found = result[kept].drop_dims([d for d in ("so2", "time", "beat_time") if d in result[kept].dims])
    return found.assign(at.data_vars), int(result.attrs["photons"]), not unmet


def _more_oximeter(found: xr.Dataset, scene: Scene, options: TraceOptions) -> float:
    if options.photons:
        return options.photons / found.attrs["photons"]
    error = float((found.ratio_stderr / abs(found.ratio)).min())
    return max(1.0, (error / (options.relative_error or math.inf)) ** 2)


STUDIES: dict[str, Study] = {
    "colour": Study(_colour, ("force", "place"), _more_colour),
    "oximeter": Study(_oximeter, ("photodiode",), _more_oximeter),
}
