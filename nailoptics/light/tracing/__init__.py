"""Sampling of light until enough is known: triggers, the loop of all sampling, and the trace of a scene."""

from .trace_scene import accuracy, trace
from .trigger import Ending, ProgressCallback, StageProgress, TraceProgress, Trigger, run_until, unlit
