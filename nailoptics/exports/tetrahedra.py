"""A geometry as tetrahedra that conform to its interfaces: the cells of its own grid, without those that are flat."""

from dataclasses import dataclass

import numpy as np

from ..geometry import Geometry
from ..geometry.grid import Array, Indices, unique_rows

# Six times the volume of a tetrahedron that counts as flat: rounding of cells that have collapsed. [mm^3]
FLAT_MM3 = 1e-14


@dataclass(frozen=True)
class TetMesh:
    """Tetrahedra of one region each, which share whole faces or none.

    nodes : (n, 3) float. [mm]
    tetrahedra : (m, 4) int. Nodes of each, of positive volume.
    region : (m,) int. Region of each, as the geometry counts them.
    """

    nodes: Array
    tetrahedra: Indices
    region: Indices

    @property
    def corners_mm(self) -> Array:
        """Corners of all tetrahedra, (m, 4, 3) float. [mm]"""
        return self.nodes[self.tetrahedra]

    @property
    def volumes_mm3(self) -> Array:
        """Volume of each tetrahedron, (m,) float. [mm^3]"""
        corners = self.corners_mm
        return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6)


def tetrahedra(geometry: Geometry) -> TetMesh:
    """The cells of a geometry, all but air, as tetrahedra; its interfaces are faces of theirs."""
    corners, region = geometry.grid.tetrahedra()
    solid = np.linalg.det(corners[:, 1:] - corners[:, :1]) > FLAT_MM3
    nodes, _, number = unique_rows(corners[solid].reshape(-1, 3))
    return TetMesh(nodes, number.reshape(-1, 4).astype(np.int32), region[solid])
