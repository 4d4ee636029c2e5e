"""Do 660 nm beside 850 nm distinguish a held proximal touch from a slow rise of the arterial pressure? Run:

    python tests/benchmarks/two_wavelengths.py FOLDER [--people person_3 ...] [--photons 100000] [--touches]

People of scenes/subjects whose bed loses oxygen where its blood stands still (`oxygen_balance`) wear the prototype with
an 850 nm die in place of the LED, and a 660 nm die beside it. Printed is the
least standard error (Cramer-Rao) of the force of a touch that has been held for some time, from one sample, where an
arterial pressure that rose with it, the other side's pressure, drift and noise are unknown, and how fast the blood
loses oxygen, too: for 850 nm alone, for both, and for both with that given. With --touches it is the
error of held-out touches, rms, and the part that the 95 % interval covers, with either board.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path += [str(Path(__file__).parents[up] / folder) for up, folder in ((1, ""), (2, "scenes/subjects"))]

import record  # noqa: E402
from force_scores import CALIBRATIONS, KINDS, PROTOTYPE, VirtualPerson, calibrated, score  # noqa: E402

from nailoptics import load_scene  # noqa: E402
from nailoptics.hemodynamics.for_scene import blood_over_touch  # noqa: E402
from nailoptics.light import DetectedLight  # noqa: E402
from nailoptics.scene import Scene, Touch  # noqa: E402
from nailoptics.scene.body import Body  # noqa: E402
from nailoptics.sensor.volts import WornLight, read_volts, with_fitted_resistors  # noqa: E402
from nailoptics.studies.force.calibrate import open_table  # noqa: E402
from nailoptics.studies.force.subject import parse_subject  # noqa: E402

# The dies, side by side, and by how much a finger's veins hold less oxygen than its arteries.
LEDS: list[dict[str, Any]] = [
    {"name": "infrared", "part": "led_800", "wavelength_nm": 850.0, "position_mm": (-1.2, -0.15)},
    {"name": "red", "part": "led_660", "position_mm": (-1.2, 0.15)},
]
LOST = 0.08
# A touch is held from here on, and read so long after. [s]
TOUCHED_S, RISE_S, AFTER_S = 40.0, 1.0, (2.0, 10.0)
FORCES_N = (0.15, 0.3, 0.5, 0.7, 1.0)
# Steps of both pressures [Pa], the arterial one [Pa], and the veins' saturation [1]; the prior of each.
STEPS = np.array([100.0, 100.0, 100.0, 0.01])
TOUCH_PA, SATURATION = 5e3, 0.03


def worn_by(name: str) -> Scene:
    """A person of scenes/subjects with both dies, whose blood loses oxygen."""
    return with_dies(record.load_person(name))


def with_dies(scene: Scene, count: int = 2) -> Scene:
    """The scene with the first of the dies."""
    oxygen = {"blood.venous_so2": scene.blood.so2 - LOST, "blood.oxygen_balance": True}
    return scene.with_(leds=LEDS[:count], **oxygen)


def held(scene: Scene, light: DetectedLight, pressure_pa: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Readings (R, t) at AFTER_S of a touch, and their noise [V]; pressures: both touches', by how much the arterial
    one rises with them, and the veins' saturation."""
    proximal_pa, distal_pa, arterial_pa, venous_so2 = pressure_pa.tolist()
    corners_s = (0.0, TOUCHED_S, TOUCHED_S + RISE_S, TOUCHED_S + RISE_S + AFTER_S[-1] + 0.5)
    own = {name: getattr(scene.touch, name) for name in ("contact_area_mm2", "distal_relaxation_s", "creep", "creep_s")}
    pressures = {
        f"recorded_{side}_pressure_pa": (0.0, 0.0, pa, pa)
        for side, pa in (("proximal", proximal_pa), ("distal", distal_pa))
    }
    fields = {"profile": "recorded", "recorded_time_s": corners_s, "sample_rate_hz": 10.0}
    mean_pa = blood_mean_pa(scene)
    high = tuple(mean_pa + np.array([0.0, 0.0, arterial_pa, arterial_pa]))
    body = Body(recorded_time_s=corners_s, recorded_arterial_pressure_pa=high)
    touched = scene.model_copy(update={"touch": Touch.model_validate(own | fields | pressures), "body": body})
    touched = touched.with_(**{"blood.venous_so2": venous_so2})
    course = blood_over_touch(touched, model="massless", rtol=1e-5)
    lit = WornLight(with_fitted_resistors(touched), light, None)
    result = read_volts(lit, course)
    at = np.searchsorted(course.time.values, [TOUCHED_S + RISE_S + after for after in AFTER_S])
    volts, noise = (result[name].values[..., at].reshape(-1, len(AFTER_S)) for name in ("volts", "volts_noise_rms"))
    return volts, noise


def blood_mean_pa(scene: Scene) -> float:
    """The arterial pressure at which the person's blood at rest holds."""
    from nailoptics.hemodynamics.for_scene import vessels

    return float(vessels(scene).arterial_pressure_pa)


def one_sample(name: str, folder: Path, photons: int) -> None:
    """Print the least errors of one person."""
    scene = worn_by(name)
    light = record.light_of_person(scene, folder / f"{name}_dies.transfer", photons=photons)
    waves_pa = np.hypot(scene.body.vasomotion.amplitude_pa, scene.body.breathing.amplitude_pa / np.sqrt(2))
    drift = scene.body.drift
    red = np.repeat([0.0, 1.0], len(scene.layout.photodiode_names))
    for side in (0, 1):
        for force_n in FORCES_N:
            base = np.array([0.0, 0.0, 0.0, scene.blood.venous_so2])
            base[side] = force_n / (1e-6 * scene.touch.contact_area_mm2)
            columns = []
            for k, step in enumerate(STEPS):
                up, down = base.copy(), base.copy()
                up[k] += step
                down[k] = max(base[k] - step, 0.0) if k != 2 else base[k] - step
                (high_v, noise_v), (low_v, _) = held(scene, light, up), held(scene, light, down)
                columns.append((high_v - low_v) / (up[k] - down[k]))
            slopes, volts = np.stack(columns, -1), 0.5 * (high_v + low_v)
            for t, after_s in enumerate(AFTER_S):
                relative = slopes[:, t] / volts[:, [t]]
                led = drift.led_per_rt_min**2 * np.equal.outer(red, red)
                covariance = np.diag((noise_v[:, t] / volts[:, t]) ** 2 + 0.5 * drift.reading_per_rt_min**2) + 0.5 * led
                area = 1e-6 * scene.touch.contact_area_mm2
                errors = [
                    area * least_error(relative[at], covariance[np.ix_(at, at)], waves_pa, spread, side)
                    for at, spread in ((red == 0, SATURATION), (red >= 0, SATURATION), (red >= 0, 1e-6))
                ]
                texts = " ".join(f"{1e3 * error:7.0f}" for error in errors)
                print(f"{name} {record.SIDES[side]:<9} {force_n:4.2f} N after {after_s:4.0f} s {texts}", flush=True)


def touches(name: str, folder: Path, photons: int) -> None:
    """Print how well one person's touches are estimated with one die and with both, calibrated by the protocol."""
    for count in (1, 2):
        own = with_dies(record.load_person(name), count)
        person = VirtualPerson(f"{name}_{count}_dies", own, folder, model="massless", rate_hz=25.0, photons=photons)
        opened = open_table(load_scene(PROTOTYPE).with_(leds=LEDS[:count]), photons=10 * photons)
        subject = parse_subject(calibrated(person, *opened, kinds=CALIBRATIONS["protocol"]))
        for site in record.SIDES:
            for kind in KINDS:
                one = score(subject, person, kind, site)
                dies = " and ".join(led["name"] for led in LEDS[:count])
                rms = f"rms {1e3 * one.rms_n:4.0f} mN (filter {1e3 * one.filter_n:4.0f})"
                print(f"{name} {site:<9} {kind:<6} {dies:<16} {rms}, covered {one.covered:.2f}", flush=True)


def least_error(slopes: np.ndarray, covariance: np.ndarray, waves_pa: float, so2: float, side: int) -> float:
    """Standard error of the pressure of one side. [Pa]"""
    prior = np.array([TOUCH_PA, TOUCH_PA, waves_pa, so2]) ** -2
    known = np.linalg.inv(slopes.T @ np.linalg.solve(covariance, slopes) + np.diag(prior))
    return float(np.sqrt(known[side, side]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--people", nargs="+", default=["person_3", "person_5", "person_6"], choices=record.people())
    parser.add_argument("--photons", type=int, default=100_000)
    parser.add_argument("--touches", action="store_true", help="estimate held-out touches instead")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    if not given.touches:
        print("least error of the force from one sample [mN]: 850 nm alone, 850 and 660 nm, both with oxygen known")
    for name in given.people:
        (touches if given.touches else one_sample)(name, given.folder, given.photons)


if __name__ == "__main__":
    main()
