"""Either engine behind one face: the light of a finger over a course of blood states, and readings at rest."""

import json
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import product
from typing import Any, Unpack

import numpy as np
import xarray as xr

from .. import geometry
from ..errors import InputError, as_far_as_reached, unless_cut_off
from ..geometry import Geometry
from ..options import Requested, TraceOptions
from ..scene import Led, Scene
from ..statistics import quotient, upper_limit_95
from ..variables import described, from_record, stopwatch, to_record
from . import backend as backends, optics
from .identity import led_digest, light_scene
from .tracing import ProgressCallback, accuracy, trace
from .tracing.store import LightStore, led_cache_key, load_or_compute
from .transfer import Transfer, mean_of_leds, photodiode_names, provenance
from .transfer.series import ReadingSeries, readings_over_states

log = logging.getLogger(__name__)

SECTION_MM = 0.05
SECTION_PHOTONS = 1 << 15
# The picture ends behind the nail's root and below the finger's middle, where little light comes. [mm]
SECTION_FROM_Y_MM, SECTION_FROM_Z_MM = -14.0, -9.0
# Air that it shows in front of the fingertip and above the board. [mm]
AIR_BEYOND_TIP_MM, AIR_ABOVE_BOARD_MM = 0.5, 0.3
# Photons of a rough trace, of all LEDs and, at least, of each: readings to some 5 %.
ROUGH_PHOTONS, LEAST_ROUGH_PHOTONS = 1 << 16, 1 << 12
# The stock integrator answers for states one by one, so it stops at this relative error even if less is required.
VOLPATH_RELATIVE_ERROR = 0.05


@dataclass(frozen=True)
class DetectedLight:
    """Detected light of a finger scene, whatever engine traced it.

    readings_at : reads a course of blood states, (t, zones) float -> ReadingSeries.
    mean_path, mean_path_stderr : (led, photodiode, absorber) float at rest; NaN where the engine records none. [mm]
    absorbers : their names. transfer : the trace behind it; None where the engine keeps none.
    """

    readings_at: Callable[[np.ndarray], ReadingSeries]
    mean_path: np.ndarray
    mean_path_stderr: np.ndarray
    absorbers: tuple[str, ...]
    attributes: dict[str, Any]
    transfer: Transfer | None = None

    def over(self, scene: Scene, course: xr.Dataset) -> ReadingSeries:
        """The readings over the course of a scene's blood, whose saturations are its own where its oxygen is balanced.

        course : of `blood_over_touch`.
        """
        blood = course.blood_fraction.values
        if not scene.blood.oxygen_balance:
            return self.readings_at(blood.T)
        states = [optics.equivalent_blood(scene, led, blood, course.so2.values).T for led in scene.leds]
        by_led = [self.readings_at(state) for state in states]
        columns = ([getattr(read, one.name)[i] for i, read in enumerate(by_led)] for one in fields(ReadingSeries))
        return ReadingSeries(*map(np.stack, columns))


@dataclass(frozen=True)
class RestReadings:
    """Readings of every LED and photodiode at rest, and where the light went (None by volpath).

    The standard error of a reading is NaN where it rests on fewer than 25 effective photons. Seconds count everything,
    from the scene to its readings. reused : whether all photons came from the store.
    """

    readings: list[dict[str, Any]]
    energy: dict[str, dict[str, float]] | None
    photons: int
    engine: str
    backend: str
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    reused: bool = False
    transfer: Transfer | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything but the transfer, and of it where in the scene the absorbed light ended."""
        summary = {name: value for name, value in vars(self).items() if name != "transfer"}
        if self.transfer is not None:
            summary |= {"absorbed": self.transfer.absorbed(), "note": self.transfer.shared_error}
        return summary


def open_light(
    scene: Scene, *, states: np.ndarray, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> DetectedLight:
    """Trace a finger scene with the engine that it names, or the best that this machine can run.

    states : (t, zones) float. The blood states that will be read; volpath traces three that span them.

    Raises: NotReachedError with the DetectedLight so far as result.
    """
    options, engine = _options(scene, requested)
    for line in unseen_leds(scene):
        log.warning(line)
    if engine == "volpath":
        return _light_by_volpath(scene, np.asarray(states, float), options, progress)
    transfer, unmet = as_far_as_reached(trace, scene, progress=progress, **options.fields)
    rest = transfer.at()
    _warn_of_few_photons(rest, "detected no light or too few photons to estimate a standard error")
    return unless_cut_off(light_of(transfer, rest=rest), unmet)


def unseen_leds(scene: Scene) -> list[str]:
    """LEDs along whose line a photodiode's responsivity is 0, which its table may not reach, a line for each."""
    return [
        f'photodiode "{diode.name}" does not see LED "{led.name}" of {led.wavelength_nm:g} nm: its responsivity '
        f"reaches from {diode.responsivity[0][0]:g} to {diode.responsivity[-1][0]:g} nm; add rows if it sees more"
        for diode, led in product(scene.photodiodes, scene.leds)
        if diode.responsivity and not optics.line_response(led, diode).any()
    ]


def read_rest(
    scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> RestReadings:
    """Trace a scene and read it at rest; raises NotReachedError with the RestReadings so far as result."""
    run_time = stopwatch()
    options, engine = _options(scene, requested)
    if engine == "volpath":
        from .reference import readings as volpath

        blood = scene.blood.rest_blood_fraction
        rest = None if scene.phantom is not None else np.full((1, scene.zone_count), blood)
        traced, rows = volpath.read_leds(scene, options, progress, rest), list[dict[str, Any]]()
        for led, r in zip(scene.leds, traced, strict=True):
            values = zip(photodiode_names(scene), r.fraction[:, 0], r.fraction_stderr[:, 0], strict=True)
            rows += [_row(led, *value, r.paths) for value in values]
        energy = mean_of_leds([r.energy for r in traced if r.energy]) if scene.phantom is not None else None
        photons, unmet = sum(r.paths for r in traced), volpath.unmet(traced)
        result = RestReadings(rows, energy, photons, "volpath", options.backend)
    else:
        transfer, unmet = as_far_as_reached(trace, scene, progress=progress, **options.fields)
        result = rest_of(transfer)
    return unless_cut_off(replace(result, **run_time()), unmet)


def _options(scene: Scene, requested: Requested) -> tuple[TraceOptions, str]:
    """How a scene is traced, on the backend that is there and as far as it says, and the engine that traces it; warns
    where volpath cannot run on the backend and takes scalar."""
    options = TraceOptions(**requested)
    chosen = backends.choose(options.backend, volpath=scene.light.engine == "volpath")
    if chosen.advice == backends.ADVICE["volpath"]:
        log.warning(chosen.advice)
    if engine_for(scene, chosen) == "volpath" and not chosen.jit and any(led.fwhm_nm for led in scene.leds):
        log.warning("the scalar backend traces an LED's line at its peak alone")
    required = accuracy(scene, options).model_dump()
    return replace(options, backend=chosen.name, **required), engine_for(scene, chosen)


def engine_for(scene: Scene, chosen: backends.Backend) -> str:
    """The engine that traces a scene on a backend, "photons" or "volpath"; raises InputError where the scene asks for
    photons and the backend compiles no kernels."""
    if scene.light.engine == "photons" and not chosen.jit:
        raise InputError(
            f'light.engine = "photons" needs a backend that compiles kernels (llvm, cuda or metal), and {chosen.name} '
            'compiles none; take another one (nailoptics doctor shows which work), or engine = "volpath".'
        )
    return "volpath" if scene.light.engine == "volpath" or not chosen.jit else "photons"


def light_of(transfer: Transfer, *, rest: xr.Dataset | None = None) -> DetectedLight:
    """A Transfer as the light of a finger scene; rest is the transfer's readings at rest, if they are there."""
    rest = transfer.at() if rest is None else rest
    unknown = np.isnan(rest.detected_fraction_stderr.values)
    relative = quotient(rest.detected_fraction_stderr, rest.detected_fraction)

    def readings_at(states: np.ndarray) -> ReadingSeries:
        readings = readings_over_states(transfer, states)
        # A sum of no photons, or of one, has no spread, which is not the same as no error.
        readings.stderr[unknown] = readings.change_stderr[unknown] = np.nan
        return readings

    made: dict[str, Any] = {"cpu_seconds": transfer.cpu_seconds, "wall_seconds": transfer.wall_seconds}
    made |= {"accuracy_reached": _reached(relative), "reused": int(transfer.reused)}
    paths = rest.mean_path_mm.values, rest.mean_path_mm_stderr.values, transfer.absorbers
    return DetectedLight(readings_at, *paths, attributes=transfer.attributes() | made, transfer=transfer)


def rough_readings(scene: Scene, states: np.ndarray) -> ReadingSeries:
    """Detected fractions of a finger scene in blood states (t, zones) by a short trace, the same for every command;
    raises InputError without a backend that compiles kernels."""
    photons = max(ROUGH_PHOTONS // len(scene.leds), LEAST_ROUGH_PHOTONS)
    transfer, _ = as_far_as_reached(trace, scene, photons=photons, seed=0)
    return light_of(transfer).readings_at(states)


def _warn_of_few_photons(rest: xr.Dataset, what: str) -> None:
    """Warn of readings that have too few photons for a standard error."""
    few = np.isnan(rest.detected_fraction_stderr.values).any(0)
    if few.any():
        log.warning("%s %s; trace more photons", ", ".join(sorted(rest.photodiode.values[few])), what)


def _reached(relative: np.ndarray) -> str:
    """The largest relative standard error at rest, in words; NaN or infinite where nothing was detected."""
    worst = float(np.max(relative))
    if not math.isfinite(worst):
        return "some photodiode detected no light or too few photons"
    return f"relative standard error of every reading at rest at most {worst:.2g}"


def section(scene: Scene, light: DetectedLight | None = None, options: TraceOptions = TraceOptions()) -> xr.Dataset:  # noqa: B008
    """The picture of the finger cut lengthwise at u = 0: regions and, by the photons engine, each LED's path density.

    The light is shown as it goes through usual blood, from the store if it is there.

    light : that of the scene; without it, the regions alone.
    """
    if light is None or light.transfer is None:
        return _section(scene, options, geometry.build(scene))
    options = replace(options, backend=backends.choose(options.backend).name)
    key = led_cache_key(scene, 0, seed=options.seed, backend=options.backend, what="section")
    key |= {"leds": [led_digest(scene, led) for led in range(len(scene.leds))]}
    stores = LightStore.of_command(options)
    entries, traced = [store.entry(key) for store in stores], lambda: to_record(_section(light_scene(scene), options))
    result, _ = load_or_compute(entries, "section", traced, from_record)
    # Its light knows no names.
    result.section_region.attrs["regions"] = json.dumps(geometry.region_names(scene.layout))
    return result


def _section(scene: Scene, options: TraceOptions, finger: Geometry | None = None) -> xr.Dataset:
    """The section: regions and each LED's path density, which is traced; finger : what is shown without light."""
    tracer = None
    if finger is None:
        # Light from the store needed no Mitsuba so far.
        backends.activate_jit(options.backend, "the picture of the light")
        from .walk.finger import FingerTracer
        from .walk.tallies import Section

        tracer = FingerTracer(scene)
        finger = tracer.geometry
    low, high = np.asarray(finger.bounds_mm)
    y = np.arange(max(low[1], SECTION_FROM_Y_MM), high[1] + AIR_BEYOND_TIP_MM, SECTION_MM)
    z = np.arange(max(low[2], SECTION_FROM_Z_MM), high[2] + AIR_ABOVE_BOARD_MM, SECTION_MM)
    about = {"long_name": "region along the section at u = 0", "regions": json.dumps(finger.regions)}
    regions = finger.section(y, z).astype(np.int16)
    data: dict[str, Any] = {"section_region": (("section_y", "section_z"), regions, about)}
    if tracer:
        density = []
        for led in range(len(scene.leds)):
            section = Section(y, z)
            tracer.walk(led, photons=SECTION_PHOTONS, seed=options.seed, section=section)
            density.append(section.density(SECTION_PHOTONS))
        data |= described(__package__, path_density=density)
    return xr.Dataset(data | described(__package__, section_y=y, section_z=z))


def _light_by_volpath(
    scene: Scene, states: np.ndarray, options: TraceOptions, progress: ProgressCallback | None
) -> DetectedLight:
    """Trace rest and one changed state per zone; between them each zone dims as in Beer-Lambert (8)."""
    from .reference import readings as volpath

    if scene.zone_count > 2:
        why = f'and the scene has {scene.zone_count}; take light.engine = "photons", or two zones.'
        raise InputError(f"blood: volpath reads three blood states, enough for two zones, {why}")
    target = max(options.relative_error or 0.0, VOLPATH_RELATIVE_ERROR)
    options = replace(options, relative_error=target, photons=None)
    log.warning(
        "volpath traces three blood states to a relative error of %g and takes Beer-Lambert (8) between them", target
    )
    run_time, corners = stopwatch(), volpath.corner_states(states)
    traced = volpath.read_leds(scene, options, progress, corners)
    relative = np.stack([quotient(reading.fraction_stderr[:, 0], reading.fraction[:, 0]) for reading in traced])
    absorbers = optics.absorbers(scene)
    no_path = np.full((*relative.shape, len(absorbers)), np.nan)
    made: dict[str, Any] = {"engine": "volpath", "backend": options.backend, "seeds": str(options.seed)}
    made = provenance(scene, photons=sum(reading.paths for reading in traced), **made) | run_time()
    made["accuracy_reached"] = _reached(relative) + "; three blood states traced, Beer-Lambert (8) between them"
    readings_at = partial(volpath.between, traced, corners)
    return unless_cut_off(DetectedLight(readings_at, no_path, no_path, absorbers, made), volpath.unmet(traced))


def rest_of(transfer: Transfer) -> RestReadings:
    """The readings of a trace at rest."""
    rest = transfer.at()
    _warn_of_few_photons(rest, "detected too few photons to estimate a standard error")
    rows = []
    for i, led in enumerate(transfer.scene.leds):
        for j, photodiode in enumerate(transfer.photodiodes):
            at = {"led": i, "photodiode": j}
            stderr = rest.detected_fraction_stderr[at]
            row = _row(led, photodiode, rest.detected_fraction[at], stderr, transfer.traces[i].photons)
            for name in ("mean_path_mm", "mean_path_mm_stderr"):
                paths = zip(transfer.absorbers, rest[name][at].values.tolist(), strict=True)
                row[name.replace("_mm_stderr", "_stderr_mm")] = dict(paths)
            rows.append(row)
    made = {name: getattr(transfer, name) for name in ("photons", "engine", "backend", "reused")}
    return RestReadings(rows, transfer.energy(), **made, transfer=transfer)


def _row(led: Led, photodiode: str, fraction: Any, stderr: Any, photons: int) -> dict[str, Any]:
    """One reading, of so many photons emitted, without the paths, which only the photons engine records."""
    row = {"led": led.name, "photodiode": photodiode, "wavelength_nm": led.wavelength_nm}
    row |= {"detected_fraction": float(fraction), "stderr": float(stderr)}
    row |= {"mean_path_mm": {}, "mean_path_stderr_mm": {}}
    return row | {"upper_limit_95": upper_limit_95(photons)} if fraction == 0 else row
