"""Either engine behind one face: a course of blood states in, detected fractions out."""

import json
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import xarray as xr

from .. import geometry
from ..errors import InputError, NotReachedError
from ..geometry import Geometry
from ..options import Requested, TraceOptions
from ..scene import Accuracy, Scene
from ..statistics import seed_of
from . import backend as backends
from . import optics
from .course import Course, course
from .tracing import INTERRUPTED, TraceProgress, accuracy, trace
from .transfer import FEW_PHOTONS, Transfer, provenance

if TYPE_CHECKING:
    from .volpath.states import StateReadings

log = logging.getLogger(__name__)

SECTION_MM = 0.05
SECTION_PHOTONS = 1 << 17
# The stock integrator answers for states one by one, so it stops at this relative error even if less is asked.
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


def open_light(
    scene: Scene,
    *,
    states: np.ndarray,
    progress: Callable[[TraceProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> DetectedLight:
    """Trace a finger scene with the engine that it asks for, or the best that this machine can run.

    Parameters
    ----------
    states : (t, zones) float. The blood states that will be read; volpath traces three that span them.

    Raises: NotReachedError with the DetectedLight so far as result.
    """
    options = TraceOptions(**requested)
    chosen, engine = open_engine(scene, options.backend)
    wanted = accuracy(scene, options)  # what cannot be asked is said before any work
    shape = geometry.build(scene)
    if engine == "volpath":
        return _volpath(scene, shape, chosen, states, options.seed, wanted, progress)
    try:
        transfer = trace(scene, progress=progress, **requested)
    except NotReachedError as error:
        if isinstance(error.result, Transfer):
            error.result = _photons(error.result, shape, options.seed)
        raise
    return _photons(transfer, shape, options.seed)


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


def _reached(relative: np.ndarray) -> str:
    """The largest relative standard error at rest, in words; NaN or infinite where nothing was seen."""
    worst = float(np.max(relative))
    if not math.isfinite(worst):
        return "some photodiode saw no light"
    return f"relative standard error of every reading at rest at most {worst:.2g}"


def _photons(transfer: Transfer, shape: Geometry, seed: int) -> DetectedLight:
    rest = transfer.at()
    blind = rest.effective_photons.values < FEW_PHOTONS
    if blind.any():
        names = sorted({transfer.photodiodes[j] for j in np.nonzero(blind)[1]})
        log.warning(
            "%s saw no light or too few photons, so that nothing is known of their standard errors; trace more photons",
            ", ".join(names),
        )
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
        section=_section(transfer.scene, shape, seed, traced=True),
        attributes=transfer.attributes()
        | {
            "cpu_seconds": transfer.cpu_seconds,
            "wall_seconds": transfer.wall_seconds,
            "accuracy_reached": _reached(relative),
        },
    )


def light_of(transfer: Transfer) -> DetectedLight:
    """A Transfer as the light of a finger scene, without the map of its section."""
    rest = transfer.at()
    worst = float((rest.detected_fraction_stderr / rest.detected_fraction).max())
    return DetectedLight(
        over=lambda states: course(transfer, states, electrons=True),
        absorbers=transfer.absorbers,
        mean_path=rest.mean_path_mm.values,
        mean_path_stderr=rest.mean_path_mm_stderr.values,
        section=xr.Dataset(),
        attributes=transfer.attributes()
        | {"accuracy_reached": f"relative standard error of every reading at rest at most {worst:.2g}"},
    )


def _section(scene: Scene, shape: Geometry, seed: int, *, traced: bool) -> xr.Dataset:
    """The longitudinal section at u = 0: regions and, if traced, each LED's path density."""
    low, high = np.asarray(shape.bounds_mm)
    y = np.arange(max(low[1], -14.0), high[1] + 0.5, SECTION_MM)
    z = np.arange(max(low[2], -9.0), high[2] + 0.3, SECTION_MM)
    grid = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), -1).reshape(-1, 3)
    data: dict[str, Any] = {
        "section_region": (
            ("section_y", "section_z"),
            shape.region_at(grid).reshape(len(y), len(z)).astype(np.int16),
            {"long_name": "region along the section at u = 0", "regions": json.dumps(shape.regions)},
        )
    }
    if traced:
        from .finger_walk import FingerTracer
        from .tallies.section import Section

        tracer = FingerTracer(scene, shape, spacing_mm=0.2)  # few photons: distances of 0.1 mm would take longer
        density = []
        for led in range(len(scene.leds)):
            section = Section(y, z)
            tracer.walk(led, photons=SECTION_PHOTONS, seed=seed, section=section)
            density.append(section.density(SECTION_PHOTONS))
        text = "path density of an LED's light, summed over the finger's width, per emitted photon"
        data["path_density"] = (("led", "section_y", "section_z"), density, {"long_name": text, "units": "mm-1"})
    coords = {
        "section_y": ("section_y", y, {"units": "mm", "long_name": "along the nail, towards the tip"}),
        "section_z": ("section_z", z, {"units": "mm", "long_name": "out of the nail, from the plate's face"}),
    }
    return xr.Dataset(data, coords=coords)


def _volpath(
    scene: Scene,
    shape: Geometry,
    chosen: backends.Backend,
    states: np.ndarray,
    seed: int,
    wanted: Accuracy,
    progress: Callable[[TraceProgress], None] | None,
) -> DetectedLight:
    """Trace rest and one changed state per zone; between them each zone dims as in Beer-Lambert (8)."""
    target = max(wanted.relative_error or 0.0, VOLPATH_RELATIVE_ERROR)
    log.warning(
        "volpath traces three blood states to a relative error of %g and takes Beer-Lambert (8) between them", target
    )
    corners = _corners(np.asarray(states, float))
    begin, cpu = time.perf_counter(), time.process_time()
    traced, paths, complaint = [], 0, None
    for i, led in enumerate(scene.leds):
        limit = math.inf
        if wanted.max_seconds is not None:
            limit = (wanted.max_seconds - (time.perf_counter() - begin)) / (len(scene.leds) - i)
        readings = volpath_states(scene, shape, chosen, corners, i, seed, target, limit, progress)
        traced.append(readings)
        paths += readings.paths * readings.batches
        complaint = complaint or readings.fell_short
        if (readings.fell_short or "").startswith(INTERRUPTED) and led is not scene.leds[-1]:
            raise KeyboardInterrupt  # nothing is known of the other LEDs
    fraction = np.stack([r.fraction[:, 0] for r in traced])
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.stack([r.fraction_stderr[:, 0] for r in traced]) / fraction
    ratio, ratio_stderr = np.stack([r.ratio for r in traced]), np.stack([r.ratio_stderr for r in traced])
    mean_path, mean_path_stderr = _secant_paths(scene, corners, ratio, ratio_stderr)
    light = DetectedLight(
        over=lambda blood: _between(fraction, relative, ratio, ratio_stderr, corners, np.asarray(blood, float)),
        absorbers=optics.absorbers(scene),
        mean_path=mean_path,
        mean_path_stderr=mean_path_stderr,
        section=_section(scene, shape, seed, traced=False),
        attributes=provenance(scene, engine="volpath", backend=chosen.name, photons=paths, seeds=str(seed))
        | {
            "cpu_seconds": time.process_time() - cpu,
            "wall_seconds": time.perf_counter() - begin,
            "accuracy_reached": _reached(relative) + "; three blood states traced, Beer-Lambert (8) between them",
        },
    )
    if complaint:
        raise NotReachedError(complaint, result=light)
    return light


def volpath_states(
    scene: Scene,
    shape: Geometry,
    chosen: backends.Backend,
    blood: np.ndarray,
    led: int,
    seed: int,
    target: float,
    max_seconds: float,
    progress: Callable[[TraceProgress], None] | None,
) -> "StateReadings":
    """Readings of one LED by volpath in up to three blood states, (states, zones) float."""
    from .volpath.mitsuba_scene import BedAbsorption
    from .volpath.states import finger_states

    name, wavelength, zones = scene.leds[led].name, scene.leds[led].wavelength_nm, optics.zones(scene)
    beds = list(optics.bed_columns(scene))
    mu_a = optics.absorption(scene, wavelength, blood_fraction=blood)[:, 0]
    low, high = np.asarray(shape.bounds_mm)[:, 1]
    v = np.linspace(low - 0.2, high + 0.2, 1 + round((high - low) / (zones.width_mm / 40)))

    def told(error: float, seconds: float) -> None:
        # The error falls with the root of the time.
        share = min(1.0, max((target / error) ** 2 if error > 0 else 1.0, seconds / max_seconds))
        if progress:
            progress(TraceProgress(name, 0, error, target, share, seconds))

    return finger_states(
        scene,
        shape,
        optics.finger_media(scene, shape.regions, wavelength),
        bed=BedAbsorption(v, mu_a[:, beds] @ zones.weights(v).T),
        led=led,
        relative_error=target,
        max_seconds=max_seconds,
        seed=seed_of(seed, led),
        backend=chosen,
        progress=told,
    )


def _corners(states: np.ndarray) -> np.ndarray:
    """The first state, and for each zone a state in which that zone alone is as far from it as it ever gets."""
    rest = states[0]
    far = states[np.abs(states - rest).argmax(0), np.arange(len(rest))]
    # A zone that hardly changes still gets a state of its own, so that its mean path is known.
    apart = np.where(rest < 0.5, 1.2 * rest + 1e-3, 0.8 * rest)
    far = np.where(np.abs(far - rest) <= 0.02 * rest, apart, far)
    return np.stack([rest, *(np.where(np.arange(len(rest)) == k, far, rest) for k in range(len(rest)))])


def _secant_paths(
    scene: Scene, corners: np.ndarray, ratio: np.ndarray, ratio_stderr: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean path in each blood zone, -d ln S / d mu_a between its two states; NaN for the other absorbers. [mm]"""
    out = np.full((2, *ratio.shape[:2], len(optics.absorbers(scene))), np.nan)
    for i, led in enumerate(scene.leds):
        mu_a = optics.absorption(scene, led.wavelength_nm, blood_fraction=corners)[:, 0]
        for k, column in enumerate(optics.bed_columns(scene)):
            span = mu_a[k + 1, column] - mu_a[0, column]
            out[0, i, :, column] = -np.log(ratio[i, :, k + 1]) / span
            out[1, i, :, column] = ratio_stderr[i, :, k + 1] / ratio[i, :, k + 1] / abs(span)
    return out[0], out[1]


def _between(
    rest: np.ndarray,
    relative: np.ndarray,
    ratio: np.ndarray,
    ratio_stderr: np.ndarray,
    corners: np.ndarray,
    blood: np.ndarray,
) -> Course:
    """Readings between the corner states: ln S is linear in the blood of each zone.

    The errors of the zones' ratios share noise of unknown sign, so they are added, which is an upper bound.
    """
    x = (blood - corners[0]) / (np.diagonal(corners[1:]) - corners[0])
    # Where nothing was seen the errors are infinite, and what comes of them is not a number.
    with np.errstate(invalid="ignore", divide="ignore"):
        of_rest = np.exp(np.log(ratio[..., 1:]) @ x.T)
        each = ratio_stderr[..., 1:] / ratio[..., 1:]
        spread, moved = (each @ np.abs(d).T for d in (x, x - x[0]))
        fraction, level = rest[..., None] * of_rest, relative[..., None]
        change = fraction - fraction[..., :1]
        return Course(
            fraction=fraction,
            stderr=fraction * np.hypot(level, spread),
            change=change,
            change_stderr=np.hypot(np.abs(change) * level, fraction * moved),
        )
