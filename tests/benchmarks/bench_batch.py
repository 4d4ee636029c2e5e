"""What a batch costs beyond its light: overhead per tiny scene, two workers against one, memory over many scenes.

Run it on a machine that does nothing else: python tests/benchmarks/bench_batch.py [scenes]
"""

import json
import sys
import tempfile
import time
from pathlib import Path

from nailoptics.batch import load_sweep, run_batch
from nailoptics.batch.folder import Folder
from nailoptics.batch.plan import left, plan
from nailoptics.batch.work import Settings, work
from nailoptics.light import backend, reuse

BASE = """
schema_version = 1
[base]
schema_version = 1
[[base.phantom.layers]]
name = "slab"
thickness_mm = 1.0
mu_a_per_mm = 0.1
mu_s_per_mm = 5.0
g = 0.8
n = 1.4
[[base.leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[base.photodiodes]]
name = "p"
aperture = true
position_mm = [1.0, 0.0]
[base.accuracy]
photons = {photons}
[[axes]]
path = "phantom.layers.slab.thickness_mm"
linspace = [0.5, 3.0, {count}]
"""


def sweep_of(folder: Path, count: int, photons: int):
    file = folder / f"{count}-{photons}.toml"
    file.write_text(BASE.format(count=count, photons=photons))
    return load_sweep(file)


def overhead_and_memory(folder: Path, count: int) -> dict[str, object]:
    """One worker's loop in this process: time beyond the traces alone, and memory along the way."""
    name = backend.choose("auto").name
    sweep, settings = sweep_of(folder, count, 1000), Settings(folder / "overhead", 0, name)
    place = Folder(settings.folder)
    place.make()
    jobs = left(plan(sweep, settings), place, settings, retry_failed=False).jobs
    kind = reuse.tracer(sweep.scenes[0], name)
    reuse.set_threads(1)
    work(jobs[0], settings)  # compiles
    trace_s, work_s, memory_mb = 0.0, 0.0, []
    for i, (job, scene) in enumerate(zip(jobs[1:], sweep.scenes[1:], strict=True)):
        begin = time.perf_counter()
        kind(reuse.reference(scene)).batch(0, photons=1000, seed=1)
        middle = time.perf_counter()
        work(job, settings)
        trace_s, work_s = trace_s + middle - begin, work_s + time.perf_counter() - middle
        if i % max(count // 10, 1) == 0:
            memory_mb.append(round(resident_mb(), 1))
    each = 1e3 / len(jobs[1:])
    return {"trace_ms": trace_s * each, "overhead_ms": (work_s - trace_s) * each, "memory_mb": memory_mb}


def resident_mb() -> float:
    """Memory that this process holds. [MB]"""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return float("nan")


def scaling(folder: Path, count: int, photons: int) -> dict[str, float]:
    """Time of one and of two workers of one thread, without their start."""
    sweep, seconds = sweep_of(folder, count, photons), {}
    for workers in (1, 2, 1, 2):
        times: list[float] = []
        run_batch(
            sweep,
            folder / f"w{workers}-{time.time()}",
            workers=workers,
            threads=1,
            progress=lambda p, times=times: times.append(time.perf_counter()) if p.done > 2 else None,
        )
        spent = times[-1] - times[0]
        seconds[workers] = min(spent, seconds.get(workers, spent))
    return {"one_s": seconds[1], "two_s": seconds[2], "efficiency": seconds[1] / (2 * seconds[2])}


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(json.dumps(overhead_and_memory(folder, count)), flush=True)
        print(json.dumps(scaling(folder, 24, 2_000_000)), flush=True)


if __name__ == "__main__":
    main()
