"""A geometry as voxels, each of one region, and how far their staircase is from the interfaces."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry import Face, Geometry
from ..geometry.grid import Array

# A die's face is moved back by so much of a voxel, so that whatever starts on its true plane starts in the epoxy: half
# the diagonal of a voxel is 0.87 of its side. Faces are backed by so many voxels, as the film may be thinner than one.
DIE_BACK, FACE_DEPTH = 0.87, 3.0
# Voxels whose middle lies on the edge between two quads of a face, but for rounding, belong to it. [voxels]
EDGE = 1e-6
MOST_VOXELS = 200_000_000


@dataclass(frozen=True)
class Voxels:
    """Cubes of one region each, x first.

    region : (nx, ny, nz) int. As the geometry counts them; air around the finger.
    origin_mm : (3,) float. Lowest corner. [mm]
    side_mm : Side of a voxel. [mm]
    """

    region: np.ndarray
    origin_mm: Array
    side_mm: float

    def place(self, points_mm: Array) -> Array:
        """Points in voxels from the lowest corner, as the voxels' own program counts them."""
        return np.asarray((points_mm - self.origin_mm) / self.side_mm)

    def at(self, points_mm: Array) -> np.ndarray:
        """Region of the voxel that each point (n, 3) lies in, (n,) int; the points must be inside."""
        return np.asarray(self.region[tuple(np.floor(self.place(points_mm)).astype(int).T)])

    def area_mm2(self, one: int, other: int) -> float:
        """Area of the staircase between two regions. [mm^2]"""
        faces = 0
        for axis in range(3):
            a, b = np.moveaxis(self.region, axis, 0)[:-1], np.moveaxis(self.region, axis, 0)[1:]
            faces += int(np.count_nonzero((a == one) & (b == other)) + np.count_nonzero((a == other) & (b == one)))
        return faces * self.side_mm**2


def voxels(geometry: Geometry, side_mm: float) -> Voxels:
    """Cut a geometry into voxels, each of the region at its middle; the faces of dies and photodiodes are kept whole.

    Raises: InputError where that would be too many, or too few for the plate.
    """
    low, high = geometry.bounds_mm + [[-1.5 * side_mm], [1.5 * side_mm]]
    count = np.ceil((high - low) / side_mm).astype(int) if 0 < side_mm < np.inf else np.zeros(3, int)
    if not 0.01 <= side_mm <= 0.5 or np.prod(count.astype(float)) > MOST_VOXELS:
        raise InputError(
            f"voxel_mm = {side_mm:g}: must be between 0.01 and 0.5, and the finger at most {MOST_VOXELS:.0e} voxels."
        )
    x, y, z = (low[k] + side_mm * (np.arange(count[k]) + 0.5) for k in range(3))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    region = geometry.columns(places, z).reshape(count)
    made = Voxels(region, low, side_mm)
    for face in geometry.photodiodes:
        # Where it is, as all that is opaque beside it: in a recess it would lie in its neighbours' shadow.
        _paint(made, face, geometry.regions.index("epoxy"), back=0.0, beside=EDGE)
    for face in geometry.leds:
        _paint(made, face, geometry.regions.index("epoxy"), back=DIE_BACK, beside=DIE_BACK)
    return made


def _paint(made: Voxels, face: Face, epoxy: int, *, back: float, beside: float) -> None:
    """Put epoxy before a part's face and the part in whole voxels behind it.

    back : how far the face lies behind its true plane. [voxels]
    beside : how far the epoxy reaches beyond the face's edges. [voxels]
    """
    for quad, normal in zip(face.quads, face.normal, strict=True):
        reach = (FACE_DEPTH + 1) * made.side_mm
        first = np.floor(made.place(quad.min(axis=0) - reach)).astype(int).clip(0)
        last = np.ceil(made.place(quad.max(axis=0) + reach)).astype(int)
        own = made.region[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        offset = made.origin_mm + made.side_mm * (np.moveaxis(np.indices(own.shape), 0, -1) + first + 0.5) - quad[0]
        over = []
        for side in (quad[1] - quad[0], quad[3] - quad[0]):
            length = float(np.linalg.norm(side))
            along = offset @ side / length
            over.append(np.maximum(-along, along - length) / made.side_mm)
        out, behind = np.maximum(*over), -(offset @ normal) / made.side_mm
        own[(out < beside) & (behind >= -1) & (behind < back)] = epoxy
        own[(out < EDGE) & (behind >= back) & (behind < back + FACE_DEPTH)] = face.region
