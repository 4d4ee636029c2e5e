"""MANY SCENES: sweeps planned, run on one machine or a cluster without losing anything, and opened as one dataset."""

from .calibrate import Estimate, estimate
from .results import open_results, write_table
from .run import Outcome, Progress, run_batch
from .status import Status, status
from .sweep import Axis, Sweep, load_sweep

__all__ = [
    "Axis",
    "Estimate",
    "Outcome",
    "Progress",
    "Status",
    "Sweep",
    "estimate",
    "load_sweep",
    "open_results",
    "run_batch",
    "status",
    "write_table",
]
