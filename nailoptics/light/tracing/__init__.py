"""Sampling of light until enough is known: triggers, the driver, and the trace of a scene."""

from .driver import Ending, ProgressCallback, StageProgress, TraceProgress, run_until, seconds_per_sample
from .trace_scene import accuracy, photons_engine, trace
from .trigger import Trigger, out_of_time, share_of_time, unlit

__all__ = [
    "Ending",
    "ProgressCallback",
    "StageProgress",
    "TraceProgress",
    "Trigger",
    "accuracy",
    "out_of_time",
    "photons_engine",
    "run_until",
    "seconds_per_sample",
    "share_of_time",
    "trace",
    "unlit",
]
