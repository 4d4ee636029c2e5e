"""Keep what the benchmarks of force measured for the page of the documentation."""

import json
import math
from collections.abc import Callable, Iterable
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

# What the page has of each row, to so many digits.
NUMBERS = ("rms_n", "filter_n", "cubic_n", "components_n", "sigmoid_n", "covered", "half_width_n", "open", "floor_n")
COLUMNS = ("touches", "person", *NUMBERS)
DIGITS = 4
# The people whose touches it draws, at about so many times each.
RANKS = {"best": 0.0, "median": 0.5, "worst": 1.0}
POINTS = 240
SERIES = ("time_s", "known_n", "force_n", "low_n", "high_n")

Series = Callable[[str, str], tuple[Iterable[float], ...]]


def keep(path: Path, simulator: str, rows: list[dict[str, Any]], series: Series) -> None:
    """Write a simulator's rows (touches, and numbers by name) into a file, in place of those it had.

    series : times, measured and estimated forces and their bounds, of a person and touches.
    """
    known = json.loads(path.read_text()) if path.exists() else {}
    shown = [{name: row[name] for name in COLUMNS if name in row} for row in rows]
    rounded = [{k: round(v, DIGITS) if isinstance(v, float) else v for k, v in row.items()} for row in shown]
    new = {"people": rounded, "series": list(_drawn(rows, series))}
    of_all = {
        name: [one for one in known.get(name, []) if one["simulator"] != simulator]
        + [{"simulator": simulator} | one for one in own]
        for name, own in new.items()
    }
    path.write_text(json.dumps(of_all, indent=1) + "\n")


def _drawn(rows: list[dict[str, Any]], series: Series) -> Iterable[dict[str, str]]:
    """The touches of the best, the median and the worst person, by the rms over all; columns in mN, times in ms."""
    by_person = groupby(sorted(rows, key=itemgetter("person")), itemgetter("person"))
    rms_n = {person: math.hypot(*(row["rms_n"] for row in own)) for person, own in by_person}
    ranked = sorted(rms_n, key=rms_n.__getitem__)
    for rank, part in RANKS.items():
        person = ranked[math.floor(part * (len(ranked) - 1))]
        for touches in dict.fromkeys(row["touches"] for row in rows):
            columns = [[*column] for column in series(person, touches)]
            step = max(1, len(columns[0]) // POINTS)
            texts = (" ".join(f"{1e3 * value:.0f}" for value in column[::step]) for column in columns)
            yield {"person": person, "rank": rank, "touches": touches} | dict(zip(SERIES, texts, strict=True))
