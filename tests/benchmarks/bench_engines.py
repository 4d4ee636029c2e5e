"""Both engines on every photodiode of the prototype, with and without index steps: python bench_engines.py [SECONDS]

The photon walk is traced to 0.5 %; stock volpath gets as many equal batches on each group of photodiodes as fit into
SECONDS (600 if not given), a number independent of what they read. Printed: both readings, their difference in
combined standard errors, and the weighted mean of their ratios. Rationale: 1 % on the outermost photodiodes, with 1e-4
of the light, costs volpath hours; what it can estimate in the time is reported with its error.
"""

import sys
import time

import numpy as np

import nailoptics as nail
from nailoptics import geometry
from nailoptics.assets import data_dir
from nailoptics.light import backend, optics
from nailoptics.light.reference.mitsuba_scene import BedAbsorption
from nailoptics.light.reference.readings import Paths, finger_paths

GROUPS = ((0, 1, 2), (3, 4), (5, 6, 7))
PATHS = 11264


def main() -> None:
    """Trace both engines and print a row per photodiode."""
    shipped = nail.load_scene(data_dir("scenes") / "prototype.toml")
    scenes = {
        steps: shipped.model_copy(update={"light": shipped.light.model_copy(update={"index_steps": steps})})
        for steps in (True, False)
    }
    tracers = {(steps, group): volpath(scene, group) for steps, scene in scenes.items() for group in GROUPS}
    deadline = time.perf_counter() + (float(sys.argv[1]) if len(sys.argv) > 1 else 600)
    seeds = iter(np.random.SeedSequence(1).generate_state(100_000))
    batches: dict[tuple[bool, tuple[int, ...]], list[np.ndarray]] = {key: [] for key in tracers}
    while time.perf_counter() < deadline:
        for key, tracer in tracers.items():
            batches[key].append(tracer.batch(paths=PATHS, seed=int(next(seeds))))
    for steps, scene in scenes.items():
        light = nail.trace(scene, relative_error=0.005, seed=2).at().isel(led=0)
        ours, error = light.detected_fraction.values, light.detected_fraction_stderr.values
        result = [np.stack(batches[steps, group]) for group in GROUPS]
        other = np.concatenate([rows.mean(0) for rows in result])
        other_error = np.concatenate([rows.std(0, ddof=1) / np.sqrt(len(rows)) for rows in result])
        print(f"{'with' if steps else 'without'} index steps, {len(result[0])} batches of {PATHS} paths")
        away = (ours - other) / np.hypot(error, other_error)
        for name, a, da, b, db, z in zip(light.photodiode.values, ours, error, other, other_error, away, strict=True):
            print(f"  {name:<12} photons {a:.4e} +- {da / a:.1%}   volpath {b:.4e} +- {db / b:.1%}   {z:+.1f} errors")
        ratio, spread = ours / other, np.hypot(error / ours, other_error / other)
        weight = spread**-2 / np.sum(spread**-2)
        print(f"  all          photons / volpath {weight @ ratio:.4f} +- {np.sum(spread**-2) ** -0.5:.4f}")


def volpath(scene: nail.Scene, group: tuple[int, ...]) -> Paths:
    """Paths from the LED's die to a group of photodiodes."""
    shape = geometry.build(scene)
    result = optics.finger_media(scene, shape.regions, scene.leds[0].wavelength_nm)
    v = np.linspace(*(np.asarray(shape.bounds_mm)[:, 1] + [-0.2, 0.2]), 101)
    rest = np.full((1, len(v)), result.mu_a[shape.regions.index("bed")])
    chosen = backend.choose("auto", volpath=True)
    return finger_paths(shape, result, bed=BedAbsorption(v, rest), led=0, photodiodes=group, backend=chosen)


if __name__ == "__main__":
    main()
