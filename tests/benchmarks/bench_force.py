"""How well force is estimated from volts, of eight virtual people whom no model of ours made. Run:

    python bench_force.py --keep FOLDER [--people person_3 ...] [--part record|touches|.. ...]
        [--rate 25] [--rest-s 3600] [--massless] [--calibration protocol|cycles] [--photons 300000]
        [--without zones|vessels|optics|creep|heartbeat|breathing|vasomotion|rhythms|drift]

Each person (scenes/subjects) is recorded as by scenes/subjects/record.py, calibrated on the protocol of touches (or
on slow cycles of 0-2 N and steps of other heights on either side) with scenes/prototype.toml as the guess, and read
under held-out touches. Parts:
- record: recordings alone, which every other part makes when it needs them;
- touches: for every person, site (either side, and both at once, which no calibration has) and kind of touch (slow
  cycles of 0.4 and 1 N; steps of 0.15-1 N that rise in 0.16 s) the rms error over touches of 0.15 N and more of the
  estimate, of the filter alone and of the baselines, the part of their samples below closure that the 95 % interval
  covers, its median half width, and of a slow cycle to 2 N the part of samples above closure whose interval is open;
  the medians over the people, beside what must be reached;
- sample: the least standard error (Cramer-Rao) of one sample's estimate of a held touch, of a person estimated
  without error, through the noise of the readings, their drift and the slow waves of the arterial pressure;
- floor: the rms of the same filter where nothing but the body's own noise is left: people who are what was calibrated,
  all of them calibrated without error, estimated from the samples before each and from all;
- pairs: who is read with whose calibration, and whether that is flagged or the interval covers all the same;
- rest: presses of the virtual switch in an hour of rest of every person, with pulse and drift;
- processor time of a calibration and of a sample.
With --without people are as the fitted model in one respect, which shows how much of the error it causes.
FOLDER keeps traced light, recordings and results: the same command resumes where it ended (Ctrl-C prints the table of
what is done). Results of other code are computed again, from the same recordings.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from nailoptics import load_scene
from nailoptics.scene import Scene
from nailoptics.studies.force.calibrate import open_table
from nailoptics.studies.force.predict import predict
from nailoptics.studies.force.reading_table import ReadingTable
from nailoptics.studies.force.subject import Subject, parse_subject

sys.path += [str(Path(__file__).parents[up] / folder) for up, folder in ((1, ""), (2, "scenes/subjects"))]

import force_page  # noqa: E402
import record  # noqa: E402
from force_floor import floor_n, one_sample_n  # noqa: E402
from force_scores import (  # noqa: E402
    CALIBRATIONS,
    DIFFERENCES,
    KINDS,
    PROTOTYPE,
    SITES,
    Score,
    VirtualPerson,
    calibrated,
    code_of_force,
    kept,
    pair,
    presses_at_rest,
    recordings_of,
    score,
    seconds_per_sample,
    virtual_person,
)

PARTS = ("record", "touches", "sample", "floor", "pairs", "rest")
# Held touches of `sample`. [N]
HELD_N = (0.15, 0.3, 0.5, 0.7, 0.85, 1.0)
# What must be reached by the medians.
GOALS = (
    "rms at most 0.055 (slow proximal), 0.060 (steps proximal), 0.030 (slow distal), 0.060 (steps distal)",
    "nobody more than 1.15 times the filter's or 1.1 times the cubic's",
    "covered 0.90 to 0.98, each at least 0.85, half width at most twice the rms",
)
HEADER = (
    f"{'person':<10} {'side':<9} {'kind':<6} {'rms':>7} {'filter':>7} {'cubic':>7} {'components':>10} {'sigmoid':>8} "
    f"{'covered':>8} {'+-':>6} {'open':>6}"
)


def row(one: Score) -> tuple[float, ...]:
    """The numbers of one line of the table."""
    errors_n = one.rms_n, one.filter_n, one.cubic_n, one.components_n, one.sigmoid_n
    return *errors_n, one.covered, one.half_width_n, one.open_above


def line(who: str, site: str, kind: str, numbers: Iterable[float]) -> str:
    """One line of the table."""
    rms, by_filter, cubic, components, sigmoid, covered, half_width, is_open = numbers
    return (
        f"{who:<10} {site:<9} {kind:<6} {rms:7.3f} {by_filter:7.3f} {cubic:7.3f} {components:10.3f} {sigmoid:8.3f} "
        f"{covered:8.3f} {half_width:6.3f} {is_open:6.2f}"
    ).replace("nan", "  -")


class Bench:
    """Results of some people, each computed once; a folder keeps them for the next run."""

    def __init__(self, given: argparse.Namespace, folder: Path) -> None:
        model = "massless" if given.massless else "inertial"
        options: dict[str, Any] = {"without": given.without, "model": model, "rate_hz": given.rate}
        options["photons"] = given.photons
        self.people = {name: virtual_person(name, folder, **options) for name in given.people}
        self.kinds = CALIBRATIONS[given.calibration]
        self.results = folder / f"results_{code_of_force()}_{model}_{given.rate:g}hz_{given.calibration}"
        self.results.mkdir(parents=True, exist_ok=True)
        self.scores: dict[tuple[str, str, str], Score] = {}
        self.floors_n: dict[tuple[str, str, str], float] = {}
        self.begun = time.monotonic()

    def say(self, text: str) -> None:
        """Progress on stderr."""
        print(f"{time.monotonic() - self.begun:6.0f} s  {text}", file=sys.stderr, flush=True)

    @cached_property
    def network(self) -> tuple[Scene, ReadingTable]:
        return open_table(load_scene(PROTOTYPE))

    def subject(self, name: str) -> tuple[Subject, float]:
        """A person's calibration, and the processor time that it took. [s]"""
        person = self.people[name]

        def find() -> dict[str, Any]:
            recordings_of(person, self.kinds)
            begin = time.process_time()
            text = calibrated(person, *self.network, kinds=self.kinds)
            return {"subject": text, "cpu_s": time.process_time() - begin}

        result = kept(self.results / f"{person.name}_subject.json", find)
        return parse_subject(result["subject"]), result["cpu_s"]

    def record(self) -> None:
        """Record everybody."""
        for name, person in self.people.items():
            person.recording("protocol", "proximal")
            for site in record.SIDES:
                for kind in record.TOUCHES:
                    person.recording(kind, site, seed=1 if kind in KINDS else 0)
                    self.say(f"{name} {site:<9} {kind} recorded")

    def touches(self) -> None:
        """Score every person's touches."""
        for name, person in self.people.items():
            for site in SITES:
                for kind in KINDS:

                    def find(kind: str = kind, site: record.Site = site, name: str = name) -> Score:
                        return score(self.subject(name)[0], self.people[name], kind, site)

                    path = self.results / f"{person.name}_{site}_{kind}.json"
                    one = Score(**kept(path, find))
                    self.scores[name, site, kind] = one
                    self.say(f"{name} {site:<9} {kind:<6} rms {one.rms_n:.3f} N")

    def table(self) -> Iterator[str]:
        """Lines of what is scored, and medians over people."""
        yield HEADER
        rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        for (name, site, kind), one in self.scores.items():
            numbers = row(one)
            rows.setdefault((site, kind), []).append(numbers)
            yield line(name, site, kind, numbers) + ("" if one.consistent else "  flagged")
        for (site, kind), several in rows.items():
            finite = [column[np.isfinite(column)] for column in np.array(several).T]
            yield line("median", site, kind, [np.median(one) if one.size else np.nan for one in finite])
        yield "required of medians: " + "; ".join(GOALS)

    def keep(self, path: Path | None) -> None:
        """Keep what was scored for the documentation, with the floor where that was computed."""
        names = ("rms_n", "filter_n", "cubic_n", "components_n", "sigmoid_n", "covered", "half_width_n", "open")
        rows = []
        for (name, site, kind), one in self.scores.items():
            row = {"touches": f"{kind} {site}", "person": name} | {column: getattr(one, column) for column in names}
            floor = self.floors_n.get((name, site, kind))
            rows.append(row if floor is None else row | {"floor_n": floor})

        def series(name: str, touches: str) -> tuple[Iterable[float], ...]:
            kind, site = touches.split()
            estimated = predict(self.subject(name)[0], self.people[name].recording(kind, site, seed=1))
            columns = ("time", "known_force_n", "force_n", "force_low_n", "force_high_n")
            return tuple(estimated[column].values.tolist() for column in columns)

        if path and rows:
            force_page.keep(path, "scenes/subjects", sorted(rows, key=lambda row: str(row["touches"])), series)

    def costs(self) -> Iterator[str]:
        """Every calibration's quality and processor time."""
        for name, person in self.people.items():
            subject, cpu_s = self.subject(name)
            per_sample_s = seconds_per_sample(subject, person.recording("steps", "proximal", seed=1))
            yield (
                f"{name}: calibrated in {cpu_s:.0f} s of processor time, rms {subject.quality.rms_n:.3f} N, "
                f"{subject.quality.relative_error:.0%} of held-out touches; {1e3 * per_sample_s:.2f} ms a sample"
            )

    def sample(self) -> Iterator[str]:
        """The least error of one sample of held touches, and medians over people."""
        yield f"{'person':<10} {'side':<9} " + " ".join(f"{force_n:5.2f} N" for force_n in HELD_N)
        for site in record.SIDES:
            rows = []
            for name in self.people:
                subject = self.subject(name)[0]
                rows.append([one_sample_n(subject, site, force_n) for force_n in HELD_N])
                yield f"{name:<10} {site:<9} " + " ".join(f"{stderr_n:7.3f}" for stderr_n in rows[-1])
            yield f"{'median':<10} {site:<9} " + " ".join(f"{stderr_n:7.3f}" for stderr_n in np.median(rows, axis=0))

    def floor(self) -> Iterator[str]:
        """How well each person's touches could be estimated by a calibration without error, and medians over people."""
        yield f"{'person':<10} {'side':<9} {'kind':<6} {'floor':>7}  [N]"
        for site in record.SIDES:
            for kind in KINDS:
                rows = []
                for name, person in self.people.items():
                    subject, path = self.subject(name)[0], f"{person.name}_floor_{site}_{kind}.json"
                    rows.append(kept(self.results / path, partial(floor_n, subject, person, kind, site)))
                    self.floors_n[name, site, kind] = rows[-1]
                    yield f"{name:<10} {site:<9} {kind:<6} {rows[-1]:7.3f}"
                yield f"{'median':<10} {site:<9} {kind:<6} {np.median(rows):7.3f}"

    def pairs(self) -> Iterator[str]:
        """Every person read with every other's calibration."""
        good, count = 0, 0
        yield "read with the calibration of (line) steps of (column)"
        yield " " * 11 + " ".join(f"{name:<8}" for name in self.people)
        for owner, own in self.people.items():
            cells = []
            for name, other in self.people.items():

                def find(owner: str = owner, other: VirtualPerson = other) -> str:
                    return pair(self.subject(owner)[0], other.recording("steps", "proximal", seed=1))

                cells.append(kept(self.results / f"{own.name}_reads_{other.name}.json", find))
                self.say(f"{name} read with the calibration of {owner}: {cells[-1]}")
                good, count = good + (name != owner and cells[-1] != "WRONG"), count + (name != owner)
            yield f"{owner:<10} " + " ".join(f"{what:<8}" for what in cells)
        if count:
            yield f"flagged or covered in {good} of {count} pairs ({good / count:.0%}; at least 90 % are required)"

    def rest(self, rest_s: float) -> Iterator[str]:
        """Presses in some time of rest."""
        for name, person in self.people.items():

            def find(name: str = name, person: VirtualPerson = person) -> int:
                return presses_at_rest(self.subject(name)[0], person, rest_s)

            count = kept(self.results / f"{person.name}_rest_{rest_s:g}s.json", find)
            yield f"{name}: {count} presses in {rest_s:g} s of rest"


def main() -> None:
    requested = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    requested.add_argument("--people", nargs="*", default=record.people(), choices=record.people())
    requested.add_argument("--part", nargs="*", default=PARTS, choices=PARTS, help="what to compute; all if not given")
    requested.add_argument("--keep", type=Path, help="folder that keeps results; a temporary one if not given")
    requested.add_argument("--rate", type=float, default=record.SAMPLE_RATE_HZ, help="of all recordings [Hz]")
    requested.add_argument("--rest-s", type=float, default=3600.0, help="how long people rest [s]")
    requested.add_argument(
        "--calibration", choices=tuple(CALIBRATIONS), default="protocol", help="touches to calibrate on"
    )
    requested.add_argument("--photons", type=int, default=record.PHOTONS, help="of every person's light")
    requested.add_argument("--massless", action="store_true", help="people without inertia: faster, the same to 1e-3")
    requested.add_argument("--without", choices=tuple(DIFFERENCES), help="people are as the fitted model in this")
    requested.add_argument("--json", type=Path, help="file that keeps the scores of touches, for the documentation")
    given = requested.parse_args()
    with tempfile.TemporaryDirectory() as passing:
        with suppress(KeyboardInterrupt):
            run(given, Bench(given, given.keep or Path(passing)))


def run(given: argparse.Namespace, bench: Bench) -> None:
    """Print all requested parts, as they are computed."""
    try:
        if "record" in given.part:
            bench.record()
        if "touches" in given.part:
            bench.touches()
    finally:
        print("\n".join(bench.table()), flush=True)
        bench.keep(given.json)
    lines = {
        "touches": bench.costs,
        "sample": bench.sample,
        "floor": bench.floor,
        "pairs": bench.pairs,
        "rest": lambda: bench.rest(given.rest_s),
    }
    for part, find in lines.items():
        if part in given.part:
            for text in find():
                print(text, flush=True)
    bench.keep(given.json)


if __name__ == "__main__":
    main()
