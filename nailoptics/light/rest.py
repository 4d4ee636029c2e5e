"""Readings at a scene's rest state, from either engine: what `trace` prints."""

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from .. import geometry
from ..errors import InputError, NotReachedError
from ..options import Requested, TraceOptions
from ..scene import Accuracy, Scene
from ..statistics import seed_of
from . import backend as backends
from . import optics
from .engines import open_engine, volpath_states
from .tracing import INTERRUPTED, TraceProgress, accuracy, trace
from .transfer import FEW_PHOTONS, Transfer

log = logging.getLogger(__name__)

VOLPATH_BATCHES = 32
FIRST_ROUND = 1 << 16
MAX_PATHS = 1 << 18


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


def read_rest(
    scene: Scene,
    *,
    progress: Callable[[TraceProgress], None] | None = None,
    **requested: Unpack[Requested],
) -> RestReadings:
    """Trace a scene and read it at rest; raises NotReachedError with the RestReadings so far as result."""
    options = TraceOptions(**requested)
    chosen, engine = open_engine(scene, options.backend)
    if engine == "volpath":
        return _volpath(scene, chosen, options, progress)
    try:
        return _of_transfer(trace(scene, progress=progress, **requested))
    except NotReachedError as error:
        if isinstance(error.result, Transfer):
            error.result = _of_transfer(error.result)
        raise


def _of_transfer(transfer: Transfer) -> RestReadings:
    rest = transfer.at()
    few = rest.effective_photons.values < FEW_PHOTONS
    if few.any():
        names = sorted({transfer.photodiodes[j] for j in np.nonzero(few)[1]})
        log.warning("%s saw too few photons to tell a standard error; trace more photons", ", ".join(names))
    stderr = np.where(few, np.nan, rest.detected_fraction_stderr.values)
    rows = []
    for i, led in enumerate(transfer.scene.leds):
        for j, photodiode in enumerate(transfer.photodiodes):
            at = {"led": i, "photodiode": j}
            paths, errors = rest.mean_path_mm[at].values, rest.mean_path_mm_stderr[at].values
            rows.append(
                _row(
                    led.name,
                    photodiode,
                    led.wavelength_nm,
                    float(rest.detected_fraction[at]),
                    float(stderr[i, j]),
                    dict(zip(transfer.absorbers, paths, strict=True)),
                    dict(zip(transfer.absorbers, errors, strict=True)),
                    transfer.traces[i].photons,
                )
            )
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


def _row(
    led: str,
    photodiode: str,
    wavelength_nm: float,
    fraction: float,
    stderr: float,
    path_mm: dict[str, float],
    path_stderr_mm: dict[str, float],
    photons: int,
) -> dict[str, Any]:
    row = {
        "led": led,
        "photodiode": photodiode,
        "wavelength_nm": wavelength_nm,
        "detected_fraction": fraction,
        "stderr": stderr,
        "mean_path_mm": {name: _number(value) for name, value in path_mm.items()},
        "mean_path_stderr_mm": {name: _number(value) for name, value in path_stderr_mm.items()},
    }
    if fraction == 0:
        # Of n photons none was seen: with 95 % confidence the fraction is below -ln(0.05) / n.
        row["upper_limit_95"] = -math.log(0.05) / photons
    return row


def _number(value: float) -> float | None:
    """JSON has no NaN: a path of light that was not seen is null."""
    return float(value) if math.isfinite(value) else None


def _volpath(
    scene: Scene,
    chosen: backends.Backend,
    options: TraceOptions,
    progress: Callable[[TraceProgress], None] | None,
) -> RestReadings:
    wanted, seed = accuracy(scene, options), options.seed
    begin, cpu = time.perf_counter(), time.process_time()
    rows, paths, complaint, energy = [], 0, None, []
    for i, led in enumerate(scene.leds):
        if scene.phantom is not None:
            limit = math.inf
            if wanted.max_seconds is not None:
                limit = (wanted.max_seconds - (time.perf_counter() - begin)) / (len(scene.leds) - i)
            values, split, spent, reached = _phantom(scene, chosen, i, seed, wanted, limit, progress)
            energy.append(split)
            if not reached:
                complaint = (
                    f'max_seconds ended the trace of LED "{led.name}" at relative error {_worst(values):.3g}; '
                    "allow more time or ask for less."
                )
            names = [p.name for p in scene.photodiodes]
        else:
            values, spent, fell_short = _finger(scene, chosen, i, seed, wanted, progress)
            if (fell_short or "").startswith(INTERRUPTED) and led is not scene.leds[-1]:
                raise KeyboardInterrupt  # nothing is known of the other LEDs
            complaint = complaint or fell_short
            names = list(scene.layout.photodiode_names)
        paths += spent
        rows += [
            _row(led.name, name, led.wavelength_nm, float(v), float(e), {}, {}, spent)
            for name, (v, e) in zip(names, values, strict=True)
        ]
    rest = RestReadings(
        readings=rows,
        energy=_mean_of_leds(energy) if energy else None,
        photons=paths,
        engine="volpath",
        backend=chosen.name,
        cpu_seconds=time.process_time() - cpu,
        wall_seconds=time.perf_counter() - begin,
    )
    if complaint:
        raise NotReachedError(complaint, result=rest)
    return rest


def _mean_of_leds(energy: list[dict[str, tuple[float, float]]]) -> dict[str, dict[str, float]]:
    """Where the light of all LEDs went, in equal parts."""
    out = {}
    for name in energy[0]:
        values, errors = zip(*(split[name] for split in energy), strict=True)
        out[name] = {"value": float(np.mean(values)), "stderr": float(np.linalg.norm(errors) / len(errors))}
    return out


def _worst(values: list[tuple[float, float]]) -> float:
    return max((error / value if value > 0 else math.inf for value, error in values), default=0.0)


def _phantom(
    scene: Scene,
    chosen: backends.Backend,
    led: int,
    seed: int,
    wanted: Accuracy,
    max_seconds: float,
    progress: Callable[[TraceProgress], None] | None,
) -> tuple[list[tuple[float, float]], dict[str, tuple[float, float]], int, bool]:
    """Readings and energy of one LED, the paths spent on each, and whether all that was asked is met.

    Paths are traced in rounds, each as long as all before it; the first always runs, and none begins after max_seconds.
    """
    from .volpath.integrate import phantom_energy, phantom_fractions

    if scene.leds[led].pattern == "measured":
        raise InputError(f'leds[{led}].pattern = "measured" cannot be traced by volpath; use the photons engine.')
    begin = time.perf_counter()
    rounds: list[np.ndarray] = []
    sizes: list[int] = []
    done, met, share = 0, False, 0.0
    while share < 1:
        asked = wanted.photons - done if wanted.photons else max(done, FIRST_ROUND)
        each = min(math.ceil(asked / VOLPATH_BATCHES), MAX_PATHS)
        options: dict[str, Any] = {"led": led, "batches": VOLPATH_BATCHES, "paths_per_batch": each, "backend": chosen}
        *seeds, last = (seed_of(seed, led, len(rounds), k) for k in range(len(scene.photodiodes) + 1))
        columns = [phantom_fractions(scene, photodiode=j, seed=s, **options) for j, s in enumerate(seeds)]
        rounds.append(np.column_stack([*columns, phantom_energy(scene, seed=last, **options)]))
        sizes.append(each)
        done += each * VOLPATH_BATCHES
        values = [_pooled([r[:, k] for r in rounds], sizes) for k in range(len(columns))]
        error, seconds = _worst(values), time.perf_counter() - begin
        if wanted.photons:
            share = done / wanted.photons
        elif wanted.relative_error:
            share = min(1.0, (wanted.relative_error / error) ** 2) if error > 0 else 1.0
        met = share >= 1 or not (wanted.photons or wanted.relative_error)
        share = min(1.0, max(share, seconds / max_seconds)) if max_seconds > 0 else 1.0
        if progress:
            progress(TraceProgress(scene.leds[led].name, done, error, wanted.relative_error, share, seconds))
    reflected, transmitted, out = (
        _pooled(columns, sizes)
        for columns in ([r[:, -2] for r in rounds], [r[:, -1] for r in rounds], [r[:, -2:].sum(1) for r in rounds])
    )
    energy = {
        "reflected": reflected,
        "transmitted": transmitted,
        "absorbed": (1 - out[0], out[1]),
        "lost": (0.0, 0.0),
    }
    return values, energy, done, met


def _pooled(rounds: list[np.ndarray], sizes: list[int]) -> tuple[float, float]:
    """Mean and standard error of rounds of batches, each round weighed by the paths in a batch of it."""
    weight = np.array(sizes) / sum(sizes)
    mean = [float(np.mean(batches)) for batches in rounds]
    stderr = [float(np.std(batches, ddof=1) / math.sqrt(len(batches))) for batches in rounds]
    return float(weight @ mean), float(np.linalg.norm(weight * stderr))


def _finger(
    scene: Scene,
    chosen: backends.Backend,
    led: int,
    seed: int,
    wanted: Accuracy,
    progress: Callable[[TraceProgress], None] | None,
) -> tuple[list[tuple[float, float]], int, str | None]:
    """Readings of one LED, the paths spent on all, and why they fall short of what was asked, if they do."""
    target = wanted.relative_error or 0.05
    rest = np.full((1, optics.zones(scene).count), scene.blood.rest_blood_fraction)
    limit = (wanted.max_seconds or math.inf) / len(scene.leds)
    if wanted.relative_error is None and wanted.max_seconds is None:
        log.warning("volpath traces a finger to a relative error, not a number of photons; it takes %g", target)
    shape = geometry.build(scene)
    readings = volpath_states(scene, shape, chosen, rest, led, seed, target, limit, progress)
    pairs = list(zip(readings.fraction[:, 0], readings.fraction_stderr[:, 0], strict=True))
    return pairs, readings.paths * readings.batches, readings.fell_short
