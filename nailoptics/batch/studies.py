"""The studies that a sweep may run on every scene; each answers with a dataset, whose dimensions all scenes share."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from ..errors import InputError, as_far_as_reached
from ..light import Transfer, trace
from ..light.detect import light_of
from ..light.tracing.store import LightStore
from ..options import TraceOptions
from ..scene import Scene
from ..scene.sweep import StudyName
from ..variables import Variable, variable

PAIR = ("led", "photodiode")
# The dataset, its photons per LED, and whether it is as accurate as required.
Answer = tuple[xr.Dataset, int, bool]


@dataclass(frozen=True)
class Study:
    """One study.

    run : its answer for a scene, with options, stores in which its light is looked for and, in the first, stored, and
        the phantom that is traced in its place, if any.
    rows : the dimensions over which the table of a sweep has rows.
    own_accuracy : whether its default accuracy is not that of readings.
    """

    run: Callable[[Scene, TraceOptions, Sequence[LightStore], Scene | None], Answer]
    rows: tuple[str, ...] = PAIR
    own_accuracy: bool = False


def relative_error(dataset: xr.Dataset) -> float:
    """Largest relative standard error at rest; inf where it is unknown."""
    if "detected_fraction_rest" not in dataset:
        return math.inf
    fraction, stderr = dataset["detected_fraction_rest"].values, dataset["detected_fraction_rest_stderr"].values
    if np.any(fraction <= 0) or np.any(np.isnan(stderr)):
        return math.inf
    return float(np.max(stderr / fraction, initial=0.0))


def _simulate(scene: Scene, options: TraceOptions, stores: Sequence[LightStore], traced: Scene | None) -> Answer:
    """The simulated touch of a finger, or the readings of a phantom."""
    if scene.phantom is not None:
        return _trace(scene, options, stores, traced)
    from ..hemodynamics.for_scene import blood_over_touch
    from ..sensor.ambient import scene_ambient_a
    from ..sensor.volts import WornLight, with_fitted_resistors
    from ..studies.simulate import simulate_from

    transfer, photons, reached = _transfer(scene, options, stores, None)
    light = WornLight(with_fitted_resistors(scene), light_of(transfer), scene_ambient_a(scene, options))
    course = blood_over_touch(scene, bandwidth_hz=scene.electronics.bandwidth_hz)
    return _summarised(simulate_from(light, course=course, seed=options.seed)), photons, reached


def _trace(scene: Scene, options: TraceOptions, stores: Sequence[LightStore], traced: Scene | None) -> Answer:
    """Readings at rest, mean paths and where the light ended."""
    transfer, photons, reached = _transfer(scene, options, stores, traced)
    rest, energy = transfer.at(), transfer.energy()
    at_rest = {f"detected_fraction{end}": f"detected_fraction_rest{end}" for end in ("", "_stderr")}
    kept = rest[[*at_rest, "effective_photons", "mean_path_mm", "mean_path_mm_stderr", "wavelength_nm"]].rename(at_rest)
    kept.detected_fraction_rest.attrs["ancillary_variables"] = "detected_fraction_rest_stderr"
    value, stderr = ([part[name] for part in energy.values()] for name in ("value", "stderr"))
    shares = variable("energy", "part", value, "share of the emitted power", stderr=stderr)
    known = {"traced_mu_a_per_mm": transfer.traces[0].mu_a.tolist()} if traced else {}
    return kept.assign(shares).assign_coords(part=list(energy)).assign_attrs(known), photons, reached


def _transfer(
    scene: Scene, options: TraceOptions, stores: Sequence[LightStore], traced: Scene | None
) -> tuple[Transfer, int, bool]:
    """A scene's light, its photons per LED, and whether it is as accurate as required."""
    if scene.light.engine == "volpath":
        raise InputError('light.engine = "volpath": a batch needs the photons engine; use simulate or trace.')
    transfer, unmet = as_far_as_reached(trace, scene, stores=stores, traced=traced, **options.fields)
    if unmet and options.max_seconds is None:  # more time would not help
        raise unmet
    return transfer, min(led.photons for led in transfer.traces), not unmet


def _summarised(result: xr.Dataset) -> xr.Dataset:
    """A simulated touch with the numbers that a sweep is about: at the start, and where it changes most."""
    start, peak = result.isel(time=0), result.isel(time=abs(result.volts_change).argmax("time"))

    def of(moment: xr.Dataset, source: str, name: str, text: str) -> dict[str, Variable]:
        values, stderr = moment[source].transpose(*PAIR), None
        if f"{source}_stderr" in moment:
            stderr = moment[f"{source}_stderr"].transpose(*PAIR).values
        return variable(name, PAIR, values.values, text, units=values.attrs["units"], stderr=stderr)

    return result.assign(
        of(start, "detected_fraction", "detected_fraction_rest", "detected fraction at the start")
        | of(start, "volts", "volts_start", "voltage at the start")
        | of(peak, "volts_change", "volts_change_peak", "largest change of the voltage")
        | of(peak, "volts_noise_rms", "volts_noise_peak", "electronic noise at the largest change, rms")
        | variable("saturated_ever", PAIR, result.saturated.any("time").values, "converter at its limit at any time")
    )


def _colour(scene: Scene, options: TraceOptions, stores: Sequence[LightStore], traced: Scene | None) -> Answer:
    """Colours of the nail under each force, and a photograph of each."""
    from ..studies.colour.nail_colour import colour, photographs

    # The accuracy of a scene's readings is not that of its colours.
    result, unmet = as_far_as_reached(colour, scene, stores=stores, **replace(options, relative_error=None).fields)
    pictures = photographs(scene, result, states=range(result.sizes["state"]), backend=options.backend)
    names = [name for name, variable in result.variables.items() if "tile" not in variable.dims]
    # Forces and places are the scene's own, and "state" is what a batch calls its progress with a scene.
    answer = result[names].reset_coords(["force_n", "v_mm"]).rename_dims(state="force")
    dims = ("force", "row", "column", "channel")
    answer = answer.assign(variable("photograph", dims, pictures, "photograph of the finger, sRGB", units="1"))
    return answer.assign_attrs(result.attrs), int(result.attrs["photons"]), not unmet


def _oximeter(scene: Scene, options: TraceOptions, stores: Sequence[LightStore], traced: Scene | None) -> Answer:
    """Ratio of ratios, perfusion and errors of an oximeter; what runs over time or saturation is left out."""
    from ..studies.oximetry.oxygen import oximeter

    result, unmet = as_far_as_reached(oximeter, scene, stores=stores, **options.fields)
    names = [name for name, one in result.data_vars.items() if set(one.dims) <= {"photodiode", "led", "cause"}]
    return result[names], int(result.attrs["photons"]), not unmet


STUDIES: dict[StudyName, Study] = {
    "simulate": Study(_simulate),
    "trace": Study(_trace),
    "colour": Study(_colour, ("force", "place"), own_accuracy=True),
    "oximeter": Study(_oximeter, ("photodiode",), own_accuracy=True),
}
