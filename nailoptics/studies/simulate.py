"""The main job: touch, blood, traced light, volts, beside the paper's Beer-Lambert (8) and Taylor (9)."""

import logging
from dataclasses import replace
from typing import Unpack

import numpy as np
import xarray as xr

from ..assets import read_toml
from ..errors import InputError, NotReachedError, unless_cut_off
from ..hemodynamics.for_scene import blood_model, blood_over_touch, hold_end
from ..light import ProgressCallback, Transfer, backend, section
from ..options import Requested, TraceOptions
from ..paper.reduced_optics import FIT_SAMPLES, fit_reduced_optics
from ..scene import Scene, SceneIn, as_scene
from ..sensor.volts import WornLight, read_volts, replicates_v, worn_light
from ..variables import stopwatch
from .prior_uncertainty import ReadingUncertainty, readings_over_priors

log = logging.getLogger(__name__)


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
    run_time, options = stopwatch(), TraceOptions(**requested)
    if options.max_seconds and scene.priors.spread and not (options.relative_error or options.photons):
        requested["max_seconds"] = options.max_seconds / 2  # the other half is for the priors
    if scene.finger is None:
        raise InputError("simulate needs a [finger] scene; a [phantom] has no blood, use trace for its light.")
    if scene.ambient is not None:
        backend.choose_jit(options.backend, "[ambient]")
    course = blood_over_touch(scene, bandwidth_hz=scene.electronics.bandwidth_hz)
    light, unmet = worn_light(scene, states=course.blood_fraction.values.T, progress=progress, **requested)
    result, transfer = simulate_from(light, course=course, seed=options.seed), light.in_place.transfer
    if transfer is not None:
        result = result.merge(transfer.energy_by_led())
    if picture:
        result = result.merge(section(scene, light.in_place, options))
    if scene.priors.spread and transfer is not None:
        # A trace that was cut short is followed by none.
        own_traces = scene.priors.own_traces is not False and not unmet
        if options.max_seconds:
            left_s = options.max_seconds - run_time()["wall_seconds"]
            options = replace(options, max_seconds=max(left_s, np.finfo(float).tiny))
        spread = _spread(course, transfer, options, progress, own_traces)
        result = result.merge(spread.dataset(scene))
        if own_traces and (names := ", ".join(prior.name for prior in spread.untraced)):
            interrupted = spread.why.startswith("interrupted")
            unmet = NotReachedError(f"{spread.why}; priors not traced: {names}.", interrupted=interrupted)
    if (full := result.saturated.any(("led", "time")).values).any():
        how = 'lower leds.flux_mw or electronics.feedback_ohm ("auto" fits it)'
        log.warning("saturated: %s; %s.", ", ".join(result.photodiode.values[full]), how)
    result.attrs |= run_time()
    return unless_cut_off(result, unmet)


def simulate_from(light: WornLight, *, course: xr.Dataset, seed: int) -> xr.Dataset:
    """What `simulate` returns, from light that is already traced and the scene's `blood_over_touch`."""
    result, transfer = course.merge(read_volts(light, course)), light.in_place.transfer
    # Where errors of the constants are taken.
    few = np.unique(np.linspace(0, result.sizes["time"] - 1, FIT_SAMPLES).astype(int))
    replicates = None if transfer is None else replicates_v(result.isel(time=few), transfer)
    result = result.merge(fit_reduced_optics(result, few, replicates))
    if light.ambient_a is not None:
        volts_stderr = result.volts_stderr.values
        of_ambient = np.where(result.saturated, 0.0, result.ambient_left_v_stderr.values[:, None])
        np.hypot(volts_stderr, of_ambient, out=volts_stderr)
    for name in ("led", "photodiode", "absorber"):
        result[name].attrs = {"long_name": read_toml("axes.toml")[name]} | result[name].attrs
    result.attrs = light.in_place.attributes | {
        "seed": seed,
        "title": "nailoptics: touch to volts",
        "references": "S. A. Mascaro, H. H. Asada, IEEE Trans. Robotics and Automation 17(5), 2001",
    }
    return result


def _spread(
    course: xr.Dataset, transfer: Transfer, options: TraceOptions, progress: ProgressCallback | None, own_traces: bool
) -> ReadingUncertainty:
    """Uncertainty of readings at the start, and of their change to the end of the hold, due to the priors."""
    scene, ends = transfer.scene, [0, hold_end(course)]
    # These are the light's alone, and that of capillaries at rest where there are no arterioles beside them.
    names = ["rest_blood_fraction", "pulp_blood_fraction", "so2"][blood_model(scene).arterioles is not None :]
    if scene.blood.oxygen_balance:  # which arterial blood feeds
        names.remove("so2")

    def states(varied: Scene) -> tuple[np.ndarray, np.ndarray | None]:
        optical = {name: getattr(scene.blood, name) for name in names}
        same = varied.blood.model_copy(update=optical) == scene.blood and varied.touch == scene.touch
        # Eq. (7): blood goes with the blood at rest. That of another value, percents off, is known to 2e-5.
        rest, usual = varied.blood.rest_blood_fraction, scene.blood.rest_blood_fraction
        part = rest / usual if same and usual else 1.0
        blood = course if same else blood_over_touch(varied, rtol=1e-4)
        so2 = blood.so2.values[:, ends].T if scene.blood.oxygen_balance else None
        return part * blood.blood_fraction.values[:, ends].T, so2

    return readings_over_priors(transfer, states, options=options, own_traces=own_traces, progress=progress)
