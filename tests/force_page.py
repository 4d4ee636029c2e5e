"""Keep what the benchmarks of force measured for the page of the documentation."""

import json
from pathlib import Path
from typing import Any


def keep(path: Path, simulator: str, rows: list[dict[str, Any]]) -> None:
    """Write a simulator's rows (touches, and numbers by name) into a file, in place of those it had."""
    people = json.loads(path.read_text())["people"] if path.exists() else []
    people = [row for row in people if row["simulator"] != simulator]
    people += [{"simulator": simulator} | row for row in rows]
    path.write_text(json.dumps({"people": people}, indent=1) + "\n")
