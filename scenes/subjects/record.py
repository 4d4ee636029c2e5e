"""Record virtual people: what the sensor of each person in this folder reads under touches of known force.

    python scenes/subjects/record.py -o FOLDER [--person person_3 ...] [--photons 2000000]

Writes into the folder one CSV (time_s, force_n, site, volts) for each person, kind of touch and side, and each person's
traced light, which later recordings reuse.

The recordings are made with a different model from the one that is fitted to them. A fit uses scenes/prototype.toml: an
index finger of default sizes and tissue, vessels "best", two zones with the distal pressure on the distal one only,
massless walls, one wavelength, neither epidermis nor Kapton, a million photons of seed 0. These people have
- walls with mass (the inertial equations), and other constants of the vessels;
- eight zones along the nail, with a distal pressure that decreases with the distance from the tip;
- other sizes, absorption and scattering of nail, bed, bone and pulp within the priors, other blood and saturation;
- epidermis, Kapton, an LED linewidth of 33 nm, another flux, another thickness of adhesive;
- two million photons of another seed;
- a pulp that creeps under the touch and recovers slowly; heartbeat, breathing, vasomotion, drift of the LED and of
  every reading, the noise of photodiode and amplifier, and quantization by the converter.
"""

import argparse
from pathlib import Path

from nailoptics.io import write_text
from nailoptics.scene.importers.sensor_recordings import recording_csv
from nailoptics.studies.force.virtual_people import (
    PHOTONS,
    SIDES,
    TOUCHES,
    light_of_person,
    load_person,
    people,
    record_person,
)


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
        for kind in TOUCHES:
            for side in SIDES:
                path = given.output / f"{name}_{kind}_{side}.csv"
                recording = record_person(scene, light, kind, side, seed=given.seed, model=model)
                write_text(path, recording_csv(recording))
                print(path, flush=True)


if __name__ == "__main__":
    main()
