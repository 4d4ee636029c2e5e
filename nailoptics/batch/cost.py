"""What a sweep will cost, from a quick trace of some of its scenes."""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

from ..io import pack
from ..light.detect import VOLPATH_RELATIVE_ERROR
from ..light.identity import light_scene
from ..light.records import LedBatches
from ..light.tracing import StoppingRule, photons_engine
from ..light.transfer import Transfer
from ..options import Requested, TraceOptions
from ..scene import Scene
from ..scene.sweep import Sweep
from . import reading
from .plan import plan
from .status import duration_text
from .work import Settings, reads_transfer

# Lights that are tried, evenly spaced in the sweep.
SAMPLES = 3
# How long volpath is tried on each. [s]
VOLPATH_SECONDS = 5.0


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
            f"{self.scenes} scenes, light traced {self.lights} times\n"
            f"about {shared} of processor time ({each} if every scene were traced: {saved:.1f} times as much)\n"
            f"about {self.disk_bytes / 1e6:.1f} MB of disk"
        )


def estimate(sweep: Sweep, **requested: Unpack[Requested]) -> Estimate:
    """Estimate a sweep's cost; compiling is not counted, as it happens once per worker."""
    settings = Settings.of(Path(), TraceOptions(**requested))
    planned = plan(sweep, settings)
    groups: dict[str, list[Scene]] = {}
    for p in planned:
        groups.setdefault(p.key, []).append(p.scene)
    lights = list(groups.values())
    count = min(SAMPLES, len(lights))
    picks = [lights[round(i * (len(lights) - 1) / max(count - 1, 1))] for i in range(count)]
    costs = [_cost(group[0], settings) for group in picks]
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
    if not reads_transfer(scene, settings):
        begin = time.process_time()
        rough = replace(settings.options, relative_error=0.5, max_seconds=VOLPATH_SECONDS, photons=None)
        dataset, paths, _ = reading.by_volpath(scene, rough)
        required = settings.required(scene)
        if scene.phantom is not None and required.photons:
            more = max(required.photons / paths, 1.0)
        else:
            floor = VOLPATH_RELATIVE_ERROR if scene.finger is not None else 0.0
            error = min(reading.relative_error(dataset), 1.0)  # a photodiode may have seen nothing yet
            more = max((error / max(required.relative_error or floor, floor)) ** 2, 1.0)
        size = len(pack(*reading.to_record(dataset)))
        return (time.process_time() - begin) * more, 0.0, 0.0, float(size)
    engine_class, _ = photons_engine(scene, settings.options.backend)
    full: int = engine_class.batch_photons
    engine, required = engine_class(light_scene(scene)), settings.required(scene)
    engine.batch(0, photons=1024, seed=1)  # compiles
    opening = time.process_time()
    engine = engine_class(light_scene(scene))
    opening = time.process_time() - opening
    light_s, light_bytes, traces = opening, 0.0, []
    for led in range(len(scene.leds)):
        begin = time.process_time()
        batch = engine.batch(led, photons=full, seed=1)
        spent = time.process_time() - begin
        rule = StoppingRule(scene, led, required, engine.mu_a(led), full=full)
        rule.add(batch)
        photons = float(required.photons or full)
        if required.photons is None and required.relative_error is not None and math.isfinite(rule.error):
            photons *= max((rule.error / required.relative_error) ** 2, 1.0)
        times = photons / full
        light_s += spent * times
        light_bytes += times * (batch.weight.nbytes + batch.path_mm.nbytes + batch.photodiode.nbytes)
        batches = LedBatches(engine.mu_a(led), {(0, full): batch})
        traces.append(batches.trace([full], seed=settings.options.seed, led=led, rest=rule.rest))
    transfer = Transfer(scene, tuple(traces), settings.options.backend)
    reading.of_transfer(transfer, seed=settings.options.seed)  # imports
    begin = time.process_time()
    dataset = reading.of_transfer(transfer, seed=settings.options.seed)
    size = len(pack(*reading.to_record(dataset)))
    return light_s, time.process_time() - begin, light_bytes, float(size)
