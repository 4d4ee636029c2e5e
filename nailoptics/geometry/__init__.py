"""SHAPE: fingertip, nail, bone and board of a scene as watertight interfaces that know both sides."""

from .build import build
from .check import Report, check
from .model import Face, Geometry, nail_coordinates

__all__ = ["Face", "Geometry", "Report", "build", "check", "nail_coordinates"]
