"""Sampling of light until enough is known: stopping criteria, the loop of all sampling, and the trace of a scene."""

from .stopping import Ending, ProgressCallback, StageProgress, StoppingCriterion, TraceProgress, run_until, unlit
from .trace_scene import accuracy, trace
