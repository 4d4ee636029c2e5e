"""Write output_variables.json: the variables of every dataset in a folder, as commands wrote them there.

    python docs/collect_variables.py FOLDER

A file counts under its own name, and what several of one name hold counts together; of a name that no file has, the
table stays as it is. Few photons do, and these scenes have all variables between them: `simulate` of prototype, shear
and placement; `place` of placement and pulse_oximeter, not cut off; `colour` of nail_colour and heartbeat; `compare`
and `tradeoff` of prototype; `oximeter` of pulse_oximeter, with --recording and then with --readings; `predict` as in
the tutorial on force. A test names the variables of the code that the table lacks.
"""

import json
import sys
from pathlib import Path

import xarray as xr

# What writes each file, in the order of the page.
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
    """What a dataset's variables are: over which dimensions, in which unit, and what they mean."""
    with xr.open_dataset(path, engine="h5netcdf") as data:
        return {
            str(name): {"dims": list(map(str, one.dims))}
            | {key: one.attrs.get(key, "") for key in ("units", "long_name")}
            for name, one in data.variables.items()
        }


def collect(folder: Path) -> dict[str, dict[str, object]]:
    """The variables of all datasets in a folder and below it, by the file's name."""
    found: dict[str, dict[str, object]] = {}
    for name, command in COMMANDS.items():
        for path in sorted(folder.rglob(name)):
            known = found.setdefault(name, {"command": f"nailoptics {command}", "variables": {}})
            known["variables"] |= variables(path)  # type: ignore[operator]
    return found


if __name__ == "__main__":
    table = Path(__file__).with_name("output_variables.json")
    found = json.loads(table.read_text(encoding="utf-8")) | collect(Path(sys.argv[1]))
    table.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
