"""What a part that a scene leaves out saves, and what `simulate` costs beside its photons: python bench_left_out.py

Prints, for the shipped prototype and in turns: triangles, set-up, and photons per CPU second with every part; with a
part's faces kept and its medium that around it, as `explain` traces its pairs; and without them. Then CPU seconds of
`nailoptics simulate prototype` in processes of their own, with an empty store and with what that leaves in it.
"""

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from nailoptics.assets import data_dir
from nailoptics.geometry import AROUND
from nailoptics.light import backend
from nailoptics.light.transfer.records import FINGER_BATCH_PHOTONS
from nailoptics.scene import load_scene

ROUNDS = 5


def main() -> None:
    """Both, one after the other."""
    photons()
    commands()


def photons() -> None:
    """Set-up, and the median over batches that the cases walk in turns."""
    backend.activate_jit("auto", "the benchmark")
    from nailoptics.light.walk import finger as finger_walk

    scene = load_scene(data_dir("scenes") / "prototype.toml")
    every = tuple(AROUND)
    cases = [((), every), *((parts, kept) for parts in [(p,) for p in every] + [every] for kept in (every, ()))]
    tracers, setup = [], []
    for parts, kept in cases:
        lit = scene.model_copy(update={"light": scene.light.model_copy(update={"left_out": parts})})
        spent = []
        for _ in range(3):
            finger_walk._built.cache_clear()
            start = time.process_time()
            tracer = finger_walk.FingerTracer(lit, with_faces=kept)
            spent.append(time.process_time() - start)
        tracers.append(tracer)
        setup.append(min(spent))
    walked = np.empty((ROUNDS + 1, len(cases)))
    for number in range(ROUNDS + 1):
        for k, tracer in enumerate(tracers):
            start = time.process_time()
            tracer.batch(0, photons=FINGER_BATCH_PHOTONS, seed=number)
            walked[number, k] = time.process_time() - start
    rate = FINGER_BATCH_PHOTONS / np.median(walked[1:], axis=0)  # the first round compiles
    for (parts, kept), tracer, opened, fast in zip(cases, tracers, setup, rate, strict=True):
        how = "faces kept" if parts and kept else "not there" if parts else ""
        print(
            f"without {', '.join(parts) or 'nothing':24} {how:10} {len(tracer.geometry.triangles):6d} triangles, "
            f"set-up {opened:5.2f} CPU s, {fast / 1e3:6.1f} k photons per CPU s"
        )


def commands() -> None:
    """CPU seconds of whole commands, from the first import to the last page."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NAILOPTICS_STORE": f"{folder}/store"}
        still = Path(folder) / "still.toml"
        text = (data_dir("scenes") / "prototype.toml").read_text(encoding="utf-8")
        still.write_text(re.sub(r"(?m)^force_n = .*$", "force_n = 0.0", text), encoding="utf-8")
        for what, *options in (
            ("20 thousand photons at 0 N", str(still), "--photons", "20000", "--no-store"),
            ("at 2 %, the first time", "prototype", "--relative-error", "0.02"),
            ("at 2 %, the second time", "prototype", "--relative-error", "0.02"),
        ):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "nailoptics", "simulate", *options, "-o", f"{folder}/results"]
            subprocess.run(command, env=environment, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"simulate {what:28} {spent:6.1f} CPU s")


if __name__ == "__main__":
    main()
