"""A labelled curvilinear grid: cells with one region each, the interfaces between them, and the cells as tetrahedra.

Axes are (around, along, outward), right-handed; the first one is closed on itself. Every cell is split in six
tetrahedra along the diagonal from its lowest to its highest corner (Kuhn's split), and every face of a cell along the
diagonal that this split gives it, so that neighbours agree and the grid fills space exactly once.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cast import Array, Indices, Integers
from .regions import AIR

MIN_AREA_MM2 = 1e-12


@dataclass(frozen=True)
class Grid:
    """Nodes and the region of each cell.

    nodes : (a, n + 1, k + 1, 3) float. Corners of the cells; those of one row lie in one plane y = const. [mm]
    labels : (a, n, k) int. Region of each cell; cells may have collapsed to a plane, a line or a point.
    """

    nodes: Array
    labels: Indices

    @property
    def least_volume_mm3(self) -> float:
        """The least volume of the `tetrahedra`: negative where the grid folds. [mm^3]"""
        nodes, sixths = self.nodes.reshape(-1, 3), np.split(self.tetrahedra()[0], 6)
        edges = (np.diff(nodes.take(corners.T, axis=0), axis=0) for corners in sixths)
        return min(float(np.einsum("ij,ij->i", a, np.cross(b, c)).min()) for a, b, c in edges) / 6

    def merged(self) -> tuple[Array, Integers]:
        """The places (v, 3) of nodes, each once, in order, and which of them is each node's, (p,) int."""
        # Adding zero makes one of the two zeros that are equal but differ in their bits.
        points = self.nodes.reshape(-1, 3) + 0.0
        ranks = np.stack([np.unique(x, return_inverse=True)[1] for x in points.T])
        at = np.ravel_multi_index(tuple(ranks), tuple(ranks.max(1) + 1))
        _, first, place = np.unique(at, return_index=True, return_inverse=True)
        return points[first], place

    def tetrahedra(self) -> tuple[Integers, Indices]:
        """Which nodes are corners (m, 4) of all cells but air, and region (m,) of each; volumes are positive where
        nothing folds."""
        shape, paths = self.nodes.shape[:3], []
        steps = np.asarray(np.ravel_multi_index(np.eye(3, dtype=int), shape))
        for order in itertools.permutations(range(3)):
            path = np.cumsum([0, *steps[list(order)]])
            odd = order in ((0, 2, 1), (1, 0, 2), (2, 1, 0))
            paths.append(path[[0, 2, 1, 3]] if odd else path)
        cells = np.nonzero(self.labels != AIR)
        # Past the last node around comes the first.
        corners = (np.array(paths)[:, None] + np.ravel_multi_index(cells, shape)[:, None]) % math.prod(shape)
        return corners.reshape(-1, 4), np.tile(self.labels[cells].astype(np.int32), 6)

    def interfaces(self) -> tuple[Array, Indices, Indices, Indices]:
        """Vertices (v, 3), triangles (m, 3), and the regions (m,) below and above each: every face between two once."""
        a, n, k = self.labels.shape
        i = np.pad(np.arange(a * (n + 1) * (k + 1)).reshape(a, n + 1, k + 1), ((0, 1), (0, 0), (0, 0)), mode="wrap")
        quads, below, above = [], [], []

        def add(low: Indices, high: Indices, corners: list[NDArray[np.int64]]) -> None:
            differ = low != high
            quads.append(np.stack([c[differ] for c in corners], axis=-1))
            below.append(low[differ])
            above.append(high[differ])

        labels = np.pad(self.labels, ((0, 0), (1, 1), (0, 1)), constant_values=AIR)
        add(labels[:, 1:-1, :-1], labels[:, 1:-1, 1:], [i[:-1, :-1, 1:], i[1:, :-1, 1:], i[1:, 1:, 1:], i[:-1, 1:, 1:]])
        inner = labels[:, 1:-1, :-1]
        add(np.roll(inner, 1, 0), inner, [i[:-1, :-1, :-1], i[:-1, 1:, :-1], i[:-1, 1:, 1:], i[:-1, :-1, 1:]])
        add(labels[:, :-1, :-1], labels[:, 1:, :-1], [i[:-1, :, :-1], i[:-1, :, 1:], i[1:, :, 1:], i[1:, :, :-1]])
        q = np.concatenate(quads)
        triangles = np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])
        vertices, place = self.merged()
        triangles = place[triangles]
        # Drop triangles without area, and join those that a collapsed cell left on one another.
        p, q, r = (vertices[triangles[:, i]] for i in range(3))
        keep = np.linalg.norm(np.cross(q - p, r - p), axis=1) / 2 > MIN_AREA_MM2
        low, high = (np.tile(np.concatenate(sides), 2)[keep] for sides in (below, above))
        low, high, stays = _join(triangles[keep], low, high)
        used, flat = np.unique(triangles[keep][stays], return_inverse=True)
        return vertices[used], *(x.astype(np.int32) for x in (flat.reshape(-1, 3), low[stays], high[stays]))


def _join(triangles: NDArray[np.int64], below: Indices, above: Indices) -> tuple[Indices, Indices, NDArray[np.bool_]]:
    """Each stack of triangles on the same three vertices as one: what lies between them has no volume. Returns the
    regions (m,) below and above each triangle, and which triangles stay, (m,) bool."""
    corners = np.ravel_multi_index(np.sort(triangles, axis=1).T, (int(triangles.max()) + 1,) * 3)
    _, first, stack = np.unique(corners, return_index=True, return_inverse=True)
    turned = (triangles[:, [1, 2, 0]] - triangles[:, [0, 1, 2]] > 0).sum(axis=1) == 1
    # How often the way through a stack enters each region more than it leaves it: it leaves one and enters another.
    regions, up = int(max(below.max(), above.max())) + 1, np.where(turned, -1, 1)
    pairs, which = np.unique(np.tile(stack, 2) * regions + np.append(above, below), return_inverse=True)
    entered, (stack, region) = np.bincount(which, np.append(up, -up)), np.divmod(pairs, regions)
    low, high, first = region[entered < 0], region[entered > 0], first[stack[entered > 0]]
    below, above, keep = below.copy(), above.copy(), np.zeros(len(triangles), bool)
    below[first], above[first] = np.where(turned[first], (high, low), (low, high))
    keep[first] = True
    return below, above, keep
