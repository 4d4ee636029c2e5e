"""MANY SCENES: sweeps planned, run on one machine or a cluster without losing anything, and opened as one dataset."""

from ..scene.sweep import Axis, Sweep, load_sweep
from .folder import Status, open_results, status, write_table
from .jobs import count
from .run import BatchProgress, Outcome, run_batch, sweep
