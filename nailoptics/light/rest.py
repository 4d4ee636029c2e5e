"""Readings at a scene's rest state, from either engine: what `trace` prints."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import geometry
from ..errors import InputError, NotReachedError
from ..scene import Scene
from . import backend as backends
from . import media
from .tracing import DEFAULT_PHOTONS, Progress, accuracy, trace
from .transfer import Transfer

VOLPATH_BATCHES = 32


@dataclass(frozen=True)
class Rest:
    """Readings of every LED and photodiode at rest, and where the light went (None where volpath cannot tell)."""

    readings: list[dict[str, Any]]
    energy: dict[str, dict[str, float]] | None
    photons: int
    engine: str
    backend: str
    cpu_seconds: float
    wall_seconds: float
    transfer: Transfer | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything but the transfer, ready for JSON."""
        return {name: value for name, value in vars(self).items() if name != "transfer"}


def read_rest(
    scene: Scene,
    *,
    seed: int = 0,
    backend: str = "auto",
    photons: int | None = None,
    relative_error: float | None = None,
    max_seconds: float | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Rest:
    """Trace a scene and read it at rest; raises NotReachedError with the Rest so far as result."""
    chosen = backends.choose(backend)
    asked: dict[str, Any] = {"photons": photons, "relative_error": relative_error, "max_seconds": max_seconds}
    if scene.light.engine == "volpath" or (scene.light.engine == "auto" and not chosen.jit):
        return _volpath(scene, chosen, seed, asked, progress)
    try:
        return _of_transfer(trace(scene, **asked, seed=seed, backend=backend, progress=progress))
    except NotReachedError as error:
        if isinstance(error.result, Transfer):
            error.result = _of_transfer(error.result)
        raise


def _of_transfer(transfer: Transfer) -> Rest:
    rest = transfer.at()
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
                    float(rest.detected_fraction_stderr[at]),
                    dict(zip(transfer.absorbers, paths, strict=True)),
                    dict(zip(transfer.absorbers, errors, strict=True)),
                    transfer.traces[i].photons,
                )
            )
    return Rest(
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
    seed: int,
    asked: dict[str, Any],
    progress: Callable[[Progress], None] | None,
) -> Rest:
    wanted = accuracy(scene, **asked)
    begin, cpu = time.perf_counter(), time.process_time()
    rows, paths, complaint, energy = [], 0, None, None
    for i, led in enumerate(scene.leds):
        if scene.phantom is not None:
            values, energy, spent = _phantom(scene, chosen, i, seed, wanted.photons or DEFAULT_PHOTONS)
            reached = wanted.relative_error is None or _worst(values) <= wanted.relative_error
            names = [p.name for p in scene.photodiodes]
        else:
            values, spent, reached = _finger(scene, chosen, i, seed, wanted, progress)
            names = [p.partition(":")[2] for p in geometry.build(scene).regions if p.startswith("photodiode:")]
        paths += spent
        if not reached:
            complaint = f'LED "{led.name}" has a relative error of {_worst(values):.3g}; allow more photons or time.'
        rows += [
            _row(led.name, name, led.wavelength_nm, float(v), float(e), {}, {}, spent)
            for name, (v, e) in zip(names, values, strict=True)
        ]
    rest = Rest(rows, energy, paths, "volpath", chosen.name, time.process_time() - cpu, time.perf_counter() - begin)
    if complaint:
        raise NotReachedError(complaint, result=rest)
    return rest


def _worst(values: list[tuple[float, float]]) -> float:
    return max((error / value if value > 0 else math.inf for value, error in values), default=0.0)


def _phantom(
    scene: Scene, chosen: backends.Backend, led: int, seed: int, photons: int
) -> tuple[list[tuple[float, float]], dict[str, dict[str, float]] | None, int]:
    from .volpath import phantom_energy, phantom_fractions

    if scene.leds[led].pattern == "measured":
        raise InputError(f'leds[{led}].pattern = "measured" cannot be traced by volpath; use the photons engine.')
    each = max(1, math.ceil(photons / VOLPATH_BATCHES))
    options: dict[str, Any] = {"led": led, "batches": VOLPATH_BATCHES, "paths_per_batch": each, "backend": chosen}
    values = []
    for j in range(len(scene.photodiodes)):
        batches = phantom_fractions(scene, photodiode=j, seed=seed + j, **options)
        values.append(_mean(batches))
    split = phantom_energy(scene, seed=seed + len(values), **options)
    (r, r_error), (t, t_error) = (_mean(column) for column in split.T)
    a_error = float(np.std(split.sum(1), ddof=1) / math.sqrt(len(split)))
    energy = {
        "reflected": {"value": r, "stderr": r_error},
        "transmitted": {"value": t, "stderr": t_error},
        "absorbed": {"value": 1 - r - t, "stderr": a_error},
        "lost": {"value": 0.0, "stderr": 0.0},
    }
    return values, energy, each * VOLPATH_BATCHES * (len(values) + 1)


def _mean(batches: np.ndarray) -> tuple[float, float]:
    return float(np.mean(batches)), float(np.std(batches, ddof=1) / math.sqrt(len(batches)))


def _finger(
    scene: Scene,
    chosen: backends.Backend,
    led: int,
    seed: int,
    wanted: Any,
    progress: Callable[[Progress], None] | None,
) -> tuple[list[tuple[float, float]], int, bool]:
    from .engines import volpath_states

    target = wanted.relative_error or 0.05
    rest = np.full((1, media.zones(scene).count), scene.blood.rest_blood_fraction)
    limit = (wanted.max_seconds or math.inf) / len(scene.leds)
    shape = geometry.build(scene)
    readings = volpath_states(scene, shape, chosen, rest, led, seed, target, limit, progress)
    pairs = list(zip(readings.fraction[:, 0], readings.fraction_stderr[:, 0], strict=True))
    return pairs, readings.paths * readings.batches, readings.reached
