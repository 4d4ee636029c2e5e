"""Transfers on disk: archives of arrays, written whole or not at all."""

from pathlib import Path

import numpy as np

from .. import io
from ..errors import InputError
from .moments import Moments
from .records import LedTrace
from .transfer import Transfer, rest_state, scene_from_attributes

_COLUMNS = ("photodiode", "weight", "path_mm", "draw")


def save(transfer: Transfer, path: Path) -> None:
    """Write a transfer; photons of all LEDs lie one after the other."""
    header = {
        **transfer.attributes(),
        "photodiodes": transfer.photodiodes,
        "absorbers": transfer.absorbers,
        "leds": [
            {"records": len(t.weight), "photons": t.photons, "energy": t.energy, "seeds": t.seeds, "keep": t.keep}
            for t in transfer.traces
        ],
        "version_table": dict(transfer.versions),
        "cpu_seconds": transfer.cpu_seconds,
        "wall_seconds": transfer.wall_seconds,
        "events": transfer.events,
    }
    arrays = {name: np.concatenate([getattr(t, name) for t in transfer.traces]) for name in _COLUMNS}
    arrays["mu_a_per_mm"] = np.array([t.mu_a for t in transfer.traces])
    arrays["full"] = np.array([_sums(t, transfer) for t in transfer.traces])
    io.make_folder(path.parent)
    io.write_bytes(path, io.pack(header, arrays))


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
        header, arrays = io.unpack(path.read_bytes())
        scene, photodiodes = scene_from_attributes(header), tuple(header["photodiodes"])
        traces, start = [], 0
        for i, (led, mu_a) in enumerate(zip(header["leds"], arrays["mu_a_per_mm"], strict=True)):
            end = start + led["records"]
            traces.append(
                LedTrace(
                    photons=led["photons"],
                    mu_a=mu_a,
                    energy={part: (a, b) for part, (a, b) in led["energy"].items()},
                    seeds=tuple(led["seeds"]),
                    keep=led["keep"],
                    rest=rest_state(scene, i, len(photodiodes)),
                    full=_full(arrays["full"][i], led["photons"]),
                    **{name: arrays[name][start:end] for name in _COLUMNS},
                )
            )
            start = end
        return Transfer(
            scene=scene_from_attributes(header),
            photodiodes=tuple(header["photodiodes"]),
            absorbers=tuple(header["absorbers"]),
            traces=tuple(traces),
            engine=header["engine"],
            backend=header["backend"],
            versions=header["version_table"],
            cpu_seconds=header["cpu_seconds"],
            wall_seconds=header["wall_seconds"],
            events=header["events"],
        )
    except (OSError, io.CorruptError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: is not a transfer that this version can read ({error}); trace the scene again."
        ) from None
