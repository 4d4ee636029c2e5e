"""What a sweep will cost, from a quick trace of some of its scenes."""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Unpack

import numpy as np

from ..io import pack
from ..light import Transfer, trace
from ..light.detect import VOLPATH_RELATIVE_ERROR
from ..light.tracing import batch_photons
from ..light.tracing.store import LightStore
from ..options import Requested, TraceOptions
from ..scene import Scene
from ..scene.sweep import Sweep
from ..variables import to_record
from . import reading
from .plan import plan
from .status import duration_text
from .study_runs import STUDIES, Study
from .work import Settings, reads_transfer

# Lights that are tried, evenly spaced in the sweep.
SAMPLES = 3
# How long volpath is tried on each. [s]
VOLPATH_SECONDS = 5.0
# With so many a study that traces its own light is tried.
FEW_PHOTONS = 60_000


@dataclass(frozen=True)
class Estimate:
    """Scenes, traces, processor time and disk of a sweep, all of it and per scene without shared light. [s, bytes]"""

    scenes: int
    lights: int
    cpu_seconds: float
    cpu_seconds_without_sharing: float
    disk_bytes: int

    def __str__(self) -> str:
        saved = self.cpu_seconds_without_sharing / self.cpu_seconds if self.cpu_seconds else 1.0
        shared, each = duration_text(self.cpu_seconds), duration_text(self.cpu_seconds_without_sharing)
        return (
            f"{self.scenes} scenes, light traced {'once' if self.lights == 1 else f'{self.lights} times'}\n"
            f"about {shared} of processor time ({each} if every scene were traced: {saved:.1f} times as much)\n"
            f"about {self.disk_bytes / 1e6:.1f} MB of disk"
        )


def estimate(sweep: Sweep, **requested: Unpack[Requested]) -> Estimate:
    """Estimate a sweep's cost; compiling is not counted, as it happens once per worker."""
    settings = Settings.of(Path(), TraceOptions(**requested), sweep.study)
    planned = plan(sweep, settings)
    first = {p.key: p.scene for p in reversed(planned)}
    lights = [first[key] for key in dict.fromkeys(p.key for p in planned)]
    picks = np.linspace(0, len(lights) - 1, min(SAMPLES, len(lights))).round().astype(int)
    costs = [_cost(lights[pick], settings) for pick in picks]
    light_s, read_s, light_bytes, read_bytes = (sum(column) / len(costs) for column in zip(*costs, strict=True))
    scenes = len({p.digest for p in planned})
    return Estimate(
        scenes=scenes,
        lights=len(lights),
        cpu_seconds=len(lights) * light_s + scenes * read_s,
        cpu_seconds_without_sharing=scenes * (light_s + read_s),
        disk_bytes=round(len(lights) * light_bytes + scenes * read_bytes),
    )


def _cost(scene: Scene, settings: Settings) -> tuple[float, float, float, float]:
    """Processor seconds of a scene's light and of its reading, and the bytes of both."""
    begin = time.process_time()
    if study := STUDIES.get(settings.study):
        return _own_light(scene, study, settings)
    if not reads_transfer(scene, settings):
        rough = replace(settings.options, relative_error=0.5, max_seconds=VOLPATH_SECONDS, photons=None)
        dataset, paths, _ = reading.by_volpath(scene, rough, settings.study)
        required = settings.required(scene)
        if scene.phantom is not None and required.photons:
            more = max(required.photons / paths, 1.0)
        else:
            floor = VOLPATH_RELATIVE_ERROR if scene.finger is not None else 0.0
            error = min(reading.relative_error(dataset), 1.0)  # a photodiode may have seen nothing yet
            more = max((error / max(required.relative_error or floor, floor)) ** 2, 1.0)
        size = len(pack(*to_record(dataset)))
        return (time.process_time() - begin) * more, 0.0, 0.0, float(size)
    full, required, seed = batch_photons(scene), settings.required(scene), settings.options.seed
    _traced(scene, settings, photons=1024)  # compiles
    opening, _ = _traced(scene, settings, photons=1024)
    spent, transfer = _traced(scene, settings, photons=full)
    reading.of_transfer(transfer, settings.study, seed=seed)  # imports
    begin = time.process_time()
    dataset = reading.of_transfer(transfer, settings.study, seed=seed)
    read_s, times = time.process_time() - begin, (required.photons or full) / full
    error = reading.relative_error(dataset)
    if required.photons is None and required.relative_error is not None and math.isfinite(error):
        times = max((error / required.relative_error) ** 2, 1.0)
    kept = sum(t.weight.nbytes + t.path_mm.nbytes + t.photodiode.nbytes for t in transfer.traces)
    return opening + times * (spent - opening), read_s, times * kept, float(len(pack(*to_record(dataset))))


def _own_light(scene: Scene, study: Study, settings: Settings) -> tuple[float, float, float, float]:
    """The same of a scene under a study that traces its own light: with few photons, and again from what it stored."""
    wanted, spent = settings.alone(scene), []
    few = replace(wanted, relative_error=None, photons=FEW_PHOTONS, store=False)
    with TemporaryDirectory(prefix="nailoptics-") as folder:
        for _ in range(2):
            begin = time.process_time()
            dataset, _, _ = study.run(scene, few, [LightStore(Path(folder))])
            spent.append(time.process_time() - begin)
        stored = sum(path.stat().st_size for path in Path(folder).rglob("*.dat"))
    more = study.more(dataset, scene, wanted)
    return max(spent[0] - spent[1], 0.0) * more, spent[1], stored * more, float(len(pack(*to_record(dataset))))


def _traced(scene: Scene, settings: Settings, *, photons: int) -> tuple[float, Transfer]:
    """Processor seconds of a trace from the scene on, and what it traced."""
    begin = time.process_time()
    transfer = trace(scene, photons=photons, seed=1, backend=settings.options.backend, store=False)
    return time.process_time() - begin, transfer
