"""How well force is told from volts, on eight virtual people whom no model of ours made. Run: python bench_force.py

    python bench_force.py [--person person_3 ...] [--keep FOLDER] [--no-pairs] [--rest-s 3600] [--massless]
        [--without zones|vessels|optics|creep|rhythms|drift]

Each person (scenes/subjects) is recorded as scenes/subjects/record.py says, calibrated on slow cycles of 0-2 N on
either side with scenes/prototype.toml as the guess, and read under touches that no calibration has seen. Prints:
- for every person, side and kind of touch (slow cycles of 0.4 and 1 N; steps of 0.15-1 N that rise in 0.16 s): the rms
  error of the filter and of both regressions, the part of samples below closure that the 95 % interval covers, and of
  a slow cycle to 2 N the part of samples above closure whose interval is open;
- their medians over the people, beside what must be reached;
- who is read with whose calibration, and whether that is flagged or the interval covers all the same;
- presses in an hour of rest; processor time of a calibration and of a sample.
With --without people are as the fitted model in one thing, to see how much of the error it makes.
Ctrl-C ends it with the table of what is done. FOLDER keeps traced light for the next run.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import nailoptics as nail
from nailoptics.assets import data_dir
from nailoptics.scene.sensor_recordings import Recording
from nailoptics.studies.force import virtual_people as record
from nailoptics.studies.force.calibrate import calibrate_with, open_table
from nailoptics.studies.force.subject import Subject, parse_subject

sys.path.append(str(Path(__file__).parents[1]))

from force_scores import (  # noqa: E402
    DIFFERENCES,
    KINDS,
    PAIR_STRIDE,
    Score,
    pair,
    presses_at_rest,
    score,
    seconds_per_sample,
    thinned,
    virtual_person,
)

# What must be reached, by column.
GOALS = {
    "rms": "at most 0.05",
    "linear": "steps 1.5 rms, slow 1 rms or more",
    "components": "the same",
    "covered": "0.90 to 0.98",
    "open": "0.95",
}


HEADER = (
    f"{'person':<10} {'side':<9} {'kind':<6} {'rms':>7} {'linear':>7} {'components':>10} {'covered':>8} {'open':>6}"
)


def line(who: str, site: str, kind: str, row: Iterable[float]) -> str:
    rms, linear, components, covered, is_open = row
    return (
        f"{who:<10} {site:<9} {kind:<6} {rms:7.3f} {linear:7.3f} {components:10.3f} {covered:8.3f} {is_open:6.2f}"
    ).replace("nan", "  -")


def medians(scores: list[Score]) -> list[str]:
    """The table's last lines: medians over people."""
    out = []
    for site in record.SIDES:
        for kind in KINDS:
            rows = np.array([one.row for one in scores if (one.site, one.kind) == (site, kind)])
            if len(rows):
                seen = [column[np.isfinite(column)] for column in rows.T]
                out.append(line("median", site, kind, [np.median(c) if c.size else np.nan for c in seen]))
    return out


def pairs_table(subjects: dict[str, Subject], steps: dict[str, Recording]) -> list[str]:
    """Every person read with every other's calibration."""
    out, good, count = [], 0, 0
    for owner, subject in subjects.items():
        found = [pair(subject, thinned(one, PAIR_STRIDE)) for one in steps.values()]
        others = [what for what, name in zip(found, steps, strict=True) if name != owner]
        good, count = good + sum(what != "WRONG" for what in others), count + len(others)
        out.append(f"{owner:<10} " + " ".join(f"{what:<8}" for what in found))
        print(out[-1], flush=True)
    if count:
        print(
            f"flagged or covered in {good} of {count} pairs ({good / count:.0%}; at least 90 % are asked)", flush=True
        )
    return out


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--person", nargs="*", default=record.people(), choices=record.people())
    asked.add_argument("--keep", type=Path, help="folder for traced light; forgotten at the end if not given")
    asked.add_argument("--no-pairs", action="store_true", help="leave out who is read with whose calibration")
    asked.add_argument("--rest-s", type=float, default=3600.0, help="rest of the first person; 0 leaves it out [s]")
    asked.add_argument("--massless", action="store_true", help="people without inertia: faster, the same to 1e-5")
    asked.add_argument("--without", choices=tuple(DIFFERENCES), help="people are as the fitted model in this")
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as passing:
        run(given, given.keep or Path(passing))


def run(given: argparse.Namespace, keep: Path) -> None:
    keep.mkdir(parents=True, exist_ok=True)
    scores: list[Score] = []
    subjects: dict[str, Subject] = {}
    steps: dict[str, Recording] = {}
    first = None
    print(HEADER, flush=True)
    try:
        scene, table = open_table(nail.load_scene(data_dir("scenes") / "prototype.toml"))
        for name in given.person:
            model = "massless" if given.massless else "inertial"
            person = virtual_person(name, keep, model, without=given.without)
            begin = time.process_time()
            recordings = [person.recording("calibration", site) for site in record.SIDES]
            made = time.process_time() - begin
            subject = parse_subject(calibrate_with(scene, table, recordings).attrs["subject"])
            spent = time.process_time() - begin - made
            for site in record.SIDES:
                for kind in KINDS:
                    scores.append(score(subject, person, kind, site))
                    print(line(name, site, kind, scores[-1].row), flush=True)
            subjects[name], steps[name] = subject, person.recording("steps", "proximal", seed=1)
            per_sample = 1e3 * seconds_per_sample(subject, steps[name])
            first = first or person
            print(
                f"{name}: calibrated in {spent:.0f} s of processor time, rms {subject.rms_n:.3f} N, intervals widened "
                f"{subject.widening:.2f} times; {per_sample:.2f} ms a sample",
                flush=True,
            )
        if not given.no_pairs:
            pairs_table(subjects, steps)
        if given.rest_s and first is not None:
            count = presses_at_rest(subjects[first.name], first, given.rest_s)
            print(f"{first.name}: {count} presses in {given.rest_s:g} s of rest", flush=True)
    except KeyboardInterrupt:
        print("interrupted; what is done:", flush=True)
    print("\n".join([HEADER, *medians(scores)]))
    print("asked: " + "; ".join(f"{name} {goal}" for name, goal in GOALS.items()))


if __name__ == "__main__":
    main()
