"""Speed of the hemodynamics against its targets and against a plain scipy Radau of the six-state system.

Run: python tests/benchmarks/bench_hemodynamics.py [--json]. Times are the median of repeated warm calls in one process.
With --beside REVISION it reads the blood of shipped scenes with two zones, and of the prototype with eight under a
pressure that decays from the tip, by the code of both revisions, each in its own process: which bits are the same, and
how long it takes. Scenes of now must be readable there: b72706e1, the last before the bone's shield, reads them.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from nailoptics.hemodynamics import cardiac_pressure, parameters, respond, steady_state, zones_between

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tests"), str(Path(__file__).parent)]

from bench_slopes import export  # noqa: E402
from printed_equations import state_matrices  # noqa: E402


def seconds(call: Callable[[], object], repeats: int) -> float:
    call()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def radau_six_states(time_s: np.ndarray, pressure_pa: np.ndarray) -> np.ndarray:
    """The printed six-state system as anyone would write it, with the corners of the press given to the solver."""
    p = parameters("listed")
    listed = np.array([p.capillary_diameter_m, p.capillary_diameter_m, p.vein_diameter_m])
    rest = steady_state(p)
    state = np.concatenate([np.append(rest.capillary_diameter_m, rest.vein_diameter_m) - listed, np.zeros(3)])

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        touch = np.interp(t, time_s, pressure_pa)
        a, b = state_matrices(p, listed + x[:3])
        return a @ x + b @ np.array([p.arterial_pressure_pa, p.venous_pressure_pa, touch, touch])

    corners = time_s[1:-1][np.abs(np.diff(pressure_pa, 2)) > 1e-6]
    edges = np.unique(np.concatenate([[time_s[0]], corners, [time_s[-1]]]))
    columns = [state]
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        times_s = time_s[(time_s > begin) & (time_s <= end)]
        scale = np.tile(listed, 2)
        solution = solve_ivp(rates, (begin, end), state, "Radau", t_eval=times_s, rtol=1e-6, atol=1e-6 * scale)
        state = solution.y[:, -1]
        columns.extend(solution.y.T)
    return np.array(columns)[:, :3].T + listed[:, None]


def measure() -> dict[str, float]:
    p = parameters("listed")
    time_s = np.arange(0.0, 4.0, 1e-3)
    press = np.where((time_s >= 0.5) & (time_s < 2.5), 9e3, 0.0)
    touch = {"proximal_pressure_pa": press, "distal_pressure_pa": press}
    many = np.random.default_rng(0).uniform(0.0, 2e4, (2, 10_000))
    two = seconds(lambda: respond(p, time_s, **touch), 15)
    band = zones_between(np.arange(1, 8) / 8, decay_length=0.3)  # with a white band that moves
    eight = seconds(lambda: respond(p, time_s, zones=band, **touch), 15)
    long_s = np.arange(20_000) * 1e-3
    noisy = 5e3 + np.random.default_rng(0).normal(0.0, 200.0, long_s.size)
    noise = seconds(lambda: respond(p, long_s, proximal_pressure_pa=noisy, distal_pressure_pa=noisy), 1)
    beat = cardiac_pressure(long_s)
    pulse = seconds(lambda: respond(p, long_s, arterial_pressure_pa=beat), 1)
    static = seconds(lambda: steady_state(p, proximal_pressure_pa=many[0], distal_pressure_pa=many[1]), 3)
    radau = seconds(lambda: radau_six_states(time_s, press), 1)
    run = respond(p, time_s, **touch)
    exact = radau_six_states(time_s, press)
    return {
        "press_two_zones_s": two,
        "press_eight_zones_s": eight,
        "eight_over_two": eight / two,
        "noisy_samples_20000_s": noise,
        "pulsed_samples_20000_s": pulse,
        "steady_states_10000_s": static,
        "radau_six_states_s": radau,
        "radau_over_ours": radau / two,
        "largest_capillary_difference_um": float(np.abs(run["capillary_diameter_m"].values - exact[:2]).max() * 1e6),
    }


SCENES = ("prototype", "static_distal", "static_proximal", "dynamic_distal")
BLOOD = """
import sys, time
import numpy as np
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.scene import parse_scene

for text in sys.argv[1:]:
    scene, times = parse_scene(text), []
    for _ in range(9):
        begin = time.process_time()
        blood = blood_over_touch(scene).blood_fraction.values
        times.append(time.process_time() - begin)
    print(min(times), blood.tobytes().hex())
"""


def beside(revision: str) -> bool:
    """Print time and agreement of the blood of scenes by this revision and by another; whether all bits agree."""
    texts = {name: (ROOT / "scenes" / f"{name}.toml").read_text(encoding="utf-8") for name in SCENES}
    texts["prototype, zones = 8"] = texts["prototype"].replace("[blood]", "[blood]\nzones = 8\ndecay_length = 0.3")
    with tempfile.TemporaryDirectory() as folder:
        runs = []
        for code in (ROOT, export(revision, Path(folder))):
            command = [sys.executable, "-c", BLOOD, *texts.values()]
            done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(code)}, capture_output=True, check=True)
            runs.append([line.split() for line in done.stdout.decode().splitlines()])
    for name, (here_s, here), (there_s, there) in zip(texts, *runs, strict=True):
        bits = "same bits" if here == there else "other bits"
        print(f"{name:<22} {1e3 * float(here_s):6.1f} ms  {1e3 * float(there_s):6.1f} ms there  {bits}")
    return all(here == there for (_, here), (_, there) in zip(*runs, strict=True))


TARGETS = {"press_two_zones_s": 0.03, "eight_over_two": 5.0, "steady_states_10000_s": 1.0}
# The least that counts as a replacement of the established solver.
LEAST = {"radau_over_ours": 20.0}


if __name__ == "__main__":
    if "--beside" in sys.argv:
        sys.exit(not beside(sys.argv[sys.argv.index("--beside") + 1]))
    results = measure()
    if "--json" in sys.argv:
        print(json.dumps(results))
    else:
        for name, value in results.items():
            goal = f"   (target: at most {TARGETS[name]:g})" if name in TARGETS else ""
            goal = f"   (target: at least {LEAST[name]:g})" if name in LEAST else goal
            print(f"{name:<34} {value:10.4g}{goal}")
    missed = [name for name, goal in TARGETS.items() if results[name] > goal]
    sys.exit(bool(missed) or any(results[name] < goal for name, goal in LEAST.items()))
