"""What a sweep will cost, from some of its scenes, run with few photons."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Unpack

import numpy as np

from ..io import pack
from ..light.tracing.store import LightStore
from ..options import Requested, TraceOptions
from ..scene.sweep import Sweep
from ..variables import to_record
from .jobs import Planned, Settings, plan
from .studies import STUDIES, by_volpath

# Lights that are tried, evenly spaced in the sweep.
SAMPLES = 3
# Photons of each LED with which one is tried, and how long volpath is. [s]
PHOTONS, VOLPATH_SECONDS = 60_000, 5.0
# An error that is not known yet counts as so many times the required one.
MOST_EXCESS = 100.0


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
        shared, alone = duration_text(self.cpu_seconds), duration_text(self.cpu_seconds_without_sharing)
        return (
            f"{self.scenes} scenes, light traced {'once' if self.lights == 1 else f'{self.lights} times'}\n"
            f"about {shared} of processor time ({alone} if every scene were traced: {saved:.1f} times as much)\n"
            f"about {self.disk_bytes / 1e6:.1f} MB of disk"
        )


def duration_text(seconds: float) -> str:
    """A duration for people."""
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def estimate(sweep: Sweep, **requested: Unpack[Requested]) -> Estimate:
    """Estimate a sweep's cost; compiling is not counted, as it happens once per worker."""
    settings = Settings.of(Path(), TraceOptions(**requested), sweep.study)
    planned = plan(sweep, settings)
    first = {p.key: p for p in reversed(planned)}
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


def _cost(planned: Planned, settings: Settings) -> tuple[float, float, float, float]:
    """Processor seconds of a scene's light and of its reading, and the bytes of both."""
    scene, traced = planned.scene, planned.traced
    study, options = STUDIES[settings.study], settings.options_of(scene)
    volpath = by_volpath(scene, options.backend) and not study.own_light
    few = replace(options, relative_error=None, photons=PHOTONS, max_seconds=None, store=False)
    if volpath:
        few = replace(few, relative_error=0.5, photons=None, max_seconds=VOLPATH_SECONDS)
    spent = []
    with TemporaryDirectory(prefix="nailoptics-") as folder:
        stores = [LightStore(Path(folder))]
        if not volpath:
            study.run(scene, replace(few, photons=1024), [], traced)  # imports and compiles
        for _ in range(1 if volpath else 2):
            begin = time.process_time()
            dataset, photons, _ = study.run(scene, few, stores, traced)
            spent.append(time.process_time() - begin)
        stored = sum(path.stat().st_size for path in Path(folder).rglob("*.dat"))
    if options.photons and photons:
        more = options.photons / photons
    else:
        more = max(min(study.excess(dataset, scene, options), MOST_EXCESS) ** 2, 1.0)
    size = float(len(pack(*to_record(dataset))))
    if volpath:
        return spent[0] * more, 0.0, 0.0, size
    return max(spent[0] - spent[1], 0.0) * more, spent[1], stored * more, size
