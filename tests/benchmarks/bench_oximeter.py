"""How long an oximeter takes, from the light to a hundred saturations: python tests/benchmarks/bench_oximeter.py."""

import time

import numpy as np

from nailoptics import load_scene, trace
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.for_scene import beat_at
from nailoptics.studies.oximetry.ratio import saturation_curve
from nailoptics.variables import jackknifed

PHOTONS = 1 << 20


def main() -> None:
    """Processor seconds of the trace, of the curve and of a hundred saturations; the error of R that they buy."""
    scene = load_scene(data_dir("scenes") / "pulse_oximeter.toml")
    marks = [time.process_time()]
    light = trace(scene, photons=PHOTONS, seed=1)
    marks.append(time.process_time())
    curve = saturation_curve(light, (0, 1), beat_at(scene, 0.0), low=0.5, high=1.0)
    marks.append(time.process_time())
    ratio, error = jackknifed(curve(np.linspace(0.5, 1.0, 100)).ratio)
    marks.append(time.process_time())
    for name, seconds in zip(("trace", "curve", "100 saturations"), np.diff(marks), strict=True):
        print(f"{name:<16} {seconds:8.3f} s")
    print(f"relative error of R on the best photodiode: {float((error / ratio).max(-1).min()):.3%}")


if __name__ == "__main__":
    main()
