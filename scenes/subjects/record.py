"""Record virtual people: what the sensor of each person in this folder reads under touches of known force.

    python scenes/subjects/record.py -o FOLDER [--person person_3 ...] [--photons 2000000]

Writes into the folder one CSV (time_s, force_n, site, volts) for each person, kind of touch and side, and each person's
traced light, which serves every later recording.

No recording is made with the model that is fitted to it. A fit takes scenes/prototype.toml: an index finger of usual
sizes and tissue, vessels "best", two zones of which the distal one alone feels the distal pressure, massless walls, one
wavelength, neither epidermis nor Kapton, a million photons of seed 0. These people have
- walls with mass (the inertial equations), and each constant of the vessels another;
- eight zones along the nail, on which the distal pressure falls off with the distance from the tip;
- nail, bed, bone and pulp of other sizes, absorption and scattering within the priors, other blood and saturation;
- epidermis, Kapton, the LED's line of 33 nm and other flux, another thickness of adhesive;
- two million photons of another seed;
- a pulp that spreads under the touch and recovers slowly; heartbeat, breathing, vasomotion, drift of the LED and of
  every reading, the noise of photodiode and amplifier, and the converter's steps.
"""

import argparse
from pathlib import Path

from nailoptics.io import write_text
from nailoptics.scene.sensor_recordings import recording_csv
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
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("-o", "--output", type=Path, required=True, help="folder for recordings and traced light")
    asked.add_argument("--person", nargs="*", default=people(), choices=people(), help="who; everybody if not given")
    asked.add_argument("--photons", type=int, default=PHOTONS, help="photons of each person's trace")
    asked.add_argument("--seed", type=int, default=0, help="of heartbeats, drift and noise")
    asked.add_argument("--massless", action="store_true", help="leave out the walls' mass: ten times as fast")
    given = asked.parse_args()
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
