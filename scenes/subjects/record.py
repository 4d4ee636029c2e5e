"""Record virtual people: what the sensor of each person in this folder reads under touches of known force.

    python scenes/subjects/record.py -o FOLDER [--person person_3 ...] [--photons 2000000]

Writes into the folder one CSV (time_s, force_n, site, volts) for each person's protocol, one for each kind of touch and
side, and each person's traced light, which later recordings reuse.

The recordings are made with a different model from the one that is fitted to them. A fit uses scenes/prototype.toml: an
index finger of default sizes and tissue, vessels "best", two zones with the distal pressure on the distal one only,
massless walls, one wavelength, neither epidermis nor Kapton, a million photons of seed 0. These people have
- walls with mass (the inertial equations), and other constants of the vessels;
- eight zones along the nail, with a distal pressure that decreases with the distance from the tip;
- other digits, sizes and skin, absorption and scattering of nail, bed, bone and pulp within the priors, other blood and
  saturation;
- epidermis, Kapton, an LED linewidth of 33 nm, another flux, another thickness of adhesive;
- two million photons of another seed;
- a pulp that creeps under the touch and recovers slowly; heartbeat, breathing, vasomotion, drift of the LED and of
  every reading, the noise of photodiode and amplifier, and quantization by the converter.
"""

import argparse
import itertools
import zlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from nailoptics.assets import data_dir
from nailoptics.errors import InputError
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.light import DetectedLight, trace
from nailoptics.light.detect import light_of
from nailoptics.light.transfer import Transfer
from nailoptics.options import TraceOptions
from nailoptics.scene import Scene, Touch, digest, load_scene, to_toml
from nailoptics.scene.importers.sensor_recordings import Recording
from nailoptics.sensor.ambient import scene_ambient_a
from nailoptics.sensor.volts import WornLight, with_fitted_resistors
from nailoptics.studies.force.reading_table import record
from nailoptics.studies.simulate import simulate_from

Array = NDArray[np.float64]
Corners = tuple[Array, Array]
Site = Literal["proximal", "distal", "even"]

PHOTONS, LIGHT_SEED = 2_000_000, 1001
SIDES: tuple[Site, ...] = ("proximal", "distal")
SAMPLE_RATE_HZ = 100.0
# The finger rests before, between and after touches. [s]
REST_S = 2.0
# Slow touches go up and down as the paper's subjects did, at 0.05 Hz. [s]
PERIOD_S, CORNERS_PER_PERIOD = 20.0, 256
# Largest forces of three slow cycles: for calibration, and of others that no calibration has seen. [N]
CALIBRATION_N, SLOW_N = (2.0, 2.0, 2.0), (0.4, 1.0, 2.0)
# Steps are held and left for so long, and take so long to rise and to fall, as fast as the paper's fastest. [N, s]
STEPS_N, HOLD_S, EDGE_S, CORNERS_PER_EDGE = (0.5, 0.15, 1.0, 0.3, 0.75), 2.0, 0.16, 16
# Other steps, for calibrations that are to tell how fast the vessels refill. [N]
QUICK_N = (0.8, 0.2, 1.2, 0.4, 0.6)
# Allowed error of a step of the vessels' equations, of a diameter. It adds up to 1e-5, below the converter's steps.
RTOL = 1e-3


def people() -> tuple[str, ...]:
    """Names of the shipped people."""
    return tuple(path.stem for path in sorted((data_dir("scenes") / "subjects").glob("*.toml")))


def load_person(name: str) -> Scene:
    """The scene of one of them."""
    return load_scene(data_dir("scenes") / "subjects" / f"{name}.toml")


def slow_cycles(peaks_n: tuple[float, ...]) -> Corners:
    """Corners of cycles of some largest forces, times [s] and forces [N]."""
    turns = np.arange(1, len(peaks_n) * CORNERS_PER_PERIOD + 1) / CORNERS_PER_PERIOD
    peak = np.repeat(peaks_n, CORNERS_PER_PERIOD)
    time_s = np.concatenate([[0.0], REST_S + PERIOD_S * np.append(0.0, turns)])
    force_n = np.concatenate([[0.0, 0.0], peak * np.sin(np.pi * turns) ** 2])
    return np.append(time_s, time_s[-1] + REST_S), np.append(force_n, 0.0)


def steps(forces_n: tuple[float, ...]) -> Corners:
    """Corners of steps with round edges, times [s] and forces [N]."""
    edge = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, CORNERS_PER_EDGE + 1)) ** 2
    times, forces, start_s = [np.zeros(1)], [np.zeros(1)], REST_S
    for force_n in forces_n:
        for rising, at_s in ((edge, start_s), (edge[::-1], start_s + HOLD_S)):
            times.append(at_s + EDGE_S * np.linspace(0.0, 1.0, edge.size))
            forces.append(force_n * rising)
        start_s += 2.0 * HOLD_S
    return np.append(np.concatenate(times), start_s), np.append(np.concatenate(forces), 0.0)


TOUCHES: dict[str, Corners] = {
    "calibration": slow_cycles(CALIBRATION_N),
    "slow": slow_cycles(SLOW_N),
    "steps": steps(STEPS_N),
    "quick": steps(QUICK_N),
}


def touch_of(scene: Scene, corners: Corners, site: Site, rate_hz: float = SAMPLE_RATE_HZ) -> Touch:
    """A person's touch at one site, with the person's own contact, creep and recovery."""
    time_s, force_n = (tuple(column.tolist()) for column in corners)
    fields = {"profile": "recorded", "recorded_time_s": time_s, "recorded_force_n": force_n, "site": site}
    return _own_touch(scene, fields | {"sample_rate_hz": rate_hz})


def protocol_of(scene: Scene, seed: int, rate_hz: float = SAMPLE_RATE_HZ) -> Touch:
    """A person's touches by the protocol of calibration, on both sides."""
    return _own_touch(scene, {"profile": "protocol", "protocol_seed": seed, "sample_rate_hz": rate_hz})


def _own_touch(scene: Scene, fields: dict[str, Any]) -> Touch:
    own = ("contact_area_mm2", "distal_relaxation_s", "creep", "creep_s")
    return Touch.model_validate(fields | {name: getattr(scene.touch, name) for name in own})


def light_of_person(scene: Scene, path: Path, *, photons: int = PHOTONS) -> DetectedLight:
    """A person's light, traced unless it was before; kept at a path."""
    if path.exists():
        # What another version kept is traced again.
        with suppress(InputError):
            kept = Transfer.load(path)
            if digest(_untouched(kept.scene)) == digest(_untouched(scene)) and kept.photons >= photons:
                return light_of(replace(kept, scene=scene))
    traced = trace(scene, photons=photons, seed=LIGHT_SEED)
    traced.save(path)
    return light_of(traced)


def _untouched(scene: Scene) -> Scene:
    """The scene without what moves its blood: it shares light with every other touch of the person."""
    blood = scene.blood.model_copy(update={"parameters": "listed", "tuning": None, "decay_length": None})
    return scene.model_copy(update={"touch": Touch(), "body": None, "blood": blood})


def record_touch(
    scene: Scene, light: DetectedLight, touch: Touch, *, seed: int, model: Literal["massless", "inertial"] = "massless"
) -> Recording:
    """What a worn sensor records of one more touch by a person whose light is traced.

    light : what `open_light` returned for the scene, whatever its touch. seed : of pulse, drift and noise.
    model : the equations of the vessels, as for `hemodynamics.respond`.
    """
    body = scene.body.model_copy(update={"seed": seed}) if scene.body else None
    touched = scene.model_copy(update={"touch": touch, "body": body})
    course = blood_over_touch(touched, model=model, rtol=RTOL)
    lit = WornLight(with_fitted_resistors(touched), light, scene_ambient_a(touched, TraceOptions(seed=seed)))
    result = simulate_from(lit, course=course, seed=seed)
    return record(result.assign_attrs(scene=to_toml(touched)), seed=seed)


def record_person(
    scene: Scene,
    light: DetectedLight,
    kind: str,
    site: Site,
    *,
    seed: int = 0,
    model: Literal["massless", "inertial"] = "inertial",
    rate_hz: float = SAMPLE_RATE_HZ,
) -> Recording:
    """What a person's sensor reads under one of `TOUCHES` at a site, or under the "protocol" on both sides in turn.

    light : the person's, of `light_of_person`.
    rate_hz : samples in a second.
    model : the equations of the vessels; both agree within 1e-5 of a reading, and the massless are ten times as fast.
    """
    if kind not in (*TOUCHES, "protocol"):
        raise InputError(f'kind = "{kind}" is no touch; choose from {", ".join(TOUCHES)}, protocol.')
    # Another heartbeat, drift and noise for every person and recording.
    own = zlib.crc32(f"{scene.body.seed if scene.body else 0} {kind} {site} {seed}".encode())
    drawn = kind == "protocol"
    touch = protocol_of(scene, own, rate_hz) if drawn else touch_of(scene, TOUCHES[kind], site, rate_hz)
    return record_touch(scene, light, touch, seed=own, model=model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for recordings and traced light")
    parser.add_argument("--person", nargs="*", default=people(), choices=people(), help="who; everybody if not given")
    parser.add_argument("--photons", type=int, default=PHOTONS, help="photons of each person's trace")
    parser.add_argument("--seed", type=int, default=0, help="of heartbeats, drift and noise")
    parser.add_argument("--massless", action="store_true", help="leave out the walls' mass: ten times as fast")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    model = "massless" if given.massless else "inertial"
    for name in given.person:
        scene = load_person(name)
        light = light_of_person(scene, given.output / f"{name}.transfer", photons=given.photons)
        for kind, side in [("protocol", SIDES[0]), *itertools.product(TOUCHES, SIDES)]:
            path = given.output / (f"{name}_{kind}.csv" if kind == "protocol" else f"{name}_{kind}_{side}.csv")
            recording = record_person(scene, light, kind, side, seed=given.seed, model=model)
            recording.save(path)
            print(path, flush=True)


if __name__ == "__main__":
    main()
