"""Which region a point lies in, by arithmetic on the grid's tetrahedra."""

import numpy as np

from .cast import Boxes
from .grid import Array, Grid, Indices
from .regions import AIR

BINS = 64
CHUNK = 100_000


class Locator:
    """The tetrahedra of a grid, sorted into boxes: rows along y, even bins across x and z."""

    def __init__(self, grid: Grid) -> None:
        corners, labels, rows = grid.tetrahedra()
        edges = corners[:, 1:] - corners[:, :1]
        solid = np.linalg.det(edges) > 1e-14
        corners, rows, edges = corners[solid], rows[solid], edges[solid]
        flat = corners[:, :, [0, 2]]
        self.rows, self.labels = grid.rows_mm, labels[solid]
        self.low = flat.min(axis=(0, 1))
        self.per_mm = BINS / (flat.max(axis=(0, 1)) - self.low)
        # A little wider than the tetrahedra, so that rounding leaves no point between boxes.
        first = np.clip(((flat.min(axis=1) - 1e-9 - self.low) * self.per_mm).astype(np.int64), 0, BINS - 1)
        last = np.clip(((flat.max(axis=1) + 1e-9 - self.low) * self.per_mm).astype(np.int64), 0, BINS - 1)
        self.boxes = Boxes.sort(first, last, bins=BINS, layer=rows.astype(np.int64), layers=len(self.rows) - 1)
        one, two, three = edges[:, 0], edges[:, 1], edges[:, 2]
        normals = np.stack([np.cross(two, three), np.cross(three, one), np.cross(one, two)], axis=1)
        # From a point, less the origin, to barycentric coordinates 1 to 3.
        self.inverse = normals / np.einsum("ij,ij->i", one, normals[:, 0])[:, None, None]
        self.origin = corners[:, 0].copy()

    def region_at(self, points: Array) -> Indices:
        """Region (k,) at points (k, 3)."""
        points = np.asarray(points, float).reshape(-1, 3)
        chunks = (self._chunk(points[i : i + CHUNK]) for i in range(0, len(points), CHUNK))
        return np.concatenate([np.empty(0, np.int32), *chunks])

    def _chunk(self, points: Array) -> Indices:
        row = np.searchsorted(self.rows, points[:, 1], side="right") - 1
        bins = np.floor((points[:, [0, 2]] - self.low) * self.per_mm).astype(np.int64)
        inside = (row >= 0) & (row < len(self.rows) - 1) & (bins >= 0).all(axis=1) & (bins < BINS).all(axis=1)
        result = np.full(len(points), AIR, np.int32)
        where = np.nonzero(inside)[0]
        found = []
        for tetrahedron, place in self.boxes.pairs(self.boxes.at(bins[where], row[where])):
            offset = points[where[place]] - self.origin[tetrahedron]
            x, y, z = np.einsum("kij,kj->ik", self.inverse[tetrahedron], offset)
            margin = np.minimum(np.minimum(np.minimum(x, y), z), 1 - (x + y + z))
            near = np.nonzero(margin > -1e-9)[0]
            found.append((where[place[near]], margin[near], tetrahedron[near]))
        point, margin, tetrahedron = (np.concatenate([f[i] for f in found]) for i in range(3))
        # Rounding may put a point on a face a little outside both neighbours: the better one takes it.
        best = np.full(len(points), -np.inf)
        np.maximum.at(best, point, margin)
        chosen = margin == best[point]
        result[point[chosen]] = self.labels[tetrahedron[chosen]]
        return result
