"""Rectangles on the flat board, of dies, walls and outlines, along its axes or turned; and the room within a border."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .base import Point

# A turned rectangle is cut into strips along the board's axes on lines of this spacing, the same for all, so that
# neighbours that touch share their steps. Light changes over a multiple of it, the depth of the epoxy.
STRIP_MM = 0.08
NEARLY_STRAIGHT_DEG = 1e-6


@dataclass(frozen=True)
class Rectangle:
    """A rectangle on the board, in nail coordinates (u across, v to the tip). [mm]

    u_min, u_max, v_min, v_max : Its bounds; its edges where it is not turned.
    rotation_deg : How far it is turned, against the clock; 0 to 90. [deg]
    turned_size_mm : Its own size along u and v before it is turned; None if it is not.
    """

    name: str
    u_min: float
    u_max: float
    v_min: float
    v_max: float
    rotation_deg: float = 0.0
    turned_size_mm: Point | None = None

    @property
    def area_mm2(self) -> float:
        """Area. [mm^2]"""
        return self.size_mm[0] * self.size_mm[1]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Size along u and v, before it is turned. [mm]"""
        return self.turned_size_mm or (self.u_max - self.u_min, self.v_max - self.v_min)

    @property
    def center_mm(self) -> tuple[float, float]:
        """Centre (u, v). [mm]"""
        return (self.u_min + self.u_max) / 2, (self.v_min + self.v_max) / 2

    @cached_property
    def corners_mm(self) -> tuple[Point, ...]:
        """Its four corners against the clock. [mm]"""
        (u, v), (du, dv) = self.center_mm, self.size_mm
        corners = ((-du / 2, -dv / 2), (du / 2, -dv / 2), (du / 2, dv / 2), (-du / 2, dv / 2))
        return tuple((u + a, v + b) for a, b in (turned(corner, self.rotation_deg) for corner in corners))

    def overlap_mm(self, other: "Rectangle") -> float:
        """How deep the two rectangles overlap; negative is the gap between them along an edge of either. [mm]"""
        depths = []
        for angle in {self.rotation_deg, other.rotation_deg}:
            here, there = (np.array([turned(corner, -angle) for corner in box.corners_mm]) for box in (self, other))
            depths += list(np.minimum(here.max(0), there.max(0)) - np.maximum(here.min(0), there.min(0)))
        return float(min(depths))

    def holds(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the points lie in it; of its edges the lower ones belong to it."""
        if self.turned_size_mm is None:
            return (u >= self.u_min) & (u < self.u_max) & (v >= self.v_min) & (v < self.v_max)
        (mu, mv), (du, dv) = self.center_mm, self.turned_size_mm
        cos, sin = math.cos(math.radians(self.rotation_deg)), math.sin(math.radians(self.rotation_deg))
        along, across = cos * (u - mu) + sin * (v - mv), cos * (v - mv) - sin * (u - mu)
        return (along >= -du / 2) & (along < du / 2) & (across >= -dv / 2) & (across < dv / 2)

    def strips(self) -> tuple["Rectangle", ...]:
        """Rectangles along the axes that have its area and its moments in u, strip by strip; itself if not turned."""
        if self.turned_size_mm is None:
            return (self,)
        lines = STRIP_MM * np.arange(math.floor(self.v_min / STRIP_MM), math.ceil(self.v_max / STRIP_MM) + 1)
        lines = np.clip(lines, self.v_min, self.v_max)
        strips = []
        for low, high in zip(lines, lines[1:], strict=False):
            piece = _between(_between(self.corners_mm, float(low), 1), -float(high), -1)
            if high > low and (area := area_mm2(piece)) > 0:
                middle = sum((a + c) * (a * d - c * b) for (a, b), (c, d) in sides_of(piece)) / (6 * area)
                half = area / (high - low) / 2
                strips.append(Rectangle(self.name, middle - half, middle + half, float(low), float(high)))
        return tuple(strips)

    @staticmethod
    def around(name: str, center: Point, size: Point, rotation_deg: float = 0.0) -> "Rectangle":
        """The rectangle of a given size around a centre, turned against the clock. [mm, deg]"""
        (u, v), (du, dv), angle = center, size, rotation_deg % 180
        if 90 - NEARLY_STRAIGHT_DEG <= angle < 180 - NEARLY_STRAIGHT_DEG:
            du, dv, angle = dv, du, angle - 90
        if not NEARLY_STRAIGHT_DEG < angle < 90 - NEARLY_STRAIGHT_DEG:
            return Rectangle(name, u - du / 2, u + du / 2, v - dv / 2, v + dv / 2)
        cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
        half_u, half_v = (cos * du + sin * dv) / 2, (sin * du + cos * dv) / 2
        return Rectangle(name, u - half_u, u + half_u, v - half_v, v + half_v, angle, (du, dv))


def sides_of(corners: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """The sides of a closed line, each from corner to corner."""
    return pairwise((*corners, *corners[:1]))


def _between(corners: Sequence[Point], low: float, sign: int) -> list[Point]:
    """What of a convex polygon has sign times v of at least low."""
    inside: list[Point] = []
    for (a, b), (c, d) in sides_of(corners):
        if sign * b >= low:
            inside.append((a, b))
        if (sign * b >= low) != (sign * d >= low):
            share = (sign * low - b) / (d - b)
            inside.append((a + share * (c - a), sign * low))
    return inside


def area_mm2(corners: Sequence[Point]) -> float:
    """Area of a polygon, negative where its corners follow the clock. [mm^2]"""
    return sum(a * d - c * b for (a, b), (c, d) in sides_of(corners)) / 2


def turned(point: tuple[float, float], angle_deg: float) -> tuple[float, float]:
    """A point turned around the origin, against the clock; exact for multiples of 90 degrees."""
    quarters, rest = divmod(angle_deg, 90.0)
    x, y = point
    for _ in range(int(quarters) % 4):
        x, y = -y, x
    if rest:
        cos, sin = math.cos(math.radians(rest)), math.sin(math.radians(rest))
        x, y = cos * x - sin * y, sin * x + cos * y
    return x, y


def has_room(center: Point, half_mm: Point, corners: Sequence[Point], holes: Sequence[Sequence[Point]]) -> bool:
    """Whether a rectangle of half a size lies within a border and outside of its holes; it may touch their lines."""
    # Quick with many corners, and everywhere, while shapely is an extra.
    from matplotlib.path import Path as Line
    from matplotlib.transforms import Bbox

    least = np.asarray(half_mm) - 1e-9
    box = Bbox([center - least, center + least])
    border, *others = (Line([*line, line[0]]) for line in (corners, *holes))
    inside = border.contains_point(center) and not any(hole.contains_point(center) for hole in others)
    return inside and not any(line.intersects_bbox(box, filled=False) for line in (border, *others))


def encloses(x: np.ndarray, y: np.ndarray, corners: Sequence[Point], *holes: Sequence[Point]) -> np.ndarray:
    """Which points [mm] of any shape lie within a border and outside of its holes, bool of that shape."""
    from matplotlib.path import Path as Line

    points = np.column_stack([x.ravel(), y.ravel()])
    inside, *others = (Line([*line, line[0]]).contains_points(points) for line in (corners, *holes))
    return np.logical_and.reduce([inside, *(~hole for hole in others)]).reshape(x.shape)
