"""MEDIA AND SHAPE TO DETECTED LIGHT: the only room that imports Mitsuba, and only when light is traced."""

from .tracing import Progress, trace
from .transfer import RereadWarning, Transfer

__all__ = ["Progress", "RereadWarning", "Transfer", "trace"]
