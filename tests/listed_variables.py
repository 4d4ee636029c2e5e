"""Variables of written datasets beside those that the page of output files lists."""

import json
import runpy
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def assert_listed(folder: Path, *names: str) -> None:
    """Files of these names were written below a folder, with the variables that the page lists, under their words."""
    result = runpy.run_path(str(DOCS / "collect_variables.py"))["collect"](folder)
    listed = json.loads((DOCS / "output_variables.json").read_text(encoding="utf-8"))
    assert result.keys() == {*names}
    for name, made in result.items():
        for variable, words in made["variables"].items():
            known = listed[name]["variables"].get(variable)
            # A unit is not listed where it is that of what was swept.
            assert known is not None and known == words | {"units": known["units"] and words["units"]}, (name, variable)
