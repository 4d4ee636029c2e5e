"""SHAPE: fingertip, nail, bone and board of a scene as watertight interfaces that know both sides."""

from .build import build, shaping, underside
from .distance import SPACING_MM, DistanceGrid, distance_grid
from .model import Face, Geometry, check_watertight
from .regions import AROUND, region_names

__all__ = [
    "AROUND",
    "SPACING_MM",
    "DistanceGrid",
    "Face",
    "Geometry",
    "build",
    "check_watertight",
    "distance_grid",
    "region_names",
    "shaping",
    "underside",
]
