"""What a batch costs beyond its light: overhead per tiny scene, memory, two workers against one, light that is shared.

Run it on a machine that does nothing else: python tests/benchmarks/bench_batch.py [scenes]
"""

import json
import os
import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from nailoptics.assets import data_dir
from nailoptics.batch import load_sweep, run_batch
from nailoptics.batch.folder import Folder
from nailoptics.batch.jobs import Settings, in_order, jobs_of, plan_of, work
from nailoptics.light import backend
from nailoptics.light.tracing.trace_scene import LightEngine
from nailoptics.options import TraceOptions

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
    chosen = backend.choose("auto")
    sweep, settings = sweep_of(folder, count, 1000), Settings(folder / "overhead", TraceOptions(backend=chosen.name))
    place = Folder(settings.folder)
    place.make()
    jobs = in_order(jobs_of(sweep, settings))
    place.write_plan(plan_of(sweep, jobs, settings))
    backend.set_threads(1)
    work(jobs[0], settings)  # compiles
    trace_s, work_s, memory_mb = 0.0, 0.0, []
    for i, (job, scene) in enumerate(zip(jobs[1:], sweep.scenes[1:], strict=True)):
        begin = time.perf_counter()
        LightEngine(scene, chosen)().batch(0, photons=1000, seed=1)
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
    """One and two workers of one thread, without their start: wall time, and scenes per second of processor time.

    Other load on the machine takes from the wall time of two workers more than of one, and little from the second.
    """
    sweep, tiny = sweep_of(folder, count, photons), sweep_of(folder, 4, 1000)
    wall_s: dict[int, float] = {}
    cpu_s: dict[int, float] = {}
    every = sorted(os.sched_getaffinity(0))
    for workers in (1, 2, 1, 2):
        os.sched_setaffinity(0, every[:workers])  # a core for each, so that it has one thread
        start = cpu_seconds()
        run_batch(tiny, folder / f"tiny{workers}-{start}", workers=workers)
        times, begin = [], cpu_seconds()
        run_batch(
            sweep,
            folder / f"w{workers}-{start}",
            workers=workers,
            progress=lambda p, times=times: times.append(time.perf_counter()) if p.done >= 2 else None,
        )
        wall = times[-1] - times[0]
        cpu = cpu_seconds() - begin - (begin - start)
        wall_s[workers] = min(wall, wall_s.get(workers, wall))
        cpu_s[workers] = min(cpu, cpu_s.get(workers, cpu))
        os.sched_setaffinity(0, every)
    return {
        "one_s": wall_s[1],
        "two_s": wall_s[2],
        "efficiency": wall_s[1] / (2 * wall_s[2]),
        "one_cpu_s": cpu_s[1],
        "two_cpu_s": cpu_s[2],
        "efficiency_of_processor_time": cpu_s[1] / cpu_s[2],
        "load_average": os.getloadavg()[0],
    }


def cpu_seconds() -> float:
    """Processor time of all children that have ended, such as workers. [s]"""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def sharing(folder: Path) -> dict[str, object]:
    """Processor time of a typical sweep with one trace for all that share their light, and with a trace for each.

    Oxygen, blood at rest and force over the prototype, of which a few scenes are also traced one by one.
    """
    sweep = load_sweep(data_dir("scenes") / "sweeps" / "oxygen_and_force.toml")
    start = cpu_seconds()
    run_batch(sweep, folder / "shared", workers=1)
    shared_s, alone_s = cpu_seconds() - start, []
    for i in (0, len(sweep.scenes) // 2, len(sweep.scenes) - 1):
        start = cpu_seconds()
        run_batch(replace(sweep, dims={"sample": 1}, scenes=(sweep.scenes[i],)), folder / f"alone{i}", workers=1)
        alone_s.append(cpu_seconds() - start)
    each_s = sum(alone_s) / len(alone_s)
    count = len(sweep.scenes)
    return {"scenes": count, "shared_s": shared_s, "alone_s": alone_s, "times_less": each_s * count / shared_s}


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(json.dumps(overhead_and_memory(folder, count)), flush=True)
        print(json.dumps(scaling(folder, 16, 2_000_000)), flush=True)
        print(json.dumps(sharing(folder)), flush=True)


if __name__ == "__main__":
    main()
