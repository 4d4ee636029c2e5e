"""SHAPE: fingertip, nail, bone and board of a scene as watertight interfaces that know both sides."""

from .build import build, shaping
from .check import Report, check
from .distance import DistanceGrid, distance_grid
from .model import Face, Geometry, nail_coordinates

__all__ = [
    "DistanceGrid",
    "Face",
    "Geometry",
    "Report",
    "build",
    "check",
    "distance_grid",
    "nail_coordinates",
    "shaping",
]
