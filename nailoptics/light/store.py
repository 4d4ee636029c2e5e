"""Transfers on disk: NetCDF, written aside and renamed, so that a file is whole or not there."""

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..errors import InputError
from .moments import Moments
from .transfer import LedTrace, Transfer, rest_state, scene_from_attributes


def write_dataset(dataset: xr.Dataset, path: Path, *, group: str | None = None) -> None:
    """Write a dataset to NetCDF, whole or not at all; raises InputError if the place cannot be written."""
    aside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        dataset.to_netcdf(aside, engine="h5netcdf", group=group)
        aside.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            aside.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written: {error.strerror or error}; choose another place.") from None


def save(transfer: Transfer, path: Path) -> None:
    """Write a transfer; photons of all LEDs lie one after the other along `record`."""
    names = ("photodiode", "weight", "path_mm", "draw")
    columns: dict[str, Any] = {n: np.concatenate([getattr(t, n) for t in transfer.traces]) for n in names}
    data = xr.Dataset(
        {
            "photodiode": ("record", columns["photodiode"]),
            "weight": ("record", columns["weight"]),
            "path_mm": (("record", "absorber"), columns["path_mm"], {"units": "mm"}),
            "draw": ("record", columns["draw"]),
            "keep": ("led", [t.keep for t in transfer.traces]),
            "full": (("led", "detector", "sum"), [_sums(t, transfer) for t in transfer.traces]),
            "records": ("led", [len(t.weight) for t in transfer.traces]),
            "photons": ("led", [t.photons for t in transfer.traces]),
            "mu_a_per_mm": (("led", "absorber"), [t.mu_a for t in transfer.traces], {"units": "mm-1"}),
            "energy": (("led", "part", "moment"), [list(t.energy.values()) for t in transfer.traces]),
        },
        coords={
            "led": list(transfer.leds),
            "absorber": list(transfer.absorbers),
            "part": list(transfer.traces[0].energy),
        },
        attrs={
            **transfer.attributes(),
            "photodiodes": json.dumps(transfer.photodiodes),
            "batch_seeds": json.dumps([t.seeds for t in transfer.traces]),
            "version_table": json.dumps(dict(transfer.versions)),
            "cpu_seconds": transfer.cpu_seconds,
            "wall_seconds": transfer.wall_seconds,
            "events": transfer.events,
        },
    )
    write_dataset(data, path)


def _sums(trace: LedTrace, transfer: Transfer) -> np.ndarray:
    """Sums over all photons at rest, (photodiodes, 3 + 3 absorbers) float; NaN where no record was dropped."""
    full = trace.full
    if full is None:
        return np.full((len(transfer.photodiodes), 3 + 3 * len(transfer.absorbers)), np.nan)
    return np.column_stack([full.weight, full.square, full.path, full.path_square, full.path_cross, full.fourth])


def _full(sums: np.ndarray, photons: int) -> Moments | None:
    """The sums that `_sums` put in a table."""
    if not sums.size or np.isnan(sums).any():
        return None
    path, path_square, path_cross = np.split(sums[:, 2:-1], 3, axis=1)
    return Moments(photons, sums[:, 0], sums[:, 1], path, path_square, path_cross, sums[:, -1])


def load(path: Path) -> Transfer:
    """Read a transfer; raises InputError for a file that is none."""
    try:
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            data = stored.load()
        attrs = data.attrs
        ends = np.cumsum(data.records.values)
        scene = scene_from_attributes(attrs)
        photodiodes = tuple(json.loads(attrs["photodiodes"]))
        traces = []
        for i, (start, end) in enumerate(zip(np.r_[0, ends[:-1]], ends, strict=True)):
            energy = {
                str(p): (float(a), float(b)) for p, (a, b) in zip(data.part.values, data.energy.values[i], strict=True)
            }
            traces.append(
                LedTrace(
                    photons=int(data.photons[i]),
                    mu_a=data.mu_a_per_mm.values[i],
                    photodiode=data.photodiode.values[start:end],
                    weight=data.weight.values[start:end],
                    path_mm=data.path_mm.values[start:end],
                    energy=energy,
                    seeds=tuple(json.loads(attrs["batch_seeds"])[i]),
                    draw=data.draw.values[start:end],
                    keep=float(data["keep"][i]),
                    rest=rest_state(scene, i, len(photodiodes)),
                    full=_full(data["full"].values[i], int(data.photons[i])),
                )
            )
        return Transfer(
            scene=scene,
            photodiodes=photodiodes,
            absorbers=tuple(str(a) for a in data.absorber.values),
            traces=tuple(traces),
            engine=attrs["engine"],
            backend=attrs["backend"],
            versions=json.loads(attrs["version_table"]),
            cpu_seconds=float(attrs["cpu_seconds"]),
            wall_seconds=float(attrs["wall_seconds"]),
            events=int(attrs["events"]),
        )
    except (OSError, KeyError, AttributeError, ValueError) as error:
        raise InputError(f"{path}: is not a transfer that can be read ({type(error).__name__}: {error}).") from None
