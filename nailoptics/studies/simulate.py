"""The main job: touch, blood, traced light, volts, beside the paper's Beer-Lambert (8) and Taylor (9)."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Unpack

import numpy as np
import xarray as xr

from ..errors import InputError, unless_cut_off
from ..hemodynamics.for_scene import blood_model, blood_over_touch
from ..light import DetectedLight, ProgressCallback, Transfer, backend, section
from ..options import Requested, TraceOptions
from ..paper.reduced_optics import OpticsFit, fit_beer_lambert, fit_taylor
from ..scene import Scene, SceneIn, as_scene
from ..sensor.ambient import ambient_in_readings
from ..sensor.drift_motion import MovedLight, worn_light
from ..sensor.front_end import with_fitted_resistors
from ..sensor.volts import read_volts
from ..variables import Estimate, Variables, described
from .prior_uncertainty import read_by_groups, readings_over_priors

COORDINATES = {
    "time": "time from the start of the simulation",
    "led": "LED",
    "photodiode": "photodiode",
    "absorber": "absorbing region or blood zone",
}
# The errors of the fits' constants are taken at so many samples of the touch, evenly apart.
FIT_SAMPLES = 64
# By the prefix of their variables.
REDUCED_OPTICS: dict[str, Callable[..., OpticsFit]] = {"beer_lambert": fit_beer_lambert, "taylor": fit_taylor}


def simulate(
    scene: SceneIn, *, picture: bool = False, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> xr.Dataset:
    """Simulate a touch on a finger scene, from force to the volts of every photodiode.

    picture : whether to trace the light's paths through the finger, too, which the report shows.

    Returns: Dataset over led, photodiode, zone and time with the force, pressures, vessel diameters, blood, detected
    fraction and volts, each estimate with its standard error, the fits of Beer-Lambert (8) and Taylor (9), where the
    light ended, and the uncertainty of readings and their largest change due to the finger's priors. Of more than
    200 000 samples, what there is of each is of single precision.

    Raises: InputError; NotReachedError, whose result is the Dataset as far as the accuracy went.
    """
    scene = as_scene(scene)
    cpu, begin = time.process_time(), time.perf_counter()
    options = TraceOptions(**requested)
    if scene.finger is None:
        raise InputError("simulate needs a [finger] scene; a [phantom] has no blood, use trace for its light.")
    if scene.ambient is not None:
        backend.choose_jit(options.backend, "[ambient]")
    course = blood_over_touch(scene)
    states = course.blood_fraction.values.T
    light, moved, unmet = worn_light(scene, states=states, progress=progress, **requested)
    result = simulate_from(scene, light, course=course, options=options, moved=moved)
    if light.transfer is not None:
        result = result.merge(light.transfer.energy_by_led())
    if picture:
        result = result.merge(section(scene, light, options))
    if scene.priors.spread and light.transfer is not None:
        # A trace that was cut short is followed by none.
        own_traces = scene.priors.own_traces is not False and not unmet
        result = result.merge(_spread(result, light.transfer, options, progress, own_traces=own_traces))
    result.attrs |= {"cpu_seconds": time.process_time() - cpu, "wall_seconds": time.perf_counter() - begin}
    return unless_cut_off(result, unmet)


def simulate_from(
    scene: Scene, light: DetectedLight, *, course: xr.Dataset, options: TraceOptions, moved: Sequence[MovedLight] = ()
) -> xr.Dataset:
    """What `simulate` returns, from light that is already traced and the scene's `blood_over_touch`.

    moved : the light under the sensor elsewhere, where the scene's body moves it.
    """
    hold_n, bandwidth_hz = float(course.force_n[hold_end(course)]), scene.electronics.bandwidth_hz
    false_n = blood_model(scene).false_forces_n(hold_n, bandwidth_hz=bandwidth_hz)
    scene = with_fitted_resistors(scene)
    ambient = ambient_in_readings(scene, options)
    result = course.merge(read_volts(scene, light, course, moved, ambient))
    result = result.merge(_fit_reduced(result, light.transfer)).assign(ambient)
    if ambient:
        volts_stderr = result.volts_stderr.values
        np.hypot(volts_stderr, result.ambient_left_v_stderr.values[:, None], out=volts_stderr)
    if false_n:
        result = result.assign(described(__package__, false_force_n=list(false_n.values())))
        result = result.assign_coords(described(__package__, disturbance=list(false_n)))
    for name, text in COORDINATES.items():
        result[name].attrs = {"long_name": text} | result[name].attrs
    result.attrs = light.attributes | {
        "seed": options.seed,
        "title": "nailoptics: touch to volts",
        "references": "S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
    }
    return result


def _spread(
    result: xr.Dataset,
    transfer: Transfer,
    options: TraceOptions,
    progress: ProgressCallback | None,
    *,
    own_traces: bool,
) -> xr.Dataset:
    """Uncertainty of readings at the start, and of their change to the end of the hold, due to the priors."""
    scene, ends = transfer.scene, [0, hold_end(result)]

    def states(varied: Scene) -> np.ndarray:
        # Of the blood, these are the light's alone.
        optical = {name: getattr(scene.blood, name) for name in ("rest_blood_fraction", "pulp_blood_fraction", "so2")}
        same = varied.blood.model_copy(update=optical) == scene.blood
        course = result if same and varied.touch == scene.touch else blood_over_touch(varied)
        # Eq. (7): blood goes with the blood at rest.
        rest, usual = varied.blood.rest_blood_fraction, scene.blood.rest_blood_fraction
        part = rest / usual if course is result and usual else 1.0
        return np.asarray(part * course.blood_fraction.values[:, ends].T)

    over_priors = readings_over_priors(transfer, states, options=options, own_traces=own_traces, progress=progress)
    return over_priors.dataset(scene)


def hold_end(result: xr.Dataset) -> int:
    """Index of the end of the hold: the last sample whose force is (nearly) as far from the first as any."""
    departure = np.abs(result.force_n.to_numpy() - float(result.force_n[0]))
    return int(np.flatnonzero(departure >= 0.995 * departure.max())[-1])


def _fit_reduced(result: xr.Dataset, transfer: Transfer | None) -> xr.Dataset:
    """Beer-Lambert (8) and Taylor (9), each fitted to the volts of every photodiode over its own zone's diameter.

    transfer : whose photons' noise, shared by all samples, makes the constants' standard errors; NaN without it.
    """
    shape = result.volts.shape[:2]
    # One row for each zone, not for each photodiode.
    diameter_m = [result.capillary_diameter_m.values[zone] for zone in result.zone_of_photodiode.values]
    few = np.unique(np.linspace(0, result.sizes["time"] - 1, FIT_SAMPLES).astype(int))
    replicates_v = None if transfer is None else _replicates_v(result.isel(time=few), transfer)
    notes = np.full(shape, "", dtype=object)
    data: Variables = {}
    for model, fit in REDUCED_OPTICS.items():
        fits = [[fit(*pair) for pair in zip(diameter_m, volts, strict=True)] for volts in result.volts]
        rows = [[fit.predict(width_m) for fit, width_m in zip(of_led, diameter_m, strict=True)] for of_led in fits]
        columns: dict[str, Any] = {f"volts_{model}": np.array(rows, result.volts.dtype)}
        constants = list(fits[0][0].constants)
        errors = np.full((*shape, len(constants)), np.nan)
        for i, j in np.ndindex(shape):
            if replicates_v is not None:
                errors[i, j] = fits[i][j].stderr(diameter_m[j][few], replicates_v[i, j])
            notes[i, j] = notes[i, j] or fits[i][j].remark(errors[i, j])
        for k, name in enumerate(constants):
            values = [[fit.constants[name] for fit in of_led] for of_led in fits]
            columns[f"{model}_{name}"] = Estimate(values, errors[..., k])
        for name in ("residual_rms_v", "residual_max_v"):
            columns[f"{model}_{name}"] = [[getattr(fit, name) for fit in of_led] for of_led in fits]
        data |= described(__package__, **columns)
    data |= described(__package__, fit_note=notes.astype(str))
    return xr.Dataset(data)


def _replicates_v(result: xr.Dataset, transfer: Transfer) -> np.ndarray:
    """Volts by all photons, and without each group of them, (led, photodiode, 1 + groups, time) float. [V]"""
    read = read_by_groups(transfer, transfer.scene, result.blood_fraction.values.T)
    read = np.moveaxis(read, 0, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Volts are proportional to the light, but for what is dark.
        per_fraction = (result.volts_stderr / result.detected_fraction_stderr).values[:, :, None]
        moved = (read / read[:, :, :1] - 1) * result.detected_fraction.values[:, :, None]
    return np.asarray(result.volts.values[:, :, None] + per_fraction * moved)
