"""Grid lines and nodes of a finger with a board: columns around it, rows along it, layers outward."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..tissue import smoothstep
from .board import BentBoard
from .regions import AIR, BED, BONE, CUT, EPIDERMIS, PLATE, PULP
from .surfaces import BONE_ROUNDING_MM, Array, FingerSurfaces, signed_angle

SAGITTA_MM = 0.0019  # how far the nail's facets may lie inside its cylinder
BODY_STEP_MM = 0.8
CUT_SLICE_MM = 1.0
# What no anatomy says, because the depths bound nothing there and only have to stay in their order without flat cells.
TIP_SHARES = (0.3, 0.25, 0.2)  # of the tip beyond the nail, the most that each of the three depths takes
TIP_ORDER = 1.2  # each depth ends at least so many times as far before the tip as the next one
SECTION_SHARES = (0.45, 0.3, 0.2, 0.0)  # of the way to the central line, the most that depths and skin take
WITHIN, BEYOND = 0.8, 1.25  # a depth that bounds nothing lies at these multiples of its neighbour
SNAP_BONE_MM = 0.1  # a thinner gap between bone and bed is closed
MERGE_MM = 1e-3  # edges closer than this share a line, so that no cell is thinner
BELOW = 5  # layers below the skin or the nail's face: bone, pulp, and three between the depths


@dataclass(frozen=True)
class Nodes:
    """Columns, rows and layers of the grid.

    The first `len(theta)` columns cross the nail, at angles theta around the nail's axis; the others go on around the
    finger. Layers from the inside: the central line, the bone's surface, three depths below the skin (the bed's lower
    face, and the plate's and the epidermis's in their order), the skin or the nail's face, and those above the nail.
    """

    surfaces: FingerSurfaces
    board: BentBoard
    resolution: float

    @cached_property
    def theta(self) -> Array:
        """Angles of the nail's columns around its axis, (a_nail,) float. [rad]"""
        radius, edge = self.surfaces.finger.nail_radius_mm, self.surfaces.nail_half_angle
        step = min(self.board.step_mm, np.sqrt(8 * SAGITTA_MM * radius)) / self.resolution
        under = self.board.radius_mm
        required = [-edge * radius, edge * radius]
        required += [u / under * radius for r in self.board.rectangles for u in (r.u_min, r.u_max)]
        dies = [(r.u_min / under * radius, r.u_max / under * radius) for r in self.board.layout.leds]
        return grid_lines(required, step=lambda _: step, closed=dies) / radius

    @cached_property
    def phi(self) -> Array:
        """Angles of all columns around the central line, (a,) float. [rad]"""
        surfaces, nail = self.surfaces, self.surfaces.nail_angle_to_phi(self.theta)
        reach = max(surfaces.finger.width_mm / 2, surfaces.finger.thickness_mm + surfaces.center_z)
        span = 2 * np.pi - (nail[-1] - nail[0])
        count = int(np.ceil(span * reach * self.resolution / BODY_STEP_MM))
        return np.concatenate([nail, nail[-1] + span * np.arange(1, count) / count])

    @cached_property
    def y(self) -> Array:
        """Places of the rows, (n + 1,) float. [mm]"""
        surfaces, end = self.surfaces, self.surfaces.nail_end
        required = [surfaces.cut - CUT_SLICE_MM, surfaces.cut, -end, end]
        required += [v for r in self.board.rectangles for v in (r.v_min, r.v_max)]
        required += [surfaces.tip - x for x in (0.0, *self.tip_depths)]
        if surfaces.bone_end > surfaces.cut:
            required.append(surfaces.bone_end)
        pieces = int(np.ceil(9 * self.resolution))
        arc = np.sin(np.pi / 2 * np.arange(1, pieces) / pieces)
        optional = [
            -end - 0.5,
            *(end + surfaces.beyond_nail * arc),
            *(surfaces.bone_end - BONE_ROUNDING_MM * (1 - arc)),
        ]

        def step(place: float) -> float:
            if place < surfaces.cut:
                return 2 * CUT_SLICE_MM
            size = self.board.step_mm if -end < place < surfaces.tip else BODY_STEP_MM
            return size / self.resolution

        dies = [(r.v_min, r.v_max) for r in self.board.layout.leds]
        return grid_lines(required, optional=optional, step=step, closed=dies)

    @cached_property
    def _depths(self) -> tuple[Array, Array, bool]:
        """Three depths below the nail and below the skin, deepest first, and whether the plate's is the second."""
        finger, deep = self.surfaces.finger, self.surfaces.deep
        plate, bed, epidermis = finger.nail_thickness_mm, finger.bed_thickness_mm, finger.epidermis_thickness_mm
        if epidermis < plate:
            below_nail = [deep, plate, min(epidermis, WITHIN * plate)]
            below_skin = [max(deep, 2 * epidermis), max(plate, BEYOND * epidermis), epidermis]
        else:
            below_nail = [deep, float(np.clip(epidermis, plate + 0.2 * bed, plate + 0.5 * bed)), plate]
            below_skin = [max(deep, 1.5 * epidermis), epidermis, WITHIN * plate]
        return np.array(below_nail), np.array(below_skin), epidermis < plate

    @cached_property
    def tip_depths(self) -> Array:
        """How far before the tip the three depths end, (3,) float. [mm]"""
        deepest, middle, first = np.minimum(self._depths[1], np.array(TIP_SHARES) * self.surfaces.beyond_nail)
        middle = max(TIP_ORDER * first, middle)
        return np.array([max(TIP_ORDER * middle, deepest), middle, first])

    def positions(self) -> Array:
        """Nodes, (a, n + 1, 6 + k, 3) float, k layers of them above the nail. [mm]"""
        surfaces, y = self.surfaces, self.y
        center = np.array([0.0, surfaces.center_z])
        straight = y <= surfaces.nail_end
        ring, beyond = self._layers(y[straight]), y[~straight]
        phi = np.arctan2(ring[:, -1, :, 0], ring[:, -1, :, 1] - surfaces.center_z)
        depths = (*self.tip_depths, 0.0)
        growth = np.stack([self._growth(phi[:, k], beyond, depth) for k, depth in enumerate(depths)], axis=-1)
        tip = center + (ring[:, -1:] - center) * growth[..., None]
        layers = np.concatenate([ring, tip], axis=1)
        line = np.broadcast_to(center, (*layers.shape[:2], 1, 2))
        bone = self._bone(layers[:, :, 0] - center)[:, :, None]
        flat = np.concatenate([line, bone, layers, self._above(layers[:, :, -1])], axis=2)
        along = np.broadcast_to(y[None, :, None], flat.shape[:3])
        return np.stack([flat[..., 0], along, flat[..., 1]], axis=-1)

    def _layers(self, rows: Array) -> Array:
        """The three depths and the skin, (a, n, 4, 2) in (x, z), in rows no further than the nail's free edge."""
        surfaces, radius = self.surfaces, self.surfaces.finger.nail_radius_mm
        below_nail, below_skin, _ = self._depths
        shells = radius - np.append(below_nail, 0.0) + surfaces.fold(rows)[:, None]
        nail = shells[:, :, None] * _direction(self.theta)[:, None, None] - [0.0, radius]
        outer = signed_angle(self.phi[len(self.theta) :])
        body = np.empty((len(outer), len(rows), 4, 2))
        edge = nail[-1] - [0.0, surfaces.center_z]
        around = (np.abs(outer) - self.phi[len(self.theta) - 1]) / (np.pi - self.phi[len(self.theta) - 1])
        for k, depth in enumerate((*below_skin, 0.0)):
            # Under the nail columns point to its axis and elsewhere to the central line; angles that run evenly from
            # the nail's edge to the pulp keep columns from crossing on the way from one to the other.
            edge_phi = np.arctan2(edge[:, k, 0], edge[:, k, 1])
            phi = np.sign(outer)[:, None] * (edge_phi + (np.pi - edge_phi) * around[:, None])
            skin = surfaces.skin(np.concatenate([phi, edge_phi[None]]), rows)
            distance = skin - np.minimum(depth, SECTION_SHARES[k] * skin)
            step = np.linalg.norm(edge[:, k], axis=-1) - distance[-1]
            distance = distance[:-1] + step * (1 - smoothstep(2 * around))[:, None]
            body[:, :, k] = [0.0, surfaces.center_z] + distance[..., None] * _direction(phi)
        return np.concatenate([nail, body])

    def _growth(self, phi: Array, beyond: Array, depth: float) -> Array:
        """Size of the sections beyond the nail, relative to that at its free edge, (a, n) float; 0 at the end."""
        surfaces, end, reach = self.surfaces, self.surfaces.nail_end, self.surfaces.beyond_nail
        stretched = end + (beyond - end) * reach / (reach - depth)
        size = surfaces.skin(phi[:, None], stretched) / surfaces.skin(phi[:, None], np.array([end]))
        return np.where(beyond < surfaces.tip - depth - 1e-6, size, 0.0)

    def _bone(self, bed: Array) -> Array:
        """The bone's surface in each column, at most out to the bed, the deepest layer, (a, n + 1, 2) float both, that
        from the central line. [mm]"""
        surfaces, length = self.surfaces, np.linalg.norm(bed, axis=-1)
        rows = np.broadcast_to(self.y, length.shape)
        bone = np.minimum(surfaces.bone(np.arctan2(bed[..., 0], bed[..., 1]), rows), length)
        bone = np.where(length - bone < SNAP_BONE_MM, length, bone)
        bone = np.where(bone < 0.2 * SNAP_BONE_MM, 0.0, bone)
        center = np.array([0.0, surfaces.center_z])
        part = bone / length.clip(1e-12)
        # A column whose bone touches the bed must share its node to the last bit, else a gap of no width is left.
        return np.where((bone == length)[..., None], center + bed, center + bed * part[..., None])

    def _above(self, surface: Array) -> Array:
        """The layers above the nail, (a, n + 1, k, 2); elsewhere they lie on the skin and hold no cells."""
        radius = self.surfaces.finger.nail_radius_mm
        above = np.repeat(surface[:, :, None], len(self.board.heights_mm), axis=2)
        on_nail = np.abs(self.y) <= self.surfaces.nail_end
        shells = (radius + self.board.heights_mm)[:, None] * _direction(self.theta)[:, None] - [0.0, radius]
        above[: len(self.theta), on_nail] = shells[:, None]
        return above

    def labels(self) -> NDArray[np.int32]:
        """Region of each cell, (a, n, 5 + k) int, k of them above the nail."""
        surfaces, y = self.surfaces, (self.y[1:] + self.y[:-1]) / 2
        plate_is_second = self._depths[2]
        labels = np.full((len(self.phi), len(y), BELOW + len(self.board.heights_mm)), AIR, np.int32)
        labels[:, :, :BELOW] = PULP
        labels[:, y < surfaces.bone_end, 0] = BONE
        labels[:, :, [4] if plate_is_second else [3, 4]] = EPIDERMIS
        nail_columns = np.arange(len(self.theta) - 1)
        nail_rows = np.nonzero(np.abs(y) < surfaces.nail_end)[0]
        for layer, region in zip((2, 3, 4), (BED, PLATE if plate_is_second else BED, PLATE), strict=True):
            labels[:, :, layer][np.ix_(nail_columns, nail_rows)] = region
        middle = (self.theta[1:] + self.theta[:-1]) / 2
        labels[: len(middle), :, BELOW:] = self.board.labels(middle, y)
        labels[:, y < surfaces.cut, :BELOW] = CUT
        return labels


def _direction(angle: Array) -> Array:
    """Unit vectors (..., 2) in (x, z) at angles from z towards x."""
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def grid_lines(
    required: Iterable[float],
    *,
    optional: Iterable[float] = (),
    step: Callable[[float], float],
    closed: Sequence[tuple[float, float]],
) -> NDArray[np.float64]:
    """Lines through every required place, with gaps of at most a step between them.

    required : Places that get a line; the first of several within MERGE_MM stands for all. [mm]
    optional : Places that get a line unless it would come closer than a quarter step to another. [mm]
    step : Largest gap as a function of place. [mm]
    closed : Spans (low, high) that get no line but a required one. [mm]

    Returns: (n,) float, rising. [mm]
    """
    lines: list[float] = []
    for place in sorted(required):
        if not lines or place - lines[-1] > MERGE_MM:
            lines.append(place)

    def is_closed(place: float) -> bool:
        return any(low < place < high for low, high in closed)

    for place in sorted(optional):
        clear = min(abs(place - line) for line in lines) > 0.25 * step(place)
        if lines[0] < place < lines[-1] and clear and not is_closed(place):
            lines.append(place)
    lines.sort()
    result = lines[:1]
    for low, high in zip(lines, lines[1:], strict=False):
        middle = (low + high) / 2
        pieces = 1 if is_closed(middle) else int(np.ceil((high - low) / step(middle) - 1e-9))
        result += [low + (high - low) * i / pieces for i in range(1, pieces)] + [high]
    return np.array(result)
