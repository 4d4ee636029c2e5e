"""Can shear be estimated beside force from the readings of scenes/shear.toml? Run:

    python tests/benchmarks/shear_bound.py [--photons 300000]

Printed are least standard errors (Cramer-Rao) of the shear of the scene's touch, held at some forces: where the forces
on both sides are unknown, where the touch is given to press evenly, and where its normal force is measured; of one
sample, and of so many of a touch, of which the electronics' noise averages out while drift and the arterial pressure's
slow wave stay.
"""

import argparse
from dataclasses import replace

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.for_scene import blood_model
from nailoptics.light import trace
from nailoptics.light.detect import light_of
from nailoptics.sensor import electronics
from nailoptics.sensor.volts import with_fitted_resistors

FORCES_N, SAMPLES = (0.15, 0.3, 0.5, 1.0, 1.5), (1, 200)
# Priors, rms, as large as scenes/subjects': forces and shear [N], the arterial pressure's waves [Pa], and drift
# in half a minute of the LED and of each reading [1].
BEFORE_N, WAVE_PA, DRIFT = 10.0, 500.0, 2e-4
# Of derivatives. [Pa]
STEP_PA = 100.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photons", type=int, default=300_000)
    scene = with_fitted_resistors(load_scene(data_dir("scenes") / "shear.toml"))
    model, light = blood_model(scene), light_of(trace(scene, photons=parser.parse_args().photons, seed=0))
    areas_mm2 = np.array(model.touch.contact.side_areas_mm2(0.5))[[0, 1, 1]]
    diodes = [element.photodiode for element in scene.layout.photodiodes]

    def read(pressure_pa: np.ndarray, wave_pa: float = 0.0) -> electronics.Output:
        rest_pa = model.parameters.arterial_pressure_pa
        moved = replace(model, parameters=replace(model.parameters, arterial_pressure_pa=rest_pa + wave_pa))
        part = light.readings_at(moved.steady(pressure_pa)).fraction[0, :, 0]
        return electronics.read(part, scene.leds[0], diodes, scene.electronics, ambient_a=np.zeros(len(diodes)))

    print("least error of the shear [N]: forces unknown, touch known to be even, normal force known")
    for force_n in FORCES_N:
        held_pa = model.touch.held_pa([force_n])
        usual = read(held_pa)
        ends = [(read(held_pa + step).volts, read(held_pa - step).volts) for step in STEP_PA * np.eye(3)[..., None]]
        ends.append((read(held_pa, STEP_PA).volts, read(held_pa, -STEP_PA).volts))
        per_pa = np.stack([(high - low) / (2 * STEP_PA * usual.volts) for high, low in ends], -1)
        proximal, distal, shear = (per_pa[:, :3] * 1e6 / areas_mm2).T
        drift = DRIFT**2 * (np.eye(len(diodes)) + np.ones((len(diodes), len(diodes))))
        drift += WAVE_PA**2 * np.outer(per_pa[:, 3], per_pa[:, 3])
        for samples in SAMPLES:
            noise = np.diag((usual.volts_noise_rms / usual.volts) ** 2 / samples) + drift
            errors_n = []
            for unknown in ((proximal, distal, shear), ((proximal + distal) / 2, shear), (shear,)):
                slopes = np.column_stack(unknown)
                known = slopes.T @ np.linalg.solve(noise, slopes) + np.eye(len(unknown)) / BEFORE_N**2
                errors_n.append(np.sqrt(np.linalg.inv(known)[-1, -1]))
            print(f"{force_n:4.2f} N, {samples:3d} samples " + " ".join(f"{error:7.3f}" for error in errors_n))


if __name__ == "__main__":
    main()
