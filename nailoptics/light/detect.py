"""Either engine behind one face: the light of a finger over a course of blood states, and readings at rest."""

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Unpack

import numpy as np
import xarray as xr

from .. import geometry
from ..errors import InputError, NotReachedError
from ..geometry import Geometry
from ..options import Requested, TraceOptions
from ..scene import Accuracy, Led, Scene
from ..variables import variable
from . import backend as backends
from . import optics
from .course import Course, course
from .tracing import ProgressCallback, accuracy, trace
from .transfer import FEW_PHOTONS, Transfer, mean_of_leds, photodiode_names, provenance
from .volpath import led_readings as volpath

log = logging.getLogger(__name__)

SECTION_MM = 0.05
SECTION_PHOTONS = 1 << 17
# The picture ends behind the nail's root and below the finger's middle, where little light comes. [mm]
SECTION_FROM_Y_MM, SECTION_FROM_Z_MM = -14.0, -9.0
# Air that it shows in front of the fingertip and above the board. [mm]
AIR_BEYOND_TIP_MM, AIR_ABOVE_BOARD_MM = 0.5, 0.3
# So few photons are walked for it that distances on the usual cells of 0.1 mm would take longer than they save. [mm]
SECTION_CELLS_MM = 0.2
# The stock integrator answers for states one by one, so it stops at this relative error even if less is required.
VOLPATH_RELATIVE_ERROR = 0.05


@dataclass(frozen=True)
class DetectedLight:
    """Detected light of a finger scene, whatever engine traced it.

    over : reads a course of blood states, (t, zones) float -> Course.
    mean_path, mean_path_stderr : (led, photodiode, absorber) float at rest; NaN where the engine cannot tell. [mm]
    section : regions along the finger at u = 0 and, if traced, the light's path density.
    """

    over: Callable[[np.ndarray], Course]
    absorbers: tuple[str, ...]
    mean_path: np.ndarray
    mean_path_stderr: np.ndarray
    section: xr.Dataset
    attributes: dict[str, Any]


@dataclass(frozen=True)
class RestReadings:
    """Readings of every LED and photodiode at rest, and where the light went (None where volpath cannot tell).

    The standard error of a reading is NaN where fewer than ten effective photons were seen.
    """

    readings: list[dict[str, Any]]
    energy: dict[str, dict[str, float]] | None
    photons: int
    engine: str
    backend: str
    cpu_seconds: float
    wall_seconds: float
    transfer: Transfer | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything but the transfer."""
        return {name: value for name, value in vars(self).items() if name != "transfer"}


def open_light(
    scene: Scene, *, states: np.ndarray, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> DetectedLight:
    """Trace a finger scene with the engine that it names, or the best that this machine can run.

    states : (t, zones) float. The blood states that will be read; volpath traces three that span them.

    Raises: NotReachedError with the DetectedLight so far as result.
    """
    options = TraceOptions(**requested)
    chosen, engine = open_engine(scene, options.backend)
    required = accuracy(scene, options)  # what cannot be required is said before any work
    finger = geometry.build(scene)
    if engine == "volpath":
        states = np.asarray(states, float)
        return _light_by_volpath(scene, finger, states, required, seed=options.seed, backend=chosen, progress=progress)

    def read(transfer: Transfer) -> DetectedLight:
        rest = transfer.at()
        unknown = "saw no light or too few photons, so that nothing is known of their standard errors"
        _with_few_photons(transfer, rest, unknown)
        return light_of(transfer, rest=rest, section=_section(scene, finger, options.seed, traced=True))

    return _traced(scene, read, progress, requested)


def read_rest(
    scene: Scene, *, progress: ProgressCallback | None = None, **requested: Unpack[Requested]
) -> RestReadings:
    """Trace a scene and read it at rest; raises NotReachedError with the RestReadings so far as result."""
    options = TraceOptions(**requested)
    chosen, engine = open_engine(scene, options.backend)
    if engine == "volpath":
        return _rest_by_volpath(scene, chosen, options, progress)
    return _traced(scene, _rest_of, progress, requested)


def open_engine(scene: Scene, requested: str) -> tuple[backends.Backend, str]:
    """The backend and the engine that trace a scene; warns where volpath cannot run on the backend and takes scalar."""
    chosen = backends.choose(requested, volpath=scene.light.engine == "volpath")
    if chosen.advice == backends.VOLPATH_ADVICE:
        log.warning(chosen.advice)
    return chosen, engine_for(scene, chosen)


def engine_for(scene: Scene, chosen: backends.Backend) -> str:
    """The engine that traces a scene on a backend: "photons" or "volpath".

    Raises: InputError where the scene asks for photons and the backend compiles no kernels.
    """
    if scene.light.engine == "photons" and not chosen.jit:
        raise InputError(
            f'light.engine = "photons" needs a backend that compiles kernels (llvm or cuda), which {chosen.name} does '
            'not; take another one (nailoptics doctor shows which work), or engine = "volpath".'
        )
    return "volpath" if scene.light.engine == "volpath" or not chosen.jit else "photons"


def light_of(transfer: Transfer, *, rest: xr.Dataset | None = None, section: xr.Dataset | None = None) -> DetectedLight:
    """A Transfer as the light of a finger scene.

    rest : the transfer's readings at rest, if they are there.
    section : the map of the finger's section; without one it is left out.
    """
    rest = transfer.at() if rest is None else rest
    blind = rest.effective_photons.values < FEW_PHOTONS
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = rest.detected_fraction_stderr.values / rest.detected_fraction.values

    def over(states: np.ndarray) -> Course:
        seen = course(transfer, states, electrons=True)
        # A sum of no photons, or of one, has no spread, which is not the same as no error.
        seen.stderr[blind] = seen.change_stderr[blind] = np.nan
        return seen

    return DetectedLight(
        over=over,
        absorbers=transfer.absorbers,
        mean_path=rest.mean_path_mm.values,
        mean_path_stderr=rest.mean_path_mm_stderr.values,
        section=xr.Dataset() if section is None else section,
        attributes=transfer.attributes()
        | {
            "cpu_seconds": transfer.cpu_seconds,
            "wall_seconds": transfer.wall_seconds,
            "accuracy_reached": _reached(relative),
        },
    )


def _traced(
    scene: Scene, read: Callable[[Transfer], Any], progress: ProgressCallback | None, requested: Requested
) -> Any:
    """What is read from a scene's trace, or from as much of it as there is when it falls short."""
    try:
        transfer = trace(scene, progress=progress, **requested)
    except NotReachedError as error:
        if isinstance(error.result, Transfer):
            error.result = read(error.result)
        raise
    return read(transfer)


def _with_few_photons(transfer: Transfer, rest: xr.Dataset, what: str) -> np.ndarray:
    """The readings that have too few photons for a standard error, (led, photodiode) bool; warns if there are any."""
    few: np.ndarray = rest.effective_photons.values < FEW_PHOTONS
    if few.any():
        names = sorted({transfer.photodiodes[j] for j in np.nonzero(few)[1]})
        log.warning("%s %s; trace more photons", ", ".join(names), what)
    return few


def _reached(relative: np.ndarray) -> str:
    """The largest relative standard error at rest, in words; NaN or infinite where nothing was seen."""
    worst = float(np.max(relative))
    if not math.isfinite(worst):
        return "some photodiode saw no light"
    return f"relative standard error of every reading at rest at most {worst:.2g}"


def _section(scene: Scene, finger: Geometry, seed: int, *, traced: bool) -> xr.Dataset:
    """The longitudinal section at u = 0: regions and, if traced, each LED's path density."""
    low, high = np.asarray(finger.bounds_mm)
    y = np.arange(max(low[1], SECTION_FROM_Y_MM), high[1] + AIR_BEYOND_TIP_MM, SECTION_MM)
    z = np.arange(max(low[2], SECTION_FROM_Z_MM), high[2] + AIR_ABOVE_BOARD_MM, SECTION_MM)
    grid = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), -1).reshape(-1, 3)
    plane = ("section_y", "section_z")
    about = {"long_name": "region along the section at u = 0", "regions": json.dumps(finger.regions)}
    data: dict[str, Any] = {
        "section_region": (plane, finger.region_at(grid).reshape(len(y), len(z)).astype(np.int16), about)
    }
    if traced:
        from .finger_walk import FingerTracer
        from .tallies.section import Section

        tracer = FingerTracer(scene, finger, spacing_mm=SECTION_CELLS_MM)
        density = []
        for led in range(len(scene.leds)):
            section = Section(y, z)
            tracer.walk(led, photons=SECTION_PHOTONS, seed=seed, section=section)
            density.append(section.density(SECTION_PHOTONS))
        text = "path density of an LED's light, summed over the finger's width, per emitted photon"
        data |= variable("path_density", ("led", *plane), density, text, units="mm-1")
    data |= variable("section_y", "section_y", y, "along the nail, towards the tip", units="mm")
    data |= variable("section_z", "section_z", z, "out of the nail, from the plate's face", units="mm")
    return xr.Dataset(data)


def _light_by_volpath(
    scene: Scene,
    finger: Geometry,
    states: np.ndarray,
    required: Accuracy,
    *,
    seed: int,
    backend: backends.Backend,
    progress: ProgressCallback | None,
) -> DetectedLight:
    """Trace rest and one changed state per zone; between them each zone dims as in Beer-Lambert (8)."""
    target = max(required.relative_error or 0.0, VOLPATH_RELATIVE_ERROR)
    log.warning(
        "volpath traces three blood states to a relative error of %g and takes Beer-Lambert (8) between them", target
    )
    corners = volpath.corner_states(states)
    begin, cpu = time.perf_counter(), time.process_time()
    shared: dict[str, Any] = {"seed": seed, "backend": backend, "progress": progress}
    read = partial(volpath.finger_readings, scene, finger, corners, relative_error=target, **shared)
    traced, complaint = volpath.read_leds(scene, required, read)
    fraction, stderr, ratio, ratio_stderr = (
        np.stack([getattr(one, name) for one in traced])
        for name in ("fraction", "fraction_stderr", "ratio", "ratio_stderr")
    )
    rest = fraction[:, :, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = stderr[:, :, 0] / rest
    mean_path, mean_path_stderr = volpath.secant_paths(scene, corners, ratio, ratio_stderr)
    paths = sum(one.paths for one in traced)
    light = DetectedLight(
        over=lambda blood: volpath.between(rest, relative, ratio, ratio_stderr, corners, np.asarray(blood, float)),
        absorbers=optics.absorbers(scene),
        mean_path=mean_path,
        mean_path_stderr=mean_path_stderr,
        section=_section(scene, finger, seed, traced=False),
        attributes=provenance(scene, engine="volpath", backend=backend.name, photons=paths, seeds=str(seed))
        | {
            "cpu_seconds": time.process_time() - cpu,
            "wall_seconds": time.perf_counter() - begin,
            "accuracy_reached": _reached(relative) + "; three blood states traced, Beer-Lambert (8) between them",
        },
    )
    if complaint:
        raise NotReachedError(complaint, result=light)
    return light


def _rest_of(transfer: Transfer) -> RestReadings:
    """The readings of a trace at rest."""
    rest = transfer.at()
    few = _with_few_photons(transfer, rest, "saw too few photons to tell a standard error")
    stderr = np.where(few, np.nan, rest.detected_fraction_stderr.values)
    rows = []
    for i, led in enumerate(transfer.scene.leds):
        for j, photodiode in enumerate(transfer.photodiodes):
            at = {"led": i, "photodiode": j}
            row = _row(led, photodiode, rest.detected_fraction[at], stderr[i, j], transfer.traces[i].photons)
            for name in ("mean_path_mm", "mean_path_mm_stderr"):
                values = dict(zip(transfer.absorbers, rest[name][at].values, strict=True))
                key = name.replace("_mm_stderr", "_stderr_mm")
                # JSON has no NaN: a path of light that was not seen is null.
                row[key] = {absorber: float(x) if math.isfinite(x) else None for absorber, x in values.items()}
            rows.append(row)
    return RestReadings(
        readings=rows,
        energy=transfer.energy(),
        photons=transfer.photons,
        engine=transfer.engine,
        backend=transfer.backend,
        cpu_seconds=transfer.cpu_seconds,
        wall_seconds=transfer.wall_seconds,
        transfer=transfer,
    )


def _rest_by_volpath(
    scene: Scene, chosen: backends.Backend, options: TraceOptions, progress: ProgressCallback | None
) -> RestReadings:
    """The readings of a scene at rest, traced by volpath."""
    required = accuracy(scene, options)
    begin, cpu = time.perf_counter(), time.process_time()
    shared: dict[str, Any] = {"seed": options.seed, "backend": chosen, "progress": progress}
    if scene.phantom is not None:
        read = partial(volpath.phantom_readings, scene, required, **shared)
    else:
        target = required.relative_error or VOLPATH_RELATIVE_ERROR
        if required.relative_error is None and required.max_seconds is None:
            log.warning("volpath traces a finger to a relative error, not a number of photons; it takes %g", target)
        rest = np.full((1, optics.zones(scene).count), scene.blood.rest_blood_fraction)
        read = partial(volpath.finger_readings, scene, geometry.build(scene), rest, relative_error=target, **shared)
    traced, complaint = volpath.read_leds(scene, required, read)
    rows = []
    for led, one in zip(scene.leds, traced, strict=True):
        values = zip(photodiode_names(scene), one.fraction[:, 0], one.fraction_stderr[:, 0], strict=True)
        rows += [_row(led, *value, one.paths) for value in values]
    result = RestReadings(
        readings=rows,
        energy=mean_of_leds([one.energy for one in traced if one.energy]) if scene.phantom is not None else None,
        photons=sum(one.paths for one in traced),
        engine="volpath",
        backend=chosen.name,
        cpu_seconds=time.process_time() - cpu,
        wall_seconds=time.perf_counter() - begin,
    )
    if complaint:
        raise NotReachedError(complaint, result=result)
    return result


def _row(led: Led, photodiode: str, fraction: Any, stderr: Any, photons: int) -> dict[str, Any]:
    """One reading, of so many photons emitted, without the paths that only the photons engine tells."""
    row = {
        "led": led.name,
        "photodiode": photodiode,
        "wavelength_nm": led.wavelength_nm,
        "detected_fraction": float(fraction),
        "stderr": float(stderr),
        "mean_path_mm": {},
        "mean_path_stderr_mm": {},
    }
    if fraction == 0:
        # Of n photons none was seen: with 95 % confidence the fraction is below -ln(0.05) / n.
        row["upper_limit_95"] = -math.log(0.05) / photons
    return row
