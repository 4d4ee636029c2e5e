"""Cells that are soon made, and few photons and searches where no option sets fewer, in processes that run tests'
commands and pages; sitecustomize.py beside this calls for it in those whose path begins with this folder. Modules are
changed when they are loaded, as a process that has no use for them is to start as soon as ever."""

import sys
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

COARSE_MM = 0.4
PHOTONS_FROM_OUTSIDE, ROUGH_PHOTONS = 1 << 13, 1 << 14
# Of the table of light between places of a board.
FEW_NODES = {"DISTANCE_MM": (0.0, 1.2, 3.5), "BESIDE_WALL_MM": (0.0, 0.6), "PAIRS": 1 << 15}
# Of the touches that a sensor is calibrated with, and of what a calibration requires: two fifths of the time.
SHORT_PROTOCOL = {"SIDE_S": 30.0, "LEAST_TOUCHES": 4, "LEAST_LEVELS": 8, "HOLD_S": (0.3, 1.0), "CLOSING_S": 8.0}


def in_coarse_cells(distance: ModuleType) -> None:
    make = distance.distance_grid

    def distance_grid(*given: Any, spacing_mm: float = COARSE_MM, **more: Any) -> Any:
        return make(*given, spacing_mm=max(spacing_mm, COARSE_MM), **more)

    distance.distance_grid = distance_grid


def on_one_core(backend: ModuleType) -> None:
    """Processes run side by side: threads of each on all cores wait for one another."""
    activate = backend.activate

    def activated(*given: Any, **more: Any) -> Any:
        result = activate(*given, **more)
        backend.set_threads(1)
        return result

    backend.activate = activated


def few_from_outside(ambient: ModuleType) -> None:
    """Few photons leave each photodiode where its light from outside is traced."""
    ambient.trace_ambient.__kwdefaults__["photons"] = PHOTONS_FROM_OUTSIDE


def few_disturbances(oxygen: ModuleType) -> None:
    """An oximeter's bias at the ends and in the middle of what takes a beat of its own."""
    oxygen.FORCES_N, oxygen.REST_BLOOD = oxygen.FORCES_N[::4], oxygen.REST_BLOOD[[0, 2, 5]]


def without_dask(pycompat: ModuleType) -> None:
    """Without Dask arrays, which xarray would load with the first array, as in commands; an import still loads it."""
    if "dask" not in sys.modules:
        sys.modules["dask"] = None  # type: ignore[assignment]
        pycompat._get_cached_duck_array_module("dask")
        del sys.modules["dask"]


def with_values(**values: Any) -> Callable[[ModuleType], None]:
    return lambda module: vars(module).update(values)


CHANGES = {
    "nailoptics.geometry.distance": in_coarse_cells,
    "nailoptics.light.backend": on_one_core,
    "nailoptics.light.detect": with_values(ROUGH_PHOTONS=ROUGH_PHOTONS, SECTION_PHOTONS=1 << 13),
    "nailoptics.scene.protocol": with_values(**SHORT_PROTOCOL),
    "nailoptics.sensor.ambient": few_from_outside,
    "nailoptics.studies.exploration.drawn_people": with_values(RANK_PHOTONS=1 << 13),
    "nailoptics.studies.exploration.explore": with_values(LEAST_BATCH=1 << 10, FLUENCE_PHOTONS=1 << 13),
    "nailoptics.studies.exploration.pair_table": with_values(**FEW_NODES),
    "nailoptics.studies.force.fit": with_values(STARTS=({},), ROUNDS=1),
    "nailoptics.studies.oximetry.oxygen": few_disturbances,
    "nailoptics.studies.placement.place": with_values(BLOCKS=8),
    "nailoptics.studies.placement.robustness": with_values(MOST_PHOTONS=1 << 13),
    "nailoptics.studies.placement.search": with_values(FINEST=1, SHORTLIST=1, REGULAR=1),
    "nailoptics.studies.placement.verification": with_values(PHOTONS=1 << 14),
    "nailoptics.studies.prior_uncertainty": with_values(LEAST_OWN_PHOTONS=1 << 12),
    "xarray.namedarray.pycompat": without_dask,
}


class Changing(MetaPathFinder):
    """Finds the modules that are changed."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in CHANGES else None
        if spec and spec.loader:
            run = spec.loader.exec_module
            spec.loader.exec_module = lambda module: (run(module), CHANGES[name](module))  # type: ignore[method-assign]
        return spec


def install() -> None:
    sys.meta_path.insert(0, Changing())
