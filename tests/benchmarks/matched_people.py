"""How the error over touches, by which `place` ranks layouts, compares with what people reach. Run:

    python matched_people.py [--people 20] [--records 8] [--photons 300000] [--json FILE]

People are drawn from the priors as for `[placement] people`, and wear the prototype's board; vessels without mass, no
arterioles, the usual pulp, so that the fitted model has all of them. Each person's error is
- computed: `TouchError`, for 0.5 N;
- known: the rms over the same touches, in records with other heartbeats, waves and noise, of `predict` for the person
  calibrated without error;
- calibrated: of `predict` calibrated on the protocol, at 25 samples a second, with the finger of scenes/placement.toml
  as the guess; filter: of its Kalman filter alone.
Prints for each person the computed error and the ratios of the others to it, each with the standard error by records,
then over people the median with its standard error (bootstrap), spread, and how many are within a factor of 1.3.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from nailoptics import load_scene
from nailoptics.assets import data_dir
from nailoptics.hemodynamics.for_scene import blood_over_touch
from nailoptics.scene import Scene, to_toml
from nailoptics.scene.importers.sensor_recordings import Recording
from nailoptics.sensor.volts import WornLight, with_fitted_resistors, worn_light
from nailoptics.studies.force.calibrate import calibrate_with, open_table
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.reading_table import ReadingTable, record
from nailoptics.studies.force.scores import TOUCH_N
from nailoptics.studies.force.subject import parse_subject
from nailoptics.studies.force.touch_error import RATE_HZ, TouchError
from nailoptics.studies.placement import boards
from nailoptics.studies.simulate import simulate_from

sys.path += [str(Path(__file__).parents[up] / folder) for up, folder in ((1, ""), (2, "scenes/subjects"))]

from record import RTOL, protocol_of  # noqa: E402
from worn_prototype import computed_n, exactly_calibrated, played, worn  # noqa: E402

FORCE_N, WITHIN = 0.5, 1.3
HOW = ("known", "calibrated", "filter")


def played_by(light: WornLight, scene: Scene, seed: int) -> Recording:
    """What the sensor reads under a scene's touch, by a body of this seed."""
    body = scene.body.model_copy(update={"seed": seed}) if scene.body else None
    touched = scene.model_copy(update={"body": body})
    course = blood_over_touch(touched, model="massless", rtol=RTOL)
    result = simulate_from(replace(light, scene=with_fitted_resistors(touched)), course=course, seed=seed)
    return record(result.assign_attrs(scene=to_toml(touched)), seed=seed)


def errors_n(scene: Scene, guess: tuple[Scene, ReadingTable], seed: int, given: argparse.Namespace) -> dict[str, float]:
    """One person's errors and their standard errors. [N]"""
    touches, table = TouchError(scene, FORCE_N), open_table(scene, photons=given.photons)[1]
    states = np.linspace([0.0, 0.0], [2.0 * scene.blood.rest_blood_fraction] * 2, 5)
    light = worn_light(scene, states=states, photons=given.photons)[0]
    touched = scene.model_copy(update={"touch": scene.touch.model_copy(update=played(touches))})
    protocol = scene.model_copy(update={"touch": protocol_of(scene, 1000 + seed, RATE_HZ)})
    records = [replace(played_by(light, touched, k), names=table.names) for k in range(given.records)]
    calibration = replace(played_by(light, protocol, 500 + seed), names=table.names)
    own = parse_subject(calibrate_with(*guess, [calibration]).attrs["subject"])
    squares: dict[str, list[float]] = {how: [] for how in HOW}
    for one in records:
        known = predict(exactly_calibrated(scene, touches, table, one), one)
        read = predict(own, one)
        for how, force_n in zip(HOW, (known.force_n, read.force_n, read.force_filter_n), strict=True):
            off_n = (force_n.values - known.known_force_n.values)[known.known_force_n.values >= TOUCH_N]
            squares[how].append(float(np.nanmean(off_n**2)))
    row = {"computed": computed_n(touches, table), "quality": own.quality.relative_error}
    for how, each in squares.items():
        row[how] = float(np.sqrt(np.mean(each)))
        row[f"{how}_stderr"] = float(np.std(each, ddof=1) / np.sqrt(len(each)) / (2.0 * row[how]))
    return row


def summary(rows: list[dict[str, float]]) -> Iterator[str]:
    """Lines over people."""
    for how in HOW:
        ratio, random = np.array([row[how] / row["computed"] for row in rows]), np.random.default_rng(0)
        stderr = np.median(random.choice(ratio, (4000, len(ratio))), axis=1).std()
        within = int((np.abs(np.log(ratio)) < np.log(WITHIN)).sum())
        yield (
            f"{how:<10} over computed: median {np.median(ratio):.2f} +- {stderr:.2f}, {ratio.min():.2f} to "
            f"{ratio.max():.2f}, spread of logarithms {np.log(ratio).std(ddof=1):.2f}; within {WITHIN:g}: {within} of "
            f"{len(ratio)}"
        )


def main() -> None:
    requested = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    requested.add_argument("--people", type=int, default=20, help="how many, of as many that are drawn")
    requested.add_argument("--records", type=int, default=8, help="of each person's touches, two or more")
    requested.add_argument("--photons", type=int, default=300_000, help="of each trace")
    requested.add_argument("--json", type=Path, help="file that keeps each person's errors")
    given = requested.parse_args()
    usual = load_scene(data_dir("scenes") / "placement.toml").with_({"placement.people": given.people})
    guess, rows = open_table(worn(usual), photons=given.photons), list[dict[str, float]]()
    for k, person in enumerate(boards.people(usual)):
        rows.append(errors_n(worn(boards.worn_on(boards.base_board(usual), person)), guess, k, given))
        row = rows[-1]
        ratios = (
            f"{how} {row[how] / row['computed']:.2f} +- {row[how + '_stderr'] / row['computed']:.2f}" for how in HOW
        )
        quality = f"{row['quality']:.0%} of held-out touches"
        print(f"person_{k + 1:<3} computed {1e3 * row['computed']:4.0f} mN; {', '.join(ratios)}; {quality}", flush=True)
    print("\n".join(summary(rows)))
    if given.json:
        given.json.write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
