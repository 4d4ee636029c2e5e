"""Figure of merit of a photodiode-sized reading: our trace against a plain C walk, measured in the same run.

    python tests/benchmarks/bench_phantom.py [--backend llvm] [--seconds 6] [--rounds 3]

A 10 mm slab, mu_a 0.05, mu_s 10 per mm, g 0.9, matched, a pencil beam, a 1 x 1 mm square 2 mm beside it. The figure of
merit is 1 / (relative error^2 x CPU seconds). Both average over azimuth. Rounds alternate between the two, so that a
busy machine hurts both.
Needs a C compiler. Exits with 1 where the ratio falls short of 4 or the two disagree.
"""

import argparse
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import nailoptics as nail
from nailoptics.scene import parse_scene

MU_A, MU_S, G, THICKNESS, CENTRE, SIZE = 0.05, 10.0, 0.9, 10.0, 2.0, 1.0
EXACT, EXACT_STDERR = 8.977e-3, 0.009e-3  # two independent codes
LEAST_RATIO = 4.0
SCENE = f"""
schema_version = 1
[phantom]
[[phantom.layers]]
name = "slab"
thickness_mm = {THICKNESS}
mu_a_per_mm = {MU_A}
mu_s_per_mm = {MU_S}
g = {G}
[[leds]]
name = "beam"
wavelength_nm = 800.0
pattern = "pencil"
[[photodiodes]]
name = "square"
aperture = true
position_mm = [{CENTRE}, 0.0]
size_mm = [{SIZE}, {SIZE}]
"""


@dataclass(frozen=True)
class Run:
    """What one run measured and what it cost."""

    photons: int
    scatterings: int
    value: float
    stderr: float
    cpu_seconds: float
    wall_seconds: float

    @property
    def merit(self) -> float:
        """Figure of merit per CPU second."""
        return (self.value / self.stderr) ** 2 / self.cpu_seconds

    @property
    def merit_wall(self) -> float:
        """Figure of merit per second on the clock."""
        return (self.value / self.stderr) ** 2 / self.wall_seconds


def compile_plain_walk(folder: Path) -> Path:
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("cc")
    if not compiler:
        sys.exit("a C compiler is needed: install gcc, or set CC")
    program = folder / "plain_walk"
    source = Path(__file__).with_name("plain_walk.c")
    subprocess.run([compiler, "-O3", "-march=native", "-ffast-math", "-o", program, source, "-lm"], check=True)
    return program


def plain(program: Path, *, photons: int, seed: int) -> Run:
    start = time.perf_counter()
    arguments = [photons, seed, MU_A, MU_S, G, THICKNESS, CENTRE, SIZE]
    out = subprocess.run([program, *map(str, arguments)], check=True, capture_output=True, text=True).stdout
    wall = time.perf_counter() - start
    total, square, scatterings, cpu = map(float, out.split())
    mean = total / photons
    return Run(photons, int(scatterings), mean, math.sqrt((square / photons - mean**2) / photons), cpu, wall)


def ours(*, photons: int, seed: int, backend: str) -> Run:
    start, cpu = time.perf_counter(), time.process_time()
    transfer = nail.trace(parse_scene(SCENE), photons=photons, seed=seed, backend=backend)
    light = transfer.at().squeeze()
    # The reading is part of the cost.
    cpu, wall = time.process_time() - cpu, time.perf_counter() - start
    return Run(
        photons, transfer.events, float(light.detected_fraction), float(light.detected_fraction_stderr), cpu, wall
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="auto", help="auto, llvm or cuda")
    parser.add_argument("--seconds", type=float, default=6.0, help="CPU seconds of one run of each")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        program = compile_plain_walk(Path(folder))
        # The first run compiles kernels; the second measures how many photons fill the time.
        ours(photons=1 << 12, seed=1, backend=options.backend)
        trial, plain_trial = (
            ours(photons=1 << 19, seed=1, backend=options.backend),
            plain(program, photons=20_000, seed=1),
        )
        many = int(trial.photons * options.seconds / max(trial.cpu_seconds, trial.wall_seconds))
        few = int(plain_trial.photons * options.seconds / plain_trial.cpu_seconds)
        runs: dict[str, list[Run]] = {"plain C": [], "nailoptics": []}
        for i in range(options.rounds):
            runs["plain C"].append(plain(program, photons=few, seed=10 + i))
            runs["nailoptics"].append(ours(photons=many, seed=10 + i, backend=options.backend))

    columns = ("photons/s", "scatterings/s", "reading", "standard error", "rel. error", "FOM (CPU)", "FOM (wall)")
    print(f"{'':12}" + "".join(f"{column:>15}" for column in columns))
    for name, result in runs.items():
        for run in result:
            values = [f"{v / run.cpu_seconds:.3g}" for v in (run.photons, run.scatterings)]
            values += [f"{run.value:.4e}", f"{run.stderr:.1e}", f"{run.stderr / run.value:.2%}"]
            values += [f"{run.merit:.0f}", f"{run.merit_wall:.0f}"]
            print(f"{name:12}" + "".join(f"{value:>15}" for value in values))
    merit = {name: statistics.median(run.merit for run in result) for name, result in runs.items()}
    walls = {name: statistics.median(run.merit_wall for run in result) for name, result in runs.items()}
    ratio = merit["nailoptics"] / merit["plain C"]
    print(
        f"ratio of the medians: {ratio:.1f} per CPU second, {walls['nailoptics'] / walls['plain C']:.1f} on the clock"
    )
    print(f"(required: {LEAST_RATIO:g} per CPU second; photons and scatterings above are per CPU second)")

    agree = True
    for name, result in runs.items():
        mean = statistics.fmean(run.value for run in result)
        spread = math.hypot(math.sqrt(sum(run.stderr**2 for run in result)) / len(result), EXACT_STDERR)
        print(f"{name}: {mean:.4e}, {(mean - EXACT) / spread:+.1f} standard errors from {EXACT:.4e}")
        agree &= abs(mean - EXACT) < 4 * spread
    return 0 if agree and ratio >= LEAST_RATIO else 1


if __name__ == "__main__":
    sys.exit(main())
