"""Write output_variables.json: the variables of every dataset in a folder, as commands wrote them there.

    python docs/collect_variables.py FOLDER

Variables of several files of one name are merged; entries for names that the folder lacks are unchanged. Few photons
suffice, and these scenes together have all variables: `simulate` of prototype, shear and placement, one of them with
[ambient]; `place` of placement and pulse_oximeter, not cut off; `colour` of nail_colour; `compare` and `tradeoff` of
prototype; `oximeter` of pulse_oximeter, with --recording and then with --readings; `predict` as in the tutorial on
force. A test lists variables of the code that the table lacks.
"""

import json
import sys
from pathlib import Path

import xarray as xr

# The command that writes each file, in the order of the page.
COMMANDS = {
    "result.nc": "simulate",
    "compare.nc": "compare",
    "place.nc": "place",
    "tradeoff.nc": "tradeoff",
    "colour.nc": "colour",
    "oximeter.nc": "oximeter",
    "oxygen.nc": "oximeter --readings",
    "predict.nc": "predict",
}


def variables(path: Path) -> dict[str, dict[str, object]]:
    """A dataset's variables with their dimensions, units and long names."""
    with xr.open_dataset(path) as data:
        return {
            str(name): {"dims": list(map(str, one.dims))}
            | {key: one.attrs.get(key, "") for key in ("units", "long_name")}
            for name, one in data.variables.items()
        }


def collect(folder: Path) -> dict[str, dict[str, object]]:
    """The variables of all datasets in a folder and below it, by the file's name."""
    files: dict[str, dict[str, object]] = {}
    for name, command in COMMANDS.items():
        for path in sorted(folder.rglob(name)):
            known = files.setdefault(name, {"command": f"nailoptics {command}", "variables": {}})
            known["variables"] |= variables(path)  # type: ignore[operator]
    return files


if __name__ == "__main__":
    table = Path(__file__).with_name("output_variables.json")
    files = json.loads(table.read_text(encoding="utf-8")) | collect(Path(sys.argv[1]))
    table.write_text(json.dumps(files, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
