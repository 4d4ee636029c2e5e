"""MANY SCENES: sweeps planned, run on one machine or a cluster without losing anything, and opened as one dataset."""

from ..scene.sweep import Axis, Sweep, load_sweep
from .cost import Estimate, estimate
from .results import open_results, write_table
from .run import BatchProgress, Outcome, run_batch
from .status import Status, status

__all__ = [
    "Axis",
    "BatchProgress",
    "Estimate",
    "Outcome",
    "Status",
    "Sweep",
    "estimate",
    "load_sweep",
    "open_results",
    "run_batch",
    "status",
    "write_table",
]
