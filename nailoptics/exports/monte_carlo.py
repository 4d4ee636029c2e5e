"""A finger for MCX, the voxel Monte Carlo, and MMC, the mesh Monte Carlo: volume or mesh, sessions, and a runner."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..geometry import Face, Geometry, build
from ..geometry.grid import Array, Indices
from ..io import write_bytes
from ..light import optics
from ..scene import Scene
from ..scene.rectangles import turned
from . import compatibility

USUAL_VOXEL_MM = 0.1
# Photons of a session where its runner is given no number.
MMC_PHOTONS, MCX_PHOTONS = 1_000_000, 10_000_000
LABELS = "labels.bin"
# Light that has propagated for so long has been absorbed; of MCX and of MMC. [s]
MCX_LONGEST_S, MMC_LONGEST_S = 1e-8, 1e-7
# What ends photons has the index of the epoxy and this share of it more, which reflects some 1e-11 of light that comes
# straight. Where both are alike, MCX for OpenCL lets photons go on through label 0, and crashes if it keeps paths.
INDEX_STEP = 1e-5
# Detectors reach so much beyond the corners of their photodiode. [voxels]
AROUND = 3.0
# A die's face is moved back by so much of a voxel, so that whatever starts on its true plane starts in the epoxy: half
# the diagonal of a voxel is 0.87 of its side. Faces are backed by so many voxels, as the film may be thinner than one.
DIE_BACK, FACE_DEPTH = 0.87, 3.0
# Voxels whose middle lies on the edge between two quads of a face, but for rounding, belong to it. [voxels]
EDGE = 1e-6
MOST_VOXELS = 200_000_000
# Cones that stand for a die: each is another run, which takes 0.3 s before its first photon.
CONES = 64
# Steps of the lattice across the die and along it, per step of the angle: odd, as the cones are a power of two.
LATTICE = (19, 41)
# Sources start so far below their die, so that they surely lie in the epoxy; MMC counts in float32. [mm]
BELOW_DIE_MM = 1e-4
# Detectors reach so much beyond the corners of their photodiode; what they catch beside it is sorted out.
MARGIN = 1.01
# Six times the volume of a tetrahedron that counts as flat: rounding of cells that have collapsed. [mm^3]
FLAT_MM3 = 1e-14


class Voxels(NamedTuple):
    """Cubes of one region each, (nx, ny, nz) int as the geometry counts them, from a lowest corner, (3,) float. [mm]"""

    region: np.ndarray
    origin_mm: Array
    side_mm: float

    def place(self, points_mm: Array) -> Array:
        """Points in voxels from the lowest corner, as the voxels' own program counts them."""
        return np.asarray((points_mm - self.origin_mm) / self.side_mm)


def voxels(geometry: Geometry, side_mm: float) -> Voxels:
    """Cut a geometry into voxels of the region at their middle, faces of dies and photodiodes whole; InputError if too
    many, or too few for the plate."""
    low, high = geometry.bounds_mm + [[-1.5 * side_mm], [1.5 * side_mm]]
    count = np.ceil((high - low) / side_mm).astype(int) if 0 < side_mm < np.inf else np.zeros(3, int)
    if not 0.01 <= side_mm <= 0.5 or np.prod(count.astype(float)) > MOST_VOXELS:
        why = f"must be between 0.01 and 0.5, and the finger at most {MOST_VOXELS:.0e} voxels."
        raise InputError(f"voxel_mm = {side_mm:g}: {why}")
    made = Voxels(geometry.cells(low, side_mm, count), low, side_mm)
    for face in geometry.photodiodes:
        # Where it is, as all that is opaque beside it: in a recess it would lie in its neighbours' shadow.
        _paint(made, face, geometry.regions.index("epoxy"), back=0.0, beside=EDGE)
    for face in geometry.leds:
        _paint(made, face, geometry.regions.index("epoxy"), back=DIE_BACK, beside=DIE_BACK)
    return made


def _paint(made: Voxels, face: Face, epoxy: int, *, back: float, beside: float) -> None:
    """Put epoxy before a part's face and the part in whole voxels behind it.

    back, beside : how far the face lies behind its true plane, and the epoxy reaches beyond its edges. [voxels]
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


def write_mcx(scene: Scene, folder: Path, *, voxel_mm: float = USUAL_VOXEL_MM) -> dict[str, Path]:
    """Write labels, a session for each LED, a runner and a README to a folder; returns their paths by what they are."""
    exported = compatibility.as_seen(scene, reflecting=False)
    geometry = build(exported)
    made = voxels(geometry, voxel_mm)
    paths = compatibility.write_folder(
        "mcx",
        folder,
        scene,
        [mcx_session(exported, geometry, made, i) for i in range(len(exported.leds))],
        shape=" x ".join(map(str, made.region.shape)),
        side_mm=f"{made.side_mm:g}",
        behind_mm=f"{DIE_BACK * made.side_mm:.3f}",
        about="a session of one LED; coefficients in 1/mm, places in voxels",
        media=", ".join(f"{k} {name}" for k, name in enumerate(("opaque", *optics.absorbers(scene), "air"))),
        photons=MCX_PHOTONS,
    )
    write_bytes(folder / LABELS, labels(exported, geometry, made).tobytes(order="F"))
    return paths | {"labels": folder / LABELS}


def labels(scene: Scene, geometry: Geometry, made: Voxels) -> np.ndarray:
    """Medium of each voxel, (nx, ny, nz) uint8: 0 ends photons, then the absorbers, and air last."""
    names = optics.absorbers(scene)
    # Only the bed's media change along the nail, and with nothing else.
    middles = made.origin_mm[1] + made.side_mm * (np.arange(made.region.shape[1]) + 0.5)
    places = np.column_stack([np.zeros_like(middles), middles, np.zeros_like(middles)])
    labelled = np.empty(made.region.shape, np.uint8)
    for region in range(len(geometry.regions)):
        row = compatibility.absorber_of(scene, geometry, places, np.full(len(places), region))
        row = np.full(len(places), len(names) + 1) if geometry.regions[region] == "air" else row
        np.copyto(labelled, row.astype(np.uint8)[None, :, None], where=made.region == region)
    return labelled


def mcx_session(scene: Scene, geometry: Geometry, made: Voxels, led: int) -> dict[str, Any]:
    """A session of MCX for one LED, as JSON; places are in voxels from the lowest corner."""
    die, own = geometry.leds[led], scene.leds[led]
    quad, normal = die.quads[0], die.normal[0]
    along, across = (side / np.linalg.norm(side) for side in (quad[1] - quad[0], quad[3] - quad[0]))
    # Turned on the board, the die is one rectangle here, not strips.
    axes = [c * across + s * along for c, s in (turned(unit, own.rotation_deg) for unit in ((1.0, 0.0), (0.0, 1.0)))]
    sides = [axis * size / made.side_mm for axis, size in zip(axes, own.size_mm, strict=True)]
    corner = made.place(die.center_mm) - (sides[0] + sides[1]) / 2
    session = compatibility.session_of(
        scene,
        led,
        photons=MCX_PHOTONS,
        longest_s=MCX_LONGEST_S,
        # Air is a medium of its own.
        media=[*compatibility.media_table(scene, geometry, led, index_step=INDEX_STEP), [0.0, 0.0, 1.0, 1.0]],
        origin_mm=made.origin_mm.tolist(),
        photodiode_quads=[made.place(face.quads).tolist() for face in geometry.photodiodes],
    )
    # Photons leave the box of voxels without reflection.
    session["Session"] |= {"BCFlags": "aaaaaa", "SaveDataMask": "DPXV"}
    shape = {"VolumeFile": LABELS, "Dim": list(made.region.shape), "LengthUnit": made.side_mm}
    session["Domain"] |= shape | {"OriginType": 1, "MediaFormat": "byte"}
    source = {"Type": "planar", "Pos": corner.tolist(), "Dir": [*normal.tolist(), "-_Inf_"]}
    source |= {f"Param{k + 1}": [*side.tolist(), 0.0] for k, side in enumerate(sides)}
    session["Optode"] = {
        "Source": source,
        "Detector": [
            {"Pos": made.place(face.center_mm).tolist(), "R": face.reach_mm / made.side_mm + AROUND}
            for face in geometry.photodiodes
        ],
    }
    return session


class TetMesh(NamedTuple):
    """Tetrahedra that share whole faces or none: nodes (n, 3) [mm], those of each (m, 4), and its region (m,)."""

    nodes: Array
    tetrahedra: Indices
    region: Indices


def tetrahedra(geometry: Geometry) -> TetMesh:
    """The cells of a geometry, all but air, as tetrahedra; its interfaces are faces of theirs."""
    (nodes, place), (number, region) = geometry.grid.merged(), geometry.grid.tetrahedra()
    corners = nodes[place[number]]
    solid = np.linalg.det(corners[:, 1:] - corners[:, :1]) > FLAT_MM3
    used, of_used = np.unique(place[number[solid]], return_inverse=True)
    return TetMesh(nodes[used], of_used.reshape(-1, 4).astype(np.int32), region[solid])


def write_mmc(scene: Scene, folder: Path) -> dict[str, Path]:
    """Write a session for each LED, a runner and a README to a folder; returns their paths by what they are."""
    if scene.board.air_gap_um:
        why = (
            "a mesh of tetrahedra has no air, through which no light would pass; export mcx or mitsuba, or leave it out"
        )
        raise InputError(f"board.air_gap_um = {scene.board.air_gap_um:g}: {why}.")
    exported = compatibility.as_seen(scene, reflecting=False)
    geometry = build(exported)
    mesh = tetrahedra(geometry)
    return compatibility.write_folder(
        "mmc",
        folder,
        scene,
        [mmc_session(exported, geometry, mesh, i) for i in range(len(exported.leds))],
        cones=CONES,
        tetrahedra=len(mesh.tetrahedra),
        nodes=len(mesh.nodes),
        about="a session of one LED, mesh included; coefficients in 1/mm",
        media=", ".join(f"{k} {name}" for k, name in enumerate(("opaque", *optics.absorbers(scene)))),
        photons=MMC_PHOTONS,
    )


def mmc_session(scene: Scene, geometry: Geometry, mesh: TetMesh, led: int) -> dict[str, Any]:
    """A session for one LED, as JSON, which the runner gives to pmmc cone by cone."""
    die = geometry.leds[led]
    label = compatibility.absorber_of(scene, geometry, mesh.nodes[mesh.tetrahedra].mean(axis=1), mesh.region)
    places, angles = cones(die, CONES)
    made = compatibility.session_of(
        scene,
        led,
        photons=MMC_PHOTONS,
        longest_s=MMC_LONGEST_S,
        # Tetrahedra of medium 0 end photons. They have the epoxy's index, so that nothing is reflected where they meet
        # it; outside the mesh lies air.
        media=compatibility.media_table(scene, geometry, led),
        sources=[
            {"position_mm": p, "half_angle_rad": a} for p, a in zip(places.tolist(), angles.tolist(), strict=True)
        ],
        photodiode_elements=[(np.flatnonzero(mesh.region == f.region) + 1).tolist() for f in geometry.photodiodes],
    )
    normal = die.normal.mean(axis=0)
    source = {"Dir": (normal / np.linalg.norm(normal)).tolist()}
    # Around all corners of a face, out to where light may leave into its sides.
    spheres = [(f.center_mm, MARGIN * f.reach_mm + math.sqrt(f.area_mm2) / 10) for f in geometry.photodiodes]
    made["Optode"] = {"Source": source, "Detector": [{"Pos": p.tolist(), "R": r} for p, r in spheres]}
    made["Mesh"] = {
        "MeshNode": np.round(mesh.nodes, 7).tolist(),
        "MeshElem": np.column_stack([mesh.tetrahedra + 1, label]).tolist(),
    }
    return made


def cones(die: Face, count: int) -> tuple[Array, Array]:
    """Cones of light that together are a Lambertian die: where each starts, (count, 3) [mm], and its half angle [rad].

    A Lambertian emitter is a mixture of cones of equal brightness inside, whose 1 - cos of the half angle is the
    square root of a number spread evenly over 0-1. Of finitely many, each takes the middle of its step; angles and
    places, which fill the die, lie on a lattice, so that no place goes with wide cones more than another.
    """
    step = np.arange(count)
    u, v = ((step * factor % count + 0.5) / count for factor in LATTICE)
    quads = die.quads
    share = die.areas_mm2 / die.areas_mm2.sum()
    ends = np.cumsum(share)
    facet = np.minimum(np.searchsorted(ends, u, side="right"), len(quads) - 1)
    u, v = ((u - (ends - share)[facet]) / share[facet])[:, None], v[:, None]
    a, b, c, d = quads[facet].swapaxes(0, 1)
    places = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c) + BELOW_DIE_MM * die.normal[facet]
    return places, np.arccos(1 - np.sqrt((step + 0.5) / count))
