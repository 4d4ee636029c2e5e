"""Write output_variables.json: the variables of every dataset in a folder, as commands wrote them there.

    python docs/collect_variables.py FOLDER

A file counts under its own name.
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
    table.write_text(json.dumps(collect(Path(sys.argv[1])), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
