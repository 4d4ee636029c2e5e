"""Sampling of light until enough is known: triggers, the driver, and the trace of a scene."""

from .driver import Ending, ProgressCallback, StageProgress, TraceProgress, run_until, seconds_per_sample
from .trace_scene import (
    PHOTONS_ENGINE,
    LightEngine,
    accuracy,
    batch_photons,
    extend,
    led_sources,
    photons_engine,
    trace,
)
from .trigger import LedTrigger, Trigger, out_of_time, share_of_time, unlit

__all__ = [
    "PHOTONS_ENGINE",
    "Ending",
    "LedTrigger",
    "LightEngine",
    "ProgressCallback",
    "StageProgress",
    "TraceProgress",
    "Trigger",
    "accuracy",
    "batch_photons",
    "extend",
    "led_sources",
    "out_of_time",
    "photons_engine",
    "run_until",
    "seconds_per_sample",
    "share_of_time",
    "trace",
    "unlit",
]
