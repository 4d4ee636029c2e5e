"""A finger for MMC, the mesh Monte Carlo: sessions with tetrahedra, media, source and detectors, and a runner."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry import Face, Geometry, build
from ..geometry.grid import Array, Indices
from ..light import optics
from ..scene import Scene
from . import compatibility
from .run_session import MMC_PHOTONS

# Cones that stand for a die: each is another run, which takes 0.3 s before its first photon.
CONES = 64
# Steps of the lattice across the die and along it, per step of the angle: odd, as the cones are a power of two.
LATTICE = (19, 41)
# Sources start so far below their die, so that they surely lie in the epoxy; MMC counts in float32. [mm]
BELOW_DIE_MM = 1e-4
# Detectors reach so much beyond the corners of their photodiode; what they catch beside it is sorted out.
MARGIN = 1.01
# Light that has propagated for so long has been absorbed. [s]
LONGEST_S = 1e-7
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


def tetrahedra(geometry: Geometry) -> TetMesh:
    """The cells of a geometry, all but air, as tetrahedra; its interfaces are faces of theirs."""
    corners, region = geometry.grid.tetrahedra()
    solid = np.linalg.det(corners[:, 1:] - corners[:, :1]) > FLAT_MM3
    nodes, number = np.unique(corners[solid].reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    return TetMesh(nodes, number.reshape(-1, 4).astype(np.int32), region[solid])


def write_mmc(scene: Scene, folder: Path) -> dict[str, Path]:
    """Write a session for each LED, a runner and a README to a folder; returns their paths by what they are."""
    exported = compatibility.as_seen(scene, reflecting=False)
    geometry = build(exported)
    mesh = tetrahedra(geometry)
    there = f"{CONES} cones from {CONES} places of the die, of equal weight: the nearest to it that MMC has"
    own = [("emission of the LEDs", "Lambertian, from the whole die", there)]
    return compatibility.write_folder(
        "mmc",
        folder,
        exported,
        [session(exported, geometry, mesh, i) for i in range(len(exported.leds))],
        rows=compatibility.rows(scene, geometry, own=own),
        tetrahedra=len(mesh.tetrahedra),
        nodes=len(mesh.nodes),
        about="a session of one LED, mesh included; coefficients in 1/mm",
        media=compatibility.numbered(("opaque", *optics.absorbers(scene))),
        photons=MMC_PHOTONS,
    )


def session(scene: Scene, geometry: Geometry, mesh: TetMesh, led: int) -> dict[str, Any]:
    """A session for one LED, as JSON, which the runner gives to pmmc cone by cone."""
    die = geometry.leds[led]
    label = compatibility.absorber_of(scene, geometry, mesh.nodes[mesh.tetrahedra].mean(axis=1), mesh.region)
    places, angles = cones(die, CONES)
    made = compatibility.session_of(
        scene,
        led,
        photons=MMC_PHOTONS,
        longest_s=LONGEST_S,
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
    spheres = [
        (f.center_mm, MARGIN * np.linalg.norm(f.quads - f.center_mm, axis=-1).max() + math.sqrt(f.area_mm2) / 10)
        for f in geometry.photodiodes
    ]
    made["Optode"] = {"Source": source, "Detector": [{"Pos": p.tolist(), "R": float(r)} for p, r in spheres]}
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
