"""SHAPE: fingertip, nail, bone and board of a scene as watertight interfaces that know both sides."""

from .build import build, shaping, underside
from .distance import DistanceGrid, distance_grid
from .model import Face, Geometry
from .regions import AROUND, region_names
