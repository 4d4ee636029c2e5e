"""MEDIA AND SHAPE TO DETECTED LIGHT: the only package that imports Mitsuba, and only when light is traced."""

from .detect import DetectedLight, RestReadings, open_light, read_rest, rest_of, section
from .tracing import ProgressCallback, TraceProgress, trace
from .transfer import ReweightWarning, Transfer
