"""How cost grows with photodiodes, LEDs, blood states, samples and scenes, and what the main job costs, beside another
revision's. Run it on a machine that does nothing else:

    python tests/benchmarks/bench_slopes.py [--only NAME] [--beside REVISION]

Each figure is measured in a process of its own, whose light is stored in a folder of its own: processor seconds after
imports, those of child processes included, and the largest memory. A slope is the power with which processor time grows
from one row to the next: 1 is in proportion. REVISION, a commit of this repository, runs the same cases with its own
code; what it refuses is told as such.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from math import log
from pathlib import Path

ROOT = Path(__file__).parents[2]
SIZES = {
    "photodiodes": [8, 64, 256, 1024],
    "leds": [1, 2, 4, 8],
    "states": [100, 1_000, 10_000, 100_000],
    "samples": [1_000, 10_000, 100_000, 1_000_000],
    "samples of 8 zones": [1_000, 10_000, 100_000, 1_000_000],
    "samples of a pulse": [1_000, 10_000, 100_000, 1_000_000],
    "scenes": [10, 40, 160],
    "main job": [0],
    "main job again, other blood": [0],
    "main job again, tighter": [0],
    "a million photons more": [0],
}
BOARD = """
schema_version = 1
[finger]
[board]
barrier = false
"""
SWEEP = """
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
photons = 500
[[axes]]
path = "phantom.layers.slab.thickness_mm"
linspace = [0.5, 3.0, {count}]
"""
FEW = 20_000


def spent_s() -> float:
    """Processor time of this process and of those that it has waited for. [s]"""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def shipped(name: str = "prototype", **touch):
    from nailoptics import load_scene
    from nailoptics.assets import data_dir

    scene = load_scene(data_dir("scenes") / f"{name}.toml")
    return scene.model_copy(update={"touch": scene.touch.model_copy(update=touch)})


def photodiodes(count: int) -> Callable[[], object]:
    """Rows along the nail, read over a touch."""
    import nailoptics as nail
    from nailoptics.scene import parse_scene

    columns = max(1, count // 32)
    text = BOARD + '[[leds]]\nname = "ir"\npart = "led_800"\nposition_mm = [-4.0, 0.0]\n'
    for i in range(columns):
        text += f'[[photodiodes]]\nname = "p{i}"\nposition_mm = [{-3.4 + 0.2 * i:.2f}, 0.0]\n'
        text += f"elements = {count // columns}\nsize_mm = [0.15, 0.2]\npitch_mm = 0.25\n"
    scene = parse_scene(text)
    return lambda: nail.simulate(scene, photons=FEW)


def leds(count: int) -> Callable[[], object]:
    """LEDs in a row beside one photodiode."""
    import nailoptics as nail
    from nailoptics.scene import parse_scene

    text = BOARD + '[[photodiodes]]\nname = "p"\nposition_mm = [1.0, 0.0]\n'
    for i in range(count):
        text += f'[[leds]]\nname = "ir{i}"\npart = "led_800"\nposition_mm = [-2.0, {-3.5 + i:.1f}]\n'
    scene = parse_scene(text)
    return lambda: nail.simulate(scene, photons=FEW)


def states(count: int) -> Callable[[], object]:
    """Blood of both zones, read from one trace."""
    import numpy as np

    import nailoptics as nail
    from nailoptics.light.course import course

    transfer = nail.trace(shipped(), photons=200_000)
    blood = np.random.default_rng(1).uniform(0.01, 0.05, (count, 2))
    return lambda: course(transfer, blood)


def samples(count: int, *, scene=None) -> Callable[[], object]:
    """Ten seconds at a higher rate: the vessels, the readings and the fits, without the photons."""
    from nailoptics.light import open_light
    from nailoptics.studies.blood_states import blood_over_touch
    from nailoptics.studies.simulate import simulate_from

    asked = scene or shipped()
    touch = asked.touch.model_copy(update={"duration_s": 10.0, "sample_rate_hz": count / 10.0})
    asked = asked.model_copy(update={"touch": touch})
    start = asked.model_copy(update={"touch": touch.model_copy(update={"sample_rate_hz": 10.0})})
    light = open_light(asked, states=blood_over_touch(start).blood_fraction.values.T, photons=FEW)
    return lambda: simulate_from(asked, light, course=blood_over_touch(asked), seed=1)


def samples_of_8_zones(count: int) -> Callable[[], object]:
    scene = shipped()
    return samples(count, scene=scene.model_copy(update={"blood": scene.blood.model_copy(update={"zones": 8})}))


def samples_of_a_pulse(count: int) -> Callable[[], object]:
    return samples(count, scene=shipped("heartbeat"))


def scenes(count: int) -> Callable[[], object]:
    """A batch of slabs of one worker, and opening its results."""
    import nailoptics as nail
    from nailoptics.batch import load_sweep, run_batch

    folder = Path(tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"]))
    (folder / "sweep.toml").write_text(SWEEP.format(count=count), encoding="utf-8")
    sweep = load_sweep(folder / "sweep.toml")

    def run() -> None:
        run_batch(sweep, folder / "out", workers=1)
        nail.open_results(folder / "out")

    return run


def command(*options: str, scene: str = "prototype") -> None:
    """The main job in a process of its own, its files written."""
    out = tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"])
    asked = [sys.executable, "-m", "nailoptics", "simulate", scene, "-o", out, *options]
    subprocess.run(asked, check=True, capture_output=True)


def main_job(_: int) -> Callable[[], object]:
    """A first simulate at 5 %, imports and files included."""
    return lambda: command("--relative-error", "0.05")


def main_job_again_other_blood(_: int) -> Callable[[], object]:
    """The same with more blood, whose light is stored."""
    command("--relative-error", "0.05")
    text = (ROOT / "scenes" / "prototype.toml").read_text(encoding="utf-8")
    other = Path(tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"])) / "other.toml"
    other.write_text(text.replace("rest_blood_fraction = 0.03", "rest_blood_fraction = 0.035"), encoding="utf-8")
    return lambda: command("--relative-error", "0.05", scene=str(other))


def main_job_again_tighter(_: int) -> Callable[[], object]:
    """Going on from 5 % to 4 %, of which stored light is the larger part."""
    command("--relative-error", "0.05")
    return lambda: command("--relative-error", "0.04")


def a_million_photons_more(_: int) -> Callable[[], object]:
    """Photons alone, all else being warm."""
    import nailoptics as nail

    nail.trace(shipped(), photons=FEW, seed=1)
    return lambda: nail.trace(shipped(), photons=1_000_000, seed=2)


def measure(name: str, size: int) -> dict[str, float]:
    """Processor seconds and largest memory of one case, in this process."""
    prepared = globals()[name.replace(" ", "_").replace(",", "")](size)
    begin = spent_s()
    prepared()
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {"cpu_s": spent_s() - begin, "peak_mb": peak / 1e3}


def apart(name: str, size: int, code: Path) -> dict[str, float] | None:
    """The same in a process of its own, with the package that lies in a folder; None where it refuses."""
    with tempfile.TemporaryDirectory() as store:
        environment = os.environ | {"PYTHONPATH": str(code), "NAILOPTICS_STORE": store}
        asked = [sys.executable, __file__, "--case", name, str(size)]
        done = subprocess.run(asked, env=environment, cwd=code, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None


def rows(name: str, codes: list[Path]) -> list[list[str]]:
    """Lines of the table for one case: size, then seconds, slope and memory for each code."""
    lines: list[list[str]] = []
    before: list[tuple[int, float] | None] = [None] * len(codes)
    for size in SIZES[name]:
        line = [name, f"{size:,}" if size else ""]
        for k, code in enumerate(codes):
            found = apart(name, size, code)
            if found is None:
                line += ["refused", "", ""]
                continue
            last, before[k] = before[k], (size, found["cpu_s"])
            slope = f"{log(found['cpu_s'] / last[1]) / log(size / last[0]):.2f}" if last else ""
            line += [f"{found['cpu_s']:.2f}", slope, f"{found['peak_mb']:.0f}"]
        lines.append(line)
    return lines


def export(revision: str, folder: Path) -> Path:
    """The files of another revision in a folder."""
    archive = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=SIZES, action="append")
    parser.add_argument("--beside", metavar="REVISION")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.case:
        print(json.dumps(measure(asked.case[0], int(asked.case[1]))))
        return
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        codes = [ROOT] + ([export(asked.beside, Path(folder))] if asked.beside else [])
        head = ["case", "size"] + [f"{column}{mark}" for mark in ("", " there")[: len(codes)] for column in COLUMNS]
        print("".join(f"{cell:>{width}}" for cell, width in zip(head, WIDTHS, strict=False)))
        for name in asked.only or SIZES:
            for line in rows(name, codes):
                print("".join(f"{cell:>{width}}" for cell, width in zip(line, WIDTHS, strict=False)), flush=True)
    print(f"measured in {time.perf_counter() - began:.0f} s")


COLUMNS = ["CPU s", "slope", "peak MB"]
WIDTHS = [28, 11, *[15] * 6]

if __name__ == "__main__":
    main()
