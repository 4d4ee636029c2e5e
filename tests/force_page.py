"""Keep what the benchmarks of force measured for the page of the documentation."""

import json
from pathlib import Path
from typing import Any

# What the page has of each row, to so many digits.
NUMBERS = ("rms_n", "filter_n", "cubic_n", "components_n", "sigmoid_n", "covered", "half_width_n", "floor_n")
COLUMNS = ("touches", "person", *NUMBERS)
DIGITS = 4


def keep(path: Path, simulator: str, rows: list[dict[str, Any]]) -> None:
    """Write a simulator's rows (touches, and numbers by name) into a file, in place of those it had."""
    people = json.loads(path.read_text())["people"] if path.exists() else []
    people = [row for row in people if row["simulator"] != simulator]
    shown = [{name: row[name] for name in COLUMNS if name in row} for row in rows]
    rounded = [{k: round(v, DIGITS) if isinstance(v, float) else v for k, v in row.items()} for row in shown]
    people += [{"simulator": simulator} | row for row in rounded]
    path.write_text(json.dumps({"people": people}, indent=1) + "\n")
