"""The results of a batch as one dataset over the sweep's axes, and as a table."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from ..io import CorruptError, write_text
from . import reading
from .folder import Folder

DONE, MISSING, FAILED, CORRUPT = "done", "missing", "failed", "corrupt"


def open_results(folder: str | Path, *, course: bool = False) -> xr.Dataset:
    """All results of a batch as one dataset, with the sweep's axes as its first dimensions and as coordinates.

    Scenes that are missing or failed are NaN (numbers), False or empty text; `state` says which.

    course : also what runs over time (volts, blood, force), for which the scenes must share their times.

    Raises: InputError where the folder holds no batch, or its scenes do not fit one dataset.
    """
    place = Folder(Path(folder))
    plan = place.read_plan()
    dims, shape = tuple(plan["dims"]), tuple(plan["dims"].values())
    names = [axis["name"] for axis in plan["axes"]]
    states, found = [], []
    for digest in plan["scenes"]:
        one, state = None, FAILED if place.failure(digest).exists() else MISSING
        try:
            if stored := place.read_result(digest):
                one, state = _one(*stored, course), DONE
                # An axis may be called as a result is: leds.ir.wavelength_nm.
                one = one.rename({name: f"{name}_result" for name in names if name in one.data_vars})
        except CorruptError:
            state = CORRUPT
        states.append(state)
        found.append(one)
    dataset = _stacked(found, dims, shape)
    dataset["state"] = (dims, np.array(states).reshape(shape), {"long_name": "done, missing, failed or corrupt"})
    dataset["digest"] = (dims, np.array(plan["scenes"]).reshape(shape), {"long_name": "digest of the scene"})
    dataset = dataset.assign_coords(_coordinates(plan))
    dataset.attrs |= {"title": f"nailoptics: batch {plan['sweep']}", "Conventions": "CF-1.11"}
    dataset.attrs |= {name: plan[name] for name in ("seed", "backend")}
    return dataset


def _one(header: dict[str, Any], arrays: dict[str, np.ndarray], course: bool) -> xr.Dataset:
    one = reading.from_record(header, arrays)
    if not course:
        one = one.drop_dims("time", errors="ignore").drop_vars("time", errors="ignore")
    error = header["relative_error"]
    return one.assign(
        relative_error=((), np.nan if error is None else error, {"units": "1", "long_name": "largest relative error"}),
        photons=((), float(header["photons_per_led"]), {"units": "1", "long_name": "photons per LED"}),
        reached=((), bool(header["reached"]), {"units": "1", "long_name": "as accurate as requested"}),
    )


def _stacked(found: list[xr.Dataset | None], dims: tuple[str, ...], shape: tuple[int, ...]) -> xr.Dataset:
    """One array per variable over all scenes; what a scene lacks is filled."""
    present = [one for one in found if one is not None]
    if not present:
        return xr.Dataset()
    first = present[0]
    for one in present[1:]:
        for name, coord in first.coords.items():
            if name not in one.coords or not np.array_equal(one.coords[name].values, coord.values):
                raise InputError(
                    f'the scenes of this batch differ in their "{name}", so they are no one dataset; '
                    + ("leave course out." if name == "time" else "sweep scenes with the same names.")
                )
    data = {}
    for name, variable in first.data_vars.items():
        # A type that can say that nothing is there.
        number = np.result_type(variable.dtype, np.float32) if variable.dtype.kind not in "bU" else None
        empty, holding = {"b": (False, bool), "U": ("", object)}.get(variable.dtype.kind, (np.nan, number))
        full = np.full((len(found), *variable.shape), empty, holding)
        for i, item in enumerate(found):
            if item is not None and name in item:
                full[i] = item[name].values
        values = full.astype(str) if full.dtype.kind == "O" else full
        data[name] = ((*dims, *variable.dims), values.reshape(*shape, *variable.shape), variable.attrs)
    coords = {name: (c.dims, c.values, c.attrs) for name, c in first.coords.items()}
    kept = {k: v for k, v in first.attrs.items() if k in ("engine", "versions")}
    return xr.Dataset(data, coords=coords, attrs=kept)


def _coordinates(plan: dict[str, Any]) -> dict[str, Any]:
    """The axes as coordinates; values that are tables or arrays become text."""
    coordinates: dict[str, Any] = {}
    for axis in plan["axes"]:
        values = axis["values"]
        if not all(isinstance(v, bool) for v in values) and all(isinstance(v, int | float) for v in values):
            values = np.array(values)
        elif not all(isinstance(v, str) for v in values):
            values = np.array([str(v) for v in values])
        dim = axis["name"] if axis["name"] in plan["dims"] else "sample"
        coordinates[axis["name"]] = (dim, values, {"long_name": axis["path"]} if axis["path"] else {})
    return coordinates


def write_table(results: xr.Dataset, path: str | Path) -> Path:
    """Write what `open_results` returns as CSV: a row per scene, LED and photodiode, a column per quantity."""
    kept = [n for n, v in results.data_vars.items() if not {"absorber", "part", "zone", "time"} & set(v.dims)]
    for item in results.absorber.values if "mean_path_mm" in results else ():
        for name in ("mean_path_mm", "mean_path_mm_stderr"):
            results = results.assign({f"{name}_{item}": results[name].sel(absorber=item, drop=True)})
            kept.append(f"{name}_{item}")
    write_text(Path(path), results[kept].to_dataframe().to_csv())
    return Path(path)
