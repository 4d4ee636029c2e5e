"""How cost grows with photodiodes, LEDs, blood states, samples and scenes, what the main job costs, and the figure of
merit of the photons, beside another revision's. Run it on a machine that does nothing else:

    python tests/benchmarks/bench_slopes.py [--only NAME] [--beside REVISION]

Each figure is measured in a process of its own, whose light is stored in a folder of its own: processor seconds after
imports, those of child processes included, and the largest memory. A slope is the power with which processor time grows
from one row to the next: 1 is in proportion. A figure of merit, 1 / (relative error^2 x CPU s) of the worst photodiode,
stands where other rows have seconds [1/s]. REVISION, a commit of this repository, runs the same cases with its own
code; what it refuses is reported as such.
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
from functools import partial
from math import log
from pathlib import Path
from statistics import median

import numpy as np

ROOT = Path(__file__).parents[2]
FINGER = "schema_version = 1\n[finger]\n"
BOARD = FINGER + "[board]\nbarrier = false\n"
PART, NEAR = 'part = "led_800"', '[[photodiodes]]\nname = "p"\nposition_mm = [1.0, 0.0]\n'
LAYER = 'name = "slab"\nthickness_mm = 1.0\nmu_a_per_mm = 0.1\nmu_s_per_mm = 5.0\ng = 0.8\nn = 1.4\n'
SLAB = f"schema_version = 1\n[[phantom.layers]]\n{LAYER}{NEAR}aperture = true\n"
BEAM = 'wavelength_nm = 800.0\npattern = "pencil"'
SWEEP = f"""
schema_version = 1
[base]
{SLAB.replace("[[", "[[base.")}
[[base.leds]]
name = "beam"
{BEAM}
[base.accuracy]
photons = 500
[[axes]]
path = "phantom.layers.slab.thickness_mm"
linspace = [0.5, 3.0, COUNT]
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
    text = BOARD + lights(PART, (-4.0, 0.0))
    for i in range(columns):
        text += f'[[photodiodes]]\nname = "p{i}"\nposition_mm = [{-3.4 + 0.2 * i:.2f}, 0.0]\n'
        text += f"elements = {count // columns}\nsize_mm = [0.15, 0.2]\npitch_mm = 0.25\n"
    scene = parse_scene(text)
    return lambda: nail.simulate(scene, photons=FEW)


def lights(part: str, *places: tuple[float, float]) -> str:
    """LEDs in a scene."""
    each = enumerate(places)
    return "".join(f'[[leds]]\nname = "ir{i}"\n{part}\nposition_mm = [{u:.1f}, {v:.1f}]\n' for i, (u, v) in each)


def leds(count: int) -> Callable[[], object]:
    """LEDs in a row beside one photodiode."""
    import nailoptics as nail
    from nailoptics.scene import parse_scene

    scene = parse_scene(BOARD + NEAR + lights(PART, *((-2.0, -3.5 + i) for i in range(count))))
    return lambda: nail.simulate(scene, photons=FEW)


def states(count: int) -> Callable[[], object]:
    """Blood of both zones, read from one trace."""
    import numpy as np

    import nailoptics as nail
    from nailoptics.light.transfer.series import readings_over_states

    transfer = nail.trace(shipped(), photons=200_000)
    blood = np.random.default_rng(1).uniform(0.01, 0.05, (count, 2))
    return lambda: readings_over_states(transfer, blood)


def samples(count: int, name: str = "prototype", zones: int = 2) -> Callable[[], object]:
    """Ten seconds at a higher rate: the vessels, the readings and the fits, without the photons."""
    from nailoptics.hemodynamics.for_scene import blood_over_touch
    from nailoptics.light import open_light
    from nailoptics.sensor.volts import WornLight, with_fitted_resistors
    from nailoptics.studies.simulate import simulate_from

    scene = shipped(name)
    scene = scene.model_copy(update={"blood": scene.blood.model_copy(update={"zones": zones})})
    touch = scene.touch.model_copy(update={"duration_s": 10.0, "sample_rate_hz": count / 10.0})
    scene = scene.model_copy(update={"touch": touch})
    start = scene.model_copy(update={"touch": touch.model_copy(update={"sample_rate_hz": 10.0})})
    light = open_light(scene, states=blood_over_touch(start).blood_fraction.values.T, photons=FEW)
    worn = WornLight(with_fitted_resistors(scene), light, None)
    return lambda: simulate_from(worn, course=blood_over_touch(scene), seed=1)


def scenes(count: int, *, opening: bool = False) -> Callable[[], object]:
    """A batch of slabs of one worker and opening its results, or opening them alone."""
    import nailoptics as nail
    from nailoptics.batch import load_sweep, run_batch

    folder = Path(tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"]))
    (folder / "sweep.toml").write_text(SWEEP.replace("COUNT", str(count)), encoding="utf-8")
    run = partial(run_batch, load_sweep(folder / "sweep.toml"), folder / "out", workers=1)
    if opening:
        run()
    return lambda: (opening or run(), nail.open_results(folder / "out"))


def main_job(_: int, *, first: str = "", then: str = "0.05", blood: str = "0.03") -> Callable[[], object]:
    """Simulate, imports and files included, to a tolerance after another or none, with other blood than then."""
    from nailoptics.assets import data_dir

    folder = Path(tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"]))
    text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
    (folder / "other.toml").write_text(text.replace("blood_fraction = 0.03", f"blood_fraction = {blood}"))

    def command(scene: Path | str, tolerance: str) -> None:
        arguments = ["simulate", str(scene), "-o", str(folder / "out"), "--relative-error", tolerance]
        subprocess.run([sys.executable, "-m", "nailoptics", *arguments], check=True, capture_output=True)

    if first:
        command("prototype", first)
    return lambda: command(folder / "other.toml", then)


def command_run(_: int, command: str, *, again: int = 0, before: str = "") -> Callable[[], object]:
    """What a command takes from its start to the end of its process, the first time or, where all its light is stored,
    the median of so many more; before : a command that makes what it reads."""
    out = Path(os.environ["NAILOPTICS_STORE"]) / "out"

    def run_s(command: str = command) -> float:
        begin = spent_s()
        words = command.replace("OUT", str(out)).split()
        subprocess.run([sys.executable, "-m", "nailoptics", *words], check=True, capture_output=True)
        return spent_s() - begin

    for one in filter(None, (before, command if again else "")):
        run_s(one)
    return lambda: median(run_s() for _ in range(max(again, 1)))


def a_million_photons_more(_: int) -> Callable[[], object]:
    """Photons alone, all else being warm."""
    import nailoptics as nail

    nail.trace(shipped(), photons=FEW, seed=1)
    return lambda: nail.trace(shipped(), photons=1_000_000, seed=2)


def beside_photons(_: int) -> Callable[[], object]:
    """What a first simulate at 2 % takes beside its photons: scene, kernels, the picture's light, and files."""
    import nailoptics.light.detect as detect
    from nailoptics.cli import run

    trace, traced, out = detect.trace, [], tempfile.mkdtemp(dir=os.environ["NAILOPTICS_STORE"])

    def noted(*arguments: object, **more: object) -> object:
        traced.append(trace(*arguments, **more))
        return traced[-1]

    def job() -> float:
        begin, detect.trace = spent_s(), noted
        run(["simulate", "prototype", "-o", out, "--relative-error", "0.02", "--json"])
        return spent_s() - begin - traced[0].cpu_seconds

    return job


def moved(_: int, text: str, part: str) -> Callable[[], object]:
    """Simulating or tracing again where the second of two LEDs has moved."""
    import nailoptics as nail
    from nailoptics.scene import parse_scene

    before, after = (parse_scene(text + lights(part, (-2.0, -2.0), (-2.0, v))) for v in (2.0, 2.5))
    study = nail.simulate if before.finger else nail.trace
    study(before, photons=10 * FEW)
    return lambda: study(after, photons=10 * FEW)


def merit(photons: int, layout: str = "", *, of_change: bool = False) -> Callable[[], object]:
    """1 / (relative error^2 x processor seconds of the photons) of the worst photodiode, kernels being there.

    of_change : by a sixth more blood in one zone and as much less in the other, not of the reading.
    """
    import nailoptics as nail
    from nailoptics.light.transfer.series import readings_over_states
    from nailoptics.scene import parse_scene

    scene = parse_scene(layout) if layout else shipped()

    def result() -> float:
        nail.trace(scene, photons=FEW, seed=1)
        light = nail.trace(scene, photons=photons, seed=2)
        rest = light.at()
        relative = (rest.detected_fraction_stderr / rest.detected_fraction).values
        if of_change:
            moved = readings_over_states(light, np.array([[0.03, 0.03], [0.025, 0.035]]))
            relative = (moved.change_stderr / moved.change)[..., 1]
        return float(1 / (np.abs(relative).max() ** 2 * light.cpu_seconds))

    return result


RECORD = "simulate calibration --recording OUT.csv -o OUT"
CALIBRATE = "calibrate prototype OUT.csv -o OUT.toml"
AT_5_MM = NEAR + lights(PART, (-4.0, 0.0), (1.0, 5.0))
MANY = [1_000, 10_000, 100_000, 1_000_000]
CASES: dict[str, tuple[Callable[..., Callable[[], object]], list[int]]] = {
    "photodiodes": (photodiodes, [8, 64, 256, 1024]),
    "leds": (leds, [1, 2, 4, 8]),
    "states": (states, [100, 1_000, 10_000, 100_000]),
    "samples": (samples, MANY),
    "samples of 8 zones": (partial(samples, zones=8), MANY),
    "samples of a pulse": (partial(samples, name="heartbeat"), MANY),
    "scenes": (scenes, [10, 40, 160]),
    "open results": (partial(scenes, opening=True), [5_000]),
    "main job": (main_job, [0]),
    "main job again, other blood": (partial(main_job, first="0.05", blood="0.035"), [0]),
    "main job again, tighter": (partial(main_job, first="0.05", then="0.04"), [0]),
    "main job at 2 % less photons": (beside_photons, [0]),
    "first simulate": (partial(command_run, command="simulate prototype --relative-error 0.02 -o OUT"), [0]),
    "second simulate": (partial(command_run, command="simulate prototype --relative-error 0.02 -o OUT", again=5), [0]),
    "second trace": (partial(command_run, command="trace prototype --relative-error 0.02", again=5), [0]),
    "second check": (partial(command_run, command="check prototype", again=5), [0]),
    "first oximeter": (partial(command_run, command="oximeter pulse_oximeter -o OUT"), [0]),
    "second oximeter": (partial(command_run, command="oximeter pulse_oximeter -o OUT", again=1), [0]),
    "first place": (partial(command_run, command="place placement -o OUT"), [0]),
    "second place": (partial(command_run, command="place placement -o OUT", again=2), [0]),
    "first colour": (partial(command_run, command="colour nail_colour -o OUT"), [0]),
    "second colour": (partial(command_run, command="colour nail_colour -o OUT", again=1), [0]),
    "first explore": (partial(command_run, command="explore prototype -o OUT.html"), [0]),
    "second explore": (partial(command_run, command="explore prototype -o OUT.html", again=2), [0]),
    "figures": (partial(command_run, command="figures -o OUT"), [0]),
    "calibrate": (partial(command_run, command=CALIBRATE, before=RECORD), [0]),
    "a million photons more": (a_million_photons_more, [0]),
    # On a finger light meets the dies of both; on a slab beams are independent of each other.
    "one LED of two moved": (partial(moved, text=BOARD + NEAR, part=PART), [0]),
    "one beam of two moved": (partial(moved, text=SLAB, part=BEAM), [0]),
    "merit of the prototype": (merit, [1_000_000]),
    "merit of its change": (partial(merit, of_change=True), [1_000_000]),
    "merit at 5 mm": (partial(merit, layout=FINGER + AT_5_MM), [1_000_000]),
    # Nine tenths of this light come straight through the epoxy.
    "merit at 5 mm, no barrier": (partial(merit, layout=BOARD + AT_5_MM), [1_000_000]),
}


def measure(name: str, size: int) -> dict[str, float]:
    """Processor seconds, or the figure that a case measures instead, and largest memory, in this process."""
    prepared = CASES[name][0](size)
    begin = spent_s()
    result = prepared()
    spent = result if isinstance(result, float) else spent_s() - begin
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {"cpu_s": spent, "peak_mb": peak / 1e3}


def apart(name: str, size: int, code: Path) -> dict[str, float] | None:
    """The same in a process of its own, with the package that lies in a folder; None where it refuses."""
    with tempfile.TemporaryDirectory() as store:
        environment = os.environ | {"PYTHONPATH": str(code), "NAILOPTICS_STORE": store}
        command = [sys.executable, __file__, "--case", name, str(size)]
        done = subprocess.run(command, env=environment, cwd=code, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None


def rows(name: str, codes: list[Path]) -> list[list[str]]:
    """Lines of the table for one case: size, then seconds, slope and memory for each code."""
    lines: list[list[str]] = []
    before: list[tuple[int, float] | None] = [None] * len(codes)
    for size in CASES[name][1]:
        line = [name, f"{size:,}" if size else ""]
        for k, code in enumerate(codes):
            result = apart(name, size, code)
            if result is None:
                line += ["refused", "", ""]
                continue
            last, before[k] = before[k], (size, result["cpu_s"])
            slope = f"{log(result['cpu_s'] / last[1]) / log(size / last[0]):.2f}" if last else ""
            line += [f"{result['cpu_s']:.2f}", slope, f"{result['peak_mb']:.0f}"]
        lines.append(line)
    return lines


def export(revision: str, folder: Path) -> Path:
    """The files of another revision in a folder."""
    archive = subprocess.run(["git", "archive", revision], cwd=ROOT, check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", str(folder)], input=archive, check=True)
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=CASES, action="append")
    parser.add_argument("--beside", metavar="REVISION")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        print(json.dumps(measure(options.case[0], int(options.case[1]))))
        return
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        codes = [ROOT] + ([export(options.beside, Path(folder))] if options.beside else [])
        head = ["case", "size"] + [f"{column}{mark}" for mark in ("", " there")[: len(codes)] for column in COLUMNS]
        print("".join(f"{cell:>{width}}" for cell, width in zip(head, WIDTHS, strict=False)))
        for name in options.only or CASES:
            for line in rows(name, codes):
                print("".join(f"{cell:>{width}}" for cell, width in zip(line, WIDTHS, strict=False)), flush=True)
    print(f"measured in {time.perf_counter() - began:.0f} s")


COLUMNS = ["CPU s", "slope", "peak MB"]
WIDTHS = [28, 11, *[15] * 6]

if __name__ == "__main__":
    main()
