"""Sampling of light until enough is known: triggers, the loop of all sampling, and the trace of a scene."""

from .trace_scene import accuracy, trace
from .trigger import (
    Ending,
    ProgressCallback,
    StageProgress,
    TraceProgress,
    Trigger,
    out_of_time,
    run_until,
    share_of_time,
    unlit,
)
