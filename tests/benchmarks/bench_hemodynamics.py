"""Speed of the hemodynamics against its targets and against a plain scipy Radau of the six-state system.

Run: python tests/benchmarks/bench_hemodynamics.py [--json]. Times are the median of repeated warm calls in one process.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from nailoptics.hemodynamics import cardiac_pressure, parameters, respond, steady_state, zones_between

sys.path.append(str(Path(__file__).parents[1]))

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


TARGETS = {"press_two_zones_s": 0.03, "eight_over_two": 5.0, "steady_states_10000_s": 1.0}
# The least that counts as a replacement of the established solver.
LEAST = {"radau_over_ours": 20.0}


if __name__ == "__main__":
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
